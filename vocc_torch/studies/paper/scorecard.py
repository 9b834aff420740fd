"""The scorecard: every claim under every reading, and which reading fits the quoted numbers best."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from vocc_torch.errors import VoccError
from vocc_torch.measure.curve import Measured, Row
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.grid import Grid
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.studies.paper.claims import CLAIMS, Claim, ClaimGroup
from vocc_torch.studies.paper.curve_rules import gain_of, paper_counts
from vocc_torch.studies.paper.judgement import (
    VERDICTS,
    Judgement,
    NotMeasuredError,
    Numbers,
    PaperReading,
    Verdict,
)

Cell: TypeAlias = str | float | None
Judged: TypeAlias = tuple[Claim, Judgement]
COLUMNS = (
    *("claim", "where", "text", "paper", "focal_length_mm", "locator"),
    *("measured", "low", "high", "verdict", "reason", "basis"),
)
"""Columns of ``scorecard.csv``."""
FIT_COLUMNS = ("reading", *VERDICTS, "distance to quoted rates", "distance to quoted gains")
"""Columns of ``fits.csv``."""
DEFAULT = (25.0, "paper")
"""Focal length (mm) and locator of the reading that is reported in full: Table 1's lens, section IV-B-2."""


@dataclass(frozen=True)
class Scorecard:
    """What is said of each claim under each reading.

    Args:
        claims: the claims, in the paper's order.
        readings: with names of their own.
        own: the reading that is reported in full.
        judgements: by the names of claim and reading.
    """

    claims: tuple[Claim, ...]
    readings: tuple[PaperReading, ...]
    own: PaperReading
    judgements: Mapping[tuple[str, str], Judgement]

    def judged(self, group: ClaimGroup | None = None, reading: PaperReading | None = None) -> list[Judged]:
        """Give the claims of a group, by default all, as judged under a reading, by default the own one."""
        name = (reading or self.own).name
        return [
            (claim, self.judgements[claim.claim, name])
            for claim in self.claims
            if group is None or group.holds(claim)
        ]

    def at_truth(self) -> PaperReading | None:
        """Give the own reading with true corners; None where that is it, or was not measured."""
        return next(
            (
                one
                for one in self.readings
                if one.focal_length_mm == self.own.focal_length_mm
                and one.locator == "truth" != self.own.locator
            ),
            None,
        )

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give the lines of ``scorecard.csv``, its head first.

        A claim that does not depend on the reading has one line, without focal length and locator.
        """
        lines: list[tuple[Cell, ...]] = [COLUMNS]
        for claim in self.claims:
            for reading in self.readings if claim.basis == "curves" else (None,):
                one = self.judgements[claim.claim, (reading or self.own).name]
                where = (None, None) if reading is None else (reading.focal_length_mm, reading.locator)
                what = (claim.claim, claim.where, claim.text, claim.paper, *where)
                lines.append((*what, one.measured, one.low, one.high, one.verdict, one.reason, claim.basis))
        return lines


def tally(judged: Iterable[Judged]) -> dict[Verdict, int]:
    """Count verdicts."""
    found = Counter(one.verdict for _, one in judged)
    return {verdict: found[verdict] for verdict in VERDICTS}


def outcome(judged: Iterable[Judged]) -> str:
    """Sum claims up: in part where some agree and some differ; a few that agree do not speak for the others.

    Example:
        >>> outcome([])
        'cannot say'
    """
    found = tally(judged)
    if found["differ"]:
        return "holds in part" if found["agree"] else "does not hold"
    return "holds" if found["agree"] > found["cannot say"] else "cannot say"


def readings_of(
    measured: Mapping[float, Mapping[str, Measured]],
    numbers: Numbers,
    locators: Sequence[str] = ("truth", "paper"),
    grids: Mapping[str, Grid] | None = None,
) -> tuple[PaperReading, ...]:
    """Give a reading for each focal length and locator.

    Args:
        measured: the experiments by focal length (mm) and name, each with every locator.
        numbers: of the other figures, by figure and name.
        locators: where the panel's corners come from.
        grids: ambient light by LED luminance, by locator.

    Example:
        >>> [reading.name for reading in readings_of({25.0: {}, 18.0: {}}, {})]
        ['18 mm, truth', '18 mm, paper', '25 mm, truth', '25 mm, paper']
    """
    return tuple(
        PaperReading(focal_length_mm, locator, experiments, numbers, (grids or {}).get(locator))
        for focal_length_mm, experiments in sorted(measured.items())
        for locator in locators
    )


def score(
    readings: Sequence[PaperReading], own: tuple[float, str] = DEFAULT, claims: Sequence[Claim] = CLAIMS
) -> Scorecard:
    """Judge every claim under every reading; one that does not depend on it once, under the own one.

    Args:
        readings: at least one, none twice.
        own: focal length (mm) and locator of the reading that is reported in full.
        claims: the claims.

    Raises:
        VoccError: the own reading is not among the others, or one comes twice.

    Example:
        >>> card = score(readings_of({25.0: {}}, {}))
        >>> tally(card.judged())["differ"], card.judgements["setup.iso_range", "25 mm, paper"].verdict
        (1, 'differ')
    """
    names = [one.name for one in readings]
    chosen = [one for one in readings if (one.focal_length_mm, one.locator) == own]
    if not chosen:
        raise VoccError(f"own is {own[0]:g} mm, {own[1]}: the readings are {'; '.join(names) or 'none'}")
    if len(set(names)) < len(names):
        raise VoccError(f"readings are {'; '.join(names)}: each must come once")
    judgements: dict[tuple[str, str], Judgement] = {}
    for claim in claims:
        if claim.basis != "curves":
            judgements |= dict.fromkeys(((claim.claim, name) for name in names), claim.judge(chosen[0]))
            continue
        at_truth: dict[float, Judgement] = {}
        for one in sorted(readings, key=lambda reading: reading.locator != "truth"):
            judged = claim.judge(one, at_truth.get(one.focal_length_mm))
            if one.locator == "truth":
                at_truth[one.focal_length_mm] = judged
            judgements[claim.claim, one.name] = judged
    return Scorecard(tuple(claims), tuple(readings), chosen[0], judgements)


@dataclass(frozen=True, slots=True)
class Fit:
    """How well a reading fits the quoted numbers.

    A distance to quoted rates is the mean ``|log10 (measured / quoted)|``, in decades: 0.3 is a factor of
    two. A point without errors is known by its limit only: it counts as far as the limit lies below the
    quoted rate, and not at all where it lies above. The interval takes each measured rate and each quoted one
    anywhere in its own; its high end is infinite where a point saw no error.

    Args:
        reading: the reading.
        tally: verdicts of the claims that depend on the reading.
        decades: distance to the quoted bit error rates; None where none was measured.
        rates: quoted rates that could be compared.
        error_free: those of them where no error was seen.
        gain_points: mean distance to the quoted gains, in percentage points; None where none is defined.
        gains: quoted gains that could be compared.
    """

    reading: PaperReading
    tally: dict[Verdict, int]
    decades: Estimate | None
    rates: int
    error_free: int
    gain_points: float | None
    gains: int

    def row(self) -> tuple[str, ...]:
        """Give the line of ``fits.csv``."""
        rates, gains = "not measured", "none defined"
        if self.decades is not None:
            rates = f"{self.decades.value:.2f} decades [{self.decades.low:.2f}, {self.decades.high:.2f}]"
            rates += f", {self.error_free} of {self.rates} without errors" if self.error_free else ""
        if self.gain_points is not None:
            gains = f"{self.gain_points:.0f} points over {self.gains}"
        return (self.reading.name, *(str(self.tally[verdict]) for verdict in VERDICTS), rates, gains)


def fits(card: Scorecard) -> list[Fit]:
    """Give how well each reading fits, in the scorecard's order."""
    return [fit_of(card, reading) for reading in card.readings]


