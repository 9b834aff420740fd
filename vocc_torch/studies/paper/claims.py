"""Everything that the paper claims and is checked here: ``claims.yaml``, with the rules that judge it."""

from __future__ import annotations

import inspect
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cache
from importlib.resources import files
from typing import Any, Literal, TypeAlias

import yaml

from vocc_torch.errors import VoccError
from vocc_torch.studies.paper import curve_rules, figure_rules
from vocc_torch.studies.paper.judgement import Judgement, NotMeasuredError, PaperReading

Basis: TypeAlias = Literal["curves", "figures", "arithmetic"]
RULES: dict[str, Callable[..., Judgement]] = {
    "order": curve_rules.order,
    "trend": curve_rules.trend,
    "minimum": curve_rules.minimum,
    "quoted": curve_rules.quoted,
    "number": figure_rules.number,
    "time": figure_rules.time,
    "best_luminance": figure_rules.best_luminance,
    "equation": figure_rules.equation,
}
"""Every rule by its name in ``claims.yaml``."""
_OF_CURVES = ("order", "trend", "minimum", "quoted")


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
        >>> claim = Claim("a.b", "IV-C", "text", "6 %", "equation", {"name": "half_exposure"}, "arithmetic")
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
        then = {
            "agree": "with true corners it agrees",
            "differ": "it differs with true corners too",
            "cannot say": f"with true corners it cannot be said: {at_truth.reason}",
        }[at_truth.verdict]
        return replace(judged, reason=f"{judged.reason}; {then}")


def claims_of(entries: Iterable[Mapping[str, Any]]) -> tuple[Claim, ...]:
    """Read claims from the entries of ``claims.yaml``.

    Raises:
        VoccError: an entry that has no name, place, text, words of the paper or rule, or arguments that the
            rule does not take; or a name that comes twice.

    Example:
        >>> entry = {"claim": "a.b", "where": "IV", "text": "t", "paper": "p"}
        >>> claims_of([entry | {"number": {"highest": "fig04.x"}}])
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: claim a.b: number got an unexpected keyword argument 'highest'
    """
    claims = tuple(map(_claim, entries))
    for name, count in Counter(claim.claim for claim in claims).items():
        if count > 1:
            raise VoccError(f"claim {name} stands {count} times: each must come once")
    return claims


def _claim(entry: Mapping[str, Any]) -> Claim:
    """Read one claim."""
    name = entry.get("claim", "without a name")
    texts = {key: str(entry[key]) for key in ("claim", "where", "text", "paper") if entry.get(key)}
    if len(texts) < 4:
        raise VoccError(f"claim {name} has {', '.join(entry)}: it needs claim, where, text and paper")
    rules = [key for key in entry if key not in (*texts, "basis")]
    if len(rules) != 1 or rules[0] not in RULES:
        raise VoccError(
            f"claim {name} has {', '.join(rules) or 'no rule'}: it needs one of {', '.join(RULES)}"
        )
    [rule] = rules
    try:
        inspect.signature(RULES[rule]).bind(None, **entry[rule])
    except TypeError as error:
        raise VoccError(f"claim {name}: {rule} {error}") from None
    basis: Basis = entry.get("basis", "curves" if rule in _OF_CURVES else "figures")
    return Claim(**texts, rule=rule, arguments=entry[rule], basis=basis)


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


@cache
def _file() -> dict[str, list[dict[str, Any]]]:
    """Read ``claims.yaml``."""
    text = files(__package__).joinpath("claims.yaml").read_text("utf-8")
    found: dict[str, list[dict[str, Any]]] = yaml.safe_load(text)
    return found


CLAIMS = claims_of(_file()["claims"])
"""Every claim, in the paper's order of sections."""
PARTS = tuple(ClaimGroup(one["title"], tuple(one["claims"]), one["anchor"]) for one in _file()["groups"])
"""The scorecard's parts, in the paper's order; a claim stands in the first one that holds it."""
CAUSES: Mapping[str, str] = {one["cause"]: one["text"] for one in _file()["causes"]}
"""What is known of why claims differ, by the name that a rule or a verdict gives it."""
STATEMENTS = tuple(ClaimGroup(one["text"], tuple(one["claims"])) for one in _file()["statements"])
"""The paper's main statements, in the order of its sections."""


def part_of(claim: Claim) -> ClaimGroup:
    """Give the scorecard's part that a claim stands in.

    Example:
        >>> part_of(CLAIMS[0]).anchor
        'score-pictures'
    """
    return next(part for part in PARTS if part.holds(claim))
