"""Kinds of panels of the paper's figures: a picture, a cloud, a histogram, steps, arrows, bars."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.grid import Bools, Floats
from vocc_torch.report import plots
from vocc_torch.report.plots import LOOK, Axes
from vocc_torch.report.styles import Style
from vocc_torch.studies.paper.evidence import Draw

DASHED: dict[str, Any] = {"color": LOOK.ink, "linewidth": 1.3, "linestyle": "--"}
"""How thresholds are drawn."""


def picture(grey: Floats) -> Draw:
    """Show pixels (h,w) as the camera wrote them, black at 0 and white at 255."""

    def draw(axes: Axes) -> None:
        axes.imshow(grey, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)

    return draw


def cloud(
    x: Floats,
    y: Floats,
    bits: Bools,
    labels: tuple[str, str],
    line: tuple[float, float, float] | None = None,
) -> Draw:
    """Draw a point an LED in the colour of its status; On and Off are mixed, so that neither hides the other.

    Args:
        x: any shape.
        y: of the same shape.
        bits: of the same shape.
        labels: of the two axes, with their units.
        line: a decision between On and Off, ``a x + b y = c`` as (a, b, c).
    """

    def draw(axes: Axes) -> None:
        colours = np.where(bits.ravel(), LOOK.on, LOOK.off)
        mixed = np.random.default_rng(0).permutation(colours.size)
        places = x.ravel()[mixed], y.ravel()[mixed]
        axes.scatter(
            *places, s=5, c=colours[mixed], alpha=0.35, linewidths=0, rasterized=True
        )
        plots.quiet(axes, "both")
        axes.set(xlabel=labels[0], ylabel=labels[1])
        if line is not None:
            a, b, c = line
            limits = axes.get_xlim(), axes.get_ylim()
            start = (c / a, 0.0) if abs(a) > abs(b) else (0.0, c / b)
            axes.axline(start, (start[0] - b, start[1] + a), **DASHED)
            axes.set(xlim=limits[0], ylim=limits[1])

    return draw


def histogram(
    values: Floats,
    bits: Bools,
    label: str,
    threshold: float | None = None,
    log: bool = False,
) -> Draw:
    """Draw the histograms of On and of Off LEDs, and a threshold between them."""

    def draw(axes: Axes) -> None:
        plots.status_histogram(axes, values, bits, label, log=log)
        axes.legend(frameon=False)
        if threshold is not None:
            axes.axvline(threshold, **DASHED)

    return draw


def steps(
    lines: Mapping[str, Floats],
    labels: tuple[str, str],
    log: bool = False,
    threshold: float | None = None,
) -> Draw:
    """Draw values of neighbouring pixels or grey levels as steps, by name.

    Args:
        lines: (N,) each.
        labels: of the two axes, with their units.
        log: whether the vertical axis is logarithmic, from 0.5.
        threshold: a value of the horizontal axis.
    """

    def draw(axes: Axes) -> None:
        for name, values in lines.items():
            edges = np.arange(len(values) + 1) - 0.5
            axes.stairs(
                values, edges, baseline=0.5 if log else None, label=name, linewidth=1.5
            )
        plots.quiet(axes, "y")
        axes.set(xlabel=labels[0], ylabel=labels[1])
        axes.legend(frameon=False)
        if log:
            axes.set(yscale="log", ylim=(0.5, None))
        if threshold is not None:
            axes.axvline(threshold, **DASHED)

    return draw


def arrows(grey: Floats, fields: Sequence[tuple[Floats, str]]) -> Draw:
    """Draw vectors of a cell's samples over its pixels.

    Args:
        grey: (K,K) samples.
        fields: (2,K,K) as (x or y) and a colour each; the longest vector spans one and a half samples.
    """

    def draw(axes: Axes) -> None:
        picture(grey)(axes)
        for vectors, colour in fields:
            longest = max(float(np.hypot(*vectors).max()), 1e-9)
            look: dict[str, Any] = {
                "angles": "xy",
                "scale_units": "xy",
                "pivot": "mid",
                "color": colour,
            }
            axes.quiver(*vectors, scale=longest / 1.5, **look)

    return draw


def bars(
    shares: Mapping[str, Estimate], label: str, quoted: Mapping[str, float]
) -> Draw:
    """Draw a row with an interval a name, and quoted values as stars.

    Args:
        shares: by name.
        label: of the horizontal axis, with its unit.
        quoted: by name; a name without one has no star.
    """
    names = list(shares)
    style = Style("", LOOK.off, "o", "-")
    stars = {
        names.index(name): value for name, value in quoted.items() if name in names
    }
    rows = plots.Rows({"": (style, list(shares.values()))}, label, stars=stars)

    def draw(axes: Axes) -> None:
        plots.draw_rows(axes, rows, len(names))
        axes.set_yticks(range(len(names)), names)

    return draw
