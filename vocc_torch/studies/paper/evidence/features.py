"""Figs 8, 10 and 12: how grey values and features tell On LEDs from Off LEDs, alone and together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.optimize import linprog
from scipy.stats import mannwhitneyu

from vocc_torch.errors import VoccError
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.flda import FLDA
from vocc_torch.show.canvas import INK, QUIET, head
from vocc_torch.studies.paper.evidence import base, drawing
from vocc_torch.studies.paper.evidence.base import Bools, Floats

GALLERY = 20
"""Frames of the sample that Fig. 8a shows."""

LABELS = {
    "average_grey": "Average grey of an LED (0 to 255)",
    "agr": "AGR (ratio)",
    "gri": "GRI (grey values a pixel)",
    "ngr": "NGR (ratio)",
    "agr+gri+ngr": "FLDA score of AGR, GRI and NGR",
}


@dataclass(frozen=True)
class FeatureSpread(base.PaperFigure):
    """Numbers of each LED of the sample by its status.

    Args:
        sample: the sample.
        values: (B,R,C) each, by name; a name with ``+`` is the FLDA score of those features.
        lines: for a pair of features, FLDA fitted on these LEDs: (w_1, w_2, threshold).
    """

    alone: ClassVar[tuple[str, ...]]
    together: ClassVar[tuple[str, ...]] = ()

    sample: base.Sample
    values: Mapping[str, Floats]
    lines: Mapping[str, tuple[float, float, float]]

    @classmethod
    def compute(cls, source: base.Source) -> Self:
        """Score features of the sample alone, and by FLDA together."""
        sample, lines = source.sample, {}
        values = {one: sample.greys if one == "average_grey" else sample.feature(one) for one in cls.alone}
        features, bits = torch.from_numpy(sample.features), torch.from_numpy(sample.bits)
        for name in cls.together:
            chosen = [FEATURE_NAMES.index(part) for part in name.split("+")]
            flda = FLDA(len(FEATURE_NAMES)).fit(features, bits).select(chosen)
            values[name] = flda.decision_function(features[..., chosen]).numpy()
            if len(chosen) == 2:
                first, second = flda.direction.tolist()
                lines[name] = (first, second, float(flda.threshold))
        return cls(sample, values, lines)

    def rows(self) -> base.Rows:
        """A line an LED."""
        return base.led_rows(self.sample.bits, self.values)

    def findings(self) -> dict[str, float]:
        """How well each number tells On from Off, and how often GRI is negative.

        ``auc_`` is the area under the ROC curve, ``wrong_share_`` the share of wrong decisions at the best
        fixed threshold. ``separable_`` is 1 where some straight line or plane, FLDA's or another, parts all
        On LEDs from all Off LEDs.
        """
        bits = self.sample.bits
        found = {f"auc_{name}": roc_area(value, bits) for name, value in self.values.items()}
        found |= {f"wrong_share_{name}": least_error(value, bits)[0] for name, value in self.values.items()}
        for name in self.together:
            together = np.stack([self.values[part].ravel() for part in name.split("+")], axis=1)
            found[f"separable_{name}"] = float(separable(together, bits.ravel()))
        if "gri" in self.values:
            found["gri_negative_share_off"] = float(np.mean(self.values["gri"][~bits] < 0))
            found["gri_negative_share_on"] = float(np.mean(self.values["gri"][bits] < 0))
        return found

    def footnote(self, figure: Figure, said: str = "") -> str:
        """Name the statuses, and say what the numbers mean and rest on."""
        drawing.status_legend(figure)
        return (
            "AUC: area under the ROC curve, the chance that an On LED reads higher than an Off LED. "
            "Best threshold: the one fixed\nthreshold with the fewest wrong LEDs. "
            f"{len(self.sample.bits)} sample frames, {self.sample.bits.size} LEDs, true corners.{said}"
        )

    def draw_alone(self, axes: Axes, letter: str, name: str) -> None:
        """Draw one feature's distribution."""
        drawing.status_histogram(axes, self.values[name], self.sample.bits, LABELS[name])
        self._state(axes, letter, name)

    def draw_pair(self, axes: Axes, letter: str, name: str) -> None:
        """Draw two features, or the score of three and NGR, and FLDA's decision between On and Off."""
        first, second = name.split("+") if name in self.lines else (name, "ngr")
        labels = LABELS[first], LABELS[second]
        drawing.status_cloud(axes, self.values[first], self.values[second], self.sample.bits, labels)
        x, y = np.array(axes.get_xlim()), axes.get_ylim()
        along, across, threshold = self.lines.get(name, (0.0, 0.0, 0.0))
        if across:
            axes.plot(x, (threshold - along * x) / across, **drawing.DASHED)
        elif name not in self.lines:
            axes.axvline(0, **drawing.DASHED)  # where the score changes its sign
        axes.set(xlim=x, ylim=y)
        self._state(axes, letter, name)

    def _state(self, axes: Axes, letter: str, name: str) -> None:
        """Say above the axes how well a number tells On from Off."""
        area = roc_area(self.values[name], self.sample.bits)
        wrong = drawing.percent_text(least_error(self.values[name], self.sample.bits)[0])
        head(axes, f"({letter})", f"AUC {area_text(area)} \N{MIDDLE DOT} best threshold wrong: {wrong}")


