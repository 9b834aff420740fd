"""How cost and memory grow with the batch, the panel, the distance and the number of frames.

Crops of the paper's scene are simulated, located with the paper's locator and decoded by FLDA on three
features, on one thread. Each point of an axis is measured in a process of its own, a few times in turns with
all others: the thread's time for simulation and for reception, and the most memory that was resident beyond
what it was before the first frame. The frames come as one stream of batches, read on the way. A power law is
fitted to each axis; its exponent is 1 where cost is in proportion.

    python benchmarks/growth.py --csv docs/results/growth.csv --picture docs/images/growth.png
"""

from __future__ import annotations

import argparse
import csv
import io
import os
import pickle
import statistics
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import growth_picture
import numpy as np
import torch
from link import Receive, train
from memory import resident_mb

from vocc_torch import PanelShape, Scene, Simulator
from vocc_torch.files import write_atomically
from vocc_torch.hardware import LedPanel
from vocc_torch.measure.timing import describe_machine, settle_memory
from vocc_torch.receiver.flda import FLDA
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import SceneModel
from vocc_torch.simulation.scene import Distribution

BATCH = 64
NOT_MEASURED = "not measured"
AXES: dict[str, tuple[float, ...]] = {
    "batch": (1, 4, 16, 64, 256, 1024),
    "leds": (4, 8, 12, 16, 24, 32),
    "distance_m": (10, 15, 22, 33, 50, 70, 100),
}
"""Values of each axis: frames a batch, LEDs along a side of a square panel, metres."""
NOTE = (
    "Crops of the paper's scene, located with the paper's locator, decoded by FLDA on three features; "
    f"batches of {BATCH} where that is not the axis,\npanels of the second column at 50 m. Processor time, "
    "medians over processes of their own; memory is the most that was resident beyond what was before.\n"
    "The grey lines are in proportion to frames, LEDs or pixels; powers are fitted, of batches from 64 on."
)
FITTED_FROM = {"batch": 64}
"""Where a fit begins: below, a batch costs what its operations cost, whatever their size."""


@dataclass(frozen=True, slots=True)
class Reading:
    """Cost at one point of an axis: of a batch, of a frame (LEDs and distance), or of all frames so far."""

    device: str
    axis: str
    value: float
    leds: int
    crop_px: int
    simulate_ms: float
    receive_ms: float
    memory_mb: float


