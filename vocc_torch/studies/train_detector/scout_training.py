"""Training of the scout, on crops with and without panels."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.detector import scout
from vocc_torch.studies.train_detector.composition import (
    Draws,
    finished,
    mirrored,
    poses,
    with_panels,
)
from vocc_torch.studies.train_detector.material import Material, Spot, cut_at, levels_of


@dataclass(frozen=True)
class ScoutTraining:
    """Settings of the training."""

    crop_px: int = 128
    composed: int = 22  # crops of a batch with a panel that is laid into a picture
    rendered: int = 14  # with a rendered panel
    empty: int = 16  # without a panel
    mined: int = 12  # that the scout took for panels
    least_pitch_px: float = 1.8  # of LEDs that the scout is to find
    most_pitch_px: float = 4.6  # the next level shows larger ones
    most_side_px: float = 110.0  # of a panel in a crop
    blur_px: tuple[float, float] = (0.3, 1.1)
    soft_px: float = 0.45  # of LEDs' edges
    off_px: float = 45.0  # of a panel from a crop's middle, at most
    near_px: float = 6.0  # outputs so near the centre are to find the panel
    spare_share: float = 0.45  # of a side, within which others may
    corner_weight: float = 1.5
    small_px: float = 30.0  # diagonal of panels whose corners' errors count fully
    mined_frames: int = 40
    mined_of_level: int = 24
    mined_score: float = -3.0


SETTINGS = ScoutTraining()


class Crops(NamedTuple):
    """Crops (B,1,S,S), corners (B,4,2) px in the crop, and whether they show a panel (B,)."""

    grey: Tensor
    quads: Tensor
    panel: Tensor


class Sampler:
    """Draws crops.

    Args:
        material: what they are cut from.
    """

    def __init__(self, material: Material) -> None:
        self.material = material
        self.panels: list[tuple[Spot, Tensor]] = []
        for one in material.found:
            for number, plane in enumerate(levels_of(one.grey)):
                pitch = one.pitch_px / 2**number
                if SETTINGS.least_pitch_px <= pitch <= SETTINGS.most_pitch_px:
                    quad = (one.corners_px / 2**number).float()
                    x, y = quad.mean(0).tolist()
                    self.panels.append((Spot(plane, x, y), quad))
        self.mined: list[Spot] = []

    def batch(self, draw: np.random.Generator) -> Crops:
        """Draw a batch of crops."""
        composed, quads = self.composed(draw)
        parts, corners = [composed], [quads]
        if self.panels:
            crops, quads = self.rendered(draw)
            parts.append(finished(crops, Draws(draw, len(crops))))
            corners.append(quads)
        found = sum(map(len, corners))
        crops = self.material.patches(SETTINGS.crop_px, SETTINGS.empty, draw)
        if self.mined:
            crops = torch.cat([crops, self.mined_crops(draw)])
        parts.append(finished(crops, Draws(draw, len(crops))))
        corners.append(torch.zeros(len(crops), 4, 2))
        grey, quads = mirrored(torch.cat(parts), torch.cat(corners), draw)
        return Crops(grey[:, None], quads, torch.arange(len(grey)) < found)

    def composed(self, draw: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Lay panels into pictures."""
        options, draws = SETTINGS, Draws(draw, SETTINGS.composed)
        side, shapes = options.crop_px, draws.shapes()
        pitch = draws.geometric(options.least_pitch_px, options.most_pitch_px)
        pitch = torch.minimum(pitch, options.most_side_px / shapes.amax(1))
        middle = draws.uniform(-1, 1, 2) * options.off_px * 0.75 + side / 2
        quads = poses(draws, shapes, pitch, middle)
        pictures = self.material.patches(side, options.composed, draw)
        pictures = with_panels(pictures, quads, shapes, draws, options.soft_px)
        return finished(pictures, draws, options.blur_px), quads

    def rendered(self, draw: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Cut crops with rendered panels."""
        crops, quads = [], []
        for number in draw.integers(len(self.panels), size=SETTINGS.rendered):
            spot, quad = self.panels[number]
            right, down = draw.uniform(-SETTINGS.off_px, SETTINGS.off_px, 2)
            moved = Spot(spot.plane, spot.x + right, spot.y + down)
            crop, origin = cut_at(moved, SETTINGS.crop_px)
            crops.append(crop)
            quads.append(quad - torch.tensor(origin))
        return torch.from_numpy(np.stack(crops)), torch.stack(quads)

    def mined_crops(self, draw: np.random.Generator) -> Tensor:
        """Cut crops that the scout took for panels."""
        crops = []
        for number in draw.integers(len(self.mined), size=SETTINGS.mined):
            spot = self.mined[number]
            right, down = draw.uniform(-SETTINGS.off_px, SETTINGS.off_px, 2)
            moved = Spot(spot.plane, spot.x + right, spot.y + down)
            crops.append(cut_at(moved, SETTINGS.crop_px)[0])
        return torch.from_numpy(np.stack(crops))

    def mine(self, net: scout.Scout, draw: np.random.Generator) -> None:
        """Find places without a panel that the scout takes for one."""
        self.mined = []
        for number in draw.permutation(len(self.material.empty))[
            : SETTINGS.mined_frames
        ]:
            for plane in self.material.empty[number]:
                high, wide = (side // 16 * 16 for side in plane.shape)
                if not min(high, wide):
                    continue
                crop = torch.from_numpy(plane[:high, :wide]).float()
                _, quads, score = scout.peaks(
                    net(crop[None, None]), SETTINGS.mined_of_level
                )
                places = quads.mean(1)[score > SETTINGS.mined_score]
                self.mined += [Spot(plane, x, y) for x, y in places.tolist()]


def scout_loss(outputs: Tensor, crops: Crops) -> Tensor:
    """Give the focal loss of scores and the distance of corners where a panel is."""
    high, wide = outputs.shape[2:]
    stride = scout.SETTINGS.stride_px
    row, column = torch.meshgrid(torch.arange(high), torch.arange(wide), indexing="ij")
    places = torch.stack([column, row], -1)
    centre = crops.quads.mean(1)[:, None, None]
    apart = ((places + 0.5) * stride - centre).norm(dim=3)
    size = (crops.quads[:, 0] - crops.quads[:, 2]).norm(dim=1)[:, None, None]
    panel = crops.panel[:, None, None]
    spare = (apart < SETTINGS.spare_share * size) & panel
    nearest = apart <= apart.flatten(1).amin(1)[:, None, None].clamp(min=1e-3)
    inside = ((centre > 0) & (centre < high * stride)).all(3)
    near = (apart < SETTINGS.near_px) | (nearest & (apart < stride))
    there = panel & inside & near
    logit = outputs[:, 0]
    found = logit.sigmoid()
    missed = (1 - found).square() * functional.logsigmoid(logit)
    false = found.square() * functional.logsigmoid(-logit)
    cost = torch.where(there, missed, torch.where(spare, 0.0, false))
    picture, y, x = there.nonzero(as_tuple=True)
    quads = scout.quads_of(outputs[picture, :, y, x], torch.stack([x, y], 1))
    # Of small panels a pixel is more of a cell.
    unit = scout.SETTINGS.unit_px * (size[picture, 0, 0] / SETTINGS.small_px)
    off = (quads - crops.quads[picture]) / unit[:, None, None]
    far = functional.smooth_l1_loss(off, torch.zeros_like(off), beta=0.05)
    loss: Tensor = 8 * SETTINGS.corner_weight * far - cost.sum() / there.sum().clamp(1)
    return loss
