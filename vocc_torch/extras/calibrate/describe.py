"""What was fitted in the simulator's words, how sure it is, and what the recording does not tell."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch

from vocc_torch.arrays import Floats
from vocc_torch.extras.calibrate.fit import SURE
from vocc_torch.extras.calibrate.model import TURNED, RecordingFit, by_name
from vocc_torch.extras.calibrate.noise import WHITE
from vocc_torch.extras.calibrate.scene import Findings
from vocc_torch.extras.calibrate.surround import SETTINGS as SURROUND
from vocc_torch.extras.calibrate.transfer import TransferCurve
from vocc_torch.simulation.effects.sensor import Photoelectrons
from vocc_torch.simulation.photometry import through_lens


@dataclass(frozen=True)
class DescriptionSettings:
    """When a value counts."""

    likelihood: float = 10.8  # twice the log-likelihood ratio; by chance once in 1000
    narrowest_blur_px: float = 0.15  # a narrower blur is none
    widest_blur_px: float = 32.0  # that the simulator draws
    wide_gamma: float = 0.3  # half an interval from which gamma is hardly told
    unknown_lx: float = 8000.0  # an overcast day, where nothing tells the illuminance
    sure_pose: float = 9.0  # misfit that tells a pose from its mirror image
    large_residuals: float = 2.0  # variance over the noise's that is worth a sentence


SETTINGS = DescriptionSettings()


def describe(apart: Floats, found: Findings) -> None:
    """Make a scene of a fit.

    Args:
        apart: (B,) by how much frames tell a pose from its mirror image.
        found: so far, with the last fit.
    """
    fit, coded = found.fit, found.is_coded
    found.say("coded", when=coded)
    if found.bound is None:
        found.camera = replace(found.camera, gamma=round(fit.gamma, 5))
        found.tell("camera.gamma", fit.gamma, fit.deviation("gamma"))
    else:
        found.say("bound", gamma=found.bound, fitted=fit.gamma)
    half = SURE * fit.deviation("gamma")
    found.say("hardly", when=half > SETTINGS.wide_gamma)
    place(apart, found)
    if found.tried("jpeg", found.coded[1], SURROUND.coded_sigmas):
        found.tell("effects.jpeg.quality", found.coded[0], 1.0)
    counts = None if coded else found.curve
    found.say("noise", when=counts is None)
    efficiency = brightness(counts, found)
    blur, deviation = fit.values["blur_px"].item(), fit.deviation("blur_px")
    if found.tried("blooming", blur, SETTINGS.narrowest_blur_px):
        sigma = min(blur * found.coarse, SETTINGS.widest_blur_px)
        found.tell("effects.blooming.sigma_px", sigma, deviation * found.coarse)
        found.say("blur")
    if found.tried("vignetting", found.fall.gain):
        loss = found.fall.corner_loss
        with_gamma = fit.deviation("gamma") / fit.gamma * loss
        error = math.hypot(found.fall.deviation, with_gamma)
        found.tell("effects.vignetting.corner_loss", loss, error)
    if counts is not None:
        sensor_noise(counts, found, efficiency)
    found.tried("saturation")
    found.tried("quantization")
    found.tell("effects.quantization.bits", 8)
    if fit.scale > SETTINGS.large_residuals:
        found.say("residuals", times=math.sqrt(fit.scale))


def place(apart: Floats, found: Findings) -> None:
    """Describe place and pose."""
    found.over("distance_m", lambda fit: fit.distance_m)
    found.over("offset_x_m", lambda fit: fit.scene.offset_x_m.numpy())
    found.over("offset_y_m", lambda fit: fit.scene.offset_y_m.numpy())
    if set(TURNED) <= set(found.fit.free):
        for name in TURNED:
            found.over(f"effects.pose.{name}", by_name(name))
        found.say("signs", when=float(np.median(apart)) < SETTINGS.sure_pose)


def veil_luminance(found: Findings) -> tuple[float, float]:
    """Tell a veil by Off LEDs and background that are more alike than their reflectances.

    Returns:
        the veil's luminance at 1 lx, 0 for none, and its standard deviation.
    """
    panel, share = found.panel, found.panel.background_reflectance
    ratios, deviations, common = found.derived(
        lambda fit: fit.lights[1] / fit.lights[0]
    )
    middle, shares = float(np.median(ratios)), panel.led_reflectance / share
    error = math.hypot(float(np.median(deviations)) / math.sqrt(len(ratios)), common)
    alike = 1 < middle < shares and not found.loose
    gain = ((shares - middle) / error) ** 2 if alike else 0.0
    if found.tried("veiling_glare", gain, SETTINGS.likelihood):
        veil = share * (shares - middle) / (middle - 1) / math.pi
        return veil, veil * error * (1 / (shares - middle) + 1 / (middle - 1))
    if abs(middle - shares) > 3 * error:
        found.panel = replace(panel, led_reflectance=round(min(1.0, middle * share), 4))
        found.say("reflectance")
    return 0.0, 0.0


def brightness(curve: TransferCurve | None, found: Findings) -> float:
    """Describe the light, and give the quantum efficiency that fits to it."""
    fit, config, efficiency = found.fit, found.config, found.config.quantum_efficiency
    grey = found.over("background_grey", by_name("background"), 1.0)
    veil, veil_error = veil_luminance(found)
    # Luminance of the background at 1 lx.
    background = found.panel.background_reflectance / math.pi + veil
    lux, error = config.ambient_lx or SETTINGS.unknown_lx, math.nan
    note = "as configured" if config.ambient_lx else ""
    if curve is not None and curve.noise.slope:
        camera = fit.camera
        exposure_lx_s = float(through_lens(torch.tensor(background), camera))
        per_lux = Photoelectrons(efficiency).electrons_per_lx_s(camera) * exposure_lx_s
        electrons = float(np.median(fit.lights[0])) / curve.noise.slope
        counted = electrons / per_lux
        if config.ambient_lx is None:
            by_curve = math.sqrt(curve.covariance[0, 0]) / curve.noise.slope
            by_grey = 4 * grey.deviation / (grey.low + grey.high)
            # With the variance of grey values as it is, they go with 1 / gamma^2.
            by_gamma = fit.deviation("gamma") * (2 / fit.gamma)
            error = counted * math.hypot(by_curve, by_grey, by_gamma)
            lux, note = counted, "from the photon noise"
            found.say("product")
        else:
            efficiency *= counted / config.ambient_lx
    else:
        found.say("illuminance", when=config.ambient_lx is None, lux=lux)
    found.tell("ambient_lx", lux, error, note)

    def own_light(fit: RecordingFit) -> Floats:
        behind, off, on = fit.lights
        return np.asarray((on - off) / behind * (background * lux))

    found.over("led_luminance_cd_m2", own_light, 0.0)
    found.say("white", when=float(np.median(fit.values["on"])) >= WHITE)
    if veil:
        luminance = "effects.veiling_glare.luminance_cd_m2"
        found.tell(luminance, veil * lux, veil_error * lux)
        found.say("veil")
    if found.panel.board_reflectance is not None:
        board = round(fit.values["board"].item(), 4)
        found.panel = replace(found.panel, board_reflectance=board)
    return efficiency


def sensor_noise(curve: TransferCurve, found: Findings, efficiency: float) -> None:
    """Describe the sensor's noise, in electrons, which shot noise counts."""
    if not found.tried("shot_noise", curve.gains[0]):
        found.say("unit", when=curve.gains[1] > 0)
        return
    read = found.tried("read_noise", curve.gains[1])
    found.tried("photoelectrons")
    found.tried("gain")
    found.tell("effects.photoelectrons.quantum_efficiency", min(1.0, efficiency))
    found.say("photons", when=efficiency > 1, efficiency=efficiency)
    found.say("read", when=not read)
    if read:
        fit, slope, floor = found.fit, curve.noise.slope, curve.noise.floor
        count = math.sqrt(floor) / slope / found.coarse
        turn = np.array([-1 / slope, 0.5 / floor])
        by_curve = math.sqrt(turn @ curve.covariance @ turn)
        # With the variance of grey values as it is, it goes with (Off / background)^gamma / gamma.
        dark = np.median(np.abs(np.log(fit.values["off"] / fit.values["background"])))
        by_gamma = fit.deviation("gamma") * (1 / fit.gamma + float(dark))
        error = count * math.hypot(by_curve, by_gamma)
        found.tell("effects.read_noise.electrons", count, error)
