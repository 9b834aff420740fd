"""The results as a TensorBoard: one run for each receiver, and one with the layout, figures and pictures."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torch.utils.tensorboard import SummaryWriter

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import BerTable, Row
from vocc_torch.show.canvas import figure_pixels
from vocc_torch.show.tensorboard_layout import Section, how_to_read, layout
from vocc_torch.show.tensorboard_layout import axis_steps as axis_steps

Picture = NDArray[np.uint8]

SUMMARY_RUN = "_summary"
"""Name of the run that holds what belongs to no single receiver."""

_GROUP = re.compile(r"[A-Za-z0-9][A-Za-z0-9._=+-]*")

# TensorBoard's charts colour runs by the order of their first events: orange, blue, red, light blue, pink,
# green, grey, orange again. In this order most receivers come close to their colours in the figures, and the
# two that share one are far apart.
_WRITTEN_FIRST = (
    "average_greyscale",
    "flda_2",
    "flda_3",
    "flda_agr",
    "flda_gri",
    "flda_agr_ngr",
    "center_greyscale",
    "flda_ngr",
)


def write_board(
    folder: str | Path,
    table: BerTable,
    figures: Mapping[str, Figure | Picture] | None = None,
    images: Mapping[str, Picture] | None = None,
    texts: Mapping[str, str] | None = None,
) -> None:
    """Write the board of one table: ``write_boards`` with tags that begin with no group.

    Args:
        folder: the folder that TensorBoard is to be pointed at.
        table: the points.
        figures: figures by name, Matplotlib's or (H,W,3) uint8.
        images: (H,W,3) uint8 pictures by name.
        texts: Markdown by name.

    Raises:
        VoccError: what ``write_boards`` refuses.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_board(folder, BerTable(), texts={"note": "No points yet."})
        ...     [run.name for run in Path(folder).iterdir()]
        ['_summary']
    """
    write_boards(folder, {"": [table]}, figures, images, texts)


def write_boards(
    folder: str | Path,
    tables: Mapping[str, Sequence[BerTable]],
    figures: Mapping[str, Figure | Picture] | None = None,
    images: Mapping[str, Picture] | None = None,
    texts: Mapping[str, str] | None = None,
    numbers: Mapping[str, Mapping[str, float]] | None = None,
) -> None:
    """Write one board of several tables; what an earlier call left in the same runs is replaced.

    A run is a receiver, whatever the group: it keeps its colour, and a chart holds one group's receivers.
    Each run has, against the axis's value as an integer step (distance in dm, contrast in thousandths,
    offsets in mm, others rounded to their unit), ``<group>/BER/<axis>`` for every point,
    ``<group>/log10_BER/<axis>``, ``<group>/log10_BER_lo/<axis>`` and ``<group>/log10_BER_hi/<axis>`` for
    points with errors, and ``<group>/log10_BER_upper95/<axis>`` for points without. Its row in the HPARAMS
    tab has the receiver's settings and its rates over all points of each table.

    Args:
        folder: the folder that TensorBoard is to be pointed at.
        tables: by group, tables of different axes. A group's name is of letters, digits and ``._=+-``; that
            of a single group may be empty, for tags without one.
        figures: figures by name, Matplotlib's or (H,W,3) uint8.
        images: (H,W,3) uint8 pictures by name.
        texts: Markdown by name.
        numbers: what else stands in a receiver's row of the HPARAMS tab, by receiver.

    Raises:
        VoccError: another group name, two tables of one axis in a group, two values of an axis with the same
            step, a picture of another shape or type, or a folder that cannot be written.

    Example:
        >>> import tempfile
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curve import Point
        >>> point = Point("sun", "ambient_lx", 8e3, "flda_3", "truth", Counts(1, 64), "frames")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_boards(folder, {"25mm-truth": [BerTable([point])]})
        ...     sorted(run.name for run in Path(folder).iterdir())
        ['_summary', 'flda_3']
    """
    sections = _sections(tables)
    steps = [section.steps for section in sections]
    pictures = _pictures(figures or {}, images or {})
    try:
        for receiver in _run_order(sections):
            with SummaryWriter(str(_cleared(Path(folder) / receiver))) as writer:
                for section, step_of in zip(sections, steps, strict=True):
                    _write_curve(writer, section, section.table.of(receiver), step_of)
                _write_settings(writer, sections, receiver, (numbers or {}).get(receiver, {}))
        with SummaryWriter(str(_cleared(Path(folder) / SUMMARY_RUN))) as writer:
            _write_summary(writer, sections, pictures, texts or {})
    except OSError as error:
        raise VoccError(f"cannot write {folder}: {error.strerror or error}") from error


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


def _sections(tables: Mapping[str, Sequence[BerTable]]) -> list[Section]:
    """Take the tables that have points, and refuse those whose tags would be the same."""
    sections = []
    for group, members in tables.items():
        if not _GROUP.fullmatch(group) and tuple(tables) != ("",):
            raise VoccError(
                f"tables has the group {group!r}: its name must be of letters, digits and ._=+-, "
                "begin with a letter or a digit, and may be empty only where there is no other"
            )
        filled = [table for table in members if len(table)]
        axes = [table.axis for table in filled]
        for axis in axes:
            if axes.count(axis) > 1:
                raise VoccError(
                    f"tables[{group!r}] has {axes.count(axis)} tables of {axis}: it must have one"
                )
        sections += [Section(group, table) for table in filled]
    return sections


def _run_order(sections: Sequence[Section]) -> list[str]:
    """Put the receivers in the order of their runs."""
    given = dict.fromkeys(name for section in sections for name in section.table.receivers)
    known = [name for name in _WRITTEN_FIRST if name in given]
    return known + [name for name in given if name not in known]


def _pictures(
    figures: Mapping[str, Figure | Picture], images: Mapping[str, Picture]
) -> dict[str, Figure | Picture]:
    """Give figures and images by tag, and refuse what is no picture."""
    for kind, pictures in (("figures", figures), ("images", images)):
        for name, picture in pictures.items():
            if isinstance(picture, Figure):
                continue
            if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
                found = f"{picture.dtype} {picture.shape}"
                raise VoccError(f"{kind}[{name!r}] is {found}: it must be uint8 (H, W, 3)")
    tagged = {f"figures/{name}": figure for name, figure in figures.items()}
    return tagged | {f"images/{name}": image for name, image in images.items()}


def _cleared(run: Path) -> Path:
    """Make a run's folder and remove its old events: read together with new ones, points would vanish."""
    run.mkdir(parents=True, exist_ok=True)
    for events in run.glob("events.out.tfevents.*"):
        events.unlink()
    return run


