"""``tradeoff.png``: every receiver a dot, time a frame against bit error rate, and the frontier."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import blended_transform_factory

from vocc_torch.measure.intervals import Interval
from vocc_torch.show.canvas import INK, QUIET, new_figure, write_title
from vocc_torch.show.text_table import interval_text, rate_text
from vocc_torch.studies.tradeoff.price_list import PriceList
from vocc_torch.studies.tradeoff.tradeoff_axes import (
    Heights,
    budgets,
    heights,
    set_up,
    span,
    stacked,
    times_of,
)
from vocc_torch.studies.tradeoff.tradeoff_dots import STRENGTH, Dot, dots_of
from vocc_torch.studies.tradeoff.tradeoff_labels import FONT, GAP_PX, LINE_PX, Column, columns, draw_labels
from vocc_torch.studies.tradeoff.tradeoff_legend import draw_legend, text_renderer
from vocc_torch.studies.tradeoff.tradeoff_words import (
    GREYSCALE_RECEIVERS,
    frames_text,
    preamble_text,
    scenes_text,
    timed_text,
)

_MARK_COLOUR = "#8C5A00"
_BESIDE_PX = 44.0
_FOOTNOTE_CHARS = 172

Height = Callable[[Dot], float]


def tradeoff_figure(prices: PriceList, scenes: str, device: str, frames: str) -> Figure:
    """Draw the price list of one kind of scenes on one device and kind of frames.

    Args:
        prices: what was measured.
        scenes: the kind of scenes.
        device: the device.
        frames: ``whole`` or ``crops``.
    """
    dots = dots_of(prices, scenes, device, frames)
    figure = new_figure(12.4, 8.4)
    # Labels are measured as they will be drawn.
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.062, 0.203, 0.925, 0.682))
    laid, times = _columns(figure, axes, dots)
    rates, height = _heights(axes, dots, times, prices.mark(scenes))
    set_up(axes, times, rates)
    budgets(axes)
    _mark(axes, prices, scenes, rates)
    kept = sorted((dot for dot in dots if dot.rank == "frontier"), key=lambda dot: dot.offer.median_ms)
    _frontier_line(axes, kept, height)
    for dot in sorted(dots, key=lambda one: STRENGTH[one.rank]):
        _draw(axes, dot, height(dot), rates.least)
    for column in laid:
        draw_labels(axes, column, height)
    draw_legend(
        figure,
        {dot.setting.locator: dot.face for dot in dots},
        bottom=0.113,
        varied=any(dot.varied for dot in dots),
        doubtful=any(dot.rank == "perhaps" for dot in dots),
        beaten=any(dot.rank == "beaten" for dot in dots),
    )
    _write(figure, prices, scenes, device, frames)
    return figure


def _columns(figure: Figure, axes: Axes, dots: Sequence[Dot]) -> tuple[list[Column], tuple[float, float]]:
    """Lay labels out, and the time axis that leaves them room."""
    renderer = text_renderer(figure)
    box = axes.get_window_extent(renderer)

    def measure(text: str, bold: bool) -> float:
        written = figure.text(0, 0, text, fontsize=FONT, fontweight="bold" if bold else "normal")
        width = float(written.get_window_extent(renderer).width)
        written.remove()
        return width

    def limits(laid: Sequence[Column]) -> tuple[float, float]:
        room = {"left": _BESIDE_PX, "right": _BESIDE_PX}
        for column in (laid[0], laid[-1]):
            room[column.side] = column.width_px + GAP_PX + 14
        return span(times_of(dots), box.width, room["left"], room["right"])

    def place_px(laid: Sequence[Column]) -> Callable[[float], float]:
        low, high = np.log10(limits(laid))
        return lambda ms: float((np.log10(ms) - low) / (high - low) * box.width)

    laid = columns(dots, measure, int((box.height - 22) / LINE_PX), place_px)
    return laid, limits(laid)


def _heights(
    axes: Axes, dots: Sequence[Dot], times: tuple[float, float], mark: tuple[float, Interval] | None
) -> tuple[Heights, Height]:
    """Lay the rates' axis out, and give each dot its height: by its rate, or in a row without errors."""
    box = axes.get_window_extent()
    low, high = np.log10(times)
    free = sorted(
        (dot for dot in dots if dot.offer.error_free),
        key=lambda dot: (-STRENGTH[dot.rank], bool(dot.varied), dot.offer.median_ms),
    )
    rows = stacked([(np.log10(dot.offer.median_ms) - low) / (high - low) * box.width for dot in free])
    row_of = dict(zip(free, rows, strict=True))
    shown = [dot.offer.ber_high if dot.offer.error_free else dot.offer.ber for dot in dots]
    count = max(rows, default=-1) + 1
    if mark is not None:
        shown += [mark[0]] if mark[0] > 0 else []
        count += mark[0] == 0
    rates = heights(shown, count, box.height)
    return rates, lambda dot: rates.rows[row_of[dot]] if dot in row_of else dot.offer.ber


