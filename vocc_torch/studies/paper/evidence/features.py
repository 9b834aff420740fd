"""Figs 8, 10, 12, 13 and 14: how grey values and features tell On LEDs from Off LEDs, alone and together."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch
from scipy.optimize import linprog
from scipy.stats import mannwhitneyu

from vocc_torch.errors import VoccError
from vocc_torch.measure.train import train
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.flda import FLDA
from vocc_torch.report import canvas
from vocc_torch.report.plots import status_histogram
from vocc_torch.studies.paper import evidence, words
from vocc_torch.studies.paper.evidence import Bools, Floats

SHOWN = 4000
"""LEDs in the cloud of Fig. 13; more hide each other."""


class FeatureSpread(evidence.PaperFigure):
    """Numbers of each LED of the sample by its status, a panel each: of one a histogram, of two a cloud.

    ``figures.yaml`` says which: features ``alone`` and, with a ``+`` between them, ``together``; ``panels``
    with their left, bottom, width and height, as shares of the figure; and a ``gallery`` of some frames.

    Attributes:
        sample: the sample.
        values: (B,R,C) each, by name; a name with ``+`` is the FLDA score of those features.
        lines: for a pair of features, FLDA fitted on these LEDs: (w_1, w_2, threshold).
    """

    def __init__(self, source: evidence.Source) -> None:
        """Score features of the sample alone, and by FLDA together.

        Of the findings ``auc_`` is the area under the ROC curve, ``wrong_share_`` the share of wrong
        decisions at the best fixed threshold. ``separable_`` is 1 where some straight line or plane, FLDA's
        or another, parts all On LEDs from all Off LEDs.
        """
        self.sample, about = source.sample, words.FIGURES[self.name]
        sample = self.sample
        self.lines: dict[str, tuple[float, float, float]] = {}
        bits, sent, features = sample.bits, torch.from_numpy(sample.bits), torch.from_numpy(sample.features)
        named = {"average_grey": sample.greys} | {name: sample.feature(name) for name in FEATURE_NAMES}
        self.values = values = {name: named[name] for name in about["alone"]}
        parted = {}
        for name in about.get("together", ()):
            chosen = [FEATURE_NAMES.index(part) for part in name.split("+")]
            flda = FLDA(len(FEATURE_NAMES)).fit(features, sent).select(chosen)
            values[name] = flda.decision_function(features[..., chosen].double()).numpy()
            if len(chosen) == 2:
                first, second = flda.direction.tolist()
                self.lines[name] = (first, second, float(flda.threshold))
            points = np.stack([values[part].ravel() for part in name.split("+")], axis=1)
            parted[f"separable_{name}"] = float(separable(points, bits.ravel()))
        self.rows = evidence.led_rows(bits, values)
        self.findings = {f"auc_{name}": roc_area(value, bits) for name, value in values.items()}
        self.findings |= {f"wrong_share_{name}": least_error(one, bits)[0] for name, one in values.items()}
        self.findings |= parted
        if "gri" in values:
            for status, side in (("off", ~bits), ("on", bits)):
                self.findings[f"gri_negative_share_{status}"] = float(np.mean(values["gri"][side] < 0))

    def draw_on(self, figure: canvas.Figure) -> Mapping[str, object]:
        """Draw some of the frames, and each panel with how well it tells On from Off."""
        about, letters = words.FIGURES[self.name], "abcd"
        if gallery := about.get("gallery", 0):
            for index, picture in enumerate(self.sample.pictures[:gallery]):
                row, column = divmod(index, gallery // 2)
                evidence.add_panel(figure, (0.02 + 0.097 * column, 0.745 - row * 0.142), 0.09, picture)
            text, letters = f"(a) {gallery} of the frames", letters[1:]
            figure.text(0.02, 0.895, text, fontsize=11.5, color=canvas.INK, fontweight="bold")
        for letter, (name, place) in zip(letters, about["panels"].items(), strict=False):
            axes = figure.add_axes(place)
            if "+" in name:
                self.draw_pair(axes, name)
            else:
                status_histogram(axes, self.values[name], self.sample.bits, words.LABELS[name])
            if name == "gri":
                axes.axvline(0, color=canvas.QUIET, linewidth=1.0)
                negative_share(axes, self.values[name], self.sample.bits, (0.98, 0.95))
            wrong = evidence.percent_text(self.findings[f"wrong_share_{name}"])
            area = area_text(self.findings[f"auc_{name}"])
            canvas.head(axes, f"({letter})", f"AUC {area} \N{MIDDLE DOT} best threshold wrong: {wrong}")
        evidence.status_legend(figure)
        counts = {"frames": len(self.sample.bits), "leds": self.sample.bits.size}
        return {**counts, "lines": about.get("lines", "")}

    def draw_pair(self, axes: canvas.Axes, name: str) -> None:
        """Draw two features, or the score of three and NGR, and FLDA's decision between On and Off."""
        first, second = name.split("+") if name in self.lines else (name, "ngr")
        x, y = self.values[first], self.values[second]
        status_cloud(axes, x, y, self.sample.bits, (words.LABELS[first], words.LABELS[second]))
        ends, limits = np.array(axes.get_xlim()), axes.get_ylim()
        along, across, threshold = self.lines.get(name, (0.0, 0.0, 0.0))
        if across:
            axes.plot(ends, (threshold - along * ends) / across, **evidence.DASHED)
        elif name not in self.lines:
            axes.axvline(0, **evidence.DASHED)  # where the score changes its sign
        axes.set(xlim=ends, ylim=limits)


