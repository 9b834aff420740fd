"""What ``task=figures`` measures, under every reading of what the paper leaves open, and Figs 21 to 24."""

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any

from matplotlib.ticker import LogLocator

from vocc_torch.errors import VoccError, section
from vocc_torch.measure import curve, estimate, grid, intervals, paired, sweep
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.plan import Locator, Plan
from vocc_torch.report import canvas, plots, styles
from vocc_torch.studies.paper import FiguresConfig, evidence, words
from vocc_torch.studies.paper.evidence import features, frames, panels

PAPER_RECEIVERS = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")
"""The receivers of the paper's figures."""
RATE_FIGURES = {"contrast": "fig21", "ambient": "fig22", "luminance": "fig23", "distance": "fig24"}
"""The figures of bit error rates by experiment."""
DIMMING = "dimming"
"""The experiment, and the figure, that is a grid: measured with the report's own focal length only."""
FIGURES = tuple(name for name in words.FIGURES if name != "location")
"""Every figure that may be asked for by name, in the paper's order."""
_DRAWN: tuple[type[evidence.PaperFigure], ...] = (
    *(panels.GreyOverlap, panels.BloomingInterference, panels.BlurOrder, panels.ContrastPanels),
    *(features.GreyAndAgr, features.GriAndAgr, features.NgrAndOthers, features.Projection),
    *(frames.InwardGradients, frames.FrameHistogram, frames.ProcessingTime),
)
EVIDENCE = {figure.name: figure for figure in _DRAWN}
"""The figures other than bit error rates by name."""


def wanted_figures(names: Sequence[str]) -> tuple[str, ...]:
    """The figures to make, in the paper's order; no name means all.

    Raises:
        VoccError: an unknown name.

    Example:
        >>> wanted_figures(["fig22", "fig04"])
        ('fig04', 'fig22')
    """
    for name in names:
        if name not in FIGURES:
            raise VoccError(f"figures.names has {name!r}: known are {', '.join(FIGURES)}")
    return tuple(name for name in FIGURES if not names or name in names)


@dataclass(frozen=True)
class PaperPlan:
    """The studies behind the wanted figures.

    Args:
        config: the study's section of the configuration; the first lens and locator are the report's own.
        figures: names of the wanted figures, in the paper's order.
        experiments: plans by experiment and row (0 where there is no grid), at any focal length.
    """

    config: FiguresConfig
    figures: tuple[str, ...]
    experiments: Mapping[str, Mapping[float, Plan]]

    @property
    def locators(self) -> tuple[Locator, ...]:
        """The locators; the first is the report's own."""
        return tuple(self.config.locators)

    @property
    def own(self) -> tuple[float, Locator]:
        """The report's own focal length and locator."""
        return self.config.focal_lengths_mm[0], self.locators[0]

    def studies(self) -> list[sweep.Study]:
        """The studies, those of the report's own focal length first."""
        return [
            sweep.Study(study_key(name, focal_mm, row), sweep.at_focal_length(plan, focal_mm), self.locators)
            for focal_mm in self.config.focal_lengths_mm
            for name, rows in self.experiments.items()
            for row, plan in rows.items()
            if name != DIMMING or focal_mm == self.own[0]
        ]

    def measured(self, campaign: sweep.Campaign) -> dict[float, dict[str, curve.Measured]]:
        """A campaign's results by focal length and experiment; the grid is left out."""
        names = [name for name in self.experiments if name != DIMMING]
        return {
            focal_mm: {name: campaign.measured[study_key(name, focal_mm)] for name in names}
            for focal_mm in self.config.focal_lengths_mm
        }

    def grids(self, campaign: sweep.Campaign) -> dict[str, grid.Grid]:
        """The grid for each locator; empty where it was not measured."""
        rows = tuple(self.experiments.get(DIMMING, {}))
        axis = (self.config.experiments[DIMMING].row_axis if rows else None) or "ambient_lx"
        of_row = [campaign.measured[study_key(DIMMING, self.own[0], row)] for row in rows]
        every = {name: tuple(one.curves[name] for one in of_row) for name in self.locators if rows}
        return {name: grid.Grid(axis, rows, curves) for name, curves in every.items()}


