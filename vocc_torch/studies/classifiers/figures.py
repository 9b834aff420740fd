"""The pictures of a comparison: error rates of every receiver, and a map of receivers in other scenes."""

import math
import textwrap
from typing import Any

import numpy as np

from vocc_torch.measure import curve, intervals
from vocc_torch.report import canvas, heatmap, page, styles
from vocc_torch.report import drawing as plots
from vocc_torch.report.canvas import Figure, Line2D
from vocc_torch.studies.classifiers.results import (
    GENIE,
    KNOWS,
    Comparison,
    Transfer,
    ratio_text,
)

_OWN, _REFERENCE, _FAINT = "#0072B2", "#D55E00", "#D3D7DC"
_COLUMNS, _SIZE = 5, 0.72
_CELLS_IN, _GAPS_IN, _MARGINS_IN = (2.62, 1.72), (0.14, 0.62), (0.82, 0.16, 1.42, 1.16)
_CELL_IN, _LINE_IN, _LETTER_IN = 0.86, 0.46, 0.075


def curves_figure(comparison: Comparison, experiment: str) -> Figure:
    """Draw one experiment: a picture for each receiver, the best first, with all others faint behind it.

    The reference and the genie stand in each picture.

    Args:
        comparison: what was measured.
        experiment: its name.
    """
    table, names = comparison.tables[experiment], comparison.ranked
    columns, at = min(_COLUMNS, len(names)), comparison.points.get(experiment)
    figure, grid = canvas.new_grid(
        len(names), columns, _CELLS_IN, _GAPS_IN, _MARGINS_IN
    )
    known = styles.receiver_styles([*names, comparison.reference])
    rows, genie = [row for row in table if row.receiver != GENIE], table.of(GENIE)
    looks: dict[str, Any] = {
        comparison.reference: {"color": _REFERENCE, "linewidth": 1.3, "zorder": 2.5}
    }
    looks[GENIE] = {
        "color": canvas.INK,
        "linewidth": 1.5,
        "zorder": 2.6,
        "linestyle": "--",
        "clip_on": False,
    }
    for place, (axes, name) in enumerate(zip(grid, names, strict=True)):
        own = styles.Style(
            name, _REFERENCE if name == comparison.reference else _OWN, "o", "-"
        )
        plots.draw_rates(axes, curve.BerTable(table.of(name)), {name: own}, rows, _SIZE)
        axes.minorticks_off()
        # A rate that is not a number breaks the line. The genie's without errors lies at the foot: its limit
        # would tell of its few frames, not of what is possible.
        for other in (other for other in (*names, GENIE) if other != name):
            look = looks.get(other, {"color": _FAINT, "linewidth": 0.9, "zorder": 2})
            zero, others = (
                axes.get_ylim()[0] if other == GENIE else math.nan,
                table.of(other),
            )
            axes.add_line(
                Line2D(
                    [row.value for row in others],
                    [row.ber or zero for row in others],
                    **look,
                )
            )
        title = f"{place + 1}. {known[name].label}"
        size = 10.5 * min(1.0, 31 / len(title))  # so many letters fit above a picture
        axes.set_title(title, fontsize=size, color=canvas.INK, loc="left", pad=18)
        if (
            at is not None
            and (ratio := comparison.ratio(experiment, name, at)) is not None
        ):
            text = f"{ratio_text(ratio).replace('x', chr(0xD7))} at {styles.value_text(at)}"
            axes.text(
                0,
                1.03,
                text,
                transform=axes.transAxes,
                va="bottom",
                fontsize=8.8,
                color=canvas.INK,
            )
        canvas.label_edges(axes, place + columns >= len(names), place % columns == 0)
    label, reference = styles.axis_label(table.axis), known[comparison.reference].label
    width, height = figure.get_size_inches()
    figure.supxlabel(
        label, y=0.74 / height, fontsize=11.5, color=canvas.INK, va="center"
    )
    figure.supylabel("Bit error rate", x=0.14 / width, fontsize=11.5, color=canvas.INK)
    signs = [
        plots.receiver_line(
            styles.Style("the receiver named above", _OWN, "o", "-"), size=_SIZE
        ),
        Line2D([], [], color=_REFERENCE, linewidth=1.4, label=reference),
        Line2D([], [], color=_FAINT, linewidth=1.4, label="all others"),
    ]
    if genie:
        foot = (
            ", at the foot without errors"
            if any(row.error_free for row in genie)
            else ""
        )
        text = f"{KNOWS} ({styles.range_text(row.frames for row in genie)} frames a point{foot})"
        signs.append(
            Line2D([], [], color=canvas.INK, linewidth=1.5, linestyle="--", label=text)
        )
    at_signs, look = (0.01, 1 - 0.42 / height), {"fontsize": 9.8, "handlelength": 2.2}
    canvas.write_legend(figure, signs, at_signs, len(signs), **look)
    note = f"{styles.range_text(row.frames for row in rows)} frames a point \N{MIDDLE DOT} locator: "
    note += f"{table.locators[0]} \N{MIDDLE DOT} fractions and multiples: of {reference}, on the same frames"
    heading = f"Bit error rate of {len(names)} receivers over {label.partition(' (')[0].lower()}"
    canvas.write_title(
        figure, f"{heading}, the best first", f"{note}\n{plots.interval_note(rows)}"
    )
    return figure


