"""Fig. 4: grey values of On and Off LEDs overlap between frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vocc_torch.errors import VoccError
from vocc_torch.measure.plan import Plan
from vocc_torch.studies.paper.evidence.data import Bools, Cell, FigureData, Floats, Picture, led_rows
from vocc_torch.studies.paper.evidence.sample import draw_sample
from vocc_torch.studies.paper.evidence.separation import least_error, roc_area
from vocc_torch.types import Scene


@dataclass(frozen=True)
class GreyOverlap(FigureData):
    """Average greys of the sample's LEDs, and the two frames that contradict each other most.

    Args:
        greys: (B,R,C) average grey of each LED's cell.
        bits: (B,R,C).
        pair: the frame with dark On LEDs and the frame with bright Off LEDs.
        pictures: those two panels.
        conditions: (2,4) their ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
        threshold: the best fixed threshold for all frames.
        wrong: share of LEDs that it gets wrong.
    """

    greys: Floats
    bits: Bools
    pair: tuple[int, int]
    pictures: tuple[Picture, Picture]
    conditions: Floats
    threshold: float
    wrong: float

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give a line an LED."""
        return led_rows(self.bits, {"average_grey": self.greys})

    def findings(self) -> dict[str, float]:
        """Give the pair's greys, how often frames overlap, and what a fixed threshold costs."""
        dark, bright = self.pair
        on = np.where(self.bits, self.greys, np.nan)
        off = np.where(self.bits, np.nan, self.greys)
        mean_on, mean_off = (class_means(self.greys, status) for status in (self.bits, ~self.bits))
        return {
            "dark_frame_highest_on_grey": float(np.nanmax(on[dark])),
            "dark_frame_mean_on_grey": float(mean_on[dark]),
            "bright_frame_lowest_off_grey": float(np.nanmin(off[bright])),
            "bright_frame_mean_off_grey": float(mean_off[bright]),
            "contradicting_pairs_share": float(np.mean(mean_on[:, None] < mean_off[None, :])),
            "best_fixed_threshold_grey": self.threshold,
            "best_fixed_threshold_wrong_share": self.wrong,
            "average_grey_auc": roc_area(self.greys, self.bits),
        }


def grey_overlap(plan: Plan) -> GreyOverlap:
    """Find the frame whose every On LED is farthest below every Off LED of another.

    Raises:
        VoccError: no frame has both On and Off LEDs.
    """
    sample = draw_sample(plan)
    pair = most_contradicting(sample.greys, sample.bits)
    wrong, threshold = least_error(sample.greys, sample.bits)
    return GreyOverlap(
        greys=sample.greys,
        bits=sample.bits,
        pair=pair,
        pictures=(sample.pictures[pair[0]], sample.pictures[pair[1]]),
        conditions=np.stack([conditions(sample.scene, frame) for frame in pair]),
        threshold=threshold,
        wrong=wrong,
    )


def most_contradicting(greys: Floats, bits: Bools) -> tuple[int, int]:
    """Index the frame with the lowest brightest On LED, and the one with the highest darkest Off LED.

    Example:
        >>> greys = np.array([[[110.0, 100.0]], [[180.0, 150.0]]])
        >>> most_contradicting(greys, np.array([[[True, False]], [[True, False]]]))
        (0, 1)
    """
    highest_on = np.where(bits, greys, -np.inf).max(axis=(1, 2))
    lowest_off = np.where(bits, np.inf, greys).min(axis=(1, 2))
    both = bits.any(axis=(1, 2)) & ~bits.all(axis=(1, 2))
    if not both.any():
        raise VoccError("no sample frame has both On and Off LEDs: the figure compares them")
    dark = int(np.where(both, highest_on, np.inf).argmin())
    return dark, int(np.where(both, lowest_off, -np.inf).argmax())


def class_means(greys: Floats, chosen: Bools) -> Floats:
    """Mean of each frame's chosen LEDs, (B,R,C) both to (B,); NaN where a frame has none.

    Example:
        >>> class_means(np.array([[[1.0, 3.0]], [[5.0, 6.0]]]), np.array([[[True, True]], [[False, False]]]))
        array([ 2., nan])
    """
    count = chosen.sum(axis=(1, 2))
    total = np.where(chosen, greys, 0.0).sum(axis=(1, 2))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def conditions(scene: Scene, frame: int) -> Floats:
    """Ambient light (lx), LED luminance (cd/m2), distance (m) and background grey of a frame, (4,).

    Example:
        >>> conditions(Scene.of(distance_m=40.0), 0).tolist()
        [8000.0, 3000.0, 40.0, 102.0]
    """
    values = (scene.ambient_lx, scene.led_luminance_cd_m2, scene.distance_m, scene.background_grey)
    return np.array([float(value[frame]) for value in values])
