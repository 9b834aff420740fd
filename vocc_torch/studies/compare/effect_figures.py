"""The figures of ``task=effects``: costs and changes of every effect, and rates over severity."""

from collections.abc import Sequence

from vocc_torch.measure import curve, timing
from vocc_torch.measure.estimate import Estimate
from vocc_torch.report import plots, styles
from vocc_torch.report.plots import LOOK, Figure, Rows
from vocc_torch.report.styles import Style
from vocc_torch.studies.compare.effect_results import EffectResults, EffectRow

FILLS, IN_SCENE = "#", "*"
"""Signs after an effect's name: a locator needs whole frames; the scene has it."""

COSTS = {
    "near": Style("near the panel", "#009E73", "o", "-"),
    "located": Style("for a locator", "#E69F00", "s", "-"),
}
WITHOUT = Style("trained without the effect", "#D55E00", "o", "-")
WITH = Style("trained with it", "#0072B2", "D", "--")
LINEAR = 1e-3
"""Changes of the bit error rate below this are drawn to a linear scale."""

SEVERITY_COLUMNS = 5
"""Panels of severities in a row."""


def signs_of(row: EffectRow) -> str:
    """Write the signs after an effect's name."""
    shown = FILLS * row.fills_sensor + IN_SCENE * row.pair.in_scene
    return f" {shown}" if shown else ""


def titled(results: EffectResults, title: str) -> str:
    """Give a title with the scene and the receiver that the figure shows."""
    shown = results.study.shown
    label = styles.receiver_styles([shown])[shown].label
    return f"{title}, scene {results.study.scene_name} ({label})"


def effects_figure(results: EffectResults) -> Figure:
    """Draw costs and changes of the bit error rate, a row an effect.

    Changes are on an axis that is linear within a thousandth and logarithmic beyond; a sign is full where its
    95 % interval excludes 0.
    """
    rows, shown = results.every_row, results.study.shown
    panels = [Rows(cost_series(rows), "Time added (ms a frame)", "Cost", "log")]
    for title, readings in {
        "True corners": {"true_corners": WITHOUT, "retrained": WITH},
        "Paper's locator": {"located": WITHOUT},
    }.items():
        series = {
            style.label: (style, [row.estimate(reading, shown) for row in rows])
            for reading, style in readings.items()
            if reading in results.readings
        }
        if series:
            label = "Change of the bit error rate"
            panels.append(Rows(series, label, title, "symlog", LINEAR))
    names = [row.label + signs_of(row) for row in rows]
    note = (
        f"{FILLS} a locator needs whole frames \N{MIDDLE DOT} {IN_SCENE} the scene has it: compared with the"
        f" scene without it\n{results.study.plan.budget.frames} frames at true corners, the same with and"
        f" without \N{MIDDLE DOT} bars: 95 % intervals, full where they exclude 0 \N{MIDDLE DOT} linear within"
        f" {LINEAR:g}\nTimes: {results.costs.machine}; medians with quartiles"
    )
    title = titled(results, "What each effect costs and does")
    return plots.rows_figure(names, panels, title, note)


def cost_series(
    rows: Sequence[EffectRow],
) -> dict[str, tuple[Style, list[Estimate | None]]]:
    """Give the series of costs; what cannot be told from nothing is left out."""
    series = {}
    for kind, style in COSTS.items():
        costs: list[Estimate | None] = []
        for row in rows:
            cost = timing.median_of(row.costs[kind])
            same = kind == "located" and not row.fills_sensor
            costs.append(None if same or cost.low <= 0 else cost)
        series[style.label] = style, costs
    return series


def severity_figure(results: EffectResults) -> Figure:
    """Draw a panel for each effect with severities: bit error rates from harmless to harsh."""
    looks = {"true_corners": WITHOUT, "retrained": WITH}
    panels = [
        plots.table_panel(severity_table(results, name), name, looks)
        for name in results.severities
    ]
    note = (
        f"{results.study.config.severity_frames} frames a point, the same in all, true corners \N{MIDDLE DOT}"
        " bars: 95 % intervals \N{MIDDLE DOT} arrows: no errors, one-sided limit \N{MIDDLE DOT} dashed"
        " upright line: the value in the table of effects"
    )
    title = titled(results, "Bit error rate over each effect's severity")
    figure = plots.curve_figure(panels, title, note, SEVERITY_COLUMNS)
    for axes, name in zip(figure.axes, results.severities, strict=True):
        values, usual = results.study.severities[name], results.study.usual(name)
        if values[0] > values[-1]:
            axes.invert_xaxis()
        if usual is not None and min(values) <= usual <= max(values):
            axes.axvline(usual, color=LOOK.quiet, linewidth=0.9, linestyle="--")
    return figure


def severity_table(results: EffectResults, name: str) -> curve.BerTable:
    """Put one effect's points into a table: a curve for each training."""
    axis = results.study.config.severity[name].parameter.partition(".")[2]
    return curve.BerTable(
        curve.Point(name, axis, value, reading, "truth", counts, "frames")
        for (value, reading, receiver), counts in results.severities[name].items()
        if receiver == results.study.shown
    )
