"""One panel as the camera sees it under each of several sets of effects."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from vocc_torch.measure.plan import World
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.effects import Parameters
from vocc_torch.simulation.geometry import panel_corners_px
from vocc_torch.studies.effects.plan import EffectStudy
from vocc_torch.types import Scene

SHOWN_SHARE = 1.5
"""Side of a picture in sides of the panel."""

THE_SCENE = "the scene itself"


def gallery_pictures(study: EffectStudy) -> dict[str, NDArray[np.uint8]]:
    """Show the study's scene, and with each effect at its harshest, from the nearest distance.

    Ambient light and LED luminance are those in the middle of the scene's ranges, on a logarithmic scale.
    """
    cases: dict[str, Mapping[str, Parameters]] = {THE_SCENE: study.plan.world.effects}
    for one in study.comparisons:
        values = study.catalogue.severities.get(one.name)
        cases[one.name] = study.catalogue.at(one.name, values.values[-1]) if values else one.present
    model = study.model
    middle = {
        name: math.sqrt(math.prod(getattr(model, name).bounds))
        for name in ("ambient_lx", "led_luminance_cd_m2")
    }
    return effect_pictures(
        study.plan.world, cases, distance_m=model.nearest_m, seed=study.plan.seed, **middle
    )


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
        >>> cases = {"none": {}, "blurred": {"blooming": {"sigma_px": 2}}}
        >>> pictures = effect_pictures(World(device="cpu"), cases)
        >>> {name: picture.shape for name, picture in pictures.items()}
        {'none': (105, 105), 'blurred': (105, 105)}
    """
    scene = Scene.of(distance_m=distance_m, ambient_lx=ambient_lx, led_luminance_cd_m2=led_luminance_cd_m2)
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