def fit_of(card: Scorecard, reading: PaperReading) -> Fit:
    """Measure how far a reading's rates and gains are from the quoted ones."""
    apart, points, error_free = [], [], 0
    for claim in card.claims:
        if claim.rule != "quoted":
            continue
        wanted = dict(claim.arguments)
        try:
            if "ber" in wanted:
                row = reading.row(wanted["experiment"], wanted["receiver"], wanted["at"])
                theirs = ber_interval(paper_counts(reading, **wanted))
                apart.append(decades_apart(row, wanted["ber"], theirs))
                error_free += row.error_free
            else:
                at = wanted.get("at")
                known = () if at is None else (at,)
                gain = gain_of(reading.curves(wanted["experiment"], ("flda_2", "flda_3"), *known), at)
                points += [] if gain is None else [100 * abs(gain.value - wanted["gain"])]
        except NotMeasuredError:
            continue
    means = [math.fsum(column) / len(apart) for column in zip(*apart, strict=True)]
    counts = tally(one for one in card.judged(reading=reading) if one[0].basis == "curves")
    return Fit(
        reading,
        counts,
        Estimate(*means) if means else None,
        len(apart),
        error_free,
        math.fsum(points) / len(points) if points else None,
        len(points),
    )


def decades_apart(row: Row, quoted: float, theirs: Estimate) -> tuple[float, float, float]:
    """Give ``|log10 (measured / quoted)|`` and its ends, as :class:`Fit` takes it.

    Args:
        row: the measured point.
        quoted: the quoted rate, above 0.
        theirs: the rate behind it, with its interval.

    Example:
        >>> row = Row("s", "x", 1.0, "r", "truth", 9, 576, 1.0, 1e-2, 9e-3, 2e-2, 1, 0, "frames")
        >>> [round(number, 2) for number in decades_apart(row, 1e-3, Estimate(1e-3, 9e-4, 2e-3))]
        [1.0, 0.65, 1.35]
    """
    least = math.log10(row.ber_low / theirs.high) if row.ber_low > 0 else -math.inf
    most = math.log10(row.ber_high / theirs.low) if theirs.low > 0 else math.inf
    near = 0.0 if least <= 0 <= most else min(abs(least), abs(most))
    far = max(abs(least), abs(most))
    if row.error_free:
        return max(0.0, math.log10(quoted / row.ber_high)), near, far
    return abs(math.log10(row.ber / quoted)), near, far
