"""Panels as they are: what they are built into, how their LEDs look and are driven, and none at all."""

import functools
import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.random import Generator
from torch import Tensor

from vocc_torch.simulation.effects import street
from vocc_torch.simulation.effects.base import (
    Context,
    Effect,
    Quantity,
    of_kind,
    within,
)
from vocc_torch.simulation.roadside import Light
from vocc_torch.simulation.scene import Distribution
from vocc_torch.simulation.sketch import Sketch


class PanelAbsent(Effect, on=Quantity.LED_LUMINANCE):
    """Frames without a panel, otherwise as frames with one.

    Of such a frame the true panel is said not to be found. Which frames these are belongs to the scene, so a
    frame and its preambles are alike. Sampled: not differentiable in the share; the light of the panels that
    are there keeps its gradient.

    Source: a Bernoulli draw for each frame.

    Args:
        share: share of frames without a panel, above 0 and at most 1.

    Raises:
        VoccError: a share outside its range.

    Example:
        >>> PanelAbsent().share
        1.0
    """

    share: float = within(
        0,
        1,
        default=1.0,
        above=True,
        hint="leave the effect out for a panel in every frame",
    )
    sampled = True

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Put out the (B,R,C) luminance of panels that are not there."""
        return value * present(context).to(value).view(-1, 1, 1)


@dataclass(frozen=True, slots=True)
class Look:
    """How each frame's LEDs look, each (B,1,1): m, bool, 0 to 1, and bool: whether Off LEDs can be seen."""

    radius_m: Tensor
    square: Tensor
    reflectance: Tensor
    visible: Tensor


class LedLook(Effect, on=Quantity.LED_LUMINANCE):
    """Another kind of LED in every frame: size, shape, reflectance, and whether Off LEDs can be seen.

    What the panel itself says of its LEDs' size and surface is replaced. A square LED has the width that a
    round one has as its diameter. One that is smaller than the panel's sends the same light from its smaller
    area; a wider one has the panel's luminance. Off LEDs that are not visible look like what is behind them.
    A frame and its preambles show one panel. Sampled: not differentiable in the looks; the light keeps its
    gradient.

    Source: the makes of LED on sale: bare dies and lenses of a twentieth of the pitch, 3 and 5 mm LEDs and
    squares of 0.3 to 0.95 of it, diffusers that touch.

    Args:
        fill: an LED's width over the pitch, a number or a distribution, 0.02 to 1.
        square: share of frames whose LEDs are square, 0 to 1.
        reflectance: reflectance of Off LEDs, a number or a distribution, 0 to 1.
        invisible: share of frames whose Off LEDs are not seen, 0 to 1.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> LedLook(fill=0.8).square
        0.3
    """

    fill: Distribution | float = within(
        0.02, 1, default=Distribution("uniform", (0.15, 0.95))
    )
    square: float = within(0, 1, default=0.3)
    reflectance: Distribution | float = within(
        0, 1, default=Distribution("uniform", (0.05, 0.7))
    )
    invisible: float = within(0, 1, default=0.25)
    sampled = True

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Send the (B,R,C) light of an LED from the area that it has; the painter asks for the look."""
        nominal = context.panel.led_diameter_m / (2 * self.look(context).radius_m)
        return value * nominal.square().clamp(min=1).to(value)

    def look(self, context: Context) -> Look:
        """Draw each frame's look."""

        def draw(g: Generator) -> tuple[float, ...]:
            return self.drawn("fill", g), self.drawn("reflectance", g), *g.random(2)

        drawn = context.draws(self.name, draw, of_scene=True)
        fill, reflectance, shape, visibility = drawn[..., None, None].unbind(1)
        radius = fill * (context.panel.pitch_m / 2)
        return Look(
            radius, shape < self.square, reflectance, visibility >= self.invisible
        )


class Multiplexing(Effect, on=Quantity.LED_LUMINANCE):
    """Rows that are driven in turn, so that a short exposure sees some of them dark.

    Row i is in group ``i mod groups``; each group is lit for its share of a period of ``1 / refresh_hz``, at
    ``groups`` times the mean luminance. A row's light is what the exposure catches of that, from a phase that
    is uniform; of a long exposure all rows are alike. The whole panel is taken to be exposed at once. Each
    picture has a phase of its own. Sampled: not differentiable in the timing; the light keeps its gradient.

    Source: the exact overlap of an exposure with a periodic train of pulses.

    Args:
        groups: number of groups of rows, of which one is lit at a time, a whole number, 2 to 64;
            matrices on sale have 4 to 32.
        refresh_hz: how often each group is lit, Hz, a number or a distribution, 1 to 1e6; panels on sale have
            60 to 4000.
        share: share of frames with multiplexing, above 0 and at most 1; in others all rows are lit together.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> Multiplexing(groups=8, refresh_hz=400.0).share
        1.0
    """

    groups: int = within(2, 64, whole=True)
    refresh_hz: Distribution | float = within(1, 1e6)
    share: float = within(
        0, 1, default=1.0, above=True, hint="leave the effect out for none"
    )
    sampled = True

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Multiply each row's (B,R,C) luminance by what the exposure catches of its pulses."""
        drawn = context.draws(
            self.name, lambda g: (self.drawn("refresh_hz", g), *g.random(2))
        )
        rate, phase, chosen = drawn.unsqueeze(-1).unbind(1)
        length = rate * context.camera.exposure_time_s
        rows = torch.arange(value.shape[1], device=value.device)
        begin = rows % self.groups / self.groups
        caught = self._lit(phase + length, begin) - self._lit(phase, begin)
        factor = torch.where(chosen < self.share, caught * self.groups / length, 1.0)
        return value * factor.to(value).unsqueeze(-1)

    def _lit(self, until: Tensor, begin: Tensor) -> Tensor:
        """For how much of the first ``until`` periods (B,1) the rows that begin at ``begin`` (R,) are lit."""
        periods = torch.floor(until)
        return periods / self.groups + (until - periods - begin).clamp(
            0, 1 / self.groups
        )


