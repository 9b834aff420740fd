"""Readings of the pool: crops anywhere, and pictures in which a quadrilateral lies where it is asked for."""

from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.receiver.resample import corner_cells
from vocc_torch.studies.train_detector.draws import Draws
from vocc_torch.studies.train_detector.geometry import (
    UNIT,
    homography,
    mapped,
    pixels,
    rearranged,
    signed_area,
    turns,
    unit,
)
from vocc_torch.studies.train_detector.pool import Pool


@dataclass(frozen=True)
class CropSettings:
    """How crops of pictures without a panel are chosen."""

    level_shares: tuple[float, ...] = (0.51, 0.31, 0.18)  # of a frame's finest levels
    scaled: float = 0.4  # share of crops at another scale than a level's
    scale: tuple[float, float] = (0.75, 1.4)


SETTINGS = CropSettings()


def views(draws: Draws, level: Tensor, centre_px: Tensor, side_px: int) -> Tensor:
    """Draw corners (B,4,2), px of frames, of crops of a side, px of levels (B,), about places (B,2).

    Crops are turned, mirrored and scaled about whole pixels of a level: many have its grey values as they are.
    """
    size = 2.0 ** level[:, None]
    centre = (centre_px / size).round() * size
    scaled, scale = draws.coin(SETTINGS.scaled), draws.geometric(*SETTINGS.scale, 1)
    side = side_px * size * torch.where(scaled, scale, 1.0)
    corners = corner_cells(UNIT).to(side) - 0.5
    quads = centre[:, None] + side[..., None] * corners
    return rearranged(quads.float(), turns(draws, quarters=True))


def crops(pool: Pool, frame: Tensor, quads_px: Tensor, side_px: int) -> Tensor:
    """Read crops (B,S,S) with their corners at (B,4,2) px of frames."""
    square = side_px * unit(quads_px)
    return pictures(pool, frame, quads_px, square, (side_px, side_px))


def empty_crops(pool: Pool, draws: Draws, side_px: int) -> Tensor:
    """Cut crops (B,S,S) from pictures without a panel, anywhere."""
    shares, frames = SETTINGS.level_shares, pool.empty
    level = draws.chosen(range(len(shares)), shares)
    centre = draws.uniform(0, 1, 2) * pool.sizes[0].flip(0)
    frame = frames[draws.below(len(frames))]
    return crops(pool, frame, views(draws, level, centre, side_px), side_px)


def pictures(
    pool: Pool,
    frame: Tensor,
    quads_px: Tensor,
    places_px: Tensor,
    size: tuple[int, int],
) -> Tensor:
    """Read pictures (B,h,w) in which corners (B,4,2) px of frames lie at places (B,4,2) px."""
    matrix = homography(places_px, quads_px)
    shares = (signed_area(quads_px) / signed_area(places_px)).abs()
    level = (shares.clamp(min=1e-3).log2() / 2).round()
    level = level.clamp(0, len(pool.sizes) - 1).long()
    at = mapped(matrix, pixels(*size, frame.device))
    return pool.read(frame, level, at).view(-1, *size)
