"""The dimming study's tables as plain rows, each with its head."""

from __future__ import annotations

from typing import TypeAlias

from vocc_torch.measure.dimming import Grid, best_luminance
from vocc_torch.measure.optimum_ratio import optimum_ratio
from vocc_torch.measure.undimmed import HEADLIGHT_CD_M2, Estimate, Undimmed, undimmed_loss

Cells: TypeAlias = tuple[str | int | float, ...]

_ENDS = ("ber", "ber_low", "ber_high")


def dimming_rows(grid: Grid) -> list[Cells]:
    """Give every cell of the grid: by receiver, then by row, then by column.

    ``ber_low`` and ``ber_high`` are as in ``ber.csv``, but a cell without errors has its limit from the
    nearest cells of the grid that had some.

    Args:
        grid: ambient light by LED luminance.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curves import Curves
        >>> counts = {("flda_3", 500): Counts(64, 4096, 4, 8, 2), ("flda_3", 2000): Counts(64, 4096)}
        >>> axis, stopped = "led_luminance_cd_m2", {500: "frames", 2000: "frames"}
        >>> curves = Curves("dimming", axis, "truth", ("flda_3",), (500, 2000), counts, {}, stopped)
        >>> grid = Grid("ambient_lx", (4000.0,), (curves,))
        >>> head, row, _ = dimming_rows(grid)
        >>> head[:4], row[:4]
        (('ambient_lx', 'led_luminance_cd_m2', 'receiver', 'locator'), (4000.0, 500, 'flda_3', 'truth'))
    """
    names = ("frame_errors", "panels_missed")
    head = (grid.row_axis, grid.column_axis, "receiver", "locator", "frames", "bits", "bit_errors", *_ENDS)
    rows: list[Cells] = [(*head, *names, "stopped_by")]
    for receiver in grid.receivers:
        low, high = (side.tolist() for side in grid.intervals(receiver))
        for i, line in enumerate(grid.counts(receiver)):
            for j, cell in enumerate(line):
                place = (grid.rows[i], grid.columns[j], receiver, grid.locator)
                counted = (cell.frames, cell.bits, cell.bit_errors, cell.ber, low[i][j], high[i][j])
                missed = (cell.frame_errors, cell.panels_missed)
                rows.append((*place, *counted, *missed, grid.curves[i].stopped_by[grid.columns[j]]))
    return rows


def best_rows(grid: Grid) -> list[Cells]:
    """Give the best luminance of every receiver under each ambient light.

    ``best_from`` to ``best_to`` is the luminance with the least bit error rate, or the plateau of those with
    equally few errors; ``range_from`` to ``range_to`` are those that cannot be told from the best; ``yes``
    in the last two columns says that the range ends at the grid's edge, so that the best may lie beyond.

    Args:
        grid: ambient light by LED luminance.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curves import Curves
        >>> counts = {("flda_3", 500): Counts(64, 4096, 4, 8, 2), ("flda_3", 2000): Counts(64, 4096)}
        >>> axis, stopped = "led_luminance_cd_m2", {500: "frames", 2000: "frames"}
        >>> curves = Curves("dimming", axis, "truth", ("flda_3",), (500, 2000), counts, {}, stopped)
        >>> grid = Grid("ambient_lx", (4000.0,), (curves,))
        >>> head, row = best_rows(grid)
        >>> row[:7]
        ('flda_3', 'truth', 4000.0, 2000.0, 2000.0, 500.0, 2000.0)
    """
    names = ("best_from_cd_m2", "best_to_cd_m2", "range_from_cd_m2", "range_to_cd_m2")
    beyond = ("may_lie_below_grid", "may_lie_above_grid")
    rows: list[Cells] = [("receiver", "locator", grid.row_axis, *names, *_ENDS, *beyond)]
    for receiver in grid.receivers:
        for best in best_luminance(grid, receiver):
            ends = (
                best.least_cd_m2[0],
                best.least_cd_m2[-1],
                best.candidates_cd_m2[0],
                best.candidates_cd_m2[-1],
            )
            rates = (best.ber, best.ber_low, best.ber_high)
            edges = (_yes(best.reaches_lowest), _yes(best.reaches_highest))
            rows.append((receiver, grid.locator, best.ambient_lx, *ends, *rates, *edges))
    return rows


