"""The files of an experiment that is a grid of two quantities: heat maps, the best of each row, and data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, replace
from pathlib import Path

from matplotlib.figure import Figure

from vocc_torch.measure.curve import COLUMNS
from vocc_torch.measure.grid import Grid, best_luminance
from vocc_torch.show.csv_file import Cells, write_rows
from vocc_torch.show.heatmap import best_luminance_figure, dimming_figure
from vocc_torch.show.styles import LOCATED

CAPTIONS = {
    "_paper": "With the panel located as the paper does. The line: the best luminance by ambient light.",
    "_truth": "With the panel's true corners: what bit decision alone makes of it.",
    "_best": "The best luminance against ambient light, on lines of constant contrast.",
}
"""Captions by the end of the picture's name."""


def grid_figures(grids: Mapping[str, Grid], own: str, receivers: Sequence[str]) -> dict[str, Figure]:
    """Draw a grid.

    Args:
        grids: by locator.
        own: the locator whose best luminances are drawn.
        receivers: those to draw, in order.

    Returns:
        By file name without suffix.
    """
    names = [name for name in receivers if name in grids[own].receivers]
    heading = "Bit error rate over ambient light and LED luminance"
    drawn = {
        f"dimming_{locator}": dimming_figure(grid, f"{heading} ({LOCATED[locator]})", names)
        for locator, grid in grids.items()
    }
    return {**drawn, "dimming_best": best_luminance_figure(grids[own], receivers=names)}


def write_grid(path: Path, grids: Mapping[str, Grid]) -> None:
    """Write a grid's points, and beside them the best of each row.

    Args:
        path: the file of the points, by locator, row, value and receiver; the other has ``best`` after its
            name.
        grids: by locator.

    Raises:
        VoccError: a file cannot be written.
    """
    axis = next(iter(grids.values())).row_axis
    write_rows(path, [(axis, *COLUMNS), *(row for grid in grids.values() for row in _points(grid))])
    names = ("best_from_cd_m2", "best_to_cd_m2", "range_from_cd_m2", "range_to_cd_m2")
    beyond = ("may_lie_below_grid", "may_lie_above_grid")
    head = ("receiver", "locator", axis, *names, "ber", "ber_low", "ber_high", *beyond)
    best = [head, *(row for grid in grids.values() for row in _best(grid))]
    write_rows(path.with_stem(f"{path.stem}_best"), best)


def _points(grid: Grid) -> list[Cells]:
    """Give a grid's points with the grid's own intervals: a limit takes wrong frames to be as nearby."""
    ends = {name: grid.intervals(name) for name in grid.receivers}
    lines: list[Cells] = []
    for i, (at, curves) in enumerate(zip(grid.rows, grid.curves, strict=True)):
        for row in curves.table():
            low, high = (float(side[i, grid.columns.index(row.value)]) for side in ends[row.receiver])
            lines.append((at, *astuple(replace(row, ber_low=low, ber_high=high))))
    return lines


def _best(grid: Grid) -> list[Cells]:
    """Give the best luminance of every receiver under each ambient light.

    ``best_from`` to ``best_to`` is the luminance with the least bit error rate, or the plateau of those with
    equally few errors; ``range_from`` to ``range_to`` are those that cannot be told from the best; ``yes``
    in the last two columns says that the range ends at the grid's edge, so that the best may lie beyond.
    """
    lines: list[Cells] = []
    for best in (best for receiver in grid.receivers for best in best_luminance(grid, receiver)):
        ends = [side[place] for side in (best.least_cd_m2, best.candidates_cd_m2) for place in (0, -1)]
        beyond = ["yes" if edge else "no" for edge in (best.reaches_lowest, best.reaches_highest)]
        place = (best.receiver, grid.locator, best.ambient_lx)
        lines.append((*place, *ends, best.ber, best.ber_low, best.ber_high, *beyond))
    return lines
