"""Figures of intervals in rows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from matplotlib.artist import Artist
from matplotlib.lines import Line2D

from vocc_torch.measure.estimate import Estimate
from vocc_torch.report.plots import (
    LOOK,
    Axes,
    Figure,
    head,
    quiet,
    rows_of,
    sheet,
    star,
)
from vocc_torch.report.styles import (
    Style,
)


@dataclass(frozen=True)
class Rows:
    """Axes with intervals in rows.

    Args:
        series: by name in the legend, a style and an interval for each row, or None.
        x_label: with the unit.
        title: above the axes.
        scale: ``linear``, ``log`` or ``symlog``.
        linear: half the width of the linear part of ``symlog``.
        stars: quoted values by row.
    """

    series: Mapping[str, tuple[Style, Sequence[Estimate | None]]]
    x_label: str
    title: str = ""
    scale: str = "linear"
    linear: float = 1e-3
    stars: Mapping[int, float] = field(default_factory=dict)


def rows_figure(
    names: Sequence[str],
    panels: Sequence[Rows],
    title: str,
    footnote: str = "",
    groups: Sequence[str] = (),
    columns: int = 2,
) -> Figure:
    """Draw intervals in rows that all panels share, the first at the top.

    Args:
        names: of the rows.
        panels: beside each other.
        title: what the figure shows.
        footnote: what it rests on.
        groups: of the rows; every other group has a grey band.
        columns: most panels in a row.

    Example:
        >>> style = Style("time", "#0072B2", "o", "-")
        >>> panel = Rows({"time": (style, [Estimate(2.0, 1.0, 3.0)])}, "ms")
        >>> [label.get_text() for label in rows_figure(["paper"], [panel], "Times").axes[0].get_yticklabels()]
        ['paper']
    """
    layout = rows_of(list(range(len(panels))), columns)
    size = (
        5.4 * len(layout[0]) + 0.6,
        len(layout) * (0.9 + LOOK.row_in * len(names)) + 1.1,
    )
    styles = {
        name: style for panel in panels for name, (style, _) in panel.series.items()
    }
    signs: list[Artist] = [
        Line2D(
            [], [], color=style.colour, marker=style.marker, label=name, linewidth=1.5
        )
        for name, style in styles.items()
    ]
    if any(panel.stars for panel in panels):
        signs.append(Line2D([], [], **star(LOOK.quiet), label="quoted"))
    figure, axes = sheet(layout, size, title, footnote, signs)
    for place, panel in enumerate(panels):
        draw_rows(axes[place], panel, len(names))
        for row, group in enumerate(groups):
            if list(dict.fromkeys(groups)).index(group) % 2 == 0:
                axes[place].axhspan(
                    row - 0.5, row + 0.5, color="#F6F7F9", zorder=0, linewidth=0
                )
        first = place % len(layout[0]) == 0
        axes[place].set_yticks(range(len(names)), names if first else [""] * len(names))
    return figure


def draw_rows(axes: Axes, panel: Rows, count: int) -> None:
    """Draw one panel's intervals; a full marker says that the interval leaves out 0.

    Args:
        axes: empty axes.
        panel: the intervals.
        count: of rows.
    """
    quiet(axes, "x")
    linear = {"linthresh": panel.linear} if panel.scale == "symlog" else {}
    axes.set_xscale(panel.scale, **linear)
    head(axes, panel.title)
    axes.set(xlabel=panel.x_label, ylim=(count - 0.5, -0.5))
    axes.tick_params(axis="y", length=0)
    if panel.scale == "symlog":
        axes.axvline(0, color=LOOK.quiet, linewidth=1.0, zorder=1)
    for number, (style, estimates) in enumerate(panel.series.values()):
        shift = 0.5 * ((number + 0.5) / len(panel.series) - 0.5)
        for row, estimate in enumerate(estimates):
            if estimate is None or (panel.scale == "log" and estimate.high <= 0):
                continue
            reach = [[estimate.value - estimate.low], [estimate.high - estimate.value]]
            face = style.colour if estimate.real else "white"
            axes.errorbar(
                [estimate.value],
                [row + shift],
                xerr=reach,
                markerfacecolor=face,
                markersize=5,
                color=style.colour,
                marker=style.marker,
                capsize=2,
            )
    if panel.stars:
        axes.plot(list(panel.stars.values()), list(panel.stars), **star("white"))
