"""Readings of the pool: crops anywhere, and pictures in which a quadrilateral lies where it is asked for."""

from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.studies.train_detector.draws import Draws
from vocc_torch.studies.train_detector.geometry import (
    homography,
    mapped,
    pixels,
    signed_area,
)
from vocc_torch.studies.train_detector.pool import Pool


@dataclass(frozen=True)
class CropSettings:
    """How crops of pictures without a panel are chosen."""

    level_shares: tuple[float, ...] = (0.51, 0.31, 0.18)  # of a frame's finest levels
    scaled: float = 0.4  # share of crops at another scale than a level's
    scale: tuple[float, float] = (0.75, 1.4)


SETTINGS = CropSettings()


@dataclass(frozen=True)
class Views:
    """How crops of a side of S px lie in frames: turned and mirrored by quarters, and scaled.

    Args:
        frame: (B,) numbers.
        level: (B,) of the pyramid.
        centre_px: (B,2) px of the frame.
        matrix: (B,2,2) from px of the crop to px of the frame.
        side_px: S.
    """

    frame: Tensor
    level: Tensor
    centre_px: Tensor
    matrix: Tensor
    side_px: int

    def read(self, pool: Pool) -> Tensor:
        """Read the crops (B,S,S)."""
        points = pixels(self.side_px, self.side_px, self.frame.device)
        at = self.matrix @ (points - self.side_px / 2) + self.centre_px[..., None]
        crops = pool.read(self.frame, self.level, at)
        return crops.view(-1, self.side_px, self.side_px)

    def seen(self, points_px: Tensor) -> Tensor:
        """Map points of the frames (B,P,2) into the crops."""
        off = (points_px - self.centre_px[:, None]).mT
        places: Tensor = torch.linalg.solve(self.matrix, off).mT + self.side_px / 2
        return places


def views(
    draws: Draws, frame: Tensor, level: Tensor, centre_px: Tensor, side_px: int
) -> Views:
    """Turn, mirror and scale crops at random, about whole pixels of a level: its grey values as they are."""
    unit = 2.0 ** level[:, None]
    centre = ((centre_px / unit).round() * unit).float()
    over = draws.coin(0.5)[..., None]
    signs = torch.diag_embed(2.0 * draws.below(2, 2) - 1)
    matrix = torch.where(over, signs.flip(2), signs)
    scaled, scale = draws.coin(SETTINGS.scaled), draws.geometric(*SETTINGS.scale, 1)
    scale = torch.where(scaled, scale, 1.0) * unit
    return Views(frame, level, centre, matrix * scale[..., None], side_px)


def empty_crops(pool: Pool, draws: Draws, side_px: int) -> Tensor:
    """Cut crops (B,S,S) from pictures without a panel, anywhere."""
    shares, frames = SETTINGS.level_shares, pool.empty
    level = draws.chosen(range(len(shares)), shares)
    centre = draws.uniform(0, 1, 2) * pool.sizes[0].flip(0)
    frame = frames[draws.below(len(frames))]
    return views(draws, frame, level, centre, side_px).read(pool)


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
