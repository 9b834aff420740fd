"""Receivers that learnt in one kind of scenes and were tested in another, as a map of rates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import LogLocator, NullFormatter

from vocc_torch.measure.intervals import ber_interval
from vocc_torch.show.canvas import INK, QUIET, new_figure, write_title
from vocc_torch.show.styles import receiver_styles
from vocc_torch.show.text_table import rate_text
from vocc_torch.studies.classifiers.rivals import Rivals, Transfer
from vocc_torch.studies.classifiers.rivals_figure import ratio_text

_MAP = colormaps["viridis"]
_FREE = "#F4F4F2"
_CELL_IN, _LINE_IN, _GAP_IN, _ABOVE_IN, _BELOW_IN = 0.86, 0.46, 0.42, 1.3, 0.92
_LETTER_IN = 0.075
"""Width of a letter of the receivers' names."""
_MIDDLE = 0.21
"""Relative luminance at which white and dark text are about equally legible."""


def scenes_figure(rivals: Rivals) -> Figure:
    """Draw both ways: trained at home and tested elsewhere, and trained elsewhere and tested at home.

    In a cell stands the rate, and below it, where the cell's own paired 95 % interval leaves out none, how
    many times as high it is as that of the same receiver trained on the scenes of the test.

    Args:
        rivals: with transfers.
    """
    home = rivals.home
    learnt = {one.receiver for one in rivals.transfers}
    names = [name for name in rivals.ranked() if name in learnt]
    others = [name for name in dict.fromkeys(one.tested_on for one in rivals.transfers) if name != home]
    found = {(one.trained_on, one.tested_on, one.receiver): one for one in rivals.transfers}
    out = [(home, home), *((home, name) for name in others)]
    back = [(name, home) for name in others]
    labels = [style.label for style in receiver_styles(names).values()]
    left = 0.3 + _LETTER_IN * max(map(len, labels))
    width = left + _CELL_IN * (len(out) + len(back)) + _GAP_IN + 1.05
    height = _ABOVE_IN + _LINE_IN * len(names) + _BELOW_IN
    figure = new_figure(width, height)
    norm = _norm(rivals.transfers)
    for pairs, title, place in (
        (out, f"trained on {home}, tested on", 1),
        (back, f"trained on \N{HORIZONTAL ELLIPSIS}, tested on {home}", 0),
    ):
        box = (
            left / width,
            _BELOW_IN / height,
            _CELL_IN * len(pairs) / width,
            _LINE_IN * len(names) / height,
        )
        axes = figure.add_axes(box)
        _map(axes, [[found[(*pair, name)] for pair in pairs] for name in names], norm)
        axes.set_xticks(np.arange(len(pairs)) + 0.5, [pair[place].replace("_", " ") for pair in pairs])
        axes.set_title(title, fontsize=11.5, fontweight="bold", color=INK, loc="left", pad=26)
        left += _CELL_IN * len(pairs) + _GAP_IN
    figure.axes[0].set_yticks(np.arange(len(names)) + 0.5, labels)
    _bar(figure, norm, (left - 0.2) / width)
    frames = rivals.transfers[0].counts.frames
    note = (
        f"{frames} test frames a pair \N{MIDDLE DOT} at most {rivals.most_training_frames} training frames: "
        f"on {home} of each classifier's own mix, elsewhere of the scenes as they are \N{MIDDLE DOT} pale: "
        "no errors, with the 95 % limit\nbelow a rate, where a paired 95 % interval for that cell alone "
        "tells them apart: times the rate of the same receiver trained on the scenes of the test, on the "
        "same frames; 0 there: that one has no errors"
    )
    write_title(figure, "Receivers in scenes that they did not learn in", note)
    return figure


def _norm(transfers: Sequence[Transfer]) -> LogNorm:
    """Give the colours' range: all rates above 0, at least a decade of them."""
    rates = [one.counts.ber for one in transfers if one.counts.half_errors] or [1e-5]
    return LogNorm(min(*rates, max(rates) / 10), max(rates))


def _map(axes: Axes, rows: Sequence[Sequence[Transfer]], norm: LogNorm) -> None:
    """Draw a cell for each pair and receiver, the first receiver on top."""
    for line, row in enumerate(rows):
        for column, one in enumerate(row):
            _cell(axes, one, column, line, norm)
    axes.set_xlim(0, len(rows[0]))
    axes.set_ylim(len(rows), 0)
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0, labelsize=10, labelcolor=INK, labeltop=True, labelbottom=False)


def _cell(axes: Axes, one: Transfer, column: int, line: int, norm: LogNorm) -> None:
    """Draw one cell with its numbers, dark on light and light on dark."""
    counts = one.counts
    colour = to_rgb(_MAP(float(norm(counts.ber))) if counts.half_errors else _FREE)
    axes.add_patch(Rectangle((column, line), 1, 1, facecolor=colour, edgecolor="white", linewidth=1.2))
    ink = "white" if _luminance(colour) < _MIDDLE else INK
    text = rate_text(counts.ber) if counts.half_errors else f"< {rate_text(ber_interval(counts).high)}"
    below = _against_home(one)
    axes.text(
        column + 0.5, line + (0.32 if below else 0.5), text, ha="center", va="center", fontsize=9, color=ink
    )
    axes.text(column + 0.5, line + 0.71, below, ha="center", va="center", fontsize=7.8, color=ink)


def _against_home(one: Transfer) -> str:
    """Write how it compares with the receiver trained on the scenes of the test, where that differs."""
    if one.trained_on == one.tested_on:
        return ""
    ratio = one.ratio
    if ratio is None:
        return "0 there" if one.worse() else ""
    return ratio_text(ratio).replace("x", "\N{MULTIPLICATION SIGN}") if ratio.leaves_out(1) else ""


def _luminance(colour: tuple[float, float, float]) -> float:
    """Give a colour's relative luminance, 0 to 1 (WCAG 2)."""
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _bar(figure: Figure, norm: LogNorm, left: float) -> None:
    """Draw the shared colour bar."""
    box = figure.axes[0].get_position()
    axes = figure.add_axes((left, box.y0, 0.15 / figure.get_figwidth(), box.height))
    figure.colorbar(ScalarMappable(norm, _MAP), cax=axes)
    axes.yaxis.set_major_locator(LogLocator(10, numticks=20))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(which="both", length=3, color=QUIET, labelcolor=INK, labelsize=9.5)
    axes.set_ylabel("Bit error rate", fontsize=11, color=INK)
    axes.spines[:].set_visible(False)
