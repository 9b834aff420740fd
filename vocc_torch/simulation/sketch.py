"""Flat things made of polygons, drawn far to near onto the sensor's pixels; each is drawn once, whole.

A thing is drawn in patches that are cut along fixed tiles of the sensor, whichever part of the sensor is
asked for: so a window has the whole frame's very pixels. A patch is drawn some times finer than the pixels
and averaged, which leaves the share of each pixel that is covered and the mean light there.
"""

import functools
import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

Array = NDArray[np.float64]
Plane = NDArray[np.float32]

Part = tuple[Array, Array]

TILE_PX = 128
"""Side of the squares of the sensor that are drawn by themselves."""

FINENESS = ((15_000, 4), (60_000, 3))
"""Up to so many pixels of a thing, how many times finer each side is drawn; 2 beyond."""

WHOLE = 144
"""What a covered pixel counts: 2 x 2, 3 x 3 and 4 x 4 of them have whole means."""

WHOLE_OF_WHITE = [0] * 255 + [WHOLE]

LETTERS = np.array(list("ABCDEFGHIJKLMNOPRSTUVWXYZ0123456789"))

_CIRCLE = np.stack([f(np.arange(12) * (np.pi / 6)) for f in (np.cos, np.sin)], axis=-1)
_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@dataclass
class Sketch:
    """Polygons on a plane, m, x right and y down, later ones over earlier ones.

    Args:
        parts: groups of like polygons: points (N,V,2) m and luminance (N,) cd/m2.

    Example:
        >>> sketch = Sketch()
        >>> sketch.box(-1, -2, 1, 0, 300.0)
        >>> sketch.grid(-1, -2, 1, 0, 2, 3, 0.5, 40.0)
        >>> [points.shape for points, _ in sketch.parts], sketch.parts[0][1].tolist()
        ([(1, 4, 2), (6, 4, 2)], [300.0])
    """

    parts: list[Part] = field(default_factory=list)

    def polygon(self, points: object, luminance: float) -> None:
        """Add a polygon of V points."""
        self.parts.append((np.array([points], dtype=np.float64), np.array([luminance], dtype=np.float64)))

    def box(self, left: float, top: float, right: float, bottom: float, luminance: float) -> None:
        """Add an upright rectangle."""
        self.polygon([(left, top), (right, top), (right, bottom), (left, bottom)], luminance)

    def dots(self, centres: Array, half: float | Array, luminance: float | Array, *, round: bool) -> None:
        """Add squares or discs (N,2) of half a side, one number or (N,2)."""
        shape = _CIRCLE if round else _SQUARE
        halves = np.broadcast_to(np.asarray(half, dtype=np.float64), centres.shape)
        points = centres[:, None] + shape * halves[:, None]
        self.parts.append((points, np.broadcast_to(np.asarray(luminance, dtype=np.float64), len(points))))

    def grid(
        self,
        left: float,
        top: float,
        right: float,
        bottom: float,
        rows: int,
        columns: int,
        fill: float,
        luminance: float | Array,
        *,
        round: bool = False,
    ) -> None:
        """Add a lattice of rectangles or ellipses, each ``fill`` of its cell's width and height."""
        wide, high = (right - left) / columns, (bottom - top) / rows
        x, y = left + wide * (np.arange(columns) + 0.5), top + high * (np.arange(rows) + 0.5)
        centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        self.dots(centres, np.array([wide, high]) * (fill / 2), luminance, round=round)

    def text(
        self, words: str, left: float, top: float, height: float, luminance: float, fill: float = 0.0
    ) -> float:
        """Write words, of strokes, or with a ``fill`` of a matrix's dots; give their width."""
        mask = letters_mask(words)
        cell = height / len(mask)
        row, column = np.nonzero(mask)
        centres = np.stack([left + cell * (column + 0.5), top + cell * (row + 0.5)], axis=-1)
        self.dots(centres, cell * (fill or 1.0) / 2, luminance, round=fill > 0)
        return float(cell * mask.shape[1])


def letters_mask(words: str) -> NDArray[np.bool_]:
    """Give words as the bitmap of Pillow's built-in fixed font, (rows, columns), without empty rows."""
    core = _font().getmask(words, mode="1")
    mask = np.array(core, dtype=bool).reshape(core.size[::-1])
    rows = np.flatnonzero(mask.any(axis=1))
    return mask[rows[0] : rows[-1] + 1] if len(rows) else mask


@functools.cache
def _font() -> ImageFont.ImageFont:
    """Load Pillow's built-in font, which is of fixed width, once."""
    return ImageFont.load_default_imagefont()


def words_of(generator: np.random.Generator, length: int) -> str:
    """Draw a word of capitals and figures."""
    return "".join(generator.choice(LETTERS, size=length))