def paper_plan(config: FiguresConfig, plan: Plan) -> PaperPlan:
    """Build what the wanted figures need.

    Args:
        config: the study's section of the configuration.
        plan: the study's camera, receivers and budget.

    Raises:
        VoccError: an unknown figure or locator, no focal length or locator or one given twice, an experiment
            with a value outside its range, or none of the receivers that the figures show.
    """
    given: Sequence[object]
    for name, given in (("focal_lengths_mm", config.focal_lengths_mm), ("locators", config.locators)):
        if not given or len(set(given)) != len(given):
            raise VoccError(f"figures.{name} is {list(given)}: it must hold at least one, each once")
    plan.receiver.demand_locators("figures.locators", config.locators)
    # The one whose receiver is kept.
    plan = replace(plan, receiver=replace(plan.receiver, locator=config.locators[0]))
    figures, built = wanted_figures(config.names), {}
    wanted = {name for name, figure in RATE_FIGURES.items() if figure in figures} | {*figures} & {DIMMING}
    for name, one in config.experiments.items():
        if name in wanted:
            with section(f"figures.experiments.{name}", before="experiment"):
                built[name] = replace(plan, experiment=one).rows()
    names = plan.receiver.names
    if built and not set(names) & set(PAPER_RECEIVERS):
        known = ", ".join(PAPER_RECEIVERS)
        raise VoccError(f"receiver.names is {list(names)}: figures of bit error rates need one of {known}")
    return PaperPlan(config, figures, built)


def study_key(experiment: str, focal_length_mm: float, row: float = 0.0) -> str:
    """Name a study.

    Example:
        >>> study_key("ambient", 25.0), study_key("dimming", 25.0, 1000.0)
        ('ambient-25mm', 'dimming-25mm-1000')
    """
    return f"{experiment}-{focal_length_mm:g}mm" + (f"-{row:g}" if row else "")


_INTERVALS = "Bars: 95 % intervals, frames as the independent units \N{MIDDLE DOT}"
_RATES = ("ber_located", "ber_true_corners", "location_share")
LOCATION_COLUMNS = (
    *("experiment", "axis", "value", "receiver", "frames"),
    *(f"{rate}{end}" for rate in _RATES for end in ("", "_low", "_high")),
)
"""Columns of ``location.csv``."""


def only(table: curve.BerTable, receivers: Sequence[str] = PAPER_RECEIVERS) -> curve.BerTable:
    """A table's rows of some receivers.

    Example:
        >>> len(only(curve.BerTable()))
        0
    """
    return curve.BerTable(row for row in table if row.receiver in receivers)


def draw_rates(
    experiment: str, by_focal_mm: Mapping[float, curve.Measured], own: tuple[float, str]
) -> dict[str, canvas.Figure]:
    """Draw an experiment's figure under the report's own reading, and under all readings side by side.

    Args:
        experiment: which one.
        by_focal_mm: what was measured by focal length, mm, with the same locators in each.
        own: focal length, mm, and locator of the report's own reading.

    Returns:
        By file name without suffix: ``NAME``, and ``NAME_readings`` where there are several.
    """
    stem, table = RATE_FIGURES[experiment], only(by_focal_mm[own[0]].curves[own[1]].table())
    title, axis = words.FIGURES[stem]["title"], styles.axis_label(table.axis)
    drawn = {stem: plots.ber_figure(table, axis, f"{title} ({words.reading_text(*own)})")}
    lenses_mm = sorted(by_focal_mm)
    rows = [
        {words.reading_text(mm, name): only(by_focal_mm[mm].curves[name].table()) for mm in lenses_mm}
        for name in by_focal_mm[own[0]].curves
    ]
    if (readings := sum(map(len, rows))) > 1:
        footnote = f"{_INTERVALS} arrows: no errors; one-sided 95 % limit \N{MIDDLE DOT} "
        trainings = max(row.trainings for row in table)
        pale = f"pale: over {trainings} trainings"
        footnote += pale if trainings > 1 else "the same bits and scenes in every facet"
        drawn[f"{stem}_readings"] = plots.facet_figure(rows, f"{title}, {readings} readings", footnote)
    return drawn


def rate_rows(by_focal_mm: Mapping[float, curve.Measured]) -> list[tuple[str | int | float, ...]]:
    """An experiment's points of all receivers under every reading, the head first.

    Example:
        >>> rate_rows({})[0][:3]
        ('focal_length_mm', 'experiment', 'axis')
    """
    rows: list[tuple[str | int | float, ...]] = [("focal_length_mm", *curve.COLUMNS)]
    for focal_mm, measured in by_focal_mm.items():
        for table in (curves.table() for curves in measured.curves.values()):
            rows += [(focal_mm, *astuple(row)) for name in table.receivers for row in table.of(name)]
    return rows


