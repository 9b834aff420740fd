"""Receivers that learn in one kind of scenes and are tested in another."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import torch
from numpy.typing import NDArray

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import half_errors
from vocc_torch.measure.link import Link
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.tally import tallies
from vocc_torch.measure.timing import threads
from vocc_torch.measure.train import train
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.studies.classifiers.rivals import Transfer

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


def _trained_or_why(plan: Plan) -> ReceiverBank | str:
    """Train, or say why that cannot be."""
    try:
        return _trained(plan)
    except VoccError as error:
        return str(error)


def _trained(plan: Plan) -> ReceiverBank:
    """Train every receiver of a plan that learns."""
    with threads(1):
        training = train(plan, keep=True)
    names = [name for name in plan.receiver.names if training.making(name).frames]
    return training.bank(names)


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
