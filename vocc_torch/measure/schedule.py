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
from vocc_torch.measure.montecarlo import Label, Outcome, Part, Running, StopRule, Tally

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
class _Call:
    """Blocks that were handed out together, and what is known of each of them."""

    work: PointWork
    parts: tuple[Part, ...]
    known: list[Mapping[Label, Tally] | None]
    missing: tuple[Part, ...]
    future: Future[Counted] | None = None
    called_off: bool = False

    @property
    def ready(self) -> bool:
        return None not in self.known

    @property
    def failed(self) -> bool:
        return self.future is not None and (self.future.cancelled() or self.future.exception() is not None)

    def call_off(self) -> None:
        """Cancel what has not been begun; what has been is still recorded when it comes back."""
        self.called_off = self.future is not None and self.future.cancel()

    def take(self) -> None:
        """Record what has come back, and keep it for its turn."""
        if self.future is None or self.called_off:
            return
        fresh = iter(list(zip(self.missing, self.future.result(), strict=True)))
        for index, known in enumerate(self.known):
            if known is not None:
                continue
            part, counts = next(fresh)
            if self.work.ledger is not None:
                row = self.work.ledger.append(self.work.point, part.block, part.frames, counts)
                counts = dict(row.counts)
            self.known[index] = counts


@dataclass(eq=False)
class _Point:
    """A point that has been begun."""

    index: int
    work: PointWork
    parts: Iterator[Part]
    running: Running
    calls: deque[_Call] = field(default_factory=deque)
    exhausted: bool = False

    @classmethod
    def begun(cls, index: int, work: PointWork) -> _Point:
        return cls(index, work, work.rule.parts(), Running(work.rule))

    @property
    def finished(self) -> bool:
        return self.running.stopped_by is not None

    def next_call(self, blocks: int) -> _Call | None:
        """Lay out the next blocks, with what the ledger knows of them; None if there are no more."""
        parts = tuple(islice(self.parts, blocks))
        if not parts:
            self.exhausted = True
            return None
        ledger = self.work.ledger
        rows = [None if ledger is None else ledger.find(self.work.point, p.block, p.frames) for p in parts]
        known: list[Mapping[Label, Tally] | None] = [None if row is None else row.counts for row in rows]
        missing = tuple(part for part, row in zip(parts, rows, strict=True) if row is None)
        call = _Call(self.work, parts, known, missing)
        self.calls.append(call)
        return call

    def absorb(self, progress: Progress | None) -> None:
        """Add what is ready, in order, until the rule holds; what lies beyond it is dropped."""
        while self.calls and not self.finished and self.calls[0].ready:
            call = self.calls.popleft()
            for part, counts in zip(call.parts, call.known, strict=True):
                done = self.running.add(part, counts or {})
                if progress is not None:
                    progress(self.index, part.frames, self.running.counts)
                if done:
                    break
        if self.finished:
            for call in self.calls:
                call.call_off()
            self.calls.clear()


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
    schedule = _Schedule(works, submit, window, blocks_at_once, progress)
    try:
        while (outcome := schedule.next_outcome()) is not None:
            yield outcome
    finally:
        schedule.cancel()


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


class _Schedule:
    """The state of :func:`run_points`."""

    def __init__(
        self, works: Iterable[PointWork], submit: Submit, window: int, blocks: int, progress: Progress | None
    ) -> None:
        self._upcoming = enumerate(works)
        self._submit, self._window, self._blocks, self._progress = submit, window, blocks, progress
        self._points: deque[_Point] = deque()
        self._under_way: dict[Future[Counted], _Call] = {}

    def next_outcome(self) -> Outcome | None:
        """Work until the first point is finished; None once there is no point left."""
        while True:
            self._hand_out()
            if not self._points:
                return None
            if self._points[0].finished:
                return self._points.popleft().running.outcome()
            self._collect()

    def cancel(self) -> None:
        """Call off what has not been begun, and record what is done and was not collected yet."""
        for future in self._under_way:
            future.cancel()
        for future, call in self._under_way.items():
            if future.done() and not call.failed:
                with suppress(VoccError):  # what ended the run is the error to tell of
                    call.take()

    def _hand_out(self) -> None:
        """Fill the window, passing by what is known already; stop where the first point is finished."""
        while len(self._under_way) < self._window and not (self._points and self._points[0].finished):
            point = next((p for p in self._points if not p.exhausted and not p.finished), None)
            if point is None:
                upcoming = next(self._upcoming, None)
                if upcoming is None:
                    return
                self._points.append(_Point.begun(*upcoming))
                continue
            call = point.next_call(self._blocks)
            if call is not None and call.missing:
                call.future = self._submit(call.work.count, call.missing)
                self._under_way[call.future] = call
            point.absorb(self._progress)

    def _collect(self) -> None:
        """Wait for a call to come back, record it, and add what is ready."""
        if not self._under_way:
            return
        done, _ = wait(self._under_way, return_when=FIRST_COMPLETED)
        calls = [self._under_way.pop(future) for future in done]
        # What came back well is recorded before the error of another call ends the run.
        for call in sorted(calls, key=lambda call: call.failed):
            call.take()
        for point in self._points:
            point.absorb(self._progress)
