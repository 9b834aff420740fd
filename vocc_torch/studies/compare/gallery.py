"""``gallery.png`` of ``task=effects``: one panel under each effect, at its harshest."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch

from vocc_torch.arrays import Bytes
from vocc_torch.report.led_plots import Picture, picture_figure
from vocc_torch.report.plots import Figure
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.framing import panel_corners_px
from vocc_torch.studies.compare.effect_scenes import Effects, EffectStudy, ScenePair


@dataclass(frozen=True)
class GallerySettings:
    """What is shown of a scene."""

    side_panels: float = 1.5  # side of a picture in sides of the panel
    least_spread_grey: float = 3.0  # least standard deviation with a panel in it
    seen_grey: float = 1.5  # least mean change that the eye sees
    columns: int = 6  # pictures in a row
    cell_in: tuple[float, float] = (1.8, 0.3)  # width of a picture, height of its name


SETTINGS = GallerySettings()


def gallery_figure(study: EffectStudy) -> Figure:
    """Show the pictures of :func:`gallery_pictures` in rows, each with its name, pixels as squares."""
    nearest_m = study.plan.world.scene.nearest_m
    note = f"{nearest_m:g} m, the same frame for all"
    title = "One panel under each effect, at its strongest"
    pictures = list(gallery_pictures(study))
    grid = SETTINGS.columns, SETTINGS.cell_in
    return picture_figure(pictures, title, note, *grid)


def gallery_pictures(study: EffectStudy) -> Iterator[Picture]:
    """Render the study's scene and its bits once, and with each effect at its harshest.

    The panel is at the nearest distance; all else is drawn as for a test frame. A severity that leaves no
    panel to see gives way to a milder one.
    What hardly changes the panel's surroundings is shown over the whole frame.

    Yields:
        What is shown, with its grey values (H,W).
    """
    world, model = study.plan.world, study.plan.world.scene
    key = FrameKey(BlockKey(study.plan.seed, "gallery", 0), 0)
    drawn, bits = model.draw(key.block, world.panel.shape)
    scene = replace(drawn[:1], distance_m=torch.full((1,), model.nearest_m).double())
    corners = panel_corners_px(scene, world.camera, world.panel)[0].numpy()
    side = SETTINGS.side_panels * np.ptp(corners, axis=0).max()
    left, top = np.maximum(0, corners.mean(axis=0) - side / 2).round().astype(int)
    place = np.s_[top : top + round(side), left : left + round(side)]

    def rendered(effects: Effects) -> Bytes:
        simulator = replace(world, effects=effects, framing="full").simulator()
        grey = simulator.render(scene, bits[:1], keys=[key]).grey[0, 0]
        return np.asarray(grey.clamp(0, 255).round().byte().cpu())

    plain = rendered(study.scene)
    yield Picture(plain[place], "the scene itself")
    for pair in study.pairs:
        scenes = scenes_of(study, pair)
        frame = rendered(scenes.pop())
        while scenes and frame[place].std() < SETTINGS.least_spread_grey:
            frame = rendered(scenes.pop())
        near = np.abs(frame[place].astype(int) - plain[place]).mean()
        name = " + ".join(pair.differing)
        if near < SETTINGS.seen_grey:
            yield Picture(frame, f"{name}\nwhole frame")
        else:
            yield Picture(frame[place], name)


def scenes_of(study: EffectStudy, pair: ScenePair) -> list[Effects]:
    """Give the scene with an effect from harmless to harsh, or as it is where it has no severities."""
    if (severity := study.config.severity.get(pair.name)) is None:
        return [pair.present]
    return [study.at(pair.name, value) for value in severity.values]
