"""``tradeoff.png``: every receiver a dot, time a frame against bit error rate; and the paper's Fig. 25."""

import itertools
import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import ticker
from matplotlib.text import Text
from scipy.optimize import isotonic_regression

from vocc_torch.measure import estimate, plan
from vocc_torch.report import canvas, timing_figure
from vocc_torch.report.canvas import INK, QUIET, Axes, Figure, Line2D
from vocc_torch.report.styles import Style, ends_text, rate_text, receiver_styles
from vocc_torch.studies.tradeoff import report
from vocc_torch.studies.tradeoff.plan import Setting
from vocc_torch.studies.tradeoff.prices import (
    FRAMES_PER_S,
    OperatingPoint,
    Place,
    PriceList,
    most_accurate,
)

FACES = ("full", "none", "left", "bottom")
"""How the markers of the locators are filled, in their order."""

STRENGTH = {"frontier": 1.0, "perhaps": 0.75, "beaten": 0.4}
"""Opacity by rank."""

ROWS = 4
"""Most rows of dots without errors: neighbours in time are never in the same one."""

_LINE_PX, _ROW_PX, _FONT = 18.5, 19.0, 10.2
_REFERENCE_COLOUR = "#8C5A00"


@dataclass(frozen=True)
class Dot:
    """A receiver as it is drawn.

    Args:
        point: its time and its rate.
        y: where it stands: its rate, or a row of those without errors.
        style: its colour, marker and title.
        face: how its marker is filled.
        varied: what it has other than most receivers.
        told: whether the recommendation in words names it.
    """

    point: OperatingPoint
    y: float
    style: Style
    face: str
    varied: Sequence[str]
    told: bool

    @property
    def place(self) -> tuple[float, float]:
        """Time, ms, and height."""
        return self.point.ms, self.y

    def mark(self, axes: Axes, x: float, y: float, **look: Any) -> None:
        """Draw its marker; under a faint or hollow one a white one, so that bars do not shine through."""
        shown, size = STRENGTH[self.point.rank], 6.0 if self.varied else 9.5
        for colour, fill, alpha in (
            ("white", "full", 1.0),
            (self.style.colour, self.face, shown),
        ):
            line = axes.add_line(
                _sign(self.style.marker, size, fill, colour, alpha, **look)
            )
            line.set(data=([x], [y]), zorder=4.5 + shown)

    def draw(self, axes: Axes, least: float) -> None:
        """Draw it with its quartiles and its interval, down to the rows without errors below ``least``."""
        time, rate, shown = (
            self.point.time_ms,
            self.point.ber,
            STRENGTH[self.point.rank],
        )
        look: dict[str, Any] = {
            "color": self.style.colour,
            "alpha": shown,
            "linewidth": 1.0,
        }
        axes.plot([time.low, time.high], [self.y, self.y], zorder=4 + shown, **look)
        order, low = 4 + shown, max(rate.low, least)
        if self.point.error_free:  # the interval begins at 0, which is down there
            order, low = 3 + shown, self.y
            look |= {
                "alpha": 0.6 * shown,
                "linewidth": 0.8,
                "marker": "_",
                "markevery": [1],
                "markersize": 7,
            }
        axes.plot([time.value, time.value], [low, rate.high], zorder=order, **look)
        self.mark(axes, *self.place)


def _sign(
    marker: str, size: float, fill: str, colour: str, alpha: float = 1.0, **look: Any
) -> Line2D:
    """Make a marker without a place."""
    face = {
        "markerfacecolor": colour,
        "markerfacecoloralt": "white",
        "markeredgecolor": colour,
    }
    look |= {
        "marker": marker,
        "markersize": size,
        "fillstyle": fill,
        "markeredgewidth": 1.5,
        **face,
    }
    return Line2D([], [], linestyle="none", alpha=alpha, **look)


def heights(
    rates: Sequence[float], rows: int, height_px: float
) -> tuple[list[float], list[float]]:
    """Lay out a logarithmic axis with all rates, and with rows for what has no errors at its foot.

    Args:
        rates: above 0: rates and the ends of their intervals that are to be seen.
        rows: how many rows, none included.
        height_px: of the axes.

    Returns:
        The axis's lower end, where the rows end above, and its upper end; then the height of each row, the
        uppermost first.

    Example:
        >>> (bottom, least, top), rows = heights([1e-4, 1e-2], 2, 500.0)
        >>> bottom < rows[1] < rows[0] < least < 1e-4
        True
    """
    top = min(1.0, 1.9 * max(rates))
    least = min(min(rates) / 1.7, top / 10)
    band_px = _ROW_PX * rows + 8 if rows else 0
    decade_px = (height_px - band_px) / math.log10(top / least)
    below = [
        10 ** (-(8 + _ROW_PX * (row + 0.3)) / decade_px) * least for row in range(rows)
    ]
    return [10 ** (-band_px / decade_px) * least, least, top], below


