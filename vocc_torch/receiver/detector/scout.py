"""The scout: a fully convolutional network that proposes where panels are, at any level of a pyramid."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from vocc_torch.receiver.detector import pyramid as pyramids
from vocc_torch.receiver.detector.layers import convolution
from vocc_torch.receiver.detector.pyramid import Pyramid, gate
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class ScoutSettings:
    """What the scout gives."""

    # LEDs along a side at which small, middle and large panels part.
    sizes: tuple[float, ...] = (5.6, 11.3)
    stride_px: int = 8  # between its outputs
    unit_px: float = 16.0  # of the corners that it gives
    peak_cells: int = 3  # a candidate is the best of so many outputs a side
    candidates: int = 16  # of a frame
    behind: float = 2.5  # log odds of the best, beyond which others are no candidates
    peaks: int = 64  # of the larger levels, and of the smaller ones
    same: float = 0.3  # centres nearer than this share of a side are of one candidate, if sizes are alike
    alike: float = 1.4  # ratio of sizes that are alike
    gated_px: int = 200_000  # larger levels are looked at in tiles
    margin_px: int = 16  # around a level
    rare_logit: float = -4.0  # of the score before any training: panels are rare


SETTINGS = ScoutSettings()

SCORES = len(SETTINGS.sizes) + 1
"""A score for each size of panels."""

OUTPUTS = SCORES + 8
"""Scores and the moves of four corners."""


class Scout(nn.Module):
    """Convolutions at strides 4, 8 and 16, the coarser ones added to the finer ones.

    Example:
        >>> Scout()(torch.zeros(1, 1, 64, 96)).shape
        torch.Size([1, 11, 8, 12])
    """

    sides_px: ClassVar[int] = 16
    """Its pictures' sides are multiples of this."""

    def __init__(self) -> None:
        super().__init__()
        self.block = nn.Conv2d(1, 12, 4, 4)
        self.fine = nn.Sequential(
            convolution(12, 16, 2),
            nn.ReLU(inplace=True),
            convolution(16, 16),
            nn.ReLU(inplace=True),
            convolution(16, 16),
            nn.ReLU(inplace=True),
        )
        self.coarse = nn.Sequential(
            convolution(16, 24, 2),
            nn.ReLU(inplace=True),
            convolution(24, 24),
            nn.ReLU(inplace=True),
            convolution(24, 24),
            nn.ReLU(inplace=True),
            nn.Conv2d(24, 16, 1),
        )
        last = nn.Conv2d(16, OUTPUTS, 1)
        self.head = nn.Sequential(convolution(16, 16), nn.ReLU(inplace=True), last)
        last.bias = nn.Parameter(
            torch.tensor([SETTINGS.rare_logit] * SCORES + [0.0] * 8)
        )

    def forward(self, grey: Tensor) -> Tensor:
        """Score grey values (B,1,H,W), 0 to 255, sides multiples of 16, to (B,11,H/8,W/8)."""
        # Grey values become -1 to 3 by the first layer's own weights.
        weight = self.block.weight
        assert self.block.bias is not None
        bias = self.block.bias - weight.sum((1, 2, 3))
        blocks = functional.conv2d(grey.float(), weight / 64, bias, self.block.stride)
        fine = self.fine(blocks.relu_())
        coarse = functional.interpolate(self.coarse(fine), scale_factor=2.0)
        out: Tensor = self.head((fine + coarse).relu_())
        return out


def quads_of(outputs: Tensor, places: Tensor) -> Tensor:
    """Give corners (n,4,2), px, of outputs (n,11) at places (n,2), columns and rows of the output."""
    centre = (places.to(outputs) + 0.5) * SETTINGS.stride_px
    return centre[:, None] + SETTINGS.unit_px * outputs[:, SCORES:].view(-1, 4, 2)


def size_of(shape: PanelShape) -> int:
    """Give the number of the score for panels of a shape.

    Example:
        >>> [size_of(PanelShape(*sides)) for sides in ((4, 4), (4, 8), (8, 8), (8, 16))]
        [0, 1, 1, 2]
    """
    return sum(math.sqrt(shape.leds) >= side for side in SETTINGS.sizes)


