"""The scorecard: the paper's claims (``claims.yaml``) under every reading, and which reading fits best."""

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import yaml

from vocc_torch.measure.estimate import Estimate
from vocc_torch.studies.paper import rates
from vocc_torch.studies.paper.readings import Reading
from vocc_torch.studies.paper.rules import (
    RULES,
    VERDICTS,
    Evidence,
    Judgement,
    NotMeasuredError,
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
QUOTED = tuple(claim for claim in CLAIMS if claim.rule == "quoted")


def stars(experiment: str) -> dict[str, list[tuple[float, float]]]:
    """Bit error rates that the paper quotes: value of the axis and rate, by receiver.

    Example:
        >>> stars("ambient")
        {'flda_2': [(8000, 0.00066)], 'flda_3': [(8000, 0.0005)]}
    """
    found: dict[str, list[tuple[float, float]]] = {}
    for claim in QUOTED:
        quoted = claim.arguments
        if quoted["experiment"] == experiment and "ber" in quoted:
            found.setdefault(quoted["receiver"], []).append(
                (quoted["at"], quoted["ber"])
            )
    return found


@dataclass(frozen=True)
class Fit:
    """How well a reading fits the paper.

    Args:
        verdicts: how many claims on curves have each verdict.
        decades: mean distance to the quoted rates, ``|log10 (measured / quoted)|``; None without one.
        gain_points: mean distance to the quoted gains, percentage points; None without one.
    """

    verdicts: Mapping[str, int]
    decades: Estimate | None
    gain_points: float | None


@dataclass(frozen=True)
class Scorecard:
    """What is said of each claim under each reading.

    Args:
        readings: the first is reported in full.
        judgements: by claim and reading; claims without a measurement are left out, and those that do not
            depend on the reading stand under the first one alone.
        fits: by reading.
    """

    readings: tuple[Reading, ...]
    judgements: Mapping[tuple[Claim, str], Judgement]
    fits: Mapping[str, Fit]

    def judged(self, part: str = "", figure: str = "") -> dict[Claim, Judgement]:
        """The claims under the first reading, of a part or on a figure such as ``Fig. 22``."""
        return {
            claim: judgement
            for (claim, reading), judgement in self.judgements.items()
            if reading == self.readings[0].name
            and claim.name.startswith(part)
            and figure in claim.where.replace("Figs", "Fig.")
        }

    def rows(self) -> Iterable[tuple[str | float | None, ...]]:
        """The lines of ``scorecard.csv``, its head first."""
        yield (
            "claim",
            "where",
            "text",
            "paper",
            "reading",
            "measured",
            "low",
            "high",
            "verdict",
            "reason",
        )
        for (claim, reading), judgement in self.judgements.items():
            interval = judgement.interval
            ends = (interval.low, interval.high) if interval else (None, None)
            about = (
                claim.name,
                claim.where,
                claim.text,
                claim.paper,
                reading if claim.of_reading else "",
            )
            yield (
                *about,
                judgement.measured,
                *ends,
                judgement.verdict,
                judgement.reason,
            )

    def fit_rows(self) -> Iterable[tuple[str | float | None, ...]]:
        """The lines of ``readings.csv``, its head first."""
        yield (
            "reading",
            *VERDICTS,
            "decades",
            "decades_low",
            "decades_high",
            "gain_points",
            "values",
            "why",
        )
        for reading in self.readings:
            fit, values = (
                self.fits[reading.name],
                yaml.safe_dump(reading.values, default_flow_style=True),
            )
            ends = (
                (fit.decades.value, fit.decades.low, fit.decades.high)
                if fit.decades
                else (None,) * 3
            )
            counts = (fit.verdicts.get(verdict, 0) for verdict in VERDICTS)
            yield (
                reading.name,
                *counts,
                *ends,
                fit.gain_points,
                values.strip(),
                reading.why,
            )


def score(readings: Sequence[Reading], evidence: Mapping[str, Evidence]) -> Scorecard:
    """Judge every claim under every reading.

    Args:
        readings: the first is reported in full.
        evidence: what was measured, by the reading's name.
    """
    judgements = {}
    for claim in CLAIMS:
        for reading in readings if claim.of_reading else readings[:1]:
            if (judgement := claim.judge(evidence[reading.name])) is not None:
                judgements[claim, reading.name] = judgement
    fits = {}
    for reading in readings:
        verdicts: Counter[str] = Counter(
            judgement.verdict
            for (claim, name), judgement in judgements.items()
            if claim.of_reading and name == reading.name
        )
        fits[reading.name] = Fit(verdicts, *distances(evidence[reading.name]))
    return Scorecard(tuple(readings), judgements, fits)


def distances(evidence: Evidence) -> tuple[Estimate | None, float | None]:
    """Mean distances to the quoted rates, in decades, and to the quoted gains, in points."""
    apart: list[tuple[float, float, float]] = []
    points: list[float] = []
    for claim in QUOTED:
        quoted = claim.arguments
        if claim.judge(evidence) is None:
            continue
        curves, value = evidence.experiments[quoted["experiment"]], quoted.get("at")
        if "ber" in quoted:
            found = rates.decades_apart(
                curves, quoted["receiver"], quoted["at"], quoted["ber"]
            )
            apart.append((found.value, found.low, found.high))
        elif (gain := rates.gain(curves, value)) is not None:
            points.append(100 * abs(gain.value - quoted["gain"]))
    means = [math.fsum(column) / len(apart) for column in zip(*apart, strict=True)]
    return Estimate(*means) if means else None, math.fsum(points) / len(
        points
    ) if points else None


@dataclass(frozen=True)
class Assumption:
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
        keys = [
            key
            for key, value in first.values.items()
            if second.values.get(key, value) != value
        ]
        both = [card.fits[reading.name].decades for reading in (first, second)]
        if (
            len(keys) != 1
            or {*first.values} != {*second.values}
            or both[0] is None
            or both[1] is None
        ):
            continue
        changed = sum(
            judgement.verdict != card.judgements[claim, second.name].verdict
            for (claim, name), judgement in card.judgements.items()
            if name == first.name and (claim, second.name) in card.judgements
        )
        changes.setdefault(keys[0], []).append(
            (abs(both[0].value - both[1].value), changed)
        )
    means = [
        Assumption(
            key,
            len(pairs),
            *(math.fsum(column) / len(pairs) for column in zip(*pairs, strict=True)),
        )
        for key, pairs in changes.items()
    ]
    return sorted(means, key=lambda found: -found.decades)