def spread(
    wanted: Sequence[float], apart: float, low: float, high: float
) -> list[float]:
    """Move places on a line as little as need be, by least squares, to lie apart and between two ends.

    Args:
        wanted: in ascending order, at least one.
        apart: least distance of two.
        low: lower end.
        high: upper end; where there is no room for all, they go beyond it.

    Example:
        >>> spread([5.0, 5.0, 40.0], 10.0, 0.0, 100.0)
        [0.0, 10.0, 40.0]
        >>> spread([50.0, 50.0, 50.0], 10.0, 0.0, 100.0)
        [40.0, 50.0, 60.0]
    """
    # Less their steps, places that lie apart are ascending.
    level = isotonic_regression(
        [value - place * apart for place, value in enumerate(wanted)]
    ).x.tolist()
    last = max(low, high - (len(wanted) - 1) * apart)
    return [
        min(max(value, low), last) + place * apart for place, value in enumerate(level)
    ]


def tradeoff_figure(prices: PriceList, scenes: str, device: str, frames: str) -> Figure:
    """Draw the price list of one kind of scenes on one device and kind of frames.

    Args:
        prices: what was measured.
        scenes: the kind of scenes.
        device: the device.
        frames: ``whole`` or ``crops``.
    """
    points, reference = prices.points(scenes, device, frames), prices.reference(scenes)
    figure = canvas.new_figure(12.4, 8.4)
    axes = figure.add_axes((0.062, 0.203, 0.6, 0.682))
    free = sorted(
        (point for point in points if point.error_free), key=lambda point: point.ms
    )
    shown = [
        point.ber.high if point.error_free else point.ber.value for point in points
    ]
    count = min(len(free), ROWS)
    if reference is not None:
        shown += [reference.value] if reference.value else []
        count += not reference.value
    ends, rows = heights(shown, count, axes.bbox.height)
    draw_axes(axes, [point.ms for point in points], ends)
    y = {point.setting: rows[place % ROWS] for place, point in enumerate(free)}
    styles = receiver_styles(setting.receiver for setting in prices.settings)
    locators = dict.fromkeys(setting.locator for setting in prices.settings)
    faces = dict(zip(locators, itertools.cycle(FACES), strict=False))
    told, dots = _told(prices, scenes, device, frames), []
    for point in points:
        setting = point.setting
        varied = report.varied_text(setting, prices.settings[0])
        look = styles[setting.receiver], faces[setting.locator], varied, setting in told
        dots.append(Dot(point, y.get(setting, point.ber.value), *look))
    draw_labels(figure, axes, dots)
    if reference is not None:
        draw_possible(axes, reference, prices.references[scenes].counts.frames, rows)
    kept = sorted(dot.place for dot in dots if dot.point.rank == "frontier")
    x = [kept[0][0], *(ms for ms, _ in kept), axes.get_xlim()[1]]
    falls = [ends[2], *(height for _, height in kept), kept[-1][1]]
    axes.plot(
        x[:-1],
        falls[:-1],
        drawstyle="steps-post",
        color=INK,
        linewidth=1.5,
        zorder=2.2,
        alpha=0.85,
    )
    axes.fill_between(
        x,
        falls,
        ends[2],
        step="post",
        color="#EEF3F8",
        alpha=0.7,
        zorder=0.5,
        linewidth=0,
    )
    for dot in dots:
        dot.draw(axes, ends[1])
    draw_legend(figure, dots, faces)
    rounds = sorted(times.rounds for times in prices.times.values())
    about = {
        "scenes": scenes,
        "device": device,
        "frames": frames,
        "error_free": bool(free),
    }
    said = report.written(
        "figure.txt.j2", prices, rounds=[rounds[0], rounds[-1]], **about
    ).splitlines()
    footnote = textwrap.fill(" ".join(said[1:]), 172, break_on_hyphens=False)
    canvas.write_title(figure, "What accuracy costs in time", footnote)
    figure.text(
        0.018,
        1 - 0.47 / figure.get_figheight(),
        said[0],
        fontsize=11.5,
        color=QUIET,
        va="top",
    )
    return figure


