"""The LEDs: which are On, how bright each is, and where a fit of them begins."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.ndimage import uniform_filter

from vocc_torch.arrays import Bools, Floats
from vocc_torch.extras.calibrate.drawing import COLUMN, LEVELS, PanelDrawing
from vocc_torch.extras.calibrate.fit import RecordingFit, settled
from vocc_torch.receiver.levels import two_levels
from vocc_torch.receiver.resample import centre_greys
from vocc_torch.types import Frames, Panels


@dataclass(frozen=True)
class LedSettings:
    """How LEDs are decided."""

    first_frames: int = 3  # by which the blur's size is searched for
    # Of a pitch, tried for the blur.
    blur_shares: tuple[float, ...] = (
        0.12,
        0.25,
        0.45,
        0.7,
    )
    rounds: int = 4  # of fits and decisions
    flip_step: int = 4  # LEDs so far apart do not share pixels


SETTINGS = LedSettings()


def start(
    drawing: PanelDrawing, grey: Floats, corners_px: Floats, bits: Bools | None
) -> RecordingFit:
    """Begin from the corners that the locator found.

    Args:
        drawing: the windows.
        grey: (B,H,W) of the frames in them.
        corners_px: (B,4,2) on the sensor.
        bits: (B,R,C) known bits, or None to decide them from the grey values at the LEDs' centres.
    """
    shape, frames = drawing.panel.shape, len(grey)
    smooth = torch.from_numpy(uniform_filter(grey, (1, 3, 3)))
    windows = Frames(smooth[:, None], drawing.origin_px, drawing.camera.sensor_px)
    panels = Panels.known(torch.from_numpy(corners_px))
    read = centre_greys(windows, panels, shape).flatten(1)
    bright = (read > two_levels(read)[0][:, None]).numpy()
    lit = bright if bits is None else bits.reshape(frames, -1)
    centres = read.numpy()
    behind = np.median(grey[:, [0, 1, -2, -1]], axis=(1, 2))
    on = np.ma.array(centres, mask=~lit).mean(1).filled(centres.max(1) + 20)
    off = np.ma.array(centres, mask=lit).mean(1).filled(behind)
    side = np.roll(corners_px, -1, 1) - corners_px
    right, down = (side[:, 0] - side[:, 2]) / 2, (side[:, 1] - side[:, 3]) / 2
    pitch = (np.hypot(*right.T) / shape.columns + np.hypot(*down.T) / shape.rows) / 2
    table = np.zeros((frames, len(COLUMN)))
    table[:, :2], table[:, 2] = corners_px.mean(1), np.log(pitch)
    table[:, 5] = np.degrees(np.arctan2(right[:, 1], right[:, 0]))
    table[:, 6:10] = np.stack([behind, off, 1.3 * on, off], 1).clip(min=1.0)
    table[:, 10:] = drawing.camera.gamma, 1.0
    begun = RecordingFit(drawing, grey, table, lit.astype(float))
    few, tried = begun.taken(slice(0, SETTINGS.first_frames)), []
    for share in SETTINGS.blur_shares:
        blurred = few.set("blur_px", float(np.median(pitch)) * share)
        tried.append(settled(blurred, (*LEVELS[:3], "blur_px"), 3, robust=False))
    blur = min(tried, key=lambda fit: fit.misfit).value("blur_px")[0]
    return settled(begun.set("blur_px", blur), LEVELS[:3], 4, robust=False)


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


def likelier(fit: RecordingFit) -> Floats:
    """Flip each LED, and leave it so where the pixels that are nearest to it are then explained better.

    LEDs that share no pixel are flipped together. An LED beyond white is told by its flanks.
    """
    shape, (height, width) = fit.drawing.panel.shape, fit.drawing.size_px
    at, step = fit.drawing.centres_px(fit.table), SETTINGS.flip_step
    y, x = np.mgrid[:height, :width] + 0.5
    rows = np.arange(len(at))
    weights = fit.trust / fit.predicted()[1]
    parts = [*fit.parts()]
    numbers = np.arange(shape.leds).reshape(shape.sides)
    lit = fit.lit.copy()
    for i, j in np.ndindex(step, step):
        group = numbers[i::step, j::step].ravel()
        apart = (x - at[:, group, 0, None, None]) ** 2 + (
            y - at[:, group, 1, None, None]
        ) ** 2
        if not len(group):
            continue
        other, nearest = lit.copy(), apart.argmin(1)
        other[:, group] = 1 - other[:, group]
        squares = []
        for weighed in (lit, other):
            parts[2] = fit.drawing.cover(fit.table, weighed)
            squares.append(weights * (fit.grey - fit.predicted(parts)[0]) ** 2)
        gain = squares[0] - squares[1]
        for place, led in enumerate(group):
            better = (gain * (nearest == place)).sum((1, 2)) > 0
            lit[rows[better], led] = other[rows[better], led]
    return lit


def mirrored(fit: RecordingFit, free: Sequence[str]) -> tuple[RecordingFit, Floats]:
    """Turn each panel the other way where that explains its frame better: from afar both look alike.

    Returns:
        the better fit, and by how much the misfit of each frame tells the two ways apart, (B,).
    """
    other = fit
    for name in ("yaw_deg", "pitch_deg"):
        other = other.set(name, -fit.value(name))
    other = settled(other, free, 8)
    gain = misfits(fit) - misfits(other)
    apart, better = np.abs(gain) / fit.scale, gain > 0
    if not better.any():
        return fit, apart
    table = np.where(better[:, None], other.table, fit.table)
    return settled(replace(fit, table=table), free), apart


def misfits(fit: RecordingFit) -> Floats:
    """Sum each frame's squared residuals, in units of the noise, (B,)."""
    mean, variance = fit.predicted()
    return np.asarray(((fit.grey - mean) ** 2 / variance).sum((1, 2)))
