"""The layout of the price list's picture: receivers as dots, where their names stand, and its axes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter
from matplotlib.transforms import blended_transform_factory
from scipy.optimize import isotonic_regression

from vocc_torch.show.canvas import GRID, INK, QUIET, quiet_axes
from vocc_torch.show.styles import Style, receiver_styles
from vocc_torch.studies.tradeoff.plan import Setting
from vocc_torch.studies.tradeoff.price_list import PriceList
from vocc_torch.studies.tradeoff.prices import OperatingPoint, pareto_frontier
from vocc_torch.studies.tradeoff.words import FRAMES_PER_S, ms_text, recommend, varied_text

FillStyle = Literal["full", "none", "left", "bottom"]
Rank = Literal["frontier", "perhaps", "beaten"]

FACES: tuple[FillStyle, ...] = ("full", "none", "left", "bottom")
"""How the markers of the locators are filled, in their order."""

STRENGTH: dict[Rank, float] = {"frontier": 1.0, "perhaps": 0.75, "beaten": 0.4}
"""Opacity by rank."""

GAP_PX = 34.0
"""From a group's outermost dot to its labels."""

LINE_PX = 18.5
"""From one label to the next."""

FONT = 10.2
_DOT_PX = 8.0
_ROW_PX, _APART_PX, _EDGE_PX = 19.0, 14.0, 46.0
_LOCATORS = {"truth": "true corners", "paper": "paper's", "refined": "refined"}


@dataclass(frozen=True)
class Dot:
    """A receiver as it is drawn.

    Args:
        point: its time and its rate.
        setting: what it is.
        style: its colour, marker and title.
        face: how its marker is filled.
        rank: on the frontier; beaten, but in its rate perhaps by chance; or surely beaten.
        varied: what it has other than most receivers.
        told: whether the recommendation in words names it.
    """

    point: OperatingPoint
    setting: Setting
    style: Style
    face: FillStyle
    rank: Rank
    varied: tuple[str, ...]
    told: bool

    @property
    def ms(self) -> float:
        """Median time a frame, ms."""
        return self.point.time_ms.value

    def label(self, *, with_locator: bool) -> str:
        """Write its name, what it varies and its time."""
        located = (_LOCATORS[self.setting.locator],) if with_locator else ()
        return f"{', '.join([self.style.label, *self.varied, *located])}   {ms_text(self.ms)} ms"


def dots_of(prices: PriceList, scenes: str, device: str, frames: str) -> list[Dot]:
    """Say how each receiver is drawn, each with its best batch size, in the order of the settings."""
    points = prices.points(scenes, device, frames)
    kept = {one.name for one in pareto_frontier(points)}
    sure = [surely for _, surely in prices.beaten_by(scenes, points)]
    told = recommend(prices, scenes, device, frames).named
    styles = receiver_styles(setting.receiver for setting in prices.settings)
    locators = list(dict.fromkeys(setting.locator for setting in prices.settings))
    faces = {name: FACES[place % len(FACES)] for place, name in enumerate(locators)}
    return [
        Dot(
            point,
            setting,
            styles[setting.receiver],
            faces[setting.locator],
            "frontier" if point.name in kept else "beaten" if surely else "perhaps",
            tuple(varied_text(setting, prices.settings[0])),
            setting.name in told,
        )
        for setting, point, surely in zip(prices.settings, points, sure, strict=True)
    ]


@dataclass(frozen=True)
class Column:
    """Labels of a group of dots.

    Args:
        dots: the group.
        side: where the labels stand.
        named: those of the dots that have a label.
        with_locator: whether labels name the locator.
        width_px: of the widest label.
    """

    dots: tuple[Dot, ...]
    side: Literal["left", "right"]
    named: tuple[Dot, ...]
    with_locator: bool
    width_px: float


def spread(wanted: Sequence[float], apart: float, low: float, high: float) -> list[float]:
    """Move places on a line as little as need be, by least squares, to lie apart and between two ends.

    Args:
        wanted: in ascending order.
        apart: least distance of two.
        low: lower end.
        high: upper end; where there is no room for all, they go beyond it.

    Example:
        >>> spread([5.0, 5.0, 40.0], 10.0, 0.0, 100.0)
        [0.0, 10.0, 40.0]
        >>> spread([50.0, 50.0, 50.0], 10.0, 0.0, 100.0)
        [40.0, 50.0, 60.0]
    """
    if not wanted:
        return []
    # Less their steps, places that lie apart are ascending.
    level = isotonic_regression([value - place * apart for place, value in enumerate(wanted)]).x.tolist()
    last = max(low, high - (len(wanted) - 1) * apart)
    return [min(max(value, low), last) + place * apart for place, value in enumerate(level)]


