"""Who counts blocks: this process alone, processes of this machine, a Ray or a Dask cluster.

A call travels as bytes. Whoever takes it first compares its releases of this package and of what computes
with those of the run, so that no node counts with other code; what comes back are bytes too.
"""

import functools
import importlib
import math
import multiprocessing.connection
import os
import pickle
import platform
import signal
import socket
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent import futures
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Self, TypeVar

import numpy as np
import torch

import vocc_torch
from vocc_torch import plugins
from vocc_torch.errors import VoccError
from vocc_torch.measure import timing
from vocc_torch.measure.config import Settings
from vocc_torch.sources import package_digest
from vocc_torch.types import resolve_device

A = TypeVar("A")
R = TypeVar("R")
CLUSTERS = {"ray": "ray", "dask": "distributed"}
"""Executors that may be on other machines, and the package of each."""
KINDS = ("auto", "here", "processes", *CLUSTERS)


@dataclass(frozen=True)
class Limits:
    """How many work, and for how long they are waited for."""

    most_workers: int = 256  # more processes than any machine's cores
    most_by_default: int = 8  # processes where no number was given
    patience_s: float = 10.0  # processor time in this process after which others surely pay: each begins in 3 s
    connect_s: float = 5.0  # in which something must answer at an address
    tries: int = 3  # how often a cluster does a call whose node was lost


LIMITS = Limits()


class Workers:
    """Who counts: this process with one thread, or others, behind one ``concurrent.futures`` executor.

    What does calls elsewhere is opened with the context, or where that is this machine's processes with the
    first call for them; it ends with the context, and processes also when this process is killed.

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

    def __init__(
        self, count: int | None = 1, kind: str = "auto", address: str = "auto"
    ) -> None:
        if count is not None and not 0 <= count <= LIMITS.most_workers:
            raise VoccError(
                f"workers is {count}: it must be from 0 (one a core) to {LIMITS.most_workers}"
            )
        if kind not in KINDS:
            raise VoccError.of(
                "executor.kind", repr(kind), f"one of {', '.join(KINDS)}"
            )
        if kind not in CLUSTERS and address != "auto":
            raise VoccError(
                f"executor.address is {address}: it has no meaning for executor={kind}"
            )
        cores = timing.usable_cores()
        self.count = (
            min(cores, LIMITS.most_by_default) if count is None else count or cores
        )
        self._most, self._kind, self._address = count or None, kind, address
        self._here = kind == "here" or (
            kind == "auto" and (self.count == 1 or count is None)
        )
        # Where nobody said otherwise, processes begin once they surely pay.
        waits = kind == "auto" and count is None and self.count > 1
        self._patience_s = LIMITS.patience_s if waits else math.inf
        self._pool: Pool | None = None
        self._packed: tuple[object, object] = (None, b"")

    @classmethod
    def of(cls, settings: Settings) -> Self:
        """Take those that a configuration names.

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
                raise VoccError.of(
                    "device", settings.device, f"cpu for executor={kind}"
                )
            for name, classifier in settings.classifiers.items():
                if folder := classifier.training.get("checkpoints"):
                    rule = f"null for executor={kind}, whose nodes do not share it"
                    raise VoccError.of(
                        f"classifiers.{name}.training.checkpoints", folder, rule
                    )
        if count is None and kind == "auto" and not on_cpu:
            count = 1  # processes would share the accelerator
        return cls(count, kind, settings.executor.address)

    @property
    def window(self) -> int:
        """How many calls to hand out at a time, so that no worker waits for the next one."""
        if self._here:
            return 1
        slots = self.count if self._pool is None else self._pool.slots()
        # A larger cluster would begin all that it is given.
        return self._most if self._most and self._most < slots else 2 * slots

    def submit(self, call: Callable[[A], R], argument: A, /) -> futures.Future[R]:
        """Hand out a call; in this process it is made at once, and its error raised here.

        Raises:
            VoccError: the workers were ended from outside, as a system short of memory does.
        """
        result = futures.Future[R]()
        if self._here:
            begun = time.process_time()
            with timing.threads(1):
                result.set_result(call(argument))
            self._patience_s -= time.process_time() - begun
            self._here = self._patience_s > 0
            return result
        pool = self._open()
        if self._packed[0] is not call:  # packed once for many blocks
            self._packed = call, pool.kept(pickle.dumps(call))
        with worker_losses_told():
            work = pool.submit(
                called, about_run(self._kind), self._packed[1], pickle.dumps(argument)
            )
        return Unpacked(work)

    def _open(self) -> "Pool":
        if self._pool is None:
            pools = {"ray": RayPool, "dask": DaskPool}
            self._pool = (
                pools[self._kind](self._address)
                if self._kind in pools
                else ProcessPool(self.count)
            )
        return self._pool

    def __enter__(self) -> Self:
        """Join the cluster, if there is one; no process of this machine is started yet."""
        if self._here:
            timing.settle_memory()
        if self._kind in CLUSTERS:
            self._open()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """End the processes; after an error without waiting for what they are doing."""
        if self._pool is not None:
            self._pool.end(at_once=kind is not None)


