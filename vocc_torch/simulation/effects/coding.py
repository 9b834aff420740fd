"""From the sensor's readings to the picture that is written: demosaicing, clipping, rounding and JPEG."""

from dataclasses import dataclass

import numpy as np
import torch
from kornia.color import CFA, raw_to_rgb, rgb_to_grayscale, ycbcr_to_rgb
from kornia.enhance import jpeg_codec_differentiable
from numpy.random import Generator
from torch import Tensor, nn

from vocc_torch.errors import VoccError
from vocc_torch.hardware import Camera
from vocc_torch.simulation.effects.base import (
    Context,
    Effect,
    FrameEffect,
    Quantity,
    of_kind,
    within,
)
from vocc_torch.simulation.effects.colour import CHANNELS
from vocc_torch.simulation.effects.sensor import Bayer
from vocc_torch.simulation.scene import Distribution
from vocc_torch.simulation.sketch import letters_mask, words_of

PATTERNS = {(0, 0): CFA.BG, (1, 0): CFA.GB, (0, 1): CFA.GR, (1, 1): CFA.RG}
"""Kornia's names of how a frame's pattern begins, by the parity of its origin: red lies at even and even."""


@dataclass(frozen=True)
class CodingSettings:
    """How much is demosaiced and coded at a time: working arrays stay in the cache."""

    cell_px: int = 2  # of colour filters
    mosaic_rows: int = 64  # whole cells
    jpeg_block_px: int = 8
    jpeg_rows: int = 128  # whole blocks
    jpeg_pixels: int = 131_072  # of one frame or several


SETTINGS = CodingSettings()


NEUTRAL = 128 / 255
"""The chroma that the codec takes for none."""


class Demosaicing(Effect, on=Quantity.EXPOSURE):
    """White balance, bilinear interpolation of each colour, and luma ``0.299 R + 0.587 G + 0.114 B``.

    The balance divides each pixel by the share that its filter of the scene's own ``bayer`` lets through,
    so grey stays grey. What remains is what colour cameras do to a grey picture: two of three colours are
    guessed from neighbours, so edges lose sharpness, the more so in red and blue; and where noise came
    between, that of red and blue pixels is amplified and spread. Without ``bayer`` there is nothing to
    balance and the blur alone remains. A uniform frame stays uniform. In a scene in ``colour`` the three
    colours stay.

    It runs in float64, so that a frame does not depend on the batch it comes in. Linear and differentiable.

    Source: Kornia's ``raw_to_rgb`` and ``rgb_to_grayscale``; luma of ITU-R BT.601, which the recordings'
    grey is too.

    Example:
        >>> Demosaicing().reach_in_px(Camera(), 50.0)
        1
    """

    def reach_in_px(self, camera: Camera, nearest_m: float) -> int:
        """Neighbours at one pixel's distance are averaged."""
        return 1

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Balance and demosaic (B,1,H,W) luminous exposure.

        Raises:
            VoccError: a sensor without a whole cell of 2 x 2 pixels.
        """
        for name in ("width_px", "height_px"):
            if getattr(context.camera, name) < SETTINGS.cell_px:
                raise VoccError(
                    f"camera.{name} is {getattr(context.camera, name)}: "
                    f"it must be at least {SETTINGS.cell_px}: scene.effects.demosaicing reads cells of 2 x 2 pixels"
                )
        raw = value.double()
        if filters := of_kind(context.effects, Bayer):
            raw = raw / filters.filters(raw, context)
        coloured = context.channel is None and {"colour", "bayer"} <= {
            effect.name for effect in context.effects
        }
        planes = raw.new_empty(len(raw), 3 if coloured else 1, *raw.shape[2:])
        phases = (context.first_px % SETTINGS.cell_px).cpu()
        for phase in torch.unique(phases, dim=0):
            alike = (phases == phase).all(dim=1).to(raw.device)
            pattern = PATTERNS[phase[0].item(), phase[1].item()]
            planes[alike] = demosaiced(raw[alike], pattern, coloured)
        return planes.to(value.dtype)


def demosaiced(raw: Tensor, pattern: CFA, coloured: bool) -> Tensor:
    """Demosaic (B,1,H,W) frames of one pattern, strip by strip, each with the rows that its border needs.

    They are given as luma, (B,1,H,W), or ``coloured``, (B,3,H,W).

    Odd sides are continued by reflection, which keeps the pattern.
    """
    height, width = raw.shape[-2:]
    strips = []
    for top in range(0, height, SETTINGS.mosaic_rows):
        above = min(top, SETTINGS.cell_px)
        bottom = min(top + SETTINGS.mosaic_rows, height)
        strip = raw[..., top - above : bottom + SETTINGS.cell_px, :]
        odd = 0, width % SETTINGS.cell_px, 0, strip.shape[-2] % SETTINGS.cell_px
        rgb = raw_to_rgb(nn.functional.pad(strip, odd, mode="reflect"), pattern)
        planes = rgb if coloured else rgb_to_grayscale(rgb)
        strips.append(planes[..., above : above + bottom - top, :width])
    return torch.cat(strips, dim=-2)


class Saturation(Effect, on=Quantity.GREY, to=Quantity.BOUNDED_GREY):
    """Clip grey values at 255, the white of 8 bits.

    Differentiable; what is clipped carries no gradient.

    Source: the paper, Fig. 21, whose contrast is a share of 255.

    Example:
        >>> Saturation().gives.value
        'grey value, 0 to 255'
    """

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Clip (B,1,H,W) grey values."""
        return value.clamp(max=255.0)


