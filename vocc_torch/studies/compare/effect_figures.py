"""The figures of ``task=effects``: costs and changes of every effect, and rates over severity."""

from collections.abc import Mapping, Sequence

from vocc_torch.measure import curve, stage_times
from vocc_torch.measure.estimate import Estimate
from vocc_torch.report import page, plots, styles
from vocc_torch.report.plots import LOOK, Figure, Rows
from vocc_torch.report.styles import Style
from vocc_torch.studies.compare.effect_results import EffectResults, EffectRow

SIGNS = {"fills": "\N{BLACK SQUARE}", "in_scene": "*"}
"""Signs after an effect's name."""

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

UNITS = {
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


def signs_of(row: EffectRow, signs: Mapping[str, str] = SIGNS) -> str:
    """Write the signs after an effect's name."""
    shown = signs["fills"] * row.fills_sensor + signs["in_scene"] * row.pair.in_scene
    return f" {shown}" if shown else ""


def headed(template: str, results: EffectResults) -> tuple[str, str]:
    """Give a figure's title and footnote, the first line of a template and the others."""
    shown = results.study.shown
    label = styles.receiver_styles([shown])[shown].label
    text = page.render(
        __package__, template, results=results, label=label, signs=SIGNS, linear=LINEAR
    )
    title, *notes = text.splitlines()
    return title, "\n".join(notes)


def effects_figure(results: EffectResults) -> Figure:
    """Draw costs and changes of the bit error rate, a row an effect.

    Changes are on an axis that is linear within a thousandth and logarithmic beyond; a sign is full where its
    95 % interval leaves out 0.
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
    groups = [row.group for row in rows]
    title, note = headed("effects.txt.j2", results)
    return plots.rows_figure(names, panels, title, note, groups, len(panels))


def cost_series(
    rows: Sequence[EffectRow],
) -> dict[str, tuple[Style, list[Estimate | None]]]:
    """Give the series of costs; what cannot be told from nothing is left out."""
    series = {}
    for kind, style in COSTS.items():
        costs: list[Estimate | None] = []
        for row in rows:
            cost = stage_times.median_of(row.costs[kind])
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
    title, note = headed("severity.txt.j2", results)
    figure = plots.curve_figure(panels, title, note, SEVERITY_COLUMNS, False)
    for axes, name in zip(figure.axes, results.severities, strict=True):
        values, usual = results.study.severities[name], results.study.usual(name)
        if values[0] > values[-1]:
            axes.invert_xaxis()
        if usual is not None and min(values) <= usual <= max(values):
            axes.axvline(usual, color=LOOK.quiet, linewidth=0.9, linestyle="--")
    return figure


def severity_table(results: EffectResults, name: str) -> curve.BerTable:
    """Put one effect's points into a table: a curve for each training."""
    axis = parameter_label(results.study.config.severity[name].parameter)
    return curve.BerTable(
        curve.Point(name, axis, value, reading, "truth", counts, "frames")
        for (value, reading, receiver), counts in results.severities[name].items()
        if receiver == results.study.shown
    )


def parameter_label(parameter: str) -> str:
    """Write a parameter's name with its unit in brackets.

    Args:
        parameter: ``effect.parameter``.

    Example:
        >>> parameter_label("defocus.focus_distance_m"), parameter_label("prnu.share")
        ('focus distance (m)', 'share')
    """
    name = parameter.partition(".")[2]
    end = max((end for end in UNITS if name.endswith(end)), key=len, default="")
    words = name.removesuffix(end).replace("_", " ").strip()
    return f"{words} ({UNITS[end]})" if words and end else words or UNITS[end]
