"""Flat things made of polygons, drawn far to near onto the sensor's pixels; each is drawn once, whole.

A thing is drawn in patches that are cut along fixed tiles of the sensor, whichever part of the sensor is
asked for: so a window has the whole frame's very pixels. A patch is drawn some times finer than the pixels
and averaged, which leaves the share of each pixel that is covered and the mean light there.
"""

import functools
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, ImageFont

from vocc_torch.arrays import Bools, Floats, Integers, Singles

Part = tuple[Floats, Floats]


@dataclass(frozen=True)
class SketchSettings:
    """How finely things are drawn."""

    tile_px: int = 128  # side of the squares of the sensor that are drawn by themselves
    # A thing's pixels each side, up to which it is drawn 4 and 3 times finer; 2 beyond.
    finest_px: tuple[int, int] = (15_000, 60_000)


SETTINGS = SketchSettings()


COVERED = {
    n: (np.rint(np.arange(256) * (n * n / 255)) / (n * n)).astype(np.float32)
    for n in (2, 3, 4)
}
"""The share of n x n steps that is white, by their rounded mean in 8 bits."""

LETTERS = np.array(list("ABCDEFGHIJKLMNOPRSTUVWXYZ0123456789"))

_CIRCLE = np.stack([f(np.arange(12) * (np.pi / 6)) for f in (np.cos, np.sin)], axis=-1)

CLOCKWISE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
"""Where a rectangle's corners lie from its middle, ``(x, y)`` in half sides, from the top left."""


Sides = float | tuple[float, float]
"""Left and right end of a shape, or half the width of one about the middle."""


Whole = int | np.int64
"""A whole number, which may be drawn."""


Shade = float | Floats
"""One number for all shapes of a group, or one for each."""


def ends_of(sides: Sides) -> tuple[float, float]:
    """Give the left and the right end."""
    return sides if isinstance(sides, tuple) else (-sides, sides)


@dataclass
class Sketch:
    """Polygons on a plane, m, x right and y down, later ones over earlier ones.

    Args:
        parts: groups of like polygons: points (N,V,2) m and luminance (N,) cd/m2.

    Example:
        >>> sketch = Sketch()
        >>> sketch.box(1, -2, 0, 300.0)
        >>> sketch.grid(1, -2, 0, 2, 3, 0.5, 40.0)
        >>> [points.shape for points, _ in sketch.parts], sketch.parts[0][1].tolist()
        ([(1, 4, 2), (6, 4, 2)], [300.0])
    """

    parts: list[Part] = field(default_factory=list)

    def polygons(self, points: Floats, luminance: Shade) -> None:
        """Add N polygons of V points, (N,V,2)."""
        self.parts.append((points, np.broadcast_to(luminance, len(points))))

    def polygon(self, points: ArrayLike, luminance: float) -> None:
        """Add a polygon of V points."""
        self.polygons(np.array([points]), luminance)

    def box(
        self,
        sides: Sides,
        top: float,
        bottom: float,
        luminance: float,
        foot: Sides | None = None,
    ) -> None:
        """Add an upright rectangle, or a trapezoid whose lower side is ``foot``."""
        left, right = ends_of(sides)
        start, end = ends_of(foot or sides)
        self.polygon(
            [(left, top), (right, top), (end, bottom), (start, bottom)], luminance
        )

    def dots(
        self,
        centres: ArrayLike,
        half: Shade,
        luminance: Shade,
        *,
        round: bool,
    ) -> None:
        """Add squares or discs (N,2) of half a side, one number or (N,2)."""
        at = np.reshape(centres, (-1, 1, 2))
        halves = np.broadcast_to(half, (len(at), 2))[:, None]
        self.polygons(at + (_CIRCLE if round else CLOCKWISE) * halves, luminance)

    def grid(
        self,
        sides: Sides,
        top: float,
        bottom: float,
        rows: Whole,
        columns: Whole,
        fill: float,
        luminance: Shade,
        *,
        round: bool = False,
    ) -> None:
        """Add a lattice of rectangles or ellipses, each ``fill`` of its cell's width and height."""
        left, right = ends_of(sides)
        wide, high = (right - left) / columns, (bottom - top) / rows
        x = left + wide * (np.arange(columns) + 0.5)
        y = top + high * (np.arange(rows) + 0.5)
        centres = np.stack(np.meshgrid(x, y), axis=-1)
        self.dots(centres, np.array([wide, high]) * (fill / 2), luminance, round=round)

    def text(
        self,
        words: str,
        left: float,
        top: float,
        height: float,
        luminance: float,
        fill: float = 0.0,
    ) -> None:
        """Write words, of strokes, or with a ``fill`` of a matrix's dots."""
        mask = letters_mask(words)
        cell = height / len(mask)
        row, column = np.nonzero(mask)
        centres = np.stack([column + 0.5, row + 0.5], axis=-1) * cell + (left, top)
        self.dots(centres, cell * (fill or 1.0) / 2, luminance, round=fill > 0)


