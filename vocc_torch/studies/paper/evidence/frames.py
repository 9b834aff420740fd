"""Figs 9, 19 and 25: gradients inside LEDs, a frame's histogram, and the time that each step takes."""

import itertools
from collections.abc import Mapping
from dataclasses import astuple, replace
from typing import Any

import numpy as np
import torch
from matplotlib.patches import Rectangle

from vocc_torch.measure import plan as plans
from vocc_torch.measure import stage_times, timing, train
from vocc_torch.receiver import bank, foreground, receiver
from vocc_torch.receiver.features import image_gradient, radial_inward_field
from vocc_torch.receiver.locators.paper import paper_stages, quantised
from vocc_torch.report import timing_figure
from vocc_torch.report.canvas import GRID, INK, QUIET, Axes, Figure
from vocc_torch.rng import BLOCK_FRAMES, BlockKey
from vocc_torch.simulation import effects, photometry, simulator
from vocc_torch.studies.paper import evidence
from vocc_torch.studies.paper.evidence import Bools, Floats, features
from vocc_torch.types import Frames, Scene

FRAMINGS: Mapping[str, simulator.Framing] = {"whole_frames": "filled", "crops": "crop"}
"""What is handed to the stages: frames of the whole sensor, as in the paper, or what the simulator crops."""
SINGLE_ROUNDS, BATCH_ROUNDS = 48, 11
"""Timed rounds with one frame at a time, each round with another frame; and with a whole batch."""
TRAINING_FRAMES = 128
"""Enough to train on here: the weights do not change the time."""


