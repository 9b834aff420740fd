"""Monte Carlo at the points of an axis: blocks in index order until a stop rule holds.

Blocks are handed out in the order of points and blocks, a few ahead, here or to other processes, and come
back as they are ready. Each is written to its point's ledger at once and added to its point in index order,
so that the result is the same whoever counts.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from typing import NamedTuple, TypeAlias

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.ledger import Label, Ledger, Tally
from vocc_torch.rng import BLOCK_FRAMES

_FIRST_CHECK = 16
"""Blocks between looks at the precision, at first; later a sixteenth of the blocks so far."""


class Part(NamedTuple):
    """A block, or the first frames of it.

    Args:
        block: index of the block.
        frames: how many of its frames are used, from the first on, 1 to 64.
    """

    block: int
    frames: int


@dataclass(frozen=True, slots=True)
class StopRule:
    """When a point has enough frames.

    Args:
        frames: the budget, at least 1.
        target_frame_errors: stop once every receiver has this many frames in error, at least 1, or None.
        precision: stop once every receiver's 95 % interval reaches at most this share of its bit error rate
            to either side, above 0, or None. A receiver without errors never gets there.
        least_ber: a receiver whose interval lies below this rate, 0 to 1, needs no more precision. One
            without errors goes on until even wrong frames with half their bits wrong would lie below it.

    Raises:
        VoccError: a number outside its range. A rule that can never hold is none: the budget ends the point.
    """

    frames: int
    target_frame_errors: int | None = None
    precision: float | None = None
    least_ber: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a rule under which a point would never end, or would end before it began."""
        for name, value in (("frames", self.frames), ("target_frame_errors", self.target_frame_errors)):
            if value is not None and not value >= 1:
                raise VoccError(f"rule.{name} is {value}: it must be at least 1")
        if self.precision is not None and not self.precision > 0:
            raise VoccError(f"rule.precision is {self.precision}: it must be above 0")
        if not 0 <= self.least_ber <= 1:
            raise VoccError(f"rule.least_ber is {self.least_ber}: it must be 0 to 1")

    def parts(self) -> Iterator[Part]:
        """Name the blocks of the whole budget, in order.

        Example:
            >>> list(StopRule(frames=100).parts())
            [Part(block=0, frames=64), Part(block=1, frames=36)]
        """
        for start in range(0, self.frames, BLOCK_FRAMES):
            yield Part(start // BLOCK_FRAMES, min(BLOCK_FRAMES, self.frames - start))

    def reached(self, tallies: Mapping[Label, Tally], blocks: int) -> str | None:
        """Say why a point needs no more frames: ``frame_errors`` or ``precision``; None if it does.

        Args:
            tallies: what was counted so far; comparisons do not matter here.
            blocks: blocks counted so far, at least 1. The precision is looked at after 16, 32, ... blocks and
                later at steps of about a sixteenth: each look is a chance to stop by luck.

        Example:
            >>> StopRule(6400, target_frame_errors=2).reached({("a", 0): Counts(64, 64, 6, 12, 3)}, 1)
            'frame_errors'
        """
        counts = {label: one for label, one in tallies.items() if isinstance(one, Counts)}
        if not counts:
            return None
        if self.target_frame_errors is not None:
            errors: dict[Label, int] = {}
            for label, one in counts.items():
                errors[label[:-1]] = errors.get(label[:-1], 0) + one.frame_errors
            if min(errors.values()) >= self.target_frame_errors:
                return "frame_errors"
        power_of_two = 1 << (blocks.bit_length() - 1)
        if self.precision is None or blocks % max(_FIRST_CHECK, power_of_two // 16):
            return None
        return "precision" if all(map(self._precise, counts.values())) else None

    def _precise(self, counts: Counts) -> bool:
        """Whether a rate is known well enough, or is too low to matter."""
        if self.precision is None or not counts.frames:
            return False
        # Without errors nothing tells how many bits a wrong frame would have: half, as in a lost panel.
        lost = counts.bits / counts.frames / 2
        interval, ber = ber_interval(counts, errors_per_frame_error=lost), counts.ber
        if interval.high <= self.least_ber:
            return True
        reach = self.precision * ber
        return counts.half_errors > 0 and interval.high - ber <= reach and ber - interval.low <= reach


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a point gave: tallies by label, and why it stopped.

    ``stopped_by`` is ``frame_errors``, ``precision`` or ``frames``.
    """

    counts: dict[Label, Tally]
    stopped_by: str


Counted: TypeAlias = Sequence[Mapping[Label, Tally]]
Count: TypeAlias = Callable[[Sequence[Part]], Counted]
Submit: TypeAlias = Callable[[Count, Sequence[Part]], Future[Counted]]
"""Hands a call to whoever is to do it, and returns its future result."""
Progress: TypeAlias = Callable[[int, int, Mapping[Label, Tally]], None]


@dataclass(frozen=True)
class PointWork:
    """A point that is to be counted.

    Args:
        point: its name, which keys its random draws and its rows in the ledger.
        count: counts each of the parts, giving a list of as many mappings; it must be picklable where other
            processes do it.
        rule: when to stop.
        ledger: where its blocks are recorded and known blocks are taken from, or None.
    """

    point: str
    count: Count
    rule: StopRule
    ledger: Ledger | None = None


@dataclass(eq=False)
class _Point:
    """A point that has been begun: blocks that are known and wait for their turn, and the sums so far."""

    index: int
    work: PointWork
    parts: Iterator[Part]
    known: dict[int, tuple[Part, Mapping[Label, Tally]]] = field(default_factory=dict)
    counts: dict[Label, Tally] = field(default_factory=dict)
    blocks: int = 0
    frames: int = 0
    stopped_by: str | None = None
    exhausted: bool = False

    def next_missing(self, blocks: int) -> tuple[Part, ...]:
        """Lay out the next blocks, and give those of them that the ledger does not know."""
        parts, ledger = tuple(islice(self.parts, blocks)), self.work.ledger
        self.exhausted = not parts
        for part in parts:
            counts = None if ledger is None else ledger.find(self.work.point, part.block, part.frames)
            if counts is not None:
                self.known[part.block] = part, counts
        return tuple(part for part in parts if part.block not in self.known)

    def record(self, parts: Sequence[Part], counted: Counted) -> None:
        """Write down what has come back, and keep it for its turn."""
        for part, counts in list(zip(parts, counted, strict=True)):
            if self.work.ledger is not None:
                self.work.ledger.append(self.work.point, part.block, part.frames, counts)
            self.known[part.block] = part, dict(counts)

    def add_known(self, progress: Progress | None) -> None:
        """Add what is known, in order, until the rule holds; what lies beyond it is dropped."""
        while self.stopped_by is None and self.blocks in self.known:
            part, counts = self.known.pop(self.blocks)
            for label, one in counts.items():
                before = self.counts.get(label)
                # A label holds one kind of tally; the two kinds do not add, and would be refused here.
                self.counts[label] = one if before is None else before + one  # type: ignore[operator]
            self.blocks += 1
            self.frames += part.frames
            spent = "frames" if self.frames >= self.work.rule.frames else None
            self.stopped_by = self.work.rule.reached(self.counts, self.blocks) or spent
            if progress is not None:
                progress(self.index, part.frames, self.counts)


def run_points(
    works: Iterable[PointWork],
    submit: Submit,
    *,
    window: int = 1,
    blocks_at_once: int = 1,
    progress: Progress | None = None,
) -> Iterator[Outcome]:
    """Count points one after the other, with blocks of the next ones ahead where there is room.

    A run that is killed loses the calls that were under way and nothing else. Blocks beyond the one at which
    a point's rule first held are thrown away, so neither the window nor the order in which blocks come back
    changes an outcome.

    Args:
        works: the points, in order.
        submit: hands out a call.
        window: most calls handed out at a time, at least 1.
        blocks_at_once: blocks in a call, at least 1.
        progress: called for each block as it is added, with its point's index in ``works``, its frames and
            the point's tallies so far.

    Yields:
        The outcome of each point, in the order of ``works``.

    Raises:
        VoccError: a window or a call without room for a block.

    Example:
        >>> from vocc_torch.measure.workers import Workers
        >>> def count(parts):
        ...     return [{("a", 0): Counts(part.frames, part.frames)} for part in parts]
        >>> works = [PointWork(name, count, StopRule(frames)) for name, frames in (("x", 64), ("y", 100))]
        >>> [outcome.counts["a", 0].frames for outcome in run_points(works, Workers(1).submit)]
        [64, 100]
    """
    for name, value in (("window", window), ("blocks_at_once", blocks_at_once)):
        if value < 1:
            raise VoccError(f"{name} is {value}: it must be at least 1")
    upcoming, points = enumerate(works), deque[_Point]()
    under_way: dict[Future[Counted], tuple[_Point, tuple[Part, ...]]] = {}

    def add_known(point: _Point) -> None:
        point.add_known(progress)
        for future in [one for one, (its, _) in under_way.items() if its is point and point.stopped_by]:
            if future.cancel():  # what has been begun is still recorded when it comes back
                del under_way[future]

    try:
        while True:
            # Fill the window, passing by what is known already; stop where the first point is finished.
            while len(under_way) < window and not (points and points[0].stopped_by):
                point = next((one for one in points if not (one.exhausted or one.stopped_by)), None)
                if point is not None:
                    if missing := point.next_missing(blocks_at_once):
                        under_way[submit(point.work.count, missing)] = point, missing
                    add_known(point)
                elif (begun := next(upcoming, None)) is not None:
                    points.append(_Point(*begun, begun[1].rule.parts()))
                else:
                    break
            if points and points[0].stopped_by:
                first = points.popleft()
                yield Outcome(first.counts, str(first.stopped_by))
            elif under_way:
                # What came back is recorded before the error of another call is raised.
                done, _ = wait(under_way, return_when=FIRST_COMPLETED)
                calls = [(future, *under_way.pop(future)) for future in done]
                for future, point, parts in sorted(calls, key=lambda call: _failed(call[0])):
                    point.record(parts, future.result())
                for point in points:
                    add_known(point)
            else:
                return
    finally:
        for future in under_way:
            future.cancel()
        for future, (point, parts) in under_way.items():
            if future.done() and not _failed(future):
                with suppress(VoccError):  # what ended the run is the error to tell of
                    point.record(parts, future.result())


def _failed(future: Future[Counted]) -> bool:
    """Whether a call that is done has no result."""
    return future.cancelled() or future.exception() is not None
