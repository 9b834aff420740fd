"""What each effect costs and does, as a figure: a row an effect, in physical order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedFormatter, FixedLocator, LogLocator, NullFormatter, NullLocator

from vocc_torch.show.canvas import GRID, INK, QUIET, new_figure, quiet_axes, write_title
from vocc_torch.show.styles import receiver_styles
from vocc_torch.studies.effects.effects_table import cost_ratios, ms_text, scene_text, waited_text
from vocc_torch.studies.effects.table import Cost, EffectRow, EffectTable

_ROW_IN, _ABOVE_IN, _BELOW_IN = 0.262, 1.18, 1.36
_GROUP_IN, _NAME_IN, _GAP_IN, _RIGHT_IN = 1.12, 1.95, 0.3, 0.22
_COST_IN, _BER_IN = 3.3, 3.3
_BAND = "#F6F7F9"


@dataclass(frozen=True, slots=True)
class _Sign:
    """How one series is drawn."""

    label: str
    colour: str
    marker: str
    shift: float


_NEAR = _Sign("near the panel", "#009E73", "o", -0.16)
_LOCATED = _Sign("for a locator, if more", "#E69F00", "s", 0.16)
_SERIES = {
    "true_corners": _Sign("trained without the effect", "#D55E00", "o", -0.16),
    "retrained": _Sign("trained with it", "#0072B2", "D", 0.16),
    "located": _Sign("trained without the effect", "#D55E00", "o", 0.0),
}
_LINEAR = 1e-3
"""Changes below this are drawn to a linear scale."""
_TICKS = (-0.1, -0.01, -0.001, 0.0, 0.001, 0.01, 0.1)


def effects_figure(table: EffectTable) -> Figure:
    """Draw costs and changes of the bit error rate, one row an effect.

    Costs are on a logarithmic axis. Changes are on one that is linear within a thousandth and logarithmic
    beyond; a sign is full where its 95 % interval leaves out 0.

    Args:
        table: the effects.
    """
    rows = [*table.rows, *([table.together] if table.together else [])]
    located = any(row.change("located", table.shown) for row in rows)
    widths = [_COST_IN, _BER_IN, *([_BER_IN] if located else [])]
    left = _GROUP_IN + _NAME_IN
    width = left + sum(widths) + _GAP_IN * (len(widths) - 1) + _RIGHT_IN
    height = _ABOVE_IN + _ROW_IN * len(rows) + _BELOW_IN
    figure = new_figure(width, height)
    axes: list[Axes] = []
    for wide in widths:
        place = (left / width, _BELOW_IN / height, wide / width, _ROW_IN * len(rows) / height)
        axes.append(figure.add_axes(place))
        left += wide + _GAP_IN
    _draw_costs(axes[0], rows, table)
    limits = _limits(rows, table.shown)
    _draw_changes(axes[1], rows, table.shown, ("true_corners", "retrained"), limits)
    heads = ["Cost", "Change of BER, true corners"]
    if located:
        _draw_changes(axes[2], rows, table.shown, ("located",), limits)
        heads.append("Change of BER, paper's locator")
    for one, head in zip(axes, heads, strict=True):
        _set_rows(one, rows)
        one.set_title(head, fontsize=10.5, fontweight="bold", color=INK, loc="left", pad=26)
    _name_rows(axes[0], rows)
    _legends(axes, located)
    label = receiver_styles([table.shown])[table.shown].label
    title = f"What each effect costs and does{scene_text(table)} ({label})"
    write_title(figure, title, _footnote(table, rows))
    return figure


def _draw_costs(axes: Axes, rows: Sequence[EffectRow], table: EffectTable) -> None:
    """Draw what each effect adds to the time of a frame."""
    shown = [cost for row in rows for cost in (row.near, row.located) if cost.low_ms > 0]
    shown += [table.base_near, *(one for one in (table.sum_located,) if one is not None and one.low_ms > 0)]
    low, high = min(cost.median_ms for cost in shown), max(cost.high_ms for cost in shown)
    axes.set_xscale("log")
    axes.set_xlim(low / 2.2, high * 1.6)
    axes.xaxis.set_major_locator(LogLocator(10, numticks=20))
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_locator(LogLocator(10, subs=tuple(range(2, 10)), numticks=200))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("ms a frame, added")
    for number, row in enumerate(rows):
        series = ((_NEAR, row.near), (_LOCATED, row.located))
        for sign, cost in series if row.fills_sensor else series[:1]:
            _draw_cost(axes, number + (sign.shift if row.fills_sensor else 0), cost, sign)
    if rows and rows[-1] is table.together:
        for sign, total in ((_NEAR, table.sum_near), (_LOCATED, table.sum_located)):
            if total is not None and total.low_ms > 0:
                at = [len(rows) - 1 + sign.shift]
                axes.plot(
                    [total.median_ms],
                    at,
                    "|",
                    color=sign.colour,
                    markersize=11,
                    markeredgewidth=2.2,
                    zorder=4,
                )


def _draw_cost(axes: Axes, y: float, cost: Cost, sign: _Sign) -> None:
    """Draw one cost with its quartiles, or a note at the edge where it cannot be told from nothing."""
    if cost.low_ms <= 0:
        axes.text(
            0.012,
            y,
            "~0" if not cost.shown else "<0",
            color=sign.colour,
            fontsize=8,
            va="center",
            transform=axes.get_yaxis_transform(),
        )
        return
    axes.plot([cost.low_ms, cost.high_ms], [y, y], color=sign.colour, linewidth=1.5, solid_capstyle="butt")
    axes.plot([cost.median_ms], [y], sign.marker, color=sign.colour, markersize=5, zorder=3)


def _limits(rows: Sequence[EffectRow], receiver: str) -> tuple[float, float]:
    """Give the ends of the axes of changes: all intervals, and a decade to the right of 0."""
    found = [
        change.interval for row in rows for some in row.changes.values() if (change := some.get(receiver))
    ]
    low, high = min((one.low for one in found), default=0.0), max((one.high for one in found), default=0.0)
    return min(-1.5 * _LINEAR, low * 1.4), max(high * 1.4, 12 * _LINEAR)


def _draw_changes(
    axes: Axes,
    rows: Sequence[EffectRow],
    receiver: str,
    readings: Sequence[str],
    limits: tuple[float, float],
) -> None:
    """Draw the change of the bit error rate with its interval."""
    axes.set_xscale("symlog", linthresh=_LINEAR, linscale=0.55)
    axes.set_xlim(*limits)
    axes.xaxis.set_major_locator(FixedLocator(list(_TICKS)))
    axes.xaxis.set_major_formatter(
        FixedFormatter([f"{tick:+g}".replace("-", "\N{MINUS SIGN}") if tick else "0" for tick in _TICKS])
    )
    axes.xaxis.set_minor_locator(NullLocator())
    axes.axvline(0, color=QUIET, linewidth=1.0, zorder=1)
    axes.set_xlabel("bit error rate with it less that without it")
    for number, row in enumerate(rows):
        for reading in readings:
            change = row.change(reading, receiver)
            if change is None:
                continue
            sign, found = _SERIES[reading], change.interval
            y = number + sign.shift
            axes.plot([found.low, found.high], [y, y], color=sign.colour, linewidth=1.5, zorder=2)
            axes.plot(
                [found.difference],
                [y],
                sign.marker,
                color=sign.colour,
                markerfacecolor=sign.colour if found.real else "white",
                markeredgewidth=1.2,
                markersize=5,
                zorder=3,
            )


def _set_rows(axes: Axes, rows: Sequence[EffectRow]) -> None:
    """Set the rows up: bands for every other group, no names."""
    quiet_axes(axes)
    axes.tick_params(axis="x", labelsize=8.5)
    axes.xaxis.label.set_fontsize(9.5)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.yaxis.set_major_locator(NullLocator())
    axes.spines["left"].set_visible(False)
    axes.grid(axis="x", which="major", color=GRID, linewidth=0.8)
    for number, (_, first, last) in enumerate(_groups(rows)):
        if number % 2 == 0:
            axes.axhspan(first - 0.5, last + 0.5, color=_BAND, zorder=0, linewidth=0)


def _groups(rows: Sequence[EffectRow]) -> list[tuple[str, int, int]]:
    """Give the runs of rows of one group: name, first and last row."""
    runs, start = [], 0
    for group, members in groupby(row.group for row in rows):
        count = len(list(members))
        runs.append((group, start, start + count - 1))
        start += count
    return runs


def _name_rows(axes: Axes, rows: Sequence[EffectRow]) -> None:
    """Write the effects' names and their groups' at the left."""
    width_in = axes.get_position().width * axes.figure.get_figwidth()  # type: ignore[union-attr]  # a whole figure
    across = axes.get_yaxis_transform()
    for number, row in enumerate(rows):
        signs = (" \N{BLACK SQUARE}" if row.fills_sensor else "") + (" *" if row.in_scene else "")
        weight = "bold" if not row.group else "normal"
        axes.text(
            -0.1 / width_in,
            number,
            row.label + signs,
            transform=across,
            ha="right",
            va="center",
            fontsize=9,
            color=INK,
            fontweight=weight,
        )
    for group, first, last in _groups(rows):
        if not group:
            continue
        x = -(_NAME_IN + 0.98) / width_in
        axes.text(
            x,
            (first + last) / 2,
            group,
            transform=across,
            va="center",
            fontsize=9.5,
            fontweight="bold",
            color=QUIET,
        )


def _legends(axes: Sequence[Axes], located: bool) -> None:
    """Explain the signs above each column."""

    def sign(one: _Sign) -> Line2D:
        return Line2D(
            [], [], color=one.colour, marker=one.marker, markersize=5, linewidth=1.5, label=one.label
        )

    columns = [[_NEAR, _LOCATED], [_SERIES["true_corners"], _SERIES["retrained"]]]
    columns += [[_SERIES["located"]]] if located else []
    for one, signs in zip(axes, columns, strict=True):
        one.legend(
            handles=[sign(each) for each in signs],
            loc="lower left",
            bbox_to_anchor=(-0.02, 1.0),
            borderaxespad=0.15,
            ncols=2,
            frameon=False,
            fontsize=8.3,
            labelcolor=INK,
            handlelength=1.6,
            columnspacing=1.0,
            handletextpad=0.5,
        )


def _footnote(table: EffectTable, rows: Sequence[EffectRow]) -> str:
    """Say what the figure rests on."""
    dot = " \N{MIDDLE DOT} "
    frames = sorted({change.frames for row in rows if (change := row.change("true_corners", table.shown))})
    searched = sorted({change.frames for row in rows if (change := row.change("located", table.shown))})
    lines = [
        "\N{BLACK SQUARE} fills the sensor: a locator needs whole frames, once, whatever else fills it too "
        f"({ms_text(table.base_located)} ms as crops, {ms_text(table.base_whole)} ms whole)"
        + f"{dot}* the scene has it: against the scene without it",
        f"Same frames with and without: {_listed(frames)} at true corners"
        + (f", {_listed(searched)} located" if searched else "")
        + f"{dot}bars: 95 % intervals, full where they leave out 0; one in 20 misses{dot}"
        f"linear within {_LINEAR:g}",
        f"Times: medians and quartiles of {len(table.base_near.rounds_ms)} rounds, "
        f"{table.machine}{waited_text(table)}{dot}"
        "~0: not told from nothing",
    ]
    if (ratios := cost_ratios(table)) is not None:
        lines.append(
            f"Upright bars at all together: sums of the single costs; together they cost {ratios[0]:.2f} "
            f"times as much near the panel and {ratios[1]:.2f} times for a locator"
        )
    return "\n".join(lines)


def _listed(numbers: Sequence[int]) -> str:
    """List numbers of frames."""
    return " or ".join(str(number) for number in numbers)
