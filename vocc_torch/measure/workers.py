"""Who counts blocks, and in what order: processes or this one alone, and Monte Carlo at many points.

Blocks are handed out in the order of points and blocks, a few ahead, and come back as they are ready. Each is
written to its point's ledger at once and added to its point in index order, so that the result is the same
whoever counts.
"""

import itertools
import math
import pickle
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent import futures
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple, Self, TypeAlias, TypeVar

from vocc_torch.errors import VoccError
from vocc_torch.measure import intervals, timing
from vocc_torch.measure.config import Budget, Settings
from vocc_torch.measure.counts import Counts, Tally, WeightedCounts
from vocc_torch.measure.executors import ELSEWHERE, KINDS, Engine, ProcessEngine, about_run, engine_of
from vocc_torch.measure.ledger import Label, Ledger
from vocc_torch.measure.trainings import TRAININGS
from vocc_torch.rng import BLOCK_FRAMES
from vocc_torch.types import resolve_device

A = TypeVar("A")
R = TypeVar("R")
MOST_WORKERS = 256

MOST_UNASKED = 8
"""Most processes that are begun where no number was given."""

PATIENCE_S = 10.0
"""Processor time spent in this process, s, after which others surely pay: each takes about 3 s to begin."""

MOST_TRIES = 3
"""How often a call is handed out before it is given up."""

MOST_KEPT = 32
"""Most calls that are kept packed, for as many points under way."""

BEAT_S = 0.05
"""Least time between two looks at what a cluster has done, s."""

OVERDUE, OVERDUE_S = 20, 600.0
"""A call that takes this many times as long as the longest before, and so many seconds at least, is lost."""

FIRST_CHECK = 16
"""Blocks between looks at the precision, at first; later a sixteenth of the blocks so far."""

FIRST_RARE_CHECK = 128
"""Blocks before the first look where frames are weighed: few of them may have most of the weight."""


class Workers:
    """Who counts: this process with one thread, or others, behind one executor.

    What does calls elsewhere is opened with the context, or where that is this machine's processes with the
    first call for them; it ends with the context, and processes also when this process is killed. A call
    whose worker or node is lost is made again, up to three times in all.

    Args:
        count: how many work at the same time, 1 to 256; 0 for as many as this process may use cores; None to
            begin in this process and go on in one a core, at most 8, once that is quicker.
        kind: ``here``, ``processes``, ``ray``, ``dask``; ``auto`` is this process for one worker, else
            processes.
        address: of the cluster.

    Raises:
        VoccError: a number outside its range, or an executor that nobody knows.

    Example:
        >>> with Workers(1) as workers:
        ...     workers.submit(abs, -3).result()
        3
    """

    def __init__(self, count: int | None = 1, kind: str = "auto", address: str = "auto") -> None:
        if count is not None and not 0 <= count <= MOST_WORKERS:
            raise VoccError(f"workers is {count}: it must be from 0 (one a core) to {MOST_WORKERS}")
        if kind not in KINDS:
            raise VoccError.of("executor.kind", repr(kind), f"one of {', '.join(KINDS)}")
        if kind not in ELSEWHERE and address != "auto":
            raise VoccError(f"executor.address is {address}: it has no meaning for executor={kind}")
        cores = timing.usable_cores()
        self.count = min(cores, MOST_UNASKED) if count is None else count or cores
        self._most = count or None
        self._kind, self._address = kind, address
        self._here = kind == "here" or (kind == "auto" and (self.count == 1 or count is None))
        # Where nobody said otherwise, processes begin once they surely pay.
        self._patience_s = PATIENCE_S if kind == "auto" and count is None and self.count > 1 else math.inf
        self._engine: Engine | None = None
        self._sent: dict[int, tuple[object, tuple[object, object]]] = {}

    @classmethod
    def of(cls, settings: Settings) -> Self:
        """Take those that a configuration names.

        Raises:
            VoccError: as the class, or a task, a device or a training that cannot be elsewhere.
        """
        kind, count, executor = settings.executor.kind, settings.workers, settings.executor
        on_cpu = resolve_device(settings.device).type == "cpu"
        if kind in ELSEWHERE:
            if settings.task == "export":
                rule = "auto, here or processes for task=export, which writes where it computes"
                raise VoccError.of("executor.kind", kind, rule)
            if not on_cpu:
                raise VoccError.of("device", settings.device, f"cpu for executor={kind}")
            for name, one in settings.classifiers.items():
                if one.training.get("checkpoints"):
                    key = f"classifiers.{name}.training.checkpoints"
                    rule = f"null for executor={kind}, whose nodes do not share it"
                    raise VoccError.of(key, one.training["checkpoints"], rule)
        if count is None and kind == "auto" and not on_cpu:
            count = 1  # processes would share the accelerator
        return cls(count, kind, executor.address)

    @property
    def window(self) -> int:
        """How many calls to hand out at a time, so that no worker waits for the next one."""
        if self._here:
            return 1
        slots = self.count if self._engine is None else self._engine.slots()
        return 2 * (min(slots, self._most) if self._most else slots)

    def submit(self, call: Callable[[A], R], argument: A, /) -> futures.Future[R]:
        """Hand out a call; in this process it is made at once, and its error raised here.

        Raises:
            VoccError: the workers were ended from outside, as a system short of memory does.
        """
        if self._here:
            begun, done = time.process_time(), futures.Future[R]()
            with timing.threads(1):
                done.set_result(call(argument))
            self._patience_s -= time.process_time() - begun
            self._here = self._patience_s > 0
            return done
        # First, because with the pool comes Python's resource tracker, whose start lets Ctrl-C in again.
        engine = self._open()
        handed = Handed[R](engine, (*self._packed(engine, call), pickle.dumps(argument)))
        with worker_losses_told():
            handed.hand_out()
        return handed

    def run(self, works: "Iterable[PointWork]", blocks_at_once: int = 1) -> "Iterator[Outcome]":
        """Count points, as :func:`run_points`."""
        remote, window = self._kind in ELSEWHERE, partial(getattr, self, "window")
        return run_points(works, self.submit, window=window, blocks_at_once=blocks_at_once, remote=remote)

    def _open(self) -> Engine:
        if self._engine is None:
            kind = "processes" if self._kind == "auto" else self._kind
            self._engine = engine_of(kind, self.count, self._address)
        return self._engine

    def _packed(self, engine: Engine, call: object) -> tuple[object, object]:
        """Give what a call is and what its run counts with, as bytes that are packed once for many calls."""
        if id(call) not in self._sent:
            if len(self._sent) >= MOST_KEPT:
                del self._sent[next(iter(self._sent))]
            packed = about_run(self._kind), engine.kept(pickle.dumps(call))
            self._sent[id(call)] = call, packed  # with the call, whose number is another's once it is gone
        return self._sent[id(call)][1]

    def __enter__(self) -> Self:
        """Join the cluster, if there is one; no process of this machine is started yet."""
        if self._here:
            timing.settle_memory()
        if self._kind in ELSEWHERE:
            self._open()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """End the processes; after an error without waiting for what they are doing."""
        if self._engine is None:
            return
        if kind is not None and isinstance(self._engine, ProcessEngine):
            self._engine.end()
        self._engine.shutdown(wait=True, cancel_futures=True)


