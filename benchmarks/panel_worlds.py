"""Small frames that ``benchmarks/train_panel_net.py`` learns from: any panel before anything.

Panels of 4 x 4 to 16 x 64 LEDs of 1.5 to 24 px, turned and aslant, with boards or without, lighter and darker
than what is around them, in streets, before drawn clutter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
import torch
from PIL import Image, ImageDraw
from torch import Tensor

from vocc_torch import Camera, PanelShape, Scene, Simulator
from vocc_torch.hardware import LedPanel
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.effects import Backdrop

SIDE_PX, BLOCK = 256, 16
SHAPES = ((8, 8),) * 6 + (
    (4, 4),
    (4, 4),
    (4, 8),
    (16, 16),
    (16, 16),
    (8, 16),
    (16, 8),
    (32, 32),
    (16, 64),
)
PITCHES_PX = (1.5, 24.0)


class World(NamedTuple):
    """Frames (B,1,H,W) of one panel's shape, its corners (B,4,2) px, zeros where there is none, and bits."""

    grey: Tensor
    corners_px: Tensor
    shape: PanelShape
    bits: Tensor | None = None


@dataclass(frozen=True)
class Kind:
    """Shapes of a kind of frames, the frames' side, px, how many make a block, pitches, px, and turns.

    ``scatter`` is the share of blocks whose LEDs differ in light, by 10 to 90 %.
    """

    shapes: Sequence[tuple[int, int]] = SHAPES
    side_px: int = SIDE_PX
    frames: int = BLOCK
    pitches_px: tuple[float, float] = PITCHES_PX
    yaw_deg: tuple[float, float] = (-30, 30)
    pitch_deg: tuple[float, float] = (-12, 12)
    scatter: float = 0.0


TRAINING = Kind()
ASLANT = Kind(yaw_deg=(-50, 50), pitch_deg=(-50, 50), scatter=0.5)
"""Panels seen from aside and from above, and such whose LEDs are unequal."""


@dataclass(frozen=True)
class Drawn(Backdrop):
    """Rectangles, discs, bars, gratings, letters and dots of light, drawn anew behind each panel."""

    def shade(self, x: Tensor, y: Tensor, context) -> Tensor:
        """Draw each frame's."""
        drawn = [
            drawing(one, context.camera.sensor_px)
            for one in context.generators(self.name, of_scene=True)
        ]
        planes = torch.from_numpy(np.stack(drawn))[:, None]
        rows = torch.arange(len(planes)).view(-1, 1, 1, 1)
        return planes[rows, 0, y, x]


def drawing(draw: np.random.Generator, size: tuple[int, int]) -> np.ndarray:
    """Draw a street's worth of shapes: light over the background's, (H,W)."""
    high, wide = size
    light = np.full(size, draw.uniform(0.3, 1.5))
    plane = Image.new("L", (wide, high), int(draw.integers(10, 120)))
    pen = ImageDraw.Draw(plane)
    for _ in range(draw.integers(0, 25)):
        x, y = draw.uniform(0, wide), draw.uniform(0, high)
        w, h = np.exp(draw.uniform(math.log(4), math.log(wide), 2))
        shade, kind = int(255 * draw.random() ** 2), draw.integers(8)
        box = [x - w / 2, y - h / 2, x + w / 2, y + h / 2]
        if kind < 2:
            pen.rectangle(box, fill=shade, outline=int(draw.integers(256)))
        elif kind == 2:
            pen.ellipse(box, fill=shade)
        elif kind == 3:
            pen.line(box, fill=shade, width=int(draw.integers(1, 8)))
        elif kind == 4:
            letters = "".join(
                chr(draw.integers(48, 91)) for _ in range(draw.integers(2, 10))
            )
            pen.text((x, y), letters, fill=shade, font_size=float(np.clip(h, 6, 80)))
        else:
            # A grating or a regular lattice: equal cells, which carry no bits.
            step = draw.uniform(2, 20)
            count = draw.integers(3, 20, 2)
            across = count[0] if kind != 5 else 1
            for i in range(int(across)):
                for j in range(int(count[1])):
                    left, top = x + i * step, y + j * step
                    right = left + step * (0.6 if kind != 5 else 8)
                    if kind == 7 and draw.random() < 0.15:
                        continue
                    (pen.ellipse if kind == 6 else pen.rectangle)(
                        [left, top, right, top + 0.5 * step], fill=shade
                    )
    light = light * (0.05 + np.asarray(plane, np.float64) / 128)
    return light.astype(np.float32)