class Housing(street.Sketched):
    """The panel's housing: a dark or light board behind the LEDs or none, a rim, and cables.

    All lie in the panel's plane and are matt, in the scene's daylight. The board covers the LEDs' cells and
    the rim surrounds it; either may be left out. Cables run off from the rim in bent strips. The panel's
    ``board_reflectance`` is replaced by the board here. A frame and its preambles share it. Sampled: not
    differentiable in the sizes; the light behind keeps its gradient.

    Source: matt surfaces as in Eqs 2 and 3; sizes and reflectances of panels on sale in broad strokes.

    Args:
        board: reflectance of the board, a number or a distribution, 0 to 1.
        boardless: share of frames without a board, 0 to 1.
        rim: width of the rim in LED cells, a number or a distribution, 0 to 10; 0 is none.
        rim_reflectance: reflectance of the rim, a number or a distribution, 0 to 1.
        cables: number of cables, a number or a distribution, 0 to 20.

    Raises:
        VoccError: a value outside its range.

    Example:
        >>> Housing(boardless=0.5).fills_sensor
        True
    """

    board: Distribution | float = within(
        0, 1, default=Distribution("log_uniform", (0.02, 0.6))
    )
    boardless: float = within(0, 1, default=0.25)
    rim: Distribution | float = within(
        0, 10, default=Distribution("choice", (0.0, 0.1, 0.3, 0.6, 1.5))
    )
    rim_reflectance: Distribution | float = within(
        0, 1, default=Distribution("log_uniform", (0.02, 0.8))
    )
    cables: Distribution | float = within(
        0, 20, default=Distribution("choice", (0.0, 0.0, 1.0, 3.0))
    )

    def draw(self, layer: street.Layer, generator: Generator) -> None:
        """Draw one frame's board, rim and cables, where it has a panel."""
        parts = self.sketch(generator, layer.camera_view.context).parts
        if parts and bool(present(layer.camera_view.context)):
            layer.lay(parts, functools.partial(street.onto, layer.camera_view))

    def sketch(self, generator: Generator, context: Context) -> Sketch:
        """Draw one frame's parts, m from the panel's middle."""
        panel, drawing = context.panel, Sketch()
        board, rim, reflectance, cables = (
            self.drawn(name, generator)
            for name in ("board", "rim", "rim_reflectance", "cables")
        )
        light = Light(float(context.scene.ambient_lx[0]) / math.pi, 0.0, 0.0)
        y, x = (side * panel.pitch_m / 2 for side in panel.shape.sides)
        rim, shade = rim * panel.pitch_m, light.of(reflectance)
        bare = generator.random() < self.boardless
        for _ in range(round(cables)):
            side = generator.uniform(0.1, 0.8) * panel.pitch_m / 2, 0
            steps = np.arange(9) / 8 * generator.uniform(0.5, 3)
            bend = np.cumsum(generator.normal(0, 0.3, 9)) + generator.uniform(-1, 1)
            line = np.stack([bend * x, y * (0.9 + steps)], axis=-1)
            line *= generator.choice([-1, 1])
            outline = [*(line - side), *(line + side)[::-1]]
            drawing.polygon(outline, light.matt(generator, 0.02, 0.7))
        high, wide = y + rim, x + rim
        if rim and not bare:
            drawing.box(wide, -high, high, shade)
        elif rim:
            for row in (-y, y):
                drawing.box(wide, row - rim, row + rim, shade)
            for column in (-x, x):
                drawing.box((column - rim, column + rim), -high, high, shade)
        if not bare:
            drawing.box(x, -y, y, light.of(board))
        return drawing


def look(context: Context) -> Look | None:
    """How each frame's LEDs look, or None where all are as the panel says."""
    effect = of_kind(context.effects, LedLook)
    return None if effect is None else effect.look(context)


def present(context: Context) -> Tensor:
    """Which frames have a panel, (B,) bool."""
    if effect := of_kind(context.effects, PanelAbsent):
        drawn = context.draws(effect.name, Generator.random, of_scene=True)
        return drawn >= effect.share
    return torch.ones_like(context.scene.distance_m, dtype=torch.bool)


AT_THE_LEDS = (LedLook, Multiplexing, PanelAbsent)
AROUND = (Housing,)
"""In physical order; what stands in the background comes between the two."""
