"""What the TensorBoard board shows of a table: tags, integer steps, charts and the words that explain them.

TensorBoard draws scalars against an integer step and has no logarithmic axis. So the step is the physical
value in a unit that makes it whole, and the logarithm of the rate is what is logged.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import BerTable
from vocc_torch.show.styles import axis_label

_STEPS = {
    "distance_m": (10, "dm"),
    "contrast": (1000, "thousandths"),
    "offset_x_m": (1000, "mm"),
    "offset_y_m": (1000, "mm"),
}
"""What an axis value is multiplied by to be a step, and the unit that gives."""

_COLOURS = 7
"""How many colours TensorBoard has for runs."""


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


@dataclass(frozen=True, slots=True)
class Section:
    """One table's part of the board.

    Args:
        group: name that its tags begin with; empty for none.
        table: at least one point.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curve import Point
        >>> point = Point("sun", "ambient_lx", 8e3, "flda_3", "truth", Counts(1, 64), "frames")
        >>> Section("25mm-truth", BerTable([point])).tag("BER")
        '25mm-truth/BER/ambient_lx'
    """

    group: str
    table: BerTable

    def tag(self, quantity: str) -> str:
        """Name a quantity's curve; the same for every receiver, so that one chart has them all.

        Args:
            quantity: what is logged, such as ``log10_BER``.
        """
        return "/".join(filter(None, (self.group, quantity, self.table.axis)))

    @property
    def steps(self) -> dict[float, int]:
        """Each value's integer step; refuses two values with the same."""
        return axis_steps(self.table.axis, self.table.values)

    @property
    def title(self) -> str:
        """Heading of the charts: group, experiment and what a step is."""
        name = " ".join(filter(None, (self.group, self.table.experiment)))
        return f"{name}: bit error rate (step: {_step_unit(self.table.axis)})"


def layout(sections: Sequence[Section]) -> dict[str, dict[str, list[str | list[str]]]]:
    """Lay the custom scalars out: for each section its curves, its curves with intervals, and its limits.

    Args:
        sections: parts of the board, with different groups or axes.

    Returns:
        Charts by title, by section's title, as ``SummaryWriter.add_custom_scalars`` takes them. The chart of
        limits is there only where a point has no errors.
    """
    return {section.title: _charts(section) for section in sections}


def _charts(section: Section) -> dict[str, list[str | list[str]]]:
    """Choose one section's charts. Tags of lines are regular expressions, those of bands are literal."""
    charts: dict[str, list[str | list[str]]] = {
        "log10 BER": ["Multiline", [_exactly(section.tag("log10_BER"))]],
        "log10 BER with 95 % intervals": [
            "Margin",
            [section.tag(name) for name in ("log10_BER", "log10_BER_lo", "log10_BER_hi")],
        ],
    }
    if any(row.error_free for row in section.table):
        limits = _exactly(section.tag("log10_BER_upper95"))
        charts["no errors: log10 of the 95 % upper limit"] = ["Multiline", [limits]]
    return charts


def _exactly(tag: str) -> str:
    """Write the regular expression that matches one tag."""
    return f"^{re.escape(tag)}$"


def how_to_read(sections: Sequence[Section]) -> str:
    """Explain the board in Markdown.

    Args:
        sections: parts of the board, at least one.
    """
    return (
        f"{_steps_told(sections)} {_runs_told(sections)} Points are measurements: set *Smoothing* "
        "to 0 and untick *Ignore outliers in chart scaling*, which cuts curves off.\n\n"
        "Intervals are 95 %, with frames as the independent units. A point without errors has no logarithm: "
        "it is missing from *log10_BER* and stands in *log10_BER_upper95* with its one-sided 95 % limit, "
        "which takes wrong frames to be as at the receiver's other points. The curves on logarithmic "
        "axes are in the IMAGES tab; *Show actual image size* makes them legible."
    )


def _steps_told(sections: Sequence[Section]) -> str:
    """Say what the horizontal axis is."""
    units = list(dict.fromkeys(f"**{_step_unit(section.table.axis)}**" for section in sections))
    if len(units) == 1:
        return f"The horizontal axis, called *step*, is {units[0]}."
    listed = f"{', '.join(units[:-1])} or {units[-1]}"
    return f"The horizontal axis, called *step*, is {listed}, as the charts' heading says."


def _runs_told(sections: Sequence[Section]) -> str:
    """Say what runs and groups are, and where the corners come from."""
    groups: dict[str, list[str]] = {}
    for group in dict.fromkeys(section.group for section in sections):
        members = [section.table for section in sections if section.group == group]
        corners = dict.fromkeys(name for table in members for name in table.locators)
        groups.setdefault(", ".join(corners), []).append(f"`{group}`")
    if all(section.group == "" for section in sections):
        return f"Runs are receivers; the panel's corners come from: {', '.join(groups)}."
    told = "; ".join(f"{corners} in {', '.join(names)}" for corners, names in groups.items())
    return (
        f"Runs are receivers. A tag begins with its group; the panel's corners come from: {told}. "
        "*Matches*, below a chart, and the tooltip name each curve; the box before a run's name hides it. "
        f"TensorBoard has {_COLOURS} colours: the next run has the first one's again."
    )


def _step_unit(axis: str) -> str:
    """Name what a step is."""
    if axis in _STEPS:
        name = axis_label(axis).partition(" (")[0]
        return f"{name} in {_STEPS[axis][1]}"
    return axis_label(axis)
