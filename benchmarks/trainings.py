"""How much hangs on one training: learning curves of FLDA, and whether the algorithm's interval covers.

    python benchmarks/trainings.py

About four minutes of one core. Writes docs/results/trainings.csv, docs/images/trainings.png and the tables of
docs/statistics.md between this script's markers. Training frames are simulated once: FLDA's statistics add,
so a training of any size is a sum over pieces of 125 frames. Coverage is that of studies drawn, with
repetition, from many trainings and many test frames whose mean is then the truth.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from coverage_tables import Held
from interval_coverage import markdown
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from vocc_torch import load_scene
from vocc_torch.files import write_atomically
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.paired import paired_interval
from vocc_torch.measure.plan import Budget, Experiment, Plan, ReceiverPlan, World
from vocc_torch.measure.trainings import Trained, mean_difference
from vocc_torch.receiver.bank import feature_indices
from vocc_torch.receiver.flda import FLDA
from vocc_torch.report import canvas, folder, styles
from vocc_torch.simulation import SceneModel
from vocc_torch.simulation.scene import narrowed

DOCS = Path(__file__).resolve().parents[1] / "docs"
BEGIN, END = "<!-- generated: python benchmarks/trainings.py -->", "<!-- end -->"
PIECE, MOST, LEDS, FRAMES = 125, 128, 64, 2000
"""Frames of the smallest training, most trainings of a size, bits in a frame, test frames of a study."""
SIZES = tuple(PIECE << power for power in range(8))
NEAR = {"distance_m": ["uniform", 40, 60]}
POINTS = {
    "55 m, 1000 lx": {"distance_m": 55, "ambient_lx": 1000},
    "40 to 60 m, 8000 lx": {**NEAR, "ambient_lx": 8000},
    "40 to 60 m, 32000 lx": {**NEAR, "ambient_lx": 32000},
    "70 m, 4000 to 8000 lx": {"ambient_lx": ["uniform", 4000, 8000], "distance_m": 70},
}
"""Where the receivers are tested, by name."""
RECEIVERS = ("flda_agr", "flda_2", "flda_3")
LAWS = (
    ("55 m, 1000 lx", "flda_2", 125),
    ("55 m, 1000 lx", "flda_2", 1000),
    ("55 m, 1000 lx", "flda_agr", 1000),
    ("40 to 60 m, 32000 lx", "flda_3", 1000),
    ("40 to 60 m, 8000 lx", "flda_2", 1000),
    ("70 m, 4000 to 8000 lx", "flda_3", 1000),
)
OFTEN = (2, 3, 5, 8, 16)
"""Numbers of trainings in a study."""

Errors = Mapping[tuple[str, str, int], NDArray[np.int64]]
"""Half errors (trainings,frames) by point, receiver and training frames."""


def seen(world: World, model: SceneModel, point: str, frames: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Give features (N,R,C,3) and bits (N,R,C) of simulated frames, read at the true corners."""
    one = Experiment("trainings", "distance_m", (50.0,))
    plan = Plan(world, ReceiverPlan(locator="truth"), one, Budget(), Path("runs"))
    views = Link.of(plan).observe(model, block_keys(0, point, frames), preambles=False, frames=frames)
    features, bits = zip(*((one.readings.features, one.bits) for one in views), strict=True)
    return torch.cat(features), torch.cat(bits)


def trained(pieces: Sequence[FLDA], frames: int) -> list[FLDA]:
    """Train FLDA on each of some disjoint sets of training frames."""
    step, made = frames // PIECE, []
    for start in range(0, min(len(pieces), step * MOST) - step + 1, step):
        made.append(FLDA(3))
        for piece in pieces[start : start + step]:
            made[-1].merge(piece)
    return made


def wrong(fldas: Sequence[FLDA], name: str, features: torch.Tensor, bits: torch.Tensor) -> NDArray[np.int64]:
    """Count the half errors of each training in each frame, (K,N)."""
    chosen = feature_indices(name)
    rules = [one.select(chosen) for one in fldas]
    weights = torch.stack([one.direction for one in rules], 1)
    limits, counted = torch.stack([one.threshold for one in rules]), []
    for x, sent in zip(features[..., chosen].split(256), bits.split(256), strict=True):
        counted.append(((x.double() @ weights >= limits) != sent[..., None]).sum((1, 2)))
    return 2 * torch.cat(counted).T.numpy()


