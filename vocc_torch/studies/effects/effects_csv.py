"""``effects.csv`` and ``severity.csv``: what each effect costs and does, and rates over its severity."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.show.csv_file import cell_text, write_lines
from vocc_torch.studies.effects.table import READINGS, Change, Cost, EffectRow, EffectTable, SeverityCurve

_COSTS = tuple(f"{kind}_{part}ms" for kind in ("near", "located", "whole") for part in ("", "low_", "high_"))
_CHANGES = ("frames", "ber_without", "ber_with", "change", "low", "high", "real", "missed_with")
COLUMNS = (
    *("row", "effect", "group", "differs_in", "companions", "settings", "in_scene", "fills_sensor"),
    *("receiver", *_COSTS),
    *(f"{reading}_{name}" for reading in READINGS for name in _CHANGES),
    *("training_frames", "scene", "waited_share", "machine"),
)
"""Columns of ``effects.csv``. ``row`` is ``scene``, ``effect``, ``sum`` or ``together``. A cost is a median
with its quartiles over the rounds, ms a frame: of the scene itself, else what is added to it. ``real`` says
whether the 95 % interval of the change leaves out 0; ``missed_with`` counts frames without a panel found."""

SEVERITY_COLUMNS = (
    *("effect", "parameter", "value", "order", "in_table", "receiver", "trained", "frames", "bits"),
    *("bit_errors", "ber", "ber_low", "ber_high", "frame_errors"),
)
"""Columns of ``severity.csv``. ``trained``: whether the receiver trained ``without`` the effect or ``with``
it, as the table of effects has it; ``in_table`` marks the value there; ``order`` counts from harmless."""

_TRAINED = {"true_corners": "without", "retrained": "with"}
_Cell = str | int | float


def write_effects(path: str | Path, table: EffectTable) -> None:
    """Write a line for each effect and receiver: the scene itself before them, sum and all together after.

    Args:
        path: the file, replaced whole.
        table: the effects.

    Raises:
        VoccError: the file cannot be written.
    """
    write_lines(path, COLUMNS, ([cell_text(cell) for cell in line] for line in _lines(table)))


def write_severities(path: str | Path, curves: Iterable[SeverityCurve]) -> None:
    """Write a line for each effect, severity, receiver and training.

    Args:
        path: the file, replaced whole.
        curves: the effects.

    Raises:
        VoccError: the file cannot be written.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_severities(Path(folder) / "severity.csv", [])
        ...     (Path(folder) / "severity.csv").read_text().split(",")[:3]
        ['effect', 'parameter', 'value']
    """
    lines = (line for curve in curves for line in _severity_lines(curve))
    write_lines(path, SEVERITY_COLUMNS, ([cell_text(cell) for cell in line] for line in lines))


def _lines(table: EffectTable) -> Iterator[list[_Cell]]:
    """Give the lines of ``effects.csv``."""
    facts: list[_Cell] = [table.training_frames, table.scene, round(table.waited_share, 4), table.machine]
    base = (table.base_near, table.base_located, table.base_whole)
    for receiver in table.receivers:
        at_truth, at_none, at_paper = (
            _rate_cells(table.base.get(at, {}).get(receiver)) for at in ("truth", "", "paper")
        )
        rates = [*at_truth, *at_none, *at_paper]
        yield ["scene", *[""] * 7, receiver, *_costs(base), *rates, *facts]
    for receiver in table.receivers:
        for row in table.rows:
            yield [*_row_cells("effect", row, receiver), *facts]
    blank: list[_Cell] = [""] * (len(_CHANGES) * len(READINGS))
    if table.sum_near is not None and table.sum_located is not None:
        for receiver in table.receivers:
            costs = _costs((table.sum_near, table.sum_located, None))
            yield ["sum", *[""] * 7, receiver, *costs, *blank, *facts]
    if table.together is not None:
        for receiver in table.receivers:
            yield [*_row_cells("together", table.together, receiver), *facts]


def _row_cells(kind: str, row: EffectRow, receiver: str) -> list[_Cell]:
    """Give the cells of one effect, up to the facts that all lines share."""
    changes = [cell for reading in READINGS for cell in _change_cells(row.change(reading, receiver))]
    own, companions = " + ".join(row.own), " + ".join(row.companions)
    about: list[_Cell] = [kind, row.name, row.group, own, companions, row.settings]
    costs = _costs((row.near, row.located, row.whole))
    return [*about, int(row.in_scene), int(row.fills_sensor), receiver, *costs, *changes]


def _costs(costs: Sequence[Cost | None]) -> list[_Cell]:
    """Give medians and quartiles, to a tenth of a microsecond."""
    cells: list[_Cell] = []
    for cost in costs:
        parts = () if cost is None else (cost.median_ms, cost.low_ms, cost.high_ms)
        cells += [round(part, 4) for part in parts] if parts else [""] * 3
    return cells


def _rate_cells(counts: Counts | None) -> list[_Cell]:
    """Give the cells of the scene itself, which has no change."""
    if counts is None:
        return [""] * len(_CHANGES)
    return [counts.frames, "", counts.ber, "", "", "", "", counts.panels_missed]


def _change_cells(change: Change | None) -> list[_Cell]:
    """Give the cells of a change; blank where it was not measured."""
    if change is None:
        return [""] * len(_CHANGES)
    found = change.interval
    ends = [found.difference, found.low, found.high, int(found.real)]
    return [change.frames, change.absent.ber, change.present.ber, *ends, change.present.panels_missed]


def _severity_lines(curve: SeverityCurve) -> Iterator[list[_Cell]]:
    """Give one effect's lines of ``severity.csv``."""
    for order, point in enumerate(curve.points):
        for reading, errors in point.errors.items():
            for receiver, counts in errors.items():
                interval = ber_interval(counts)
                yield [
                    *(curve.name, curve.parameter, point.value, order, int(point.value == curve.usual)),
                    *(receiver, _TRAINED[reading], counts.frames, counts.bits, counts.bit_errors),
                    *(counts.ber, interval.low, interval.high, counts.frame_errors),
                ]
