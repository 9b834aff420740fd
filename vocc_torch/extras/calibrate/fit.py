"""Maximum likelihood: values by ``scipy.optimize.least_squares``, those of each frame beside those of all, and bits."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy import optimize, sparse, stats

from vocc_torch.arrays import Bools, Floats
from vocc_torch.extras.calibrate.model import (
    LEVELS,
    PLACED,
    SHARED,
    TURNED,
    RecordingFit,
)
from vocc_torch.extras.calibrate.reading import Footage
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.receiver.levels import two_levels
from vocc_torch.receiver.resample import cell_size_px, centre_greys
from vocc_torch.types import Frames, Panels

SURE = 1.959963985
"""Standard deviations of a normal 95 % interval."""

BASE = (*PLACED, *LEVELS, *SHARED[1:])
POSED = (*BASE, *TURNED)

Range = tuple[float, float]


@dataclass(frozen=True)
class RecordingFitSettings:
    """How a fit is made."""

    clear_sigmas: float = 4.0  # a pixel farther off counts less: it may be a reflection
    evaluations: int = 12  # of the picture and its derivatives, at most
    tolerance: float = 1e-6  # change of values or misfit that ends a fit
    block_px: int = 8  # neighbours within such a block may hang together
    grid_px: int = 8  # windows begin on multiples of it, as JPEG's blocks do
    margin_cells: float = 1.2  # of a window about the panel
    margin_px: float = 8.0  # beside
    blur_pitches: float = 0.25  # where the blur's fit begins
    brighter: float = 1.3  # a wide On LED than one as seen, whose light is spread
    rounds: int = 4  # of fits and decisions of bits
    flip_step: int = 4  # LEDs so far apart do not share pixels
    # Ranges in which values mean something.
    angles_deg: Range = (-75.0, 75.0)
    levels: Range = (0.01, 1e5)
    board: Range = (0.0, 1.0)
    gamma: Range = (1.0, 4.0)
    blur_px: Range = (0.02, 30.0)


SETTINGS = RecordingFitSettings()

RANGES = {
    **dict.fromkeys(PLACED, (-math.inf, math.inf)),
    **dict.fromkeys(TURNED, SETTINGS.angles_deg),
    **dict.fromkeys(LEVELS, SETTINGS.levels),
    "board": SETTINGS.board,
    "gamma": SETTINGS.gamma,
    "blur_px": SETTINGS.blur_px,
}


def windows_of(footage: Footage, camera: Camera, panel: LedPanel) -> Frames:
    """Cut a window about the panel from each frame, all of one size, on a grid of 8 px."""
    grid, sensor = SETTINGS.grid_px, np.array([camera.width_px, camera.height_px])
    low, high = footage.corners_px.min(1), footage.corners_px.max(1)
    cell = (high - low).max() / max(panel.shape.sides)
    margin = SETTINGS.margin_cells * cell + SETTINGS.margin_px
    size = (((high - low).max(0) + 2 * margin) // grid + 2) * grid
    size = np.minimum(size, sensor).astype(int)
    first = ((low + high - size) / 2 // grid * grid).clip(0, sensor - size).astype(int)
    width, height = size.tolist()
    places = zip(footage.greys, first.tolist(), strict=True)
    greys = [grey[y : y + height, x : x + width] for grey, (x, y) in places]
    planes = torch.from_numpy(np.stack(greys).astype(float))[:, None]
    return Frames(planes, torch.from_numpy(first), camera.sensor_px)


def start(
    footage: Footage, camera: Camera, panel: LedPanel, bits: Bools | None
) -> RecordingFit:
    """Begin from the corners that the locator found.

    Args:
        footage: the frames.
        camera: the camera.
        panel: the panel.
        bits: (B,R,C) known bits, or None to decide them from the grey values at the LEDs' centres.
    """
    windows, corners_px = windows_of(footage, camera, panel), footage.corners_px
    corners, grey = torch.from_numpy(corners_px), windows.grey[:, 0].numpy()
    shape, share = panel.shape, panel.background_reflectance
    read = centre_greys(windows, Panels.known(corners), shape).flatten(1)
    bright = (read > two_levels(read)[0][:, None]).numpy()
    lit = bright if bits is None else bits.reshape(bright.shape)
    behind = np.median(grey[:, [0, 1, -2, -1]], axis=(1, 2)).clip(min=1.0)
    pitch = np.mean([size.numpy() for size in cell_size_px(corners, shape)], axis=0)
    right = corners_px[:, 1] - corners_px[:, 0]
    begun = RecordingFit(camera, panel, windows.origin_px, grey, lit).set(
        x_px=corners_px[..., 0].mean(1),
        y_px=corners_px[..., 1].mean(1),
        log_pitch_px=np.log(pitch),
        yaw_deg=0.0,
        pitch_deg=0.0,
        roll_deg=np.degrees(np.arctan2(right[:, 1], right[:, 0])),
        background=behind,
        off=behind * (panel.led_reflectance / share) ** (1 / camera.gamma),
        on=SETTINGS.brighter * read.amax(1).numpy(),
        board=panel.board_reflectance or share,
        gamma=camera.gamma,
        blur_px=SETTINGS.blur_pitches * np.median(pitch),
    )
    return settled(begun, (*LEVELS, "blur_px"), 8)


def decided(
    fit: RecordingFit, free: Sequence[str], rounds: int = SETTINGS.rounds
) -> RecordingFit:
    """Fit and decide the bits in turns until none changes."""
    fit = settled(fit, free)
    for _ in range(rounds):
        lit = likelier(fit)
        if np.array_equal(lit, fit.lit):
            break
        fit = settled(replace(fit, lit=lit), free)
    return fit


def likelier(fit: RecordingFit) -> Bools:
    """Flip each LED, and leave it so where the pixels that are nearest to it are then explained better.

    LEDs that share no pixel are flipped together. An LED beyond white is told by its flanks.
    """
    shape, step, lit = fit.panel.shape, SETTINGS.flip_step, fit.lit
    numbers = np.arange(shape.leds).reshape(shape.sides)
    frame = np.arange(len(lit))[:, None, None] * shape.leds
    for i, j in np.ndindex(min(step, shape.rows), min(step, shape.columns)):
        group = numbers[i::step, j::step].ravel()
        other = lit.copy()
        other[:, group] ^= True
        gain = squares(replace(fit, lit=lit)) - squares(replace(fit, lit=other))
        place = frame + fit.nearest(group)
        total = np.bincount(place.ravel(), gain.ravel(), lit.size)
        lit = np.where(total.reshape(lit.shape) > 0, other, lit)
    return lit


def mirrored(fit: RecordingFit) -> tuple[RecordingFit, Floats]:
    """Turn each panel the other way where that explains its frame better: from afar both look alike.

    Returns:
        the better fit, and by how much the misfit of each frame tells the two ways apart, (B,).
    """
    turned = {name: -fit.values[name] for name in ("yaw_deg", "pitch_deg")}
    other = settled(fit.set(**turned), fit.free, 8)
    gain = (squares(fit) - squares(other)).sum((1, 2))
    better = gain > 0
    if better.any():
        mixed = {
            name: np.where(better[: len(value)], other.values[name], value)
            for name, value in fit.values.items()
        }
        fit = settled(fit.set(**mixed), fit.free)
    return fit, np.abs(gain) / fit.scale


def squares(fit: RecordingFit) -> Floats:
    """Give squared residuals, in units of the noise, (B,H,W)."""
    mean, variance = fit.predicted()
    return (fit.grey - mean) ** 2 / variance


def settled(
    fit: RecordingFit,
    free: Sequence[str],
    evaluations: int = SETTINGS.evaluations,
) -> RecordingFit:
    """Fit values by least squares, pixels weighed by the noise that is expected of them.

    Args:
        fit: where to begin.
        free: names of the values to fit.
        evaluations: of the picture, at most.
    """
    fit = replace(fit, free=tuple(free))
    mean, variance = fit.predicted()
    off = np.abs(fit.grey - mean) / np.sqrt(variance)
    bulk = np.quantile(off, 0.68, axis=(1, 2), keepdims=True).clip(min=0.5)
    # Residuals count in full up to four standard deviations of the bulk, and less beyond.
    calm = np.minimum(SETTINGS.clear_sigmas * bulk / off.clip(min=1e-9), 1.0)
    root: Floats = np.sqrt(calm / variance)
    low, high = np.array([RANGES[name] for name in fit.names]).T
    dense = np.ones((fit.grey[0].size, len(fit.by_frame)))
    common = np.ones((fit.grey.size, len(fit.shared)))
    sparsity = [sparse.kron(sparse.eye(len(fit.grey)), dense), common]

    def residual(vector: Floats) -> Floats:
        return (root * (fit.moved(vector).predicted()[0] - fit.grey)).ravel()

    found = optimize.least_squares(
        residual,
        fit.vector.clip(low + 1e-6, high - 1e-6),
        bounds=(low, high),
        x_scale="jac",
        jac_sparsity=sparse.hstack(sparsity),
        max_nfev=evaluations,
        ftol=SETTINGS.tolerance,
        xtol=SETTINGS.tolerance,
        gtol=None,
    )
    misfit = 2 * float(found.cost)
    scale = max(misfit / max(fit.grey.size - len(low), 1.0), 1e-12)
    spread = covariances(found.jac, found.fun, scale, fit.grey.shape)
    return replace(fit.moved(found.x), misfit=misfit, scale=scale, covariances=spread)


def covariances(
    jacobian: sparse.csr_matrix, residual: Floats, scale: float, shape: tuple[int, ...]
) -> Floats:
    """Say how sure the values are; see :class:`RecordingFit`.

    Args:
        jacobian: (B*H*W,P) of the weighted residuals.
        residual: (B*H*W,) weighted residuals.
        scale: their variance.
        shape: (B,H,W).
    """
    normal = (jacobian.T @ jacobian).toarray()
    unit = np.sqrt(normal.diagonal().clip(min=1e-12))
    units = np.outer(unit, unit)
    inverse = np.linalg.pinv(normal / units, rcond=1e-10, hermitian=True) / units
    scores = jacobian.multiply(residual[:, None]).tocsr()
    frame, y, x = np.indices(shape).reshape(3, -1)
    down, across = (axis // SETTINGS.block_px for axis in (y, x))
    block = (frame * shape[1] + down) * shape[2] + across
    freedom = max(shape[0] - 1, 1)
    wide = shape[0] / freedom * (float(stats.t.ppf(0.975, freedom)) / SURE) ** 2
    found = [inverse * scale]
    for groups, factor in ((block, 1.0), (frame, wide)):
        rows = sparse.csr_matrix((np.ones(len(x)), (groups, np.arange(len(x)))))
        pulls = (rows @ scores) @ inverse
        found.append(factor * pulls.T @ pulls)
    return np.stack(found)
