"""What each effect costs and does, as a figure: a row an effect, in physical order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedFormatter, FixedLocator, LogLocator, NullFormatter, NullLocator

from vocc_torch.show.canvas import GRID, INK, QUIET, new_figure, quiet_axes, write_title
from vocc_torch.show.styles import receiver_styles
from vocc_torch.studies.effects.results import Cost, EffectResults, EffectRow, Kind
from vocc_torch.studies.effects.tables import cost_ratios, ms_text, scene_text, times_text

_ROW_IN, _ABOVE_IN, _BELOW_IN = 0.262, 1.18, 1.36
_LEFT_IN, _NAME_IN, _GAP_IN, _RIGHT_IN, _WIDE_IN = 3.07, 2.93, 0.3, 0.22, 3.3
_BAND = "#F6F7F9"
_LINEAR = 1e-3
"""Changes below this are drawn to a linear scale."""
_TICKS = (-0.1, -0.01, -0.001, 0.0, 0.001, 0.01, 0.1)


@dataclass(frozen=True, slots=True)
class _Series:
    """How one series is drawn: its marker stands ``shift`` rows below the middle of its row."""

    label: str
    colour: str
    marker: str
    shift: float

    @property
    def line(self) -> Line2D:
        """Its sign in a legend."""
        look: dict[str, Any] = {"color": self.colour, "marker": self.marker, "label": self.label}
        return Line2D([], [], markersize=5, linewidth=1.5, **look)


_COSTS: dict[Kind, _Series] = {
    "near": _Series("near the panel", "#009E73", "o", -0.16),
    "located": _Series("for a locator, if more", "#E69F00", "s", 0.16),
}
_CHANGES = {
    "true_corners": _Series("trained without the effect", "#D55E00", "o", -0.16),
    "retrained": _Series("trained with it", "#0072B2", "D", 0.16),
    "located": _Series("trained without the effect", "#D55E00", "o", 0.0),
}


def effects_figure(results: EffectResults) -> Figure:
    """Draw costs and changes of the bit error rate, one row an effect.

    Costs are on a logarithmic axis. Changes are on one that is linear within a thousandth and logarithmic
    beyond; a sign is full where its 95 % interval leaves out 0.
    """
    rows, shown = results.every_row, results.study.shown
    columns: dict[str, tuple[str, ...]] = {
        "Cost": ("near", "located"),
        "Change of BER, true corners": ("true_corners", "retrained"),
    }
    if any(row.change("located", shown) for row in rows):
        columns["Change of BER, paper's locator"] = ("located",)
    width = _LEFT_IN + _WIDE_IN * len(columns) + _GAP_IN * (len(columns) - 1) + _RIGHT_IN
    height = _ABOVE_IN + _ROW_IN * len(rows) + _BELOW_IN
    figure = new_figure(width, height)
    for number, (head, names) in enumerate(columns.items()):
        left = _LEFT_IN + number * (_WIDE_IN + _GAP_IN)
        place = (left / width, _BELOW_IN / height, _WIDE_IN / width, _ROW_IN * len(rows) / height)
        axes = figure.add_axes(place)
        if number == 0:
            _draw_costs(axes, results)
            _name_rows(axes, rows)
        else:
            _draw_changes(axes, rows, shown, names)
        _set_rows(axes, rows)
        axes.set_title(head, fontsize=10.5, fontweight="bold", color=INK, loc="left", pad=26)
        signs = [(_CHANGES | _COSTS if number == 0 else _CHANGES)[name].line for name in names]
        look: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (-0.02, 1.0), "borderaxespad": 0.15}
        look |= {"ncols": 2, "frameon": False, "labelcolor": INK, "handlelength": 1.6, "handletextpad": 0.5}
        axes.legend(handles=signs, fontsize=8.3, columnspacing=1.0, **look)
    label = receiver_styles([shown])[shown].label
    title = f"What each effect costs and does{scene_text(results)} ({label})"
    write_title(figure, title, _footnote(results))
    return figure


def _draw_costs(axes: Axes, results: EffectResults) -> None:
    """Draw what each effect adds to the time of a frame."""
    rows, sums = results.every_row, results.sums
    shown = [row.costs[kind] for row in rows for kind in _COSTS] + list(sums.values())
    shown = [results.base_costs["near"], *(cost for cost in shown if cost.quartiles_ms[0] > 0)]
    low, high = min(cost.median_ms for cost in shown), max(cost.quartiles_ms[2] for cost in shown)
    axes.set_xscale("log")
    axes.set_xlim(low / 2.2, high * 1.6)
    axes.xaxis.set_major_locator(LogLocator(10, numticks=20))
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_locator(LogLocator(10, subs=tuple(range(2, 10)), numticks=200))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("ms a frame, added")
    for number, row in enumerate(rows):
        if row.fills_sensor:
            for kind, series in _COSTS.items():
                _draw_cost(axes, number + series.shift, row.costs[kind], series)
        else:
            _draw_cost(axes, number, row.costs["near"], _COSTS["near"])
    for kind, total in sums.items() if results.together else ():
        if total.quartiles_ms[0] > 0:
            at = len(rows) - 1 + _COSTS[kind].shift
            (mark,) = axes.plot([total.median_ms], [at], "|", color=_COSTS[kind].colour, zorder=4)
            mark.set(markersize=11, markeredgewidth=2.2)


def _draw_cost(axes: Axes, y: float, cost: Cost, series: _Series) -> None:
    """Draw one cost with its quartiles, or a note at the edge where it cannot be told from nothing."""
    low, median, high = cost.quartiles_ms
    if low > 0:
        axes.plot([low, high], [y, y], color=series.colour, linewidth=1.5, solid_capstyle="butt")
        axes.plot([median], [y], series.marker, color=series.colour, markersize=5, zorder=3)
    else:
        note, across = "<0" if cost.shown else "~0", axes.get_yaxis_transform()
        axes.text(0.012, y, note, color=series.colour, fontsize=8, va="center", transform=across)


def _draw_changes(axes: Axes, rows: Sequence[EffectRow], receiver: str, readings: Sequence[str]) -> None:
    """Draw the change of the bit error rate with its interval; all axes of changes have the same limits."""
    every = [
        change.estimate for row in rows for some in row.changes.values() if (change := some.get(receiver))
    ]
    low, high = min((one.low for one in every), default=0.0), max((one.high for one in every), default=0.0)
    axes.set_xscale("symlog", linthresh=_LINEAR, linscale=0.55)
    axes.set_xlim(min(-1.5 * _LINEAR, low * 1.4), max(high * 1.4, 12 * _LINEAR))
    axes.xaxis.set_major_locator(FixedLocator(list(_TICKS)))
    ticks = [f"{tick:+g}".replace("-", "\N{MINUS SIGN}") if tick else "0" for tick in _TICKS]
    axes.xaxis.set_major_formatter(FixedFormatter(ticks))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.axvline(0, color=QUIET, linewidth=1.0, zorder=1)
    axes.set_xlabel("bit error rate with it less that without it")
    for number, row in enumerate(rows):
        for reading in readings:
            if (change := row.change(reading, receiver)) is None:
                continue
            series, found = _CHANGES[reading], change.estimate
            y, fill = number + series.shift, series.colour if found.real else "white"
            axes.plot([found.low, found.high], [y, y], color=series.colour, linewidth=1.5, zorder=2)
            (mark,) = axes.plot([found.value], [y], series.marker, color=series.colour, zorder=3)
            mark.set(markerfacecolor=fill, markeredgewidth=1.2, markersize=5)


def _set_rows(axes: Axes, rows: Sequence[EffectRow]) -> None:
    """Set the rows up: bands for every other group, no names."""
    quiet_axes(axes)
    axes.tick_params(axis="x", labelsize=8.5)
    axes.xaxis.label.set_fontsize(9.5)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.yaxis.set_major_locator(NullLocator())
    axes.spines["left"].set_visible(False)
    axes.grid(axis="x", which="major", color=GRID, linewidth=0.8)
    for _, first, last in _groups(rows)[::2]:
        axes.axhspan(first - 0.5, last + 0.5, color=_BAND, zorder=0, linewidth=0)


def _groups(rows: Sequence[EffectRow]) -> list[tuple[str, int, int]]:
    """Return the runs of rows of one group: name, first and last row."""
    runs, start = [], 0
    for group, members in groupby(row.group for row in rows):
        count = len(list(members))
        runs.append((group, start, start + count - 1))
        start += count
    return runs


def _name_rows(axes: Axes, rows: Sequence[EffectRow]) -> None:
    """Write the effects' names and their groups' at the left."""
    across = axes.get_yaxis_transform()
    for number, row in enumerate(rows):
        signs = " \N{BLACK SQUARE}" * row.fills_sensor + " *" * row.pair.in_scene
        name = axes.text(
            -0.1 / _WIDE_IN, number, row.label + signs, transform=across, ha="right", va="center"
        )
        name.set(fontsize=9, color=INK, fontweight="normal" if row.group else "bold")
    for group, first, last in _groups(rows):
        head = axes.text(-_NAME_IN / _WIDE_IN, (first + last) / 2, group, transform=across, va="center")
        head.set(fontsize=9.5, fontweight="bold", color=QUIET)


def _footnote(results: EffectResults) -> str:
    """Say what the figure rests on."""
    dot, rows, shown = " \N{MIDDLE DOT} ", results.every_row, results.study.shown

    def frames(reading: str) -> str:
        counted = {change.present.frames for row in rows if (change := row.change(reading, shown))}
        return " or ".join(map(str, sorted(counted)))

    crop_ms, whole_ms = ms_text(results.base_costs["located"]), ms_text(results.base_costs["whole"])
    searched = frames("located")
    lines = [
        "\N{BLACK SQUARE} fills the sensor: a locator needs whole frames, once, whatever else fills it too "
        f"({crop_ms} ms as crops, {whole_ms} ms whole){dot}* the scene has it: against the scene without it",
        f"Same frames with and without: {frames('true_corners')} at true corners"
        + (f", {searched} located" if searched else "")
        + f"{dot}bars: 95 % intervals, full where they leave out 0; one in 20 misses{dot}"
        f"linear within {_LINEAR:g}",
        f"Times: {times_text(results)}, with quartiles{dot}~0: not told from nothing",
    ]
    if (ratios := cost_ratios(results)) is not None:
        lines.append(
            f"Upright bars at all together: sums of the single costs; together they cost {ratios[0]:.2f} "
            f"times as much near the panel and {ratios[1]:.2f} times for a locator"
        )
    return "\n".join(lines)
