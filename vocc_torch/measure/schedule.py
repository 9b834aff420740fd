"""Count the blocks of many points, here or in other processes; the result is the same in any order.

Blocks are handed out in the order of points and blocks, a few ahead, and come back as they are ready. Each is
written to its point's ledger at once and added to its point in index order.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from typing import Protocol, TypeAlias

from vocc_torch.errors import VoccError
from vocc_torch.measure.ledger import Ledger
from vocc_torch.measure.montecarlo import Label, Outcome, Part, StopRule, Tally

Counted: TypeAlias = Sequence[Mapping[Label, Tally]]
Count: TypeAlias = Callable[[Sequence[Part]], Counted]
Progress: TypeAlias = Callable[[int, int, Mapping[Label, Tally]], None]


class Submit(Protocol):
    """Hands a call to whoever is to do it."""

    def __call__(self, count: Count, parts: Sequence[Part], /) -> Future[Counted]:
        """Give the call's future result."""


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


def submit_here(count: Count, parts: Sequence[Part]) -> Future[Counted]:
    """Count in this process, at once; an error is raised here and now."""
    future: Future[Counted] = Future()
    future.set_result(count(parts))
    return future


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
    submit: Submit = submit_here,
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
        >>> from vocc_torch.measure.counts import Counts
        >>> def count(parts):
        ...     return [{("a", 0): Counts(part.frames, part.frames)} for part in parts]
        >>> works = [PointWork(name, count, StopRule(frames)) for name, frames in (("x", 64), ("y", 100))]
        >>> [outcome.counts["a", 0].frames for outcome in run_points(works)]
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
                _collect(under_way)
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


def _collect(under_way: dict[Future[Counted], tuple[_Point, tuple[Part, ...]]]) -> None:
    """Wait for calls to come back and record them; what came back well before the error of another."""
    done, _ = wait(under_way, return_when=FIRST_COMPLETED)
    calls = [(future, *under_way.pop(future)) for future in done]
    for future, point, parts in sorted(calls, key=lambda call: _failed(call[0])):
        point.record(parts, future.result())


def _failed(future: Future[Counted]) -> bool:
    """Whether a call that is done has no result."""
    return future.cancelled() or future.exception() is not None


def run_point(
    count: Count,
    rule: StopRule,
    *,
    blocks_at_once: int = 1,
    progress: Callable[[int, Mapping[Label, Tally]], None] | None = None,
) -> Outcome:
    """Add blocks of one point in index order until the rule holds.

    Args:
        count: counts each of the parts, giving a list of as many mappings.
        rule: when to stop.
        blocks_at_once: blocks counted in one call, at least 1.
        progress: called after each block with its frames and the counts so far.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> def one_error(parts):
        ...     return [{("a", 0): Counts(p.frames, p.frames, 2, 4, 1)} for p in parts]
        >>> outcome = run_point(one_error, StopRule(frames=640, target_frame_errors=3), blocks_at_once=2)
        >>> outcome.counts["a", 0].frames, outcome.stopped_by
        (192, 'frame_errors')
    """
    told = None if progress is None else lambda _, frames, counts: progress(frames, counts)
    return next(run_points([PointWork("", count, rule)], blocks_at_once=blocks_at_once, progress=told))
