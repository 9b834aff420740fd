"""Figs 8, 10 and 12 to 14: how grey values and features tell On LEDs from Off LEDs, alone and together."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.optimize import linprog
from scipy.stats import mannwhitneyu

from vocc_torch.measure.grid import Bools, Floats
from vocc_torch.measure.train import train
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.flda import FLDA
from vocc_torch.studies.paper.evidence import (
    Draw,
    PaperFigure,
    Sample,
    Source,
    drawing,
    led_rows,
)

LABELS = {
    "average_grey": "Average grey of an LED (0 to 255)",
    "agr": "AGR (ratio)",
    "gri": "GRI (grey values a pixel)",
    "ngr": "NGR (ratio)",
}
"""Axes of what tells On from Off."""


@dataclass(frozen=True)
class Separation:
    """How well a number tells On LEDs from Off LEDs.

    Args:
        auc: area under the ROC curve, the chance that an On LED reads higher than an Off LED.
        wrong_share: least share of wrong decisions of any fixed threshold.
        threshold: the lowest such threshold.
    """

    auc: float
    wrong_share: float
    threshold: float

    @classmethod
    def of(cls, values: Floats, bits: Bools) -> "Separation":
        """Separate values of any shape by bits of the same shape, with both On and Off.

        The area is the Mann-Whitney statistic over the number of pairs (Hanley and McNeil 1982).

        Example:
            >>> values, bits = np.array([1.0, 2.0, 2.0, 3.0]), np.array([False, False, True, True])
            >>> Separation.of(values, bits)
            Separation(auc=0.875, wrong_share=0.25, threshold=1.5)
        """
        on, off = np.sort(values[bits]), np.sort(values[~bits])
        statistic = mannwhitneyu(on, off, method="asymptotic").statistic
        levels = np.unique(values)
        ends = np.nextafter(levels[-1:], np.inf)
        thresholds = np.concatenate([levels[:1], (levels[1:] + levels[:-1]) / 2, ends])
        wrong = (
            np.searchsorted(on, thresholds)
            + len(off)
            - np.searchsorted(off, thresholds)
        )
        best = int(wrong.argmin())
        area = float(statistic) / (len(on) * len(off))
        return cls(area, float(wrong[best]) / bits.size, float(thresholds[best]))

    @property
    def text(self) -> str:
        """The separation for a heading."""
        return f"AUC {self.auc:.4f}, wrong {self.wrong_share:.2%}"


def separable(values: Floats, bits: Bools) -> bool:
    """Whether some straight line or plane has all On on one side and all Off on the other.

    The largest margin of any line with weights from -1 to 1 is a linear program; it is above 0 exactly where
    the convex hulls of On and Off are disjoint (Mangasarian, Operations Research 13, 1965).

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
    deviation, columns = values.std(axis=0), values.shape[1]
    scaled = (values - values.mean(axis=0)) / np.where(deviation > 0, deviation, 1.0)
    sides = np.where(bits, 1.0, -1.0)[:, None] * np.column_stack(
        [scaled, np.ones(len(scaled))]
    )
    # Unknown are the weights, the offset and the margin, which is made large.
    cost = np.append(np.zeros(columns + 1), -1.0)
    ranges = [(-1.0, 1.0)] * columns + [(None, None)] * 2
    constraints = np.column_stack([-sides, np.ones(len(sides))])
    found = linprog(cost, A_ub=constraints, b_ub=np.zeros(len(sides)), bounds=ranges)
    return bool(found.success and (sides @ found.x[:-1]).min() > 0)


