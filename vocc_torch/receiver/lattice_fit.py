"""The LED lattice fitted to the picture, in sub-pixels: Gauss-Newton steps and bits."""

from dataclasses import dataclass, replace
from functools import lru_cache

import torch
from torch import Tensor

from vocc_torch.receiver.lattice_model import PATCH, Lattice, Model, read_patches
from vocc_torch.receiver.levels import GAMMA, grey_values, linear_light, two_levels
from vocc_torch.receiver.resample import corner_cells, map_points, sample_cells
from vocc_torch.types import Frames, PanelShape


@dataclass(frozen=True)
class FitSettings:
    """Steps of the fit, and the expected errors of the starting values."""

    steps: int = 20  # most steps
    free_steps: int = 2  # first steps, with bits from amplitudes; later ones flip bits
    least_steps: int = 4  # least steps before the fit may end
    still_cells: float = 4e-3  # a smaller step ends the fit
    most_cells: float = 0.4  # largest step
    # Standard deviations of the corner fields 1, u, v and uv in x and in y, cells.
    corners_cells: tuple[float, ...] = (1.0, 0.5, 0.5, 0.1, 1.0, 0.5, 0.5, 0.1)
    # Standard deviations of the blur, cells, and of levels and background, white being 1.
    others: tuple[float, ...] = (0.2, 0.2, 0.3, 1.0, 0.02)
    no_face: float = 1e-6  # light of the face of a panel without a face
    # Light of a white face above the background, over that of a background of 18 % grey.
    whitest_face: float = 1 / 0.18 - 1
    blur_cells: tuple[float, float] = (0.1, 0.75)  # limits of the blur
    saturated_dn: float = 254.5  # grey value of a saturated pixel
    imputations: int = 16  # rounds in which saturated pixels are estimated
    ridge: float = 1e-6  # regularises amplitudes of overlapping spots
    least_light: float = 1e-5  # lower limit of light, white being 1


FIT = FitSettings()


def fit_lattice(
    frames: Frames, start: Lattice, face_light: float = FIT.no_face
) -> Lattice:
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
    best, current = start[active], start[active]
    for number in range(FIT.steps):
        # One frame goes twice: products of one matrix may be summed otherwise than those of several, and a
        # fit of what is no lattice can go either way.
        twice = active.new_zeros(2) if len(active) == 1 else slice(None)
        before, after, unsettled = _improved(frames, current[twice], number, face_light)
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
        active, current = active[rows], after[rows]
    return best


def _read(frames: Frames, lattice: Lattice) -> Tensor:
    """Read the frames around the lattices; one that goes twice is read once."""
    corners = lattice.corners_px[: len(frames)]
    read = read_patches(frames, corners, lattice.shape, PATCH.margin)
    return read.expand(len(lattice.blur), -1, -1)


def _improved(
    frames: Frames, lattice: Lattice, number: int, face_light: float
) -> tuple[Lattice, Lattice, Tensor]:
    """Run step ``number``: lattices scored before it, lattices after it, and which (B,) need another step."""
    model = Model.of(_read(frames, lattice), lattice)
    unsettled = torch.full_like(
        lattice.background, number < FIT.least_steps, dtype=torch.bool
    )
    if number < FIT.free_steps:
        bits, found = _two_levels(_amplitudes(model))
        levels = lattice.levels if number else found.double()
        model = Model.of(model.grey, replace(lattice, bits=bits, levels=levels))
    else:
        turned = _turned_bits(model)
        is_turned = turned.flatten(1).any(1)
        if bool(is_turned.any()):
            unsettled |= is_turned
            bits = lattice.bits ^ turned
            model = Model.of(model.grey, replace(lattice, bits=bits))
    trust = model.trust()
    step = _step(model, trust, face_light)
    greatest = step[:, :8].abs().amax(1)
    step = step * (FIT.most_cells / greatest.clamp(min=FIT.most_cells))[:, None]
    moved = _moved(model.lattice, step)
    return model.scored(trust), moved, unsettled | (greatest >= FIT.still_cells)


def _step(model: Model, trust: Tensor, face_light: float) -> Tensor:
    """Solve for a Gauss-Newton step (B,14), damped by what is expected of each value."""
    slope = model.predicted / (GAMMA * model.light.clamp(min=FIT.least_light))
    slope = torch.where(model.light < 1, slope, 0.0).flatten(1)
    root = trust.sqrt().flatten(1)
    residual = (model.grey - model.predicted).flatten(1) * root
    jacobian = _changes(model) * (slope * root)[:, None]
    variance = (residual.square().mean(1) + PATCH.rounding_dn**2).double()[:, None]
    curvature = (jacobian @ jacobian.mT).double() / variance[..., None]
    spreads = (*FIT.corners_cells, *FIT.others, face_light)
    expected = torch.tensor(spreads, dtype=torch.float64)
    curvature += torch.diag(expected**-2).to(curvature.device)
    slopes = (jacobian @ residual[..., None])[..., 0].double() / variance
    step: Tensor = torch.linalg.solve(curvature, slopes)
    return step


