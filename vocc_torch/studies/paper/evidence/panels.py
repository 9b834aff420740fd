"""Figs 4 to 6, 17 and 20: panels as the camera wrote them, and the grey values that mislead a receiver."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from matplotlib.patches import Rectangle
from scipy.optimize import brentq

from vocc_torch.errors import VoccError
from vocc_torch.report.canvas import INK, QUIET, Axes, Figure
from vocc_torch.simulation import Simulator, effects
from vocc_torch.studies.paper import evidence, words
from vocc_torch.studies.paper.evidence import features
from vocc_torch.types import Frames, Scene

PAPER_SCENES = {6: (32000.0, 500.0), 30: (4000.0, 3500.0), 50: (1000.0, 4000.0)}
"""Section IV-D-1: ambient light (lx) and LED luminance (cd/m2) by the contrast stated, in per cent."""
BRIGHTEST_CD_M2 = 1e6
"""No LED is looked for beyond this luminance."""


class GreyOverlap(evidence.PaperFigure):
    """Average greys of the sample's LEDs, and the two frames that contradict each other most.

    Attributes:
        sample: the sample.
        pair: the frame with dark On LEDs and the frame with bright Off LEDs.
    """

    name = "fig04"

    def __init__(self, source: evidence.Source) -> None:
        """Find the frame whose every On LED is farthest below every Off LED of another.

        Raises:
            VoccError: no frame has both On and Off LEDs.
        """
        self.sample = source.sample
        greys, bits = self.sample.greys, self.sample.bits
        self.pair = dark, bright = most_contradicting(greys, bits)
        # A mean without LEDs is NaN, and so lies above and below nothing.
        mean_on, mean_off = (np.ma.array(greys, mask=m).mean((1, 2)).filled(np.nan) for m in (~bits, bits))
        wrong, threshold = features.least_error(greys, bits)
        self.rows = evidence.led_rows(bits, {"average_grey": greys})
        highest, lowest = float(greys[dark][bits[dark]].max()), float(greys[bright][~bits[bright]].min())
        found = {"dark_frame_highest_on_grey": highest, "dark_frame_mean_on_grey": float(mean_on[dark])}
        found |= {"bright_frame_lowest_off_grey": lowest}
        found |= {"bright_frame_mean_off_grey": float(mean_off[bright])}
        found |= {"contradicting_pairs_share": float(np.mean(mean_on[:, None] < mean_off[None, :]))}
        found |= {"best_fixed_threshold_grey": threshold, "best_fixed_threshold_wrong_share": wrong}
        self.findings = {**found, "average_grey_auc": features.roc_area(greys, bits)}

    def draw_on(self, figure: Figure) -> Mapping[str, object]:
        """Draw the two frames, and every frame's range of greys by status."""
        axes, greys, bits = figure.add_axes((0.325, 0.165, 0.66, 0.68)), self.sample.greys, self.sample.bits
        order = np.argsort(greys.mean(axis=(1, 2)), kind="stable")
        for status, _, colour in evidence.STATUS:
            ranges = ((place, greys[frame][bits[frame] == status]) for place, frame in enumerate(order))
            chosen = {place: values for place, values in ranges if values.size}
            low, mean, high = np.array([(v.min(), v.mean(), v.max()) for v in chosen.values()]).T
            axes.vlines(list(chosen), low, high, color=colour, alpha=0.45, linewidth=2.6)
            axes.plot(list(chosen), mean, ".", color=colour, markersize=5.5)
        label = f"{len(order)} sample frames, sorted by the mean grey of the panel"
        evidence.plain_axes(axes, label, "Average grey of an LED (0 to 255)")
        axes.set_xlim(-2, len(order) + 1)
        axes.margins(y=0.06)
        for index, (status, name, colour) in enumerate(evidence.STATUS[::-1]):
            frame, letter, corner = self.pair[index], "ab"[index], (0.02, 0.51 - 0.41 * index)
            shown = greys[frame][bits[frame] == status]
            text = f"({letter}) {name} LEDs: {shown.min():.0f} to {shown.max():.0f}"
            below = evidence.condition_text(self.sample.conditions[frame])
            evidence.add_panel(figure, corner, 0.19, self.sample.pictures[frame], text, below, colour)
            place = int(np.flatnonzero(order == frame)[0])
            axes.axvspan(place - 0.5, place + 0.5, color=QUIET, alpha=0.22, linewidth=0)
            bold: dict[str, Any] = {"fontsize": 11.5, "ha": "center", "fontweight": "bold"}
            evidence.note(axes, letter, (place, 1.01), xycoords=("data", "axes fraction"), **bold)
        threshold = self.findings["best_fixed_threshold_grey"]
        wrong = evidence.percent_text(self.findings["best_fixed_threshold_wrong_share"])
        axes.axhline(threshold, **evidence.DASHED)
        text = f"best fixed threshold {threshold:.0f}:\n{wrong} of LEDs wrong"
        evidence.note(axes, text, (-1.4, threshold), (0, 5))
        evidence.status_legend(figure)
        return {}