@dataclass(frozen=True)
class LocationSplit:
    """One receiver with the panel located and with its true corners, on the same frames.

    Args:
        experiment: its name.
        axis: quantity that varies.
        value: the quantity's value; None for the whole experiment, every value's frames together.
        receiver: its name.
        frames: frames read both ways.
        located: bit error rate with the panel located.
        truth: bit error rate with its true corners.
        share: share of the located errors that true corners save, ``(located - truth) / located``; below 0
            where location helps; None where the located panel gave no error.
    """

    experiment: str
    axis: str
    value: float | None
    receiver: str
    frames: int
    located: estimate.Estimate
    truth: estimate.Estimate
    share: estimate.Estimate | None

    def row(self) -> tuple[str | float | None, ...]:
        """The line of ``location.csv``; a total has no value."""
        *what, located, truth, share = astuple(self)
        return (*what, *located, *truth, *(share or (None, None, None)))


def location_split(experiments: Mapping[str, curve.Measured]) -> tuple[LocationSplit, ...]:
    """Split every receiver's errors at every value, each experiment's total after its values.

    Args:
        experiments: by name; those without both locators are left out.

    Example:
        >>> from vocc_torch.measure.curve import Curves
        >>> def read(locator, counts):
        ...     at = {("flda_3", 50.0): counts}
        ...     return Curves("d", "distance_m", locator, ("flda_3",), (50.0,), at, {}, {50.0: "frames"})
        >>> located, truth = Counts(2000, 128_000, 400, 8000, 60), Counts(2000, 128_000, 40, 80, 20)
        >>> both = paired.PairedCounts(2000, 128_000, 360, 7000, 60)
        >>> curves = {"paper": read("paper", located), "truth": read("truth", truth)}
        >>> split = location_split({"d": curve.Measured(curves, {("flda_3", 50.0): both})})
        >>> [(one.value, round(one.share.value, 3)) for one in split]
        [(50.0, 0.9), (None, 0.9)]
    """
    found = []
    for name, measured in experiments.items():
        if not measured.location:
            continue
        truth, located = measured.curves["truth"], measured.curves["paper"]
        for receiver in located.receivers:
            read: dict[float | None, tuple[Counts, Counts, paired.PairedCounts]] = {
                at: (located.counts[receiver, at], truth.counts[receiver, at], both)
                for at in located.values
                if (both := measured.location.get((receiver, at)))
            }
            wrong, right, apart = zip(*read.values(), strict=True)
            read[None] = sum(wrong, Counts()), sum(right, Counts()), sum(apart, paired.PairedCounts())
            for value, (a, b, pair) in read.items():
                share = paired.relative_gain(a, b, pair)
                rates = intervals.ber_interval(a), intervals.ber_interval(b)
                found.append(LocationSplit(name, located.axis, value, receiver, a.frames, *rates, share))
    return tuple(found)


_ROW_IN, _HEAD_IN, _TOP_IN, _BOTTOM_IN, _WIDTH_IN = 0.35, 0.42, 0.72, 1.02, 7.5
_ROOM = 7.0
"""Factor of the rate's axis that is left for the shares, right of the highest rate."""