class Handed(futures.Future[R]):
    """The result of a call that was handed out, perhaps more than once.

    Args:
        engine: who does it.
        work: what :func:`vocc_torch.measure.executors.called` is given.
    """

    def __init__(self, engine: Engine, work: Sequence[object]) -> None:
        super().__init__()
        self._engine, self._work, self._tries = engine, work, 0
        self._inner: futures.Future[bytes] | None = None

    def hand_out(self) -> None:
        """Hand the call out, once more if it was before."""
        self._tries += 1
        self._inner = self._engine.call(*self._work)
        self._inner.add_done_callback(self._came)

    def cancel(self) -> bool:
        """Cancel a call that nobody has begun."""
        return self._engine.cancels and self._inner is not None and self._inner.cancel() and super().cancel()

    def _came(self, inner: futures.Future[bytes]) -> None:
        """Take what came back, or hand a lost call out again."""
        try:
            if inner.cancelled() and self._engine.cancels:
                if super().cancel():
                    self.set_running_or_notify_cancel()
                return
            try:
                well, value = pickle.loads(inner.result())
            except self._engine.lost as error:
                if self._tries < MOST_TRIES:
                    warnings.warn("a worker or node was lost: what it did is handed out again", stacklevel=1)
                    self.hand_out()
                    return
                raise _lost(error, self._tries) from error
        except Exception as error:
            well, value = False, _of_node(error)
        if well:
            self.set_result(value)
        else:
            self.set_exception(value)


def _lost(error: BaseException, tries: int) -> VoccError:
    """Say in one line why a call never came back."""
    if "OutOfMemory" in type(error).__name__:
        help_ = "give a smaller batch_frames, or nodes with more memory for each CPU"
        return VoccError(f"a task ran out of memory on its node, {tries} times in all: {help_}")
    told = f"a task was lost with its worker or node, {tries} times in all ({type(error).__name__})"
    return VoccError(f"{told}: start again to go on")


def _of_node(error: Exception) -> Exception:
    """Say in one line that a node cannot begin, where that is the error."""
    if type(error).__module__.partition(".")[0] not in ("ray", "distributed"):
        return error
    lines = [line for line in str(error).splitlines() if line.strip()]
    why = next((one for one in reversed(lines) if "Error" in one), lines[-1] if lines else "no reason given")
    return VoccError(f"a node cannot take part ({why.strip()}): give every node the same releases")


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
        """Write down what has come back, and keep it for its turn; what comes twice is counted once."""
        for part, counts in list(zip(parts, counted, strict=True)):
            if self.ledger is not None:
                self.ledger.append(self.point, *part, counts)
            if part.block >= self._blocks:
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


