"""Bit error rate over the severity of each effect: small multiples with one vertical axis."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import BerTable, Point
from vocc_torch.show.ber_axes import draw_rates, receiver_line
from vocc_torch.show.canvas import INK, QUIET, new_figure, write_title
from vocc_torch.show.styles import Style, receiver_styles
from vocc_torch.studies.effects.effects_table import scene_text
from vocc_torch.studies.effects.table import EffectTable, SeverityCurve

_WIDE_IN, _HIGH_IN, _ACROSS_IN, _DOWN_IN = 2.32, 1.55, 0.28, 0.86
_LEFT_IN, _RIGHT_IN, _ABOVE_IN, _BELOW_IN = 0.78, 0.15, 1.12, 0.38
_COLUMNS = 5
_SIZE = 0.74
_STYLES = {
    "true_corners": Style("trained without the effect", "#D55E00", "o", "-"),
    "retrained": Style("trained with it, as the table of effects has it", "#0072B2", "D", "--"),
}
_UNITS = {
    "_deg": "°",
    "_m": "m",
    "_s": "s",
    "_px": "px",
    "_nm": "nm",
    "_lx": "lx",
    "_cd_m2": "cd/m²",
    "_m_s": "m/s",
    "electrons_per_s": "electrons/s",
    "electrons": "electrons",
}
"""Units by the end of a parameter's name; the longest end that fits counts."""


def severity_figure(curves: Sequence[SeverityCurve], table: EffectTable) -> Figure:
    """Draw one small axes for each effect, from harmless at the left to harsh at the right.

    Args:
        curves: the effects, at least one.
        table: for the receiver that is shown and the scene's own rate.

    Raises:
        VoccError: no effect.
    """
    if not curves:
        raise VoccError("curves is empty: a figure needs at least one effect")
    tables = [_table(curve, table.shown) for curve in curves]
    shown = [row for one in tables for row in one.rows]
    columns = min(_COLUMNS, len(curves))
    lines = math.ceil(len(curves) / columns)
    width = max(10.9, _LEFT_IN + columns * _WIDE_IN + (columns - 1) * _ACROSS_IN + _RIGHT_IN)
    height = _ABOVE_IN + lines * (_HIGH_IN + _DOWN_IN) + _BELOW_IN
    figure = new_figure(width, height)
    for number, (curve, rates) in enumerate(zip(curves, tables, strict=True)):
        line, column = divmod(number, columns)
        left_in = _LEFT_IN + column * (_WIDE_IN + _ACROSS_IN)
        top_in = _ABOVE_IN + line * (_HIGH_IN + _DOWN_IN)
        place = (left_in / width, 1 - (top_in + _HIGH_IN) / height, _WIDE_IN / width, _HIGH_IN / height)
        axes = figure.add_axes(place)
        draw_rates(axes, rates, _STYLES, shown, size=_SIZE, width_in=_WIDE_IN)
        _finish(axes, curve, table, leftmost=column == 0)
    label = receiver_styles([table.shown])[table.shown].label
    frames = curves[0].points[0].errors["true_corners"][table.shown].frames
    note = (
        f"{frames} frames a point, the same in all, true corners \N{MIDDLE DOT} bars: 95 % intervals "
        "\N{MIDDLE DOT} arrows: no errors, one-sided limit\ngrey line: the scene itself \N{MIDDLE DOT} "
        "dashed upright line: the value in the table of effects"
    )
    write_title(figure, f"Bit error rate over each effect's severity{scene_text(table)} ({label})", note)
    figure.legend(
        handles=[receiver_line(style, size=0.9) for style in _STYLES.values()],
        loc="upper left",
        bbox_to_anchor=(0.01, 1 - 0.46 / height),
        ncols=2,
        frameon=False,
        fontsize=10,
        labelcolor=INK,
        handlelength=3.0,
    )
    return figure


def parameter_label(parameter: str) -> str:
    """Write a parameter's name with its unit in brackets.

    Args:
        parameter: ``effect.parameter``.

    Example:
        >>> parameter_label("defocus.focus_distance_m"), parameter_label("prnu.share")
        ('focus distance (m)', 'share')
    """
    name = parameter.partition(".")[2]
    ends = [end for end in _UNITS if name.endswith(end)]
    if not ends:
        return name.replace("_", " ")
    end = max(ends, key=len)
    words = name.removesuffix(end).replace("_", " ").strip()
    return f"{words} ({_UNITS[end]})" if words else _UNITS[end]


def _table(curve: SeverityCurve, receiver: str) -> BerTable:
    """Put one effect's points into a table: a curve for each training."""
    return BerTable(
        Point(curve.name, curve.parameter, point.value, reading, "truth", errors[receiver], "frames")
        for point in curve.points
        for reading, errors in point.errors.items()
    )


def _finish(axes: Axes, curve: SeverityCurve, table: EffectTable, *, leftmost: bool) -> None:
    """Turn falling values round, and mark the scene's own rate and the table's value."""
    values = [point.value for point in curve.points]
    if values[0] > values[-1]:
        axes.set_xlim(*reversed(axes.get_xlim()))
    base = table.base.get("truth", {}).get(table.shown)
    if base is not None and base.half_errors:
        axes.axhline(base.ber, color=QUIET, linewidth=1.0, alpha=0.55, zorder=1)
    if curve.usual is not None and min(values) <= curve.usual <= max(values):
        axes.axvline(curve.usual, color=QUIET, linewidth=0.9, linestyle=(0, (2, 2)), zorder=1)
    axes.set_title(curve.name, fontsize=9.5, fontweight="bold", color=INK, loc="left", pad=4)
    effect = curve.parameter.partition(".")[0]
    label = parameter_label(curve.parameter)
    axes.set_xlabel(label if effect == curve.name else f"{effect}: {label}", labelpad=3, fontsize=8.6)
    axes.set_ylabel("Bit error rate" if leftmost else "", fontsize=9)
    axes.tick_params(axis="y", which="both", labelleft=leftmost)
