"""How likely the grey values of a frame are, given the light that fell there.

Without noise a grey value is met by every exposure of an interval, which has no upper end at white, and by no
other. With noise, which is close to normal, it has the probability that the exposure falls in that interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects import Context, Effect
from vocc_torch.simulation.effects.sensor import DarkCurrent, Dsnu, FullWell, Photoelectrons, Prnu, ReadNoise
from vocc_torch.simulation.photometry import MIDDLE_GREY, auto_iso

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
        variance = self.response_share**2 * (mean - self.dark_electrons).clamp(min=0) ** 2
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
    made = named.get("photoelectrons")
    if not isinstance(made, Photoelectrons):
        return None
    camera, share = context.camera, 0.0
    per_unit = made.electrons_per_lx_s(camera) * 10 / float(auto_iso(context))
    dark = fixed = 0.0
    for effect in effects:
        if isinstance(effect, Prnu):
            share = effect.share
        elif isinstance(effect, ReadNoise | Dsnu):
            fixed += effect.electrons**2
        elif isinstance(effect, DarkCurrent):
            dark = effect.electrons_per_s * camera.exposure_time_s
    noise = SensorNoise(per_unit, dark, "shot_noise" in named, share, fixed)
    white = torch.tensor((255 / MIDDLE_GREY) ** camera.gamma, dtype=torch.float64)
    needed = float(white + WELL_SIGMAS * noise.variance(white).sqrt()) * per_unit
    well = named.get("full_well")
    if isinstance(well, FullWell) and well.electrons < needed:
        raise UnknownLikelihoodError(
            "the genie knows no likelihood for pixels full before they are white: "
            f"scene.effects.full_well.electrons is {well.electrons:g}, white needs {needed:.0f}"
        )
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
        low, high, step, slack = (limit if pixels is None else limit[pixels] for limit in limits)
        if self.noise is None:
            outside = (low + slack - exposure).clamp(min=0) + (exposure - high + slack).clamp(min=0)
            return (outside / step) ** 2
        sigma = self.noise.variance(exposure).sqrt()
        return -log_interval_probability((low - exposure) / sigma, (high - exposure) / sigma)

    def deviation(self, exposure: Tensor) -> Tensor:
        """Standard deviation of grey values read as exposures, (P,): of rounding, and of noise at these."""
        rounding = self.step**2 / 12
        return (rounding if self.noise is None else rounding + self.noise.variance(exposure)).sqrt()
