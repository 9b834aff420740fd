"""What stands around the panel and before it: texture, lamps, another panel, fog, obstacles and glare."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.fft
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects.base import BRIGHTEST, Context, Effect, Extent, Quantity
from vocc_torch.simulation.effects.light import dimmed_once
from vocc_torch.simulation.effects.second_panel import SecondPanel
from vocc_torch.simulation.geometry import Camera, panel_corners_m
from vocc_torch.simulation.perspective import view_of
from vocc_torch.simulation.photometry import reflected_luminance_cd_m2
from vocc_torch.simulation.raster import disc_quadrant_area, interval_cover

MOST_LAMPS = 1000
"""Most lamps in a frame."""

CONTRAST_AT_VISIBILITY = 0.02
"""Share of a contrast that is left at the visibility distance, by that distance's definition."""

NO_GLARE = "leave the effect out for no glare"


def power_law_noise(
    generator: np.random.Generator, size: tuple[int, int], beta: float
) -> NDArray[np.float32]:
    """Gaussian noise of mean 0 and variance 1 whose power falls with spatial frequency as ``1 / f^beta``.

    Each Fourier coefficient is drawn by itself and weighted by ``f^(-beta/2)``, f being the length of the
    frequency vector in cycles a pixel; the coefficient at f = 0 is zero. The noise is periodic in the size.

    Args:
        generator: the source of randomness.
        size: height and width, px.
        beta: exponent, at least 0; 0 is white noise.

    Returns:
        (height, width); mean and variance hold for these very pixels, to float32 rounding.

    Example:
        >>> noise = power_law_noise(np.random.default_rng(0), (48, 64), beta=2.0)
        >>> noise.shape, round(float(noise.std()), 4)
        ((48, 64), 1.0)
    """
    height, width = size
    across, down = np.fft.rfftfreq(width), np.fft.fftfreq(height)
    squared = down.astype(np.float32)[:, None] ** 2 + across.astype(np.float32) ** 2
    squared[0, 0] = 1.0
    weight = squared ** np.float32(-beta / 4)
    weight[0, 0] = 0.0
    # These columns stand for themselves, every other one also for its mirror image.
    alone = [0, -1] if width % 2 == 0 else [0]
    weight[:, alone] *= np.float32(math.sqrt(2))
    parts = generator.standard_normal((*weight.shape, 2), dtype=np.float32)
    spectrum = parts.view(np.complex64)[..., 0] * weight
    plane: NDArray[np.float32] = scipy.fft.irfft2(spectrum, s=size, overwrite_x=True)
    rms = math.sqrt(float(np.square(plane).mean(dtype=np.float64)))
    return plane * np.float32(1 / rms if rms > 0 else 0)


