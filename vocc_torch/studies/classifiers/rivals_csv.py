"""The tables of ``task=classifiers`` as text files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import COLUMNS
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.paired import paired_interval, sign_test
from vocc_torch.show.csv_file import cell_text, cells, write_lines
from vocc_torch.studies.classifiers.rivals import Rivals

Cell = str | int | float | None

PAIRED_COLUMNS = (
    *("experiment", "axis", "value", "locator", "receiver", "reference", "frames"),
    *("difference", "difference_low", "difference_high", "real"),
    *("ratio", "ratio_low", "ratio_high", "receiver_worse", "reference_worse", "sign_test_p"),
)
"""``difference`` is the receiver's rate less the reference's, ``ratio`` the one over the other: empty where
the reference made no error; ``receiver_worse`` and ``reference_worse`` count frames."""

PRICE_COLUMNS = (
    *("receiver", "training_s", "simulated_s", "training_frames", "parameters", "size_bytes"),
    "bits_ms",
)
"""What each receiver takes, ``bits_ms`` from the rectified panel to a frame's bits; its rates at the
summary's points come after."""

POINT_COLUMNS = ("ber", "ber_low", "ber_high", "ratio", "ratio_low", "ratio_high")
"""What ``classifiers.csv`` says of each point."""

GENIE_COLUMNS = (
    *("experiment", "axis", "value", "frames", "bits", "bit_errors", "ber", "ber_low", "ber_high"),
    *("proven", "seconds_a_frame", "best_receivers", "best_bit_errors"),
)
"""``best_receivers`` have the fewest wrong bits on the genie's frames: all that do, with spaces between."""

SCENE_COLUMNS = (
    *("trained_on", "tested_on", "receiver", "frames", "bits", "bit_errors", "ber", "ber_low", "ber_high"),
    *("frame_errors", "panels_missed", "ratio", "ratio_low", "ratio_high"),
)
"""``ratio``: to the same receiver trained on the scenes of the test; empty where that one made no error."""


def write_rivals(folder: str | Path, rivals: Rivals) -> None:
    """Write points, pairs and prices and, where they were measured, the genie's marks and the scenes.

    Args:
        folder: where they go.
        rivals: what was measured.

    Raises:
        VoccError: a file cannot be written.
    """
    here = Path(folder)
    tables = rivals.tables().values()
    rows = (row for table in tables for receiver in table.receivers for row in table.of(receiver))
    write_lines(here / "ber.csv", COLUMNS, (cells(row) for row in rows))
    _write(here / "paired.csv", PAIRED_COLUMNS, _pairs(rivals))
    points = [f"{name}_{value:g}_{what}" for name, value in rivals.points.items() for what in POINT_COLUMNS]
    _write(here / "classifiers.csv", (*PRICE_COLUMNS, *points), _prices(rivals))
    if rivals.marks:
        _write(here / "genie.csv", GENIE_COLUMNS, _marks(rivals))
    if rivals.transfers:
        _write(here / "robustness.csv", SCENE_COLUMNS, _transfers(rivals))


def _write(path: Path, columns: tuple[str, ...], lines: Iterable[tuple[Cell, ...]]) -> None:
    """Write lines; None is an empty cell."""
    write_lines(path, columns, (["" if cell is None else cell_text(cell) for cell in line] for line in lines))


def _pairs(rivals: Rivals) -> Iterator[tuple[Cell, ...]]:
    """Compare every receiver with the reference at every point."""
    reference = rivals.reference
    for name, curves in rivals.curves.items():
        for value in curves.values:
            for receiver in curves.receivers:
                if receiver == reference:
                    continue
                paired = curves.pair(receiver, reference, value)
                found = paired_interval(paired)
                yield (
                    *(name, curves.axis, value, curves.locator, receiver, reference, paired.frames),
                    *(found.value, found.low, found.high, int(found.real)),
                    *_of(rivals.ratio(name, receiver, value)),
                    *(paired.a_worse, paired.b_worse, sign_test(paired)),
                )


def _of(ratio: Estimate | None) -> tuple[Cell, ...]:
    """Give a ratio's cells."""
    return (None, None, None) if ratio is None else (ratio.value, ratio.low, ratio.high)


def _prices(rivals: Rivals) -> Iterator[tuple[Cell, ...]]:
    """Give a line a receiver, the best first, and the genie's where it was asked."""
    tables = rivals.tables()
    for receiver in rivals.ranked():
        made = rivals.making[receiver]
        line: list[Cell] = [receiver, made.training_s, made.simulated_s, made.frames, made.parameters]
        line += [made.size_bytes, rivals.bits_ms.get(receiver)]
        for experiment, value in rivals.points.items():
            (row,) = (one for one in tables[experiment].of(receiver) if one.value == value)
            line += [row.ber, row.ber_low, row.ber_high, *_of(rivals.ratio(experiment, receiver, value))]
        yield tuple(line)


def interval_of(counts: Counts) -> Estimate:
    """Give a rate's interval; without errors its limit takes a wrong frame to have one wrong bit."""
    return ber_interval(counts)


def _marks(rivals: Rivals) -> Iterator[tuple[Cell, ...]]:
    """Give a line a point."""
    for name, marks in rivals.marks.items():
        for value, mark in sorted(marks.items()):
            counts, ends = mark.counts, interval_of(mark.counts)
            best = mark.best
            yield (
                *(name, rivals.curves[name].axis, value, counts.frames, counts.bits, counts.bit_errors),
                *(counts.ber, ends.low, ends.high, mark.proven, mark.seconds_a_frame),
                *(" ".join(best), mark.receivers[best[0]].bit_errors if best else None),
            )


def _transfers(rivals: Rivals) -> Iterator[tuple[Cell, ...]]:
    """Give a line for each pair of scenes and receiver."""
    for one in rivals.transfers:
        counts, ends = one.counts, interval_of(one.counts)
        yield (
            *(one.trained_on, one.tested_on, one.receiver, counts.frames, counts.bits, counts.bit_errors),
            *(counts.ber, ends.low, ends.high, counts.frame_errors, counts.panels_missed),
            *_of(one.ratio),
        )
