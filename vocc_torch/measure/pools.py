"""Pools of processes that run calls: on this machine, or on a Ray or a Dask cluster.

Calls and results are sent as bytes. A worker with another release or other code of this package refuses.
"""

import functools
import multiprocessing
import os
import pickle
import platform
import signal
import socket
import threading
import traceback
from collections.abc import Callable
from concurrent import futures
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import torch

from vocc_torch import __version__, plugins
from vocc_torch.errors import VoccError
from vocc_torch.measure import timing
from vocc_torch.sources import package_digest

Call: TypeAlias = futures.Future[Any]
"""A call that was handed out."""
CLUSTERS = {"ray": "ray", "dask": "distributed"}
"""Pools that may run on other machines, and the package of each."""


@dataclass(frozen=True)
class PoolLimits:
    """Waiting times and numbers of clusters."""

    connect_s: float = 5.0  # time in which an address must answer
    tries: int = 3  # runs of a call on a cluster whose nodes are lost
    cached_calls: int = 8  # that go with many arguments


LIMITS = PoolLimits()


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


def joined(kind: str, address: str) -> WorkerPool:
    """Join a cluster, or say in one line why it cannot be joined."""
    try:
        package = import_module(CLUSTERS[kind])
        return (
            ray_pool(package, address) if kind == "ray" else dask_pool(package, address)
        )
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
    return WorkerPool(
        lambda *packed: task.remote(*packed).future(),
        lambda: int(ray.cluster_resources().get("CPU", 0)) or 1,
        lambda _: ray.shutdown(),
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


def _begin(files: dict[str, str]) -> None:
    """Set a process of this machine up; ``files`` are the user's, as the run began with them."""
    plugins.EXPECTED.update(files)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers itself
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this process with its parent: a killed parent cannot tell its workers to end."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


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


_unpacked = functools.lru_cache(LIMITS.cached_calls)(pickle.loads)
"""A call that comes with many arguments is unpacked once."""


def called(run: bytes, call: bytes, argument: bytes) -> bytes:
    """Make a call in a worker.

    Args:
        run: what the run counts with: :func:`releases` and the user's files, pickled.
        call: what is called, pickled.
        argument: its argument, pickled.

    Returns:
        Pickled: whether it went well, and its result or its error.

    Example:
        >>> run = pickle.dumps((releases(), {}))
        >>> pickle.loads(called(run, pickle.dumps(abs), pickle.dumps(-3)))
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
