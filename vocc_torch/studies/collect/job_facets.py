"""Bit error rates of many jobs as small multiples: a facet for each, on one scale."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import BerTable, Row
from vocc_torch.show.ber_axes import draw_rates, interval_note, receiver_line
from vocc_torch.show.canvas import GRID, INK, QUIET, new_figure, write_title
from vocc_torch.show.styles import Style, axis_label, receiver_styles

MOST_FACETS = 30
"""Most facets in a figure; more are not legible side by side."""
_FACET_IN = {1: (7.4, 3.9), 4: (3.9, 2.5), MOST_FACETS: (3.3, 2.15)}
"""Width and height of a facet's axes, inches, for up to so many facets."""
_LEFT_IN, _GAP_IN, _RIGHT_IN = 0.85, 0.3, 0.3
_LABELS_IN = 0.55
"""Room below a facet's axes for the numbers and the name of its axis."""
_SIZE = 0.78
_HEAD_PT, _LINE_IN, _MOST_LINES = 9.0, 0.165, 3
_LETTER_IN = 0.066
"""Width of a letter of heads and footnote, inches."""
_FOOT_LINE_IN = 0.19


@dataclass(frozen=True, slots=True)
class Facet:
    """One job, as reports show it.

    Args:
        name: of the job.
        label: what is particular of it; may be empty.
        table: its points, or None.
        status: in a word.
        note: why there is no table, or what is wrong beside it; may be empty.
    """

    name: str
    label: str
    table: BerTable | None
    status: str = "done"
    note: str = ""


def jobs_figure(facets: Sequence[Facet], title: str) -> Figure:
    """Draw each job's bit error rates in axes of its own, all on the same scale of rates.

    A receiver looks the same in every facet and in every other figure. A job without points keeps its place,
    with the reason in it.

    Args:
        facets: 1 to 30 jobs, in order.
        title: what the figure shows.

    Raises:
        VoccError: no job, or more than 30.

    Example:
        >>> len(jobs_figure([Facet("0", "seed=1", None, "failed", "no panel")], "Jobs").axes)
        1
    """
    if not 1 <= len(facets) <= MOST_FACETS:
        raise VoccError(f"facets has {len(facets)} jobs: a figure takes 1 to {MOST_FACETS}")
    tables = [facet.table for facet in facets if facet.table]
    shown = [row for table in tables for row in table]
    styles = receiver_styles(all_receivers(facets))
    frame = _Frame(len(facets), len(styles))
    heads = [_head(facet, frame.letters) for facet in facets]
    foot = _footnote(shown, len(facets) - len(tables), frame.width)
    frame.fit(max(map(len, heads)), foot.count("\n") + 1)
    figure = new_figure(frame.width, frame.height)
    for number, (facet, head) in enumerate(zip(facets, heads, strict=True)):
        axes = figure.add_axes(frame.place(number))
        _write_head(axes, head)
        if facet.table:
            _draw(axes, facet.table, styles, shown, first=number % frame.columns == 0)
        else:
            _write_reason(axes, facet, frame.letters)
    write_title(figure, title, foot)
    _legend(figure, list(styles.values()), frame.legend_columns)
    return figure


def all_receivers(facets: Iterable[Facet]) -> list[str]:
    """Name the receivers of all jobs, in the order of the job that has the most of them.

    Example:
        >>> all_receivers([Facet("0", "", None)])
        []
    """
    tables = [facet.table for facet in facets if facet.table]
    tables.sort(key=lambda table: -len(table.receivers))
    return list(dict.fromkeys(name for table in tables for name in table.receivers))


