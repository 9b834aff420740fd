"""The paper's baselines: a grey value against a threshold from preamble frames (its reference [10])."""

from __future__ import annotations

import torch
from torch import Tensor


def preamble_threshold(on_greys: Tensor, off_greys: Tensor) -> Tensor:
    """Threshold halfway between the mean grey of an all-On and of an all-Off preamble.

    Args:
        on_greys: (B,R,C) grey value of each LED in the all-On preamble of the same scene.
        off_greys: (B,R,C) likewise, all Off.

    Returns:
        (B,1,1) threshold. Where both preambles are equal it is that level: an LED at it reads On.

    Example:
        >>> float(preamble_threshold(torch.full((1, 2, 2), 200.0), torch.full((1, 2, 2), 100.0)))
        150.0
    """
    return (on_greys.mean(dim=(1, 2), keepdim=True) + off_greys.mean(dim=(1, 2), keepdim=True)) / 2


def greyscale_scores(greys: Tensor, threshold: Tensor) -> Tensor:
    """Grey values above the threshold, (B,R,C) and (B,1,1) to (B,R,C); at least 0 is On.

    Example:
        >>> greyscale_scores(torch.tensor([[[160.0, 140.0]]]), torch.tensor([[[150.0]]])).tolist()
        [[[10.0, -10.0]]]
    """
    return (greys - threshold).to(torch.float64)
