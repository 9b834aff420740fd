"""Which LEDs of a lattice are On, and whether an outer line of Off LEDs is missed."""

from __future__ import annotations

from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from vocc_torch.receiver.lattice_model import (
    MARGIN,
    SAMPLES,
    Lattice,
    Model,
    Spots,
    corner_cells,
    grey_values,
    linear_light,
    sample_cells,
)
from vocc_torch.receiver.rectification import map_points

_SATURATED_DN = 254.5
_IMPUTATIONS = 8


def with_free_bits(model: Model, lattice: Lattice, *, levels: bool) -> Lattice:
    """Take bits, and levels where they are wanted, from an amplitude of each LED's own."""
    light = linear_light(model.grey) - lattice.background.to(model.grey.dtype)[:, None, None]
    bits, found = _two_levels(_amplitudes(light, model))
    return replace(lattice, bits=bits, levels=found.to(torch.float64) if levels else lattice.levels)


def _amplitudes(light: Tensor, model: Model) -> Tensor:
    """Fit an amplitude to each LED, (B,R,C), by least squares; white pixels may be any brighter.

    They are taken to be as bright as the fit says, and fitted again (Dempster, Laird and Rubin 1977).
    """
    down, across = _inverse(model.rows), _inverse(model.columns)
    found = down @ light @ across.mT
    white = model.grey >= _SATURATED_DN
    some = white.flatten(1).any(1).nonzero()[:, 0]
    if len(some):
        light, white, down, across = light[some], white[some], down[some], across[some]
        rows, columns, own = model.rows.value[some], model.columns.value[some].mT, found[some]
        for _ in range(_IMPUTATIONS):
            guess = torch.maximum(light, rows @ own @ columns)
            own = down @ torch.where(white, guess, light) @ across.mT
        found[some] = own
    return found


def _inverse(spots: Spots) -> Tensor:
    """Give the pseudo-inverse (B,n,N) of an axis's spots, near singular where these melt together."""
    value = spots.value.to(torch.float64)
    products = value.mT @ value
    products.diagonal(dim1=1, dim2=2).add_(1e-6)
    inverse: Tensor = torch.linalg.solve(products, value.mT)
    return inverse.to(torch.float32)


def _two_levels(amplitude: Tensor) -> tuple[Tensor, Tensor]:
    """Part amplitudes (B,R,C) where the variance between the two parts is greatest: bits, and means (B,2)."""
    value = amplitude.flatten(1).sort(1).values
    leds = value.shape[1]
    if leds == 1:
        return torch.ones_like(amplitude, dtype=torch.bool), torch.cat([value * 0, value], 1)
    low = torch.arange(1, leds, dtype=value.dtype, device=value.device)
    below = value.cumsum(1)
    means = below[:, :-1] / low, (below[:, -1:] - below[:, :-1]) / (leds - low)
    best = (low * (leds - low) * (means[1] - means[0]) ** 2).argmax(1, keepdim=True)
    limit = (value.gather(1, best) + value.gather(1, best + 1)) / 2
    return amplitude > limit[..., None], torch.cat([mean.gather(1, best) for mean in means], 1)


def with_turned_bits(model: Model, lattice: Lattice) -> tuple[Lattice, Tensor]:
    """Turn bits where that explains the picture around the LED better; say also in which frames, (B,)."""
    width = 3 * SAMPLES
    place = (torch.arange(width, device=model.grey.device) + 0.5) / SAMPLES - 1.5
    across, down = (torch.exp(-((place / one[:, None]) ** 2) / 2) for one in lattice.blur.float().unbind(1))
    levels = lattice.levels.to(torch.float32)
    change = torch.where(lattice.bits, -1.0, 1.0) * (levels[:, 1] - levels[:, 0])[:, None, None]
    spot = change[..., None, None] * (down[:, :, None] * across[:, None])[:, None, None]
    light, grey = _around(model.light), _around(model.grey)
    rest = (model.predicted - model.grey).square()
    gain = _around(rest).sum((3, 4))
    gain = gain - (grey_values(light + spot) - grey).square().sum((3, 4))
    # Neighbours share their light: of them only the one that gains most is turned.
    best = gain == F.max_pool2d(gain, 3, 1, 1)
    turned = best & (gain > rest.mean((1, 2)).clamp(min=1.0)[:, None, None])
    return replace(lattice, bits=lattice.bits ^ turned), turned.flatten(1).any(1)


def _around(plane: Tensor) -> Tensor:
    """Cut the 3 x 3 cells around each LED out of (B,H,W): (B,R,C,3K,3K)."""
    width = 3 * SAMPLES
    return plane.unfold(1, width, SAMPLES).unfold(2, width, SAMPLES)


def with_missed_lines(model: Model, lattice: Lattice) -> tuple[Lattice, Tensor]:
    """Move lattices by a cell where an outer line of Off LEDs is missed; say also where, (B,).

    Such a line gives little light, so a fit may rest a line too far to the other side. Each side is tried:
    the far line is taken away, and a line of Off LEDs added before the near one.
    """
    amplitude = lattice.amplitudes()
    costs = [(model.predicted - model.grey).square().sum((1, 2))]
    options = []
    for axis, spots, others in ((1, model.rows, model.columns), (2, model.columns, model.rows)):
        leds = int(amplitude.shape[axis])
        samples, blur = sample_cells(leds, MARGIN).to(amplitude), lattice.blur[:, 2 - axis, None].float()
        off = lattice.levels[:, :1].float() * others.value.sum(2)
        for far, near, by in ((leds - 1, -0.5, -1), (0, leds + 0.5, 1)):
            new = torch.exp(-(((samples - near) / blur) ** 2) / 2)
            old = (others.value @ amplitude.select(axis, far)[..., None])[..., 0]
            change = new[:, :, None] * off[:, None] - spots.value[:, :, far, None] * old[:, None]
            light = model.light + (change if axis == 1 else change.mT)
            costs.append((grey_values(light) - model.grey).square().sum((1, 2)))
            options.append((axis, by))
    chosen = torch.stack(costs, 1).argmin(1)
    shifted = chosen > 0
    if not bool(shifted.any()):
        return lattice, shifted
    found = replace(lattice)
    for option, (axis, by) in enumerate(options, start=1):
        bits = lattice.bits.roll(-by, axis)
        bits.select(axis, -1 if by > 0 else 0).fill_(False)
        cells = corner_cells(lattice.shape).to(bits.device, copy=True)
        cells[:, 2 - axis] += by
        corners = map_points(lattice.corners_px, cells.expand(len(bits), 4, 2), lattice.shape)
        there = (chosen == option)[:, None, None]
        found.bits, found.corners_px = found.bits.where(~there, bits), found.corners_px.where(~there, corners)
    return found, shifted
