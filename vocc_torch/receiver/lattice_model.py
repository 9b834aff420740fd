"""The light of an LED lattice with two levels, On and Off, as a camera with a gamma would show it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from vocc_torch.receiver.rectification import MOST_PX, cell_homography, rectify
from vocc_torch.types import Frames, Panels, PanelShape

GAMMA = 2.2
"""Exponent of common cameras, between linear light and grey values."""

SAMPLES = 4
"""Samples along an LED cell's side."""

MARGIN = 1
"""Cells around the panel on which a lattice is fitted."""

# Standard deviation of rounding, DN: no picture fits better.
ROUNDING_DN = 0.29
_OUTLIER = 3.0


@dataclass(slots=True)
class Lattice:
    """LED lattices as fitted to B pictures.

    Args:
        corners_px: (B,4,2) float64, as in :class:`vocc_torch.types.Panels`.
        blur: (B,2) float64, standard deviation of a spot along the rows and down the columns, cells.
        levels: (B,2) float64, light of an Off and an On LED in its middle above the background; white is 1.
        background: (B,) float64, light of the background.
        bits: (B,R,C) bool, which LEDs are taken to be On.
        rms_dn: (B,) float64, root mean square of what the lattice leaves unexplained, DN, with the weights of
            :meth:`Model.trust`.
        share: (B,) float64, share of the picture's variation about the background that it explains, at most
            1, with the same weights.
        share_of_all: (B,) float64, the share where all pixels weigh alike.
    """

    corners_px: Tensor
    blur: Tensor
    levels: Tensor
    background: Tensor
    bits: Tensor
    rms_dn: Tensor
    share: Tensor
    share_of_all: Tensor

    @classmethod
    def at(cls, corners_px: Tensor, blur: Tensor, background_dn: Tensor, shape: PanelShape) -> Lattice:
        """Start with corners (B,4,2), a blur (B,) and a background (B,), DN; without light."""
        none = background_dn.new_zeros(len(corners_px), dtype=torch.float64)
        bits = torch.zeros(len(none), shape.rows, shape.columns, dtype=torch.bool, device=none.device)
        light = linear_light(background_dn.to(torch.float64))
        pairs = blur[:, None].repeat(1, 2), torch.stack([none, none], 1)
        return cls(corners_px.clone(), *pairs, light, bits, none, none.clone(), none.clone())

    @property
    def shape(self) -> PanelShape:
        """Rows and columns."""
        return PanelShape(*self.bits.shape[1:])

    def amplitudes(self) -> Tensor:
        """(B,R,C) float32 light of each LED."""
        levels = self.levels.to(torch.float32)
        return torch.where(self.bits, levels[:, 1:, None], levels[:, :1, None])

    def __getitem__(self, rows: Tensor | slice) -> Lattice:
        """Take the lattices of an index, a bool mask or a slice."""
        return Lattice(*(getattr(self, field.name)[rows] for field in fields(self)))

    def put(self, rows: Tensor, other: Lattice) -> None:
        """Overwrite the lattices ``rows``."""
        for field in fields(self):
            getattr(self, field.name)[rows] = getattr(other, field.name)


def linear_light(grey: Tensor) -> Tensor:
    """Undo the camera's gamma; white is 1, and grey values below 0 are black.

    Example:
        >>> linear_light(torch.tensor([0.0, 255.0])).tolist()
        [0.0, 1.0]
    """
    return (grey / 255).clamp(min=0) ** GAMMA


def grey_values(light: Tensor) -> Tensor:
    """Give the grey values, DN, of light of which 1 is white; more is white too, and less than 1e-5 is that.

    Example:
        >>> grey_values(torch.tensor([1.0, 7.0])).tolist()
        [255.0, 255.0]
    """
    return 255 * light.clamp(1e-5, 1.0) ** (1 / GAMMA)


def moved(corners_px: Tensor, cells: Tensor, shape: PanelShape) -> Tensor:
    """Map points in cell coordinates, (B,P,2) columns and rows, into the image, (B,P,2) px, finite.

    Example:
        >>> corners = torch.tensor([[[2.0, 3.0], [10.0, 3.0], [10.0, 11.0], [2.0, 11.0]]]).double()
        >>> point = torch.tensor([[[8.0, -1.0]]]).double()
        >>> moved(corners, point, PanelShape(8, 8)).round(decimals=9).tolist()
        [[[10.0, 2.0]]]
    """
    points = torch.cat([cells, torch.ones_like(cells[..., :1])], 2) @ cell_homography(corners_px, shape).mT
    # A point on the horizon is as far away as a corner may be.
    return (points[..., :2] / points[..., 2:]).nan_to_num().clamp(-MOST_PX, MOST_PX)


def corner_cells(shape: PanelShape, beyond: float = 0.0) -> Tensor:
    """Give the cell coordinates of the corners, (4,2) float64, or of points ``beyond`` cells outside them.

    Example:
        >>> corner_cells(PanelShape(4, 8)).tolist()
        [[0.0, 0.0], [8.0, 0.0], [8.0, 4.0], [0.0, 4.0]]
    """
    least, right, low = 0 - beyond, shape.columns + beyond, shape.rows + beyond
    ends = [[least, least], [right, least], [right, low], [least, low]]
    return torch.tensor(ends, dtype=torch.float64)


