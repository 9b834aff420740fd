"""Calibrate the detector: greatest scores of street frames without a panel, to a table.

    python benchmarks/false_alarms.py --shapes 4x4 4x8 8x8 16x16 --frames 3000
    python benchmarks/false_alarms.py --first 3000 --frames 3000
    python benchmarks/false_alarms.py --frames 0

The frames are of the scenes ``street_held_out`` and ``street_held_out_night``, whose clutter training has not seen,
eight of each in turn, under keys that nothing else uses. A frame is drawn once, and one pyramid of it serves every
shape. Greatest scores are appended to a file in docs/results/false_alarms that is named by the digest of the
weights: an interrupted run goes on, and several processes may do ranges. At the end the package's table is written
from all scores of these weights, and docs/results/false_alarms.csv says how good it is: 95 % bounds about one false
alarm in 1000 frames, by counting, and the shape of a generalized Pareto tail (0 is exponential; below, the table
says too many).
"""

import argparse
import csv
import math
from dataclasses import astuple
from functools import lru_cache
from importlib import resources
from pathlib import Path

import torch
from scipy.stats import genpareto

import vocc_torch as vt
from vocc_torch import PanelShape
from vocc_torch.files import file_digest
from vocc_torch.measure.intervals import clopper_pearson
from vocc_torch.measure.link import rendered
from vocc_torch.measure.plan import World
from vocc_torch.receiver.detector.judge import pitch_of
from vocc_torch.receiver.detector.pipeline import SETTINGS, candidates, with_surround
from vocc_torch.receiver.detector.pyramid import Pyramid
from vocc_torch.receiver.detector.weights import SHIPPED, Networks, load_networks
from vocc_torch.receiver.false_alarms import TABLE, FalseAlarms
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.types import Frames

LOCATOR = "detector"
RESULTS = Path(__file__).resolve().parents[1] / "docs" / "results"
SCORES = RESULTS / "false_alarms"
WORLDS = (
    ("street_held_out", "calibration"),
    ("street_held_out_night", "calibration by night"),
)
"""Scenes, and the keys of their frames: by one key a street by night would be that of a day, in the dark."""
BATCH = 8
STATED = 1e-3
SHARES = (0.07, 0.02, 0.005)
"""Shares of the frames above a floor."""
LEAST_ABOVE = 20
"""Frames above a floor, at least, but for the first."""
HEAD = (
    "locator,rows,columns,frames,score,greatest,tail_frames,above,above_low,"
    "above_high,pareto_shape,shape_low,shape_high"
)


@lru_cache
def empty(scene: str) -> World:
    """Load a scene without its panel."""
    return vt.load_scene(scene, "+scene.effects.panel_absent={}")


def drawn(batch: int) -> Frames:
    """Draw a batch of panel-free frames: eight of a scene, then eight of the other, and on."""
    scene, point = WORLDS[batch % 2]
    world, start = empty(scene), batch // 2 * BATCH
    block = BlockKey(0, point, start // BLOCK_FRAMES)
    rows = range(start % BLOCK_FRAMES, BLOCK_FRAMES, BATCH)
    return next(rendered(world.simulator(), world.scene, [block], rows, False))[-1][0]


def scores_file() -> Path:
    """Name the file of scores of the weights that ship."""
    weights = resources.files("vocc_torch.receiver.detector") / SHIPPED
    return SCORES / f"{LOCATOR}_{file_digest(str(weights))[:12]}.csv"


def read_scores(path: Path) -> dict[tuple[int, str], float]:
    """Read greatest scores by frame and shape; minus infinity where a frame has no candidate."""
    if not path.exists():
        return {}
    with path.open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.reader(file) if len(row) == 3]
    return {(int(frame), shape): float(score) for frame, shape, score in rows}


def greatest(networks: Networks, frame: Frames, shapes: list[str]) -> dict[str, float]:
    """Score the best candidate of one frame for each shape."""
    pyramid = Pyramid.of(with_surround(frame)[0])
    found = {}
    for text in shapes:
        quads, odds = candidates(networks, pyramid, shape_of(text))
        # As the detector drops them.
        odds = odds[pitch_of(quads, shape_of(text)) >= SETTINGS.least_pitch_px]
        found[text] = max(odds.tolist(), default=-math.inf)
    return found


def shape_of(text: str) -> PanelShape:
    """Read a shape, rows x columns."""
    return PanelShape(*map(int, text.split("x")))


