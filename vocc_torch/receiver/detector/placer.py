"""The placer: a network that sees each cell of a candidate, moves its corners and says how well they lie."""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from vocc_torch.receiver.detector.layers import convolution, standardised
from vocc_torch.receiver.detector.pyramid import Pyramid
from vocc_torch.receiver.resample import (
    cell_homography,
    corner_cells,
    map_cells,
    map_points,
)
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class PlacerSettings:
    """What the placer sees of a candidate."""

    samples: int = 4  # along a cell's side
    margin: int = 1  # cells around the panel
    channels: int = 32
    layers: int = 4
    grain: float = 1.0  # variance of grey values, that counts as no contrast
    most: float = 4.0  # standard deviations, beyond which grey values are cut
    # Weights of no move, of the fields 1, u, v and uv, in cells that are sure.
    ridge: tuple[float, ...] = (0.02, 0.05, 0.05, 0.5)
    most_weight: float = 6.0  # logarithm of how sure a cell is


SETTINGS = PlacerSettings()

AXES = torch.stack([torch.eye(2), -torch.eye(2)], 1).flatten(0, 1)
"""A cell across and down, to either side."""

_ENDS = torch.cat([torch.eye(4), torch.eye(4) + torch.eye(4).roll(1, 1)])
"""The four corners, and the four sides."""

SLIPS = (_ENDS[:, None, :, None] * AXES[:, None]).flatten(0, 1)
"""Moves (32,4,2), cells, of a corner or a side by a cell."""


class Placer(nn.Module):
    """Convolutions over cells: each says how far the lattice is off, and how sure it is.

    :func:`corner_moves` joins the moves of all cells.

    Example:
        >>> logit, cells = Placer()(torch.rand(5, 40, 24))
        >>> logit.shape, cells.shape, corner_moves(cells, PanelShape(8, 4)).shape
        (torch.Size([5]), torch.Size([5, 3, 10, 6]), torch.Size([5, 4, 2]))
    """

    sides_px: ClassVar[int] = SETTINGS.samples
    """Its pictures' sides are multiples of this."""

    def __init__(self) -> None:
        super().__init__()
        wide = SETTINGS.channels
        self.first = convolution(SETTINGS.samples**2, wide)
        self.layers = nn.ModuleList(
            [convolution(wide, wide) for _ in range(SETTINGS.layers)]
        )
        self.around = nn.Linear(2 * wide, wide)
        self.off = nn.Conv2d(wide, 3, 1)
        self.score = nn.Sequential(
            nn.Linear(2 * wide, wide), nn.ReLU(), nn.Linear(wide, 1)
        )

    def forward(self, patches: Tensor) -> tuple[Tensor, Tensor]:
        """Score patches (n,(R+2M)K,(C+2M)K) of candidates.

        Returns:
            (n,) logits, and (n,3,R+2M,C+2M) three numbers for each cell: how far it lies from the true one across
            and down, cells, and the logarithm of how sure that is.
        """
        light = standardised(patches, SETTINGS.grain, SETTINGS.most)
        cells = functional.pixel_unshuffle(light[:, None], SETTINGS.samples)
        state = self.first(cells).relu_()
        for number, layer in enumerate(self.layers):
            if number == len(self.layers) // 2:
                state = state + self.around(_pooled(state))[..., None, None]
            state = state + layer(state).relu_()
        return self.score(_pooled(state))[:, 0], self.off(state)


def _pooled(state: Tensor) -> Tensor:
    return torch.cat([state.mean((2, 3)), state.amax((2, 3))], 1)


def corner_moves(cells: Tensor, shape: PanelShape) -> Tensor:
    """Join the moves of cells by least squares to moves of the four corners (n,4,2), cells.

    The moves of the corners are a shift, stretches and a shear along the panel's axes.

    Args:
        cells: (n,3,R+2M,C+2M), as :meth:`Placer.forward` gives them.
        shape: rows R and columns C.

    Example:
        >>> cells = torch.tensor([1.0, 1.0, 5.0])[None, :, None, None].expand(1, 3, 6, 4)
        >>> bool((corner_moves(cells, PanelShape(4, 2)) - 1).abs().max() < 1e-3)
        True
    """
    fields, corners, ridge = _fields(shape, cells.device)
    across, down, sure = cells.flatten(2).unbind(1)
    off = torch.stack([across, down], 2)
    weight = sure.clamp(max=SETTINGS.most_weight).exp()[..., None] * fields
    gram = weight.mT @ fields + ridge
    moves: Tensor = corners @ torch.linalg.solve(gram, weight.mT @ off)
    return moves