class Peaks(NamedTuple):
    """Places where a score is the best about.

    Args:
        picture: (n,) int64.
        place: (n,2) int64 columns and rows of the output.
        quads: (n,4,2) px of the picture.
        score: (n,).
    """

    picture: Tensor
    place: Tensor
    quads: Tensor
    score: Tensor


def peaks(score: Tensor, outputs: Tensor, most: int) -> Peaks:
    """Take the best local maxima of a score (B,h,w), with the corners of outputs (B,11,h,w)."""
    best = functional.max_pool2d(
        score[:, None], SETTINGS.peak_cells, 1, SETTINGS.peak_cells // 2
    )[:, 0]
    flat = score.masked_fill(score < best, -torch.inf).flatten()
    values, order = flat.topk(min(most, len(flat)))
    order = order[values > -torch.inf]
    high, wide = outputs.shape[2:]
    picture, row, column = order // (high * wide), order // wide % high, order % wide
    place = torch.stack([column, row], 1)
    quads = quads_of(outputs[picture, :, row, column], place)
    return Peaks(picture, place, quads, flat[order])


def distinct(quads: Tensor, score: Tensor, most: int) -> Tensor:
    """Return the rows of the best candidates, at most one for each place."""
    order = score.argsort(descending=True, stable=True)
    return order[firsts(same_place(quads[order]), most)]


def firsts(same: Tensor, most: int) -> list[int]:
    """Choose the first candidates of which none is the same, (n,n) bool, as one chosen before.

    Example:
        >>> firsts(torch.eye(4).bool() | torch.tensor([False, True, False, False]), 2)
        [0, 2]
    """
    left = same.cpu().numpy()
    chosen: list[int] = []
    taken = np.zeros(len(left), bool)
    while len(chosen) < most and not taken.all():
        chosen.append(int(taken.argmin()))
        taken |= left[chosen[-1]]
    return chosen


def same_place(quads: Tensor) -> Tensor:
    """Say which candidates (...,n,4,2) are of one place and alike in size, (...,n,n) bool."""
    centre = quads.mean(-2)
    size = (quads[..., 0, :] - quads[..., 2, :]).norm(dim=-1).clamp(min=1e-6)
    sizes, others = size[..., None], size[..., None, :]
    near = torch.cdist(centre, centre) < SETTINGS.same * torch.minimum(sizes, others)
    alike: Tensor = (sizes / others).log().abs() < math.log(SETTINGS.alike)
    return near & alike


def propose(
    net: nn.Module, pyramid: Pyramid, shape: PanelShape
) -> tuple[Tensor, Tensor, Tensor]:
    """Find the best candidates of a frame.

    Args:
        net: the scout.
        pyramid: of the frame.
        shape: rows and columns.

    Returns:
        Corners (n,4,2) float64 px, scores (n,) and levels (n,), the best first.
    """
    levels = pyramid.levels
    large = sum(level.numel() > SETTINGS.gated_px for level in levels)
    size = size_of(shape)
    looks = [look(net, levels, large, size) for look in (_in_tiles, _in_canvas)]
    corners, score, level = map(torch.cat, zip(*looks, strict=True))
    near = (score > score.amax() - SETTINGS.behind).nonzero()[:, 0]
    rows = near[distinct(corners[near], score[near], SETTINGS.candidates)]
    return corners[rows], score[rows], level[rows]


