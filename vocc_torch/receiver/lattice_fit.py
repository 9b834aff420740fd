"""The LED lattice fitted to the picture, in sub-pixels, by damped Gauss-Newton steps."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import torch
from torch import Tensor

from vocc_torch.receiver.lattice_bits import with_free_bits, with_missed_lines, with_turned_bits
from vocc_torch.receiver.lattice_model import (
    GAMMA,
    MARGIN,
    ROUNDING_DN,
    Lattice,
    Model,
    corner_cells,
    read_patches,
)
from vocc_torch.receiver.rectification import map_points
from vocc_torch.types import Frames, PanelShape

_STEPS = 12
# Steps that begin with bits from amplitudes of the LEDs' own; those after turn single bits.
_FREE_STEPS = 2
# Steps before which a missed line is looked for.
_LINE_STEPS = (3, 6)
# A step below this, in cells, is the last.
_STILL_CELLS = 4e-3
_MOST_CELLS = 0.4
# How far a step may go where the picture does not say, as standard deviations: of the corner fields 1, u, v
# and uv in x and in y and of the blur in cells; of the levels and the background in light, white being 1.
_EXPECTED = (1.0, 0.5, 0.5, 0.1, 1.0, 0.5, 0.5, 0.1, 0.2, 0.2, 0.3, 1.0, 0.02)
# The same for the first steps, while bits are still wrong: hardly any turn, shear and perspective.
_STIFF_STEPS = 3
_STIFF = (1.0, 0.5, 0.05, 0.02, 1.0, 0.05, 0.5, 0.02, *_EXPECTED[8:])
_BLUR_CELLS = (0.1, 0.75)


def fit_lattice(frames: Frames, start: Lattice) -> Lattice:
    """Fit corners, spots and two levels to the pictures.

    The corners move freely, so a panel may be turned or seen in perspective. What is compared are the grey
    values, which the camera has rounded and clipped: there every pixel counts alike, and a white one says
    only that its light is at least white. A frame leaves when its step is small; none has more than 12.

    Args:
        frames: B frames or crops.
        start: where to begin, within about a third of a cell.

    Returns:
        The lattices, finite; ``rms_dn`` and ``share`` say how well they explain the pictures, and only they
        tell where there is no lattice to fit.
    """
    every = torch.arange(len(frames), device=start.blur.device)
    active = _paired(every)
    best, own, seen = start[every], start[active], frames
    for number in range(_STEPS):
        before, after, unsettled = _improved(seen, own, number)
        if number == 0:
            best.put(active, before)
        else:
            better = before.rms_dn < best.rms_dn[active]
            best.put(active[better], before[better])
        own = after
        if not bool(unsettled.all()):
            active = active[unsettled]
            if not len(active):
                break
            rows = unsettled.nonzero()[:, 0]
            seen = Frames(seen.grey[rows], seen.origin_px[rows], seen.sensor_px)
            own, active = after[_paired(rows)], _paired(active)
    return best


def _paired(rows: Tensor) -> Tensor:
    """Take one frame twice: products of one matrix may be summed otherwise than those of several."""
    if len(rows) == 1:
        rows = rows.repeat(2)
    return rows


def _patches(frames: Frames, lattice: Lattice) -> Tensor:
    """Read the pictures around the lattices; that of one frame that goes twice is read once."""
    patches = read_patches(frames, lattice.corners_px[: len(frames)], lattice.shape, MARGIN)
    return patches if len(frames) == len(lattice.blur) else patches.repeat(2, 1, 1)


def _improved(frames: Frames, lattice: Lattice, number: int) -> tuple[Lattice, Lattice, Tensor]:
    """Do step ``number``: lattices scored before it, lattices after it, and which (B,) need another."""
    model = Model.of(_patches(frames, lattice), lattice)
    unsettled = torch.full_like(lattice.background, number <= _LINE_STEPS[0], dtype=torch.bool)
    if number < _FREE_STEPS:
        lattice = with_free_bits(model, lattice, levels=number == 0)
        model = model.again(lattice)
    else:
        lattice, turned = with_turned_bits(model, lattice)
        if bool(turned.any()):
            unsettled |= turned
            model = model.again(lattice)
        if number in _LINE_STEPS:
            lattice, shifted = with_missed_lines(model, lattice)
            if bool(shifted.any()):
                unsettled |= shifted
                model = Model.of(_patches(frames, lattice), lattice)
    trust = model.trust()
    before = model.scored(lattice, trust)
    after, moves = _stepped(model, lattice, trust, _STIFF if number < _STIFF_STEPS else _EXPECTED)
    return before, after, unsettled | (moves >= _STILL_CELLS)


def _stepped(
    model: Model, lattice: Lattice, trust: Tensor, expected: tuple[float, ...]
) -> tuple[Lattice, Tensor]:
    """Take a Gauss-Newton step damped by what is ``expected``; give also its greatest move (B,), cells."""
    predicted = model.predicted
    slope = torch.where(model.light < 1, predicted / (GAMMA * model.light.clamp(min=1e-5)), 0.0).flatten(1)
    rest = (model.grey - predicted).flatten(1)
    root = trust.sqrt().flatten(1)
    rest = rest * root
    jacobian = _changes(model, lattice) * (slope * root)[:, None]
    variance = (rest.square().mean(1) + ROUNDING_DN**2).to(torch.float64)[:, None]
    curvature = (jacobian @ jacobian.mT).to(torch.float64) / variance[..., None]
    curvature += _damping(expected, curvature.device)
    slopes = (jacobian @ rest[..., None])[..., 0].to(torch.float64) / variance
    step = torch.linalg.solve(curvature, slopes)
    greatest = step[:, :8].abs().amax(1)
    return _applied(step * (_MOST_CELLS / greatest.clamp(min=_MOST_CELLS))[:, None], lattice), greatest


@lru_cache(maxsize=8)
def _damping(expected: tuple[float, ...], device: torch.device) -> Tensor:
    """Give the curvature that stands for what is expected of each value, as a diagonal matrix."""
    with torch.inference_mode(False):
        return torch.diag(torch.tensor(expected, dtype=torch.float64) ** -2).to(device)


def _changes(model: Model, lattice: Lattice) -> Tensor:
    """Give the light's derivatives (B,13,H*W) by what :data:`_EXPECTED` lists."""
    rows, columns, amplitude = model.rows, model.columns, lattice.amplitudes()
    (row_place, row_blur), (column_place, column_blur) = rows.changes(), columns.changes()
    batch, high, wide = model.grey.shape
    across = torch.cat([rows.value, rows.value * rows.lever], 1)
    down = torch.cat([row_place, row_place * rows.lever, row_blur], 1)
    sideways = torch.cat([column_place, column_place * columns.lever, column_blur], 1)
    straight = torch.cat([columns.value, columns.value * columns.lever], 1)
    # Products of all pairs at once; of each six the one that is no derivative is left out.
    lit = torch.bmm(torch.cat([across, down], 1), amplitude)
    by_x = torch.bmm(lit[:, : 2 * high], sideways.mT).view(batch, 2, high, 3, wide).transpose(2, 3)
    by_y = torch.bmm(lit[:, 2 * high :], straight.mT).view(batch, 3, high, 2, wide).transpose(2, 3)
    changes = [
        by_x[:, :, :2].reshape(batch, 4, -1),
        by_y[:, :2].reshape(batch, 4, -1),
        by_x[:, 0, 2].reshape(batch, 1, -1),
        by_y[:, 2, 0].reshape(batch, 1, -1),
        model.parts.flatten(2),
        torch.ones_like(model.grey).flatten(1)[:, None],
    ]
    return torch.cat(changes, 1)


def _applied(step: Tensor, lattice: Lattice) -> Lattice:
    """Move corners by their fields, and the other values by their steps."""
    shape = lattice.shape
    cells, fields = _fields(shape, step.device)
    moves = torch.stack([step[:, :4] @ fields, step[:, 4:8] @ fields], 2)
    return replace(
        lattice,
        corners_px=map_points(lattice.corners_px, cells + moves, shape),
        blur=(lattice.blur + step[:, 8:10]).clamp(*_BLUR_CELLS),
        levels=lattice.levels + step[:, 10:12],
        background=(lattice.background + step[:, 12]).clamp(0, 1),
    )


@lru_cache(maxsize=32)
def _fields(shape: PanelShape, device: torch.device) -> tuple[Tensor, Tensor]:
    """Give the corners' cells (4,2), and the fields 1, u, v and uv at them, (4,4)."""
    with torch.inference_mode(False):
        cells = corner_cells(shape)
        u, v = (2 * cells / cells.amax(0) - 1).unbind(1)
        return cells.to(device), torch.stack([torch.ones_like(u), u, v, u * v]).to(device)
