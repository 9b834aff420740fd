"""Bit error rates of many receivers: a small picture for each, with all others faint behind it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedFormatter, FixedLocator, LogLocator, NullFormatter, NullLocator

from vocc_torch.measure.curve import BerTable, Row
from vocc_torch.measure.estimate import Estimate
from vocc_torch.show.canvas import GRID, INK, QUIET, new_figure, write_title
from vocc_torch.show.styles import axis_label, receiver_styles, value_text
from vocc_torch.studies.classifiers.rivals import GENIE, Rivals

KNOWS = "knows the scene"
"""What the genie is called in pictures."""

_OWN, _REFERENCE, _FAINT = "#0072B2", "#D55E00", "#D3D7DC"
_WIDE_IN, _HIGH_IN, _COLUMNS = 2.62, 1.72, 5
_TITLE = 31
"""Letters of a title that fit above a picture."""
_LEFT_IN, _RIGHT_IN, _ABOVE_IN, _BELOW_IN, _BETWEEN_IN = 0.78, 0.16, 1.42, 1.06, 0.58


def ratio_text(ratio: Estimate) -> str:
    """Write a ratio for people: a limit where the receiver made no error.

    Example:
        >>> [ratio_text(Estimate(*one)) for one in ((0.0, 0.0, 0.0027), (0.031, 0.02, 0.05), (4.2, 3.0, 6.0))]
        ['< 1/370', '1/32', '4.2 x']
    """
    if ratio.value == 0:
        return f"< {_share(ratio.high)}"
    return _share(ratio.value)


def _share(value: float) -> str:
    """Write a share as a fraction, or a multiple."""
    if value > 0.95:
        return f"{value:.2g} x" if value < 99.5 else f"{value:.0f} x"
    part = 1 / value
    return f"1/{part:.2g}" if part < 9.95 else f"1/{float(f'{part:.2g}'):.0f}"


def curves_figure(rivals: Rivals, experiment: str) -> Figure:
    """Draw one experiment: receivers in the order of their rank, the reference and the genie in each picture.

    Args:
        rivals: what was measured.
        experiment: its name.
    """
    table, names = rivals.tables()[experiment], rivals.ranked()
    lines = math.ceil(len(names) / _COLUMNS)
    columns = min(_COLUMNS, len(names))
    width = _LEFT_IN + columns * _WIDE_IN + (columns - 1) * 0.12 + _RIGHT_IN
    height = _ABOVE_IN + lines * _HIGH_IN + (lines - 1) * _BETWEEN_IN + _BELOW_IN
    figure = new_figure(max(width, 7.2), height)
    styles = receiver_styles(names)
    for place, name in enumerate(names):
        line, column = divmod(place, _COLUMNS)
        left = _LEFT_IN + column * (_WIDE_IN + 0.12)
        bottom = height - _ABOVE_IN - (line + 1) * _HIGH_IN - line * _BETWEEN_IN
        box = (
            left / figure.get_figwidth(),
            bottom / height,
            _WIDE_IN / figure.get_figwidth(),
            _HIGH_IN / height,
        )
        axes = figure.add_axes(box)
        _panel(axes, rivals, table, name)
        title = f"{place + 1}. {styles[name].label}"
        size = 10.5 * min(1.0, _TITLE / len(title))
        axes.set_title(title, fontsize=size, color=INK, loc="left", pad=18)
        axes.tick_params(labelleft=column == 0, labelbottom=place + columns >= len(names))
        _note(axes, rivals, experiment, name)
    _labels(figure, rivals, table)
    return figure


def _panel(axes: Axes, rivals: Rivals, table: BerTable, name: str) -> None:
    """Draw one receiver before the others."""
    _set_up(axes, table)
    for other in rivals.receivers:
        if other not in (name, rivals.reference):
            _line(axes, table.of(other), _FAINT, width=0.9)
    if name != rivals.reference:
        _line(axes, table.of(rivals.reference), _REFERENCE, width=1.3)
    if GENIE in table.receivers:
        # Without errors it lies at the foot: its limit tells of its few frames, not of what is possible.
        foot, genie = axes.get_ylim()[0], table.of(GENIE)
        heights = [row.ber or foot for row in genie]
        axes.plot(
            [row.value for row in genie], heights, "--", color=INK, linewidth=1.5, zorder=3, clip_on=False
        )
    own = _REFERENCE if name == rivals.reference else _OWN
    _line(axes, table.of(name), own, width=2.0, marked=True)


def _line(axes: Axes, rows: Sequence[Row], colour: str, *, width: float, marked: bool = False) -> None:
    """Draw a curve, which breaks where there were no errors; marked, with intervals and limits."""
    rates = [math.nan if row.error_free else row.ber for row in rows]
    front = 5 if marked else 2 if colour == _FAINT else 3
    axes.plot([row.value for row in rows], rates, color=colour, linewidth=width, zorder=front)
    if not marked:
        return
    seen, free = ([row for row in rows if row.error_free == none] for none in (False, True))
    ends = [[row.ber - row.ber_low for row in seen], [row.ber_high - row.ber for row in seen]]
    points = [row.value for row in seen], [row.ber for row in seen]
    axes.errorbar(*points, ends, color=colour, linestyle="none", elinewidth=1.1, zorder=front)
    axes.plot(*points, "o", color=colour, markersize=4.6, markeredgecolor="white", zorder=front + 1)
    limits = [row.value for row in free], [row.ber_high for row in free]
    axes.plot(*limits, "v", color=colour, markerfacecolor="white", markersize=5.2, zorder=front)


def _set_up(axes: Axes, table: BerTable) -> None:
    """Give all pictures the same two axes."""
    values = table.values
    log = values[0] > 0 and values[-1] > 10 * values[0]
    axes.set_xscale("log" if log else "linear")
    grown = (values[-1] / values[0]) ** 0.06 if log else 0.06 * (values[-1] - values[0]) or 1.0
    axes.set_xlim(
        *((values[0] / grown, values[-1] * grown) if log else (values[0] - grown, values[-1] + grown))
    )
    named = _spread(values)
    axes.xaxis.set_major_locator(FixedLocator(list(values)))
    axes.xaxis.set_major_formatter(FixedFormatter([value_text(v) if v in named else "" for v in values]))
    axes.xaxis.set_minor_locator(NullLocator())
    if len(value_text(values[-1])) > 4:
        # A long name keeps within its picture, away from the next one's.
        axes.get_xticklabels()[-1].set_horizontalalignment("right")
    lowest = min(row.ber_high if row.error_free else row.ber for row in table if row.receiver != GENIE)
    axes.set_yscale("log")
    axes.set_ylim(lowest / 2.5, min(1.0, 1.6 * max(row.ber_high for row in table)))
    axes.yaxis.set_major_locator(LogLocator(10, numticks=12))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_minor_locator(NullLocator())
    axes.grid(color=GRID, linewidth=0.7)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(QUIET)
    axes.tick_params(length=3, color=QUIET, labelcolor=INK, labelsize=8.8)
    axes.set_axisbelow(True)


def _spread(values: Sequence[float]) -> tuple[float, ...]:
    """Choose the values that are named: every one, or every other one where they are many."""
    wide = len(values) > 5 or any(len(value_text(b)) > 4 for _, b in pairwise(values))
    return tuple(values[::2]) if wide else tuple(values)


def _note(axes: Axes, rivals: Rivals, experiment: str, name: str) -> None:
    """Say below its name what the receiver has of the reference's rate at the summary's point."""
    value = rivals.points.get(experiment)
    ratio = None if value is None else rivals.ratio(experiment, name, value)
    if ratio is None or value is None:
        return
    axes.text(
        0.0,
        1.03,
        f"{ratio_text(ratio).replace('x', chr(0xD7))} at {value_text(value)}",
        transform=axes.transAxes,
        va="bottom",
        fontsize=8.8,
        color=_OWN if ratio.high < 1 else INK,
    )


def _labels(figure: Figure, rivals: Rivals, table: BerTable) -> None:
    """Write title, legend, axes' names and what the points rest on."""
    width, height = figure.get_figwidth(), figure.get_figheight()
    label, reference = axis_label(table.axis), receiver_styles([rivals.reference])[rivals.reference].label
    handles = _handles(table, reference)
    figure.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(0.01, 1 - 0.42 / height),
        ncols=len(handles),
        frameon=False,
        fontsize=9.8,
        labelcolor=INK,
        handlelength=2.2,
        columnspacing=1.6,
    )
    across = (_LEFT_IN + width - _RIGHT_IN) / 2 / width
    figure.text(across, 0.62 / height, label, ha="center", va="center", fontsize=11.5, color=INK)
    middle = (height - _ABOVE_IN + _BELOW_IN) / 2 / height
    figure.text(0.14 / width, middle, "Bit error rate", rotation=90, va="center", fontsize=11.5, color=INK)
    others = [row for row in table if row.receiver != GENIE]
    note = (
        f"{frames_text(others)} frames a point \N{MIDDLE DOT} locator: {table.locators[0]} \N{MIDDLE DOT} "
        f"bars: 95 % intervals \N{MIDDLE DOT} fractions and multiples: of {reference}, on the same frames"
    )
    over = label.partition(" (")[0].lower()
    write_title(
        figure, f"Bit error rate of {len(rivals.receivers)} receivers over {over}, the best first", note
    )


