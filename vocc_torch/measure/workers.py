"""Who counts blocks, and in what order: processes or this one alone, and Monte Carlo at many points.

Blocks are handed out in the order of points and blocks, a few ahead, and come back as they are ready. Each is
written to its point's ledger at once and added to its point in index order, so that the result is the same
whoever counts.
"""

import itertools
import multiprocessing.connection
import os
import pickle
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent import futures
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import NamedTuple, Self, TypeAlias, TypeVar, cast

import torch

from vocc_torch import plugins
from vocc_torch.errors import VoccError
from vocc_torch.measure import intervals, timing
from vocc_torch.measure.config import Budget
from vocc_torch.measure.counts import Counts, Tally, WeightedCounts
from vocc_torch.measure.ledger import Label, Ledger
from vocc_torch.measure.trainings import TRAININGS
from vocc_torch.rng import BLOCK_FRAMES

A = TypeVar("A")
R = TypeVar("R")
MOST_WORKERS = 256

FIRST_CHECK = 16
"""Blocks between looks at the precision, at first; later a sixteenth of the blocks so far."""

FIRST_RARE_CHECK = 128
"""Blocks before the first look where frames are weighed: few of them may have most of the weight."""


class Workers:
    """Other processes, each with one thread, or this process if one worker is asked for.

    The processes start when the first call is handed out, which takes some seconds. They end with the
    context, and also when this process is killed.

    Args:
        count: how many work at the same time, 1 to 256; 0 for as many as this process may use cores.

    Raises:
        VoccError: a number outside its range.

    Example:
        >>> with Workers(1) as workers:
        ...     workers.submit(abs, -3).result()
        3
    """

    def __init__(self, count: int = 1) -> None:
        if not 0 <= count <= MOST_WORKERS:
            raise VoccError(f"workers is {count}: it must be from 0 (one a core) to {MOST_WORKERS}")
        self.count = count or timing.usable_cores()
        self._pool: futures.ProcessPoolExecutor | None = None

    @property
    def window(self) -> int:
        """How many calls to hand out at a time, so that no worker waits for the next one."""
        return 1 if self.count == 1 else 2 * self.count

    def submit(self, call: Callable[[A], R], argument: A, /) -> futures.Future[R]:
        """Hand out a call; in this process it is made at once, and its error raised here.

        Raises:
            VoccError: the workers were ended from outside, as a system short of memory does.
        """
        if self.count == 1:
            done: futures.Future[R] = futures.Future()
            done.set_result(call(argument))
            return done
        # First, because with the pool comes Python's resource tracker, whose start lets Ctrl-C in again.
        if self._pool is None:
            # Forking a process in which torch has started threads can hang the child.
            context = multiprocessing.get_context("spawn")
            given = (plugins.files_read(),)
            self._pool = futures.ProcessPoolExecutor(self.count, context, initializer=_begin, initargs=given)
        before = None
        if hasattr(signal, "pthread_sigmask"):  # not on Windows
            # A process begun meanwhile never hears of Ctrl-C, not even while it starts.
            before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            with worker_losses_told():
                # Both ways a _Whole arrives as what it holds.
                return cast("futures.Future[R]", self._pool.submit(_Whole.called, _Whole((call, argument))))
        finally:
            if before is not None:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def __enter__(self) -> Self:
        """Give itself; no process is started yet."""
        if self.count == 1:
            timing.settle_memory()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """End the processes; after an error without waiting for what they are doing."""
        if self._pool is None:
            return
        # Before Python 3.14 a pool has no other way to end what its processes are doing.
        if kind is not None:
            for process in list((self._pool._processes or {}).values()):
                process.terminate()
        self._pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def worker_losses_told() -> Iterator[None]:
    """Say in one line that a worker process is gone, wherever a call's result was waited for.

    Raises:
        VoccError: a worker was ended from outside, as a system short of memory does.
    """
    try:
        yield
    except futures.BrokenExecutor as error:
        lost = "a worker process was ended from outside, perhaps for lack of memory"
        help_ = "give fewer workers or a smaller batch_frames, and start again to go on"
        raise VoccError(f"{lost}: {help_}") from error


