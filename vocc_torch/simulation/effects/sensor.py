"""The sensor: colour filters, electrons, their noise and their readout, after EMVA Standard 1288.

NumPy draws random planes on the CPU whatever the device, tile by tile of the sensor, each from a stream of
its own. So neither the batch nor the device nor other effects change them, and a crop has the very numbers
that the full frame has there, for the price of the tiles that it touches.
"""

import functools
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.random import Generator
from torch import Tensor

from vocc_torch.arrays import Numbers, Singles
from vocc_torch.errors import VoccError
from vocc_torch.hardware import Camera
from vocc_torch.rng import FrameKey, sensor_generator
from vocc_torch.simulation.effects.base import (
    Context,
    Effect,
    Quantity,
    of_kind,
    within,
)
from vocc_torch.simulation.effects.colour import CHANNELS
from vocc_torch.simulation.effects.poisson import poisson_quantile

PLANCK_J_S = 6.62607015e-34
SPEED_OF_LIGHT_M_S = 299_792_458.0
LUMENS_PER_WATT = 683.0
"""Luminous efficacy of light at 555 nm, the greatest there is."""

CONVERSIONS = (1e-12, 1e15)
"""Fewest and most electrons per lx s on offer: safe in float32 both ways, and wider than any camera's."""

NO_NOISE = "leave the effect out for none"


class Bayer(Effect, on=Quantity.EXPOSURE):
    """Bayer's mosaic: each pixel gets the share of the light that its filter lets through.

    Cells of 2 x 2 pixels, red and green over green and blue, begin at the sensor's top left pixel. Without
    ``colour`` all light is taken to be of one colour, as that of white LEDs and daylight nearly is, so a
    filter is one number; with it each filter takes the light of its channel. Named alone it leaves the raw
    mosaic; ``demosaicing`` balances and interpolates it after the readout, and what the filters took from the
    light then comes back as noise.

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
    fills_sensor = True

    def filters(self, like: Tensor, context: Context) -> Tensor:
        """The share that each pixel's filter lets through.

        Args:
            like: (B,1,H,W), for its shape, precision and device.
            context: says where each frame lies on the sensor.

        Returns:
            (B,1,H,W).
        """
        cell = [[self.red, self.green], [self.green, self.blue]]
        return mosaic(cell, like, context)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Filter (B,1,H,W) luminous exposure; of (B,3,H,W) each filter takes its own channel."""
        if value.shape[1] == len(CHANNELS):
            value = value.gather(1, mosaic([[0, 1], [1, 2]], value, context).long())
        return value * self.filters(value, context)


def mosaic(
    cell_of: Sequence[Sequence[float]], like: Tensor, context: Context
) -> Tensor:
    """Lay a cell of 2 x 2 numbers over each frame (B,C,H,W) as the sensor's cells lie, (B,1,H,W)."""
    x, y = context.pixels((like.shape[-2], like.shape[-1]))
    cell = torch.tensor(cell_of, dtype=like.dtype, device=x.device)
    return cell[y % 2, x % 2].to(like.device)


