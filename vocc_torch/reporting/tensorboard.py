"""The results as a TensorBoard: one run for each receiver, and one with the layout, figures and pictures.

TensorBoard draws scalars against an integer step and has no logarithmic axis. So the step is the physical
value in a unit that makes it whole, and the logarithm of the rate is what is logged.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torch.utils.tensorboard import SummaryWriter

from vocc_torch.errors import VoccError
from vocc_torch.evaluation.curve import BerTable, Row
from vocc_torch.reporting.canvas import figure_pixels
from vocc_torch.reporting.styles import axis_label

SUMMARY_RUN = "_summary"
"""Name of the run that holds what belongs to no single receiver."""

_STEPS = {"distance_m": (10, "dm"), "contrast": (1000, "thousandths")}
"""What an axis value is multiplied by to be a step, and the unit that gives."""


def write_board(
    folder: str | Path,
    table: BerTable,
    figures: Mapping[str, Figure] | None = None,
    images: Mapping[str, NDArray[np.uint8]] | None = None,
    texts: Mapping[str, str] | None = None,
) -> None:
    """Write the board whole; what an earlier call left in the same runs is replaced.

    Each receiver's run holds, against the axis's value as an integer step (distance in dm, contrast in
    thousandths, others rounded to their unit), ``BER/<axis>`` for every point, ``log10_BER/<axis>``,
    ``log10_BER_lo/<axis>`` and ``log10_BER_hi/<axis>`` for points with errors, and
    ``log10_BER_upper95/<axis>`` for points without. Its row in the HPARAMS tab has the receiver's settings
    and its rates over all points.

    Args:
        folder: the folder that TensorBoard is to be pointed at.
        table: the points.
        figures: figures by name.
        images: (H,W,3) uint8 pictures by name.
        texts: Markdown by name.

    Raises:
        VoccError: two values of the axis with the same step, a picture of another shape or type, or a folder
            that cannot be written.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_board(folder, BerTable(), texts={"note": "No points yet."})
        ...     [run.name for run in Path(folder).iterdir()]
        ['_summary']
    """
    steps = axis_steps(table.axis, table.values)
    for name, image in (images or {}).items():
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            raise VoccError(f"images[{name!r}] is {image.dtype} {image.shape}: it must be uint8 (H, W, 3)")
    try:
        for receiver in table.receivers:
            with SummaryWriter(str(_cleared(Path(folder) / receiver))) as writer:
                _write_receiver(writer, table.of(receiver), steps)
        with SummaryWriter(str(_cleared(Path(folder) / SUMMARY_RUN))) as writer:
            _write_summary(writer, table, figures or {}, images or {}, texts or {})
    except OSError as error:
        raise VoccError(f"cannot write {folder}: {error.strerror or error}") from error


def axis_steps(axis: str, values: Sequence[float]) -> dict[float, int]:
    """Give each value of an axis its integer step.

    Args:
        axis: name of the axis.
        values: values of it.

    Raises:
        VoccError: two values with the same step: one would hide the other.

    Example:
        >>> axis_steps("distance_m", [30.0, 32.5]), axis_steps("ambient_lx", [1000.0])
        ({30.0: 300, 32.5: 325}, {1000.0: 1000})
    """
    factor, _ = _STEPS.get(axis, (1, ""))
    steps = {value: round(value * factor) for value in sorted(values)}
    for value, other in pairwise(steps):
        if steps[value] == steps[other]:
            raise VoccError(
                f"{axis} is {value:g} and {other:g}: "
                f"TensorBoard's steps are integers and both give {steps[value]}"
            )
    return steps


def board_hint(folder: str | Path) -> str:
    """Give the command that serves the board and the link that opens it with smoothing off.

    Args:
        folder: the folder given to ``write_board``.

    Example:
        >>> print(board_hint("runs/ambient/board"))
        tensorboard --logdir runs/ambient/board
        http://127.0.0.1:6006/?smoothing=0#custom_scalars&_smoothingWeight=0
    """
    link = "http://127.0.0.1:6006/?smoothing=0#custom_scalars&_smoothingWeight=0"
    return f"tensorboard --logdir {shlex.quote(str(folder))}\n{link}"


def _cleared(run: Path) -> Path:
    """Make a run's folder and remove its old events: read together with new ones, points would vanish."""
    run.mkdir(parents=True, exist_ok=True)
    for events in run.glob("events.out.tfevents.*"):
        events.unlink()
    return run


