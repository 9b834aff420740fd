"""The scout: a fully convolutional network that proposes where panels are, at any level of a pyramid."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from vocc_torch.receiver.detector.layers import convolution
from vocc_torch.receiver.detector.pyramid import SETTINGS as TILES
from vocc_torch.receiver.detector.pyramid import Pyramid, gate
from vocc_torch.types import PanelShape

SIZES = (5.6, 11.3)
"""LEDs along a side at which small, middle and large panels part."""

SCORES = len(SIZES) + 1
"""A score for each size of panels."""

OUTPUTS = SCORES + 8
"""Scores and the moves of four corners."""


@dataclass(frozen=True)
class ScoutSettings:
    """What the scout gives."""

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


class Scout(nn.Module):
    """Convolutions at strides 4, 8 and 16, the coarser ones added to the finer ones.

    Example:
        >>> Scout()(torch.zeros(1, 1, 64, 96)).shape
        torch.Size([1, 11, 8, 12])
    """

    def __init__(self) -> None:
        super().__init__()
        self.block = nn.Conv2d(1, 12, 4, 4)
        self.fine = nn.Sequential(
            convolution(12, 16, 2),
            nn.ReLU(),
            convolution(16, 16),
            nn.ReLU(),
            convolution(16, 16),
            nn.ReLU(),
        )
        self.coarse = nn.Sequential(
            convolution(16, 24, 2),
            nn.ReLU(),
            convolution(24, 24),
            nn.ReLU(),
            convolution(24, 24),
            nn.ReLU(),
            nn.Conv2d(24, 16, 1),
        )
        last = nn.Conv2d(16, OUTPUTS, 1)
        self.head = nn.Sequential(convolution(16, 16), nn.ReLU(), last)
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
        fine = self.fine(blocks.relu())
        coarse = functional.interpolate(self.coarse(fine), scale_factor=2.0)
        out: Tensor = self.head((fine + coarse).relu())
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
    return sum(math.sqrt(shape.leds) >= side for side in SIZES)


class Peaks(NamedTuple):
    """Places where a score is the best about.

    Args:
        row: (n,) of the output.
        column: (n,) of the output.
        score: (n,), the best first.
    """

    row: Tensor
    column: Tensor
    score: Tensor


def peaks(score: Tensor, most: int) -> Peaks:
    """Take the best local maxima of a score (h,w).

    Example:
        >>> row, column, score = peaks(torch.tensor([[0.0, 1.0, 0.0, 2.0]]), 9)
        >>> row.tolist(), column.tolist(), score.tolist()
        ([0, 0], [3, 1], [2.0, 1.0])
    """
    side = SETTINGS.peak_cells
    best = functional.max_pool2d(score[None], side, 1, side // 2)[0]
    flat = score.masked_fill(score < best, -torch.inf).flatten()
    values, order = flat.topk(min(most, len(flat)))
    order = order[values > -torch.inf]
    wide = score.shape[1]
    return Peaks(order // wide, order % wide, flat[order])


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
    net: Scout, pyramid: Pyramid, shape: PanelShape
) -> tuple[Tensor, Tensor, Tensor]:
    """Find the best candidates of a frame.

    Args:
        net: the scout.
        pyramid: of the frame.
        shape: rows and columns.

    Returns:
        Corners (n,4,2) float64 px, scores (n,) and levels (n,), the best first.
    """
    sheet = Sheet.of(pyramid.levels)
    outputs = net(sheet.grey)
    score = outputs[0, size_of(shape)].masked_fill(sheet.owner < 0, -torch.inf)
    row, column, score = peaks(score, SETTINGS.peaks)
    places = torch.stack([column, row], 1)
    window = sheet.owner[row, column]
    level = sheet.level[window]
    quads = quads_of(outputs[0, :, row, column].mT, places).double()
    quads = (quads - sheet.origin[window, None]) * 2.0 ** level[:, None, None]
    near = (score > score.amax() - SETTINGS.behind).nonzero()[:, 0]
    rows = near[distinct(quads[near], score[near], SETTINGS.candidates)]
    return quads[rows], score[rows], level[rows]


class Window(NamedTuple):
    """A part of a level, and where it is in the picture that the scout sees; px."""

    level: int
    top: int
    left: int
    high: int
    wide: int
    row: int
    column: int


class Sheet(NamedTuple):
    """What the scout sees of a frame, in one picture: tiles of the larger levels, and the smaller levels.

    Args:
        grey: (1,1,H,W) uint8; around levels is a mean grey value.
        owner: (H/8,W/8) number of the window that an output belongs to, -1 for none.
        origin: (n,2) px of the windows' levels in the picture.
        level: (n,) of the windows.
    """

    grey: Tensor
    owner: Tensor
    origin: Tensor
    level: Tensor

    @classmethod
    def of(cls, levels: Sequence[Tensor]) -> "Sheet":
        """Lay out levels (H,W)."""
        step, margin = SETTINGS.stride_px, SETTINGS.margin_px
        windows, (tall, broad) = windows_of(levels)
        device = levels[0].device
        mean = levels[-1].float().mean().round().byte()
        grey = mean.expand(tall, broad).contiguous()
        owner = torch.full((tall // step, broad // step), -1, device=device)
        for number, (level, top, left, high, wide, row, column) in enumerate(windows):
            # A window shows its surroundings, and outputs belong to it as far as one beyond its edges.
            over, before = min(margin, top), min(margin, left)
            seen = levels[level][
                top - over : top + high + margin, left - before : left + wide + margin
            ]
            down, across = row - over, column - before
            grey[down : down + seen.shape[0], across : across + seen.shape[1]] = seen
            owner[
                row // step - 1 : -(-(row + high) // step) + 1,
                column // step - 1 : -(-(column + wide) // step) + 1,
            ] = number
        origins = [(one.column - one.left, one.row - one.top) for one in windows]
        return cls(
            grey[None, None],
            owner,
            torch.tensor(origins, device=device),
            torch.tensor([one.level for one in windows], device=device),
        )


def windows_of(levels: Sequence[Tensor]) -> tuple[list[Window], tuple[int, int]]:
    """Lay out the smaller levels (H,W), and below them the tiles of the larger ones that the gate chooses.

    Returns:
        The windows, and height and width of the picture.

    Example:
        >>> windows, sides = windows_of([torch.zeros(50, 100), torch.zeros(25, 50), torch.zeros(12, 25)])
        >>> [(one.row, one.column) for one in windows], sides
        ([(16, 16), (16, 144), (64, 144)], (96, 224))
    """
    step, margin, tile = 2 * SETTINGS.stride_px, SETTINGS.margin_px, TILES.tile_px
    large = sum(level.numel() > SETTINGS.gated_px for level in levels)
    windows: list[Window] = []
    top, left, tall, broad = margin, margin, 0, tile + 2 * margin
    for number, (high, wide) in enumerate(level.shape for level in levels[large:]):
        windows.append(Window(large + number, 0, 0, high, wide, top, left))
        below, beside = (
            at + -(-side // step) * step + margin
            for at, side in ((top, high), (left, wide))
        )
        tall, broad = max(tall, below), max(broad, beside)
        # The first is on the left, the others are in a column beside it.
        top, left = (below, left) if number else (margin, beside)
    side = tile + 2 * margin
    across = broad // side
    gated = [
        Window(number, row * tile, column * tile, tile, tile, 0, 0)
        for number, level in enumerate(levels[:large])
        for row, column in gate(level).tolist()
    ]
    for number, window in enumerate(gated):
        row, column = divmod(number, across)
        windows.append(
            window._replace(
                row=tall + side * row + margin, column=side * column + margin
            )
        )
    return windows, (tall + side * -(-len(gated) // across), broad)