@dataclass(frozen=True, slots=True)
class BackgroundTexture(Effect):
    """Background luminance times a texture of mean 1, ``exp(s g) / mean(exp(s g))``, ``s^2 = ln(1 + c^2)``.

    g is :func:`power_law_noise` over the whole sensor and c the contrast. The texture is log-normal, as the
    luminances of natural scenes nearly are, so it is never negative; its logarithm has the power law. Its
    mean over the sensor is 1, so auto-ISO meters the same background. It lies behind the panel: board and
    LEDs cover it, and where the panel has no board it shows between the LEDs. It is drawn on the sensor's
    grid, a crop being a part of it, and a frame and its preambles share it. Sampled: the texture is a
    constant to automatic differentiation, and the light keeps its gradient.

    Source: D. J. Field, "Relations between the statistics of natural images and the response properties of
    cortical cells", J. Opt. Soc. Am. A 4, 1987; D. L. Ruderman, "The statistics of natural images",
    Network 5, 1994.

    Args:
        contrast: root-mean-square contrast, standard deviation over mean, above 0 and at most 1; natural
            scenes have 0.2 to 0.5. The logarithm's is exact; so a frame's own is within 5 % of it at 0.3.
        beta: exponent of the power spectrum, 0 to 4; natural images have about 2, 0 is white noise.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> BackgroundTexture(contrast=0.3).beta
        2.0
    """

    contrast: float
    beta: float = 2.0

    name = "background_texture"
    takes = gives = Quantity.BACKGROUND
    sampled = fills_sensor = True

    def __post_init__(self) -> None:
        """Check the ranges."""
        self.demand("contrast", 0, 1, above=True, hint="leave the effect out for a uniform background")
        self.demand("beta", 0, 4)

    def texture(self, generator: np.random.Generator, sensor_px: tuple[int, int]) -> NDArray[np.float32]:
        """Draw one frame's texture on the whole sensor, (height, width), mean 1."""
        log_sigma = np.float32(math.sqrt(math.log1p(self.contrast**2)))
        texture: NDArray[np.float32] = np.exp(log_sigma * power_law_noise(generator, sensor_px, self.beta))
        return texture * np.float32(1 / texture.mean(dtype=np.float64))

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Multiply (B,1,H,W) background luminance by each frame's texture."""
        height, width = value.shape[-2:]
        frames = zip(context.generators(self.name, of_scene=True), context.origins(), strict=True)
        parts = [
            torch.from_numpy(self.texture(generator, context.camera.sensor_px))[y : y + height, x : x + width]
            for generator, (x, y) in frames
        ]
        return value * torch.stack(parts).unsqueeze(1).to(value)


@dataclass(frozen=True, slots=True)
class Lamps(Effect):
    """Round lamps at random places behind the panel, each covering the exact area of its disc.

    The centres are uniform over the sensor, so a border may cut a lamp. A lamp's image has the diameter that
    the pinhole camera gives it at the panel's distance. Board and LEDs cover a lamp behind them; one lamp
    covers another, their edges in one pixel taken as independent. More lamps keep the places of fewer; a
    frame and its preambles share them. Sampled: not differentiable in places nor in size; the light of the
    background keeps its gradient.

    Source: the pinhole camera; luminance does not change with distance in clear air. The scene's
    ``attenuation`` dims a lamp as it does our LEDs, or ``airlight`` does, with the whole background.

    Args:
        count: lamps in a frame, a whole number from 1 to 1000.
        luminance_cd_m2: of a lamp, cd/m2, above 0 and at most 1e12; tail and street lamps have 1e3 to 1e5,
            headlamps seen in their beam 1e6 and more, the sun 1.6e9.
        diameter_m: above 0 and at most 10.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> Lamps(count=5, luminance_cd_m2=20_000.0, diameter_m=0.2).fills_sensor
        True
    """

    count: int
    luminance_cd_m2: float
    diameter_m: float

    name = "lamps"
    takes = gives = Quantity.BACKGROUND
    sampled = fills_sensor = True

    def __post_init__(self) -> None:
        """Check the ranges."""
        self.demand_whole("count", 1, MOST_LAMPS)
        self.demand("luminance_cd_m2", 0, BRIGHTEST, above=True)
        self.demand("diameter_m", 0, 10, above=True)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Paint each frame's lamps onto its (B,1,H,W) background luminance."""
        camera, painted = context.camera, value.clone()
        radii = (self.diameter_m / 2 * camera.pixels_per_metre(context.scene.distance_m)).tolist()
        shining = torch.full_like(context.scene.distance_m, self.luminance_cd_m2).view(-1, 1, 1)
        light = dimmed_once(shining, context).flatten().tolist()
        generators = context.generators(self.name, of_scene=True)
        frames = zip(radii, context.origins(), light, generators, strict=True)
        for frame, (radius, origin, light_cd_m2, generator) in enumerate(frames):
            for across, down in generator.random((self.count, 2)).tolist():
                centre = (across * camera.width_px, down * camera.height_px)
                _paint(painted[frame, 0], centre, radius, origin, light_cd_m2)
        return painted


