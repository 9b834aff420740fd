"""The picture of ``growth.py``: four panels, time above and memory below, with a line in proportion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter

from vocc_torch.reporting import canvas
from vocc_torch.reporting.canvas import FINE_GRID, INK, QUIET

BLUE, VERMILION, PURPLE = "#0072B2", "#D55E00", "#7B5EA7"  # of Okabe and Ito's palette, as reporting/styles.py
LINES = (("simulate_ms", "simulate", "simulate", BLUE, "o"), ("receive_ms", "receive", "locate and decode", VERMILION, "s"))
PANELS = (
    ("batch", "value", "Frames in a batch", "ms a batch", 1.0),
    ("leds", "leds", "LEDs on the panel", "ms a frame", 1.0),
    ("distance_m", "value", "Distance (m)", "ms a frame", -2.0),
    ("frames", "value", "Frames of a run", "s a run", 1.0),
)
"""Axis, column, label, unit of time, and the power that is in proportion to frames, LEDs or pixels."""


class Row(Protocol):
    """What is drawn of a reading."""

    axis: str
    value: float
    leds: int
    simulate_ms: float
    receive_ms: float
    memory_mb: float


def draw(rows: Sequence[Row], fits: Mapping[str, Mapping[str, float]], machine: str, path: Path) -> None:
    """Draw all axes of one device.

    Args:
        rows: the readings.
        fits: the fitted powers, by axis and by ``simulate``, ``receive``, ``memory``.
        machine: what it ran on.
        path: the image file.
    """
    figure = canvas.new_figure(15.5, 6.6)
    grid = figure.add_gridspec(
        2, 4, height_ratios=(2.5, 1), left=0.052, right=0.99, top=0.83, bottom=0.2, hspace=0.13, wspace=0.27
    )
    for index, panel in enumerate(PANELS):
        time, memory = figure.add_subplot(grid[0, index]), figure.add_subplot(grid[1, index])
        own = [row for row in rows if row.axis == panel[0]]
        _draw_time(time, own, fits[panel[0]], panel)
        _draw_memory(memory, own, panel, fits[panel[0]].get("memory"))
    footnote = (
        "Crops of the paper's scene, located with the paper's locator, decoded by FLDA on three features; batches "
        "of 256 but on the left; panels at 50 m in the second column. One thread.\nMedians over processes of their "
        "own; memory: the most that was resident beyond what it was before the first frame. The grey lines are in "
        f"proportion to frames, LEDs or pixels.\n{machine}"
    )
    canvas.write_title(figure, "What the whole link costs as the work grows", footnote)
    canvas.save_figure(figure, path)


def _draw_time(axes: Axes, rows: Sequence[Row], fits: Mapping[str, float], panel: tuple[str, str, str, str, float]) -> None:
    """Draw the times of an axis, each with its fitted power, and a line in proportion."""
    name, column, _, unit, power = panel
    scale = 1e-3 if name == "frames" else 1.0
    x = np.array([getattr(row, column) for row in rows], dtype=float)
    total = np.array([row.simulate_ms + row.receive_ms for row in rows]) * scale
    anchor = 0 if power < 0 else -1
    axes.plot(x, total[anchor] * (x / x[anchor]) ** power, color="#B8BDC4", linewidth=5, alpha=0.55, zorder=1)
    for field, fitted, label, colour, marker in LINES:
        y = np.array([getattr(row, field) for row in rows]) * scale
        axes.plot(x, y, color=colour, marker=marker, markersize=5.5, linewidth=1.8, label=label, zorder=3)
        sign = f"{fits[fitted]:.2f}".replace("-", "\N{MINUS SIGN}")
        place = 0.1 if fitted == "receive" else 0.02
        what = "pixels" if name == "distance_m" else {"leds": "LEDs"}.get(name, "frames")
        axes.text(
            *(0.98, place + 0.02), f"{label}: {what}$^{{{sign}}}$", transform=axes.transAxes, color=colour,
            ha="right", va="bottom", fontsize=10.5,
        ) if power > 0 else axes.text(
            *(0.02, place + 0.02), f"{label}: {what}$^{{{sign}}}$", transform=axes.transAxes, color=colour,
            ha="left", va="bottom", fontsize=10.5,
        )  # fmt: skip
    axes.set_ylabel(unit)
    _log_axes(axes, x, both=True)
    axes.tick_params(labelbottom=False)


def _draw_memory(axes: Axes, rows: Sequence[Row], panel: tuple[str, str, str, str, float], power: float | None) -> None:
    """Draw the memory of an axis."""
    x = np.array([getattr(row, panel[1]) for row in rows], dtype=float)
    y = np.array([row.memory_mb for row in rows])
    axes.plot(x, y, color=PURPLE, marker="D", markersize=4.5, linewidth=1.6)
    axes.fill_between(x, 0, y, color=PURPLE, alpha=0.1, linewidth=0)
    axes.set_ylim(0, 1.35 * y.max())
    axes.set_ylabel("memory, MB")
    axes.set_xlabel(panel[2])
    _log_axes(axes, x, both=False)
    if power is not None:
        sign = f"{power:.2f}".replace("-", "\N{MINUS SIGN}")
        axes.text(0.98, 0.96, f"memory: frames$^{{{sign}}}$", transform=axes.transAxes, ha="right", va="top",
                  color=PURPLE, fontsize=10.5)  # fmt: skip


def _log_axes(axes: Axes, x: np.ndarray, *, both: bool) -> None:  # type: ignore[type-arg]  # of floats
    """Make axes logarithmic, with a tick at each value."""
    axes.set_xscale("log")
    if both:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xticks(x, [f"{v / 1e3:.0f}k" if v >= 1e3 and v not in (1024,) else f"{v:.0f}" for v in x])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.minorticks_off()
    axes.grid(True, color=FINE_GRID)
    canvas.quiet_axes(axes)
    axes.tick_params(labelsize=9.5)
    axes.xaxis.label.set_fontsize(11)
    axes.yaxis.label.set_fontsize(11)
    axes.yaxis.label.set_color(INK)
    axes.tick_params(color=QUIET)
