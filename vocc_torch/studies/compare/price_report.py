"""The price list as tables, words and a figure."""

import itertools
import math
import textwrap
from dataclasses import dataclass
from typing import Any

from matplotlib import ticker

from vocc_torch.measure import stage_times
from vocc_torch.report import plots, styles, terminal
from vocc_torch.report.plots import LOOK, Axes, Curve, Figure, Line2D
from vocc_torch.report.styles import Style
from vocc_torch.studies.compare.prices import (
    TIMING,
    OperatingPoint,
    PriceList,
    Setting,
    most_accurate,
)
from vocc_torch.studies.compare.run import Row, ends, rate_texts
from vocc_torch.types import resolve_device

LOCATED_BY = styles.Words(
    truth="true corners", paper="paper's locator", refined="refined locator"
)
OPACITY = {"frontier": 1.0, "perhaps": 0.75, "beaten": 0.35}
FACES = ("full", "none", "left", "bottom")
"""Fill of the markers, one a locator."""


@dataclass(frozen=True)
class Limits:
    """What is recommended for, and how words and points are laid out."""

    frames_per_s: tuple[int, ...] = (1000, 100, 60, 30)  # rates of cameras
    rates: tuple[float, ...] = (1e-2, 1e-3, 1e-4, 1e-5)  # bit error rates
    columns: int = 110  # of a line of words
    near: float = 0.06  # numbers this close in log10 of time and rate cover each other
    size_in: tuple[float, float] = (12.5, 6.4)
    line_in: float = 0.215  # height of a receiver's line in the legend


LIMITS = Limits()


def name_of(setting: Setting) -> str:
    """Name a receiver and what finds the panel for it."""
    label = styles.receiver_styles([setting.receiver])[setting.receiver].label
    return f"{label}, {LOCATED_BY[setting.locator]}"


def stated(point: OperatingPoint) -> str:
    """Write a point: receiver, rate and time."""
    rate, interval = rate_texts(point.ber)
    bounds = f" ({interval})" if interval else ""
    time = styles.number_text(point.ms)
    return f"{name_of(point.setting)}: BER {rate}{bounds}, {time} ms"


def conditions(prices: PriceList) -> str:
    """Say what the prices rest on."""
    study = prices.study
    handed = "whole frames" if study.config.frames == "whole" else "crops"
    text = (
        f"{prices.frames} frames of the scene {study.scene_name}, the same for all;"
        f" times on {handed} in each receiver's best batch; {prices.machine}."
    )
    if prices.waited_share >= TIMING.busy_share:
        share = 100 * prices.waited_share
        text += f" Other work had the processor for {share:.0f} % of the time."
    return text


def recommendation(prices: PriceList) -> str:
    """Say which receiver to take within a time, and below a bit error rate.

    A receiver keeps within a time where its upper quartile does, and below a rate where its whole interval
    does.
    """
    points = prices.points()
    quickest = min(points, key=lambda point: point.ms)
    lines = [conditions(prices)]
    for speed in LIMITS.frames_per_s:
        limit_ms = 1e3 / speed
        taken = most_accurate([p for p in points if p.time_ms.high <= limit_ms])
        if taken is None:
            answer = f"none; the quickest is {stated(quickest)}"
        else:
            answer = f"take {stated(taken)}"
        lines.append(f"Within {styles.number_text(limit_ms)} ms a frame: {answer}.")
    nearest = min(points, key=lambda point: (point.ber.high, point.ms))
    for rate in LIMITS.rates:
        below = [point for point in points if point.ber.high < rate]
        if below:
            quick = min(below, key=lambda point: (point.ms, point.ber.value))
            answer = f"take {stated(quick)}"
        else:
            answer = f"none is shown to be; the nearest is {stated(nearest)}"
        lines.append(f"For a BER below {styles.rate_text(rate)}: {answer}.")
        if not below:
            break
    for name, why in prices.study.left_out.items():
        lines.append(f"Left out: {name}, since {why}.")
    return "\n".join(textwrap.fill(line, LIMITS.columns) for line in lines) + "\n"


def price_rows(prices: PriceList) -> list[Row]:
    """Give the rows of ``tradeoff.csv``: a row for each receiver, locator and batch.

    ``ms`` is the median time a frame with its quartiles. ``rank`` compares receivers with the same batch.
    """
    study = prices.study
    rows: list[Row] = []
    for batch in prices.batches:
        for point in prices.points(batch):
            cells: Row = {
                "receiver": point.setting.receiver,
                "locator": point.setting.locator,
                "device": str(resolve_device(study.plan.world.device)),
                "frames": study.config.frames,
                "batch": batch,
                **ends("ms", point.time_ms),
                "scenes": study.scene_name,
                "test_frames": prices.frames,
                **ends("ber", point.ber),
                "rank": point.rank,
            }
            rows.append({name: five_digits(cell) for name, cell in cells.items()})
    return rows


