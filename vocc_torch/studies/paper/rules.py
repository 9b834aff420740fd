"""The five rules by which claims of the paper are judged: order, trend, minimum, quoted and number.

A verdict is *agree*, *differ* or *cannot say*. Frames are the independent units of every interval. A claim of
m comparisons makes each at 1 - 0.05 / m (Bonferroni): a true claim is contradicted in at most 5 % of studies.

**order, trend.** *Differ* where any comparison contradicts the claim beyond chance; *agree* where none does
and at least half of them support it beyond chance; else *cannot say*.

**minimum.** The values that no other value is surely below hold the true lowest one in 95 % of studies.
*Differ* where the claimed value is not among them. *Agree* where it is the lowest measured or next to it, at
most half of the axis may be the lowest, and at most one of these values saw no error; else *cannot say*.
Without a value, *agree* where some inner value has surely fewer errors than one on either side, *differ*
where an end is surely below all inner values.

**quoted.** The paper's number has the sampling error of its own number of frames. *Differ* where the 95 %
interval of the difference leaves out 0; *agree* where it holds 0 and our interval spans at most a factor of
10 for a rate, 100 points for a gain; else *cannot say*.

**number.** A figure's number with its interval, against limits, or pairs of numbers in ascending order.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, TypeAlias, get_args

from vocc_torch.measure import curve, estimate
from vocc_torch.measure.estimate import Estimate
from vocc_torch.report.styles import place_text, rate_text
from vocc_torch.studies.paper import rates
from vocc_torch.studies.paper.rates import Comparison

Verdict: TypeAlias = Literal["agree", "differ", "cannot say"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)


@dataclass(frozen=True)
class Strictness:
    """Limits of the verdicts.

    Args:
        least_support: share of a claim's comparisons that must support it beyond chance.
        widest_ratio: of the ends of a rate's interval, beyond which it agrees with nothing.
        widest_gain: of a gain's interval, likewise.
    """

    least_support: float = 0.5
    widest_ratio: float = 10.0
    widest_gain: float = 1.0


STRICT = Strictness()


class NotMeasuredError(Exception):
    """A rule asks for something that was not measured."""


@dataclass(eq=False)
class Evidence:
    """What was measured under one reading of the paper.

    Args:
        experiments: curves by experiment: ``contrast``, ``ambient``, ``luminance``, ``distance``.
        numbers: of the other figures, such as ``fig12.auc_ngr``, each with its interval.
    """

    experiments: dict[str, curve.Curves] = field(default_factory=dict)
    numbers: dict[str, Estimate] = field(default_factory=dict)

    def curves(
        self, experiment: str, receivers: Sequence[str], values: Sequence[float] = ()
    ) -> curve.Curves:
        """Give an experiment's curves.

        Raises:
            NotMeasuredError: the experiment, a receiver or a value of its axis is missing.
        """
        found = self.experiments.get(experiment, curve.Curves(()))
        if {*receivers} <= {*found.receivers} and {*values} <= {*found.values}:
            return found
        raise NotMeasuredError(experiment)

    def number(self, name: str) -> Estimate:
        """Give a number.

        Raises:
            NotMeasuredError: it was not computed.
        """
        found = self.numbers.get(name)
        if found is None or not math.isfinite(found.value):
            raise NotMeasuredError(name)
        return found


class Judgement(NamedTuple):
    """What a claim's measurement says; the claim agrees unless something contradicts it or leaves a doubt.

    Args:
        measured: what was measured, in words.
        against: what contradicts the claim.
        doubt: why nothing can be said.
        interval: where the measurement is one number.
    """

    measured: str
    against: str = ""
    doubt: str = ""
    interval: Estimate | None = None

    @property
    def verdict(self) -> Verdict:
        """``agree``, ``differ`` or ``cannot say``."""
        return "differ" if self.against else "cannot say" if self.doubt else "agree"

    @property
    def reason(self) -> str:
        """Why the verdict is not ``agree``; empty where it is."""
        return self.against or self.doubt


def order(
    evidence: Evidence,
    experiments: Sequence[str],
    above: Sequence[str],
    below: Sequence[str],
) -> Judgement:
    """Judge whether some receivers have higher rates than others, at every value of these experiments."""
    found = [
        Comparison(curves, (high, value), (low, value))
        for experiment in experiments
        for curves in [evidence.curves(experiment, [*above, *below])]
        for high, low in itertools.product(above, below)
        for value in curves.values
    ]
    return weighed(found)


def trend(
    evidence: Evidence,
    experiment: str,
    receivers: Sequence[str],
    last: float,
    rises: bool,
    first: float | None = None,
) -> Judgement:
    """Judge whether rates rise or fall along an axis.

    Args:
        evidence: what was measured.
        experiment: its name.
        receivers: whose rates.
        last: the value where the trend ends.
        rises: whether the rates rise.
        first: the value where it begins; every two values between are compared. Without it the lowest value
            of the axis is compared with ``last`` alone.
    """
    curves = evidence.curves(
        experiment, receivers, [last] if first is None else [first, last]
    )
    values = [curves.values[0], last]
    if first is not None:
        values = [value for value in curves.values if first <= value <= last]
    found = [
        Comparison(curves, (receiver, high), (receiver, low))
        for receiver in receivers
        for high, low in itertools.combinations(sorted(values, reverse=rises), 2)
    ]
    return weighed(found)


def weighed(comparisons: Sequence[Comparison]) -> Judgement:
    """Judge a claim that implies all these comparisons.

    Raises:
        NotMeasuredError: there is none.
    """
    if not comparisons:
        raise NotMeasuredError("a comparison")
    confidence = estimate.joint_confidence(len(comparisons))
    differences = [comparison.difference(confidence) for comparison in comparisons]
    support = sum(difference.low > 0 for difference in differences)
    highs = [difference.high for difference in differences]
    against = sum(high < 0 for high in highs)
    surest = comparisons[highs.index(min(highs))]
    enough = support >= STRICT.least_support * len(comparisons)
    return Judgement(
        f"{support} of {len(comparisons)} comparisons support it, {against} contradict it",
        surest.text() if against else "",
        "" if enough else "too few differences are significant",
    )


def minimum(
    evidence: Evidence, experiment: str, receiver: str, at: float | None = None
) -> Judgement:
    """Judge whether a receiver's rate is lowest at a value of the axis, or anywhere inside the axis."""
    curves = evidence.curves(experiment, [receiver], [] if at is None else [at])
    values, candidates = curves.values, rates.candidates(curves, receiver)
    ber = {value: curves.tested(receiver, value).ber for value in values}
    first, *others = (value for value in values if ber[value] == min(ber.values()))
    named = ", ".join(place_text(curves.axis, value) for value in (first, *others))
    measured = f"lowest at {named}; {len(candidates)} of {len(values)} values may be the lowest"
    if at is None:
        return Judgement(measured, *valley(curves, receiver))
    against = doubt = ""
    number = values.index(at)
    if at not in candidates:
        against = f"{rate_text(ber[at])} at {place_text(curves.axis, at)}, {rate_text(ber[first])} there"
    elif 2 * len(candidates) > len(values):
        doubt = "too many to decide"
    elif sum(not ber[value] for value in candidates) > 1:
        doubt = "several values have no errors"
    elif not {first, *others} & {*values[max(0, number - 1) : number + 2]}:
        doubt = "the lowest rate is elsewhere"
    interval = Estimate(first, min(*candidates, first), max(*candidates, first))
    return Judgement(measured, against, doubt, interval)


