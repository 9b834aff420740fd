"""The LEDs' own light: the symbols that they show, faults and scatter of LEDs, and the air before them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.geometry import led_centres_m
from vocc_torch.simulation.perspective import view_of
from vocc_torch.simulation.photometry import transmission

MOST_SYMBOLS = 1001
"""Most symbols that a panel may show during its readout."""

LONGEST_S = 1e6
"""Longest time on offer, s."""


@dataclass(frozen=True, slots=True)
class RollingShutter(Effect):
    """Row i of the sensor is exposed over ``[t_i, t_i + T]``, ``t_i = i readout_s / (height - 1)``.

    The panel shows symbol after symbol, each for ``symbol_s``. The symbol that was sent with the frame, the
    truth, is the one that shows in the middle of the exposure of the row that the panel's centre lies in (or
    of the sensor's row nearest to it). Camera and panel are not synchronised: that moment is uniform over
    the truth's ``symbol_s``. The symbols before and after it are data, each LED On or Off with equal chance.
    A row receives each symbol's light for the share of T during which that symbol shows.

    Each picture has a phase and neighbours of its own, a preamble too: it stands amid data, and what it
    mixes with is not known to the receiver. Symbols are drawn outwards from the truth, so the nearer ones do
    not depend on how many there are. Those that show during the readout of the panel and of a cell around it
    are drawn; farther rows, where the panel is not, keep the first or the last of them. The rest of the scene
    does not change with time, and nothing is taken to move. Sampled: not differentiable in the timing.

    Source: C.-K. Liang, L.-W. Chang and H. H. Chen, "Analysis and compensation of rolling shutter effect",
    IEEE Trans. Image Process. 17(8), 2008; C. Danakis et al., "Using a CMOS camera sensor for visible light
    communication", IEEE Globecom Workshops, 2012.

    Args:
        readout_s: from the start of the first row's exposure to that of the last row's, s, above 0 and at
            most 1e6; most cameras take 5 to 30 ms.
        symbol_s: how long the panel shows a symbol, s, at least the camera's exposure time and at most 1e6.

    Raises:
        VoccError: a value outside its range; when called, a symbol shorter than the exposure, or more than
            1001 symbols.

    Example:
        >>> RollingShutter(readout_s=0.016, symbol_s=1 / 30).readout_s
        0.016
    """

    readout_s: float
    symbol_s: float

    name = "rolling_shutter"
    takes = gives = Quantity.SYMBOLS
    sampled = True

    def __post_init__(self) -> None:
        """Check the ranges that do not need the camera."""
        self.demand("readout_s", 0, LONGEST_S, above=True, hint="leave the effect out for a global shutter")
        self.demand("symbol_s", 0, LONGEST_S, above=True)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Put each frame's (B,R,C) bits amid the symbols that show during the panel's readout.

        Returns:
            (B,K,R,C) bool, K odd, in the order in which they show; the truth is number ``K // 2``.
        """
        timing = self._timing(context)
        before_and_after = np.empty((len(value), timing.around, 2, *value.shape[1:]), dtype=np.uint8)
        for symbols, generator in zip(before_and_after, timing.generators, strict=True):
            symbols[:] = generator.integers(2, size=symbols.shape, dtype=np.uint8)
        data = torch.from_numpy(before_and_after).to(value.device).bool()
        return torch.cat([data[:, :, 0].flip(1), value.unsqueeze(1), data[:, :, 1]], dim=1)

    def row_shares(self, context: Context, height: int) -> Tensor:
        """The share of each pixel row's exposure during which each symbol shows.

        Args:
            context: the frames; ``origin_px`` says which of the sensor's rows comes first.
            height: rows of the frame or crop.

        Returns:
            (B,K,height) float64, 0 to 1; they add to 1 in each row. The symbols are those of a call.
        """
        timing = self._timing(context)
        rows = torch.arange(height, device=timing.edges_s.device) + context.first_px[:, 1:].double()
        begins = self._begins_s(rows - timing.centre_row.unsqueeze(-1), context)
        # The share of the exposure that is over when a symbol begins: telescopes to 1 over all symbols.
        over = (timing.edges_s.unsqueeze(-1) - begins.unsqueeze(1)) / context.camera.exposure_time_s
        return over.clamp_(0, 1).diff(dim=1)

    def _begins_s(self, rows: Tensor, context: Context) -> Tensor:
        """When a row so many below the panel's centre is first exposed; 0 is mid exposure of the centre."""
        camera = context.camera
        return rows * (self.readout_s / max(camera.height_px - 1, 1)) - camera.exposure_time_s / 2

    def _timing(self, context: Context) -> _Timing:
        """Draw each frame's phase, and find the symbols that show during the readout of its panel."""
        if self.symbol_s < context.camera.exposure_time_s:
            exposure_s = context.camera.exposure_time_s
            raise self.refusal("symbol_s", f"at least camera.exposure_time_s, which is {exposure_s:g}")
        top, centre, bottom = _panel_rows(context)
        generators = context.generators(self.name)
        draws = torch.tensor([g.random() for g in generators], dtype=torch.float64, device=top.device)
        truth_s = -draws * self.symbol_s
        begins, ends = self._begins_s(top - centre, context), self._begins_s(bottom - centre, context)
        ends = ends + context.camera.exposure_time_s
        first = torch.floor((begins - truth_s) / self.symbol_s)
        last = torch.ceil((ends - truth_s) / self.symbol_s) - 1
        around = int(torch.maximum(-first, last).max())
        if 2 * around + 1 > MOST_SYMBOLS:
            shown = f"the panel shows {2 * around + 1} symbols during its readout, at most {MOST_SYMBOLS}"
            raise VoccError(f"scene.effects.{self.name}.symbol_s is {self.symbol_s:g}: {shown} are allowed")
        steps = torch.arange(-around, around + 2, dtype=torch.float64, device=top.device)
        edges = truth_s.unsqueeze(-1) + steps * self.symbol_s
        # A frame's own symbols end its timeline, not the batch's: so the batch cannot change a frame.
        edges = edges.masked_fill(steps <= first.unsqueeze(-1), -torch.inf)
        edges = edges.masked_fill(steps > last.unsqueeze(-1), torch.inf)
        return _Timing(edges, centre, around, generators)


