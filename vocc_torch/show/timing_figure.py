"""Drawing of Fig. 25: the time of each bit detector over that of panel detection."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation
from numpy.typing import NDArray

from vocc_torch.show.canvas import GRID, INK, head, new_figure, quiet_axes, text_renderer, write_title
from vocc_torch.show.styles import receiver_styles

Floats = NDArray[np.float64]

PANEL_DETECTION = "panel_detection"
PAPER_SHARES = {
    PANEL_DETECTION: 1.0,
    "center_greyscale": 0.05,
    "average_greyscale": 0.07,
    "flda_2": 0.12,
    "flda_3": 0.14,
}
"""Section IV-D-5 and Fig. 25: time of each stage over that of panel detection."""

_PANEL = ("Panel detection", "#A9AFB6")
_BUSY = 0.05
"""From this share of waiting on, times are those of a machine that did other work too."""
_KINDS = {"whole_frames": "whole frames", "crops": "crops of the panel's surroundings"}


def timing_figure(
    title: str,
    *,
    frames: tuple[str, ...],
    batches: tuple[int, ...],
    stages: tuple[str, ...],
    times_ms: Floats,
    shares: Floats,
    ngr_costs: Floats,
    paper_shares: Floats,
    rounds: tuple[int, ...],
    sensor_px: tuple[int, int],
    machine: str,
    threads: int,
    waited_share: float,
) -> Figure:
    """Draw a bar a stage for each kind of frames and each batch size, with the paper's value beside it.

    Args:
        title: the figure's.
        frames: F kinds of frames.
        batches: N batch sizes, 1 or 2 of them.
        stages: S stages, panel detection first, then receivers.
        times_ms: (F,N,S,3) lower quartile, median and upper quartile, ms a frame.
        shares: (F,N,S,3) likewise, of the time over that of panel detection.
        ngr_costs: (F,N,2,3) likewise, of what a third feature adds to two, and to panel detection and two.
        paper_shares: (S,) the paper's, of panel detection.
        rounds: (N,) timed rounds.
        sensor_px: height and width of a whole frame.
        machine: what was measured on.
        threads: threads that torch used within an operation.
        waited_share: share of the time in which other work had the processor, 0 to 1.
    """
    figure = new_figure(10, 6.8)
    column = 0.79 / len(batches)
    longest, labels = 100 * max(1.0, float(shares.max())), []
    for place, (f, n) in enumerate(np.ndindex(len(frames), len(batches))):
        axes = figure.add_axes((0.205 + column * n, 0.588 - 0.368 * f, column - 0.025, 0.285))
        labels += _bars(axes, stages, times_ms[f, n, :, 1], shares[f, n], paper_shares)
        axes.set_xticks(np.arange(0, longest + 1, 20))
        axes.tick_params(axis="y", labelleft=n == 0)
        if f == len(frames) - 1:
            axes.set_xlabel("Time over that of panel detection (%)")
            axes.xaxis.label.set_fontsize(11)
        said = f"{_KINDS.get(frames[f], frames[f])}, {_at_a_time(batches[n])}"
        head(axes, f"({'abcd'[place]})", said)
    for axes in figure.axes:
        axes.set_xlim(0, _room(figure, axes, labels))
    _legend(figure)
    timed = " and ".join(
        f"{count} rounds {_at_a_time(batch)}" for count, batch in zip(rounds, batches, strict=True)
    )
    footnote = (
        f"{_third_feature(ngr_costs)}\n"
        f"Medians of {timed}; whole frames of {sensor_px[1]} x {sensor_px[0]} px. "
        f"Preambles are not counted. The paper: Matlab.\nOurs: {machine}."
    )
    if waited_share > _BUSY:
        busy = f"Take with care: for {100 * waited_share:.0f} % of the time other work had the processor."
        footnote = f"{busy}\n{footnote}"
    write_title(figure, title, footnote)
    return figure


def _third_feature(ngr_costs: Floats) -> str:
    """Tell in medians what NGR adds in each part of the figure."""
    of_two, of_all = (
        [f"{100 * cost:z.1f}".replace("-", "\N{MINUS SIGN}") for cost in ngr_costs[..., part, 1].flat]
        for part in (0, 1)
    )
    lettered = ", ".join(f"({letter}) {cost}" for letter, cost in zip("abcd", of_two, strict=False))
    return (
        f"NGR adds {lettered} % to two features' time (the paper: 17 %), "
        f"and to the whole {', '.join(of_all)} % (1.78 %)."
    )


def _at_a_time(batch: int) -> str:
    """Say a batch size."""
    return "one at a time" if batch == 1 else f"{batch} at a time"


def _bars(
    axes: Axes, stages: tuple[str, ...], times_ms: Floats, shares: Floats, paper_shares: Floats
) -> list[tuple[float, Annotation]]:
    """Draw one kind of frames at one batch size: S bars, the detectors' quartiles and the paper's marks.

    Returns:
        The bars' labels, each with the value that it begins behind.
    """
    styles = receiver_styles(stages[1:])
    looks = [_PANEL, *((styles[name].label, styles[name].colour) for name in stages[1:])]
    low, median, high = 100 * shares.T
    rows = np.arange(float(len(stages)))
    axes.barh(rows, median, height=0.62, color=[colour for _, colour in looks])
    spread = np.stack([median - low, high - median])[:, 1:]
    axes.errorbar(median[1:], rows[1:], xerr=spread, fmt="none", ecolor=INK, elinewidth=1.2, capsize=2.5)
    axes.add_line(_paper_mark(100 * paper_shares[1:], rows[1:]))
    labels = []
    for row, (spent, share) in enumerate(zip(times_ms, median, strict=True)):
        end = max(high[row], 100 * paper_shares[row])
        said = f"{number_text(share)} %  ({number_text(spent)} ms)" if row else f"{number_text(spent)} ms"
        label = axes.annotate(
            said, (end, row), (9, 0), textcoords="offset points", va="center", color=INK, fontsize=10
        )
        labels.append((float(end), label))
    quiet_axes(axes)
    axes.grid(axis="x", color=GRID, linewidth=0.8)
    axes.set_yticks(rows, [label for label, _ in looks])
    axes.tick_params(axis="y", length=0)
    axes.invert_yaxis()
    return labels


def _room(figure: Figure, axes: Axes, labels: Sequence[tuple[float, Annotation]]) -> float:
    """Give the upper end of an axis from 0 on which every label ends within it."""
    renderer = text_renderer(figure)
    width = axes.get_window_extent(renderer).width
    gap = 14 * figure.dpi / 72
    # Measured away from its place, a label has the same width.
    texts = [(end, label.get_window_extent(renderer).width + gap) for end, label in labels]
    return max(end * width / max(width - text, 0.2 * width) for end, text in texts)


def number_text(value: float) -> str:
    """Write a positive number in three digits, never as a power of ten.

    Example:
        >>> [number_text(value) for value in (1042.6, 32.53, 9.999, 0.5942, 0.01337)]
        ['1043', '32.5', '10.0', '0.594', '0.0134']
    """
    rounded = float(f"{value:.3g}")
    digits = max(0, 2 - int(np.floor(np.log10(max(rounded, 1e-9)))))
    return f"{value:.{digits}f}"


def _paper_mark(x: Floats, y: Floats) -> Line2D:
    """Make the marks of the paper's values."""
    marks = Line2D(x, y, linestyle="none", marker="D", markersize=7.5, zorder=5, label="the paper")
    marks.set(markerfacecolor="white", markeredgecolor=INK)
    return marks


def _legend(figure: Figure) -> None:
    """Explain the marks at the figure's top right."""
    handles = [
        _paper_mark(np.empty(0), np.empty(0)),
        Line2D([], [], color=INK, marker="|", markersize=7, linewidth=1.2, label="quartiles"),
    ]
    figure.legend(
        handles=handles,
        loc="upper right",
        bbox_to_anchor=(0.99, 1 - 0.06 / figure.get_figheight()),
        ncols=2,
        frameon=False,
        fontsize=10.5,
        handletextpad=0.4,
        columnspacing=1.4,
    )