def valley(curves: curve.Curves, receiver: str) -> tuple[str, str]:
    """Say what contradicts, and what leaves in doubt, that a rate falls, is lowest inside the axis, and rises.

    Raises:
        NotMeasuredError: the axis has no inner value.
    """
    values = curves.values
    if len(values) < 3:
        raise NotMeasuredError(f"an inner value of {curves.axis}")
    confidence = estimate.joint_confidence(estimate.all_pairs(len(values)))

    def is_above(high: float, low: float) -> bool:
        pair = Comparison(curves, (receiver, high), (receiver, low))
        return pair.difference(confidence).low > 0

    inside = values[1:-1]
    for end in (values[0], values[-1]):
        if all(is_above(value, end) for value in inside):
            return f"lowest at an end, {place_text(curves.axis, end)}", ""
    for number, value in enumerate(inside, start=1):
        sides = values[:number], values[number + 1 :]
        if all(any(is_above(other, value) for other in side) for side in sides):
            return "", ""
    return "", "the rise is not significant on both sides"


def quoted(
    evidence: Evidence,
    experiment: str,
    at: float | None = None,
    receiver: str = "flda_3",
    ber: float | None = None,
    gain: float = 0.0,
) -> Judgement:
    """Judge a bit error rate, or a share of two features' errors that three do not make, that is quoted.

    Args:
        evidence: what was measured.
        experiment: its name.
        at: value of the axis; None for the average gain over all values.
        receiver: whose rate.
        ber: the quoted rate; None for a gain.
        gain: the quoted gain, where no rate is quoted.
    """
    values = [] if at is None else [at]
    curves = evidence.curves(experiment, [receiver, "flda_2", "flda_3"], values)
    if ber is not None and at is not None:
        found = curves.rate(receiver, at)
        apart = rates.quoted_difference(curves, receiver, at, ber)
        measured = interval_text(found, rate_text)
        wide = found.high > STRICT.widest_ratio * found.low
        gap = f"{found.value / ber:.2g} times the quoted rate"
    else:
        share = rates.gain(curves, at, gain)
        if share is None:
            return Judgement("no gain", doubt="two features made no error")
        found, apart = share
        measured = interval_text(found, lambda share: f"{100 * share:.0f} %")
        wide = found.high - found.low > STRICT.widest_gain
        gap = f"{100 * (found.value - gain):+.0f} points"
    doubt = "the interval is wide" if wide else ""
    return Judgement(measured, gap if apart.real else "", doubt, found)


