"""What stands in a street: vehicles, houses, signs, displays, fences, lamps and trees, each a sketch.

Sizes in m, x right and y down from the middle of a thing's foot. Reflectances, luminances and proportions are
those of everyday things in broad strokes; every one is drawn at random.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator

from vocc_torch.simulation.sketch import Shade, Sketch, words_of

FLOOR_M = -0.28
"""Lower edge of a vehicle's body."""


@dataclass(frozen=True, slots=True)
class Light:
    """The light that things stand in, and that they make.

    Args:
        daylight_cd_m2: luminance of a white surface, ``E / pi``.
        led_cd_m2: of an On LED of our panel, which displays are about as bright as.
        lit: share of vehicles and lamps that are lit.
    """

    daylight_cd_m2: float
    led_cd_m2: float
    lit: float

    def of(self, reflectance: Shade, shining_cd_m2: Shade = 0.0) -> Any:
        """Luminance of matt surfaces, and of light of their own; black is not quite black."""
        return np.maximum(self.daylight_cd_m2 * reflectance + shining_cd_m2, 1e-6)

    def matt(self, generator: Generator, low: float, high: float) -> Any:
        """Luminance of a matt surface of any reflectance between two."""
        return self.of(generator.uniform(low, high))

    def lamp(
        self, generator: Generator, low: float, high: float, *, lit: bool = True
    ) -> Any:
        """Luminance of a lamp, log-uniform cd/m2, or of its glass where it is off."""
        return spread(generator, low, high) if lit else self.matt(generator, 0.08, 0.3)


def spread(generator: Generator, low: float, high: float) -> float:
    """Draw log-uniformly."""
    return math.exp(generator.uniform(math.log(low), math.log(high)))


def vehicle(sketch: Sketch, g: Generator, light: Light, least_m: float = 0.0) -> None:
    """Draw the back or the front of a car, a van or a lorry, at least ``least_m`` wide and high."""
    boxy = g.random() < 0.35
    low, most = ((2.0, 2.1), (2.5, 3.6)) if boxy else ((1.6, 1.35), (1.95, 1.75))
    wide, high = np.maximum(g.uniform(low, most), (1.3 * least_m, 1.5 * least_m))
    half, rear = wide / 2, g.random() < 0.7
    paint = g.choice([0.04, 0.08, 0.15, 0.3, 0.5, 0.75]) * g.uniform(0.7, 1.1)
    belt = -high if boxy else -high * g.uniform(0.52, 0.66)
    sketch.box(half * 1.05, -0.1, 0.08, light.of(0.03))  # its shadow
    sketch.box(half * 0.96, -0.35, -0.12, light.of(0.02))
    for wheel in (-half * 0.95, -half * 0.7), (half * 0.7, half * 0.95):
        sketch.box(wheel, -0.35, 0, light.of(0.03))
    inset = half * g.uniform(0.75, 0.92)
    if not boxy:
        sketch.box(inset, -high, belt, light.of(paint), half)
    strips = g.integers(3, 9)
    edges = itertools.pairwise(np.linspace(belt, FLOOR_M, strips + 1))
    for strip, gloss in zip(edges, g.uniform(0.7, 1.3, strips), strict=True):
        sketch.box(half, *strip, light.of(paint * gloss))
    head, foot, window = half * 0.85, half * 0.88, (-high * 0.92, -high * 0.6)
    if not boxy:
        head, window = inset * 0.92, (-high * 0.95, belt * 1.04)
    if not boxy or g.random() < 0.4:
        sketch.box(head, *window, light.of(0.03), foot)
        sky, cut = light.matt(g, 0.1, 1.2), g.uniform(-0.6, 0.4, 2) * head
        sketch.box((cut[0], head), *window, sky, (cut[1], foot))
    if boxy:
        _livery(sketch, g, light, half, high, paint)
    _vehicle_front(sketch, g, light, half, belt, rear)


