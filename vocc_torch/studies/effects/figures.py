"""Costs and changes a row an effect, rates over severity, and one panel as the camera sees it under each."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from matplotlib import ticker
from numpy.typing import NDArray

from vocc_torch.measure import curve, estimate, stage_times
from vocc_torch.report import canvas, drawing, page, plots
from vocc_torch.report.canvas import INK, QUIET, Axes, Figure
from vocc_torch.report.styles import Style, receiver_styles
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.framing import panel_corners_px
from vocc_torch.studies.effects.plan import Effects, EffectStudy
from vocc_torch.studies.effects.results import EffectResults, EffectRow, Rounds
from vocc_torch.types import Scene

_ROW_IN, _ABOVE_IN, _BELOW_IN = 0.262, 1.18, 1.36
_LEFT_IN, _NAME_IN, _GAP_IN, _RIGHT_IN, _WIDE_IN = 3.07, 2.93, 0.3, 0.22, 3.3
_LINEAR = 1e-3
"""Changes below this are drawn to a linear scale."""
_FACETS_A_ROW, _TILES_A_ROW, _TILE_IN = 5, 6, 1.67
_SHOWN_SHARE = 1.5
"""Side of a picture of the gallery in sides of the panel."""
_LEAST_SEEN, _FAINT = 3.0, 1.5
"""Grey values: least spread of a picture with a panel in it, and least mean change that the eye sees."""

_COSTS = {
    "near": (Style("near the panel", "#009E73", "o", "-"), -0.16),
    "located": (Style("for a locator, if more", "#E69F00", "s", "-"), 0.16),
}
_WITHOUT = Style("trained without the effect", "#D55E00", "o", "-")
_WITH = Style("trained with it", "#0072B2", "D", "--")
_PARTS = {
    "Cost": _COSTS,
    "Change of BER, true corners": {
        "true_corners": (_WITHOUT, -0.16),
        "retrained": (_WITH, 0.16),
    },
    "Change of BER, paper's locator": {"located": (_WITHOUT, 0.0)},
}
"""The figure's parts: how each series is drawn, and how many rows below the middle of its row."""

_UNITS = {
    "_deg": "°",
    "_m": "m",
    "_s": "s",
    "_px": "px",
    "_nm": "nm",
    "_lx": "lx",
    "_cd_m2": "cd/m²",
}
_UNITS |= {"_m_s": "m/s", "electrons_per_s": "electrons/s", "electrons": "electrons"}
"""Units by the end of a parameter's name; the longest end that fits counts."""


SIGNS = {"fills": "\N{BLACK SQUARE}", "in_scene": "\N{CIRCLED MINUS}"}
"""Signs after an effect's name."""


def ms_text(rounds: Rounds) -> str:
    """Write a time a frame, ms; what cannot be told from nothing is so written.

    Args:
        rounds: the time round by round, ms.

    Example:
        >>> import numpy as np
        >>> times = ((0.0123,), (1.234,), (123.4,), (-1.0, 2.0), (-0.25,))
        >>> [ms_text(np.array(rounds)) for rounds in times]
        ['0.012', '1.2', '123', '~0', '-0.25']
    """
    one = stage_times.median_of(rounds)
    if not one.real:
        return "~0"
    size = abs(one.value)
    return (
        f"{one.value:.0f}"
        if size >= 9.95
        else f"{one.value:.1f}"
        if size >= 0.995
        else f"{one.value:.2g}"
    )


def written(
    template: str,
    results: EffectResults,
    signs: Mapping[str, str] = SIGNS,
    **values: object,
) -> str:
    """Fill in one of the study's templates.

    Args:
        template: its file.
        results: what was measured.
        signs: what marks effects.
        values: what it names besides.
    """
    shown = results.study.shown
    label = receiver_styles([shown])[shown].label
    return page.render(
        __package__,
        template,
        results=results,
        label=label,
        signs=signs,
        ms=ms_text,
        **values,
    )


