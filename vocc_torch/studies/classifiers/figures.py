"""The pictures of a comparison: error rates of every receiver, and a map of receivers in other scenes."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter, NullLocator

from vocc_torch.measure.curve import BerTable, Row
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.show.canvas import INK, QUIET, ink_on, new_figure, write_legend, write_title
from vocc_torch.show.plots import draw_rates, interval_note, receiver_line
from vocc_torch.show.styles import Style, axis_label, receiver_styles, value_text
from vocc_torch.show.text_table import rate_text
from vocc_torch.studies.classifiers.results import GENIE, Comparison, Transfer
from vocc_torch.studies.classifiers.words import KNOWS, ratio_text

_OWN, _REFERENCE, _FAINT = "#0072B2", "#D55E00", "#D3D7DC"
_COLUMNS, _SIZE = 5, 0.72
_WIDE_IN, _HIGH_IN, _BESIDE_IN, _BETWEEN_IN = 2.62, 1.72, 0.14, 0.62
_LEFT_IN, _RIGHT_IN, _ABOVE_IN, _BELOW_IN = 0.82, 0.16, 1.42, 1.16
_TITLE_LETTERS = 31
"""Letters of a title that fit above a picture."""

_MAP, _NO_ERRORS = colormaps["viridis"], "#F4F4F2"
_CELL_IN, _LINE_IN, _LETTER_IN = 0.86, 0.46, 0.075
_FOOTNOTE_LETTERS_IN = 14.2
"""Letters of a footnote in an inch."""


def curves_figure(comparison: Comparison, experiment: str) -> Figure:
    """Draw one experiment: a picture for each receiver, the best first, with all others faint behind it.

    The reference and the genie stand in each picture.

    Args:
        comparison: what was measured.
        experiment: its name.
    """
    table, names = comparison.tables[experiment], comparison.ranked
    columns = min(_COLUMNS, len(names))
    lines = math.ceil(len(names) / columns)
    width = _LEFT_IN + columns * (_WIDE_IN + _BESIDE_IN) - _BESIDE_IN + _RIGHT_IN
    height = _ABOVE_IN + lines * (_HIGH_IN + _BETWEEN_IN) - _BETWEEN_IN + _BELOW_IN
    figure = new_figure(max(width, 7.2), height)
    room = {"left": _LEFT_IN / width, "right": 1 - _RIGHT_IN / width, "top": 1 - _ABOVE_IN / height}
    room |= {"bottom": _BELOW_IN / height, "wspace": _BESIDE_IN / _WIDE_IN, "hspace": _BETWEEN_IN / _HIGH_IN}
    grid = figure.subplots(lines, columns, squeeze=False, gridspec_kw=room).flatten().tolist()
    styles = receiver_styles(names)
    for place, (axes, name) in enumerate(zip(grid, names, strict=False)):
        _draw_receiver(axes, comparison, table, name)
        title = f"{place + 1}. {styles[name].label}"
        size = 10.5 * min(1.0, _TITLE_LETTERS / len(title))
        axes.set_title(title, fontsize=size, color=INK, loc="left", pad=18)
        axes.text(0, 1.03, _against_reference(comparison, experiment, name), transform=axes.transAxes)
        axes.texts[-1].set(va="bottom", fontsize=8.8, color=INK)
        axes.tick_params(axis="y", which="both", labelleft=place % columns == 0)
        axes.tick_params(axis="x", labelbottom=place + columns >= len(names))
    for axes in grid[len(names) :]:
        axes.remove()
    label, reference = (
        axis_label(table.axis),
        receiver_styles([comparison.reference])[comparison.reference].label,
    )
    figure.supxlabel(label, y=0.74 / height, fontsize=11.5, color=INK, va="center")
    figure.supylabel("Bit error rate", x=0.14 / width, fontsize=11.5, color=INK)
    handles = _signs(table, reference)
    write_legend(figure, handles, (0.01, 1 - 0.42 / height), len(handles), fontsize=9.8, handlelength=2.2)
    rows = [row for row in table if row.receiver != GENIE]
    note = f"{frames_text(rows)} frames a point \N{MIDDLE DOT} locator: {table.locators[0]} \N{MIDDLE DOT} "
    note += f"fractions and multiples: of {reference}, on the same frames\n{interval_note(rows)}"
    over = label.partition(" (")[0].lower()
    write_title(figure, f"Bit error rate of {len(names)} receivers over {over}, the best first", note)
    return figure


def _draw_receiver(axes: Axes, comparison: Comparison, table: BerTable, name: str) -> None:
    """Draw one receiver with its intervals and limits before the lines of the others."""
    rows = [row for row in table if row.receiver != GENIE]
    colour = _REFERENCE if name == comparison.reference else _OWN
    own = BerTable(table.of(name))
    draw_rates(axes, own, {name: Style(name, colour, "o", "-")}, rows, size=_SIZE, width_in=_WIDE_IN)
    axes.yaxis.set_minor_locator(NullLocator())
    for other in (*comparison.ranked, GENIE):
        look: dict[str, Any] = {"color": _FAINT, "linewidth": 0.9, "zorder": 2}
        if other == comparison.reference:
            look = {"color": _REFERENCE, "linewidth": 1.3, "zorder": 2.5}
        # A rate that is not a number breaks the line. The genie's without errors lies at the foot: its limit
        # would tell of its few frames, not of what is possible.
        zero = math.nan
        if other == GENIE:
            look = {"color": INK, "linewidth": 1.5, "zorder": 2.6, "linestyle": "--", "clip_on": False}
            zero = axes.get_ylim()[0]
        if other != name:
            points = table.of(other)
            axes.plot([row.value for row in points], [row.ber or zero for row in points], **look)


def _against_reference(comparison: Comparison, experiment: str, name: str) -> str:
    """Write a receiver's rate over the reference's at the summary's point, if there is one."""
    value = comparison.points.get(experiment)
    ratio = None if value is None else comparison.ratio(experiment, name, value)
    if ratio is None or value is None:
        return ""
    return f"{ratio_text(ratio).replace('x', chr(0xD7))} at {value_text(value)}"


