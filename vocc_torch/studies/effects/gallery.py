"""Bit error rate over the severity of each effect, and one panel as the camera sees it under each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import BerTable, Point
from vocc_torch.measure.plan import World
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.show.canvas import INK, QUIET, new_figure, write_title
from vocc_torch.show.plots import facet_figure
from vocc_torch.show.styles import Style, receiver_styles
from vocc_torch.simulation.effects import Parameters
from vocc_torch.simulation.framing import panel_corners_px
from vocc_torch.studies.effects.plan import EffectStudy
from vocc_torch.studies.effects.results import EffectResults, SeverityCurve
from vocc_torch.studies.effects.tables import scene_text
from vocc_torch.types import Scene

_COLUMNS, _TILES_A_ROW, _TILE_IN = 5, 6, 1.75
_SHOWN_SHARE = 1.5
"""Side of a picture of the gallery in sides of the panel."""
THE_SCENE = "the scene itself"
_STYLES = {
    "true_corners": Style("trained without the effect", "#D55E00", "o", "-"),
    "retrained": Style("trained with it, as the table of effects has it", "#0072B2", "D", "--"),
}
_UNITS = {"_deg": "°", "_m": "m", "_s": "s", "_px": "px", "_nm": "nm", "_lx": "lx", "_cd_m2": "cd/m²"}
_UNITS |= {"_m_s": "m/s", "electrons_per_s": "electrons/s", "electrons": "electrons"}
"""Units by the end of a parameter's name; the longest end that fits counts."""


def severity_figure(results: EffectResults) -> Figure:
    """Draw one small axes for each effect with severities, from harmless at the left to harsh."""
    curves, receiver = results.severities, results.study.shown
    tables = {curve.name: _table(curve, receiver) for curve in curves}
    rows = [dict(list(tables.items())[first : first + _COLUMNS]) for first in range(0, len(tables), _COLUMNS)]
    label = receiver_styles([receiver])[receiver].label
    note = (
        f"{results.study.severity_frames} frames a point, the same in all, true corners \N{MIDDLE DOT} "
        "bars: 95 % intervals \N{MIDDLE DOT} arrows: no errors, one-sided limit\ngrey line: the scene itself "
        "\N{MIDDLE DOT} dashed upright line: the value in the table of effects"
    )
    title = f"Bit error rate over each effect's severity{scene_text(results)} ({label})"
    figure = facet_figure(rows, title, note, axes_alike=False, styles=_STYLES)
    base = results.base.get("truth", {}).get(receiver)
    for axes, curve in zip(figure.axes, curves, strict=True):
        values = list(curve.errors)
        if values[0] > values[-1]:
            axes.set_xlim(*reversed(axes.get_xlim()))
        if base is not None and base.half_errors:
            axes.axhline(base.ber, color=QUIET, linewidth=1.0, alpha=0.55, zorder=1)
        if curve.usual is not None and min(values) <= curve.usual <= max(values):
            axes.axvline(curve.usual, color=QUIET, linewidth=0.9, linestyle=(0, (2, 2)), zorder=1)
    return figure


def parameter_label(parameter: str) -> str:
    """Write a parameter's name with its unit in brackets.

    Args:
        parameter: ``effect.parameter``.

    Example:
        >>> parameter_label("defocus.focus_distance_m"), parameter_label("prnu.share")
        ('focus distance (m)', 'share')
    """
    name = parameter.partition(".")[2]
    ends = [end for end in _UNITS if name.endswith(end)]
    if not ends:
        return name.replace("_", " ")
    end = max(ends, key=len)
    words = name.removesuffix(end).replace("_", " ").strip()
    return f"{words} ({_UNITS[end]})" if words else _UNITS[end]


def _table(curve: SeverityCurve, receiver: str) -> BerTable:
    """Put one effect's points into a table: a curve for each training."""
    effect, label = curve.parameter.partition(".")[0], parameter_label(curve.parameter)
    axis = label if effect == curve.name else f"{effect}: {label}"
    return BerTable(
        Point(curve.name, axis, value, reading, "truth", errors[receiver], "frames")
        for value, readings in curve.errors.items()
        for reading, errors in readings.items()
    )


def gallery_figure(pictures: Mapping[str, NDArray[np.uint8]], title: str, footnote: str = "") -> Figure:
    """Show grey pictures in rows, each with its name, pixels as squares.

    Args:
        pictures: by name, (H,W) uint8 each, at least one; all in the order in which they are shown.
        title: what they show.
        footnote: what they rest on.

    Raises:
        VoccError: no picture.

    Example:
        >>> figure = gallery_figure({"clear": np.zeros((8, 8), dtype=np.uint8)}, "One picture")
        >>> [axes.get_title() for axes in figure.axes]
        ['clear']
    """
    if not pictures:
        raise VoccError("pictures is empty: a gallery shows at least one")
    columns = min(_TILES_A_ROW, len(pictures))
    rows = math.ceil(len(pictures) / columns)
    width, head, foot = max(5.0, columns * _TILE_IN + 0.3), 0.62, 0.34 if footnote else 0.1
    height = rows * (_TILE_IN + 0.3) + head + foot
    figure = new_figure(width, height)
    for index, (name, picture) in enumerate(pictures.items()):
        row, column = divmod(index, columns)
        left = (0.18 + column * _TILE_IN) / width
        bottom = 1 - (head + 0.24 + row * (_TILE_IN + 0.3) + _TILE_IN - 0.08) / height
        axes = figure.add_axes((left, bottom, (_TILE_IN - 0.08) / width, (_TILE_IN - 0.08) / height))
        axes.imshow(picture, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        axes.set_title(name, fontsize=9.5, color=INK, pad=3)
        axes.set_axis_off()
    write_title(figure, title, footnote)
    return figure


def gallery_pictures(study: EffectStudy) -> dict[str, NDArray[np.uint8]]:
    """Show the study's scene, and with each effect at its harshest, from the nearest distance.

    Ambient light and LED luminance are those in the middle of the scene's ranges, on a logarithmic scale.
    """
    cases: dict[str, Mapping[str, Parameters]] = {THE_SCENE: study.plan.world.effects}
    for one in study.pairs:
        values = study.catalogue.severities.get(one.name)
        cases[one.name] = study.catalogue.at(one.name, values.values[-1]) if values else one.present
    model = study.model
    light = ("ambient_lx", "led_luminance_cd_m2")
    middle = {name: math.sqrt(math.prod(getattr(model, name).bounds)) for name in light}
    seed = study.plan.seed
    return effect_pictures(study.plan.world, cases, distance_m=model.nearest_m, seed=seed, **middle)


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
    side = round(_SHOWN_SHARE * float((corners.amax(0) - corners.amin(0)).max()))
    left, top = (int(c) for c in (corners.mean(0) - side / 2).round().tolist())
    pictures = {}
    for name, effects in cases.items():
        simulator = replace(world, effects=effects, framing="full").simulator()
        frame = simulator.render(scene, bits, keys=[key]).grey[0, 0]
        shown = frame[max(0, top) : top + side, max(0, left) : left + side]
        pictures[name] = shown.double().clamp(0, 255).round().byte().cpu().numpy()
    return pictures