class Unpacked(futures.Future[R]):
    """The result of a call whose bytes come back from a worker."""

    def __init__(self, work: futures.Future[bytes]) -> None:
        super().__init__()
        self._work = work
        work.add_done_callback(self._came)

    def cancel(self) -> bool:
        """Cancel a call that nobody has begun."""
        return self._work.cancel() and super().cancel()

    def _came(self, work: futures.Future[bytes]) -> None:
        with suppress(futures.InvalidStateError):  # it was cancelled
            try:
                well, value = pickle.loads(work.result())
            except futures.BrokenExecutor as error:
                return self.set_exception(error)
            except futures.CancelledError:
                super().cancel()
                return None
            except Exception as error:
                well, value = False, _of_cluster(error)
            self.set_result(value) if well else self.set_exception(value)


class Pool:
    """What does calls elsewhere."""

    def slots(self) -> int:
        """How many calls are worked on at the same time; nodes may come and go."""
        raise NotImplementedError

    def submit(
        self, call: Callable[..., bytes], /, *arguments: object
    ) -> futures.Future[bytes]:
        """Hand out a call."""
        raise NotImplementedError

    def kept(self, content: bytes) -> object:
        """Give what stands for bytes that go with many calls; the bytes arrive all the same."""
        return content

    def end(self, *, at_once: bool) -> None:
        """Begin no further call, and free what was opened."""
        raise NotImplementedError


class ProcessPool(Pool):
    """Processes of this machine with one thread each; they end with this process, however that ends."""

    def __init__(self, count: int) -> None:
        # Forking a process in which torch has started threads can hang the child.
        context = multiprocessing.get_context("spawn")
        self._executor = futures.ProcessPoolExecutor(
            count, context, initializer=_begin, initargs=(plugins.files_read(),)
        )
        self._count = count

    def slots(self) -> int:
        """As many as there are processes."""
        return self._count

    def submit(
        self, call: Callable[..., bytes], /, *arguments: object
    ) -> futures.Future[bytes]:
        """Hand out a call; a process begun meanwhile never hears of Ctrl-C, not even while it starts."""
        if not hasattr(signal, "pthread_sigmask"):  # on Windows
            return self._executor.submit(call, *arguments)
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return self._executor.submit(call, *arguments)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def end(self, *, at_once: bool) -> None:
        """End the processes; before Python 3.14 a pool has no other way to do so at once."""
        for process in (
            list((self._executor._processes or {}).values()) if at_once else ()
        ):
            process.terminate()
        self._executor.shutdown(cancel_futures=True)


def _begin(files: dict[str, str]) -> None:
    """Set a worker process up; ``files`` are the user's, as the run began with them."""
    plugins.EXPECTED.update(files)
    # Ctrl-C reaches the whole group; the parent ends its workers itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end_with_parent() -> None:
        # A killed parent cannot tell its workers to end.
        if (parent := multiprocessing.parent_process()) is not None:
            multiprocessing.connection.wait([parent.sentinel])
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


