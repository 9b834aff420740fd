"""The picture of ``growth.py``: four panels, time above and memory below, with a line in proportion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter
from numpy.typing import NDArray

from vocc_torch.report import canvas
from vocc_torch.report.canvas import FINE_GRID, INK

BLUE, VERMILION, PURPLE = (
    "#0072B2",
    "#D55E00",
    "#7B5EA7",
)  # of Okabe and Ito's palette, as reporting/styles.py
PROPORTION = "#B8BDC4"
LINES = (("simulate", "simulate", BLUE, "o"), ("receive", "locate and decode", VERMILION, "s"))


@dataclass(frozen=True, slots=True)
class Panel:
    """How an axis is drawn: its column, names, unit of time, and the power that is in proportion."""

    axis: str
    title: str
    column: str
    label: str
    grows_with: str
    unit: str
    scale: float = 1.0
    power: float = 1.0


PANELS = (
    Panel("batch", "Batch", "value", "Frames in a batch", "frames", "ms a batch"),
    Panel("leds", "Panel, 4 x 4 to 32 x 32", "leds", "LEDs on the panel", "LEDs", "ms a frame"),
    Panel("distance_m", "Distance", "value", "Distance (m)", "pixels", "ms a frame", power=-2.0),
    Panel("frames", "Length of a run", "value", "Frames of a run", "frames", "s a run", scale=1e-3),
)


class Row(Protocol):
    """What is drawn of a reading."""

    @property
    def axis(self) -> str: ...  # noqa: D102  # as in growth.Reading
    @property
    def memory_mb(self) -> float: ...  # noqa: D102


def draw(rows: Sequence[Row], fits: Mapping[str, Mapping[str, float]], note: str, path: Path) -> None:
    """Draw all axes of one device.

    Args:
        rows: the readings.
        fits: the fitted powers, by axis and by ``simulate``, ``receive``, ``memory``.
        note: what it rests on.
        path: the image file.
    """
    figure = canvas.new_figure(15.5, 6.8)
    grid = figure.add_gridspec(
        2,
        4,
        height_ratios=(2.5, 1),
        left=0.052,
        right=0.988,
        top=0.77,
        bottom=0.215,
        hspace=0.13,
        wspace=0.27,
    )
    for index, panel in enumerate(PANELS):
        own = [row for row in rows if row.axis == panel.axis]
        x = np.array([getattr(row, panel.column) for row in own], dtype=float)
        _draw_time(figure.add_subplot(grid[0, index]), x, own, fits[panel.axis], panel)
        _draw_memory(figure.add_subplot(grid[1, index]), x, own, fits[panel.axis], panel)
    canvas.write_title(figure, "What the whole link costs as the work grows", note)
    canvas.save_figure(figure, path)


def _draw_time(
    axes: Axes, x: NDArray[np.float64], rows: Sequence[Row], fits: Mapping[str, float], panel: Panel
) -> None:
    """Draw the times of an axis, each with its fitted power, and a line in proportion."""
    times = {name: np.array([getattr(row, f"{name}_ms") for row in rows]) * panel.scale for name, *_ in LINES}
    last = 0 if panel.power < 0 else -1
    total = times["simulate"] + times["receive"]
    proportion = total[last] * (x / x[last]) ** panel.power
    axes.plot(x, proportion, color=PROPORTION, linewidth=6, alpha=0.5, zorder=1, solid_capstyle="round")
    for place, (name, label, colour, marker) in enumerate(LINES):
        axes.plot(x, times[name], color=colour, marker=marker, markersize=5.5, linewidth=1.8, zorder=3)
        text = f"{label}: {panel.grows_with}$^{{{fits[name]:.2f}}}$"
        axes.text(
            0, 1.12 - 0.085 * place, text, transform=axes.transAxes, color=colour, va="center", fontsize=11
        )
    axes.text(0, 1.225, panel.title, transform=axes.transAxes, color=INK, fontsize=12.5, fontweight="bold")
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_ylabel(panel.unit)
    _finish(axes, x, panel)
    axes.tick_params(labelbottom=False)


def _draw_memory(
    axes: Axes, x: NDArray[np.float64], rows: Sequence[Row], fits: Mapping[str, float], panel: Panel
) -> None:
    """Draw the memory of an axis."""
    y = np.array([row.memory_mb for row in rows])
    axes.plot(x, y, color=PURPLE, marker="D", markersize=4.5, linewidth=1.6)
    axes.fill_between(x, 0, y, color=PURPLE, alpha=0.1, linewidth=0)
    axes.set_ylim(0, 1.45 * y.max())
    axes.set_ylabel("memory, MB")
    axes.set_xlabel(panel.label)
    _finish(axes, x, panel)
    if "memory" in fits:
        text = f"memory: frames$^{{{fits['memory']:.2f}}}$"
        axes.text(0.02, 0.95, text, transform=axes.transAxes, va="top", color=PURPLE, fontsize=11)


def _finish(axes: Axes, x: NDArray[np.float64], panel: Panel) -> None:
    """Set what both axes of a column share: a logarithmic scale with a tick at each value, a fine grid."""
    thousands = panel.axis == "frames"
    axes.set_xscale("log")
    axes.set_xticks(x, [f"{value / 1e3:.0f}k" if thousands else f"{value:.0f}" for value in x])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.minorticks_off()
    axes.grid(True, color=FINE_GRID)
    canvas.quiet_axes(axes)
    axes.tick_params(labelsize=9.5)
    for label in (axes.xaxis.label, axes.yaxis.label):
        label.set_fontsize(11)
