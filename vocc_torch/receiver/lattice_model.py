"""The light of an LED lattice with two levels, On and Off, as a camera with a gamma of 2.2 would show it.

:func:`search_lattice` finds where the lattice may lie near a quadrilateral, over pitch, place and blur.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple, Self

import torch
from torch import Tensor

from vocc_torch.receiver.levels import grey_values, linear_light
from vocc_torch.receiver.resample import corner_cells, map_points, rectify, sample_cells
from vocc_torch.types import Batched, Frames, Panels, PanelShape


@dataclass(frozen=True)
class PatchSettings:
    """How a patch of a picture is read, and compared with a lattice."""

    samples: int = 4  # along an LED cell's side
    margin: int = 1  # cells around the panel
    # Standard deviation of rounding: no picture fits better.
    rounding_dn: float = 0.29
    # Mean absolute differences at which a squared difference counts by half.
    outlier: float = 3.0
    # Standard deviation of the face's blurred edge over that of a spot; the spot's has
    # the LED's size in it.
    edge_blur: float = 0.7


PATCH = PatchSettings()


@dataclass(frozen=True, slots=True)
class Lattice(Batched):
    """LED lattices as fitted to B pictures.

    Args:
        corners_px: (B,4,2) float64, as in :class:`vocc_torch.types.Panels`.
        blur: (B,2) float64, standard deviation of a spot along the rows and down the columns, cells.
        levels: (B,2) float64, light of an Off and an On LED in its middle above the background; white is 1.
        background: (B,) float64, light of the background.
        face: (B,) float64, light of the panel's face between the LEDs above the background.
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
    face: Tensor
    bits: Tensor
    rms_dn: Tensor
    share: Tensor
    share_of_all: Tensor

    @classmethod
    def at(
        cls, corners_px: Tensor, blur: Tensor, background_dn: Tensor, shape: PanelShape
    ) -> Self:
        """Start with corners (B,4,2), a blur (B,) and a background (B,), DN; without light."""
        none = background_dn.new_zeros(4, len(corners_px), dtype=torch.float64)
        bits = none.new_zeros(
            len(corners_px), shape.rows, shape.columns, dtype=torch.bool
        )
        light = linear_light(background_dn.double())
        levels, face = none[:2].mT.clone(), none[0]
        return cls(
            corners_px.clone(),
            blur[:, None].repeat(1, 2),
            levels,
            light,
            face,
            bits,
            *none[1:],
        )

    @property
    def shape(self) -> PanelShape:
        """Rows and columns."""
        return PanelShape(*self.bits.shape[1:])

    def amplitudes(self) -> Tensor:
        """(B,R,C) float32 light of each LED."""
        levels = self.levels.float()
        return torch.where(self.bits, levels[:, 1:, None], levels[:, :1, None])


def read_patches(
    frames: Frames, corners_px: Tensor, shape: PanelShape, margin: int
) -> Tensor:
    """Resample grey values around the panel, (B,(R+2m)K,(C+2m)K) float32 with K = ``PATCH.samples``."""
    return rectify(
        frames, Panels.known(corners_px), shape, PATCH.samples, margin=margin
    )[:, 0].float()


class Profiles(NamedTuple):
    """Profiles along an axis at its samples, float32.

    Args:
        spots: (B,N,n) of spot n at sample N, 1 in its middle.
        by_blur: (B,N,n) their derivatives by the spots' standard deviation, per cell.
        face: (B,N) of the face, 1 within the panel, 0 outside.
    """

    spots: Tensor
    by_blur: Tensor
    face: Tensor

    @classmethod
    def of(cls, leds: int, blur: Tensor) -> Self:
        """Compute the profiles of an axis of LEDs from the standard deviations (B,) of its spots, cells."""
        samples, middles = _places(leds, blur.device)
        width = blur.float()[:, None, None]
        offset = (samples[:, None] - middles) / width
        spots = torch.exp(-(offset**2) / 2)
        edge = PATCH.edge_blur * width[..., 0]
        rise, fall = (torch.special.ndtr((samples - end) / edge) for end in (0, leds))
        return cls(spots, spots * offset**2 / width, rise - fall)


@lru_cache(maxsize=32)
@torch.inference_mode(False)
def _places(leds: int, device: torch.device) -> list[Tensor]:
    """Return an axis's samples (N,) and the middles of its spots (n,), cells, float32."""
    places = sample_cells(leds, PATCH.samples, PATCH.margin), sample_cells(leds, 1, 0)
    return [place.float().to(device) for place in places]