class GreyAndAgr(FeatureSpread):
    """Fig. 8: some of the frames, and the distributions of average grey and of AGR."""

    name = "fig08"


class GriAndAgr(FeatureSpread):
    """Fig. 10: the distribution of GRI, and GRI against AGR."""

    name = "fig10"


class NgrAndOthers(FeatureSpread):
    """Fig. 12: the distribution of NGR, NGR against each of the others, and all three."""

    name = "fig12"


class Projection(evidence.PaperFigure):
    """Features of training LEDs and their projections.

    Attributes:
        features: (N,3) AGR, GRI, NGR of the first training LEDs.
        bits: (N,).
        projections: (N,) ``w . x``, Eq. 10.
        flda: what was trained: w (Eq. 14) and the threshold (Eq. 19).
        deviation: (3,) standard deviation of each feature within the classes, pooled.
        frames: training frames.
    """

    name = "fig13_14"

    def __init__(self, source: evidence.Source) -> None:
        """Train at the true corners on the plan's training frames; project the LEDs that training keeps."""
        training = train(replace(source.plan, receiver=replace(source.plan.receiver, locator="truth")))
        self.flda, self.frames = training.flda.cpu(), training.frames
        known, threshold = self.flda.statistics, float(self.flda.threshold)
        self.features, self.bits = training.features.double().numpy(), training.bits.numpy()
        self.deviation = (known.scatter.sum(dim=0) / known.count.sum()).diagonal().sqrt().numpy()
        weights = self.flda.direction.numpy()
        self.projections = self.features @ weights
        leds = zip(self.bits.tolist(), self.features.tolist(), self.projections.tolist(), strict=True)
        lines = [(led, int(bit), *features, along) for led, (bit, features, along) in enumerate(leds)]
        self.rows = [("led", "bit", *FEATURE_NAMES, "projection"), *lines]
        self.findings = {}
        for name, weight, deviation in zip(FEATURE_NAMES, weights, self.deviation, strict=True):
            self.findings[f"w_{name}"] = float(weight)
            self.findings[f"w_{name}_per_deviation"] = float(weight * deviation)
        wrong = (self.projections >= threshold) != self.bits
        self.findings |= {"threshold": threshold, "auc_projection": roc_area(self.projections, self.bits)}
        self.findings |= {"wrong_share_on": float(wrong[self.bits].mean())}
        self.findings |= {"wrong_share_off": float(wrong[~self.bits].mean())}

    def draw_on(self, figure: canvas.Figure) -> Mapping[str, object]:
        """Draw w among the LEDs of two features, and the histogram of the projections of all three."""
        axes = figure.add_axes((0.075, 0.215, 0.41, 0.62))
        self.draw_plane(axes)
        canvas.head(axes, "(a)", "w and its threshold for AGR and GRI alone")
        axes = figure.add_axes((0.575, 0.215, 0.41, 0.62))
        label, threshold = "Projection w \N{MIDDLE DOT} x of AGR, GRI and NGR", self.findings["threshold"]
        status_histogram(axes, self.projections, self.bits, label, log=True)
        axes.axvline(threshold, **evidence.DASHED)
        on, off = (evidence.percent_text(self.findings[f"wrong_share_{status}"]) for status in ("on", "off"))
        canvas.head(axes, "(b)", f"wrong at {threshold:.2f}: {on} of On, {off} of Off")
        evidence.status_legend(figure)
        weights = [f"{name.upper()} {self.findings[f'w_{name}_per_deviation']:.2f}" for name in FEATURE_NAMES]
        shown = {"frames": self.frames, "leds": len(self.bits), "shown": min(SHOWN, len(self.bits))}
        return {**shown, "weights": ", ".join(weights).replace("-", "\N{MINUS SIGN}")}

    def draw_plane(self, axes: canvas.Axes) -> None:
        """Draw two features over their deviations, w as an arrow and the threshold at a right angle to it."""
        deviation, midpoint = self.deviation[:2], self.flda.statistics.mean.mean(dim=0).numpy()[:2]
        scaled = (self.features[:SHOWN, :2] - midpoint) / deviation
        labels = ("AGR (standard deviations)", "GRI (standard deviations)")
        status_cloud(axes, scaled[:, 0], scaled[:, 1], self.bits[:SHOWN], labels)
        along = self.flda.select([0, 1]).direction.numpy() * deviation
        along = along / np.hypot(*along)
        across = np.array([-along[1], along[0]])
        reach = 1.03 * float(np.abs(scaled).max())
        axes.plot(*np.stack([-2 * reach * across, 2 * reach * across], axis=1), **evidence.DASHED)
        tip = 0.8 * reach * along
        arrow = {"arrowstyle": "-|>", "color": canvas.INK, "linewidth": 2.0, "mutation_scale": 16}
        axes.annotate("", tuple(tip), tuple(-tip), arrowprops={**arrow, "shrinkA": 0, "shrinkB": 0})
        evidence.note(axes, "w", tuple(tip), (7, -4), fontsize=13, fontweight="bold")
        # Both axes at one scale, so that the threshold stands at a right angle to w.
        box = axes.get_window_extent()
        axes.set_ylim(-reach, reach)
        axes.set_xlim(-reach * box.width / box.height, reach * box.width / box.height)


