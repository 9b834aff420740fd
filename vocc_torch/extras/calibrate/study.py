"""From frames to a scene: fits one after the other, each effect only where the recording asks for it."""

from dataclasses import dataclass, replace

import numpy as np
import torch

from vocc_torch.arrays import Bools, Floats
from vocc_torch.errors import VoccError
from vocc_torch.extras.calibrate import CalibrateConfig
from vocc_torch.extras.calibrate.describe import describe
from vocc_torch.extras.calibrate.drawing import PanelDrawing
from vocc_torch.extras.calibrate.fit import (
    BASE,
    POSED,
    RANGES,
    RecordingFit,
    settled,
    trusted,
)
from vocc_torch.extras.calibrate.fit import SETTINGS as FIT
from vocc_torch.extras.calibrate.leds import decided, mirrored, start
from vocc_torch.extras.calibrate.reading import Footage
from vocc_torch.extras.calibrate.scene import WORDS, Findings
from vocc_torch.extras.calibrate.surround import (
    Falloff,
    Surround,
    compression,
    falloff,
    tiled,
)
from vocc_torch.extras.calibrate.transfer import transfer
from vocc_torch.hardware import Camera, LedPanel, PanelShape


@dataclass(frozen=True)
class StudySettings:
    """How a recording is prepared and judged."""

    grid_px: int = 8  # windows begin on multiples of it, as JPEG's blocks do
    margin_cells: float = 1.2  # of a window about the panel
    margin_px: float = 8.0  # beside
    least_contrast: float = 6.0  # grey values between Off and On, as seen
    finest_pitch_px: int = 12  # of more pixels several are averaged into one
    noise_frames: int = 4  # fewer show no noise
    odd: float = 4.0  # times the squared residuals of the better frames, from which on a frame is left out
    odd_least: float = 0.5  # of these, in grey values squared
    better: float = 0.15  # share of all frames that the better ones are
    turned_deg: float = 4.6  # a panel that faces the camera has no slope by its angles


SETTINGS = StudySettings()

BY_PIXEL = {"effects.blooming.sigma_px": 1, "effects.read_noise.electrons": -1}
"""With which power of the pixels' width values grow."""


