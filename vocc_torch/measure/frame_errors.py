"""What every receiver of a list got wrong in each of the same frames: simulated, counted and compared.

:meth:`FrameJob.count` is the one loop that counts errors by frame. A study says which scenes (``model``,
``point``), where panels are looked for (``locators``) and what decides (``receivers``); it gets
:class:`FrameErrors`, a row for each receiver, from which counts, comparisons and intervals follow.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts, half_errors
from vocc_torch.measure.estimate import CONFIDENCE, Estimate, all_pairs, joint_confidence
from vocc_torch.measure.link import Link, Observation
from vocc_torch.measure.paired import PairedCounts, paired_interval
from vocc_torch.measure.plan import Locator, Plan
from vocc_torch.measure.workers import Workers
from vocc_torch.receiver.bank import ReceiverBank, needs_preambles
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation import SceneModel


@dataclass(frozen=True, eq=False)
class FrameErrors:
    """What L receivers got wrong in each of the same N frames of one kind of scenes.

    Args:
        half_errors: (L,N) int64, wrong bits, times two, 0 to twice ``leds``; ``leds`` where no panel was
            found, since every bit is then a coin toss.
        found: (L,N) bool, whether the receiver's locator found the panel.
        leds: bits in a frame, at least 1.
        groups: (N,) int64, what the frames were sorted by, or None.
        misplaced: (L,N) bool, whether the panel was missed or located off its place, or None if unknown.

    Raises:
        VoccError: frames of so many bits that 64 bits do not hold the sum of squared errors.

    Example:
        >>> half = np.array([[4, 0, 64], [0, 2, 64]])
        >>> errors = FrameErrors(half, np.array([[True, True, False]] * 2), leds=64)
        >>> [one.half_errors for one in errors.counts], errors.first(2).counts[0].bit_errors
        ([68, 66], 2.0)
        >>> errors.pairs[0, 1].half_difference, errors.pairs[0, 1].discordant
        (2, 2)
    """

    half_errors: NDArray[np.int64]
    found: NDArray[np.bool_]
    leds: int
    groups: NDArray[np.int64] | None = None
    misplaced: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        """Refuse more than 64 bits can count."""
        frames = self.half_errors.shape[1]
        if frames * (2 * int(self.leds)) ** 2 > np.iinfo(np.int64).max:
            raise VoccError.of("leds", self.leds, f"less: squared errors of {frames} frames overflow 64 bits")

    @classmethod
    def joined(cls, parts: Iterable[Self]) -> Self:
        """Join parts with the same receivers, at least one: the frames of the first, then of the second."""
        every = list(parts)
        halves, found = ([getattr(one, name) for one in every] for name in ("half_errors", "found"))
        groups = [one.groups for one in every if one.groups is not None]
        sorted_by = np.concatenate(groups) if groups else None
        misplaced = [one.misplaced for one in every if one.misplaced is not None]
        off = np.concatenate(misplaced, axis=1) if misplaced else None
        joined = np.concatenate(halves, axis=1), np.concatenate(found, axis=1)
        return cls(*joined, every[0].leds, sorted_by, off)

    def first(self, frames: int) -> Self:
        """Give the same of the first frames alone, 1 to N of them."""
        return self.of(frames=slice(frames))

    def of(
        self, receivers: slice | Sequence[int] = slice(None), frames: slice | NDArray[np.bool_] = slice(None)
    ) -> Self:
        """Give the same of some receivers, by their places, and of some frames, by place or where True."""
        halves, found = self.half_errors[receivers][:, frames], self.found[receivers][:, frames]
        groups = None if self.groups is None else self.groups[frames]
        off = None if self.misplaced is None else self.misplaced[receivers][:, frames]
        return type(self)(halves, found, self.leds, groups, off)

    @classmethod
    def pooled(cls, trainings: Sequence[Self]) -> Self:
        """Give the errors of several trainings together: a frame holds the bits of all of them.

        Args:
            trainings: of the same receivers on the same frames.
        """
        first = trainings[0]
        halves = np.sum([one.half_errors for one in trainings], axis=0)
        found = np.all([one.found for one in trainings], axis=0)
        return cls(halves, found, first.leds * len(trainings), first.groups, first.misplaced)

    @cached_property
    def counts(self) -> list[Counts]:
        """Errors of each receiver, as :meth:`Counts.of` counts them."""
        frames = self.half_errors.shape[1]
        missed = frames - self.found.sum(axis=1, keepdims=True)
        off = np.zeros_like(self.found) if self.misplaced is None else self.misplaced
        of_location = np.stack([off.sum(axis=1), (self.half_errors * off).sum(axis=1)], axis=1)
        rows = np.hstack([_sums(self.half_errors), missed, of_location]).tolist()
        return [Counts(frames, frames * self.leds, *sums) for sums in rows]

    @cached_property
    def pairs(self) -> dict[tuple[int, int], PairedCounts]:
        """Comparisons by the places (a, b), a before b.

        All in one pass, at a small part of the time: 16 receivers make 120 pairs.
        """
        receivers, frames = self.half_errors.shape
        first, second = np.triu_indices(receivers, k=1)
        apart = self.half_errors[first] - self.half_errors[second]
        sides = np.hstack([_sums(np.maximum(apart, 0)), _sums(np.maximum(-apart, 0))]).tolist()
        places = zip(first.tolist(), second.tolist(), sides, strict=True)
        return {(a, b): PairedCounts(frames, frames * self.leds, *sums) for a, b, sums in places}

    def paired(self, a: int, b: int) -> PairedCounts:
        """Compare two receivers by their places, in either order."""
        if a == b:
            return PairedCounts(self.half_errors.shape[1], self.half_errors.shape[1] * self.leds)
        return self.pairs[a, b] if a < b else self.pairs[b, a].swapped()

    def compared(self, a: int, b: int, confidence: float = CONFIDENCE) -> Estimate:
        """Estimate the rate of receiver ``a`` less that of ``b``, by their places.

        Args:
            a: a row of ``half_errors``.
            b: another one.
            confidence: of the interval, above 0, below 1.
        """
        return paired_interval(self.paired(a, b), confidence)

    def surely_worse(self, a: int, b: int) -> bool:
        """Whether a's rate is above b's by intervals of all pairs that hold together at 95 %."""
        return self.compared(a, b, joint_confidence(all_pairs(len(self.half_errors)))).low > 0


def _sums(errors: NDArray[np.int64]) -> NDArray[np.int64]:
    """Give the sum, the sum of squares and the number above 0 of each row, (L,3)."""
    squared = np.einsum("ln,ln->l", errors, errors)
    return np.stack([errors.sum(axis=1), squared, np.count_nonzero(errors, axis=1)], axis=1)


Receivers = Callable[[Mapping[str, Observation]], Iterable[tuple[torch.Tensor, Observation]]]
"""What decides one batch, given what was observed of its frames by locator; picklable where workers do it.

