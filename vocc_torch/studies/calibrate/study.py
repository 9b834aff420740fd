"""From frames to a scene: fits one after the other, each effect only where the recording asks for it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy import optimize
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.simulation.effects.sensor import Photoelectrons
from vocc_torch.studies.calibrate import model, statistics
from vocc_torch.studies.calibrate import scene as scenes
from vocc_torch.studies.calibrate.fit import BASE, POSED, Fit, amplitudes, decided, mirrored, settled, start
from vocc_torch.studies.calibrate.model import LEVELS, OF_FRAME, PLACED, Windows
from vocc_torch.studies.calibrate.reading import Footage
from vocc_torch.studies.calibrate.scene import Calibrated, Named, Value

GRID_PX = 8
"""Windows begin on multiples of it, as JPEG's blocks and Bayer's cells do."""
BLIND_BLUR_PX = 0.15
"""A narrower blur is none."""
LEAST_CONTRAST = 6.0
"""Grey values between Off and On, as seen, below which LEDs are alike."""
NOISE_FREE = "fewer than 4 frames show no noise"
SCATTER_LIKELIHOOD = 10.8
"""Twice the log-likelihood ratio that one value reaches by chance in a thousand (chi-squared)."""


@dataclass(frozen=True)
class Study:
    """A calibration with all that its page shows.

    Args:
        scene: what came of it.
        fit: the last fit.
        curve: the photon transfer curve; None for too few frames.
        own: (B,R*C) each LED's light over On's.
        footage: the frames.
    """

    scene: Calibrated
    fit: Fit
    curve: statistics.Curve | None
    own: Tensor
    footage: Footage


def windows_of(
    footage: Footage, camera: Camera, panel: LedPanel, most: int
) -> tuple[Windows, Tensor, Footage]:
    """Cut a window about the panel from each frame, all of one size, on a grid of 8 px.

    Returns:
        what is known of them, their grey values (B,H,W), and the footage of the frames that were taken.

    Raises:
        VoccError: a panel that fills the picture.
    """
    step = -(-len(footage) // most)
    kept = slice(None, None, step)
    footage = replace(
        footage,
        greys=footage.greys[kept],
        numbers=footage.numbers[kept],
        times_s=footage.times_s[kept],
        corners_px=footage.corners_px[kept],
    )
    corners = footage.corners_px
    low, high = corners.amin(1), corners.amax(1)
    cell = (high - low).amax(1) / max(panel.shape.rows, panel.shape.columns)
    margin = (1.2 * cell + 8).unsqueeze(1)
    extent = (high - low + 2 * margin).amax(0)
    sensor = torch.tensor([camera.width_px, camera.height_px])
    size = ((extent / GRID_PX).ceil() * GRID_PX + GRID_PX).long()
    size = torch.minimum(size, sensor)
    first = ((low + high) / 2 - size / 2).round().long() // GRID_PX * GRID_PX
    first = torch.minimum(first.clamp(min=0), sensor - size).clamp(min=0) // GRID_PX * GRID_PX
    size = torch.minimum(size, sensor - first.amax(0))
    width, height = size.tolist()
    cut = [
        torch.from_numpy(frame[y : y + height, x : x + width].astype(np.float64))
        for frame, (x, y) in zip(footage.greys, first.tolist(), strict=True)
    ]
    known = Windows(
        panel.shape,
        panel.led_diameter_m / panel.pitch_m / 2,
        camera.focal_length_px,
        camera.sensor_px,
        first,
        (height, width),
    )
    return known, torch.stack(cut), footage


def gain(simple: Fit, rich: Fit) -> float:
    """Say by how much Schwarz's criterion favours the richer of two fits, in units of its own noise."""
    added = (rich.values - simple.values) * math.log(rich.grey.numel())
    return (simple.misfit - rich.misfit) / rich.scale - added


BIC = "misfit less log(pixels) a value (BIC)"


