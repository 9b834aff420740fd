"""The LEDs' own light and what lies on its way: symbols, faults, scatter, air, obstacles and glare."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.hardware import Camera
from vocc_torch.simulation import photometry, raster
from vocc_torch.simulation.effects import colour, view
from vocc_torch.simulation.effects.base import (
    BRIGHTEST,
    Context,
    Effect,
    Extent,
    Quantity,
    of_kind,
    within,
)

MOST_SYMBOLS = 1001
"""Most symbols that a panel may show during its readout."""

LONGEST_S = 1e6
"""Longest time on offer, s."""


CONTRAST_AT_VISIBILITY = 0.02
"""Share of a contrast that is left at the visibility distance, by that distance's definition."""

NO_GLARE = "leave the effect out for no glare"
FREE_VIEW = "leave the effect out for a free view"


class RollingShutter(Effect, on=Quantity.SYMBOLS):
    """Rolling shutter: row i is exposed over ``[t_i, t_i + T]``, ``t_i = i readout_s / (height - 1)``.

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

    readout_s: float = within(
        0, LONGEST_S, above=True, hint="leave the effect out for a global shutter"
    )
    symbol_s: float = within(0, LONGEST_S, above=True)
    sampled = True

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Put each frame's (B,R,C) bits amid the symbols that show during the panel's readout.

        Returns:
            (B,K,R,C) bool, K odd, in the order in which they show; the truth is number ``K // 2``.
        """
        edges_s, _, generators = self._timing(context)
        size = edges_s.shape[1] // 2 - 1, 2, *value.shape[1:]
        drawn = [
            generator.integers(2, size=size, dtype=np.uint8) for generator in generators
        ]
        data = torch.from_numpy(np.stack(drawn)).to(value.device).bool()
        before, after = data.unbind(2)
        return torch.cat([before.flip(1), value.unsqueeze(1), after], dim=1)

    def row_shares(self, context: Context, height: int) -> Tensor:
        """The share of each pixel row's exposure during which each symbol shows.

        Args:
            context: the frames; ``origin_px`` says which of the sensor's rows comes first.
            height: rows of the frame or crop.

        Returns:
            (B,K,height) float64, 0 to 1; they add to 1 in each row. The symbols are those of a call.
        """
        edges_s, centre_row, _ = self._timing(context)
        rows = torch.arange(height, device=edges_s.device) + context.first_px[:, 1:]
        begins = self._begins_s(rows - centre_row.unsqueeze(-1), context)
        # The share of the exposure that is over when a symbol begins: telescopes to 1 over all symbols.
        over = (
            edges_s.unsqueeze(-1) - begins.unsqueeze(1)
        ) / context.camera.exposure_time_s
        return over.clamp_(0, 1).diff(dim=1)

    def _begins_s(self, rows: Tensor, context: Context) -> Tensor:
        """When a row so many below the panel's centre is first exposed; 0 is mid exposure of the centre."""
        row_s = self.readout_s / max(context.camera.height_px - 1, 1)
        return rows * row_s - context.camera.exposure_time_s / 2

    def _timing(self, context: Context) -> tuple[Tensor, Tensor, Sequence[Any]]:
        """Draw each frame's phase, and find the symbols that show during the readout of its panel.

        Returns:
            (B,K+1) where one symbol follows the other, s from the middle of the centre row's exposure; (B,)
            the sensor's row that the panel's centre lies in; what tells each frame's neighbours.
        """
        scene, camera = context.scene, context.camera
        if self.symbol_s < camera.exposure_time_s:
            rule = f"at least camera.exposure_time_s, {camera.exposure_time_s:g}"
            raise self.refusal("symbol_s", rule)
        leds = view.led_centres_m(context.panel)
        points = torch.cat([torch.zeros_like(leds[:1]), leds])
        y = view.view_of(context).points_px(points)[..., 1]
        cell = context.panel.pitch_m * camera.pixels_per_metre(scene.distance_m)
        # The panel with a cell around it.
        rows = torch.stack([y.amin(dim=1) - cell, y[:, 0], y.amax(dim=1) + cell])
        top, centre, bottom = torch.floor(rows).clamp(0, camera.height_px - 1)
        shown_s, shown_number = self._shown_s(context)
        truth_s = -torch.tensor(shown_s, dtype=top.dtype, device=top.device)
        begins = self._begins_s(top - centre, context)
        ends = self._begins_s(bottom - centre, context)
        first = torch.floor((begins - truth_s) / self.symbol_s)
        last = torch.ceil((ends + camera.exposure_time_s - truth_s) / self.symbol_s) - 1
        around = int(torch.maximum(-first, last).max())
        symbols = 2 * around + 1
        if symbols > MOST_SYMBOLS:
            raise VoccError(
                f"scene.effects.{self.name}.symbol_s is {self.symbol_s:g}: "
                f"the panel shows {symbols} symbols during its readout, at most {MOST_SYMBOLS}"
                " are allowed"
            )
        steps = torch.arange(-around, around + 2, dtype=top.dtype, device=top.device)
        edges = truth_s.unsqueeze(-1) + steps * self.symbol_s
        # A frame's own symbols end its timeline, not the batch's: so the batch cannot change a frame.
        edges = edges.masked_fill(steps <= first.unsqueeze(-1), -torch.inf)
        edges = edges.masked_fill(steps > last.unsqueeze(-1), torch.inf)
        return edges, centre, shown_number

    def _shown_s(self, context: Context) -> tuple[Sequence[float], Sequence[Any]]:
        """Draw for how long each frame's truth has shown, s, and give the streams of its neighbours."""
        generators = context.generators(self.name)
        shown_s = [generator.random() * self.symbol_s for generator in generators]
        if context.leds:
            generators = context.generators(self.name + context.leds)
        return shown_s, generators


