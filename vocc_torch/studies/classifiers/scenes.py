"""Receivers that learn in one kind of scenes and are tested in another."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import half_errors
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.plan import Plan, narrowed
from vocc_torch.measure.plug_in_training import built
from vocc_torch.measure.tally import tallies
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.receiver.bank import FLDA_FEATURES, ReceiverBank
from vocc_torch.receiver.classifiers.inputs import Inputs
from vocc_torch.receiver.classifiers.protocol import Batches, Guarded
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.reader import Readings
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation import SceneModel
from vocc_torch.studies.classifiers.rivals import Transfer
from vocc_torch.studies.tradeoff.times import threads

JOB_BLOCKS = 2
"""Test blocks that are handed out at a time."""

Found = tuple[NDArray[np.int64], NDArray[np.bool_]]
"""(T,L,N) half errors by scenes trained on, receiver and frame, and whether the panel was found, (N,)."""


def across_scenes(
    worlds: Mapping[str, Plan], workers: Workers, told: Callable[[str], None]
) -> tuple[list[Transfer], dict[str, str]]:
    """Train in every kind of scenes, and test at home what was trained elsewhere, and the other way round.

    Args:
        worlds: by name, the home first; receivers and budget are the same.
        workers: who does it.
        told: called with what is done next.

    Returns:
        By scenes tested on, then scenes trained on, then receiver; those trained where they are tested are
        among them, and receivers that learn nothing are not. And why scenes are left out, by name: no panel
        was found there, or a receiver could not learn from so few.
    """
    home = next(iter(worlds))
    with worker_losses_told():
        told("training in other scenes")
        training = {name: workers.submit(_trained_or_why, plan) for name, plan in worlds.items()}
        made = {name: future.result() for name, future in training.items()}
        lost = {name: one for name, one in made.items() if isinstance(one, str)}
        banks = {name: one for name, one in made.items() if not isinstance(one, str)}
        if home in lost or len(banks) == 1:
            return [], lost
        told("testing across scenes")
        pairs = {home: tuple(banks), **{name: (home, name) for name in banks if name != home}}
        waiting = {
            name: [
                workers.submit(_Test(worlds[name], {one: banks[one] for one in pairs[name]}), blocks)
                for blocks in _chunks(worlds[name].budget.frames)
            ]
            for name in banks
        }
        found = {name: [part.result() for part in parts] for name, parts in waiting.items()}
    names = banks[home].names
    leds = worlds[home].world.panel.shape.leds
    return [one for name in banks for one in _transfers(names, leds, name, pairs[name], found[name])], lost


def _chunks(frames: int) -> Iterator[tuple[range, int]]:
    """Share blocks out: which ones, and how many of their frames are used."""
    for first in range(0, -(-frames // BLOCK_FRAMES), JOB_BLOCKS):
        last = min(first + JOB_BLOCKS, -(-frames // BLOCK_FRAMES))
        yield range(first, last), min(frames, last * BLOCK_FRAMES) - first * BLOCK_FRAMES


class _Kept:
    """Training panels that are simulated once for all receivers."""

    def __init__(self, link: Link, model: SceneModel, seed: int, frames: int) -> None:
        keys = block_keys(seed, "train", frames)
        self.shape = link.reader.shape
        self.parts: list[tuple[Readings, Tensor, Tensor]] = [
            (seen.readings, seen.bits, seen.panels.found)
            for seen in link.observe(model, keys, preambles=False, frames=frames)
        ]
        if not any(bool(found.any()) for *_, found in self.parts):
            raise VoccError(f"no panel was found in any of {frames} frames")

    def seen_by(self, inputs: Inputs) -> Batches:
        """Give the panels as a classifier sees them; those that were not located are left out."""

        def batches(first: int, count: int) -> Iterator[tuple[Tensor, Tensor]]:
            start = 0
            for readings, bits, found in self.parts:
                rows = slice(max(0, first - start), max(0, min(len(bits), first + count - start)))
                start += len(bits)
                chosen = found[rows]
                if len(chosen):
                    yield inputs.of(readings, readings.cell_px, self.shape)[rows][chosen], bits[rows][chosen]

        return batches


def _trained_or_why(plan: Plan) -> ReceiverBank | str:
    """Train, or say why that cannot be."""
    try:
        return _trained(plan)
    except VoccError as error:
        return str(error)


def _trained(plan: Plan) -> ReceiverBank:
    """Train every receiver of a plan that learns."""
    frames, plugged_in = plan.budget.training_frames, plan.receiver.classifiers
    most = max([frames, *(max(one.frames or 0, one.training.frames) for one in plugged_in)])
    # In batches of a block: sums over LEDs then do not depend on the batch's size.
    link = Link.of(replace(plan, batch_frames=BLOCK_FRAMES))
    own = plan.experiment.training_model(plan.world)
    with threads(1):
        kept: list[tuple[SceneModel, _Kept]] = []

        def panels(model: SceneModel) -> _Kept:
            for known, there in kept:
                if known == model:
                    return there
            kept.append((model, _Kept(link, model, plan.seed, most)))
            return kept[-1][1]

        flda = FLDA(n_features=len(FEATURE_NAMES)).to(link.simulator.device)
        for x, bits in panels(own).seen_by(Inputs())(0, frames):
            flda.update(x, bits)
        classifiers: dict[str, Guarded] = {}
        for one in plugged_in:
            model = narrowed(own, one.scene, f"classifiers.{one.name}.scene")
            guarded, asked = built(one), _Asked(panels(model).seen_by(one.inputs))
            guarded.fit_stream(asked, one.frames or frames)
            if asked.any:
                classifiers[one.name] = guarded
    names = [name for name in plan.receiver.names if name in FLDA_FEATURES or name in classifiers]
    return ReceiverBank(names, flda, classifiers)


@dataclass
class _Asked:
    """Training panels, and whether any were asked for."""

    batches: Batches
    any: bool = False

    def __call__(self, first: int, count: int) -> Iterator[tuple[Tensor, Tensor]]:
        """Give panels ``first`` to ``first + count``."""
        self.any = True
        return self.batches(first, count)


@dataclass(frozen=True)
class _Test:
    """Counts errors on blocks of one kind of scenes, of receivers trained in several."""

    plan: Plan
    banks: Mapping[str, ReceiverBank]

    def __call__(self, chunk: tuple[range, int]) -> Found:
        """Count some blocks' frames."""
        blocks, frames = chunk
        link, experiment = Link.of(self.plan), self.plan.experiment
        model = experiment.training_model(self.plan.world)
        keys = [BlockKey(self.plan.seed, experiment.name, block) for block in blocks]
        wrong, found = [], []
        for seen in link.observe(model, keys, preambles=False, frames=frames):
            scores = [bank.scores(seen.readings, None) for bank in self.banks.values()]
            halves = [
                [half_errors(s >= 0, seen.bits, seen.panels.found) for s in one.values()] for one in scores
            ]
            wrong.append(torch.stack([torch.stack(one) for one in halves]))
            found.append(seen.panels.found)
        return torch.cat(wrong, dim=2).cpu().numpy(), torch.cat(found).cpu().numpy()


def _transfers(
    names: Sequence[str], leds: int, tested: str, trained: tuple[str, ...], parts: Sequence[Found]
) -> Iterator[Transfer]:
    """Count the frames of one kind of scenes."""
    wrong = np.concatenate([part for part, _ in parts], axis=2)
    found = np.concatenate([part for _, part in parts])
    home = trained.index(tested)
    for (place, scene), (row, name) in product(enumerate(trained), enumerate(names)):
        two = np.stack([wrong[home, row], wrong[place, row]])
        (at_home, here), pairs = tallies(two, leds, np.broadcast_to(found, two.shape))
        yield Transfer(name, scene, tested, here, at_home, pairs[0, 1])
