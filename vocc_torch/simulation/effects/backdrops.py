"""What fills the picture behind all else: photographs of the user's, and shapes that cover one another."""

import functools
import hashlib
import importlib.util
import math
from pathlib import Path

import numpy as np
import torch
from numpy.random import SFC64, Generator
from PIL import Image, ImageOps
from torch import Tensor

from vocc_torch.arrays import Floats, Singles
from vocc_torch.errors import VoccError
from vocc_torch.files import PICTURE_FORMATS, PICTURE_SUFFIXES, ordinary_file
from vocc_torch.simulation.effects import street
from vocc_torch.simulation.effects.base import (
    Context,
    Effect,
    FrameEffect,
    Quantity,
    within,
)
from vocc_torch.simulation.roadside import spread
from vocc_torch.simulation.scene import Distribution
from vocc_torch.simulation.sketch import Sketch


class Photographs(FrameEffect, on=Quantity.BACKGROUND):
    """Photographs of a folder behind the panel, at a random place, scale and brightness in each frame.

    Grey values become light by undoing the gamma, and each photograph has a mean of 1 before its level. It
    covers the sensor, magnified up to twice more than that needs; one of fewer pixels than the sensor is
    shown at 1 to 2 pixels a pixel, and goes on mirrored beyond its borders. A photograph of a panel is a
    panel: keep such out. A frame and its preambles share it. Sampled: the photograph is a constant to
    automatic differentiation, and the light keeps its gradient.

    Source: the inverse of Eq. 1; light that was clipped at white stays clipped.

    Args:
        folder: of pictures that Pillow reads; or a folder of an installed package, as PACKAGE/FOLDER:
            ``matplotlib/mpl-data/sample_data`` is always installed, ``sklearn/datasets/images`` has two photographs
            under CC BY 2.0, ``skimage/data`` those that its README names with their licences.
        gamma: of the pictures, 0.1 to 10.
        level: luminance over that of the plain background, a number or a distribution, above 0 to 100.

    Raises:
        VoccError: a folder that is not there or holds no picture, or a picture that cannot be read.

    Example:
        >>> Photographs(folder="matplotlib/mpl-data/sample_data").gamma
        2.2
    """

    name = "backdrop"
    folder: str
    gamma: float = within(0.1, 10, default=2.2)
    level: Distribution | float = within(
        0, 100, above=True, default=Distribution("log_uniform", (0.5, 2.0))
    )

    def __post_init__(self) -> None:
        """Check the ranges, and that there are pictures."""
        Effect.__post_init__(self)
        pictures_of(self.folder, Path.cwd())

    @property
    def digest(self) -> str:
        """Identity of these pictures: their names and sizes."""
        listing = "".join(
            f"{path.name}/{size}/"
            for path, size in pictures_of(self.folder, Path.cwd())
        )
        return hashlib.sha256(listing.encode()).hexdigest()

    def frame(self, plane: Tensor, generator: Generator, context: Context) -> Tensor:
        """Multiply (1,H,W) background luminance by the frame's photograph."""
        pictures = pictures_of(self.folder, Path.cwd())
        full = np.array(context.camera.sensor_px)
        path, _ = pictures[generator.integers(len(pictures))]
        light = light_of(path, self.gamma, 2 * int(full.max()), context.channel)
        sides = np.array(light.shape) - 1
        scale = min(max(full / sides), 1.0) * 2 ** generator.random()
        room = np.maximum(sides - full / scale, 0)
        starts, mirrored = generator.random(2) * room, generator.random() < 0.5
        left, top = context.first_px[0].tolist()
        places = []
        for axis, first in enumerate((top, left)):
            side = sides[axis]
            along = (first + np.arange(plane.shape[axis + 1]) + 0.5) / scale
            along += starts[axis]
            along = np.abs(along - 2 * side * np.floor(along / (2 * side) + 0.5))
            places.append((along - 0.5).clip(0, side - 1))
        y, x = places
        if mirrored:
            x = sides[1] - 1 - x
        level = np.float32(self.drawn("level", generator))
        shade = street.between(light, x, y) * level
        return plane * torch.from_numpy(shade).to(plane)


