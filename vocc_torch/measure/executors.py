"""Executors that count blocks: this process, processes of this machine, a Ray or a Dask cluster.

Calls and results are sent as bytes. A worker with another release or other code of this package refuses.
"""

import functools
import importlib
import math
import multiprocessing
import os
import pickle
import platform
import signal
import socket
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent import futures
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple, Self, TypeAlias, TypeVar

import numpy as np
import torch

from vocc_torch import __version__, plugins
from vocc_torch.errors import VoccError, demand_word
from vocc_torch.measure import timing
from vocc_torch.measure.config import Settings
from vocc_torch.sources import package_digest
from vocc_torch.types import resolve_device

A = TypeVar("A")
R = TypeVar("R")
Call: TypeAlias = futures.Future[Any]
"""A call that was handed out."""
CLUSTERS = {"ray": "ray", "dask": "distributed"}
"""Executors that may run on other machines, and the package of each."""
KINDS = ("auto", "here", "processes", *CLUSTERS)


@dataclass(frozen=True)
class WorkerLimits:
    """Numbers of workers and waiting times."""

    most_workers: int = 256  # more processes than any machine's cores
    most_by_default: int = 8  # processes if no number is given
    patience_s: float = (
        10.0  # processor time after which processes pay off: each starts in 3 s
    )
    connect_s: float = 5.0  # time in which an address must answer
    tries: int = 3  # runs of a call on a cluster whose nodes are lost
    cached_calls: int = 8  # that go with many arguments


LIMITS = WorkerLimits()


class WorkerPool(NamedTuple):
    """Runs calls in other processes.

    Args:
        submit: hands out :func:`called` with three arguments.
        slots: gives the number of calls that run at the same time; nodes may come and go.
        end: starts no further call; its argument says whether running calls are ended at once.
    """

    submit: Callable[..., Call]
    slots: Callable[[], int]
    end: Callable[[bool], object]


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
        if kind not in CLUSTERS and address != "auto":
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
        self._pool: WorkerPool | None = None

    @classmethod
    def of(cls, settings: Settings) -> Self:
        """Take the executor of a configuration.

        Raises:
            VoccError: as the class, or a task, a device or a training that cannot be elsewhere.
        """
        kind, count = settings.executor.kind, settings.workers
        on_cpu = resolve_device(settings.device).type == "cpu"
        if kind in CLUSTERS:
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
        call: Callable[[A], Any],
        argument: A,
        /,
        here: Callable[[A], Any] | None = None,
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
        packed = about_run(self._kind), _packed(call), pickle.dumps(argument)
        try:
            self._pool = self._pool or process_pool(self.count)
            return self._pool.submit(*packed)
        except futures.BrokenExecutor as error:
            raise _lost(error) from error

    def result(self, call: Call, /) -> Any:
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
        call: Callable[[A], R],
        arguments: Iterable[A],
        here: Callable[[A], R] | None = None,
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
        if self._kind in CLUSTERS:
            self._pool = _joined(self._kind, self._address)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """End the workers; after an error without waiting for what they are doing."""
        if self._pool is not None:
            self._pool.end(kind is not None)


def _lost(error: BaseException) -> BaseException:
    """Say in one line that a call was lost with its worker, or that a node cannot begin."""
    help_ = "give fewer workers, a smaller batch_frames or nodes of the same releases, and start again to go on"
    if isinstance(error, futures.BrokenExecutor):
        return VoccError(
            f"a worker process was ended from outside, perhaps for lack of memory: {help_}"
        )
    if type(error).__module__.partition(".")[0] in CLUSTERS.values():
        why = plugins.one_line(error)[:160]
        return VoccError(f"a cluster lost a task {LIMITS.tries} times ({why}): {help_}")
    return error


def process_pool(count: int) -> WorkerPool:
    """Give processes of this machine with one thread each, which end when this process does."""
    # Forking a process in which torch has started threads can hang the child.
    context = multiprocessing.get_context("spawn")
    files = plugins.files_read()
    executor = futures.ProcessPoolExecutor(count, context, _begin, (files,))

    def submit(*packed: bytes) -> Call:
        if not hasattr(signal, "pthread_sigmask"):  # on Windows
            return executor.submit(called, *packed)
        # A process that begins meanwhile does not hear of Ctrl-C, even while it starts.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return executor.submit(called, *packed)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def end(at_once: bool) -> None:
        # Before Python 3.14 a pool has no way of its own to end at once.
        for process in multiprocessing.active_children() if at_once else ():
            process.terminate()
        executor.shutdown(cancel_futures=True)

    return WorkerPool(submit, lambda: count, end)


