"""Bit error rate against ambient light of a panel that dims, and of panels that cannot."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from vocc_torch.measure.dimming import Grid
from vocc_torch.measure.undimmed import HEADLIGHT_CD_M2, Estimate, Loss, Undimmed, undimmed_loss
from vocc_torch.show.canvas import FINE_GRID, GRID, INK, QUIET, new_figure, quiet_axes, write_title
from vocc_torch.show.octaves import cell_edges, frames_text, grid_value, name_octaves, octave
from vocc_torch.show.styles import Style, axis_label, receiver_styles

_PANEL_IN, _SINGLE_IN = (4.35, 3.1), (8.95, 4.2)
_MOST_COLUMNS = 2
_FIXED, _HEADLIGHT = "#4A4E54", "#9AA0A6"
_SHIFT = 0.07
"""Octaves between the panels under one ambient light."""


def undimmed_figure(
    grid: Grid,
    title: str = "What a panel loses that cannot dim",
    receivers: Sequence[str] | None = None,
    headlight_cd_m2: float = HEADLIGHT_CD_M2,
) -> Figure:
    """Draw each receiver's rates with the best luminance for each ambient light, and with one for all.

    Args:
        grid: ambient light by LED luminance.
        title: what the figure shows.
        receivers: those to draw, in order; all of the grid's by default.
        headlight_cd_m2: luminance of a headlight, cd/m2, above 0; the nearest of the grid is drawn.

    Raises:
        VoccError: an unknown receiver, or a luminance that is not above 0.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curves import Curves
        >>> counts = {("flda_3", 500): Counts(64, 4096, 4, 8, 2), ("flda_3", 2000): Counts(64, 4096)}
        >>> axis, stopped = "led_luminance_cd_m2", {500: "frames", 2000: "frames"}
        >>> curves = Curves("dimming", axis, "truth", ("flda_3",), (500, 2000), counts, {}, stopped)
        >>> grid = Grid("ambient_lx", (4000.0,), (curves,))
        >>> undimmed_figure(grid).axes[0].get_title("left")
        'FLDA: AGR + GRI + NGR'
    """
    names = tuple(receivers or grid.receivers)
    losses = [undimmed_loss(grid, name, headlight_cd_m2) for name in names]
    columns = min(_MOST_COLUMNS, len(names))
    lines = math.ceil(len(names) / columns)
    panel = _PANEL_IN if columns > 1 else _SINGLE_IN
    width, height = 0.95 + (panel[0] + 0.25) * columns, 2.1 + (panel[1] + 0.85) * lines
    figure = new_figure(width, height)
    limits = _limits(losses)
    for number, (loss, style) in enumerate(zip(losses, receiver_styles(names).values(), strict=True)):
        line, column = divmod(number, columns)
        left = 0.85 + (panel[0] + 0.25) * column
        bottom = height - 1.5 - panel[1] - (panel[1] + 0.85) * line
        box = (left / width, bottom / height, panel[0] / width, panel[1] / height)
        axes = figure.add_axes(box)
        _axes(axes, grid, limits)
        _panel(axes, loss, style)
        lowest = number + columns >= len(names)
        axes.tick_params(which="both", labelbottom=lowest, labelleft=column == 0)
        axes.set_xlabel(axis_label(grid.row_axis) if lowest else "")
        axes.set_ylabel("Bit error rate" if column == 0 else "")
    _legend(figure, headlight_cd_m2)
    footnote = (
        f"{frames_text(grid)}\n"
        "Times: mean bit error rate over the dimmed panel's, every octave of ambient light alike, with its "
        "95 % interval. Arrows: no errors, limit.\n"
        "The dimmed rate is the least of the grid's, which tends to look too low: its bars and the intervals "
        "allow for it."
    )
    write_title(figure, title, footnote)
    return figure


def _limits(losses: Sequence[Loss]) -> tuple[float, float]:
    """Give the rates' range on the page; a lower end far below every rate may run out of the picture."""
    cells = [cell for loss in losses for line in _lines(loss) for cell in line]
    lowest = min(cell.value or cell.high for cell in cells)
    feet = [max(cell.low, lowest / 4) / 1.3 if cell.value else cell.high / 5 for cell in cells]
    low, high = min(feet), min(1.0, 1.6 * max(cell.high for cell in cells))
    return low, max(high, 20 * low)


def _lines(loss: Loss) -> tuple[tuple[Estimate, ...], ...]:
    """Give the headlight's, the fixed and the dimmed panel's rates; the first only where they differ."""
    dimmed = tuple(Estimate(best.ber, best.ber_low, best.ber_high) for best in loss.dimmed)
    return () if _same(loss) else loss.headlight.ber, loss.fixed.ber, dimmed


def _same(loss: Loss) -> bool:
    """Say whether the headlight has the best fixed luminance."""
    return loss.headlight.luminance_cd_m2 == loss.fixed.luminance_cd_m2


def _axes(axes: Axes, grid: Grid, limits: tuple[float, float]) -> None:
    """Prepare a panel: octaves along, the rate's decades up."""
    edges = cell_edges(grid.rows)
    axes.set_xlim(edges[0], edges[-1])
    axes.set_yscale("log")
    axes.set_ylim(*limits)
    axes.yaxis.set_major_locator(LogLocator(10, numticks=20))
    axes.yaxis.set_minor_locator(LogLocator(10, subs=tuple(range(2, 10)), numticks=200))
    axes.yaxis.set_minor_formatter(NullFormatter())
    name_octaves(axes.xaxis, grid.rows)
    quiet_axes(axes)
    axes.grid(axis="y", which="major", color=GRID, linewidth=1.0)
    axes.grid(axis="y", which="minor", color=FINE_GRID, linewidth=0.6)


