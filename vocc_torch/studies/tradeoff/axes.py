"""Axes of the price list's picture: logarithmic both, with rows at the foot for receivers without errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter
from matplotlib.transforms import blended_transform_factory

from vocc_torch.show.canvas import GRID, QUIET, quiet_axes
from vocc_torch.studies.tradeoff.words import FRAMES_PER_S

_ROW_PX, _APART_PX = 19.0, 14.0
_EDGE_PX = 46.0


@dataclass(frozen=True)
class Heights:
    """Where rates stand: above ``least`` on a logarithmic axis, and those without errors in rows below it.

    Args:
        bottom: lower end of the axis.
        least: upper end of the rows.
        top: upper end of the axis.
        rows: height of each row, the uppermost first.
    """

    bottom: float
    least: float
    top: float
    rows: tuple[float, ...]


def heights(rates: Sequence[float], rows: int, height_px: float) -> Heights:
    """Lay out an axis with all rates, and with rows at its foot.

    Args:
        rates: above 0: rates and the ends of their intervals that are to be seen.
        rows: how many rows, none included.
        height_px: of the axes.

    Example:
        >>> laid = heights([1e-4, 1e-2], 2, 500.0)
        >>> laid.bottom < laid.rows[1] < laid.rows[0] < laid.least < 1e-4
        True
    """
    top = min(1.0, 1.9 * max(rates))
    least = min(min(rates) / 1.7, top / 10)
    if not rows:
        return Heights(least, least, top, ())
    band_px = _ROW_PX * rows + 8
    decade_px = (height_px - band_px) / math.log10(top / least)
    below = [10 ** (-(8 + _ROW_PX * (row + 0.3)) / decade_px) * least for row in range(rows)]
    return Heights(10 ** (-band_px / decade_px) * least, least, top, tuple(below))


def span(dots: Sequence[float], width_px: float, left_px: float, right_px: float) -> tuple[float, float]:
    """Give a logarithmic time axis that leaves room at both ends, and shows all time limits.

    Args:
        dots: times, ms.
        width_px: of the axes.
        left_px: room left of the first time.
        right_px: room right of the last one.

    Example:
        >>> low, high = span([2.0, 10.0], 1000.0, 200.0, 300.0)
        >>> 0 < low < 1 and high > 33.3
        True
    """
    limits = [math.log10(1e3 / speed) for speed in FRAMES_PER_S]
    first, last = math.log10(min(dots)), math.log10(max(dots))
    low, high = min(first, *limits), max(last, *limits)
    # Room is asked for in pixels, whose size depends on the ends: a few rounds settle both.
    for _ in range(40):
        px = min(0.02, (high - low) / width_px)
        low = min(first - left_px * px, min(limits) - _EDGE_PX * px)
        high = max(last + right_px * px, max(limits) + _EDGE_PX * px)
    return 10**low, 10**high


def stacked(x_px: Sequence[float]) -> list[int]:
    """Give each of some points on a line a row, so that none lies on another, the first ones uppermost.

    Example:
        >>> stacked([10.0, 12.0, 100.0, 11.0])
        [0, 1, 0, 2]
    """
    rows: list[list[float]] = []
    given = []
    for x in x_px:
        free = (row for row, taken in enumerate(rows) if all(abs(x - other) >= _APART_PX for other in taken))
        row = next(free, len(rows))
        if row == len(rows):
            rows.append([])
        rows[row].append(x)
        given.append(row)
    return given


def set_up(axes: Axes, times: tuple[float, float], rates: Heights) -> None:
    """Draw the axes."""
    quiet_axes(axes)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(*times)
    axes.set_ylim(rates.bottom, rates.top)
    axes.tick_params(axis="x", which="both", length=4, pad=4)
    axes.set_xlabel("Time a frame (ms), each receiver at its best batch size")
    axes.set_ylabel("Bit error rate")
    plain = FuncFormatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_major_formatter(plain)
    axes.xaxis.set_minor_locator(LogLocator(subs=(2, 5)))
    axes.xaxis.set_minor_formatter(plain)
    powers = range(math.ceil(math.log10(rates.least)), math.floor(math.log10(rates.top)) + 1)
    axes.yaxis.set_major_locator(FixedLocator([10.0**power for power in powers]))
    minor = [digit * 10.0**power for power in (powers.start - 1, *powers) for digit in range(2, 10)]
    axes.yaxis.set_minor_locator(FixedLocator([one for one in minor if rates.least <= one <= rates.top]))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.grid(which="major", axis="y", color=GRID, linewidth=0.9)
    if rates.rows:
        _foot(axes, rates)


def _foot(axes: Axes, rates: Heights) -> None:
    """Set the rows of receivers without errors apart."""
    across = blended_transform_factory(axes.transAxes, axes.transData)
    axes.add_patch(
        Rectangle(
            (0, rates.bottom), 1, rates.least - rates.bottom,
            transform=across, facecolor="#E4EFE8", edgecolor="none", zorder=0.6,
        )
    )  # fmt: skip
    middle = math.sqrt(rates.bottom * rates.least)
    axes.text(
        -0.008, middle, "no\nerror", transform=across, ha="right", va="center", fontsize=10.5, linespacing=1.1
    )


def budgets(axes: Axes) -> None:
    """Draw the time a frame that cameras leave."""
    above = blended_transform_factory(axes.transData, axes.transAxes)
    for speed in FRAMES_PER_S:
        axes.axvline(1e3 / speed, color=QUIET, linewidth=0.9, linestyle=(0, (5, 4)), zorder=1.5, alpha=0.4)
        said = f"{speed} frames/s" if speed == max(FRAMES_PER_S) else f"{speed}"
        axes.text(
            1e3 / speed, 1.012, said, transform=above, ha="center", va="bottom", fontsize=10.5, color=QUIET
        )