def _begin(files: dict[str, str]) -> None:
    """Set a worker process up; ``files`` are the user's, as the run began with them."""
    plugins.EXPECTED.update(files)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers itself
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this process with its parent: a killed parent cannot tell its workers to end."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _joined(kind: str, address: str) -> WorkerPool:
    """Join a cluster, or say in one line why it cannot be joined."""
    try:
        package = importlib.import_module(CLUSTERS[kind])
        return {"ray": ray_pool, "dask": dask_pool}[kind](package, address)
    except ImportError:
        raise VoccError(
            f"executor.kind is {kind}, which is not installed: pip install 'vocc-torch[{kind}]'"
        ) from None
    except Exception as error:
        raise VoccError(
            f"executor.address is {address}: no {kind} cluster answers there ({plugins.one_line(error)[:160]})"
        ) from error


def ray_pool(ray: Any, address: str) -> WorkerPool:
    """Join a Ray cluster: a call is a task of one CPU, handed out again where its node is lost.

    Args:
        ray: the package.
        address: HOST:PORT, ``auto`` for the cluster that runs on this machine, ``local`` for a new one.
    """
    if address not in ("auto", "local"):
        # Ray's own client tries for minutes.
        host, _, port = address.rpartition("://")[2].rpartition(":")
        socket.create_connection((host, int(port)), LIMITS.connect_s).close()
    options = {"include_dashboard": False} if address == "local" else {}
    ray.init(address, log_to_driver=False, logging_level="ERROR", **options)
    task = ray.remote(num_cpus=1, max_retries=LIMITS.tries - 1)(called)

    def slots() -> int:
        return int(ray.cluster_resources().get("CPU", 0)) or 1

    return WorkerPool(
        lambda *packed: task.remote(*packed).future(), slots, lambda _: ray.shutdown()
    )


def dask_pool(distributed: Any, address: str) -> WorkerPool:
    """Join a Dask scheduler, which hands a call out again where its worker is lost.

    Args:
        distributed: the package.
        address: HOST:PORT of the scheduler.
    """
    client = distributed.Client(address, timeout=LIMITS.connect_s, set_as_default=False)
    executor = client.get_executor(pure=False)

    def end(_: bool) -> None:
        executor.shutdown(wait=False)
        client.close()

    return WorkerPool(
        functools.partial(executor.submit, called),
        lambda: sum(client.nthreads().values()) or 1,
        end,
    )


@functools.cache
def releases() -> str:
    """Name what counts in this process: releases, and a digest of this package's code."""
    digits = [of.rpartition(".")[0] for of in (torch.__version__, np.__version__)]
    code = f"vocc_torch {__version__} of code {package_digest('vocc_torch')}"
    torch_numpy = f"torch {digits[0]}, NumPy {digits[1]}"
    return f"{code}, {torch_numpy}, Python {platform.python_version()}"


def about_run(kind: str) -> bytes:
    """Pack what a run counts with: releases, and on a cluster the user's own Python files.

    Raises:
        VoccError: files on Dask, whose workers outlive the run with the files' modules in them.
    """
    files = plugins.carried() if kind in CLUSTERS else {}
    if files and kind == "dask":
        rule = f"ray, or one on this machine: {next(iter(files))} cannot go with dask"
        raise VoccError.of("executor.kind", kind, rule)
    return pickle.dumps((releases(), files))


@functools.cache
def _prepare(run: bytes) -> None:
    """Make this process ready for a run, once, or refuse."""
    timing.settle_memory()
    expected, files = pickle.loads(run)
    if (here := releases()) != expected:
        raise VoccError(
            f"node {socket.gethostname()} has {here}, and this run {expected}: give every node the same releases"
        )
    plugins.receive(files)


_packed = functools.lru_cache(LIMITS.cached_calls)(pickle.dumps)
_unpacked = functools.lru_cache(LIMITS.cached_calls)(pickle.loads)
"""A call that goes with many arguments is packed and unpacked once."""


def called(run: bytes, call: bytes, argument: bytes) -> bytes:
    """Make a call in a worker.

    Args:
        run: what the run counts with, of :func:`about_run`.
        call: what is called, pickled.
        argument: its argument, pickled.

    Returns:
        Pickled: whether it went well, and its result or its error.

    Example:
        >>> pickle.loads(called(about_run("processes"), pickle.dumps(abs), pickle.dumps(-3)))
        (True, 3)
    """
    try:
        _prepare(run)
        with timing.threads(1):  # the processes together use the cores
            result = _unpacked(call)(pickle.loads(argument))
        # In one piece: torch would send each tensor as an open file of this process, for the other to fetch.
        return pickle.dumps((True, result))
    except Exception as error:
        error.add_note(f"in a worker:\n{traceback.format_exc()}")
        with suppress(Exception):  # an error may be such that nobody can read it
            packed = pickle.dumps((False, error))
            pickle.loads(packed)
            return packed
        return pickle.dumps((False, RuntimeError(plugins.one_line(error))))
