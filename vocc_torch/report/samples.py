"""``samples.png``: what a run's scenes look like, before its numbers."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import torch
from matplotlib import get_data_path
from PIL import Image, ImageDraw, ImageFont

from vocc_torch.files import atomic_file
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.sweep import Kind, scenes_of
from vocc_torch.report.annotation import enlarged
from vocc_torch.report.plots import LOOK, Pixels
from vocc_torch.report.run_files import SAMPLES
from vocc_torch.report.styles import axis_label, count_text
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import SceneModel, Simulator
from vocc_torch.types import Scene

COLUMNS, MOST = 6, 12
CELL_PX, GAP_PX, MARGIN_PX, HEAD_PX, CAPTION_PX = 216, 20, 28, 40, 62


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
    origin_px: torch.Tensor


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
            seen = simulator.render(
                scenes[row], bits[row], nearest_m=nearest_m, keys=keys, panel_only=True
            )
        shown = (
            seen.pixels[0]
            if seen.colour is not None
            else np.repeat(seen.pixels[0][..., None], 3, axis=2)
        )
        yield Crop(scenes[row], shown, seen.origin_px[0].cpu())


def write_samples(
    folder: Path, plan: Plan, kinds: Sequence[Kind] = ("train", "test")
) -> None:
    """Draw a dozen scenes, each panel enlarged to one size, with its values below.

    Args:
        folder: the run's.
        plan: the study.
        kinds: those that a receiver trains on, those of the experiment's points, or both.

    Raises:
        VoccError: the file cannot be written.
    """
    heads = {
        "train": "What a receiver trains on",
        "test": f"What is tested: {plan.experiment.name}",
    }
    simulator, most = (
        replace(plan.world, framing="crop").simulator(),
        MOST // len(kinds),
    )
    drawn: dict[str, list[tuple[str, Crop]]] = {heads[kind]: [] for kind in kinds}
    for kind in kinds:
        points = list(scenes_of(plan, kind).items())
        places = np.unique(
            np.linspace(0, len(points) - 1, most).round().astype(int)
        ).tolist()
        for name, model in (points[place] for place in places):
            axis, _, value = name.rpartition("/")[2].partition("=")
            label = f"{axis_label(axis)}: {value}" if value else ""
            shown = crops(
                simulator, BlockKey(plan.seed, name, 0), model, most // len(places)
            )
            drawn[heads[kind]] += [(label, crop) for crop in shown]
    with atomic_file(folder / SAMPLES) as temporary:
        picture_of(drawn).save(temporary, format="PNG")


def picture_of(groups: Mapping[str, Sequence[tuple[str, Crop]]]) -> Image.Image:
    """Lay crops out in rows below the name of their group, each with its label and its scene's values."""
    shown = {
        head: [(label, thumbnail(crop), crop.scene) for label, crop in some]
        for head, some in groups.items()
    }
    # A wide panel's pictures are as low as they are.
    tall = {
        head: max(picture.height for _, picture, _ in some)
        for head, some in shown.items()
    }
    step, rows = (
        CELL_PX + GAP_PX,
        {head: -(-len(some) // COLUMNS) for head, some in shown.items()},
    )
    heights = [
        HEAD_PX + count * (tall[head] + CAPTION_PX) for head, count in rows.items()
    ]
    page = Image.new(
        "RGB",
        (COLUMNS * step - GAP_PX + 2 * MARGIN_PX, sum(heights) + 2 * MARGIN_PX),
        "white",
    )
    draw, top = ImageDraw.Draw(page), MARGIN_PX
    for head, some in shown.items():
        draw.text((MARGIN_PX, top), head, LOOK.ink, font(20, bold=True))
        top += HEAD_PX
        for at, (label, picture, scene) in enumerate(some):
            x = MARGIN_PX + at % COLUMNS * step
            y = top + at // COLUMNS * (tall[head] + CAPTION_PX)
            page.paste(picture, (x, y + tall[head] - picture.height))
            for line, text in enumerate(filter(None, (label, *captions(scene)))):
                look = (
                    (LOOK.ink, font(12, bold=True))
                    if text == label
                    else (LOOK.quiet, font(12))
                )
                draw.text((x, y + tall[head] + 6 + 17 * line), text, *look)
        top += rows[head] * (tall[head] + CAPTION_PX)
    return page


def thumbnail(crop: Crop) -> Image.Image:
    """Show a crop as wide or as high as a cell."""
    # Square pixels first, so that they can be seen.
    picture = enlarged(crop.pixels, max(1, -(-2 * CELL_PX // max(crop.pixels.shape))))
    picture.thumbnail((CELL_PX, CELL_PX), Image.Resampling.BOX)
    return picture


def captions(scene: Scene) -> tuple[str, str]:
    """Say a scene's values in two lines.

    Example:
        >>> captions(Scene.of(distance_m=50.0))[0]
        '50 m, ambient 8\u2009000 lx'
    """
    lights = float(scene.ambient_lx[0]), float(scene.led_luminance_cd_m2[0])
    ambient, led = (
        count_text(round(value)) if value >= 100 else f"{value:.3g}" for value in lights
    )
    own = f"LED {led} cd/m\N{SUPERSCRIPT TWO}, background {float(scene.background_grey[0]):.0f}"
    return f"{float(scene.distance_m[0]):.3g} m, ambient {ambient} lx", own


@cache
def font(size_px: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """The typeface of all pictures, which Matplotlib brings."""
    return ImageFont.truetype(
        Path(get_data_path(), f"fonts/ttf/DejaVuSans{'-Bold' * bold}.ttf"), size_px
    )