class InwardGradients(evidence.PaperFigure):
    """The vectors of Eq. 7 in an On and in an Off LED, first and second, and every LED's GRI by distance.

    Attributes:
        sample: the sample.
        frame: the frame of the two LEDs.
        leds: their rows and columns, from 0.
        grey: ((R+2)K,(C+2)K) the panel's samples.
        slopes: (2,(R+2)K,(C+2)K) as (x or y): gradient at the panel's samples, grey values a pixel, from
            dark to bright.
        inward: (2,K,K) as (x or y): unit vectors towards a cell's centre.
        places_px: (2,K,K) x and y of a cell's samples, from its centre.
        cell_px: width of an LED cell in the frame.
    """

    name = "fig09"

    def __init__(self, source: evidence.Source) -> None:
        """Take the sample frame of middle distance, and its On and its Off LED of middle GRI."""
        self.sample = sample = source.sample
        world, reader = source.plan.world, source.plan.receiver.reader
        gri, distance, k = sample.feature("gri"), sample.conditions[:, 2], reader.samples_per_led
        usable = np.flatnonzero(sample.bits.any((1, 2)) & ~sample.bits.all((1, 2)))
        self.frame = frame = int(usable[np.abs(distance[usable] - np.median(distance)).argmin()])
        self.leds = [middle_led(gri[frame], sample.bits[frame] == status) for status in (True, False)]
        pixels_per_metre = world.camera.pixels_per_metre(sample.scene.distance_m)
        self.cell_px = world.panel.pitch_m * float(pixels_per_metre[frame])
        self.grey = sample.patches[frame, 0].double().numpy()
        slopes = image_gradient(sample.patches[frame : frame + 1], reader.gradient)[0].double()
        self.slopes = (slopes * (k / self.cell_px)).numpy()
        self.inward = radial_inward_field(k, torch.float64, torch.device("cpu")).numpy()
        steps = ((np.arange(k) + 0.5) / k - 0.5) * self.cell_px
        self.places_px = np.stack(np.meshgrid(steps, steps))
        names = (f"gradient_{axis}_grey_per_px" for axis in "xy")
        self.rows = [("status", "x_px", "y_px", "grey", *names, "inward_x", "inward_y")]
        self.findings = {}
        for led, status in enumerate(("On", "Off")):
            parts = *self.places_px, self.cell(self.grey, led), *self.cell(self.slopes, led), *self.inward
            self.rows += [(status, *line) for line in np.stack(parts, axis=-1).reshape(-1, 7).tolist()]
            self.findings[f"gri_{status.lower()}"] = float(gri[frame][self.leds[led]])
        near = distance <= np.median(distance)
        halves = {"": np.ones_like(near), "_nearer_half": near, "_farther_half": ~near}
        for (on, name, _), (part, these) in itertools.product(evidence.STATUS, halves.items()):
            if (chosen := gri[these][sample.bits[these] == on]).size:
                self.findings[f"gri_negative_share_{name.lower()}{part}"] = float(np.mean(chosen < 0))

    def cell(self, values: Floats, led: int, around: int = 0) -> Floats:
        """Cut the samples of a drawn LED's cell out of the panel's, (...,K,K), and so many around it."""
        k, (row, column) = self.inward.shape[-1], self.leds[led]
        starts = k * (row + 1) - around, k * (column + 1) - around
        rows, columns = (slice(start, start + k + 2 * around) for start in starts)
        return values[..., rows, columns]

    def draw_on(self, figure: Figure) -> Mapping[str, object]:
        """Draw the vectors in an On and in an Off LED, and the GRI of all LEDs by distance."""
        gradients = np.stack([self.cell(self.slopes, led) for led in (0, 1)])
        strongest = float(np.hypot(gradients[:, 0], gradients[:, 1]).max())
        k, inward = self.inward.shape[-1], (0.7 * self.inward, evidence.MARK)
        rim = max(1, k // 4)
        reach = self.cell_px * (0.5 + rim / k)
        for led, (_, name, colour) in enumerate(evidence.STATUS[::-1]):
            slopes = gradients[led] / max(strongest, 1e-12), colour
            parts = {"(a) gradient": [slopes], "(b) radial inward": [inward], "(c) both": [inward, slopes]}
            # A cell with a quarter of a cell around it.
            shown = self.cell(self.grey, led, rim), (-reach, reach, reach, -reach)
            for index, (text, fields) in enumerate(parts.items()):
                corner = 0.045 + 0.207 * index, 0.525 - 0.35 * led
                axes = evidence.add_panel(figure, corner, 0.2, shown)
                self.draw_vectors(axes, fields)
                evidence.heading(axes, "" if led else text)
                if index == 0:
                    row, column = self.leds[led]
                    label = f"{name} LED, row {row + 1}, column {column + 1}"
                    axes.set_ylabel(label, fontsize=10.5, color=colour)
            box = {"facecolor": "white", "alpha": 0.9, "edgecolor": "none", "pad": 2.5}
            look: dict[str, Any] = {"fontweight": "bold", "va": "top", "bbox": box, "color": colour}
            text = f"GRI {evidence.signed(self.findings[f'gri_{name.lower()}'])}"
            evidence.note(axes, text, (0.03, 0.965), xycoords="axes fraction", **look)
        axes, gri = figure.add_axes((0.735, 0.175, 0.25, 0.683)), self.sample.feature("gri")
        distances = np.broadcast_to(self.sample.conditions[:, 2, None, None], gri.shape)
        labels = ("Distance (m)", "GRI (grey values a pixel)")
        features.status_cloud(axes, distances, gri, self.sample.bits, labels)
        axes.axhline(0, color=INK, linewidth=1.1)
        evidence.heading(axes, "(d) all sample frames")
        axes.yaxis.labelpad = 0
        for (_, name, colour), height in zip(evidence.STATUS, (0.06, 0.82), strict=True):
            look = {"xycoords": "axes fraction", "ha": "right", "color": colour, "fontweight": "bold"}
            evidence.note(axes, name, (0.97, height), **look)
        features.negative_share(axes, gri, self.sample.bits, (0.98, 0.98))
        condition = evidence.condition_text(self.sample.conditions[self.frame])
        return {"condition": condition, "strongest": strongest, "k": k, "cell_px": self.cell_px}

    def draw_vectors(self, axes: Axes, fields: list[tuple[Floats, str]]) -> None:
        """Outline a cell, and draw vectors (2,K,K) of a colour at its samples."""
        edge = self.cell_px / 2
        axes.add_patch(Rectangle((-edge, -edge), 2 * edge, 2 * edge, fill=False, edgecolor="white"))
        heads = {"headwidth": 3.6, "headlength": 3.8, "headaxislength": 3.4, "minlength": 0.3, "width": 0.011}
        # y points down in the image's coordinates; angles="xy" follows the axes.
        look: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1, "pivot": "mid", **heads}
        for vectors, colour in fields:
            # Length 1 spans one and a half samples.
            arrows = *self.places_px, *(vectors * (1.5 * self.cell_px / self.inward.shape[-1]))
            axes.quiver(*arrows, color=colour, edgecolor="white", linewidth=0.35, **look)