def effects_figure(results: EffectResults) -> Figure:
    """Draw costs and changes of the bit error rate, one row an effect.

    Costs are on a logarithmic axis. Changes are on one that is linear within a thousandth and logarithmic
    beyond; a sign is full where its 95 % interval leaves out 0.
    """
    rows, parts = results.every_row, dict(_PARTS)
    if "located" not in results.readings:
        parts.popitem()
    cell_in, margins_in = (
        (_WIDE_IN, _ROW_IN * len(rows)),
        (_LEFT_IN, _RIGHT_IN, _ABOVE_IN, _BELOW_IN),
    )
    figure, grid = canvas.new_grid(
        len(parts), len(parts), cell_in, (_GAP_IN, 0), margins_in
    )
    look: dict[str, Any] = {
        "loc": "lower left",
        "fontsize": 8.3,
        "borderaxespad": 0.15,
        "handlelength": 1.6,
    }
    for axes, (head, series) in zip(grid, parts.items(), strict=True):
        canvas.quiet_axes(axes)
        if head == "Cost":
            draw_costs(axes, results)
        else:
            draw_changes(axes, results, series)
        set_rows(axes, rows, named=head == "Cost")
        axes.set_title(
            head, fontsize=10.5, fontweight="bold", color=INK, loc="left", pad=26
        )
        signs = [
            drawing.receiver_line(replace(style, line="-"), size=0.7)
            for style, _ in series.values()
        ]
        box = axes.get_position()
        at = box.x0 - 0.02 * box.width, box.y1
        canvas.write_legend(
            figure, signs, at, 2, handletextpad=0.5, columnspacing=1.0, **look
        )
    title, *notes = written("effects.txt.j2", results, linear=_LINEAR).splitlines()
    canvas.write_title(figure, title, "\n".join(notes))
    return figure


def draw_costs(axes: Axes, results: EffectResults) -> None:
    """Draw what each effect adds to the time of a frame, or a note where it cannot be told from nothing."""
    rows = results.every_row
    sums = {
        kind: stage_times.median_of(rounds) for kind, rounds in results.sums.items()
    }
    costs = [
        {kind: stage_times.median_of(row.costs[kind]) for kind in _COSTS}
        for row in rows
    ]
    shown = [one for row in (*costs, sums) for one in row.values() if one.low > 0]
    shown.append(stage_times.median_of(results.base_costs["near"]))
    across = axes.get_yaxis_transform()
    axes.set_xscale("log")
    axes.set_xlim(
        min(one.value for one in shown) / 2.2, max(one.high for one in shown) * 1.6
    )
    axes.xaxis.set(major_formatter="{x:g}", minor_formatter=ticker.NullFormatter())
    axes.set_xlabel("ms a frame, added")
    for number, (row, own) in enumerate(zip(rows, costs, strict=True)):
        for kind, (style, shift) in _COSTS.items():
            # What does not fill the sensor costs a locator as much as near the panel.
            y = number + shift if row.fills_sensor else number
            if own[kind].low > 0 and (row.fills_sensor or kind == "near"):
                _bar(axes, own[kind], y, style)
            elif row.fills_sensor or kind == "near":
                note = axes.text(
                    0.012, y, "<0" if own[kind].real else "~0", transform=across
                )
                note.set(color=style.colour, fontsize=8, va="center")
    for kind, total in sums.items():
        if total.low > 0:
            style, shift = _COSTS[kind]
            (mark,) = axes.plot(
                [total.value],
                [len(rows) - 1 + shift],
                "|",
                color=style.colour,
                zorder=4,
            )
            mark.set(markersize=11, markeredgewidth=2.2)


def draw_changes(
    axes: Axes, results: EffectResults, series: Mapping[str, tuple[Style, float]]
) -> None:
    """Draw the change of the bit error rate with its interval; all axes of changes have the same limits."""
    rows, shown = results.every_row, results.study.shown
    every = [
        change.estimate
        for row in rows
        for (_, name), change in row.changes.items()
        if name == shown
    ]
    low, high = (
        min((one.low for one in every), default=0.0),
        max((one.high for one in every), default=0.0),
    )
    ticks = (-0.1, -0.01, -0.001, 0.0, 0.001, 0.01, 0.1)
    names = [
        f"{tick:+g}".replace("-", "\N{MINUS SIGN}") if tick else "0" for tick in ticks
    ]
    axes.set_xscale("symlog", linthresh=_LINEAR, linscale=0.55)
    axes.set_xticks(ticks, names)
    axes.set_xlim(min(-1.5 * _LINEAR, low * 1.4), max(high * 1.4, 12 * _LINEAR))
    axes.xaxis.set_minor_locator(ticker.NullLocator())
    axes.axvline(0, color=QUIET, linewidth=1.0, zorder=1)
    axes.set_xlabel("bit error rate with it less that without it")
    for number, row in enumerate(rows):
        for reading, (style, shift) in series.items():
            if change := row.changes.get((reading, shown)):
                _bar(
                    axes,
                    change.estimate,
                    number + shift,
                    style,
                    full=change.estimate.real,
                )


