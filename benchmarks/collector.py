"""What a block of frames costs, what travels for it, and how many blocks one collector takes in a second.

    python benchmarks/collector.py --workers 1000 --blocks 20000

A block is counted for real, on one thread, with the receivers of the paper; its result is then what simulated
workers give back at once. The collector is the product's own: it hands out, takes in, writes to a ledger on
the disk and adds up. Times are processor time, which other work on the machine changes little, and wall time.
"""

import argparse
import pickle
import queue
import tempfile
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any

import torch

from vocc_torch.measure import executors, point_work, workers
from vocc_torch.measure.config import Budget
from vocc_torch.measure.ledger import Label, Ledger, Tally
from vocc_torch.measure.plan import Experiment, Plan, ReceiverPlan, World
from vocc_torch.measure.sweep import count_parts
from vocc_torch.measure.train import train
from vocc_torch.rng import BLOCK_FRAMES

BLOCKS = 12
"""Blocks that are counted for real."""


class ReadyEngine(executors.Engine):
    """Simulated workers: each call comes back at once with the counts of a block that was counted before."""

    cancels = False

    def __init__(self, count: int, counts: dict[Label, Tally]) -> None:
        self.count, self.bytes_out, self.answer = count, 0, pickle.dumps((True, [counts]))
        self._calls: queue.SimpleQueue[Future[Any]] = queue.SimpleQueue()
        threading.Thread(target=self._answer, daemon=True).start()

    def slots(self) -> int:
        """As many as are simulated."""
        return self.count

    def submit(self, call: object, /, *given: Any, **_: Any) -> Future[Any]:
        """Take a call."""
        future: Future[Any] = Future()
        self.bytes_out += len(given[2])
        self._calls.put(future)
        return future

    def _answer(self) -> None:
        while True:
            time.sleep(0.02)  # as answers come over a network, many at a time
            while not self._calls.empty():
                self._calls.get().set_result(self.answer)


def counted(plan: Plan) -> tuple[partial[Any], dict[Label, Tally], float]:
    """Train, and count some blocks on one thread: what counts, a block's counts, and its processor time."""
    torch.set_num_threads(1)
    training = train(plan)
    count = partial(count_parts, plan, {"paper": training.bank(plan.receiver.names)}, 1000.0)
    count([point_work.Part(0, BLOCK_FRAMES)])
    begun = time.process_time()
    for block in range(BLOCKS):
        (counts,) = count([point_work.Part(block, BLOCK_FRAMES)])
    return count, counts, (time.process_time() - begun) / BLOCKS


def collected(engine: ReadyEngine, count: object, blocks: int, ledger: Ledger | None) -> tuple[float, float]:
    """Collect blocks of one point, and give processor time and wall time, s a block."""
    workers.engine_of = lambda *_: engine  # what executor=ray opens
    with workers.Workers(None, "ray") as pool:
        work = point_work.PointWork("p", count, Budget(BLOCK_FRAMES * blocks), ledger)  # type: ignore[arg-type]
        begun, wall = time.process_time(), time.perf_counter()
        (outcome,) = pool.run([work])
        spent = time.process_time() - begun, time.perf_counter() - wall
    assert all(one.frames == BLOCK_FRAMES * blocks for one in outcome.counts.values())
    return spent[0] / blocks, spent[1] / blocks


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--workers", type=int, default=1000, help="simulated workers")
    parser.add_argument("--blocks", type=int, default=20_000, help="blocks that are collected")
    options = parser.parse_args(arguments)
    experiment = Experiment("ambient", "ambient_lx", (1000.0,))
    receivers = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")
    plan = Plan(World(device="cpu"), ReceiverPlan(receivers), experiment, Budget(64, 256), Path("runs"))
    count, counts, cost_s = counted(plan)
    print(f"a block of {BLOCK_FRAMES} frames, {len(receivers)} receivers: {1e3 * cost_s:.0f} ms of one core")
    print(f"its call, sent once a point: {len(pickle.dumps(count))} bytes")
    bits = BLOCK_FRAMES * plan.world.panel.shape.leds
    for name in ("in memory", "with its ledger"):
        engine = ReadyEngine(options.workers, counts)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "ledger.sqlite"
            with Ledger.open(path, {}) as ledger:
                kept = ledger if name != "in memory" else None
                busy_s, wall_s = collected(engine, count, options.blocks, kept)
            size = path.stat().st_size / options.blocks
        if kept is None:
            out = engine.bytes_out / options.blocks
            print(f"its message: {out:.0f} bytes out, {len(engine.answer)} bytes back")
        told = f"{1 / wall_s:.0f} blocks/s by the clock, {1 / busy_s:.0f} by processor time"
        print(f"{options.workers} simulated workers, {name}: {told}, {size:.0f} bytes a block on the disk")
        days = 1e12 / bits * busy_s / 86400
        print(f"  enough for {cost_s / busy_s:.0f} cores; 1e12 bits take the collector {days:.1f} days")


if __name__ == "__main__":
    main()