def letters_mask(words: str) -> Bools:
    """Give words as the bitmap of Pillow's built-in fixed font, (rows, columns), without empty rows."""
    core = _font().getmask(words, mode="1")
    mask = np.array(core, dtype=bool).reshape(core.size[::-1])
    rows = np.flatnonzero(mask.any(axis=1))
    return mask[rows[0] : rows[-1] + 1] if len(rows) else mask


@functools.cache
def _font() -> ImageFont.ImageFont:
    """Load Pillow's built-in font, which is of fixed width, once."""
    return ImageFont.load_default_imagefont()


def words_of(generator: Generator, length: Whole) -> str:
    """Draw a word of capitals and figures."""
    return "".join(generator.choice(LETTERS, size=length))


Window = tuple[int, int, int, int]
"""Left, top, right and bottom of what is looked at, px of the sensor."""

Picture = tuple[Singles, Singles]
"""The share of each pixel that things cover, or leave, and the light of these things there."""


@dataclass(frozen=True, slots=True)
class Drawing:
    """A thing as it lies on the sensor, drawn tile by tile.

    Args:
        corners: (P,2) of all polygons, in steps of which ``fine`` are a pixel.
        starts: (N,) where each polygon's corners begin.
        ends: (N,) likewise.
        least: (N,2) px, each polygon's extent.
        most: (N,2) likewise.
        first: (2,) the first pixel that it touches.
        last: (2,) the last one.
        luminance: (N,) of each.
        scale: what it is drawn times.
        fine: how many times finer than the pixels it is drawn, each side.
        share: what a mirror shows of it; 1 without one.
    """

    corners: Integers
    starts: Integers
    ends: Integers
    least: Floats
    most: Floats
    first: Integers
    last: Integers
    luminance: Floats
    scale: float
    fine: int
    share: float

    @classmethod
    def on_sensor(
        cls,
        parts: Iterable[Part],
        place: Callable[[Floats], Floats],
        share: float = 1.0,
    ) -> "Drawing | None":
        """Place polygons (N,V,2) and their luminance (N,), as of a sketch.

        Args:
            parts: the polygons.
            place: takes points (M,2) on the plane to the sensor, px; where it gives NaN nothing is drawn.
            share: what a mirror shows.
        """
        polygons, luminances = zip(*parts, strict=True)
        flat = place(np.concatenate([points.reshape(-1, 2) for points in polygons]))
        flat = flat.clip(-1e6, 1e6)
        if not np.isfinite(flat).all():
            return None
        first = np.floor(flat.min(axis=0)).astype(int)
        last = np.ceil(flat.max(axis=0)).astype(int)
        pixels = np.prod(last - first)
        fine = 4 - int(np.searchsorted(SETTINGS.finest_px, pixels))
        sides = np.concatenate(
            [np.full(len(points), points.shape[1]) for points in polygons]
        )
        ends = np.cumsum(sides)
        starts = ends - sides
        # Pillow fills to both ends: half a step inwards, so that as many steps are filled as there are.
        middles = np.add.reduceat(flat, starts) / sides[:, None]
        inwards = np.sign(middles.repeat(sides, axis=0) - flat)
        corners = np.rint(flat * fine - 0.5 + 0.5 * inwards).astype(int)
        least = np.minimum.reduceat(flat, starts)
        most = np.maximum.reduceat(flat, starts)
        luminance = np.concatenate(luminances)
        # The darkest is above 255, so that in 8 bits what is covered is white; a power of two rounds nothing.
        scale = 2.0 ** math.ceil(math.log2(256 / float(luminance.min())))
        extents = least, most, first, last
        return cls(corners, starts, ends, *extents, luminance, scale, fine, share)

    def patch(self, begin: Integers, end: Integers) -> Picture | None:
        """Draw what lies from one pixel to another: the share covered, and the light there; None for nothing."""
        inside = ((self.least < end) & (self.most > begin)).all(axis=1)
        drawn = np.flatnonzero(inside)
        if not len(drawn):
            return None
        image = Image.new("F", tuple(((end - begin) * self.fine).tolist()))
        pen, start = ImageDraw.Draw(image), self.starts[drawn[0]]
        corners = self.corners[start : self.ends[drawn[-1]]] - begin * self.fine
        at = corners.clip(-30_000, 30_000).ravel().tolist()
        cuts = (2 * (bounds[drawn] - start) for bounds in (self.starts, self.ends))
        for first, last, shade in zip(
            *cuts, (self.luminance[drawn] * self.scale).tolist(), strict=True
        ):
            pen.polygon(at[first:last], fill=shade)
        lit = np.asarray(image.reduce(self.fine), dtype=np.float32)
        cover = COVERED[self.fine][np.asarray(image.convert("L").reduce(self.fine))]
        share = np.float32(self.share)
        return cover * share, lit / np.float32(self.scale) * share