def _bar(
    axes: Axes, one: estimate.Estimate, y: float, style: Style, *, full: bool = True
) -> None:
    """Draw a number with its interval."""
    axes.plot([one.low, one.high], [y, y], color=style.colour, linewidth=1.5, zorder=2)
    (mark,) = axes.plot(
        [one.value], [y], style.marker, color=style.colour, markersize=5, zorder=3
    )
    mark.set(markerfacecolor=style.colour if full else "white", markeredgewidth=1.2)


def set_rows(axes: Axes, rows: Sequence[EffectRow], *, named: bool) -> None:
    """Set the rows up: bands for every other group, names of effects and groups at the left."""
    axes.tick_params(axis="x", labelsize=8.5)
    axes.xaxis.label.set_fontsize(9.5)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.grid(axis="x", which="major", color=canvas.GRID, linewidth=0.8)
    across, first = axes.get_yaxis_transform(), 0
    for number, (group, some) in enumerate(
        itertools.groupby(rows, key=lambda row: row.group)
    ):
        last = first + len(members := list(some)) - 1
        if number % 2 == 0:
            axes.axhspan(
                first - 0.5, last + 0.5, color="#F6F7F9", zorder=0, linewidth=0
            )
        if named:
            head = axes.text(
                -_NAME_IN / _WIDE_IN,
                (first + last) / 2,
                group,
                transform=across,
                va="center",
            )
            head.set(fontsize=9.5, fontweight="bold", color=QUIET)
        for place, row in enumerate(members if named else (), first):
            words = (
                row.label
                + " \N{BLACK SQUARE}" * row.fills_sensor
                + " *" * row.pair.in_scene
            )
            name = axes.text(
                -0.1 / _WIDE_IN, place, words, transform=across, ha="right", va="center"
            )
            name.set(
                fontsize=9, color=INK, fontweight="normal" if row.group else "bold"
            )
        first = last + 1


def severity_figure(results: EffectResults) -> Figure:
    """Draw one small axes for each effect with severities, from harmless at the left to harsh."""
    study, facets = (
        results.study,
        [(name, _table(results, name)) for name in results.severities],
    )
    rows = [
        dict(facets[first : first + _FACETS_A_ROW])
        for first in range(0, len(facets), _FACETS_A_ROW)
    ]
    title, *notes = written("severity.txt.j2", results).splitlines()
    retrained = replace(_WITH, label=f"{_WITH.label}, as the table of effects has it")
    styles = {"true_corners": _WITHOUT, "retrained": retrained}
    figure = plots.facet_figure(
        rows, title, "\n".join(notes), axes_alike=False, styles=styles
    )
    base = results.base.get(("truth", study.shown))
    for axes, name in zip(figure.axes, results.severities, strict=True):
        values, usual = study.severities[name], study.usual(name)
        if values[0] > values[-1]:
            axes.set_xlim(*reversed(axes.get_xlim()))
        if base is not None and base.half_errors:
            axes.axhline(base.ber, color=QUIET, linewidth=1.0, alpha=0.55, zorder=1)
        if usual is not None and min(values) <= usual <= max(values):
            axes.axvline(
                usual, color=QUIET, linewidth=0.9, linestyle=(0, (2, 2)), zorder=1
            )
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
    end = max((end for end in _UNITS if name.endswith(end)), key=len, default="")
    words = name.removesuffix(end).replace("_", " ").strip()
    return f"{words} ({_UNITS[end]})" if words and end else words or _UNITS[end]