def location_figure(splits: Sequence[LocationSplit], lens_mm: float) -> canvas.Figure:
    """Draw each experiment's rates with the panel located and with its true corners.

    Args:
        splits: any with totals of the paper's receivers, which are drawn.
        lens_mm: focal length, for the title.

    Example:
        >>> rate = estimate.Estimate(1e-3, 8e-4, 1.2e-3)
        >>> split = LocationSplit("distance", "distance_m", None, "flda_3", 2000, rate, rate, None)
        >>> location_figure([split], 25.0).axes[0].get_xscale()
        'log'
    """
    totals: dict[str, list[LocationSplit]] = {}
    for split in splits:
        if split.value is None and split.receiver in PAPER_RECEIVERS:
            totals.setdefault(split.experiment, []).append(split)
    columns = min(2, len(totals))
    gap_in = (0.52, _HEAD_IN)
    cell_in = (_WIDTH_IN + gap_in[0]) / columns - gap_in[0], max(map(len, totals.values())) * _ROW_IN
    margins_in = (2.2, 0.3, _TOP_IN + _HEAD_IN, _BOTTOM_IN)
    figure, panels = canvas.new_grid(len(totals), columns, cell_in, gap_in, margins_in)
    rates = [rate for group in totals.values() for split in group for rate in (split.located, split.truth)]
    limits = min(one.value or one.high for one in rates) / 3, _ROOM * max(one.high for one in rates)
    for number, (axes, (experiment, group)) in enumerate(zip(panels, totals.items(), strict=True)):
        axes.set(xscale="log", xlim=limits)
        draw_splits(axes, group)
        heading = words.EXPERIMENTS[experiment][:1].upper() + words.EXPERIMENTS[experiment][1:]
        axes.set_title(heading, fontsize=11.5, fontweight="bold", color=canvas.INK, loc="left", pad=4)
        last = number + columns >= len(totals)
        axes.tick_params(axis="y", labelleft=number % columns == 0)
        axes.tick_params(axis="x", labelbottom=last)
        axes.set_xlabel("Bit error rate" if last else "")
    title = words.FIGURES["location"]["title"].format(lens_mm=lens_mm)
    canvas.write_title(figure, title, f"{_INTERVALS} arrow: no error, one-sided 95 % limit")
    band = canvas.Line2D([], [], color=canvas.QUIET, linewidth=6, alpha=0.35)
    band.set_label("location error, and its share")
    located = marker(canvas.QUIET, canvas.QUIET, "o", label="panel located")
    handles = [located, marker(canvas.QUIET, "white", "o", label="true corners: decision error"), band]
    look = {"fontsize": 10.5, "handlelength": 2.0, "columnspacing": 2.2}
    canvas.write_legend(figure, handles, (0.01, 1 - 0.44 / figure.get_figheight()), 3, **look)
    return figure


def draw_splits(axes: canvas.Axes, group: Sequence[LocationSplit]) -> None:
    """Draw one experiment, a row a receiver, the first at the top: both rates, and the band between."""
    axes.set_ylim(len(group) - 0.3, -0.7)
    canvas.quiet_axes(axes)
    axes.spines["left"].set_visible(False)
    axes.xaxis.set_major_locator(LogLocator(10, numticks=30))
    axes.xaxis.set_minor_locator(LogLocator(10, subs=tuple(range(2, 10)), numticks=300))
    axes.grid(axis="x", which="major", color=canvas.GRID, linewidth=1.0)
    axes.grid(axis="x", which="minor", color=canvas.FINE_GRID, linewidth=0.6)
    known = styles.receiver_styles(PAPER_RECEIVERS)
    axes.set_yticks(range(len(group)), [known[split.receiver].label for split in group])
    axes.tick_params(axis="y", length=0)
    for row, split in enumerate(group):
        style, rates = known[split.receiver], (split.truth, split.located)
        colour, band = style.colour, [rate.value or rate.high for rate in rates]
        axes.plot(band, [row, row], color=colour, linewidth=6, alpha=0.28, solid_capstyle="butt")
        for face, rate, at in zip(("white", colour), rates, band, strict=True):
            if rate.value > 0:
                axes.hlines(row, max(rate.low, axes.get_xlim()[0]), rate.high, color=colour, linewidth=1.6)
            else:
                arrow = {"arrowstyle": "<|-", "color": colour, "linewidth": 1.4, "shrinkA": 4, "shrinkB": 4}
                axes.annotate("", (at, row), (-26, 0), textcoords="offset points", arrowprops=arrow)
            axes.add_line(marker(colour, face, style.marker, [at], [row]))
        if split.share is not None:
            share = f"{100 * split.share.value:.0f} %".replace("-", "\N{MINUS SIGN}")
            look: dict[str, Any] = {"va": "center", "fontsize": 10, "color": canvas.INK}
            at = max(rate.high for rate in rates)
            axes.annotate(share, (at, row), (9, 0), textcoords="offset points", **look)


def marker(
    colour: str, face: str, shape: str, xs: Sequence[float] = (), ys: Sequence[float] = (), label: str = ""
) -> canvas.Line2D:
    """Make markers without a line."""
    line = canvas.Line2D(xs, ys, linestyle="none", color=colour, zorder=4, label=label)
    line.set(marker=shape, markersize=8, markerfacecolor=face, markeredgewidth=1.4)
    return line
