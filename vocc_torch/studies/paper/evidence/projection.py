"""Figs 13 and 14: the training LEDs projected on Fisher's discriminant vector w, and the threshold."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vocc_torch.measure.plan import Plan
from vocc_torch.measure.train import train
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.show.canvas import INK, head
from vocc_torch.studies.paper.evidence import drawing
from vocc_torch.studies.paper.evidence.features import roc_area
from vocc_torch.studies.paper.evidence.figure import Bools, Cell, Floats, PaperFigure

SHOWN = 4000
"""LEDs in the cloud; more hide each other."""


@dataclass(frozen=True)
class Projection(PaperFigure):
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

    name = "fig13_14"
    title = "Figs 13 and 14: projection on Fisher's discriminant vector w"
    caption = "The vector w on which On and Off LEDs lie farthest apart for their spread, with the threshold."
    height_in = 5.6

    features: Floats
    bits: Bools
    direction: Floats
    threshold: float
    projections: Floats
    pair_direction: Floats
    midpoint: Floats
    deviation: Floats
    frames: int

    @classmethod
    def compute(cls, plan: Plan) -> Self:
        """Train at the true corners on the plan's training frames; project the LEDs that training keeps."""
        training = train(replace(plan, receiver=replace(plan.receiver, locator="truth")))
        flda, features = training.flda.cpu(), training.features.double().numpy()
        seen, direction = flda.statistics, flda.direction.numpy()
        within = seen.scatter.sum(dim=0) / seen.count.sum()
        return cls(
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

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line an LED."""
        leds = zip(self.bits.tolist(), self.features.tolist(), self.projections.tolist(), strict=True)
        lines = [(led, int(bit), *features, along) for led, (bit, features, along) in enumerate(leds)]
        return [("led", "bit", *FEATURE_NAMES, "projection"), *lines]

    def findings(self) -> dict[str, float]:
        """Give w, the threshold, and how the projections part the LEDs."""
        found: dict[str, float] = {}
        for name, weight, deviation in zip(
            FEATURE_NAMES, self.direction.tolist(), self.deviation.tolist(), strict=True
        ):
            found |= {f"w_{name}": weight, f"w_{name}_per_deviation": weight * deviation}
        wrong = (self.projections >= self.threshold) != self.bits
        return found | {
            "threshold": self.threshold,
            "auc_projection": roc_area(self.projections, self.bits),
            "wrong_share_on": float(wrong[self.bits].mean()),
            "wrong_share_off": float(wrong[~self.bits].mean()),
        }

    def draw_on(self, figure: Figure) -> str:
        """Draw w among the LEDs of two features, and the histogram of the projections of all three."""
        found = self.findings()
        axes = figure.add_axes((0.075, 0.215, 0.41, 0.62))
        self._draw_plane(axes)
        head(axes, "(a)", "w and its threshold for AGR and GRI alone")
        axes = figure.add_axes((0.575, 0.215, 0.41, 0.62))
        label = "Projection w \N{MIDDLE DOT} x of AGR, GRI and NGR"
        drawing.status_histogram(axes, self.projections, self.bits, label, log=True)
        axes.axvline(self.threshold, **drawing.DASHED)
        on, off = (drawing.percent_text(found[f"wrong_share_{status}"]) for status in ("on", "off"))
        head(axes, "(b)", f"wrong at {self.threshold:.2f}: {on} of On, {off} of Off")
        drawing.status_legend(figure)
        weights = [f"{name.upper()} {found[f'w_{name}_per_deviation']:.2f}" for name in FEATURE_NAMES]
        footnote = (
            f"FLDA trained on {self.frames} frames at the true corners; {len(self.bits)} of their LEDs "
            f"in (b), {min(SHOWN, len(self.bits))} in (a), placed by standard\n"
            "deviations within a class from the midpoint of the classes. "
            f"Weights in w for such a deviation: {', '.join(weights)}."
        )
        return footnote.replace("-", "\N{MINUS SIGN}")

    def _draw_plane(self, axes: Axes) -> None:
        """Draw two features over their deviations, w as an arrow and the threshold at a right angle to it."""
        deviation = self.deviation[:2]
        scaled = (self.features[:SHOWN, :2] - self.midpoint[:2]) / deviation
        labels = ("AGR (standard deviations)", "GRI (standard deviations)")
        drawing.status_cloud(axes, scaled[:, 0], scaled[:, 1], self.bits[:SHOWN], labels)
        along = self.pair_direction * deviation
        along = along / np.hypot(*along)
        across = np.array([-along[1], along[0]])
        reach = 1.03 * float(np.abs(scaled).max())
        axes.plot(*np.stack([-2 * reach * across, 2 * reach * across], axis=1), **drawing.DASHED)
        tip = 0.8 * reach * along
        arrow: dict[str, Any] = {"arrowstyle": "-|>", "color": INK, "linewidth": 2.0, "mutation_scale": 16}
        axes.annotate("", tuple(tip), tuple(-tip), arrowprops={**arrow, "shrinkA": 0, "shrinkB": 0})
        bold: dict[str, Any] = {"fontsize": 13, "fontweight": "bold", "color": INK}
        axes.annotate("w", tuple(tip), (7, -4), textcoords="offset points", **bold)
        # Both axes at one scale, so that the threshold stands at a right angle to w.
        box = axes.get_window_extent()
        axes.set_ylim(-reach, reach)
        axes.set_xlim(-reach * box.width / box.height, reach * box.width / box.height)