def draw_axes(axes: Axes, times_ms: Sequence[float], ends: Sequence[float]) -> None:
    """Draw both axes, the rows without errors and the time a frame that cameras leave."""
    canvas.quiet_axes(axes)
    bottom, least, top = ends
    every = [*times_ms, *(1e3 / speed for speed in FRAMES_PER_S)]
    axes.set(
        xscale="log",
        yscale="log",
        xlim=(min(every) / 1.3, max(every) * 1.3),
        ylim=(bottom, top),
    )
    axes.set_xlabel("Time a frame (ms), each receiver at its best batch size")
    axes.set_ylabel("Bit error rate")
    axes.tick_params(axis="x", which="both", length=4, pad=4)
    axes.xaxis.set_minor_locator(ticker.LogLocator(subs=(2, 5)))
    axes.xaxis.set(major_formatter="{x:g}", minor_formatter="{x:g}")
    # No tick pretends to a rate in the rows.
    tens = [10.0**power for power in range(-12, 1)]
    for digits, minor in (((1,), False), (range(2, 10), True)):
        ticks = [digit * ten for ten in tens for digit in digits]
        axes.set_yticks([tick for tick in ticks if least <= tick <= top], minor=minor)
    axes.yaxis.set_minor_formatter(ticker.NullFormatter())
    axes.grid(which="major", axis="y", color=canvas.GRID, linewidth=0.9)
    if bottom < least:
        look: dict[str, Any] = {
            "ha": "right",
            "va": "center",
            "fontsize": 10.5,
            "linespacing": 1.1,
        }
        axes.axhspan(bottom, least, color="#E4EFE8", linewidth=0, zorder=0.6)
        across = axes.get_yaxis_transform()
        axes.text(
            -0.008, math.sqrt(bottom * least), "no\nerror", transform=across, **look
        )
    for speed in FRAMES_PER_S:
        unit = " frames/s" if speed == FRAMES_PER_S[0] else ""
        axes.axvline(
            1e3 / speed,
            color=QUIET,
            linewidth=0.9,
            linestyle=(0, (5, 4)),
            zorder=1.5,
            alpha=0.4,
        )
        name = axes.text(
            1e3 / speed, 1.012, f"{speed}{unit}", transform=axes.get_xaxis_transform()
        )
        name.set(ha="center", va="bottom", fontsize=10.5, color=QUIET)


def _told(prices: PriceList, scenes: str, device: str, frames: str) -> set[Setting]:
    """Name the receivers that the words name."""
    batches = prices.batches(device, frames)
    sizes = [None, 1] if batches[0] == 1 and len(batches) > 1 else [None]
    told = [
        one for size in sizes for one in prices.answers(scenes, device, frames, size)
    ]
    named = [point for one in told for point in (one.taken, one.other)]
    if scenes in prices.references:
        named.append(most_accurate(prices.points(scenes, device, frames)))
    return {point.setting for point in named if point}


def draw_labels(figure: Figure, axes: Axes, dots: Sequence[Dot]) -> None:
    """Name dots in a column beside the axes, at their heights as far as there is room."""
    wanted = [
        dot
        for dot in dots
        if not dot.varied or dot.told or dot.point.rank == "frontier"
    ]
    wanted.sort(
        key=lambda dot: (
            dot.point.rank != "frontier",
            not dot.told,
            dot.point.rank == "beaten",
        )
    )
    chosen = sorted(
        wanted[: int(axes.bbox.height / _LINE_PX)],
        key=lambda dot: (dot.y, -dot.point.ms),
    )
    least, most = np.log10(axes.get_ylim())
    heights_px = (
        (np.log10([dot.y for dot in chosen]) - least)
        / (most - least)
        * axes.bbox.height
    )
    places = spread(heights_px.tolist(), _LINE_PX, 0, axes.bbox.height)
    widths = []
    for dot, place_px in zip(chosen, places, strict=True):
        first, place = dot.point.rank == "frontier", place_px / axes.bbox.height
        located = report.LOCATED_BY[dot.point.setting.locator].removesuffix(" locator")
        named = ", ".join([dot.style.label, *dot.varied, located])
        words = f"{named}   {timing_figure.number_text(dot.point.ms)} ms"
        line = {
            "arrowstyle": "-",
            "color": QUIET,
            "linewidth": 0.7,
            "alpha": 0.8 if first else 0.35,
        }
        # From the dot to its marker, which stands before the words.
        line |= {
            "shrinkA": 0.028 * 0.6 * axes.bbox.width,
            "shrinkB": 0,
            "relpos": (0, 0.62),
        }
        label = axes.annotate(
            words, dot.place, (1.05, place), textcoords="axes fraction", arrowprops=line
        )
        label.set(
            va="center_baseline",
            fontsize=_FONT,
            fontweight="bold" if first else "normal",
            zorder=2.1,
        )
        label.set_color(QUIET if dot.point.rank == "beaten" else INK)
        widths.append(Text.get_window_extent(label, canvas.text_renderer(figure)).width)
        dot.mark(axes, 1.033, place, transform=axes.transAxes, clip_on=False)
    left, bottom, _, up = axes.get_position().bounds
    room = 1 - left - (max(widths) + 8) / figure.bbox.width
    axes.set_position((left, bottom, room / 1.05, up))