def sample_cells(leds: int, margin: int) -> Tensor:
    """Give the cell coordinates of an axis's samples, ``margin`` cells beyond either end included.

    Example:
        >>> sample_cells(1, 0).tolist()
        [0.125, 0.375, 0.625, 0.875]
    """
    return (torch.arange((leds + 2 * margin) * SAMPLES, dtype=torch.float64) + 0.5) / SAMPLES - margin


def read_patches(frames: Frames, corners_px: Tensor, shape: PanelShape, margin: int) -> Tensor:
    """Resample grey values around the panel, (B,(R+2m)K,(C+2m)K) float32 with K = ``SAMPLES``."""
    beyond = margin - 1
    if beyond:
        cells = corner_cells(shape, beyond).to(corners_px.device).expand(len(corners_px), 4, 2)
        corners_px = moved(corners_px, cells, shape)
    wide = PanelShape(shape.rows + 2 * beyond, shape.columns + 2 * beyond)
    return rectify(frames, Panels.known(corners_px), wide, SAMPLES)[:, 0].to(torch.float32)


@dataclass(frozen=True, slots=True)
class Spots:
    """Profiles of the spots along an axis at its samples, and their derivatives: all (B,N,n) float32.

    Args:
        value: of spot n at sample N, 1 in its middle.
        by_place: by the middle's place, per cell.
        by_blur: by the standard deviation, per cell.
        lever: (n,) the middles' places, -1 to 1 over the panel.
    """

    value: Tensor
    by_place: Tensor
    by_blur: Tensor
    lever: Tensor

    @classmethod
    def of(cls, leds: int, blur: Tensor) -> Spots:
        """Lay ``leds`` spots of the standard deviations (B,), in cells, along an axis."""
        centre = torch.arange(leds, dtype=torch.float32, device=blur.device) + 0.5
        width = blur[:, None, None].to(torch.float32)
        offset = (sample_cells(leds, MARGIN).to(centre)[:, None] - centre) / width
        value = torch.exp(-(offset**2) / 2)
        by_place = value * offset / width
        return cls(value, by_place, by_place * offset, 2 * centre / leds - 1)


@dataclass(frozen=True, slots=True)
class Model:
    """A lattice's picture beside the one that was taken.

    Args:
        grey: (B,H,W) float32, the picture as resampled about the lattice, DN.
        rows: spots down the columns, one a row.
        columns: spots along the rows, one a column.
        parts: (B,2,H,W) light of the Off and of the On LEDs at levels of 1.
        light: (B,H,W) light that the lattice predicts, background included.
        predicted: (B,H,W) its grey values, DN.
    """

    grey: Tensor
    rows: Spots
    columns: Spots
    parts: Tensor
    light: Tensor
    predicted: Tensor

    @classmethod
    def of(cls, grey: Tensor, lattice: Lattice) -> Model:
        """Predict pictures that are resampled about the lattices."""
        columns = Spots.of(lattice.shape.columns, lattice.blur[:, 0])
        rows = Spots.of(lattice.shape.rows, lattice.blur[:, 1])
        return cls._seen(grey, rows, columns, lattice)

    @classmethod
    def _seen(cls, grey: Tensor, rows: Spots, columns: Spots, lattice: Lattice) -> Model:
        """Predict pictures by spots that are laid already."""
        both = torch.stack([~lattice.bits, lattice.bits], 1).to(grey.dtype)
        parts = rows.value[:, None] @ both @ columns.value[:, None].mT
        levels, background = lattice.levels.to(grey.dtype), lattice.background.to(grey.dtype)
        light = (parts * levels[:, :, None, None]).sum(1) + background[:, None, None]
        return cls(grey, rows, columns, parts, light, grey_values(light))

    def again(self, lattice: Lattice) -> Model:
        """Predict anew after a change of bits, levels and background only."""
        return self._seen(self.grey, self.rows, self.columns, lattice)

    def trust(self) -> Tensor:
        """Weigh pixels (B,H,W): what the lattice cannot explain, such as what hides the panel, counts little.

        Cauchy's weights, of which a squared difference loses half at three mean absolute ones.
        """
        rest = (self.grey - self.predicted).abs()
        scale = _OUTLIER * rest.mean((1, 2), keepdim=True) + 1.0
        return 1 / (1 + (rest / scale) ** 2)

    def scored(self, lattice: Lattice) -> Lattice:
        """Note how well the lattice explains the picture."""
        level = grey_values(lattice.background).to(self.grey.dtype)[:, None, None]
        rest, spread = (self.grey - self.predicted).square(), (self.grey - level).square()
        trust = self.trust()
        alike = rest.mean((1, 2)), spread.mean((1, 2))
        weighed = [(one * trust).sum((1, 2)) / trust.sum((1, 2)) for one in (rest, spread)]
        shares = [
            1 - left.to(torch.float64) / whole.to(torch.float64).clamp(min=ROUNDING_DN**2)
            for left, whole in (weighed, alike)
        ]
        rms = weighed[0].to(torch.float64).sqrt()
        return replace(lattice, rms_dn=rms, share=shares[0], share_of_all=shares[1])