def score(path: Path, frames: range, shapes: list[str]) -> None:
    """Append the scores that are missing of a range of frames."""
    networks, known = load_networks(None, torch.device("cpu")), read_scores(path)
    path.parent.mkdir(exist_ok=True)
    for batch in range(frames.start // BATCH, math.ceil(frames.stop / BATCH)):
        first = batch * BATCH
        numbers = range(max(first, frames.start), min(first + BATCH, frames.stop))
        missing = {
            number: [text for text in shapes if (number, text) not in known]
            for number in numbers
        }
        if not any(missing.values()):
            continue
        drawing, lines = drawn(batch), []
        for number, some in missing.items():
            frame = drawing[number - first : number - first + 1]
            for text, best in greatest(networks, frame, some).items():
                lines.append(f"{number},{text},{best:.4f}\n")
        with path.open("a", encoding="utf-8") as file:
            file.write("".join(lines))
        print(f"{numbers.stop - frames.start} of {len(frames)}", flush=True)


def fitted(shape: PanelShape, maxima: torch.Tensor) -> FalseAlarms:
    """Fit the greatest scores (N,) of N panel-free frames, minus infinity where there is none."""
    ordered = maxima.sort(descending=True).values
    first, *ranks = (round(share * len(ordered)) for share in SHARES)
    counts = (max(10, first), *(rank for rank in ranks if rank >= LEAST_ABOVE))
    # A floor that is no score tells nothing of those above it.
    above = tuple(count for count in counts if ordered[count].isfinite())
    floors = tuple(ordered[[*above]].tolist())
    scale = max(float((ordered[: above[-1]] - floors[-1]).mean()), 1e-6)
    return FalseAlarms(LOCATOR, *astuple(shape), len(ordered), above, floors, scale)


def quality(row: FalseAlarms, found: torch.Tensor) -> list[str]:
    """Say how good a table's row is, as ``HEAD`` has it."""
    floor = row.floors[-1]
    at = floor + row.scale * math.log(row.above[-1] / row.frames / STATED)
    excess = found[found > floor].sub(floor).numpy()
    above = int((found >= at).sum())
    counted = clopper_pearson(above, len(found))
    bent = genpareto.fit(excess, floc=0)[0]
    # Of tails that end so abruptly likelihood has no such bounds.
    spread = 1.96 * (1 + bent) / math.sqrt(len(excess)) if bent > -0.5 else math.nan
    numbers = [at, found.max(), row.above[-1], above]
    numbers += [counted.low, counted.high, bent, bent - spread, bent + spread]
    return [*map(str, astuple(row)[:4]), *(f"{number:.4g}" for number in numbers)]


def cells(row: FalseAlarms) -> list[str]:
    """Write a row of the package's table: several numbers are one cell."""
    many = [part if isinstance(part, tuple) else (part,) for part in astuple(row)]
    return [
        " ".join(f"{n:.6g}" if isinstance(n, float) else str(n) for n in part)
        for part in many
    ]


def write_tables(known: dict[tuple[int, str], float]) -> None:
    """Write the package's table, and how good it is."""
    shapes = sorted({text for _, text in known}, key=lambda text: shape_of(text).leds)
    rows, lines = [], [HEAD.split(",")]
    for text in shapes:
        maxima = [best for (_, other), best in known.items() if other == text]
        found = torch.tensor(maxima, dtype=torch.float64)
        rows.append(fitted(shape_of(text), found))
        lines.append(quality(rows[-1], found))
        print(dict(zip(lines[0], lines[-1], strict=True)))
    with TABLE.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(FalseAlarms.__dataclass_fields__)
        writer.writerows(map(cells, rows))
    with (RESULTS / "false_alarms.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(lines)


def main() -> None:
    """Score, and write both tables."""
    parser = argparse.ArgumentParser(description="False alarms of the detector.")
    parser.add_argument("--first", type=int, default=0, help="the first frame")
    parser.add_argument("--frames", type=int, default=200, help="0: the tables alone")
    parser.add_argument("--shapes", nargs="+", default=["4x4", "4x8", "8x8", "16x16"])
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    path = scores_file()
    frames = range(arguments.first, arguments.first + arguments.frames)
    with torch.inference_mode():
        score(path, frames, arguments.shapes)
    write_tables(read_scores(path))


if __name__ == "__main__":
    main()
