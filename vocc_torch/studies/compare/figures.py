"""The figures of all comparisons: curves, intervals in rows, maps of scenes, and times against errors."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import ticker

from vocc_torch.measure import curve
from vocc_torch.measure.estimate import Estimate
from vocc_torch.report import heatmap, plots, styles
from vocc_torch.report.plots import LOOK, Curve, Figure, Panel, Rows
from vocc_torch.report.styles import Style
from vocc_torch.report.terminal import BLANK, TableRow, ratio_text
from vocc_torch.studies.compare.effect_scenes import EffectStudy


@dataclass(frozen=True)
class FigureSettings:
    """How the figures are laid out."""

    receivers: int = 4  # panels of receivers in a row
    severities: int = 5  # panels of severities in a row
    price_in: tuple[float, float] = (6.2, 5.6)  # a panel of times and errors, inches


SETTINGS = FigureSettings()
COSTS = {
    "near": Style("near the panel", "#009E73", "o", "-"),
    "located": Style("for a locator", "#E69F00", "s", "-"),
}
READINGS = {
    "true_corners": Style("trained without the effect", "#D55E00", "o", "-"),
    "retrained": Style("trained with it", "#0072B2", "D", "--"),
}
SHOWN = Style("the receiver of the panel", "#0072B2", "o", "-")
FRONTIER = Style("nothing is both quicker and better", LOOK.ink, "", "-")
DOT = " \N{MIDDLE DOT} "


def curves_figure(
    table: curve.BerTable, rows: Sequence[TableRow], reference: str, place: str
) -> Figure:
    """Draw one experiment: a panel for each receiver, the best first, with the reference beside it.

    Args:
        table: the experiment's points.
        rows: of ``classifiers.csv``.
        reference: the receiver that the others are compared with.
        place: what the columns of the stated point begin with; empty for none.
    """
    looks = styles.receiver_styles(row["receiver"] for row in rows)
    label, panels = looks[reference].label, list[Panel]()
    for row, (name, look) in zip(rows, looks.items(), strict=True):
        drawn = {reference: Style(label, "#D55E00", "", "-"), name: SHOWN}
        title = f"{len(panels) + 1}. {look.label}"
        ratio = row.get(f"{place}_ratio", BLANK)
        if ratio is not BLANK:
            title += f"\n{ratio_text(ratio)} at {place.rpartition('_')[2]}"
        panels.append(plots.table_panel(table, title, drawn))
    frames = styles.range_text(row.frames for row in table)
    note = (
        f"{frames} frames a point{DOT}locator: {table.locators[0]}{DOT}fractions and"
        f" multiples: of {label}, on the same frames{DOT}{plots.interval_note(table)}"
    )
    title = f"Bit error rate of {len(rows)} receivers, the fewest errors first"
    return plots.curve_figure(panels, title, note, SETTINGS.receivers)


def scenes_figure(
    rows: Sequence[TableRow], home: str, receivers: Sequence[str]
) -> Figure:
    """Draw the rates of receivers that were trained in one scene and tested in another.

    Args:
        rows: rows of ``robustness.csv``.
        home: name of the scene of the experiments. It is in each pair, for the training or for the test.
        receivers: names in order; receivers without training are left out.
    """
    moves = {
        ((row["trained_on"], row["tested_on"]), row["receiver"]): row
        for row in rows
        if row["trained_on"] != row["tested_on"] or row["tested_on"] == home
    }
    pairs = list(dict.fromkeys(pair for pair, _ in moves))
    names = [name for name in receivers if (pairs[0], name) in moves][::-1]
    cells = [[moves[pair, name] for pair in pairs] for name in names]
    matrix = heatmap.Matrix(
        np.array([[row["ber"].value for row in line] for line in cells]),
        [list(map(transfer_text, line)) for line in cells],
        [style.label for style in styles.receiver_styles(names).values()],
        ["\n\N{DOWNWARDS ARROW}\n".join(pair).replace("_", " ") for pair in pairs],
        "trained on \N{DOWNWARDS ARROW} tested on",
    )
    note = (
        f"{rows[0]['frames']} test frames a pair{DOT}pale: no errors, 95 % limit{DOT}second line: ratio to the"
        " same receiver trained on the test scenes, if its paired 95 % interval excludes 1"
    )
    return heatmap.matrix_figure(
        [matrix], "Receivers in scenes without training", note
    )[0]


def transfer_text(row: TableRow) -> str:
    """Write a rate, and under it how it compares with the receiver trained on the scenes of the test."""
    ratio, rate = row["ratio"], row["ber"]
    text = styles.rate_or_limit(rate.value, rate.high)
    return f"{text}\n{ratio_text(ratio)}" if ratio.leaves_out(1) else text


def titled(study: EffectStudy, title: str) -> str:
    """Give a title with the scene and the receiver that the figure shows."""
    label = styles.receiver_styles([study.shown])[study.shown].label
    return f"{title}, scene {study.scene_name} ({label})"


def effects_figure(study: EffectStudy, rows: Sequence[TableRow]) -> Figure:
    """Draw costs and changes of the bit error rate, a row an effect.

    Changes are on an axis that is linear within a thousandth and logarithmic beyond; a sign is full where its
    95 % interval excludes 0.

    Args:
        study: what was compared.
        rows: of the effects, for the receiver that is shown.
    """
    costs = []
    for kind, style in COSTS.items():
        # What cannot be told from nothing is left out, and so is what is the same as near the panel.
        shown = [
            added
            if (added := row[f"{kind}_ms"]).low > 0
            and (kind == "near" or row["fills_sensor"])
            else None
            for row in rows
        ]
        costs.append((style, shown))
    panels = [Rows(costs, "Time added (ms a frame)", "Cost", "log")]
    located = {"located": READINGS["true_corners"]}
    for title, looks in {"True corners": READINGS, "Paper's locator": located}.items():
        series = [
            (style, [row.get(f"{reading}_change") for row in rows])
            for reading, style in looks.items()
            if f"{reading}_frames" in rows[0]
        ]
        if series:
            panels.append(Rows(series, "Change of the bit error rate", title, "symlog"))
    note = (
        f"# a locator needs whole frames{DOT}* the scene has it: compared with the scene without it\n"
        f"{study.plan.budget.frames} frames at true corners, the same with and without{DOT}bars: 95 %"
        f" intervals, full where they exclude 0{DOT}linear within {LOOK.linear:g}\nTimes:"
        f" {rows[0]['machine']}; medians with quartiles"
    )
    names = [
        f"{row['differs_in']} {'#' * row['fills_sensor']}{'*' * row['in_scene']}"
        for row in rows
    ]
    title = titled(study, "What each effect costs and does")
    return plots.rows_figure(names, panels, title, note)


def severity_figure(study: EffectStudy, rows: Sequence[TableRow]) -> Figure:
    """Draw a panel for each effect with severities: bit error rates from harmless to harsh.

    Args:
        study: what was compared.
        rows: of ``severity.csv``.
    """
    panels = []
    for name, pair in study.measured.items():
        curves = []
        for trained, style in zip(("without", "with"), READINGS.values(), strict=True):
            place = {"effect": name, "receiver": study.shown, "trained": trained}
            rates = [row["ber"] for row in rows if place.items() <= row.items()]
            curves.append(Curve(style, [*pair.severities], rates))
        panels.append(Panel(curves, name, pair.parameter.partition(".")[2]))
    note = (
        f"{study.config.severity_frames} frames a point, the same in all, true corners{DOT}bars: 95 %"
        f" intervals{DOT}arrows: no errors, one-sided limit{DOT}dashed upright line: the value in the table"
        " of effects"
    )
    title = titled(study, "Bit error rate over each effect's severity")
    figure = plots.curve_figure(panels, title, note, SETTINGS.severities)
    for axes, pair in zip(figure.axes, study.measured.values(), strict=True):
        values, usual = [*pair.severities], pair.usual
        if values[0] > values[-1]:
            axes.invert_xaxis()
        if usual is not None and min(values) <= usual <= max(values):
            axes.axvline(usual, color=LOOK.quiet, linewidth=0.9, linestyle="--")
    return figure


def price_figure(rows: Sequence[TableRow], conditions: str) -> Figure:
    """Draw times a frame against bit error rates, a panel a locator, with the frontier.

    Args:
        rows: of ``tradeoff.csv``, one for each receiver and locator.
        conditions: what they rest on.
    """
    quickest = sorted(rows, key=lambda row: row["ms"].value)
    looks = styles.receiver_styles(row["receiver"] for row in quickest)
    times, rates = [], []
    for row in quickest:
        if row["rank"] == "frontier":
            times.append(row["ms"].value)
            rates.append(Estimate(*[row["ber"].value or row["ber"].high] * 3))
    line = Curve(FRONTIER, times, rates)
    panels = []
    for locator in dict.fromkeys(row["locator"] for row in rows):
        curves = [
            Curve(looks[row["receiver"]], [row["ms"].value], [row["ber"]])
            for row in quickest
            if row["locator"] == locator
        ]
        located = styles.LOOKS["located"].get(locator, locator.replace("_", " "))
        words = located, "Time a frame (ms)"
        panels.append(Panel([line, *curves], *words, x_scale="log", spread_pt=0))
    title = f"Time and errors of {len(rows)} receivers, {rows[0]['scenes']}"
    note = f"{conditions} Bars: 95 % intervals; arrows: no errors, 95 % upper limit."
    figure = plots.curve_figure(panels, title, note, panel_in=SETTINGS.price_in)
    for axes in figure.axes:
        axes.xaxis.set_major_locator(ticker.LogLocator(10, subs=(1, 2, 5)))
    return figure
