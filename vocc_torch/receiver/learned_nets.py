"""The learned locator's two networks, told the panel's rows and columns, and how pictures are read for them.

Neither sees a whole panel's bits: one sees texture from afar on a pyramid of scales, the other a corner.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from vocc_torch.types import PanelShape

PITCH_PX = 2.1213
"""Pitch of a panel for which a scale of the pyramid is the right one, px; scales differ by 2."""

STRIDE_PX, PATCH = 8, 32
"""Pixels of a scale between the finder's places, and samples along a corner's patch."""

CORNER_CELLS = 4
"""Cells from a corner to its patch's border, at zoom 1."""

_BORDER_PX, _CHANNELS, _POOLED = 16, (16, 32), 8


class Finder(nn.Module):
    """Where a panel of R x C cells of about 1.5 to 3 px may lie, at every 8th pixel.

    Absolute values of filters of mean 0, over the local contrast: neither the light's level nor its sign, a
    panel darker than its surroundings, changes what it sees. What is told of R and C: means over boxes of
    the panel's extent and of twice that, and their logarithms. Fully convolutional: any size of picture.

    Example:
        >>> Finder()(torch.zeros(1, 1, 64, 96), PanelShape(8, 8)).shape
        torch.Size([1, 5, 8, 12])
    """

    def __init__(self) -> None:
        super().__init__()
        first, n = _CHANNELS
        self.stem = nn.Conv2d(1, first, 8, 4, 2, bias=False)
        self.wide = nn.Conv2d(first, n, 3, 2, 1, bias=False)
        self.lift = nn.Parameter(torch.zeros(n, 1, 1))
        self.spread = nn.ModuleList(
            nn.Sequential(nn.Conv2d(n, n, 3, 1, d, d, groups=n), nn.Conv2d(n, n, 1), nn.ReLU())
            for d in (1, 1, 2)
        )
        self.narrow = nn.Conv2d(n, _POOLED, 1)
        self.hidden = nn.Conv2d(n + 2 * _POOLED, n, 1)
        self.told = nn.Linear(2, n)
        self.judge = nn.Conv2d(n, 5, 1)

    def forward(self, grey: Tensor, shape: PanelShape) -> Tensor:
        """Judge places.

        Args:
            grey: (B,1,H,W) grey values.
            shape: rows and columns.

        Returns:
            (B,5,h,w) with h and w the sides over 8, rounded up: logit, the panel's centre from the place in
            half sides (x, y), logarithm of its pitch over ``PITCH_PX``, turn in radians.
        """
        height, width = grey.shape[-2:]
        high, wide = (-(-side // STRIDE_PX) for side in (height, width))
        more = [_BORDER_PX, wide * STRIDE_PX - width + _BORDER_PX]
        more += [_BORDER_PX, high * STRIDE_PX - height + _BORDER_PX]
        padded = nn.functional.pad(grey, more, mode="replicate")
        kernel = self.stem.weight - self.stem.weight.mean((1, 2, 3), keepdim=True)
        seen = nn.functional.conv2d(padded, kernel, stride=4, padding=2).abs()
        contrast = nn.functional.avg_pool2d(seen.mean(1, keepdim=True), 2, ceil_mode=True)
        contrast = nn.functional.avg_pool2d(contrast, 5, 1, 2, count_include_pad=False)
        seen = (self.wide(seen) / (contrast + 1.0) + self.lift).relu()
        for block in self.spread:
            seen = block(seen)
        pooled, parts = self.narrow(seen), [seen]
        for size in (1, 2):
            for axis, leds in enumerate((shape.rows, shape.columns)):
                half = max(0, round((size * leds * PITCH_PX / STRIDE_PX - 1) / 2))
                side, around = [1, 1], [0, 0]
                side[axis], around[axis] = 2 * half + 1, half
                pooled = nn.functional.avg_pool2d(pooled, side, 1, around, count_include_pad=False)
            parts.append(pooled)
        cut = _BORDER_PX // STRIDE_PX
        told = self.told(seen.new_tensor([math.log2(shape.rows) / 4, math.log2(shape.columns) / 4]))
        judged: Tensor = self.judge((self.hidden(torch.cat(parts, 1)) + told[:, None, None]).relu())
        return judged[..., cut : cut + high, cut : cut + wide]


class CornerNet(nn.Module):
    """Where the grid's corner lies in a patch about a guess of it, whose inside is always at the lower right.

    Example:
        >>> CornerNet()(torch.rand(5, 1, 32, 32), torch.zeros(5, 3)).shape
        torch.Size([5, 3])
    """

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for before, after, stride in ((1, 16, 1), (16, 32, 2), (32, 48, 2), (48, 64, 2)):
            layers += [nn.Conv2d(before, after, 3, stride, 1), nn.ReLU()]
        self.see = nn.Sequential(*layers, nn.Flatten())
        self.judge = nn.Sequential(nn.Linear(64 * (PATCH // 8) ** 2 + 3, 64), nn.ReLU(), nn.Linear(64, 3))

    def forward(self, patches: Tensor, told: Tensor) -> Tensor:
        """Judge (n,1,32,32) patches, told (n,3) of log2 of rows, columns and zoom: the corner, and a logit.

        Returns:
            (n,3): the corner's place from the patch's middle along the two sides that meet there, in half
            patches, and the logit of its being a panel's corner and in the middle.
        """
        mean = patches.mean((2, 3), keepdim=True)
        spread = (patches - mean).square().mean((2, 3), keepdim=True)
        seen = self.see((patches - mean) / (spread + 4.0).sqrt())
        judged: Tensor = self.judge(torch.cat([seen, told / 4], 1))
        return judged


def pyramid(grey: Tensor, most: int = 6) -> list[Tensor]:
    """Halve grey values (B,1,H,W) again and again while 16 px are left: float32 pictures, largest first.

    Example:
        >>> [tuple(one.shape[2:]) for one in pyramid(torch.zeros(1, 1, 64, 80))]
        [(64, 80), (32, 40), (16, 20)]
    """
    scales = [grey.to(torch.float32)]
    while len(scales) < most and min(scales[-1].shape[-2:]) >= 32:
        scales.append(nn.functional.avg_pool2d(scales[-1], 2))
    return scales


def corner_frames(corners_px: Tensor, shape: PanelShape) -> Tensor:
    """Give each corner's two vectors, (n,4,2,2), one cell along the row and the column, to the inside."""
    across, down = (corners_px[:, [1, 0, 3, 2]] - corners_px), (corners_px[:, [3, 2, 1, 0]] - corners_px)
    return torch.stack([across / shape.columns, down / shape.rows], 2)


def corner_patches(
    scales: Sequence[Tensor],
    frame: Tensor,
    level: Tensor,
    corners_px: Tensor,
    shape: PanelShape,
    zoom: Tensor,
) -> Tensor:
    """Read the patches about the corners of n quadrilaterals, (4n,1,32,32).

    Args:
        scales: a pyramid of B pictures.
        frame: (n,) of them.
        level: (n,) scale to read, 0 being the largest.
        corners_px: (n,4,2) float32 px of the largest.
        shape: rows and columns.
        zoom: (n,) patches of 32 samples reach ``CORNER_CELLS`` times this far.
    """
    steps = ((torch.arange(PATCH, device=zoom.device) + 0.5) / PATCH * 2 - 1) * CORNER_CELLS
    axes = corner_frames(corners_px, shape) * zoom.view(-1, 1, 1, 1)
    x = axes[:, :, 0, None, None, :] * steps[:, None]
    points = corners_px[:, :, None, None] + x + axes[:, :, 1, None, None, :] * steps[:, None, None]
    patches = scales[0].new_empty(len(frame), 4 * PATCH * PATCH)
    for one in sorted(set(level.tolist())):
        rows = (level == one).nonzero()[:, 0]
        at = points[rows].flatten(1, 3) / 2**one - 0.5
        plane = scales[one][:, 0]
        patches[rows] = _bilinear(plane, frame[rows], at)
    return patches.view(-1, 1, PATCH, PATCH)


def _bilinear(planes: Tensor, frame: Tensor, at: Tensor) -> Tensor:
    """Read planes (B,H,W) at points (n,P,2) of ``frame``, pixel centres at whole numbers; borders go on."""
    height, width = planes.shape[-2:]
    at = torch.stack([at[..., 0].clamp(0, width - 1), at[..., 1].clamp(0, height - 1)], -1)
    first = at.floor()
    share, (left, top) = (at - first).to(planes.dtype), first.long().unbind(-1)
    begin = frame[:, None] * (height * width)
    flat, rows = planes.flatten(), (top, (top + 1).clamp(max=height - 1))
    columns = (left, (left + 1).clamp(max=width - 1))
    near = [flat[begin + row * width + column] for row in rows for column in columns]
    upper, lower = (torch.lerp(near[i], near[i + 1], share[..., 0]) for i in (0, 2))
    return torch.lerp(upper, lower, share[..., 1])


def places_px(size: tuple[int, int]) -> Tensor:
    """Give the finder's places (2,h,w) in px of the scale: columns, then rows.

    Example:
        >>> places_px((1, 3))[0].tolist()
        [[2.0, 10.0, 18.0]]
    """
    rows, columns = (torch.arange(n, dtype=torch.float32) * STRIDE_PX + 2 for n in size)
    return torch.stack([columns.expand(size), rows[:, None].expand(size)])
