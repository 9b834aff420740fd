"""Figs 9, 19 and 25: gradients inside LEDs, a frame's histogram, and the time that each step takes."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch

from vocc_torch.measure import stage_times, timing, train
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.grid import Bools, Floats
from vocc_torch.measure.plan import resolve_device
from vocc_torch.receiver import bank, foreground, receiver
from vocc_torch.receiver.features import image_gradient, radial_inward_field
from vocc_torch.receiver.locators.paper import paper_stages, quantised
from vocc_torch.report.plots import LOOK, STATUS
from vocc_torch.rng import BlockKey
from vocc_torch.studies.paper import evidence
from vocc_torch.studies.paper.evidence import PaperFigure, Rows, Source, drawing
from vocc_torch.studies.paper.evidence.features import LABELS
from vocc_torch.types import Frames

PAPER_SHARES = {
    "center_greyscale": 0.05,
    "average_greyscale": 0.07,
    "flda_2": 0.12,
    "flda_3": 0.14,
}
"""Section IV-D-5 and Fig. 25: time of each bit detector over that of panel detection."""


@dataclass(frozen=True)
class TimingBudget:
    """How processing times are measured.

    Args:
        rounds: frames that are timed one at a time.
        training_frames: enough to train on here, for the weights do not change the time.
        most_waited: largest share of the time for which other work may have had the processor; beyond it
            nothing is known of the times.
    """

    rounds: int = 48
    training_frames: int = 128
    most_waited: float = 0.05


def inward_gradients(source: Source) -> PaperFigure:
    """Fig. 9: the vectors of Eq. 7 in an On and an Off LED of middle GRI, and every LED's GRI by distance."""
    sample, reader = source.sample, source.plan.receiver.reader
    gri, k = sample.features["gri"], reader.samples_per_led
    mixed = np.flatnonzero(sample.bits.any((1, 2)) & ~sample.bits.all((1, 2)))
    frame = int(
        mixed[np.abs(sample.distance_m[mixed] - np.median(sample.distance_m)).argmin()]
    )
    panel = torch.from_numpy(sample.panels[frame])[None, None]
    slopes = image_gradient(panel, reader.gradient)[0].numpy()
    inward = radial_inward_field(k, torch.float64, torch.device("cpu")).numpy()
    numbers: dict[str, float] = {}
    panels: dict[str, evidence.Draw] = {}
    rows: Rows = [
        ("status", "grey", "gradient_x", "gradient_y", "inward_x", "inward_y")
    ]
    for status, name, colour in reversed(STATUS):
        row, column = middle_led(gri[frame], sample.bits[frame] == status)
        cell = (
            slice((row + 1) * k, (row + 2) * k),
            slice((column + 1) * k, (column + 2) * k),
        )
        grey, slope = sample.panels[frame][cell], slopes[:, *cell]
        rows += [
            (name, *line)
            for line in np.stack([grey, *slope, *inward], axis=-1)
            .reshape(-1, 5)
            .tolist()
        ]
        numbers[f"gri_{name.lower()}"] = float(gri[frame, row, column])
        numbers[f"gri_negative_share_{name.lower()}"] = float(
            np.mean(gri[sample.bits == status] < 0)
        )
        heading = (
            f"{name} LED, GRI {gri[frame, row, column]:+.1f}\ngrey: inward vectors"
        )
        panels[heading] = drawing.arrows(grey, [(inward, LOOK.quiet), (slope, colour)])
    distances = np.broadcast_to(sample.distance_m[:, None, None], gri.shape)
    labels = ("Distance (m)", LABELS["gri"])
    panels["all sample frames"] = drawing.cloud(
        distances, gri, sample.bits, labels, (0.0, 1.0, 0.0)
    )
    return PaperFigure(rows, numbers, panels)


