"""How LEDs and panels are drawn in the paper's figures."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vocc_torch.show.canvas import GRID, INK, QUIET, quiet_axes, write_legend
from vocc_torch.studies.paper.evidence.base import Bools, Floats, Picture

OFF, ON, MARK = "#0072B2", "#D55E00", "#009E73"
STATUS = ((False, "Off", OFF), (True, "On", ON))
DASHED: dict[str, Any] = {"color": INK, "linewidth": 1.3, "linestyle": "--"}
"""How thresholds are drawn."""


def add_panel(
    figure: Figure, corner: tuple[float, float], width: float, picture: Picture, *words: str
) -> Axes:
    """Show a panel's pixels as the camera wrote them, black at 0 and white at 255, in a square.

    Args:
        figure: the figure.
        corner: the square's left and bottom, as shares of the figure's width and height.
        width: as a share of the figure's width.
        picture: the pixels and where they lie.
        words: see :func:`heading`; a panel without any is not outlined.

    Returns:
        Axes without ticks; their coordinates are LED columns and rows, from 0.
    """
    axes = figure.add_axes((*corner, width, width * figure.get_figwidth() / figure.get_figheight()))
    grey, extent = picture
    axes.imshow(grey, cmap="gray", vmin=0, vmax=255, extent=extent, interpolation="nearest")
    axes.set_anchor("NW")
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(bool(words))
    axes.spines[:].set_color(GRID)
    heading(axes, *words)
    return axes


def heading(axes: Axes, text: str = "", below: str = "", colour: str = INK) -> None:
    """Write above the axes, in bold, and a line in grey between the two."""
    axes.set_title(text, fontsize=11.5, color=colour, loc="left", pad=20 if below else 5, fontweight="bold")
    axes.text(0, 1.025, below, transform=axes.transAxes, fontsize=9, color=QUIET)


def note(
    axes: Axes, text: str, at: tuple[float, float], aside_pt: tuple[float, float] = (0, 0), **look: Any
) -> None:
    """Write a note.

    Args:
        axes: where to write.
        text: what to write.
        at: the place.
        aside_pt: how far beside it, to the right and up, points.
        look: what else Matplotlib's annotation takes.
    """
    axes.annotate(text, at, aside_pt, textcoords="offset points", **{"color": INK, **look})


def plain_axes(axes: Axes, x_label: str, y_label: str, grid: Literal["x", "y", "both"] = "y") -> None:
    """Label axes, with a grid behind the data."""
    quiet_axes(axes)
    axes.grid(axis=grid, color=GRID, linewidth=0.8)
    axes.set(xlabel=x_label, ylabel=y_label)


def status_histogram(axes: Axes, values: Floats, bits: Bools, label: str, *, log: bool = False) -> None:
    """Draw the histograms of On and of Off LEDs over the same bins, each as shares of its own LEDs.

    Args:
        axes: where to draw.
        values: any shape.
        bits: of the same shape.
        label: of the horizontal axis, with its unit.
        log: whether shares are on a logarithmic axis, so that few LEDs show too.
    """
    edges, least = np.histogram_bin_edges(values, bins=60), 0.5 / bits.size if log else 0.0
    for status, name, colour in STATUS:
        chosen = values[bits == status]
        shares = np.histogram(chosen, edges)[0] / max(1, chosen.size)
        axes.stairs(shares, edges, fill=True, color=colour, alpha=0.25, baseline=least)
        axes.stairs(shares, edges, color=colour, linewidth=1.6, label=name, baseline=least)
    axes.margins(x=0.02)
    axes.set_ylim(bottom=0)
    if log:
        axes.set(yscale="log", ylim=(least, 1.0))
    plain_axes(axes, label, "Share of LEDs")


def status_cloud(axes: Axes, x: Floats, y: Floats, bits: Bools, labels: tuple[str, str]) -> None:
    """Draw a point an LED; On and Off are mixed, so that neither hides the other.

    Args:
        axes: where to draw.
        x: any shape.
        y: of the same shape.
        bits: of the same shape.
        labels: of the two axes, with their units.
    """
    colours = np.where(bits.ravel(), ON, OFF)
    mixed = np.random.default_rng(0).permutation(colours.size)
    places = x.ravel()[mixed], y.ravel()[mixed]
    axes.scatter(*places, s=7, c=colours[mixed], alpha=0.35, linewidths=0, rasterized=True)
    axes.margins(0.03)
    plain_axes(axes, *labels, grid="both")


def status_legend(figure: Figure) -> None:
    """Name the statuses at the figure's top right."""
    look: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 7}
    dots = [Line2D([], [], color=colour, label=f"{name} LEDs", **look) for _, name, colour in STATUS]
    place: dict[str, Any] = {"loc": "upper right", "handlelength": 2.0, "handletextpad": 0.1}
    at = (0.99, 1 - 0.06 / figure.get_figheight())
    write_legend(figure, dots, at, columns=2, fontsize=10.5, columnspacing=1.4, **place)


def legend_above(axes: Axes, columns: int) -> None:
    """Explain what is drawn, in rows above the axes."""
    place: dict[str, Any] = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "handlelength": 1.2}
    axes.legend(columnspacing=1.0, ncols=columns, frameon=False, fontsize=10, **place)


def percent_text(share: float) -> str:
    """Write a share in percent with three digits.

    Example:
        >>> percent_text(0.27469), percent_text(0.00015625)
        ('27.5 %', '0.0156 %')
    """
    return f"{100 * share:.3g} %"


def signed(value: float) -> str:
    r"""Write a number with its sign, a minus as typographers want it.

    Example:
        >>> signed(22.14), signed(-6.99).replace("\N{MINUS SIGN}", "minus ")
        ('+22.1', 'minus 7.0')
    """
    return f"{value:+.1f}".replace("-", "\N{MINUS SIGN}")


def negative_text(values: Floats, bits: Bools) -> str:
    """Say how many of the Off and of the On LEDs have a negative value."""
    off, on = (percent_text(float(np.mean(values[bits == status] < 0))) for status in (False, True))
    return f"negative: {off} of Off,\n{on} of On LEDs"


def condition_text(condition: Floats) -> str:
    """Write ambient light, LED luminance and distance.

    Example:
        >>> condition_text(np.array([31240.0, 2013.0, 68.2, 86.0]))
        '31\N{THIN SPACE}240 lx · 2\N{THIN SPACE}013 cd/m² · 68 m'
    """
    ambient, luminance, distance_m, _ = condition
    text = f"{ambient:,.0f} lx \N{MIDDLE DOT} {luminance:,.0f} cd/m² \N{MIDDLE DOT} {distance_m:.0f} m"
    return text.replace(",", "\N{THIN SPACE}")