def _paint(
    plane: Tensor, centre: tuple[float, float], radius: float, origin: tuple[int, int], light_cd_m2: float
) -> None:
    """Paint one lamp onto the part of the sensor that ``plane`` shows, (H,W), in place."""
    height, width = plane.shape
    # The sensor's coordinates throughout, so that a crop gets the full frame's very numbers.
    left, top = (max(math.floor(c - radius), o) for c, o in zip(centre, origin, strict=True))
    right = min(math.ceil(centre[0] + radius), origin[0] + width)
    bottom = min(math.ceil(centre[1] + radius), origin[1] + height)
    if left >= right or top >= bottom:
        return
    x, y = (
        (torch.arange(low, high + 1, dtype=torch.float64, device=plane.device) - middle) / radius
        for low, high, middle in ((left, right, centre[0]), (top, bottom, centre[1]))
    )
    area = disc_quadrant_area(x, y).diff(dim=0).diff(dim=1) * radius**2
    cover = area.clamp(0, 1).to(plane.dtype)
    window = plane[top - origin[1] : bottom - origin[1], left - origin[0] : right - origin[0]]
    window.mul_(1 - cover).add_(cover * light_cd_m2)


@dataclass(frozen=True, slots=True)
class Airlight(Effect):
    """Koschmieder's law, ``L_seen = L T + L_air (1 - T)`` with ``T = exp(-3.912 d / V)``.

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

    visibility_m: float
    horizon_factor: float = 1.0

    name = "airlight"
    takes = gives = Quantity.UNLIT
    metered = True

    def __post_init__(self) -> None:
        """Check the ranges."""
        self.demand("visibility_m", 0, above=True)
        self.demand("horizon_factor", 0, 10)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Lay each frame's path of air before its (B,1,H,W) luminance without the LEDs' own light."""
        scene = context.scene
        depth = scene.distance_m * (math.log(CONTRAST_AT_VISIBILITY) / self.visibility_m)
        horizon = reflected_luminance_cd_m2(scene.ambient_lx, self.horizon_factor)
        kept, added = torch.exp(depth), horizon * -torch.expm1(depth)
        return value * kept.to(value.dtype).view(-1, 1, 1, 1) + added.to(value.dtype).view(-1, 1, 1, 1)


@dataclass(frozen=True, slots=True)
class Occlusion(Effect):
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

    width_share: float
    height_share: float
    reflectance: float = 0.04

    name = "occlusion"
    takes = gives = Quantity.LUMINANCE
    sampled = True

    def __post_init__(self) -> None:
        """Check the ranges."""
        for parameter in ("width_share", "height_share"):
            self.demand(parameter, 0, 2, above=True, hint="leave the effect out for a free view")
        self.demand("reflectance", 0, 1)

    def size_in_px(self, size_px: Extent, camera: Camera, nearest_m: float) -> Extent:
        """Height and width of the panel's image with half of the rectangle beyond it on every side."""
        height, width = size_px
        return height * (1 + self.height_share), width * (1 + self.width_share)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Hide a part of each frame's (B,1,H,W) luminance."""
        corners_m = panel_corners_m(context.panel).to(context.scene.distance_m.device)
        corners = view_of(context).points_px(corners_m)
        low, high = corners.amin(dim=1), corners.amax(dim=1)
        draws = np.stack([g.random(2) for g in context.generators(self.name, of_scene=True)])
        centre = low + torch.from_numpy(draws).to(low) * (high - low)
        shares = torch.tensor([self.width_share, self.height_share], dtype=torch.float64).to(low)
        reach = (high - low) * shares / 2
        low, high = centre - reach, centre + reach
        covers = []
        for axis, side in enumerate((context.camera.width_px, context.camera.height_px)):
            # Cut from the whole sensor, so that a crop gets the full frame's very numbers.
            steps = torch.arange(value.shape[3 - axis], device=low.device)
            whole = interval_cover(low[:, axis], high[:, axis], side)
            covers.append(whole.gather(1, context.first_px[:, axis : axis + 1] + steps))
        across, down = covers
        cover = (down.unsqueeze(-1) * across.unsqueeze(-2)).unsqueeze(1).to(value.dtype)
        surface = reflected_luminance_cd_m2(context.scene.ambient_lx, self.reflectance)
        return value * (1 - cover) + cover * surface.to(value.dtype).view(-1, 1, 1, 1)


