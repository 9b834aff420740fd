"""A small network that sees a whole panel's cells: whether it is one, where it ends, how corners are off."""

import math
from functools import lru_cache
from pathlib import Path

import torch
from torch import Tensor, nn

from vocc_torch.errors import VoccError
from vocc_torch.receiver.model_file import read_model, write_model
from vocc_torch.types import PanelShape

SHIPPED = "learned_locator.json"
"""The weights that ship, beside this file; ``benchmarks/train_panel_net.py`` made them."""

SAMPLES, CONTEXT = 4, 2
"""Samples along a cell's side, and cells beyond a placing that are seen."""

_KIND = "learned_locator"
_FIRST, _CELL, _SIDE, _QUARTER, _HIDDEN = 16, 32, 8, 16, 48
_MOST = 4.0
OUTPUTS = 9
"""A logit, and moves of four corners along the rows and down the columns."""


class PanelNet(nn.Module):
    """Judge every placing by whole cells of a panel on a lattice.

    Convolutions see cells with their neighbours. A placing is told by means of what is seen inside it, of the
    squares of that, so that two levels can be told from many, along each of its sides, and in its quarters.

    Example:
        >>> PanelNet()(torch.rand(5, 64, 80), torch.full((5,), 3.0), PanelShape(8, 12)).shape
        torch.Size([5, 9, 5, 5])
    """

    def __init__(self) -> None:
        super().__init__()
        self.spot = nn.Conv2d(1, _FIRST, 4, 2, 1)
        self.cell = nn.Conv2d(_FIRST, 24, SAMPLES // 2, SAMPLES // 2)
        self.near = nn.Conv2d(24, _CELL, 3)
        self.far = nn.Conv2d(_CELL, _CELL, 3)
        self.side = nn.Conv2d(_CELL, 4 * _SIDE, 1)
        self.quarter = nn.Conv2d(_CELL, _QUARTER, 1)
        self.judge = nn.Sequential(
            nn.Conv2d(2 * _CELL + 4 * _SIDE + 4, _HIDDEN, 1),
            nn.ReLU(),
            nn.Conv2d(_HIDDEN, 1, 1),
        )
        self.move = nn.Sequential(
            nn.Conv2d(4 * _QUARTER + 4, _HIDDEN, 1), nn.ReLU(), nn.Conv2d(_HIDDEN, 8, 1)
        )

    def forward(
        self, patches: Tensor, pitch_px: Tensor, shape: PanelShape, moved: bool = True
    ) -> Tensor:
        """Judge placings.

        Args:
            patches: (n,(R+2m)K,(C+2m)K) grey values of R x C cells, a margin m each way, K = ``SAMPLES``.
            pitch_px: (n,) in the frame.
            shape: R and C.
            moved: whether moves are wanted, else the logit alone is given.

        Returns:
            (n,9,P,Q) with P, Q = 2 (m - ``CONTEXT``) + 1, for shifts down and right by up to m - ``CONTEXT``:
            a logit, and moves (4,2) of the corners, cells.
        """
        high, wide = shape.rows, shape.columns
        margins = (
            (patches.shape[1] // SAMPLES - high) // 2,
            (patches.shape[2] // SAMPLES - wide) // 2,
        )
        down, right = (2 * (one - CONTEXT) + 1 for one in margins)
        top, left = ((one - 1) * SAMPLES for one in margins)
        middle = patches[
            :, top : patches.shape[1] - top, left : patches.shape[2] - left
        ]
        spread, mean = torch.var_mean(middle.flatten(1), 1, correction=0)
        spread, mean = spread[:, None, None], mean[:, None, None]
        contrast = (spread + 1.0).sqrt()
        seen = ((patches - mean) / contrast).clamp(-_MOST, _MOST)[:, None]
        seen = self.cell(self.spot(seen).relu()).relu()
        seen = self.far(self.near(seen).relu()).relu()
        told = patches.new_tensor([math.log2(high) / 4, math.log2(wide) / 4]).expand(
            len(patches), 2
        )
        told = torch.cat(
            [told, pitch_px.log2()[:, None] / 4, contrast[:, 0].log2() / 4], 1
        )
        told = told[..., None, None].expand(-1, -1, down, right)
        inside = _means(torch.cat([seen, seen.square()], 1), high, wide)
        sides = self.side(seen).relu().split(_SIDE, 1)
        lines = [_means(one, 1, wide) for one in sides[:2]] + [
            _means(one, high, 1) for one in sides[2:]
        ]
        at = [lines[0][:, :, :down], lines[1][:, :, high - 1 : high - 1 + down]]
        at += [lines[2][..., :right], lines[3][..., wide - 1 : wide - 1 + right]]
        logit: Tensor = self.judge(torch.cat([inside, *at, told], 1))
        if not moved:
            return logit
        half = ((high + 1) // 2, (wide + 1) // 2)
        quarters = _means(self.quarter(seen).relu(), *half)
        y, x = high - half[0], wide - half[1]
        four = [
            quarters[:, :, j : j + down, i : i + right]
            for j, i in ((0, 0), (0, x), (y, x), (y, 0))
        ]
        moves = self.move(torch.cat([*four, told], 1))
        return torch.cat([logit, moves], 1)


def _means(planes: Tensor, high: int, wide: int) -> Tensor:
    """Means over every box of (n,C,H,W), as differences of running sums: many times faster than pooling."""
    for axis, size, before in ((3, wide, (1, 0)), (2, high, (0, 0, 1, 0))):
        if size > 1:
            sums, many = (
                nn.functional.pad(planes.cumsum(axis), before),
                planes.shape[axis] - size + 1,
            )
            planes = (sums.narrow(axis, size, many) - sums.narrow(axis, 0, many)) / size
    return planes


def save_weights(path: Path, net: PanelNet) -> None:
    """Write a network's weights, in the format of receivers: text, a checksum, and no code.

    Raises:
        VoccError: the file cannot be written.
    """
    write_model(path, {"kind": _KIND}, net.state_dict())


@lru_cache(maxsize=8)
def load_weights(path: Path, device: torch.device) -> PanelNet:
    """Read what :func:`save_weights` wrote; nothing in the file is executed.

    Raises:
        VoccError: a file that is missing, damaged or of another kind.
    """
    settings, state = read_model(
        path, "weights", "a file that benchmarks/train_panel_net.py wrote"
    )
    with torch.inference_mode(False):
        net = PanelNet()
        try:
            if settings["kind"] != _KIND or not all(
                bool(one.isfinite().all()) for one in state.values()
            ):
                raise ValueError
            net.load_state_dict(state)
        except (KeyError, RuntimeError, ValueError):
            raise VoccError(
                f"weights {path} hold no learned locator: train it again"
            ) from None
        # So kept, the first convolution, of one plane, takes a sixth of the time.
        net.to(memory_format=torch.channels_last)
        return net.eval().requires_grad_(False).to(device)
