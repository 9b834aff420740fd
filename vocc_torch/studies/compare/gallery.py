"""``gallery.png`` of ``task=effects``: one panel under each effect, at its harshest."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from vocc_torch.report import plots
from vocc_torch.report.plots import LOOK, Figure
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.framing import panel_corners_px
from vocc_torch.studies.compare.effect_plan import Effects, EffectStudy, ScenePair
from vocc_torch.types import Scene

Picture = NDArray[np.uint8]
"""Grey values (H,W); those beyond 255 are white."""


@dataclass(frozen=True)
class GallerySettings:
    """What is shown of a scene."""

    side_panels: float = 1.5  # side of a picture in sides of the panel
    least_spread_grey: float = 3.0  # least standard deviation with a panel in it
    seen_grey: float = 1.5  # least mean change that the eye sees
    enlarged_grey: int = 100  # what the largest difference is enlarged to
    columns: int = 6  # pictures in a row
    cell_in: tuple[float, float] = (1.8, 2.1)  # room of a picture and its name, inches


GALLERY = GallerySettings()


def gallery_figure(study: EffectStudy) -> Figure:
    """Show the pictures of :func:`gallery_pictures` in rows, each with its name, pixels as squares."""
    pictures = gallery_pictures(study)
    layout = plots.rows_of(list(range(len(pictures))), GALLERY.columns)
    light = "middle of the scene's light"
    note = f"{study.model.nearest_m:g} m, {light}; difference: from the scene, enlarged"
    width, height = GALLERY.cell_in
    size = max(7.0, width * len(layout[0])), 1.2 + height * len(layout)
    title = "One panel under each effect, at its strongest"
    figure, axes = plots.sheet(layout, size, title, note)
    for place, (name, picture) in enumerate(pictures.items()):
        axes[place].imshow(
            picture, cmap="gray", vmin=0, vmax=255, interpolation="nearest"
        )
        axes[place].set_title(name, fontsize=9.5, color=LOOK.ink)
        axes[place].set_axis_off()
    return figure


def gallery_pictures(study: EffectStudy) -> dict[str, Picture]:
    """Render the study's scene and its bits once, and with each effect at its harshest.

    The panel is at the nearest distance; ambient light and LED luminance are those in the middle of the
    scene's ranges, on a logarithmic scale. A severity that leaves no panel to see gives way to a milder one.
    What hardly changes the panel is shown over the frame where it shows there, else as its difference from
    the scene itself, enlarged, on middle grey.

    Returns:
        By what they show, the square about the panel's place, or the frame.
    """
    world, model = study.plan.world, study.model
    light: dict[str, Any] = {
        name: math.sqrt(math.prod(getattr(model, name).bounds))
        for name in ("ambient_lx", "led_luminance_cd_m2")
    }
    scene = Scene.of(distance_m=model.nearest_m, **light)
    key = FrameKey(BlockKey(study.plan.seed, "gallery", 0), 0)
    shape = world.panel.shape.rows, world.panel.shape.columns
    bits = torch.from_numpy(key.block.generator("bits").random(shape) < 0.5)
    corners = panel_corners_px(scene, world.camera, world.panel)[0]
    extent_px = float((corners.amax(0) - corners.amin(0)).max())
    side = round(GALLERY.side_panels * extent_px)
    left, top = (int(edge) for edge in (corners.mean(0) - side / 2).round().tolist())
    place = np.s_[max(0, top) : top + side, max(0, left) : left + side]

    def rendered(effects: Effects) -> Picture:
        simulator = replace(world, effects=effects, framing="full").simulator()
        frame = simulator.render(scene, bits[None], keys=[key]).grey[0, 0]
        return frame.double().clamp(0, 255).round().byte().cpu().numpy()

    plain = rendered(study.scene)
    pictures = {"the scene itself": plain[place]}
    for pair in study.pairs:
        frame = harshest(study, pair, rendered, place)
        name = " + ".join(pair.differing)
        change = frame.astype(int) - plain
        near = np.abs(change[place])
        picture = frame[place]
        if not near.any() and np.abs(change).mean() < GALLERY.seen_grey:
            name += "\nno visible change"
        elif near.mean() < GALLERY.seen_grey <= np.abs(change).mean():
            name, picture = f"{name}\nfull frame", frame
        elif near.mean() < GALLERY.seen_grey:
            factor = max(1, GALLERY.enlarged_grey // near.max())
            name += f"\ndifference x {factor}"
            picture = (128 + factor * change[place]).astype(np.uint8)
        pictures[name] = picture
    return pictures


def harshest(
    study: EffectStudy,
    pair: ScenePair,
    rendered: Callable[[Effects], Picture],
    place: tuple[slice, slice],
) -> Picture:
    """Render an effect at the harshest severity that leaves a panel to see.

    Args:
        study: the study.
        pair: the scene with the effect.
        rendered: renders a frame.
        place: where the panel is.
    """
    severity = study.config.severity.get(pair.name)
    scenes = [pair.present]
    if severity is not None:
        scenes = [study.at(pair.name, value) for value in severity.values]
    frame = rendered(scenes.pop())
    while scenes and frame[place].std() < GALLERY.least_spread_grey:
        frame = rendered(scenes.pop())
    return frame
