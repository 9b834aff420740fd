"""Processes that do a study's work, or this one alone."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait
from typing import Self, TypeVar, cast

import torch

from vocc_torch.errors import VoccError
from vocc_torch.measure.timing import settle_memory, usable_cores

A = TypeVar("A")
R = TypeVar("R")
MOST_WORKERS = 256


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
        self.count = count or usable_cores()
        self._pool: ProcessPoolExecutor | None = None

    @property
    def window(self) -> int:
        """How many calls to hand out at a time, so that no worker waits for the next one."""
        return 1 if self.count == 1 else 2 * self.count

    def submit(self, call: Callable[[A], R], argument: A, /) -> Future[R]:
        """Hand out a call; in this process it is made at once, and its error raised here.

        Raises:
            VoccError: the workers were ended from outside, as a system short of memory does.
        """
        if self.count == 1:
            done: Future[R] = Future()
            done.set_result(call(argument))
            return done
        # First, because with the pool comes Python's resource tracker, whose start lets Ctrl-C in again.
        if self._pool is None:
            # Forking a process in which torch has started threads can hang the child.
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self.count, context, initializer=_begin)
        with worker_losses_told(), _deaf_to_interrupts():
            # Both ways a _Whole arrives as what it holds.
            return cast("Future[R]", self._pool.submit(_called, _Whole((call, argument))))

    def __enter__(self) -> Self:
        """Give itself; no process is started yet."""
        if self.count == 1:
            settle_memory()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """End the processes; after an error without waiting for what they are doing."""
        if self._pool is None:
            return
        # Before Python 3.14 a pool has no other way to end what its processes are doing.
        processes = list((self._pool._processes or {}).values())
        if kind is not None:
            for process in processes:
                process.terminate()
        self._pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Put Ctrl-C off: a process begun meanwhile never hears of it, not even while it starts."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def worker_losses_told() -> Iterator[None]:
    """Say in one line that a worker process is gone, wherever a call's result was waited for.

    Raises:
        VoccError: a worker was ended from outside, as a system short of memory does.
    """
    try:
        yield
    except BrokenProcessPool as error:
        raise VoccError(
            "a worker process was ended from outside, perhaps for lack of memory: "
            "give fewer workers or a smaller batch_frames, and start again to go on"
        ) from error


class _Whole:
    """Takes a value to another process in one piece.

    Torch would send each tensor as an open file of this process, for the other one to fetch: many calls at a
    time run out of files, and a fetch that is broken off is loud.
    """

    def __init__(self, value: object) -> None:
        self._value = value

    def __reduce__(self) -> tuple[Callable[[bytes], object], tuple[bytes]]:
        return pickle.loads, (pickle.dumps(self._value),)


def _called(work: object) -> _Whole:
    """Make a call in a worker."""
    call, argument = cast("tuple[Callable[[object], object], object]", work)
    return _Whole(call(argument))


def _begin() -> None:
    """Set a worker process up."""
    # One thread each: the processes together use the cores.
    torch.set_num_threads(1)
    settle_memory()
    # Ctrl-C reaches the whole group; the parent ends its workers itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this worker when its parent is gone: a killed parent cannot tell it to."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
