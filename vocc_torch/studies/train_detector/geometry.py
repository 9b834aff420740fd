"""Quadrilaterals and homographies, in batches."""

import torch
from torch import Tensor

from vocc_torch.receiver.resample import cell_homography, corner_cells
from vocc_torch.studies.train_detector.draws import Draws
from vocc_torch.types import PanelShape

UNIT = PanelShape(1, 1)


def unit(like: Tensor) -> Tensor:
    """Give the corners (B,4,2) of squares of side 1."""
    return corner_cells(UNIT).to(like)[None].expand_as(like)


def pixels(high: int, wide: int, device: torch.device) -> Tensor:
    """Give the centres (1,2,H*W) of a picture's pixels."""
    down, across = (torch.arange(side, device=device) + 0.5 for side in (high, wide))
    y, x = torch.meshgrid(down, across, indexing="ij")
    return torch.stack([x.flatten(), y.flatten()])[None]


def mapped(matrix: Tensor, points: Tensor) -> Tensor:
    """Map points (B,2,P) by homographies (B,3,3); those beyond the horizon far away."""
    seen = matrix[:, :, :2] @ points + matrix[:, :, 2:]
    return seen[:, :2] / seen[:, 2:].clamp(min=1e-3)


def homography(first: Tensor, second: Tensor) -> Tensor:
    """Give matrices (B,3,3) that take the corners (B,4,2) of convex quadrilaterals to those of others."""
    back, _ = torch.linalg.inv_ex(cell_homography(first, UNIT))
    # A quadrilateral of no area has no homography: numbers without a meaning stand for it.
    matrix: Tensor = cell_homography(second, UNIT) @ back
    return matrix.nan_to_num().float()


def cells_of(quads: Tensor, shapes: Tensor, high: int, wide: int) -> Tensor:
    """Give the place in cells (B,2,H*W), across and down, of each pixel of pictures with panels (B,4,2)."""
    matrix = homography(quads, unit(quads) * shapes.flip(1)[:, None])
    return mapped(matrix, pixels(high, wide, quads.device))


def signed_area(quads: Tensor) -> Tensor:
    """Give the areas (B,) of quadrilaterals, px^2, above 0 where they go clockwise."""
    (x, y), (right, below) = quads.unbind(2), quads.roll(-1, 1).unbind(2)
    return (x * below - y * right).sum(1) / 2


def rearranged(quads: Tensor, order: Tensor) -> Tensor:
    """Take corners (B,4,2) in another order (B,4)."""
    return quads.gather(1, order[..., None].expand(-1, -1, 2))


def ordered(quads: Tensor) -> Tensor:
    """Begin corners (B,4,2) at the top left, clockwise."""
    back = (signed_area(quads) < 0)[:, None, None]
    quads = torch.where(back, quads.flip(1), quads)
    first = quads.sum(2).argmin(1)[:, None] + torch.arange(4, device=quads.device)
    return rearranged(quads, first % 4)


def turns(draws: Draws, quarters: bool) -> Tensor:
    """Draw orders (B,4) of corners: what is read so is turned and mirrored.

    Args:
        draws: B of them.
        quarters: whether quarter turns are among them, not halves alone.
    """
    first = draws.below(4) if quarters else 2 * draws.below(2)
    back = draws.below(2) * 2 - 1
    steps = torch.arange(4, device=draws.device)
    # Going the other way, a side of the same length comes first.
    return (first[:, None] + back[:, None] * steps + (back[:, None] < 0)) % 4
