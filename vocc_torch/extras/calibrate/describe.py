"""What was fitted in the simulator's words, how sure it is, and what the recording does not tell."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from vocc_torch.extras.calibrate import model, surround
from vocc_torch.extras.calibrate.fit import SURE, RecordingFit
from vocc_torch.extras.calibrate.leds import Scatter
from vocc_torch.extras.calibrate.scene import CODED, SURE_SIGMAS, Findings, Named, Value
from vocc_torch.extras.calibrate.surround import Array, Excess
from vocc_torch.extras.calibrate.transfer import Curve, pattern, transfer
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.simulation.effects.sensor import Photoelectrons
from vocc_torch.simulation.photometry import MIDDLE_GREY

LIKELIHOOD = 10.8
"""Twice the log-likelihood ratio that one value reaches by chance once in a thousand times (chi-squared)."""
BLIND_BLUR_PX = 0.15
"""A narrower blur is none."""
WIDE_GAMMA = 0.3
"""Half of gamma's 95 % interval from which on the page says that it is hardly told."""
RESPONSE = 0.05
"""Sensors whose pixels differ by a larger share of the background's light differ in their offsets."""
UNKNOWN_LX = 8000.0
"""Illuminance where nothing tells it: an overcast day. Only ratios of light matter then."""


def veil(fit: RecordingFit, panel: LedPanel) -> float:
    """Give the luminance of a veil that makes Off LEDs and background as alike as they are, at 1 lx.

    Both reflect the same daylight: where their ratio is nearer to 1 than that of their reflectances, a veil
    lies over both.
    """
    ratio = float(fit.level("off").median() / fit.level("background").median())
    share = panel.background_reflectance
    return max(0.0, (panel.led_reflectance - ratio * share) / (ratio - 1) / math.pi) if ratio > 1 else 0.0


def illuminance(electrons: float, camera: Camera, seen_cd_m2: float, efficiency: float) -> float:
    """Say which illuminance gives a pixel of the background so many electrons, lx.

    Args:
        electrons: that the photon transfer curve counts.
        camera: whose picture it is.
        seen_cd_m2: luminance that the background has at 1 lx, with any veil.
        efficiency: the quantum efficiency.
    """
    exposure = 10 * seen_cd_m2 * camera.exposure_time_s / (camera.calibration_constant * camera.f_number**2)
    return electrons / (Photoelectrons(efficiency).electrons_per_lx_s(camera) * exposure)


def behind(fit: RecordingFit) -> float:
    """Give the background's light."""
    return float(fit.level("background").median())


def describe(scatter: Scatter, apart: Tensor, found: Findings) -> None:
    """Make a scene of a fit.

    Args:
        scatter: of the LEDs.
        apart: (B,) by how much frames tell a pose from its mirror image.
        found: so far, with the last fit.
    """
    fit, curve = found.fit, found.curve
    in_time(found)
    found.say("colours")
    gamma = float(fit.of_all[0])
    coded = found.tried("jpeg", found.coded[1], CODED)
    found.loose = coded or found.bound is not None
    found.say("coded", when=coded)
    if found.bound is not None:
        found.say("bound", gamma=found.bound, own=gamma)
    else:
        found.camera = replace(found.camera, gamma=round(gamma, 5))
        found.tell("camera.gamma", gamma, fit.deviation("gamma"))
        found.say("hardly", when=SURE * fit.deviation("gamma") > WIDE_GAMMA)
    where(apart, found)
    if coded:
        found.tell("effects.jpeg.quality", found.coded[0], 1.0)
    counts = curve is not None and curve.noise.slope > 0 and not coded
    efficiency = how_bright(curve if counts else None, found)
    through_the_lens(found)
    if coded:
        found.say("scatter")
    elif found.tried("led_scatter", scatter.gain, LIKELIHOOD):
        key = "effects.led_scatter.coefficient_of_variation"
        found.tell(key, min(scatter.share, 2.0), scatter.deviation)
    if curve is None or coded:
        why = "coding takes it away" if coded else "rounding hides it, or fewer than 4 frames show none"
        found.say("noise", why=why)
    else:
        how_noisy(curve, found, efficiency)
    beside(found)
    found.effects += [Named(one, True, "always: 8-bit pictures") for one in ("saturation", "quantization")]
    found.tell("effects.quantization.bits", 8)
    found.say("residuals", when=fit.scale > 2, times=math.sqrt(fit.scale))
    found.effects = [one for one in found.effects if "." not in one.effect]


