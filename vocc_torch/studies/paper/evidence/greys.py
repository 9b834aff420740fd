"""Figs 4 to 6: greys of On and Off LEDs overlap between frames, and blooming lifts Off LEDs to On."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from vocc_torch.errors import VoccError
from vocc_torch.show.canvas import INK, QUIET
from vocc_torch.studies.paper.evidence import base, drawing
from vocc_torch.studies.paper.evidence.features import least_error, roc_area


@dataclass(frozen=True)
class GreyOverlap(base.PaperFigure):
    """Average greys of the sample's LEDs, and the two frames that contradict each other most.

    Args:
        sample: the sample.
        pair: the frame with dark On LEDs and the frame with bright Off LEDs.
    """

    name = "fig04"
    title = "Fig. 4: greys of On and Off LEDs overlap between frames"
    caption = "On LEDs of one frame are darker than Off LEDs of another: no threshold serves every frame."
    height_in = 6.3

    sample: base.Sample
    pair: tuple[int, int]

    @classmethod
    def compute(cls, source: base.Source) -> Self:
        """Find the frame whose every On LED is farthest below every Off LED of another.

        Raises:
            VoccError: no frame has both On and Off LEDs.
        """
        return cls(source.sample, most_contradicting(source.sample.greys, source.sample.bits))

    def rows(self) -> base.Rows:
        """A line an LED."""
        return base.led_rows(self.sample.bits, {"average_grey": self.sample.greys})

    def findings(self) -> dict[str, float]:
        """The pair's greys, how often frames overlap, and what the best threshold for all frames costs."""
        (dark, bright), greys, bits = self.pair, self.sample.greys, self.sample.bits
        # A mean without LEDs is NaN, and so lies above and below nothing.
        mean_on, mean_off = (np.ma.array(greys, mask=m).mean((1, 2)).filled(np.nan) for m in (~bits, bits))
        wrong, threshold = least_error(greys, bits)
        return {
            "dark_frame_highest_on_grey": float(greys[dark][bits[dark]].max()),
            "dark_frame_mean_on_grey": float(mean_on[dark]),
            "bright_frame_lowest_off_grey": float(greys[bright][~bits[bright]].min()),
            "bright_frame_mean_off_grey": float(mean_off[bright]),
            "contradicting_pairs_share": float(np.mean(mean_on[:, None] < mean_off[None, :])),
            "best_fixed_threshold_grey": threshold,
            "best_fixed_threshold_wrong_share": wrong,
            "average_grey_auc": roc_area(greys, bits),
        }

    def draw_on(self, figure: Figure) -> str:
        """Draw the two frames, and every frame's range of greys by status."""
        axes = figure.add_axes((0.325, 0.165, 0.66, 0.68))
        order = self._draw_ranges(axes)
        for index, (status, name, colour) in enumerate(drawing.STATUS[::-1]):
            frame, letter, corner = self.pair[index], "ab"[index], (0.02, 0.51 - 0.41 * index)
            shown = self.sample.greys[frame][self.sample.bits[frame] == status]
            text = f"({letter}) {name} LEDs: {shown.min():.0f} to {shown.max():.0f}"
            below = drawing.condition_text(self.sample.conditions[frame])
            drawing.add_panel(figure, corner, 0.19, self.sample.pictures[frame], text, below, colour)
            place = int(np.flatnonzero(order == frame)[0])
            axes.axvspan(place - 0.5, place + 0.5, color=QUIET, alpha=0.22, linewidth=0)
            above: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "ha": "center"}
            drawing.note(axes, letter, (place, 1.01), fontsize=11.5, fontweight="bold", **above)
        found = self.findings()
        threshold = found["best_fixed_threshold_grey"]
        wrong = drawing.percent_text(found["best_fixed_threshold_wrong_share"])
        axes.axhline(threshold, **drawing.DASHED)
        text = f"best fixed threshold {threshold:.0f}:\n{wrong} of LEDs wrong"
        drawing.note(axes, text, (-1.4, threshold), (0, 5))
        drawing.status_legend(figure)
        return (
            "Bars: from the darkest to the brightest LED of a frame; dots: mean of its On and of its Off "
            "LEDs. LED cells by the true corners."
        )

    def _draw_ranges(self, axes: Axes) -> NDArray[np.int64]:
        """Draw the range and the mean of each frame's LEDs by status; return the frames in their order."""
        greys, bits = self.sample.greys, self.sample.bits
        order = np.argsort(greys.mean(axis=(1, 2)), kind="stable")
        for status, _, colour in drawing.STATUS:
            chosen = {place: greys[frame][bits[frame] == status] for place, frame in enumerate(order)}
            chosen = {place: values for place, values in chosen.items() if values.size}
            low, mean, high = np.array([(v.min(), v.mean(), v.max()) for v in chosen.values()]).T
            axes.vlines(list(chosen), low, high, color=colour, alpha=0.45, linewidth=2.6)
            axes.plot(list(chosen), mean, ".", color=colour, markersize=5.5)
        label = f"{len(order)} sample frames, sorted by the mean grey of the panel"
        drawing.plain_axes(axes, label, "Average grey of an LED (0 to 255)")
        axes.set_xlim(-2, len(order) + 1)
        axes.margins(y=0.06)
        return order


