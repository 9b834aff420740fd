"""The LEDs: which are On, and where a fit of them begins."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from vocc_torch.arrays import Bools, Floats
from vocc_torch.extras.calibrate.fit import settled
from vocc_torch.extras.calibrate.model import LEVELS, RecordingFit
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.receiver.levels import two_levels
from vocc_torch.receiver.resample import cell_size_px, centre_greys
from vocc_torch.types import Frames, Panels


@dataclass(frozen=True)
class LedSettings:
    """How LEDs are decided."""

    blur_pitches: float = 0.25  # where the blur's fit begins
    brighter: float = 1.3  # a wide On LED than one as seen, whose light is spread
    rounds: int = 4  # of fits and decisions
    flip_step: int = 4  # LEDs so far apart do not share pixels


SETTINGS = LedSettings()


def start(
    windows: Frames,
    camera: Camera,
    panel: LedPanel,
    corners_px: Floats,
    bits: Bools | None,
) -> RecordingFit:
    """Begin from the corners that the locator found.

    Args:
        windows: about the panel in each frame.
        camera: the camera.
        panel: the panel.
        corners_px: (B,4,2) on the sensor.
        bits: (B,R,C) known bits, or None to decide them from the grey values at the LEDs' centres.
    """
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