def spread(
    sample: Sample, names: list[str], first: dict[str, Draw] | None = None
) -> PaperFigure:
    """Draw features alone as histograms, and features together, joined by ``+``, as clouds.

    Args:
        sample: the sample.
        names: of features, or of several joined by ``+``.
        first: panels before them.
    """
    values: dict[str, Floats] = {"average_grey": sample.greys, **sample.features}
    panels = dict(first or {})
    numbers: dict[str, float] = {}
    stacked = torch.from_numpy(np.stack(list(sample.features.values()), axis=-1))
    flda = FLDA(len(FEATURE_NAMES)).fit(stacked, torch.from_numpy(sample.bits))
    for name in names:
        parts = name.split("+")
        line = None
        if len(parts) > 1:
            chosen = [FEATURE_NAMES.index(part) for part in parts]
            pair = flda.select(chosen)
            values[name] = pair.decision_function(stacked[..., chosen]).numpy()
            points = np.stack([values[part].ravel() for part in parts], axis=1)
            numbers[f"separable_{name}"] = float(separable(points, sample.bits.ravel()))
            if len(parts) == 2:
                line = (*pair.direction.tolist(), float(pair.threshold))
        found = Separation.of(values[name], sample.bits)
        numbers[f"auc_{name}"], numbers[f"wrong_share_{name}"] = (
            found.auc,
            found.wrong_share,
        )
        label = LABELS.get(name, "score of FLDA")
        if len(parts) == 2:
            x, y = (values[part] for part in parts)
            draw = drawing.cloud(
                x, y, sample.bits, (LABELS[parts[0]], LABELS[parts[1]]), line
            )
        else:
            draw = drawing.histogram(values[name], sample.bits, label, found.threshold)
        panels[f"{name.upper().replace('_', ' ')}\n{found.text}"] = draw
    rows = led_rows(sample.bits, {name: values[name] for name in names})
    return PaperFigure(rows, numbers, panels)


def grey_and_agr(source: Source) -> PaperFigure:
    """Fig. 8: twenty of the frames, and the distributions of average grey and of AGR."""
    shown = source.sample.panels[:20]
    rows = [
        np.hstack(list(shown[first : first + 5]))
        for first in range(0, len(shown) // 5 * 5, 5)
    ]
    gallery = (
        {f"{len(rows) * 5} of the frames": drawing.picture(np.vstack(rows))}
        if rows
        else {}
    )
    return spread(source.sample, ["average_grey", "agr"], gallery)


def gri_and_agr(source: Source) -> PaperFigure:
    """Fig. 10: the distribution of GRI, and GRI against AGR."""
    return spread(source.sample, ["gri", "agr+gri"])


def ngr_and_others(source: Source) -> PaperFigure:
    """Fig. 12: the distribution of NGR, NGR against either of the others, and all three."""
    return spread(
        source.sample,
        ["agr", "gri", "ngr", "agr+gri", "agr+ngr", "gri+ngr", "agr+gri+ngr"],
    )


def projection(source: Source) -> PaperFigure:
    """Figs 13 and 14: training LEDs and their projections on w, trained at the true corners."""
    training = train(
        replace(source.plan, receiver=replace(source.plan.receiver, locator="truth"))
    )
    flda, bits = training.flda.cpu(), training.bits.numpy()
    features, threshold = training.features.double().numpy(), float(flda.threshold)
    projections = features @ flda.direction.numpy()
    wrong = (projections >= threshold) != bits
    numbers = {
        f"w_{name}": weight
        for name, weight in zip(FEATURE_NAMES, flda.direction.tolist(), strict=True)
    }
    numbers |= {
        "threshold": threshold,
        "auc_projection": Separation.of(projections, bits).auc,
    }
    numbers |= {
        "wrong_share_on": float(wrong[bits].mean()),
        "wrong_share_off": float(wrong[~bits].mean()),
    }
    lines = np.column_stack([bits, features, projections]).tolist()
    pair = flda.select([0, 1])
    line = (*pair.direction.tolist(), float(pair.threshold))
    clouded = drawing.cloud(
        features[:4000, 0],
        features[:4000, 1],
        bits[:4000],
        (LABELS["agr"], LABELS["gri"]),
        line,
    )
    label = "Projection w \N{MIDDLE DOT} x of AGR, GRI and NGR"
    panels = {
        "threshold for AGR and GRI alone": clouded,
        "projections of all three": drawing.histogram(
            projections, bits, label, threshold, log=True
        ),
    }
    return PaperFigure(
        [("bit", *FEATURE_NAMES, "projection"), *map(tuple, lines)], numbers, panels
    )