def middle_led(gri: Floats, chosen: Bools) -> tuple[int, int]:
    """Row and column of the LED with the middle GRI of those chosen; of two middle ones the lower.

    Example:
        >>> middle_led(np.array([[3.0, 1.0], [2.0, 9.0]]), np.array([[True, True], [True, False]]))
        (1, 0)
    """
    order = np.argsort(gri[chosen], kind="stable")
    row, column = np.argwhere(chosen)[order[(len(order) - 1) // 2]].tolist()
    return row, column


class FrameHistogram(evidence.PaperFigure):
    """How often each grey value occurs on the whole sensor, and the locator's first steps.

    Attributes:
        counts: (256,) pixels of the sensor with each grey value.
        on_counts: (256,) of these, those whose centre lies in the cell of an On LED, by the true corners.
        off_counts: (256,) likewise, Off.
        threshold: Otsu's; pixels above it are foreground.
        levels: (3,) grey of background, of an Off and of an On LED before any blur, by Eqs 1 to 3.
        picture: the panel with two cells of margin.
        outline: (4,2) corners that the plan's locator finds, in LED cells from the true top left corner; None
            where it finds no panel.
    """

    name = "fig19"

    def __init__(self, source: evidence.Source) -> None:
        """Count the grey values of one frame of the paper's middle scene, and threshold it as locators do."""
        plan, scene, bits = source.plan, evidence.paper_scene(), source.bits("histogram")
        shape, simulator, locate = plan.world.panel.shape, plan.world.simulator(), plan.receiver.location
        seen = simulator.render(scene, bits)
        frames = Frames(quantised(seen.grey), seen.origin_px, seen.sensor_px, seen.surround)
        corners, located = simulator.true_panels(scene).corners_px, locate(frames, shape)
        # Whose cell the centre of each pixel lies in: 1 On, 0 Off, -1 none.
        (left, top), (right, bottom) = (corners[0, [0, 2]] - frames.origin_px[0]).tolist()
        grey = frames.grey[0, 0].cpu().numpy()
        row = np.digitize(np.arange(grey.shape[0]) + 0.5, np.linspace(top, bottom, shape.rows + 1))
        column = np.digitize(np.arange(grey.shape[1]) + 0.5, np.linspace(left, right, shape.columns + 1))
        cells = np.pad(bits[0].cpu().numpy().astype(int), 1, constant_values=-1)
        status = cells[np.ix_(row, column)]
        counts = (np.bincount(grey[status == bit], minlength=256).astype(float) for bit in (0, 1))
        self.off_counts, self.on_counts = counts
        self.counts = foreground.sensor_histogram(frames)[0].double().cpu().numpy()
        self.threshold = int(paper_stages(frames, locate.closing_px).threshold[0])
        self.levels = grey_levels(plan, scene)
        (self.picture,) = evidence.cut_out(frames, corners, shape, margin_cells=2.0)
        cell = (corners[0, 2] - corners[0, 0]).cpu().numpy() / (shape.columns, shape.rows)
        found = (located.corners_px[0] - corners[0, 0]).cpu().numpy() / cell
        self.outline = found if bool(located.found[0]) else None
        kinds = np.stack([self.counts, self.on_counts, self.off_counts], axis=1).astype(int).tolist()
        head = ("grey", "pixels", "pixels_in_on_cells", "pixels_in_off_cells")
        self.rows = [head, *((level, *line) for level, line in enumerate(kinds))]
        above, off, on = slice(self.threshold + 1, None), self.off_counts, self.on_counts
        self.findings = {
            "threshold": self.threshold,
            **dict(zip(("background_grey", "off_grey", "on_grey"), self.levels.tolist(), strict=True)),
            "panel_share_of_frame": float((on + off).sum() / self.counts.sum()),
            "foreground_share_of_on_cells": float(on[above].sum() / max(1.0, on.sum())),
            "foreground_share_of_off_cells": float(off[above].sum() / max(1.0, off.sum())),
            "foreground_pixels_outside_panel": float((self.counts - on - off)[above].sum()),
        }

    def draw_on(self, figure: Figure) -> Mapping[str, object]:
        """Draw the histogram with its threshold, and the panel beside what the threshold makes of it."""
        self.draw_counts(figure.add_axes((0.085, 0.215, 0.63, 0.62)))
        grey, extent = self.picture
        evidence.add_panel(figure, (0.775, 0.535), 0.175, self.picture, "the panel")
        mask = np.where(grey > self.threshold, 255.0, 0.0), extent
        panel = evidence.add_panel(figure, (0.775, 0.13), 0.175, mask, f"grey above {self.threshold}")
        if self.outline is not None:
            panel.plot(*np.concatenate([self.outline, self.outline[:1]]).T, color=evidence.MARK, linewidth=2)
            panel.set(xlim=extent[:2], ylim=extent[2:])
        shares = (self.findings[f"foreground_share_of_{one}_cells"] for one in ("on", "off"))
        on, off = map(evidence.percent_text, shares)
        middle = evidence.conditions(evidence.paper_scene())[0]
        return {"condition": evidence.condition_text(middle), "on": on, "off": off}

    def draw_counts(self, axes: Axes) -> None:
        """Draw the counts of the frame and of its cells, the threshold, and the greys before any blur."""
        parts: tuple[tuple[Floats, dict[str, Any]], ...] = (
            (self.counts, {"fill": True, "color": GRID, "label": "whole frame"}),
            (self.counts, {"color": QUIET, "linewidth": 0.8}),
            (self.off_counts, {"color": evidence.OFF, "linewidth": 1.6, "label": "in Off cells"}),
            (self.on_counts, {"color": evidence.ON, "linewidth": 1.6, "label": "in On cells"}),
        )
        for counts, look in parts:
            axes.stairs(counts, np.arange(257) - 0.5, baseline=0.5, **look)
        top, at = float(self.counts.max()) * 4, self.threshold + 0.5
        axes.set(yscale="log", ylim=(0.5, top), xlim=(max(0.0, np.flatnonzero(self.counts)[0] - 8.0), 259))
        evidence.plain_axes(axes, "Grey value (0 to 255)", "Pixels of the frame")
        evidence.legend_above(axes, 3)
        axes.axvline(at, **evidence.DASHED)
        evidence.note(axes, f"Otsu\n{self.threshold}", (at, top), (6, -6), fontsize=11, va="top")
        # Levels are marked at heights where nothing else is.
        off, on = ("Off LED", evidence.OFF, top**0.55), ("On LED", evidence.ON, top**0.55)
        marks = ("background", QUIET, top / 8), off, on
        for level, (name, colour, height) in zip(self.levels.tolist(), marks, strict=True):
            axes.plot([level, level], [0.5, height], color=colour, linewidth=1.5, linestyle=":")
            axes.plot([level], [height], marker="v", markersize=8, color=colour)
            aside, side = ((-9, 0), "right") if level > 230 else ((9, 0), "left")
            bold: dict[str, Any] = {"fontsize": 10.5, "fontweight": "bold", "ha": side, "va": "center"}
            evidence.note(axes, f"{name}\n{level:.0f}", (level, height), aside, color=colour, **bold)


def grey_levels(plan: plans.Plan, scene: Scene) -> Floats:
    """Grey of the background, of an Off and of an On LED of one scene before any blur, by Eqs 1 to 3; (3,).

    Clipped at white where the scenes name saturation. The air's loss, under 1 % at 70 m, is left out.
    """
    camera, panel = plan.world.camera, plan.world.panel
    surfaces = panel.background_reflectance, panel.led_reflectance
    background, off = (photometry.reflected_luminance_cd_m2(scene.ambient_lx, one) for one in surfaces)
    seen = torch.cat([background, off, off + scene.led_luminance_cd_m2])
    iso = photometry.auto_iso(effects.Context(scene, camera, panel=panel))
    exposures = photometry.through_lens(seen, camera)
    greys = photometry.grey_value(exposures, iso, gamma=camera.gamma).double().cpu()
    return (greys.clamp(max=255.0) if "saturation" in plan.world.effects else greys).numpy()


class ProcessingTime(evidence.PaperFigure):
    """The time a frame takes in panel detection and in the paper's four bit detectors.

    Numbers are medians over the rounds, with their quartiles. Those of a ratio are over the ratios of each
    round, since a busy spell of the machine meets both times. Every detector does what it needs and no more.
    Rendering, the way to the receiver's device and preambles are not counted, as in the paper.

    Attributes:
        measured: the times.
    """

    name = "fig25"

    def __init__(
        self, source: evidence.Source, single_rounds: int = SINGLE_ROUNDS, batch_rounds: int = BATCH_ROUNDS
    ) -> None:
        """Time panel detection and the paper's four bit detectors on frames of the plan's scenes.

        Args:
            source: has the plan; its locator's settings are used, whichever locator it names, and batches of
                ``batch_frames``, at most a block of 64.
            single_rounds: timed rounds with one frame at a time, at least 1.
            batch_rounds: timed rounds with a batch, at least 1.
        """
        plan, of, timed = source.plan, source.plan.receiver, {}
        device, keys = plans.resolve_device(plan.world.device), [BlockKey(plan.seed, "figures/timing", 0)]
        budget = replace(plan.budget, training_frames=min(TRAINING_FRAMES, plan.budget.training_frames))
        flda = train.train(replace(plan, budget=budget)).flda
        receivers = {
            name: receiver.StagedReceiver(bank.ReceiverBank([name], flda), of.reader, of.location)
            for name in timing_figure.PAPER_SHARES
            if name != timing_figure.PANEL_DETECTION
        }
        rounds = {min(plan.batch_frames, BLOCK_FRAMES): batch_rounds, 1: single_rounds}
        for kind, framing in FRAMINGS.items():
            world = replace(plan.world, framing=framing)
            exposure = stage_times.Exposure.of(world, world.scene, keys, preambles=True)
            for batch, count in sorted(rounds.items()):
                timed[kind, batch] = stage_times.time_stages(receivers, exposure, batch, count, device)
        worked = sum(one.processor_s for one in timed.values()) / sum(one.wall_s for one in timed.values())
        waited = max(0.0, 1 - worked) if device.type == "cpu" else 0.0
        about = plan.world.camera.sensor_px, timing.describe_machine(device), torch.get_num_threads(), waited
        by_place = {place: one.by_receiver for place, one in timed.items()}
        self.measured = timing_figure.DetectionTimes(by_place, *about)
        self.rows, self.findings = lay_out(self.measured)

    def draw_on(self, figure: Figure) -> Mapping[str, object]:
        """Draw a bar a stage."""
        return {"footnote": self.measured.draw_on(figure)}


def lay_out(seen: timing_figure.DetectionTimes) -> tuple[evidence.Rows, dict[str, float]]:
    """Times and shares by stage as the lines of a CSV file, and as numbers with what NGR adds, by name.

    Each number is a median; its quartiles have ``_low`` and ``_high`` after its name. NGR adds to bit
    detection, and to all image processing.
    """
    parts = ("median", "lower_quartile", "upper_quartile")
    columns = (f"{part}_{unit}" for unit in ("ms", "share") for part in parts)
    rest = ("paper_share", "rounds", "threads", "waited_share", "machine")
    lines: evidence.Rows = [("frames", "batch_frames", "stage", *columns, *rest)]
    found: dict[str, float] = {}
    for place in seen.by_place:
        times, shares = seen.times_ms(place), seen.shares(place)
        for stage, paper in timing_figure.PAPER_SHARES.items():
            both = *astuple(times[stage]), *astuple(shares[stage])
            conditions = (paper, seen.rounds(place), seen.threads, seen.waited_share, seen.machine)
            lines.append((*place, stage, *both, *conditions))
        named = {f"ms_{stage}": one for stage, one in times.items()}
        named |= {f"share_{stage}": one for stage, one in list(shares.items())[1:]}
        named["extra_cost_of_ngr"], named["extra_total_cost_of_ngr"] = seen.ngr_costs(place)
        for name, one in named.items():
            at = f"{name}_{place[0]}_batch_{place[1]}"
            found |= {at: one.value, f"{at}_low": one.low, f"{at}_high": one.high}
    return lines, found | {"threads": seen.threads, "waited_share": seen.waited_share}