@lru_cache(maxsize=32)
@torch.inference_mode(False)
def _fields(shape: PanelShape, device: torch.device) -> list[Tensor]:
    """Fields 1, u, v and uv at cells (N,4) and corners (4,4), u and v -1 to 1 in the panel, and ridge (4,4)."""
    v, u = (
        (torch.arange(leds + 2 * SETTINGS.margin).float() - SETTINGS.margin + 0.5)
        * (2 / leds)
        - 1
        for leds in (shape.rows, shape.columns)
    )
    v, u = torch.meshgrid(v, u, indexing="ij")
    cells = torch.stack([torch.ones_like(u), u, v, u * v], -1).view(-1, 4)
    u, v = (2 * corner_cells(PanelShape(1, 1)).float() - 1).unbind(1)
    corners = torch.stack([torch.ones_like(u), u, v, u * v], 1)
    ridge = torch.diag(torch.tensor(SETTINGS.ridge))
    return [part.to(device) for part in (cells, corners, ridge)]


def placed(
    net: nn.Module, pyramid: Pyramid, quads: Tensor, shape: PanelShape
) -> tuple[Tensor, Tensor]:
    """Score candidates (n,4,2) float64 px, (n,), and move their corners, (n,4,2)."""
    homography = cell_homography(quads, shape)
    samples, margin = (SETTINGS.samples,) * 2, SETTINGS.margin
    patches = pyramid.read_cells(quads, homography, shape, samples, margin)
    logit, cells = net(patches)
    moves = corner_moves(cells, shape).double()
    return logit, map_cells(homography, corner_cells(shape).to(moves) + moves)


def placed_in_views(
    net: nn.Module, pyramid: Pyramid, quads: Tensor, shape: PanelShape
) -> tuple[Tensor, Tensor]:
    """Do what :func:`placed` does, in the mean of all turned and mirrored views of each candidate."""
    order = corner_orders(shape.rows == shape.columns).to(quads.device)
    logit, moved = placed(net, pyramid, quads[:, order].flatten(0, 1), shape)
    back = order.argsort(1)[..., None].expand(len(quads), -1, 4, 2)
    moved = moved.view(back.shape).gather(2, back)
    return logit.view(len(quads), -1).mean(1), moved.mean(1)


def corner_orders(square: bool) -> Tensor:
    """Give the corners (V,4) of a candidate in the order of each view's; rows stay rows unless they are square.

    Example:
        >>> corner_orders(square=False).tolist()
        [[0, 1, 2, 3], [1, 0, 3, 2], [3, 2, 1, 0], [2, 3, 0, 1]]
    """
    corners = torch.tensor([[0, 1], [3, 2]])
    turned = [corners, corners.T] if square else [corners]
    flips: tuple[tuple[int, ...], ...] = ((), (1,), (0,), (0, 1))
    seen = [view.flip(flip) for view in turned for flip in flips]
    return torch.stack(seen).flatten(1)[:, [0, 1, 3, 2]]


def slips(quad: Tensor, shape: PanelShape) -> Tensor:
    """Move a corner or a side of a candidate (4,2) px by a cell, (32,4,2)."""
    return moved(quad, SLIPS, shape)


def asides(quad: Tensor, shape: PanelShape) -> Tensor:
    """Move a candidate (4,2) px by a cell, (4,4,2)."""
    return moved(quad, AXES[:, None], shape)


def moved(quad: Tensor, cells: Tensor, shape: PanelShape) -> Tensor:
    """Move corners (4,2) px by cells (n,4,2), or all alike by (n,1,2), along their own lines: (n,4,2)."""
    places = corner_cells(shape).to(quad) + cells.to(quad)
    return map_points(quad.expand(len(cells), 4, 2), places, shape)
