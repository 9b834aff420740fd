"""Who may do calls elsewhere, behind the interface of ``concurrent.futures``: local processes, Ray, Dask.

A call travels as bytes. Whoever takes it first tells its releases of this package and of what computes from
those of the run, so that no node counts with other code; what comes back are bytes too, an error among them.
"""

import functools
import multiprocessing.connection
import os
import pickle
import platform
import signal
import socket
import threading
import traceback
from collections.abc import Callable
from concurrent import futures
from contextlib import closing
from importlib import import_module
from typing import Any

import numpy as np
import torch

import vocc_torch
from vocc_torch import plugins
from vocc_torch.errors import VoccError
from vocc_torch.measure import timing
from vocc_torch.sources import package_digest

ELSEWHERE = ("ray", "dask")
"""Kinds of executors that may be on other machines."""
KINDS = ("auto", "here", "processes", *ELSEWHERE)

CONNECT_S = 5.0
"""Seconds in which something must answer at an address."""


class Engine(futures.Executor):
    """An executor that says how much it does at a time, and how it tells that a call was lost.

    Attributes:
        lost: errors of calls whose worker or node is gone; they are made again.
        cancels: whether a call that waits for its turn can be cancelled.
    """

    lost: tuple[type[BaseException], ...] = ()
    cancels = True

    def slots(self) -> int:
        """How many calls are worked on at the same time; nodes may come and go."""
        raise NotImplementedError

    def call(self, *given: Any) -> futures.Future[bytes]:
        """Hand out :func:`called`."""
        return self.submit(called, *given)

    def kept(self, content: bytes) -> object:
        """Give what stands for bytes that go with many calls; the bytes arrive all the same."""
        return content


class ProcessEngine(futures.ProcessPoolExecutor, Engine):
    """Processes of this machine with one thread each; they end with this process, however that ends.

    Args:
        count: how many.
    """

    def __init__(self, count: int) -> None:
        # Forking a process in which torch has started threads can hang the child.
        context = multiprocessing.get_context("spawn")
        super().__init__(count, context, initializer=_begin, initargs=(plugins.files_read(),))
        self._count = count

    def slots(self) -> int:
        """As many as there are processes."""
        return self._count

    def submit(self, call: Callable[..., Any], /, *given: Any, **named: Any) -> futures.Future[Any]:
        """Hand out a call; a process begun meanwhile never hears of Ctrl-C, not even while it starts."""
        if not hasattr(signal, "pthread_sigmask"):  # on Windows
            return super().submit(call, *given, **named)
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return super().submit(call, *given, **named)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def end(self) -> None:
        """End what the processes are doing; before Python 3.14 a pool has no other way."""
        for process in list((self._processes or {}).values()):
            process.terminate()


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


class RayEngine(Engine):
    """A Ray cluster: a call is a task of one CPU.

    Args:
        address: HOST:PORT of the cluster, ``auto`` for the one that runs on this machine, ``local`` for a new
            one.

    Raises:
        VoccError: Ray is not installed, or there is no cluster at the address.
    """

    cancels = False  # what is under way is recorded when it comes

    def __init__(self, address: str) -> None:
        self._ray = _imported("ray", "ray")
        if address not in ("auto", "local"):
            demand_answer(address)
        own = {"include_dashboard": False} if address == "local" else {}
        try:
            self._ray.init(address, log_to_driver=False, logging_level="ERROR", **own)
        except Exception as error:
            raise _no_cluster("Ray", address, error) from error
        # It would print the last lines of a lost node's log; the run says in one line that a node was lost.
        vars(import_module("ray._private.worker"))["print_to_stdstream"] = lambda *_, **__: None
        self._task = self._ray.remote(num_cpus=1, max_retries=0)(called)
        gone = (
            "WorkerCrashedError",
            "NodeDiedError",
            "OutOfMemoryError",
            "ObjectLostError",
            "RaySystemError",
        )
        self.lost = tuple(getattr(self._ray.exceptions, name) for name in (*gone, "LocalRayletDiedError"))

    def slots(self) -> int:
        """As many as the cluster has CPUs."""
        return int(self._ray.cluster_resources().get("CPU", 0)) or 1

    def kept(self, content: bytes) -> object:
        """Lay the bytes into Ray's store, from which every node fetches them once."""
        return self._ray.put(content)

    def submit(self, _: Callable[..., Any], /, *given: Any, **named: Any) -> futures.Future[Any]:
        """Hand out a call of :func:`called`."""
        future: futures.Future[Any] = self._task.remote(*given, **named).future()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster, which ends what it is doing for this run."""
        self._ray.shutdown()


class DaskEngine(Engine):
    """The workers of a Dask scheduler.

    Args:
        address: HOST:PORT of the scheduler.

    Raises:
        VoccError: Dask is not installed, or no scheduler answers at the address.
    """

    cancels = False

    def __init__(self, address: str) -> None:
        distributed = _imported("distributed", "dask")
        if address in ("auto", "local"):
            raise VoccError.of("executor.address", address, "HOST:PORT of a scheduler for executor=dask")
        demand_answer(address, b"")
        try:
            self._client = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
        except Exception as error:
            raise _no_cluster("Dask", address, error) from error
        self._executor = self._client.get_executor(pure=False)
        self.lost = (distributed.scheduler.KilledWorker, futures.CancelledError)

    def slots(self) -> int:
        """As many as the workers have threads."""
        return sum(self._client.nthreads().values()) or 1

    def submit(self, call: Callable[..., Any], /, *given: Any, **named: Any) -> futures.Future[Any]:
        """Hand out a call."""
        future: futures.Future[Any] = self._executor.submit(call, *given, **named)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the scheduler."""
        self._executor.shutdown(wait=False)
        self._client.close()


