"""Drawings of Figs 8, 10 and 12: features by status, alone and together."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vocc_torch.show.canvas import INK, QUIET, new_figure, write_title
from vocc_torch.studies.paper.evidence_figures.panels import (
    Bools,
    Floats,
    Picture,
    head,
    panel_axes,
    percent_text,
    separation_text,
    status_cloud,
    status_histogram,
    status_legend,
)

LABELS = {
    "average_grey": "Average grey of an LED (0 to 255)",
    "agr": "AGR (ratio)",
    "gri": "GRI (grey values a pixel)",
    "ngr": "NGR (ratio)",
}
_EXPLAINED = (
    "AUC: area under the ROC curve, the chance that an On LED reads higher than an Off LED. "
    "Best threshold: the one fixed\nthreshold with the fewest wrong LEDs"
)


def grey_agr_figure(
    title: str,
    *,
    bits: Bools,
    values: Mapping[str, Floats],
    auc: Mapping[str, float],
    wrong: Mapping[str, float],
    lines: Mapping[str, tuple[float, float, float]],
    gallery: tuple[Picture, ...],
) -> Figure:
    """Draw some of the frames, and the distributions of average grey and of AGR under them.

    Args:
        title: the figure's.
        bits: (B,R,C).
        values: (B,R,C) each, ``average_grey`` and ``agr``.
        auc: area under the ROC curve of each.
        wrong: share of wrong decisions at the best fixed threshold of each.
        lines: none here.
        gallery: panels.
    """
    figure = new_figure(10, 6.9)
    columns = 10
    for index, picture in enumerate(gallery):
        row, column = divmod(index, columns)
        side = 0.9 / columns
        axes = figure.add_axes((0.02 + 0.97 * column / columns, 0.745 - row * 0.142, side, side * 10 / 6.9))
        panel_axes(axes, picture, frame=False)
    for index, name in enumerate(("average_grey", "agr")):
        axes = figure.add_axes((0.075 + 0.5 * index, 0.175, 0.41, 0.355))
        status_histogram(axes, values[name], bits, LABELS[name])
        head(axes, f"({'bc'[index]})", separation_text(auc[name], wrong[name]))
    figure.text(0.02, 0.895, f"(a) {len(gallery)} of the frames", fontsize=11.5, color=INK, fontweight="bold")
    status_legend(figure)
    write_title(figure, title, _footnote(bits))
    return figure


def gri_figure(
    title: str,
    *,
    bits: Bools,
    values: Mapping[str, Floats],
    auc: Mapping[str, float],
    wrong: Mapping[str, float],
    lines: Mapping[str, tuple[float, float, float]],
) -> Figure:
    """Draw the distribution of GRI, and GRI against AGR.

    Args:
        title: the figure's.
        bits: (B,R,C).
        values: (B,R,C) each, ``agr`` and ``gri``.
        auc: area under the ROC curve of each, and of ``agr+gri``.
        wrong: share of wrong decisions at the best fixed threshold of each.
        lines: FLDA of the pair: (w_1, w_2, threshold).
    """
    figure = new_figure(10, 5.6)
    axes = figure.add_axes((0.075, 0.2, 0.41, 0.635))
    _alone(axes, "(a)", "gri", bits, values, auc, wrong)
    gri = values["gri"]
    shares = [percent_text(float(np.mean(gri[bits == status] < 0))) for status in (False, True)]
    text = f"negative: {shares[0]} of Off,\n{shares[1]} of On LEDs"
    axes.axvline(0, color=QUIET, linewidth=1.0)
    axes.text(0.98, 0.95, text, transform=axes.transAxes, ha="right", va="top", fontsize=10, color=INK)
    _pair(figure.add_axes((0.575, 0.2, 0.41, 0.635)), "(b)", "agr+gri", bits, values, auc, wrong, lines)
    status_legend(figure)
    write_title(figure, title, f"{_footnote(bits)} Line: FLDA fitted on these LEDs.")
    return figure


def ngr_figure(
    title: str,
    *,
    bits: Bools,
    values: Mapping[str, Floats],
    auc: Mapping[str, float],
    wrong: Mapping[str, float],
    lines: Mapping[str, tuple[float, float, float]],
) -> Figure:
    """Draw the distribution of NGR, NGR against each of the others, and a projection of all three.

    Args:
        title: the figure's.
        bits: (B,R,C).
        values: (B,R,C) each, ``agr``, ``gri`` and ``ngr``, and the FLDA score of all three.
        auc: area under the ROC curve of each, and of the pairs.
        wrong: share of wrong decisions at the best fixed threshold of each.
        lines: FLDA of each pair: (w_1, w_2, threshold).
    """
    figure = new_figure(10, 9.2)
    places = [(0.075 + 0.5 * (i % 2), 0.57 - 0.43 * (i // 2), 0.41, 0.325) for i in range(4)]
    _alone(figure.add_axes(places[0]), "(a)", "ngr", bits, values, auc, wrong)
    _pair(figure.add_axes(places[1]), "(b)", "agr+ngr", bits, values, auc, wrong, lines)
    _pair(figure.add_axes(places[2]), "(c)", "gri+ngr", bits, values, auc, wrong, lines)
    axes, name = figure.add_axes(places[3]), "agr+gri+ngr"
    status_cloud(axes, values[name], values["ngr"], bits, ("FLDA score of AGR, GRI and NGR", LABELS["ngr"]))
    axes.axvline(0, color=INK, linewidth=1.3, linestyle="--")
    head(axes, "(d)", separation_text(auc[name], wrong[name]))
    status_legend(figure)
    footnote = (
        f"{_footnote(bits)} Lines: FLDA fitted on these LEDs.\n"
        "(d) is a projection of the three features on the plane of w, "
        "on which the score (a log-likelihood ratio) lies, and NGR."
    )
    write_title(figure, title, footnote)
    return figure


def _alone(
    axes: Axes,
    letter: str,
    name: str,
    bits: Bools,
    values: Mapping[str, Floats],
    auc: Mapping[str, float],
    wrong: Mapping[str, float],
) -> None:
    """Draw one feature's distribution."""
    status_histogram(axes, values[name], bits, LABELS[name])
    head(axes, letter, separation_text(auc[name], wrong[name]))


def _pair(
    axes: Axes,
    letter: str,
    name: str,
    bits: Bools,
    values: Mapping[str, Floats],
    auc: Mapping[str, float],
    wrong: Mapping[str, float],
    lines: Mapping[str, tuple[float, float, float]],
) -> None:
    """Draw two features against each other, and FLDA's decision between On and Off."""
    first, second = name.split("+")
    status_cloud(axes, values[first], values[second], bits, (LABELS[first], LABELS[second]))
    limits = axes.get_xlim(), axes.get_ylim()
    along, across, threshold = lines[name]
    x = np.array(limits[0])
    if across:
        axes.plot(x, (threshold - along * x) / across, color=INK, linewidth=1.3, linestyle="--")
    axes.set_xlim(limits[0])
    axes.set_ylim(limits[1])
    head(axes, letter, separation_text(auc[name], wrong[name]))


def _footnote(bits: Bools) -> str:
    """Say what the figure rests on and what its numbers mean."""
    return f"{_EXPLAINED}. {len(bits)} sample frames, {bits.size} LEDs, true corners."
