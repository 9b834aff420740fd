"""Names of receivers in columns beside their dots, with a line to each, so that none lies on another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from vocc_torch.show.canvas import INK, QUIET
from vocc_torch.studies.tradeoff.tradeoff_dots import Dot

GAP_PX = 34.0
"""From a group's outermost dot to its labels."""

LINE_PX = 18.5
"""From one label to the next."""

_DOT_PX = 8.0
FONT = 10.2

Measure = Callable[[str, bool], float]
"""Gives a text's width, px, from the text and whether it is bold."""


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
    blocks: list[list[float]] = []
    for place, value in enumerate(wanted):
        blocks.append([value - place * apart])
        while len(blocks) > 1 and _mean(blocks[-2]) > _mean(blocks[-1]):
            blocks[-2:] = [blocks[-2] + blocks[-1]]
    level = [_mean(block) for block in blocks for _ in block]
    last = max(low, high - (len(wanted) - 1) * apart)
    return [min(max(value, low), last) + place * apart for place, value in enumerate(level)]


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def columns(
    dots: Sequence[Dot],
    measure: Measure,
    most: int,
    place_px: Callable[[Sequence[Column]], Callable[[float], float]],
) -> list[Column]:
    """Group dots by their locator and give each group its labels, groups that leave no room together.

    Args:
        dots: all of them.
        measure: measures labels.
        most: how many labels have room above each other.
        place_px: gives the time axis that suits some columns: px from ms.
    """
    by_locator: dict[str, list[Dot]] = {}
    for dot in dots:
        by_locator.setdefault(dot.setting.locator, []).append(dot)
    groups = sorted(by_locator.values(), key=lambda group: min(one.offer.median_ms for one in group))
    while True:
        laid = [
            _column(group, "left" if place < len(groups) - 1 else "right", measure, most)
            for place, group in enumerate(groups)
        ]
        px = place_px(laid)
        crowded = (
            place
            for place, (first, second) in enumerate(pairwise(laid))
            if px(_first(second)) - px(_last(first))
            < GAP_PX + (second.width_px + GAP_PX if second.side == "left" else 0)
        )
        meet = next(crowded, None)
        if meet is None:
            return laid
        groups[meet : meet + 2] = [groups[meet] + groups[meet + 1]]


def _first(column: Column) -> float:
    return min(dot.offer.median_ms for dot in column.dots)


def _last(column: Column) -> float:
    return max(dot.offer.median_ms for dot in column.dots)


def _column(group: Sequence[Dot], side: Literal["left", "right"], measure: Measure, most: int) -> Column:
    """Choose which of a group have a label: usual ones and those told of, or the frontier's without room."""
    mixed = len({dot.setting.locator for dot in group}) > 1
    usual = [dot for dot in group if not dot.varied or dot.rank == "frontier" or dot.told]
    named = usual
    if len(named) > most:
        named = [dot for dot in usual if dot.rank != "beaten" or dot.told]
    if len(named) > most:
        named = [dot for dot in usual if dot.rank == "frontier" or dot.told]
    if len(named) > most:
        named = [dot for dot in usual if dot.rank == "frontier"][:most]
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
    at = {dot: forth.transform((dot.offer.median_ms, height(dot))) for dot in column.dots}
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