def _livery(
    sketch: Sketch, g: Generator, light: Light, half: float, high: float, paint: float
) -> None:
    """Draw ribs and letters on a van or a lorry."""
    if g.random() < 0.5:
        count, (fill, shade) = g.integers(6, 30), g.uniform((0.2, 0.4), (0.6, 1.6))
        ribs = light.of(paint * shade)
        sketch.grid(half, -high * 0.95, -high * 0.25, 1, count, fill, ribs)
    if g.random() < 0.6:
        size, words = g.uniform(0.12, 0.4), words_of(g, g.integers(4, 9))
        foot = -half * 0.8, -high * g.uniform(0.5, 0.9)
        sketch.text(words, *foot, size, light.matt(g, 0, 0.9))


def _vehicle_front(
    sketch: Sketch, g: Generator, light: Light, half: float, belt: float, rear: bool
) -> None:
    """Draw a grille, lamps, the number plate, the bumper, and the sun in the chrome."""
    if g.random() < 0.5:
        rows, columns = g.integers(3, 10), g.choice([1, 1, 8, 16])
        top = belt * g.uniform(0.55, 0.8)
        place = half * 0.55, top, top + 0.25
        sketch.box(*place, light.of(0.02))
        fill = g.uniform(0.3, 0.7)
        sketch.grid(*place, rows, columns, fill, light.matt(g, 0.05, 0.8))
    _vehicle_lamps(sketch, g, light, half, max(belt, -1.1), rear)
    plate = -g.uniform(0.42, 0.8)
    shine = light.matt(g, 0.5, 0.8) + g.uniform(0, 30) * light.lit
    sketch.box(0.27, plate, plate + 0.12, shine)
    sketch.text(words_of(g, 8), -0.24, plate + 0.02, 0.08, light.of(0.03))
    sketch.box(half, -0.34, FLOOR_M, light.matt(g, 0.03, 0.3))
    if g.random() < 0.4 and light.daylight_cd_m2 > 0:
        at = g.uniform((-half, belt), (half, FLOOR_M), (g.integers(1, 4), 2))
        sketch.dots(at, g.uniform(0.01, 0.05), light.of(spread(g, 3, 60)), round=True)


def _vehicle_lamps(
    sketch: Sketch, g: Generator, light: Light, half: float, belt: float, rear: bool
) -> None:
    """Draw lamps on both sides: glasses, discs or lattices of LEDs, and a third lamp of brakes."""
    lit, tall = g.random() < light.lit, g.uniform(0.1, 0.35)
    range_cd = (800, 2e4) if rear else (2e4, 1e6)
    lamp_light = light.lamp(g, *range_cd, lit=lit)
    glass = light.matt(g, 0.08, 0.3)
    wide, height = g.uniform((0.12, 0.75), (0.4, 0.95))
    top, kind = belt * height, g.integers(3)
    bottom, middle = top + tall, top + tall / 2
    rows, columns = g.integers((1, 3), (5, 9))
    outer = half * 0.97
    for left, right in (-outer, wide - outer), (outer - wide, outer):
        place = (left, right), top, bottom
        sketch.box(*place, glass)
        if kind == 0:
            sketch.box((left + 0.02, right - 0.02), top + 0.02, middle, lamp_light)
        elif kind == 1:
            centre = (left + right) / 2, middle
            sketch.dots(centre, min(wide, tall) * 0.4, lamp_light, round=True)
        else:
            fill = g.uniform(0.4, 0.8)
            sketch.grid(*place, rows, columns, fill, lamp_light, round=True)
    if rear and g.random() < 0.4:
        braking = light.lamp(g, 2000, 15_000, lit=lit and g.random() < 0.5)
        top, lamps = belt * 1.15, g.integers(6, 20)
        sketch.grid(0.25, top, top + 0.03, 1, lamps, 0.7, braking, round=True)