class Bench:
    """The link on a device at one point of an axis.

    Args:
        axis: ``batch``, ``leds``, ``distance_m`` or ``frames``.
        value: the axis's.
        device: ``cpu`` or ``cuda``.
        flda: trained on the paper's scenes; what is decided here does not matter.
    """

    def __init__(self, axis: str, value: float, device: str, flda: FLDA) -> None:
        side = int(value) if axis == "leds" else 8
        self.axis, self.value, self.shape, self.device = (
            axis,
            value,
            PanelShape(side, side),
            torch.device(device),
        )
        self.batch = int(value) if axis == "batch" else BATCH
        self.model = SceneModel()
        if axis in ("leds", "distance_m"):
            at = float(value) if axis == "distance_m" else 50.0
            self.model = replace(self.model, distance_m=Distribution("constant", (at,)))
        self.simulator = Simulator(panel=LedPanel(self.shape), device=device)
        self.receive = Receive(self.shape, flda)

    def scenes(self, block: int) -> tuple[Scene, torch.Tensor]:
        """Draw a batch; each number gives other frames."""
        count = -(-self.batch // 64)
        drawn = [self.model.draw(BlockKey(0, "growth", block * count + i), self.shape) for i in range(count)]
        scene, bits = Scene.cat([s for s, _ in drawn]), torch.cat([b for _, b in drawn])
        return scene[: self.batch].to(self.device), bits[: self.batch].to(self.device)

    def run(self, block: int) -> tuple[float, float]:
        """Simulate and receive one batch: seconds of each."""
        begin = self._clock()
        frames = self.simulator.render(*self.scenes(block), nearest_m=self.model.nearest_m)
        middle = self._clock()
        self.receive(frames)
        return middle - begin, self._clock() - middle

    def reading(self, simulate_s: float, receive_s: float, memory_mb: float, value: float) -> Reading:
        """State what was measured."""
        height, width = self.simulator.crop_px(self.model.nearest_m)
        times = 1e3 * simulate_s, 1e3 * receive_s
        return Reading(self.device.type, self.axis, value, self.shape.leds, height * width, *times, memory_mb)

    def memory_mb(self, *, peak: bool = False) -> float:
        """Give the memory in use, 10^6 bytes: on a CPU what is resident, on a GPU what torch lent at most."""
        if self.device.type == "cuda":
            return torch.cuda.max_memory_allocated() / 1e6
        if not peak:
            return resident_mb()
        status = Path("/proc/self/status").read_text()
        return next(int(line.split()[1]) for line in status.splitlines() if "VmHWM" in line) * 1024 / 1e6

    def _clock(self) -> float:
        """Give the time when all that was asked for is done; on a CPU it is the thread's own."""
        if self.device.type != "cuda":
            return time.thread_time()
        torch.cuda.synchronize()
        return time.perf_counter()


def point(axis: str, value: float, device: str, flda: FLDA, seconds: float) -> list[Reading]:
    """Measure a point for some seconds, at least three batches."""
    bench = Bench(axis, value, device, flda)
    before = bench.memory_mb()
    bench.run(0)
    spent: list[tuple[float, float]] = []
    until = time.perf_counter() + seconds
    while len(spent) < 3 or time.perf_counter() < until:
        spent.append(bench.run(len(spent) + 1))
    share = 1 if axis == "batch" else bench.batch
    simulate, receive = (statistics.median(each) / share for each in zip(*spent, strict=True))
    return [bench.reading(simulate, receive, bench.memory_mb(peak=True) - before, value)]


def stream(most: int, device: str, flda: FLDA) -> list[Reading]:
    """Run batches until there are ``most`` frames, reading at 1000 frames and at each half decade on."""
    bench = Bench("frames", most, device, flda)
    before = bench.memory_mb()
    bench.run(0)
    marks = sorted({most, *(int(m) for m in np.geomspace(1e3, 1e9, 13).round() if m < most)})
    found, total, done, block = [], np.zeros(2), 0, 1
    for mark in marks:
        while done < mark:
            total += bench.run(block)
            done, block = done + bench.batch, block + 1
        simulate, receive = total.tolist()
        found.append(bench.reading(simulate, receive, bench.memory_mb() - before, done))
    return found


T = TypeVar("T")


def apart(work: Callable[[], T]) -> T:
    """Work in a fork of this process, which has imported everything and run nothing."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            with os.fdopen(write, "wb") as end, torch.no_grad():
                pickle.dump(work(), end)
        except Exception:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    os.close(write)
    with os.fdopen(read, "rb") as end:
        text = end.read()
    if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]):
        raise SystemExit("a point could not be measured")
    found: T = pickle.loads(text)
    return found


def measured(device: str, flda: FLDA, given: argparse.Namespace) -> Iterator[Reading]:
    """Measure all axes on a device: medians over the rounds, the most memory of any."""
    points = [(axis, value) for axis, values in AXES.items() for value in values]
    rounds = []
    for turn in range(given.rounds):
        order = points[:: -1 if turn % 2 else 1]
        rounds.append({at: apart(partial(point, *at, device, flda, given.seconds))[0] for at in order})
    for at in points:
        each = [one[at] for one in rounds]
        times = (statistics.median(getattr(r, name) for r in each) for name in ("simulate_ms", "receive_ms"))
        simulate, receive = times
        most = max(r.memory_mb for r in each)
        yield replace(each[0], simulate_ms=simulate, receive_ms=receive, memory_mb=most)
    yield from apart(lambda: stream(given.frames, device, flda))


def exponent(readings: Sequence[Reading], name: str, against: str = "value") -> float:
    """Fit the power of the axis with which a column grows, by least squares of the logarithms."""
    from_value = FITTED_FROM.get(readings[0].axis, 0)
    kept = [r for r in readings if r.value >= from_value]
    x, y = (np.log([getattr(r, column) for r in kept]) for column in (against, name))
    return float(np.polyfit(x, y, 1)[0])


def fits(readings: Sequence[Reading]) -> dict[str, dict[str, float]]:
    """Fit each axis: by its value, LEDs by their number and distances by the pixels of the crop."""
    against = {"leds": "leds", "distance_m": "crop_px"}
    found = {}
    for axis in (*AXES, "frames"):
        rows = [r for r in readings if r.axis == axis]
        by = against.get(axis, "value")
        found[axis] = {name: exponent(rows, f"{name}_ms", by) for name in ("simulate", "receive")}
    memory = [r for r in readings if r.axis == "frames"]
    found["frames"]["memory"] = exponent(memory, "memory_mb")
    return found


def write(readings: Sequence[Reading], absent: Sequence[str], machine: str, path: Path) -> None:
    """Write the table; a device that is not there has a row that says so."""
    text = io.StringIO()
    names = [field.name for field in fields(Reading)]
    table = csv.writer(text, lineterminator="\n")
    table.writerow([*names, "machine"])
    for reading in readings:
        values = asdict(reading).values()
        table.writerow([*(f"{v:.6g}" if isinstance(v, float) else v for v in values), machine])
    for device in absent:
        table.writerow([device, *[NOT_MEASURED] * (len(names) - 1), machine])
    write_atomically(path, text.getvalue().encode())


def main() -> None:
    """Measure, print the fits, write the table and draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rounds", type=int, default=3, help="processes a point")
    parser.add_argument("--seconds", type=float, default=0.4, help="how long a process measures")
    parser.add_argument("--frames", type=int, default=100_000, help="frames of the stream")
    parser.add_argument("--csv", type=Path, help="file for the table")
    parser.add_argument("--picture", type=Path, help="file for the picture of the CPU")
    given = parser.parse_args()
    torch.set_num_threads(1)
    settle_memory()
    # Asked in a fork: a process that has spoken to the GPU cannot be forked.
    there, flda = apart(torch.cuda.is_available), apart(train)
    readings = [r for device in ("cpu", *["cuda"] * there) for r in measured(device, flda, given)]
    machine = describe_machine(torch.device("cpu"))
    for device in dict.fromkeys(r.device for r in readings):
        own = [r for r in readings if r.device == device]
        print(f"{device}, {machine}")
        for axis, powers in fits(own).items():
            print(f"  {axis:10s} " + ", ".join(f"{name} {power:.2f}" for name, power in powers.items()))
    if given.csv:
        write(readings, () if there else ("cuda",), machine, given.csv)
    if given.picture:
        cpu = [r for r in readings if r.device == "cpu"]
        growth_picture.draw(cpu, fits(cpu), f"{NOTE}\n{machine}", given.picture)


if __name__ == "__main__":
    main()