class Trials:
    """Effects that were tried, and the fit that stands."""

    def __init__(self) -> None:
        """Begin with none."""
        self.named: list[Named] = []

    def judge(self, effect: str, simple: Fit, rich: Fit, explains: str) -> Fit:
        """Keep the richer fit where the criterion favours it."""
        gained = gain(simple, rich)
        self.named.append(Named(effect, gained > 0, BIC, gained, 0.0, explains))
        return rich if gained > 0 else simple


def calibrate(
    footage: Footage,
    camera: Camera,
    panel: LedPanel,
    *,
    most: int,
    bits: np.ndarray | None = None,
    ambient_lx: float | None = None,
    quantum_efficiency: float = 0.6,
) -> Study:
    """Fit a scene to a recording.

    Args:
        footage: frames with the panel's corners.
        camera: whose picture it is, of the recording's size.
        panel: the panel.
        most: frames that are fitted, at most.
        bits: (N,R,C) what the panel showed by frame, or None.
        ambient_lx: illuminance, where it is known.
        quantum_efficiency: for the illuminance, where it is not.

    Raises:
        VoccError: LEDs that all look alike in all frames, or a fit that explains nothing.
    """
    unknown: list[str] = []
    doubts: list[str] = []
    trials = Trials()
    known, grey, footage = windows_of(footage, camera, panel, most)
    around = statistics.Surround.of(footage.greys, footage.corners_px, max(panel.shape.rows, panel.shape.columns))
    fall = statistics.falloff(around, camera.focal_length_px, camera.gamma)
    known = shaded(known, camera, fall)
    told = None if bits is None else torch.from_numpy(bits[footage.numbers.clip(max=len(bits) - 1)])
    begun = start(known, grey, footage.corners_px, told, camera.gamma)
    demand_contrast(begun, footage, told)
    posed = replace(begun, of_frame=begun.of_frame + 0.08 * model.direction("yaw")[1])
    fit, own, error = decided(posed, POSED)
    fit, apart = mirrored(fit, POSED)
    flat = fit.of_frame.clone()
    flat[:, 3:6] = 0
    upright = settled(replace(fit, of_frame=flat), BASE, steps=10)
    is_posed = gain(upright, fit) > 0
    fit = trials.judge("pose", upright, fit, "the panel's image is no upright square grid")
    free = POSED if is_posed else BASE
    top = ceiling_of(fit)
    del top
    curve = None
    if len(grey) >= 4:
        for _ in range(2):
            curve = statistics.transfer(fit)
            fit = settled(replace(fit, noise=curve.noise), free, steps=8)
    fit, free = sensor_and_lens(fit, free, trials)
    own, error = amplitudes(fit)
    if bits is None and bool(((own > 0.5) != fit.bits).any()):
        fit, own, error = decided(replace(fit, lit=(own > 0.5).double()), free)
    scatter, scatter_deviation, likelihood = scatter_of(own, error, fit)
    trials.named.append(
        Named(
            "led_scatter",
            likelihood > SCATTER_LIKELIHOOD,
            "likelihood ratio",
            likelihood,
            SCATTER_LIKELIHOOD,
            "LEDs differ in brightness",
        )
    )
    if likelihood > SCATTER_LIKELIHOOD:
        factors = factors_of(own, fit)
        fit = settled(replace(fit, lit=fit.bits * factors), free, steps=8)
    if curve is not None:
        curve = statistics.transfer(fit)
        fit = settled(replace(fit, noise=curve.noise), free, steps=4)
    return described(
        Study(Calibrated((), (), camera, panel), fit, curve, own, footage),
        trials,
        around,
        fall,
        scatter=(scatter, scatter_deviation),
        apart=apart,
        ambient_lx=ambient_lx,
        efficiency=quantum_efficiency,
        unknown=unknown,
        doubts=doubts,
    )