def engine_of(kind: str, count: int, address: str) -> Engine:
    """Open what does calls elsewhere.

    Args:
        kind: ``processes``, ``ray`` or ``dask``.
        count: how many processes.
        address: of the cluster.

    Raises:
        VoccError: what a cluster refuses.
    """
    if kind == "processes":
        return ProcessEngine(count)
    return (RayEngine if kind == "ray" else DaskEngine)(address)


def _imported(module: str, extra: str) -> Any:
    try:
        return import_module(module)
    except ImportError:
        told = f"executor.kind is {extra}, which is not installed"
        raise VoccError(f"{told}: pip install 'vocc-torch[{extra}]'") from None


def _no_cluster(what: str, address: str, error: Exception) -> VoccError:
    why = (str(error).splitlines() or [type(error).__name__])[0].partition(". ")[0]
    return VoccError(f"executor.address is {address}: no {what} cluster can be joined there ({why})")


_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])
"""How a conversation of gRPC begins, which Ray's servers speak; they answer at once."""


def demand_answer(address: str, hello: bytes = _PREFACE) -> None:
    """Refuse an address where nothing answers, within seconds; Ray itself would try for minutes.

    Args:
        address: HOST:PORT, perhaps after a scheme and ``://``.
        hello: what is said there before an answer comes; nothing for a server that speaks first.

    Raises:
        VoccError: no such address, or silence.

    Example:
        >>> demand_answer("127.0.0.1:1")
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: executor.address is 127.0.0.1:1: nothing answers there (Connection ...)
    """
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 1 << 16:
        raise VoccError.of("executor.address", repr(address), "HOST:PORT, auto or local")
    try:
        with closing(socket.create_connection((host.strip("[]"), int(port)), CONNECT_S)) as line:
            line.settimeout(CONNECT_S)
            line.sendall(hello)
            if not line.recv(1):
                raise ConnectionError("it hangs up")
    except OSError as error:
        why = error.strerror or str(error)
        raise VoccError(f"executor.address is {address}: nothing answers there ({why})") from None


@functools.cache
def releases() -> dict[str, str]:
    """Tell what counts here: releases, and a digest of this package's code."""
    short = {"torch": torch.__version__, "numpy": np.__version__, "python": platform.python_version()}
    rest = {name: ".".join(release.split(".")[:2]) for name, release in short.items()}
    return {"vocc_torch": vocc_torch.__version__, "code of vocc_torch": package_digest("vocc_torch"), **rest}


def about_run(kind: str) -> bytes:
    """Tell what a run counts with: releases, and on a cluster the user's own Python files.

    Raises:
        VoccError: such files where they cannot go.
    """
    files = plugins.carried() if kind in ELSEWHERE else {}
    if files and kind == "dask":  # whose workers outlive the run, and its files' modules with them
        rule = "ray, or one on this machine"
        raise VoccError(
            f"executor.kind is dask, and {next(iter(files))} cannot go with it: it must be {rule}"
        )
    return pickle.dumps((releases(), files))


@functools.cache
def _joined(run: bytes) -> str:
    """Make this process ready for a run, once, or say why it cannot take part."""
    # One thread each: the processes together use the cores.
    torch.set_num_threads(1)
    timing.settle_memory()
    (wanted, files), here = pickle.loads(run), releases()
    for name, release in wanted.items():
        if here.get(name) != release:
            told = f"node {socket.gethostname()} has {name} {here.get(name)}, and this run {release}"
            return f"{told}: give every node the same releases"
    plugins.receive(files)
    return ""


@functools.lru_cache(8)
def _unpacked(call: bytes) -> Callable[[object], object]:
    made: Callable[[object], object] = pickle.loads(call)
    return made


def called(run: bytes, call: bytes, argument: bytes) -> bytes:
    """Make a call in a worker.

    Args:
        run: what the run counts with, of :func:`about_run`.
        call: what is called, pickled.
        argument: what it is given, pickled.

    Returns:
        Pickled: whether it went well, and what it gave or the error that it raised.

    Example:
        >>> given = about_run("processes"), pickle.dumps(abs), pickle.dumps(-3)
        >>> pickle.loads(called(*given))
        (True, 3)
    """
    try:
        if refusal := _joined(run):
            raise VoccError(refusal)
        # In one piece: torch would send each tensor as an open file of this process, for the other to fetch.
        return pickle.dumps((True, _unpacked(call)(pickle.loads(argument))))
    except Exception as error:
        if not isinstance(error, VoccError):
            error.add_note(f"in worker {os.getpid()} of {socket.gethostname()}:\n{traceback.format_exc()}")
        try:
            packed = pickle.dumps((False, error))
            pickle.loads(packed)
        except Exception:
            return pickle.dumps((False, RuntimeError(plugins.one_line(error))))
        return packed