def in_time(found: Findings) -> None:
    """Describe the symbols' and the rows' times."""
    told = found.pace
    if told is None:
        found.say("rate")
        return
    sure = told.readout_s / told.readout_error_s if told.symbol_s >= found.camera.exposure_time_s else 0.0
    if found.tried("rolling_shutter", sure, SURE_SIGMAS):
        found.tell("effects.rolling_shutter.readout_s", told.readout_s, told.readout_error_s)
        found.tell("effects.rolling_shutter.symbol_s", told.symbol_s, told.symbol_error_s)
    else:
        found.say("rolling", symbol=told.symbol_s, error=SURE * told.symbol_error_s)


def where(apart: Tensor, found: Findings) -> None:
    """Describe place and pose."""
    camera, pitch_m = found.camera, found.panel.pitch_m
    whole = camera.focal_length_px * pitch_m
    found.over("distance_m", lambda own, _: whole * torch.exp(-own["log_pitch_px"]))
    for name, side in (("x", camera.width_px), ("y", camera.height_px)):

        def offset(own: Mapping[str, Tensor], _: Tensor, name: str = name, side: int = side) -> Tensor:
            return (own[f"{name}_px"] - side / 2) * pitch_m * torch.exp(-own["log_pitch_px"])

        found.over(f"offset_{name}_m", offset)
    found.say("ratio")
    if not found.asked("pose"):
        return
    for name in ("yaw", "pitch", "roll"):
        key = f"effects.pose.{name}_deg"
        found.over(key, lambda own, _, name=name: torch.rad2deg(own[name]))  # type: ignore[misc]
    found.say("signs", when=float(apart.median()) < 9)