def most_contradicting(greys: evidence.Floats, bits: evidence.Bools) -> tuple[int, int]:
    """Index the frame with the lowest brightest On LED, and the one with the highest darkest Off LED.

    Example:
        >>> greys = np.array([[[110.0, 100.0]], [[180.0, 150.0]]])
        >>> most_contradicting(greys, np.array([[[True, False]], [[True, False]]]))
        (0, 1)
    """
    highest_on = np.where(bits, greys, -np.inf).max(axis=(1, 2))
    lowest_off = np.where(bits, np.inf, greys).min(axis=(1, 2))
    both = bits.any(axis=(1, 2)) & ~bits.all(axis=(1, 2))
    if not both.any():
        raise VoccError("no sample frame has both On and Off LEDs: the figure compares them")
    dark = int(np.where(both, highest_on, np.inf).argmin())
    return dark, int(np.where(both, lowest_off, -np.inf).argmax())


class BloomingInterference(evidence.PaperFigure):
    """The panel with the most misleading Off LED, without and with blooming.

    Attributes:
        sample: the sample.
        frame: the panel's frame.
        led: row and column of the LED, from 0.
        pictures: the panel without and with blooming.
    """

    name = "fig05_06"

    def __init__(self, source: evidence.Source) -> None:
        """Find, in the sample frames, the Off LED whose average grey lies farthest above its threshold.

        Raises:
            VoccError: the scenes have no blooming, or the sample has no Off LED.
        """
        clear, plan, self.sample = source.without_blooming(), source.plan, source.sample
        sample = self.sample
        if sample.bits.all():
            raise VoccError("the sample frames have no Off LED: the figure needs one")
        margins = np.where(sample.bits, -np.inf, sample.greys - sample.thresholds[:, None, None])
        frame, row, column = (int(i) for i in np.unravel_index(margins.argmax(), margins.shape))
        self.frame, self.led = frame, (row, column)
        one = slice(frame, frame + 1)
        scene, bits = sample.scene[one], sample.bits[one]
        rendered, panels = clear.render(scene, torch.from_numpy(bits)), clear.true_panels(scene)
        sharp = plan.receiver.reader.read_greys(rendered, panels).average.double().cpu().numpy()
        (picture,) = evidence.cut_out(rendered, panels.corners_px, plan.world.panel.shape)
        self.pictures = picture, sample.pictures[frame]
        bloomed, gri = sample.greys[frame], sample.feature("gri")[one]
        greys = {"average_grey_without_blooming": sharp, "average_grey_with_blooming": bloomed[None]}
        self.rows = [line[1:] for line in evidence.led_rows(bits, greys | {"gri_with_blooming": gri})]
        around = slice(max(0, row - 1), row + 2), slice(max(0, column - 1), column + 2)
        cells, misread = bloomed[around], int((margins >= 0).sum())
        self.findings = {"led_row": row + 1, "led_column": column + 1}
        before, after = float(sharp[0, row, column]), float(bloomed[self.led])
        self.findings |= {"grey_without_blooming": before, "grey_with_blooming": after}
        self.findings |= {"threshold": float(sample.thresholds[frame])}
        self.findings |= {"on_neighbours": int(bits[0][around].sum())}
        self.findings |= {"neighbours_mean_grey": (float(cells.sum()) - after) / max(1, cells.size - 1)}
        self.findings |= {"gri": float(gri[0, row, column]), "misread_off_leds": misread}
        self.findings |= {"misread_off_share": misread / int((~sample.bits).sum())}

    def draw_on(self, figure: Figure) -> Mapping[str, object]:
        """Draw the panel without and with blooming, and the greys along the LED's row."""
        (row, column), found = self.led, self.findings
        names = "(a) without blooming", "(b) with blooming"
        for left, picture, text in zip((0.02, 0.285), self.pictures, names, strict=True):
            panel = evidence.add_panel(figure, (left, 0.42), 0.25, picture, text)
            for edge, width in (("white", 3.4), (evidence.MARK, 2.0)):
                panel.add_patch(Rectangle((column, row), 1, 1, fill=False, ec=edge, lw=width, zorder=4))
        threshold, gri = found["threshold"], found["gri"]
        read = "On" if found["grey_with_blooming"] >= threshold else "Off", "Off" if gri < 0 else "On"
        said = {"reads": read[0], "says": read[1], "gri_text": evidence.signed(gri)}
        text = words.FIGURES[self.name]["text"].format(**found, **said)
        figure.text(0.02, 0.385, text, fontsize=10, color=INK, va="top", linespacing=1.55)
        axes = figure.add_axes((0.615, 0.205, 0.37, 0.632))
        self.draw_row(axes)
        axes.axhline(threshold, **evidence.DASHED)
        box = {"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 1.5}
        look: dict[str, Any] = {"bbox": box, "ha": "right", "va": "bottom"}
        evidence.note(axes, "threshold", (0.99, threshold + 1), xycoords=("axes fraction", "data"), **look)
        axes.axvspan(column, column + 1, color=evidence.MARK, alpha=0.16, linewidth=0)
        return {
            "off_leds": int((~self.sample.bits).sum()),
            "share": evidence.percent_text(found["misread_off_share"]),
            "condition": evidence.condition_text(self.sample.conditions[self.frame], background=True),
        }

    def draw_row(self, axes: Axes) -> None:
        """Draw the pixels through the middle of the LED's row, and the average grey of each of its cells."""
        row, bits, greys = self.led[0], self.sample.bits[self.frame], self.sample.greys[self.frame]
        looks = ("pixels without", QUIET, 1.0), ("pixels with blooming", INK, 1.4)
        for (grey, extent), (name, colour, width) in zip(self.pictures, looks, strict=True):
            left, right, bottom, top = extent
            line = grey[int((row + 0.5 - top) / (bottom - top) * len(grey))]
            edges = np.linspace(left, right, len(line) + 1)
            axes.stairs(line, edges, baseline=None, color=colour, linewidth=width, alpha=0.75, label=name)
        for status, name, colour in evidence.STATUS[::-1]:
            at, label = np.flatnonzero(bits[row] == status), f"{name} cell, average"
            axes.hlines(greys[row, at], at, at + 1, color=colour, linewidth=4, label=label)
        evidence.plain_axes(axes, f"LED column (row {row + 1})", "Grey value (0 to 255)")
        columns = np.arange(bits.shape[1])
        axes.set(xlim=self.pictures[0][1][:2], xticks=columns + 0.5, xticklabels=columns + 1)
        evidence.legend_above(axes, 2)


class BlurOrder(evidence.PaperFigure):
    """One panel blurred before and after gamma encoding.

    Attributes:
        pictures: blurred after gamma (the existing schemes), blurred before gamma (the paper's), not blurred.
        sigma_px: standard deviation of the blur.
    """

    name = "fig17"

    def __init__(self, source: evidence.Source) -> None:
        """Render the paper's middle scene in both orders, with the same Gaussian and the same bits.

        Raises:
            VoccError: the scenes have no blooming.
        """
        world, clear, scene = source.plan.world, source.without_blooming(), evidence.paper_scene()
        bits = source.bits("blur_order")
        before, sharp = (one.render(scene, bits) for one in (world.simulator(), clear))
        (blur,) = effects.build_effects({"blooming": world.effects["blooming"]})
        grey = blur(sharp.grey.to(torch.float64), effects.Context(scene, world.camera))
        whole = before.grey.dtype == torch.uint8
        after = Frames(grey.round() if whole else grey, sharp.origin_px, sharp.sensor_px)
        self.sigma_px = float(world.effects["blooming"]["sigma_px"])  # type: ignore[arg-type]
        place, frames = (clear.true_panels(scene).corners_px, world.panel.shape), (after, before, sharp)
        self.pictures = [evidence.cut_out(one, *place)[0] for one in frames]
        names = ("gaussian_after_gamma", "gaussian_before_gamma", "no_blooming")
        self.rows = evidence.pixel_rows(dict(zip(names, self.pictures, strict=True)))
        dull, bright, clean = (picture for picture, _ in self.pictures)
        self.findings = {
            "highest_grey_after_gamma": float(dull.max()),
            "highest_grey_before_gamma": float(bright.max()),
            "highest_grey_no_blooming": float(clean.max()),
            "mean_loss": float((bright - dull).mean()),
            "greatest_loss": float((bright - dull).max()),
            "brighter_after_gamma_share": float((dull > bright).mean()),
        }

    def draw_on(self, figure: Figure) -> Mapping[str, object]:
        """Draw the panel in both orders, and the greys along the line of the brightest pixel before gamma."""
        profile = figure.add_axes((0.635, 0.215, 0.35, 0.57))
        row = int(self.pictures[1][0].max(axis=1).argmax())
        # Not the colours of On and Off, which mean statuses in every figure.
        looks = ("after gamma", "#CC79A7", 2.1), ("before gamma", evidence.MARK, 2.1), ("no blur", QUIET, 1.0)
        for index, (name, colour, linewidth) in enumerate(looks):
            grey, (left, right, bottom, top) = self.pictures[index]
            look: dict[str, Any] = {"color": colour, "linewidth": linewidth, "zorder": 2 - index / 9}
            profile.stairs(grey[row], baseline=None, label=name, **look)
            if index < 2:
                text = f"({'ab'[index]}) Gaussian {name}"
                below = f"brightest {grey.max():.0f}, mean {grey.mean():.1f}"
                corner = (0.02 + 0.275 * index, 0.19)
                panel = evidence.add_panel(figure, corner, 0.265, self.pictures[index], text, below)
                y = top + (row + 0.5) * (bottom - top) / len(grey)
                panel.hlines([y, y], [left, right - 0.45], [left + 0.45, right], color=colour, linewidth=3)
        evidence.plain_axes(profile, "Column (px), along the marked line", "Grey value (0 to 255)")
        profile.set_xlim(0, grey.shape[1])
        evidence.legend_above(profile, 3)
        middle = evidence.conditions(evidence.paper_scene())[0]
        condition, cell_px = evidence.condition_text(middle, background=True), grey.shape[1] / (right - left)
        return {"condition": condition, "sigma_px": self.sigma_px, "cell_px": cell_px}


class ContrastPanels(evidence.PaperFigure):
    """Six panels with the same bits: the paper's three scenes, then three with the contrast asked for.

    Attributes:
        pictures: six panels.
        contrasts: (6,) contrast by Eqs 1 to 3 of the LEDs before any blur.
        seen: (6,) the same in the pictures: mean grey of the centre pixels of On LEDs less that of Off LEDs.
        conditions: (6,4) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
    """

    name = "fig20"

    def __init__(self, source: evidence.Source) -> None:
        """Render the paper's scenes, and the same with the LED luminance that the stated contrast needs."""
        world, bits = source.plan.world, source.bits("contrast")
        simulator, darkest = world.simulator(), world.scene.background_grey.bounds[0]
        scenes = {f"paper_scene_{c}": evidence.paper_scene(*light) for c, light in PAPER_SCENES.items()}
        for stated, scene in zip(PAPER_SCENES, tuple(scenes.values()), strict=True):
            scenes[f"true_{stated}"] = scene_of_contrast(simulator, scene, stated / 100, darkest)
        both = Scene.cat(list(scenes.values()))
        frames, panels = simulator.render(both, bits.repeat(len(both), 1, 1)), simulator.true_panels(both)
        centres = source.plan.receiver.reader.read_greys(frames, panels).centre.double().cpu()
        self.pictures = evidence.cut_out(frames, panels.corners_px, world.panel.shape)
        self.contrasts = simulator.contrast(both).double().cpu().numpy()
        on, off = (centres[:, side[0]].mean(dim=1) for side in (bits, ~bits))
        self.seen, self.conditions = (on - off).numpy() / 255.0, evidence.conditions(both)
        self.rows = evidence.pixel_rows(dict(zip(scenes, self.pictures, strict=True)))
        self.findings = {}
        names = ("contrast", "contrast_in_picture", "led_luminance_cd_m2", "background_grey")
        numbers = np.stack([self.contrasts, self.seen, *self.conditions[:, [1, 3]].T], axis=1).tolist()
        for scene_name, line in zip(scenes, numbers, strict=True):
            self.findings |= {f"{name}_{scene_name}": one for name, one in zip(names, line, strict=True)}

    def draw_on(self, figure: Figure) -> Mapping[str, object]:
        """Draw the paper's scenes above, and scenes that have the contrast it states below."""
        for index, contrast in enumerate(self.contrasts):
            row, column = divmod(index, 3)
            wanted = list(PAPER_SCENES)[column]
            # The same in whole percents is not said twice.
            stated = f" (paper: {wanted} %)" if abs(contrast - wanted / 100) > 0.005 else ""
            below = evidence.condition_text(self.conditions[index], background=True)
            text = f"contrast {100 * contrast:.1f} %{stated}"
            corner = 0.075 + 0.31 * column, 0.55 - 0.44 * row
            axes = evidence.add_panel(figure, corner, 0.28, self.pictures[index], text, below)
            axes.set_xlabel(f"in the picture {100 * self.seen[index]:.1f} %", color=INK)
            if column == 0:
                label = ("The paper's scenes", "The stated contrast")[row]
                axes.set_ylabel(label, fontsize=12, color=INK, labelpad=10)
        return {"distance_m": self.conditions[0, 2]}


def scene_of_contrast(simulator: Simulator, scene: Scene, wanted: float, darkest: float) -> Scene:
    """The scene with the LED luminance that gives a contrast.

    White limits the contrast: where the scene cannot reach it, the background becomes ``darkest``, the lowest
    grey value that auto-ISO may give it; where that does not do either, the highest contrast is given.

    Args:
        simulator: knows the contrast of a scene.
        scene: one scene.
        wanted: above 0 and below 1.
        darkest: grey value, at most that of the scene.

    Example:
        >>> simulator = Simulator()
        >>> float(simulator.contrast(scene_of_contrast(simulator, Scene.of(), 0.3, 86.0)).round(decimals=6))
        0.3
    """

    def lit(luminance: float) -> Scene:
        return replace(scene, led_luminance_cd_m2=torch.full_like(scene.led_luminance_cd_m2, luminance))

    def excess(luminance: float) -> float:
        return float(simulator.contrast(lit(luminance))) - wanted

    if excess(BRIGHTEST_CD_M2) < 0:
        scene = replace(scene, background_grey=scene.background_grey.clamp(max=darkest))
    if excess(BRIGHTEST_CD_M2) < 0:
        return lit(BRIGHTEST_CD_M2)
    return lit(brentq(excess, 0.0, BRIGHTEST_CD_M2, xtol=1e-10, rtol=1e-14))