def status_cloud(axes: canvas.Axes, x: Floats, y: Floats, bits: Bools, labels: tuple[str, str]) -> None:
    """Draw a point an LED; On and Off are mixed, so that neither hides the other.

    Args:
        axes: where to draw.
        x: any shape.
        y: of the same shape.
        bits: of the same shape.
        labels: of the two axes, with their units.
    """
    colours = np.where(bits.ravel(), evidence.ON, evidence.OFF)
    mixed = np.random.default_rng(0).permutation(colours.size)
    places = x.ravel()[mixed], y.ravel()[mixed]
    axes.scatter(*places, s=7, c=colours[mixed], alpha=0.35, linewidths=0, rasterized=True)
    axes.margins(0.03)
    evidence.plain_axes(axes, *labels, grid="both")


def negative_share(axes: canvas.Axes, values: Floats, bits: Bools, at: tuple[float, float]) -> None:
    """Write how many of the Off and of the On LEDs have a negative value, left of a place of the axes."""
    off, on = (evidence.percent_text(float(np.mean(values[side] < 0))) for side in (~bits, bits))
    text = f"negative: {off} of Off,\n{on} of On LEDs"
    evidence.note(axes, text, at, xycoords="axes fraction", ha="right", va="top")


def area_text(auc: float) -> str:
    """Write an area; as 1 only where it is.

    Example:
        >>> area_text(0.53577), area_text(0.99956), area_text(0.9999999), area_text(1.0)
        ('= 0.536', '= 0.9996', '> 0.9999', '= 1')
    """
    text = f"{auc:.3f}" if auc < 0.999 else f"{auc:.4f}" if auc < 0.9999 else ""
    return f"= {text}" if text else "= 1" if auc == 1 else "> 0.9999"


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
    on, off = counted(bits)
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
    _, off = counted(bits)
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
    counted(bits)
    deviation, columns = values.std(axis=0), values.shape[1]
    scaled = (values - values.mean(axis=0)) / np.where(deviation > 0, deviation, 1.0)
    sides = np.where(bits, 1.0, -1.0)[:, None] * np.column_stack([scaled, np.ones(len(scaled))])
    # Unknown are the weights, the offset and the margin, which is made large.
    cost, ranges = np.append(np.zeros(columns + 1), -1.0), [(-1.0, 1.0)] * columns + [(None, None)] * 2
    constraints = np.column_stack([-sides, np.ones(len(sides))])
    found = linprog(cost, A_ub=constraints, b_ub=np.zeros(len(sides)), bounds=ranges)
    return bool(found.success and (sides @ found.x[:-1]).min() > 0)


def counted(bits: Bools) -> tuple[int, int]:
    """How many bits are On and Off, both of which are needed.

    Raises:
        VoccError: all On or all Off.
    """
    on, off = int(bits.sum()), int((~bits).sum())
    if not on or not off:
        raise VoccError(f"bits holds {on} On and {off} Off: a comparison needs both")
    return on, off
