"""The scorecard: the paper's claims (``claims.yaml``) under every reading, and which reading fits best."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import astuple, dataclass
from functools import cached_property
from importlib.resources import files
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import yaml

from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.plan import Plan
from vocc_torch.studies.paper import rates
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
    def part(self) -> str:
        """The first word of its name."""
        return self.name.partition(".")[0]

    @property
    def of_reading(self) -> bool:
        """Whether the verdict depends on the reading; numbers of figures do not."""
        return self.rule != "number"


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


@dataclass(eq=False, kw_only=True)
class PaperReading(Evidence):
    """One way to fill what the paper leaves open, what was measured under it, and how it fits the paper.

    Numbers of figures do not depend on the reading: the first reading alone has them.

    Args:
        name: a word.
        values: by the key of the configuration, such as ``panel.board_reflectance``.
        why: what in the text allows it.
        plan: the study under this reading, at any experiment.
    """

    name: str
    values: Mapping[str, Any]
    why: str
    plan: Plan

    @property
    def locator(self) -> str:
        """Where the panel's corners come from."""
        return self.plan.receiver.locator

    @cached_property
    def judgements(self) -> dict[Claim, Judgement]:
        """What is judged of each claim; claims without a measurement are left out."""
        found = {}
        for claim in CLAIMS:
            with suppress(NotMeasuredError):
                found[claim] = RULES[claim.rule](self, **claim.arguments)
        return found

    def judged(self, part: str) -> dict[Claim, Judgement]:
        """What is judged of a part's claims."""
        judged = self.judgements.items()
        return {claim: found for claim, found in judged if claim.part == part}

    @property
    def verdicts(self) -> dict[Claim, Verdict]:
        """The verdicts on the claims on curves."""
        judged = self.judgements.items()
        return {claim: found.verdict for claim, found in judged if claim.of_reading}

    def count(self, verdict: Verdict) -> int:
        """How many claims on curves have a verdict."""
        return [*self.verdicts.values()].count(verdict)

    @cached_property
    def decades(self) -> Estimate | None:
        """Mean distance to the quoted rates, ``|log10 (measured / quoted)|``; None where none was measured."""
        apart = []
        for claim in QUOTED:
            if claim in self.judgements:
                quoted = claim.arguments
                curves = self.experiments[quoted["experiment"]]
                place = quoted["receiver"], quoted["at"], quoted["ber"]
                apart.append(astuple(rates.decades_apart(curves, *place)))
        return Estimate(*np.mean(apart, axis=0).tolist()) if apart else None


Line: TypeAlias = tuple[str | float | None, ...]


def ends_of(found: Estimate | None) -> Line:
    """A number and its interval, or nothing three times."""
    return (found.value, found.low, found.high) if found else (None,) * 3


def claim_rows(readings: Sequence[PaperReading]) -> Iterator[Line]:
    """The lines of ``scorecard.csv``, its head first: each claim under each reading."""
    head = "claim", "where", "text", "paper", "reading"
    yield (*head, "measured", "low", "high", "verdict", "reason")
    for claim, reading in itertools.product(CLAIMS, readings):
        if found := reading.judgements.get(claim):
            yield (
                claim.name,
                claim.where,
                claim.text,
                claim.paper,
                reading.name * claim.of_reading,
                found.measured,
                *ends_of(found.interval)[1:],
                found.verdict,
                found.reason,
            )


def fit_rows(readings: Sequence[PaperReading]) -> Iterator[Line]:
    """The lines of ``readings.csv``, its head first: how well each reading fits the paper."""
    distance = "decades", "decades_low", "decades_high"
    yield ("reading", *VERDICTS, *distance, "values", "why")
    for reading in readings:
        counts = map(reading.count, VERDICTS)
        values = yaml.safe_dump(reading.values, default_flow_style=True, width=999)
        text = values.strip(), reading.why
        yield (reading.name, *counts, *ends_of(reading.decades), *text)


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


def assumptions(readings: Sequence[PaperReading]) -> list[Assumption]:
    """The assumptions in which readings differ, the one that moves the quoted rates most first."""
    changes: dict[str, list[tuple[float, int]]] = {}
    for first, second in itertools.combinations(readings, 2):
        differing = [
            key
            for key in {**first.values, **second.values}
            if first.values.get(key) != second.values.get(key)
        ]
        if len(differing) == 1 and first.decades and second.decades:
            # Both readings have a verdict on the same claims.
            changed = len(first.verdicts.items() - second.verdicts.items())
            moved = abs(first.decades.value - second.decades.value)
            changes.setdefault(differing[0], []).append((moved, changed))
    found = [
        Assumption(key, len(pairs), *np.mean(pairs, axis=0).tolist())
        for key, pairs in changes.items()
    ]
    return sorted(found, key=lambda assumption: -assumption.decades)
