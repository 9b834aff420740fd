"""``samples.png``: what a run's scenes look like, before its numbers."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from vocc_torch.measure.plan import Plan
from vocc_torch.measure.sweep import Kind, scenes_of
from vocc_torch.report.folder import SAMPLES
from vocc_torch.report.led_plots import Picture, picture_figure
from vocc_torch.report.plots import Pixels, save_figure
from vocc_torch.report.styles import axis_label, count_text
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import SceneModel, Simulator
from vocc_torch.types import Scene


@dataclass(frozen=True)
class SampleSettings:
    """How many scenes are shown, and how large."""

    columns: int = 6  # crops in a row
    most: int = 12  # crops in all
    width_in: float = 1.8  # width of a crop, inches
    words_in: float = 0.75  # height of what stands above and below it, inches


SETTINGS = SampleSettings()


@dataclass(frozen=True, eq=False)
class Crop:
    """The panel's surroundings in one frame.

    Args:
        scene: of the one frame.
        pixels: (H,W,3) uint8.
        origin_px: (2,) int64, sensor coordinates (x, y) of its top left pixel.
    """

    scene: Scene
    pixels: Pixels
    origin_px: Tensor


def crops(
    simulator: Simulator,
    key: BlockKey,
    model: SceneModel,
    frames: int,
    nearest_m: float | None = None,
) -> Iterator[Crop]:
    """Render the panel's surroundings in the first frames of a block, one by one.

    Args:
        simulator: one that frames by ``crop``.
        key: names the block.
        model: the scenes.
        frames: how many, 1 to 64.
        nearest_m: distance of the panel that has room in every crop; by default each is as tight as it can.
    """
    scenes, bits = model.draw(key, simulator.panel.shape)
    for frame in range(frames):
        row, keys = slice(frame, frame + 1), [FrameKey(key, frame)]
        with torch.autocast(simulator.device.type, enabled=False):
            rendered = simulator.render(
                scenes[row], bits[row], nearest_m=nearest_m, keys=keys, panel_only=True
            )
        pixels = rendered.pixels[0]
        if rendered.colour is None:
            pixels = np.repeat(pixels[..., None], 3, axis=2)
        yield Crop(scenes[row], pixels, rendered.origin_px[0].cpu())


def write_samples(
    folder: Path, plan: Plan, kinds: Sequence[Kind] = ("train", "test")
) -> None:
    """Draw a dozen scenes, each with its values below.

    Args:
        folder: the run's.
        plan: the study.
        kinds: those that a receiver trains on, those of the experiment's points, or both.

    Raises:
        VoccError: the file cannot be written.
    """
    heads = {
        "train": "Training frames",
        "test": f"Test frames: {plan.experiment.name}",
    }
    simulator = replace(plan.world, framing="crop").simulator()
    most = SETTINGS.most // len(kinds)
    pictures: list[Picture | None] = []
    for kind in kinds:
        head, models = heads[kind], scenes_of(plan, kind)
        steps = np.linspace(0, len(models) - 1, most).round()
        names = np.array([*models])[np.unique(steps.astype(int))].tolist()
        for name in names:
            axis, _, value = name.rpartition("/")[2].partition("=")
            place = f"{axis_label(axis)}: {value}\n" if value else ""
            key = BlockKey(plan.seed, name, 0)
            for crop in crops(simulator, key, models[name], most // len(names)):
                words = place + caption(crop.scene)
                pictures.append(Picture(crop.pixels, head, words))
                head = ""
        pictures += [None] * (-len(pictures) % SETTINGS.columns)
    cell_in = SETTINGS.width_in, SETTINGS.words_in
    figure = picture_figure(pictures, "Scenes", "", SETTINGS.columns, cell_in)
    save_figure(figure, folder / SAMPLES)


def caption(scene: Scene) -> str:
    """Say a scene's values in two lines.

    Example:
        >>> caption(Scene.of(distance_m=50.0)).splitlines()[0]
        '50 m, ambient 8\u2009000 lx'
    """
    ambient, led = (
        count_text(round(light)) if light >= 100 else f"{light:.3g}"
        for light in (scene.ambient_lx.item(), scene.led_luminance_cd_m2.item())
    )
    distance_m, grey = scene.distance_m.item(), scene.background_grey.item()
    return (
        f"{distance_m:.3g} m, ambient {ambient} lx\n"
        f"LED {led} cd/m\N{SUPERSCRIPT TWO}, background {grey:.0f}"
    )
