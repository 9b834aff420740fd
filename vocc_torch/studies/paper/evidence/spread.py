"""Figs 8, 10 and 12: how grey values and features are spread over On and Off LEDs, alone and together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from vocc_torch.measure.plan import Plan
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.flda import FLDA
from vocc_torch.studies.paper.evidence.data import Bools, Cell, FigureData, Floats, Picture, led_rows
from vocc_torch.studies.paper.evidence.sample import Sample, draw_sample
from vocc_torch.studies.paper.evidence.separation import least_error, roc_area, separable

GALLERY = 20
"""Frames of the sample that Fig. 8a shows."""


@dataclass(frozen=True)
class Spread(FigureData):
    """Numbers of each LED by its status.

    Args:
        bits: (B,R,C).
        values: (B,R,C) each, by name; a name with ``+`` is the FLDA score of those features.
        auc: area under the ROC curve of each.
        wrong: share of wrong decisions at the best fixed threshold of each.
        lines: for a pair of features, FLDA fitted on these LEDs: (w_1, w_2, threshold).
    """

    bits: Bools
    values: Mapping[str, Floats]
    auc: Mapping[str, float]
    wrong: Mapping[str, float]
    lines: Mapping[str, tuple[float, float, float]]

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line an LED."""
        return led_rows(self.bits, self.values)

    def findings(self) -> dict[str, float]:
        """Give the discriminability of each number, and how often GRI is negative.

        ``separable_`` is 1 where some straight line or plane, FLDA's or another, parts all On LEDs from all
        Off LEDs.
        """
        found = {f"auc_{name}": value for name, value in self.auc.items()}
        found |= {f"wrong_share_{name}": value for name, value in self.wrong.items()}
        for name in self.values:
            if "+" in name:
                together = np.stack([self.values[part].ravel() for part in name.split("+")], axis=1)
                found[f"separable_{name}"] = float(separable(together, self.bits.ravel()))
        if "gri" in self.values:
            negative = self.values["gri"] < 0
            found["gri_negative_share_off"] = float(negative[~self.bits].mean())
            found["gri_negative_share_on"] = float(negative[self.bits].mean())
        return found


@dataclass(frozen=True)
class SpreadWithFrames(Spread):
    """The same, with some of the frames.

    Args:
        gallery: the first frames' panels.
    """

    gallery: tuple[Picture, ...]


def grey_and_agr(plan: Plan) -> SpreadWithFrames:
    """Fig. 8: average grey against average greyscale ratio."""
    sample = draw_sample(plan)
    values = {"average_grey": sample.greys, "agr": feature(sample, "agr")}
    return SpreadWithFrames(sample.bits, values, *_judged(values, sample.bits), {}, sample.pictures[:GALLERY])


def gri_and_agr(plan: Plan) -> Spread:
    """Fig. 10: gradient radial inwardness alone, and with AGR."""
    return _spread(draw_sample(plan), ("agr", "gri"), ("agr+gri",))


def ngr_and_others(plan: Plan) -> Spread:
    """Fig. 12: neighbour greyscale ratio alone, with AGR, with GRI, and all three."""
    return _spread(draw_sample(plan), FEATURE_NAMES, ("agr+gri", "agr+ngr", "gri+ngr", "agr+gri+ngr"))


def feature(sample: Sample, name: str) -> Floats:
    """Give one feature of the sample, (B,R,C)."""
    return sample.features[..., FEATURE_NAMES.index(name)]


def _spread(sample: Sample, singles: tuple[str, ...], together: tuple[str, ...]) -> Spread:
    """Score combinations of features beside the single ones."""
    values = {name: feature(sample, name) for name in singles}
    lines = {}
    features, bits = torch.from_numpy(sample.features), torch.from_numpy(sample.bits)
    whole = FLDA(len(FEATURE_NAMES)).fit(features, bits)
    for name in together:
        chosen = [FEATURE_NAMES.index(part) for part in name.split("+")]
        flda = whole.select(chosen)
        values[name] = flda.decision_function(features[..., chosen]).numpy()
        if len(chosen) == 2:
            first, second = flda.direction.tolist()
            lines[name] = (first, second, float(flda.threshold))
    return Spread(sample.bits, values, *_judged(values, sample.bits), lines)


def _judged(values: Mapping[str, Floats], bits: Bools) -> tuple[dict[str, float], dict[str, float]]:
    """Areas under the ROC curves, and least shares of wrong decisions."""
    areas = {name: roc_area(value, bits) for name, value in values.items()}
    return areas, {name: least_error(value, bits)[0] for name, value in values.items()}