def _panel(axes: Axes, loss: Loss, style: Style) -> None:
    """Draw one receiver's three lines, and above them what is lost."""
    x = [octave(best.ambient_lx) for best in loss.dimmed]
    for number, (cells, look) in enumerate(zip(_lines(loss), _looks(style), strict=True)):
        if cells:
            _draw(axes, [place + _SHIFT * (number - 1) for place in x], cells, look)
    axes.set_title(style.label, fontsize=11.5, fontweight="bold", color=INK, loc="left", pad=36)
    if _same(loss):
        text = f"best fixed and headlight, {_at(loss.fixed)}:\n{loss_text(loss.fixed)}"
    else:
        parts = (("best fixed", loss.fixed), ("headlight", loss.headlight))
        text = "\n".join(f"{name}, {_at(panel)}: {loss_text(panel)}" for name, panel in parts)
    axes.annotate(
        text, (0, 1), (0, 6), "axes fraction", "offset points", fontsize=9.5, color=QUIET, linespacing=1.35
    )


def _at(panel: Undimmed) -> str:
    return f"{grid_value(panel.luminance_cd_m2)} cd/m²"


def loss_text(panel: Undimmed) -> str:
    """Write how many times the dimmed panel's mean bit error rate another panel has.

    Args:
        panel: the other panel.

    Example:
        >>> rate = Estimate(1e-3, 8e-4, 1.2e-3)
        >>> loss_text(Undimmed(4e3, (rate,), rate, Estimate(2.71, 1.8, 3.6)))
        '2.7 times (1.80 to 3.6)'
        >>> loss_text(Undimmed(4e3, (rate,), rate, Estimate(math.inf, 4.2, math.inf)))
        'at least 4.2 times; dimmed, no errors were seen'
    """
    ratio = panel.ratio
    if panel.mean.value == 0:
        return "no errors were seen, nor dimmed"
    if math.isinf(ratio.value):
        least = f"at least {_factor(ratio.low)} times" if ratio.low > 1 else "not known"
        return f"{least}; dimmed, no errors were seen"
    high = "no upper limit" if math.isinf(ratio.high) else _factor(ratio.high)
    return f"{_factor(ratio.value)} times ({_factor(ratio.low)} to {high})"


def _factor(value: float) -> str:
    """Write a factor of at least 1 in two or three digits."""
    return f"{value:.{2 if value < 1.995 else 1 if value < 9.95 else 0}f}"


def _looks(style: Style) -> tuple[Style, Style, Style]:
    """Give the signs of the headlight, of the fixed panel, and of the dimmed one in the receiver's colour."""
    return (
        Style("", _HEADLIGHT, "D", ":"),
        Style("", _FIXED, "s" if style.marker != "s" else "p", "--"),
        Style(style.label, style.colour, style.marker, "-"),
    )


def _draw(axes: Axes, x: Sequence[float], cells: Sequence[Estimate], look: Style) -> None:
    """Draw one panel's rates with bars, and limits as hollow markers with an arrow down."""
    rate = [cell.value or math.nan for cell in cells]
    ends = [[cell.value - cell.low for cell in cells], [cell.high - cell.value for cell in cells]]
    axes.errorbar(x, rate, ends, color=look.colour, linestyle="none", elinewidth=1.3, capsize=2.4)
    axes.add_line(_line(look, x, rate))
    for at, cell in zip(x, cells, strict=True):
        if not cell.value:
            # The arrow runs from its text, below, to the limit: its head is at the start.
            arrow = {"arrowstyle": "<|-", "color": look.colour, "linewidth": 1.3, "shrinkA": 0, "shrinkB": 3}
            axes.annotate("", (at, cell.high), (0, -22), "data", "offset points", arrowprops=arrow)
            axes.add_line(_line(look, [at], [cell.high], hollow=True))


def _line(look: Style, x: Sequence[float], y: Sequence[float], *, hollow: bool = False) -> Line2D:
    """Make a line with its markers."""
    return Line2D(
        x,
        y,
        color=look.colour,
        linestyle=look.line,
        linewidth=1.7,
        marker=look.marker,
        markersize=7.5,
        markerfacecolor="white" if hollow else look.colour,
        markeredgecolor=look.colour if hollow else "white",
        markeredgewidth=1.3 if hollow else 0.7,
        zorder=3,
    )


def _legend(figure: Figure, headlight_cd_m2: float) -> None:
    """Explain the three lines under the title."""
    names = (
        f"headlight: nearest to {grid_value(headlight_cd_m2)} cd/m²",
        "best fixed: least mean rate",
        "dimmed: best for each ambient light",
    )
    looks = _looks(Style("", INK, "o", "-"))
    signs = [_line(look, [], []) for look in looks]
    figure.legend(
        signs[::-1],
        names[::-1],
        loc="upper left",
        bbox_to_anchor=(0.012, 1 - 0.4 / figure.get_figheight()),
        ncols=len(names),
        frameon=False,
        fontsize=10,
        labelcolor=INK,
        handlelength=2.6,
        columnspacing=1.8,
    )