class GreyAndAgr(FeatureSpread):
    """Fig. 8: some of the frames, and the distributions of average grey and of AGR."""

    name = "fig08"
    title = "Fig. 8: average grey against average greyscale ratio (AGR)"
    caption = "Twenty of 100 sample frames; average greys of On and Off overlap over all, AGR parts them."
    height_in = 6.9
    alone = ("average_grey", "agr")

    def draw_on(self, figure: Figure) -> str:
        """Draw panels in two rows, and two histograms."""
        for index, picture in enumerate(self.sample.pictures[:GALLERY]):
            row, column = divmod(index, GALLERY // 2)
            drawing.add_panel(figure, (0.02 + 0.097 * column, 0.745 - row * 0.142), 0.09, picture)
        text = f"(a) {GALLERY} of the frames"
        figure.text(0.02, 0.895, text, fontsize=11.5, color=INK, fontweight="bold")
        self.draw_alone(figure.add_axes((0.075, 0.175, 0.41, 0.355)), "b", "average_grey")
        self.draw_alone(figure.add_axes((0.575, 0.175, 0.41, 0.355)), "c", "agr")
        return self.footnote(figure)


class GriAndAgr(FeatureSpread):
    """Fig. 10: the distribution of GRI, and GRI against AGR."""

    name = "fig10"
    title = "Fig. 10: gradient radial inwardness (GRI), alone and with AGR"
    caption = "GRI alone parts most LEDs; AGR and GRI together part all of them."
    height_in = 5.6
    alone, together = ("agr", "gri"), ("agr+gri",)

    def draw_on(self, figure: Figure) -> str:
        """Draw a histogram and a cloud."""
        axes = figure.add_axes((0.075, 0.2, 0.41, 0.635))
        self.draw_alone(axes, "a", "gri")
        axes.axvline(0, color=QUIET, linewidth=1.0)
        text = drawing.negative_text(self.values["gri"], self.sample.bits)
        drawing.note(axes, text, (0.98, 0.95), xycoords="axes fraction", ha="right", va="top")
        self.draw_pair(figure.add_axes((0.575, 0.2, 0.41, 0.635)), "b", "agr+gri")
        return self.footnote(figure, " Line: FLDA fitted on these LEDs.")


class NgrAndOthers(FeatureSpread):
    """Fig. 12: the distribution of NGR, NGR against each of the others, and all three."""

    name = "fig12"
    title = "Fig. 12: neighbour greyscale ratio (NGR) and the others"
    caption = "NGR alone overlaps completely, but helps AGR and helps GRI; the three together part best."
    height_in = 9.2
    alone, together = FEATURE_NAMES, ("agr+gri", "agr+ngr", "gri+ngr", "agr+gri+ngr")

    def draw_on(self, figure: Figure) -> str:
        """Draw a histogram and three clouds."""
        axes = [figure.add_axes((x, y, 0.41, 0.325)) for y in (0.57, 0.14) for x in (0.075, 0.575)]
        self.draw_alone(axes[0], "a", "ngr")
        self.draw_pair(axes[1], "b", "agr+ngr")
        self.draw_pair(axes[2], "c", "gri+ngr")
        self.draw_pair(axes[3], "d", "agr+gri+ngr")
        said = (
            " Lines: FLDA fitted on these LEDs.\n(d) is a projection of the three features on the "
            "plane of w, on which the score (a log-likelihood ratio) lies, and NGR."
        )
        return self.footnote(figure, said)


def area_text(auc: float) -> str:
    """Write an area in three digits, near 1 in up to five; 1 only where it is.

    Example:
        >>> area_text(0.53577), area_text(0.99956), area_text(0.9999999), area_text(1.0)
        ('= 0.536', '= 0.9996', '> 0.99999', '= 1')
    """
    if auc == 1:
        return "= 1"
    for digits in (3, 4, 5):
        if float(text := f"{auc:.{digits}f}") <= 1 - 3 * 10**-digits:
            return f"= {text}"
    return f"= {text}" if float(text) < 1 else "> 0.99999"


def roc_area(values: Floats, bits: Bools) -> float:
    """Area under the ROC curve: the chance that an On LED reads higher than an Off LED, ties counted half.

    It is the Mann-Whitney statistic over the number of pairs (Hanley and McNeil 1982).

    Args:
        values: of any shape, finite.
        bits: of the same shape, with both On and Off.

    Returns:
        0 to 1; 0.5 tells nothing.

    Raises:
        VoccError: all On or all Off.

    Example:
        >>> roc_area(np.array([1.0, 2.0, 2.0, 3.0]), np.array([False, False, True, True]))
        0.875
    """
    on, off = _counts(bits)
    return float(mannwhitneyu(values[bits], values[~bits], method="asymptotic").statistic) / (on * off)


def least_error(values: Floats, bits: Bools) -> tuple[float, float]:
    """Smallest share of wrong decisions of any fixed threshold (On where the value is at least it).

    Args:
        values: of any shape, finite.
        bits: of the same shape, with both On and Off.

    Returns:
        The share, and the lowest such threshold: halfway between two neighbouring values, or, where one
        answer for all is best, the lowest value or just above the highest.

    Raises:
        VoccError: all On or all Off.

    Example:
        >>> least_error(np.array([1.0, 2.0, 4.0, 3.0]), np.array([False, False, True, True]))
        (0.0, 2.5)
    """
    _, off = _counts(bits)
    levels = np.unique(values)
    between = np.concatenate([levels[:1], (levels[1:] + levels[:-1]) / 2, np.nextafter(levels[-1:], np.inf)])
    # On LEDs below the threshold and Off LEDs from it on are wrong.
    below_on, below_off = (np.searchsorted(np.sort(values[side]), between) for side in (bits, ~bits))
    wrong = below_on + off - below_off
    best = int(wrong.argmin())
    return float(wrong[best]) / bits.size, float(between[best])


def separable(values: Floats, bits: Bools) -> bool:
    """Whether some straight line, plane or hyperplane has all On on one side and all Off on the other.

    The largest margin of any line with weights from -1 to 1 is a linear program; it is above 0 exactly where
    the convex hulls of On and Off are disjoint (Mangasarian, Operations Research 13, 1965). The line found is
    checked on every value.

    Args:
        values: (N,D), finite.
        bits: (N,), with both On and Off.

    Raises:
        VoccError: all On or all Off.

    Example:
        >>> square = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
        >>> separable(square, np.array([False, False, True, True]))
        True
        >>> separable(square, np.array([False, True, True, False]))
        False
    """
    _counts(bits)
    deviation, columns = values.std(axis=0), values.shape[1]
    scaled = (values - values.mean(axis=0)) / np.where(deviation > 0, deviation, 1.0)
    sides = np.where(bits, 1.0, -1.0)[:, None] * np.column_stack([scaled, np.ones(len(scaled))])
    # Unknown are the weights, the offset and the margin, which is made large.
    cost, ranges = np.append(np.zeros(columns + 1), -1.0), [(-1.0, 1.0)] * columns + [(None, None)] * 2
    constraints = np.column_stack([-sides, np.ones(len(sides))])
    found = linprog(cost, A_ub=constraints, b_ub=np.zeros(len(sides)), bounds=ranges)
    return bool(found.success and (sides @ found.x[:-1]).min() > 0)


def _counts(bits: Bools) -> tuple[int, int]:
    """Count On and Off, both of which are needed."""
    on, off = int(bits.sum()), int((~bits).sum())
    if not on or not off:
        raise VoccError(f"bits holds {on} On and {off} Off: a comparison needs both")
    return on, off