def disability_glare_cd_m2(illuminance_lx: float, angle_deg: float) -> float:
    """Veiling luminance of a glare source by Stiles and Holladay, ``L_v = 10 E / theta^2``.

    Args:
        illuminance_lx: illuminance E by the source on the plane of the lens, lx, at least 0.
        angle_deg: angle theta between the source and the line of sight, degrees, 1 to 30.

    Returns:
        Veiling luminance, cd/m2. Source: CIE 146:2002, the equation without its term for age.

    Example:
        >>> disability_glare_cd_m2(40_000.0, 10.0)
        4000.0
    """
    return 10.0 * illuminance_lx / angle_deg**2


@dataclass(frozen=True, slots=True)
class VeilingGlare(Effect):
    """Light of the sun or of a lamp, scattered in windscreen and lens: one luminance added to every pixel.

    Give either the veil itself, where it is known, or the source's illuminance and angle, from which it
    follows by :func:`disability_glare_cd_m2`. That equation was measured on young human eyes and stands in
    for a dusty windscreen and lens; a clean lens scatters less. The angle to the panel stands for the whole
    frame, so the veil is uniform. The source itself is outside the view. Differentiable in the light.

    Source: CIE 146:2002, where the veil follows from its source.

    Args:
        luminance_cd_m2: the veil, cd/m2, above 0 and at most 1e12.
        glare_illuminance_lx: illuminance by the source on the plane of the lens, lx, above 0 and at most
            1e12; a low sun gives 10,000 to 80,000, an oncoming low beam 1 to 5.
        angle_deg: angle between the source and the line of sight, degrees, 1 to 30.

    Raises:
        VoccError: a value outside its range, neither of the two ways, or both.

    Example:
        >>> VeilingGlare(glare_illuminance_lx=40_000.0, angle_deg=10.0).veil_cd_m2
        4000.0
    """

    luminance_cd_m2: float | None = None
    glare_illuminance_lx: float | None = None
    angle_deg: float | None = None

    name = "veiling_glare"
    takes = gives = Quantity.LUMINANCE
    metered = True

    def __post_init__(self) -> None:
        """Check that the veil is given in one way, and the ranges."""
        key, source = f"scene.effects.{self.name}", (self.glare_illuminance_lx, self.angle_deg)
        if self.luminance_cd_m2 is not None:
            if source != (None, None):
                rule = "it must be left out where glare_illuminance_lx or angle_deg is given"
                raise VoccError(f"{key}.luminance_cd_m2 is {self.luminance_cd_m2:g}: {rule}")
            self.demand("luminance_cd_m2", 0, BRIGHTEST, above=True, hint=NO_GLARE)
            return
        if source == (None, None):
            rule = "give it, or glare_illuminance_lx with angle_deg"
            raise VoccError(f"{key}.luminance_cd_m2 is missing: {rule}")
        for name, value in zip(("glare_illuminance_lx", "angle_deg"), source, strict=True):
            if value is None:
                raise VoccError(f"{key}.{name} is missing: glare_illuminance_lx and angle_deg go together")
        self.demand("glare_illuminance_lx", 0, BRIGHTEST, above=True, hint=NO_GLARE)
        self.demand("angle_deg", 1, 30)

    @property
    def veil_cd_m2(self) -> float:
        """The luminance that is added."""
        if self.luminance_cd_m2 is not None:
            return self.luminance_cd_m2
        assert self.glare_illuminance_lx is not None
        assert self.angle_deg is not None
        return disability_glare_cd_m2(self.glare_illuminance_lx, self.angle_deg)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Add the veil to (B,1,H,W) luminance."""
        return value + self.veil_cd_m2


EFFECTS = (BackgroundTexture, Lamps, SecondPanel, Airlight, Occlusion, VeilingGlare)
"""In physical order."""
