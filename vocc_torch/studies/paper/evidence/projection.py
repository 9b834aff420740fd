"""Figs 13 and 14: the training LEDs projected on Fisher's discriminant vector w, and the threshold."""

from __future__ import annotations

from dataclasses import dataclass, replace

from vocc_torch.measure.plan import Plan
from vocc_torch.measure.train import train
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.studies.paper.evidence.data import Bools, Cell, FigureData, Floats
from vocc_torch.studies.paper.evidence.separation import roc_area


@dataclass(frozen=True)
class Projection(FigureData):
    """Features of training LEDs and their projections.

    Args:
        features: (N,3) AGR, GRI, NGR of the first training LEDs.
        bits: (N,).
        direction: (3,) w, Eq. 14.
        threshold: Eq. 19.
        projections: (N,) ``w . x``, Eq. 10.
        pair_direction: (2,) w on AGR and GRI alone.
        midpoint: (3,) halfway between the classes' means.
        deviation: (3,) standard deviation of each feature within the classes, pooled.
        frames: training frames.
    """

    features: Floats
    bits: Bools
    direction: Floats
    threshold: float
    projections: Floats
    pair_direction: Floats
    midpoint: Floats
    deviation: Floats
    frames: int

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line an LED."""
        leds = zip(self.bits.tolist(), self.features.tolist(), self.projections.tolist(), strict=True)
        lines = [(led, int(bit), *features, along) for led, (bit, features, along) in enumerate(leds)]
        return [("led", "bit", *FEATURE_NAMES, "projection"), *lines]

    def findings(self) -> dict[str, float]:
        """Give w, the threshold, and how the projections part the LEDs."""
        found = {}
        for index, name in enumerate(FEATURE_NAMES):
            found[f"w_{name}"] = float(self.direction[index])
            found[f"w_{name}_per_deviation"] = float(self.direction[index] * self.deviation[index])
        wrong = (self.projections >= self.threshold) != self.bits
        return found | {
            "threshold": self.threshold,
            "auc_projection": roc_area(self.projections, self.bits),
            "wrong_share_on": float(wrong[self.bits].mean()),
            "wrong_share_off": float(wrong[~self.bits].mean()),
        }


def projection(plan: Plan) -> Projection:
    """Train at the true corners on the plan's training frames, and project the LEDs that training keeps."""
    known = replace(plan, receiver=replace(plan.receiver, locator="truth"))
    training = train(known)
    flda, features = training.flda.cpu(), training.features.double().numpy()
    seen = flda.statistics
    direction = flda.direction.numpy()
    within = seen.scatter.sum(dim=0) / seen.count.sum()
    return Projection(
        features=features,
        bits=training.bits.numpy(),
        direction=direction,
        threshold=float(flda.threshold),
        projections=features @ direction,
        pair_direction=flda.select([0, 1]).direction.numpy(),
        midpoint=seen.mean.mean(dim=0).numpy(),
        deviation=within.diagonal().sqrt().numpy(),
        frames=training.frames,
    )
