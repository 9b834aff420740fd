"""``paired.csv``: every two receivers compared on the same frames."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from itertools import combinations
from pathlib import Path

from vocc_torch.files import atomic_file
from vocc_torch.measure.curves import Curves
from vocc_torch.measure.paired import DifferenceInterval, paired_interval, sign_test
from vocc_torch.show.csv_file import cell_text
from vocc_torch.show.styles import receiver_styles, value_text

COLUMNS = (
    "experiment",
    "axis",
    "value",
    "locator",
    "a",
    "b",
    "frames",
    "difference",
    "difference_low",
    "difference_high",
    "real",
    "a_worse",
    "b_worse",
    "sign_test_p",
)
"""Columns of ``paired.csv``: ``difference`` is the bit error rate of a less that of b; ``real`` says whether
its 95 % interval leaves out 0; ``a_worse`` and ``b_worse`` count frames."""


def write_paired(path: str | Path, all_curves: Iterable[Curves]) -> None:
    """Write a line for every two receivers at every value.

    Args:
        path: the file, replaced whole.
        all_curves: experiments.

    Raises:
        VoccError: the file cannot be written.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_paired(Path(folder) / "paired.csv", [])
        ...     (Path(folder) / "paired.csv").read_text().split(",")[4:6]
        ['a', 'b']
    """
    with atomic_file(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for curves in all_curves:
            writer.writerows(map(cell_text, row) for row in _rows(curves))


def _rows(curves: Curves) -> Iterable[tuple[str | int | float, ...]]:
    """Give an experiment's lines."""
    for value in curves.values:
        for a, b in combinations(curves.receivers, 2):
            paired = curves.pair(a, b, value)
            if not paired.frames:
                continue
            found = paired_interval(paired)
            yield (
                curves.experiment,
                curves.axis,
                value,
                curves.locator,
                a,
                b,
                paired.frames,
                found.difference,
                found.low,
                found.high,
                int(found.real),
                paired.a_worse,
                paired.b_worse,
                sign_test(paired),
            )


def compared(curves: Curves, reference: str) -> list[str]:
    """Say in a line for each other receiver where it differs from a reference for certain.

    Args:
        curves: an experiment.
        reference: a receiver in it.

    Example:
        >>> compared(Curves("d", "distance_m", "truth", ("flda_3",), (), {}, {}, {}), "flda_3")
        []
    """
    lines = []
    labels = {name: style.label for name, style in receiver_styles(curves.receivers).items()}
    for name in curves.receivers:
        if name == reference:
            continue
        found = {value: paired_interval(curves.pair(name, reference, value)) for value in curves.values}
        parts = [
            f"{word} at {', '.join(places)}"
            for word, places in (
                ("worse", _places(found, worse=True)),
                ("better", _places(found, worse=False)),
            )
            if places
        ]
        lines.append(f"{labels[name]}: {'; '.join(parts) or 'no difference shown'}")
    return lines


def _places(found: dict[float, DifferenceInterval], *, worse: bool) -> list[str]:
    """Name the values at which a receiver is surely worse, or surely better."""
    return [value_text(value) for value, one in found.items() if one.real and (one.difference > 0) == worse]
