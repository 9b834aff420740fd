"""Where the LED lattice may lie near a quadrilateral: an exhaustive search over pitch, place and blur."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.receiver.lattice_model import corner_cells, linear_light, read_patches, sample_cells
from vocc_torch.receiver.rectification import map_points
from vocc_torch.types import Frames, PanelShape

_MARGIN = 2
_PITCHES, _SHIFTS, _BLURS = 20, 21, (0.16, 0.26, 0.42)
# Cells by which a panel's extent, and its middle, may differ from the quadrilateral's.
_EXTENT, _SHIFT = 3.0, 1.5
# Steps of pitch by which the axes may differ, 4 % in a panel of 8; the fit stretches what is seen aslant.
_MOST_APART = 1


@dataclass(frozen=True, slots=True)
class _Bank:
    """Candidates for one axis.

    Args:
        pitch: (P,) cells.
        shift: (S,) cells.
        projectors: (N*(N+1)/2,P*S*G), their upper triangles; what is beside the diagonal counts twice.
        upper: (N*(N+1)/2,) where in N x N numbers the upper triangle lies.
    """

    pitch: Tensor
    shift: Tensor
    projectors: Tensor
    upper: Tensor


@functools.lru_cache(maxsize=8)
def _bank(leds: int, most: int, device: torch.device) -> _Bank:
    """Span of ``leds`` spots at each candidate's places, as projectors on an axis; ``most`` of both axes."""
    pitch = 1 + torch.linspace(-_EXTENT, _EXTENT, _PITCHES, dtype=torch.float64) / max(most, 8)
    shift = torch.linspace(-_SHIFT, _SHIFT, _SHIFTS, dtype=torch.float64)
    blur = torch.tensor(_BLURS, dtype=torch.float64)
    p, s, g = (grid.flatten()[:, None, None] for grid in torch.meshgrid(pitch, shift, blur, indexing="ij"))
    centre = leds / 2 + s + p * (torch.arange(leds, dtype=torch.float64) + 0.5 - leds / 2)
    spots = torch.exp(-(((sample_cells(leds, _MARGIN)[:, None] - centre) / (g * p)) ** 2) / 2)
    basis = torch.linalg.qr(spots)[0]
    row, column = torch.triu_indices(spots.shape[1], spots.shape[1])
    halves = (basis @ basis.mT)[:, row, column] * torch.where(row == column, 1.0, 2.0)
    projectors = halves.mT.to(torch.float32).contiguous()
    upper = row * spots.shape[1] + column
    return _Bank(pitch.to(device), shift.to(device), projectors.to(device), upper.to(device))


def search_lattice(
    frames: Frames, corners_px: Tensor, background: Tensor, shape: PanelShape, *, square: bool = True
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
        square: whether cells are looked for that are nearly square, or nearly of the quadrilateral's.

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
    corners_px = _with_square_cells(corners_px, shape) if square else corners_px
    grey = read_patches(frames, corners_px, shape, _MARGIN)
    light = linear_light(grey) - linear_light(background.to(grey.dtype))[:, None, None]
    most, banks, bests = max(shape.rows, shape.columns), [], []
    for leds, products in _by_leds(shape, light.mT @ light, light @ light.mT):
        with torch.inference_mode(False):
            bank = _bank(leds, most, light.device)
        energy = products.flatten(1)[:, bank.upper] @ bank.projectors
        for one in energy.view(-1, len(light), _PITCHES, _SHIFTS, len(_BLURS)):
            bests.append(one.max(2))
            banks.append(bank)
    # Energy by pitch along the rows, pitch down the columns and blur.
    pitches = torch.arange(_PITCHES, device=light.device)
    pairs = bests[0].values[:, :, None] + bests[1].values[:, None]
    apart = (pitches[:, None] - pitches).abs() > _MOST_APART
    chosen = pairs.masked_fill(apart[..., None], -torch.inf).flatten(1).argmax(1)
    blur, pair = chosen % len(_BLURS), chosen // len(_BLURS)
    half, middle = [], []
    for leds, bank, best, pitch in (
        (shape.columns, banks[0], bests[0], pair // _PITCHES),
        (shape.rows, banks[1], bests[1], pair % _PITCHES),
    ):
        place = best.indices[torch.arange(len(pitch), device=pitch.device), pitch, blur]
        half.append(bank.pitch[pitch] * leds / 2)
        middle.append(bank.shift[place] + leds / 2)
    sides = corner_cells(PanelShape(2, 2)).to(light.device) - 1
    cells = torch.stack(middle, 1)[:, None] + sides * torch.stack(half, 1)[:, None]
    blurs = torch.tensor(_BLURS, dtype=torch.float64, device=light.device)
    return map_points(corners_px, cells, shape), blurs[blur]


def _by_leds(shape: PanelShape, across: Tensor, down: Tensor) -> list[tuple[int, Tensor]]:
    """Return the products of each axis by its number of LEDs; of axes alike as one batch."""
    if shape.columns == shape.rows:
        return [(shape.rows, torch.cat([across, down]))]
    return [(shape.columns, across), (shape.rows, down)]


def _with_square_cells(corners_px: Tensor, shape: PanelShape) -> Tensor:
    """Lay rectangles of square cells over quadrilaterals, of their area.

    A first quadrilateral may leave out a line of Off LEDs, or take in what lies beside the panel.
    """
    top_left, top_right, low_right, low_left = corners_px.unbind(1)
    across = (top_right - top_left + low_right - low_left) / 2
    down = (low_left - top_left + low_right - top_right) / 2
    wide, high = across.norm(dim=1, keepdim=True), down.norm(dim=1, keepdim=True)
    cell = (wide * high / shape.leds).sqrt()
    along = across / wide.clamp(min=1e-9) * cell * shape.columns / 2
    below = down / high.clamp(min=1e-9) * cell * shape.rows / 2
    corners = torch.stack([-along - below, along - below, along + below, below - along], 1)
    return corners + corners_px.mean(1, keepdim=True)
