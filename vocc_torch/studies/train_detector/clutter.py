"""What stands behind panels in ``clutter.yaml``: photographs, and lattices that are no panels."""

import functools
import math
from importlib import resources
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.random import Generator

from vocc_torch.errors import library
from vocc_torch.simulation import roadside
from vocc_torch.simulation.effects import street, within
from vocc_torch.simulation.effects.backdrops import moved
from vocc_torch.simulation.scene import Distribution
from vocc_torch.simulation.sketch import Sketch

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

SIDES = (4, 5, 6, 8, 8, 12, 16)
"""Rows and columns of lattices."""


def copy_photographs(folder: Path) -> None:
    """Copy the training photographs into a folder.

    Raises:
        VoccError: the packages that they ship with are not installed.
    """
    need = "task=train_detector shows photographs of scikit-image and scikit-learn"
    folder.mkdir(parents=True, exist_ok=True)
    for name in PHOTOGRAPHS:
        package, _, file = name.partition("/")
        source = resources.files(library(package, "test", need)) / file
        (folder / file).write_bytes(source.read_bytes())


class Lattices(street.Sketched):
    """Lattices of dots on boards that are no panels, anywhere on the sensor.

    Their dots are lit by a rule, lie off the lattice, in rows shifted by half a cell or within a disc, or are
    fewer than show a lattice; each lattice has at least one of these. A frame and its preambles share them.

    Args:
        count: of a frame, a number or a distribution, 0 to 100.
    """

    after: ClassVar[str | None] = "backdrop"

    count: Distribution | float = within(
        0, 100, default=Distribution("uniform", (1.0, 6.0))
    )

    def draw(self, layer: street.Layer, generator: Generator) -> None:
        """Draw one frame's lattices."""
        context = layer.camera_view.context
        light = roadside.Light(
            float(context.scene.ambient_lx[0]) / math.pi,
            float(context.scene.led_luminance_cd_m2[0]),
            lit=1.0,
        )
        for _ in range(round(self.drawn("count", generator))):
            middle = generator.uniform((0, 0), context.camera.sensor_px[::-1])
            turn, lean = generator.normal(0, 0.3, 2)
            pitch_px = roadside.spread(generator, 1.8, 16)
            axes = np.array([[1, turn], [-turn, 1 + lean]]) * pitch_px
            place = functools.partial(moved, axes, middle)
            layer.lay(lattice(generator, light).parts, place)


def lattice(g: Generator, light: roadside.Light) -> Sketch:
    """Draw a lattice that is no panel, with a board or without; a cell has a side of 1."""
    ruled, scattered, bricks, disc, sparse = g.random(5) < (0.5, 0.45, 0.3, 0.3, 0.25)
    size = g.choice(SIDES, 2)[::-1]
    row, column = np.indices(tuple(size[::-1]))
    at = np.stack([column, row], axis=-1) - (size - 1) / 2
    far = np.hypot(*(at * 2 / size).T).T
    lit, shown = g.random(row.shape) < g.uniform(0.2, 0.8), np.ones(row.shape, bool)
    if ruled or not (scattered or bricks or disc or sparse):
        down, across = g.integers(3, size=2)
        lit = (down * row + across * column) % g.integers(1, 5) == 0
        lit ^= g.random(row.shape) < 0.03
    if scattered:
        at += np.clip(g.normal(0, g.uniform(0.18, 0.45), at.shape), -0.45, 0.45)
    if bricks:
        at[..., 0] += row % 2 / 2
    if disc:
        shown = far < g.uniform(0.9, 1.05)
    if sparse:
        shown = g.random(row.shape) < g.uniform(1, 3.5) / row.size
        shown.flat[g.integers(row.size)] = True
        lit = shown
    drawing = Sketch()
    if g.random() < 0.7:
        wide, high = size / 2 + g.uniform(0, 1.5)
        drawing.box(wide, -high, high, light.matt(g, 0.02, 0.6))
    bright = light.led_cd_m2 * roadside.spread(g, 0.1, 2)
    luminance = np.where(lit, bright, light.matt(g, 0.03, 0.6))
    fill, round_dots = g.uniform(0.2, 0.95), bool(g.random() < 0.6)
    drawing.dots(at[shown], fill / 2, luminance[shown], round=round_dots)
    return drawing
