"""The judge: a network that sees a candidate by its corners, scores it and finds the panel's corners."""

import math
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
    cell_size_px,
    map_cells,
    sample_cells,
)
from vocc_torch.types import PanelShape

SQUARE = PanelShape(14, 14)
"""A candidate's sides are cut in so many parts, whatever its rows and columns."""


@dataclass(frozen=True)
class JudgeSettings:
    """What the judge sees of a candidate."""

    samples: int = 2  # along a side of one of the parts of SQUARE
    leds: int = 8  # for which a picture is large enough
    most_grown: int = 4  # times, that a picture is larger
    margin: int = 5  # parts around the candidate
    most: float = 4.0  # standard deviations, beyond which grey values are cut
    grain: float = 4.0  # variance of grey values, that counts as no contrast
    heat_px: int = 2  # side of a place in the corners' maps
    about: int = 2  # places about the best one that are averaged


SETTINGS = JudgeSettings()


def samples_of(shape: PanelShape) -> tuple[int, int]:
    """Say how many px the parts of SQUARE have in the pictures of candidates, down and across; powers of 2.

    Example:
        >>> samples_of(PanelShape(4, 8)), samples_of(PanelShape(8, 16)), samples_of(PanelShape(32, 32))
        ((2, 2), (2, 4), (4, 4))
    """
    down, across = (
        2 ** max(0, round(math.log2(leds / SETTINGS.leds)))
        for leds in (shape.rows, shape.columns)
    )
    while down * across > SETTINGS.most_grown:
        down, across = (down // 2, across) if down > across else (down, across // 2)
    return SETTINGS.samples * down, SETTINGS.samples * across


class Judge(nn.Module):
    """Convolutions at strides 2, 4 and 8: a score, and a map for each corner of where it is.

    Example:
        >>> shape = PanelShape(8, 8)
        >>> waves = waves_of(torch.tensor([shape.sides]), samples_of(shape))
        >>> logit, maps = Judge()(torch.rand(5, 48, 48), waves)
        >>> logit.shape, maps.shape
        (torch.Size([5]), torch.Size([5, 4, 24, 24]))
    """

    sides_px: ClassVar[int] = 8
    """Its pictures' sides are multiples of this."""

    def __init__(self, fine: int = 24, coarse: int = 32) -> None:
        super().__init__()
        self.first = convolution(SETTINGS.heat_px**2, fine)
        self.lattice = nn.Conv2d(2 * SETTINGS.heat_px**2, fine, 3, 1, 1, bias=False)
        self.down = convolution(fine, coarse, 2)
        self.mid = nn.ModuleList([convolution(coarse, coarse) for _ in range(3)])
        self.deep = convolution(coarse, coarse, 2)
        self.deep2 = convolution(coarse, coarse)
        self.heat = nn.Conv2d(fine, 4, 1)
        self.coarse_heat = nn.Conv2d(coarse, 4 * SETTINGS.heat_px**2, 1)
        self.score = nn.Sequential(
            nn.Linear(2 * coarse, fine), nn.ReLU(), nn.Linear(fine, 1)
        )

    def forward(self, pictures: Tensor, waves: Tensor) -> tuple[Tensor, Tensor]:
        """Score pictures (n,H,W) of candidates, (n,), and map their corners, (n,4,H/2,W/2) logits.

        Args:
            pictures: grey values.
            waves: (n,2,H,W), or (1,2,H,W) for all, of :func:`waves_of`.
        """
        light = standardised(pictures, SETTINGS.grain, SETTINGS.most)
        blocks = functional.pixel_unshuffle(light[:, None], SETTINGS.heat_px)
        lattice = self.lattice(functional.pixel_unshuffle(waves, SETTINGS.heat_px))
        fine = (self.first(blocks) + lattice).relu_()
        coarse = self.mid[0](self.down(fine).relu_()).relu_()
        coarse = coarse + self.mid[1](coarse).relu_()
        deep = self.deep2(self.deep(coarse).relu_()).relu_()
        logit = self.score(torch.cat([deep.mean((2, 3)), deep.amax((2, 3))], 1))[:, 0]
        coarse = coarse + functional.interpolate(deep, scale_factor=2.0)
        coarse = self.coarse_heat(self.mid[2](coarse).relu_())
        # As a product of matrices it takes a third of the time.
        heat = self.heat.weight.flatten(1) @ fine.flatten(2)
        maps = functional.pixel_shuffle(coarse, SETTINGS.heat_px)
        assert self.heat.bias is not None
        maps = maps + heat.view_as(maps) + self.heat.bias[:, None, None]
        return logit, maps


def waves_of(shapes: Tensor, samples: tuple[int, int]) -> Tensor:
    """Draw rows and columns (n,2) as waves: down a candidate with a period per row, across with one per column.

    Args:
        shapes: rows and columns.
        samples: px of a part of ``SQUARE``, down and across.

    Returns:
        (n,2,H,W) -1 to 1; beyond the candidate's ends a wave is 0.
    """
    waves = []
    for leds, count in zip(shapes.unbind(1), samples, strict=True):
        at = sample_cells(1, count * SQUARE.rows, 0).to(leds.device)
        wave = (2 * math.pi * leds[:, None] * at).cos().float()
        waves.append(functional.pad(wave, (count * SETTINGS.margin,) * 2))
    down, across = waves
    size = (len(shapes), down.shape[1], across.shape[1])
    planes = down[:, :, None].expand(size), across[:, None].expand(size)
    return torch.stack(planes, 1)


@lru_cache(maxsize=32)
@torch.inference_mode(False)
def _waves(shape: PanelShape, device: torch.device) -> Tensor:
    return waves_of(torch.tensor([shape.sides], device=device), samples_of(shape))


def corners_of(maps: Tensor) -> Tensor:
    """Find corners (n,4,2), px of the picture, in maps (n,4,h,w): the mean about the best place of each.

    Example:
        >>> maps = torch.zeros(1, 4, 24, 24)
        >>> maps[0, :, 5, 7] = 50.0
        >>> corners_of(maps)[0, 0].tolist()
        [15.0, 11.0]
    """
    high, wide = maps.shape[2:]
    best = maps.flatten(2).argmax(2, keepdim=True)
    steps = torch.arange(-SETTINGS.about, SETTINGS.about + 1, device=maps.device)
    y, x = (best // wide + steps)[..., None], (best % wide + steps)[..., None, :]
    beyond = (y < 0) | (y >= high) | (x < 0) | (x >= wide)
    index = y.clamp(0, high - 1) * wide + x.clamp(0, wide - 1)
    near = maps.flatten(2).gather(2, index.flatten(2)).view(index.shape)
    share = near.masked_fill(beyond, -torch.inf).flatten(2).softmax(2).view_as(index)
    middle = torch.stack([(share * x).sum((2, 3)), (share * y).sum((2, 3))], 2)
    return SETTINGS.heat_px * (middle + 0.5)


def pitch_of(quads: Tensor, shape: PanelShape) -> Tensor:
    """Give the mean pitch (n,) of quadrilaterals, px, float32."""
    pitch: Tensor = torch.stack(cell_size_px(quads, shape)).prod(0).sqrt().float()
    return pitch.nan_to_num(1.0).clamp(0.3, 300)


def judged(
    net: nn.Module, pyramid: Pyramid, quads: Tensor, shape: PanelShape
) -> tuple[Tensor, Tensor]:
    """Judge candidates (n,4,2) float64 px: logits (n,), and the corners (n,4,2) that the judge sees.

    It reads pictures of candidates in which each is a rectangle.
    """
    homography = cell_homography(quads, SQUARE)
    samples, margin = samples_of(shape), SETTINGS.margin
    pictures = pyramid.read_cells(quads, homography, SQUARE, samples, margin)
    logit, maps = net(pictures, _waves(shape, pictures.device))
    return logit, map_cells(homography, parts_of(corners_of(maps), shape))


def parts_of(places: Tensor, shape: PanelShape) -> Tensor:
    """Give places (n,4,2) px of candidates' pictures in parts of SQUARE, float64."""
    down, across = samples_of(shape)
    return places.double() / places.new_tensor([across, down]) - SETTINGS.margin
