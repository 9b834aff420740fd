"""The best LED luminance against ambient light, on lines of constant contrast."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from vocc_torch.measure.dimming import Best, Grid, best_luminance
from vocc_torch.measure.optimum_ratio import OptimumRatio, on_off_ratio, optimum_ratio
from vocc_torch.show.canvas import GRID, INK, QUIET, new_figure, quiet_axes, write_title
from vocc_torch.show.octaves import cell_edges, frames_text, name_octaves, octave, reach
from vocc_torch.show.styles import Style, axis_label, receiver_styles

_WIDTH_IN, _ENTRY_IN = 11.2, 0.7
_CONTRAST = "#B8BDC4"
_BEYOND = 0.28
"""How far beyond the grid an open range is drawn, in heights of the last cell."""
_MOST_SPREAD = 0.11
"""Most octaves between neighbouring receivers under one ambient light."""


def best_luminance_figure(
    grid: Grid,
    title: str = "Best LED luminance for each ambient light",
    receivers: Sequence[str] | None = None,
    led_reflectance: float = 0.4,
) -> Figure:
    """Draw the best luminance of each receiver against the ambient light, on lines of constant contrast.

    Along a dashed line the On LEDs get the same multiple of the Off LEDs' exposure; a camera that sets its
    ISO speed by the background then takes the same picture. Receivers stand a little apart. Beside the axes
    stands the power of the ambient light that the best luminance follows.

    Args:
        grid: ambient light by LED luminance.
        title: what the figure shows.
        receivers: those to draw, in order; all of the grid's by default.
        led_reflectance: of the Off LEDs' surface, above 0, at most 1.

    Raises:
        VoccError: an unknown receiver, or a reflectance outside its range.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curves import Curves
        >>> counts = {("flda_3", 500): Counts(64, 4096, 4, 8, 2), ("flda_3", 2000): Counts(64, 4096)}
        >>> axis, stopped = "led_luminance_cd_m2", {500: "frames", 2000: "frames"}
        >>> curves = Curves("dimming", axis, "truth", ("flda_3",), (500, 2000), counts, {}, stopped)
        >>> grid = Grid("ambient_lx", (4000.0,), (curves,))
        >>> best_luminance_figure(grid).axes[0].get_ylabel()
        'LED luminance (cd/m²)'
    """
    names = tuple(receivers or grid.receivers)
    height = max(6.6, 2.2 + _ENTRY_IN * len(names))
    figure = new_figure(_WIDTH_IN, height)
    axes = figure.add_axes((0.085, 0.98 / height, 0.55, 1 - 1.68 / height))
    ambient, luminance = cell_edges(grid.rows), cell_edges(grid.columns)
    axes.set_xlim(ambient[0], ambient[-1])
    axes.set_ylim(luminance[0], luminance[-1])
    _contrast_lines(axes, led_reflectance)
    spread = min(_MOST_SPREAD, 0.8 * float(np.diff(ambient).min()) / len(names))
    beyond = _BEYOND * float(luminance[1] - luminance[0]), _BEYOND * float(luminance[-1] - luminance[-2])
    entries = []
    for number, (name, style) in enumerate(receiver_styles(names).items()):
        shift = spread * (number - (len(names) - 1) / 2)
        _draw(axes, best_luminance(grid, name), shift, beyond, style)
        entries.append((style, _followed(optimum_ratio(grid, name))))
    name_octaves(axes.xaxis, grid.rows)
    name_octaves(axes.yaxis, grid.columns)
    quiet_axes(axes)
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_xlabel(axis_label(grid.row_axis), labelpad=6)
    axes.set_ylabel(axis_label(grid.column_axis))
    _legend(figure, entries)
    write_title(figure, title, frames_text(grid))
    return figure


def _contrast_lines(axes: Axes, led_reflectance: float) -> None:
    """Draw lines of constant exposure ratio of On to Off LEDs: 2, 3, 5, 9, what is above 1 doubling."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    # Octaves of luminance over ambient light at which the ratio is 2.
    two = -math.log2(on_off_ratio(1.0, 1.0, led_reflectance) - 1)
    for power in range(math.ceil(bottom - right - two), math.floor(top - left - two) + 1):
        offset = two + power
        axes.axline((0, offset), slope=1, color=_CONTRAST, linewidth=1.0, linestyle=(0, (5, 4)), zorder=0.5)
        text = f"\N{MULTIPLICATION SIGN}{1 + 2.0**power:.3g}"
        if right + offset <= top:
            axes.text(right, right + offset, f" {text}", va="center", fontsize=9, color=QUIET)
        else:
            axes.text(top - offset, top, text, ha="center", va="bottom", fontsize=9, color=QUIET)


