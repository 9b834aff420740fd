"""The figures of all comparisons: curves, intervals in rows, maps of scenes, and times against errors."""

from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import ticker

from vocc_torch.measure import curve, intervals
from vocc_torch.measure.estimate import Estimate
from vocc_torch.report import heatmap, plots, styles
from vocc_torch.report.plots import LOOK, Curve, Figure, Panel, Rows
from vocc_torch.report.styles import Style
from vocc_torch.studies.compare.prices import LOCATED_BY, PriceList
from vocc_torch.studies.compare.report import ratio_text

if TYPE_CHECKING:
    from vocc_torch.studies.compare.classifiers import ReceiverComparison, Transfer
    from vocc_torch.studies.compare.effect_scenes import ScenePair
    from vocc_torch.studies.compare.effects import EffectResults


@dataclass(frozen=True)
class FigureSettings:
    """How the figures are laid out."""

    receivers: int = 4  # panels of receivers in a row
    severities: int = 5  # panels of severities in a row
    linear: float = (
        1e-3  # changes of the error rate below this are drawn to a linear scale
    )
    price_in: tuple[float, float] = (
        6.2,
        5.6,
    )  # a panel of times against errors, inches


SETTINGS = FigureSettings()
FILLS, IN_SCENE = "#", "*"
"""Signs after an effect's name: a locator needs whole frames; the scene has it."""

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


def curves_figure(comparison: "ReceiverComparison", experiment: str) -> Figure:
    """Draw one experiment: a panel for each receiver, the best first, with the reference beside it.

    Args:
        comparison: what was measured.
        experiment: its name.
    """
    table, names = comparison.tables[experiment], comparison.ranked
    looks, reference = styles.receiver_styles(names), comparison.reference
    label = looks[reference].label
    panels = []
    for place, name in enumerate(names, 1):
        drawn = {reference: Style(label, "#D55E00", "", "-"), name: SHOWN}
        rows = [row for receiver in drawn for row in table.of(receiver)]
        title = f"{place}. {looks[name].label}"
        at = comparison.points.get(experiment)
        if at is not None and (ratio := comparison.ratio(experiment, name)):
            title += f"\n{ratio_text(ratio)} at {styles.value_text(at)}"
        panels.append(plots.table_panel(curve.BerTable(rows), title, drawn))
    frames = styles.range_text(row.frames for row in table)
    note = (
        f"{frames} frames a point{DOT}locator: {table.locators[0]}{DOT}fractions and"
        f" multiples: of {label}, on the same frames{DOT}{plots.interval_note(table)}"
    )
    heading = f"Bit error rate of {len(names)} receivers, the fewest errors first"
    return plots.curve_figure(panels, heading, note, SETTINGS.receivers)


def scenes_figure(comparison: "ReceiverComparison") -> Figure:
    """Draw both ways: trained at home and tested elsewhere, and trained elsewhere and tested at home.

    Args:
        comparison: with transfers.
    """
    moves = {
        ((move.trained_on, move.tested_on), move.receiver): move
        for move in comparison.transfers
        if move.trained_on != move.tested_on or move.tested_on == comparison.home
    }
    pairs = list(dict.fromkeys(pair for pair, _ in moves))
    names = [name for name in comparison.ranked if (pairs[0], name) in moves][::-1]
    rows = [[moves[pair, name] for pair in pairs] for name in names]
    matrix = heatmap.Matrix(
        np.array([[move.counts.ber for move in row] for row in rows]),
        [list(map(transfer_text, row)) for row in rows],
        [style.label for style in styles.receiver_styles(names).values()],
        ["\n\N{RIGHTWARDS ARROW} ".join(pair).replace("_", " ") for pair in pairs],
        "trained on \N{RIGHTWARDS ARROW} tested on",
    )
    note = (
        f"{comparison.transfers[0].counts.frames} test frames a pair{DOT}pale: no errors, 95 % limit"
        f"{DOT}second line: ratio to the same receiver trained on the test scenes, if its paired 95 % interval"
        " excludes 1"
    )
    title = "Receivers in scenes without training"
    return heatmap.matrix_figure([matrix], title, note)[0]


def transfer_text(move: "Transfer") -> str:
    """Write a rate, and under it how it compares with the receiver trained on the scenes of the test."""
    limit = intervals.ber_interval(move.counts).high
    text = heatmap.rate_or_limit(move.counts.ber, limit)
    if move.ratio is None:
        return f"{text}\n0 there" if move.worse else text
    return f"{text}\n{ratio_text(move.ratio)}" if move.ratio.leaves_out(1) else text


def signs_of(pair: "ScenePair") -> str:
    """Write the signs after an effect's name."""
    return f" {FILLS * pair.fills_sensor}{IN_SCENE * pair.in_scene}".rstrip()