def shaded(known: Windows, camera: Camera, fall: statistics.Falloff) -> Windows:
    """Dim the windows as the background falls off, where it does."""
    if fall.natural_gain <= 0:
        return known
    shade, out = statistics.natural(camera.height_px, camera.width_px, camera.focal_length_px)
    if fall.barrel_gain > 0 and fall.corner_loss > 0:
        shade = shade * (1 - fall.corner_loss * out)
    height, width = known.size_px
    parts = [shade[y : y + height, x : x + width] for x, y in known.origin_px.tolist()]
    return replace(known, gain=torch.from_numpy(np.stack(parts)))


def demand_contrast(fit: Fit, footage: Footage, told: Tensor | None) -> None:
    """Refuse frames in which no LED differs from another."""
    on, off = fit.value("on"), fit.value("off")
    seen = float((on - off).median())
    constant = bool((fit.bits == fit.bits[:1]).all()) and bool((fit.bits[0] == fit.bits[0, 0]).all())
    if constant or seen < LEAST_CONTRAST:
        rule = "show symbols with LEDs On and LEDs Off"
        raise VoccError(f"input: all LEDs look alike in all {len(footage)} frames: {rule}")


def ceiling_of(fit: Fit) -> float | None:
    """Give the grey value at which pixels pile up below white, as full wells do, or None."""
    top = float(fit.grey.max())
    if top >= model.WHITE - 1 or top < 100:
        return None
    near, below = ((fit.grey > top - d).double().mean() for d in (2.5, 10.0))
    return top if float(near) > 2e-3 and float(near) > 0.6 * float(below) else None


def sensor_and_lens(fit: Fit, free: Sequence[str], trials: Trials) -> tuple[Fit, tuple[str, ...]]:
    """Try demosaicing, motion, the lens and a board, one after the other."""
    free = tuple(free)
    mosaic = replace(fit, windows=replace(fit.windows, mosaic=True))
    if not bool((fit.windows.origin_px % 2).any()):
        tried = settled(mosaic, free, steps=6)
        # No value more: the likelier of the two, by what one value would cost.
        gained = (fit.misfit - tried.misfit) / tried.scale - math.log(fit.grey.numel())
        trials.named.append(
            Named("demosaicing", gained > 0, BIC, gained, 0.0, "colours are guessed from neighbours")
        )
        fit = tried if gained > 0 else fit
    moving = tuple(name for name in free if name != "blur") + ("blur_xx", "blur_yy", "blur_xy")
    rich = settled(fit, moving, steps=4)
    kept = trials.judge("motion_blur", fit, rich, "light is spread farther in one direction")
    free = moving if kept is rich else free
    fit = kept
    rich = settled(fit, (*free, "k1"), steps=6)
    kept = trials.judge("lens_distortion", fit, rich, "the lattice of LEDs is bent about the sensor's middle")
    free = (*free, "k1") if kept is rich else free
    fit = kept if kept is rich else fit
    boards = replace(fit, windows=replace(fit.windows, has_board=True))
    boards.of_frame[:, OF_FRAME.index("board")] = fit.value("off").clamp(max=300)
    rich = settled(boards, (*free, "board"), steps=10)
    kept = trials.judge("panel.board_reflectance", fit, rich, "between the LEDs it is not as bright as around them")
    return kept, (*free, "board") if kept is rich else free