def measured(training_frames: int, frames: int) -> Errors:
    """Simulate, train and count."""
    world = load_scene("paper")
    x, bits = seen(world, world.scene, "train", training_frames)
    pieces = [FLDA(3).update(*part) for part in zip(x.split(PIECE), bits.split(PIECE), strict=True)]
    fldas = {size: made for size in SIZES if len(made := trained(pieces, size)) > 1}
    found = {}
    for at, scene in POINTS.items():
        tested = seen(world, narrowed(world.scene, scene), at, frames)
        found |= {
            (at, name, size): wrong(of, name, *tested) for name in RECEIVERS for size, of in fldas.items()
        }
    return found


def curve_rows(errors: Errors) -> list[folder.Cells]:
    """Give the lines of trainings.csv, the head first."""
    rows: list[folder.Cells] = [
        (
            *("point", "receiver", "training_frames", "trainings", "test_frames"),
            *("ber_mean", "ber_sd", "ber_best", "ber_worst"),
        )
    ]
    for (at, name, size), half in errors.items():
        rates = half.mean(1) / (2 * LEDS)
        told = (rates.mean(), rates.std(ddof=1), rates.min(), rates.max())
        rows.append((at, name, size, *half.shape, *(f"{one:.4g}" for one in told)))
    return rows


def drawn(errors: Errors) -> canvas.Figure:
    """Draw mean, best and worst training over the number of training frames, a facet a point."""
    figure, facets = canvas.new_grid(len(POINTS), 2, (4.2, 2.7), (0.75, 0.75), (0.8, 0.2, 1.15, 1.0))
    looks = styles.receiver_styles(RECEIVERS)
    for number, (axes, at) in enumerate(zip(facets, POINTS, strict=True)):
        for name, look in looks.items():
            sizes = [size for point, receiver, size in errors if (point, receiver) == (at, name)]
            rates = [errors[at, name, size].mean(1) / (2 * LEDS) for size in sizes]
            mean = [one.mean() for one in rates]
            axes.fill_between(
                sizes,
                [one.min() for one in rates],
                [one.max() for one in rates],
                color=look.colour,
                alpha=0.2,
                linewidth=0,
            )
            axes.plot(
                sizes, mean, color=look.colour, linestyle=look.line, marker=look.marker, label=look.label
            )
        axes.set(xscale="log", yscale="log", title=at)
        axes.set_xticks(SIZES[::2], [f"{size}" for size in SIZES[::2]])
        axes.xaxis.set_minor_formatter(FuncFormatter(lambda *_: ""))
        canvas.quiet_axes(axes, "both")
        canvas.label_edges(
            axes,
            True,
            True,
            "Training frames" if number > 1 else "",
            "Bit error rate" if number % 2 == 0 else "",
        )
    note = f"Line: mean of the trainings \N{MIDDLE DOT} shade: best to worst of up to {MOST} trainings,"
    note += "\nall tested on the same frames, at true corners"
    canvas.write_title(figure, "How much hangs on one training", note)
    handles, _ = facets[0].get_legend_handles_labels()
    canvas.write_legend(figure, handles, (0.01, 1 - 0.46 / figure.get_figheight()), 3)
    return figure


def counts_of(half: NDArray[np.int64]) -> Trained:
    """Put the trainings of one receiver (K,N) together."""
    each, together = tallies(half[:, None])
    return Trained(tuple(one[0] for one in each), together.counts[0])


def tallies(half: NDArray[np.int64]) -> tuple[list[list[Counts]], FrameErrors]:
    """Give the counts of each training, and all trainings together, of some receivers (K,L,N)."""
    alone = [FrameErrors(one, np.ones(one.shape, dtype=bool), LEDS) for one in half]
    both = half.sum(0)
    return [one.counts for one in alone], FrameErrors(both, np.ones(both.shape, dtype=bool), LEDS * len(half))