class Playback(RollingShutter):
    """A rolling shutter before a panel that plays a film: phase and neighbours are those of each moment.

    Before and after the film the panel is dark. It stands in a list of built effects, never in a scene's
    file; :func:`vocc_torch.simulation.recording.record` makes one.

    Args:
        film: (N,R,C) bool, the symbols in order.
        middles_s: the moment, s from the film's begin, in which the middle of each frame's exposure of the
            panel's centre lies, by what the frame's key calls its take.
        further: films (N,R,C) of LEDs of further colours, by what a context calls them.

    Example:
        >>> film = torch.ones(2, 1, 1, dtype=torch.bool)
        >>> Playback(1e-3, 0.01, film=film, middles_s={"0": 0.012, "1": 0.025}).symbol_at("0")
        1
    """

    film: Tensor = field(kw_only=True)
    middles_s: Mapping[str, float] = field(kw_only=True)
    further: Mapping[str, Tensor] = field(kw_only=True, default_factory=dict)

    def symbol_at(self, take: str) -> int:
        """Give the number of the symbol that shows in the middle of a take; it may be beyond the film."""
        return math.floor(self.middles_s[take] / self.symbol_s)

    def symbols(self, numbers: Tensor, leds: str = "") -> Tensor:
        """Give symbols by number, of any shape, (...,R,C) bool; dark where there is none."""
        in_film = (numbers >= 0) & (numbers < len(self.film))
        film = self.further[leds] if leds else self.film
        return film[numbers.clamp(0, len(film) - 1)] & in_film[..., None, None]

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Put each frame's (B,R,C) bits amid their neighbours in the film, (B,K,R,C)."""
        edges_s, _, truths = self._timing(context)
        around = edges_s.shape[1] // 2 - 1
        numbers = torch.tensor(truths)[:, None] + torch.arange(-around, around + 1)
        return self.symbols(numbers, context.leds).to(value.device)

    def _shown_s(self, context: Context) -> tuple[Sequence[float], Sequence[Any]]:
        """Say for how long each frame's truth has shown, s, and its number."""
        takes = [key.take for key in context.keys_for(self.name)]
        numbers = [self.symbol_at(take) for take in takes]
        shown_s = [
            self.middles_s[take] - number * self.symbol_s
            for take, number in zip(takes, numbers, strict=True)
        ]
        return shown_s, numbers


