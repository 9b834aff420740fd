"""Receivers that learn in one kind of scenes and are tested in another."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from itertools import product

from vocc_torch.errors import VoccError
from vocc_torch.measure.frame_errors import Banks, FrameErrors, FrameJob
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.timing import threads
from vocc_torch.measure.train import train
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.rng import BLOCK_FRAMES
from vocc_torch.studies.classifiers.rivals import Transfer

JOB_FRAMES = 2 * BLOCK_FRAMES
"""Test frames that are handed out at a time."""


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
        waiting = {name: _test(worlds[name], [banks[one] for one in pairs[name]], workers) for name in banks}
        found = {name: FrameErrors.joined(part.result() for part in parts) for name, parts in waiting.items()}
    names = banks[home].names
    return [one for name in banks for one in _transfers(names, name, pairs[name], found[name])], lost


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


def _test(plan: Plan, banks: Sequence[ReceiverBank], workers: Workers) -> list[Future[FrameErrors]]:
    """Have errors counted on one kind of scenes, of receivers trained in several."""
    locator, model = plan.receiver.locator, plan.experiment.training_model(plan.world)
    receivers = Banks([(locator, bank) for bank in banks])
    job = FrameJob(plan, model, plan.experiment.name, (locator,), receivers)
    return job.handed_out(plan.budget.frames, workers, at_once=JOB_FRAMES)


def _transfers(
    names: Sequence[str], tested: str, trained: tuple[str, ...], errors: FrameErrors
) -> Iterator[Transfer]:
    """Count the frames of one kind of scenes."""
    home = trained.index(tested) * len(names)
    for (place, scene), (row, name) in product(enumerate(trained), enumerate(names)):
        both = errors.of([home + row, place * len(names) + row])
        at_home, here = both.counts
        yield Transfer(name, scene, tested, here, at_home, both.pairs[0, 1])