It yields for each receiver, in the same order every time, its bits (B,R,C) bool and the observation that it
decided on.
"""


@dataclass(frozen=True, eq=False)
class Banks:
    """Receivers of one or more banks, a row for each receiver, bank after bank.

    Args:
        banks: each with the name of the locator whose readings it decides on. The same locator may stand
            here more than once, for receivers that trained on several scenes.
    """

    banks: Sequence[tuple[str, ReceiverBank]]

    def __call__(self, views: Mapping[str, Observation], /) -> Iterator[tuple[torch.Tensor, Observation]]:
        """Decide one batch, as ``Receivers`` says."""
        for locator, bank in self.banks:
            seen = views[locator]
            for scores in bank.scores(seen.readings, seen.preambles).values():
                yield scores >= 0, seen

    @property
    def needs_preambles(self) -> bool:
        """Whether any of the receivers needs frames of known bits."""
        return any(needs_preambles(bank.names) for _, bank in self.banks)


Told = Callable[[int], None]
"""Called with the frames done since the last call."""

Sorter = Callable[[Link, Observation], torch.Tensor]
"""Gives the group (B,) int64 of each frame of a batch."""


@dataclass(frozen=True, eq=False)
class FrameJob:
    """Counts errors on frames of one kind of scenes; picklable, so that workers do it.

    Args:
        plan: world, reader, seed and batch size.
        model: the scenes.
        point: name that keys their random draws.
        locators: names of the locators.
        receivers: what decides.
        preambles: whether a receiver needs the all-On and all-Off frames of each scene.
        sorter: sorts the frames into groups, or None.

    Example:
        >>> from pathlib import Path
        >>> from vocc_torch.measure.plan import Budget, Experiment, ReceiverPlan, World
        >>> from vocc_torch.receiver.flda import FLDA
        >>> experiment = Experiment("d", "distance_m", (50.0,))
        >>> plan = Plan(World(device="cpu"), ReceiverPlan(), experiment, Budget(2), Path("runs"))
        >>> greyscale = Banks([("truth", ReceiverBank(["average_greyscale"], FLDA(3)))])
        >>> job = FrameJob(plan, plan.world.scene, "d", ("truth",), greyscale, greyscale.needs_preambles)
        >>> with Workers(1) as workers:
        ...     errors = job.handed_out(2, workers)()
        >>> errors.counts[0].frames, errors.counts[0].bit_errors
        (2, 0.0)
    """

    plan: Plan
    model: SceneModel
    point: str
    locators: tuple[Locator, ...]
    receivers: Receivers
    preambles: bool = False
    sorter: Sorter | None = None

    def count(self, blocks: Iterable[int], frames: int, first: int = 0) -> FrameErrors:
        """Simulate blocks, look for the panel with each locator, let every receiver decide, and count.

        Args:
            blocks: indices of the point's blocks.
            frames: how many frames of these to use, from the first on.
            first: how many of them to pass over.
        """
        link, keys = Link.of(self.plan), [BlockKey(self.plan.seed, self.point, block) for block in blocks]
        finders, preambles = self.plan.receiver.finders(self.locators), self.preambles
        wrong, found, off, groups = [], [], [], []
        every = link.observe_each(finders, self.model, keys, preambles=preambles, frames=frames, first=first)
        for views in every:
            seen = next(iter(views.values()))
            decided = list(self.receivers(views))
            halves = [half_errors(bits, view.bits, view.panels.found) for bits, view in decided]
            wrong.append(torch.stack(halves))
            found.append(torch.stack([view.panels.found for _, view in decided]))
            off.append(torch.stack([view.misplaced for _, view in decided]))
            if self.sorter is not None:
                groups.append(self.sorter(link, seen))
        wrong_there, located, misplaced = (
            torch.cat(parts, dim=1).cpu().numpy() for parts in (wrong, found, off)
        )
        sorted_by = torch.cat(groups).cpu().numpy() if groups else None
        return FrameErrors(wrong_there, located, link.reader.shape.leds, sorted_by, misplaced)

    def __call__(self, frames: range) -> FrameErrors:
        """Count some of the point's frames, which are named by their indices, from 0 on."""
        blocks = range(frames.start // BLOCK_FRAMES, -(-frames.stop // BLOCK_FRAMES))
        before = blocks.start * BLOCK_FRAMES
        return self.count(blocks, frames.stop - before, frames.start - before)

    def handed_out(
        self, frames: int, workers: Workers, *, at_once: int = 4 * BLOCK_FRAMES, told: Told | None = None
    ) -> Callable[[], FrameErrors]:
        """Hand out the point's first frames; what is returned waits for what came of them.

        Args:
            frames: how many, at least 1.
            workers: who does it; they change no count.
            at_once: frames in a call, at least 1; best a multiple of a block.
            told: called with the frames of each call when it is done.
        """
        calls = []
        for first in range(0, frames, at_once):
            part = range(first, min(first + at_once, frames))
            calls.append(workers.submit(self, part))
            if told is not None:
                calls[-1].add_done_callback(partial(lambda done, _: told(done), len(part)))
        return lambda: FrameErrors.joined(call.result() for call in calls)
