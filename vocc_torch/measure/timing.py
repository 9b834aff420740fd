"""How long calls take: warmed up, in turns, the device done before the clock is read; and on what machine."""

import ctypes
import os
import platform
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch

from vocc_torch.arrays import Floats
from vocc_torch.measure.estimate import Estimate

_TRIM_THRESHOLD = -1  # of malloc.h
_MMAP_THRESHOLD = -3  # of malloc.h
_CPU_FILE = Path("/proc/cpuinfo")
"""Where Linux names the processor; platform.processor() is empty there."""


def median_of(values: Sequence[float] | Floats) -> Estimate:
    """Give the median with the lower and the upper quartile as its ends, between two values where need be.

    Example:
        >>> median_of([1.0, 2.0, 3.0, 4.0])
        Estimate(value=2.5, low=1.75, high=3.25)
    """
    low, median, high = np.percentile(values, (25, 50, 75)).tolist()
    return Estimate(median, low, high)


Name = TypeVar("Name")


def interleaved(
    calls: Mapping[Name, Callable[[], object]],
    repeats: int,
    device: torch.device,
    *,
    warm_up: int = 2,
) -> dict[Name, tuple[float, ...]]:
    """Time calls in rounds, each once a round, so that a busy period of the machine affects all calls.

    Every other round runs backwards, so that the caches differ between rounds and a slow drift affects all
    calls equally. The device is idle when a call starts and has finished when the clock is read.

    Args:
        calls: what to time, by name.
        repeats: timed rounds, at least 1.
        device: where the calls work.
        warm_up: untimed rounds at the start, at least 0, for allocation, compilation and cached values.

    Returns:
        How long each call took, round by round, s.

    Example:
        >>> spent = interleaved({"sum": lambda: sum(range(9)), "none": int}, 5, torch.device("cpu"))
        >>> list(spent), len(spent["sum"]), min(spent["sum"]) > 0
        (['sum', 'none'], 5, True)
    """
    seconds: dict[Name, tuple[float, ...]] = dict.fromkeys(calls, ())
    if device.type == "cpu":
        settle_memory()
    for turn in range(warm_up + repeats):
        for name in list(calls)[:: -1 if turn % 2 else 1]:
            finish(device)
            begin = time.perf_counter()
            calls[name]()
            finish(device)
            spent = time.perf_counter() - begin
            if turn >= warm_up:
                seconds[name] += (spent,)
    return seconds


@dataclass
class Waiting:
    """How much of a measurement other work had the processor.

    Args:
        share: of its time, 0 to 1; 0 on an accelerator, for which a process waits without it.
    """

    share: float = 0.0


@contextmanager
def watched(device: torch.device) -> Iterator[Waiting]:
    """Measure in what share of a block's time this thread did not have the processor.

    Example:
        >>> with watched(torch.device("cpu")) as waiting:
        ...     _ = sum(range(9))
        >>> 0 <= waiting.share <= 1
        True
    """
    waiting = Waiting()
    wall_s, processor_s = time.perf_counter(), time.thread_time()
    yield waiting
    wall_s = time.perf_counter() - wall_s
    processor_s = time.thread_time() - processor_s
    if device.type == "cpu":
        waiting.share = max(0.0, 1 - processor_s / wall_s)


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Let torch, and scikit-learn where it is in use, work with that many threads; 0 leaves their own number.

    Example:
        >>> with threads(1):
        ...     torch.get_num_threads()
        1
    """
    before = torch.get_num_threads()
    with ExitStack() as stack:
        # It comes with scikit-learn, whose threads are not torch's.
        if count and "threadpoolctl" in sys.modules:
            stack.enter_context(_pools(len(sys.modules)).limit(limits=count))
        stack.callback(torch.set_num_threads, before)
        torch.set_num_threads(count or before)
        yield


@lru_cache(maxsize=1)
def _pools(modules: int) -> Any:
    """Find libraries with threads of their own, anew where modules have come: it takes milliseconds."""
    return sys.modules["threadpoolctl"].ThreadpoolController()


def settle_memory() -> None:
    """Let the C library keep freed memory, so that a call's time does not depend on earlier calls.

    glibc returns freed memory beyond a limit to the system, and getting pages back takes time: by chance,
    reading 64 panels took 1 to 2.5 times as long. Blocks up to 32 MiB, the most that it
    allows, and 256 MiB in all are kept (mallopt(3), M_MMAP_THRESHOLD and M_TRIM_THRESHOLD), enough for
    batches of 256 frames. Other C libraries have no such limits to set.

    Example:
        >>> settle_memory()
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # macOS, musl, Windows
        return
    for limit, size in ((_MMAP_THRESHOLD, 32 << 20), (_TRIM_THRESHOLD, 256 << 20)):
        mallopt(limit, size)


def finish(device: torch.device) -> None:
    """Wait until the device has finished; the CPU has when a call returns."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def describe_machine(device: torch.device) -> str:
    """Name what a time depends on: processor, cores, threads, torch and, where it is used, the accelerator.

    Args:
        device: where the timed calls work.

    Example:
        >>> describe_machine(torch.device("cpu"))  # doctest: +ELLIPSIS
        '..., torch ...'
    """
    counts = {"core": usable_cores(), "thread": torch.get_num_threads()}
    counted = ", ".join(
        f"{count} {name}{'s' * (count != 1)}" for name, count in counts.items()
    )
    is_cuda, told = device.type == "cuda", ""
    with suppress(OSError):
        told = _CPU_FILE.read_text("utf-8", "replace")
    named = re.search(r"^model name\s*:\s*(.*\S)", told, re.MULTILINE)
    cpu = named[1] if named else platform.processor() or platform.machine()
    gpu = f"{torch.cuda.get_device_name(device)}, " if is_cuda else ""
    return (
        f"{gpu}{cpu or 'unknown processor'} with {counted}, torch {torch.__version__}"
    )


def usable_cores() -> int:
    """Count the cores that this process may run on; a container may allow fewer than there are."""
    return (
        len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count() or 1
    )