def scatter_of(own: Tensor, error: Tensor, fit: Fit) -> tuple[float, float, float]:
    """Estimate the coefficient of variation of the LEDs' light, its deviation, and twice its log-likelihood ratio."""
    weights = fit.bits / error.square()
    total = weights.sum(0)
    lit = (total > 0) & ((fit.bits).sum(0) >= 1)
    mean = ((weights * own).sum(0) / total.clamp(min=1e-12))[lit]
    # What the frames' scatter about an LED's mean says beside the pixels' own.
    around = (weights * (own - ((weights * own).sum(0) / total.clamp(min=1e-12))).square()).sum(0)[lit]
    freedom = (fit.bits.sum(0)[lit] - 1).clamp(min=0)
    wide = max(1.0, float(around.sum() / freedom.sum().clamp(min=1)))
    variance = wide / total[lit]
    count = len(mean)
    if count < 4:
        return 0.0, math.nan, 0.0

    def loss(log_share: float) -> float:
        spread = variance + math.exp(2 * log_share) * float(mean.mean()) ** 2
        middle = (mean / spread).sum() / (1 / spread).sum()
        return float((spread.log() + (mean - middle).square() / spread).sum())

    found = optimize.minimize_scalar(loss, bounds=(math.log(1e-5), math.log(2.0)), method="bounded")
    share = math.exp(float(found.x))
    noise = float(variance.mean()) / float(mean.mean()) ** 2
    deviation = (share**2 + noise) / max(share, 1e-9) / math.sqrt(2 * count)
    return share, deviation, loss(math.log(1e-6)) - float(found.fun)


def factors_of(own: Tensor, fit: Fit) -> Tensor:
    """Give each LED's own factor, of mean 1, from the frames in which it is On, (R*C,)."""
    count = fit.bits.sum(0)
    mean = (own * fit.bits).sum(0) / count.clamp(min=1)
    middle = mean[count > 0].mean()
    return torch.where(count > 0, mean / middle, 1.0)


