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
from vocc_torch.studies.compare.effect_scenes import Effects, EffectStudy


@dataclass(frozen=True)
class GallerySettings:
    """What is shown of a scene."""

    side_panels: float = 1.5  # side of a picture in sides of the panel
    least_spread_grey: float = 3.0  # least standard deviation with a panel in it
    seen_grey: float = 5.0  # least change that the eye sees
    seen_percent: float = 1.0  # of the pixels, that must change so much
    draws: int = 4  # of an effect that not every frame shows
    columns: int = 6  # pictures in a row
    cell_in: tuple[float, float] = (1.8, 0.3)  # width of a picture, height of its name


SETTINGS = GallerySettings()


def gallery_figure(study: EffectStudy) -> Figure:
    """Show the pictures of :func:`gallery_pictures` in rows, each with its name, pixels as squares."""
    return picture_figure(
        list(gallery_pictures(study)),
        "One panel under each effect, at its strongest",
        f"{study.plan.world.scene.nearest_m:g} m, the same frame for all",
        SETTINGS.columns,
        SETTINGS.cell_in,
    )


def gallery_pictures(study: EffectStudy) -> Iterator[Picture]:
    """Render the study's scene and its bits once, and with each effect at its harshest.

    The panel is at the nearest distance; all else is drawn as for a test frame. A severity that leaves no
    panel to see gives way to a milder one.
    What changes the frame but hardly the panel's surroundings is shown over the whole frame.

    Yields:
        What is shown, with its grey values (H,W).
    """
    world, model = study.plan.world, study.plan.world.scene
    block = BlockKey(study.plan.seed, "gallery", 0)
    drawn, bits = model.draw(block, world.panel.shape)
    scene = replace(drawn[:1], distance_m=torch.full((1,), model.nearest_m).double())
    corners = panel_corners_px(scene, world.camera, world.panel)[0].numpy()
    side = SETTINGS.side_panels * np.ptp(corners, axis=0).max()
    left, top = np.maximum(0, corners.mean(axis=0) - side / 2).round().astype(int)
    place = np.s_[top : top + round(side), left : left + round(side)]

    def rendered(effects: Effects, draw: int = 0) -> Bytes:
        simulator = replace(world, effects=effects, framing="full").simulator()
        keys = [FrameKey(block, draw)]
        frames = simulator.render(scene, bits[:1], keys=keys)
        pixels: Bytes = replace(frames, colour=None).pixels[0]
        return pixels

    plain = rendered(study.scene)
    yield Picture(plain[place], "the scene itself")
    for pair in study.pairs:
        name = " + ".join(pair.differing)
        scenes = list(pair.severities.values()) or [pair.present]
        for draw in range(SETTINGS.draws):
            frame = rendered(scenes[-1], draw)
            if differs(frame, plain):
                break
        while scenes[:-1] and frame[place].std() < SETTINGS.least_spread_grey:
            scenes.pop()
            frame = rendered(scenes[-1], draw)
        if differs(frame[place], plain[place]):
            yield Picture(frame[place], name)
        elif differs(frame, plain):
            yield Picture(frame, f"{name}\nwhole frame")
        else:
            yield Picture(frame[place], f"{name}\nno change to see")


def differs(pixels: Bytes, plain: Bytes) -> bool:
    """Say whether the eye sees that grey values differ."""
    change = np.abs(pixels.astype(int) - plain)
    most = np.percentile(change, 100 - SETTINGS.seen_percent)
    return bool(most >= SETTINGS.seen_grey)
