"""The counting engine: blocks of 64 frames in, errors per frame out, for every executor and stop rule.

A study describes each of its points as a :class:`Job`: which scenes, which locators, which receivers.
:func:`count` hands its blocks out, records each in the store as it comes back, and adds them in index order
until the stop rule holds. Workers, batches and interruptions do not change the outcome.
"""

import itertools
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent import futures
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
import torch

from vocc_torch.errors import VoccError
from vocc_torch.measure import intervals
from vocc_torch.measure.config import Budget, Experiment
from vocc_torch.measure.counts import Counts, half_errors
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.frame_errors import FrameErrors, Key
from vocc_torch.measure.link import Link, Observation
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.pools import Call
from vocc_torch.measure.store import Store
from vocc_torch.receiver.deciders import Bank, needs_preambles
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation import SceneModel

FIRST_LOOK_BLOCKS = 16
"""Blocks between looks at the precision, at first; later a sixteenth of the blocks so far."""

Tallies: TypeAlias = Mapping[tuple[Key, int], Counts]
"""Errors by receiver and group of frames: a contrast bin, or 0 if frames are not sorted."""


class Part(NamedTuple):
    """A block, or the first frames of it.

    Args:
        block: index of the block.
        frames: how many of its frames are used, from the first on, 1 to 64.
    """

    block: int
    frames: int


