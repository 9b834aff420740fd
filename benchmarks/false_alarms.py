"""Calibrate the locators that state false alarms: greatest scores on streets without a panel, to a table.

    python benchmarks/false_alarms.py --frames 3000
    python benchmarks/false_alarms.py --first 3000 --frames 1000 --locators learned --shapes 8x8
    python benchmarks/false_alarms.py --frames 0

The frames are of the scenes ``street`` and ``street_night``, eight of each in turn, with no panel in them,
under a key that nothing else uses. Each is drawn once for all locators and shapes, and its greatest scores go
to docs/results/false_alarms at once: what stands there is not done again, so a run that was killed goes on,
and several may do ranges apart from one another. At the end, or with no frames at once, the package's table
is written anew from all that stands there, and docs/results/false_alarms.csv, which says how good it is:
bounds of 95 % about one false alarm in 1000 frames, by the tail and by counting, and whether the tail is
exponential: the shape of a generalized Pareto tail (0, or below: then the table says too many), and Anderson
and Darling's statistic (1.32 and more has a chance of 5 %).
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from scipy.stats import genpareto

import vocc_torch as vt
from vocc_torch import PanelShape
from vocc_torch.measure.intervals import clopper_pearson
from vocc_torch.measure.link import rendered
from vocc_torch.measure.plan import World
from vocc_torch.receiver.false_alarms import TABLE, FalseAlarms, read_table, write_table
from vocc_torch.receiver.locators.learned import LearnedLocator, sighted
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.types import Frames

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "results"
SCORES = RESULTS / "false_alarms"
WORLDS = (("street", "calibration"), ("street_night", "calibration by night"))
"""Scenes, and the keys of their frames: by one key a street by night would be that of a day, in the dark."""
BATCH, NONE, CHECKED = 8, -99.0, 6
STATED = 1e-3
HEAD = (
    "locator",
    "rows",
    "columns",
    "frames",
    "score",
    "greatest",
    "tail_frames",
    "low",
    "high",
    "above",
)
HEAD += (
    "above_low",
    "above_high",
    "pareto_shape",
    "shape_low",
    "shape_high",
    "anderson_darling",
)
Key = tuple[str, PanelShape]


def scores(name: str) -> Callable[[Frames, PanelShape], torch.Tensor]:
    """Give what scores the panels that one frame may show, as the table takes them."""
    net = LearnedLocator().net(torch.device("cpu"))
    return lambda frame, shape: sighted(net, frame, shape)[1]


@lru_cache
def empty(scene: str) -> World:
    """Load a scene without its panel."""
    return vt.load_scene(scene, "+scene.effects.panel_absent={}")


def drawn(batch: int) -> Frames:
    """Draw a batch of panel-free frames: eight of a scene, then eight of the other, and on."""
    scene, point = WORLDS[batch % 2]
    world, at = empty(scene), batch // 2 * BATCH
    block, rows = (
        BlockKey(0, point, at // BLOCK_FRAMES),
        range(at % BLOCK_FRAMES, BLOCK_FRAMES, BATCH),
    )
    return next(rendered(world.simulator(), world.scene, [block], rows, False))[-1][0]


def path_of(key: Key) -> Path:
    """Name the file of a locator's scores for a shape."""
    return SCORES / f"{key[0]}_{key[1].rows}x{key[1].columns}.csv"


def read_scores(key: Key) -> dict[int, float]:
    """Read each frame's greatest score."""
    if not path_of(key).exists():
        return {}
    with path_of(key).open(newline="", encoding="utf-8") as file:
        return {
            int(row[0]): float(row[1])
            for row in list(csv.reader(file))[1:]
            if len(row) == 2 and row[1]
        }


def append_scores(key: Key, found: dict[int, float]) -> None:
    """Add frames' greatest scores, in one piece."""
    path, text = (
        path_of(key),
        "".join(f"{frame},{score:.4f}\n" for frame, score in found.items()),
    )
    start = "" if path.exists() and path.read_bytes().endswith(b"\n") else "\n"
    with path.open("a", encoding="utf-8") as file:
        file.write(("" if path.stat().st_size else "frame,score") + start + text)


def greatest(
    score: Callable[[Frames, PanelShape], torch.Tensor],
    frame: Frames,
    shape: PanelShape,
) -> float:
    """Score one frame's best place."""
    return max(score(frame, shape).tolist(), default=NONE)


