"""What was fitted in the simulator's words, how sure it is, and what the recording does not tell."""

import math
from dataclasses import replace
from operator import itemgetter

import numpy as np

from vocc_torch.arrays import Floats
from vocc_torch.extras.calibrate.drawing import COLUMN, TURNED
from vocc_torch.extras.calibrate.fit import SURE, RecordingFit
from vocc_torch.extras.calibrate.noise import WHITE, linear
from vocc_torch.extras.calibrate.scene import CODED, Findings, Named, Value
from vocc_torch.extras.calibrate.transfer import TransferCurve, bent, transfer
from vocc_torch.hardware import Camera
from vocc_torch.simulation.effects.sensor import Photoelectrons

LIKELIHOOD = 10.8
"""Twice the log-likelihood ratio that one value reaches by chance once in a thousand times (chi-squared)."""

BLIND_BLUR_PX = 0.15
"""A narrower blur is none."""

WIDE_GAMMA = 0.3
"""Half of gamma's 95 % interval from which on the page says that it is hardly told."""

UNKNOWN_LX = 8000.0
"""Illuminance where nothing tells it: an overcast day. Only ratios of light matter then."""


def describe(apart: Floats, found: Findings) -> None:
    """Make a scene of a fit.

    Args:
        apart: (B,) by how much frames tell a pose from its mirror image.
        found: so far, with the last fit.
    """
    fit, curve = found.fit, found.curve
    found.say("rate")
    found.say("colours")
    coded = found.tried("jpeg", found.coded[1], CODED)
    found.loose = coded or found.bound is not None
    found.say("coded", when=coded)
    if found.bound is not None:
        found.say("bound", gamma=found.bound, fitted=fit.gamma)
    else:
        found.camera = replace(found.camera, gamma=round(fit.gamma, 5))
        found.tell("camera.gamma", fit.gamma, fit.deviation("gamma"))
        found.say("hardly", when=SURE * fit.deviation("gamma") > WIDE_GAMMA)
    place(apart, found)
    if coded:
        found.tell("effects.jpeg.quality", found.coded[0], 1.0)
    counts = curve is not None and curve.noise.slope > 0 and not coded
    efficiency = brightness(curve if counts else None, found)
    lens(found)
    if curve is None or coded:
        why = (
            "compression removes it"
            if coded
            else "rounding hides it, or there are fewer than 4 frames"
        )
        found.say("noise", why=why)
    else:
        sensor_noise(curve, found, efficiency)
    found.say("beside")
    always = ("saturation", "quantization")
    found.effects += [Named(name, True, "always: 8-bit pictures") for name in always]
    found.tell("effects.quantization.bits", 8)
    found.say("residuals", when=fit.scale > 2, times=math.sqrt(fit.scale))


def place(apart: Floats, found: Findings) -> None:
    """Describe place and pose."""
    drawing = found.fit.drawing
    found.over("distance_m", drawing.distance_m)
    found.over("offset_x_m", lambda table: drawing.scene(table).offset_x_m.numpy())
    found.over("offset_y_m", lambda table: drawing.scene(table).offset_y_m.numpy())
    found.say("ratio")
    if not found.asked("pose"):
        return
    for name in TURNED:
        found.over(f"effects.pose.{name}", itemgetter((slice(None), COLUMN[name])))
    found.say("signs", when=float(np.median(apart)) < 9)


def level(table: Floats, name: str) -> Floats:
    """Give a level of each frame as light, (B,)."""
    return linear(table[:, COLUMN[name]], float(table[0, COLUMN["gamma"]]))


def illuminance(
    electrons: float, camera: Camera, seen_cd_m2: float, efficiency: float
) -> float:
    """Say which illuminance gives a pixel of the background so many electrons, lx.

    Args:
        electrons: that the photon transfer curve counts.
        camera: whose picture it is.
        seen_cd_m2: luminance that the background has at 1 lx, with any veil.
        efficiency: the quantum efficiency.
    """
    exposure = (
        10
        * seen_cd_m2
        * camera.exposure_time_s
        / (camera.calibration_constant * camera.f_number**2)
    )
    return electrons / (
        Photoelectrons(efficiency).electrons_per_lx_s(camera) * exposure
    )


def veil_luminance(found: Findings) -> tuple[float, float]:
    """Tell a veil by Off LEDs and background that are more alike than their reflectances.

    Returns:
        the veil's luminance at 1 lx, 0 for none, and its standard deviation.
    """
    panel = found.panel
    ratio, own_error, common = found.derived(
        lambda table: level(table, "off") / level(table, "background")
    )
    middle = float(np.median(ratio))
    error = math.hypot(float(np.median(own_error)) / math.sqrt(len(ratio)), common)
    shares = panel.led_reflectance / panel.background_reflectance
    alike = 1 < middle < shares and not found.loose
    gain = ((shares - middle) / max(error, 1e-9)) ** 2 if alike else 0.0
    if found.tried("veiling_glare", gain, LIKELIHOOD):
        veil = panel.background_reflectance * (shares - middle) / (middle - 1) / math.pi
        return veil, veil * error * (1 / (shares - middle) + 1 / (middle - 1))
    if abs(middle - shares) > 3 * error:
        share = min(1.0, middle * panel.background_reflectance)
        found.panel = replace(panel, led_reflectance=round(share, 4))
        found.say("reflectance")
    return 0.0, 0.0