def described(
    study: Study,
    trials: Trials,
    around: statistics.Surround,
    fall: statistics.Falloff,
    *,
    scatter: tuple[float, float],
    apart: Tensor,
    ambient_lx: float | None,
    efficiency: float,
    unknown: list[str],
    doubts: list[str],
) -> Study:
    """Say in the simulator's words what was fitted, and what nobody can tell."""
    fit, curve, camera, panel = study.fit, study.curve, study.scene.camera, study.scene.panel
    named = {one.effect: one for one in trials.named}
    gamma = float(fit.of_all[0])
    values: list[Value] = []
    gamma_deviation = float(fit.deviation("gamma"))
    camera = replace(camera, gamma=round(gamma, 5))
    values.append(Value("camera.gamma", gamma, gamma_deviation, "encoding, by the spots' flanks"))
    # Place and pose.
    away = camera.focal_length_px * panel.pitch_m * torch.exp(-fit.value("log_pitch_px"))
    values.append(
        scenes.spread("distance_m", away, away * fit.deviation("log_pitch_px"), "by the image of a pitch")
    )
    for name, middle in (("x", camera.width_px / 2), ("y", camera.height_px / 2)):
        place = (fit.value(f"{name}_px") - middle) * away / camera.focal_length_px
        off = fit.deviation(f"{name}_px") * away / camera.focal_length_px
        values.append(scenes.spread(f"offset_{name}_m", place, off, "by the panel's place in the picture"))
    unknown.append(
        "distance, focal length and the panel's pitch: only their ratio is seen; camera.focal_length_mm and "
        "panel.led_diameter_m and led_gap_m are taken from the configuration"
    )
    if named["pose"].asked:
        for name in ("yaw", "pitch", "roll"):
            degrees, off = torch.rad2deg(fit.value(name)), torch.rad2deg(fit.deviation(name))
            values.append(scenes.spread(f"effects.pose.{name}_deg", degrees, off, ""))
        if float(apart.median()) < 9:
            unknown.append("the signs of yaw and pitch: from so far away the panel turned the other way looks alike")
    # Light.
    compressed, sure = statistics.compression(around.greys)
    is_coded = sure > 12
    if is_coded:
        trials.named.append(
            Named("jpeg", True, "coefficients on multiples of their steps (z)", sure, 12.0, "pictures are coded")
        )
        values.append(Value("effects.jpeg.quality", compressed, 1.0, "by the steps of the coefficients"))
    else:
        trials.named.append(Named("jpeg", False, "coefficients on multiples of their steps (z)", sure, 12.0))
    level = fit.value("background")
    values.append(scenes.spread("background_grey", level, fit.deviation("background"), "as seen", 1.0))
    ratio = scenes.linear(fit, "off") / scenes.linear(fit, "background")
    off_sure = gamma * (fit.deviation("off") / fit.value("off") + fit.deviation("background") / level)
    shares = panel.led_reflectance / panel.background_reflectance
    middle, error = float(ratio.median()), float((ratio * off_sure).median()) / math.sqrt(len(ratio))
    apart_by = ((shares - middle) / max(error, 1e-6)) ** 2 if 1 < middle < shares else 0.0
    veiled = apart_by > SCATTER_LIKELIHOOD
    counted = curve is not None and curve.noise.slope > 0 and not is_coded
    lux = ambient_lx
    if lux is None and counted:
        lux = scenes.illuminance(fit, camera, panel, efficiency, veiled=veiled)
        unknown.append(
            "illuminance and quantum efficiency: only their product is seen, in the photons; "
            "calibrate.quantum_efficiency is taken from the configuration (or give calibrate.ambient_lx)"
        )
    elif lux is None:
        lux = scenes.UNKNOWN_LX
        unknown.append(
            f"the illuminance: auto-exposure takes it away; {lux:g} lx is put in its place, and luminances are "
            "relative to it (or give calibrate.ambient_lx)"
        )
    seen = scenes.lighting(fit, camera, panel, lux, veiled=veiled)
    if counted and ambient_lx is not None:
        efficiency *= scenes.illuminance(fit, camera, panel, efficiency, veiled=veiled) / ambient_lx
    assert curve is not None or not counted
    lux_off = curve.deviation[0] / curve.noise.slope * lux if counted and curve and ambient_lx is None else math.nan
    values.append(Value("ambient_lx", lux, lux_off, "by the photons" if counted and ambient_lx is None else ""))
    led = (scenes.linear(fit, "on") - scenes.linear(fit, "off")) / scenes.linear(fit, "background")
    led = led * seen.background_cd_m2
    led_off = led * gamma * fit.deviation("on") / fit.value("on").clamp(min=1)
    values.append(scenes.spread("led_luminance_cd_m2", led, led_off, "relative to ambient_lx", 0.0))
    if veiled:
        explains = "Off LEDs and background are more alike than their reflectances are"
        wide = seen.veil_cd_m2 * error * (1 / (shares - middle) + 1 / (middle - 1))
        trials.named.append(Named("veiling_glare", True, "likelihood ratio", apart_by, SCATTER_LIKELIHOOD, explains))
        values.append(Value("effects.veiling_glare.luminance_cd_m2", seen.veil_cd_m2, wide, "over all"))
        unknown.append(
            "fog or glare: both lay a veil over the picture, and it is written as veiling_glare; "
            "for fog name airlight and attenuation in its stead"
        )
    else:
        trials.named.append(Named("veiling_glare", False, "likelihood ratio", apart_by, SCATTER_LIKELIHOOD))
    if seen.reflectance is not None and abs(seen.reflectance - panel.led_reflectance) > 0.02 and not veiled:
        panel = replace(panel, led_reflectance=round(seen.reflectance, 4))
    if named["panel.board_reflectance"].asked:
        share = scenes.linear(fit, "board") / scenes.linear(fit, "background")
        board = float(share.median()) * panel.background_reflectance
        panel = replace(panel, board_reflectance=round(min(max(board, 0.0), 1.0), 4))
    unknown.append("the air: what attenuation takes from the LEDs is in led_luminance_cd_m2")
    values += lens_values(fit, camera, named, fall, trials)
    if scatter[0] and named["led_scatter"].asked:
        key = "effects.led_scatter.coefficient_of_variation"
        values.append(Value(key, min(scatter[0], 2.0), scatter[1], "over the LEDs of this panel"))
    noise_values(study, around, camera, efficiency, trials, values, unknown, is_coded)
    shine(around, camera, away, seen, fit, trials, values, unknown)
    for effect in ("saturation", "quantization"):
        trials.named.append(Named(effect, True, "8-bit pictures", 0.0, 0.0))
    values.append(Value("effects.quantization.bits", 8, math.nan, ""))
    if fit.scale > 3:
        doubts.append(
            f"residuals are {math.sqrt(fit.scale):.1f} times what noise and rounding explain: see the picture of them"
        )
    kept = [one for one in trials.named if not one.effect.startswith("panel.")]
    scene = Calibrated(tuple(v for v in values if v.key != "camera.gamma"), tuple(kept), camera, panel)
    return replace(study, scene=replace(scene, unknown=tuple(unknown), doubts=tuple(doubts)))


