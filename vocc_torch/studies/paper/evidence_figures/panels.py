"""What the drawings share: the colours of On and Off, panels in grey, histograms and clouds by status."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from vocc_torch.show.canvas import GRID, INK, quiet_axes
from vocc_torch.show.canvas import head as head

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Picture = tuple[Floats, tuple[float, float, float, float]]
"""Grey values (h,w), and their extent in LED cells from the panel's corner: left, right, bottom, top."""

OFF, ON = "#0072B2", "#D55E00"
MARK = "#009E73"
STATUS = ((False, "Off", OFF), (True, "On", ON))


def panel_axes(axes: Axes, picture: Picture, title: str = "", *, frame: bool = True) -> None:
    """Show a panel's pixels as the camera wrote them, black at 0 and white at 255.

    Args:
        axes: without ticks afterwards; its coordinates are LED columns and rows, from 0.
        picture: the pixels and where they lie.
        title: above the panel.
        frame: whether to outline the grid of LED cells.
    """
    grey, (left, right, bottom, top) = picture
    axes.imshow(
        grey,
        cmap="gray",
        vmin=0,
        vmax=255,
        extent=(left, right, bottom, top),
        interpolation="nearest",
        aspect="equal",
    )
    axes.set_anchor("NW")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(frame)
    axes.spines[:].set_color(GRID)
    if title:
        axes.set_title(title, fontsize=10.5, color=INK, loc="left", pad=5)


def outline_led(axes: Axes, row: int, column: int, colour: str = MARK) -> None:
    """Draw a frame around an LED's cell; row and column count from 0."""
    axes.add_patch(Rectangle((column, row), 1, 1, fill=False, edgecolor="white", linewidth=3.4, zorder=4))
    axes.add_patch(Rectangle((column, row), 1, 1, fill=False, edgecolor=colour, linewidth=2.0, zorder=5))


def status_histogram(axes: Axes, values: Floats, bits: Bools, label: str, *, log: bool = False) -> None:
    """Draw the histograms of On and of Off LEDs over the same bins, each as shares of its own LEDs.

    Args:
        axes: where to draw.
        values: any shape.
        bits: of the same shape.
        label: of the horizontal axis, with its unit.
        log: whether shares are on a logarithmic axis, so that few LEDs show too.
    """
    edges = np.histogram_bin_edges(values, bins=60)
    least = 1.0
    for status, name, colour in STATUS:
        chosen = values[bits == status]
        shares = np.histogram(chosen, edges)[0] / max(1, chosen.size)
        least = min(least, 0.5 / max(1, chosen.size))
        axes.stairs(shares, edges, fill=True, color=colour, alpha=0.25, baseline=least if log else 0)
        axes.stairs(shares, edges, color=colour, linewidth=1.6, label=name, baseline=least if log else 0)
    if log:
        axes.set_yscale("log")
        axes.set_ylim(least, 1.0)
    else:
        axes.set_ylim(bottom=0)
    axes.margins(x=0.02)
    quiet_axes(axes)
    axes.grid(axis="y", color=GRID, linewidth=0.8)
    axes.set_xlabel(label)
    axes.set_ylabel("Share of LEDs")


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
    order = np.random.default_rng(0).permutation(colours.size)
    axes.scatter(
        x.ravel()[order], y.ravel()[order], s=7, c=colours[order], alpha=0.35, linewidths=0, rasterized=True
    )
    axes.margins(0.03)
    quiet_axes(axes)
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])


def separation_text(auc: float, wrong: float) -> str:
    """Say how well a number tells On from Off.

    Example:
        >>> separation_text(0.80148, 0.27469)
        'AUC = 0.801 · best threshold wrong: 27.5 %'
        >>> separation_text(0.9999874, 0.0)
        'AUC = 0.99999 · best threshold wrong: 0 %'
    """
    return f"AUC {area_text(auc)} \N{MIDDLE DOT} best threshold wrong: {percent_text(wrong)}"


def area_text(auc: float) -> str:
    """Write an area in three digits, near 1 in up to five; 1 only where it is.

    Example:
        >>> area_text(0.53577), area_text(0.99956), area_text(0.9999999), area_text(1.0)
        ('= 0.536', '= 0.9996', '> 0.99999', '= 1')
    """
    if auc == 1:
        return "= 1"
    for digits in (3, 4, 5):
        if float(text := f"{auc:.{digits}f}") <= 1 - 3 * 10**-digits:
            return f"= {text}"
    return f"= {text}" if float(text) < 1 else "> 0.99999"


def percent_text(share: float) -> str:
    """Write a share in percent with three digits.

    Example:
        >>> percent_text(0.27469), percent_text(0.00015625)
        ('27.5 %', '0.0156 %')
    """
    return f"{100 * share:.3g} %"


def status_legend(figure: Figure) -> None:
    """Name the statuses at the figure's top right."""
    handles = [
        Line2D([], [], linestyle="none", marker="o", color=colour, markersize=7, label=f"{name} LEDs")
        for _, name, colour in STATUS
    ]
    figure.legend(
        handles=handles,
        loc="upper right",
        bbox_to_anchor=(0.99, 1 - 0.06 / figure.get_figheight()),
        ncols=2,
        frameon=False,
        fontsize=10.5,
        handletextpad=0.1,
        columnspacing=1.4,
    )


def condition_text(condition: Floats) -> str:
    """Write ambient light, LED luminance and distance.

    Example:
        >>> condition_text(np.array([31240.0, 2013.0, 68.2, 86.0]))
        '31\N{THIN SPACE}240 lx · 2\N{THIN SPACE}013 cd/m² · 68 m'
    """
    ambient, luminance = (f"{value:,.0f}".replace(",", "\N{THIN SPACE}") for value in condition[:2])
    return f"{ambient} lx \N{MIDDLE DOT} {luminance} cd/m² \N{MIDDLE DOT} {condition[2]:.0f} m"