Patch = tuple[int, int, Plane, Plane]
"""Left column and top row of a patch of the sensor, the share of each pixel covered, and the light there."""

Window = tuple[int, int, int, int]
"""Left, top, right and bottom of what is looked at, px of the sensor."""


def patches(parts: Iterable[Part], place: Callable[[Array], Array], window: Window) -> Iterator[Patch]:
    """Draw what a window shows of a thing, tile by tile.

    Args:
        parts: polygons (N,V,2) and their luminance (N,), as of a sketch.
        place: takes points (M,2) on the plane to the sensor, px; where it gives NaN nothing is drawn.
        window: within the sensor.

    Example:
        >>> sketch = Sketch()
        >>> sketch.box(1.5, 1, 3, 2, 10.0)
        >>> [(left, top, cover.tolist(), light.tolist())
        ...  for left, top, cover, light in patches(sketch.parts, lambda points: points, (0, 0, 9, 9))]
        [(1, 1, [[0.5, 1.0]], [[5.0, 10.0]])]
    """
    parts = list(parts)
    flat = place(np.concatenate([points.reshape(-1, 2) for points, _ in parts])).clip(-1e6, 1e6)
    if not np.isfinite(flat).all():
        return
    low, high = np.floor(flat.min(axis=0)).astype(int), np.ceil(flat.max(axis=0)).astype(int)
    first, last = np.maximum(low, window[:2]), np.minimum(high, window[2:])
    if (first >= last).any():
        return
    fine = next((finer for pixels, finer in FINENESS if np.prod(high - low) <= pixels), 2)
    sides = np.concatenate([np.full(len(points), points.shape[1]) for points, _ in parts])
    ends = np.cumsum(sides)
    starts = ends - sides
    least, most = np.minimum.reduceat(flat, starts), np.maximum.reduceat(flat, starts)
    # Pillow fills to both ends: half a step inwards, so that as many steps are filled as there are.
    inwards = np.sign((np.add.reduceat(flat, starts) / sides[:, None]).repeat(sides, axis=0) - flat)
    whole = np.rint(flat * fine - 0.5 + 0.5 * inwards).astype(int)
    luminance = np.concatenate([each for _, each in parts])
    # The darkest is above 255, so that in 8 bits what is covered is white; a power of two rounds nothing.
    scale = 2.0 ** math.ceil(math.log2(256 / float(luminance.min())))
    tiles = (range(begin // TILE_PX, -(-end // TILE_PX)) for begin, end in zip(first, last, strict=True))
    for column, row in itertools.product(*tiles):
        begin = np.maximum(low, (column * TILE_PX, row * TILE_PX))
        end = np.minimum(high, ((column + 1) * TILE_PX, (row + 1) * TILE_PX))
        seen = ((least < end) & (most > begin)).all(axis=1).nonzero()[0]
        if not len(seen):
            continue
        image = Image.new("F", tuple(((end - begin) * fine).tolist()))
        pen, at = ImageDraw.Draw(image), (whole - begin * fine).clip(-30_000, 30_000).ravel().tolist()
        shown = zip(2 * starts[seen], 2 * ends[seen], (luminance[seen] * scale).tolist(), strict=True)
        for start, stop, light in shown:
            pen.polygon(at[start:stop], fill=light)
        solid = image.convert("L").point(WHOLE_OF_WHITE).reduce(fine)
        cover = np.asarray(solid, dtype=np.float32) / np.float32(WHOLE)
        lit = np.asarray(image.reduce(fine), dtype=np.float32) / np.float32(scale)
        yield int(begin[0]), int(begin[1]), cover, lit


def lay(keep: Plane, added: Plane, patch: Patch, origin_px: tuple[int, int]) -> None:
    """Lay a patch before a picture in place, which shows ``keep`` of what is behind and ``added`` light.

    Args:
        keep: (h,w), changed in place.
        added: (h,w), likewise.
        patch: one of :func:`patches`.
        origin_px: the sensor's column and row where the picture begins.
    """
    left, top, cover, light = patch
    x, y = left - origin_px[0], top - origin_px[1]
    rows, columns = (slice(max(at, 0), max(at + n, 0)) for at, n in ((y, len(cover)), (x, cover.shape[1])))
    free = 1 - cover[max(-y, 0) :, max(-x, 0) :][: max(len(keep) - rows.start, 0)]
    free = free[:, : max(keep.shape[1] - columns.start, 0)]
    seen = light[max(-y, 0) :, max(-x, 0) :][: len(free), : free.shape[1]]
    keep[rows, columns] *= free
    added[rows, columns] *= free
    added[rows, columns] += seen