def _mark(axes: Axes, prices: PriceList, scenes: str, rates: Heights) -> None:
    """Draw what is possible: the rate of a decoder that knows the scene."""
    mark = prices.mark(scenes)
    if mark is None:
        return
    rate, interval = mark
    frames = prices.marks[scenes].counts.frames
    across = blended_transform_factory(axes.transAxes, axes.transData)
    if rate > 0:
        said = (
            f"BER {rate_text(rate)} ({interval_text(rate, interval.low, interval.high)}) in {frames} frames"
        )
        axes.axhspan(interval.low, interval.high, color=_MARK_COLOUR, alpha=0.07, linewidth=0, zorder=0.7)
    else:
        said = f"no error in {frames} frames, too few to say more"
    y = rate if rate > 0 else rates.rows[-1]
    axes.axhline(y, color=_MARK_COLOUR, linewidth=1.4, linestyle=(0, (6, 3)), zorder=1.6)
    text = f"What is possible, by a decoder that knows the scene: {said}"
    axes.text(0.012, y, text, transform=across, va="bottom", fontsize=FONT, color=_MARK_COLOUR, zorder=6.5)


def _frontier_line(axes: Axes, kept: Sequence[Dot], height: Height) -> None:
    """Draw the steps of the frontier and shade what lies behind it."""
    low_x, high_x = axes.get_xlim()
    _, high_y = axes.get_ylim()
    x, y = np.array(times_of(kept)), np.array([height(dot) for dot in kept])
    behind_x, behind_y = np.r_[x, high_x], np.r_[y, y[-1]]
    axes.fill_between(
        behind_x, behind_y, high_y, step="post", color="#EEF3F8", alpha=0.7, zorder=0.5, linewidth=0
    )
    steps_x, steps_y = np.r_[x[0], x], np.r_[high_y, y]
    axes.plot(steps_x, steps_y, drawstyle="steps-post", color=INK, linewidth=1.5, zorder=2.2, alpha=0.85)
    axes.set_xlim(low_x, high_x)


def _draw(axes: Axes, dot: Dot, y: float, least: float) -> None:
    """Draw a dot with its quartiles and its interval, down to the rows without errors."""
    offer, style = dot.offer, dot.style
    alpha, order = STRENGTH[dot.rank], 4.0 + STRENGTH[dot.rank]
    x, colour = offer.median_ms, style.colour
    axes.plot([offer.low_ms, offer.high_ms], [y, y], color=colour, alpha=alpha, linewidth=1.0, zorder=order)
    # Without errors the interval begins at 0, which is down there.
    low = y if offer.error_free else max(offer.ber_low, least)
    axes.plot(
        [x, x], [low, offer.ber_high], color=colour, alpha=0.6 * alpha if offer.error_free else alpha,
        linewidth=0.8 if offer.error_free else 1.0, zorder=order - 1 if offer.error_free else order,
        marker="_", markevery=[1], markersize=7 if offer.error_free else 0,
    )  # fmt: skip
    # Under a faint or hollow marker a white one, so that bars do not shine through.
    for face, edge, fill, shown in (("white", "white", "full", 1.0), (colour, colour, dot.face, alpha)):
        axes.plot(
            [x],
            [y],
            marker=style.marker,
            markersize=6.0 if dot.varied else 9.5,
            fillstyle=fill,
            markerfacecolor=face,
            markerfacecoloralt="white",
            markeredgecolor=edge,
            markeredgewidth=1.5,
            alpha=shown,
            linestyle="none",
            zorder=order + 0.5,
        )


def _write(figure: Figure, prices: PriceList, scenes: str, device: str, frames: str) -> None:
    """Write title and footnote."""
    counts = next(iter(prices.counts(scenes).values()))
    rounds = [len(prices.spent[prices.settings[0], place].rounds_ms["read"]) for place in prices.places]
    span_text = f"{min(rounds)}" if min(rounds) == max(rounds) else f"{min(rounds)} to {max(rounds)}"
    waited, known = "", ""
    if prices.waited_share >= 0.05:
        share = f"{100 * prices.waited_share:.0f} %"
        waited = f"Take times with care: for {share} of it other work had the processor. "
    if any(setting.receiver in GREYSCALE_RECEIVERS for setting in prices.settings):
        known = f"Times of the greyscale receivers include {preamble_text(prices)}. "
    elsewhere = f"; {told}" if (told := timed_text(prices, scenes)) else ""
    said = (
        f"{waited}Frontier (bold): nothing is both quicker and better, by medians and rates as seen. Surely "
        "beaten: one no slower by the median has a lower rate, by paired intervals of all pairs that hold "
        f"together at 95 % (Bonferroni). Rates: {counts.frames} frames, the same for all; bars are 95 % "
        f"intervals. Times: medians and quartiles of {span_text} interleaved rounds, each call "
        f"right after an untimed one{elsewhere}. {known}"
        f"{prices.machines[device]}."
    )
    footnote = textwrap.fill(said, _FOOTNOTE_CHARS, break_on_hyphens=False)
    write_title(figure, "What accuracy costs in time", footnote)
    what = f"{frames_text(prices, scenes, frames)}; {scenes_text(prices, scenes)}"
    free = any(counts.bit_errors == 0 for counts in prices.counts(scenes).values())
    row = " In the row without errors height says nothing." if free else ""
    said = f"{what}. Farther left is quicker, farther down better.{row}"
    figure.text(0.018, 1 - 0.47 / figure.get_figheight(), said, fontsize=11.5, color=QUIET, va="top")
