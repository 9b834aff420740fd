"""What was fitted in the simulator's words, how sure it is, and what the recording does not tell."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import resources

import numpy as np
import torch
import yaml
from torch import Tensor

from vocc_torch.simulation.photometry import MIDDLE_GREY
from vocc_torch.studies.calibrate import CalibrateConfig
from vocc_torch.studies.calibrate import scene as scenes
from vocc_torch.studies.calibrate.fit import SURE, RecordingFit
from vocc_torch.studies.calibrate.leds import Scatter
from vocc_torch.studies.calibrate.model import WHITE
from vocc_torch.studies.calibrate.pace import Pace
from vocc_torch.studies.calibrate.scene import Calibrated, Named, Value
from vocc_torch.studies.calibrate.surround import (
    Array,
    Excess,
    Falloff,
    Surround,
    lamps,
    patterns,
    quantisation_table,
)
from vocc_torch.studies.calibrate.transfer import Curve, pattern, transfer

LIKELIHOOD = 10.8
"""Twice the log-likelihood ratio that one value reaches by chance once in a thousand times (chi-squared)."""
CODED = 12.0
"""Standard deviations from which coefficients lie on multiples of their steps."""
CODED_GAIN = 30.0
"""Gain that an effect needs in coded pictures."""
BLIND_BLUR_PX = 0.15
"""A narrower blur is none."""
WORDS = yaml.safe_load((resources.files(__package__) / "sentences.yaml").read_text())
DOUBTS = ("white", "bound", "residuals", "photons")
"""Sentences of what the model does not explain; the others say what the recording does not tell."""
BY_GAMMA = {"camera.gamma", "led_luminance_cd_m2", "ambient_lx", "effects.blooming.sigma_px"}
BY_GAMMA |= {"effects.veiling_glare.luminance_cd_m2", "effects.vignetting.corner_loss"}
"""Values that have no interval where gamma is not told."""
SURE_SIGMAS = 3.0
"""Standard deviations from which motion, distortion and the rows' times are there."""
WIDE_GAMMA = 0.3
"""Half of gamma's 95 % interval from which on the page says that it is hardly told."""
RESPONSE = 0.05
"""Sensors whose pixels differ by a larger share of the background's light differ in their offsets."""


@dataclass(kw_only=True)
class Findings(Calibrated):
    """A scene while it is found.

    Args:
        config: what the recording cannot tell.
        around: the picture around the panel.
        fall: how light falls off there.
        coded: the likeliest JPEG quality, and how sure it is.
        loose: whether the recording tells gamma and blur no better than coding or their bounds let it.
        bound: where gamma ran to, if that is no camera's.
        pace: the times of symbols and rows.
    """

    config: CalibrateConfig
    around: Surround
    fall: Falloff
    coded: tuple[int, float] = (0, 0.0)
    loose: bool = False
    bound: float | None = None
    pace: Pace | None = None

    def tried(self, effect: str, gain: float, needed: float = 0.0) -> bool:
        """Note an effect, and say whether the recording asks for it."""
        criterion, explains = WORDS["effects"][effect]
        self.effects.append(Named(effect, gain > needed, criterion, gain, needed, explains))
        return gain > needed

    def judge(
        self, effect: str, simple: RecordingFit, rich: RecordingFit, sigmas: float = math.inf
    ) -> RecordingFit:
        """Keep the richer of two fits where Schwarz's criterion favours it, in units of its own noise.

        A new value of so few standard deviations that it may be none gains nothing.
        """
        gain = (simple.misfit - rich.misfit) / rich.scale * (sigmas > SURE_SIGMAS)
        gain -= (rich.values - simple.values) * math.log(rich.pixels)
        # What coding leaves hangs together over its blocks.
        return rich if self.tried(effect, gain, CODED_GAIN * self.is_coded) else simple

    @property
    def is_coded(self) -> bool:
        """Whether pictures are coded."""
        return self.coded[1] > CODED

    def derived(
        self, fit: RecordingFit, of: Callable[[Mapping[str, Tensor], Tensor], Tensor]
    ) -> scenes.Derived:
        """Derive a value of every frame; coded ones err alike, as the panel lies in the blocks' grid."""
        made, own, common = fit.derived(of)
        return made, own, math.hypot(common, float(own.median()) * self.is_coded)

    def tell(self, key: str, given: float, deviation: float = math.nan, note: str = "") -> None:
        """Note a value."""
        self.note(Value(key, given, deviation, note or WORDS["values"].get(key, "")))

    def over(self, key: str, derived: scenes.Derived, least: float = -math.inf) -> None:
        """Note a value of every frame."""
        self.note(scenes.spread(key, derived, WORDS["values"][key], least))

    def note(self, value: Value) -> None:
        """Note a value; without an interval where it hangs on a gamma that the recording does not tell."""
        if value.key in BY_GAMMA and self.loose:
            note = "; ".join(part for part in (value.note, "no interval: gamma is not told") if part)
            value = replace(value, deviation=math.nan, note=note)
        self.values.append(value)

    def say(self, word: str, **given: object) -> None:
        """Note a sentence of ``sentences.yaml``: what is not told, or not explained."""
        (self.doubts if word in DOUBTS else self.unknown).append(WORDS["sentences"][word].format(**given))

    def asked(self, effect: str) -> bool:
        """Say whether the recording asks for an effect."""
        return any(one.effect == effect and one.asked for one in self.effects)


