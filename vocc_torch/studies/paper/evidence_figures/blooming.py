"""Drawings of Figs 5, 6 and 17: what blooming does, and in which order."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vocc_torch.show.canvas import GRID, INK, QUIET, new_figure, quiet_axes, write_title
from vocc_torch.studies.paper.evidence_figures.panels import (
    MARK,
    OFF,
    ON,
    Bools,
    Floats,
    Picture,
    condition_text,
    outline_led,
    panel_axes,
    percent_text,
)

_AFTER_GAMMA, _BEFORE_GAMMA = "#CC79A7", "#009E73"
"""Not the colours of On and Off, which mean statuses in every figure."""
_BACKED = {"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 1.5}


def interference_figure(
    title: str,
    *,
    pictures: tuple[Picture, Picture],
    greys: Floats,
    bits: Bools,
    led: tuple[int, int],
    threshold: float,
    gri: Floats,
    condition: Floats,
    misread: int,
    off_leds: int,
) -> Figure:
    """Draw a panel without and with blooming, and the greys along the row of its most misleading Off LED.

    Args:
        title: the figure's.
        pictures: the panel without and with blooming.
        greys: (2,R,C) average grey of each LED's cell, without and with.
        bits: (R,C).
        led: row and column of the LED, from 0.
        threshold: from there on a grey reads On.
        gri: (R,C) grey values a pixel.
        condition: (4,) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
        misread: Off LEDs of the sample whose grey reads On.
        off_leds: Off LEDs of the sample.
    """
    figure = new_figure(10, 6.0)
    row, column = led
    for index, heading in enumerate(("(a) without blooming", "(b) with blooming")):
        axes = figure.add_axes((0.02 + 0.265 * index, 0.42, 0.25, 0.25 * 10 / 6.0))
        panel_axes(axes, pictures[index], heading)
        outline_led(axes, row, column)
    figure.text(
        0.02,
        0.385,
        _story(greys, bits, led, threshold, gri),
        fontsize=10,
        color=INK,
        va="top",
        linespacing=1.55,
    )
    axes = figure.add_axes((0.615, 0.205, 0.37, 0.632))
    _row_profile(axes, pictures, greys, bits, row)
    axes.axhline(threshold, color=INK, linewidth=1.3, linestyle="--")
    axes.annotate(
        "threshold",
        (1, threshold),
        (-2, 5),
        ("axes fraction", "data"),
        "offset points",
        ha="right",
        color=INK,
        bbox=_BACKED,
    )
    axes.axvspan(column, column + 1, color=MARK, alpha=0.16, linewidth=0)
    axes.set_xlabel(f"LED column (row {row + 1})")
    share = percent_text(misread / max(1, off_leds))
    footnote = (
        f"The most misleading Off LED of the sample frames, in which {misread} of {off_leds} Off LEDs "
        f"({share}) read On by average grey.\n"
        f"This frame: {condition_text(condition)}, background {condition[3]:.0f}. True corners. "
        "Threshold: halfway between the all-On and the all-Off preamble."
    )
    write_title(figure, title, footnote)
    return figure


def _story(greys: Floats, bits: Bools, led: tuple[int, int], threshold: float, gri: Floats) -> str:
    """Tell in numbers what happens to the marked LED."""
    row, column = led
    around = (slice(max(0, row - 1), row + 2), slice(max(0, column - 1), column + 2))
    near = bits[around].size - 1
    neighbours = (greys[1][around].sum() - greys[1][led]) / max(1, near)
    reads = "On" if greys[1][led] >= threshold else "Off"
    says = "Off" if gri[led] < 0 else "On"
    return (
        f"The marked LED (row {row + 1}, column {column + 1}) is Off; "
        f"{int(bits[around].sum())} of its {near} neighbours\n"
        f"are On, and their cells average {neighbours:.0f}. Blooming lifts its own from {greys[0][led]:.0f}\n"
        f"to {greys[1][led]:.0f}; the threshold is {threshold:.0f}, so greyscale reads {reads}.\n"
        f"Its GRI is {signed(float(gri[led]))} grey values a pixel: the sign says {says}."
    )


def order_figure(
    title: str,
    *,
    pictures: tuple[Picture, Picture, Picture],
    row_px: int,
    cell_px: float,
    sigma_px: float,
    condition: Floats,
) -> Figure:
    """Draw a panel blurred after and before gamma encoding, and the greys along one line of pixels.

    Args:
        title: the figure's.
        pictures: blurred after gamma, blurred before gamma, not blurred.
        row_px: the line, from 0.
        cell_px: width of an LED cell.
        sigma_px: standard deviation of the blur.
        condition: (4,) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
    """
    figure = new_figure(10, 5.0)
    names = ("(a) Gaussian after gamma", "(b) Gaussian before gamma")
    for index, (name, colour) in enumerate(zip(names, (_AFTER_GAMMA, _BEFORE_GAMMA), strict=True)):
        axes = figure.add_axes((0.02 + 0.275 * index, 0.19, 0.265, 0.265 * 10 / 5.0))
        panel_axes(axes, pictures[index])
        axes.set_title(name, fontsize=11.5, color=INK, loc="left", pad=20, fontweight="bold")
        text = f"brightest {pictures[index][0].max():.0f}, mean {pictures[index][0].mean():.1f}"
        axes.text(0, 1.025, text, transform=axes.transAxes, fontsize=10, color=INK)
        left, right, bottom, top = pictures[index][1]
        y = top + (row_px + 0.5) * (bottom - top) / len(pictures[index][0])
        axes.plot([left, left + 0.45], [y, y], color=colour, linewidth=3)
        axes.plot([right - 0.45, right], [y, y], color=colour, linewidth=3)
    axes = figure.add_axes((0.635, 0.215, 0.35, 0.57))
    edges = np.arange(pictures[0][0].shape[1] + 1)
    drawn = (
        (2, "no blur", QUIET, 1.0),
        (0, "after gamma", _AFTER_GAMMA, 2.1),
        (1, "before gamma", _BEFORE_GAMMA, 2.1),
    )
    for index, name, colour, width in drawn:
        axes.stairs(
            pictures[index][0][row_px], edges, color=colour, linewidth=width, label=name, baseline=None
        )
    quiet_axes(axes)
    axes.grid(axis="y", color=GRID, linewidth=0.8)
    axes.set_xlim(edges[0], edges[-1])
    axes.set_xlabel("Column (px), along the marked line")
    axes.set_ylabel("Grey value (0 to 255)")
    axes.legend(
        loc="lower right", bbox_to_anchor=(1.02, 1.0), ncols=3, frameon=False, fontsize=10, handlelength=1.3
    )
    footnote = (
        f"{condition_text(condition)}, background {condition[3]:.0f}; Gaussian of {sigma_px:g} px, "
        f"LED cells of {cell_px:.1f} px. The same bits and the same filter; only the order differs."
    )
    write_title(figure, title, footnote)
    return figure


def signed(value: float) -> str:
    r"""Write a number with its sign, a minus as typographers want it.

    Example:
        >>> signed(22.14), signed(-6.99).replace("\N{MINUS SIGN}", "minus ")
        ('+22.1', 'minus 7.0')
    """
    return f"{value:+.1f}".replace("-", "\N{MINUS SIGN}")


def _row_profile(axes: Axes, pictures: tuple[Picture, Picture], greys: Floats, bits: Bools, row: int) -> None:
    """Draw the pixels through the middle of a row of LEDs, and the average grey of each of its cells."""
    for (grey, (left, right, bottom, top)), colour, width, name in zip(
        pictures, (QUIET, INK), (1.0, 1.4), ("pixels without", "pixels with blooming"), strict=True
    ):
        line = grey[int((row + 0.5 - top) / (bottom - top) * len(grey))]
        edges = np.linspace(left, right, len(line) + 1)
        axes.stairs(line, edges, color=colour, linewidth=width, label=name, baseline=None, alpha=0.75)
    for status, name, colour in ((True, "On cell, average", ON), (False, "Off cell, average", OFF)):
        columns = np.flatnonzero(bits[row] == status)
        axes.hlines(greys[1, row, columns], columns, columns + 1, color=colour, linewidth=4, label=name)
    quiet_axes(axes)
    axes.grid(axis="y", color=GRID, linewidth=0.8)
    axes.set_xlim(pictures[0][1][0], pictures[0][1][1])
    axes.set_xticks(np.arange(bits.shape[1]) + 0.5, [str(c + 1) for c in range(bits.shape[1])])
    axes.set_ylabel("Grey value (0 to 255)")
    axes.legend(
        loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=2, frameon=False, fontsize=9.5, handlelength=1.6
    )