def _draw(axes: Axes, bests: Sequence[Best], shift: float, beyond: tuple[float, float], style: Style) -> None:
    """Draw one receiver: ranges, plateaus, and the best joined by a line."""
    x = [octave(best.ambient_lx) + shift for best in bests]
    for at, best in zip(x, bests, strict=True):
        low, high = reach(best)
        ends = low - best.reaches_lowest * beyond[0], high + best.reaches_highest * beyond[1]
        axes.plot([at, at], ends, color=style.colour, linewidth=1.5, alpha=0.75, zorder=2)
        for reached, end, marker in (
            (best.reaches_lowest, ends[0], "v"),
            (best.reaches_highest, ends[1], "^"),
        ):
            if reached:
                axes.plot([at], [end], marker, color=style.colour, markersize=5, zorder=2.4)
        plateau = [octave(best.least_cd_m2[0]), octave(best.least_cd_m2[-1])]
        if plateau[0] < plateau[1]:
            axes.plot([at, at], plateau, color=style.colour, linewidth=5.5, alpha=0.55, zorder=2.2)
    axes.add_line(_line(style, x, [octave(best.middle_cd_m2) for best in bests]))


def _line(style: Style, x: Sequence[float], y: Sequence[float]) -> Line2D:
    """Make a receiver's line; without data it is its sign in the legend."""
    return Line2D(
        x,
        y,
        label=style.label,
        color=style.colour,
        linestyle=style.line,
        linewidth=1.3,
        marker=style.marker,
        markersize=8,
        markeredgecolor="white",
        markeredgewidth=0.8,
        zorder=3,
    )


def _followed(found: OptimumRatio) -> str:
    """Say which power of the ambient light the best luminance follows."""
    if found.slope is None or found.ratio is None:
        return "too few ambient lights that have their\nbest luminance inside the grid for sure"
    slope, ratio = found.slope, found.ratio
    return (
        f"luminance \N{PROPORTIONAL TO} ambient$^{{\\,{slope.value:.2f}}}$ "
        f"({slope.low:.2f} to {slope.high:.2f})\n"
        f"luminance / ambient {ratio.value:.2f} ({ratio.low:.2f} to {ratio.high:.2f})"
    )


def _legend(figure: Figure, entries: Sequence[tuple[Style, str]]) -> None:
    """Name the receivers beside the axes, with what their best luminance follows; explain the signs below."""
    left, height = 0.708, figure.get_figheight()
    for number, (style, text) in enumerate(entries):
        y = 1 - (0.78 + _ENTRY_IN * number) / height
        sign = _line(style, [left, left + 0.03], [y, y])
        sign.set_transform(figure.transFigure)
        figure.add_artist(sign)
        figure.text(left + 0.042, y, style.label, fontsize=11, fontweight="bold", color=INK, va="center")
        below = y - 0.12 / height
        figure.text(left + 0.042, below, text, fontsize=9, color=QUIET, va="top", linespacing=1.3)
    notes = (
        "Thin bar: cannot be told from the best (95 %)\n"
        "Thick bar: equally few errors, mostly none\n"
        "Triangle: the best may lie beyond the grid\n"
        "Dashed: On LEDs' exposure over Off LEDs'"
    )
    figure.text(left, 0.2 / height, notes, fontsize=9, color=QUIET, va="bottom", linespacing=1.5)