class _Frame:
    """Where the facets stand in the figure, in inches from its top left."""

    def __init__(self, facets: int, receivers: int) -> None:
        self._facet = next(size for most, size in _FACET_IN.items() if facets <= most)
        self.columns = facets if facets <= 3 else min(5, math.ceil(math.sqrt(facets)))
        self._rows = math.ceil(facets / self.columns)
        self.width = _LEFT_IN + self.columns * (self._facet[0] + _GAP_IN) - _GAP_IN + _RIGHT_IN
        self.letters = int((self._facet[0] + 0.5 * _GAP_IN) / _LETTER_IN)
        self.legend_columns = max(1, int(self.width / 2.75))
        self._top = 0.55 + 0.24 * math.ceil(receivers / self.legend_columns)

    def fit(self, head_lines: int, foot_lines: int) -> None:
        """Leave room for the longest head and for the footnote."""
        self._head = 0.16 + _LINE_IN * head_lines
        self._step = self._head + self._facet[1] + _LABELS_IN
        self.height = self._top + self._rows * self._step + _FOOT_LINE_IN * foot_lines + 0.2

    def place(self, number: int) -> tuple[float, float, float, float]:
        """Give a facet's axes: left, bottom, width and height in shares of the figure."""
        row, column = divmod(number, self.columns)
        wide, high = self._facet
        left = _LEFT_IN + column * (wide + _GAP_IN)
        below = self._top + row * self._step + self._head + high
        return left / self.width, 1 - below / self.height, wide / self.width, high / self.height


def _head(facet: Facet, letters: int) -> list[str]:
    """Wrap a facet's name and label, the latter cut after three lines."""
    about = facet.label if facet.status == "done" else ", ".join(filter(None, [facet.label, facet.status]))
    text = f"job {facet.name}" + (f": {about}" if about else "")
    return textwrap.wrap(text, letters, max_lines=_MOST_LINES, placeholder=" \N{HORIZONTAL ELLIPSIS}")


def _write_head(axes: Axes, lines: Sequence[str]) -> None:
    """Write what the job is above its axes."""
    axes.annotate(
        "\n".join(lines),
        xy=(0, 1),
        xycoords="axes fraction",
        xytext=(0, 5),
        textcoords="offset points",
        fontsize=_HEAD_PT,
        color=INK,
        va="bottom",
        linespacing=1.25,
    )


def _draw(
    axes: Axes, table: BerTable, styles: dict[str, Style], shown: Sequence[Row], *, first: bool
) -> None:
    """Draw a job's points; only the first of a row has the rates' numbers."""
    width_in = axes.bbox.width / axes.figure.dpi
    draw_rates(axes, table, styles, shown, size=_SIZE, width_in=width_in)
    axes.set_xlabel(axis_label(table.axis), labelpad=2, fontsize=_HEAD_PT)
    if first:
        axes.set_ylabel("Bit error rate", fontsize=_HEAD_PT)
    else:
        axes.tick_params(axis="y", which="both", labelleft=False)


def _write_reason(axes: Axes, facet: Facet, letters: int) -> None:
    """Write in a job's place why it has no points."""
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_color(GRID)
    lines = textwrap.wrap(facet.note or facet.status, letters - 6, max_lines=8)
    axes.text(
        0.5,
        0.5,
        "\n".join(lines),
        transform=axes.transAxes,
        ha="center",
        va="center",
        fontsize=_HEAD_PT,
        color=QUIET,
        linespacing=1.4,
    )


def _legend(figure: Figure, styles: Sequence[Style], columns: int) -> None:
    """Name the receivers under the title."""
    if not styles:
        return
    figure.legend(
        handles=[receiver_line(style, size=0.9) for style in styles],
        loc="upper left",
        bbox_to_anchor=(0.01, 1 - 0.44 / figure.get_figheight()),
        ncols=min(columns, len(styles)),
        frameon=False,
        fontsize=9.5,
        labelcolor=INK,
        handlelength=3,
        columnspacing=1.8,
    )


def _footnote(shown: Sequence[Row], without: int, width_in: float) -> str:
    """Say what the points rest on, in lines that fit the figure."""
    locators = ", ".join(dict.fromkeys(row.locator for row in shown))
    parts = [f"locator: {locators}"] if locators else []
    if without:
        parts.append("1 job has no points" if without == 1 else f"{without} jobs have no points")
    lines = [" \N{MIDDLE DOT} ".join(parts), interval_note(shown) if shown else ""]
    letters = int((width_in - 0.4) / _LETTER_IN)
    return "\n".join(part for line in lines for part in textwrap.wrap(line, letters))
