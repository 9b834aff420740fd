"""The scout: a fully convolutional network that proposes where panels are, at any level of a pyramid."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from vocc_torch.receiver.detector import pyramid as pyramids
from vocc_torch.receiver.detector.pyramid import Pyramid, gate

OUTPUTS = 9
"""A score and the moves of four corners."""


@dataclass(frozen=True)
class ScoutSettings:
    """What the scout gives."""

    stride_px: int = 8  # between its outputs
    unit_px: float = 16.0  # of the corners that it gives
    peak_cells: int = 3  # a candidate is the best of so many outputs a side
    candidates: int = 16  # of a frame
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
        torch.Size([1, 9, 8, 12])
    """

    def __init__(self) -> None:
        super().__init__()
        self.block = nn.Conv2d(1, 12, 4, 4)
        self.fine = nn.Sequential(
            nn.Conv2d(12, 16, 3, 2, 1),
            nn.ReLU(),
            nn.Conv2d(16, 16, 3, 1, 1),
            nn.ReLU(),
            nn.Conv2d(16, 16, 3, 1, 1),
            nn.ReLU(),
        )
        self.coarse = nn.Sequential(
            nn.Conv2d(16, 24, 3, 2, 1),
            nn.ReLU(),
            nn.Conv2d(24, 24, 3, 1, 1),
            nn.ReLU(),
            nn.Conv2d(24, 24, 3, 1, 1),
            nn.ReLU(),
            nn.Conv2d(24, 16, 1),
        )
        last = nn.Conv2d(16, OUTPUTS, 1)
        self.head = nn.Sequential(nn.Conv2d(16, 16, 3, 1, 1), nn.ReLU(), last)
        last.bias = nn.Parameter(
            torch.tensor([SETTINGS.rare_logit, *[0.0] * (OUTPUTS - 1)])
        )

    def forward(self, grey: Tensor) -> Tensor:
        """Score grey values (B,1,H,W), 0 to 255, sides multiples of 16, to (B,9,H/8,W/8)."""
        fine = self.fine(self.block(grey.float() / 64 - 1).relu())
        coarse = functional.interpolate(self.coarse(fine), scale_factor=2.0)
        out: Tensor = self.head((fine + coarse).relu())
        return out


def quads_of(outputs: Tensor, places: Tensor) -> Tensor:
    """Give corners (n,4,2), px, of outputs (n,9) at places (n,2), columns and rows of the output."""
    centre = (places.to(outputs) + 0.5) * SETTINGS.stride_px
    return centre[:, None] + SETTINGS.unit_px * outputs[:, 1:].view(-1, 4, 2)


def peaks(outputs: Tensor, most: int) -> tuple[Tensor, Tensor, Tensor]:
    """Take the best local maxima of outputs (B,9,h,w): picture (n,), corners (n,4,2) px and scores (n,)."""
    score = outputs[:, :1]
    best = functional.max_pool2d(
        score, SETTINGS.peak_cells, 1, SETTINGS.peak_cells // 2
    )
    flat = score.masked_fill(score < best, -torch.inf).flatten()
    values, order = flat.topk(min(most, len(flat)))
    picture = order // (score.shape[2] * score.shape[3])
    row, column = order // score.shape[3] % score.shape[2], order % score.shape[3]
    return (
        picture,
        quads_of(outputs[picture, :, row, column], torch.stack([column, row], 1)),
        values,
    )


def distinct(quads: Tensor, score: Tensor, most: int) -> Tensor:
    """Give the rows of at most so many candidates, the best first, one of those at nearly the same place."""
    order = score.argsort(descending=True, stable=True)
    centre, size = (
        quads.mean(1)[order],
        (quads[:, 0] - quads[:, 2]).norm(dim=1)[order].clamp(min=1e-6),
    )
    near = torch.cdist(centre, centre) < SETTINGS.same * torch.minimum(
        size[:, None], size
    )
    ratio = size[:, None] / size
    same = (near & (ratio < SETTINGS.alike) & (ratio > 1 / SETTINGS.alike)).numpy()
    chosen: list[int] = []
    for row in range(len(order)):
        if not any(same[row, other] for other in chosen):
            chosen.append(row)
        if len(chosen) == most:
            break
    return order[chosen]


