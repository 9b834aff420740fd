"""LEDs of a colour before a camera of three channels: spectra in broad strokes, and luma."""

import functools
import math

import numpy as np
import torch
from numpy.random import SFC64, Generator
from torch import Tensor

from vocc_torch.arrays import Floats
from vocc_torch.errors import demand_word
from vocc_torch.simulation.effects.base import (
    Context,
    Effect,
    Quantity,
    of_kind,
    within,
)
from vocc_torch.simulation.scene import Distribution

CHANNELS = ("red", "green", "blue")
FURTHER = ("second", "third")
"""Colours that a panel may send in beside its first, as the parameters of ``colour`` begin."""

SENSITIVITIES_NM = ((600.0, 35.0), (540.0, 35.0), (460.0, 30.0))
"""Peak and standard deviation of what each channel sees, as most colour cameras' in broad strokes."""

DAYLIGHT_K = 6500.0
"""Temperature of the black body that stands for daylight."""

WAVELENGTHS_NM: Floats = np.arange(360.0, 781.0)

LUMA = (0.299, 0.587, 0.114)
"""Weights of ITU-R BT.601."""

LUMA_16 = tuple(round(weight * (1 << 16)) for weight in LUMA)
"""The same in 65536ths, as Pillow adds whole numbers."""


def luminous_efficiency(wavelength_nm: Floats) -> Floats:
    """The eye's sensitivity V by day, 1 at 555 nm, to within 0.01.

    Source: C. Wyman, P.-P. Sloan and P. Shirley, "Simple analytic approximations to the CIE XYZ color
    matching functions", J. Comput. Graph. Tech. 2(2), 2013.

    Example:
        >>> luminous_efficiency(np.array([510.0, 555.0, 610.0])).round(2).tolist()
        [0.5, 1.0, 0.5]
    """
    total = np.zeros_like(wavelength_nm)
    for height, peak, below, above in (
        (0.821, 568.8, 46.9, 40.5),
        (0.286, 530.9, 16.3, 31.1),
    ):
        width = np.where(wavelength_nm < peak, below, above)
        total += height * np.exp(-0.5 * ((wavelength_nm - peak) / width) ** 2)
    return total


@functools.cache
def channel_shares(peak_nm: float, width_nm: float) -> tuple[float, float, float]:
    """What red, green and blue see of an LED over what they see of daylight of the same luminance.

    Args:
        peak_nm: of the LED's light, whose spectrum is a Gaussian.
        width_nm: full width at half its maximum.

    Example:
        >>> [round(share, 2) for share in channel_shares(630.0, 20.0)]
        [3.31, 0.19, 0.0]
    """
    nm = WAVELENGTHS_NM
    led = np.exp(-4 * math.log(2) * ((nm - peak_nm) / width_nm) ** 2)
    day = nm**-5.0 / np.expm1(1.438777e7 / (nm * DAYLIGHT_K))
    sensitivities = np.stack(
        [np.exp(-0.5 * ((nm - peak) / sigma) ** 2) for peak, sigma in SENSITIVITIES_NM]
    )
    eye = luminous_efficiency(nm)
    red, green, blue = (
        (sensitivities @ led) / (eye @ led) / ((sensitivities @ day) / (eye @ day))
    )
    return float(red), float(green), float(blue)


