"""The LED lattice fitted to the picture, in sub-pixels, by damped Gauss-Newton steps."""

from __future__ import annotations

from dataclasses import replace

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
    moved,
    read_patches,
)
from vocc_torch.types import Frames

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
    active = torch.arange(len(frames), device=start.blur.device)
    best = own = start[active]
    for number in range(_STEPS):
        seen = Frames(frames.grey[active], frames.origin_px[active], frames.sensor_px)
        before, after, unsettled = _improved(seen, own, number)
        better = before.rms_dn < best.rms_dn[active] if number else torch.ones_like(unsettled)
        best.put(active[better], before[better])
        active, own = active[unsettled], after[unsettled]
        if not len(active):
            break
    return best


def _improved(frames: Frames, lattice: Lattice, number: int) -> tuple[Lattice, Lattice, Tensor]:
    """Do step ``number``: lattices scored before it, lattices after it, and which (B,) need another."""
    if len(lattice.blur) == 1:
        # Products of one matrix may be summed otherwise than those of several: one frame goes twice.
        twice, one = torch.zeros_like(frames.origin_px[0]), slice(0, 1)
        pair = Frames(frames.grey[twice], frames.origin_px[twice], frames.sensor_px)
        before, after, unsettled = _improved(pair, lattice[twice], number)
        return before[one], after[one], unsettled[one]
    model = Model.of(read_patches(frames, lattice.corners_px, lattice.shape, MARGIN), lattice)
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
                model = Model.of(read_patches(frames, lattice.corners_px, lattice.shape, MARGIN), lattice)
    before = model.scored(lattice)
    after, moves = _stepped(model, lattice, _STIFF if number < _STIFF_STEPS else _EXPECTED)
    return before, after, unsettled | (moves >= _STILL_CELLS)


def _stepped(model: Model, lattice: Lattice, expected: tuple[float, ...]) -> tuple[Lattice, Tensor]:
    """Take a Gauss-Newton step damped by what is ``expected``; give also its greatest move (B,), cells."""
    predicted = model.predicted
    slope = torch.where(model.light < 1, predicted / (GAMMA * model.light.clamp(min=1e-5)), 0.0).flatten(1)
    rest = (model.grey - predicted).flatten(1)
    trust = model.trust().sqrt().flatten(1)
    rest = rest * trust
    jacobian = _changes(model, lattice) * (slope * trust)[:, None]
    variance = (rest.square().mean(1) + ROUNDING_DN**2).to(torch.float64)[:, None]
    curvature = (jacobian @ jacobian.mT).to(torch.float64) / variance[..., None]
    curvature += torch.diag(curvature.new_tensor(expected) ** -2)
    slopes = (jacobian @ rest[..., None])[..., 0].to(torch.float64) / variance
    step = torch.linalg.solve(curvature, slopes)
    greatest = step[:, :8].abs().amax(1)
    return _applied(step * (_MOST_CELLS / greatest.clamp(min=_MOST_CELLS))[:, None], lattice), greatest


def _changes(model: Model, lattice: Lattice) -> Tensor:
    """Give the light's derivatives (B,13,H*W) by what :data:`_EXPECTED` lists."""
    rows, columns, amplitude = model.rows, model.columns, lattice.amplitudes()
    across = [rows.value @ amplitude, (rows.value * rows.lever) @ amplitude]
    down = [rows.by_place @ amplitude, (rows.by_place * rows.lever) @ amplitude]
    sideways = (columns.by_place.mT, (columns.by_place * columns.lever).mT)
    straight = (columns.value.mT, (columns.value * columns.lever).mT)
    changes = [up @ side for up in across for side in sideways]
    changes += [up @ side for up in down for side in straight]
    changes += [across[0] @ columns.by_blur.mT, rows.by_blur @ amplitude @ straight[0]]
    changes += [*model.parts.unbind(1), torch.ones_like(model.grey)]
    return torch.stack([change.flatten(1) for change in changes], 1)


def _applied(step: Tensor, lattice: Lattice) -> Lattice:
    """Move corners by their fields, and the other values by their steps."""
    shape = lattice.shape
    cells = corner_cells(shape).to(step.device)
    u, v = (2 * cells / cells.amax(0) - 1).unbind(1)
    fields = torch.stack([torch.ones_like(u), u, v, u * v])
    moves = torch.stack([step[:, :4] @ fields, step[:, 4:8] @ fields], 2)
    return replace(
        lattice,
        corners_px=moved(lattice.corners_px, cells + moves, shape),
        blur=(lattice.blur + step[:, 8:10]).clamp(*_BLUR_CELLS),
        levels=lattice.levels + step[:, 10:12],
        background=(lattice.background + step[:, 12]).clamp(0, 1),
    )