def house(sketch: Sketch, g: Generator, light: Light) -> None:
    """Draw a front of windows, some of them lit, with a shop and its sign or without."""
    wide, high = g.uniform((6, 5), (30, 22))
    sketch.box(wide / 2, -high, 0, light.matt(g, 0.08, 0.6))
    rows = max(1, round(high / g.uniform(2.6, 3.5)))
    columns = max(2, round(wide / g.uniform(1.2, 4)))
    state = g.random(rows * columns)
    glass = np.where(state < 0.5, 0.04, g.uniform(0.05, 1.0, len(state)))
    lived_in = g.random(len(state)) < light.lit * g.uniform(0.1, 0.7)
    inside = np.exp(g.uniform(2.5, 6.5, len(state))) * lived_in
    windows = wide / 2, -high, -1.2, rows, columns
    inner = g.uniform(0.35, 0.8)
    if g.random() < 0.6:
        sketch.grid(*windows, min(inner * 1.15, 0.95), light.matt(g, 0.2, 0.8))
    sketch.grid(*windows, inner, light.of(glass, inside))
    if g.random() < 0.5:
        lit = g.random() < light.lit
        ground, ink = (light.lamp(g, 30, 2000, lit=lit) for _ in range(2))
        sketch.box(wide / 3, -3.2, -2.4, ground)
        sketch.text(words_of(g, g.integers(4, 12)), -wide / 3.3, -3.1, 0.6, ink)


def sign(sketch: Sketch, g: Generator, light: Light) -> None:
    """Draw a traffic sign, a direction sign or a poster with lettering, on a pole."""
    wide, high, up = g.uniform((0.6, 0.5, 1.5), (3.5, 1.6, 5))
    sketch.box(0.05, -up, 0, light.matt(g, 0.1, 0.5))
    ground, ink = g.uniform((0.03, 0.6), (0.15, 0.85))
    if g.random() < 0.5:
        ground, ink = ink, ground
    if g.random() < 0.4:
        for share, shade in (1.0, 0.12), (0.8, ink):
            sketch.dots((0, -up), high / 2 * share, light.of(shade), round=True)
        limit = str(g.integers(2, 13) * 10)
        sketch.text(limit, -high * 0.25, -up - high * 0.2, high * 0.4, light.of(0.03))
        return
    sketch.box(wide / 2, -up - high, -up, light.of(ground))
    lines = g.integers(1, 5)
    step = high / lines
    for line in range(lines):
        length = int(np.clip(g.uniform(0.4, 0.9) * wide / (step * 0.5), 1, 16))
        place = -wide * 0.45, -up - high + step * (line + 0.15)
        sketch.text(words_of(g, length), *place, step * 0.7, light.of(ink))


def display(sketch: Sketch, g: Generator, light: Light) -> None:
    """Draw a dot matrix that shows words or an arrow: over a road, on a bus, in a shop."""
    lines, length = g.integers((1, 2), (4, 11))
    dot = spread(g, 0.01, 0.06)
    up, rim, fill = g.uniform((1.5, 1, 0.4), (5.5, 4, 0.95))
    rim *= dot
    wide, high = (6 * length + 1) * dot, 12 * lines * dot
    half, foot = wide / 2, high - up
    sketch.box(half + rim, -up - rim, foot + rim, light.matt(g, 0.02, 0.2))
    lamp = light.led_cd_m2 * spread(g, 0.2, 3) + light.of(0.2)
    if g.random() < 0.3 and lines * length < 9:
        dots, off = (12 * lines, 6 * length + 1), light.matt(g, 0.02, 0.3)
        sketch.grid(half, -up, foot, *dots, fill, off, round=True)
    for line in range(lines):
        place = dot - half, dot * (12 * line + 1.5) - up
        sketch.text(words_of(g, length), *place, 8 * dot, lamp, fill)