def parts_of(frames: int) -> Iterator[Part]:
    """Name the blocks of a budget, in order.

    Example:
        >>> list(parts_of(100))
        [Part(block=0, frames=64), Part(block=1, frames=36)]
    """
    for start in range(0, frames, BLOCK_FRAMES):
        yield Part(start // BLOCK_FRAMES, min(BLOCK_FRAMES, frames - start))


NumberedBank: TypeAlias = tuple[str, Bank, int]
"""Receivers, the locator that they are trained with, and the number of their training."""


def group_of(experiment: Experiment, link: Link, seen: Observation) -> torch.Tensor:
    """Return the group that each frame counts in, (B,) int64: its contrast bin, -1 outside all bins; else 0.

    A contrast on an edge between two bins belongs to the upper one; the last bin holds its upper edge too.
    """
    if experiment.axis != "contrast":
        return torch.zeros(len(seen.bits), dtype=torch.int64, device=seen.bits.device)
    contrast = link.simulator.contrast(seen.scene)
    edges = contrast.new_tensor(experiment.values)
    groups = torch.bucketize(contrast, edges, right=True) - 1
    groups = torch.where(contrast == edges[-1], experiment.bins - 1, groups)
    return torch.where(groups < experiment.bins, groups, -1)


@dataclass(frozen=True, eq=False)
class Job:
    """Receivers on the frames of one kind of scenes.

    Args:
        plan: world, reader, locators, seed and batch size.
        model: the scenes.
        point: name that keys their random draws.
        banks: banks of receivers, each with the name of its locator and the number of its training.
        name: name of the job's rows in the store, if several jobs count the same point; ``point`` by default.

    Example:
        >>> from vocc_torch.measure.plan import Experiment, ReceiverPlan, World
        >>> from vocc_torch.receiver.deciders import bank_of
        >>> from vocc_torch.receiver.flda import FLDA
        >>> experiment = Experiment("d", "distance_m", (50.0,))
        >>> plan = Plan(World(device="cpu"), ReceiverPlan(), experiment, Budget(2))
        >>> greyscale = "truth", bank_of(["average_greyscale"], FLDA(3)), 0
        >>> job = Job(plan, plan.world.scene, "d", [greyscale])
        >>> with Workers(1) as workers:
        ...     (outcome,) = count([PointTask(job, Budget(2))], workers)
        >>> outcome.errors.counts[0].frames, outcome.errors.counts[0].bit_errors, outcome.stopped_by
        (2, 5.0, 'frames')
    """

    plan: Plan
    model: SceneModel
    point: str
    banks: Sequence[NumberedBank]
    name: str = ""

    @property
    def rows(self) -> str:
        """The name of its rows in the store."""
        return self.name or self.point

    @property
    def keys(self) -> tuple[Key, ...]:
        """Whose decisions are counted, in order."""
        return tuple(
            Key(locator, name, number)
            for locator, bank, number in self.banks
            for name in bank
        )

    @property
    def finders(self) -> Mapping[str, PanelLocator | None]:
        """What finds the panel, by the name of the view; None takes the simulator's own corners."""
        locators = dict.fromkeys(locator for locator, _, _ in self.banks)
        return self.plan.receiver.finders(list(locators))

    def decisions(
        self, views: Mapping[str, Observation]
    ) -> Iterator[tuple[torch.Tensor, Observation]]:
        """Give for each key the bits of a batch, (B,R,C) bool, and the observation that they were decided on."""
        for locator, bank, _ in self.banks:
            view = views[locator]
            for decider in bank.values():
                yield decider.score(view.readings, view.preambles) >= 0, view

    def __call__(self, parts: Sequence[Part]) -> list[bytes]:
        """Simulate blocks, look for the panel with each locator, let every receiver decide, and count.

        Args:
            parts: of the blocks only the last may be used in part.
        """
        link, batches = Link.of(self.plan), []
        every = link.observe_each(
            self.finders,
            self.model,
            [BlockKey(self.plan.seed, self.point, part.block) for part in parts],
            preambles=needs_preambles([key.receiver for key in self.keys]),
            frames=sum(part.frames for part in parts),
        )
        for views in every:
            rows = []
            for bits, view in self.decisions(views):
                found = view.panels.found
                wrong = half_errors(bits, view.bits, found)
                rows.append(torch.stack([wrong, found.long(), view.misplaced.long()]))
            groups = group_of(self.plan.experiment, link, next(iter(views.values())))
            batches.append(
                torch.cat([torch.stack(rows, 1).flatten(0, 1), groups[None]])
            )
        # In one piece from the device.
        *table, groups = torch.cat(batches, dim=1).cpu().numpy()
        shaped = np.reshape(table, (3, len(self.keys), -1))
        errors = FrameErrors(shaped, groups, link.reader.shape.leds, self.keys)
        starts = range(0, len(parts) * BLOCK_FRAMES, BLOCK_FRAMES)
        return [
            errors.of(frames=slice(start, start + BLOCK_FRAMES)).packed()
            for start in starts
        ]

    def read(self, content: bytes, part: Part) -> FrameErrors:
        """Give the errors that a block's bytes say."""
        leds, experiment = self.plan.world.panel.shape.leds, self.plan.experiment
        errors = FrameErrors.unpacked(content, part.frames, leds, self.keys)
        # Frames may lie in none of several bins.
        least = -1 if experiment.axis == "contrast" else 0
        if errors.groups.min() < least or errors.groups.max() >= experiment.bins:
            raise VoccError(
                "counts have a frame in a group that its point does not have"
            )
        return errors

    def tallies(self, errors: FrameErrors, part: Part) -> Tallies:
        """Count the errors of each receiver in each group of a block's frames."""
        return {
            (key, group): counts
            for group, some in errors.by_group()
            for key, counts in zip(some.keys, some.counts, strict=True)
        }


@dataclass(frozen=True)
class Outcome:
    """What a point gave.

    Args:
        errors: of every receiver in each of its frames.
        counts: their sums.
        stopped_by: why it got no more frames: ``frame_errors``, ``precision`` or ``frames``.
    """

    errors: FrameErrors
    counts: Tallies
    stopped_by: str


Progress = Callable[[int], object]
"""Called for each block as it is added, with its frames."""


@dataclass(eq=False)
class PointTask:
    """A point that is to be counted: blocks that wait for their turn, and the sums so far.

    Args:
        job: counts its blocks.
        rule: when it has enough.
        store: where blocks are recorded and known ones are taken from, or None.
        progress: called for each block as it is added.

    Attributes:
        stopped_by: why it has enough; empty until then.
        exhausted: whether all of its blocks have been taken.
    """

    job: Job
    rule: Budget
    store: Store | None = None
    progress: Progress = lambda frames: None

    def __post_init__(self) -> None:
        """Lay the blocks out."""
        self.counts: dict[tuple[Key, int], Counts] = {}
        self.stopped_by, self.exhausted = "", False
        self._parts = parts_of(self.rule.frames)
        self._waiting: dict[int, tuple[Part, bytes]] = {}
        self._added: list[FrameErrors] = []

    def take(self, blocks: int) -> list[Part]:
        """Take the next blocks, and return the blocks that are not in the store."""
        missing = []
        for part in itertools.islice(self._parts, blocks):
            self.exhausted = BLOCK_FRAMES * (part.block + 1) >= self.rule.frames
            content = None
            if self.store is not None:
                content = self.store.find(self.job.rows, *part)
            if content is None:
                missing.append(part)
            else:
                self._waiting[part.block] = part, content
        return missing

    def record(self, parts: Sequence[Part], contents: Sequence[bytes]) -> None:
        """Write down what has come back, and keep it for its turn."""
        for part, content in zip(parts, contents, strict=True):
            if self.store is not None:
                self.store.add(self.job.rows, *part, content)
            self._waiting[part.block] = part, content

    def add(self) -> None:
        """Add known blocks in order until the stop rule holds; later blocks are not counted."""
        while not self.stopped_by and (blocks := len(self._added)) in self._waiting:
            part, content = self._waiting.pop(blocks)
            self._added.append(errors := self.job.read(content, part))
            for label, counts in self.job.tallies(errors, part).items():
                self.counts[label] = counts + self.counts.get(label, 0)
            spent = "frames" if (blocks + 1) * BLOCK_FRAMES >= self.rule.frames else ""
            self.stopped_by = stop_reason(self.rule, self.counts, blocks + 1) or spent
            self.progress(part.frames)

    @property
    def outcome(self) -> Outcome:
        """What was counted so far, of at least one block."""
        errors = FrameErrors.joined(self._added)
        return Outcome(errors, self.counts, self.stopped_by)


def stop_reason(rule: Budget, tallies: Tallies, blocks: int) -> str | None:
    """Say why a point needs no more frames: ``frame_errors`` or ``precision``; None if it does.

    Args:
        rule: when a point has enough. A rule that can never hold is none: the frames end the point.
        tallies: what was counted so far; further trainings do not matter here.
        blocks: blocks counted so far, at least 1. The precision is looked at after 16, 32, ... blocks and
            later at steps of about a sixteenth: each look is a chance to stop by luck.

    Example:
        >>> tallies = {(Key("truth", "a"), 0): Counts(64, 64, 6, 12, 3)}
        >>> stop_reason(Budget(6400, target_frame_errors=2), tallies, 1)
        'frame_errors'
    """
    # A receiver gets the frames that it would get alone, so its numbers do not depend on other trainings.
    counts = [(key, each) for (key, _), each in tallies.items() if not key.training]
    if counts and rule.target_frame_errors is not None:
        errors = Counter[Key]()
        for key, counted in counts:
            errors[key] += counted.frame_errors
        if min(errors.values()) >= rule.target_frame_errors:
            return "frame_errors"
    power_of_two = 1 << (blocks.bit_length() - 1)
    if rule.precision is None or blocks % max(FIRST_LOOK_BLOCKS, power_of_two // 16):
        return None
    precise = [
        intervals.precise_enough(counted, rule.precision, rule.least_ber)
        for _, counted in counts
    ]
    return "precision" if precise and all(precise) else None


Calls: TypeAlias = dict[Call, tuple[PointTask, list[Part]]]


def count(
    points: Iterable[PointTask], workers: Workers, batch_frames: int = BLOCK_FRAMES
) -> Iterator[Outcome]:
    """Count points one after the other, with blocks of the next ones ahead where there is room.

    A run that is killed loses the blocks that were under way and nothing else.

    Args:
        points: in order.
        workers: who counts.
        batch_frames: frames in a call; its whole blocks are.

    Yields:
        The outcome of each point, in their order.

    Raises:
        VoccError: a store that cannot be written, or a worker that was ended from outside.
    """
    upcoming, begun, calls = iter(points), deque[PointTask](), Calls()
    blocks = max(1, batch_frames // BLOCK_FRAMES)

    def fill() -> None:
        # Passing by what is known already; up to where the first point is finished.
        while len(calls) < workers.window and not (begun and begun[0].stopped_by):
            ahead = (one for one in begun if not (one.exhausted or one.stopped_by))
            if (point := next(ahead, None) or next(upcoming, None)) is None:
                return
            if point not in begun:
                begun.append(point)
            if missing := point.take(blocks):
                calls[workers.submit(point.job, missing)] = point, missing
            point.add()

    try:
        while True:
            fill()
            if begun and begun[0].stopped_by:
                yield begun.popleft().outcome
            elif calls:
                done, _ = futures.wait(calls, return_when=futures.FIRST_COMPLETED)
                _record(done, calls, workers)
                for point in begun:
                    point.add()
            else:
                return
            for call, (point, _) in [*calls.items()]:
                if point.stopped_by and call.cancel():
                    del calls[call]
    finally:
        for call in [*calls]:
            if not call.cancel() and call.done():
                with suppress(Exception):  # what ended the run is the error to tell of
                    _record([call], calls, workers)


def _record(done: Collection[Call], calls: Calls, workers: Workers) -> None:
    """Record what has come back."""
    with ExitStack() as together:  # one wait for the disk
        for store in {calls[call][0].store for call in done}:
            if store is not None:
                together.enter_context(store.together())
        for call in done:
            point, parts = calls.pop(call)
            point.record(parts, workers.result(call))
