"""The comparison of many receivers as CSV files, as a TensorBoard and as a table on the terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from matplotlib.figure import Figure
from rich.console import Console
from rich.text import Text

from vocc_torch.measure.curve import COLUMNS, Row
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.paired import paired_interval, sign_test
from vocc_torch.show.csv_file import cell_text, cells, write_rows
from vocc_torch.show.styles import value_text
from vocc_torch.show.tensorboard import write_boards
from vocc_torch.show.text_table import ends_text, plain_table, point_text
from vocc_torch.studies.classifiers.results import GENIE, Comparison
from vocc_torch.studies.classifiers.words import KNOWS, point_label, ratio_text

Cell: TypeAlias = str | int | float | None
Line: TypeAlias = Sequence[Cell]

_WIDE = 110
"""Columns from which frames, parameters and size stand in the terminal's table too."""

_ENDS = ("ber", "ber_low", "ber_high")
_RATIO = ("ratio", "ratio_low", "ratio_high")


def write_tables(folder: Path, comparison: Comparison) -> None:
    """Write points, pairs and costs and, where they were measured, the genie's points and the scenes.

    Args:
        folder: where they go.
        comparison: what was measured.

    Raises:
        VoccError: a file cannot be written.
    """
    rows = [
        cells(row)
        for table in comparison.tables.values()
        for name in table.receivers
        for row in table.of(name)
    ]
    write_rows(folder / "ber.csv", [COLUMNS, *rows])
    files = {"paired": paired_lines, "classifiers": classifier_lines}
    if comparison.genie:
        files["genie"] = genie_lines
    if comparison.transfers:
        files["robustness"] = scene_lines
    for name, lines in files.items():
        written = [[None if cell is None else cell_text(cell) for cell in line] for line in lines(comparison)]
        write_rows(folder / f"{name}.csv", written)


def paired_lines(comparison: Comparison) -> Iterator[Line]:
    """Compare every receiver with the reference at every point: head and lines of ``paired.csv``.

    ``difference`` is the receiver's rate less the reference's, ``ratio`` the one over the other: empty where
    the reference made no error; ``receiver_worse`` and ``reference_worse`` count frames.
    """
    yield (
        *("experiment", "axis", "value", "locator", "receiver", "reference", "frames"),
        *("difference", "difference_low", "difference_high", "real"),
        *(*_RATIO, "receiver_worse", "reference_worse", "sign_test_p"),
    )
    reference = comparison.reference
    for name, curves in comparison.curves.items():
        for value in curves.values:
            for receiver in (one for one in curves.receivers if one != reference):
                paired = curves.pair(receiver, reference, value)
                found = paired_interval(paired)
                yield (
                    *(name, curves.axis, value, curves.locator, receiver, reference, paired.frames),
                    *(*_of(found), int(found.real), *_of(comparison.ratio(name, receiver, value))),
                    *(paired.a_worse, paired.b_worse, sign_test(paired)),
                )


def _of(estimate: Estimate | None) -> Line:
    """Give an estimate's cells."""
    return (None, None, None) if estimate is None else (estimate.value, estimate.low, estimate.high)


def classifier_lines(comparison: Comparison) -> Iterator[Line]:
    """Give head and lines of ``classifiers.csv``: what each receiver costs, its rates, the best first.

    ``bits_ms`` is the time from the rectified panel to a frame's bits. Rates are at the summary's points.
    """
    costs = ("training_s", "simulated_s", "training_frames", "parameters", "size_bytes", "bits_ms")
    points = [f"{name}_{at:g}_{what}" for name, at in comparison.points.items() for what in (*_ENDS, *_RATIO)]
    yield ("receiver", *costs, *points)
    for receiver in comparison.ranked:
        made = comparison.costs[receiver]
        line: list[Cell] = [receiver, made.training_s, made.simulated_s, made.frames, made.parameters]
        line += [made.size_bytes, comparison.decision_ms.get(receiver)]
        for experiment, value in comparison.points.items():
            row = comparison.row(experiment, receiver, value)
            line += [getattr(row, what) for what in _ENDS]
            line += _of(comparison.ratio(experiment, receiver, value))
        yield line


def genie_lines(comparison: Comparison) -> Iterator[Line]:
    """Give head and lines of ``genie.csv``, a line a point.

    ``best_receivers`` have the fewest wrong bits on the genie's frames: all that do, with spaces between.
    """
    yield (
        *("experiment", "axis", "value", "frames", "bits", "bit_errors", *_ENDS),
        *("proven", "seconds_a_frame", "best_receivers", "best_bit_errors"),
    )
    for name, points in comparison.genie.items():
        for value, one in sorted(points.items()):
            counts, best = one.genie.counts, one.best
            yield (
                *(name, comparison.curves[name].axis, value, counts.frames, counts.bits, counts.bit_errors),
                *(*_of(ber_interval(counts)), one.genie.proven, one.genie.seconds_a_frame),
                *(" ".join(best), one.receivers[best[0]].bit_errors if best else None),
            )


