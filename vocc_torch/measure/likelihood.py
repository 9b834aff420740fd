"""How likely the grey values of a frame are, given the light that each LED adds to each pixel.

Before gamma encoding, clipping and rounding the exposure of a pixel is an affine function of the bits.
Without noise a grey value is met by every exposure of an interval, which has no upper end at white, and by no
other. With noise, which is close to normal, it has the probability that the exposure falls in that interval.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation import Simulator
from vocc_torch.simulation.effects import (
    Context,
    Effect,
    Parameters,
    coding,
    sensor,
    view,
)
from vocc_torch.simulation.photometry import MIDDLE_GREY, auto_iso
from vocc_torch.types import Frames, PanelShape, Scene

AFFINE = (
    *(
        "lens_distortion",
        "attenuation",
        "airlight",
        "veiling_glare",
        "motion_blur",
        "defocus",
        "diffraction",
    ),
    *("blooming", "vignetting", "bayer", "photoelectrons", "dark_current", "gain"),
)
"""Effects that leave the exposure an affine function of the bits."""

NOISE = ("prnu", "shot_noise", "dsnu", "read_noise")
"""Effects that add independent noise to each pixel, of known variance."""

CODING = ("full_well", "saturation", "quantization")
"""Effects that clip and round."""

SLACK = 5e-5
"""Digital numbers by which single precision may move a value before it is rounded."""

WELL_SIGMAS = 6.0
"""A full well at least so many standard deviations above white never shows in a frame."""


class UnknownLikelihoodError(VoccError):
    """The genie does not know how likely frames with these effects are."""


def log_interval_probability(low: Tensor, high: Tensor) -> Tensor:
    """Logarithm of the probability that a standard normal variable lies between two bounds, even far out.

    Args:
        low: any shape, may be minus infinity.
        high: above ``low``, may be infinity.

    Example:
        >>> one = torch.ones((), dtype=torch.float64)
        >>> [round(float(log_interval_probability(a * one, b * one)), 3) for a, b in ((-1, 1), (40, 41))]
        [-0.382, -804.608]
    """
    # log_ndtr is accurate in the lower tail alone, so intervals above 0 are mirrored.
    above = low > 0
    low, high = torch.where(above, -high, low), torch.where(above, -low, high)
    below_high = torch.special.log_ndtr(high)
    ratio = torch.exp(torch.special.log_ndtr(low) - below_high)
    inside: Tensor = below_high + torch.log1p(-ratio.clamp(max=1 - 1e-15))
    return inside


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Variance of a pixel's electrons given their mean, as EMVA 1288 adds it up.

    Args:
        electrons_per_unit: electrons of one unit of relative exposure, above 0.
        dark_electrons: mean dark signal, at least 0.
        shot: whether electrons are counted, with a variance of their mean.
        response_share: standard deviation of the pixels' response as a share of the light's signal (PRNU).
        fixed_variance: of what does not depend on the signal (read noise, DSNU), electrons squared.

    Example:
        >>> noise = SensorNoise(1000.0, 0.0, True, 0.0, 9.0)
        >>> [round(float(v) * 1000**2) for v in noise.variance(torch.tensor([0.0, 1.0]))]
        [9, 1009]
    """

    electrons_per_unit: float
    dark_electrons: float
    shot: bool
    response_share: float
    fixed_variance: float

    def variance(self, exposure: Tensor) -> Tensor:
        """Variance of relative exposure, in any shape, whose mean is ``exposure``."""
        mean = exposure.clamp(min=0) * self.electrons_per_unit
        variance = (
            self.response_share**2 * (mean - self.dark_electrons).clamp(min=0) ** 2
        )
        variance = variance + self.fixed_variance + (mean if self.shot else 0.0)
        # A pixel without electrons has no variance, and a normal density none without.
        return variance.clamp(min=0.01) / self.electrons_per_unit**2


def sensor_noise(effects: Sequence[Effect], context: Context) -> SensorNoise | None:
    """Read the noise of one frame from the effects of its scene.

    Args:
        effects: all effects of the scene.
        context: the frame's scene and camera, and the effects that auto-ISO meters.

    Returns:
        The noise, or None where no effect makes any.

    Raises:
        UnknownLikelihoodError: a capacity that pixels reach before they are white.
    """
    named = {effect.name: effect for effect in effects}
    electrons = named.get("photoelectrons")
    if not isinstance(electrons, sensor.Photoelectrons):
        return None
    camera, share = context.camera, 0.0
    per_unit = electrons.electrons_per_lx_s(camera) * 10 / float(auto_iso(context))
    dark = fixed = 0.0
    for effect in effects:
        if isinstance(effect, sensor.Prnu):
            share = effect.share
        elif isinstance(effect, sensor.ReadNoise | sensor.Dsnu):
            fixed += effect.electrons**2
        elif isinstance(effect, sensor.DarkCurrent):
            dark = effect.electrons_per_s * camera.exposure_time_s
    noise = SensorNoise(per_unit, dark, "shot_noise" in named, share, fixed)
    white = torch.tensor((255 / MIDDLE_GREY) ** camera.gamma, dtype=torch.float64)
    least_well = float(white + WELL_SIGMAS * noise.variance(white).sqrt()) * per_unit
    well = named.get("full_well")
    if isinstance(well, sensor.FullWell) and well.electrons < least_well:
        why = f"scene.effects.full_well.electrons is {well.electrons:g}, white needs {least_well:.0f}"
        refusal = "the genie knows no likelihood for pixels full before they are white"
        raise UnknownLikelihoodError(f"{refusal}: {why}")
    return noise if share or fixed or noise.shot else None


