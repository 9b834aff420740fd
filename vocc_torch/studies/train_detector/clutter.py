"""What stands behind the panels of the training frames: drawn shapes, lettering, lattices and photographs."""

import functools
import math
from dataclasses import dataclass
from importlib import resources

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from torch import Tensor

from vocc_torch.simulation.effects import Backdrop
from vocc_torch.simulation.effects.base import Context
from vocc_torch.simulation.sketch import words_of

Plane = NDArray[np.float32]
Generator = np.random.Generator

PHOTOGRAPHS = (
    "skimage.data/astronaut.png",
    "skimage.data/brick.png",
    "skimage.data/camera.png",
    "skimage.data/cell.png",
    "skimage.data/chelsea.png",
    "skimage.data/clock_motion.png",
    "skimage.data/coins.png",
    "skimage.data/color.png",
    "skimage.data/grass.png",
    "skimage.data/gravel.png",
    "skimage.data/hubble_deep_field.jpg",
    "skimage.data/ihc.png",
    "skimage.data/logo.png",
    "skimage.data/microaneurysms.png",
    "skimage.data/motorcycle_left.png",
    "skimage.data/page.png",
    "skimage.data/phantom.png",
    "skimage.data/retina.jpg",
    "skimage.data/rocket.jpg",
    "skimage.data/text.png",
    "sklearn.datasets.images/flower.jpg",
)
"""Training photographs. ``coffee``, ``china`` and ``horse`` are left to the validation."""

VALIDATION_PHOTOGRAPHS = (
    "skimage.data/coffee.png",
    "skimage.data/horse.png",
    "skimage.data/moon.png",
    "sklearn.datasets.images/china.jpg",
)


@functools.cache
def photograph(name: str) -> Plane:
    """Read a photograph's grey values, 0 to 1, from ``package/file``."""
    package, _, file = name.partition("/")
    with (
        resources.as_file(resources.files(package) / file) as path,
        Image.open(path) as picture,
    ):
        return np.asarray(picture.convert("L"), np.float32) / np.float32(255)


def crop_of(picture: Plane, size: tuple[int, int], draw: Generator) -> Plane:
    """Cut a random part of a photograph at a random scale, mirrored and turned at random, (H,W)."""
    least = min(picture.shape[0] / size[0], picture.shape[1] / size[1])
    scale = math.exp(draw.uniform(math.log(0.25), math.log(max(least, 0.3))))
    high, wide = (
        max(8, min(side, round(out * scale)))
        for side, out in zip(picture.shape, size, strict=True)
    )
    top = int(draw.integers(picture.shape[0] - high + 1))
    left = int(draw.integers(picture.shape[1] - wide + 1))
    part = picture[top : top + high, left : left + wide]
    part = part[:: int(draw.choice((-1, 1))), :: int(draw.choice((-1, 1)))]
    resized = Image.fromarray(np.ascontiguousarray(part)).resize(
        size[::-1], Image.Resampling.BICUBIC
    )
    return np.clip(np.asarray(resized, np.float32), np.float32(0), np.float32(1))


def drawing(draw: Generator, size: tuple[int, int]) -> Plane:
    """Draw rectangles, discs, bars, gratings, letters and lattices, grey values (H,W), 0 to 1."""
    high, wide = size
    plane = Image.new("L", (wide, high), int(draw.integers(10, 120)))
    pen = ImageDraw.Draw(plane)
    for _ in range(int(draw.integers(0, 25))):
        middle = draw.uniform(0, (wide, high))
        half = np.exp(draw.uniform(math.log(2), math.log(wide / 2), 2))
        box = [*(middle - half), *(middle + half)]
        shade = int(255 * draw.random() ** 2)
        kind = int(draw.integers(8))
        if kind < 2:
            pen.rectangle(box, fill=shade, outline=int(draw.integers(256)))
        elif kind == 2:
            pen.ellipse(box, fill=shade)
        elif kind == 3:
            pen.line(box, fill=shade, width=int(draw.integers(1, 8)))
        elif kind == 4:
            words = words_of(draw, int(draw.integers(2, 10)))
            pen.text(
                tuple(middle),
                words,
                fill=shade,
                font_size=float(np.clip(half[1], 6, 80)),
            )
        else:
            _lattice(pen, draw, middle, shade)
    return np.asarray(plane, np.float32) / np.float32(255)


def _lattice(
    pen: ImageDraw.ImageDraw, draw: Generator, start: NDArray[np.float64], shade: int
) -> None:
    """Draw a grating or a lattice of equal cells, some of them left out by a rule or at random."""
    step = math.exp(draw.uniform(math.log(2), math.log(24)))
    rows, columns = (int(count) for count in draw.integers(3, 20, 2))
    fill = draw.uniform(0.3, 0.95)
    kind = int(draw.integers(4))
    missing = 0.15 * float(draw.random() < 0.3)
    spread = 80 * float(draw.random() < 0.3)
    for row in range(rows):
        for column in range(columns if kind else 1):
            if draw.random() < missing or (kind == 3 and (row + column) % 2):
                continue
            left, top = start + step * np.array((column, row))
            right = left + step * (fill if kind else 8)
            box = [left, top, right, top + step * fill]
            grey = int(np.clip(shade + spread * draw.standard_normal(), 0, 255))
            (pen.ellipse if kind == 2 else pen.rectangle)(box, fill=grey)


@dataclass(frozen=True)
class Behind(Backdrop):
    """A drawing or a photograph behind each panel, as luminance over that of the plain background.

    Args:
        photographs: names for :func:`photograph`, or none for drawings.
    """

    photographs: tuple[str, ...] = ()

    def shade(self, x: Tensor, y: Tensor, context: Context) -> Tensor:
        """Draw each frame's."""
        planes = [
            self.picture(draw, context.camera.sensor_px)
            for draw in context.generators(self.name, of_scene=True)
        ]
        rows = torch.arange(len(planes)).view(-1, 1, 1, 1)
        return torch.from_numpy(np.stack(planes))[:, None][rows, 0, y, x]

    def picture(self, draw: Generator, size: tuple[int, int]) -> Plane:
        """Give one frame's luminance (H,W)."""
        level = math.exp(draw.uniform(-1, 1))
        if not self.photographs:
            return (level * (0.05 + 2 * drawing(draw, size))).astype(np.float32)
        name = self.photographs[int(draw.integers(len(self.photographs)))]
        return (level * 4 * crop_of(photograph(name), size, draw) ** 2.2).astype(
            np.float32
        )