def lens_values(
    fit: Fit, camera: Camera, named: dict[str, Named], fall: statistics.Falloff, trials: Trials
) -> list[Value]:
    """Describe blur, motion, distortion and vignetting."""
    values = []
    moments = torch.tensor([[fit.of_all[1], fit.of_all[3]], [fit.of_all[3], fit.of_all[2]]])
    small, large = torch.linalg.eigvalsh(moments).tolist()
    moved = named["motion_blur"].asked
    blur = math.sqrt(max(small if moved else float(fit.of_all[1]), 0.0))
    deviation = float(fit.deviation("blur_xx" if moved else "blur")) / (2 * max(blur, 1e-3))
    asked = blur > BLIND_BLUR_PX
    trials.named.append(
        Named("blooming", asked, "standard deviation (px)", blur, BLIND_BLUR_PX, "light spreads over neighbours")
    )
    if asked:
        note = "a Gaussian's; defocus, diffraction and blooming look alike"
        values.append(Value("effects.blooming.sigma_px", min(blur, 32.0), deviation, note))
    if moved:
        length = math.sqrt(12 * max(large - small, 0.0))
        _, axes = torch.linalg.eigh(moments)
        away = camera.focal_length_px * torch.exp(-fit.value("log_pitch_px")).median()
        del away
        across, down = (axes[:, 1] * length).tolist()
        values += [
            Value("effects.motion_blur.velocity_x_m_s", across, math.nan, "px"),
            Value("effects.motion_blur.velocity_y_m_s", down, math.nan, "px"),
        ]
    if named["lens_distortion"].asked:
        values.append(Value("effects.lens_distortion.k1", float(fit.of_all[4]), float(fit.deviation("k1")), ""))
    asked = fall.natural_gain > 0
    trials.named.append(
        Named("vignetting", asked, "BIC of the background's blocks", fall.natural_gain, 0.0, "darker towards the corners")
    )
    if asked:
        barrel = fall.barrel_gain > 0 and 0 < fall.corner_loss < 1
        loss = fall.corner_loss if barrel else 0.0
        values.append(
            Value("effects.vignetting.corner_loss", loss, fall.deviation if barrel else math.nan, "beside cos^4")
        )
    return values