class StuckLeds(Effect, on=Quantity.LED_LUMINANCE):
    """LEDs that are stuck Off or On, each independently of its bit.

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

    off_share: float = within(0, 1, default=0.0)
    on_share: float = within(0, 1, default=0.0)
    sampled = True

    def __post_init__(self) -> None:
        """Check the shares."""
        Effect.__post_init__(self)
        together = self.off_share + self.on_share
        if not 0 < together <= 1:
            rule = (
                "at most 1"
                if together
                else "above 0 (leave the effect out for no stuck LEDs)"
            )
            raise VoccError.of(
                f"scene.effects.{self.name}.off_share + on_share", f"{together:g}", rule
            )

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Overrule (B,R,C) LED luminance where an LED is stuck."""
        shape = tuple(value.shape[1:])
        # One draw decides both, from its two ends, so that neither share moves the other's LEDs.
        draw = context.draws(
            self.name + context.leds, lambda g: g.random(shape), of_scene=True
        )
        full = context.scene.led_luminance_cd_m2.to(value).view(-1, 1, 1)
        value = torch.where(draw < self.off_share, torch.zeros_like(value), value)
        return torch.where(draw >= 1 - self.on_share, full, value)


class LedScatter(Effect, on=Quantity.LED_LUMINANCE):
    """Unequal LEDs: each has a light factor ``exp(s z - s^2 / 2)``, ``s^2 = ln(1 + v^2)``.

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
        >>> LedScatter(coefficient_of_variation=0.1).name
        'led_scatter'
    """

    coefficient_of_variation: float = within(
        0, 2, above=True, hint="leave the effect out for no scatter"
    )
    sampled = True

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Multiply (B,R,C) LED luminance by each LED's factor."""
        sigma = math.sqrt(math.log1p(self.coefficient_of_variation**2))
        shape = tuple(value.shape[1:])

        factors = context.draws(
            self.name + context.leds,
            lambda g: np.exp(sigma * g.standard_normal(shape) - sigma**2 / 2),
            of_scene=True,
        )
        return value * factors.to(value)


class Attenuation(Effect, on=Quantity.LED_LUMINANCE):
    """Air dims the LEDs' own light by ``T = exp(-3.91 d / V)`` (Eq. 20).

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

    visibility_m: float = within(0, above=True)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Dim (B,R,C) LED luminance by the transmission at each frame's distance."""
        distance_m = context.scene.distance_m.view(-1, 1, 1)
        return value * photometry.transmission(distance_m, self.visibility_m)


def dimmed_once(light_cd_m2: Tensor, context: Context) -> Tensor:
    """Dim the own light of what stands in the background as our LEDs' is (Eq. 20), (B,R,C) cd/m2.

    Where ``airlight`` is named nothing is done here: it dims the whole background with all that shines in it.

    Example:
        >>> from vocc_torch.simulation.effects import build_effects
        >>> from vocc_torch.hardware import Camera
        >>> from vocc_torch.types import Scene
        >>> lamp, scene = torch.ones(1, 1, 1), Scene.of(distance_m=100.0)
        >>> fog = build_effects({"attenuation": {"visibility_m": 200}, "airlight": {"visibility_m": 200}})
        >>> for air in (fog[:1], fog):
        ...     print(round(float(dimmed_once(lamp, Context(scene, Camera(), effects=air))), 3))
        0.142
        1.0
    """
    air = of_kind(context.effects, Attenuation)
    if air is None or any(e.takes == Quantity.UNLIT for e in context.effects):
        return light_cd_m2
    return air.applied(light_cd_m2, context)