def draw_possible(
    axes: Axes, rate: estimate.Estimate, frames: int, rows: Sequence[float]
) -> None:
    """Draw what is possible: the rate of a decoder that knows the scene."""
    y, said = (
        rate.value or rows[-1],
        f"no error in {frames} frames, too few to say more",
    )
    if rate.value > 0:
        said = f"BER {rate_text(rate.value)} ({ends_text(rate.low, rate.high)}) in {frames} frames"
        axes.axhspan(
            rate.low,
            rate.high,
            color=_REFERENCE_COLOUR,
            alpha=0.07,
            linewidth=0,
            zorder=0.7,
        )
    axes.axhline(
        y, color=_REFERENCE_COLOUR, linewidth=1.4, linestyle=(0, (6, 3)), zorder=1.6
    )
    words = f"What is possible, by a decoder that knows the scene: {said}"
    text = axes.text(
        0.012, y, words, transform=axes.get_yaxis_transform(), fontsize=_FONT
    )
    text.set(va="bottom", color=_REFERENCE_COLOUR, zorder=6.5)


def draw_legend(
    figure: Figure, dots: Sequence[Dot], faces: Mapping[plan.Locator, str]
) -> None:
    """Say in a row what fillings, sizes and strengths mean."""
    ranks = {dot.point.rank for dot in dots}
    handles = [
        _sign("o", 9.0, face, QUIET, label=report.LOCATED_BY[name])
        for name, face in faces.items()
    ]
    if any(dot.varied for dot in dots):
        handles.append(
            _sign("o", 5.5, "full", QUIET, label="other K, gradient or precision")
        )
    handles.append(Line2D([], [], color=INK, linewidth=1.5, label="frontier"))
    for rank, label in (
        ("perhaps", "beaten, perhaps by chance"),
        ("beaten", "surely beaten"),
    ):
        if rank in ranks:
            handles.append(_sign("o", 9.0, "full", QUIET, STRENGTH[rank], label=label))
    look: dict[str, Any] = {
        "loc": "lower left",
        "handletextpad": 0.35,
        "borderaxespad": 0,
    }
    at = (0.012, 0.113)
    canvas.write_legend(
        figure, handles, at, len(handles), handlelength=2.0, columnspacing=1.5, **look
    )


def shares_figure(prices: PriceList) -> Figure | None:
    """Draw Fig. 25 on the first device; nothing where the paper's locator or receivers were not priced."""
    by_name = {
        one.receiver: one for one in reversed(prices.settings) if one.locator == "paper"
    }
    if not by_name.keys() >= timing_figure.PAPER_SHARES.keys() - {
        timing_figure.PANEL_DETECTION
    }:
        return None
    device = prices.places[0].device
    by_place = {}
    for kind in [frames for name, frames in prices.kinds if name == device]:
        sizes = prices.batches(device, kind)
        for batch in dict.fromkeys((sizes[0], sizes[-1])):
            times = {
                name: prices.times[one, Place(device, kind, batch)]
                for name, one in by_name.items()
            }
            by_place[f"{kind}_frames" if kind == "whole" else kind, batch] = times
    sensor_px, machine = (
        prices.study.plan.world.camera.sensor_px,
        prices.machines[device],
    )
    about = sensor_px, machine, prices.threads, prices.waited_share
    return timing_figure.DetectionTimes(by_place, *about).draw(
        "Time of the paper's receivers (Fig. 25)"
    )