def coverage(errors: Errors, studies: int) -> list[list[str]]:
    """How often intervals hold the algorithm's rate, by law and number of trainings."""
    head = "point|receiver, training frames|BER|SD, %|trainings|one training's own covers, %"
    head += "|frames alone cover, %|covers, %|truth below / above, %|width / BER"
    table, rng = [head.split("|")], np.random.default_rng(0)
    for law in LAWS:
        every = errors[law]
        truth, spread = every.mean() / (2 * LEDS), every.mean(1).std(ddof=1) / every.mean()
        for often in OFTEN:
            ends = np.empty((3, studies, 2))
            for study in range(studies):
                chosen = rng.integers(0, len(every), often), rng.integers(0, every.shape[1], FRAMES)
                of = counts_of(every[np.ix_(*chosen)])
                found = (
                    ber_interval(of.each[0]),
                    ber_interval(of.pooled, errors_per_frame_error=often),
                    of.interval(),
                )
                ends[:, study] = [(one.low, one.high) for one in found]
            own, frames, algorithm = (Held.of(one, truth) for one in ends)
            what = (law[0], f"{law[1]}, {law[2]}", f"{truth:.1e}", f"{100 * spread:.0f}", f"{often}")
            covers = (str(own), str(frames), str(algorithm), algorithm.sides)
            width = np.median(ends[2, :, 1] - ends[2, :, 0]) / truth
            table.append([*what, *covers, f"{width:.2f}"])
    return table


def paired_coverage(errors: Errors, studies: int) -> list[list[str]]:
    """How often intervals hold the difference of two algorithms, paired by frame and by training."""
    head = "point|difference|trainings|one training's own covers, %|covers, %"
    table, rng = [f"{head}|truth below / above, %|told from 0, %".split("|")], np.random.default_rng(1)
    for at in ("55 m, 1000 lx", "70 m, 4000 to 8000 lx", "40 to 60 m, 8000 lx"):
        every = np.stack([errors[at, name, 1000] for name in ("flda_2", "flda_3")], 1)
        truth = (every[:, 0].mean() - every[:, 1].mean()) / (2 * LEDS)
        for often in OFTEN[1:4]:
            ends, told = np.empty((2, studies, 2)), 0
            for study in range(studies):
                frames = rng.integers(0, every.shape[2], FRAMES)
                half = every[rng.integers(0, len(every), often)][..., frames]
                each, together = tallies(half)
                first = FrameErrors(half[0], np.ones(half[0].shape, dtype=bool), LEDS).pairs[0, 1]
                a, b = (Trained(tuple(one[i] for one in each), together.counts[i]) for i in range(2))
                found = paired_interval(first), mean_difference(a, b, together.pairs[0, 1])
                told += found[1].real
                ends[:, study] = [(one.low, one.high) for one in found]
            own, algorithm = (Held.of(one, truth) for one in ends)
            covers = (str(own), str(algorithm), algorithm.sides, f"{100 * told / studies:.0f}")
            table.append([at, f"{truth:+.1e}", f"{often}", *covers])
    return table


def main() -> None:
    """Simulate, and write the table, the picture and the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--training-frames", type=int, default=128_000, help="simulated once (128000)")
    parser.add_argument("--frames", type=int, default=16_384, help="test frames of a point (16384)")
    parser.add_argument("--studies", type=int, default=1000, help="a row of the coverage tables (1000)")
    parser.add_argument("--docs", type=Path, default=DOCS, help="where the page and the results are")
    given, begun = parser.parse_args(), time.process_time()
    errors = measured(given.training_frames, given.frames)
    folder.write_rows(given.docs / "results" / "trainings.csv", curve_rows(errors))
    canvas.save_figure(drawn(errors), given.docs / "images" / "trainings.png")
    print(f"learning curves, {time.process_time() - begun:.0f} s of CPU", flush=True)
    page = (given.docs / "statistics.md").read_text()
    first, *rest = page.split(BEGIN)
    for table, part in zip((coverage, paired_coverage), rest, strict=True):
        text = markdown(table(errors, given.studies))
        print(f"{table.__name__}, {time.process_time() - begun:.0f} s of CPU\n{text}\n", flush=True)
        first += (
            f"{BEGIN}\n\n{text}\n\n{given.studies} studies a row, seed 0.\n\n{END}{part.split(END, 1)[1]}"
        )
    write_atomically(given.docs / "statistics.md", first.encode())


if __name__ == "__main__":
    torch.set_num_threads(1)
    main()
