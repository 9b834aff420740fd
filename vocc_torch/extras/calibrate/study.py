"""From frames to a scene: fits one after the other, each effect only where the recording asks for it."""

import math
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.extras.calibrate import CalibrateConfig, model
from vocc_torch.extras.calibrate.describe import LIKELIHOOD, describe
from vocc_torch.extras.calibrate.fit import RANGES, UNDITHERED, RecordingFit, corrected, settled, trusted
from vocc_torch.extras.calibrate.leds import BASE, POSED, amplitudes, decided, mirrored, scatter, start
from vocc_torch.extras.calibrate.model import OF_FRAME, Windows
from vocc_torch.extras.calibrate.pace import Pace, pace
from vocc_torch.extras.calibrate.reading import Footage
from vocc_torch.extras.calibrate.scene import WORDS, Findings
from vocc_torch.extras.calibrate.surround import Falloff, Surround, compression, falloff, natural, tiled
from vocc_torch.extras.calibrate.transfer import transfer
from vocc_torch.hardware import Camera, LedPanel, PanelShape
from vocc_torch.receiver.resample import cell_size_px

GRID_PX = 8
"""Windows begin on multiples of it, as JPEG's blocks do."""
LEAST_CONTRAST = 6.0
"""Grey values between Off and On, as seen, below which LEDs are alike."""
FINEST_PITCH_PX = 12
"""Pixels from LED to LED that are enough; of more, several are averaged into one."""
LEAST_FRAMES = 4
"""Fewer show no noise."""
ODD, ODD_LEAST, BETTER = 4.0, 0.5, 0.15
"""Frames whose corners are wrong by a row, or in which something passes, have more than so many times the
squared residuals of the better ones, which are this share of all. The least, in grey values squared."""
BY_PIXEL = {"effects.blooming.sigma_px": 1, "effects.read_noise.electrons": -1}
"""With which power of the pixels' width values grow."""


def windows_of(footage: Footage, camera: Camera, panel: LedPanel) -> tuple[Windows, Tensor]:
    """Cut a window about the panel from each frame, all of one size, on a grid of 8 px.

    Returns:
        what is known of them, and their grey values (B,H,W).
    """
    low, high = footage.corners_px.amin(1), footage.corners_px.amax(1)
    cell = (high - low).amax(1, keepdim=True) / max(panel.shape.rows, panel.shape.columns)
    extent = (high - low + 2 * (1.2 * cell + 8)).amax(0)
    sensor = torch.tensor([camera.width_px, camera.height_px])
    size = torch.minimum(((extent / GRID_PX).ceil() * GRID_PX + GRID_PX).long(), sensor)
    first = ((low + high) / 2 - size / 2).round().long() // GRID_PX * GRID_PX
    first = torch.minimum(first.clamp(min=0), sensor - size).clamp(min=0) // GRID_PX * GRID_PX
    size = torch.minimum(size, sensor - first.amax(0))
    width, height = size.tolist()
    radius, focal = panel.led_diameter_m / panel.pitch_m / 2, camera.focal_length_px
    windows = Windows(panel.shape, radius, focal, camera.sensor_px, first, (height, width))
    return windows, windows.cut(torch.from_numpy(footage.greys)).double()