class Model(NamedTuple):
    """A lattice's picture and the measured one.

    Args:
        grey: (B,H,W) float32, the picture as resampled about the lattice, DN.
        lattice: of B pictures.
        rows: down the columns, with a spot for each row.
        columns: along the rows, with a spot for each column.
        box: (B,H,W) light of a face of 1.
        base: (B,H,W) light without LEDs: that of the background and of the face.
        parts: (B,2,H,W) light of the Off and of the On LEDs at levels of 1.
        light: (B,H,W) light that the lattice predicts, background included.
        predicted: (B,H,W) its grey values, DN.
    """

    grey: Tensor
    lattice: Lattice
    rows: Profiles
    columns: Profiles
    box: Tensor
    base: Tensor
    parts: Tensor
    light: Tensor
    predicted: Tensor

    @classmethod
    def of(cls, grey: Tensor, lattice: Lattice) -> Self:
        """Predict pictures that are resampled about the lattices."""
        sides = zip(lattice.shape.sides, lattice.blur.flip(1).unbind(1), strict=True)
        rows, columns = (Profiles.of(*side) for side in sides)
        lit = torch.stack([~lattice.bits, lattice.bits], 1).to(grey.dtype)
        parts = rows.spots[:, None] @ lit @ columns.spots[:, None].mT
        box = rows.face[:, :, None] * columns.face[:, None]
        background, face = (
            light.to(grey.dtype)[:, None, None]
            for light in (lattice.background, lattice.face)
        )
        base = background + face * box
        levels = lattice.levels.to(grey.dtype)[:, :, None, None]
        light = base + (parts * levels).sum(1)
        predicted = grey_values(light)
        return cls(grey, lattice, rows, columns, box, base, parts, light, predicted)

    def trust(self) -> Tensor:
        """Weigh pixels (B,H,W): what the lattice cannot explain, such as what hides the panel, counts little.

        Cauchy's weights, of which a squared difference loses half at three mean absolute ones.
        """
        misfit = (self.grey - self.predicted).abs()
        scale = PATCH.outlier * misfit.mean((1, 2), keepdim=True) + 1.0
        return 1 / (1 + (misfit / scale) ** 2)

    def scored(self, trust: Tensor) -> Lattice:
        """Return the lattice with its ``rms_dn`` and shares; ``trust`` (B,H,W) weighs the pixels."""
        level = grey_values(self.lattice.background).to(self.grey.dtype)[:, None, None]
        squares = [(self.grey - part).square() for part in (self.predicted, level)]
        weight = trust.sum((1, 2))
        means = [(square * trust).sum((1, 2)) / weight for square in squares]
        means += [square.mean((1, 2)) for square in squares]
        left, spread = torch.stack(means).double().view(2, 2, -1).unbind(1)
        share, share_of_all = 1 - left / spread.clamp(min=PATCH.rounding_dn**2)
        return replace(
            self.lattice, rms_dn=left[0].sqrt(), share=share, share_of_all=share_of_all
        )


@dataclass(frozen=True)
class SearchSettings:
    """Grid of the search."""

    margin: int = 2  # cells around the quadrilateral
    pitches: int = 20
    shifts: int = 21
    most_apart: int = 1  # steps of pitch between the axes; the fit stretches further
    blurs_cells: tuple[float, ...] = (0.16, 0.26, 0.42)
    extent_cells: float = 3.0  # by which a panel may be larger than the quadrilateral
    shift_cells: float = 1.5  # by which its middle may be off
    least_leds: int = 8  # of an axis, for the steps of pitch


SEARCH = SearchSettings()


@lru_cache(maxsize=8)
@torch.inference_mode(False)
def _bank(leds: int, most: int, device: torch.device) -> tuple[Tensor, ...]:
    """Span of ``leds`` spots at each candidate's places on an axis, ``most`` being that of both axes.

    Returns:
        (P,) pitches and (S,) shifts, cells; (N*(N+1)/2,P*S*G) upper triangles of projectors, in which what is
        beside the diagonal counts twice; (N*(N+1)/2,) where in N x N numbers the upper triangle lies.
    """
    pitch = 1 + torch.linspace(
        -SEARCH.extent_cells, SEARCH.extent_cells, SEARCH.pitches, dtype=torch.float64
    ) / max(most, SEARCH.least_leds)
    shift = torch.linspace(
        -SEARCH.shift_cells, SEARCH.shift_cells, SEARCH.shifts, dtype=torch.float64
    )
    blur = torch.tensor(SEARCH.blurs_cells, dtype=torch.float64)
    p, s, g = (
        part[:, None, None]
        for part in torch.cartesian_prod(pitch, shift, blur).unbind(1)
    )
    centre = leds / 2 + s + p * (sample_cells(leds, 1, 0) - leds / 2)
    samples = sample_cells(leds, PATCH.samples, SEARCH.margin)[:, None]
    spots = torch.exp(-(((samples - centre) / (g * p)) ** 2) / 2)
    basis = torch.linalg.qr(spots)[0]
    row, column = torch.triu_indices(spots.shape[1], spots.shape[1])
    halves = (basis @ basis.mT)[:, row, column] * torch.where(row == column, 1.0, 2.0)
    projectors = halves.mT.float().contiguous()
    upper = row * spots.shape[1] + column
    return tuple(part.to(device) for part in (pitch, shift, projectors, upper))