class _Whole:
    """Takes a value to another process in one piece.

    Torch would send each tensor as an open file of this process, for the other one to fetch: many calls at a
    time run out of files, and a fetch that is broken off is loud.
    """

    def __init__(self, value: object) -> None:
        self._value = value

    def __reduce__(self) -> tuple[Callable[[bytes], object], tuple[bytes]]:
        return pickle.loads, (pickle.dumps(self._value),)

    @staticmethod
    def called(work: object) -> "_Whole":
        """Make a call in a worker."""
        call, argument = cast("tuple[Callable[[object], object], object]", work)
        return _Whole(call(argument))


def _begin(files: dict[str, str]) -> None:
    """Set a worker process up; ``files`` are the user's, as the run began with them."""
    plugins.EXPECTED.update(files)
    # One thread each: the processes together use the cores.
    torch.set_num_threads(1)
    timing.settle_memory()
    # Ctrl-C reaches the whole group; the parent ends its workers itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end_with_parent() -> None:
        # A killed parent cannot tell its workers to end.
        if (parent := multiprocessing.parent_process()) is not None:
            multiprocessing.connection.wait([parent.sentinel])
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


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


def stop_reason(rule: Budget, tallies: Mapping[Label, Tally], blocks: int) -> str | None:
    """Say why a point needs no more frames: ``frame_errors`` or ``precision``; None if it does.

    Args:
        rule: when a point has enough. A rule that can never hold is none: the frames end the point.
        tallies: what was counted so far; comparisons and further trainings do not matter here.
        blocks: blocks counted so far, at least 1. The precision is looked at after 16, 32, ... blocks and
            later at steps of about a sixteenth: each look is a chance to stop by luck.

    Example:
        >>> stop_reason(Budget(6400, target_frame_errors=2), {("a", 0): Counts(64, 64, 6, 12, 3)}, 1)
        'frame_errors'
    """
    # A receiver gets the frames that it would get alone, so its numbers do not depend on other trainings.
    counts = {
        label: one for label, one in tallies.items() if isinstance(one, Counts) and TRAININGS not in label
    }
    if counts and rule.target_frame_errors is not None:
        errors: dict[Label, int] = {}
        for label, one in counts.items():
            errors[label[:-1]] = errors.get(label[:-1], 0) + one.frame_errors
        if min(errors.values()) >= rule.target_frame_errors:
            return "frame_errors"
    power_of_two = 1 << (blocks.bit_length() - 1)
    if not counts or rule.precision is None or blocks % max(FIRST_CHECK, power_of_two // 16):
        return None
    for one in counts.values():
        if not one.frames or (isinstance(one, WeightedCounts) and blocks < FIRST_RARE_CHECK):
            return None
        # Without errors nothing tells how many bits a wrong frame would have: half, as in a lost panel.
        interval = intervals.ber_interval(one, errors_per_frame_error=one.bits / one.frames / 2)
        reach = max(interval.high - one.ber, one.ber - interval.low)
        narrow = one.half_errors > 0 and reach <= rule.precision * one.ber
        if not narrow and interval.high > rule.least_ber:
            return None
    return "precision"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a point gave: tallies by label, and why it stopped.

    ``stopped_by`` is ``frame_errors``, ``precision`` or ``frames``.
    """

    counts: dict[Label, Tally]
    stopped_by: str


Counted: TypeAlias = Sequence[Mapping[Label, Tally]]
Count: TypeAlias = Callable[[Sequence[Part]], Counted]
Submit: TypeAlias = Callable[[Count, Sequence[Part]], futures.Future[Counted]]
"""Hands a call to whoever is to do it, and returns its future result."""


@dataclass(eq=False)
class PointWork:
    """A point that is to be counted: blocks that are known and wait for their turn, and the sums so far.

    Args:
        point: its name, which keys its random draws and its rows in the ledger.
        count: counts each of the parts, giving a list of as many mappings; it must be picklable where other
            processes do it.
        rule: when to stop.
        ledger: where its blocks are recorded and known blocks are taken from, or None.
        told: called for each block as it is added, with its frames and the tallies so far.

    Attributes:
        counts: the tallies so far.
        stopped_by: why it has enough; empty until then.
        exhausted: whether all of its blocks have been taken.
    """

    point: str
    count: Count
    rule: Budget
    ledger: Ledger | None = None
    told: Callable[[int, Mapping[Label, Tally]], object] = lambda frames, tallies: None
    counts: dict[Label, Tally] = field(default_factory=dict, init=False)
    stopped_by: str = field(default="", init=False)
    exhausted: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        """Lay the blocks out."""
        self._parts = parts_of(self.rule.frames)
        self._known: dict[int, tuple[Part, Mapping[Label, Tally]]] = {}
        self._blocks = 0

    def take(self, blocks: int) -> list[Part]:
        """Take the next blocks, and give those of them that the ledger does not know."""
        taken, missing = list(itertools.islice(self._parts, blocks)), []
        self.exhausted = not taken
        for part in taken:
            if self.ledger is None or (counts := self.ledger.find(self.point, *part)) is None:
                missing.append(part)
            else:
                self._known[part.block] = part, counts
        return missing

    def record(self, parts: Sequence[Part], counted: Counted) -> None:
        """Write down what has come back, and keep it for its turn."""
        for part, counts in list(zip(parts, counted, strict=True)):
            if self.ledger is not None:
                self.ledger.append(self.point, *part, counts)
            self._known[part.block] = part, counts

    def add_known(self) -> None:
        """Add what is known, in order, until the rule holds; what lies beyond it is dropped."""
        while not self.stopped_by and self._blocks in self._known:
            part, counts = self._known.pop(self._blocks)
            for label, one in counts.items():
                self.counts[label] = self.counts[label] + one if label in self.counts else one
            self._blocks += 1
            spent = "frames" if self._blocks * BLOCK_FRAMES >= self.rule.frames else ""
            self.stopped_by = stop_reason(self.rule, self.counts, self._blocks) or spent
            self.told(part.frames, self.counts)


def run_points(
    works: Iterable[PointWork], submit: Submit, *, window: int = 1, blocks_at_once: int = 1
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

    Yields:
        The outcome of each point, in the order of ``works``.

    Example:
        >>> def count(parts):
        ...     return [{("a", 0): Counts(part.frames, part.frames)} for part in parts]
        >>> works = [PointWork(name, count, Budget(frames)) for name, frames in (("x", 64), ("y", 100))]
        >>> [outcome.counts["a", 0].frames for outcome in run_points(works, Workers(1).submit)]
        [64, 100]
    """
    upcoming, points = iter(works), deque[PointWork]()
    under_way: dict[futures.Future[Counted], tuple[PointWork, list[Part]]] = {}
    try:
        while True:
            # Fill the window, passing by what is known already; stop where the first point is finished.
            while len(under_way) < window and not (points and points[0].stopped_by):
                point = next((one for one in points if not (one.exhausted or one.stopped_by)), None)
                if point is None:
                    if (point := next(upcoming, None)) is None:
                        break
                    points.append(point)
                if missing := point.take(blocks_at_once):
                    under_way[submit(point.count, missing)] = point, missing
                point.add_known()
                _call_off(under_way)
            if points and points[0].stopped_by:
                first = points.popleft()
                yield Outcome(first.counts, first.stopped_by)
            elif under_way:
                # What came back is recorded before the error of another call is raised.
                done, _ = futures.wait(under_way, return_when=futures.FIRST_COMPLETED)
                calls = [(future, *under_way.pop(future)) for future in done]
                for future, point, parts in sorted(calls, key=lambda call: _failed(call[0])):
                    point.record(parts, future.result())
                for point in points:
                    point.add_known()
                _call_off(under_way)
            else:
                return
    finally:
        for future, (point, parts) in under_way.items():
            if not future.cancel() and future.done() and not _failed(future):
                with suppress(VoccError):  # what ended the run is the error to tell of
                    point.record(parts, future.result())


def _call_off(under_way: dict[futures.Future[Counted], tuple[PointWork, list[Part]]]) -> None:
    """Cancel the calls of points that have enough; what has been begun is recorded when it comes back."""
    for future in [one for one, (point, _) in under_way.items() if point.stopped_by and one.cancel()]:
        del under_way[future]


def _failed(future: futures.Future[Counted]) -> bool:
    """Whether a call that is done has no result."""
    return future.cancelled() or future.exception() is not None