def calibrate(
    footage: Footage,
    camera: Camera,
    panel: LedPanel,
    config: CalibrateConfig,
    bits: NDArray[np.bool_] | None = None,
    paced: Pace | None = None,
) -> Findings:
    """Fit a scene to a recording.

    Args:
        footage: frames with the panel's corners.
        camera: whose picture it is, of the recording's size.
        panel: the panel.
        config: how many frames are fitted, and what is known of the light.
        bits: (N,R,C) what the panel showed by frame, or None.
        paced: the times of symbols and rows, where more frames than these told them.

    Raises:
        VoccError: LEDs that all look alike in all frames, or a fit that explains nothing.
    """
    coded, whole, times = compression(footage.greys), camera, coarseness(footage.corners_px, panel.shape)
    camera, chosen = coarser(camera, times), footage.taken(np.s_[:: -(-len(footage) // config.frames)])
    footage = binned(chosen, times)
    known, grey = windows_of(footage, camera, panel)
    cells = max(panel.shape.rows, panel.shape.columns)
    around = Surround.of(footage.greys, footage.corners_px, cells)
    fall = falloff(around, camera.focal_length_px, camera.gamma)
    told = None if bits is None else torch.from_numpy(bits[footage.numbers.clip(max=len(bits) - 1)])
    begun = start(shaded(known, camera, fall), grey, footage.corners_px, told, camera.gamma)
    demand_contrast(begun)
    found = Findings(camera, panel, config, footage, begun, around, fall, coded)
    quiet = around.noise() < UNDITHERED
    fit, free, apart = placed(trusted(begun) if quiet else begun, found)
    found.pace = paced or in_time(fit, footage.times_s)
    kept = fitting(fit)
    if not bool(kept.all()):  # some frames may have bent the others: each alone
        frames = [slice(i, i + 1) for i in range(len(grey))]
        kept = fitting(*(decided(posed(begun.taken(one)), POSED)[0] for one in frames))
    if paced is None and found.pace is not None and int(kept.sum()) >= LEAST_FRAMES + found.pace.mixed.sum():
        kept &= ~torch.from_numpy(found.pace.mixed)
    if not bool(kept.all()):
        study = calibrate(chosen.taken(kept.numpy()), whole, panel, config, bits, found.pace)
        study.unknown.append(WORDS["sentences"]["odd"].format(count=int((~kept).sum())))
        return study
    if min(abs(float(fit.of_all[0]) - end) for end in RANGES["gamma"]) < 1e-6:  # the levels are the camera's
        found.bound, free = float(fit.of_all[0]), tuple(name for name in free if name != "gamma")
        own = fit.of_all.index_fill(0, torch.tensor(0), camera.gamma)
        fit = settled(replace(fit, of_all=own), free)
    if fall.natural_gain > 0:  # it was told with the camera's gamma
        found.fall = falloff(around, camera.focal_length_px, float(fit.of_all[0]))
        fit = settled(replace(fit, windows=shaded(known, camera, found.fall)), free)
    for _ in range(0 if quiet or len(grey) < LEAST_FRAMES else 2):
        found.curve = transfer(fit)
        fit = settled(trusted(replace(fit, noise=found.curve.noise)), free, steps=8)
    fit = sensor_and_lens(fit, free, found)
    free = fit.free
    fit, own, error = decided(fit, free, 4 if bits is None else 0)
    differ = scatter(own, error, fit.bits)
    if differ.gain > LIKELIHOOD:
        fit = settled(replace(fit, lit=fit.bits * differ.factors), free, steps=8)
    if found.curve is not None:
        found.curve = transfer(fit)
        fit = settled(replace(fit, noise=found.curve.noise), free, steps=4)
    found.fit = corrected(fit, free, math.sqrt(around.noise())) if quiet and not found.is_coded else fit
    describe(differ, apart, found)
    finer(found, whole, times)
    return found


def in_time(fit: RecordingFit, times_s: NDArray[np.float64]) -> Pace | None:
    """Tell the times of symbols and rows by the LEDs' light in frames whose times are known."""
    if not np.isfinite(times_s).all():
        return None
    cells = len(fit.grey), fit.windows.shape.rows, -1
    at = model.seen(fit.windows, fit.of_frame, fit.of_all, model.grid(fit.windows.shape))[0][..., 1]
    rows_px, own = at.view(cells).mean(2), amplitudes(fit)[0].view(cells)
    return pace(own.numpy(), times_s, rows_px.numpy(), fit.windows.sensor_px[0], fit.windows.radius)


def fitting(*fits: RecordingFit) -> Tensor:
    """Tell frames that are fitted about as well as the better ones, (B,) bool: others' corners are wrong."""
    parts = [(fit.grey - mean).square().mean((1, 2)) for fit in fits for mean in fit.predicted()[:1]]
    misfit = torch.cat(parts)
    return misfit <= ODD * misfit.quantile(BETTER).clamp(min=ODD_LEAST)


def coarseness(corners_px: Tensor, shape: PanelShape) -> int:
    """Say how many pixels are one: near panels hold more of them than a fit needs."""
    across, down = cell_size_px(corners_px, shape)
    return max(1, int(float(torch.minimum(across, down).median()) / FINEST_PITCH_PX))


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
    for at, one in enumerate(found.values):
        if one.key in BY_PIXEL:
            scale = float(times) ** BY_PIXEL[one.key]
            found.values[at] = one._replace(given=one.middle * scale, deviation=one.deviation * scale)
    found.camera = replace(camera, gamma=found.camera.gamma)


def placed(begun: RecordingFit, found: Findings) -> tuple[RecordingFit, tuple[str, ...], Tensor]:
    """Fit place, levels, blur and gamma, and the pose where the image is no upright square grid.

    Returns:
        the fit, the names of what is fitted, and by how much each frame tells a pose from its mirror image.
    """
    fit, _, _ = decided(posed(begun), POSED)
    flat = fit.of_frame.index_fill(1, torch.arange(3, 6), 0.0)
    upright = settled(replace(fit, of_frame=flat), BASE, steps=10)
    kept = found.judge("pose", upright, fit)
    if kept is upright:
        return decided(upright, BASE)[0], BASE, torch.zeros(len(fit.grey))
    fit, apart = mirrored(fit, POSED)
    return fit, POSED, apart


def posed(begun: RecordingFit) -> RecordingFit:
    """Turn the panel a little: where it faces the camera the angles have no slope."""
    return replace(begun, of_frame=begun.of_frame + 0.08 * model.directions(["yaw"])[0])


def shaded(known: Windows, camera: Camera, fall: Falloff) -> Windows:
    """Dim the windows as the background falls off, where it does."""
    if fall.natural_gain <= 0:
        return known
    shade, out = natural(camera.height_px, camera.width_px, camera.focal_length_px)
    if fall.barrel_gain > 0 and fall.corner_loss > 0:
        shade = shade * (1 - fall.corner_loss * out)
    whole = torch.from_numpy(shade).expand(len(known.origin_px), -1, -1)
    return replace(known, gain=known.cut(whole))


def demand_contrast(fit: RecordingFit) -> None:
    """Refuse frames in which no LED differs from another."""
    seen = float((fit.value("on") - fit.value("off")).median())
    if bool((fit.bits == fit.bits[0, 0]).all()) or seen < LEAST_CONTRAST:
        rule = "show symbols with LEDs On and LEDs Off"
        raise VoccError(f"input: all LEDs look alike in all {len(fit.grey)} frames: {rule}")


def sensor_and_lens(fit: RecordingFit, free: tuple[str, ...], found: Findings) -> RecordingFit:
    """Try motion, the lens and a board, one after the other."""
    moving = (*(name for name in free if name != "blur"), "blur_xx", "blur_yy")
    rich = settled(fit, moving, steps=3)
    error = math.hypot(rich.deviation("blur_xx"), rich.deviation("blur_yy"))
    apart = abs(float(rich.value("blur_xx") - rich.value("blur_yy")))
    fit = found.judge("motion_blur", fit, rich, apart / error if error else 0.0)
    rich = settled(fit, (*fit.free, "k1"), steps=6)
    error = rich.deviation("k1")  # 0 where the frames tell nothing of it
    fit = found.judge("lens_distortion", fit, rich, abs(float(rich.value("k1"))) / error if error else 0.0)
    board = torch.tensor([OF_FRAME.index("board")])
    own = fit.of_frame.index_copy(1, board, fit.value("background").unsqueeze(1))
    boards = replace(fit, windows=replace(fit.windows, has_board=True), of_frame=own)
    rich = settled(boards, (*fit.free, "board"), steps=4)
    return found.judge("panel.board_reflectance", fit, rich)
