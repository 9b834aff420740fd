"""Two receivers on the same frames: the difference of their bit error rates, and its interval.

Most frames are equally difficult for both receivers. In a comparison frame by frame this common difficulty
cancels. So much smaller differences are significant than with two separate intervals.

A t interval of the mean difference would be symmetric. If few frames differ, most differences are 0, their
sum has a skewed distribution, and the sample often underestimates the spread. With three discordant frames
expected, all in one direction, the t interval covers about 80 % instead of 95 %.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Self

from scipy.special import betainc

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval, clustered_interval


@dataclass(frozen=True, slots=True)
class PairedCounts:
    """By how much one receiver, a, did worse than another, b, on the same frames.

    Frames in which both have equally many wrong bits do not contribute. The other frames are *discordant*:
    those in which a is worse and those in which b is worse are counted separately, because the interval needs
    both sides.

    Args:
        a: errors of a beyond those of b, in the frames where a had more; its ``frame_errors`` are these frames.
        b: likewise of b beyond those of a.

    Example:
        >>> paired = PairedCounts(Counts(64, 4096, 6, 20, 2), Counts(64, 4096))
        >>> total = sum([paired, paired], PairedCounts())
        >>> total.half_difference, total.half_difference_squared, total.discordant
        (12, 40, 4)
    """

    a: Counts = field(default_factory=Counts)
    b: Counts = field(default_factory=Counts)

    def __add__(self, other: Self) -> Self:
        """Join what was counted on disjoint frames."""
        if type(other) is not type(self):
            return NotImplemented
        return type(self)(self.a + other.a, self.b + other.b)

    @property
    def frames(self) -> int:
        """Frames compared."""
        return self.a.frames

    @property
    def half_difference(self) -> int:
        """Sum over the frames of a's half errors less b's."""
        return self.a.half_errors - self.b.half_errors

    @property
    def half_difference_squared(self) -> int:
        """Sum over the frames of the square of a's half errors less b's."""
        return self.a.half_errors_squared + self.b.half_errors_squared

    @property
    def spread(self) -> int:
        """Variance of the half difference between frames, times the square of the frames: whole, so exact."""
        return self.frames * self.half_difference_squared - self.half_difference**2

    @property
    def discordant(self) -> int:
        """Frames in which one receiver had more errors than the other."""
        return self.a.frame_errors + self.b.frame_errors


def paired_interval(
    paired: PairedCounts,
    confidence: float = 0.95,
    errors_per_discordant_frame: float = 1.0,
) -> Estimate:
    """The interval of the difference of two bit error rates, with frames as the independent units.

    **Some frames differ.** The difference is that of two rates: of a's errors beyond b's, and of b's beyond
    a's, each with its :func:`excess_interval`. They are joined by the method of variance estimates recovery,
    :meth:`~vocc_torch.measure.estimate.Estimate.less`. Within a frame the two exclude each other, so they are
    correlated by -(product of means) / (product of standard deviations). That is next to nothing where few
    frames differ; where most do, leaving it out would cost up to 6 points of coverage.

    **No frame differs.** ``low`` and ``high`` are then limits of the size of the difference: a frame differs
    with a probability of at most ``1 - (1 - confidence)^(1 / frames)``, and no more than
    ``errors_per_discordant_frame`` bits are taken to differ in it.

    As with :func:`~vocc_torch.measure.intervals.ber_interval`, nothing covers a kind of frame that is so
    rare that none came up though its many errors make up much of the difference.

    Args:
        paired: at least one frame; where frames differ, at most ``intervals.MOST_TRIALS`` bits.
        confidence: above 0, below 1.
        errors_per_discordant_frame: mean difference in a discordant frame, in bits, above 0, at most the bits
            of a frame; used only where no frame differs.

    Example:
        >>> a, b = Counts(2000, 128_000, 60, 160, 25), Counts(2000, 128_000, 20, 40, 10)
        >>> interval = paired_interval(PairedCounts(a, b))
        >>> f"{interval.value:.2e} in [{interval.low:.2e}, {interval.high:.2e}]", interval.real
        ('1.56e-04 in [4.27e-05, 2.86e-04]', True)
    """
    if not paired.discordant:
        limit = ber_interval(paired.a, confidence, errors_per_discordant_frame).high
        return Estimate(0.0, -limit, limit)
    a, b = (excess_interval(side, paired, confidence) for side in (paired.a, paired.b))
    correlation = _correlation(paired.a.spread, paired.b.spread, paired.spread)
    return a.less(b, correlation).clipped(-1.0, 1.0)


def excess_interval(side: Counts, paired: PairedCounts, confidence: float) -> Estimate:
    """Return the interval of the rate by which one receiver's errors exceed the other's.

    As in :func:`~vocc_torch.measure.intervals.ber_interval` this is Clopper and Pearson's interval with an
    effective number of trials, a t quantile for the uncertainty of this number, and the limits from the
    binomial number of frames. A side with few frames uses the size of the differences on both sides: its
    spread is computed with one more frame of the common size, ``sum d^2 / sum |d|`` over the frames'
    differences d, and the degrees of freedom are those of both sides together. Otherwise a single frame in
    which b is worse would hide 20 frames in which a is worse.

    Args:
        side: the excess of one receiver.
        paired: the comparison, at least one frame of which differs.
        confidence: above 0, below 1.
    """
    leds, rate = side.bits / side.frames, side.ber
    summed = paired.a.half_errors + paired.b.half_errors
    common = paired.half_difference_squared / summed
    size = (side.half_errors_squared + common**2) / (side.half_errors + common) / 2
    effect = leds
    if paired.frames > 1:
        # The variance of a frame's errors over that of as many independent bits of the same rate.
        variance_ratio = (size - leds * rate) / (1 - rate) if rate < 1 else 1.0
        effect = max(1.0, variance_ratio * paired.frames / (paired.frames - 1))
    # A frame's difference is one bit at least and all its bits at most. Only the half that a missed panel of
    # an odd number of LEDs counts can be half a bit from what the other receiver got wrong.
    fewest = 1.0 if leds % 2 == 0 else 0.5
    return clustered_interval(side, effect, summed / common, fewest, confidence)


def sign_test(paired: PairedCounts) -> float:
    """Return the exact two-sided p-value of the sign test on the discordant frames.

    If the receivers were equals, each would be the worse in half the discordant frames, whatever the sizes of
    the differences. It takes no account of sizes and can disagree with :func:`paired_interval`: a receiver
    that is a little better in most frames and far worse in a few has the better count of frames and the
    worse bit error rate.

    Args:
        paired: the comparison.

    Returns:
        The p-value, 0 to 1; 1 where no frame differs.

    Example:
        >>> sign_test(PairedCounts(Counts(64, 4096, 12, 24, 6)))
        0.03125
    """
    fewer, larger = sorted((paired.a.frame_errors, paired.b.frame_errors))
    # At even odds both tails are alike; where the sides are too, they overlap.
    return min(1.0, 2 * float(betainc(larger, fewer + 1, 0.5)))


def relative_gain(
    a: Counts, b: Counts, paired: PairedCounts, confidence: float = 0.95
) -> Estimate | None:
    """Give the relative gain of receiver b over receiver a on the same frames, and its interval.

    The gain is the difference of the two rates over the rate of a. Both have intervals that hold with few
    errors, :func:`~vocc_torch.measure.paired.paired_interval` and
    :func:`~vocc_torch.measure.intervals.ber_interval`, and they are joined by the method of variance
    estimates recovery for ratios (Donner and Zou, Statistical Methods in Medical Research 21, 2012,
    "Closed-form confidence intervals for functions of the normal mean and standard deviation"): g lies in the
    interval if ``difference - g * rate`` may be 0, given their correlation over the frames. The gain is then
    real exactly where the paired difference is.

    The method also applies to the ratio of the two rates. If a and b are wrong in the same frames, the
    interval of this ratio is far too narrow, however few the frames are. If b has hardly any errors of a, the
    interval of difference and rate is too narrow: its low end loses up to 6 points of coverage. A low end
    above 0 is therefore the lower of the two. It is not set below the low end of the difference divided by
    the high end of the rate of a.

    Args:
        a: counts of the receiver compared against.
        b: counts of the other on the same frames.
        paired: the comparison of a with b.
        confidence: above 0, below 1.

    Returns:
        The gain, or None if a has no error, which leaves the gain undefined.

    Example:
        >>> a, b = Counts(2000, 128_000, 160, 600, 60), Counts(2000, 128_000, 120, 400, 50)
        >>> more, fewer = Counts(2000, 128_000, 60, 160, 25), Counts(2000, 128_000, 20, 40, 10)
        >>> gain = relative_gain(a, b, PairedCounts(more, fewer))
        >>> f"{gain.value:.2f} in [{gain.low:.2f}, {gain.high:.2f}]", gain.real
        ('0.25 in [0.08, 0.42]', True)
    """
    difference = paired_interval(paired, confidence)
    if not a.half_errors:
        return None
    rate, gain = ber_interval(a, confidence), difference.value / a.ber
    spreads = a.spread, b.spread, paired.spread
    ends = mover_ratio(difference, rate, _correlation(spreads[2], *spreads[:2]))
    low = ends.low
    if low > 0:
        most = Estimate(b.ber, b.ber, _two_sided(b, a, confidence).high)
        left = mover_ratio(most, rate, _correlation(*spreads)).high
        low = min(low, max(1 - left, difference.low / rate.high))
    return Estimate(gain, min(low, gain), min(1.0, max(ends.high, gain)))


def _correlation(first: int, second: int, difference: int) -> float:
    """Give the correlation of two quantities from their variances and that of their difference."""
    if not first or not second:
        return 0.0
    shared = (first + second - difference) / 2 / math.sqrt(first) / math.sqrt(second)
    return max(-1.0, min(1.0, shared))


def mean_gain(
    points: Iterable[tuple[Counts, Counts, PairedCounts]],
) -> Estimate | None:
    """Average the relative gain over several points of an axis, such as bins of contrast.

    Every point counts the same, however many errors it has. The points are independent, and their intervals
    are joined by variance estimates recovery: the distance of the average's low end is the root of the summed
    squares of the points' distances to their low ends, over their number, and likewise for the high end.
    A point with few errors widens it for all. The gain of all errors together, in which each point weighs by
    its errors, is :func:`relative_gain` of the summed counts.

    Points at which a made no error are left out. Such a choice favours points where a was unlucky: with many
    left out, read the average with care.

    Args:
        points: ``(a, b, paired)`` of each point, on frames that no two points share.

    Returns:
        The average, or None where a made no error anywhere.

    Example:
        >>> a, b = Counts(2000, 128_000, 160, 600, 60), Counts(2000, 128_000, 120, 400, 50)
        >>> more, fewer = Counts(2000, 128_000, 60, 160, 25), Counts(2000, 128_000, 20, 40, 10)
        >>> both = a, b, PairedCounts(more, fewer)
        >>> one, four = mean_gain([both]), mean_gain([both] * 4)
        >>> f"{one.high - one.value:.2f} {four.high - four.value:.2f}"
        '0.17 0.09'
    """
    gains = [gain for pair in points if (gain := relative_gain(*pair)) is not None]
    if not gains:
        return None
    mean = math.fsum(gain.value for gain in gains) / len(gains)
    low = mean - math.hypot(*(gain.value - gain.low for gain in gains)) / len(gains)
    high = mean + math.hypot(*(gain.high - gain.value for gain in gains)) / len(gains)
    return Estimate(mean, low, min(1.0, high))


def difference_independent(a: Counts, b: Counts, confidence: float = 0.95) -> Estimate:
    """Give the interval of the difference of two rates on different frames, such as two values of an axis.

    Is the rate at 4000 lx really lower than at 8000 lx? The two rates' own intervals are joined by variance
    estimates recovery, :meth:`~vocc_torch.measure.estimate.Estimate.less`. A side without errors has the
    two-sided limit, with wrong frames of the size that the other side's have.

    Args:
        a: counts at one point, at least one frame.
        b: counts at the other, on frames of its own.
        confidence: above 0, below 1.

    Example:
        >>> many, few = Counts(2000, 128_000, 160, 600, 60), Counts(2000, 128_000, 40, 120, 15)
        >>> interval = difference_independent(many, few)
        >>> f"{interval.value:.1e} in [{interval.low:.1e}, {interval.high:.1e}]", interval.real
        ('4.7e-04 in [2.5e-04, 7.0e-04]', True)
    """
    first, second = _two_sided(a, b, confidence), _two_sided(b, a, confidence)
    return first.less(second).clipped(-1.0, 1.0)


def _two_sided(counts: Counts, other: Counts, confidence: float) -> Estimate:
    """Give a rate's interval; wrong frames of an error-free one have the size of the other's."""
    if not counts.half_errors:
        # The limit of an error-free point is one-sided; a two-sided interval leaves half as much above it.
        confidence = min((1 + confidence) / 2, math.nextafter(1.0, 0.0))
    return ber_interval(counts, confidence, other.errors_per_frame_error)


def mover_ratio(over: Estimate, under: Estimate, correlation: float = 0.0) -> Estimate:
    """Join the intervals of two numbers to that of their ratio, by variance estimates recovery.

    Donner and Zou (Statistical Methods in Medical Research 21, 2012, "Closed-form confidence intervals for
    functions of the normal mean and standard deviation"): g lies in the interval if ``over - g * under`` may
    be 0. Without the correlation, where the two go together, it is wider than need be.

    Args:
        over: the number above the line.
        under: the rate below the line, above 0.
        correlation: of the two, -1 to 1.

    Returns:
        ``low`` to ``high``, which may be above 1, and is infinite where the rate below the line may be 0.
        Where ``over`` is 0, low is 0 and high a limit of the same confidence as its own high end. A rate
        below the line whose high end is more than twice the rate leaves low above 0 as long as that of the
        number above the line is.

    Example:
        >>> ends = mover_ratio(Estimate(0.02, 0.01, 0.04), Estimate(0.2, 0.19, 0.21))
        >>> f"{ends.low:.3f} to {ends.high:.3f}"
        '0.050 to 0.201'
    """
    rate = under.value

    def least(value: float, low: float, shared: float) -> float:
        # A positive g subtracts the rate, which is then feared at its high end; a negative one adds it.
        below, aside = value - low, under.high - rate if low > 0 else rate - under.low
        # Squared, the condition is a g^2 - 2 b g + c = 0; wanted is the root below value / rate. Differences
        # of squares are products, or a rate that is known badly would lose its low end to rounding.
        near = 2 * rate - under.high if low > 0 else under.low
        a, c = near * (rate + aside), low * (value + below)
        b = value * rate - shared * below * aside
        root = math.sqrt(max(0.0, b * b - a * c))
        if a == 0 and b <= 0:
            return -math.inf if b or c else 0.0
        return c / (b + root) if b > 0 or a <= 0 else (b - root) / a

    high = -least(-over.value, -over.high, -correlation)
    return Estimate(over.value / rate, least(over.value, over.low, correlation), high)


def rate_ratio(
    reference: Counts, receiver: Counts, paired: PairedCounts
) -> Estimate | None:
    """Give a receiver's bit error rate over the reference's.

    Two intervals have 95 % confidence: that of :func:`mover_ratio`, from the separate intervals of the rates,
    and that of 1 minus the relative gain, which accounts for shared errors. The first is narrower if the
    rates differ much, the second if most errors are shared. The result is their intersection. In simulated
    pairs of 256 to 4096 frames with shared, independent and clustered errors at most 4 % of the results
    missed the true ratio (a test has the most difficult case). If the paired interval of the difference
    contains 0, the interval of the ratio contains 1.

    Args:
        reference: counts of the reference.
        receiver: counts of the receiver on the same frames.
        paired: the reference (a) compared with the receiver (b).

    Returns:
        The ratio, or None where the reference made no error. Where the receiver made none it is 0, with a
        high end from the one-sided 95 % limit of its rate, a wrong frame taken to have as many wrong bits as
        the reference's have.

    Example:
        >>> a, b = Counts(2000, 128_000, 160, 600, 60), Counts(2000, 128_000, 120, 400, 50)
        >>> more, fewer = Counts(2000, 128_000, 60, 160, 25), Counts(2000, 128_000, 20, 40, 10)
        >>> ratio = rate_ratio(a, b, PairedCounts(more, fewer))
        >>> f"{ratio.value:.2f} in [{ratio.low:.2f}, {ratio.high:.2f}]", ratio.leaves_out(1)
        ('0.75 in [0.58, 0.92]', True)
    """
    gain = relative_gain(reference, receiver, paired)
    if gain is None:
        return None
    size = reference.errors_per_frame_error
    interval = ber_interval(receiver, errors_per_frame_error=size)
    apart = mover_ratio(interval, ber_interval(reference))
    low, high = max(apart.low, 1 - gain.high), min(apart.high, 1 - gain.low)
    if not paired_interval(paired).real:
        low, high = min(low, 1.0), max(high, 1.0)
    ratio = receiver.half_errors / reference.half_errors
    return Estimate(ratio, min(low, ratio), max(high, ratio))