def middle_led(gri: Floats, chosen: Bools) -> tuple[int, int]:
    """Row and column of the LED with the middle GRI of those chosen; of two middle ones the lower.

    Example:
        >>> middle_led(np.array([[3.0, 1.0], [2.0, 9.0]]), np.array([[True, True], [True, False]]))
        (1, 0)
    """
    order = np.argsort(gri[chosen], kind="stable")
    row, column = np.argwhere(chosen)[order[(len(order) - 1) // 2]].tolist()
    return row, column


def frame_histogram(source: Source) -> PaperFigure:
    """Fig. 19: how often a grey value occurs on the sensor, in On and in Off cells, and Otsu's threshold."""
    plan, scene, bits = source.plan, evidence.paper_scene(), source.bits("histogram")
    shape, simulator, locate = (
        plan.world.panel.shape,
        plan.world.simulator(),
        plan.receiver.location,
    )
    rendered = simulator.render(scene, bits)
    frames = Frames(
        quantised(rendered.grey),
        rendered.origin_px,
        rendered.sensor_px,
        rendered.surround,
    )
    corners = simulator.true_panels(scene).corners_px
    # Each pixel is counted in the cell that its centre lies in; cells outside the panel are -1.
    (left, top), (right, bottom) = (corners[0, [0, 2]] - frames.origin_px[0]).tolist()
    grey = frames.grey[0, 0].cpu().numpy()
    row = np.digitize(
        np.arange(grey.shape[0]) + 0.5, np.linspace(top, bottom, shape.rows + 1)
    )
    column = np.digitize(
        np.arange(grey.shape[1]) + 0.5, np.linspace(left, right, shape.columns + 1)
    )
    status = np.pad(bits[0].cpu().numpy().astype(int), 1, constant_values=-1)[
        np.ix_(row, column)
    ]
    off, on = (
        np.bincount(grey[status == bit], minlength=256).astype(float) for bit in (0, 1)
    )
    counts = foreground.sensor_histogram(frames)[0].double().cpu().numpy()
    threshold = int(paper_stages(frames, locate.closing_px).threshold[0])
    above = slice(threshold + 1, None)
    numbers = {
        "background_grey": float(scene.background_grey),
        "threshold": threshold,
        "on_grey": float(np.average(np.arange(256), weights=on)),
        "off_grey": float(np.average(np.arange(256), weights=off)),
        "foreground_share_of_on_cells": float(on[above].sum() / on.sum()),
        "foreground_share_of_off_cells": float(off[above].sum() / off.sum()),
        "foreground_pixels_outside_panel": float((counts - on - off)[above].sum()),
    }
    lines = {"frame": counts, "in Off cells": off, "in On cells": on}
    labels = ("Grey value (0 to 255)", "Pixels of the frame")
    picture = evidence.cut_out(frames, corners, shape)
    panels = {
        f"Otsu's threshold {threshold}": drawing.steps(
            lines, labels, log=True, threshold=threshold + 0.5
        ),
        "the panel": drawing.picture(picture),
        f"grey above {threshold}": drawing.picture(
            np.where(picture > threshold, 255.0, 0.0)
        ),
    }
    rows = np.column_stack([np.arange(256), counts, on, off]).astype(int).tolist()
    head = ("grey", "pixels", "pixels_in_on_cells", "pixels_in_off_cells")
    return PaperFigure([head, *map(tuple, rows)], numbers, panels)


def processing_time(
    source: Source, budget: TimingBudget = TimingBudget()
) -> PaperFigure:
    """Fig. 25: the time of each bit detector over that of panel detection, one frame at a time.

    Numbers are medians over the rounds with their quartiles. Rendering and preambles are not counted.
    """
    plan = source.plan
    device = resolve_device(plan.world.device)
    frames = min(budget.training_frames, plan.budget.training_frames)
    trained = train.train(
        replace(plan, budget=replace(plan.budget, training_frames=frames, trainings=1))
    )
    receivers = {
        name: receiver.StagedReceiver(
            bank.ReceiverBank([name], trained.flda),
            plan.receiver.reader,
            plan.receiver.location,
        )
        for name in PAPER_SHARES
    }
    world = replace(plan.world, framing="filled")
    keys = [BlockKey(plan.seed, "figures/timing", 0)]
    exposure = stage_times.Exposure.of(world, world.scene, keys, preambles=True)
    timed = stage_times.time_stages(receivers, exposure, 1, budget.rounds, device)
    waited = (
        max(0.0, 1 - timed.processor_s / timed.wall_s) if device.type == "cpu" else 0.0
    )
    numbers = time_numbers(timed.by_receiver, waited, budget)
    shares = {name: numbers[f"share_{name}"] for name in PAPER_SHARES}
    label = "Time over that of panel detection"
    panels = {
        f"the paper's values as stars; {timing.describe_machine(device)}": drawing.bars(
            shares, label, PAPER_SHARES
        )
    }
    rows: Rows = [("number", "median", "lower_quartile", "upper_quartile")]
    rows += [
        (name, found.value, found.low, found.high) for name, found in numbers.items()
    ]
    return PaperFigure(rows, numbers, panels)


def time_numbers(
    times: Mapping[str, stage_times.StageTimes], waited: float, budget: TimingBudget
) -> dict[str, Estimate]:
    """Times in ms, their shares of panel detection's, and what NGR adds, each with its quartiles.

    Args:
        times: round by round, by receiver.
        waited: share of the time for which other work had the processor; where it is above what the budget
            allows, every interval is open.
        budget: has that limit.
    """
    panel = times["flda_3"].summed(["locate"])
    spent = {
        name: times[name].summed(stage_times.BIT_DETECTION) for name in PAPER_SHARES
    }
    two, three = spent["flda_2"], spent["flda_3"]
    rounds = {
        "ms_panel_detection": panel,
        **{f"ms_{name}": value for name, value in spent.items()},
    }
    rounds |= {f"share_{name}": value / panel for name, value in spent.items()}
    rounds["share_longest"] = np.max(list(spent.values()), axis=0) / panel
    rounds["cost_of_ngr"] = three / two - 1
    rounds["cost_of_ngr_in_total"] = (three - two) / (panel + two)
    found = {name: stage_times.median_of(value) for name, value in rounds.items()}
    if waited > budget.most_waited:
        found = {
            name: Estimate(time.value, -np.inf, np.inf) for name, time in found.items()
        }
    return found | {"waited_share": Estimate(waited, waited, waited)}
