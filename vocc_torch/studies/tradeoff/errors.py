"""Count every receiver's errors on the same frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.measure.counts import half_errors
from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.workers import Workers
from vocc_torch.rng import BLOCK_FRAMES, BlockKey, FrameKey
from vocc_torch.simulation import SceneModel, Simulator
from vocc_torch.studies.tradeoff.chain import Chain
from vocc_torch.studies.tradeoff.plan import TradeoffStudy
from vocc_torch.types import Frames, Panels, Scene

JOB_BLOCKS = 4
"""Blocks of 64 frames that are handed out at a time."""

Found = tuple[NDArray[np.int64], NDArray[np.bool_]]
"""(L,N) half errors by receiver and frame, and whether the panel was found."""


@dataclass(frozen=True)
class Shot:
    """Frames of some scenes, with their preambles where a receiver needs them.

    Args:
        scene: the scenes.
        bits: (B,R,C) what was sent.
        keys: a key a frame.
        frames: the frames.
        preambles: the all-On and the all-Off frames, or nothing.
    """

    scene: Scene
    bits: Tensor
    keys: Sequence[FrameKey]
    frames: Frames
    preambles: tuple[Frames, ...]


def shots(
    simulator: Simulator,
    model: SceneModel,
    keys: Sequence[BlockKey],
    batch: int,
    *,
    preambles: bool,
    panel_only: bool = False,
) -> Iterator[Shot]:
    """Render blocks in batches.

    Args:
        simulator: the simulator.
        model: the scenes.
        keys: the blocks.
        batch: frames at a time.
        preambles: whether all-On and all-Off frames are wanted too.
        panel_only: whether what lies far from the panel may be left out.
    """
    drawn = [model.draw(key, simulator.panel.shape) for key in keys]
    scenes, sent = Scene.cat([s for s, _ in drawn]), torch.cat([b for _, b in drawn])
    names = [FrameKey(key, frame) for key in keys for frame in range(BLOCK_FRAMES)]
    for start in range(0, len(scenes), batch):
        rows = slice(start, start + batch)
        scene, bits = scenes[rows].to(simulator.device), sent[rows].to(simulator.device)
        takes = [("", bits)]
        if preambles:
            takes += [("on", torch.ones_like(bits)), ("off", torch.zeros_like(bits))]
        rendered = [
            simulator.render(
                scene,
                shown,
                nearest_m=model.nearest_m,
                keys=[replace(key, take=take) if take else key for key in names[rows]],
                panel_only=panel_only,
            )
            for take, shown in takes
        ]
        yield Shot(scene, bits, names[rows], rendered[0], tuple(rendered[1:]))


def located(simulator: Simulator, chains: Sequence[Chain], shot: Shot) -> dict[str, Panels]:
    """Locate the panel with each of the receivers' locators."""
    locators = {chain.setting.locator: chain.locator for chain in chains}
    return {
        name: simulator.true_panels(shot.scene, shot.keys)
        if locator is None
        else locator(shot.frames, simulator.panel.shape)
        for name, locator in locators.items()
    }


@dataclass(frozen=True)
class CountJob:
    """Counts errors on some blocks of one kind of scenes, here or in a worker.

    Args:
        plan: the study's plan.
        model: the scenes.
        point: what keys their draws.
        chains: the receivers.
    """

    plan: Plan
    model: SceneModel
    point: str
    chains: Sequence[Chain]

    def __call__(self, blocks: Sequence[int]) -> Found:
        """Count the blocks' frames."""
        simulator = self.plan.world.simulator()
        keys = [BlockKey(self.plan.seed, self.point, block) for block in blocks]
        preambles = any(chain.needs_preambles for chain in self.chains)
        wrong, found = [], []
        # Nobody who knows the corners looks anywhere else.
        known = all(chain.locator is None for chain in self.chains)
        batch = self.plan.batch_frames
        for shot in shots(simulator, self.model, keys, batch, preambles=preambles, panel_only=known):
            panels = located(simulator, self.chains, shot)
            wrong.append(torch.stack(list(self._wrong(shot, panels))))
            found.append(torch.stack([panels[chain.setting.locator].found for chain in self.chains]))
        return torch.cat(wrong, dim=1).cpu().numpy(), torch.cat(found, dim=1).cpu().numpy()

    def _wrong(self, shot: Shot, panels: Mapping[str, Panels]) -> Iterator[Tensor]:
        """Give each receiver's half errors, (B,)."""
        # Receivers that differ in what comes after share the rectified panels.
        patches: dict[tuple[str, int, str], Tensor | None] = {}
        for chain in self.chains:
            setting, where = chain.setting, panels[chain.setting.locator]
            key = setting.locator, setting.samples_per_led, setting.dtype
            if chain.rectifies and key not in patches:
                patches[key] = chain.rectify(shot.frames, where)
            seen = patches[key] if chain.rectifies else None
            threshold = chain.threshold(shot.preambles, where)
            decided = chain.classify(chain.features(shot.frames, where, seen), threshold)
            yield half_errors(decided, shot.bits, where.found)


def count_errors(study: TradeoffStudy, chains: Sequence[Chain], workers: Workers) -> dict[str, FrameErrors]:
    """Count every receiver's errors on the budget's frames of each kind of scenes.

    Args:
        study: the study.
        chains: the trained receivers, on the device of the plan's world.
        workers: who does it.
    """
    frames, leds = study.plan.budget.frames, study.plan.world.panel.shape.leds
    blocks = range(-(-frames // BLOCK_FRAMES))
    waiting = {}
    for name in study.scenes:
        job = CountJob(study.plan, study.model(name), study.point(name), chains)
        waiting[name] = [
            workers.submit(job, blocks[start : start + JOB_BLOCKS])
            for start in range(0, len(blocks), JOB_BLOCKS)
        ]
    counted = {}
    for name, parts in waiting.items():
        wrong, found = zip(*(part.result() for part in parts), strict=True)
        counted[name] = FrameErrors(
            np.concatenate(wrong, axis=1)[:, :frames], np.concatenate(found, axis=1)[:, :frames], leds
        )
    return counted
