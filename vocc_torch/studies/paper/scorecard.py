"""The scorecard: the paper's claims (``claims.yaml``) under every reading, and which reading fits best."""

import contextlib
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Any, Literal, TypeAlias

from vocc_torch.measure import curve, estimate, grid, intervals
from vocc_torch.studies.paper import curve_rules, figure_rules, judgement
from vocc_torch.studies.paper.judgement import VERDICTS, Judgement, NotMeasuredError, PaperReading, Verdict
from vocc_torch.studies.paper.words import read_yaml

Basis: TypeAlias = Literal["curves", "figures", "arithmetic"]
_OF_CURVES = ("order", "trend", "minimum", "quoted_ber", "quoted_gain")
RULES: dict[str, Callable[..., Judgement]] = {name: getattr(curve_rules, name) for name in _OF_CURVES}
RULES |= {name: getattr(figure_rules, name) for name in ("number", "time", "best_luminance")}
"""Every rule by its name in ``claims.yaml``."""


@dataclass(frozen=True)
class Claim:
    """Something that the paper says and that can be checked.

    Args:
        claim: its name, such as ``ambient.lowest.flda_3``.
        where: section and figure of the paper.
        text: what is claimed, in our words.
        paper: what the paper quotes or says.
        rule: a name in ``RULES``.
        arguments: of the rule.
        basis: what it is judged by: ``curves`` of bit error rates, which depend on the reading; ``figures``
            of one sample, with the study's own settings; ``arithmetic`` with the paper's own numbers.

    Example:
        >>> half = {"value": "paper.half_exposure_grey", "most": 100.0}
        >>> claim = Claim("a.b", "IV-C", "text", "6 %", "number", half, "arithmetic")
        >>> claim.judge(PaperReading(25.0, "paper", {}, {})).verdict
        'agree'
    """

    claim: str
    where: str
    text: str
    paper: str
    rule: str
    arguments: Mapping[str, Any]
    basis: Basis

    def judge(self, reading: PaperReading, at_truth: Judgement | None = None) -> Judgement:
        """Judge the claim; where it differs, with what becomes of it with true corners.

        Args:
            reading: what was measured.
            at_truth: how the claim is judged with true corners, if those are not this reading's.
        """
        try:
            judged = RULES[self.rule](reading, **self.arguments)
        except NotMeasuredError as missing:
            return Judgement("cannot say", "not measured", f"{missing} was not measured")
        if judged.verdict != "differ" or at_truth is None or self.basis != "curves":
            return judged
        then = {"agree": "with true corners it agrees", "differ": "it differs with true corners too"}
        unsaid = f"with true corners it cannot be said: {at_truth.reason}"
        return replace(judged, reason=f"{judged.reason}; {then.get(at_truth.verdict, unsaid)}")


def claims_of(entries: Iterable[Mapping[str, Any]]) -> tuple[Claim, ...]:
    """Read claims from the entries of ``claims.yaml``.

    Args:
        entries: each with ``claim``, ``where``, ``text`` and ``paper``, perhaps a ``basis``, and one rule
            with its arguments.

    Example:
        >>> entry = {"claim": "a.b", "where": "IV", "text": "t", "paper": "p"}
        >>> claims_of([entry | {"number": {"value": "fig04.x"}}])[0].basis
        'figures'
    """
    claims: list[Claim] = []
    for entry in entries:
        (rule,) = {*entry} & {*RULES}
        basis: Basis = entry.get("basis", "curves" if rule in _OF_CURVES else "figures")
        texts = {key: str(entry[key]) for key in ("claim", "where", "text", "paper")}
        claims.append(Claim(**texts, rule=rule, arguments=entry[rule], basis=basis))
    return tuple(claims)


@dataclass(frozen=True)
class ClaimGroup:
    """Claims that are told of together: a part of the scorecard, or a main statement of the paper.

    Args:
        text: the part's heading, or what the paper states in sum.
        patterns: of the names of its claims.
        anchor: the part's name in links; empty for a statement.
    """

    text: str
    patterns: tuple[str, ...]
    anchor: str = ""

    def holds(self, claim: Claim) -> bool:
        """Whether a claim belongs to it."""
        return any(fnmatchcase(claim.claim, pattern) for pattern in self.patterns)


_FILE: dict[str, list[dict[str, Any]]] = read_yaml("claims.yaml")
CLAIMS = claims_of(_FILE["claims"])
"""Every claim, in the paper's order of sections."""
PARTS = tuple(ClaimGroup(one["title"], tuple(one["claims"]), one["anchor"]) for one in _FILE["groups"])
"""The scorecard's parts, in the paper's order; a claim stands in the first one that holds it."""
CAUSES: Mapping[str, str] = {one["cause"]: one["text"] for one in _FILE["causes"]}
"""What is known of why claims differ, by the name that a rule or a verdict gives it."""
STATEMENTS = tuple(ClaimGroup(one["text"], tuple(one["claims"])) for one in _FILE["statements"])
"""The paper's main statements, in the order of its sections."""