class Call(NamedTuple):
    """A call that is under way.

    Args:
        point: whose blocks it counts.
        parts: the blocks.
        since: when it was handed out, s.
        copies: how often it was.
    """

    point: PointWork
    parts: list[Part]
    since: float
    copies: int = 1


UnderWay: TypeAlias = dict[futures.Future[Counted], Call]


def run_points(
    works: Iterable[PointWork],
    submit: Submit,
    *,
    window: int | Callable[[], int] = 1,
    blocks_at_once: int = 1,
    remote: bool = False,
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
        remote: whether a call may be lost without a word: it is then handed out again when it is overdue, as
            ``OVERDUE`` says, and what comes back first is taken.

    Yields:
        The outcome of each point, in the order of ``works``.

    Raises:
        VoccError: a call that never came back, however often it was handed out.

    Example:
        >>> def count(parts):
        ...     return [{("a", 0): Counts(part.frames, part.frames)} for part in parts]
        >>> works = [PointWork(name, count, Budget(frames)) for name, frames in (("x", 64), ("y", 100))]
        >>> [outcome.counts["a", 0].frames for outcome in run_points(works, Workers(1).submit)]
        [64, 100]
    """
    upcoming, points, longest_s = iter(works), deque[PointWork](), 0.0
    looked = beat = time.monotonic()
    under_way: UnderWay = {}
    try:
        while True:
            most = window if isinstance(window, int) else window()
            # Fill the window, passing by what is known already; stop where the first point is finished.
            while len(under_way) < most and not (points and points[0].stopped_by):
                point = next((one for one in points if not (one.exhausted or one.stopped_by)), None)
                if point is None:
                    if (point := next(upcoming, None)) is None:
                        break
                    points.append(point)
                if missing := point.take(blocks_at_once):
                    under_way[submit(point.count, missing)] = Call(point, missing, time.monotonic())
                point.add_known()
                if point.stopped_by:
                    _call_off(under_way)
            if points and points[0].stopped_by:
                first = points.popleft()
                yield Outcome(first.counts, first.stopped_by)
            elif under_way:
                # What came back is recorded before the error of another call is raised.
                patience_s = max(OVERDUE_S, OVERDUE * longest_s) if remote else None
                if remote:  # many at a time, for each time the disk is waited for
                    time.sleep(max(0.0, beat + BEAT_S - time.monotonic()))
                done, _ = futures.wait(under_way, patience_s, return_when=futures.FIRST_COMPLETED)
                beat = time.monotonic()
                calls = [(future, under_way.pop(future)) for future in done]
                with ExitStack() as together:
                    for ledger in {call.point.ledger for _, call in calls if call.point.ledger}:
                        together.enter_context(ledger.together())
                    for future, call in sorted(calls, key=lambda one: _failed(one[0])):
                        call.point.record(call.parts, future.result())
                        longest_s = max(longest_s, time.monotonic() - call.since)
                        if call.copies > 1:
                            for other in [one for one, of in under_way.items() if of.parts is call.parts]:
                                del under_way[other]
                if patience_s is not None and time.monotonic() > looked + patience_s / 4:
                    looked = time.monotonic()
                    _hand_out_again(under_way, submit, looked - patience_s)
                for point in points:
                    point.add_known()
                if any(point.stopped_by for point in points):
                    _call_off(under_way)
            else:
                return
    finally:
        for future, call in under_way.items():
            if not future.cancel() and future.done() and not _failed(future):
                with suppress(VoccError):  # what ended the run is the error to tell of
                    call.point.record(call.parts, future.result())


def _hand_out_again(under_way: UnderWay, submit: Submit, before: float) -> None:
    """Hand out once more what was handed out before a time; what still comes of it counts all the same."""
    overdue = {id(call.parts): call for call in under_way.values() if call.since < before}
    for call in overdue.values():
        same = [future for future, of in under_way.items() if of.parts is call.parts]
        if call.point.stopped_by:  # nobody waits for it
            for future in same:
                del under_way[future]
            continue
        if call.copies >= MOST_TRIES:
            told = f"block {call.parts[0].block} of {call.point.point} was handed out {MOST_TRIES} times"
            raise VoccError(f"{told} and never came back: start again to go on")
        again = call._replace(since=time.monotonic(), copies=call.copies + 1)
        for future in (*same, submit(call.point.count, call.parts)):
            under_way[future] = again


def _call_off(under_way: UnderWay) -> None:
    """Cancel the calls of points that have enough; what has been begun is recorded when it comes back."""
    for future in [one for one, call in under_way.items() if call.point.stopped_by and one.cancel()]:
        del under_way[future]


def _failed(future: futures.Future[Counted]) -> bool:
    """Whether a call that is done has no result."""
    return future.cancelled() or future.exception() is not None