def columns(
    dots: Sequence[Dot],
    measure: Callable[[str, bool], float],
    most: int,
    place_px: Callable[[Sequence[Column]], Callable[[float], float]],
) -> list[Column]:
    """Group dots by their locator and give each group its labels, groups that leave no room together.

    Args:
        dots: all of them.
        measure: gives a label's width, px, from its text and whether it is bold.
        most: how many labels have room above each other.
        place_px: gives the time axis that suits some columns: px from ms.
    """
    by_locator: dict[str, list[Dot]] = {}
    for dot in dots:
        by_locator.setdefault(dot.setting.locator, []).append(dot)
    groups = sorted(by_locator.values(), key=lambda group: min(dot.ms for dot in group))
    while True:
        laid = [
            _column(group, "left" if place < len(groups) - 1 else "right", measure, most)
            for place, group in enumerate(groups)
        ]
        px = place_px(laid)
        for place, (first, second) in enumerate(pairwise(laid)):
            room = px(min(dot.ms for dot in second.dots)) - px(max(dot.ms for dot in first.dots))
            if room < GAP_PX + (second.width_px + GAP_PX if second.side == "left" else 0):
                groups[place : place + 2] = [groups[place] + groups[place + 1]]
                break
        else:
            return laid


def _column(
    group: Sequence[Dot], side: Literal["left", "right"], measure: Callable[[str, bool], float], most: int
) -> Column:
    """Choose which of a group have a label: usual ones and those told of, or the frontier's without room."""
    mixed = len({dot.setting.locator for dot in group}) > 1
    frontier = [dot for dot in group if dot.rank == "frontier"]
    choices = (
        [dot for dot in group if not dot.varied or dot.rank == "frontier" or dot.told],
        [dot for dot in group if dot.told or (dot.rank != "beaten" and (not dot.varied or dot in frontier))],
        [dot for dot in group if dot.told or dot.rank == "frontier"],
    )
    named = next((chosen for chosen in choices if len(chosen) <= most), frontier[:most])
    widths = (measure(dot.label(with_locator=mixed), dot.rank == "frontier") for dot in named)
    return Column(tuple(group), side, tuple(named), mixed, max(widths, default=0.0))


def draw_labels(axes: Axes, column: Column, height: Callable[[Dot], float]) -> None:
    """Write a column's labels with their lines.

    Args:
        axes: with their final limits.
        column: the labels.
        height: a dot's height, as the axis has it.
    """
    forth, back = axes.transData, axes.transData.inverted()
    box = axes.get_window_extent()
    at = {dot: forth.transform((dot.ms, height(dot))) for dot in column.dots}
    named = sorted(column.named, key=lambda dot: (at[dot][1], -at[dot][0]))
    places = spread([float(at[dot][1]) for dot in named], LINE_PX, box.y0 + 11, box.y1 - 11)
    right = column.side == "right"
    xs = [float(x) for x, _ in at.values()]
    edge = max(xs) + GAP_PX if right else min(xs) - GAP_PX
    for dot, y in zip(named, places, strict=True):
        x0, y0 = (float(value) for value in at[dot])
        x, place = back.transform((edge, y))
        first = dot.rank == "frontier"
        axes.text(
            x, place, dot.label(with_locator=column.with_locator), ha="left" if right else "right",
            va="center_baseline", fontsize=FONT, color=QUIET if dot.rank == "beaten" else INK, zorder=7,
            fontweight="bold" if first else "normal",
            path_effects=[withStroke(linewidth=3, foreground="white")],
        )  # fmt: skip
        sign = 1 if right else -1
        ends = [(x0 + sign * _DOT_PX, y0), (edge - sign * 12, y), (edge - sign * 4, y)]
        line = back.transform(ends)
        axes.plot(line[:, 0], line[:, 1], color=QUIET, linewidth=0.7, alpha=0.9 if first else 0.5, zorder=2.1)


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