def _write_curve(
    writer: SummaryWriter, section: Section, rows: Sequence[Row], steps: Mapping[float, int]
) -> None:
    """Write one receiver's curve in ascending order; steps out of order would vanish."""
    for row in rows:
        step = steps[row.value]
        writer.add_scalar(section.tag("BER"), row.ber, step)
        if row.error_free:
            writer.add_scalar(section.tag("log10_BER_upper95"), math.log10(row.ber_high), step)
            continue
        writer.add_scalar(section.tag("log10_BER"), math.log10(row.ber), step)
        writer.add_scalar(section.tag("log10_BER_lo"), math.log10(row.ber_low), step)
        writer.add_scalar(section.tag("log10_BER_hi"), math.log10(row.ber_high), step)


def _write_settings(
    writer: SummaryWriter, sections: Sequence[Section], receiver: str, numbers: Mapping[str, float]
) -> None:
    """Write a receiver's row of the HPARAMS tab."""
    rows = {
        section: section.table.of(receiver) for section in sections if receiver in section.table.receivers
    }
    each = [row for some in rows.values() for row in some]
    settings = {
        "receiver": receiver,
        "locator": _listed(row.locator for row in each),
        "experiment": _listed(row.experiment for row in each),
    }
    groups = _listed(section.group for section in rows)
    if groups:
        settings["group"] = groups
    if len(sections) == 1:
        rates = {
            "all_points/BER": _pooled(each),
            "all_points/lowest_BER": min(row.ber for row in each),
            "all_points/highest_BER": max(row.ber for row in each),
        }
    else:
        rates = {f"all_points/{section.tag('BER')}": _pooled(some) for section, some in rows.items()}
    # The run's own folder: any other would make a run more.
    writer.add_hparams(settings, {**rates, **numbers}, run_name=".")


def _listed(names: Iterable[str]) -> str:
    """List different names in the order in which they first come."""
    return ", ".join(dict.fromkeys(name for name in names if name))


def _pooled(rows: Sequence[Row]) -> float:
    """Give the bit error rate over all bits of some points."""
    return sum(row.bit_errors for row in rows) / sum(row.bits for row in rows)


def _write_summary(
    writer: SummaryWriter,
    sections: Sequence[Section],
    pictures: Mapping[str, Figure | Picture],
    texts: Mapping[str, str],
) -> None:
    """Write what belongs to no single receiver."""
    if sections:
        writer.add_custom_scalars(layout(sections))
        writer.add_text("how to read", how_to_read(sections))
    for name, text in texts.items():
        writer.add_text(name, text)
    for tag, picture in pictures.items():
        pixels = figure_pixels(picture) if isinstance(picture, Figure) else picture
        writer.add_image(tag, pixels, dataformats="HWC")