@dataclass(frozen=True, slots=True)
class PixelModel:
    """The pixels of one frame that any LED's light reaches. Exposure is relative: ``(G / 118)^gamma``, Eq. 1.

    Args:
        base: (P,) float64, exposure with every LED Off.
        light: (N,P) float64, what each On LED adds; N in raster order.
        low: (P,) exposure at which the grey value begins, minus infinity at black.
        high: (P,) where it ends, infinity at white.
        centre: (P,) exposure of the grey value itself.
        step: (P,) width of a step of grey there.
        slack: (P,) how far the simulator's working precision may move a value that is then rounded.
        noise: the sensor's, or None.

    Example:
        >>> one = torch.ones(1, dtype=torch.float64)
        >>> seen = PixelModel(one, one.view(1, 1), 1.9 * one, 2.1 * one, 2 * one, 0.2 * one, 0 * one, None)
        >>> [round(float(seen.misfit(seen.exposure(bit))), 2) for bit in (torch.zeros(1), torch.ones(1))]
        [20.25, 0.0]
    """

    base: Tensor
    light: Tensor
    low: Tensor
    high: Tensor
    centre: Tensor
    step: Tensor
    slack: Tensor
    noise: SensorNoise | None

    def exposure(self, shares: Tensor) -> Tensor:
        """Relative exposure of bits, or of shares of each LED's light, (...,N) to (...,P)."""
        return self.base + shares.to(self.light.dtype) @ self.light

    def misfit(self, exposure: Tensor, pixels: Tensor | None = None) -> Tensor:
        """How ill an exposure fits each pixel's grey value.

        Args:
            exposure: (...,P), or (...,Q) of the pixels named.
            pixels: (...,Q) int64, or None for all.

        Returns:
            Without noise the squared distance, in steps, to the inside of the grey value's interval: 0 where
            the value is met whatever rounding does. With noise minus the logarithm of its probability.
        """
        limits = self.low, self.high, self.step, self.slack
        low, high, step, slack = (
            limit if pixels is None else limit[pixels] for limit in limits
        )
        if self.noise is None:
            outside = (low + slack - exposure).clamp(min=0) + (
                exposure - high + slack
            ).clamp(min=0)
            return (outside / step) ** 2
        sigma = self.noise.variance(exposure).sqrt()
        return -log_interval_probability(
            (low - exposure) / sigma, (high - exposure) / sigma
        )

    def deviation(self, exposure: Tensor) -> Tensor:
        """Standard deviation of grey values read as exposures, (P,): of rounding, and of noise at these."""
        rounding = self.step**2 / 12
        return (
            rounding if self.noise is None else rounding + self.noise.variance(exposure)
        ).sqrt()


Window = tuple[slice, slice]


def overlap(mine: Frames, theirs: Frames) -> tuple[Window, Window]:
    """Find what two pictures of one frame both show: its rows and columns in each picture.

    Example:
        >>> picture = torch.zeros(1, 1, 4, 4)
        >>> here, there = (Frames(picture, torch.tensor([[x, 0]]), (9, 9)) for x in (2, 3))
        >>> overlap(here, there)[0]
        (slice(0, 4, None), slice(1, 4, None))
    """
    x, y = (theirs.origin_px[0].cpu() - mine.origin_px[0].cpu()).tolist()
    sizes = zip(mine.grey.shape[-2:], theirs.grey.shape[-2:], (y, x), strict=True)
    (rows, their_rows), (columns, their_columns) = (
        clipped(at, theirs, mine) for mine, theirs, at in sizes
    )
    return (rows, columns), (their_rows, their_columns)


def clipped(start: int, length: int, size: int) -> tuple[slice, slice]:
    """Cut ``length`` places from ``start`` on to those within ``size``: slices of the whole and of the part.

    Example:
        >>> clipped(-2, 5, 10)
        (slice(0, 3, None), slice(2, 5, None))
    """
    low, high = min(max(start, 0), size), max(min(start + length, size), 0)
    return slice(low, max(low, high)), slice(low - start, max(low, high) - start)


