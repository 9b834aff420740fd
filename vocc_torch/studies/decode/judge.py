"""Criteria for doubtful readings."""

import torch

from vocc_torch.receiver.calibration import APPEARANCE
from vocc_torch.receiver.receiver import Decoded

DOUBTFUL_SCORE = 0.6
"""Noise that fills a 4:3 picture scores 0.56; of the paper's scenes one in fifty scores less than this."""
DOUBTFUL_MARGIN = 0.15
"""Smallest margin of an LED, as a share of the mean margin."""
DOUBTFUL_PARTED = 5.0
"""By :func:`parted`: with both limits 33 of the 46 panels that are marked have wrong bits
(``pytest -m slow -rP tests/studies/decode/test_judge.py``)."""
LEAST_PARTED = 6.0
"""By :func:`parted`: of 896 panels that were all On or all Off 889 are below."""

LEAST_CONTRAST = 40.0
"""Digital numbers from the darkest to the brightest cell: of 144 simulated panels of one level nine in ten have
less (paper, street and night), of 72 panels of random bits one in three."""


def is_one_level(read: Decoded) -> torch.Tensor:
    """Say which panels (B,) may be all On or all Off: scores that hardly part, and little contrast."""
    contrast = read.appearance[:, APPEARANCE.index("contrast")]
    apart = parted(read.scores, read.bits)
    return (apart < DOUBTFUL_PARTED) & (contrast < LEAST_CONTRAST)


def is_doubtful(read: Decoded) -> torch.Tensor:
    """Say which frames (B,) may hold no panel or be misread: a low score, or no gap between On and Off."""
    sure = read.scores.abs()
    close = sure.amin(dim=(1, 2)) < DOUBTFUL_MARGIN * sure.mean(dim=(1, 2))
    mixed = close & (parted(read.scores, read.bits) < DOUBTFUL_PARTED)
    return mixed | ((read.panel_score < DOUBTFUL_SCORE) & read.false_alarms.isnan())


def parted(scores: torch.Tensor, bits: torch.Tensor) -> torch.Tensor:
    """Say how far apart the scores of On and of Off lie, (B,), over their spread; 0 where all are alike.

    One level that is split in its middle gives about 2.7 where greys are normal, 3.5 where they are uniform.

    Args:
        scores: (B,R,C).
        bits: (B,R,C) bool.

    Example:
        >>> bits = torch.tensor([[[True, False], [True, False]], [[True, True], [True, True]]])
        >>> parted(torch.tensor([[[2.0, -2.0], [1.0, -1.0]], [[1.0, 2.0], [1.0, 2.0]]]), bits).tolist()
        [6.0, 0.0]
    """
    both = [
        (scores * one).sum(dim=(1, 2)) / one.sum(dim=(1, 2)) for one in (bits, ~bits)
    ]
    on, off = (one[:, None, None] for one in both)
    spread = (scores - torch.where(bits, on, off)).square().mean(dim=(1, 2)).sqrt()
    return ((both[0] - both[1]) / spread).nan_to_num(nan=0.0)