def _write_receiver(writer: SummaryWriter, rows: Sequence[Row], steps: Mapping[float, int]) -> None:
    """Write one receiver's curve in ascending order; steps out of order would vanish."""
    axis = rows[0].axis
    for row in rows:
        step = steps[row.value]
        writer.add_scalar(f"BER/{axis}", row.ber, step)
        if row.error_free:
            writer.add_scalar(f"log10_BER_upper95/{axis}", math.log10(row.ber_high), step)
            continue
        writer.add_scalar(f"log10_BER/{axis}", math.log10(row.ber), step)
        writer.add_scalar(f"log10_BER_lo/{axis}", math.log10(row.ber_low), step)
        writer.add_scalar(f"log10_BER_hi/{axis}", math.log10(row.ber_high), step)
    settings = {"receiver": rows[0].receiver, "locator": rows[0].locator, "experiment": rows[0].experiment}
    rates = {
        "all_points/BER": sum(row.bit_errors for row in rows) / sum(row.bits for row in rows),
        "all_points/lowest_BER": min(row.ber for row in rows),
        "all_points/highest_BER": max(row.ber for row in rows),
    }
    # The run's own folder: any other would make a run more.
    writer.add_hparams(settings, rates, run_name=".")


def _write_summary(
    writer: SummaryWriter,
    table: BerTable,
    figures: Mapping[str, Figure],
    images: Mapping[str, NDArray[np.uint8]],
    texts: Mapping[str, str],
) -> None:
    """Write what belongs to no single receiver."""
    if len(table):
        writer.add_custom_scalars(_layout(table))
        writer.add_text("how to read", _reading(table))
    for name, text in texts.items():
        writer.add_text(name, text)
    for name, figure in figures.items():
        writer.add_image(f"figures/{name}", figure_pixels(figure), dataformats="HWC")
    for name, image in images.items():
        writer.add_image(f"images/{name}", image, dataformats="HWC")


def _layout(table: BerTable) -> dict[str, dict[str, list[str | list[str]]]]:
    """Lay the custom scalars out: curves with intervals, all curves, and the limits if there are any."""
    axis = table.axis
    charts: dict[str, list[str | list[str]]] = {
        "log10 BER": ["Multiline", [rf"^log10_BER/{axis}$"]],
        "log10 BER with 95 % intervals": [
            "Margin",
            [f"log10_BER/{axis}", f"log10_BER_lo/{axis}", f"log10_BER_hi/{axis}"],
        ],
    }
    if any(row.error_free for row in table):
        charts["no errors: log10 of the 95 % upper limit"] = ["Multiline", [rf"^log10_BER_upper95/{axis}$"]]
    return {f"{table.experiment}: bit error rate (step: {_step_unit(axis)})": charts}


def _step_unit(axis: str) -> str:
    """Name what a step is."""
    if axis in _STEPS:
        name = axis_label(axis).partition(" (")[0]
        return f"{name} in {_STEPS[axis][1]}"
    return axis_label(axis)


def _reading(table: BerTable) -> str:
    """Explain the board in Markdown."""
    return (
        f"The horizontal axis, called *step*, is **{_step_unit(table.axis)}**. Runs are receivers; the "
        f"panel's corners come from: {', '.join(table.locators)}. Points are measurements: set *Smoothing* "
        "to 0 and untick *Ignore outliers in chart scaling*, which cuts curves off.\n\n"
        "Intervals are 95 %, with frames as the independent units. A point without errors has no logarithm: "
        "it is missing from *log10_BER* and stands in *log10_BER_upper95* with its one-sided 95 % limit, "
        "which takes wrong frames to be as at the receiver's other points. The curves on logarithmic "
        "axes are in the IMAGES tab; *Show actual image size* makes them legible."
    )
