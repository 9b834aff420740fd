"""The judge: a network that sees a candidate's cells, scores its placings and moves its corners."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from vocc_torch.receiver.detector.pyramid import Pyramid
from vocc_torch.receiver.resample import cell_size_px, corner_cells, map_points
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class JudgeSettings:
    """What the judge sees."""

    samples: int = 4  # along a cell's side
    context: int = 2  # cells around a placing
    most: float = (
        4.0  # standard deviations from the mean, beyond which grey values are cut
    )
    reach: int = 2  # cells by which corners are sought


SETTINGS = JudgeSettings()


class Judge(nn.Module):
    """Convolutions over cells, their means inside a placing and along its sides, and its corners.

    The means of squares tell two levels from many. Means over all placings by whole cells are differences of
    running sums. About each corner every cell says how likely the corner is near and where it is; the mean of
    the places by likelihood counts. Any number of rows and columns has the same weights.

    Example:
        >>> logit, moves = Judge()(torch.rand(5, 64, 80), torch.full((5,), 3.0), PanelShape(8, 12))
        >>> logit.shape, moves.shape
        (torch.Size([5, 5, 5]), torch.Size([5, 4, 2]))
    """

    def __init__(self, width: int = 32, side: int = 8, hidden: int = 48) -> None:
        super().__init__()
        self.cell = nn.Conv2d(SETTINGS.samples**2, width, 1)
        self.near = nn.Conv2d(width, width, 3)
        self.far = nn.Conv2d(width, width, 3)
        self.side = nn.Conv2d(width, 4 * side, 1)
        self.corner = nn.Conv2d(width, 12, 1)
        self.score = nn.Sequential(
            nn.Conv2d(2 * width + 4 * side + 4, hidden, 1),
            nn.ReLU(),
            nn.Conv2d(hidden, 1, 1),
        )

    def forward(
        self, patches: Tensor, pitch_px: Tensor, shape: PanelShape
    ) -> tuple[Tensor, Tensor]:
        """Judge placings.

        Args:
            patches: (n,(R+2m)K,(C+2m)K) grey values of R x C cells with m cells around.
            pitch_px: (n,) in the frame.
            shape: R and C.

        Returns:
            (n,P,P) logits, P = 2 (m - context) + 1, of placings down and right by up to m - context cells,
            and (n,4,2) by how much the corners are off, cells.
        """
        high, wide, samples = shape.rows, shape.columns, SETTINGS.samples
        reach = (patches.shape[1] // samples - high) // 2 - SETTINGS.context
        placings = 2 * reach + 1
        edge = (reach + SETTINGS.context - 1) * samples
        middle = patches[
            :, edge : patches.shape[1] - edge, edge : patches.shape[2] - edge
        ]
        spread, mean = torch.var_mean(middle.flatten(1), 1, correction=0)
        contrast = (spread + 1).sqrt()
        seen = ((patches - mean[:, None, None]) / contrast[:, None, None]).clamp(
            -SETTINGS.most, SETTINGS.most
        )
        cells = nn.functional.pixel_unshuffle(seen[:, None], samples)
        cells = self.cell(cells.contiguous(memory_format=torch.channels_last)).relu()
        cells = self.far(self.near(cells).relu()).relu()
        sizes = patches.new_tensor([math.log2(high) / 4, math.log2(wide) / 4]).expand(
            len(patches), 2
        )
        facts = torch.cat(
            [sizes, pitch_px.log2()[:, None] / 4, contrast.log2()[:, None] / 4], 1
        )
        facts = facts[..., None, None].expand(-1, -1, placings, placings)
        inside = box_means(torch.cat([cells, cells.square()], 1), high, wide)
        sides = self.side(cells).relu().chunk(4, 1)
        rows = [box_means(one, 1, wide) for one in sides[:2]]
        columns = [box_means(one, high, 1) for one in sides[2:]]
        around = [rows[0][:, :, :placings], rows[1][:, :, high - 1 :]]
        around += [columns[0][..., :placings], columns[1][..., wide - 1 :]]
        logit = self.score(torch.cat([inside, *around, facts], 1))[:, 0]
        return logit, corner_moves(self.corner(cells), reach)


def corner_moves(planes: Tensor, reach: int) -> Tensor:
    """Find corners in what cells say of them.

    Args:
        planes: (n,12,R+2r,C+2r): for each corner a logit, and how far right and down of the cell it is.
        reach: r, cells around the panel.

    Returns:
        (n,4,2) cells from where the corners are taken to be.

    Example:
        >>> planes = torch.zeros(1, 12, 10, 10)
        >>> planes[0, ::3, 2, 3] = 50.0
        >>> corner_moves(planes, 1)[0, 0].tolist()
        [2.5, 1.5]
    """
    side = min(2 * reach + 2, *planes.shape[2:])
    low = torch.arange(side, device=planes.device) + 0.5 - reach
    high = low.flip(0).neg()
    moves = []
    for number, (right, bottom) in enumerate(
        ((False, False), (True, False), (True, True), (False, True))
    ):
        window = planes[:, 3 * number : 3 * number + 3]
        window = window[:, :, -side:] if bottom else window[:, :, :side]
        window = window[..., -side:] if right else window[..., :side]
        share = window[:, 0].flatten(1).softmax(1)
        across = (window[:, 1] + (high if right else low)).flatten(1)
        down = (window[:, 2] + (high if bottom else low)[:, None]).flatten(1)
        moves.append(torch.stack([(share * across).sum(1), (share * down).sum(1)], 1))
    return torch.stack(moves, 1)


def box_means(planes: Tensor, high: int, wide: int) -> Tensor:
    """Give the means over every box of (n,C,H,W).

    Example:
        >>> box_means(torch.arange(6.0).view(1, 1, 2, 3), 2, 2).tolist()
        [[[[2.0, 3.0]]]]
    """
    for axis, size, before in ((3, wide, (1, 0)), (2, high, (0, 0, 1, 0))):
        sums = nn.functional.pad(planes.cumsum(axis), before)
        count = planes.shape[axis] - size + 1
        planes = (sums.narrow(axis, size, count) - sums.narrow(axis, 0, count)) / size
    return planes


def pitch_of(quads: Tensor, shape: PanelShape) -> Tensor:
    """Give the mean pitch (n,) of quadrilaterals, px, float32."""
    pitch: Tensor = torch.stack(cell_size_px(quads, shape)).prod(0).sqrt().float()
    return pitch.nan_to_num(1.0).clamp(0.3, 300)


def judged(
    net: Judge, pyramid: Pyramid, quads: Tensor, shape: PanelShape
) -> tuple[Tensor, Tensor, Tensor]:
    """Judge candidates, shift them to their likeliest placing, and find their corners.

    Args:
        net: the judge.
        pyramid: of the frame.
        quads: (n,4,2) float64 px.
        shape: rows and columns.

    Returns:
        (n,) logits of the likeliest placings, (n,4,2) these placings, and (n,4,2) the corners as seen.
    """
    reach = SETTINGS.reach
    patches = pyramid.read_cells(
        quads, shape, SETTINGS.samples, reach + SETTINGS.context
    )
    logits, moves = net(patches, pitch_of(quads, shape), shape)
    logit, place = logits.flatten(1).max(1)
    placings = 2 * reach + 1
    shift = torch.stack([place % placings - reach, place // placings - reach], 1)[
        :, None
    ].to(quads)
    cells = corner_cells(shape).to(quads)
    return (
        logit,
        map_points(quads, cells + shift, shape),
        map_points(quads, cells + moves.to(quads), shape),
    )
