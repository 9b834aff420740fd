"""``paired.csv``: every two receivers compared on the same frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import combinations
from pathlib import Path

from vocc_torch.measure.curve import Curves
from vocc_torch.measure.paired import paired_interval, sign_test
from vocc_torch.show.csv_file import cell_text, write_rows
from vocc_torch.show.styles import receiver_styles, value_text

COLUMNS = (
    *("experiment", "axis", "value", "locator", "a", "b", "frames"),
    *("difference", "difference_low", "difference_high", "real", "a_worse", "b_worse", "sign_test_p"),
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
    lines = (map(cell_text, row) for curves in all_curves for row in _rows(curves))
    write_rows(path, [COLUMNS, *map(tuple, lines)])


def _rows(curves: Curves) -> Iterator[tuple[str | int | float, ...]]:
    """Give an experiment's lines."""
    for value in curves.values:
        for a, b in combinations(curves.receivers, 2):
            paired = curves.pair(a, b, value)
            if not paired.frames:
                continue
            found = paired_interval(paired)
            place = (curves.experiment, curves.axis, value, curves.locator, a, b, paired.frames)
            worse = (paired.a_worse, paired.b_worse, sign_test(paired))
            yield *place, found.value, found.low, found.high, int(found.real), *worse


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
    for name, style in receiver_styles(curves.receivers).items():
        if name == reference:
            continue
        places: dict[str, list[str]] = {"worse": [], "better": []}
        for value in curves.values:
            found = paired_interval(curves.pair(name, reference, value))
            if found.real:
                places["worse" if found.value > 0 else "better"].append(value_text(value))
        parts = [f"{word} at {', '.join(values)}" for word, values in places.items() if values]
        lines.append(f"{style.label}: {'; '.join(parts) or 'no difference shown'}")
    return lines