def brightness(curve: TransferCurve | None, found: Findings) -> float:
    """Describe the light, and give the quantum efficiency that fits to it."""
    fit, panel, config = found.fit, found.panel, found.config
    efficiency = config.quantum_efficiency
    background_grey = itemgetter((slice(None), COLUMN["background"]))
    found.over("background_grey", background_grey, 1.0)
    grey = found.values[-1]
    veil, veil_error = veil_luminance(found)
    # Luminance of the background at 1 lx.
    background = panel.background_reflectance / math.pi + veil
    lux, error = config.ambient_lx or UNKNOWN_LX, math.nan
    note = "as configured" if config.ambient_lx else ""
    if curve is None:
        found.say("illuminance", when=config.ambient_lx is None, lux=lux)
    else:
        counted = illuminance(
            electrons(fit, curve)[0], found.camera, background, efficiency
        )
        if config.ambient_lx is None:
            by_grey, gamma = 2 * grey.deviation / grey.middle, by_gamma(fit, curve)[0]
            error = counted * math.hypot(curve.slope_error, by_grey, gamma)
            lux, note = counted, "from the photon noise"
            found.say("product")
        else:
            efficiency *= counted / config.ambient_lx
    found.note(Value("ambient_lx", lux, error, note))

    def own_light(table: Floats) -> Floats:
        added = level(table, "on") - level(table, "off")
        return added / level(table, "background") * (background * lux)

    found.over("led_luminance_cd_m2", own_light, 0.0)
    found.say("air")
    found.say("white", when=float(np.median(fit.value("on"))) >= WHITE)
    if veil:
        found.tell(
            "effects.veiling_glare.luminance_cd_m2", veil * lux, veil_error * lux
        )
        found.say("veil")
    if fit.has_board:
        share = float(np.median(fit.level("board") / fit.level("background")))
        board = min(max(share * panel.background_reflectance, 0.0), 1.0)
        found.panel = replace(found.panel, board_reflectance=round(board, 4))
    return efficiency


def lens(found: Findings) -> None:
    """Describe blur and vignetting."""
    fit, fall = found.fit, found.fall
    blur = float(fit.value("blur_px")[0])
    if found.tried("blooming", blur, BLIND_BLUR_PX):
        found.tell(
            "effects.blooming.sigma_px", min(blur, 32.0), fit.deviation("blur_px")
        )
        found.say("blur")
    found.say("lens")
    if found.tried("vignetting", fall.gain):
        found.tell("effects.vignetting.corner_loss", fall.corner_loss, fall.deviation)


def electrons(fit: RecordingFit, curve: TransferCurve) -> Floats:
    """Count the background's electrons, and those of the noise in the dark, (2,)."""
    background = float(np.median(fit.level("background")))
    return np.array([background, math.sqrt(curve.noise.floor)]) / curve.noise.slope


def by_gamma(fit: RecordingFit, curve: TransferCurve) -> Floats:
    """Say by which share :func:`electrons` change as gamma does by its deviation."""
    if "gamma" not in fit.free:
        return np.zeros(2)
    other = bent(fit)
    other_transfer = transfer(other)
    if not other_transfer.noise.slope:
        return np.ones(2)
    here = electrons(fit, curve).clip(1e-9)
    moved = electrons(other, other_transfer).clip(1e-9)
    shares: Floats = np.abs(np.log(moved / here)).clip(max=1.0)
    return shares


def sensor_noise(curve: TransferCurve, found: Findings, efficiency: float) -> None:
    """Describe the sensor's noise, in electrons, which shot noise counts."""
    if not found.tried("shot_noise", curve.gains[0]):
        found.say("unit", when=curve.gains[1] > 0)
        return
    read = found.tried("read_noise", curve.gains[1])
    found.effects += [
        Named(name, True, "needed by the noise") for name in ("photoelectrons", "gain")
    ]
    found.tell("effects.photoelectrons.quantum_efficiency", min(1.0, efficiency))
    found.say("photons", when=efficiency > 1, efficiency=efficiency)
    counted, shaky = electrons(found.fit, curve), by_gamma(found.fit, curve)
    if read:
        unit = 1 / curve.noise.slope
        # A floor too high: a slope too low.
        turn = np.array([-unit, unit**2 / (2 * counted[1] ** 2)])
        variance = max(0.0, float(turn @ curve.covariance @ turn))
        error = float(counted[1]) * math.hypot(math.sqrt(variance), shaky[1])
        found.tell("effects.read_noise.electrons", float(counted[1]), error)
    else:
        found.say("read", electrons=math.sqrt(curve.hidden) / curve.noise.slope)
