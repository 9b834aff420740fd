"""What is said of a claim, and the rules by which it is said.

A claim is never called wrong for what chance can do. Frames are the independent units in every interval, and
an interval has 95 %. Where a claim implies m comparisons, each is made at 1 - 0.05 / m (Bonferroni), so a
true claim is contradicted by any of them in at most 5 % of studies, whatever its size and however many frames
there are. A finer measurement therefore turns *cannot say* into one of the other verdicts, and a true claim
into *differ* only at that rate.

**An order** (one receiver above another, a rise, a fall). Receivers on the same frames are compared frame by
frame (:func:`~vocc_torch.measure.paired.paired_interval`), values of an axis as independent points
(:func:`~vocc_torch.measure.relative.difference_independent`). *Differ* where any comparison contradicts
the claim beyond doubt; *agree* where none does and at least half of them support it beyond doubt; else
*cannot say*, with the counts.

**A lowest point at x.** The values that no other value is surely below form a set that holds the true lowest
one in 95 % of studies. *Differ* where x is not in it. *Cannot say* where the set is the whole axis, or where
x is in it and two or more of its values saw no error, because then the lowest was not resolved. *Agree* where
x, in the set, is the lowest value measured or next to it on the axis; else *cannot say*.

**A valley.** *Agree* where some value inside the axis has surely more errors on both sides; *differ* where an
end of the axis is surely below everything between the ends; else *cannot say*.

**A quoted bit error rate.** The paper's number has a sampling error of its own, which it does not state. It
is taken to be that of as many errors as the number stands for in the paper's frames (2000 a point; for a
contrast bin the bin's share of 20000), clustered by frame as ours are at that point. *Differ* where the 95 %
interval of the difference of the two rates leaves out 0; *agree* where it holds 0 and our interval spans no
more than a factor of 10; else *cannot say*.

**A quoted gain** (share of one receiver's errors that another one does not make). Its sampling error is taken
to be ours, scaled from our number of frames to the paper's. *Differ* where the interval of the difference
leaves out 0; *agree* where it holds 0 and our interval is no wider than 100 percentage points; else *cannot
say*, as where no error was seen. A share with a wider interval is written as not known.

**Numbers of single pictures and of samples of 100 frames** are compared as they are: they have no interval,
in the paper as here.

**Processing times** are ratios on one machine, with other software, of whole frames one at a time as in the
paper. *Cannot say* where the quartiles over the rounds are farther apart than a factor of 2, or where the
processor was busy with something else for more than 5 % of the time; *agree* where the median is within a
factor of 1.5 of the quoted ratio; else *differ*. An order of times, and "much longer" (twice at least), hold
where the quartiles do not overlap: *agree* or *differ* by them, else *cannot say*.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, TypeAlias

if TYPE_CHECKING:
    from vocc_torch.studies.paper.scorecard.comparisons import Comparison

Verdict: TypeAlias = Literal["agree", "differ", "cannot say"]
VERDICTS: tuple[Verdict, ...] = ("agree", "differ", "cannot say")
"""Every verdict, in the order of the tallies."""

ERROR_RATE = 0.05
"""How often a true claim may be contradicted by chance."""


@dataclass(frozen=True)
class Judgement:
    """A verdict with what it rests on.

    Args:
        verdict: ``agree``, ``differ`` or ``cannot say``.
        measured: what was measured, with its interval, in words.
        reason: why the verdict is not ``agree``; may be empty.
        low: lower end of the interval, where the measurement is one number.
        high: its upper end.
        against: the comparisons that contradict the claim beyond doubt, the surest first.

    Example:
        >>> Judgement("agree", "5.2e-4 [3.9e-4, 6.8e-4]", low=3.9e-4, high=6.8e-4).reason
        ''
    """

    verdict: Verdict
    measured: str
    reason: str = ""
    low: float | None = None
    high: float | None = None
    against: tuple[Comparison, ...] = ()

    def because(self, reason: str) -> Judgement:
        """Give the same judgement for a fuller reason."""
        return replace(self, reason=reason)


def not_measured(what: str) -> Judgement:
    """Say that there is nothing to judge by.

    Example:
        >>> not_measured("experiment distance").verdict
        'cannot say'
    """
    return Judgement("cannot say", "not measured", f"{what} was not measured")