def noise_values(
    study: Study,
    around: statistics.Surround,
    camera: Camera,
    efficiency: float,
    trials: Trials,
    values: list[Value],
    unknown: list[str],
    is_coded: bool,
) -> None:
    """Describe the sensor's noise in electrons."""
    fit, curve = study.fit, study.curve
    if curve is None:
        unknown.append(f"noise: {NOISE_FREE}; the scene has none")
        return
    if is_coded:
        unknown.append("the sensor's noise: coding takes most of it away; the scene has none")
        return
    gains = curve.gains
    criterion = "log-likelihood of residuals' variances, BIC"
    shot, read = curve.noise.slope > 0, curve.noise.floor > 0
    trials.named += [
        Named("shot_noise", shot, criterion, gains[0], 0.0, "variance grows with light"),
        Named("read_noise", read, criterion, gains[1], 0.0, "variance in the dark"),
    ]
    pattern = statistics.patterns(around)
    x, gamma = float(scenes.linear(fit, "background").median()), fit.of_all[0]
    steep = statistics.middle_slope(x, gamma, curve.noise)
    if shot:
        electrons = 1 / curve.noise.slope
    else:
        exposure = 10 * x / 1.0
        del exposure
        electrons = math.nan
    fixed = pattern.fixed_gain > SCATTER_LIKELIHOOD and shot
    rows = pattern.row_gain > SCATTER_LIKELIHOOD and shot
    share = pattern.fixed / steep / x
    kind = "prnu" if share < 0.05 else "dsnu"
    ratio = "likelihood ratio of variances in the background"
    other = "dsnu" if kind == "prnu" else "prnu"
    trials.named += [
        Named(kind, fixed, ratio, pattern.fixed_gain, SCATTER_LIKELIHOOD, "pixels differ, always alike"),
        Named(other, False, "not told apart", 0.0, SCATTER_LIKELIHOOD),
        Named("row_noise", rows, ratio, pattern.row_gain, SCATTER_LIKELIHOOD, "rows differ, anew in each frame"),
    ]
    if not shot:
        if read:
            unknown.append("noise that does not grow with light: without photons to count it has no unit, and is left out")
            trials.named = [replace(one, asked=False) if one.effect == "read_noise" else one for one in trials.named]
        return
    for effect in ("photoelectrons", "gain"):
        trials.named.append(Named(effect, True, "needed by the noise", 0.0, 0.0))
    values.append(Value("effects.photoelectrons.quantum_efficiency", min(1.0, efficiency), math.nan, "as configured"))
    slope_error = curve.deviation[0] / curve.noise.slope
    if read:
        sigma = math.sqrt(curve.noise.floor) * electrons
        relative = math.hypot(curve.deviation[1] / (2 * curve.noise.floor), slope_error)
        values.append(Value("effects.read_noise.electrons", sigma, sigma * relative, "in the dark"))
    if fixed:
        relative = pattern.fixed_deviation / pattern.fixed
        if kind == "prnu":
            values.append(Value("effects.prnu.share", share, share * relative, "of each pixel"))
        else:
            amount = share * x * electrons
            values.append(
                Value("effects.dsnu.electrons", amount, amount * math.hypot(relative, slope_error), "of each pixel")
            )
        unknown.append(
            "whether pixels differ in response (prnu) or in offset (dsnu): the background has one level; less than 5 % "
            "of the light is taken for response"
        )
    if rows:
        amount = pattern.row / steep * electrons
        relative = math.hypot(pattern.row_deviation / pattern.row, slope_error)
        values.append(Value("effects.row_noise.electrons", amount, amount * relative, "of each row"))


def shine(
    around: statistics.Surround,
    camera: Camera,
    away: Tensor,
    seen: scenes.Lighting,
    fit: Fit,
    trials: Trials,
    values: list[Value],
    unknown: list[str],
) -> None:
    """Describe lamps beside the panel."""
    count, wide, grey = statistics.lamps(around)
    asked = count >= 0.5
    trials.named.append(Named("lamps", asked, "round bright things a frame", count, 0.5, "lamps beside the panel"))
    if asked:
        scale = camera.focal_length_px / float(away.median())
        light = statistics.light_of(grey, float(fit.of_all[0])) / float(scenes.linear(fit, "background").median())
        values += [
            Value("effects.lamps.count", max(1, round(count)), math.nan, "a frame"),
            Value("effects.lamps.luminance_cd_m2", light * seen.background_cd_m2, math.nan, "as seen"),
            Value("effects.lamps.diameter_m", min(10.0, wide / scale), math.nan, "at the panel's distance"),
        ]
        if grey >= 254:
            unknown.append("the lamps' luminance: they are white, and may be brighter than the scene says")


__all__ = ["LEVELS", "PLACED", "Photoelectrons", "Study", "calibrate"]