def _in_canvas(
    net: nn.Module, levels: Sequence[Tensor], large: int, size: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Look at all of the smaller levels (H,W) in one picture, with margins of a mean grey value around."""
    small = levels[large:]
    if not small:
        return _nothing(levels[0])
    step = SETTINGS.stride_px
    sides = [tuple(level.shape) for level in small]
    origins, (tall, broad) = canvas_of(sides)
    mean = small[-1].float().mean().round().byte()
    canvas = mean.expand(1, 1, tall, broad).contiguous()
    # Outputs belong to a level as far as one beyond its edges.
    owner = torch.full((tall // step, broad // step), -1, device=mean.device)
    for number, ((high, wide), (top, left)) in enumerate(
        zip(sides, origins, strict=True)
    ):
        canvas[0, 0, top : top + high, left : left + wide] = small[number]
        rows = slice(top // step - 1, -(-(top + high) // step) + 1)
        owner[rows, left // step - 1 : -(-(left + wide) // step) + 1] = number
    origin = torch.tensor(origins, device=mean.device).flip(1)
    level = torch.arange(large, len(levels), device=mean.device)
    return _best(net(canvas), size, owner[None], origin, level)


def _best(
    outputs: Tensor, size: int, owner: Tensor, origin: Tensor, level: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Take the best outputs (B,11,h,w) for panels of a size.

    Args:
        outputs: of the scout.
        size: number of the score.
        owner: (B,h,w) number of the part of a level that an output belongs to, -1 for none.
        origin: (n,2) px of parts in their pictures.
        level: (n,) of parts.

    Returns:
        Corners (n,4,2) px of the frame, scores (n,) and levels (n,).
    """
    score = outputs[:, size].masked_fill(owner < 0, -torch.inf)
    found = peaks(score, outputs, SETTINGS.peaks)
    column, row = found.place.unbind(1)
    part = owner[found.picture, row, column]
    quads = found.quads.double() - origin[part, None]
    return quads * 2.0 ** level[part, None, None], found.score, level[part]


def _nothing(like: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    none = torch.zeros(0, 4, 2, dtype=torch.float64, device=like.device)
    return none, none[:, 0, 0].float(), none[:, 0, 0].long()


def canvas_of(
    sides: Sequence[tuple[int, ...]],
) -> tuple[list[tuple[int, int]], tuple[int, int]]:
    """Put levels into one picture, the first on the left, the others in a column beside it.

    Args:
        sides: (height, width) of the levels, the largest first.

    Returns:
        (top, left) of each level, and (height, width) of the picture.

    Example:
        >>> canvas_of([(50, 100), (25, 50), (12, 25)])
        ([(16, 16), (16, 144), (64, 144)], (96, 224))
    """
    step, margin = 2 * SETTINGS.stride_px, SETTINGS.margin_px
    beyond = [
        tuple(-(-side // step) * step + margin for side in size) for size in sides
    ]
    left = margin + beyond[0][1]
    origins, top = [(margin, margin)], margin
    for high, _ in beyond[1:]:
        origins.append((top, left))
        top += high
    wide = max((wide for _, wide in beyond[1:]), default=0)
    return origins, (max(top, margin + beyond[0][0]), left + wide)


def _in_tiles(
    net: nn.Module, levels: Sequence[Tensor], large: int, size: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Look at the tiles of the larger levels (H,W) that the gate chooses."""
    if not large:
        return _nothing(levels[0])
    tile, margin = pyramids.SETTINGS.tile_px, pyramids.SETTINGS.margin_px
    side = tile + 2 * margin
    tiles, places, numbers = [], [], []
    for number, level in enumerate(levels[:large]):
        chosen = gate(level) * tile - margin
        mean = int(level[::margin, ::margin].float().mean())
        views = level.new_full((len(chosen), 1, side, side), mean)
        for view, (top, left) in zip(views, chosen.tolist(), strict=True):
            part = level[max(top, 0) : top + side, max(left, 0) : left + side]
            high, wide = part.shape
            view[0, max(-top, 0) :, max(-left, 0) :][:high, :wide] = part
        tiles.append(views)
        places.append(-chosen.flip(1))
        numbers.append(torch.full_like(chosen[:, 0], number))
    level, inner = torch.cat(numbers), tile // SETTINGS.stride_px
    owner = torch.arange(len(level), device=level.device)[:, None, None]
    edges = (margin // SETTINGS.stride_px,) * 4
    owner = functional.pad(owner.expand(-1, inner, inner), edges, value=-1)
    return _best(net(torch.cat(tiles)), size, owner, torch.cat(places), level)