def stage_rows(prices: PriceList) -> list[Row]:
    """Give the rows of ``stages.csv``: each stage's median time a frame, and what training took."""
    rows: list[Row] = []
    for (setting, batch), times in prices.times.items():
        cost = prices.costs[setting]
        cells: Row = {"receiver": setting.receiver, "locator": setting.locator}
        cells["batch"] = batch
        for stage in stage_times.STAGES:
            cells[f"{stage}_ms"] = times.stage(stage).value
        cells["training_s"], cells["training_frames"] = cost.training_s, cost.frames
        cells["parameters"], cells["size_bytes"] = cost.parameters, cost.size_bytes
        rows.append({name: five_digits(cell) for name, cell in cells.items()})
    return rows


def five_digits(value: str | int | float | None) -> str | int | float | None:
    """Round a float to five digits, more than any time or rate has."""
    return float(f"{value:.5g}") if isinstance(value, float) else value


def print_prices(prices: PriceList, words: str, console: terminal.Console) -> None:
    """Print the quickest receiver first, and what to take.

    Args:
        prices: what was measured.
        words: the recommendation.
        console: where to print.
    """
    mark = "*" if console.options.ascii_only else "\N{BLACK DIAMOND}"
    heads = ("", "receiver", "locator", "ms", "alone\nms", "BER", "95 %")
    table = terminal.plain_table(*heads)
    for column in table.columns[:3]:
        column.justify = "left"
    for point in sorted(prices.points(), key=lambda point: point.ms):
        alone = prices.times.get((point.setting, 1))
        cells = (
            mark if point.rank == "frontier" else "",
            point.setting.receiver,
            point.setting.locator,
            styles.number_text(point.ms),
            styles.number_text(alone.total.value) if alone else "",
            *rate_texts(point.ber),
        )
        look = "" if point.rank == "frontier" else "dim"
        table.add_row(*map(terminal.Text, cells), style=look)
    console.print(table)
    note = f"{mark} nothing is both quicker and better"
    console.print(terminal.Text(f"{note}\n\n{words}"), soft_wrap=True)


def price_figure(prices: PriceList) -> Figure:
    """Draw every receiver's time a frame against its bit error rate, with the frontier."""
    points = sorted(prices.points(), key=lambda point: point.ms)
    title = f"Time and errors of {len(points)} receivers, {prices.study.scene_name}"
    note = (
        f"{conditions(prices)} Line and bold: nothing is both quicker and better. Paler: beaten, perhaps by"
        " chance; palest: surely beaten (paired intervals of all pairs, 95 % together). Bars: 95 %"
        " intervals and quartiles; arrows: no error, the rate is below this."
    )
    width, height = LIMITS.size_in
    size = width, max(height, 1.6 + LIMITS.line_in * len(points))
    figure, panels = plots.sheet([[0]], size, title, note)
    axes = panels[0]
    signs = draw_points(axes, points)
    frontier = [point for point in points if point.rank == "frontier"]
    axes.plot(
        [point.ms for point in frontier],
        [point.ber.value or point.ber.high for point in frontier],
        color=LOOK.ink,
        drawstyle="steps-post",
        zorder=1,
    )
    shown = Curve(Style("", "", "", "-"), [], [point.ber for point in points])
    axes.set(xscale="log", yscale="log", ylim=plots.rate_limits([shown]))
    axes.set(xlabel="Time a frame (ms)", ylabel="Bit error rate")
    axes.xaxis.set_major_locator(ticker.LogLocator(10, subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(ticker.FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(ticker.NullFormatter())
    plots.quiet(axes, "both")
    place: dict[str, Any] = {"loc": "outside right upper", "frameon": False}
    legend = figure.legend(handles=signs, fontsize=8.5, **place)
    for text, point in zip(legend.get_texts(), points, strict=True):
        text.set_fontweight("bold" if point.rank == "frontier" else "normal")
    return figure


def draw_points(axes: Axes, points: list[OperatingPoint]) -> list[Line2D]:
    """Draw numbered points with quartiles and intervals; give their signs for the legend."""
    looks = styles.receiver_styles(point.setting.receiver for point in points)
    locators = dict.fromkeys(point.setting.locator for point in points)
    faces = dict(zip(locators, itertools.cycle(FACES), strict=False))
    signs: list[Line2D] = []
    numbered: list[tuple[float, float]] = []
    for number, point in enumerate(points, 1):
        style, free = looks[point.setting.receiver], point.ber.value == 0
        y = point.ber.high if free else point.ber.value
        look: dict[str, Any] = {"color": style.colour, "marker": style.marker}
        look |= {"fillstyle": faces[point.setting.locator], "markersize": 8}
        look["alpha"] = OPACITY[point.rank]
        time = point.time_ms
        reach = [[point.ms - time.low], [time.high - point.ms]]
        rates = 0.4 * y if free else [[y - point.ber.low], [point.ber.high - y]]
        axes.errorbar([point.ms], [y], rates, reach, uplims=free, elinewidth=1, **look)
        at = math.log10(point.ms), math.log10(y)
        if all(math.dist(at, other) > LIMITS.near for other in numbered):
            offset: dict[str, Any] = {"textcoords": "offset points", "fontsize": 8.5}
            axes.annotate(str(number), (point.ms, y), (6, 5), **offset)
            numbered.append(at)
        label = f"{number}  {name_of(point.setting)}  {styles.number_text(time.value)}"
        signs.append(Line2D([], [], **look, linestyle="none", label=f"{label} ms"))
    return signs