def followed_rows(grid: Grid) -> list[Cells]:
    """Give for every receiver which power of the ambient light its best luminance follows.

    Cells are empty where too few ambient lights have their best inside the grid.

    Args:
        grid: ambient light by LED luminance.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curves import Curves
        >>> counts = {("flda_3", 500): Counts(64, 4096, 4, 8, 2), ("flda_3", 2000): Counts(64, 4096)}
        >>> axis, stopped = "led_luminance_cd_m2", {500: "frames", 2000: "frames"}
        >>> curves = Curves("dimming", axis, "truth", ("flda_3",), (500, 2000), counts, {}, stopped)
        >>> grid = Grid("ambient_lx", (4000.0,), (curves,))
        >>> head, row = followed_rows(grid)
        >>> row
        ('flda_3', 'truth', 0, '', '', '', '', '', '')
    """
    names = ("slope", "slope_low", "slope_high")
    ratios = ("cd_m2_per_lx", "cd_m2_per_lx_low", "cd_m2_per_lx_high")
    rows: list[Cells] = [("receiver", "locator", "ambient_levels", *names, *ratios)]
    for receiver in grid.receivers:
        found = optimum_ratio(grid, receiver)
        numbers = [number for part in (found.slope, found.ratio) for number in _or_empty(part)]
        rows.append((receiver, grid.locator, len(found.ambient_lx), *numbers))
    return rows


def loss_rows(grid: Grid, headlight_cd_m2: float = HEADLIGHT_CD_M2) -> list[Cells]:
    """Give the bit error rates of the dimmed panel, the best fixed one and the headlight, and the ratios.

    Each has a row for every ambient light and one for the mean over them, which alone has a ratio to the
    dimmed panel; ``inf`` is no upper limit.

    Args:
        grid: ambient light by LED luminance.
        headlight_cd_m2: luminance of a headlight, cd/m2, above 0; the nearest of the grid is taken.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curves import Curves
        >>> counts = {("flda_3", 500): Counts(64, 4096, 4, 8, 2), ("flda_3", 2000): Counts(64, 4096)}
        >>> axis, stopped = "led_luminance_cd_m2", {500: "frames", 2000: "frames"}
        >>> curves = Curves("dimming", axis, "truth", ("flda_3",), (500, 2000), counts, {}, stopped)
        >>> grid = Grid("ambient_lx", (4000.0,), (curves,))
        >>> [row[2:6] for row in loss_rows(grid)[-2:]]
        [('headlight', 2000.0, 4000.0, 0.0), ('headlight', 2000.0, 'mean', 0.0)]
    """
    ratios = ("times_dimmed", "times_dimmed_low", "times_dimmed_high")
    rows: list[Cells] = [("receiver", "locator", "panel", grid.column_axis, grid.row_axis, *_ENDS, *ratios)]
    for receiver in grid.receivers:
        loss = undimmed_loss(grid, receiver, headlight_cd_m2)
        lead = (receiver, grid.locator)
        for best in loss.dimmed:
            rates = (best.ber, best.ber_low, best.ber_high)
            rows.append((*lead, "dimmed", best.range_text, best.ambient_lx, *rates, "", "", ""))
        rows.append((*lead, "dimmed", "", "mean", *_numbers(loss.dimmed_mean), 1.0, 1.0, 1.0))
        for name, panel in (("best_fixed", loss.fixed), ("headlight", loss.headlight)):
            rows.extend((*lead, name, *cells) for cells in _panel_rows(grid, panel))
    return rows


def _panel_rows(grid: Grid, panel: Undimmed) -> list[Cells]:
    """Give one panel's rows from its luminance on."""
    rows: list[Cells] = [
        (panel.luminance_cd_m2, row, *_numbers(rate), "", "", "")
        for row, rate in zip(grid.rows, panel.ber, strict=True)
    ]
    return [*rows, (panel.luminance_cd_m2, "mean", *_numbers(panel.mean), *_numbers(panel.ratio))]


def _numbers(estimate: Estimate) -> tuple[float, float, float]:
    return estimate.value, estimate.low, estimate.high


def _or_empty(estimate: Estimate | None) -> Cells:
    return _numbers(estimate) if estimate else ("", "", "")


def _yes(true: bool) -> str:
    return "yes" if true else "no"
