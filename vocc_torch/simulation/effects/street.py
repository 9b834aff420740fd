"""A street around the panel: photographs or a drawn scenery behind, and what stands before it."""

import functools
import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.random import SFC64, Generator
from torch import Tensor

from vocc_torch.arrays import Floats, Singles
from vocc_torch.hardware import Camera
from vocc_torch.simulation import roadside, sketch
from vocc_torch.simulation.effects import colour, view
from vocc_torch.simulation.effects.base import Context, FrameEffect, Quantity, within
from vocc_torch.simulation.raster import Size
from vocc_torch.simulation.scene import Distribution

STRIP_PX = 32
"""Rows that are filled at a time: their working arrays stay in the cache."""

SKY = {None: 1.0, 0: 0.88, 1: 1.0, 2: 1.31}
"""What luma and each channel see of the sky over its luminance: blue, of luma 1."""

Place = Callable[[Floats], Floats]
"""Takes points (M,2) on a plane, m, to the sensor, px."""

NODE_PX = 8
"""Distance of the nodes between which drawn textures run evenly, px."""


def noise_nodes(generator: Generator, sensor_px: Size) -> Singles:
    """Draw noise of seven octaves of one variance each, as natural scenes have about, on nodes 8 px apart."""
    height, width = (-(-side // NODE_PX) + 2 for side in sensor_px)
    nodes = np.zeros((height, width), dtype=np.float32)
    for octave in range(7):
        step = 1 << octave
        coarse = generator.standard_normal(
            (height // step + 3, width // step + 3), dtype=np.float32
        )
        x, y = np.arange(width) / step, np.arange(height) / step
        nodes += between(coarse, x, y)
    return nodes / np.float32(math.sqrt(7))


def between(nodes: Singles, x: Floats, y: Floats) -> Singles:
    """Interpolate nodes (h,w) bilinearly at columns x (W,) and rows y (H,), to (H,W)."""
    return down(across(nodes, x), y)


def across(nodes: Singles, x: Floats) -> Singles:
    """Interpolate nodes (h,w) at columns x (W,), to (h,W)."""
    column = x.astype(int)
    u = (x - column).astype(np.float32)
    filled: Singles = nodes[:, column] * (1 - u) + nodes[:, column + 1] * u
    return filled


def down(lines: Singles, y: Floats) -> Singles:
    """Interpolate lines (h,W) at rows y (H,), to (H,W)."""
    row = y.astype(int)
    low: Singles = lines[row]
    filled: Singles = lines[row + 1]
    filled -= low
    filled *= (y - row).astype(np.float32)[:, None]
    filled += low
    return filled


class Scenery(FrameEffect, on=Quantity.BACKGROUND):
    """Textured sky, skyline and ground in place of a plain background.

    The horizon lies near the sensor's middle. The sky has 2 to 7 times the plain background's luminance, the
    skyline 0.15 to 1.5, the ground 0.3 to 2; each has a texture of equal contrast in every octave. Auto-ISO
    meters the plain background, as an incident meter does. A frame and its preambles share it. Sampled: the
    scenery is a constant to automatic differentiation, and the light keeps its gradient.

    Source: value noise, whose octaves of one variance have the power spectrum ``1 / f^2`` of natural images
    (D. J. Field, J. Opt. Soc. Am. A 4, 1987); luminances by the reflectances of asphalt (0.05 to 0.2), grass
    and walls (0.1 to 0.3), and a sky that lights a level plane.

    Args:
        contrast: standard deviation of the logarithm of the skyline's texture, 0 to 1; sky and ground have
            less.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> Scenery().contrast
        0.35
    """

    contrast: float = within(0, 1, default=0.35)

    def frame(self, plane: Tensor, generator: Generator, context: Context) -> Tensor:
        """Multiply (1,H,W) background luminance by the frame's scenery."""
        left, top = context.first_px[0].tolist()
        sensor_px = context.camera.sensor_px
        sky, far, ground = (
            roadside.spread(generator, low, high)
            for low, high in ((2, 7), (0.15, 1.5), (0.3, 2))
        )
        sky *= SKY[context.channel]
        horizon = sensor_px[0] * generator.uniform(0.42, 0.55)
        nodes = noise_nodes(generator, (1, sensor_px[1]))[:1]
        x = (left + np.arange(plane.shape[2]) + 0.5) / NODE_PX
        skyline = across(nodes * generator.uniform(0.02, 0.12), x)
        edge = horizon - np.maximum(skyline + np.float32(0.05), 0) * sensor_px[0]
        texture = across(noise_nodes(generator, sensor_px), x)
        for first in range(0, plane.shape[1], STRIP_PX):
            strip = plane[0, first : first + STRIP_PX]
            y = top + first + np.arange(len(strip)) + 0.5
            rows = y.astype(np.float32)[:, None]
            # Where all of a row is sky, or all is not, one number stands for it.
            mixed = rows[0] < edge.max() + 1 and rows[-1] > edge.min() - 1
            above = np.clip((edge if mixed else edge[:, :1]) - rows + 0.5, 0, 1)
            below = np.clip(y - horizon + 0.5, 0, 1).astype(np.float32)[:, None]
            # Brighter towards the horizon, and the ground darker towards the camera.
            lift = (1 + 0.4 * (y / sensor_px[0] - 0.5)).astype(np.float32)[:, None]
            middle = 1 - above - below
            base = above * (sky * lift) + middle * np.float32(far)
            base += below * (ground / lift)
            depth = np.float32(self.contrast) * (0.4 * above + middle + 0.5 * below)
            wave = down(texture, y / NODE_PX) * depth
            # The exponential's first terms: the same numbers wherever a pixel lies in its array.
            luminance = (wave + 1 + wave * wave * np.float32(0.5)) * base
            strip.mul_(torch.from_numpy(luminance).to(strip))
        return plane


@dataclass(slots=True)
class Layer:
    """What lies before one frame's background.

    Args:
        camera_view: the frame alone, as its camera sees the panel.
        window: the part of the sensor that it covers, px: left, top, right and bottom.
        things: what was laid, the farthest first.
        dirt: (h,w) nodes of a texture on all of it, on the sensor; None for none.
    """

    camera_view: view.View
    window: sketch.Window
    things: list[sketch.Drawing] = field(default_factory=list)
    dirt: Singles | None = None

    def lay(
        self,
        parts: list[sketch.Part],
        place: Place,
        share: float = 1.0,
        seed: int | None = None,
    ) -> None:
        """Lay a sketch before what is there: a mirror's ``share`` of it, in the colours of a ``seed``."""
        if seed is not None and self.camera_view.context.channel is not None:
            tints = colour.tints(seed, len(parts), self.camera_view.context.channel)
            parts = [
                (points, light * tint)
                for (points, light), tint in zip(parts, tints, strict=True)
            ]
        if thing := sketch.Drawing.on_sensor(parts, place, share):
            self.things.append(thing)

    def drawn(self) -> sketch.Picture:
        """Draw: how much of what is behind stays, and the light of the things."""
        left, top, right, bottom = self.window
        keep, added = sketch.composed(self.things, self.window)
        if self.dirt is not None:
            x, y = np.arange(left, right) + 0.5, np.arange(top, bottom) + 0.5
            dirt = between(self.dirt, x / NODE_PX, y / NODE_PX)
            added *= np.maximum(1 + np.float32(0.12) * dirt, 0)
        return keep, added


class Sketched(FrameEffect, on=Quantity.BACKGROUND):
    """Objects drawn before the background."""

    @abstractmethod
    def draw(self, layer: Layer, generator: Generator) -> None:
        """Draw one frame's things."""

    def frame(self, plane: Tensor, generator: Generator, context: Context) -> Tensor:
        """Lay what is drawn before the frame's (1,H,W) background luminance."""
        left, top = context.first_px[0].tolist()
        window = left, top, left + plane.shape[2], top + plane.shape[1]
        layer = Layer(view.view_of(context), window)
        self.draw(layer, generator)
        keep, light = (torch.from_numpy(part).to(plane) for part in layer.drawn())
        return plane * keep + light


Placed = tuple[float, roadside.Thing, Place, int, Floats, float]
"""Distance m, what is drawn, how it lies on the sensor, its seed, its middle on the sensor, its reach, px."""


class Clutter(Sketched):
    """Vehicles, houses, signs with lettering, displays of dots, fences, lamps and trees behind the panel.

    Each is a flat drawing of random proportions on a plane of its own, seen through the pinhole camera from
    1.3 m above a road, the far ones behind the near ones. Surfaces are matt and lie in the scene's daylight;
    lamps and displays have a luminance of their own: the same street is a day's and a night's. What is nearer
    than the panel does not cover it. In ``carried`` of the frames the panel is on the back or the front of a
    vehicle, which has its pose. No display shows random dots: no thing here is a panel.

    Lamps shine at their luminance whatever the distance; the scene's ``airlight`` dims all of the background
    as at the panel's distance. Straight edges stay straight: ``lens_distortion`` bends the panel and the
    vehicle that carries it. A frame and its preambles share it. Sampled: not differentiable in places nor in
    shapes; the light behind keeps its gradient.

    Source: matt surfaces as in Eqs 2 and 3, the pinhole camera; reflectances, luminances and sizes are those
    of everyday things in broad strokes.

    Args:
        things: number of things in a frame, a number or a distribution, 0 to 200.
        lit: share of vehicles, windows and lamps that are lit, 0 to 1.
        carried: share of frames whose panel is on a vehicle, 0 to 1.
        wet: share of frames whose ground mirrors what stands on it, 0 to 1.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> Clutter(things=8).lit
        0.3
    """

    things: Distribution | float = within(
        0, 200, default=Distribution("uniform", (6.0, 20.0))
    )
    lit: float = within(0, 1, default=0.3)
    carried: float = within(0, 1, default=0.6)
    wet: float = within(0, 1, default=0.2)

    def draw(self, layer: Layer, generator: Generator) -> None:
        """Draw one frame's things."""
        (left, top, right, bottom), context = layer.window, layer.camera_view.context
        white, led = context.scene.ambient_lx[0], context.scene.led_luminance_cd_m2[0]
        light = roadside.Light(float(white) / math.pi, float(led), self.lit)
        wet = (generator.random() < self.wet) * generator.uniform(0.1, 0.5)
        things = self.placed(generator, layer.camera_view)
        things.sort(key=lambda placed: -placed[0])
        for _, thing, place, seed, (x, y), reach in things:
            if max(x - right, left - x, y - bottom, top - y) > reach:
                continue
            drawing = sketch.Sketch()
            thing(drawing, Generator(SFC64(seed)), light)
            parts = drawing.parts
            if wet and thing is not roadside.marks:
                mirrored = [(points * (1, -1), shades) for points, shades in parts]
                layer.lay(mirrored, place, wet, seed)
            layer.lay(parts, place, seed=seed)
        # No surface is of one shade: dirt, and what it mirrors.
        layer.dirt = noise_nodes(generator, context.camera.sensor_px)

    def placed(self, generator: Generator, camera_view: view.View) -> list[Placed]:
        """Choose and place the vehicles and other objects of a frame."""
        context = camera_view.context
        camera, panel = context.camera, context.panel
        panel_m, width = float(context.scene.distance_m[0]), camera.width_px
        focal = camera.focal_length_px
        count = round(self.drawn("things", generator))
        kinds = generator.integers(len(roadside.BESIDE), size=count)
        depths = np.exp(generator.uniform(math.log(8), math.log(150), count))
        columns = generator.uniform(0, width, count)
        turns = generator.standard_normal((count, 2)) * (0.15, 0.03)
        along = generator.random(count) < 0.5
        *seeds, host_seed, road_seed = generator.integers(1 << 62, size=count + 2)
        slope = generator.uniform(-0.03, 0.03)
        carried = generator.random() < self.carried
        at = generator.uniform((-0.25, 0.3), (0.25, 0.75))
        corners = camera_view.points_px(view.panel_corners_m(panel))[0].cpu().numpy()
        centre = corners.mean(axis=0)
        extent = np.abs(corners - centre).max()
        plane = functools.partial(through_pinhole, camera)
        road = functools.partial(plane, ((1, 0, 0), (0, slope, 1)), (0, 1.3, 0))
        things: list[Placed] = [
            (math.inf, roadside.marks, road, road_seed, centre, math.inf)
        ]
        places = zip(kinds, depths, columns, turns, along, seeds, strict=True)
        for kind, depth, column, (yaw, roll), beside, seed in places:
            thing = roadside.BESIDE[kind]
            if beside and thing is roadside.house:
                yaw += math.copysign(0.9, width / 2 - column)
            aside, down = (column - width / 2) / focal * depth, 1.3 + slope * depth
            middle = np.array([column, camera.height_px / 2 + down / depth * focal])
            reach = roadside.REACH_M[thing]
            reach *= focal / max(depth - reach * abs(math.sin(yaw)), 2.0)
            before = np.abs(middle - centre).max() < reach + extent
            if depth > panel_m or not before:
                place = functools.partial(
                    plane, turned(yaw, roll), (aside, down, depth)
                )
                things.append((depth, thing, place, seed, middle, reach))
        if carried:
            least = panel.pitch_m * max(panel.shape.sides)
            host = functools.partial(roadside.vehicle, least_m=least)
            reach = 12 * max(1.0, least) * focal / panel_m
            behind = functools.partial(on_vehicle, camera_view, at)
            things.append((panel_m, host, behind, host_seed, centre, reach))
        return things


def turned(yaw: float, roll: float) -> tuple[tuple[float, float, float], ...]:
    """Give the axes of an upright plane that is turned, rad: to the right and down."""
    sine, cosine = math.sin(roll), math.cos(roll)
    across = cosine * math.cos(yaw), sine, -cosine * math.sin(yaw)
    return across, (-sine, cosine, 0)


def on_vehicle(camera_view: view.View, at: Floats, points: Floats) -> Floats:
    """Map points of a vehicle onto the sensor, px: the panel is at shares of its width and height."""
    (left, top), (right, bottom) = points.min(axis=0), points.max(axis=0)
    shift = at * (right - left, min(top, -bottom))
    return onto(camera_view, points - shift)


def onto(camera_view: view.View, points: Floats) -> Floats:
    """Map points (M,2) of one frame's panel, m, onto the sensor, px; NaN where some of them have no image."""
    points_m = torch.from_numpy(points)
    if not bool(camera_view.has_image(points_m, 0.0).all()):
        return np.full_like(points, np.nan)
    return camera_view.points_px(points_m)[0].cpu().numpy()


def through_pinhole(
    camera: Camera,
    axes: Sequence[Sequence[float]],
    foot: Sequence[float],
    points: Floats,
) -> Floats:
    """Map points (M,2) of a plane, m, onto the sensor, px, by the plane's axes (2,3) and its foot (3,)."""
    projected = points @ np.array(axes) + foot
    middle = np.array([camera.width_px, camera.height_px]) / 2
    scaled = camera.focal_length_px * projected[:, :2]
    onto: Floats = middle + scaled / np.maximum(projected[:, 2:], 0.5)
    return onto
