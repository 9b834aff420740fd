"""Small frames of any panel before any background, the training data of both networks."""

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.simulator import Simulator
from vocc_torch.studies.train_detector.clutter import PHOTOGRAPHS, Behind
from vocc_torch.types import PanelShape, Scene

SHAPES = (
    ((8, 8),) * 6
    + ((4, 4),) * 4
    + ((4, 8), (8, 4), (16, 16), (16, 16), (8, 16), (16, 8), (8, 32), (32, 32))
)


@dataclass(frozen=True)
class WorldSettings:
    """What the training frames show."""

    width_px: int = 320
    height_px: int = 320
    frames: int = 16  # in a block, of one shape, camera and set of effects
    least_pitch_px: float = 1.6  # a shorter LED pitch cannot be read
    most_pitch_px: float = 32.0  # the pyramid halves longer ones
    most_fill: float = 0.85  # share of the frame's side that a panel fills
    pixel_um: float = 6.875  # of the paper's camera
    led_pitch_m: float = 0.06  # sets the distance, nothing else
    absent: float = 0.25  # share of frames without a panel


SMALL = WorldSettings()
"""Frames for most of the training."""

WIDE = WorldSettings(width_px=1920, height_px=1080, frames=4, absent=1.0)
"""Whole frames without a panel: what lies in them is as large and as far as in a street."""


class World(NamedTuple):
    """Frames (B,H,W) uint8 of a panel's shape, its corners (B,4,2) px, zeros for no panel, and its bits."""

    grey: Tensor
    corners_px: Tensor
    shape: PanelShape
    bits: Tensor


def world(
    seed: int,
    block: int,
    options: WorldSettings = SMALL,
    photographs: tuple[str, ...] = PHOTOGRAPHS,
) -> World:
    """Render a block of frames; the same ones for the same seed, block and options."""
    key = BlockKey(
        seed,
        "train_detector" if options == SMALL else f"train_detector {options}",
        block,
    )
    draw, frames = key.generator("world"), options.frames
    shape = PanelShape(*SHAPES[draw.integers(len(SHAPES))])
    diameter_m = options.led_pitch_m * draw.uniform(0.3, 0.95)
    board = (None, None, 0.02, 0.05, 0.1, 0.4, 0.8)[draw.integers(7)]
    background = draw.uniform(0.1, 0.6)
    panel = LedPanel(
        shape,
        diameter_m,
        options.led_pitch_m - diameter_m,
        board_reflectance=board,
        led_reflectance=draw.uniform(0.03, 0.8),
        background_reflectance=background,
    )
    side = min(options.width_px, options.height_px)
    camera = Camera(
        draw.uniform(10, 25),
        width_px=options.width_px,
        height_px=options.height_px,
        sensor_width_mm=options.width_px * options.pixel_um / 1e3,
    )
    leds = max(shape.rows, shape.columns)
    most = min(options.most_pitch_px, options.most_fill * side / leds)
    pitch_px = np.exp(
        draw.uniform(math.log(options.least_pitch_px), math.log(most), frames)
    )
    ambient = np.exp(
        draw.uniform(
            math.log(10 if draw.random() < 0.3 else 300), math.log(32000), frames
        )
    )
    reach_m = (side / pitch_px - 0.9 * leds).clip(1) * options.led_pitch_m / 2
    values = (
        ambient,
        ambient * background / math.pi * np.exp(draw.uniform(-1.2, 2.5, frames)),
        camera.focal_length_px * options.led_pitch_m / pitch_px,
        draw.uniform(30, 160, frames),
        draw.uniform(-1, 1, frames) * reach_m,
        draw.uniform(-1, 1, frames) * reach_m,
    )
    scene = Scene(*(torch.from_numpy(value) for value in values))
    share = draw.uniform(0.25, 0.75, (frames, 1, 1))
    bits = torch.from_numpy(draw.random((frames, shape.rows, shape.columns)) < share)
    effects = _effects(draw, options.absent)
    if "housing" in effects:
        panel = replace(panel, board_reflectance=None)
    parts = list(Simulator(camera, panel, effects).effects)
    behind = draw.random()
    if behind < 0.35:
        parts.append(Behind())
    elif behind < 0.65:
        parts.append(Behind(photographs))
    keys = [FrameKey(key, number) for number in range(frames)]
    simulator = Simulator(camera, panel, parts)
    grey = simulator.render(scene, bits, keys=keys).grey[:, 0]
    truth = simulator.true_panels(scene, keys)
    return World(
        grey, truth.corners_px.float() * truth.found.view(-1, 1, 1), shape, bits
    )


def _effects(draw: np.random.Generator, absent: float) -> dict[str, dict[str, Any]]:
    """Draw the effects of a block."""
    turn = float(draw.choice((5.0, 20.0, 45.0)))
    aslant = float(draw.choice((15.0, 30.0, 50.0)))
    effects: dict[str, dict[str, Any]] = {
        "pose": {
            "yaw_deg": ["uniform", -aslant, aslant],
            "pitch_deg": ["uniform", -aslant, aslant]
            if draw.random() < 0.5
            else ["uniform", -10, 10],
            "roll_deg": ["uniform", -turn, turn],
        },
        "blooming": {"sigma_px": float(draw.uniform(0.3, 1.8))},
        "photoelectrons": {"quantum_efficiency": 0.6},
        "shot_noise": {},
        "read_noise": {"electrons": float(draw.uniform(1, 6))},
        "gain": {},
        "saturation": {},
        "quantization": {"bits": 8},
        "panel_absent": {"share": absent},
    }
    if draw.random() < 0.35:
        effects["led_scatter"] = {
            "coefficient_of_variation": float(draw.uniform(0.1, 0.8))
        }
    if draw.random() < 0.6:
        effects |= {"led_look": {}, "housing": {}}
    if draw.random() < 0.5:
        effects |= {"scenery": {}, "clutter": {"lit": float(draw.random()), "wet": 0.3}}
    if draw.random() < 0.25:
        effects["background_texture"] = {
            "contrast": float(draw.uniform(0.1, 0.8)),
            "beta": float(draw.uniform(1, 3)),
        }
    if draw.random() < 0.35:
        effects["jpeg"] = {"quality": int(draw.integers(40, 96))}
    return effects
