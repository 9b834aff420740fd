"""From frames to a scene: fits one after the other, each effect only where the recording asks for it."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch

from vocc_torch.arrays import Bools, Floats
from vocc_torch.errors import VoccError
from vocc_torch.extras.calibrate import CalibrateConfig
from vocc_torch.extras.calibrate.describe import describe
from vocc_torch.extras.calibrate.fit import (
    BASE,
    POSED,
    RANGES,
    decided,
    mirrored,
    settled,
    start,
)
from vocc_torch.extras.calibrate.fit import SETTINGS as FIT
from vocc_torch.extras.calibrate.model import TURNED, RecordingFit
from vocc_torch.extras.calibrate.reading import Footage
from vocc_torch.extras.calibrate.scene import Findings
from vocc_torch.extras.calibrate.surround import SETTINGS as SURROUND
from vocc_torch.extras.calibrate.surround import (
    background,
    compression,
    falloff,
    tiled,
)
from vocc_torch.extras.calibrate.transfer import transfer
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.receiver.resample import cell_size_px


@dataclass(frozen=True)
class StudySettings:
    """How a recording is prepared and judged."""

    least_contrast: float = 6.0  # grey values between Off and On, as seen
    finest_pitch_px: int = 12  # of more pixels several are averaged into one
    noise_frames: int = 4  # fewer show no noise
    undithered: float = 0.1  # variance of the background below which rounding hides it
    odd: float = 4.0  # times the squared residuals of the better frames, from which on a frame is left out
    odd_least: float = 0.5  # of these, in grey values squared
    better: float = 0.15  # share of all frames that the better ones are
    turned_deg: float = 4.6  # a panel that faces the camera has no slope by its angles


SETTINGS = StudySettings()


def coarsened(footage: Footage, camera: Camera, times: int) -> tuple[Footage, Camera]:
    """Average so many by so many pixels into one; what is left over at the edges is cut."""
    if times == 1:
        return footage, camera
    greys = tiled(footage.greys, times).mean((-2, -1))
    height, width = greys.shape[1:]
    wide = camera.sensor_width_mm * width * times / camera.width_px
    coarse = replace(camera, width_px=width, height_px=height, sensor_width_mm=wide)
    return replace(footage, greys=greys, corners_px=footage.corners_px / times), coarse


def calibrate(
    footage: Footage,
    camera: Camera,
    panel: LedPanel,
    config: CalibrateConfig,
    bits: Bools | None = None,
) -> Findings:
    """Fit a scene to a recording.

    Args:
        footage: frames with the panel's corners.
        camera: whose picture it is, of the recording's size.
        panel: the panel.
        config: how many frames are fitted, and what is known of the light.
        bits: (N,R,C) what the panel showed by frame, or None.

    Raises:
        VoccError: LEDs that all look alike in all frames, or a fit that explains nothing.
    """
    chosen = footage.taken(np.s_[:: -(-len(footage) // config.frames)])
    # Near panels hold more pixels than a fit needs.
    sizes = cell_size_px(torch.from_numpy(chosen.corners_px), panel.shape)
    pitch = float(torch.minimum(*sizes).median())
    times = max(1, int(pitch / SETTINGS.finest_pitch_px))
    used, coarse = coarsened(chosen, camera, times)
    shown = None if bits is None else bits[used.numbers.clip(max=len(bits) - 1)]
    begun = start(used, coarse, panel, shown)
    demand_contrast(begun)
    coded = compression(footage.greys)
    found = Findings(camera, panel, config, used, begun, coded, times)
    cells = max(panel.shape.sides)
    outside = background(used.greys.shape[1:], used.corners_px, cells)
    # Neighbouring pixels of the background differ by its noise; where all is panel it counts as noisy.
    pairs = outside[:, 1:] & outside[:, :-1]
    apart_dn = np.diff(used.greys.astype(np.float64), axis=2)[:, pairs]
    quiet = pairs.any() and (apart_dn**2).mean() / 2 < SETTINGS.undithered
    rounds = FIT.rounds if bits is None else 0
    fit, apart = placed(begun, found, rounds)
    # Frames that are fitted about as well as the better ones: others' corners are wrong.
    misfit = ((fit.grey - fit.predicted()[0]) ** 2).mean((1, 2))
    usual = max(np.quantile(misfit, SETTINGS.better), SETTINGS.odd_least)
    good = misfit <= SETTINGS.odd * usual
    if not good.all():
        study = calibrate(chosen.taken(good), camera, panel, config, bits)
        study.say("odd", count=np.count_nonzero(~good))
        return study
    if min(abs(fit.gamma - end) for end in RANGES["gamma"]) < 1e-3:
        found.bound = fit.gamma
        free = [name for name in fit.free if name != "gamma"]
        fit = settled(fit.set(gamma=camera.gamma), free)
    found.fall = falloff(used.greys, outside, fit)
    if found.fall.gain > 0:
        dimmed = replace(fit, corner_loss=found.fall.corner_loss)
        fit = settled(dimmed, fit.free)
    if not quiet and len(used) >= SETTINGS.noise_frames:
        fit = settled(replace(fit, noise=transfer(fit).noise), fit.free)
        found.curve = transfer(fit)
    found.fit = decided(fit, fit.free, rounds)
    describe(apart, found)
    return found


def placed(
    begun: RecordingFit, found: Findings, rounds: int
) -> tuple[RecordingFit, Floats]:
    """Fit place, levels, blur and gamma, and the pose where the image is no upright square grid.

    Returns:
        the fit, and by how much each frame tells a pose from its mirror image.
    """
    board = () if begun.panel.board_reflectance is None else ("board",)
    turn = SETTINGS.turned_deg
    turned = begun.set(yaw_deg=turn, pitch_deg=turn / 2)
    fit = decided(turned, (*board, *POSED), rounds)
    flat = fit.set(**dict.fromkeys(TURNED, 0.0))
    upright = settled(flat, (*board, *BASE))
    # Schwarz's criterion in units of the richer fit's noise. What coding leaves hangs together over its blocks.
    gain = (upright.misfit - fit.misfit) / fit.scale
    gain -= (len(fit.names) - len(upright.names)) * math.log(fit.grey.size)
    if found.tried("pose", gain, SURROUND.coded_gain * found.is_coded):
        return mirrored(fit)
    return decided(upright, upright.free, rounds), np.zeros(len(fit.grey))


def demand_contrast(fit: RecordingFit) -> None:
    """Refuse frames in which no LED differs from another."""
    contrast = float(np.median(fit.values["on"] - fit.values["off"]))
    if fit.lit.all() or not fit.lit.any() or contrast < SETTINGS.least_contrast:
        raise VoccError(
            f"input: all LEDs look alike in all {len(fit.grey)} frames: show symbols with LEDs On and LEDs Off"
        )