class Colour(Effect, on=Quantity.LED_LUMINANCE):
    """LEDs of one colour, or of three at once, seen by a colour camera balanced to daylight.

    Frames then have ``colour``, (B,3,H,W), beside their grey, which is its luma or a channel. A channel sees
    an LED's light as its sensitivity weighs the LED's spectrum, over daylight's of the same luminance. So
    what daylight lights is grey in all three, but for what has a colour of its own: photographs of a
    ``backdrop``, the sky, and drawn things, whose colours are random. Without ``bayer`` each channel has a
    sensor of its own with noise of its own; with it one mosaic is read, and ``demosaicing`` makes three
    channels of it (a raw mosaic is one plane, and has no ``colour``). Effects of others after a mosaic, or
    after JPEG, get the three together, (B,3,H,W).

    A panel may send in three colours at once: each place then has a second and a third LED, with bits, faults
    and scatter of their own. A frame's bits, which receivers are measured by, stay those of the first, and
    :meth:`~vocc_torch.simulation.Simulator.further_bits` gives the others. Preambles are of all colours.

    A frame and its preambles share the colour. Sampled: the colour is a constant to automatic
    differentiation, and the light keeps its gradient.

    Source: Gaussian spectra; sensitivities as those of J. Jiang et al., "What is the space of spectral
    sensitivity functions for digital color cameras?", WACV 2013, in round numbers; daylight as a black body.

    Args:
        peak_nm: peak wavelength of the LEDs' light, nm, a number or a distribution, 400 to 700; 630 is red,
            525 green, 470 blue.
        width_nm: full width of their spectrum at half its maximum, nm, 5 to 200.
        white: share of frames whose (first) LEDs are white, 0 to 1.
        grey: what becomes the frames' grey, which receivers read: ``luma`` (Rec. 601), ``red``, ``green`` or
            ``blue``. Files in colour hold all three channels.
        second_nm: peak wavelength of a second LED at each place, nm, a number or a distribution, 400 to 700.
        third_nm: the same of a third LED.
        second_share: luminance of the second LEDs over that of the first, above 0 and at most 100.
        third_share: the same of the third LEDs.

    Raises:
        VoccError: a value outside its range, another word for ``grey``, or a share of no LEDs.

    Example:
        >>> Colour(peak_nm=590).width_nm
        20.0
    """

    peak_nm: Distribution | float = within(400, 700, default=630.0)
    width_nm: float = within(5, 200, default=20.0)
    white: float = within(0, 1, default=0.0)
    grey: str = "luma"
    second_nm: Distribution | float | None = within(400, 700, default=None)
    third_nm: Distribution | float | None = within(400, 700, default=None)
    second_share: float = within(0, 100, default=1.0, above=True)
    third_share: float = within(0, 100, default=1.0, above=True)
    sampled = True

    def __post_init__(self) -> None:
        """Check the ranges and the word."""
        Effect.__post_init__(self)
        demand_word(f"scene.effects.{self.name}.grey", self.grey, ("luma", *CHANNELS))
        for ordinal in FURTHER:
            if (
                getattr(self, f"{ordinal}_nm") is None
                and getattr(self, f"{ordinal}_share") != 1
            ):
                raise self.refusal(f"{ordinal}_share", f"left out without {ordinal}_nm")

    @property
    def further(self) -> tuple[str, ...]:
        """The further colours, ``second`` and ``third``, that a panel sends in."""
        return tuple(
            ordinal for ordinal in FURTHER if getattr(self, f"{ordinal}_nm") is not None
        )

    def sent(self, context: Context) -> Tensor:
        """Draw bits of the context's further LEDs, (B,R,C) bool; a preamble has them all On or all Off."""
        size, stream = context.panel.shape.sides, f"{self.name}.bits{context.leds}"
        bits = context.draws(stream, lambda g: g.integers(2, size=size)).bool()
        for i, key in enumerate(context.keys):
            if key.take in ("on", "off"):
                bits[i] = key.take == "on"
        return bits

    def grey_of(self, channels: Tensor) -> Tensor:
        """What (B,3,H,W) becomes for receivers, (B,1,H,W)."""
        if self.grey == "luma":
            return luma_of(channels)
        return channels[:, [CHANNELS.index(self.grey)]]

    def shares(self, context: Context) -> Tensor:
        """What the context's channel sees of each frame's LEDs, (B,); without one, what luma does."""
        leds = context.leds[1:]

        def share(generator: Generator) -> float:
            peak = self.drawn(f"{leds or 'peak'}_nm", generator)
            white = generator.random() < self.white and not leds
            shares = (1.0, 1.0, 1.0) if white else channel_shares(peak, self.width_nm)
            if context.channel is not None:
                return shares[context.channel]
            return sum(w * s for w, s in zip(LUMA, shares, strict=True))

        return context.draws(self.name + context.leds, share, of_scene=True)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Weigh (B,R,C) LED luminance."""
        share = getattr(self, f"{context.leds[1:]}_share") if context.leds else 1.0
        return value * (share * self.shares(context)).to(value).view(-1, 1, 1)


def of_leds(light_cd_m2: Tensor, context: Context) -> Tensor:
    """Weigh the light of other LEDs of the panel's make, (B,R,C), as the scene's ``colour`` says."""
    effect = of_kind(context.effects, Colour)
    return light_cd_m2 if effect is None else effect(light_cd_m2, context)


def luma_of(colour: Tensor) -> Tensor:
    """Luma of (B,3,H,W), (B,1,H,W): of whole numbers as Pillow has it, to the last bit.

    Example:
        >>> luma_of(torch.tensor([255, 0, 0], dtype=torch.uint8).view(1, 3, 1, 1)).item()
        76
    """
    if colour.dtype != torch.uint8:
        return (colour * colour.new_tensor(LUMA).view(3, 1, 1)).sum(dim=1, keepdim=True)
    weighed = colour.int() * colour.new_tensor(LUMA_16, dtype=torch.int32).view(3, 1, 1)
    return (weighed.sum(dim=1, keepdim=True).add_(1 << 15) >> 16).to(torch.uint8)


def tints(seed: int, parts: int, channel: int) -> Floats:
    """Draw what a channel sees of a thing's parts over their luminance, (parts,): colours of luma 1.

    Example:
        >>> red, green, blue = (tints(7, 1, channel)[0] for channel in range(3))
        >>> round(float(0.299 * red + 0.587 * green + 0.114 * blue), 9)
        1.0
    """
    drawn = Generator(SFC64(seed)).standard_normal((parts + 1, 3))
    # One colour for the thing, and a little of its own for each part.
    colours = np.exp(0.25 * drawn[:1] + 0.1 * drawn[1:])
    ratios: Floats = colours[:, channel] / (colours @ np.array(LUMA))
    return ratios