def world(
    seed: int, block: int, *, cluttered: bool = True, kind: Kind = TRAINING
) -> World:
    """Render a block of frames of one shape, camera, board and set of effects."""
    key = BlockKey(seed, "train_locator", block)
    draw = key.generator("world")
    shape = PanelShape(*kind.shapes[draw.integers(len(kind.shapes))])
    diameter = 0.06 * draw.uniform(0.35, 0.95)
    board = [None, None, 0.02, 0.05, 0.1, 0.3, 0.8][draw.integers(7)]
    surfaces = {
        "led_reflectance": draw.uniform(0.03, 0.8),
        "background_reflectance": draw.uniform(0.1, 0.6),
    }
    panel = LedPanel(
        shape, diameter, 0.06 - diameter, board_reflectance=board, **surfaces
    )
    focal_mm = float(draw.uniform(10, 25))
    camera = Camera(
        focal_mm,
        width_px=kind.side_px,
        height_px=kind.side_px,
        sensor_width_mm=kind.side_px * 13.2 / 1920,
    )
    most = min(kind.pitches_px[1], 0.8 * kind.side_px / max(shape.rows, shape.columns))
    pitch = np.exp(
        draw.uniform(math.log(kind.pitches_px[0]), math.log(most), kind.frames)
    )
    distance = camera.focal_length_px * 0.06 / pitch
    ambient = np.exp(draw.uniform(math.log(100), math.log(32000), kind.frames))
    turn = draw.choice([5.0, 20.0, 44.0])
    reach = (
        np.clip(1.0 - pitch * max(shape.rows, shape.columns) / kind.side_px, 0.05, 0.9)
        * kind.side_px
        / 2
        / pitch
        * 0.06
    )
    scene = Scene(
        *(
            torch.from_numpy(
                np.asarray(values, np.float64).repeat(kind.frames)
                if np.ndim(values) == 0
                else values
            )
            for values in (
                ambient,
                ambient
                * surfaces["background_reflectance"]
                / math.pi
                * np.exp(draw.uniform(-1.2, 2.5, kind.frames)),
                distance,
                draw.uniform(30, 160, kind.frames),
                draw.uniform(-1, 1, kind.frames) * reach,
                draw.uniform(-1, 1, kind.frames) * reach,
            )
        )
    )
    bits = torch.from_numpy(
        draw.random((kind.frames, shape.rows, shape.columns))
        < draw.uniform(0.3, 0.7, (kind.frames, 1, 1))
    )
    effects: dict[str, object] = {
        "pose": {
            "yaw_deg": ["uniform", *kind.yaw_deg],
            "pitch_deg": ["uniform", *kind.pitch_deg],
            "roll_deg": ["uniform", -turn, turn],
        },
        "blooming": {"sigma_px": float(draw.uniform(0.3, 2.0))},
        "photoelectrons": {"quantum_efficiency": 0.6},
        "shot_noise": {},
        "read_noise": {"electrons": float(draw.uniform(1, 5))},
        "gain": {},
        "saturation": {},
        "quantization": {"bits": 8},
    }
    if kind.scatter and draw.random() < kind.scatter:
        effects["led_scatter"] = {
            "coefficient_of_variation": float(draw.uniform(0.1, 0.9))
        }
    if cluttered and draw.random() < 0.7:
        effects |= {"led_look": {}, "housing": {}}
        panel = replace(panel, board_reflectance=None)
    behind = draw.random() if cluttered else 1.0
    if behind < 0.6:
        effects |= {
            "scenery": {},
            "clutter": {"lit": float(draw.random()), "wet": 0.3},
            "panel_absent": {"share": 0.2},
        }
    elif behind < 0.9:
        effects["background_texture"] = {
            "contrast": float(draw.uniform(0.1, 0.8)),
            "beta": float(draw.uniform(1, 3)),
        }
    if draw.random() < 0.4:
        effects["jpeg"] = {"quality": int(draw.integers(40, 96))}
    keys = [FrameKey(key, one) for one in range(kind.frames)]
    built = list(Simulator(camera, panel, effects).effects)
    if cluttered and draw.random() < 0.5:
        built.append(Drawn())
    simulator = Simulator(camera, panel, built)
    grey, truth = (
        simulator.render(scene, bits, keys=keys).grey,
        simulator.true_panels(scene, keys),
    )
    return World(
        grey, truth.corners_px.float() * truth.found.view(-1, 1, 1), shape, bits
    )


def shaken(one: World, draw: np.random.Generator) -> World:
    """Mirror, invert and pale a block of frames, each kind at random: light's sign must not matter."""
    grey, corners = one.grey.float(), one.corners_px
    for axis in (0, 1):
        if draw.random() < 0.5:
            grey, there = (
                grey.flip(3 - axis),
                (corners != 0).any(2, keepdim=True).any(1, keepdim=True),
            )
            corners = corners.clone()
            corners[..., axis] = grey.shape[3 - axis] - corners[..., axis]
            corners = corners[:, [[1, 0, 3, 2], [3, 2, 1, 0]][axis]] * there
    gain = torch.from_numpy(
        draw.uniform(0.25, 1.0, len(grey)) * draw.choice([1, -1], len(grey))
    ).float()
    gain = gain.view(-1, 1, 1, 1)
    grey = torch.where(
        gain < 0,
        255 + grey * gain,
        grey * gain + (1 - gain) * float(draw.uniform(0, 200)),
    )
    return World(grey.clamp(0, 255), corners, one.shape)


def handmade(one: World, draw: np.random.Generator, off_cells: float = 0.1) -> World:
    """Warp pictures smoothly: LEDs then lie off their lattice, as in panels made by hand; corners stay."""
    warped, (high, wide) = [], one.grey.shape[2:]
    across, down = np.meshgrid(
        np.arange(wide, dtype=np.float32), np.arange(high, dtype=np.float32)
    )
    for grey, corners in zip(
        one.grey[:, 0].numpy(), one.corners_px.numpy(), strict=True
    ):
        pitch = (
            max(1.5, math.sqrt(cv2.contourArea(corners) / one.shape.leds))
            if corners.any()
            else 8.0
        )
        few = [max(2, round(side / pitch)) for side in (high, wide)]
        moves = (off_cells * pitch * draw.standard_normal((*few, 2))).astype(np.float32)
        moves = cv2.resize(moves, (wide, high), interpolation=cv2.INTER_CUBIC)
        at = (across + moves[..., 0], down + moves[..., 1])
        warped.append(
            cv2.remap(grey, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        )
    return World(torch.from_numpy(np.stack(warped))[:, None], one.corners_px, one.shape)