class Photoelectrons(Effect, on=Quantity.EXPOSURE, to=Quantity.ELECTRONS):
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
    luminous_efficacy_lm_w: float = within(
        0, LUMENS_PER_WATT, default=LUMENS_PER_WATT, above=True
    )

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
            raise VoccError(
                f"scene.effects.photoelectrons "
                f"makes {electrons:g} electrons per lx s in pixels of {pitch_m * 1e6:g} um: "
                f"it must be {fewest:g} to {most:g}"
            )
        return electrons

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Turn (B,1,H,W) luminous exposure into mean electrons."""
        return value * self.electrons_per_lx_s(context.camera)


TILE_PX = 128
"""Side of the squares that are drawn by themselves."""

TILE = TILE_PX, TILE_PX
"""Shape of such a square."""

DrawTile = Callable[[int, int, int], Numbers]
"""Gives the tile of a row and a column of tiles, down to so many of its rows."""


@dataclass(frozen=True)
class TileSettings:
    """How much is counted at a time, and how much is held."""

    part_values: int = 1 << 17  # counted at a time: working arrays stay in the cache
    # Tiles of patterns that are held, 64 KiB each: of a full-HD sensor 135 a pattern and
    # channel.
    most_tiles: int = 1024


SETTINGS = TileSettings()


class ElectronNoise(Effect, on=Quantity.ELECTRONS):
    """Random numbers on the electrons of each pixel; it fills the sensor."""

    sampled = fills_sensor = True

    def tiled(
        self,
        value: Tensor,
        context: Context,
        tiles: Callable[[FrameKey, str], DrawTile],
    ) -> Numbers:
        """Lay the tiles together that each frame touches, (B,H,W).

        Args:
            value: (B,1,H,W), the frames.
            context: names them and says where each lies on the sensor.
            tiles: gives what draws the tiles of a frame's stream.

        Raises:
            VoccError: frames without keys.
        """
        stream, planes = f"effect.{self.name}{context.sensor}", []
        (height, width), keys = value.shape[-2:], context.keys_for(self.name)
        for key, (left, top) in zip(keys, context.first_px.tolist(), strict=True):
            draw, end = tiles(key, stream), top + height
            lines = [
                [
                    draw(row // TILE_PX, column // TILE_PX, end - row)
                    for column in range(left - left % TILE_PX, left + width, TILE_PX)
                ]
                for row in range(top - top % TILE_PX, end, TILE_PX)
            ]
            plane: Numbers = np.block(lines)[top % TILE_PX :, left % TILE_PX :]
            planes.append(plane[:, :width])
        # A full frame is alone, and not copied.
        return np.stack(planes) if len(planes) > 1 else planes[0][None]

    def normals(
        self, value: Tensor, context: Context, dtype: type[np.floating[Any]]
    ) -> Numbers:
        """Standard normal numbers of each picture, (B,H,W)."""

        def tiles(key: FrameKey, stream: str) -> DrawTile:
            generator: Callable[[int, int], Any] = key.tiles(stream)
            return lambda row, column, rows: generator(row, column).standard_normal(
                (min(rows, TILE_PX), TILE_PX), dtype
            )

        return self.tiled(value, context, tiles)


class SensorPattern(ElectronNoise):
    """A pattern of the sensor itself: keyed by the run's seed and the pixel's place, by nothing else."""

    @abstractmethod
    def tile(self, generator: Generator) -> Singles:
        """Draw one tile; always the same from the same numbers."""

    def pattern(self, value: Tensor, context: Context) -> Tensor:
        """Each frame's part of the pattern, (B,1,H,W) in shape, type and device of ``value``.

        Raises:
            VoccError: frames without keys.
        """

        def tiles(key: FrameKey, stream: str) -> DrawTile:
            seed = key.block.seed
            return lambda row, column, rows: pattern_tile(
                self, seed, f"{stream}/{row}/{column}"
            )[:rows]

        drawn = torch.from_numpy(self.tiled(value, context, tiles))
        return drawn.unsqueeze(1).to(value)


@functools.lru_cache(SETTINGS.most_tiles)
def pattern_tile(pattern: SensorPattern, seed: int, place: str) -> Singles:
    """Draw one tile of a pattern, which never changes in a run."""
    return pattern.tile(sensor_generator(seed, place))


class Prnu(SensorPattern):
    """Unequal response of pixels, ``mu_e (1 + s z)`` with z standard normal, fixed during a run.

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

    def tile(self, generator: Generator) -> Singles:
        """Draw the response of each pixel."""
        normals = generator.standard_normal(TILE, dtype=np.float32)
        return (1 + np.float32(self.share) * normals).clip(min=0)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Multiply (B,1,H,W) electrons by each pixel's response."""
        return value * self.pattern(value, context)


class DarkCurrent(Effect, on=Quantity.ELECTRONS):
    """Mean dark signal ``mu_d = mu_I t`` in electrons, with exposure time t.

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

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Add the mean dark signal to (B,1,H,W) electrons."""
        return value + self.electrons_per_s * context.camera.exposure_time_s


