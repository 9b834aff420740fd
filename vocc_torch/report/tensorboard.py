"""The results as a TensorBoard: one run for each receiver, and one with the layout, figures and pictures.

TensorBoard draws scalars against an integer step and has no logarithmic axis. So the step is the physical
value in a unit that makes it whole, and the logarithm of the rate is what is logged.
"""

import math
import re
import threading
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from PIL import Image
from torch.utils.tensorboard import SummaryWriter

from vocc_torch.errors import VoccError
from vocc_torch.measure.config import Settings, as_yaml
from vocc_torch.measure.curve import BerTable, Row
from vocc_torch.report import page, styles
from vocc_torch.report.plots import Figure, Pixels, save_figure

SUMMARY_RUN = "_summary"
"""Name of the run that holds what belongs to no single receiver."""


LOG_FACTOR = 1000
"""What the logarithm of a value is multiplied by, for a whole step."""

OUTLIERS = 0.05
"""Share of a chart's values at either end that TensorBoard takes for outliers, and cuts off."""

NOT_HYPERPARAMETERS = (
    "name",
    "workers",
    "executor",
    "tensorboard",
    "task",
    "batch_frames",
)
"""Keys of a sweep that change no result."""


def axis_steps(axis: str, values: Sequence[float]) -> dict[float, int]:
    """Give each value of an axis its integer step.

    Args:
        axis: name of the axis.
        values: values of it.

    Raises:
        VoccError: two values with the same step: one would hide the other.

    Example:
        >>> axis_steps("distance_m", [30.0, 32.5]), axis_steps("ambient_lx", [1e3, 2e3, 32e3])
        ({30.0: 300, 32.5: 325}, {1000.0: 3000, 2000.0: 3301, 32000.0: 4505})
    """
    factor, _ = styles.LOOKS["steps"].get(axis, (1, ""))
    logarithmic = styles.scale_of(values, axis) == "log"
    by_step: dict[int, float] = {}
    for value in sorted(values):
        step = round(LOG_FACTOR * math.log10(value) if logarithmic else value * factor)
        if (other := by_step.setdefault(step, value)) != value:
            raise VoccError(
                f"{axis} is {other:g} and {value:g}: TensorBoard's steps are integers and both give {step}"
            )
    return {value: step for step, value in by_step.items()}


def swept_keys() -> dict[str, str]:
    """Give the keys of a multirun with this job's values; empty in a single run.

    Example:
        >>> swept_keys()
        {}
    """
    if not HydraConfig.initialized() or HydraConfig.get().mode != RunMode.MULTIRUN:
        return {}
    words = (word.lstrip("+~") for word in HydraConfig.get().overrides.task)
    pairs = (word.partition("=")[::2] for word in words)
    return {key: value for key, value in pairs if key not in NOT_HYPERPARAMETERS}


def write_figures(
    settings: Settings,
    folder: Path,
    figures: Mapping[str, Figure],
    tables: Mapping[str, Sequence[BerTable]] = {},
    images: Mapping[str, Pixels] = {},
    **rows: Mapping[str, Any],
) -> None:
    """Write a run's figures as PNG files and, where it wants one, its board with figures and configuration.

    Args:
        settings: the configuration.
        folder: the run's folder.
        figures: by the name of the file, without its end.
        tables: as of :func:`write_boards`.
        images: (H,W,3) uint8 pictures by name.
        **rows: ``numbers`` and ``runs`` of :func:`write_boards`.
    """
    pictures = {f"images/{name}": pixels for name, pixels in images.items()}
    for name, figure in figures.items():
        path = folder / f"{name}.png"
        save_figure(figure, path)
        if settings.tensorboard:
            pictures[f"figures/{name}"] = np.array(Image.open(path).convert("RGB"))
    if settings.tensorboard:
        configuration = f"```yaml\n{as_yaml(settings)}\n```"
        write_boards(folder / "tensorboard", tables, pictures, configuration, **rows)