class Airlight(Effect, on=Quantity.UNLIT):
    """Fog adds scattered daylight (Koschmieder): ``L T + L_air (1 - T)``, ``T = exp(-3.912 d / V)``.

    The path of length d takes its share of what lies behind it and adds daylight that it scatters towards the
    camera. ``L_air`` is the horizon's luminance, ``horizon_factor E / pi``: a sky of one luminance that
    lights a level plane with E has the luminance ``E / pi``. Everything seen is taken to be at the panel's
    distance, the background and its lamps too. Headlights that shine into the fog are not part of it.

    This effect acts on all light but the LEDs' own, which ``attenuation`` (Eq. 20) dims; so nothing is dimmed
    twice, and a foggy scene names both, with one visibility, or is refused. Eq. 20 rounds 3.912 to 3.91, at
    most 0.2 % of the light within the visibility distance. Differentiable in the light and in the scene.

    Source: H. Koschmieder, "Theorie der horizontalen Sichtweite", Beitr. Phys. freien Atmos. 12, 1924;
    W. E. K. Middleton, "Vision through the Atmosphere", 1952. The meteorological optical range of weather
    services is where 5 % of a contrast is left instead, ``0.766 V``.

    Args:
        visibility_m: visibility distance V, m, above 0; fog is below 1000, dense fog below 200.
        horizon_factor: luminance of the horizon over that of a uniform sky, 0 to 10: 1 in fog and 3/7 under
            CIE's overcast sky; 0 is air that absorbs only.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> Airlight(visibility_m=100.0).horizon_factor
        1.0
    """

    visibility_m: float = within(0, above=True)
    horizon_factor: float = within(0, 10, default=1.0)
    metered = True

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Lay each frame's path of air before its (B,1,H,W) luminance without the LEDs' own light."""
        ambient_lx, distance_m = (
            part.view(-1, 1, 1, 1)
            for part in (context.scene.ambient_lx, context.scene.distance_m)
        )
        depth = distance_m * (math.log(CONTRAST_AT_VISIBILITY) / self.visibility_m)
        horizon = photometry.reflected_luminance_cd_m2(ambient_lx, self.horizon_factor)
        added = horizon * -torch.expm1(depth)
        return value * torch.exp(depth).to(value.dtype) + added.to(value.dtype)


class Occlusion(Effect, on=Quantity.LUMINANCE):
    """A matt rectangle near the camera, such as a post, a wiper or dirt, that covers what lies behind it.

    Its sides are level and upright, sharp, and shares of the panel's image, the least upright rectangle
    around its four corners; its centre is uniform over that rectangle. Each pixel loses the share of its
    area that is covered, the LEDs' light too, and gets the luminance ``R E / pi`` there: the rectangle
    stands in the scene's daylight, so near that no fog lies before it. It stays where it is for a frame and
    its preambles. Sampled: not differentiable in its place nor in its size; the light keeps its gradient.

    Source: the exact area of a rectangle in a pixel; a matt surface as in Eqs 2 and 3.

    Args:
        width_share: its width over that of the panel's image, above 0 and at most 2.
        height_share: its height over that of the panel's image, above 0 and at most 2.
        reflectance: of its surface, 0 to 1; black rubber has 0.04.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> Occlusion(width_share=0.25, height_share=2.0).size_in_px((32.0, 32.0), Camera(), 50.0)
        (96.0, 40.0)
    """

    width_share: float = within(0, 2, above=True, hint=FREE_VIEW)
    height_share: float = within(0, 2, above=True, hint=FREE_VIEW)
    reflectance: float = within(0, 1, default=0.04)
    sampled = True

    def size_in_px(self, size_px: Extent, camera: Camera, nearest_m: float) -> Extent:
        """Height and width of the panel's image with half of the rectangle beyond it on every side."""
        height, width = size_px
        return height * (1 + self.height_share), width * (1 + self.width_share)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Hide a part of each frame's (B,1,H,W) luminance."""
        corners_m = view.panel_corners_m(context.panel)
        corners = view.view_of(context).points_px(corners_m)
        low, high = corners.amin(dim=1), corners.amax(dim=1)
        drawn = context.draws(self.name, lambda g: g.random(2), of_scene=True)
        reach = (high - low) * low.new_tensor([self.width_share, self.height_share]) / 2
        centre = low + drawn * (high - low) - context.first_px
        begin, end = centre - reach, centre + reach
        across, down = (
            raster.interval_cover(begin[:, axis], end[:, axis], value.shape[3 - axis])
            for axis in (0, 1)
        )
        cover = (down.unsqueeze(-1) * across.unsqueeze(-2)).unsqueeze(1).to(value.dtype)
        surface = photometry.reflected_luminance_cd_m2(
            context.scene.ambient_lx.view(-1, 1, 1, 1), self.reflectance
        )
        return value * (1 - cover) + cover * surface.to(value.dtype)