def scene_lines(comparison: Comparison) -> Iterator[Line]:
    """Give head and lines of ``robustness.csv``, a line for each pair of scenes and receiver.

    ``ratio``: to the same receiver trained on the scenes of the test; empty where that one made no error.
    """
    yield (
        *("trained_on", "tested_on", "receiver", "frames", "bits", "bit_errors", *_ENDS),
        *("frame_errors", "panels_missed", *_RATIO),
    )
    for one in comparison.transfers:
        counts = one.counts
        yield (
            *(one.trained_on, one.tested_on, one.receiver, counts.frames, counts.bits, counts.bit_errors),
            *(*_of(ber_interval(counts)), counts.frame_errors, counts.panels_missed, *_of(one.ratio)),
        )


def write_board(
    folder: Path, comparison: Comparison, figures: Mapping[str, Figure], texts: Mapping[str, str]
) -> None:
    """Write a TensorBoard with a run for each receiver, and one for the genie.

    Args:
        folder: the folder that TensorBoard is to be pointed at.
        comparison: what was measured.
        figures: figures by name.
        texts: Markdown by name.

    Raises:
        VoccError: the folder cannot be written.
    """
    names = [*comparison.ranked, *([GENIE] if comparison.genie else [])]
    numbers = {name: dict(_hparams(comparison, name)) for name in names}
    write_boards(folder, {"": list(comparison.tables.values())}, figures, {}, texts, numbers)


def _hparams(comparison: Comparison, receiver: str) -> Iterator[tuple[str, float]]:
    """Give what stands in a receiver's row of the HPARAMS tab beside its rates over all points."""
    for experiment, value in comparison.points.items():
        point = f"{experiment}_{value_text(value)}"
        if (row := comparison.row(experiment, receiver, value)) is not None:
            yield f"BER/{point}", row.ber
        if (ratio := comparison.ratio(experiment, receiver, value)) is not None:
            yield f"of_{comparison.reference}/{point}", ratio.value
    if receiver == GENIE:
        return
    made = comparison.costs[receiver]
    costs = {"training_s": made.training_s, "training_frames": made.frames}
    for what, given in (costs | {"parameters": made.parameters, "size_bytes": made.size_bytes}).items():
        if given is not None:
            yield f"making/{what}", float(given)
    if receiver in comparison.decision_ms:
        yield "bits_ms", comparison.decision_ms[receiver]


def print_table(comparison: Comparison, console: Console) -> None:
    """Print a line for each receiver, the best first, and the genie's above them.

    Args:
        comparison: what was measured.
        console: where to print.
    """
    wide = console.width >= _WIDE
    heads = [
        cell
        for name in comparison.points
        for cell in (f"BER at\n{point_label(comparison, name)}", f"of\n{comparison.reference}")
    ]
    costs = ["training\ns", *(["frames", "para-\nmeters", "kB"] if wide else []), "bits\nms"]
    table = plain_table()
    table.add_column("receiver", overflow="fold")
    for head in [*heads, *costs]:
        table.add_column(head, justify="right", no_wrap=True)
    for receiver in [*([GENIE] if comparison.genie else []), *comparison.ranked]:
        line = [KNOWS if receiver == GENIE else receiver]
        for name, value in comparison.points.items():
            ratio = comparison.ratio(name, receiver, value)
            line.append(_rate(comparison.row(name, receiver, value)))
            line.append("" if ratio is None else ratio_text(ratio))
        line += [""] * len(costs) if receiver == GENIE else _costs(comparison, receiver, wide)
        table.add_row(*(Text(cell, style="dim" if receiver == GENIE else "") for cell in line))
    console.print(table)


def _rate(row: Row | None) -> str:
    """Write a rate with its interval below, or a limit; of the genie without errors how many bits it had."""
    if row is None:
        return ""
    if row.error_free:
        # A limit would tell of the genie's few frames alone.
        return f"0 of\n{row.bits} bits" if row.receiver == GENIE else point_text(row)
    return f"{point_text(row)}\n{ends_text(row.ber_low, row.ber_high)}"


def _costs(comparison: Comparison, receiver: str, wide: bool) -> list[str]:
    """Write what a receiver costs; what learns nothing has no training."""
    made, spent = comparison.costs[receiver], comparison.decision_ms[receiver]
    training = [f"{made.training_s:.1f}", f"{made.frames}"] if made.frames else ["", ""]
    size = f"{made.size_bytes / 1000:.3g}" if made.frames and made.size_bytes is not None else ""
    line = [*training, "" if made.parameters is None else str(made.parameters), size]
    return [*(line if wide else line[:1]), f"{spent:.2g}" if spent < 9.95 else f"{spent:.0f}"]
