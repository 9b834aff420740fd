"""Convolutions of 3 x 3 by Winograd's way, where torch has it."""

from functools import lru_cache

import torch
from torch import Tensor, nn


class Convolution(nn.Conv2d):
    """A convolution of 3 x 3 with a margin of 1, at the quickest that torch has on a CPU.

    At stride 1 NNPACK's takes 0.6 of the time of oneDNN's, which torch chooses by itself, and knows no
    gradients. At stride 2 oneDNN's is quicker with channels last.

    Example:
        >>> layer, grey = Convolution(2, 3).requires_grad_(False), torch.rand(1, 2, 6, 8)
        >>> usual = nn.functional.conv2d(grey, layer.weight, layer.bias, padding=1)
        >>> bool((layer(grey) - usual).abs().max() < 1e-5)
        True
    """

    def __init__(self, before: int, after: int, stride: int = 1) -> None:
        super().__init__(before, after, 3, stride, 1)

    def forward(self, input: Tensor) -> Tensor:
        """Convolve (B,C,H,W)."""
        if self.stride != (1, 1):
            return super().forward(input.contiguous(memory_format=torch.channels_last))
        learns = torch.is_grad_enabled() and self.weight.requires_grad
        if not input.is_cpu or learns or not quick():
            return super().forward(input)
        return torch._nnpack_spatial_convolution(input, self.weight, self.bias, 1)


@lru_cache(maxsize=1)
def quick() -> bool:
    """Say whether torch has NNPACK on this machine."""
    return bool(torch._nnpack_available())