def part_of(claim: Claim) -> ClaimGroup:
    """The scorecard's part that a claim stands in.

    Example:
        >>> part_of(CLAIMS[0]).anchor
        'score-pictures'
    """
    return next(part for part in PARTS if part.holds(claim))


Judged: TypeAlias = tuple[Claim, Judgement]
COLUMNS = (
    *("claim", "where", "text", "paper", "focal_length_mm", "locator"),
    *("measured", "low", "high", "verdict", "reason", "basis"),
    *("algorithm_verdict", "algorithm_measured"),
)
"""Columns of ``scorecard.csv``; the last are of all trainings, and empty after a single one."""
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
        algorithms: the same of the algorithms, where receivers were trained several times.
    """

    claims: tuple[Claim, ...]
    readings: tuple[PaperReading, ...]
    own: PaperReading
    judgements: Mapping[tuple[str, str], Judgement]
    algorithms: Mapping[tuple[str, str], Judgement] = field(default_factory=dict)

    def changed(self) -> list[tuple[Claim, Judgement, Judgement]]:
        """The claims whose verdict is another one for the algorithms, under the own reading, with both."""
        found = []
        for claim, first in self.judged():
            every = self.algorithms.get((claim.claim, self.own.name))
            if every is not None and every.verdict != first.verdict and claim.basis == "curves":
                found.append((claim, first, every))
        return found

    def judged(self, group: ClaimGroup | None = None, reading: PaperReading | None = None) -> list[Judged]:
        """The claims of a group, by default all, as judged under a reading, by default the own one."""
        name = (reading or self.own).name
        claims = [claim for claim in self.claims if group is None or group.holds(claim)]
        return [(claim, self.judgements[claim.claim, name]) for claim in claims]

    def grouped(self, groups: Sequence[ClaimGroup]) -> dict[ClaimGroup, list[Judged]]:
        """The claims as judged under the own reading, each in the first group that holds it."""
        found: dict[ClaimGroup, list[Judged]] = {}
        for group in groups:
            taken = {claim.claim for claims in found.values() for claim, _ in claims}
            if held := [one for one in self.judged(group) if one[0].claim not in taken]:
                found[group] = held
        return found

    def on_figure(self, name: str) -> list[Judged]:
        """The claims that name a figure, such as ``fig05_06``, as judged under the own reading."""
        numbers = {int(number) for number in re.findall(r"\d+", name)}
        found = ((one, re.findall(r"Fig\. (\d+)", one[0].where)) for one in self.judged())
        return [one for one, named in found if numbers & set(map(int, named))]

    def at_truth(self) -> PaperReading | None:
        """The own reading with true corners; None where that is it, or was not measured."""
        wanted = replace(self.own, locator="truth").name
        return next((one for one in self.readings if one.name == wanted != self.own.name), None)

    def rows(self) -> list[tuple[str | float | None, ...]]:
        """The lines of ``scorecard.csv``, its head first.

        A claim that does not depend on the reading has one line, without focal length and locator.
        """
        lines: list[tuple[str | float | None, ...]] = [COLUMNS]
        for claim in self.claims:
            for reading in self.readings if claim.basis == "curves" else (None,):
                one = self.judgements[claim.claim, (reading or self.own).name]
                where = (reading.focal_length_mm, reading.locator) if reading else (None, None)
                what = (claim.claim, claim.where, claim.text, claim.paper, *where)
                told = (one.measured, one.low, one.high, one.verdict, one.reason, claim.basis)
                of = self.algorithms.get((claim.claim, reading.name)) if reading else None
                lines.append((*what, *told, *((of.verdict, of.measured) if of else (None, None))))
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


def causes(card: Scorecard, claims: Sequence[Judged]) -> list[tuple[str, int]]:
    """The known causes of claims that differ, each with how many of them it holds for.

    Args:
        card: the scorecard.
        claims: any claims; those that do not differ are passed over.
    """
    truth, counts = card.at_truth(), Counter[str]()
    for claim, judged in claims:
        if judged.verdict == "differ":
            counts.update(judged.causes)
            if truth is not None and claim.basis == "curves":
                counts[card.judgements[claim.claim, truth.name].verdict] += 1
    return [(text, counts[name]) for name, text in CAUSES.items() if counts[name]]


def why(card: Scorecard, claims: Sequence[Judged]) -> str:
    """Say why a statement does not hold in every claim: the known causes, and the surest contradiction.

    Where nothing contradicts it, say what kept a claim from being decided.
    """
    differing = [one for one in claims if one[1].verdict == "differ"]
    if not differing:
        silent = [judged.reason for _, judged in claims if judged.verdict == "cannot say" and judged.reason]
        return f"not decided: {silent[0]}" if silent else ""
    claim, judged = differing[0]
    example = f"{claim.text}: {judged.measured}, where the paper has {claim.paper}"
    if judged.against:
        one = judged.against[0]
        example = (f"{one.above[0]}: " if one.above[0] == one.below[0] else "") + one.text()
    of = f" of {len(differing)})"
    known = [text + (f" ({count}{of}" if len(differing) > 1 else "") for text, count in causes(card, claims)]
    return "; ".join([*known, f"for example, {example}"])


def readings_of(
    measured: Mapping[float, Mapping[str, curve.Measured]],
    numbers: judgement.Numbers,
    locators: Sequence[str] = ("truth", "paper"),
    grids: Mapping[str, grid.Grid] | None = None,
) -> tuple[PaperReading, ...]:
    """A reading for each focal length and locator.

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
        readings: of different names, with the own one.
        own: focal length (mm) and locator of the reading that is reported in full.
        claims: the claims.

    Example:
        >>> card = score(readings_of({25.0: {}}, {}))
        >>> tally(card.judged())["differ"], card.judgements["setup.iso_range", "25 mm, paper"].verdict
        (1, 'differ')
    """
    [chosen] = [one for one in readings if (one.focal_length_mm, one.locator) == own]
    judgements: dict[tuple[str, str], Judgement] = {}
    # True corners come first: what they make of a claim is told with the other readings.
    for one in sorted(readings, key=lambda reading: reading.locator != "truth"):
        for claim in claims:
            at_truth = judgements.get((claim.claim, replace(one, locator="truth").name))
            judged = claim.judge(one if claim.basis == "curves" else chosen, at_truth)
            judgements[claim.claim, one.name] = judged
    return Scorecard(tuple(claims), tuple(readings), chosen, judgements)


def score_all(readings: Sequence[PaperReading], own: tuple[float, str] = DEFAULT) -> Scorecard:
    """Judge the receivers of the first training, and where there are several trainings the algorithms too."""
    card = score(readings, own)
    every = [curves for one in readings for of in one.experiments.values() for curves in of.curves.values()]
    if not any(curves.trained for curves in every):
        return card
    algorithms = score([replace(one, of_algorithms=True) for one in readings], own)
    return replace(card, algorithms=algorithms.judgements)


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
    decades: estimate.Estimate | None
    rates: int
    error_free: int
    gain_points: float | None
    gains: int

    def row(self) -> tuple[str, ...]:
        """The line of ``fits.csv``."""
        rates, gains = "not measured", "none defined"
        if self.decades is not None:
            rates = f"{self.decades.value:.2f} decades [{self.decades.low:.2f}, {self.decades.high:.2f}]"
            rates += f", {self.error_free} of {self.rates} without errors" if self.error_free else ""
        if self.gain_points is not None:
            gains = f"{self.gain_points:.0f} points over {self.gains}"
        return (self.reading.name, *map(str, self.tally.values()), rates, gains)


def fits(card: Scorecard) -> list[Fit]:
    """How far each reading's rates and gains are from the quoted ones, in the card's order."""
    found = []
    quoted = {rule: [claim.arguments for claim in card.claims if claim.rule == rule] for rule in RULES}
    for reading in card.readings:
        apart, points, error_free = [], [], 0
        for rate in quoted["quoted_ber"]:
            with contextlib.suppress(NotMeasuredError):
                row = reading.row(rate["experiment"], rate["receiver"], rate["at"])
                _, theirs = curve_rules.paper_counts(reading, **rate)
                apart.append(decades_apart(row, rate["ber"], intervals.ber_interval(theirs)))
                error_free += row.error_free
        for one in quoted["quoted_gain"]:
            with contextlib.suppress(NotMeasuredError):
                _, gain = curve_rules.gains_of(reading, one["experiment"], one.get("at"))
                points += [100 * abs(gain.value - one["gain"])] if gain else []
        counts = tally(one for one in card.judged(reading=reading) if one[0].basis == "curves")
        means = [math.fsum(column) / len(apart) for column in zip(*apart, strict=True)]
        mean = math.fsum(points) / len(points) if points else None
        decades = estimate.Estimate(*means) if means else None
        found.append(Fit(reading, counts, decades, len(apart), error_free, mean, len(points)))
    return found


def decades_apart(row: curve.Row, quoted: float, theirs: estimate.Estimate) -> tuple[float, float, float]:
    """``|log10 (measured / quoted)|`` and its ends, as :class:`Fit` takes it.

    Args:
        row: the measured point.
        quoted: the quoted rate, above 0.
        theirs: the rate behind it, with its interval.

    Example:
        >>> row = curve.Row("s", "x", 1.0, "r", "truth", 9, 576, 1.0, 1e-2, 9e-3, 2e-2, 1, 0, "frames")
        >>> [round(number, 2) for number in decades_apart(row, 1e-3, estimate.Estimate(1e-3, 9e-4, 2e-3))]
        [1.0, 0.65, 1.35]
    """
    least = math.log10(row.ber_low / theirs.high) if row.ber_low > 0 else -math.inf
    most = math.log10(row.ber_high / theirs.low) if theirs.low > 0 else math.inf
    near = 0.0 if least <= 0 <= most else min(abs(least), abs(most))
    far = max(abs(least), abs(most))
    if row.error_free:
        return max(0.0, math.log10(quoted / row.ber_high)), near, far
    return abs(math.log10(row.ber / quoted)), near, far
