"""The scorecard: the paper's claims (``claims.yaml``) under every reading, and which reading fits best."""

import itertools
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass
from importlib.resources import files
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import yaml

from vocc_torch.measure.estimate import Estimate
from vocc_torch.studies.paper import rates
from vocc_torch.studies.paper.readings import PaperReading
from vocc_torch.studies.paper.rules import (
    RULES,
    VERDICTS,
    Evidence,
    Judgement,
    NotMeasuredError,
    Verdict,
)


@dataclass(frozen=True, eq=False)
class Claim:
    """A row of ``claims.yaml``: something that the paper says and that can be checked.

    Args:
        name: such as ``ambient.lowest.flda_3``.
        where: section and figure of the paper.
        text: what is claimed, in our words.
        paper: what the paper quotes or says.
        rule: a name in ``RULES``.
        arguments: of the rule.
    """

    name: str
    where: str
    text: str
    paper: str
    rule: str
    arguments: Mapping[str, Any]

    @property
    def of_reading(self) -> bool:
        """Whether the verdict depends on the reading; numbers of figures do not."""
        return self.rule != "number"

    def judge(self, evidence: Evidence) -> Judgement | None:
        """Judge the claim; None where its measurement is missing."""
        try:
            return RULES[self.rule](evidence, **self.arguments)
        except NotMeasuredError:
            return None


_FILE = yaml.safe_load(files(__package__).joinpath("claims.yaml").read_text("utf-8"))
CLAIMS = tuple(Claim(**row) for row in _FILE["claims"])
"""Every claim, in the paper's order of sections."""
PARTS: Mapping[str, str] = _FILE["parts"]
"""Headings of the scorecard's parts, by the first word of a claim's name."""
QUOTED = tuple(claim for claim in CLAIMS if "ber" in claim.arguments)
"""The claims that quote a bit error rate."""


def stars(experiment: str) -> dict[str, list[tuple[float, float]]]:
    """Bit error rates that the paper quotes: value of the axis and rate, by receiver.

    Example:
        >>> stars("ambient")
        {'flda_2': [(8000, 0.00066)], 'flda_3': [(8000, 0.0005)]}
    """
    found: dict[str, list[tuple[float, float]]] = {}
    for quoted in (claim.arguments for claim in QUOTED):
        if quoted["experiment"] == experiment:
            star = (quoted["at"], quoted["ber"])
            found.setdefault(quoted["receiver"], []).append(star)
    return found


Line: TypeAlias = tuple[str | float | None, ...]
JUDGED = ("measured", "low", "high", "verdict", "reason")


def ends_of(found: Estimate | None) -> Line:
    """A number and its interval, or nothing three times."""
    return (found.value, found.low, found.high) if found else (None,) * 3


@dataclass(frozen=True)
class Fit:
    """How well a reading fits the paper.

    Args:
        verdicts: on the claims on curves.
        decades: mean distance to the quoted rates, ``|log10 (measured / quoted)|``; None without one.
    """

    verdicts: Mapping[Claim, Verdict]
    decades: Estimate | None

    def count(self, verdict: Verdict) -> int:
        """How many claims on curves have a verdict."""
        return [*self.verdicts.values()].count(verdict)


class Scorecard(NamedTuple):
    """The verdict on each claim under each reading.

    Args:
        readings: the first is reported in full.
        judgements: by reading and claim; claims without a measurement are left out, and those that do not
            depend on the reading stand under the first one alone.
        fits: by reading.
    """

    readings: tuple[PaperReading, ...]
    judgements: Mapping[str, Mapping[Claim, Judgement]]
    fits: Mapping[str, Fit]

    def judged(self, part: str = "") -> dict[Claim, Judgement]:
        """The claims under the first reading, of a part such as ``ambient.``."""
        first = self.judgements[self.readings[0].name]
        return {claim: first[claim] for claim in first if claim.name.startswith(part)}

    def rows(self) -> Iterable[Line]:
        """The lines of ``scorecard.csv``, its head first."""
        yield ("claim", "where", "text", "paper", "reading", *JUDGED)
        for claim, (reading, judged) in itertools.product(
            CLAIMS, self.judgements.items()
        ):
            if found := judged.get(claim):
                yield (
                    claim.name,
                    claim.where,
                    claim.text,
                    claim.paper,
                    reading * claim.of_reading,
                    found.measured,
                    *ends_of(found.interval)[1:],
                    found.verdict,
                    found.reason,
                )

    def fit_rows(self) -> Iterable[Line]:
        """The lines of ``readings.csv``, its head first."""
        yield (
            "reading",
            *VERDICTS,
            "decades",
            "decades_low",
            "decades_high",
            "values",
            "why",
        )
        for reading in self.readings:
            fit = self.fits[reading.name]
            values = yaml.safe_dump(reading.values, default_flow_style=True, width=999)
            yield (
                reading.name,
                *map(fit.count, VERDICTS),
                *ends_of(fit.decades),
                values.strip(),
                reading.why,
            )


def score(
    readings: Sequence[PaperReading], evidence: Mapping[str, Evidence]
) -> Scorecard:
    """Judge every claim under every reading.

    Args:
        readings: the first is reported in full.
        evidence: what was measured, by the reading's name.
    """
    judgements, fits = {}, {}
    for reading in readings:
        found = evidence[reading.name]
        judgements[reading.name] = judged = {
            claim: judgement
            for claim in CLAIMS
            if claim.of_reading or reading is readings[0]
            if (judgement := claim.judge(found))
        }
        verdicts = {at: of.verdict for at, of in judged.items() if at.of_reading}
        fits[reading.name] = Fit(verdicts, distance(found, judged))
    return Scorecard(tuple(readings), judgements, fits)


def distance(evidence: Evidence, judged: Container[Claim]) -> Estimate | None:
    """Mean distance to the quoted rates, in decades; None where none was measured."""
    apart = []
    for claim in QUOTED:
        if claim in judged:
            quoted = claim.arguments
            curves = evidence.experiments[quoted["experiment"]]
            place = quoted["receiver"], quoted["at"], quoted["ber"]
            apart.append(astuple(rates.decades_apart(curves, *place)))
    return Estimate(*np.mean(apart, axis=0).tolist()) if apart else None


class Assumption(NamedTuple):
    """What changing one value alone does, as the mean over pairs of readings that differ in nothing else.

    Args:
        key: of the configuration.
        pairs: the pairs of readings.
        decades: how far the distances to the quoted rates are apart.
        verdicts: how many verdicts change.
    """

    key: str
    pairs: int
    decades: float
    verdicts: float


def assumptions(card: Scorecard) -> list[Assumption]:
    """The assumptions in which readings differ, the one that moves the quoted rates most first."""
    changes: dict[str, list[tuple[float, int]]] = {}
    for first, second in itertools.combinations(card.readings, 2):
        differing = [
            key
            for key in {**first.values, **second.values}
            if first.values.get(key) != second.values.get(key)
        ]
        before, after = card.fits[first.name], card.fits[second.name]
        if len(differing) == 1 and before.decades and after.decades:
            # Both readings have a verdict on the same claims.
            changed = len(before.verdicts.items() - after.verdicts.items())
            moved = abs(before.decades.value - after.decades.value)
            changes.setdefault(differing[0], []).append((moved, changed))
    found = [
        Assumption(key, len(pairs), *np.mean(pairs, axis=0).tolist())
        for key, pairs in changes.items()
    ]
    return sorted(found, key=lambda assumption: -assumption.decades)
