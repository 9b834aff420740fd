"""The figures of ``task=classifiers``: errors of every receiver, and receivers in other scenes."""

from collections.abc import Sequence

import numpy as np

from vocc_torch.measure import curve, intervals
from vocc_torch.measure.estimate import Estimate
from vocc_torch.report import heatmap, plots, styles
from vocc_torch.report.plots import Curve, Figure, Panel
from vocc_torch.report.styles import Style
from vocc_torch.studies.compare.rival_results import (
    ReceiverComparison,
    Transfer,
    ratio_text,
)

SHOWN = Style("the receiver of the panel", "#0072B2", "o", "-")
OTHERS = Style("all others", "#D3D7DC", "", "-")
COLUMNS = 4
"""Panels in a row."""


def curves_figure(comparison: ReceiverComparison, experiment: str) -> Figure:
    """Draw one experiment: a panel for each receiver, the best first, with all others faint behind it.

    Args:
        comparison: what was measured.
        experiment: its name.
    """
    table, names = comparison.tables[experiment], comparison.ranked
    labels = {
        name: style.label for name, style in styles.receiver_styles(names).items()
    }
    reference = Style(labels[comparison.reference], "#D55E00", "", "-")
    at, panels = comparison.points.get(experiment), []
    for place, name in enumerate(names, 1):
        others = set(names) - {name, comparison.reference}
        curves = [bare_curve(table.of(other), OTHERS) for other in sorted(others)]
        curves.append(bare_curve(table.of(comparison.reference), reference))
        shown = curve.BerTable(table.of(name))
        curves += plots.table_panel(shown, styles={name: SHOWN}).curves
        title = f"{place}. {labels[name]}"
        ratio = None if at is None else comparison.ratio(experiment, name, at)
        if at is not None and ratio is not None:
            title += f"\n{ratio_text(ratio)} at {styles.value_text(at)}"
        panels.append(Panel(curves, title, styles.axis_label(table.axis)))
    frames = styles.range_text(row.frames for row in table)
    note = " \N{MIDDLE DOT} ".join(
        [
            f"{frames} frames a point",
            f"locator: {table.locators[0]}",
            f"fractions and multiples: of {reference.label}, on the same frames",
            plots.interval_note(table),
        ]
    )
    heading = f"Bit error rate of {len(names)} receivers, the fewest errors first"
    return plots.curve_figure(panels, heading, note, COLUMNS)


def bare_curve(rows: Sequence[curve.Row], style: Style) -> Curve:
    """Make a curve without intervals, which breaks at a point without errors."""
    rates = [Estimate(row.ber, row.ber, row.ber) for row in rows]
    return Curve(style, [row.value for row in rows], rates, bars=False)


def scenes_figure(comparison: ReceiverComparison) -> Figure:
    """Draw both ways: trained at home and tested elsewhere, and trained elsewhere and tested at home.

    Args:
        comparison: with transfers.
    """
    home, transfers = comparison.home, comparison.transfers
    found = {
        (move.trained_on, move.tested_on, move.receiver): move for move in transfers
    }
    names = [name for name in comparison.ranked if (home, home, name) in found][::-1]
    scenes = list(dict.fromkeys(move.tested_on for move in transfers))
    others = [name for name in scenes if name != home]
    labels = [style.label for style in styles.receiver_styles(names).values()]
    maps = []
    for title, pairs in {
        f"trained on {home}, tested on": [(home, name) for name in (home, *others)],
        f"trained on ..., tested on {home}": [(name, home) for name in others],
    }.items():
        moves = [[found[(*pair, name)] for pair in pairs] for name in names]
        rates = np.array([[move.counts.ber for move in row] for row in moves])
        texts = [list(map(transfer_text, row)) for row in moves]
        columns = [a if b == home and a != home else b for a, b in pairs]
        shown = [name.replace("_", " ") for name in columns]
        maps.append(heatmap.Matrix(rates, texts, labels, shown, title))
    note = (
        f"{transfers[0].counts.frames} test frames a pair \N{MIDDLE DOT} pale: no errors, 95 % limit"
        " \N{MIDDLE DOT} second line: ratio to the same receiver trained on the test scenes, if its paired"
        " 95 % interval excludes 1"
    )
    title = "Receivers in scenes without training"
    return heatmap.matrix_figure(maps, title, note, len(maps))[0]


def transfer_text(move: Transfer) -> str:
    """Write a rate, and under it how it compares with the receiver trained on the scenes of the test."""
    limit = intervals.ber_interval(move.counts).high
    text = heatmap.rate_or_limit(move.counts.ber, limit)
    if move.ratio is None:
        return f"{text}\n0 there" if move.surely_worse else text
    return f"{text}\n{ratio_text(move.ratio)}" if move.ratio.leaves_out(1) else text