def _signs(table: BerTable, reference: str) -> list[Line2D]:
    """Give the legend's signs."""
    signs = [
        receiver_line(Style("the receiver named above", _OWN, "o", "-"), size=_SIZE),
        Line2D([], [], color=_REFERENCE, linewidth=1.4, label=reference),
        Line2D([], [], color=_FAINT, linewidth=1.4, label="all others"),
    ]
    if genie := table.of(GENIE):
        foot = ", at the foot without errors" if any(row.error_free for row in genie) else ""
        text = f"{KNOWS} ({frames_text(genie)} frames a point{foot})"
        signs.append(Line2D([], [], color=INK, linewidth=1.5, linestyle="--", label=text))
    return signs


def frames_text(rows: Iterable[Row]) -> str:
    """Write how many frames points have.

    Example:
        >>> frames_text([])
        'no'
    """
    frames = sorted({row.frames for row in rows})
    ends = dict.fromkeys([*frames[:1], *frames[-1:]])
    return " to ".join(f"{number:,}".replace(",", "\N{THIN SPACE}") for number in ends) or "no"


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
    others = [name for name in dict.fromkeys(one.tested_on for one in transfers) if name != home]
    out = [(home, home), *((home, name) for name in others)]
    back = [(name, home) for name in others]
    labels = [style.label for style in receiver_styles(names).values()]
    left = 0.3 + _LETTER_IN * max(map(len, labels))
    width = left + _CELL_IN * (len(out) + len(back)) + 1.47
    frames = transfers[0].counts.frames
    note = (
        f"{frames} test frames a pair \N{MIDDLE DOT} at most {comparison.most_training_frames} training "
        f"frames, on {home} of each classifier's own mix, elsewhere of the scenes as they are \N{MIDDLE DOT} "
        "pale: no errors, with the 95 % limit \N{MIDDLE DOT} below a rate: how many times that of the same "
        "receiver trained on the scenes of the test, on the same frames, where a paired 95 % interval for "
        "this cell alone tells them apart; 0 there: that one has no errors"
    )
    lines = textwrap.wrap(note, int(width * _FOOTNOTE_LETTERS_IN))
    above, below = 1.3, 0.5 + 0.2 * len(lines)
    height = above + _LINE_IN * len(names) + below
    figure = new_figure(width, height)
    rates = [one.counts.ber for one in transfers if one.counts.half_errors] or [1e-5]
    norm = LogNorm(min(*rates, max(rates) / 10), max(rates))
    box = (0.0, below / height, 0.0, _LINE_IN * len(names) / height)
    for pairs, title, side in (
        (out, f"trained on {home}, tested on", 1),
        (back, f"trained on \N{HORIZONTAL ELLIPSIS}, tested on {home}", 0),
    ):
        axes = figure.add_axes((left / width, box[1], _CELL_IN * len(pairs) / width, box[3]))
        _draw_map(axes, [[found[(*pair, name)] for pair in pairs] for name in names], norm)
        axes.set_xticks(np.arange(len(pairs)) + 0.5, [pair[side].replace("_", " ") for pair in pairs])
        axes.set_title(title, fontsize=11.5, fontweight="bold", color=INK, loc="left", pad=26)
        left += _CELL_IN * len(pairs) + 0.42
    figure.axes[0].set_yticks(np.arange(len(names)) + 0.5, labels)
    bar = figure.add_axes(((left - 0.2) / width, box[1], 0.15 / width, box[3]))
    figure.colorbar(ScalarMappable(norm, _MAP), cax=bar).outline.set_visible(False)
    bar.yaxis.set_major_locator(LogLocator(10, numticks=20))
    bar.yaxis.set_minor_formatter(NullFormatter())
    bar.tick_params(which="both", length=3, color=QUIET, labelcolor=INK, labelsize=9.5)
    bar.set_ylabel("Bit error rate", fontsize=11, color=INK)
    write_title(figure, "Receivers in scenes that they did not learn in", "\n".join(lines))
    return figure


