"""What the networks have in common: convolutions of 3 x 3, and the grey values that they see."""

from torch import Tensor, nn


def convolution(before: int, after: int, stride: int = 1) -> nn.Conv2d:
    """Give a convolution of 3 x 3 with a margin of 1."""
    return nn.Conv2d(before, after, 3, stride, 1)


def standardised(pictures: Tensor, grain: float, most: float) -> Tensor:
    """Give pictures (n,H,W) without their mean, in standard deviations.

    Args:
        pictures: grey values.
        grain: variance that counts as no contrast.
        most: deviations, beyond which values are cut.

    Example:
        >>> import torch
        >>> standardised(torch.tensor([[[1.0, 3.0], [5.0, 7.0]]]), 4.0, 1.0).tolist()
        [[[-1.0, -0.3333333432674408], [0.3333333432674408, 1.0]]]
    """
    light = pictures - pictures.mean((1, 2), keepdim=True)
    spread = light.square().mean((1, 2), keepdim=True)
    return (light / (spread + grain).sqrt()).clamp(-most, most)