def drawing_of(
    footage: Footage, camera: Camera, panel: LedPanel
) -> tuple[PanelDrawing, Floats]:
    """Cut a window about the panel from each frame, all of one size, on a grid of 8 px.

    Returns:
        what is known of them, and their grey values (B,H,W).
    """
    grid, sensor = SETTINGS.grid_px, np.array([camera.width_px, camera.height_px])
    low, high = footage.corners_px.min(1), footage.corners_px.max(1)
    cell = (high - low).max(1, keepdims=True) / max(panel.shape.sides)
    extent = (high - low + 2 * (SETTINGS.margin_cells * cell + SETTINGS.margin_px)).max(
        0
    )
    size = np.minimum((np.ceil(extent / grid) * grid + grid).astype(int), sensor)
    first = np.round((low + high) / 2 - size / 2).astype(int) // grid * grid
    first = np.minimum(first.clip(min=0), sensor - size).clip(min=0) // grid * grid
    width, height = np.minimum(size, sensor - first.max(0)).tolist()
    drawing = PanelDrawing(camera, panel, torch.from_numpy(first), (height, width))
    places = zip(footage.greys, first.tolist(), strict=True)
    return drawing, np.stack(
        [grey[y : y + height, x : x + width] for grey, (x, y) in places]
    ).astype(float)


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
    coded = compression(footage.greys)
    times = coarseness(footage.corners_px, panel.shape)
    chosen = footage.taken(np.s_[:: -(-len(footage) // config.frames)])
    coarse = coarser(camera, times)
    used = binned(chosen, times)
    drawing, grey = drawing_of(used, coarse, panel)
    around = Surround.of(used.greys, used.corners_px, max(panel.shape.sides))
    fall = falloff(around, drawing, coarse.gamma)
    shown = None if bits is None else bits[used.numbers.clip(max=len(bits) - 1)]
    begun = start(shaded(drawing, fall), grey, used.corners_px, shown)
    demand_contrast(begun)
    found = Findings(coarse, panel, config, used, begun, around, fall, coded)
    quiet = around.noise() < FIT.undithered
    rounds = 4 if bits is None else 0
    fit, apart = placed(trusted(begun) if quiet else begun, found, rounds)
    good = fitting(fit)
    if not good.all():  # some frames may have bent the others: each alone
        alone = [begun.taken(slice(frame, frame + 1)) for frame in range(len(grey))]
        good = fitting(*(settled(frame_fit, fit.free) for frame_fit in alone))
    if not good.all():
        study = calibrate(chosen.taken(good), camera, panel, config, bits)
        study.unknown.append(WORDS["sentences"]["odd"].format(count=int((~good).sum())))
        return study
    fit = bounded(fit, found)
    if fall.gain > 0:  # it was told with the camera's gamma
        found.fall = falloff(around, drawing, fit.gamma)
        fit = settled(replace(fit, drawing=shaded(drawing, found.fall)), fit.free)
    for _ in range(0 if quiet or len(grey) < SETTINGS.noise_frames else 2):
        found.curve = transfer(fit)
        fit = settled(trusted(replace(fit, noise=found.curve.noise)), fit.free, 6)
    found.fit = decided(fit, fit.free, rounds)
    if found.curve is not None:
        found.curve = transfer(found.fit)
    describe(apart, found)
    finer(found, camera, times)
    return found


def fitting(*fits: RecordingFit) -> Bools:
    """Tell frames that are fitted about as well as the better ones, (B,): others' corners are wrong."""
    misfit = np.concatenate(
        [((fit.grey - fit.predicted()[0]) ** 2).mean((1, 2)) for fit in fits]
    )
    return np.asarray(
        misfit
        <= SETTINGS.odd * max(np.quantile(misfit, SETTINGS.better), SETTINGS.odd_least)
    )


def coarseness(corners_px: Floats, shape: PanelShape) -> int:
    """Say how many pixels are one: near panels hold more of them than a fit needs."""
    sides = np.linalg.norm(np.roll(corners_px, -1, 1) - corners_px, axis=2)
    means = sides.reshape(-1, 2, 2).mean(1) / (shape.columns, shape.rows)
    return max(1, int(np.median(means.min(1)) / SETTINGS.finest_pitch_px))


def coarser(camera: Camera, times: int) -> Camera:
    """Give the camera whose pixels are so many times as wide; what is left over at the edges is cut."""
    width, height = camera.width_px // times, camera.height_px // times
    wide = camera.sensor_width_mm * width * times / camera.width_px
    return replace(camera, width_px=width, height_px=height, sensor_width_mm=wide)


def binned(footage: Footage, times: int) -> Footage:
    """Average so many by so many pixels into one."""
    if times == 1:
        return footage
    greys = tiled(footage.greys, times).mean((-2, -1))
    return replace(footage, greys=greys, corners_px=footage.corners_px / times)


def finer(found: Findings, camera: Camera, times: int) -> None:
    """Say of single pixels what was found of many in one."""
    for at, value in enumerate(found.values):
        if value.key in BY_PIXEL:
            scale = float(times) ** BY_PIXEL[value.key]
            found.values[at] = value._replace(
                setting=value.middle * scale, deviation=value.deviation * scale
            )
    found.camera = replace(camera, gamma=found.camera.gamma)


def placed(
    begun: RecordingFit, found: Findings, rounds: int
) -> tuple[RecordingFit, Floats]:
    """Fit place, levels, blur and gamma, and the pose where the image is no upright square grid.

    Returns:
        the fit, and by how much each frame tells a pose from its mirror image.
    """
    board = ("board",) if begun.has_board else ()
    turned = begun.set("yaw_deg", SETTINGS.turned_deg)
    turned = turned.set("pitch_deg", SETTINGS.turned_deg / 2)
    fit = decided(turned, (*board, *POSED), rounds)
    flat = fit.set("yaw_deg", 0.0).set("pitch_deg", 0.0).set("roll_deg", 0.0)
    upright = settled(flat, (*board, *BASE))
    if found.judge("pose", upright, fit) is upright:
        return decided(upright, upright.free, rounds), np.zeros(len(fit.grey))
    return mirrored(fit, fit.free)


def bounded(fit: RecordingFit, found: Findings) -> RecordingFit:
    """Take the camera's gamma where the recording's runs to its bound."""
    if min(abs(fit.gamma - end) for end in RANGES["gamma"]) > 1e-3:
        return fit
    found.bound = fit.gamma
    free = [name for name in fit.free if name != "gamma"]
    return settled(fit.set("gamma", found.camera.gamma), free)


def shaded(drawing: PanelDrawing, fall: Falloff) -> PanelDrawing:
    """Dim the windows as the background falls off, where it does."""
    return replace(drawing, corner_loss=fall.corner_loss if fall.gain > 0 else None)


def demand_contrast(fit: RecordingFit) -> None:
    """Refuse frames in which no LED differs from another."""
    contrast = float(np.median(fit.value("on") - fit.value("off")))
    if (fit.bits == fit.bits[0, 0]).all() or contrast < SETTINGS.least_contrast:
        raise VoccError(
            f"input: all LEDs look alike in all {len(fit.grey)} frames: show symbols with LEDs On and LEDs Off"
        )