def _moved(lattice: Lattice, step: Tensor) -> Lattice:
    """Move lattices by steps (B,14), within the limits."""
    *corner, blur, levels, background, face = torch.split(step, [4, 4, 2, 2, 1, 1], 1)
    cells, fields = _fields(lattice.shape, step.device)
    moves = (torch.stack(corner, 1) @ fields).mT
    background = (lattice.background + background[:, 0]).clamp(0, 1)
    face = lattice.face + face[:, 0]
    return replace(
        lattice,
        corners_px=map_points(lattice.corners_px, cells + moves, lattice.shape),
        blur=(lattice.blur + blur).clamp(*FIT.blur_cells),
        levels=lattice.levels + levels,
        background=background,
        face=face.clamp(-background, FIT.whitest_face * background),
    )


def _changes(model: Model) -> Tensor:
    """Return the light's derivatives (B,14,H*W) by corner fields, blur, levels, background and face.

    A corner field moves the light at each sample along the light's own slope.
    """
    amplitude, box = model.lattice.amplitudes(), model.box[:, None]
    down, across = torch.gradient(model.light, spacing=1 / PATCH.samples, dim=(1, 2))
    v, u = (
        sample_cells(leds, PATCH.samples, PATCH.margin).to(amplitude) / leds * 2 - 1
        for leds in model.lattice.shape.sides
    )
    fields = _bilinear(*torch.meshgrid(u, v, indexing="xy"))
    corners = [-slope[:, None] * fields for slope in (across, down)]
    wider = model.rows.spots @ amplitude @ model.columns.by_blur.mT
    taller = model.rows.by_blur @ amplitude @ model.columns.spots.mT
    blurs = torch.stack([wider, taller], 1)
    changes = [*corners, blurs, model.parts, torch.ones_like(box), box]
    return torch.cat(changes, 1).flatten(2)


def _bilinear(u: Tensor, v: Tensor) -> Tensor:
    """Return the fields 1, u, v and uv."""
    return torch.stack([torch.ones_like(u), u, v, u * v])


@lru_cache(maxsize=32)
@torch.inference_mode(False)
def _fields(shape: PanelShape, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the corners' cells (4,2), and the fields 1, u, v and uv at them, (4,4)."""
    cells = corner_cells(shape)
    u, v = (2 * cells / cells.amax(0) - 1).unbind(1)
    return cells.to(device), _bilinear(u, v).to(device)


def _amplitudes(model: Model) -> Tensor:
    """Fit an amplitude to each LED, (B,R,C), by least squares; white pixels may be any brighter.

    They are taken to be as bright as the fit says, and fitted again (Dempster, Laird and Rubin 1977).
    """
    # Pseudo-inverses of the spots' profiles, near singular where spots melt together.
    inverses = []
    for value in (model.rows.spots.double(), model.columns.spots.double()):
        products = value.mT @ value
        products.diagonal(dim1=1, dim2=2).add_(FIT.ridge)
        inverses.append(torch.linalg.solve(products, value.mT).float())
    down, across = inverses
    light = linear_light(model.grey) - model.base
    found: Tensor = down @ light @ across.mT
    white = model.grey >= FIT.saturated_dn
    if white.any():
        rows, columns = model.rows.spots, model.columns.spots.mT
        for _ in range(FIT.imputations):
            guess = torch.maximum(light, rows @ found @ columns)
            found = down @ torch.where(white, guess, light) @ across.mT
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


def _turned_bits(model: Model) -> Tensor:
    """Say which bits (B,R,C) are to be flipped because that fits the picture better."""
    lattice = model.lattice
    # From the middle of an LED, over its cell and those beside it.
    place = sample_cells(1, PATCH.samples, 1).to(model.grey) - 0.5
    across, down = (
        torch.exp(-((place / blur[:, None]) ** 2) / 2)
        for blur in lattice.blur.float().unbind(1)
    )
    brighter = lattice.levels.float().diff(dim=1)[..., None]
    change = torch.where(lattice.bits, -1.0, 1.0) * brighter
    spot = change[..., None, None] * (down[:, :, None] * across[:, None])[:, None, None]
    light, grey = _around(model.light), _around(model.grey)
    squares = (model.predicted - model.grey).square()
    gain = _around(squares).sum((3, 4))
    gain = gain - (grey_values(light + spot) - grey).square().sum((3, 4))
    # Neighbours share their light: of them only the one that gains most is turned.
    best = gain == torch.nn.functional.max_pool2d(gain, 3, 1, 1)
    return best & (gain > squares.mean((1, 2)).clamp(min=1.0)[:, None, None])


def _around(plane: Tensor) -> Tensor:
    """Cut the 3 x 3 cells around each LED out of (B,H,W): (B,R,C,3K,3K)."""
    width = 3 * PATCH.samples
    return plane.unfold(1, width, PATCH.samples).unfold(2, width, PATCH.samples)