@functools.cache
def pictures_of(folder: str, here: Path) -> tuple[tuple[Path, int], ...]:
    """List the pictures of a folder, as seen from here, by name, and their sizes in bytes.

    Raises:
        VoccError: no folder, or none with a picture that can be read.
    """
    key, path = "scene.effects.backdrop.folder", here / folder
    if not path.is_dir():
        package, _, inside = folder.partition("/")
        spec = importlib.util.find_spec(package) if package.isidentifier() else None
        places = (spec and spec.submodule_search_locations) or [folder]
        path = Path(places[0]) / inside
    if not path.is_dir():
        rule = (
            "a folder of pictures, or one in an installed package, such as skimage/data"
        )
        raise VoccError.of(key, repr(folder), rule)
    found = tuple(
        (picture, picture.stat().st_size)
        for picture in sorted(path.iterdir())
        if picture.suffix.lower() in PICTURE_SUFFIXES and _opens(picture)
    )
    if not found:
        rule = f"a folder with a picture that can be read, {' '.join(PICTURE_SUFFIXES)}"
        raise VoccError.of(key, repr(folder), rule)
    return found


def _opens(path: Path) -> bool:
    """Whether a file is a picture."""
    try:
        with ordinary_file(path) as file, Image.open(file, formats=PICTURE_FORMATS):
            return True
    except (OSError, ValueError, Image.DecompressionBombError):
        return False


@functools.lru_cache(maxsize=32)
def light_of(
    path: Path, gamma: float, most_px: int, channel: int | None = None
) -> Singles:
    """Read a picture's light, (H+1,W+1), its last row and column repeated; larger ones shrink.

    Of its luma, which has a mean of 1, or of one channel over the luma's mean.

    Raises:
        VoccError: a picture that cannot be read.
    """
    try:
        with (
            ordinary_file(path) as file,
            Image.open(file, formats=PICTURE_FORMATS) as picture,
        ):
            planes = [ImageOps.exif_transpose(picture.convert("L"))]
            if channel is not None:
                coloured = ImageOps.exif_transpose(picture.convert("RGB"))
                planes.append(coloured.getchannel(channel))
            for plane in planes:
                plane.thumbnail((most_px, most_px))
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise VoccError(
            f"scene.effects.backdrop.folder holds {path.name}, which cannot be read ({error})"
        ) from None
    lights = [
        (np.asarray(plane, dtype=np.float32) / np.float32(255)) ** np.float32(gamma)
        for plane in planes
    ]
    mean = max(float(lights[0].mean()), 1e-9)
    scaled: Singles = np.pad(lights[-1] / mean, (0, 1), mode="edge")
    return scaled.astype(np.float32)