def how_bright(curve: Curve | None, found: Findings) -> float:
    """Describe the light, and give the quantum efficiency that fits to it."""
    fit, camera, panel = found.fit, found.camera, found.panel
    ambient_lx, efficiency = found.config.ambient_lx, found.config.quantum_efficiency
    found.over("background_grey", lambda own, _: own["background"], 1.0)
    grey = found.values.pop()
    if found.fall.natural_gain > 0 and found.fall.barrel_gain > 0:  # the level is that of the sensor's middle
        sides = {"x_px": camera.width_px, "y_px": camera.height_px}
        out = math.hypot(*(2 * float(fit.value(one).median()) - side for one, side in sides.items()))
        out /= math.hypot(*sides.values())
        shade = out * found.fall.deviation / (1 - out * found.fall.corner_loss) / float(fit.of_all[0])
        grey = grey._replace(deviation=math.hypot(grey.deviation, shade * grey.middle))
    if found.is_coded:  # blocks that are alike have their means rounded alike
        step = float(surround.quantisation_table(found.coded[0])[0, 0]) / 8
        grey = grey._replace(deviation=math.hypot(grey.deviation, step / math.sqrt(12)))
    found.values.append(grey)
    ratio, own_error, common = found.derived(
        lambda own, all_: model.linear(own["off"], all_[:, 0]) / model.linear(own["background"], all_[:, 0])
    )
    middle = float(ratio.median())
    error = math.hypot(float(own_error.median()) / math.sqrt(len(ratio)), common)
    shares = panel.led_reflectance / panel.background_reflectance
    off = ((shares - middle) / max(error, 1e-9)) ** 2 if 1 < middle < shares and not found.loose else 0.0
    veiled = found.tried("veiling_glare", off, LIKELIHOOD)
    over = veil(fit, panel) if veiled else 0.0
    seen = panel.background_reflectance / math.pi + over  # luminance of the background at 1 lx
    lux, lux_error, note = ambient_lx or UNKNOWN_LX, math.nan, "as configured" if ambient_lx else ""
    if curve is not None:
        counted = illuminance(electrons(fit, curve, Excess())[0], camera, seen, efficiency)
        if ambient_lx is None:
            shaky = 2 * grey.deviation / grey.middle, by_gamma(fit, curve, Excess())[0]
            lux_error = counted * math.hypot(curve.slope_error, *shaky)
            lux, note = counted, "by the photons counted"
            found.say("product")
        else:
            efficiency *= counted / ambient_lx
    elif ambient_lx is None:
        found.say("illuminance", lux=lux)
    found.note(Value("ambient_lx", lux, lux_error, note))

    def own_light(own: Mapping[str, Tensor], all_: Tensor) -> Tensor:
        on, off, ground = (model.linear(own[name], all_[:, 0]) for name in ("on", "off", "background"))
        return (on - off) / ground * (seen * lux)

    found.over("led_luminance_cd_m2", own_light, 0.0)
    found.say("air")
    found.say("white", when=float(fit.value("on").median()) >= model.WHITE)
    if veiled:
        slope = 1 / (shares - middle) + 1 / (middle - 1)
        found.tell("effects.veiling_glare.luminance_cd_m2", over * lux, over * lux * error * slope)
        found.say("veil")
    elif abs(middle - shares) > 3 * error:
        own = min(1.0, middle * panel.background_reflectance)
        found.panel = replace(panel, led_reflectance=round(own, 4))
        found.say("reflectance")
    board = None
    if found.asked("panel.board_reflectance"):
        share = float((fit.level("board") / fit.level("background")).median())
        board = round(min(max(share * panel.background_reflectance, 0.0), 1.0), 4)
    found.panel = replace(found.panel, board_reflectance=board)
    return efficiency


def through_the_lens(found: Findings) -> None:
    """Describe blur, motion, distortion and vignetting."""
    fit, fall = found.fit, found.fall
    moments, moved = fit.of_all[1:3], found.asked("motion_blur")
    long = int(moments.argmax())
    blur, narrow = math.sqrt(float(moments.min())), ("blur_yy", "blur_xx")[long] if moved else "blur"
    if found.tried("blooming", blur, BLIND_BLUR_PX):
        error = fit.deviation(narrow) / (2 * max(blur, 1e-3))
        found.tell("effects.blooming.sigma_px", min(blur, 32.0), error)
        found.say("blur")
    if moved:
        length = math.sqrt(12 * float(moments.max() - moments.min()))
        away = found.panel.pitch_m * torch.exp(-fit.value("log_pitch_px")).median()
        speed = length * float(away) / found.camera.exposure_time_s
        error = 6 * math.hypot(fit.deviation("blur_xx"), fit.deviation("blur_yy")) / length**2 * speed
        found.tell(f"effects.motion_blur.velocity_{'xy'[long]}_m_s", min(200.0, speed), error)
    if found.asked("lens_distortion"):
        found.tell("effects.lens_distortion.k1", float(fit.value("k1")), fit.deviation("k1"))
    else:
        found.say("lens")
    if found.tried("vignetting", fall.natural_gain):
        barrel = fall.barrel_gain > 0 and 0 < fall.corner_loss < 1
        loss, error = (fall.corner_loss, fall.deviation) if barrel else (0.0, math.nan)
        found.tell("effects.vignetting.corner_loss", loss, error)


def electrons(fit: RecordingFit, curve: Curve, fixed: Excess) -> Array:
    """Count the background's electrons, the noise's in the dark, and those in which pixels differ."""
    x, floor = behind(fit), curve.noise.floor
    sigma = pattern(fixed.value, x, fit.of_all[0], curve) if fixed.value else 0.0
    # Where the panel moves over the pixels, what differs from pixel to pixel is in the floor too.
    inside = sigma > RESPONSE * x and fixed.gain > LIKELIHOOD and not curve.still
    dark = math.sqrt(max(floor - sigma**2 * inside, 0.01 * floor))
    return np.array([x, dark, sigma]) / curve.noise.slope


