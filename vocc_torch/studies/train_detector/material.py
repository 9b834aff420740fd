"""What training crops are cut from: pictures without a panel, and rendered panels with their corners."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.receiver.detector.pyramid import Pyramid
from vocc_torch.studies.train_detector.clutter import PHOTOGRAPHS, drawing, photograph
from vocc_torch.studies.train_detector.pool import Example

Plane = NDArray[np.uint8]


@dataclass(frozen=True)
class MaterialSettings:
    """What crops are cut from, and how often."""

    drawings: int = 60
    drawing_px: int = 400  # side
    least_side_px: int = 140  # of a picture that is cut from
    level_share: float = 0.7  # of a frame's level, of the next finer one's
    other_share: float = 0.3  # of drawings and photographs


SETTINGS = MaterialSettings()


class Spot(NamedTuple):
    """A place in a picture."""

    plane: Plane
    x: float
    y: float


def levels_of(grey: Tensor) -> list[Plane]:
    """Give the halvings of a frame (1,1,H,W)."""
    levels = Pyramid.of(grey).levels
    return [level.round().to(torch.uint8).numpy() for level in levels]


class Material:
    """Pictures without a panel, and frames with one.

    Args:
        examples: the pool.
        seed: of the drawings.
    """

    def __init__(self, examples: Sequence[Example], seed: int) -> None:
        self.empty = [levels_of(one.grey) for one in examples if one.empty]
        self.found = [one for one in examples if one.readable]
        side = SETTINGS.drawing_px
        draws = (np.random.default_rng((seed, k)) for k in range(SETTINGS.drawings))
        pictures = [drawing(draw, (side, side)) for draw in draws]
        pictures += [photograph(name) for name in PHOTOGRAPHS]
        planes, shares = [], []
        for group, share in ((pictures, SETTINGS.other_share), (None, 1.0)):
            stacks = self.empty
            if group is not None:
                greys = (torch.from_numpy(255 * one)[None, None] for one in group)
                stacks = [levels_of(grey) for grey in greys]
            cut = [
                (plane, SETTINGS.level_share**number)
                for stack in stacks
                for number, plane in enumerate(stack)
                if min(plane.shape) >= SETTINGS.least_side_px
            ]
            total = sum(weight for _, weight in cut)
            planes += [plane for plane, _ in cut]
            shares += [share * weight / total for _, weight in cut]
        self.planes = planes
        self.shares = np.array(shares) / sum(shares)

    def patches(self, side: int, count: int, draw: np.random.Generator) -> Tensor:
        """Cut (B,S,S) from pictures without a panel, anywhere, mirrored and transposed at random."""
        out = np.empty((count, side, side), np.float32)
        for row, number in enumerate(
            draw.choice(len(self.planes), count, p=self.shares)
        ):
            plane = self.planes[number]
            top, left = (int(draw.integers(size - side + 1)) for size in plane.shape)
            crop = plane[top : top + side, left : left + side]
            crop = crop[:: int(draw.choice((-1, 1))), :: int(draw.choice((-1, 1)))]
            out[row] = crop.T if draw.random() < 0.5 else crop
        return torch.from_numpy(out)


def cut_at(spot: Spot, side: int) -> tuple[NDArray[np.float32], tuple[int, int]]:
    """Cut (S,S) about a place, inside the picture where that is large enough, and give its corner, px."""
    starts = []
    for middle, length in (
        (spot.y, spot.plane.shape[0]),
        (spot.x, spot.plane.shape[1]),
    ):
        start = round(middle - side / 2)
        least, most = sorted((0, length - side))
        starts.append(
            min(max(start, least), most) if length >= side else most // 2 + least // 2
        )
    top, left = starts
    high, wide = spot.plane.shape
    rows = slice(max(top, 0), min(top + side, high))
    columns = slice(max(left, 0), min(left + side, wide))
    crop = spot.plane[rows, columns]
    out = np.full((side, side), crop.mean(), np.float32)
    out[
        rows.start - top : rows.stop - top, columns.start - left : columns.stop - left
    ] = crop
    return out, (left, top)