def search_lattice(
    frames: Frames,
    corners_px: Tensor,
    background: Tensor,
    shape: PanelShape,
) -> tuple[Tensor, Tensor]:
    """Find the lattice near a quadrilateral whose spots explain most of the light.

    The light of a lattice of equal spots lies, row by row, in the span of C spots, and column by column in
    that of R, whatever the bits. The energy in each candidate's span is summed over both axes; the pitches,
    in the quadrilateral's cells, are nearly the same along both, as is the blur.

    Args:
        frames: B frames or crops.
        corners_px: (B,4,2) quadrilaterals, off by up to 1.5 cells in place and 3 in extent.
        background: (B,) grey value of what is around the panel.
        shape: rows and columns, at most 16 each: a search takes memory by their square.

    Returns:
        (B,4,2) corners of the best lattice, and (B,) its spots' standard deviation, cells; of equally good
        ones, as in a picture without light, the first.

    Example:
        >>> x = torch.arange(64.0) + 0.5
        >>> row = sum(torch.exp(-(((x - centre) / 2) ** 2) / 2) for centre in (22, 30, 38, 46))
        >>> grey = (255 * (0.1 + 0.8 * row[:, None] * row) ** (1 / 2.2)).view(1, 64, 64)
        >>> start = torch.tensor([[[14.0, 20.0], [48.0, 20.0], [48.0, 54.0], [14.0, 54.0]]]).double()
        >>> background = torch.full((1,), 255 * 0.1 ** (1 / 2.2)).double()
        >>> corners, _ = search_lattice(Frames.whole(grey), start, background, PanelShape(4, 4))
        >>> bool((corners[0, [0, 2]] - torch.tensor([[18.0, 18.0], [50.0, 50.0]])).abs().max() < 1.5)
        True
    """
    grey = read_patches(frames, corners_px, shape, SEARCH.margin)
    light = linear_light(grey) - linear_light(background.to(grey.dtype))[:, None, None]
    sides = shape.columns, shape.rows
    products = light.mT @ light, light @ light.mT
    banks = [_bank(leds, max(sides), light.device) for leds in sides]
    size = len(light), SEARCH.pitches, SEARCH.shifts, len(SEARCH.blurs_cells)
    bests = [
        (product.flatten(1)[:, upper] @ spans).view(size).max(2)
        for product, (_, _, spans, upper) in zip(products, banks, strict=True)
    ]
    # Energy by pitch along the rows, pitch down the columns and blur.
    pitches = torch.arange(SEARCH.pitches, device=light.device)
    energy = bests[0].values[:, :, None] + bests[1].values[:, None]
    apart = (pitches[:, None] - pitches).abs() > SEARCH.most_apart
    chosen = energy.masked_fill(apart[..., None], -torch.inf).flatten(1).argmax(1)
    *axis_pitches, blur = torch.unravel_index(chosen, energy.shape[1:])
    frame = torch.arange(len(light), device=light.device)
    shifts = [
        best.indices[frame, pitch, blur]
        for best, pitch in zip(bests, axis_pitches, strict=True)
    ]
    pitch_cells, shift_cells, *_ = banks[0]
    leds = torch.tensor(sides, device=light.device)
    half = pitch_cells[torch.stack(axis_pitches, 1)] * leds / 2
    middle = shift_cells[torch.stack(shifts, 1)] + leds / 2
    corners = corner_cells(PanelShape(2, 2)).to(light.device) - 1
    cells = middle[:, None] + corners * half[:, None]
    blurs = torch.tensor(SEARCH.blurs_cells, dtype=torch.float64, device=light.device)
    return map_points(corners_px, cells, shape), blurs[blur]