def propose(net: Scout, pyramid: Pyramid, gated: bool = True) -> tuple[Tensor, Tensor]:
    """Give the best candidates of a frame, corners (n,4,2) float64 px and scores (n,), the best first.

    Args:
        net: the scout.
        pyramid: of the frame.
        gated: whether only the tiles that the gate chooses are looked at in large levels.
    """
    levels = pyramid.levels
    large = sum(gated and level.numel() > SETTINGS.gated_px for level in levels)
    parts = [*_in_tiles(net, levels[:large]), *_in_canvas(net, levels[large:])]
    quads, scores = [], []
    for number, (corners, score) in enumerate(parts):
        quads.append(corners.double() * 2.0**number)
        scores.append(score)
    corners, score = torch.cat(quads), torch.cat(scores)
    rows = distinct(corners, score, SETTINGS.candidates)
    return corners[rows], score[rows]


def _in_canvas(net: Scout, levels: Sequence[Tensor]) -> list[tuple[Tensor, Tensor]]:
    """Look at all of levels (H,W) in one picture, with margins of their mean grey value around."""
    if not levels:
        return []
    stride, most = SETTINGS.stride_px, 2 * SETTINGS.candidates
    sides = [tuple(level.shape) for level in levels]
    origins, size = canvas_of(sides)
    mean = levels[-1].float().mean().round().byte()
    canvas = mean.expand(1, 1, *size).contiguous()
    for level, (high, wide), (top, left) in zip(levels, sides, origins, strict=True):
        canvas[0, 0, top : top + high, left : left + wide] = level
    outputs = net(canvas)
    parts = []
    for (high, wide), (top, left) in zip(sides, origins, strict=True):
        rows = slice(top // stride - 1, -(-(top + high) // stride) + 1)
        columns = slice(left // stride - 1, -(-(left + wide) // stride) + 1)
        _, quads, score = peaks(outputs[:, :, rows, columns], most)
        parts.append((quads - stride, score))
    return parts


def canvas_of(
    sides: Sequence[tuple[int, ...]],
) -> tuple[list[tuple[int, int]], tuple[int, int]]:
    """Put levels into one picture, the first on the left, the others one below the other beside it.

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


def _in_tiles(net: Scout, levels: Sequence[Tensor]) -> list[tuple[Tensor, Tensor]]:
    """Look at the tiles of levels (H,W) that the gate chooses."""
    if not levels:
        return []
    tile, margin = pyramids.SETTINGS.tile_px, pyramids.SETTINGS.margin_px
    side = tile + 2 * margin
    tiles, places = [], []
    for level in levels:
        row, column = gate(level).unbind(1)
        high, wide = (-(-length // tile) * tile for length in level.shape)
        beyond = (wide - level.shape[1], high - level.shape[0])
        around = (margin, margin + beyond[0], margin, margin + beyond[1])
        mean = int(level[::margin, ::margin].float().mean())
        canvas = functional.pad(level, around, value=mean)
        views = canvas.unfold(0, side, tile).unfold(1, side, tile)
        tiles.append(views[row, column][:, None])
        places.append(torch.stack([column, row], 1) * tile - margin)
    outputs = net(torch.cat(tiles))
    edge = margin // SETTINGS.stride_px
    outputs[:, 0, :edge] = outputs[:, 0, -edge:] = -torch.inf
    outputs[:, 0, :, :edge] = outputs[:, 0, :, -edge:] = -torch.inf
    parts = []
    for output, origin in zip(
        outputs.split(list(map(len, tiles))), places, strict=True
    ):
        picture, quads, score = peaks(output, 2 * SETTINGS.candidates)
        parts.append((quads + origin[picture, None].to(quads), score))
    return parts
