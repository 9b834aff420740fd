"""Executors that count blocks: this process, processes of this machine, a Ray or a Dask cluster."""

import functools
import math
import pickle
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent import futures
from dataclasses import dataclass
from typing import Any, Self, TypeVar

from vocc_torch import plugins
from vocc_torch.errors import VoccError, demand_word
from vocc_torch.measure import pools, timing
from vocc_torch.measure.config import Settings
from vocc_torch.measure.pools import Call
from vocc_torch.types import resolve_device

R = TypeVar("R")
KINDS = ("auto", "here", "processes", *pools.CLUSTERS)


@dataclass(frozen=True)
class WorkerLimits:
    """Numbers of workers and waiting times."""

    most_workers: int = 256  # more processes than any machine's cores
    most_by_default: int = 8  # processes if no number is given
    # Processor time after which processes pay off: each starts in 3 s.
    patience_s: float = 10.0


LIMITS = WorkerLimits()
_packed = functools.lru_cache(pools.LIMITS.cached_calls)(pickle.dumps)
"""A call that goes with many arguments is packed once."""


class Workers:
    """An executor behind ``concurrent.futures``: this process with one thread, or others.

    Entering the context joins a cluster. Processes of this machine start with their first call. All end with the
    context; processes also end when this process is killed.

    Args:
        count: number of workers, 1 to 256; 0 takes one per usable core; None starts in this process and adds
            one per core, at most 8, once that is faster.
        kind: ``here``, ``processes``, ``ray``, ``dask``; ``auto`` is this process for one worker, else
            processes.
        address: of the cluster.

    Raises:
        VoccError: a number outside its range, or an unknown executor.

    Example:
        >>> with Workers(1) as workers:
        ...     workers.result(workers.submit(abs, -3))
        3
    """

    def __init__(
        self, count: int | None = 1, kind: str = "auto", address: str = "auto"
    ) -> None:
        if count is not None and not 0 <= count <= LIMITS.most_workers:
            rule = f"from 0 (one a core) to {LIMITS.most_workers}"
            raise VoccError.of("workers", count, rule)
        demand_word("executor.kind", kind, KINDS)
        if kind not in pools.CLUSTERS and address != "auto":
            rule = f"auto for executor={kind}"
            raise VoccError.of("executor.address", address, rule)
        self._most, self._kind, self._address = count or None, kind, address
        self.count = count or timing.usable_cores()
        self._patience_s = 0.0  # of processor time in this process
        if count is None:
            self.count = min(self.count, LIMITS.most_by_default)
            self._patience_s = LIMITS.patience_s * (kind == "auto")
        if kind == "here" or (kind == "auto" and self.count == 1):
            self._patience_s = math.inf
        self._pool: pools.WorkerPool | None = None

    @classmethod
    def of(cls, settings: Settings) -> Self:
        """Take the executor of a configuration.

        Raises:
            VoccError: as the class, or a task, a device or a training that cannot be elsewhere.
        """
        kind, count = settings.executor.kind, settings.workers
        on_cpu = resolve_device(settings.device).type == "cpu"
        if kind in pools.CLUSTERS:
            if settings.task == "export":
                rule = "auto, here or processes for task=export, which writes where it computes"
                raise VoccError.of("executor.kind", kind, rule)
            if not on_cpu:
                rule = f"cpu for executor={kind}"
                raise VoccError.of("device", settings.device, rule)
            for name, classifier in settings.classifiers.items():
                if folder := classifier.training.get("checkpoints"):
                    key = f"classifiers.{name}.training.checkpoints"
                    rule = f"null for executor={kind}, whose nodes do not share it"
                    raise VoccError.of(key, folder, rule)
        if count is None and kind == "auto" and not on_cpu:
            count = 1  # processes would share the accelerator
        return cls(count, kind, settings.executor.address)

    @property
    def window(self) -> int:
        """How many calls to hand out at a time, so that no worker waits for the next one."""
        if self._patience_s > 0:
            return 1
        slots = self.count if self._pool is None else self._pool.slots()
        # A larger cluster would begin every call that it has.
        return self._most if self._most and self._most < slots else 2 * slots

    def submit(
        self,
        call: Callable[..., Any],
        argument: object,
        here: Callable[..., Any] | None = None,
    ) -> Call:
        """Start a call for :meth:`result`. In this process it runs at once, and an error is raised here.

        Args:
            call: importable by name.
            argument: of the call.
            here: the same call for this process, which may also report how far it is.

        Raises:
            VoccError: the workers were ended from outside, as a system short of memory does.
        """
        if self._patience_s > 0:
            done, begun = Call(), time.process_time()
            with timing.threads(1):
                done.set_result((True, (here or call)(argument)))
            self._patience_s -= time.process_time() - begun
            return done
        run = pools.about_run(self._kind)
        try:
            self._pool = self._pool or pools.process_pool(self.count)
            return self._pool.submit(run, _packed(call), pickle.dumps(argument))
        except futures.BrokenExecutor as error:
            raise _lost(error) from error

    def result(self, call: Call) -> Any:
        """Wait for a call's result.

        Raises:
            VoccError: the call was lost with its worker, or the node cannot begin; or what the call raised.
        """
        try:
            done = call.result()
        except Exception as error:
            raise _lost(error) from None
        well, value = done if isinstance(done, tuple) else pickle.loads(done)
        if not well:
            raise value
        return value

    def map(
        self,
        call: Callable[..., R],
        arguments: Iterable[object],
        here: Callable[..., R] | None = None,
    ) -> Iterator[R]:
        """Make a call with each argument, and give the results in their order.

        As many calls are handed out ahead as keep all workers busy. ``here`` is that of :meth:`submit`.

        Example:
            >>> list(Workers(1).map(abs, [-3, 4]))
            [3, 4]
        """
        calls = deque[Call]()
        for argument in arguments:
            calls.append(self.submit(call, argument, here))
            while len(busy := [of for of in calls if not of.done()]) >= self.window:
                futures.wait(busy, return_when=futures.FIRST_COMPLETED)
            while calls and calls[0].done():
                yield self.result(calls.popleft())
        yield from map(self.result, calls)

    def __enter__(self) -> Self:
        """Join the cluster, if there is one; no process of this machine is started yet."""
        if self._patience_s > 0:
            timing.settle_memory()
        if self._kind in pools.CLUSTERS:
            self._pool = pools.joined(self._kind, self._address)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """End the workers; after an error without waiting for what they are doing."""
        if self._pool is not None:
            self._pool.end(kind is not None)


def _lost(error: BaseException) -> BaseException:
    """Say in one line that a call was lost with its worker, or that a node cannot begin."""
    if isinstance(error, futures.BrokenExecutor):
        what = "a worker process was ended from outside, perhaps for lack of memory"
    elif type(error).__module__.partition(".")[0] in pools.CLUSTERS.values():
        why = plugins.one_line(error)[:160]
        what = f"a cluster lost a task {pools.LIMITS.tries} times ({why})"
    else:
        return error
    return VoccError(
        f"{what}: give fewer workers, a smaller batch_frames or nodes of the same releases, and start again to go on"
    )