def write_boards(
    folder: str | Path,
    tables: Mapping[str, Sequence[BerTable]],
    images: Mapping[str, Pixels] = {},
    configuration: str = "",
    numbers: Mapping[str, dict[str, float]] = {},
    runs: Mapping[str, tuple[dict[str, Any], dict[str, float]]] = {},
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
        tables: by group, tables of different axes; the name of a single group may be empty, for tags without
            one.
        images: (H,W,3) uint8 pictures by name.
        configuration: of the run, as Markdown.
        numbers: what else stands in a receiver's row of the HPARAMS tab, by receiver.
        runs: further runs by name, which are a row of the HPARAMS tab each: settings and numbers.

    Raises:
        VoccError: two values of an axis with the same step, or a folder that cannot be written.

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
    parts = [
        BoardPart(group, table, axis_steps(table.axis, table.values))
        for group, group_tables in tables.items()
        for table in group_tables
        if len(table)
    ]
    names = dict.fromkeys(name for part in parts for name in part.table.receivers)
    # The sort is stable: those without a place keep their order.
    first = styles.LOOKS["written_first"]
    receivers = sorted(names, key=lambda name: [*first, name].index(name))
    try:
        with quiet_threads():
            for receiver in receivers:
                with cleared_run(Path(folder) / receiver) as writer:
                    write_receiver(writer, parts, receiver, numbers.get(receiver, {}))
            for name, row in runs.items():
                with cleared_run(Path(folder) / name) as writer:
                    # The run's own folder: any other would make a run more.
                    writer.add_hparams(*row, run_name=".")
            with cleared_run(Path(folder) / SUMMARY_RUN) as writer:
                write_guide(writer, parts)
                writer.add_text("configuration", configuration)
                for name, pixels in images.items():
                    writer.add_image(name, pixels, dataformats="HWC")
    except OSError as error:
        raise VoccError(f"cannot write {folder}: {error.strerror or error}") from error


def cleared_run(run: Path) -> SummaryWriter:
    """Begin a run anew: its old events, read together with new ones, would make points vanish."""
    for events in run.glob("events.out.tfevents.*"):
        events.unlink()
    return SummaryWriter(str(run))


@dataclass(frozen=True, slots=True)
class BoardPart:
    """One table's part of the board.

    Args:
        group: what its tags begin with; may be empty.
        table: the points.
        steps: each value's step.
    """

    group: str
    table: BerTable
    steps: Mapping[float, int]

    def tag(self, quantity: str) -> str:
        """Name a quantity's curve; the same for every receiver, so that one chart has them all."""
        return "/".join(filter(None, (self.group, quantity, self.table.axis)))

    @property
    def unit(self) -> str:
        """Say what a step is."""
        label = styles.axis_label(self.table.axis)
        if styles.scale_of(self.table.values, self.table.axis) == "log":
            return f"{LOG_FACTOR} x log10 of {label}"
        return str(styles.LOOKS["steps"].get(self.table.axis, (1, label))[1])

    def repeats(self, row: Row) -> int:
        """Return at how many neighbouring steps a point with errors is written.

        TensorBoard takes what few points have for outliers: both ends of a chart have enough of them.
        """
        rates = sorted(point.ber for point in self.table if not point.error_free)
        if row.ber not in (rates[0], rates[-1]):
            return 1
        step = self.steps[row.value]
        beyond = [other - step for other in self.steps.values() if other > step]
        enough = 2 + math.ceil(1.2 * OUTLIERS * len(rates))
        return min(min(beyond, default=len(rates)), enough)

    def charts(self) -> tuple[str, dict[str, list[str | list[str]]]]:
        """Lay out curves, curves with intervals, and limits where a point has no errors, with their heading.

        Tags of lines are regular expressions, those of bands are literal.
        """
        rates, limits = (re.escape(self.tag(name)) for name in (SHOWN[0], LIMITS))
        charts: dict[str, list[str | list[str]]] = {
            "log10 BER": ["Multiline", [f"^{rates}$"]],
            "log10 BER with 95 % intervals": ["Margin", list(map(self.tag, SHOWN))],
        }
        if any(row.error_free for row in self.table):
            title = "no errors: log10 of the 95 % upper limit"
            charts[title] = ["Multiline", [f"^{limits}$"]]
        name = " ".join(filter(None, (self.group, self.table.experiment)))
        return f"{name}: bit error rate (step: {self.unit})", charts

    def rates(self, receiver: str) -> Iterator[tuple[str, float, int]]:
        """Give tag, value and step of one receiver's curves, in ascending order; others would vanish."""
        for row in self.table.of(receiver):
            step = self.steps[row.value]
            yield self.tag("BER"), row.ber, step
            if row.error_free:
                yield self.tag(LIMITS), math.log10(row.ber_high), step
                continue
            rates = row.ber, row.ber_low or row.ber / 10, row.ber_high
            for quantity, rate in zip(SHOWN, rates, strict=True):
                for beside in range(self.repeats(row)):
                    yield self.tag(quantity), math.log10(rate), step + beside


SHOWN = ("log10_BER", "log10_BER_lo", "log10_BER_hi")
"""The curves of the charts: rates and the ends of their intervals."""
LIMITS = "log10_BER_upper95"
"""The curve of upper limits at points without errors."""


def write_receiver(
    writer: SummaryWriter,
    parts: Sequence[BoardPart],
    receiver: str,
    numbers: dict[str, float],
) -> None:
    """Write a receiver's curves, and its row of the HPARAMS tab with its rates over all points of a table."""
    rates, rows = {}, list[tuple[str, Row]]()
    for part in parts:
        for rate in part.rates(receiver):
            writer.add_scalar(*rate)
        if mine := part.table.of(receiver):
            name = "BER" if len(parts) == 1 else part.tag("BER")
            wrong, bits = sum(row.wrong_bits for row in mine), sum(r.bits for r in mine)
            rates[f"all_points/{name}"] = wrong / bits
            rows += ((part.group, row) for row in mine)
    if len(parts) == 1:
        rates["all_points/lowest_BER"] = min(row.ber for _, row in rows)
        rates["all_points/highest_BER"] = max(row.ber for _, row in rows)
    settings = {
        "receiver": receiver,
        "locator": listed(row.locator for _, row in rows),
        "experiment": listed(row.experiment for _, row in rows),
    }
    if groups := listed(group for group, _ in rows):
        settings["group"] = groups
    # The run's own folder: any other would make a run more.
    writer.add_hparams(settings | swept_keys(), rates | numbers, run_name=".")


def write_guide(writer: SummaryWriter, parts: Sequence[BoardPart]) -> None:
    """Lay the charts out and say how to read them, where there are curves."""
    if parts:
        writer.add_custom_scalars(dict(part.charts() for part in parts))
        groups = defaultdict[str, dict[str, None]](dict)
        for part in parts:
            groups[", ".join(part.table.locators)][part.group] = None
        units = list(dict.fromkeys(part.unit for part in parts))
        text = page.render(__package__, "board.md.j2", groups=groups, units=units)
        writer.add_text("how to read", text.rstrip())


def listed(names: Iterable[str]) -> str:
    """List different names in the order in which they first come.

    Example:
        >>> listed(["truth", "", "paper", "truth"])
        'truth, paper'
    """
    return ", ".join(dict.fromkeys(filter(None, names)))


@contextmanager
def quiet_threads() -> Iterator[None]:
    """Keep TensorBoard's writing thread from printing the OSError that ``write_board`` then raises."""
    shown = threading.excepthook
    threading.excepthook = lambda failure: (
        None if issubclass(failure.exc_type, OSError) else shown(failure)
    )
    try:
        yield
    finally:
        threading.excepthook = shown
