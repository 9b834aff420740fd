"""One panel as the camera sees it under each of several sets of effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.effects import Parameters
from vocc_torch.simulation.geometry import panel_corners_px
from vocc_torch.studies.plan import World
from vocc_torch.types import Scene

SHOWN_SHARE = 1.5
"""Side of a picture in sides of the panel."""


def effect_pictures(
    world: World,
    cases: Mapping[str, Mapping[str, Parameters]],
    *,
    distance_m: float = 25.0,
    ambient_lx: float = 4000.0,
    led_luminance_cd_m2: float = 3000.0,
    seed: int = 0,
) -> dict[str, NDArray[np.uint8]]:
    """Render one scene and its bits once under each set of effects.

    Args:
        world: camera and panel; its own effects and scenes are not used.
        cases: by name, the effects.
        distance_m: of the panel, m.
        ambient_lx: of the scene, lx.
        led_luminance_cd_m2: of the LEDs, cd/m2.
        seed: of the bits and of what the effects draw, at least 0.

    Returns:
        By name, the square about the panel's place, (H,W) uint8; grey values beyond 255 are white.

    Example:
        >>> pictures = effect_pictures(World(device="cpu"), {"none": {}, "blurred": {"blooming": {"sigma_px": 2}}})
        >>> {name: picture.shape for name, picture in pictures.items()}
        {'none': (105, 105), 'blurred': (105, 105)}
    """
    scene = Scene.of(
        distance_m=distance_m, ambient_lx=ambient_lx, led_luminance_cd_m2=led_luminance_cd_m2
    )
    key = FrameKey(BlockKey(seed, "gallery", 0), 0)
    shape = world.panel.shape.rows, world.panel.shape.columns
    bits = torch.from_numpy(key.block.generator("bits").random(shape) < 0.5).unsqueeze(0)
    corners = panel_corners_px(scene, world.camera, world.panel)[0]
    side = round(SHOWN_SHARE * float((corners.amax(0) - corners.amin(0)).max()))
    left, top = (int(c) for c in (corners.mean(0) - side / 2).round().tolist())
    pictures = {}
    for name, effects in cases.items():
        simulator = replace(world, effects=effects, framing="full").simulator()
        frame = simulator.render(scene, bits, keys=[key]).grey[0, 0]
        shown = frame[max(0, top) : top + side, max(0, left) : left + side]
        pictures[name] = shown.double().clamp(0, 255).round().byte().cpu().numpy()
    return pictures