def titled(results: "EffectResults", title: str) -> str:
    """Give a title with the scene and the receiver that the figure shows."""
    shown = results.study.shown
    label = styles.receiver_styles([shown])[shown].label
    return f"{title}, scene {results.study.scene_name} ({label})"


def effects_figure(results: "EffectResults") -> Figure:
    """Draw costs and changes of the bit error rate, a row an effect.

    Changes are on an axis that is linear within a thousandth and logarithmic beyond; a sign is full where its
    95 % interval excludes 0.
    """
    study, costs = results.study, {}
    pairs = study.every_pair
    for kind, style in COSTS.items():
        every = [results.cost(kind, pair) for pair in pairs]
        # What cannot be told from nothing is left out, and so is what is the same as near the panel.
        costs[style.label] = (
            style,
            [
                cost if cost.low > 0 and (kind == "near" or pair.fills_sensor) else None
                for cost, pair in zip(every, pairs, strict=True)
            ],
        )
    panels = [Rows(costs, "Time added (ms a frame)", "Cost", "log")]
    located = (
        {"located": READINGS["true_corners"]} if study.config.located_frames else {}
    )
    for title, looks in {"True corners": READINGS, "Paper's locator": located}.items():
        series = {}
        for reading, style in looks.items():
            changes = [results.change(pair, reading, study.shown) for pair in pairs]
            found = [change.estimate if change else None for change in changes]
            series[style.label] = style, found
        if series:
            label = "Change of the bit error rate"
            panels.append(Rows(series, label, title, "symlog", SETTINGS.linear))
    note = (
        f"{FILLS} a locator needs whole frames{DOT}{IN_SCENE} the scene has it: compared with the scene"
        f" without it\n{study.plan.budget.frames} frames at true corners, the same with and without{DOT}bars:"
        f" 95 % intervals, full where they exclude 0{DOT}linear within {SETTINGS.linear:g}\nTimes:"
        f" {results.machine}; medians with quartiles"
    )
    names = [pair.label + signs_of(pair) for pair in pairs]
    title = titled(results, "What each effect costs and does")
    return plots.rows_figure(names, panels, title, note)


def severity_figure(results: "EffectResults") -> Figure:
    """Draw a panel for each effect with severities: bit error rates from harmless to harsh."""
    study, points = results.study, dict[str, list[curve.Point]]()
    for name, value, reading, receiver, counts in results.severities():
        if receiver == study.shown:
            axis = study.config.severity[name].parameter.partition(".")[2]
            point = curve.Point(name, axis, value, reading, "truth", counts, "frames")
            points.setdefault(name, []).append(point)
    panels = [
        plots.table_panel(curve.BerTable(of), name, READINGS)
        for name, of in points.items()
    ]
    note = (
        f"{study.config.severity_frames} frames a point, the same in all, true corners{DOT}bars: 95 %"
        f" intervals{DOT}arrows: no errors, one-sided limit{DOT}dashed upright line: the value in the table"
        " of effects"
    )
    title = titled(results, "Bit error rate over each effect's severity")
    figure = plots.curve_figure(panels, title, note, SETTINGS.severities)
    for axes, (name, values) in zip(figure.axes, study.severities.items(), strict=True):
        if values[0] > values[-1]:
            axes.invert_xaxis()
        usual = study.usual(name)
        if usual is not None and min(values) <= usual <= max(values):
            axes.axvline(usual, color=LOOK.quiet, linewidth=0.9, linestyle="--")
    return figure


def price_figure(prices: PriceList) -> Figure:
    """Draw every receiver's time a frame against its bit error rate, a panel a locator, with the frontier."""
    points = sorted(prices.points(), key=attrgetter("ms"))
    looks = styles.receiver_styles(point.key.receiver for point in points)
    frontier = [point for point in points if point.rank == "frontier"]
    best = [point.ber.value or point.ber.high for point in frontier]
    rates = [Estimate(rate, rate, rate) for rate in best]
    line = Curve(FRONTIER, [point.ms for point in frontier], rates, bars=False)
    panels = []
    for locator in prices.study.config.locators:
        curves = [
            Curve(looks[point.key.receiver], [point.ms], [point.ber])
            for point in points
            if point.key.locator == locator
        ]
        words = LOCATED_BY[locator], "Time a frame (ms)"
        panels.append(Panel([line, *curves], *words, x_scale="log", spread_pt=0))
    title = f"Time and errors of {len(points)} receivers, {prices.study.scene_name}"
    note = f"{prices.conditions()} Bars: 95 % intervals; arrows: no error, the rate is below this."
    figure = plots.curve_figure(panels, title, note, panel_in=SETTINGS.price_in)
    for axes in figure.axes:
        axes.xaxis.set_major_locator(ticker.LogLocator(10, subs=(1, 2, 5)))
    return figure
