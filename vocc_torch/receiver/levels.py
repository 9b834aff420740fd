"""Two levels: values parted into dark and bright ones, and the light of grey values."""

import torch
from torch import Tensor

GAMMA = 2.2
"""Exponent of common cameras, between linear light and grey values."""


def linear_light(grey: Tensor) -> Tensor:
    """Undo the camera's gamma; white is 1, and grey values below 0 are black.

    Example:
        >>> linear_light(torch.tensor([0.0, 255.0])).tolist()
        [0.0, 1.0]
    """
    return (grey / 255).clamp(min=0) ** GAMMA


def grey_values(light: Tensor) -> Tensor:
    """Grey values, DN, of light of which 1 is white; more is white too, and less than 1e-5 counts as that.

    Example:
        >>> grey_values(torch.tensor([1.0, 7.0])).tolist()
        [255.0, 255.0]
    """
    return 255 * light.clamp(1e-5, 1.0) ** (1 / GAMMA)


LIGHT_OF_GREY = (
    (255 * linear_light(torch.arange(256, dtype=torch.float64))).float().numpy()
)
"""(256,) float32 light of each grey value, of which 255 is white: spots of light add, grey values do not."""


def two_levels(values: Tensor) -> tuple[Tensor, Tensor]:
    """Part values where the sum of squares within both parts is least: k-means in one dimension, exact.

    Args:
        values: (B,N), N at least 1.

    Returns:
        (B,) float64 limits, the middle between the two parts' means, and (B,2) these means; where all values
        are equal, that value.

    Example:
        >>> limits, means = two_levels(torch.tensor([[0.0, 1.0, 9.0, 10.0], [3.0, 3.0, 3.0, 3.0]]))
        >>> limits.tolist(), means.tolist()
        ([5.0, 3.0], [[0.5, 9.5], [3.0, 3.0]])
    """
    ordered = values.double().sort(dim=1).values
    count = ordered.shape[1]
    if count == 1:
        return ordered[:, 0], ordered.expand(-1, 2)
    below = torch.arange(1, count, dtype=torch.float64, device=values.device)
    # Relative to the least value, so that equal values differ by nothing at all.
    sums = (ordered - ordered[:, :1]).cumsum(dim=1)
    low = sums[:, :-1] / below
    high = (sums[:, -1:] - sums[:, :-1]) / (count - below)
    best = (below * (count - below) * (high - low).square()).argmax(dim=1, keepdim=True)
    parts = torch.cat([low.gather(1, best), high.gather(1, best)], dim=1)
    return ordered[:, 0] + parts.mean(dim=1), ordered[:, :1] + parts
