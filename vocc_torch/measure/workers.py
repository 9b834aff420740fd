"""Who counts blocks: this process alone, processes of this machine, or a cluster."""

import math
import pickle
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent import futures
from contextlib import contextmanager, suppress
from functools import partial
from typing import Self, TypeVar

from vocc_torch.errors import VoccError
from vocc_torch.measure import timing
from vocc_torch.measure.config import Settings
from vocc_torch.measure.executors import ELSEWHERE, KINDS, Engine, ProcessEngine, about_run, engine_of
from vocc_torch.measure.point_work import Outcome, PointWork
from vocc_torch.measure.schedule import MOST_TRIES, run_points
from vocc_torch.types import resolve_device

A = TypeVar("A")
R = TypeVar("R")
MOST_WORKERS = 256

MOST_UNASKED = 8
"""Most processes that are begun where no number was given."""

PATIENCE_S = 10.0
"""Processor time spent in this process, s, after which others surely pay: each takes about 3 s to begin."""

MOST_KEPT = 32
"""Most calls that are kept packed, for as many points under way."""


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
        # A larger cluster would begin all that it is given.
        return self._most if self._most and self._most < slots else 2 * slots

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

    def run(self, works: Iterable[PointWork], blocks_at_once: int = 1) -> Iterator[Outcome]:
        """Count points, as :func:`vocc_torch.measure.schedule.run_points`."""
        window, again = partial(getattr, self, "window"), self._again if self._kind in ELSEWHERE else None
        return run_points(works, self.submit, window=window, blocks_at_once=blocks_at_once, again=again)

    @staticmethod
    def _again(future: futures.Future[R]) -> None:
        if isinstance(future, Handed) and not future.done():
            future.hand_out()

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
        self._engine, self._work, self._lost = engine, work, 0
        self._copies: list[futures.Future[bytes]] = []

    def hand_out(self) -> None:
        """Hand the call out, once more if it was before; what comes back first is its result."""
        self._copies.append(self._engine.call(*self._work))
        self._copies[-1].add_done_callback(self._came)

    def cancel(self) -> bool:
        """Cancel a call that nobody has begun."""
        return self._engine.cancels and self._copies[-1].cancel() and super().cancel()

    def _came(self, copy: futures.Future[bytes]) -> None:
        """Take what came back, or hand a lost call out again."""
        try:
            if copy.cancelled() and self._engine.cancels:
                if super().cancel():
                    self.set_running_or_notify_cancel()
                return
            try:
                well, value = pickle.loads(copy.result())
            except self._engine.lost as error:
                self._lost += 1
                if not all(one.done() for one in self._copies):
                    return
                if self._lost < MOST_TRIES:
                    warnings.warn("a worker or node was lost: what it did is handed out again", stacklevel=1)
                    self.hand_out()
                    return
                raise _lost(error, self._lost) from error
        except Exception as error:
            well, value = False, _of_node(error)
        with suppress(futures.InvalidStateError):  # another copy came first
            self.set_result(value) if well else self.set_exception(value)


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