def most_contradicting(greys: base.Floats, bits: base.Bools) -> tuple[int, int]:
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


@dataclass(frozen=True)
class BloomingInterference(base.PaperFigure):
    """The panel with the most misleading Off LED, without and with blooming.

    Args:
        sample: the sample.
        frame: the panel's frame.
        led: row and column of the LED, from 0.
        sharp: the panel without blooming.
        sharp_greys: (R,C) average grey of each of its cells.
    """

    name = "fig05_06"
    title = "Figs 5 and 6: blooming turns an Off LED's grey into that of an On LED"
    caption = "A panel without and with blooming; an Off LED among bright neighbours can be mistaken for On."

    sample: base.Sample
    frame: int
    led: tuple[int, int]
    sharp: base.Picture
    sharp_greys: base.Floats

    @classmethod
    def compute(cls, source: base.Source) -> Self:
        """Find, in the sample frames, the Off LED whose average grey lies farthest above its threshold.

        Raises:
            VoccError: the scenes have no blooming, or the sample has no Off LED.
        """
        clear, sample, plan = source.without_blooming(), source.sample, source.plan
        if sample.bits.all():
            raise VoccError("the sample frames have no Off LED: the figure needs one")
        margins = off_margins(sample)
        frame, row, column = (int(i) for i in np.unravel_index(margins.argmax(), margins.shape))
        scene, bits = sample.scene[frame : frame + 1], torch.from_numpy(sample.bits[frame : frame + 1])
        rendered, panels = clear.render(scene, bits), clear.true_panels(scene)
        greys = plan.receiver.reader.read_greys(rendered, panels).average[0].double().cpu().numpy()
        (sharp,) = base.cut_out(rendered, panels.corners_px, plan.world.panel.shape)
        return cls(sample, frame, (row, column), sharp, greys)

    def rows(self) -> base.Rows:
        """A line an LED of the panel."""
        values = {
            "average_grey_without_blooming": self.sharp_greys[None],
            "average_grey_with_blooming": self.sample.greys[self.frame][None],
            "gri_with_blooming": self.sample.feature("gri")[self.frame][None],
        }
        return [line[1:] for line in base.led_rows(self.sample.bits[self.frame][None], values)]

    def findings(self) -> dict[str, float]:
        """The LED's greys against its threshold, and how often this happens."""
        (row, column), bloomed = self.led, self.sample.greys[self.frame]
        around = (slice(max(0, row - 1), row + 2), slice(max(0, column - 1), column + 2))
        neighbours = bloomed[around].size - 1
        misread = int((off_margins(self.sample) >= 0).sum())
        return {
            "led_row": row + 1,
            "led_column": column + 1,
            "grey_without_blooming": float(self.sharp_greys[self.led]),
            "grey_with_blooming": float(bloomed[self.led]),
            "threshold": float(self.sample.thresholds[self.frame]),
            "on_neighbours": int(self.sample.bits[self.frame][around].sum()),
            "neighbours_mean_grey": float((bloomed[around].sum() - bloomed[self.led]) / max(1, neighbours)),
            "gri": float(self.sample.feature("gri")[self.frame][self.led]),
            "misread_off_leds": misread,
            "misread_off_share": misread / int((~self.sample.bits).sum()),
        }

    def draw_on(self, figure: Figure) -> str:
        """Draw the panel without and with blooming, and the greys along the LED's row."""
        (row, column), found = self.led, self.findings()
        pictures = (self.sharp, self.sample.pictures[self.frame])
        for left, picture, text in zip((0.02, 0.285), pictures, ("(a) without", "(b) with"), strict=True):
            panel = drawing.add_panel(figure, (left, 0.42), 0.25, picture, f"{text} blooming")
            for edge, width in (("white", 3.4), (drawing.MARK, 2.0)):
                panel.add_patch(Rectangle((column, row), 1, 1, fill=False, ec=edge, lw=width, zorder=4))
        bloomed, threshold, gri = found["grey_with_blooming"], found["threshold"], found["gri"]
        reads, says = "On" if bloomed >= threshold else "Off", "Off" if gri < 0 else "On"
        text = (
            f"The marked LED (row {row + 1}, column {column + 1}) is Off; {found['on_neighbours']} of its "
            f"neighbours are\nOn, and the neighbours' cells average {found['neighbours_mean_grey']:.0f}. "
            f"Blooming lifts its own from\n{found['grey_without_blooming']:.0f} to {bloomed:.0f}; the "
            f"threshold is {threshold:.0f}, so greyscale reads {reads}.\n"
            f"Its GRI is {drawing.signed(gri)} grey values a pixel: the sign says {says}."
        )
        figure.text(0.02, 0.385, text, fontsize=10, color=INK, va="top", linespacing=1.55)
        axes = figure.add_axes((0.615, 0.205, 0.37, 0.632))
        self._draw_row(axes, pictures)
        axes.axhline(threshold, **drawing.DASHED)
        box = {"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 1.5}
        at, within = (0.99, threshold + 1), ("axes fraction", "data")
        drawing.note(axes, "threshold", at, xycoords=within, bbox=box, ha="right", va="bottom")
        axes.axvspan(column, column + 1, color=drawing.MARK, alpha=0.16, linewidth=0)
        condition, off_leds = self.sample.conditions[self.frame], int((~self.sample.bits).sum())
        share = drawing.percent_text(found["misread_off_share"])
        return (
            f"The most misleading Off LED of the sample frames, in which {found['misread_off_leds']} of "
            f"{off_leds} Off LEDs ({share}) read On by average grey.\n"
            f"This frame: {drawing.condition_text(condition)}, background {condition[3]:.0f}. True corners. "
            "Threshold: halfway between the all-On and the all-Off preamble."
        )

    def _draw_row(self, axes: Axes, pictures: tuple[base.Picture, base.Picture]) -> None:
        """Draw the pixels through the middle of the LED's row, and the average grey of each of its cells."""
        row, bits, greys = self.led[0], self.sample.bits[self.frame], self.sample.greys[self.frame]
        looks = (("pixels without", QUIET, 1.0), ("pixels with blooming", INK, 1.4))
        for (grey, (left, right, bottom, top)), (name, colour, width) in zip(pictures, looks, strict=True):
            line = grey[int((row + 0.5 - top) / (bottom - top) * len(grey))]
            edges = np.linspace(left, right, len(line) + 1)
            axes.stairs(line, edges, baseline=None, color=colour, linewidth=width, alpha=0.75, label=name)
        for status, name, colour in drawing.STATUS[::-1]:
            at, label = np.flatnonzero(bits[row] == status), f"{name} cell, average"
            axes.hlines(greys[row, at], at, at + 1, color=colour, linewidth=4, label=label)
        drawing.plain_axes(axes, f"LED column (row {row + 1})", "Grey value (0 to 255)")
        columns = np.arange(bits.shape[1])
        axes.set(xlim=self.sharp[1][:2], xticks=columns + 0.5, xticklabels=columns + 1)
        drawing.legend_above(axes, 2)


def off_margins(sample: base.Sample) -> base.Floats:
    """How far the average grey of each Off LED lies above its frame's threshold; minus infinity for On."""
    return np.where(sample.bits, -np.inf, sample.greys - sample.thresholds[:, None, None])
