"""Drawing of Fig. 25: the time of each bit detector over that of panel detection."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from vocc_torch.measure import estimate, grid, stage_times
from vocc_torch.report import canvas, page, styles
from vocc_torch.report.canvas import INK, Axes, Figure, Line2D

Place = tuple[str, int]
"""Kind of frames and batch size."""

PANEL_DETECTION = "panel_detection"
PAPER_SHARES = {
    PANEL_DETECTION: 1.0,
    "center_greyscale": 0.05,
    "average_greyscale": 0.07,
}
PAPER_SHARES |= {"flda_2": 0.12, "flda_3": 0.14}
"""Section IV-D-5 and Fig. 25: time of each stage over that of panel detection."""

_KINDS = {"whole_frames": "whole frames", "crops": "crops of the panel's surroundings"}


@dataclass(frozen=True)
class DetectionTimes:
    """Times of the paper's receivers by stage, on F kinds of frames and one or two batch sizes each.

    Args:
        by_place: times by receiver for each kind of frames (``whole_frames``, ``crops``) and batch size.
        sensor_px: height and width of a whole frame.
        machine: what was measured on.
        threads: threads that torch used within an operation.
        waited_share: share of the time in which other work had the processor, 0 to 1; with more than one
            thread it is a lower limit.
    """

    by_place: Mapping[Place, Mapping[str, stage_times.StageTimes]]
    sensor_px: tuple[int, int]
    machine: str
    threads: int
    waited_share: float

    def rounds(self, place: Place) -> int:
        """How many rounds were timed."""
        return next(iter(self.by_place[place].values())).rounds

    def times_ms(self, place: Place) -> dict[str, estimate.Estimate]:
        """Give panel detection's and each bit detector's time, ms a frame."""
        return {
            stage: stage_times.median_of(spent)
            for stage, spent in self._spent_ms(place).items()
        }

    def shares(self, place: Place) -> dict[str, estimate.Estimate]:
        """Give the same over panel detection's time in the same round."""
        spent = self._spent_ms(place)
        return {
            stage: stage_times.median_of(one / spent[PANEL_DETECTION])
            for stage, one in spent.items()
        }

    def ngr_costs(self, place: Place) -> tuple[estimate.Estimate, estimate.Estimate]:
        """Give what a third feature adds to the time of two, and to that of panel detection and two."""
        spent = self._spent_ms(place)
        panel, two, three = (
            spent[stage] for stage in (PANEL_DETECTION, "flda_2", "flda_3")
        )
        return stage_times.median_of(three / two - 1), stage_times.median_of(
            (three - two) / (panel + two)
        )

    def _spent_ms(self, place: Place) -> dict[str, grid.Floats]:
        """Give the times round by round."""
        times = self.by_place[place]
        bits = {
            name: times[name].summed(stage_times.BIT_DETECTION)
            for name in PAPER_SHARES
            if name in times
        }
        return {PANEL_DETECTION: times["flda_3"].summed(["locate"]), **bits}

    def draw(self, title: str) -> Figure:
        """Draw the figure, with its title and what it rests on."""
        figure = canvas.new_figure(10, 6.8)
        canvas.write_title(figure, title, self.draw_on(figure))
        return figure

    def draw_on(self, figure: Figure) -> str:
        """Draw a bar a stage in each place, with the paper's value beside it; give the footnote."""
        kinds, batches = (
            list(dict.fromkeys(one)) for one in zip(*self.by_place, strict=True)
        )
        column, longest = 0.79 / len(batches), 0.0
        for letter, place in zip("abcd", self.by_place, strict=False):
            f, n = kinds.index(place[0]), batches.index(place[1])
            axes = figure.add_axes(
                (0.205 + column * n, 0.588 - 0.368 * f, column - 0.025, 0.285)
            )
            longest = max(longest, self.draw_bars(axes, place))
            axes.tick_params(axis="y", length=0, labelleft=n == 0)
            canvas.head(
                axes,
                f"({letter})",
                f"{_KINDS.get(place[0], place[0])}, {_at_a_time(place[1])}",
            )
            if f == len(kinds) - 1:
                axes.set_xlabel("Time over that of panel detection (%)", fontsize=11)
        for axes in figure.axes:
            # The longest label takes less than two fifths of the width.
            axes.set_xlim(0, 1.65 * longest)
            axes.xaxis.set_major_locator(MaxNLocator(7, steps=[2, 5, 10]))
        quartiles = Line2D(
            [],
            [],
            color=INK,
            marker="|",
            markersize=7,
            linewidth=1.2,
            label="quartiles",
        )
        look: dict[str, Any] = {
            "loc": "upper right",
            "fontsize": 10.5,
            "handlelength": 2.0,
        }
        at = (0.99, 1 - 0.06 / figure.get_figheight())
        canvas.write_legend(
            figure, [axes.lines[-1], quartiles], at, 2, columnspacing=1.4, **look
        )
        return page.render(
            __package__, "times.txt.j2", times=self, at_a_time=_at_a_time
        ).rstrip()

    def draw_bars(self, axes: Axes, place: Place) -> float:
        """Draw the bars, the detectors' quartiles and the paper's marks; give the last label's begin."""
        times, shares = self.times_ms(place), self.shares(place)
        looks = styles.receiver_styles(
            name for name in PAPER_SHARES if name != PANEL_DETECTION
        ).values()
        panel = ("Panel detection", "#A9AFB6")
        labels, colours = zip(
            panel, *((look.label, look.colour) for look in looks), strict=True
        )
        low, median, high = (
            100
            * np.array([(one.low, one.value, one.high) for one in shares.values()]).T
        )
        paper, rows = (
            100 * np.array(list(PAPER_SHARES.values())),
            np.arange(float(len(PAPER_SHARES))),
        )
        axes.barh(rows, median, height=0.62, color=colours)
        spread = np.stack([median - low, high - median])[:, 1:]
        axes.errorbar(
            median[1:],
            rows[1:],
            xerr=spread,
            fmt="none",
            ecolor=INK,
            elinewidth=1.2,
            capsize=2.5,
        )
        mark: dict[str, Any] = {
            "markersize": 7.5,
            "markeredgecolor": INK,
            "color": "white",
            "zorder": 5,
        }
        axes.plot(paper[1:], rows[1:], "D", label="the paper", **mark)
        ends = np.maximum(high, paper).tolist()
        for row, (spent, share, end) in enumerate(
            zip(times.values(), median, ends, strict=True)
        ):
            time = f"{number_text(spent.value)} ms"
            said = f"{number_text(share)} %  ({time})" if row else time
            axes.annotate(
                said, (end, row), (9, 0), textcoords="offset points", va="center"
            )
            axes.texts[-1].set(fontsize=10, color=INK)
        canvas.quiet_axes(axes, "x")
        axes.set_yticks(rows, labels)
        axes.invert_yaxis()
        return float(max(ends))


def _at_a_time(batch: int) -> str:
    """Say a batch size."""
    return "one at a time" if batch == 1 else f"{batch} at a time"


def number_text(value: float) -> str:
    """Write a positive number in three digits, never as a power of ten.

    Example:
        >>> [number_text(value) for value in (1042.6, 32.53, 9.999, 0.5942, 0.01337)]
        ['1043', '32.5', '10.0', '0.594', '0.0134']
    """
    rounded = float(f"{value:.3g}")
    digits = max(0, 2 - int(np.floor(np.log10(max(rounded, 1e-9)))))
    return f"{value:.{digits}f}"