def _draw_map(axes: Axes, rows: Sequence[Sequence[Transfer]], norm: LogNorm) -> None:
    """Draw a cell with its numbers for each receiver, the first on top, and pair of scenes."""
    rates = np.ma.masked_equal([[one.counts.ber for one in row] for row in rows], 0.0)
    look = _MAP.with_extremes(bad=_NO_ERRORS)
    axes.pcolormesh(rates, norm=norm, cmap=look, edgecolors="white", linewidth=1.2)
    for line, row in enumerate(rows):
        for column, one in enumerate(row):
            counts, below = one.counts, _against_home(one)
            back = _MAP(float(norm(counts.ber))) if counts.half_errors else _NO_ERRORS
            text = (
                rate_text(counts.ber) if counts.half_errors else f"< {rate_text(ber_interval(counts).high)}"
            )
            for words, down, size in ((text, 0.32 if below else 0.5, 9), (below, 0.71, 7.8)):
                place = (column + 0.5, line + down, words)
                axes.text(*place, ha="center", va="center", fontsize=size, color=ink_on(to_rgb(back)))
    axes.invert_yaxis()
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0, labelsize=10, labelcolor=INK, labeltop=True, labelbottom=False)


def _against_home(one: Transfer) -> str:
    """Write how it compares with the receiver trained on the scenes of the test, where that differs."""
    if one.trained_on == one.tested_on:
        return ""
    ratio = one.ratio
    if ratio is None:
        return "0 there" if one.surely_worse() else ""
    return ratio_text(ratio).replace("x", "\N{MULTIPLICATION SIGN}") if ratio.leaves_out(1) else ""