def scored(keys: list[Key], frames: range) -> Iterator[int]:
    """Score what is missing of frames, and yield how many are done.

    Raises:
        SystemExit: scores stand there that the locator does not give any more.
    """
    judges = {name: scores(name) for name in {name for name, _ in keys}}
    done = {key: read_scores(key) for key in keys}
    SCORES.mkdir(exist_ok=True)
    with torch.inference_mode():
        for key, known in done.items():
            some = [one for one, score in known.items() if score > NONE]
            for frame in some[:: max(1, len(some) // CHECKED)][:CHECKED]:
                now = greatest(
                    judges[key[0]], drawn(frame // BATCH)[frame % BATCH :][:1], key[1]
                )
                if abs(now - known[frame]) > 1e-3:
                    told = f"frame {frame} has {known[frame]:g} there and {now:g} now: delete the file"
                    raise SystemExit(
                        f"{path_of(key)} holds scores of another locator: {told}"
                    )
        for batch in range(frames.start // BATCH, math.ceil(frames.stop / BATCH)):
            wanted = range(
                max(batch * BATCH, frames.start), min((batch + 1) * BATCH, frames.stop)
            )
            missing = {
                key: [one for one in wanted if one not in known]
                for key, known in done.items()
            }
            if any(missing.values()):
                seen = drawn(batch)
                for key, some in missing.items():
                    rows = [(one, seen[one % BATCH :][:1]) for one in some]
                    append_scores(
                        key,
                        {
                            one: greatest(judges[key[0]], row, key[1])
                            for one, row in rows
                        },
                    )
            yield wanted.stop - frames.start


def judged(row: FalseAlarms, found: torch.Tensor) -> list[str]:
    """Say how good a table's row is, as ``HEAD`` has it."""
    at, floor = row.score_at(STATED), row.floors[-1]
    excess = found[found > floor].sub(floor).sort().values.numpy()
    above = int((found >= at).sum())
    counted, bent = (
        clopper_pearson(above, len(found)),
        float(genpareto.fit(excess, floc=0)[0]),
    )
    # Of tails that end so abruptly likelihood has no such bounds.
    spread = 1.96 * (1 + bent) / math.sqrt(len(excess)) if bent > -0.5 else math.nan
    below = np.clip(1 - np.exp(-excess / excess.mean()), 1e-12, 1 - 1e-12)
    odd = 2 * np.arange(len(excess)) + 1
    apart = -len(excess) - float(
        (odd * (np.log(below) + np.log(1 - below[::-1]))).mean()
    )
    told = [
        at,
        float(found.max()),
        row.above[-1],
        *row.interval(at),
        above,
        counted.low,
        counted.high,
    ]
    told += [bent, bent - spread, bent + spread, apart * (1 + 0.6 / len(excess))]
    return [
        row.locator,
        *map(str, (row.rows, row.columns, row.frames)),
        *(f"{one:.4g}" for one in told),
    ]


def main() -> None:
    """Score, and write both tables."""
    parser = argparse.ArgumentParser(description="False alarms of the locators.")
    parser.add_argument("--first", type=int, default=0, help="the first frame")
    parser.add_argument(
        "--frames", type=int, default=200, help="how many; 0 writes the tables alone"
    )
    parser.add_argument("--shapes", nargs="+", default=["8x8", "4x4"])
    parser.add_argument("--locators", nargs="+", default=["learned"])
    given = parser.parse_args()
    torch.set_num_threads(1)
    shapes = [PanelShape(*map(int, text.split("x"))) for text in given.shapes]
    keys = [(name, shape) for shape in shapes for name in given.locators]
    for count in scored(keys, range(given.first, given.first + given.frames)):
        print(f"{count} of {given.frames}", flush=True)
    rows, told = list(read_table()), []
    for path in sorted(SCORES.glob("*.csv")):
        name, size = path.stem.rsplit("_", 1)
        shape = PanelShape(*map(int, size.split("x")))
        found = torch.tensor(
            list(read_scores((name, shape)).values()), dtype=torch.float64
        )
        found = found.masked_fill(found <= NONE, -torch.inf)
        rows = [
            one
            for one in rows
            if (one.locator, one.rows, one.columns) != (name, shape.rows, shape.columns)
        ]
        rows.append(FalseAlarms.of(name, shape, found))
        told.append(judged(rows[-1], found))
        print(dict(zip(HEAD, told[-1], strict=True)), flush=True)
    write_table(
        TABLE, sorted(rows, key=lambda one: (one.locator, one.rows, one.columns))
    )
    with (RESULTS / "false_alarms.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([HEAD, *told])


if __name__ == "__main__":
    main()
