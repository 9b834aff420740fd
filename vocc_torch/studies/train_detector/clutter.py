"""What stands behind the panels of the training frames: drawn shapes, lettering, lattices and photographs."""

import functools
import math
from importlib import resources

import numpy as np
from PIL import Image, ImageDraw

from vocc_torch.arrays import Bytes, Floats, Singles
from vocc_torch.simulation.sketch import words_of

Plane = Singles
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


def mosaics(seed: int, size: tuple[int, int, int]) -> Bytes:
    """Put frames (N,H,W) of a size together from photographs, at several sizes, and drawings."""
    count, high, wide = size
    side = 272
    rows, columns = -(-high // side), -(-wide // side)
    frames = np.empty((count, rows, side, columns, side), np.uint8)
    for number in range(count):
        draw = np.random.default_rng((seed, number))
        for row, column in np.ndindex(rows, columns):
            frames[number, row, :, column] = (255 * _tile(draw, side)).round()
    return frames.reshape(count, rows * side, -1)[:, :high, :wide]


def _tile(draw: Generator, side: int) -> Plane:
    """Cut a square from a photograph at a random size, or draw one."""
    if draw.random() < 0.3:
        return drawing(draw, (side, side))
    whole = photograph(PHOTOGRAPHS[draw.integers(len(PHOTOGRAPHS))])
    least = side / min(whole.shape)
    scale = max(least, math.exp(draw.uniform(math.log(0.3), math.log(1.5))))
    high, wide = (max(side, round(length * scale)) for length in whole.shape)
    picture = Image.fromarray(whole).resize((wide, high), Image.Resampling.BOX)
    top, left = (int(draw.integers(length - side + 1)) for length in (high, wide))
    return np.asarray(picture)[top : top + side, left : left + side].clip(0, 1)


@functools.cache
def photograph(name: str) -> Plane:
    """Read a photograph's grey values, 0 to 1, from ``package/file``."""
    package, _, file = name.partition("/")
    with (
        resources.as_file(resources.files(package) / file) as path,
        Image.open(path) as picture,
    ):
        return np.asarray(picture.convert("L"), np.float32) / np.float32(255)


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
    pen: ImageDraw.ImageDraw, draw: Generator, start: Floats, shade: int
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