@dataclass(frozen=True, slots=True)
class _Timing:
    """When the symbols of each frame begin and end."""

    edges_s: Tensor
    """(B,K+1): where one symbol follows the other; 0 is the middle of the centre row's exposure."""
    centre_row: Tensor
    """(B,): the sensor's row that the panel's centre lies in."""
    around: int
    """Symbols before the truth, and as many after it."""
    generators: list[np.random.Generator]
    """Each frame's stream, its phase drawn."""


def _panel_rows(context: Context) -> tuple[Tensor, Tensor, Tensor]:
    """Sensor rows of a panel with a cell around it: first, centre's and last, (B,) each, on the sensor."""
    scene, leds = context.scene, led_centres_m(context.panel)
    points = torch.cat([torch.zeros_like(leds[:1]), leds]).to(scene.distance_m.device)
    y = view_of(context).points_px(points)[..., 1]
    cell = context.panel.pitch_m * context.camera.pixels_per_metre(scene.distance_m)
    rows = torch.stack([y.amin(dim=1) - cell, y[:, 0], y.amax(dim=1) + cell])
    top, centre, bottom = torch.floor(rows).clamp(0, context.camera.height_px - 1)
    return top, centre, bottom


@dataclass(frozen=True, slots=True)
class StuckLeds(Effect):
    """Each LED independently is stuck Off or stuck On, whatever its bit.

    A stuck-On LED shines at the scene's LED luminance. Every frame of a block is another panel, with stuck
    LEDs of its own; a frame and its preambles show one panel, and what is stuck in one is stuck in all. A
    larger share keeps the LEDs that are stuck at a smaller one. The bits that were sent stay the truth, so
    half of the stuck LEDs' bits are errors that no receiver can avoid. Sampled: not differentiable in the
    shares; the light of the LEDs that shine keeps its gradient.

    Source: a Bernoulli draw for each LED; the shares are those of the panel's failed drivers and dies.

    Args:
        off_share: probability that an LED is stuck Off, 0 to 1.
        on_share: probability that an LED is stuck On, 0 to 1; the two shares are above 0 and at most 1
            together.

    Raises:
        VoccError: a share outside its range.

    Example:
        >>> StuckLeds(off_share=0.02).on_share
        0.0
    """

    off_share: float = 0.0
    on_share: float = 0.0

    name = "stuck_leds"
    takes = gives = Quantity.LED_LUMINANCE
    sampled = True

    def __post_init__(self) -> None:
        """Check the shares."""
        for parameter in ("off_share", "on_share"):
            self.demand(parameter, 0, 1)
        together = self.off_share + self.on_share
        if not 0 < together <= 1:
            rule = "at most 1" if together else "above 0 (leave the effect out for no stuck LEDs)"
            shown = f"scene.effects.{self.name}.off_share + on_share is {together:g}"
            raise VoccError(f"{shown}: it must be {rule}")

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Overrule (B,R,C) LED luminance where an LED is stuck."""
        draws = [g.random(tuple(value.shape[1:])) for g in context.generators(self.name, of_scene=True)]
        # One draw decides both, from its two ends, so that neither share moves the other's LEDs.
        draw = torch.from_numpy(np.stack(draws)).to(value.device)
        full = context.scene.led_luminance_cd_m2.to(value).view(-1, 1, 1)
        value = torch.where(draw < self.off_share, torch.zeros_like(value), value)
        return torch.where(draw >= 1 - self.on_share, full, value)


@dataclass(frozen=True, slots=True)
class LedScatter(Effect):
    """A factor for each LED's own light: ``exp(s z - s^2 / 2)`` with ``s^2 = ln(1 + v^2)``.

    The factor is log-normal with mean 1, v is its coefficient of variation and z is standard normal.
    Luminances spread so because the many causes (binning, temperature, ageing, dirt) each multiply. Every
    frame of a block is another panel, so each has factors of its own; a frame and its preambles show one
    panel and share them. Sampled: the factors are constants to automatic differentiation, and the light keeps
    its gradient.

    Source: E. Limpert, W. A. Stahel and M. Abbt, "Log-normal Distributions across the Sciences", BioScience
    51, 2001. LEDs uniform over a luminous-intensity bin that spans a factor of 1.12 to 1.4 have v from 0.03
    to 0.1.

    Args:
        coefficient_of_variation: standard deviation of the luminance over its mean, above 0 and at most 2.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> round(LedScatter(coefficient_of_variation=0.1).log_sigma, 5)
        0.09975
    """

    coefficient_of_variation: float

    name = "led_scatter"
    takes = gives = Quantity.LED_LUMINANCE
    sampled = True

    def __post_init__(self) -> None:
        """Check the range."""
        self.demand("coefficient_of_variation", 0, 2, above=True, hint="leave the effect out for no scatter")

    @property
    def log_sigma(self) -> float:
        """Standard deviation s of the factors' logarithm."""
        return math.sqrt(math.log1p(self.coefficient_of_variation**2))

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Multiply (B,R,C) LED luminance by each LED's factor."""
        sigma = self.log_sigma
        generators = context.generators(self.name, of_scene=True)
        draws = np.stack([generator.standard_normal(tuple(value.shape[1:])) for generator in generators])
        return value * torch.from_numpy(np.exp(sigma * draws - sigma**2 / 2)).to(value)