class Letterbox(FrameEffect, on=Quantity.BOUNDED_GREY):
    """Black bars and a line of text that a recorder writes over the picture.

    Neither lens nor sensor sees it, so its edges are sharp and free of noise. Of the bars' frames half have
    them aside. Letters are those of a fixed bitmap, a whole number of times enlarged, white or black, near
    the upper or the lower border. It may cover the panel. A frame and its preambles share it. Sampled: not
    differentiable in the sizes; what is covered carries no gradient.

    Source: pictures of another shape than the screen's, and the stamps of dashboard cameras.

    Args:
        bar: share of the picture's height that bars above and below cover, or of its width for bars at
            the sides, a number or a distribution, 0 to 0.5.
        share: share of frames with bars, 0 to 1.
        lettering: share of frames with lettering, 0 to 1.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> Letterbox(bar=0.1, share=1.0).lettering
        0.0
    """

    bar: Distribution | float = within(
        0, 0.5, default=Distribution("uniform", (0.02, 0.15))
    )
    share: float = within(0, 1, default=0.2)
    lettering: float = within(0, 1, default=0.0)

    def frame(self, plane: Tensor, generator: Generator, context: Context) -> Tensor:
        """Cover a part of the frame's (C,H,W) grey values."""
        (left, top), (height, width) = (
            context.first_px[0].tolist(),
            context.camera.sensor_px,
        )
        rows = top + np.arange(plane.shape[1])
        columns = left + np.arange(plane.shape[2])
        bar = self.drawn("bar", generator) * (generator.random() < self.share)
        along, full = ((rows[:, None], height), (columns, width))[
            int(generator.random() < 0.5)
        ]
        mask = letters_mask(words_of(generator, generator.integers(8, 24)))
        times = max(1, round(height * generator.uniform(0.01, 0.04) / len(mask)))
        x, y, white = *generator.random(2), 255.0 * (generator.random() < 0.8)
        y = (0.01 if y < 0.5 else 0.98) * (height - times * len(mask))
        if bar:
            black = torch.from_numpy((along < bar * full) | (along >= (1 - bar) * full))
            plane = plane.masked_fill(black.to(plane.device), 0.0)
        if generator.random() < self.lettering:
            row = (rows - round(y)) // times + 1
            column = (columns - round(x * width * 0.5)) // times + 1
            bordered = np.pad(mask, 1)
            lit = bordered.take(row, 0, mode="clip").take(column, 1, mode="clip")
            plane = plane.masked_fill(torch.from_numpy(lit).to(plane.device), white)
        return plane


