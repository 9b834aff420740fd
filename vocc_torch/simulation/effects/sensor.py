"""The sensor: colour filters, electrons, their noise and their readout, after EMVA Standard 1288."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.hardware import Camera
from vocc_torch.simulation.effects import noise
from vocc_torch.simulation.effects.base import Context, Effect, Quantity, within
from vocc_torch.simulation.effects.noise import SensorPattern, poisson_quantile

PLANCK_J_S = 6.62607015e-34
SPEED_OF_LIGHT_M_S = 299_792_458.0
LUMENS_PER_WATT = 683.0
"""Luminous efficacy of light at 555 nm, the greatest there is."""

CONVERSIONS = (1e-12, 1e15)
"""Fewest and most electrons per lx s on offer: safe in float32 both ways, and wider than any camera's."""

NO_NOISE = "leave the effect out for none"


@dataclass(frozen=True, slots=True)
class Bayer(Effect):
    """Bayer's mosaic: each pixel gets the share of the light that its filter lets through.

    Cells of 2 x 2 pixels, red and green over green and blue, begin at the sensor's top left pixel. All
    light is taken to be of one colour, as that of white LEDs and daylight nearly is, so a filter is one
    number. Named alone it leaves the raw mosaic; ``demosaicing`` balances and interpolates it after the
    readout, and what the filters took from the light then comes back as noise.

    Linear and differentiable. It fills the sensor.

    Source: B. E. Bayer, US patent 3,971,065 (1976).

    Args:
        red: share that red filters let through, relative to ``photoelectrons``'s quantum efficiency,
            0.001 to 1; cameras that amplify red by 2 in daylight have 0.5.
        green: the same of green.
        blue: the same of blue.

    Raises:
        VoccError: a share outside its range.

    Example:
        >>> from vocc_torch.hardware import Camera
        >>> from vocc_torch.types import Scene
        >>> Bayer()(torch.ones(1, 1, 2, 4), Context(Scene.of(), Camera()))[0, 0].tolist()
        [[0.5, 1.0, 0.5, 1.0], [1.0, 0.625, 1.0, 0.625]]
    """

    red: float = within(0.001, 1, default=0.5)
    green: float = within(0.001, 1, default=1.0)
    blue: float = within(0.001, 1, default=0.625)

    name = "bayer"
    takes = gives = Quantity.EXPOSURE
    fills_sensor = True

    def filters(self, like: Tensor, context: Context) -> Tensor:
        """The share that each pixel's filter lets through.

        Args:
            like: (B,1,H,W), for its shape, precision and device.
            context: says where each frame lies on the sensor.

        Returns:
            (B,1,H,W).
        """
        height, width = like.shape[-2:]
        cell = torch.tensor([[self.red, self.green], [self.green, self.blue]], dtype=like.dtype)
        places = [(x % 2, y % 2) for x, y in context.first_px.tolist()]
        planes = {}
        for x, y in set(places):
            cells = cell.roll((-y, -x), (0, 1)).repeat(height // 2 + 1, width // 2 + 1)
            planes[x, y] = cells[:height, :width].to(like.device)
        if len(planes) == 1:
            return planes[places[0]].expand_as(like)
        return torch.stack([planes[place] for place in places]).unsqueeze(1)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Filter (B,1,H,W) luminous exposure."""
        return value * self.filters(value, context)


@dataclass(frozen=True, slots=True)
class Photoelectrons(Effect):
    """Mean number of electrons that a pixel collects, ``mu_e = eta H A lambda / (K h c)``.

    H is the luminous exposure in lx s, ``H / K`` the radiant exposure in J/m2 by the luminous efficacy K, A
    the area of a square pixel of the camera's pitch and ``h c / lambda`` the energy of a photon. H and the
    defaults count light as if it all were at 555 nm, where a lumen takes fewest photons: the noisiest case.
    The paper's camera then collects 1.2e5 electrons per lx s at a quantum efficiency of 0.6.

    Linear and differentiable. Effects that take electrons need it; ``gain`` leads back to luminous exposure.

    Source: EMVA Standard 1288, release 4.0 Linear, linear signal model.

    Args:
        quantum_efficiency: electrons per photon that meets the pixel's area, fill factor and colour filter
            included, above 0 and at most 1.
        wavelength_nm: of the light, nm, 380 to 780.
        luminous_efficacy_lm_w: of the light, lm/W, above 0 and at most 683; white LEDs have about 300.

    Raises:
        VoccError: a value outside its range; when called, too few or too many electrons per lx s.

    Example:
        >>> round(Photoelectrons(quantum_efficiency=0.6).electrons_per_lx_s(Camera()))
        116009
    """

    quantum_efficiency: float = within(0, 1, above=True)
    wavelength_nm: float = within(380, 780, default=555.0)
    luminous_efficacy_lm_w: float = within(0, LUMENS_PER_WATT, default=LUMENS_PER_WATT, above=True)

    name = "photoelectrons"
    takes = Quantity.EXPOSURE
    gives = Quantity.ELECTRONS

    def electrons_per_lx_s(self, camera: Camera) -> float:
        """Electrons that one lx s of luminous exposure yields in a pixel of this camera.

        Raises:
            VoccError: fewer than 1e-12 or more than 1e15, which only a strange pixel pitch gives.
        """
        pitch_m = camera.sensor_width_mm / 1000 / camera.width_px
        photon_j = PLANCK_J_S * SPEED_OF_LIGHT_M_S / (self.wavelength_nm * 1e-9)
        photons = pitch_m**2 / photon_j / self.luminous_efficacy_lm_w
        electrons, (fewest, most) = self.quantum_efficiency * photons, CONVERSIONS
        if not fewest <= electrons <= most:
            made = f"makes {electrons:g} electrons per lx s in pixels of {pitch_m * 1e6:g} um"
            raise VoccError(f"scene.effects.photoelectrons {made}: it must be {fewest:g} to {most:g}")
        return electrons

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Turn (B,1,H,W) luminous exposure into mean electrons."""
        return value * self.electrons_per_lx_s(context.camera)


class ElectronEffect(Effect):
    """An effect on the electrons of each pixel."""

    takes = gives = Quantity.ELECTRONS


class ElectronNoise(ElectronEffect):
    """Random numbers on the electrons of each pixel; it fills the sensor."""

    sampled = fills_sensor = True


@dataclass(frozen=True, slots=True)
class AddedNoise(ElectronNoise):
    """Noise of a stated deviation, added to the electrons.

    Args:
        electrons: standard deviation, above 0 and at most 100,000.
    """

    electrons: float = within(0, 100_000, above=True, hint=NO_NOISE)

    @abstractmethod
    def noise(self, value: Tensor, context: Context) -> Tensor:
        """Draw the noise of (B,1,H,W) electrons, in a shape that broadcasts to theirs."""

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Add noise to (B,1,H,W) electrons."""
        return value + self.noise(value, context)


@dataclass(frozen=True, slots=True)
class Prnu(ElectronNoise):
    """Each pixel's own response, ``mu_e (1 + s z)`` with z standard normal, the same in every frame of a run.

    The pattern belongs to the sensor: it follows from the run's seed and the pixel's place alone, so
    training frames, test frames and preambles all carry it. It multiplies what light frees, before dark
    current and noise. A response below zero is none (at ``share`` 0.2, one pixel in 3.5 million).

    Linear in the light and differentiable. It fills the sensor.

    Source: EMVA Standard 1288, release 4.0 Linear, spatial nonuniformity (PRNU).

    Args:
        share: standard deviation of the response as a share of its mean, above 0 and at most 0.2; EMVA's
            PRNU in per cent over 100, for sensors on sale 0.003 to 0.02.

    Raises:
        VoccError: a share outside its range.

    Example:
        >>> Prnu(share=0.01).fills_sensor
        True
    """

    share: float = within(0, 0.2, above=True, hint=NO_NOISE)
    _pattern: SensorPattern = field(default_factory=SensorPattern, init=False, repr=False, compare=False)

    name = "prnu"

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Multiply (B,1,H,W) electrons by each pixel's response."""
        share = np.float32(self.share)
        return value * self._pattern.planes(
            value, context, self.name, lambda tile: (1 + share * noise.standard_normals(tile)).clip(min=0)
        )


@dataclass(frozen=True, slots=True)
class DarkCurrent(ElectronEffect):
    """Mean dark signal ``mu_d = mu_I t`` on top of the photoelectrons, t being the exposure time.

    The number of thermal electrons is Poisson distributed too: where the scene names ``shot_noise``, which
    follows, it covers them. At the paper's 1/1500 s a dark current matters from some 10,000 electrons a
    second on.

    Linear and differentiable; every pixel gets the same.

    Source: EMVA Standard 1288, release 4.0 Linear, dark current.

    Args:
        electrons_per_s: dark current of a pixel, above 0 and at most 1e9; a cooled sensor has less than 1, a
            warm small pixel 10 to 1000.

    Raises:
        VoccError: a dark current outside its range.

    Example:
        >>> DarkCurrent(electrons_per_s=100.0).name
        'dark_current'
    """

    electrons_per_s: float = within(0, 1e9, above=True, hint=NO_NOISE)

    name = "dark_current"

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Add the mean dark signal to (B,1,H,W) electrons."""
        return value + self.electrons_per_s * context.camera.exposure_time_s


@dataclass(frozen=True, slots=True)
class HotPixels(ElectronNoise):
    """Pixels that each are hot with the same probability, with ``mu_I t`` electrons more than the others.

    Which pixels are hot belongs to the sensor: it follows from the run's seed and the pixel's place alone. A
    pixel that is hot at one share is hot at every larger one. Shot noise, which follows, covers their charge.

    The light keeps its gradient. It fills the sensor.

    Source: EMVA Standard 1288, release 4.0 Linear, defect pixel characterisation.

    Args:
        share: probability that a pixel is hot, above 0 and at most 1; sensors on sale have 1e-6 to 1e-3.
        electrons_per_s: their added dark current, above 0 and at most 1e9; at the paper's 1/1500 s it takes
            1.5 million to add 1000 electrons.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> HotPixels(share=1e-4, electrons_per_s=1e6).fills_sensor
        True
    """

    share: float = within(0, 1, above=True, hint=NO_NOISE)
    electrons_per_s: float = within(0, 1e9, above=True, hint=NO_NOISE)
    _pattern: SensorPattern = field(default_factory=SensorPattern, init=False, repr=False, compare=False)

    name = "hot_pixels"

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Add the hot pixels' charge to (B,1,H,W) electrons."""
        hot = self._pattern.planes(
            value, context, self.name, lambda tile: (tile.random(noise.TILE) < self.share).astype(np.float32)
        )
        return torch.add(value, hot, alpha=self.electrons_per_s * context.camera.exposure_time_s)


@dataclass(frozen=True, slots=True)
class ShotNoise(ElectronNoise):
    """Poisson distributed electrons, variance equal to the mean: ``P(n) = mu^n exp(-mu) / n!``.

    Exact at every mean: each pixel's standard normal number is put through the Poisson quantile function,
    with no normal approximation. So the pixel keeps its draw whatever its own mean and its neighbours' are,
    and scenes that differ in another effect stay paired.

    Sampled, and not differentiable: the counts are whole numbers, and carry no gradient. They are drawn on
    the CPU and moved. It fills the sensor.

    Source: EMVA Standard 1288, release 4.0 Linear, noise model.

    Example:
        >>> from vocc_torch.rng import BlockKey, FrameKey
        >>> from vocc_torch.hardware import Camera
        >>> from vocc_torch.types import Scene
        >>> context = Context(Scene.of(), Camera(), [FrameKey(BlockKey(0, "doc", 0), 0)])
        >>> electrons = ShotNoise()(torch.full((1, 1, 200, 200), 50.0), context)
        >>> round(float(electrons.mean()), 1), round(float(electrons.var()))
        (50.0, 50)
    """

    name = "shot_noise"

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Draw counts of the mean (B,1,H,W) electrons.

        Raises:
            VoccError: a mean that is not a number.
        """
        means = value.detach().to("cpu").squeeze(1).numpy()
        counts, normals = np.empty_like(means), np.empty(noise.TILE)
        frames = noise.picture_tiles(context, self.name, means.shape[1:])
        for mean, count, tiles in zip(means, counts, frames, strict=True):
            # Tile by tile the working arrays stay in the processor's cache.
            for part, generator in tiles:
                generator.standard_normal(out=normals[: part.rows])
                tile = mean[part.in_window].astype(np.float64)
                # Rounding in an earlier effect may leave a black pixel a hair below zero.
                np.maximum(tile, 0.0, out=tile)
                if np.isnan(tile).any():
                    got = "a mean number of electrons that is not a number"
                    raise VoccError(f"scene.effects.{self.name} got {got}")
                count[part.in_window] = poisson_quantile(tile, normals[part.in_tile])
        return torch.from_numpy(counts).unsqueeze(1).to(value)


@dataclass(frozen=True, slots=True)
class FullWell(ElectronEffect):
    """Clip the collected charge at the full-well capacity, ``min(n, n_sat)``; nothing spills to neighbours.

    It follows shot noise, so the noise of a full pixel vanishes, as at the end of a measured photon-transfer
    curve. The gradient is one below the capacity and zero above.

    Source: EMVA Standard 1288, release 4.0 Linear, signal saturation.

    Args:
        electrons: capacity, at least 1 and at most 1e9; pixels of 2 to 7 um hold 10,000 to 100,000.

    Raises:
        VoccError: a capacity outside its range.

    Example:
        >>> FullWell(electrons=30_000).name
        'full_well'
    """

    electrons: float = within(1, 1e9)

    name = "full_well"

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Clip (B,1,H,W) electrons."""
        return value.clamp(max=self.electrons)


@dataclass(frozen=True, slots=True)
class Dsnu(AddedNoise):
    """Each pixel's own offset, ``s z`` electrons with z standard normal, the same in every frame of a run.

    The pattern belongs to the sensor: it follows from the run's seed and the pixel's place alone. It is an
    offset of the readout, added after the charge is collected, so it has no shot noise; hot pixels, whose
    charge has, are an effect of their own.

    The light keeps its gradient. It fills the sensor.

    Source: EMVA Standard 1288, release 4.0 Linear, spatial nonuniformity (DSNU).

    Args:
        electrons: standard deviation of the offset, above 0 and at most 100,000; EMVA's DSNU in electrons.

    Raises:
        VoccError: a deviation outside its range.

    Example:
        >>> Dsnu(electrons=2.0).fills_sensor
        True
    """

    _pattern: SensorPattern = field(default_factory=SensorPattern, init=False, repr=False, compare=False)

    name = "dsnu"

    def noise(self, value: Tensor, context: Context) -> Tensor:
        """Each pixel's offset, (B,1,H,W) electrons."""
        sigma = np.float32(self.electrons)
        return self._pattern.planes(
            value, context, self.name, lambda tile: sigma * noise.standard_normals(tile)
        )


@dataclass(frozen=True, slots=True)
class RowNoise(AddedNoise):
    """An offset that all pixels of a sensor row share, ``s z`` electrons with z standard normal.

    It is drawn for all the sensor's rows, anew in every picture; a crop takes its own rows. The light keeps
    its gradient. It fills the sensor.

    Source: the temporal counterpart of the row nonuniformity of EMVA Standard 1288, release 4.0 Linear.

    Args:
        electrons: standard deviation of the offset, above 0 and at most 100,000.

    Raises:
        VoccError: a deviation outside its range.

    Example:
        >>> RowNoise(electrons=1.0).fills_sensor
        True
    """

    name = "row_noise"

    def noise(self, value: Tensor, context: Context) -> Tensor:
        """Draw the offsets of the rows that each frame shows, (B,1,H,1) electrons."""
        height, sensor_rows = value.shape[-2], context.camera.height_px
        rows = [
            torch.from_numpy(generator.standard_normal(sensor_rows, dtype=np.float32)[y : y + height])
            for generator, (_, y) in zip(
                context.generators(self.name), context.first_px.tolist(), strict=True
            )
        ]
        return self.electrons * torch.stack(rows).view(-1, 1, height, 1).to(value)


@dataclass(frozen=True, slots=True)
class ReadNoise(AddedNoise):
    """Gaussian noise of each pixel, ``s z`` electrons with z standard normal, anew in every picture.

    EMVA's temporal dark noise at zero exposure time: the intercept of the photon-transfer curve is its
    square. Readings may fall below zero. The light keeps its gradient. It fills the sensor.

    Source: EMVA Standard 1288, release 4.0 Linear, noise model.

    Args:
        electrons: root mean square, above 0 and at most 100,000; sensors on sale have 1 to 15.

    Raises:
        VoccError: a root mean square outside its range.

    Example:
        >>> ReadNoise(electrons=3.0).fills_sensor
        True
    """

    name = "read_noise"

    def noise(self, value: Tensor, context: Context) -> Tensor:
        """Draw the noise of each pixel, (B,1,H,W) electrons."""
        return noise.frame_normals(value, context, self.name, self.electrons)


@dataclass(frozen=True, slots=True)
class Gain(Effect):
    """The luminous exposure that a number of electrons stands for, ``H = mu_e / k``.

    k is the conversion of the scene's own ``photoelectrons``, in electrons per lx s, so the mean picture
    keeps its brightness and the noise becomes noise of exposure: its variance against its mean is a line of
    the slope ``1 / k``, the photon-transfer curve. The ISO speed multiplies afterwards, in gamma encoding
    (Eq. 1). A reading below zero, which read noise makes in the dark, is black: no black level is added.
    Neither is the mean dark signal taken off.

    Linear down to zero, and differentiable.

    Source: EMVA Standard 1288, release 4.0 Linear, linear signal model and noise model (overall system gain).

    Example:
        >>> Gain().takes.value, Gain().gives.value
        ('electrons', 'luminous exposure (lx s)')
    """

    name = "gain"
    takes = Quantity.ELECTRONS
    gives = Quantity.EXPOSURE

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Turn (B,1,H,W) electrons into luminous exposure."""
        maker = next(effect for effect in context.effects if isinstance(effect, Photoelectrons))
        return value.clamp(min=0) / maker.electrons_per_lx_s(context.camera)


ELECTRONS = (Photoelectrons, Prnu, DarkCurrent, HotPixels, ShotNoise, FullWell, Dsnu, RowNoise, ReadNoise)
EFFECTS = (Bayer, *ELECTRONS, Gain)
"""In physical order."""