class RayPool(Pool):
    """A Ray cluster: a call is a task of one CPU, which Ray hands out again where its node is lost.

    Args:
        address: HOST:PORT of the cluster, ``auto`` for the one that runs on this machine, ``local`` for a new
            one.

    Raises:
        VoccError: Ray is not installed, or there is no cluster at the address.
    """

    def __init__(self, address: str) -> None:
        self._ray = _imported("ray")
        if address not in ("auto", "local"):
            demand_answer(address)
        options = {"include_dashboard": False} if address == "local" else {}
        with _joining("Ray", address):
            self._ray.init(
                address, log_to_driver=False, logging_level="ERROR", **options
            )
        self._task = self._ray.remote(num_cpus=1, max_retries=LIMITS.tries - 1)(called)

    def slots(self) -> int:
        """As many as the cluster has CPUs."""
        return int(self._ray.cluster_resources().get("CPU", 0)) or 1

    def kept(self, content: bytes) -> object:
        """Lay the bytes into Ray's store, from which every node fetches them once."""
        return self._ray.put(content)

    def submit(
        self, _: Callable[..., bytes], /, *arguments: object
    ) -> futures.Future[bytes]:
        """Hand out a call of :func:`called`."""
        future: futures.Future[bytes] = self._task.remote(*arguments).future()
        return future

    def end(self, *, at_once: bool) -> None:
        """Leave the cluster, which ends what it is doing for this run."""
        self._ray.shutdown()


class DaskPool(Pool):
    """The workers of a Dask scheduler, which hands a call out again where its worker is lost.

    Args:
        address: HOST:PORT of the scheduler.

    Raises:
        VoccError: Dask is not installed, or no scheduler answers at the address.
    """

    def __init__(self, address: str) -> None:
        distributed = _imported("dask")
        if address in ("auto", "local"):
            raise VoccError.of(
                "executor.address",
                address,
                "HOST:PORT of a scheduler for executor=dask",
            )
        demand_answer(address)
        with _joining("Dask", address):
            self._client = distributed.Client(
                address, timeout=LIMITS.connect_s, set_as_default=False
            )
        self._executor = self._client.get_executor(pure=False)

    def slots(self) -> int:
        """As many as the workers have threads."""
        return sum(self._client.nthreads().values()) or 1

    def submit(
        self, call: Callable[..., bytes], /, *arguments: object
    ) -> futures.Future[bytes]:
        """Hand out a call."""
        future: futures.Future[bytes] = self._executor.submit(call, *arguments)
        return future

    def end(self, *, at_once: bool) -> None:
        """Leave the scheduler."""
        self._executor.shutdown(wait=False)
        self._client.close()


def _imported(kind: str) -> Any:
    try:
        return importlib.import_module(CLUSTERS[kind])
    except ImportError:
        missing = f"executor.kind is {kind}, which is not installed"
        raise VoccError(f"{missing}: pip install 'vocc-torch[{kind}]'") from None


@contextmanager
def _joining(name: str, address: str) -> Iterator[None]:
    """Say in one line why a cluster cannot be joined."""
    try:
        yield
    except Exception as error:
        why = (str(error).splitlines() or [type(error).__name__])[0].partition(". ")[0]
        refusal = f"executor.address is {address}: no {name} cluster can be joined there ({why})"
        raise VoccError(refusal) from error


def demand_answer(address: str) -> None:
    """Refuse an address at which nothing listens, within seconds; a cluster's own client tries for minutes.

    Args:
        address: HOST:PORT, perhaps after a scheme and ``://``.

    Raises:
        VoccError: no such address, or nothing there.

    Example:
        >>> demand_answer("127.0.0.1:1")
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: executor.address is 127.0.0.1:1: nothing answers there (Connection ...)
    """
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 1 << 16:
        raise VoccError.of(
            "executor.address", repr(address), "HOST:PORT, auto or local"
        )
    try:
        with closing(
            socket.create_connection((host.strip("[]"), int(port)), LIMITS.connect_s)
        ):
            pass
    except OSError as error:
        why = error.strerror or str(error)
        raise VoccError(
            f"executor.address is {address}: nothing answers there ({why})"
        ) from None


