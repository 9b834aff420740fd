"""A claim of the paper, and how it is judged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

from vocc_torch.studies.paper.scorecard.explanations import Explanation, with_true_corners
from vocc_torch.studies.paper.scorecard.judgement import Judgement
from vocc_torch.studies.paper.scorecard.reading import Reading

Basis: TypeAlias = Literal["curves", "figures", "arithmetic"]


@dataclass(frozen=True)
class Claim:
    """Something that the paper says and that can be checked.

    Args:
        key: its name, such as ``ambient.lowest.flda_3``.
        where: section and figure of the paper.
        text: what is claimed, in our words.
        paper: what the paper quotes or says.
        rule: judges it under a reading, by the rules of :mod:`.judgement`.
        basis: what it is judged by: ``curves`` of bit error rates, which depend on the reading; ``figures``
            of one sample, with the study's own settings; ``arithmetic`` with the paper's own numbers.
        explanations: reasons that may hold where it differs; each says nothing where its condition fails.

    Example:
        >>> rule = lambda reading: Judgement("agree", reading.name)
        >>> claim = Claim("a.b", "IV-C", "text", "6 %", rule, "arithmetic")
        >>> claim.judge(Reading(25.0, "paper", {}, {})).measured
        '25 mm, paper'
    """

    key: str
    where: str
    text: str
    paper: str
    rule: Callable[[Reading], Judgement]
    basis: Basis = "curves"
    explanations: tuple[Explanation, ...] = ()

    def judge(self, reading: Reading, at_truth: Judgement | None = None) -> Judgement:
        """Judge the claim; where it differs, with every explanation that holds.

        Args:
            reading: what was measured.
            at_truth: how the claim is judged with true corners, if that is not this reading.
        """
        judgement = self.rule(reading)
        if judgement.verdict != "differ":
            return judgement
        texts = [judgement.reason, *(explain(reading, judgement) for explain in self.explanations)]
        if self.basis == "curves":
            texts.append(with_true_corners(at_truth))
        return judgement.because("; ".join(text for text in texts if text))