def behind(fit: RecordingFit) -> float:
    """Give the background's light."""
    return float(scenes.linear(fit, "background").median())


def level(name: str, own: Mapping[str, Tensor], of_all: Tensor) -> Tensor:
    """Give a level as light, (B,)."""
    return (own[name] / MIDDLE_GREY) ** of_all[:, 0]


def describe(
    fit: RecordingFit, curve: Curve | None, scatter: Scatter, apart: Tensor, found: Findings
) -> None:
    """Make a scene of a fit.

    Args:
        fit: the last.
        curve: the photon transfer curve, or None for too few frames.
        scatter: of the LEDs.
        apart: (B,) by how much frames tell a pose from its mirror image.
        found: so far.
    """
    in_time(found)
    found.say("colours")
    gamma, quality = float(fit.of_all[0]), found.coded[0]
    coded = found.tried("jpeg", found.coded[1], CODED)
    found.loose = coded or found.bound is not None
    if coded:
        found.say("coded")
    if found.bound is not None:
        found.say("bound", gamma=found.bound, own=gamma)
    else:
        found.camera = replace(found.camera, gamma=round(gamma, 5))
        found.tell("camera.gamma", gamma, fit.deviation("gamma"))
        if SURE * fit.deviation("gamma") > WIDE_GAMMA:
            found.say("hardly")
    where(fit, apart, found)
    if coded:
        found.tell("effects.jpeg.quality", quality, 1.0)
    counts = curve is not None and curve.noise.slope > 0 and not coded
    efficiency = how_bright(fit, curve if counts else None, found)
    through_the_lens(fit, found)
    if coded:
        found.say("scatter")
    elif found.tried("led_scatter", scatter.gain, LIKELIHOOD):
        key = "effects.led_scatter.coefficient_of_variation"
        found.tell(key, min(scatter.share, 2.0), scatter.deviation)
    if curve is None or coded:
        why = "coding takes it away" if coded else "rounding hides it, or fewer than 4 frames show none"
        found.say("noise", why=why)
    else:
        how_noisy(fit, curve, found, efficiency)
    beside(fit, found)
    found.effects += [Named(one, True, "always: 8-bit pictures") for one in ("saturation", "quantization")]
    found.tell("effects.quantization.bits", 8)
    if fit.scale > 2:
        found.say("residuals", times=math.sqrt(fit.scale))
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


def where(fit: RecordingFit, apart: Tensor, found: Findings) -> None:
    """Describe place and pose."""
    whole = found.camera.focal_length_px * found.panel.pitch_m
    found.over("distance_m", found.derived(fit, lambda own, _: whole * torch.exp(-own["log_pitch_px"])))
    for name, side in (("x", found.camera.width_px), ("y", found.camera.height_px)):

        def offset(own: Mapping[str, Tensor], _: Tensor, name: str = name, side: int = side) -> Tensor:
            return (own[f"{name}_px"] - side / 2) * found.panel.pitch_m * torch.exp(-own["log_pitch_px"])

        found.over(f"offset_{name}_m", found.derived(fit, offset))
    found.say("ratio")
    if not found.asked("pose"):
        return
    for name in ("yaw", "pitch", "roll"):
        degrees = found.derived(fit, lambda own, _, name=name: torch.rad2deg(own[name]))  # type: ignore[misc]
        found.over(f"effects.pose.{name}_deg", degrees)
    if float(apart.median()) < 9:
        found.say("signs")


