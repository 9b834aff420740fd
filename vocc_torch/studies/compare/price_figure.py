"""The figure of ``task=tradeoff``: time a frame against bit error rate."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from matplotlib import ticker

from vocc_torch.report import plots, styles
from vocc_torch.report.plots import LOOK, Axes, Curve, Figure, Line2D
from vocc_torch.report.styles import Style
from vocc_torch.studies.compare import price_report
from vocc_torch.studies.compare.prices import OperatingPoint, PriceList


@dataclass(frozen=True)
class PriceLook:
    """How operating points are drawn."""

    faces: tuple[str, ...] = ("full", "none", "left", "bottom")  # one a locator
    opacity: Mapping[str, float] = field(
        default_factory=lambda: {"frontier": 1.0, "perhaps": 0.75, "beaten": 0.35}
    )
    near: float = 0.06  # numbers this close in log10 of time and rate cover each other
    size_in: tuple[float, float] = (12.5, 6.4)
    line_in: float = 0.215  # height of a receiver's line in the legend


PRICE_LOOK = PriceLook()


def price_figure(prices: PriceList, scenes: str, device: str, frames: str) -> Figure:
    """Draw every setting's time a frame against its bit error rate, with the frontier.

    Args:
        prices: what was measured.
        scenes: kind of scenes.
        device: where was timed.
        frames: ``whole`` or ``crops``.
    """
    points = prices.points(scenes, device, frames)
    points.sort(key=lambda point: point.ms)
    title = f"Time and errors of {len(points)} receivers, {scenes.replace('_', ' ')}"
    note = price_report.written(
        "figure.txt.j2", prices, scenes=scenes, frames=frames, device=device
    )
    width, height = PRICE_LOOK.size_in
    size = width, max(height, 1.6 + PRICE_LOOK.line_in * len(points))
    figure, panels = plots.sheet([[0]], size, title, note.rstrip())
    axes = panels[0]
    signs = draw_points(axes, points, prices)
    frontier = [point for point in points if point.rank == "frontier"]
    axes.plot(
        [point.ms for point in frontier],
        [height_of(point) for point in frontier],
        color=LOOK.ink,
        drawstyle="steps-post",
        zorder=1,
    )
    rates = [point.ber for point in points]
    shown = Curve(Style("", "", "", "-"), [], rates)
    axes.set(xscale="log", yscale="log", ylim=plots.rate_limits([shown]))
    axes.set(xlabel="Time a frame (ms)", ylabel="Bit error rate")
    axes.xaxis.set_major_locator(ticker.LogLocator(10, subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(ticker.FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(ticker.NullFormatter())
    plots.quiet(axes, "both")
    legend = figure.legend(
        handles=signs, loc="outside right upper", frameon=False, fontsize=8.5
    )
    for text, point in zip(legend.get_texts(), points, strict=False):
        text.set_fontweight("bold" if point.rank == "frontier" else "normal")
    return figure


def height_of(point: OperatingPoint) -> float:
    """Give the rate at which a point is drawn: its limit where it has no errors."""
    return point.ber.value or point.ber.high


def draw_points(
    axes: Axes, points: Sequence[OperatingPoint], prices: PriceList
) -> list[Line2D]:
    """Draw numbered points with quartiles and intervals; give their signs for the legend.

    Args:
        axes: where to draw.
        points: in the order of their numbers.
        prices: whose points they are.
    """
    receivers = styles.receiver_styles(point.setting.receiver for point in points)
    locators = dict.fromkeys(setting.locator for setting in prices.settings)
    faces = dict(zip(locators, itertools.cycle(PRICE_LOOK.faces), strict=False))
    signs: list[Line2D] = []
    numbered: list[tuple[float, float]] = []
    for number, point in enumerate(points, 1):
        style, y = receivers[point.setting.receiver], height_of(point)
        time = point.time_ms
        look: dict[str, Any] = {
            "color": style.colour,
            "marker": style.marker,
            "alpha": PRICE_LOOK.opacity[point.rank],
            "fillstyle": faces[point.setting.locator],
            "markersize": 8,
        }
        axes.errorbar(
            [point.ms],
            [y],
            0.4 * y
            if point.error_free
            else [[y - point.ber.low], [point.ber.high - y]],
            [[point.ms - time.low], [time.high - point.ms]],
            uplims=point.error_free,
            elinewidth=1.0,
            **look,
        )
        at = math.log10(point.ms), math.log10(y)
        if all(math.dist(at, other) > PRICE_LOOK.near for other in numbered):
            place: dict[str, Any] = {"textcoords": "offset points", "fontsize": 8.5}
            axes.annotate(str(number), (point.ms, y), (6, 5), **place)
            numbered.append(at)
        located = price_report.LOCATED_BY[point.setting.locator]
        varied = price_report.varied_text(point.setting, prices.settings[0])
        words = ", ".join([style.label, *varied, located])
        label = f"{number}  {words}  {styles.number_text(point.ms)} ms"
        signs.append(Line2D([], [], **look, linestyle="none", label=label))
    return signs
