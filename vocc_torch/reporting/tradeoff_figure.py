"""``tradeoff.png``: every receiver a dot, time a frame against bit error rate, and the frontier."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogFormatterSciNotation, LogLocator, NullFormatter
from matplotlib.transforms import blended_transform_factory

from vocc_torch.evaluation.frontier import Offer, frontier
from vocc_torch.evaluation.price_list import PriceList, Setting
from vocc_torch.reporting.canvas import FINE_GRID, GRID, INK, QUIET, new_figure, quiet_axes, write_title
from vocc_torch.reporting.styles import Style, receiver_styles
from vocc_torch.reporting.tradeoff_labels import Box, place_labels
from vocc_torch.reporting.tradeoff_legend import FAINT, FillStyle, draw_legend, text_renderer
from vocc_torch.reporting.tradeoff_words import FRAMES_PER_S, frames_text, scenes_text, varied_text

_FACES: tuple[FillStyle, ...] = ("full", "none", "left", "bottom")
"""How the markers of the locators are filled, in their order."""

_SHORT = {"truth": "true corners", "paper": "paper's locator", "refined": "refined"}
_MARKER_PX = 13.0


@dataclass(frozen=True)
class _Dot:
    """A receiver as it is drawn."""

    offer: Offer
    setting: Setting
    style: Style
    face: FillStyle
    kept: bool
    varied: list[str]

    @property
    def y(self) -> float:
        """Height of the dot: its rate, or the limit where there were no errors."""
        return self.offer.ber_high if self.offer.error_free else self.offer.ber


def tradeoff_figure(prices: PriceList, scenes: str, device: str, frames: str) -> Figure:
    """Draw the price list of one kind of scenes on one device and kind of frames.

    Args:
        prices: what was measured.
        scenes: the kind of scenes.
        device: the device.
        frames: ``whole`` or ``crops``.
    """
    dots = _dots(prices, scenes, device, frames)
    figure = new_figure(12.4, 8.0)
    # Labels are measured as they will be drawn.
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.075, 0.155, 0.675, 0.725))
    _set_up(axes, dots)
    _budgets(axes)
    kept = sorted((dot for dot in dots if dot.kept), key=lambda dot: dot.offer.median_ms)
    _frontier_line(axes, kept)
    for dot in sorted(dots, key=lambda one: one.kept):
        _draw(axes, dot)
    _label(figure, axes, dots, kept)
    draw_legend(
        figure,
        {dot.setting.receiver: dot.style for dot in dots},
        {dot.setting.locator: dot.face for dot in dots},
        varied=any(dot.varied for dot in dots),
        limits=any(dot.offer.error_free for dot in dots),
    )
    _write(figure, prices, scenes, device, frames)
    return figure


def _dots(prices: PriceList, scenes: str, device: str, frames: str) -> list[_Dot]:
    """Say how each receiver is drawn."""
    offers = prices.offers(scenes, device, frames)
    kept = {one.name for one in frontier(offers)}
    styles = receiver_styles(setting.receiver for setting in prices.settings)
    locators = list(dict.fromkeys(setting.locator for setting in prices.settings))
    faces = {name: _FACES[place % len(_FACES)] for place, name in enumerate(locators)}
    return [
        _Dot(
            offer,
            setting,
            styles[setting.receiver],
            faces[setting.locator],
            offer.name in kept,
            varied_text(setting, prices.settings[0]),
        )
        for setting, offer in zip(prices.settings, offers, strict=True)
    ]


def _set_up(axes: Axes, dots: Sequence[_Dot]) -> None:
    """Set both logarithmic axes up, with all dots and all time limits inside."""
    quiet_axes(axes)
    axes.set_xscale("log")
    axes.set_yscale("log")
    times = [dot.offer.median_ms for dot in dots] + [1e3 / speed for speed in FRAMES_PER_S]
    axes.set_xlim(min(times) / 1.45, max(times) * 1.35)
    highest = max(dot.offer.ber_high for dot in dots)
    lowest = min(dot.y / (4 if dot.offer.error_free else 1.8) for dot in dots)
    axes.set_ylim(lowest, min(1.0, 1.7 * highest))
    axes.set_xlabel("Time a frame (ms), at each receiver's best batch size")
    axes.set_ylabel("Bit error rate")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(LogLocator(subs=(2, 5)))
    axes.xaxis.set_minor_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_major_formatter(LogFormatterSciNotation())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.grid(which="major", color=GRID, linewidth=0.9)
    axes.grid(which="minor", color=FINE_GRID, linewidth=0.7)


def _budgets(axes: Axes) -> None:
    """Draw the time a frame that cameras leave."""
    above = blended_transform_factory(axes.transData, axes.transAxes)
    for speed in FRAMES_PER_S:
        axes.axvline(1e3 / speed, color=QUIET, linewidth=1.0, linestyle=(0, (5, 4)), zorder=1.5, alpha=0.7)
        axes.text(
            1e3 / speed,
            1.012,
            f"{speed} frames/s" if speed == max(FRAMES_PER_S) else f"{speed}",
            transform=above,
            ha="center",
            va="bottom",
            fontsize=10.5,
            color=QUIET,
        )


def _frontier_line(axes: Axes, kept: Sequence[_Dot]) -> None:
    """Draw the steps of the frontier and shade what lies behind it."""
    low_x, high_x = axes.get_xlim()
    low_y, high_y = axes.get_ylim()
    x = np.array([dot.offer.median_ms for dot in kept])
    # How far below its limit an offer without errors lies is not known: it may be all the way.
    y = np.array([low_y if dot.offer.error_free else dot.y for dot in kept])
    steps_x, steps_y = np.r_[x[0], x, high_x], np.r_[high_y, y, y[-1]]
    axes.fill_between(
        steps_x, steps_y, high_y, step="post", color="#EEF3F8", alpha=0.75, zorder=0.5, linewidth=0
    )
    axes.plot(steps_x, steps_y, drawstyle="steps-post", color=INK, linewidth=1.5, zorder=2.2, alpha=0.8)
    axes.set_xlim(low_x, high_x)


def _draw(axes: Axes, dot: _Dot) -> None:
    """Draw a dot with its interval and quartiles."""
    offer, style = dot.offer, dot.style
    alpha, order = (1.0, 5.0) if dot.kept else (FAINT, 3.0)
    x, colour = offer.median_ms, style.colour
    axes.plot(
        [offer.low_ms, offer.high_ms], [dot.y, dot.y], color=colour, alpha=alpha, linewidth=1.3, zorder=order
    )
    if offer.error_free:
        axes.annotate(
            "",
            (x, dot.y / 2.6),
            (x, dot.y),
            arrowprops={"arrowstyle": "-|>", "color": colour, "alpha": alpha, "linewidth": 1.3, "shrinkA": 0},
            zorder=order,
        )
    else:
        axes.plot(
            [x, x], [offer.ber_low, offer.ber_high], color=colour, alpha=alpha, linewidth=1.3, zorder=order
        )
    # Under a faint or hollow marker a white one, so that bars do not shine through.
    for face, edge, fill, shown in (("white", "white", "full", 1.0), (colour, colour, dot.face, alpha)):
        axes.plot(
            [x],
            [dot.y],
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


def _label(figure: Figure, axes: Axes, dots: Sequence[_Dot], kept: Sequence[_Dot]) -> None:
    """Name the receivers of the frontier."""
    figure.draw_without_rendering()
    renderer = text_renderer(figure)
    texts = [
        axes.text(
            dot.offer.median_ms, dot.y, _named(dot), fontsize=10.5, color=INK, zorder=7, linespacing=1.15
        )
        for dot in kept
    ]
    for text in texts:
        text.set_bbox({"facecolor": "white", "alpha": 0.86, "edgecolor": "none", "pad": 1.6})
    points = [tuple(axes.transData.transform((dot.offer.median_ms, dot.y))) for dot in kept]
    extents = [text.get_window_extent(renderer) for text in texts]
    frame = axes.get_window_extent(renderer)
    inside = (frame.x0 + 6, frame.y0 + 6, frame.x1 - 6, frame.y1 - 6)
    spots = place_labels(
        [(float(x), float(y)) for x, y in points],
        [(box.width + 6, box.height + 6) for box in extents],
        [box for dot in dots for box in _boxes(axes, dot)],
        inside,
    )
    for text, spot, (x, y), size in zip(texts, spots, points, extents, strict=True):
        place = axes.transData.inverted().transform((spot.left + 3, spot.bottom + 3))
        text.set_position((float(place[0]), float(place[1])))
        text.set_verticalalignment("bottom")
        if not spot.near:
            end = (min(max(x, spot.left), spot.left + size.width), spot.bottom + size.height / 2 + 3)
            tip = axes.transData.inverted().transform(end)
            start = axes.transData.inverted().transform((x, y))
            axes.plot([start[0], tip[0]], [start[1], tip[1]], color=QUIET, linewidth=0.8, zorder=2.6)


def _boxes(axes: Axes, dot: _Dot) -> list[Box]:
    """Give what a dot and its lines take up, px."""
    offer = dot.offer
    x, y = axes.transData.transform((offer.median_ms, dot.y))
    low, high = (dot.y / 2.6, dot.y) if offer.error_free else (max(offer.ber_low, 1e-12), offer.ber_high)
    (_, bottom), (_, top) = (axes.transData.transform((offer.median_ms, end)) for end in (low, high))
    half = _MARKER_PX / 2 if not dot.varied else _MARKER_PX / 3
    return [(x - half, y - half, x + half, y + half), (x - 1.5, bottom, x + 1.5, top)]


def _named(dot: _Dot) -> str:
    """Write a dot's label."""
    return "\n".join([dot.style.label, ", ".join([_SHORT[dot.setting.locator], *dot.varied])])


def _write(figure: Figure, prices: PriceList, scenes: str, device: str, frames: str) -> None:
    """Write title and footnote."""
    counts = next(iter(prices.counts(scenes).values()))
    rounds = [len(prices.spent[prices.settings[0], place].rounds_ms["read"]) for place in prices.places]
    span = f"{min(rounds)}" if min(rounds) == max(rounds) else f"{min(rounds)} to {max(rounds)}"
    waited = ""
    if prices.waited_share >= 0.05:
        waited = f" Take with care: for {100 * prices.waited_share:.0f} % of it other work had the processor."
    footnote = (
        f"Errors: {counts.frames} frames, the same for all receivers. Bars: 95 % intervals of the rates, "
        f"quartiles of the times.\n"
        f"Times: medians of {span} interleaved rounds; {prices.machines[device]}.{waited}"
    )
    write_title(figure, "What accuracy costs in time", footnote)
    said = f"{frames_text(prices, frames)}, {scenes_text(prices, scenes)}"
    figure.text(0.018, 1 - 0.47 / figure.get_figheight(), said, fontsize=11.5, color=QUIET, va="top")
