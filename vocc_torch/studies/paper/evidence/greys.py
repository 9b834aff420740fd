"""Figs 4 to 6: greys of On and Off LEDs overlap between frames, and blooming lifts Off LEDs to On."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from vocc_torch.errors import VoccError
from vocc_torch.measure.plan import Plan
from vocc_torch.show.canvas import INK, QUIET, new_figure, write_title
from vocc_torch.simulation import Simulator
from vocc_torch.studies.paper.evidence.features import least_error, roc_area
from vocc_torch.studies.paper.evidence.figure import (
    DASHED,
    MARK,
    STATUS,
    Bools,
    Cell,
    Floats,
    PaperFigure,
    Picture,
    add_panel,
    condition_text,
    corner_legend,
    heading,
    led_rows,
    legend_above,
    percent_text,
    plain_axes,
    signed,
)
from vocc_torch.studies.paper.evidence.sample import cut_out, draw_sample


@dataclass(frozen=True)
class GreyOverlap(PaperFigure):
    """Average greys of the sample's LEDs, and the two frames that contradict each other most.

    Args:
        greys: (B,R,C) average grey of each LED's cell.
        bits: (B,R,C).
        pair: the frame with dark On LEDs and the frame with bright Off LEDs.
        pictures: those two panels.
        conditions: (2,4) their ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
        threshold: the best fixed threshold for all frames.
        wrong: share of LEDs that it gets wrong.
    """

    name = "fig04"
    title = "Fig. 4: greys of On and Off LEDs overlap between frames"
    caption = (
        "On LEDs of one frame are darker than Off LEDs of another, so no fixed threshold serves every frame."
    )

    greys: Floats
    bits: Bools
    pair: tuple[int, int]
    pictures: tuple[Picture, Picture]
    conditions: Floats
    threshold: float
    wrong: float

    @classmethod
    def compute(cls, plan: Plan) -> Self:
        """Find the frame whose every On LED is farthest below every Off LED of another.

        Raises:
            VoccError: no frame has both On and Off LEDs.
        """
        sample = draw_sample(plan)
        pair = most_contradicting(sample.greys, sample.bits)
        wrong, threshold = least_error(sample.greys, sample.bits)
        pictures = sample.pictures[pair[0]], sample.pictures[pair[1]]
        return cls(sample.greys, sample.bits, pair, pictures, sample.conditions[list(pair)], threshold, wrong)

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line an LED."""
        return led_rows(self.bits, {"average_grey": self.greys})

    def findings(self) -> dict[str, float]:
        """Give the pair's greys, how often frames overlap, and what a fixed threshold costs."""
        dark, bright = self.pair
        on, off = self.greys[dark][self.bits[dark]], self.greys[bright][~self.bits[bright]]
        mean_on, mean_off = (class_means(self.greys, status) for status in (self.bits, ~self.bits))
        return {
            "dark_frame_highest_on_grey": float(on.max()),
            "dark_frame_mean_on_grey": float(mean_on[dark]),
            "bright_frame_lowest_off_grey": float(off.min()),
            "bright_frame_mean_off_grey": float(mean_off[bright]),
            "contradicting_pairs_share": float(np.mean(mean_on[:, None] < mean_off[None, :])),
            "best_fixed_threshold_grey": self.threshold,
            "best_fixed_threshold_wrong_share": self.wrong,
            "average_grey_auc": roc_area(self.greys, self.bits),
        }

    def draw(self) -> Figure:
        """Draw the two frames, and every frame's range of greys by status."""
        figure = new_figure(10, 6.3)
        for index, (_, name, colour) in enumerate(STATUS[::-1]):
            panel = add_panel(figure, 0.02, 0.51 - 0.41 * index, 0.19, self.pictures[index])
            shown = self.greys[self.pair[index]][self.bits[self.pair[index]] == (name == "On")]
            text = f"({'ab'[index]}) {name} LEDs: {shown.min():.0f} to {shown.max():.0f}"
            heading(panel, text, condition_text(self.conditions[index]), colour)
        axes = figure.add_axes((0.325, 0.165, 0.66, 0.68))
        order = self._draw_ranges(axes)
        for frame, letter in zip(self.pair, "ab", strict=True):
            place = int(np.flatnonzero(order == frame)[0])
            axes.axvspan(place - 0.5, place + 0.5, color=QUIET, alpha=0.22, linewidth=0)
            above: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "ha": "center", "va": "bottom"}
            axes.text(place, 1.005, letter, fontsize=11.5, fontweight="bold", color=INK, **above)
        axes.axhline(self.threshold, **DASHED)
        text = f"best fixed threshold {self.threshold:.0f}:\n{percent_text(self.wrong)} of LEDs wrong"
        axes.annotate(
            text, (0.01, self.threshold), (0, 5), ("axes fraction", "data"), "offset points", color=INK
        )
        corner_legend(figure)
        footnote = (
            "Bars: from the darkest to the brightest LED of a frame; dots: mean of its On and of its Off "
            "LEDs. LED cells by the true corners."
        )
        write_title(figure, self.title, footnote)
        return figure

    def _draw_ranges(self, axes: Axes) -> NDArray[np.int64]:
        """Draw the range and the mean of each frame's LEDs by status; give the frames in their order."""
        order = np.argsort(self.greys.mean(axis=(1, 2)), kind="stable")
        for status, _, colour in STATUS:
            chosen = [self.greys[frame][self.bits[frame] == status] for frame in order]
            kept = [(place, greys) for place, greys in enumerate(chosen) if greys.size]
            x = [place for place, _ in kept]
            ends = [greys.min() for _, greys in kept], [greys.max() for _, greys in kept]
            axes.vlines(x, *ends, color=colour, alpha=0.45, linewidth=2.6)
            axes.plot(x, [greys.mean() for _, greys in kept], ".", color=colour, markersize=5.5)
        x_label = f"{len(order)} sample frames, sorted by the mean grey of the panel"
        plain_axes(axes, x_label, "Average grey of an LED (0 to 255)")
        axes.set_xlim(-2, len(order) + 1)
        axes.margins(y=0.06)
        return order