class Quantization(Effect, on=Quantity.BOUNDED_GREY, to=Quantity.DIGITAL):
    """Round grey values of 0 to 255 to ``2^bits`` levels, the nearest, ties to even.

    Black stays 0 and white 255, to the last bit. Not differentiable: the numbers are whole, and carry no
    gradient.

    Source: W. R. Bennett, "Spectra of Quantized Signals", Bell Syst. Tech. J. 27, 1948: the error of a signal
    that moves over many levels is uniform over one.

    Args:
        bits: 1 to 16; 8 bits give uint8 frames, other depths floating grey values on a coarser or finer grid.

    Raises:
        VoccError: a bit depth outside its range.

    Example:
        >>> Quantization(bits=8).levels
        256
    """

    bits: int = within(1, 16, default=8, whole=True)

    @property
    def levels(self) -> int:
        """Number of digital numbers."""
        return 1 << self.bits

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Quantise (B,1,H,W) grey values, half to even."""
        if self.bits == 8:
            return torch.round(value).to(torch.uint8)
        top = self.levels - 1
        # The product is a whole number that float32 holds, so white is 255 to the last bit.
        return torch.round(value * (top / 255.0)) * 255.0 / top


class Jpeg(Effect, on=Quantity.DIGITAL):
    """Encode and decode 8-bit frames by Kornia's differentiable JPEG codec.

    Blocks of 8 x 8 pixels are cosine transformed, divided by the standard's luminance table scaled by the
    quality, rounded and transformed back. The frame is the luma that goes in and comes out. Kornia's codec
    rounds softly, by ``round(x) + (x - round(x))^3``, and its tables with it, so that it stays near JPEG
    rather than being it: on noisy frames at qualities of 30 to 95 it differs from libjpeg by 0.6 grey levels
    in the mean and by up to 15, where JPEG itself changes the frame by 1.5 to 4. It errs on the gentle side:
    the root mean square of what coding changes was 5 % below libjpeg's at quality 50 and 19 % at 10.

    The blocks lie on the sensor's grid. It fills the sensor, since a crop off that grid would be coded
    otherwise, and such a crop is refused. One of whole blocks, or cut by the sensor, is coded as its part of
    the full frame, whatever the batch. Whole numbers in and out carry no gradient.

    Source: ITU-T T.81 (1992); C. Reich et al., "Differentiable JPEG: the devil is in the details", WACV 2024.

    Args:
        quality: libjpeg's scale, a whole number from 1 to 100.

    Raises:
        VoccError: a quality outside its range.

    Example:
        >>> Jpeg(quality=80).takes.value
        'digital number'
    """

    quality: int = within(1, 100, whole=True)
    fills_sensor = True

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Code (B,1,H,W) uint8 frames, or (B,3,H,W) with chroma of half the resolution.

        Raises:
            VoccError: crops off the grid of blocks.
        """
        for at in context.first_px.tolist():
            if any(start % SETTINGS.jpeg_block_px for start in at):
                raise VoccError(
                    f"scene.effects.jpeg got a crop at {at}, off the grid of {SETTINGS.jpeg_block_px} px"
                )
        height, width = value.shape[-2:]
        coded = torch.empty_like(value)
        quality = torch.tensor([float(self.quality)], device=value.device)
        coloured = value.shape[1] == len(CHANNELS)
        # Grey RGB would have a chroma of 127.5, whose rounding errors depend on the strip's size and reach
        # the luma. So the strips are tinted to the chroma that the codec takes for none.
        neutral = torch.tensor([0.5, NEUTRAL, NEUTRAL], device=value.device)
        tint = (ycbcr_to_rgb(neutral.view(3, 1, 1)) - 0.5) * (not coloured)
        pixels = min(height, SETTINGS.jpeg_rows) * width
        several = max(1, SETTINGS.jpeg_pixels // pixels)
        for frames, results in zip(
            torch.split(value, several), torch.split(coded, several), strict=True
        ):
            for strip, result in zip(
                torch.split(frames, SETTINGS.jpeg_rows, dim=2),
                torch.split(results, SETTINGS.jpeg_rows, dim=2),
                strict=True,
            ):
                light = jpeg_codec_differentiable(strip.float() / 255 + tint, quality)
                if not coloured:
                    # The codec clips its colours: red, brighter, is whole down to black, and green up to white.
                    red, green = light[:, :1] - tint[0], light[:, 1:2] - tint[1]
                    light = torch.where(green > 0.5, green, red)
                result.copy_(torch.round(light * 255.0).clamp(0, 255))
        return coded


EFFECTS = (Demosaicing, Saturation, Letterbox, Quantization, Jpeg)
"""In physical order."""