def _table(results: EffectResults, name: str) -> curve.BerTable:
    """Put one effect's points into a table: a curve for each training."""
    parameter = results.study.config.severity[name].parameter
    effect, label = parameter.partition(".")[0], parameter_label(parameter)
    axis = label if effect == name else f"{effect}: {label}"
    return curve.BerTable(
        curve.Point(name, axis, value, reading, "truth", counts, "frames")
        for (value, reading, receiver), counts in results.severities[name].items()
        if receiver == results.study.shown
    )


def gallery_figure(study: EffectStudy) -> Figure:
    """Show the grey pictures of :func:`gallery_pictures` in rows, each with its name, pixels as squares."""
    pictures = gallery_pictures(study)
    columns = min(_TILES_A_ROW, len(pictures))
    gap_in = (0.08, 0.5)
    # The title needs five inches.
    margins_in = (0.18, max(0.2, 4.9 - columns * (_TILE_IN + 0.08)), 0.98, 0.48)
    figure, grid = canvas.new_grid(
        len(pictures), columns, (_TILE_IN, _TILE_IN), gap_in, margins_in
    )
    for axes, (name, picture) in zip(grid, pictures.items(), strict=True):
        axes.imshow(picture, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        axes.set_title(name, fontsize=9.5, color=INK, pad=3)
        axes.set_axis_off()
    about = f"{study.model.nearest_m:g} m, middle of the scene's light; difference: from the scene, enlarged"
    canvas.write_title(figure, "One panel under each effect, at its harshest", about)
    return figure


def gallery_pictures(study: EffectStudy) -> dict[str, NDArray[np.uint8]]:
    """Render the study's scene and its bits once, and with each effect at its harshest.

    The panel is at the nearest distance; ambient light and LED luminance are those in the middle of the
    scene's ranges, on a logarithmic scale. A severity that leaves no panel to see gives way to a milder one.
    What hardly changes the panel is shown over the whole frame where it shows there, else as its difference
    from the scene itself, enlarged, on middle grey.

    Returns:
        By what they show, the square about the panel's place, (H,W) uint8; grey values beyond 255 are white.
    """
    world, model = study.plan.world, study.model
    light = ("ambient_lx", "led_luminance_cd_m2")
    middle: dict[str, Any] = {
        name: math.sqrt(math.prod(getattr(model, name).bounds)) for name in light
    }
    scene = Scene.of(distance_m=model.nearest_m, **middle)
    key = FrameKey(BlockKey(study.plan.seed, "gallery", 0), 0)
    shape = world.panel.shape.rows, world.panel.shape.columns
    bits = torch.from_numpy(key.block.generator("bits").random(shape) < 0.5).unsqueeze(
        0
    )
    corners = panel_corners_px(scene, world.camera, world.panel)[0]
    side = round(_SHOWN_SHARE * float((corners.amax(0) - corners.amin(0)).max()))
    left, top = (int(c) for c in (corners.mean(0) - side / 2).round().tolist())
    place = np.s_[max(0, top) : top + side, max(0, left) : left + side]

    def rendered(effects: Effects) -> NDArray[np.uint8]:
        simulator = replace(world, effects=effects, framing="full").simulator()
        frame = simulator.render(scene, bits, keys=[key]).grey[0, 0]
        return frame.double().clamp(0, 255).round().byte().cpu().numpy()

    plain = rendered(study.scene)
    pictures = {"the scene itself": plain[place]}
    for one in study.pairs:
        severity, name = study.config.severity.get(one.name), " + ".join(one.own)
        cases = (
            [study.at(one.name, value) for value in severity.values]
            if severity
            else [one.present]
        )
        while (frame := rendered(cases.pop()))[place].std() < _LEAST_SEEN and cases:
            pass
        apart, shown = frame.astype(int) - plain, frame[place]
        near, anywhere = np.abs(apart[place]), np.abs(apart).mean()
        if near.mean() < _FAINT <= anywhere:
            name, shown = f"{name}\nwhole frame", frame
        elif not near.any():
            name = f"{name}\nno visible change"
        elif near.mean() < _FAINT:
            times = 100 // near.max()
            name, shown = (
                f"{name}\ndifference x {times}",
                (128 + times * apart[place]).astype(np.uint8),
            )
        pictures[name] = shown
    return pictures