class ForwardModel:
    """The forward model of a frame's pixels, which the genie knows and no receiver does.

    Args:
        simulator: renders the frames.

    Raises:
        UnknownLikelihoodError: an effect whose likelihood is not known, by name, or frames that are not
            quantised.

    Example:
        >>> simulator, scene = Simulator(), Scene.of(distance_m=50.0)
        >>> frames = simulator.render(scene, torch.ones(1, 8, 8, dtype=torch.bool))
        >>> model = ForwardModel(simulator).pixels(frames, scene)
        >>> float(model.misfit(model.exposure(torch.ones(64))).sum())
        0.0
    """

    def __init__(self, simulator: Simulator) -> None:
        self.camera, self.panel, self.effects = (
            simulator.camera,
            simulator.panel,
            simulator.effects,
        )
        known = (*AFFINE, *NOISE, *CODING)
        if others := [
            f"scene.effects.{effect.name}"
            for effect in self.effects
            if effect.name not in known
        ]:
            refusal = f"the genie knows no likelihood for {', '.join(others)}"
            raise UnknownLikelihoodError(f"{refusal}: known are {', '.join(known)}")
        levels = [
            effect.levels
            for effect in self.effects
            if isinstance(effect, coding.Quantization)
        ]
        if not levels:
            raise UnknownLikelihoodError(
                "the genie reads digital numbers: name scene.effects.quantization"
            )
        self._half_step = 127.5 / (levels[0] - 1)
        parameters: dict[str, Parameters] = {}
        for effect in self.effects:
            if effect.name in AFFINE:
                assert is_dataclass(effect)
                settings = {
                    attribute.name: getattr(effect, attribute.name)
                    for attribute in fields(effect)
                    if attribute.init
                }
                # A parameter that may be left out is None where it was.
                parameters[effect.name] = {
                    name: value for name, value in settings.items() if value is not None
                }
        # Each LED is rendered as a panel of one LED at its place: small pictures, not the whole panel's.
        # Off, it is as grey as what lies behind it.
        grey = simulator.panel.background_reflectance
        lone = replace(
            simulator.panel,
            shape=PanelShape(1, 1),
            led_reflectance=grey,
            board_reflectance=None,
        )
        self._whole, self._led = (
            Simulator(
                self.camera,
                panel,
                parameters,
                device=simulator.device,
                dtype=torch.float64,
            )
            for panel in (simulator.panel, lone)
        )

    def pixels(self, frame: Frames, scene: Scene) -> PixelModel:
        """Model the pixels of one frame that any LED's light reaches.

        Args:
            frame: one frame, whole, crop or window.
            scene: its scene.

        Returns:
            The model, on the CPU.

        Raises:
            UnknownLikelihoodError: pixels that are full before they are white.
        """
        context = Context(
            scene, self.camera, effects=self._whole.effects, panel=self.panel
        )
        noise = sensor_noise(self.effects, context)
        none = torch.zeros(
            1, self.panel.shape.rows, self.panel.shape.columns, dtype=torch.bool
        )
        unlit = self._whole.render(scene, none, panel_only=True)
        mine, theirs = overlap(unlit, frame)
        light = self.led_light(scene, unlit)[(slice(None), *mine)].flatten(1)
        reached = (light > 0).any(0)
        base = self._exposure(unlit.grey[0, 0])[mine].flatten()[reached]
        grey = frame.grey[0, 0][theirs].flatten().to("cpu", torch.float64)[reached]
        sides = (grey - self._half_step).clamp(min=0), grey + self._half_step, grey
        low, high, centre = (self._exposure(side) for side in sides)
        open_low, open_high = (
            low.masked_fill(grey <= 0, -torch.inf),
            high.masked_fill(grey >= 255, torch.inf),
        )
        slack = (high - low) * (SLACK / (2 * self._half_step))
        return PixelModel(
            base,
            light[:, reached],
            open_low,
            open_high,
            centre,
            high - low,
            slack,
            noise,
        )

    def _exposure(self, grey: Tensor) -> Tensor:
        """Undo gamma encoding (Eq. 1): relative exposure, on the CPU."""
        return (grey.to("cpu") / MIDDLE_GREY) ** self.camera.gamma

    def led_light(self, scene: Scene, whole: Frames) -> Tensor:
        """Render what each LED adds to the pixels of a picture, (N,H,W)."""
        at = view.led_centres_m(self.panel).to(scene.distance_m)
        leds = Scene(
            *(getattr(scene, field.name).expand(len(at)) for field in fields(Scene))
        )
        x, y = (
            offset + shift
            for offset, shift in zip(
                (leds.offset_x_m, leds.offset_y_m), at.T, strict=True
            )
        )
        leds = replace(leds, offset_x_m=x, offset_y_m=y)
        on = torch.ones(len(at), 1, 1, dtype=torch.bool)
        lit = self._led.render(leds, on, panel_only=True)
        alike = slice(
            0, None if any(effect.fills_sensor for effect in self._led.effects) else 1
        )
        without = self._exposure(
            self._led.render(leds[alike], ~on[alike], panel_only=True).grey[:, 0]
        )
        added = self._exposure(lit.grey[:, 0]) - without
        # Gamma and back leave rounding where an LED adds nothing.
        added = torch.where(added > 1e-12 * without, added, 0.0)
        light = added.new_zeros(len(at), *whole.grey.shape[-2:])
        for led, (left, top) in enumerate((lit.origin_px - whole.origin_px).tolist()):
            rows, own_rows = clipped(top, added.shape[-2], light.shape[-2])
            columns, own_columns = clipped(left, added.shape[-1], light.shape[-1])
            light[led, rows, columns] = added[led, own_rows, own_columns]
        return light
