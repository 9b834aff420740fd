"""The paper's baselines: a grey value against a threshold from preamble frames (its reference [10])."""

from __future__ import annotations

import torch
from torch import Tensor

from vocc_torch.errors import VoccError


def preamble_threshold(on_greys: Tensor, off_greys: Tensor) -> Tensor:
    """Threshold halfway between the mean grey of an all-On and of an all-Off preamble.

    Args:
        on_greys: (B,R,C) grey value of each LED in the all-On preamble of the same scene, finite.
        off_greys: (B,R,C) likewise, all Off.

    Returns:
        (B,1,1) float64 threshold. Where both preambles are equal it is that level: an LED at it reads On.
        It has no sign: with preambles that are swapped an LED still reads On where it is the brighter.

    Raises:
        VoccError: a grey value that is not finite.

    Example:
        >>> float(preamble_threshold(torch.full((1, 2, 2), 200.0), torch.full((1, 2, 2), 100.0)))
        150.0
    """
    # In float64 the mean of equal float32 values is that value, whatever their number.
    on, off = (greys.mean(dim=(1, 2), keepdim=True, dtype=torch.float64) for greys in (on_greys, off_greys))
    threshold = (on + off) / 2
    if not bool(threshold.isfinite().all()):
        raise VoccError("preambles hold grey values that are not finite: each must be finite")
    return threshold


def greyscale_scores(greys: Tensor, threshold: Tensor) -> Tensor:
    """Grey values above the threshold, (B,R,C) and (B,1,1) to (B,R,C) float64; at least 0, so 0 too, is On.

    Raises:
        VoccError: a grey value or threshold that is not finite.

    Example:
        >>> greyscale_scores(torch.tensor([[[160.0, 140.0]]]), torch.tensor([[[150.0]]])).tolist()
        [[[10.0, -10.0]]]
    """
    scores = greys.to(torch.float64) - threshold
    if not bool(scores.isfinite().all()):
        raise VoccError("grey values or thresholds give a score that is not finite: both must be finite")
    return scores