def scenes_figure(comparison: Comparison) -> Figure:
    """Draw both ways: trained at home and tested elsewhere, and trained elsewhere and tested at home.

    In a cell stands the rate, and below it, where the cell's own paired 95 % interval leaves out none, how
    many times as high it is as that of the same receiver trained on the scenes of the test.

    Args:
        comparison: with transfers.
    """
    home, transfers = comparison.home, comparison.transfers
    found = {(one.trained_on, one.tested_on, one.receiver): one for one in transfers}
    names = [name for name in comparison.ranked if (home, home, name) in found]
    others = [
        name
        for name in dict.fromkeys(one.tested_on for one in transfers)
        if name != home
    ]
    out, back = (
        [(home, home), *((home, name) for name in others)],
        [(name, home) for name in others],
    )
    labels = [style.label for style in styles.receiver_styles(names).values()]
    left = 0.3 + _LETTER_IN * max(map(len, labels))
    width = left + _CELL_IN * (len(out) + len(back)) + 1.47
    frames, most = transfers[0].counts.frames, comparison.most_training_frames
    note = page.render(
        __package__,
        "scenes.txt.j2",
        frames=frames,
        most_training_frames=most,
        home=home,
    )
    lines = textwrap.wrap(note, int(14.2 * width))  # letters of a footnote in an inch
    below = 0.5 + 0.2 * len(lines)
    height = 1.3 + _LINE_IN * len(names) + below
    figure, norm = (
        canvas.new_figure(width, height),
        heatmap.rate_norm(one.counts.ber for one in transfers),
    )
    bottom, tall = below / height, _LINE_IN * len(names) / height
    elsewhere = "trained on \N{HORIZONTAL ELLIPSIS}, tested on"
    for pairs, title, side in (
        (out, f"trained on {home}, tested on", 1),
        (back, f"{elsewhere} {home}", 0),
    ):
        axes = figure.add_axes(
            (left / width, bottom, _CELL_IN * len(pairs) / width, tall)
        )
        rows = [[found[(*pair, name)] for pair in pairs] for name in names]
        edges = (np.arange(len(pairs) + 1.0), np.arange(len(names) + 1.0))
        heatmap.draw_cells(
            axes,
            *edges,
            np.array([[one.counts.ber for one in row] for row in rows]),
            norm,
        )
        for line, row in enumerate(rows):
            for column, one in enumerate(row):
                rate, under = one.counts.ber, against_home(one)
                limit = styles.rate_text(intervals.ber_interval(one.counts).high)
                text = styles.rate_text(rate) if rate else f"< {limit}"
                for words, down, size in (
                    (text, 0.32 if under else 0.5, 9),
                    (under, 0.71, 7.8),
                ):
                    heatmap.write_rate(
                        axes, (column + 0.5, line + down), words, size, norm, rate
                    )
        axes.invert_yaxis()
        axes.set_yticks([])
        axes.set_xticks(
            edges[0][:-1] + 0.5, [pair[side].replace("_", " ") for pair in pairs]
        )
        axes.tick_params(
            length=0,
            labelsize=10,
            labelcolor=canvas.INK,
            labeltop=True,
            labelbottom=False,
        )
        title = textwrap.fill(
            title, max(17, int(8.5 * _CELL_IN * len(pairs)))
        )  # letters in an inch
        axes.set_title(
            title,
            fontsize=11.5,
            fontweight="bold",
            color=canvas.INK,
            loc="left",
            pad=26,
        )
        left += _CELL_IN * len(pairs) + 0.42
    figure.axes[0].set_yticks(np.arange(len(names)) + 0.5, labels)
    heatmap.draw_scale(figure, ((left - 0.2) / width, bottom, 0.15 / width, tall), norm)
    canvas.write_title(
        figure, "Receivers in scenes that they did not learn in", "\n".join(lines)
    )
    return figure


def against_home(one: Transfer) -> str:
    """Write how it compares with the receiver trained on the scenes of the test, where they surely differ."""
    if one.ratio is None:
        return "0 there" if one.surely_worse() else ""
    return (
        ratio_text(one.ratio).replace("x", "\N{MULTIPLICATION SIGN}")
        if one.ratio.leaves_out(1)
        else ""
    )