def by_gamma(fit: RecordingFit, curve: Curve, fixed: Excess) -> Array:
    """Say by which share :func:`electrons` change as gamma does by its deviation."""
    if "gamma" not in fit.free:
        return np.zeros(3)
    bent = fit.bent(fit.deviation("gamma"))
    other = transfer(bent)
    if not other.noise.slope:
        return np.ones(3)
    both = [electrons(*one, fixed).clip(1e-9) for one in ((fit, curve), (bent, other))]
    shares: Array = np.abs(np.log(both[1] / both[0])).clip(max=1.0)
    return shares


def how_noisy(curve: Curve, found: Findings, efficiency: float) -> None:
    """Describe the sensor's noise, in electrons, which shot noise counts."""
    if not found.tried("shot_noise", curve.gains[0]):
        found.say("unit", when=curve.gains[1] > 0)
        return
    read = found.tried("read_noise", curve.gains[1])
    found.effects += [Named(one, True, "needed by the noise") for one in ("photoelectrons", "gain")]
    found.tell("effects.photoelectrons.quantum_efficiency", min(1.0, efficiency))
    found.say("photons", when=efficiency > 1, efficiency=efficiency)
    fit, (fixed, row) = found.fit, surround.patterns(found.around)
    counted, shaky, slope_error = electrons(fit, curve, fixed), by_gamma(fit, curve, fixed), curve.slope_error
    share = float(counted[2] / counted[0])
    kind, other = ("prnu", "dsnu") if share < RESPONSE else ("dsnu", "prnu")
    if read:
        unit = 1 / curve.noise.slope
        turn = np.array([-unit, unit**2 / (2 * counted[1] ** 2)])  # a floor too high: a slope too low
        relative = math.hypot(math.sqrt(max(0.0, float(turn @ curve.covariance @ turn))), shaky[1])
        found.tell("effects.read_noise.electrons", float(counted[1]), float(counted[1]) * relative)
    else:
        found.say("read", electrons=math.sqrt(curve.hidden) / curve.noise.slope)
    if found.tried(kind, fixed.gain, LIKELIHOOD):
        name, given, relative = "share", share, fixed.deviation / fixed.value
        if kind == "dsnu":
            name, given = "electrons", float(counted[2])
            relative = math.hypot(relative, slope_error, shaky[2])
        found.tell(f"effects.{kind}.{name}", given, given * relative)
        found.say("pattern", kind=kind, share=share)
    found.effects.append(Named(other, False, f"not told from {kind}", 0.0, LIKELIHOOD))
    if found.tried("row_noise", row.gain, LIKELIHOOD):
        amount = pattern(row.value, behind(fit), fit.of_all[0], curve) / curve.noise.slope
        relative = math.hypot(row.deviation / row.value, slope_error)
        found.tell("effects.row_noise.electrons", amount, amount * relative)


def beside(found: Findings) -> None:
    """Describe lamps beside the panel."""
    count, wide, grey = surround.lamps(found.around)
    if not found.tried("lamps", count, 0.5):
        return
    fit, panel, gamma = found.fit, found.panel, float(found.fit.of_all[0])
    across = wide * panel.pitch_m / float(torch.exp(fit.value("log_pitch_px")).median())
    lux = next(one for one in found.values if one.key == "ambient_lx").middle
    light = (grey / MIDDLE_GREY) ** gamma / behind(fit)
    light *= lux * panel.background_reflectance / math.pi
    found.tell("effects.lamps.count", max(1, round(count)))
    found.tell("effects.lamps.luminance_cd_m2", light)
    found.tell("effects.lamps.diameter_m", min(10.0, across))
    found.say("lamps", when=grey >= 254)
