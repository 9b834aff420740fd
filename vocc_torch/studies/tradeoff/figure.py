"""``tradeoff.png``: every receiver a dot, time a frame against bit error rate; and the paper's Fig. 25."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.transforms import blended_transform_factory

from vocc_torch.measure.estimate import Estimate
from vocc_torch.receiver.bank import needs_preambles
from vocc_torch.show.canvas import INK, QUIET, new_figure, text_renderer, write_title
from vocc_torch.show.text_table import ends_text, rate_text
from vocc_torch.show.timing_figure import PANEL_DETECTION, PAPER_SHARES, DetectionTimes
from vocc_torch.studies.tradeoff.layout import (
    FONT,
    GAP_PX,
    LINE_PX,
    STRENGTH,
    Column,
    Dot,
    FillStyle,
    Heights,
    budgets,
    columns,
    dots_of,
    draw_labels,
    heights,
    set_up,
    span,
    stacked,
)
from vocc_torch.studies.tradeoff.price_list import Place, PriceList
from vocc_torch.studies.tradeoff.words import (
    BUSY_SHARE,
    LOCATED_BY,
    frames_text,
    preamble_text,
    scenes_text,
    timed_text,
    upper_first,
)

_REFERENCE_COLOUR = "#8C5A00"
_BESIDE_PX = 44.0
_FOOTNOTE_CHARS = 172
_FIG25_FRAMES = {"whole": "whole_frames", "crops": "crops"}


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
    axes = figure.add_axes((0.062, 0.203, 0.925, 0.682))
    laid, times = _columns(figure, axes, dots)
    rates, height = _heights(axes, dots, times, prices.reference(scenes))
    set_up(axes, times, rates)
    budgets(axes)
    _reference(axes, prices, scenes, rates)
    _frontier_line(
        axes, sorted((dot for dot in dots if dot.rank == "frontier"), key=lambda dot: dot.ms), height
    )
    for dot in sorted(dots, key=lambda one: STRENGTH[one.rank]):
        _draw(axes, dot, height(dot), rates.least)
    for column in laid:
        draw_labels(axes, column, height)
    _legend(figure, dots)
    _write(figure, prices, scenes, device, frames)
    return figure


def _columns(figure: Figure, axes: Axes, dots: Sequence[Dot]) -> tuple[list[Column], tuple[float, float]]:
    """Lay labels out, and the time axis that leaves them room."""
    # Labels are measured as they will be drawn.
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
        return span([dot.ms for dot in dots], box.width, room["left"], room["right"])

    def place_px(laid: Sequence[Column]) -> Callable[[float], float]:
        low, high = np.log10(limits(laid))
        return lambda ms: float((np.log10(ms) - low) / (high - low) * box.width)

    laid = columns(dots, measure, int((box.height - 22) / LINE_PX), place_px)
    return laid, limits(laid)


def _heights(
    axes: Axes, dots: Sequence[Dot], times: tuple[float, float], reference: Estimate | None
) -> tuple[Heights, Callable[[Dot], float]]:
    """Lay the rates' axis out, and give each dot its height: by its rate, or in a row without errors."""
    box = axes.get_window_extent()
    low, high = np.log10(times)
    free = sorted(
        (dot for dot in dots if dot.point.error_free),
        key=lambda dot: (-STRENGTH[dot.rank], bool(dot.varied), dot.ms),
    )
    rows = stacked([(np.log10(dot.ms) - low) / (high - low) * box.width for dot in free])
    row_of = dict(zip(free, rows, strict=True))
    shown = [dot.point.ber.high if dot.point.error_free else dot.point.ber.value for dot in dots]
    count = max(rows, default=-1) + 1
    if reference is not None:
        shown += [reference.value] if reference.value > 0 else []
        count += reference.value == 0
    rates = heights(shown, count, box.height)
    return rates, lambda dot: rates.rows[row_of[dot]] if dot in row_of else dot.point.ber.value


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
        transform=blended_transform_factory(axes.transAxes, axes.transData), fontsize=FONT, zorder=6.5,
    )  # fmt: skip


def _frontier_line(axes: Axes, kept: Sequence[Dot], height: Callable[[Dot], float]) -> None:
    """Draw the steps of the frontier and shade what lies behind it."""
    low_x, high_x = axes.get_xlim()
    _, high_y = axes.get_ylim()
    x, y = np.array([dot.ms for dot in kept]), np.array([height(dot) for dot in kept])
    behind_x, behind_y = np.r_[x, high_x], np.r_[y, y[-1]]
    axes.fill_between(
        behind_x, behind_y, high_y, step="post", color="#EEF3F8", alpha=0.7, zorder=0.5, linewidth=0
    )
    steps_x, steps_y = np.r_[x[0], x], np.r_[high_y, y]
    axes.plot(steps_x, steps_y, drawstyle="steps-post", color=INK, linewidth=1.5, zorder=2.2, alpha=0.85)
    axes.set_xlim(low_x, high_x)


