"""LEDs measured in whole pixels, without resampling: another reading of what a cell of the panel is."""

from typing import NamedTuple

import torch
from torch import Tensor

from vocc_torch.receiver.features import (
    Gradient,
    checked_greys,
    image_gradient,
    level_ratios,
)
from vocc_torch.types import Frames, PanelShape

GRAIN = 2.0**24
"""Parts of a grey value to which inwardness is rounded: sums of it are exact in any order of pixels."""


class Axis(NamedTuple):
    """The cells along one axis of the image, a cell of margin at both ends included.

    Args:
        pixels: (B,N) int64, columns or rows of the frame.
        member: (B,L+2,N) float64, 1 where a pixel belongs to a cell.
        towards: (B,N) float64, from a pixel's middle to the middle of its cell, px.
        centre: (B,L) int64, the pixel at the rounded centre of each LED's cell.
    """

    pixels: Tensor
    member: Tensor
    towards: Tensor
    centre: Tensor

    @classmethod
    def of(cls, low: Tensor, high: Tensor, leds: int, size: int) -> "Axis":
        """Divide boxes (B,1) from ``low`` to ``high``, px from the frame's first, of a frame of ``size``."""
        first, last = (end.clamp(-size, 2 * size) for end in (low, high))
        cells = torch.arange(-1, leds + 2).to(low)
        step = (last - first) / leds
        edges = (first + cells * step).round()
        start = edges[:, :1] - 1
        places = start + torch.arange(int((edges[:, -1:] - start).max()) + 1).to(low)
        inside = places[:, None] >= edges[:, :-1, None]
        member = (inside & (places[:, None] < edges[:, 1:, None])).double()
        middles = (edges[:, 1:] + edges[:, :-1]) / 2
        towards = torch.einsum("bcn,bc->bn", member, middles) - places - 0.5
        centre = first + (cells[1:-2] + 0.5) * step
        pixels, centre = (at.round().clamp(0, size - 1) for at in (places, centre))
        return cls(pixels.long(), member, towards, centre.long())


def read_pixels(
    frames: Frames,
    corners_px: Tensor,
    shape: PanelShape,
    disc_share: float,
    gradient: Gradient,
) -> dict[str, Tensor]:
    """Measure every LED in whole pixels of the box about the LEDs' discs: (B,R,C) float64 by name.

    AGR, GRI and NGR are the features, ``average`` is the mean grey of the LED's cell, and ``centre`` the grey of
    the pixel at its rounded centre.

    The box reaches from the first disc's edge to the last one's, both rounded to whole pixels. Its cells are equal,
    with rounded edges too. The vectors of Eq. 8 point from a pixel's middle to the middle of its cell.

    Args:
        frames: B frames.
        corners_px: (B,4,2) corners of the grid of LED cells; a turned panel has an upright box.
        shape: rows and columns.
        disc_share: an LED's diameter over the pitch, above 0 to 1.
        gradient: see :func:`vocc_torch.receiver.features.image_gradient`.

    Raises:
        VoccError: a value that is no grey value.

    Example:
        >>> frames = Frames.whole(torch.full((1, 1, 40, 40), 50, dtype=torch.uint8))
        >>> corners = torch.tensor([[[8.0, 8.0], [32.0, 8.0], [32.0, 32.0], [8.0, 32.0]]])
        >>> measures = read_pixels(frames, corners, PanelShape(4, 4), 0.5, "central")
        >>> {name: value[0, 0, 0].item() for name, value in measures.items()}
        {'agr': 1.0, 'gri': 0.0, 'ngr': 1.0, 'average': 50.0, 'centre': 50.0}
    """
    corners = corners_px.double() - frames.origin_px[:, None]
    low, high = corners.amin(1), corners.amax(1)
    leds = low.new_tensor([shape.columns, shape.rows])
    inset = (high - low) / leds * (1 - disc_share) / 2
    height, width = frames.grey.shape[-2:]
    first, last = (low + inset).round(), (high - inset).round()
    x = Axis.of(first[:, :1], last[:, :1], shape.columns, width)
    y = Axis.of(first[:, 1:], last[:, 1:], shape.rows, height)
    batch = torch.arange(len(corners), device=corners.device)[:, None, None]
    plane = frames.grey[:, 0].double()
    grey = plane[batch, y.pixels[:, :, None], x.pixels[:, None]]
    centre = plane[batch, y.centre[:, :, None], x.centre[:, None]]
    counts = y.member.sum(2)[:, :, None] * x.member.sum(2)[:, None]

    def means(values: Tensor) -> Tensor:
        summed = torch.einsum("brh,bhw,bcw->brc", y.member, values, x.member)
        return summed / counts.clamp(min=1)

    levels = checked_greys(means(grey), "cell means")
    slope_x, slope_y = image_gradient(grey[:, None], gradient).unbind(1)
    across, down = x.towards[:, None], y.towards[:, :, None]
    inward = (slope_x * across + slope_y * down) / torch.hypot(across, down).clamp(
        min=0.5
    )
    gri = means((inward * GRAIN).round() / GRAIN)[:, 1:-1, 1:-1]
    agr, ngr = level_ratios(levels).unbind(1)
    average = levels[:, 1:-1, 1:-1]
    return {"agr": agr, "gri": gri, "ngr": ngr, "average": average, "centre": centre}
