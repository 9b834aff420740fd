"""Criteria for doubtful readings."""

from dataclasses import dataclass

import torch

from vocc_torch.receiver.calibration import APPEARANCE
from vocc_torch.receiver.receiver import Decoded


@dataclass(frozen=True)
class ReadingLimits:
    """Below these limits a reading is doubtful, or a panel may be all On or all Off."""

    # Noise that fills a 4:3 picture scores 0.56; of the paper's scenes one in fifty
    # scores less than this.
    score: float = 0.6
    margin: float = 0.15  # smallest of an LED, as a share of the mean margin
    least_margin: float = 0.02  # the same, however far On and Off lie apart
    # By :func:`parted`: with this limit and that of the margin 34 of the 47 panels that are marked have wrong
    # bits (``pytest -m slow -rP tests/studies/decode/test_judge.py``).
    parted: float = 5.0
    # By :func:`parted`, of a plane that is taken instead of luma: of 896 panels that
    # were all On or all Off 889 are below.
    least_parted: float = 6.0
    # Digital numbers from the darkest to the brightest cell: of 144 simulated panels of
    # one level nine in ten have less (paper, street and night), of 72 panels of random
    # bits one in three.
    contrast: float = 40.0


LIMITS = ReadingLimits()


def is_one_level(read: Decoded) -> torch.Tensor:
    """Say which panels (B,) may be all On or all Off: scores that hardly part, and little contrast."""
    contrast = read.appearance[:, APPEARANCE.index("contrast")]
    apart = parted(read.scores, read.bits)
    return (apart < LIMITS.parted) & (contrast < LIMITS.contrast)


def is_doubtful(read: Decoded) -> torch.Tensor:
    """Say which frames (B,) may hold no panel or be misread.

    The score is low, On and Off are not clearly apart, or one LED lies on the threshold.
    """
    sure = read.scores.abs()
    closest, mean = sure.amin(dim=(1, 2)), sure.mean(dim=(1, 2))
    close = closest < LIMITS.margin * mean
    mixed = close & (parted(read.scores, read.bits) < LIMITS.parted)
    mixed |= closest < LIMITS.least_margin * mean
    return mixed | ((read.panel_score < LIMITS.score) & read.false_alarms.isnan())


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
    sides = (1, 2)
    on, off = (
        (scores * group).sum(sides, True) / group.sum(sides, True)
        for group in (bits, ~bits)
    )
    squares = (scores - torch.where(bits, on, off)).square()
    return ((on - off).flatten() / squares.mean(sides).sqrt()).nan_to_num(nan=0.0)