def interval_text(found: Estimate, write: Callable[[float], str]) -> str:
    """Write a number with its interval; an exact number stands alone.

    Example:
        >>> interval_text(Estimate(0.24, 0.1, 0.3), "{:.4g}".format)
        '0.24 [0.1, 0.3]'
    """
    ends = (
        f" [{write(found.low)}, {write(found.high)}]" if found.low < found.high else ""
    )
    return write(found.value) + ends


def number(
    evidence: Evidence,
    value: str = "",
    least: float = -math.inf,
    most: float = math.inf,
    ascending: Sequence[tuple[str, str]] = (),
) -> Judgement:
    """Judge whether a number lies within limits, or whether numbers ascend.

    Args:
        evidence: what was measured.
        value: the number's name.
        least: its lower limit.
        most: its upper limit.
        ascending: pairs of names, of which the first is below the second.
    """
    against = doubt = ""
    if value:
        found = evidence.number(value)
        measured = interval_text(found, "{:.4g}".format)
        limits = f"{least:.4g} to {most:.4g}"
        if found.high < least or found.low > most:
            against = limits
        elif found.low < least or found.high > most:
            doubt = limits
        return Judgement(measured, against, doubt, found)
    names = itertools.chain.from_iterable(ascending)
    numbers = {name: evidence.number(name) for name in names}
    measured = ", ".join(f"{name} {found.value:.7g}" for name, found in numbers.items())
    for lower, higher in reversed(ascending):
        if numbers[lower].low > numbers[higher].high:
            against = f"{higher} is lower than {lower}"
        if numbers[lower].high >= numbers[higher].low:
            doubt = "equal, or the intervals overlap"
    return Judgement(measured, against, doubt)


RULES: Mapping[str, Callable[..., Judgement]] = {
    rule.__name__: rule for rule in (order, trend, minimum, quoted, number)
}
"""The rules by their names in ``claims.yaml``."""
