"""The LED lattice fitted to the picture, in sub-pixels: Gauss-Newton steps, bits, missed lines of LEDs."""

from dataclasses import replace
from functools import lru_cache

import torch
from torch import Tensor

from vocc_torch.receiver import lattice_model, resample
from vocc_torch.receiver.lattice_model import MARGIN, SAMPLES, Lattice, Model
from vocc_torch.receiver.levels import GAMMA, grey_values, linear_light, two_levels
from vocc_torch.receiver.resample import corner_cells, sample_cells
from vocc_torch.types import Frames, PanelShape

# Steps in all; those that begin with bits from amplitudes of the LEDs' own, while those after turn single
# bits; and those before which a missed line is looked for.
_STEPS, _FREE_STEPS, _LINE_STEPS = 12, 2, (3, 6)
# A step below the first, in cells, is the last; none is above the second.
_STILL_CELLS, _MOST_CELLS = 4e-3, 0.4
# How far a step may go where the picture does not say, as standard deviations: of the corner fields 1, u, v
# and uv in x and in y and of the blur in cells; of the levels and the background in light, white being 1. The
# face follows.
_EXPECTED = (1.0, 0.5, 0.5, 0.1, 1.0, 0.5, 0.5, 0.1, 0.2, 0.2, 0.3, 1.0, 0.02)
WHITEST_FACE = 1 / 0.18 - 1
"""Light of a white face above the background, over that of a background of 18 % grey."""
NO_FACE = 1e-6
"""How far the light of the face may go from 0 where a panel is taken to have none."""
# The same for the first steps, while bits are still wrong: hardly any turn, shear and perspective.
_STIFF_STEPS = 3
_STIFF = (1.0, 0.5, 0.05, 0.02, 1.0, 0.05, 0.5, 0.02, *_EXPECTED[8:])
_BLUR_CELLS, _SATURATED_DN, _IMPUTATIONS = (0.1, 0.75), 254.5, 8


def fit_lattice(frames: Frames, start: Lattice, face_light: float = NO_FACE) -> Lattice:
    """Fit corners, spots and two levels to the pictures.

    The corners move freely, so a panel may be turned or seen in perspective. What is compared are the grey
    values, which the camera has rounded and clipped: there every pixel counts alike, and a white one says
    only that its light is at least white. A frame leaves when its step is small; none has more than 12.

    Args:
        frames: B frames or crops.
        start: where to begin, within about a third of a cell.
        face_light: how far the light of the face may go in a step, white being 1; hardly any where the panel
            has no face.

    Returns:
        The lattices, finite; ``rms_dn`` and ``share`` say how well they explain the pictures, and only they
        tell where there is no lattice to fit.
    """
    active = torch.arange(len(frames), device=start.blur.device)
    best, own = start[active], start[active]
    for number in range(_STEPS):
        # One frame goes twice: products of one matrix may be summed otherwise than those of several, and a
        # fit of what is no lattice can go either way.
        twice = active.new_zeros(2) if len(active) == 1 else slice(None)
        before, after, unsettled = _improved(frames, own[twice], number, face_light)
        before, unsettled = before[: len(active)], unsettled[: len(active)]
        better = (
            before.rms_dn < best.rms_dn[active]
            if number
            else torch.ones_like(unsettled)
        )
        best.put(active[better], before[better])
        rows = unsettled.nonzero()[:, 0]
        if not len(rows):
            break
        frames = frames[rows] if len(rows) < len(frames) else frames
        active, own = active[rows], after[rows]
    return best


def _read(frames: Frames, lattice: Lattice) -> Tensor:
    """Read the frames around the lattices; one that goes twice is read once."""
    corners = lattice.corners_px[: len(frames)]
    read = lattice_model.read_patches(frames, corners, lattice.shape, MARGIN)
    return read.expand(len(lattice.blur), -1, -1)