def _handles(table: BerTable, reference: str) -> list[Line2D]:
    """Give the legend's lines."""
    handles = [
        Line2D([], [], color=_OWN, linewidth=2, marker="o", markersize=5, label="the receiver named above"),
        Line2D([], [], color=_REFERENCE, linewidth=1.4, label=reference),
        Line2D([], [], color=_FAINT, linewidth=1.4, label="all others"),
        Line2D(
            *([], []),
            color=_OWN,
            marker="v",
            linestyle="none",
            markerfacecolor="white",
            label="no errors: limit",
        ),
    ]
    if genie := table.of(GENIE):
        foot = ", at the foot without errors" if any(row.error_free for row in genie) else ""
        text = f"{KNOWS} ({frames_text(genie)} frames a point{foot})"
        handles.append(Line2D([], [], color=INK, linewidth=1.5, linestyle="--", label=text))
    return handles


def frames_text(rows: Iterable[Row]) -> str:
    """Write how many frames points have.

    Example:
        >>> frames_text([])
        'no'
    """
    frames = sorted({row.frames for row in rows})
    ends = [
        f"{number:,}".replace(",", "\N{THIN SPACE}") for number in dict.fromkeys([*frames[:1], *frames[-1:]])
    ]
    return " to ".join(ends) or "no"
