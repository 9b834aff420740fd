"""Receivers as dots of the price list's picture: how each is drawn, and where its name stands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke
from scipy.optimize import isotonic_regression

from vocc_torch.measure.prices import OperatingPoint, pareto_frontier
from vocc_torch.show.canvas import INK, QUIET
from vocc_torch.show.styles import Style, receiver_styles
from vocc_torch.studies.tradeoff.plan import Setting
from vocc_torch.studies.tradeoff.price_list import PriceList
from vocc_torch.studies.tradeoff.words import ms_text, recommend, varied_text

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