@dataclass(frozen=True, slots=True)
class Attenuation(Effect):
    """The air's transmission coefficient on the LEDs' own light (Eq. 20), ``T = exp(-3.91 d / V)``.

    Linear in the light, and differentiable in it and in the distance.

    Source: the paper, Eq. 20.

    Args:
        visibility_m: meteorological visibility distance, m, above 0; the paper's clear weather is 40 km.

    Raises:
        VoccError: a visibility that is not above 0.

    Example:
        >>> Attenuation(visibility_m=40_000.0).visibility_m
        40000.0
    """

    visibility_m: float

    name = "attenuation"
    takes = gives = Quantity.LED_LUMINANCE

    def __post_init__(self) -> None:
        """Check the range."""
        self.demand("visibility_m", 0, above=True)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Dim (B,R,C) LED luminance by the transmission at each frame's distance."""
        return value * transmission(context.scene.distance_m, self.visibility_m).view(-1, 1, 1)


def dimmed_once(light_cd_m2: Tensor, context: Context) -> Tensor:
    """Dim the own light of what stands in the background as our LEDs' is (Eq. 20), (B,R,C) cd/m2.

    Where ``airlight`` is named nothing is done here: it dims the whole background with all that shines in it.

    Example:
        >>> from vocc_torch.simulation.effects import build_effects
        >>> from vocc_torch.simulation.geometry import Camera
        >>> from vocc_torch.types import Scene
        >>> lamp, scene = torch.ones(1, 1, 1), Scene.of(distance_m=100.0)
        >>> fog = build_effects({"attenuation": {"visibility_m": 200}, "airlight": {"visibility_m": 200}})
        >>> for air in (fog[:1], fog):
        ...     print(round(float(dimmed_once(lamp, Context(scene, Camera(), effects=air))), 3))
        0.142
        1.0
    """
    if not any(effect.takes == Quantity.UNLIT for effect in context.effects):
        for effect in context.effects:
            if isinstance(effect, Attenuation):
                light_cd_m2 = effect(light_cd_m2, context)
    return light_cd_m2


EFFECTS = (RollingShutter, StuckLeds, LedScatter, Attenuation)
"""In physical order."""
