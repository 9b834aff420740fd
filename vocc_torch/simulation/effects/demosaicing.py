"""A grey picture from a mosaic of colours."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
import torch.nn.functional as F
from kornia.color import CFA, raw_to_rgb, rgb_to_grayscale
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.bayer import Bayer
from vocc_torch.simulation.effects.noise_planes import origins_px

PATTERNS = {(0, 0): CFA.BG, (1, 0): CFA.GB, (0, 1): CFA.GR, (1, 1): CFA.RG}
"""Kornia's names of how a frame's pattern begins, by the parity of its origin: red lies at even and even."""

CELL_PX = 2
STRIP_ROWS = 64
"""Rows demosaiced at a time, whole cells: their working arrays stay in the processor's cache."""


@dataclass(frozen=True, slots=True)
class Demosaicing(Effect):
    """White balance, bilinear interpolation of each colour, and luma ``0.299 R + 0.587 G + 0.114 B``.

    The balance divides each pixel by the share that its filter of the scene's own ``bayer`` lets through,
    so grey stays grey. What remains is what colour cameras do to a grey picture: two of three colours are
    guessed from neighbours, so edges lose sharpness, the more so in red and blue; and where noise came
    between, that of red and blue pixels is amplified and spread. Without ``bayer`` there is nothing to
    balance and the blur alone remains. A uniform frame stays uniform.

    It runs in float64, so that a frame does not depend on the batch it comes in. Linear and differentiable.

    Source: Kornia's ``raw_to_rgb`` and ``rgb_to_grayscale``; luma of ITU-R BT.601, which the recordings'
    grey is too.

    Example:
        >>> Demosaicing().reach_px
        1
    """

    name: ClassVar[str] = "demosaicing"
    takes: ClassVar[Quantity] = Quantity.EXPOSURE
    gives: ClassVar[Quantity] = Quantity.EXPOSURE

    @property
    def reach_px(self) -> int:
        """Neighbours at one pixel's distance are averaged."""
        return 1

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Balance and demosaic (B,1,H,W) luminous exposure.

        Raises:
            VoccError: a sensor without a whole cell of 2 x 2 pixels.
        """
        for name in ("width_px", "height_px"):
            if getattr(context.camera, name) < CELL_PX:
                rule = f"it must be at least {CELL_PX}: scene.effects.demosaicing reads cells of 2 x 2 pixels"
                raise VoccError(f"camera.{name} is {getattr(context.camera, name)}: {rule}")
        raw = value.to(torch.float64)
        for effect in context.effects:
            if isinstance(effect, Bayer):
                raw = raw / effect.filters(raw, context)
        phases = [(x % 2, y % 2) for x, y in origins_px(context)]
        if len(set(phases)) == 1:
            return _luma(raw, PATTERNS[phases[0]]).to(value.dtype)
        order = sorted(range(len(phases)), key=phases.__getitem__)
        groups = itertools.groupby(order, key=phases.__getitem__)
        parts = [_luma(raw[list(rows)], PATTERNS[phase]) for phase, rows in groups]
        return torch.cat(parts)[np.argsort(order)].to(value.dtype)


def _luma(raw: Tensor, pattern: CFA) -> Tensor:
    """Demosaic (B,1,H,W) frames of one pattern, strip by strip, each with the rows that its border needs."""
    height = raw.shape[-2]
    strips = []
    for top in range(0, height, STRIP_ROWS):
        above = min(top, CELL_PX)
        strip = _strip_luma(raw[..., top - above : top + STRIP_ROWS + CELL_PX, :], pattern)
        strips.append(strip[..., above : above + min(STRIP_ROWS, height - top), :])
    return torch.cat(strips, dim=-2)


def _strip_luma(raw: Tensor, pattern: CFA) -> Tensor:
    """Demosaic one strip; odd sides are continued by reflection, which keeps the pattern."""
    height, width = raw.shape[-2:]
    even = F.pad(raw, (0, width % CELL_PX, 0, height % CELL_PX), mode="reflect")
    luma: Tensor = rgb_to_grayscale(raw_to_rgb(even, pattern))[..., :height, :width]
    return luma
