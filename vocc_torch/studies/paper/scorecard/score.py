"""The scorecard: every claim under every reading."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from vocc_torch.errors import VoccError
from vocc_torch.measure.curves import Measured
from vocc_torch.measure.grid import Grid
from vocc_torch.studies.paper.scorecard.claim import Claim
from vocc_torch.studies.paper.scorecard.claims import CLAIMS
from vocc_torch.studies.paper.scorecard.judgement import VERDICTS, Judgement, Verdict
from vocc_torch.studies.paper.scorecard.reading import Findings, Reading

Cell: TypeAlias = str | float
COLUMNS = (
    "claim",
    "where",
    "text",
    "paper",
    "focal_length_mm",
    "locator",
    "measured",
    "low",
    "high",
    "verdict",
    "reason",
    "basis",
)
"""Columns of ``scorecard.csv``."""
DEFAULT = (25.0, "paper")
"""Focal length (mm) and locator of the reading that is reported in full: Table 1's lens, section IV-B-2."""


@dataclass(frozen=True)
class Scorecard:
    """What is said of each claim under each reading.

    Args:
        claims: the claims, in the paper's order.
        readings: the readings, with names of their own.
        default: the one that is reported in full.
        judgements: by claim key and reading name.
    """

    claims: tuple[Claim, ...]
    readings: tuple[Reading, ...]
    default: Reading
    judgements: Mapping[tuple[str, str], Judgement]

    def of(self, claim: Claim, reading: Reading | None = None) -> Judgement:
        """Give the judgement of a claim, under the default reading where none is given."""
        return self.judgements[claim.key, (reading or self.default).name]

    def details(self) -> list[tuple[Claim, Judgement]]:
        """Give every claim as judged under the default reading."""
        return [(claim, self.of(claim)) for claim in self.claims]

    def matrix(self) -> list[tuple[Claim, tuple[Verdict, ...]]]:
        """Give every claim's verdicts, one a reading in the order of ``readings``."""
        return [
            (claim, tuple(self.of(claim, reading).verdict for reading in self.readings))
            for claim in self.claims
        ]

    def tally(self, reading: Reading | None = None, *, curves_only: bool = False) -> dict[Verdict, int]:
        """Count the verdicts under a reading, by default of all claims under the default one.

        Args:
            reading: one of the readings.
            curves_only: leave out the claims that do not depend on the reading.
        """
        judged = [claim for claim in self.claims if claim.basis == "curves" or not curves_only]
        counted = Counter(self.of(claim, reading).verdict for claim in judged)
        return {verdict: counted[verdict] for verdict in VERDICTS}

    def rows(self) -> list[tuple[Cell, ...]]:
        """Give the lines of ``scorecard.csv``, its head first.

        A claim that does not depend on the reading has one line, without focal length and locator.
        """
        lines: list[tuple[Cell, ...]] = [COLUMNS]
        for claim in self.claims:
            if claim.basis != "curves":
                lines.append(_line(claim, "", "", self.of(claim)))
                continue
            lines += [
                _line(claim, reading.focal_length_mm, reading.locator, self.of(claim, reading))
                for reading in self.readings
            ]
        return lines


def _line(claim: Claim, focal_length_mm: Cell, locator: str, judged: Judgement) -> tuple[Cell, ...]:
    """Write one judgement as a line."""
    ends = ("" if end is None else end for end in (judged.low, judged.high))
    what = (claim.key, claim.where, claim.text, claim.paper, focal_length_mm, locator)
    return (*what, judged.measured, *ends, judged.verdict, judged.reason, claim.basis)


def readings_of(
    measured: Mapping[float, Mapping[str, Measured]],
    findings: Findings,
    locators: Sequence[str] = ("truth", "paper"),
    grids: Mapping[str, Grid] | None = None,
) -> tuple[Reading, ...]:
    """Give a reading for each focal length and locator.

    Args:
        measured: the experiments by focal length (mm) and name, each with every locator.
        findings: the other figures' numbers, by figure and name.
        locators: where the panel's corners come from.
        grids: ambient light by LED luminance, by locator.

    Example:
        >>> [reading.name for reading in readings_of({25.0: {}, 18.0: {}}, {})]
        ['18 mm, truth', '18 mm, paper', '25 mm, truth', '25 mm, paper']
    """
    return tuple(
        Reading(focal_length_mm, locator, experiments, findings, (grids or {}).get(locator))
        for focal_length_mm, experiments in sorted(measured.items())
        for locator in locators
    )


def score(
    readings: Sequence[Reading],
    default: tuple[float, str] = DEFAULT,
    claims: Sequence[Claim] = CLAIMS,
) -> Scorecard:
    """Judge every claim under every reading.

    A claim that does not depend on the reading is judged once, under the default one.

    Args:
        readings: at least one, none twice.
        default: focal length (mm) and locator of the reading that is reported in full.
        claims: the claims, each under a key of its own.

    Raises:
        VoccError: the default is not among the readings, or a reading or a key comes twice.

    Example:
        >>> card = score(readings_of({25.0: {}}, {}))
        >>> card.tally()["differ"], card.of(next(c for c in CLAIMS if c.key == "setup.iso_range")).verdict
        (1, 'differ')
    """
    chosen = [one for one in readings if (one.focal_length_mm, one.locator) == default]
    if not chosen:
        known = "; ".join(one.name for one in readings) or "none"
        raise VoccError(f"default is {default[0]:g} mm, {default[1]}: the readings are {known}")
    for what, names in (("readings", [one.name for one in readings]), ("claims", [c.key for c in claims])):
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            raise VoccError(f"{what} has {twice[0]!r} twice: each must come once")
    judgements: dict[tuple[str, str], Judgement] = {}
    for claim in claims:
        judgements |= _judged(claim, readings, chosen[0])
    return Scorecard(tuple(claims), tuple(readings), chosen[0], judgements)


def _judged(claim: Claim, readings: Sequence[Reading], default: Reading) -> dict[tuple[str, str], Judgement]:
    """Judge one claim under every reading."""
    if claim.basis != "curves":
        once = claim.judge(default)
        return {(claim.key, one.name): once for one in readings}
    known = {one.focal_length_mm: claim.judge(one) for one in readings if one.locator == "truth"}
    return {
        (claim.key, one.name): known[one.focal_length_mm]
        if one.locator == "truth"
        else claim.judge(one, known.get(one.focal_length_mm))
        for one in readings
    }