def _improved(
    frames: Frames, lattice: Lattice, number: int, face_light: float
) -> tuple[Lattice, Lattice, Tensor]:
    """Run step ``number``: lattices scored before it, lattices after it, and which (B,) need another step."""
    model = Model.of(_read(frames, lattice), lattice)
    unsettled = torch.full_like(
        lattice.background, number <= _LINE_STEPS[0], dtype=torch.bool
    )
    if number < _FREE_STEPS:
        background = lattice.background.to(model.grey.dtype)[:, None, None]
        light = linear_light(model.grey) - background
        edges = model.edges
        face = lattice.face.to(light.dtype)[:, None, None]
        light = light - face * edges[0].value[:, :, None] * edges[1].value[:, None]
        bits, found = _two_levels(_amplitudes(light, model))
        levels = lattice.levels if number else found.double()
        lattice = replace(lattice, bits=bits, levels=levels)
        model = Model.of(model.grey, lattice)
    else:
        lattice, turned = _with_turned_bits(model, lattice)
        if bool(turned.any()):
            unsettled |= turned
            model = Model.of(model.grey, lattice)
        if number in _LINE_STEPS:
            lattice, shifted = _with_missed_lines(model, lattice)
            if bool(shifted.any()):
                unsettled |= shifted
                model = Model.of(_read(frames, lattice), lattice)
    trust = model.trust()
    before = model.scored(lattice, trust)
    # A Gauss-Newton step, damped by what is expected of each value.
    predicted = model.predicted
    slope = predicted / (GAMMA * model.light.clamp(min=1e-5))
    slope = torch.where(model.light < 1, slope, 0.0).flatten(1)
    root = trust.sqrt().flatten(1)
    rest = (model.grey - predicted).flatten(1) * root
    jacobian = _changes(model, lattice) * (slope * root)[:, None]
    variance = (rest.square().mean(1) + lattice_model.ROUNDING_DN**2).double()[:, None]
    curvature = (jacobian @ jacobian.mT).double() / variance[..., None]
    stiffness = _STIFF if number < _STIFF_STEPS else _EXPECTED
    expected = torch.tensor((*stiffness, face_light), dtype=torch.float64)
    curvature += torch.diag(expected**-2).to(curvature.device)
    slopes = (jacobian @ rest[..., None])[..., 0].double() / variance
    step = torch.linalg.solve(curvature, slopes)
    greatest = step[:, :8].abs().amax(1)
    step = step * (_MOST_CELLS / greatest.clamp(min=_MOST_CELLS))[:, None]
    cells, fields = _fields(lattice.shape, step.device)
    moves = torch.stack([step[:, :4] @ fields, step[:, 4:8] @ fields], 2)
    corners_px = resample.map_points(lattice.corners_px, cells + moves, lattice.shape)
    blur, levels = (
        (lattice.blur + step[:, 8:10]).clamp(*_BLUR_CELLS),
        lattice.levels + step[:, 10:12],
    )
    background = (lattice.background + step[:, 12]).clamp(0, 1)
    face = (lattice.face + step[:, 13]).clamp(-background, WHITEST_FACE * background)
    after = replace(
        lattice,
        corners_px=corners_px,
        blur=blur,
        levels=levels,
        background=background,
        face=face,
    )
    return before, after, unsettled | (greatest >= _STILL_CELLS)


def _changes(model: Model, lattice: Lattice) -> Tensor:
    """Return the light's derivatives (B,14,H*W) by what :data:`_EXPECTED` lists, and by the face."""
    rows, columns, amplitude = model.rows, model.columns, lattice.amplitudes()
    (row_place, row_blur), (column_place, column_blur) = (
        rows.changes(),
        columns.changes(),
    )
    batch, high, wide = model.grey.shape
    across = torch.cat([rows.value, rows.value * rows.lever], 1)
    down = torch.cat([row_place, row_place * rows.lever, row_blur], 1)
    sideways = torch.cat([column_place, column_place * columns.lever, column_blur], 1)
    straight = torch.cat([columns.value, columns.value * columns.lever], 1)
    # Products of all pairs at once; of each six the one that is no derivative is left out.
    lit = torch.bmm(torch.cat([across, down], 1), amplitude)
    by_x = (
        torch.bmm(lit[:, : 2 * high], sideways.mT)
        .view(batch, 2, high, 3, wide)
        .transpose(2, 3)
    )
    by_y = (
        torch.bmm(lit[:, 2 * high :], straight.mT)
        .view(batch, 3, high, 2, wide)
        .transpose(2, 3)
    )
    up, along = model.edges
    face = lattice.face.to(amplitude.dtype)[:, None, None, None, None]
    samples = [
        sample_cells(int(leds), SAMPLES, MARGIN).to(amplitude) / leds * 2 - 1
        for leds in amplitude.shape[1:]
    ]
    v_face = torch.stack([up.value, up.value * samples[0]], 1)
    u_face = torch.stack([along.value, along.value * samples[1]], 1)
    ends_x = torch.stack([along.shift, along.stretch], 1)
    ends_y = torch.stack([up.shift, up.stretch], 1)
    face_x = face * v_face[:, :, None, :, None] * ends_x[:, None, :, None]
    face_y = face * ends_y[:, :, None, :, None] * u_face[:, None, :, None]
    changes = [
        by_x[:, :, :2] + face_x,
        by_y[:, :2] + face_y,
        by_x[:, 0, 2],
        by_y[:, 2, 0],
    ]
    box = up.value[:, :, None] * along.value[:, None]
    changes += [model.parts, torch.ones_like(model.grey), box]
    return torch.cat([one.reshape(batch, -1, high * wide) for one in changes], 1)