class HotPixels(SensorPattern):
    """Hot pixels: with the probability ``share`` a pixel has ``electrons_per_s t`` more electrons.

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

    def tile(self, generator: Generator) -> Singles:
        """Draw which pixels are hot, 0 or 1."""
        return (generator.random(TILE) < self.share).astype(np.float32)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Add the hot pixels' charge to (B,1,H,W) electrons."""
        charge = self.electrons_per_s * context.camera.exposure_time_s
        return torch.add(value, self.pattern(value, context), alpha=charge)


class ShotNoise(ElectronNoise):
    """Photon shot noise: Poisson distributed electrons, ``P(n) = mu^n exp(-mu) / n!``.

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

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Draw counts of the mean (B,1,H,W) electrons.

        Raises:
            VoccError: a mean that is not a number.
        """
        # Rounding in an earlier effect may leave a black pixel a hair below zero.
        means = value.detach().cpu().clamp(min=0).double().squeeze(1).numpy()
        if np.isnan(means.sum()):
            raise VoccError(
                f"scene.effects.{self.name} got a mean of electrons that is not a number"
            )
        normals = self.normals(value, context, np.float64)
        several = -(-means.size // SETTINGS.part_values)
        parts = (np.array_split(plane.ravel(), several) for plane in (means, normals))
        counts = np.concatenate([*map(poisson_quantile, *parts)])
        return torch.from_numpy(counts).view(value.shape).to(value)


class FullWell(Effect, on=Quantity.ELECTRONS):
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

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Clip (B,1,H,W) electrons."""
        return value.clamp(max=self.electrons)


class Dsnu(SensorPattern):
    """Unequal offset of pixels, ``s z`` electrons with z standard normal, fixed during a run.

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

    electrons: float = within(0, 100_000, above=True, hint=NO_NOISE)

    def tile(self, generator: Generator) -> Singles:
        """Draw each pixel's offset, electrons."""
        return np.float32(self.electrons) * generator.standard_normal(
            TILE, dtype=np.float32
        )

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Add each pixel's offset to (B,1,H,W) electrons."""
        return value + self.pattern(value, context)


class RowNoise(ElectronNoise):
    """Row noise: an offset of ``s z`` electrons per sensor row, z standard normal.

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

    electrons: float = within(0, 100_000, above=True, hint=NO_NOISE)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Add to (B,1,H,W) electrons the offsets of the rows that each frame shows."""
        height, sensor_rows = value.shape[-2], context.camera.height_px
        drawn = context.draws(
            f"{self.name}{context.sensor}",
            lambda g: g.standard_normal(sensor_rows, dtype=np.float32),
        )
        shown = context.first_px[:, 1:] + torch.arange(height, device=drawn.device)
        rows = drawn.gather(1, shown).view(-1, 1, height, 1)
        return value + self.electrons * rows.to(value)


class ReadNoise(ElectronNoise):
    """Gaussian noise of each pixel, ``s z`` electrons with z standard normal, new in every frame.

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

    electrons: float = within(0, 100_000, above=True, hint=NO_NOISE)

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Add noise, drawn in float32, to (B,1,H,W) electrons."""
        noise = self.normals(value, context, np.float32)
        noise *= np.float32(self.electrons)
        return value + torch.from_numpy(noise).unsqueeze(1).to(value)


class Gain(Effect, on=Quantity.ELECTRONS, to=Quantity.EXPOSURE):
    """Convert electrons back to luminous exposure, ``H = mu_e / k``.

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

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Turn (B,1,H,W) electrons into luminous exposure."""
        maker = of_kind(context.effects, Photoelectrons)
        assert maker is not None
        return value.clamp(min=0) / maker.electrons_per_lx_s(context.camera)


EFFECTS = (
    Bayer,
    Photoelectrons,
    Prnu,
    DarkCurrent,
    HotPixels,
    ShotNoise,
    FullWell,
    Dsnu,
    RowNoise,
    ReadNoise,
    Gain,
)
"""In physical order."""