def fence(sketch: Sketch, g: Generator, light: Light) -> None:
    """Draw a fence, a shutter, bricks, a grating or a mesh: bars or cells of one pitch."""
    wide, high = g.uniform((1.5, 0.8), (10, 3))
    pitch = spread(g, 0.04, 0.4)
    place = wide / 2, -high, 0
    rows, columns = (max(2, min(24, round(side / pitch))) for side in (high, wide))
    rows, columns = ((1, columns), (rows, 1), (rows, columns))[g.integers(3)]
    if g.random() < 0.7:
        sketch.box(*place, light.matt(g, 0.03, 0.7))
    shade = g.uniform(0.03, 0.8)
    shades = shade * np.exp(g.normal(0, g.uniform(0, 0.25), rows * columns))
    cells = rows, columns, g.uniform(0.25, 0.9)
    sketch.grid(*place, *cells, light.of(shades), round=g.random() < 0.2)


def lamp_post(sketch: Sketch, g: Generator, light: Light) -> None:
    """Draw a street lamp, traffic lights, a chain of lamps or a field of floodlights."""
    up, kind, lit = g.uniform(2.5, 8), g.integers(4), g.random() < light.lit
    lamp_light = light.lamp(g, 2e3, 1e5, lit=lit)
    sketch.box(0.07, -up, 0, light.matt(g, 0.03, 0.3))
    if kind == 0:
        centre = g.uniform(-1, 1), -up
        half = g.uniform((0.15, 0.06), (0.5, 0.25))
        sketch.dots(centre, half, lamp_light, round=True)
    elif kind == 1:
        sketch.box(0.18, -up, 1.0 - up, light.of(0.03))
        states = np.full(3, light.of(0.06))
        states[g.integers(3)] = light.lamp(g, 2e3, 2e4)
        sketch.grid(0.18, 0.02 - up, 0.98 - up, 3, 1, 0.7, states, round=True)
    else:
        rows, columns = (1, g.integers(4, 25)) if kind == 2 else g.integers(2, (6, 7))
        wide = columns * g.uniform(0.15, 0.6)
        bright = lamp_light * np.exp(g.normal(0, 0.15, rows * columns))
        foot, fill = rows * wide / columns - up, g.uniform(0.3, 0.8)
        sketch.grid(wide / 2, -up, foot, rows, columns, fill, bright, round=True)


def tree(sketch: Sketch, g: Generator, light: Light) -> None:
    """Draw a trunk and a crown of leaves in sun and shade."""
    up, wide = g.uniform((2.5, 1), (8, 3.5))
    sketch.box(0.15, -up, 0, light.of(0.07))
    leaves = g.integers(40, 120)
    at = g.normal((0, -up), (wide / 2, wide / 2.2), (leaves, 2))
    shade = light.of(np.exp(g.uniform(math.log(0.02), math.log(0.3), leaves)))
    half = g.uniform(0.1, 0.6, (leaves, 1))
    sketch.dots(at, half, shade, round=g.random() < 0.5)


def marks(sketch: Sketch, g: Generator, light: Light) -> None:
    """Draw lane marks and a crossing on the ground: x right and y ahead of the camera."""
    paint = light.matt(g, 0.3, 0.7)
    dash, lane, start, first = g.uniform((2, 2.8, 3, -2.5), (6, 3.8, 9, -1))
    for line in range(-1, 3):
        x = first + line * lane
        (dashes, fill) = (20, 0.5) if line in (0, 1) else (1, 1.0)
        sides = x - 0.08, x + 0.08
        sketch.grid(sides, start, start + 20 * dash, dashes, 1, fill, paint)
    if g.random() < 0.3:
        ahead, sides = g.uniform(8, 40), (first - lane, first + 2 * lane)
        sketch.grid(sides, ahead, ahead + 4, 1, g.integers(8, 16), 0.5, paint)


Thing = Callable[[Sketch, Generator, Light], None]

REACH_M: dict[Thing, float] = {
    vehicle: 4.0,
    house: 27.0,
    sign: 7.0,
    display: 8.0,
    fence: 6.0,
    lamp_post: 17.0,
    tree: 18.0,
}
"""How far each thing reaches from the middle of its foot at most, m."""

BESIDE: tuple[Thing, ...] = (vehicle, *REACH_M)
"""What a street is drawn from, each entry with the same chance."""