def most_contradicting(greys: Floats, bits: Bools) -> tuple[int, int]:
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


def class_means(greys: Floats, chosen: Bools) -> Floats:
    """Mean of each frame's chosen LEDs, (B,R,C) both to (B,); NaN where a frame has none.

    Example:
        >>> class_means(np.array([[[1.0, 3.0]], [[5.0, 6.0]]]), np.array([[[True, True]], [[False, False]]]))
        array([ 2., nan])
    """
    count = chosen.sum(axis=(1, 2))
    total = np.where(chosen, greys, 0.0).sum(axis=(1, 2))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


@dataclass(frozen=True)
class BloomingInterference(PaperFigure):
    """The panel with the most misleading Off LED, without and with blooming.

    Args:
        pictures: the panel without and with blooming.
        greys: (2,R,C) average grey of each LED's cell, without and with.
        bits: (R,C).
        led: row and column of the LED, from 0.
        threshold: halfway between the scene's all-On and all-Off averages: from there on a grey reads On.
        gri: (R,C) gradient radial inwardness with blooming, grey values a pixel.
        condition: (4,) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
        misread: Off LEDs of the whole sample whose grey reads On.
        off_leds: Off LEDs of the whole sample.
    """

    name = "fig05_06"
    title = "Figs 5 and 6: blooming turns an Off LED's grey into that of an On LED"
    caption = "A panel without and with blooming; an Off LED among bright neighbours can be mistaken for On."

    pictures: tuple[Picture, Picture]
    greys: Floats
    bits: Bools
    led: tuple[int, int]
    threshold: float
    gri: Floats
    condition: Floats
    misread: int
    off_leds: int

    @classmethod
    def compute(cls, plan: Plan) -> Self:
        """Find, in the sample frames, the Off LED whose average grey lies farthest above its threshold.

        Raises:
            VoccError: the scenes have no blooming, or the sample has no Off LED.
        """
        clear, sample = without_blooming(plan), draw_sample(plan)
        margins = np.where(sample.bits, -np.inf, sample.greys - sample.thresholds[:, None, None])
        if sample.bits.all():
            raise VoccError("the sample frames have no Off LED: the figure needs one")
        frame, row, column = (int(i) for i in np.unravel_index(margins.argmax(), margins.shape))
        scene, bits = sample.scene[frame : frame + 1], torch.from_numpy(sample.bits[frame : frame + 1])
        rendered, panels = clear.render(scene, bits), clear.true_panels(scene)
        clear_greys = plan.receiver.reader.read_greys(rendered, panels).average.double().cpu().numpy()
        sharp = cut_out(rendered, panels.corners_px[0], plan.world.panel.shape)
        return cls(
            pictures=(sharp, sample.pictures[frame]),
            greys=np.concatenate([clear_greys, sample.greys[frame : frame + 1]]),
            bits=sample.bits[frame],
            led=(row, column),
            threshold=float(sample.thresholds[frame]),
            gri=sample.feature("gri")[frame],
            condition=sample.conditions[frame],
            misread=int((margins >= 0).sum()),
            off_leds=int((~sample.bits).sum()),
        )

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line an LED of the panel."""
        values = {
            "average_grey_without_blooming": self.greys[:1],
            "average_grey_with_blooming": self.greys[1:],
            "gri_with_blooming": self.gri[None],
        }
        return [line[1:] for line in led_rows(self.bits[None], values)]

    def findings(self) -> dict[str, float]:
        """Give the LED's greys against its threshold, and how often this happens."""
        (row, column), around = self.led, self._around()
        sharp, bloomed = (float(greys[self.led]) for greys in self.greys)
        block = self.greys[1][around]
        return {
            "led_row": row + 1,
            "led_column": column + 1,
            "grey_without_blooming": sharp,
            "grey_with_blooming": bloomed,
            "threshold": self.threshold,
            "on_neighbours": int(self.bits[around].sum()),
            "neighbours_mean_grey": float((block.sum() - bloomed) / max(1, block.size - 1)),
            "gri": float(self.gri[self.led]),
            "misread_off_leds": self.misread,
            "misread_off_share": self.misread / self.off_leds,
        }

    def _around(self) -> tuple[slice, slice]:
        """Index the LED and its neighbours."""
        row, column = self.led
        return slice(max(0, row - 1), row + 2), slice(max(0, column - 1), column + 2)

    def draw(self) -> Figure:
        """Draw the panel without and with blooming, and the greys along the LED's row."""
        figure = new_figure(10, 6.0)
        row, column = self.led
        for index, text in enumerate(("(a) without blooming", "(b) with blooming")):
            panel = add_panel(figure, 0.02 + 0.265 * index, 0.42, 0.25, self.pictures[index])
            heading(panel, text)
            for colour, width in (("white", 3.4), (MARK, 2.0)):
                panel.add_patch(
                    Rectangle((column, row), 1, 1, fill=False, edgecolor=colour, linewidth=width, zorder=4)
                )
        figure.text(0.02, 0.385, self._story(), fontsize=10, color=INK, va="top", linespacing=1.55)
        axes = figure.add_axes((0.615, 0.205, 0.37, 0.632))
        self._draw_row(axes)
        axes.axhline(self.threshold, **DASHED)
        axes.text(
            0.99,
            self.threshold,
            "threshold",
            transform=axes.get_yaxis_transform(),
            ha="right",
            va="bottom",
            color=INK,
            bbox={"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 1.5},
        )
        axes.axvspan(column, column + 1, color=MARK, alpha=0.16, linewidth=0)
        share = percent_text(self.misread / self.off_leds)
        footnote = (
            f"The most misleading Off LED of the sample frames, in which {self.misread} of {self.off_leds} "
            f"Off LEDs ({share}) read On by average grey.\nThis frame: {condition_text(self.condition)}, "
            f"background {self.condition[3]:.0f}. True corners. "
            "Threshold: halfway between the all-On and the all-Off preamble."
        )
        write_title(figure, self.title, footnote)
        return figure

    def _story(self) -> str:
        """Tell in numbers what happens to the marked LED."""
        found, near = self.findings(), self.bits[self._around()].size - 1
        sharp, bloomed, gri = (found[name] for name in ("grey_without_blooming", "grey_with_blooming", "gri"))
        return (
            f"The marked LED (row {found['led_row']}, column {found['led_column']}) is Off; "
            f"{found['on_neighbours']} of its {near} neighbours\n"
            f"are On, and their cells average {found['neighbours_mean_grey']:.0f}. "
            f"Blooming lifts its own from {sharp:.0f}\nto {bloomed:.0f}; the threshold is "
            f"{self.threshold:.0f}, so greyscale reads {'On' if bloomed >= self.threshold else 'Off'}.\n"
            f"Its GRI is {signed(gri)} grey values a pixel: the sign says {'Off' if gri < 0 else 'On'}."
        )

    def _draw_row(self, axes: Axes) -> None:
        """Draw the pixels through the middle of the LED's row, and the average grey of each of its cells."""
        row = self.led[0]
        lines = (("pixels without", QUIET, 1.0), ("pixels with blooming", INK, 1.4))
        for (grey, (left, right, bottom, top)), (name, colour, width) in zip(
            self.pictures, lines, strict=True
        ):
            line = grey[int((row + 0.5 - top) / (bottom - top) * len(grey))]
            edges = np.linspace(left, right, len(line) + 1)
            axes.stairs(line, edges, color=colour, linewidth=width, label=name, baseline=None, alpha=0.75)
        for status, name, colour in STATUS[::-1]:
            at, label = np.flatnonzero(self.bits[row] == status), f"{name} cell, average"
            axes.hlines(self.greys[1, row, at], at, at + 1, color=colour, linewidth=4, label=label)
        plain_axes(axes, f"LED column (row {row + 1})", "Grey value (0 to 255)")
        axes.set_xlim(self.pictures[0][1][:2])
        columns = np.arange(self.bits.shape[1])
        axes.set_xticks(columns + 0.5, [str(column + 1) for column in columns])
        legend_above(axes, 2)


def without_blooming(plan: Plan) -> Simulator:
    """Build the plan's simulator without the blooming effect.

    Raises:
        VoccError: the scenes have none.
    """
    effects = dict(plan.world.effects)
    if effects.pop("blooming", None) is None:
        raise VoccError("scene.effects has no blooming: this figure shows what it does")
    return replace(plan.world, effects=effects).simulator()