def composed(things: Iterable[Drawing], window: Window) -> Picture:
    """Lay things before a picture, later ones over earlier ones.

    Args:
        things: on the sensor.
        window: within the sensor.

    Returns:
        How much of what is behind stays in each pixel of the window, and the light of the things.

    Example:
        >>> sketch = Sketch()
        >>> sketch.box((1.5, 3), 1, 2, 10.0)
        >>> thing = Drawing.on_sensor(sketch.parts, lambda points: points)
        >>> [part[1, 1:3].tolist() for part in composed([thing], (0, 0, 9, 9))]
        [[0.5, 0.0], [5.0, 10.0]]
    """
    begin, end = np.reshape(window, (2, 2))
    # A patch begins at a corner of its tile or of its thing, whatever the window, and so is the same in all.
    start = begin - begin % SETTINGS.tile_px
    width, height = end - start
    keep = np.ones((height, width), np.float32)
    added = np.zeros((height, width), np.float32)
    for thing in things:
        touched = np.maximum(thing.first, begin) // SETTINGS.tile_px
        stop = np.minimum(thing.last, end)
        tiles = -(-stop // SETTINGS.tile_px) - touched
        for tile in np.ndindex(*tiles.clip(min=0)):
            corner = (touched + tile) * SETTINGS.tile_px
            patch_px = np.maximum(corner, thing.first)
            patch = thing.patch(patch_px, np.minimum(corner + SETTINGS.tile_px, stop))
            if patch is None:
                continue
            cover, light = patch
            x, y = patch_px - start
            place = slice(y, y + len(cover)), slice(x, x + cover.shape[1])
            keep[place] *= 1 - cover
            added[place] *= 1 - cover
            added[place] += light
    left, top = begin - start
    return keep[top:, left:], added[top:, left:]