class VeilingGlare(Effect, on=Quantity.LUMINANCE):
    """Light of the sun or of a lamp, scattered in windscreen and lens: one luminance added to every pixel.

    Give either the veil itself, where it is known, or the source's illuminance E on the plane of the lens and
    its angle theta to the line of sight: the veil is then ``10 E / theta^2`` (Stiles and Holladay), theta in
    degrees. That was measured on young human eyes and stands in for a dusty windscreen and lens; a clean lens
    scatters less. The angle to the panel stands for the whole frame, so the veil is uniform. The source
    itself is outside the view. Differentiable in the light.

    Source: CIE 146:2002, its disability glare equation without the term for age.

    Args:
        luminance_cd_m2: the veil, cd/m2, above 0 and at most 1e12; null computes it from the next two.
        glare_illuminance_lx: illuminance by the source on the plane of the lens, lx, above 0 and at most
            1e12; a low sun gives 10,000 to 80,000, an oncoming low beam 1 to 5.
        angle_deg: angle between the source and the line of sight, degrees, 1 to 30.

    Raises:
        VoccError: a value outside its range, neither of the two ways, or both.

    Example:
        >>> VeilingGlare(glare_illuminance_lx=40_000.0, angle_deg=10.0).veil_cd_m2
        4000.0
    """

    luminance_cd_m2: float | None = within(
        0, BRIGHTEST, default=None, above=True, hint=NO_GLARE
    )
    glare_illuminance_lx: float | None = within(
        0, BRIGHTEST, default=None, above=True, hint=NO_GLARE
    )
    angle_deg: float | None = within(1, 30, default=None)

    metered = True

    def __post_init__(self) -> None:
        """Check that the veil is given in one way, and the ranges."""
        missing = [
            name
            for name in ("glare_illuminance_lx", "angle_deg")
            if getattr(self, name) is None
        ]
        if self.luminance_cd_m2 is not None and len(missing) < 2:
            rule = "left out where glare_illuminance_lx or angle_deg is given"
            raise self.refusal("luminance_cd_m2", rule)
        if self.luminance_cd_m2 is None and missing:
            first = missing[0] if len(missing) == 1 else "luminance_cd_m2"
            raise VoccError(
                f"scene.effects.{self.name}.{first} is missing: "
                "give luminance_cd_m2, or glare_illuminance_lx with angle_deg"
            )
        Effect.__post_init__(self)

    @property
    def veil_cd_m2(self) -> float:
        """The luminance that is added, cd/m2."""
        if self.luminance_cd_m2 is not None:
            return self.luminance_cd_m2
        return 10.0 * (self.glare_illuminance_lx or 0.0) / (self.angle_deg or 1.0) ** 2

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Add the veil to (B,1,H,W) luminance."""
        return value + self.veil_cd_m2


AT_THE_LEDS = (RollingShutter, StuckLeds, LedScatter, colour.Colour, Attenuation)
ON_THE_WAY = (Airlight, Occlusion, VeilingGlare)
"""In physical order; what stands in the background comes between the two."""
