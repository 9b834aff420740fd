"""Figs 8, 10 and 12: how well grey values and features separate On from Off LEDs."""

from collections.abc import Sequence

import numpy as np
import torch
from scipy.optimize import linprog
from scipy.stats import mannwhitneyu

from vocc_torch.arrays import Bools, Floats
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.report import led_plots, plots
from vocc_torch.studies.paper.evidence import PaperFigure
from vocc_torch.studies.paper.evidence.sample import Source

LABELS = {
    "average_grey": "Average grey of an LED (0 to 255)",
    "agr": "AGR (ratio)",
    "gri": "GRI (grey values a pixel)",
    "ngr": "NGR (ratio)",
}
"""Axes of what tells On from Off."""


def separation(values: Floats, bits: Bools) -> tuple[float, float]:
    """Say how well values of any shape separate On from Off; bits have the same shape, with both kinds.

    Returns:
        The area under the ROC curve, which is the Mann-Whitney statistic over the number of pairs (Hanley and
        McNeil 1982): the chance that an On LED reads higher than an Off LED. And the least share of wrong
        decisions of any fixed threshold.

    Example:
        >>> values, bits = np.array([1.0, 2.0, 2.0, 3.0]), np.array([False, False, True, True])
        >>> separation(values, bits)
        (0.875, 0.25)
    """
    off, on = np.sort(values[~bits]), np.sort(values[bits])
    # A threshold takes its level and all higher ones for On. The best is that of an On LED, or above all.
    limits = np.append(on, np.inf)
    wrong = np.searchsorted(on, limits) + off.size - np.searchsorted(off, limits)
    pairs = mannwhitneyu(on, off).statistic
    return float(pairs / (on.size * off.size)), int(wrong.min()) / bits.size


def separable(values: Floats, bits: Bools) -> bool:
    """Whether some straight line or plane has all On on one side and all Off on the other.

    A linear program is feasible exactly where the convex hulls of On and Off are disjoint (Mangasarian,
    Operations Research 13, 1965).

    Args:
        values: (N,D), finite.
        bits: (N,), with both On and Off.

    Example:
        >>> square = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
        >>> separable(square, np.array([False, False, True, True]))
        True
        >>> separable(square, np.array([False, True, True, False]))
        False
    """
    scaled = (values - values.mean(axis=0)) / np.maximum(values.std(axis=0), 1e-12)
    points = np.column_stack([scaled, np.ones(len(scaled))])
    sides = np.where(bits, -1.0, 1.0)[:, None] * points
    margins, cost = np.full(len(sides), -1.0), np.zeros(sides.shape[1])
    return bool(linprog(cost, sides, margins, bounds=(None, None)).success)


def spread(source: Source, title: str, names: Sequence[str]) -> PaperFigure:
    """Draw features alone as histograms, and two of them, joined by ``+``, as clouds with FLDA's line.

    Several features are separated by the score of FLDA.
    """
    sample, bits = source.sample, source.sample.bits
    figure, axes = plots.sheet(len(names), title)
    numbers = {}
    for panel, name in zip(axes, names, strict=True):
        parts, label = name.split("+"), LABELS.get(name, "Score of FLDA")
        if name in sample.values:
            values = sample.values[name]
        else:
            chosen = [FEATURE_NAMES.index(part) for part in parts]
            pair, points = source.flda.select(chosen), sample.features[..., chosen]
            values = pair.decision_function(torch.from_numpy(points)).numpy()
            whole = points.reshape(-1, len(chosen))
            numbers[f"separable_{name}"] = float(separable(whole, bits.ravel()))
        if len(parts) == 2:
            line = (*pair.direction.tolist(), float(pair.threshold))
            labels = (LABELS[parts[0]], LABELS[parts[1]])
            led_plots.status_cloud(panel, whole, bits, labels, line)
        else:
            led_plots.status_histogram(panel, values, bits, label)
        area, wrong = separation(values, bits)
        numbers |= {f"auc_{name}": area, f"wrong_share_{name}": wrong}
        heading = f"{name}\nAUC {area:.4f}, wrong {wrong:.2%}"
        panel.set_title(heading, loc="left", fontsize=10)
    axes[0].legend(frameon=False)
    if "gri" in names:
        negative = sample.values["gri"] < 0
        numbers["negative_share_on"] = float(negative[bits].mean())
        numbers["negative_share_off"] = float(negative[~bits].mean())
    return PaperFigure(numbers, figure)
