"""Readings of the pool: crops anywhere, and pictures in which a quadrilateral lies where it is asked for."""

from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.studies.train_detector.composition import (
    Draws,
    homography,
    mapped,
    pixels,
)
from vocc_torch.studies.train_detector.pool import Pool


@dataclass(frozen=True)
class CropSettings:
    """How crops of pictures without a panel are chosen."""

    level_share: float = 0.6  # of a level, of the next finer one's
    finest_levels: int = 3  # of a frame that are cut from
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
    """Turn, mirror and scale crops at random."""
    over = draws.coin(0.5)[..., None]
    signs = torch.diag_embed(2.0 * draws.below(2, 2) - 1)
    matrix = torch.where(over, signs.flip(2), signs)
    scale = torch.where(
        draws.coin(SETTINGS.scaled), draws.geometric(*SETTINGS.scale, 1), 1.0
    )
    scale = scale * 2.0 ** level[:, None]
    return Views(frame, level, centre_px, matrix * scale[..., None], side_px)


def empty_crops(pool: Pool, draws: Draws, side_px: int) -> Tensor:
    """Cut crops (B,S,S) from pictures without a panel, anywhere."""
    device = draws.device
    shares = SETTINGS.level_share ** torch.arange(
        SETTINGS.finest_levels, device=device, dtype=torch.float32
    )
    level, frames = draws.chosen(shares), pool.empty
    size = pool.sizes[0].flip(0)
    # Whole pixels of the level: its grey values as they are.
    unit = (2**level)[:, None]
    centre = (draws.uniform(0, 1, 2) * size / unit).floor() * unit
    frame = frames[draws.below(len(frames))]
    return views(draws, frame, level, centre.float(), side_px).read(pool)


def pictures(
    pool: Pool,
    frame: Tensor,
    quads_px: Tensor,
    places_px: Tensor,
    size: tuple[int, int],
) -> Tensor:
    """Read pictures (B,h,w) in which corners (B,4,2) px of frames lie at places (B,4,2) px."""
    matrix = homography(places_px.float(), quads_px.float())
    shares = area(quads_px) / area(places_px)
    level = (shares.clamp(min=1e-3).log2() / 2).round()
    level = level.clamp(0, len(pool.sizes) - 1).long()
    at = mapped(matrix, pixels(*size, frame.device))
    return pool.read(frame, level, at).view(-1, *size)


def area(quads: Tensor) -> Tensor:
    """Give the areas (B,) of quadrilaterals, px^2."""
    (x, y), (right, below) = quads.unbind(2), quads.roll(-1, 1).unbind(2)
    return ((x * below - y * right).sum(1) / 2).abs()


def ordered(quads: Tensor) -> Tensor:
    """Begin corners (B,4,2) at the top left, clockwise."""
    (x, y), (right, below) = quads.unbind(2), quads.roll(-1, 1).unbind(2)
    back = ((x * below - y * right).sum(1) < 0)[:, None, None]
    quads = torch.where(back, quads.flip(1), quads)
    first = quads.sum(2).argmin(1)[:, None] + torch.arange(4, device=quads.device)
    return quads.gather(1, (first % 4)[..., None].expand(-1, -1, 2))


def turned(draws: Draws, quads: Tensor, quarters: bool | Tensor = True) -> Tensor:
    """Begin corners (B,4,2) anywhere and go either way: what is read so is turned and mirrored.

    Args:
        draws: B of them.
        quads: corners.
        quarters: whether quarter turns are among them, not halves alone.
    """
    first = draws.below(4)
    first = torch.where(
        torch.as_tensor(quarters, device=first.device), first, first // 2 * 2
    )
    back = draws.below(2) * 2 - 1
    steps = torch.arange(4, device=quads.device)
    # Going the other way, a side of the same length comes first.
    order = (first[:, None] + back[:, None] * steps + (back[:, None] < 0)) % 4
    return quads.gather(1, order[..., None].expand(-1, -1, 2))
