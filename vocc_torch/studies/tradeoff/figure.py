"""``tradeoff.png``: every receiver a dot, time a frame against bit error rate; and the paper's Fig. 25."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from scipy.optimize import isotonic_regression

from vocc_torch.receiver.bank import needs_preambles
from vocc_torch.show import canvas, timing_figure
from vocc_torch.show.canvas import INK, QUIET
from vocc_torch.show.styles import Style, ends_text, rate_text, receiver_styles
from vocc_torch.studies.tradeoff import words
from vocc_torch.studies.tradeoff.plan import Setting
from vocc_torch.studies.tradeoff.price_list import Place, PriceList
from vocc_torch.studies.tradeoff.prices import OperatingPoint, pareto_frontier

FillStyle = Literal["full", "none", "left", "bottom"]
Rank = Literal["frontier", "perhaps", "beaten"]

FACES: tuple[FillStyle, ...] = ("full", "none", "left", "bottom")
"""How the markers of the locators are filled, in their order."""

STRENGTH: dict[Rank, float] = {"frontier": 1.0, "perhaps": 0.75, "beaten": 0.4}
"""Opacity by rank."""

ROWS = 4
"""Most rows of dots without errors: neighbours in time are never in the same one."""

_LINE_PX, _ROW_PX = 18.5, 19.0
_FONT = 10.2
_REFERENCE_COLOUR = "#8C5A00"
_FIG25_FRAMES = {"whole": "whole_frames", "crops": "crops"}


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

    def mark(self, axes: Axes, x: float, y: float, **look: Any) -> None:
        """Draw its marker; under a faint or hollow one a white one, so that bars do not shine through."""
        colour = self.style.colour
        shown = STRENGTH[self.rank]
        for face, edge, fill, alpha in (("white", "white", "full", 1.0), (colour, colour, self.face, shown)):
            axes.plot(
                [x], [y], marker=self.style.marker, markersize=6.0 if self.varied else 9.5, fillstyle=fill,
                markerfacecolor=face, markerfacecoloralt="white", markeredgecolor=edge, markeredgewidth=1.5,
                alpha=alpha, linestyle="none", zorder=4.5 + shown, **look,
            )  # fmt: skip


def dots_of(prices: PriceList, scenes: str, device: str, frames: str) -> list[Dot]:
    """Say how each receiver is drawn, each with its best batch size, in the order of the settings."""
    points = prices.points(scenes, device, frames)
    kept = {one.name for one in pareto_frontier(points)}
    beaten = prices.beaten_by(scenes, points)
    told = words.recommend(prices, scenes, device, frames).named
    styles = receiver_styles(setting.receiver for setting in prices.settings)
    locators = list(dict.fromkeys(setting.locator for setting in prices.settings))
    return [
        Dot(
            point,
            setting,
            styles[setting.receiver],
            FACES[locators.index(setting.locator) % len(FACES)],
            "frontier" if point.name in kept else "beaten" if surely else "perhaps",
            tuple(words.varied_text(setting, prices.settings[0])),
            setting.name in told,
        )
        for setting, point, (_, surely) in zip(prices.settings, points, beaten, strict=True)
    ]


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
    band_px = _ROW_PX * rows + 8 if rows else 0
    decade_px = (height_px - band_px) / math.log10(top / least)
    below = [10 ** (-(8 + _ROW_PX * (row + 0.3)) / decade_px) * least for row in range(rows)]
    return Heights(10 ** (-band_px / decade_px) * least, least, top, tuple(below))


def spread(wanted: Sequence[float], apart: float, low: float, high: float) -> list[float]:
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
    level = isotonic_regression([value - place * apart for place, value in enumerate(wanted)]).x.tolist()
    last = max(low, high - (len(wanted) - 1) * apart)
    return [min(max(value, low), last) + place * apart for place, value in enumerate(level)]


def tradeoff_figure(prices: PriceList, scenes: str, device: str, frames: str) -> Figure:
    """Draw the price list of one kind of scenes on one device and kind of frames.

    Args:
        prices: what was measured.
        scenes: the kind of scenes.
        device: the device.
        frames: ``whole`` or ``crops``.
    """
    dots = dots_of(prices, scenes, device, frames)
    figure = canvas.new_figure(12.4, 8.4)
    axes = figure.add_axes((0.062, 0.203, 0.6, 0.682))
    free = sorted((dot for dot in dots if dot.point.error_free), key=lambda dot: dot.ms)
    shown = [dot.point.ber.high if dot.point.error_free else dot.point.ber.value for dot in dots]
    rows, reference = min(len(free), ROWS), prices.reference(scenes)
    if reference is not None:
        shown += [reference.value] if reference.value else []
        rows += not reference.value
    rates = heights(shown, rows, axes.bbox.height)
    y = {dot: dot.point.ber.value for dot in dots}
    y |= {dot: rates.rows[place % ROWS] for place, dot in enumerate(free)}
    _axes(axes, [dot.ms for dot in dots], rates)
    _labels(figure, axes, dots, y)
    _reference(axes, prices, scenes, rates)
    kept = sorted((dot for dot in dots if dot.rank == "frontier"), key=lambda dot: dot.ms)
    steps = np.array([[dot.ms, y[dot]] for dot in kept])
    x, falls = np.r_[steps[0, 0], steps[:, 0]], np.r_[rates.top, steps[:, 1]]
    axes.plot(x, falls, drawstyle="steps-post", color=INK, linewidth=1.5, zorder=2.2, alpha=0.85)
    behind, floor = np.r_[x, axes.get_xlim()[1]], np.r_[falls, falls[-1]]
    axes.fill_between(
        behind, floor, rates.top, step="post", color="#EEF3F8", alpha=0.7, zorder=0.5, linewidth=0
    )
    for dot in dots:
        _dot(axes, dot, y[dot], rates.least)
    _legend(figure, dots)
    _write(figure, prices, scenes, device, frames)
    return figure


def _axes(axes: Axes, times_ms: Sequence[float], rates: Heights) -> None:
    """Draw both axes, the rows without errors and the time a frame that cameras leave."""
    canvas.quiet_axes(axes)
    limits_ms = [1e3 / speed for speed in words.FRAMES_PER_S]
    every = [*times_ms, *limits_ms]
    axes.set(
        xscale="log", yscale="log", xlim=(min(every) / 1.3, max(every) * 1.3), ylim=(rates.bottom, rates.top),
        xlabel="Time a frame (ms), each receiver at its best batch size", ylabel="Bit error rate",
    )  # fmt: skip
    axes.tick_params(axis="x", which="both", length=4, pad=4)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_locator(ticker.LogLocator(subs=(2, 5)))
    axes.xaxis.set_minor_formatter("{x:g}")
    # No tick pretends to a rate in the rows.
    powers = [10.0**power for power in range(-12, 1) if 10.0**power >= rates.least / 10]
    axes.yaxis.set_major_locator(ticker.FixedLocator([one for one in powers if one >= rates.least]))
    minor = [digit * one for one in powers for digit in range(2, 10) if digit * one >= rates.least]
    axes.yaxis.set_minor_locator(ticker.FixedLocator(minor))
    axes.yaxis.set_minor_formatter(ticker.NullFormatter())
    axes.grid(which="major", axis="y", color=canvas.GRID, linewidth=0.9)
    if rates.rows:
        axes.axhspan(rates.bottom, rates.least, color="#E4EFE8", linewidth=0, zorder=0.6)
        axes.text(
            -0.008, math.sqrt(rates.bottom * rates.least), "no\nerror", ha="right", va="center",
            transform=axes.get_yaxis_transform(), fontsize=10.5, linespacing=1.1,
        )  # fmt: skip
    for place, (speed, limit) in enumerate(zip(words.FRAMES_PER_S, limits_ms, strict=True)):
        axes.axvline(limit, color=QUIET, linewidth=0.9, linestyle=(0, (5, 4)), zorder=1.5, alpha=0.4)
        axes.text(
            limit, 1.012, f"{speed}" if place else f"{speed} frames/s", ha="center", va="bottom",
            transform=axes.get_xaxis_transform(), fontsize=10.5, color=QUIET,
        )  # fmt: skip


def _labels(figure: Figure, axes: Axes, dots: Sequence[Dot], y: Mapping[Dot, float]) -> None:
    """Name dots in a column beside the axes, at their heights as far as there is room."""
    wanted = [dot for dot in dots if not dot.varied or dot.told or dot.rank == "frontier"]
    wanted.sort(key=lambda dot: (dot.rank != "frontier", not dot.told, dot.rank == "beaten"))
    least, most = np.log10(axes.get_ylim())
    height = {
        dot: float((np.log10(y[dot]) - least) / (most - least)) * axes.bbox.height
        for dot in wanted[: int(axes.bbox.height / _LINE_PX)]
    }
    named = sorted(height, key=lambda dot: (height[dot], -dot.ms))
    places = spread([height[dot] for dot in named], _LINE_PX, 0, axes.bbox.height)
    widths = []
    for dot, place_px in zip(named, places, strict=True):
        first, place = dot.rank == "frontier", place_px / axes.bbox.height
        located = words.LOCATED_BY[dot.setting.locator].removesuffix(" locator")
        label = axes.annotate(
            f"{', '.join([dot.style.label, *dot.varied, located])}   {words.ms_text(dot.ms)} ms",
            (dot.ms, y[dot]), (1.05, place), textcoords="axes fraction", va="center_baseline", fontsize=_FONT,
            color=QUIET if dot.rank == "beaten" else INK, fontweight="bold" if first else "normal",
        )  # fmt: skip
        widths.append(Text.get_window_extent(label, canvas.text_renderer(figure)).width)
        axes.annotate(
            "", (dot.ms, y[dot]), (1.022, place), textcoords="axes fraction", zorder=2.1,
            arrowprops={"arrowstyle": "-", "color": QUIET, "linewidth": 0.7, "alpha": 0.8 if first else 0.35,
                        "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
        dot.mark(axes, 1.033, place, transform=axes.transAxes, clip_on=False)
    left, bottom, _, up = axes.get_position().bounds
    room = 1 - left - (max(widths) + 8) / figure.bbox.width
    axes.set_position((left, bottom, room / 1.05, up))


def _reference(axes: Axes, prices: PriceList, scenes: str, rates: Heights) -> None:
    """Draw what is possible: the rate of a decoder that knows the scene."""
    rate = prices.reference(scenes)
    if rate is None:
        return
    frames, colour = prices.references[scenes].counts.frames, _REFERENCE_COLOUR
    if rate.value > 0:
        said = f"BER {rate_text(rate.value)} ({ends_text(rate.low, rate.high)}) in {frames} frames"
        axes.axhspan(rate.low, rate.high, color=colour, alpha=0.07, linewidth=0, zorder=0.7)
    else:
        said = f"no error in {frames} frames, too few to say more"
    y = rate.value if rate.value > 0 else rates.rows[-1]
    axes.axhline(y, color=colour, linewidth=1.4, linestyle=(0, (6, 3)), zorder=1.6)
    axes.text(
        0.012, y, f"What is possible, by a decoder that knows the scene: {said}", va="bottom", color=colour,
        transform=axes.get_yaxis_transform(), fontsize=_FONT, zorder=6.5,
    )  # fmt: skip


def _dot(axes: Axes, dot: Dot, y: float, least: float) -> None:
    """Draw a dot with its quartiles and its interval, down to the rows without errors."""
    time, rate, free = dot.point.time_ms, dot.point.ber, dot.point.error_free
    alpha, order, colour = STRENGTH[dot.rank], 4.0 + STRENGTH[dot.rank], dot.style.colour
    axes.plot([time.low, time.high], [y, y], color=colour, alpha=alpha, linewidth=1.0, zorder=order)
    # Without errors the interval begins at 0, which is down there.
    axes.plot(
        [dot.ms, dot.ms], [y if free else max(rate.low, least), rate.high], color=colour,
        alpha=0.6 * alpha if free else alpha, linewidth=0.8 if free else 1.0,
        zorder=order - 1 if free else order, marker="_", markevery=[1], markersize=7 if free else 0,
    )  # fmt: skip
    dot.mark(axes, dot.ms, y)


def _legend(figure: Figure, dots: Sequence[Dot]) -> None:
    """Say in a row what fillings, sizes and strengths mean."""

    def sign(label: str, *, markersize: float = 9.0, fill: FillStyle = "full", alpha: float = 1.0) -> Line2D:
        face = "white" if fill == "none" else QUIET
        return Line2D(
            [], [], color=QUIET, alpha=alpha, marker="o", markersize=markersize, markerfacecolor=face,
            markeredgewidth=1.5 if fill != "full" else None, fillstyle=fill, markerfacecoloralt="white",
            linestyle="none", label=label,
        )  # fmt: skip

    faces, ranks = {dot.setting.locator: dot.face for dot in dots}, {dot.rank for dot in dots}
    handles = [sign(words.LOCATED_BY[name], fill=face) for name, face in faces.items()]
    if any(dot.varied for dot in dots):
        handles.append(sign("other K, gradient or precision", markersize=5.5))
    handles.append(Line2D([], [], color=INK, linewidth=1.5, label="frontier"))
    if "perhaps" in ranks:
        handles.append(sign("beaten, perhaps by chance", alpha=STRENGTH["perhaps"]))
    if "beaten" in ranks:
        handles.append(sign("surely beaten", alpha=STRENGTH["beaten"]))
    canvas.write_legend(
        figure, handles, (0.012, 0.113), len(handles), loc="lower left", handletextpad=0.35,
        handlelength=2.0, columnspacing=1.5, borderaxespad=0,
    )  # fmt: skip


def _write(figure: Figure, prices: PriceList, scenes: str, device: str, frames: str) -> None:
    """Write title and footnote."""
    rounds = sorted({times.rounds for times in prices.times.by_place.values()})
    counted = " to ".join(str(one) for one in dict.fromkeys((rounds[0], rounds[-1])))
    waited = known = ""
    if prices.times.waited_share >= words.BUSY_SHARE:
        share = f"{100 * prices.times.waited_share:.0f} %"
        waited = f"Take times with care: for {share} of it other work had the processor. "
    if needs_preambles([setting.receiver for setting in prices.settings]):
        known = f"Times of the greyscale receivers include {words.preamble_text(prices)}. "
    said = (
        f"{waited}Frontier (bold): nothing is both quicker and better, by medians and measured rates. Surely "
        "beaten: one no slower by the median has a lower rate, by paired intervals of all pairs that hold "
        f"together at 95 % (Bonferroni). Rates: {prices.counted_frames} frames, the same for all; bars are "
        f"95 % intervals. Times: medians and quartiles of {counted} interleaved rounds, each call right "
        f"after an untimed one{words.timed_text(prices, scenes)}. {known}{prices.times.machines[device]}."
    )
    footnote = textwrap.fill(said, 172, break_on_hyphens=False)
    canvas.write_title(figure, "What accuracy costs in time", footnote)
    what = f"{words.frames_text(prices, scenes, frames)}; {words.scenes_text(prices, scenes)}"
    free = any(counts.bit_errors == 0 for counts in prices.counts(scenes).values())
    row = " In the rows without errors height says nothing." if free else ""
    said = f"{words.upper_first(what)}. Farther left is quicker, farther down better.{row}"
    figure.text(0.018, 1 - 0.47 / figure.get_figheight(), said, fontsize=11.5, color=QUIET, va="top")


def shares_figure(prices: PriceList) -> Figure | None:
    """Draw Fig. 25 on the first device; nothing where the paper's locator or receivers were not priced."""
    by_name = {one.receiver: one for one in reversed(prices.settings) if one.locator == "paper"}
    if not by_name.keys() >= timing_figure.PAPER_SHARES.keys() - {timing_figure.PANEL_DETECTION}:
        return None
    device = prices.places[0].device
    kinds = [frames for name, frames in prices.kinds if name == device]
    every = prices.batches(device, kinds[0])
    measured = timing_figure.DetectionTimes(
        by_place={
            (_FIG25_FRAMES[kind], batch): {
                name: prices.times.by_place[one, Place(device, kind, batch)] for name, one in by_name.items()
            }
            for kind in kinds
            for batch in dict.fromkeys((every[0], every[-1]))
        },
        sensor_px=prices.sensor_px,
        machine=prices.times.machines[device],
        threads=prices.times.threads,
        waited_share=prices.times.waited_share,
    )
    return measured.draw("Time of the paper's receivers (Fig. 25)")