def how_bright(fit: RecordingFit, curve: Curve | None, found: Findings) -> float:
    """Describe the light, and give the quantum efficiency that fits to it."""
    camera, panel, ambient_lx = found.camera, found.panel, found.config.ambient_lx
    efficiency = found.config.quantum_efficiency
    found.over("background_grey", found.derived(fit, lambda own, _: own["background"]), 1.0)
    grey = found.values.pop()
    if found.fall.natural_gain > 0 and found.fall.barrel_gain > 0:  # the level is that of the sensor's middle
        sides = {"x_px": camera.width_px, "y_px": camera.height_px}
        out = math.hypot(*(2 * float(fit.value(one).median()) - side for one, side in sides.items()))
        out /= math.hypot(*sides.values())
        shade = out * found.fall.deviation / (1 - out * found.fall.corner_loss) / float(fit.of_all[0])
        grey = replace(grey, deviation=math.hypot(grey.deviation, shade * grey.middle))
    if found.is_coded:  # blocks that are alike have their means rounded alike
        step = float(quantisation_table(found.coded[0])[0, 0]) / 8
        grey = replace(grey, deviation=math.hypot(grey.deviation, step / math.sqrt(12)))
    found.values.append(grey)
    ratio = found.derived(fit, lambda own, all_: level("off", own, all_) / level("background", own, all_))
    middle = float(ratio[0].median())
    error = math.hypot(float(ratio[1].median()) / math.sqrt(len(ratio[0])), ratio[2])
    shares = panel.led_reflectance / panel.background_reflectance
    off = ((shares - middle) / max(error, 1e-9)) ** 2 if 1 < middle < shares and not found.loose else 0.0
    veiled = found.tried("veiling_glare", off, LIKELIHOOD)
    over = scenes.veil(fit, panel) if veiled else 0.0
    seen = panel.background_reflectance / math.pi + over  # luminance of the background at 1 lx
    lux, lux_error, note = ambient_lx or scenes.UNKNOWN_LX, math.nan, "as configured" if ambient_lx else ""
    if curve is not None:
        counted = scenes.illuminance(electrons(fit, curve, Excess())[0], camera, seen, efficiency)
        if ambient_lx is None:
            shaky = 2 * grey.deviation / grey.middle, by_gamma(fit, curve, Excess())[0]
            lux_error = counted * math.hypot(curve.slope_error, *shaky)
            lux, note = counted, "by the photons counted"
            found.say("product")
        else:
            efficiency *= counted / ambient_lx
    elif ambient_lx is None:
        found.say("illuminance", lux=lux)
    found.tell("ambient_lx", lux, lux_error, note)

    def own_light(own: Mapping[str, Tensor], all_: Tensor) -> Tensor:
        on, off, ground = (level(name, own, all_) for name in ("on", "off", "background"))
        return (on - off) / ground * (seen * lux)

    found.over("led_luminance_cd_m2", found.derived(fit, own_light), 0.0)
    found.say("air")
    if float(fit.value("on").median()) >= WHITE:
        found.say("white")
    if veiled:
        slope = 1 / (shares - middle) + 1 / (middle - 1)
        found.tell("effects.veiling_glare.luminance_cd_m2", over * lux, over * lux * error * slope)
        found.say("veil")
    elif abs(middle - shares) > 3 * error:
        own = min(1.0, middle * panel.background_reflectance)
        found.panel = replace(panel, led_reflectance=round(own, 4))
        found.say("reflectance")
    if found.asked("panel.board_reflectance"):
        share = float((scenes.linear(fit, "board") / scenes.linear(fit, "background")).median())
        board = min(max(share * panel.background_reflectance, 0.0), 1.0)
        found.panel = replace(found.panel, board_reflectance=round(board, 4))
    return efficiency


def through_the_lens(fit: RecordingFit, found: Findings) -> None:
    """Describe blur, motion, distortion and vignetting."""
    camera, fall = found.camera, found.fall
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
        speed = length * float(away) / camera.exposure_time_s
        error = 6 * math.hypot(fit.deviation("blur_xx"), fit.deviation("blur_yy")) / length**2 * speed
        key = f"effects.motion_blur.velocity_{'xy'[long]}_m_s"
        found.tell(key, min(200.0, speed), error)
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


def how_noisy(fit: RecordingFit, curve: Curve, found: Findings, efficiency: float) -> None:
    """Describe the sensor's noise, in electrons, which shot noise counts."""
    if not found.tried("shot_noise", curve.gains[0]):
        if curve.gains[1] > 0:
            found.say("unit")
        return
    read = found.tried("read_noise", curve.gains[1])
    found.effects += [Named(one, True, "needed by the noise") for one in ("photoelectrons", "gain")]
    found.tell("effects.photoelectrons.quantum_efficiency", min(1.0, efficiency))
    if efficiency > 1:
        found.say("photons", efficiency=efficiency)
    (fixed, row), x = patterns(found.around), behind(fit)
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
        relative, name = fixed.deviation / fixed.value, "share"
        if kind == "dsnu":
            relative, name = math.hypot(relative, slope_error, shaky[2]), "electrons"
        given = share if kind == "prnu" else float(counted[2])
        found.tell(f"effects.{kind}.{name}", given, given * relative)
        found.say("pattern", kind=kind, share=share)
    found.effects.append(Named(other, False, f"not told from {kind}", 0.0, LIKELIHOOD))
    if found.tried("row_noise", row.gain, LIKELIHOOD):
        amount = pattern(row.value, x, fit.of_all[0], curve) / curve.noise.slope
        relative = math.hypot(row.deviation / row.value, slope_error)
        found.tell("effects.row_noise.electrons", amount, amount * relative)


def beside(fit: RecordingFit, found: Findings) -> None:
    """Describe lamps beside the panel."""
    count, wide, grey = lamps(found.around)
    if not found.tried("lamps", count, 0.5):
        return
    panel, gamma = found.panel, float(fit.of_all[0])
    across = wide * panel.pitch_m / float(torch.exp(fit.value("log_pitch_px")).median())
    lux = next(one for one in found.values if one.key == "ambient_lx").middle
    light = (grey / MIDDLE_GREY) ** gamma / behind(fit)
    light *= lux * panel.background_reflectance / math.pi
    found.tell("effects.lamps.count", max(1, round(count)))
    found.tell("effects.lamps.luminance_cd_m2", light)
    found.tell("effects.lamps.diameter_m", min(10.0, across))
    if grey >= 254:
        found.say("lamps")
