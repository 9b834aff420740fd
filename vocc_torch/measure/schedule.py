"""In what order blocks are counted: Monte Carlo at many points, by whoever does calls.

Blocks are handed out in the order of points and blocks, a few ahead, and come back as they are ready.
"""

import statistics
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent import futures
from contextlib import ExitStack, suppress
from typing import NamedTuple, TypeAlias

from vocc_torch.errors import VoccError
from vocc_torch.measure.point_work import Count, Counted, Outcome, Part, PointWork

MOST_TRIES = 3
"""How often a call is handed out before it is given up."""

BEAT_S = 0.05
"""Least time between two looks at what a cluster has done, s."""

OVERDUE, OVERDUE_S = 20, 600.0
"""A call that takes this many times as long as the longest before, and so many seconds at least, is lost."""

LATE, LATE_S = 3, 5.0
"""Where no other block is left, a call that takes this many times as long as most did, and so many seconds at
least, is handed out once more: a run does not wait for one slow or silent node. That counts from the first
result on: before it workers begin, which takes longer than most blocks."""

Future: TypeAlias = futures.Future[Counted]

Submit: TypeAlias = Callable[[Count, Sequence[Part]], Future]
"""Hands a call to whoever is to do it, and returns its future result."""


class Call(NamedTuple):
    """A call that is under way.

    Args:
        point: whose blocks it counts.
        parts: the blocks.
        begun: when it was handed out first, s.
        since: when it was handed out last, s.
        copies: how often it was.
    """

    point: PointWork
    parts: list[Part]
    begun: float
    since: float
    copies: int = 1


class UnderWay(dict[Future, Call]):
    """The calls of a run that have not come back.

    Args:
        submit: hands out a call.
        again: hands one out once more, where a call may be lost without a word.
    """

    def __init__(self, submit: Submit, again: Callable[[Future], object] | None) -> None:
        super().__init__()
        self._submit, self._again, self._longest_s, self._beat = submit, again, 0.0, time.monotonic()
        self._took_s, self._first = deque[float](maxlen=99), 0.0

    def hand_out(self, point: PointWork, parts: list[Part]) -> None:
        """Hand out a call for some blocks of a point."""
        now = time.monotonic()
        self[self._submit(point.count, parts)] = Call(point, parts, now, now)

    def collect(self, last: bool) -> None:
        """Wait until something comes back and record it, before the error of another call is raised.

        Args:
            last: whether no block is left to hand out, so that late calls are what is waited for.
        """
        patience_s = overdue_s = max(OVERDUE_S, OVERDUE * self._longest_s)
        if last and self._first:
            patience_s = min(overdue_s, max(LATE_S, LATE * statistics.median(self._took_s or [0.0])))
        if self._again:  # many at a time, for each time the disk is waited for
            time.sleep(max(0.0, self._beat + BEAT_S - time.monotonic()))
        done, _ = futures.wait(self, patience_s if self._again else None, return_when=futures.FIRST_COMPLETED)
        self._beat = time.monotonic()
        calls = [(future, self.pop(future)) for future in done]
        with ExitStack() as together:
            for ledger in {call.point.ledger for _, call in calls if call.point.ledger}:
                together.enter_context(ledger.together())
            for future, call in sorted(calls, key=lambda one: _failed(one[0])):
                call.point.record(call.parts, future.result())
                self._longest_s = max(self._longest_s, self._beat - call.begun)
                if self._first:
                    self._took_s.append(self._beat - max(call.begun, self._first))
                self._first = self._first or self._beat
        if self._again:
            self._hand_out_again(self._again, patience_s, overdue_s)

    def _hand_out_again(self, again: Callable[[Future], object], patience_s: float, overdue_s: float) -> None:
        """Hand out again what has been under way for too long; what comes back first is taken."""
        now = time.monotonic()
        late = [one for one in self.items() if max(one[1].since, self._first) <= now - patience_s]
        for future, call in late:
            if call.copies < MOST_TRIES and not call.point.stopped_by:
                again(future)
                self[future] = call._replace(since=now, copies=call.copies + 1)
            elif call.since < now - overdue_s:
                if not call.point.stopped_by:
                    told = (
                        f"block {call.parts[0].block} of {call.point.point} was handed out {MOST_TRIES} times"
                    )
                    raise VoccError(f"{told} and never came back: start again to go on")
                del self[future]  # nobody waits for it

    def call_off(self) -> None:
        """Cancel the calls of points that have enough; what has been begun is recorded when it comes back."""
        for future in [one for one, call in self.items() if call.point.stopped_by and one.cancel()]:
            del self[future]

    def end(self) -> None:
        """Cancel what can be cancelled, and record what came back meanwhile."""
        for future, call in self.items():
            if not future.cancel() and future.done() and not _failed(future):
                with suppress(VoccError):  # what ended the run is the error to tell of
                    call.point.record(call.parts, future.result())


def run_points(
    works: Iterable[PointWork],
    submit: Submit,
    *,
    window: int | Callable[[], int] = 1,
    blocks_at_once: int = 1,
    again: Callable[[Future], object] | None = None,
) -> Iterator[Outcome]:
    """Count points one after the other, with blocks of the next ones ahead where there is room.

    A run that is killed loses the calls that were under way and nothing else. Blocks beyond the one at which
    a point's rule first held are thrown away, so neither the window nor the order in which blocks come back
    changes an outcome; nor does a block that comes twice, or is lost and handed out again.

    Args:
        works: the points, in order.
        submit: hands out a call.
        window: most calls handed out at a time, at least 1, or what tells it as workers come and go.
        blocks_at_once: blocks in a call, at least 1.
        again: hands a call out once more, where one may be lost without a word: when it is late or overdue,
            as ``LATE`` and ``OVERDUE`` say; what comes back first is taken.

    Yields:
        The outcome of each point, in the order of ``works``.

    Raises:
        VoccError: a call that never came back, however often it was handed out.

    Example:
        >>> from vocc_torch.measure.config import Budget
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.workers import Workers
        >>> def count(parts):
        ...     return [{("a", 0): Counts(part.frames, part.frames)} for part in parts]
        >>> works = [PointWork(name, count, Budget(frames)) for name, frames in (("x", 64), ("y", 100))]
        >>> [outcome.counts["a", 0].frames for outcome in Workers(1).run(works)]
        [64, 100]
    """
    upcoming, points, under_way = iter(works), deque[PointWork](), UnderWay(submit, again)
    all_begun = False

    def fill() -> None:
        # Passing by what is known already; up to where the first point is finished.
        nonlocal all_begun
        most = window if isinstance(window, int) else window()
        while len(under_way) < most and not (points and points[0].stopped_by):
            point = next((one for one in points if not (one.exhausted or one.stopped_by)), None)
            if point is None:
                if (point := next(upcoming, None)) is None:
                    all_begun = True
                    return
                points.append(point)
            if missing := point.take(blocks_at_once):
                under_way.hand_out(point, missing)
            point.add_known()
            if point.stopped_by:
                under_way.call_off()

    try:
        while True:
            fill()
            if points and points[0].stopped_by:
                first = points.popleft()
                yield Outcome(first.counts, first.stopped_by)
            elif under_way:
                under_way.collect(last=all_begun and all(one.exhausted or one.stopped_by for one in points))
                for point in points:
                    point.add_known()
                under_way.call_off()
            else:
                return
    finally:
        under_way.end()


def _failed(future: Future) -> bool:
    """Whether a call that is done has no result."""
    return future.cancelled() or future.exception() is not None
