"""The files of an experiment that is a grid of two quantities: heat maps, the best of each row, and data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, replace
from pathlib import Path

from matplotlib.figure import Figure

from vocc_torch.measure.curve import COLUMNS
from vocc_torch.measure.dimming import Grid
from vocc_torch.show.best_luminance import best_luminance_figure
from vocc_torch.show.csv_file import write_rows
from vocc_torch.show.dimming_rows import best_rows, followed_rows, loss_rows
from vocc_torch.show.heatmap import dimming_figure
from vocc_torch.show.styles import LOCATED
from vocc_torch.show.undimmed import undimmed_figure

CAPTIONS = {
    "_paper": "With the panel located as the paper does. The line: the best luminance by ambient light.",
    "_truth": "With the panel's true corners: what bit decision alone makes of it.",
    "_best": "The best luminance against ambient light, on lines of constant contrast.",
    "_loss": "A dimmed panel, one with the single best luminance, and one with a headlight's.",
}
"""Captions by the end of the picture's name."""

Line = tuple[str | int | float, ...]


def grid_figures(grids: Mapping[str, Grid], own: str, receivers: Sequence[str]) -> dict[str, Figure]:
    """Draw a grid.

    Args:
        grids: by locator.
        own: the locator whose best luminances and losses are drawn.
        receivers: those to draw, in order.

    Returns:
        By file name without suffix.
    """
    drawn: dict[str, Figure] = {}
    for locator, grid in grids.items():
        names = [name for name in receivers if name in grid.receivers]
        heading = f"Bit error rate over ambient light and LED luminance ({LOCATED[locator]})"
        drawn[f"dimming_{locator}"] = dimming_figure(grid, heading, names)
    names = [name for name in receivers if name in grids[own].receivers]
    drawn["dimming_best"] = best_luminance_figure(grids[own], receivers=names)
    drawn["dimming_loss"] = undimmed_figure(grids[own], receivers=names)
    return drawn


def write_grid(path: Path, grids: Mapping[str, Grid]) -> None:
    """Write a grid's points, and beside them the best of each row and the loss of a panel that cannot dim.

    Args:
        path: the file of the points, by locator, row, value and receiver; the others are called ``best``,
            ``followed`` (the power of the ambient light that the best follows) and ``loss`` after it.
        grids: by locator.

    Raises:
        VoccError: a file cannot be written.
    """
    lines: list[Line] = [(next(iter(grids.values())).row_axis, *COLUMNS)]
    for grid in grids.values():
        lines += _points(grid)
    write_rows(path, lines)
    for what, rows_of in (("best", best_rows), ("followed", followed_rows), ("loss", loss_rows)):
        head, *rest = (rows_of(grid) for grid in grids.values())
        write_rows(
            path.with_stem(f"{path.stem}_{what}"), [*head, *(row for rows in rest for row in rows[1:])]
        )


def _points(grid: Grid) -> list[Line]:
    """Give a grid's points with the grid's own intervals: a limit takes wrong frames to be as nearby."""
    ends = {name: grid.intervals(name) for name in grid.receivers}
    lines: list[Line] = []
    for i, (at, curves) in enumerate(zip(grid.rows, grid.curves, strict=True)):
        for row in curves.table():
            low, high = (float(side[i, grid.columns.index(row.value)]) for side in ends[row.receiver])
            lines.append((at, *astuple(replace(row, ber_low=low, ber_high=high))))
    return lines