def _draw(axes: Axes, dot: Dot, y: float, least: float) -> None:
    """Draw a dot with its quartiles and its interval, down to the rows without errors."""
    time, rate, free = dot.point.time_ms, dot.point.ber, dot.point.error_free
    alpha, order = STRENGTH[dot.rank], 4.0 + STRENGTH[dot.rank]
    x, colour = dot.ms, dot.style.colour
    axes.plot([time.low, time.high], [y, y], color=colour, alpha=alpha, linewidth=1.0, zorder=order)
    # Without errors the interval begins at 0, which is down there.
    axes.plot(
        [x, x], [y if free else max(rate.low, least), rate.high], color=colour,
        alpha=0.6 * alpha if free else alpha, linewidth=0.8 if free else 1.0,
        zorder=order - 1 if free else order, marker="_", markevery=[1], markersize=7 if free else 0,
    )  # fmt: skip
    # Under a faint or hollow marker a white one, so that bars do not shine through.
    for face, edge, fill, shown in (("white", "white", "full", 1.0), (colour, colour, dot.face, alpha)):
        axes.plot(
            [x], [y], marker=dot.style.marker, markersize=6.0 if dot.varied else 9.5, fillstyle=fill,
            markerfacecolor=face, markerfacecoloralt="white", markeredgecolor=edge, markeredgewidth=1.5,
            alpha=shown, linestyle="none", zorder=order + 0.5,
        )  # fmt: skip


def _legend(figure: Figure, dots: Sequence[Dot]) -> None:
    """Say in a row what fillings, sizes and strengths mean."""

    def sign(label: str, *, markersize: float = 9.0, fill: FillStyle = "full", alpha: float = 1.0) -> Line2D:
        face = "white" if fill == "none" else QUIET
        return Line2D(
            [], [], color=QUIET, alpha=alpha, marker="o", markersize=markersize, markerfacecolor=face,
            markeredgewidth=1.5 if fill != "full" else None, fillstyle=fill, markerfacecoloralt="white",
            linestyle="none", label=label,
        )  # fmt: skip

    faces = {dot.setting.locator: dot.face for dot in dots}
    handles = [sign(LOCATED_BY[name], fill=face) for name, face in faces.items()]
    if any(dot.varied for dot in dots):
        handles.append(sign("other K, gradient or precision", markersize=5.5))
    handles.append(Line2D([], [], color=INK, linewidth=1.5, label="frontier"))
    if any(dot.rank == "perhaps" for dot in dots):
        handles.append(sign("beaten, perhaps by chance", alpha=STRENGTH["perhaps"]))
    if any(dot.rank == "beaten" for dot in dots):
        handles.append(sign("surely beaten", alpha=STRENGTH["beaten"]))
    figure.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(0.012, 0.113), ncols=len(handles), frameon=False,
        fontsize=10, labelcolor=INK, handletextpad=0.35, columnspacing=1.5, borderaxespad=0,
    )  # fmt: skip


def _write(figure: Figure, prices: PriceList, scenes: str, device: str, frames: str) -> None:
    """Write title and footnote."""
    rounds = sorted({times.rounds for times in prices.times.by_place.values()})
    elsewhere = timed_text(prices, scenes)
    counted = " to ".join(str(one) for one in dict.fromkeys((rounds[0], rounds[-1])))
    waited = known = ""
    if prices.times.waited_share >= BUSY_SHARE:
        share = f"{100 * prices.times.waited_share:.0f} %"
        waited = f"Take times with care: for {share} of it other work had the processor. "
    if needs_preambles([setting.receiver for setting in prices.settings]):
        known = f"Times of the greyscale receivers include {preamble_text(prices)}. "
    said = (
        f"{waited}Frontier (bold): nothing is both quicker and better, by medians and measured rates. Surely "
        "beaten: one no slower by the median has a lower rate, by paired intervals of all pairs that hold "
        f"together at 95 % (Bonferroni). Rates: {prices.counted_frames} frames, the same for all; bars are "
        f"95 % intervals. Times: medians and quartiles of {counted} "
        f"interleaved rounds, each call right after an untimed one{elsewhere}. {known}"
        f"{prices.times.machines[device]}."
    )
    footnote = textwrap.fill(said, _FOOTNOTE_CHARS, break_on_hyphens=False)
    write_title(figure, "What accuracy costs in time", footnote)
    what = upper_first(f"{frames_text(prices, scenes, frames)}; {scenes_text(prices, scenes)}")
    free = any(counts.bit_errors == 0 for counts in prices.counts(scenes).values())
    row = " In the row without errors height says nothing." if free else ""
    said = f"{what}. Farther left is quicker, farther down better.{row}"
    figure.text(0.018, 1 - 0.47 / figure.get_figheight(), said, fontsize=11.5, color=QUIET, va="top")


def shares_figure(prices: PriceList) -> Figure | None:
    """Draw Fig. 25 on the first device; nothing where the paper's locator or receivers were not priced."""
    by_name = {one.receiver: one for one in reversed(prices.settings) if one.locator == "paper"}
    if not by_name.keys() >= PAPER_SHARES.keys() - {PANEL_DETECTION}:
        return None
    device = prices.places[0].device
    kinds = [frames for name, frames in prices.kinds if name == device]
    every = prices.batches(device, kinds[0])
    measured = DetectionTimes(
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
