"""The paper's main statements: each stands on several claims of the scorecard."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Literal

from vocc_torch.show.report.document import Tone
from vocc_torch.studies.paper.report.groups import Judged, counted
from vocc_torch.studies.paper.report.words import EXPERIMENTS
from vocc_torch.studies.paper.scorecard import Reading, Scorecard, Verdict
from vocc_torch.studies.paper.scorecard.explanations import Explanation, one_rule_for_all, own_preamble
from vocc_torch.studies.paper.scorecard.quoted import QUOTED_BERS

Outcome = Literal["holds", "holds in part", "does not hold", "cannot say"]
OUTCOME_TONES: dict[Outcome, Tone | None] = {
    "holds": "agree",
    "holds in part": None,
    "does not hold": "differ",
    "cannot say": "unsure",
}
"""How each outcome is shown."""


@dataclass(frozen=True)
class Statement:
    """Something that the paper says in sum.

    Args:
        text: what it says, in our words.
        keys: patterns of the keys of its claims.
        anchor: the section of the scorecard with its claims.
    """

    text: str
    keys: tuple[str, ...]
    anchor: str

    def claims(self, scorecard: Scorecard, reading: Reading | None = None) -> tuple[Judged, ...]:
        """Give its claims as judged under a reading, by default the report's own."""
        return tuple(
            (claim, scorecard.of(claim, reading))
            for claim in scorecard.claims
            if any(fnmatchcase(claim.key, key) for key in self.keys)
        )


def _each(key: str) -> tuple[str, ...]:
    """Give the pattern of a claim that is made of every experiment."""
    return tuple(f"{experiment}.{key}" for experiment in EXPERIMENTS)


STATEMENTS = (
    Statement(
        "AGR alone and GRI alone make fewer errors than greyscale",
        ("features.agr_alone.*", "features.gri_alone.*"),
        "score-features",
    ),
    Statement(
        "NGR alone is useless",
        ("features.ngr_alone", "figures.ngr_alone"),
        "score-features",
    ),
    Statement(
        "the more features together, the fewer errors",
        ("features.agr_and_gri", "features.ngr_helps_agr", "features.three_best"),
        "score-features",
    ),
    Statement(
        "two and three features make fewer errors than both greyscale receivers, everywhere",
        _each("superior.*"),
        "score-contrast",
    ),
    Statement(
        "three features make fewer errors than two, everywhere", _each("ngr_improves"), "score-contrast"
    ),
    Statement(
        "the order is centre greyscale (worst), average greyscale, two, three features, everywhere",
        _each("order"),
        "score-contrast",
    ),
    Statement(
        "error rates fall and rise again with contrast and with ambient light",
        ("contrast.valley.*", "ambient.valley.*"),
        "score-contrast",
    ),
    Statement("the contrast of the frames spans 6 to 54 %", ("contrast.range.*",), "score-contrast"),
    Statement(
        "error rates are lowest at 4000 lx for greyscale and at 8000 lx for the proposed receivers",
        ("ambient.lowest.*",),
        "score-ambient",
    ),
    Statement(
        "error rates of all receivers are lowest at an LED luminance of 4000 cd/m2",
        ("luminance.lowest.*",),
        "score-luminance",
    ),
    Statement(
        "error rates fall up to an LED luminance of 4000 cd/m2 and rise beyond",
        ("luminance.falls.*", "luminance.rises.*"),
        "score-luminance",
    ),
    Statement("error rates rise with distance", ("distance.rises.*",), "score-distance"),
    Statement(
        "the four quoted error rates, 3.9e-4 to 6.6e-4",
        ("contrast.ber.*", "ambient.ber.*"),
        "score-ambient",
    ),
    Statement(
        "the five quoted shares of errors that NGR saves, 11 to 30 %",
        (*_each("gain"), "contrast.gain.average"),
        "score-contrast",
    ),
    Statement("the quoted processing times", ("time.*",), "score-time"),
    Statement(
        "the best LED luminance depends on the ambient light",
        ("discussion.dimming.*",),
        "score-discussion",
    ),
)
"""The paper's main statements, in the order of its sections."""


def outcome(claims: Iterable[Judged]) -> Outcome:
    """Sum claims up: in part where some agree and some differ; a few that agree do not speak for the others.

    Example:
        >>> outcome([])
        'cannot say'
    """
    found = counted(claims)
    if found["differ"]:
        return "holds in part" if found["agree"] else "does not hold"
    return "holds" if found["agree"] > found["cannot say"] else "cannot say"


def at_truth(scorecard: Scorecard) -> Reading | None:
    """Give the report's own reading with true corners; None where that is it, or was not measured."""
    own = scorecard.default
    others = (one for one in scorecard.readings if one.focal_length_mm == own.focal_length_mm)
    return next((one for one in others if one.locator == "truth" != own.locator), None)


@dataclass(frozen=True)
class Cause:
    """A reason that holds for several claims.

    Args:
        text: the reason.
        claims: how many of the claims that differ it holds for.
    """

    text: str
    claims: int


def causes(scorecard: Scorecard, claims: Iterable[Judged]) -> tuple[Cause, ...]:
    """Give the reasons that the scorecard knows for claims that differ.

    Args:
        scorecard: the claims and readings.
        claims: any claims; those that do not differ are passed over.
    """
    differing = [(claim, judged) for claim, judged in claims if judged.verdict == "differ"]
    truth = at_truth(scorecard)

    def explained(explain: Explanation) -> Callable[[Judged], bool]:
        return lambda one: explain in one[0].explanations and bool(explain(scorecard.default, one[1]))

    def with_true_corners(verdict: Verdict) -> Callable[[Judged], bool]:
        return lambda one: (
            one[0].basis == "curves" and truth is not None and scorecard.of(one[0], truth).verdict == verdict
        )

    known: dict[str, Callable[[Judged], bool]] = {
        "the centre greyscale is better than in the paper: its threshold comes from preambles of the very "
        "same scene": explained(own_preamble),
        "at low contrast one linear rule for all scenes loses to a greyscale receiver with preambles": (
            explained(one_rule_for_all)
        ),
        "with true corners it agrees": with_true_corners("agree"),
        "the quoted rate lies between those with the panel located and with true corners": (
            lambda one: _between(scorecard.default, one[0].key)
        ),
        "with true corners these frames cannot decide": with_true_corners("cannot say"),
    }
    found = [Cause(text, sum(map(holds, differing))) for text, holds in known.items()]
    return tuple(cause for cause in found if cause.claims)


def _between(reading: Reading, key: str) -> bool:
    """Whether a quoted rate lies between that of the located panel and that of its true corners."""
    for quoted in QUOTED_BERS:
        if key != f"{quoted.experiment}.ber.{quoted.receiver}":
            continue
        measured = reading.experiments.get(quoted.experiment)
        if measured is None or not {"paper", "truth"} <= set(measured.curves):
            return False
        located, truth = (
            reading.located_by(name).row(quoted.experiment, quoted.receiver, quoted.value)
            for name in ("paper", "truth")
        )
        return located is not None and truth is not None and truth.ber < quoted.ber < located.ber
    return False