class Leaves(street.Sketched):
    """Overlapping shapes of all sizes, plain or patterned, some of them lamps.

    Discs, rectangles, triangles and stars lie at random places and turns, the largest behind. Their radii
    have the density ``r^-3``, with which dead leaves have the statistics of natural images at every scale.
    Some carry rings, spokes, stripes, scribbles, or a lattice of dots or squares in which all rows or all
    columns are alike: lattices with two levels, and no panel. Luminances are log-normal about that of the
    plain background; lamps have their own. A frame and its preambles share them. Sampled: not
    differentiable in the shapes; the light behind keeps its gradient.

    Source: A. B. Lee, D. Mumford and J. Huang, "Occlusion models for natural images", Int. J. Comput. Vis.
    41, 2001.

    Args:
        count: shapes a frame, a whole number, 1 to 2000.
        contrast: standard deviation of the logarithm of their luminances, 0 to 3.
        lamps: share of the smaller shapes that shine, 0 to 1.
        patterned: share of the shapes that carry a pattern, 0 to 1.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> Leaves(count=100).contrast
        0.7
    """

    count: int = within(1, 2000, whole=True, default=150)
    contrast: float = within(0, 3, default=0.7)
    lamps: float = within(0, 1, default=0.05)
    patterned: float = within(0, 1, default=0.4)

    def draw(self, layer: street.Layer, generator: Generator) -> None:
        """Draw one frame's shapes."""
        context, window = layer.camera_view.context, layer.window
        ambient, sensor_px = (
            float(context.scene.ambient_lx[0]),
            context.camera.sensor_px,
        )
        plain = ambient * context.panel.background_reflectance / math.pi
        low, high = max(sensor_px) / 120, max(sensor_px) / 2.5
        drawn, large = generator.random((self.count, 3)), self.count // 20
        radii = low / np.sqrt(1 - drawn[:, 0] * (1 - (low / high) ** 2))
        radii[:large] = high * (0.3 + 0.7 * drawn[:large, 0])
        middles = drawn[:, 1:] * sensor_px[::-1]
        seeds = generator.integers(1 << 62, size=self.count).tolist()
        far = np.maximum(window[:2] - middles, middles - window[2:]).max(axis=1)
        for leaf in np.flatnonzero(far < 2 * radii):
            random, radius = Generator(SFC64(seeds[leaf])), radii[leaf]
            turn, squeeze = random.uniform((0, 0.4), (2 * math.pi, 1.0))
            x, y = math.cos(turn), math.sin(turn)
            axes = np.array([[x, y], [-y * squeeze, x * squeeze]]) * radius
            place = functools.partial(moved, axes, middles[leaf])
            drawing = self.leaf(random, plain, radius < 6 * low)
            layer.lay(drawing.parts, place, seed=seeds[leaf])

    def leaf(self, g: Generator, plain: float, small: bool) -> Sketch:
        """Draw one shape, about 1 in size; those that shine are small."""
        drawing, lamp = Sketch(), (g.random() < self.lamps) and small
        shade, ink = (
            max(plain * math.exp(self.contrast * g.standard_normal()), 1e-6)
            for _ in range(2)
        )
        shade = spread(g, 300, 1e5) if lamp else shade
        corners = g.choice([3, 4, 4, 5, 16])
        dent = g.uniform(0.3, 0.9) if g.random() < 0.2 else math.cos(math.pi / corners)
        reach = np.tile([1.0, dent], corners)[:, None]
        angles = np.arange(2 * corners) * (math.pi / corners)
        drawing.polygon(on_circle(angles) * reach, shade)
        if g.random() < self.patterned:
            pattern(drawing, g, shade, ink)
        return drawing


def on_circle(angles: Floats) -> Floats:
    """Points (N,2) of the unit circle at angles, rad."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def pattern(drawing: Sketch, g: Generator, shade: float, ink: float) -> None:
    """Draw rings, spokes, stripes, scribbles or a lattice onto a shape of a shade."""
    rows, columns = g.integers(2, 14, 2)
    fill, round = g.uniform(0.3, 0.95), g.random() < 0.5
    match g.integers(5):
        case 0:
            for ring in np.linspace(0.9, 0.1, 2 * g.integers(1, 5)):
                shade, ink = ink, shade
                drawing.dots((0, 0), ring * 0.7, shade, round=round)
        case 1:
            for angle in np.arange(rows) * (2 * math.pi / rows):
                ends = on_circle(angle + np.array([-0.4, 0.4]) / rows)
                drawing.polygon([(0, 0), *ends], ink)
        case 2:
            drawing.grid(0.7, -0.7, 0.7, 1, columns, fill, ink)
        case 3:
            for line in np.linspace(-0.6, 0.6, rows):
                pen = np.cumsum(g.normal(0.08, 0.12, (12, 2)), axis=0) * (1, 0.3)
                pen += (-0.7, line)
                drawing.polygon([*pen, *np.add(pen, (0.02, 0.04))[::-1]], ink)
        case _:
            lit = g.random(columns) < 0.6
            turned = (np.arange(rows)[:, None] % 2 > 0) & (g.random() < 0.3)
            bright = np.where(lit ^ turned, ink * g.uniform(1, 8), ink).ravel()
            drawing.grid(0.7, -0.7, 0.7, rows, columns, fill, bright, round=round)


def moved(axes: Floats, middle: Floats, points: Floats) -> Floats:
    """Turn, scale and move points (M,2)."""
    return points @ axes + middle


EFFECTS = (Photographs, Leaves)
"""In physical order."""