def _of_cluster(error: Exception) -> Exception:
    """Say in one line that a cluster lost a call for good, or that a node cannot begin."""
    name, package = type(error).__name__, type(error).__module__.partition(".")[0]
    if package not in CLUSTERS.values():
        return error
    if "OutOfMemory" in name:
        help_ = "give a smaller batch_frames, or nodes with more memory for each CPU"
        return VoccError(
            f"a task ran out of memory on its node, {LIMITS.tries} times in all: {help_}"
        )
    if name != "RaySystemError" and (
        "Crashed" in name or "Died" in name or "Lost" in name or "Killed" in name
    ):
        lost = f"a task was lost with its worker or node, {LIMITS.tries} times in all ({name})"
        return VoccError(f"{lost}: start again to go on")
    lines = [line for line in str(error).splitlines() if line.strip()]
    why = next(
        (line for line in reversed(lines) if "Error" in line),
        lines[-1] if lines else name,
    )
    return VoccError(
        f"a node cannot take part ({why.strip()}): give every node the same releases"
    )


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


@functools.cache
def releases() -> dict[str, str]:
    """Tell what counts here: releases, and a digest of this package's code."""
    full = {
        "torch": torch.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
    short = {name: ".".join(release.split(".")[:2]) for name, release in full.items()}
    return {
        "vocc_torch": vocc_torch.__version__,
        "code of vocc_torch": package_digest("vocc_torch"),
        **short,
    }


def about_run(kind: str) -> bytes:
    """Tell what a run counts with: releases, and on a cluster the user's own Python files.

    Raises:
        VoccError: such files where they cannot go.
    """
    files = plugins.carried() if kind in CLUSTERS else {}
    # Whose workers outlive the run, and its files' modules with them.
    if files and kind == "dask":
        cannot = f"executor.kind is dask, and {next(iter(files))} cannot go with it"
        raise VoccError(f"{cannot}: it must be ray, or one on this machine")
    return pickle.dumps((releases(), files))


@functools.cache
def _joined(run: bytes) -> str:
    """Make this process ready for a run, once, or say why it cannot take part."""
    # One thread each: the processes together use the cores.
    torch.set_num_threads(1)
    timing.settle_memory()
    (expected, files), here = pickle.loads(run), releases()
    for name, release in expected.items():
        if here.get(name) != release:
            differs = f"node {socket.gethostname()} has {name} {here.get(name)}, and this run {release}"
            return f"{differs}: give every node the same releases"
    plugins.receive(files)
    return ""


@functools.lru_cache(8)
def _unpacked(call: bytes) -> Callable[[object], object]:
    function: Callable[[object], object] = pickle.loads(call)
    return function


def called(run: bytes, call: bytes, argument: bytes) -> bytes:
    """Make a call in a worker.

    Args:
        run: what the run counts with, of :func:`about_run`.
        call: what is called, pickled.
        argument: what it is given, pickled.

    Returns:
        Pickled: whether it went well, and what it gave or the error that it raised.

    Example:
        >>> pickle.loads(called(about_run("processes"), pickle.dumps(abs), pickle.dumps(-3)))
        (True, 3)
    """
    try:
        if refusal := _joined(run):
            raise VoccError(refusal)
        # In one piece: torch would send each tensor as an open file of this process, for the other to fetch.
        return pickle.dumps((True, _unpacked(call)(pickle.loads(argument))))
    except Exception as error:
        if not isinstance(error, VoccError):
            error.add_note(
                f"in worker {os.getpid()} of {socket.gethostname()}:\n{traceback.format_exc()}"
            )
        try:
            packed = pickle.dumps((False, error))
            pickle.loads(packed)
        except Exception:
            return pickle.dumps((False, RuntimeError(plugins.one_line(error))))
        return packed