@lru_cache(maxsize=32)
@torch.inference_mode(False)
def _fields(shape: PanelShape, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the corners' cells (4,2), and the fields 1, u, v and uv at them, (4,4)."""
    cells = corner_cells(shape)
    u, v = (2 * cells / cells.amax(0) - 1).unbind(1)
    return cells.to(device), torch.stack([torch.ones_like(u), u, v, u * v]).to(device)


def _amplitudes(light: Tensor, model: Model) -> Tensor:
    """Fit an amplitude to each LED, (B,R,C), by least squares; white pixels may be any brighter.

    They are taken to be as bright as the fit says, and fitted again (Dempster, Laird and Rubin 1977).
    """
    # Pseudo-inverses of the spots' profiles, near singular where spots melt together.
    inverses = []
    for value in (
        model.rows.value.double(),
        model.columns.value.double(),
    ):
        products = value.mT @ value
        products.diagonal(dim1=1, dim2=2).add_(1e-6)
        inverses.append(torch.linalg.solve(products, value.mT).float())
    down, across = inverses
    found: Tensor = down @ light @ across.mT
    white = model.grey >= _SATURATED_DN
    some = white.flatten(1).any(1).nonzero()[:, 0]
    if len(some):
        light, white, down, across = light[some], white[some], down[some], across[some]
        rows, columns, own = (
            model.rows.value[some],
            model.columns.value[some].mT,
            found[some],
        )
        for _ in range(_IMPUTATIONS):
            guess = torch.maximum(light, rows @ own @ columns)
            own = down @ torch.where(white, guess, light) @ across.mT
        found[some] = own
    return found


def _two_levels(amplitude: Tensor) -> tuple[Tensor, Tensor]:
    """Split amplitudes (B,R,C) into Off and On: bits, and class means (B,2); a single LED is On."""
    value = amplitude.flatten(1)
    if value.shape[1] == 1:
        return torch.ones_like(amplitude, dtype=torch.bool), torch.cat(
            [value * 0, value], 1
        )
    limits, means = two_levels(value)
    return amplitude > limits[:, None, None], means


def _with_turned_bits(model: Model, lattice: Lattice) -> tuple[Lattice, Tensor]:
    """Return lattices with bits flipped where that fits the picture better, and which frames (B,) changed."""
    width = 3 * SAMPLES
    place = (torch.arange(width, device=model.grey.device) + 0.5) / SAMPLES - 1.5
    across, down = (
        torch.exp(-((place / one[:, None]) ** 2) / 2)
        for one in lattice.blur.float().unbind(1)
    )
    levels = lattice.levels.float()
    change = (
        torch.where(lattice.bits, -1.0, 1.0)
        * (levels[:, 1] - levels[:, 0])[:, None, None]
    )
    spot = change[..., None, None] * (down[:, :, None] * across[:, None])[:, None, None]
    light, grey = _around(model.light), _around(model.grey)
    rest = (model.predicted - model.grey).square()
    gain = _around(rest).sum((3, 4))
    gain = gain - (grey_values(light + spot) - grey).square().sum((3, 4))
    # Neighbours share their light: of them only the one that gains most is turned.
    best = gain == torch.nn.functional.max_pool2d(gain, 3, 1, 1)
    turned = best & (gain > rest.mean((1, 2)).clamp(min=1.0)[:, None, None])
    return replace(lattice, bits=lattice.bits ^ turned), turned.flatten(1).any(1)


def _around(plane: Tensor) -> Tensor:
    """Cut the 3 x 3 cells around each LED out of (B,H,W): (B,R,C,3K,3K)."""
    width = 3 * SAMPLES
    return plane.unfold(1, width, SAMPLES).unfold(2, width, SAMPLES)


def _with_missed_lines(model: Model, lattice: Lattice) -> tuple[Lattice, Tensor]:
    """Return lattices moved by a cell where an outer line of Off LEDs was missed, and which (B,) moved.

    Such a line gives little light, so a fit may rest a line too far to the other side. Each side is tried:
    the far line is taken away, and a line of Off LEDs added before the near one.
    """
    costs = [(model.predicted - model.grey).square().sum((1, 2))]
    options = [lattice]
    for axis, by in ((1, -1), (1, 1), (2, -1), (2, 1)):
        bits = lattice.bits.roll(-by, axis)
        bits.select(axis, -1 if by > 0 else 0).fill_(False)
        moved = (by, 0) if axis == 1 else (0, by)
        predicted = Model.of(model.grey, replace(lattice, bits=bits), moved).predicted
        costs.append((predicted - model.grey).square().sum((1, 2)))
        cells = corner_cells(lattice.shape).to(bits.device, copy=True)
        cells[:, 2 - axis] += by
        corners = resample.map_points(
            lattice.corners_px, cells.expand(len(bits), 4, 2), lattice.shape
        )
        options.append(replace(lattice, bits=bits, corners_px=corners))
    chosen = torch.stack(costs, 1).argmin(1)
    rows = torch.arange(len(chosen), device=chosen.device)
    return Lattice.cat(options)[chosen * len(rows) + rows], chosen > 0
