"""Two receivers on the same frames: what the difference of their bit error rates is, and whether it is real.

Most frames are as hard for one receiver as for the other. Compared frame by frame, what they share cancels,
and far smaller differences can be told from chance than from two curves with an interval each.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass

from scipy.special import betainc

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import MOST_TRIALS, ber_interval, clopper_pearson, t_correction


@dataclass(frozen=True, slots=True)
class PairedCounts:
    """By how much one receiver, a, did worse than another, b, on the same frames, as Python integers.

    A frame where both have as many wrong bits says nothing of their difference. The other frames, the
    discordant ones, are kept apart by which receiver was worse, each side with its first two moments: the
    interval needs both sides. Errors are kept in halves of a bit error, as in
    :class:`~vocc_torch.measure.counts.Counts`, so that ``half_difference`` is exactly the difference of
    the two receivers' ``half_errors``.

    Args:
        frames: frames compared.
        bits: bits sent in them.
        a_excess: half errors of a beyond those of b, summed over the frames where a had more.
        a_excess_squared: sum of their squares, a frame at a time.
        a_worse: frames where a had more.
        b_excess: half errors of b beyond those of a, summed over the frames where b had more.
        b_excess_squared: sum of their squares, a frame at a time.
        b_worse: frames where b had more.

    Raises:
        VoccError: a count is not an integer, is below 0, or contradicts another.

    Example:
        >>> paired = PairedCounts(frames=64, bits=4096, a_excess=6, a_excess_squared=20, a_worse=2)
        >>> total = sum([paired, paired.swapped()], PairedCounts())
        >>> total.half_difference, total.half_difference_squared, total.discordant, paired.difference
        (0, 40, 4, 0.000732421875)
    """

    frames: int = 0
    bits: int = 0
    a_excess: int = 0
    a_excess_squared: int = 0
    a_worse: int = 0
    b_excess: int = 0
    b_excess_squared: int = 0
    b_worse: int = 0

    def __post_init__(self) -> None:
        """Refuse numbers that no set of frames can give, such as a damaged ledger row."""
        for side in ("a", "b"):
            try:
                self._side(side)
            except VoccError as error:
                raise VoccError(f"paired, {side} worse: {error}") from None
        if self.discordant > self.frames:
            rule = f"it must be at most {self.frames} (frames)"
            raise VoccError(f"paired.a_worse + b_worse is {self.discordant}: {rule}")

    def _side(self, side: str) -> Counts:
        """One side's excess as the counts that they are: errors that come a frame at a time."""
        excess, squared, worse = (
            getattr(self, f"{side}_{name}") for name in ("excess", "excess_squared", "worse")
        )
        return Counts(self.frames, self.bits, excess, squared, worse)

    def __add__(self, other: PairedCounts | int) -> PairedCounts:
        """Join the counts of disjoint frames; the 0 that ``sum`` starts from is let through."""
        if isinstance(other, int) and other == 0:
            return self
        if not isinstance(other, PairedCounts):
            return NotImplemented
        return PairedCounts(*(one + more for one, more in zip(astuple(self), astuple(other), strict=True)))

    __radd__ = __add__

    def swapped(self) -> PairedCounts:
        """Give the same comparison seen from the other receiver."""
        frames, bits, *sides = astuple(self)
        return PairedCounts(frames, bits, *sides[3:], *sides[:3])

    @property
    def half_difference(self) -> int:
        """Sum over the frames of a's half errors less b's."""
        return self.a_excess - self.b_excess

    @property
    def half_difference_squared(self) -> int:
        """Sum over the frames of the square of a's half errors less b's."""
        return self.a_excess_squared + self.b_excess_squared

    @property
    def discordant(self) -> int:
        """Frames in which one receiver had more errors than the other."""
        return self.a_worse + self.b_worse

    @property
    def difference(self) -> float:
        """Bit error rate of a less that of b, -1 to 1.

        Raises:
            VoccError: no bits were counted.
        """
        if self.bits == 0:
            raise VoccError("paired.bits is 0: a difference of bit error rates needs at least one frame")
        return self.half_difference / (2 * self.bits)


def paired_interval(
    paired: PairedCounts, confidence: float = 0.95, errors_per_discordant_frame: float = 1.0
) -> Estimate:
    """The interval of the difference of two bit error rates, with frames as the independent units.

    **Why not a t interval.** The mean of the differences between frames has one, but it is symmetric. Where
    few frames differ, the differences are a handful of events in a sea of zeros, the sum is skewed, and the
    sample often shows too little of its spread: with three discordant frames expected, all one way, the t
    interval covers about 80 % instead of 95 %. More t quantile, for fewer degrees of freedom, widens both
    ends alike, the wrong one too.

    **Some frames differ.** The difference is that of two rates: of a's errors beyond b's, and of b's beyond
    a's. Each is a rate of errors that come a frame at a time and has an interval as in
    :func:`~vocc_torch.measure.intervals.ber_interval`: Clopper and Pearson's with an effective number of
    trials, a t quantile that pays for estimating it, and the limits that the binomial number of frames sets.
    How large a difference is where there is one shows on both sides, and a side with few frames borrows from
    the other: its spread is taken with one more frame of the common size, ``sum d^2 / sum |d|`` over the
    frames' differences d, and the degrees of freedom are those of both sides together. For a side that never
    was the worse, that frame's size is all there is. Without the loan, a single frame in which b was worse
    would make 20 in which a was look like chance.

    The two are joined by the method of variance estimates recovery (Zou and Donner, Statistics in Medicine
    27, 2008, "Construction of confidence limits about effect measures: a general approach"; for two
    proportions it is Newcombe's square-and-add): the distance of the low end from the difference is the root
    of the summed squares of the first rate's distance to its low end and the second's to its high end, and
    the other way round for the high end. Within a frame the two exclude each other, so they are correlated by
    -(product of means) / (product of standard deviations). That is next to nothing where few frames differ;
    where most do, leaving it out would cost up to 6 points of coverage.

    **No frame differs.** ``low`` and ``high`` are then limits of the size of the difference: a frame differs
    with a probability of at most ``1 - (1 - confidence)^(1 / frames)``, and no more than
    ``errors_per_discordant_frame`` bits are taken to differ in it.

    As with :func:`~vocc_torch.measure.intervals.ber_interval`, nothing covers a kind of frame that is so
    rare that none came up though its many errors make up much of the difference.

    Args:
        paired: at least one frame; where frames differ, at most ``MOST_TRIALS`` bits.
        confidence: above 0, below 1.
        errors_per_discordant_frame: mean difference in a discordant frame, in bits, above 0, at most the bits
            of a frame; used only where no frame differs.

    Raises:
        VoccError: no frames, or an argument outside its range.

    Example:
        >>> interval = paired_interval(PairedCounts(2000, 128_000, 60, 160, 25, 20, 40, 10))
        >>> f"{interval.value:.2e} in [{interval.low:.2e}, {interval.high:.2e}]", interval.real
        ('1.56e-04 in [4.27e-05, 2.86e-04]', True)
    """
    difference, leds = paired.difference, paired.bits / paired.frames
    if not 0 < errors_per_discordant_frame <= leds:
        raise VoccError(
            f"errors_per_discordant_frame is {errors_per_discordant_frame}: "
            f"it must be above 0 and at most the bits of a frame, {leds:g}"
        )
    sides = [paired._side("a"), paired._side("b")]
    if not paired.discordant:
        limit = ber_interval(sides[0], confidence, errors_per_discordant_frame).high
        return Estimate(0.0, -limit, limit)
    if paired.bits > MOST_TRIALS:
        raise VoccError(f"paired.bits is {paired.bits}: an interval takes at most {MOST_TRIALS:g} bits")
    a, b = (_excess_interval(side, paired, confidence) for side in sides)
    correlation = _correlation(paired)

    def joined(first: float, second: float) -> float:
        return math.sqrt(first**2 + second**2 - 2 * correlation * first * second)

    return Estimate(
        difference,
        low=max(-1.0, difference - joined(sides[0].ber - a.low, b.high - sides[1].ber)),
        high=min(1.0, difference + joined(a.high - sides[0].ber, sides[1].ber - b.low)),
    )


def _excess_interval(side: Counts, paired: PairedCounts, confidence: float) -> Estimate:
    """Give the interval of one side's rate, as :func:`paired_interval` says; at least one frame differs."""
    worse = clopper_pearson(side.frame_errors, paired.frames, confidence)
    leds, rate = paired.bits / paired.frames, side.ber
    summed = paired.a_excess + paired.b_excess
    common = paired.half_difference_squared / summed
    size = (side.half_errors_squared + common**2) / (side.half_errors + common) / 2
    effect = leds
    if paired.frames > 1:
        # The variance of a frame's errors over that of as many independent bits of the same rate.
        variance_ratio = (size - leds * rate) / (1 - rate) if rate < 1 else 1.0
        effect = max(1.0, variance_ratio * paired.frames / (paired.frames - 1))
    trials = paired.bits / effect
    if side.half_errors:
        freedom = max(1.0, min(paired.frames - 1, summed / common + 1))
        trials *= t_correction(paired.bits, freedom, confidence)
    clustered = clopper_pearson(rate * trials, trials, confidence)
    # A frame's difference is one bit at least and all its bits at most. Only the half that a missed panel of
    # an odd number of LEDs counts can be half a bit from what the other receiver got wrong.
    fewest = 1.0 if leds % 2 == 0 else 0.5
    return Estimate(
        rate,
        min(max(clustered.low, worse.low * fewest / leds), rate),
        max(min(clustered.high, worse.high), rate),
    )


def _correlation(paired: PairedCounts) -> float:
    """Give the correlation of the two sides' excess in a frame: their product is 0 in every frame."""
    product = paired.a_excess * paired.b_excess
    if product == 0:
        return 0.0
    spread_a = paired.frames * paired.a_excess_squared - paired.a_excess**2
    spread_b = paired.frames * paired.b_excess_squared - paired.b_excess**2
    return max(-1.0, -product / math.sqrt(spread_a) / math.sqrt(spread_b))


def sign_test(paired: PairedCounts) -> float:
    """Return the exact two-sided p-value of the sign test on the discordant frames.

    If the receivers were equals, each would be the worse in half the discordant frames, whatever the sizes of
    the differences. It takes no account of sizes and can disagree with :func:`paired_interval`: a receiver
    that is a little better in most frames and far worse in a few has the better count of frames and the
    worse bit error rate.

    Args:
        paired: at most ``MOST_TRIALS`` discordant frames.

    Returns:
        The p-value, 0 to 1; 1 where no frame differs.

    Raises:
        VoccError: more discordant frames.

    Example:
        >>> sign_test(PairedCounts(64, 4096, a_excess=12, a_excess_squared=24, a_worse=6))
        0.03125
    """
    if paired.discordant > MOST_TRIALS:
        raise VoccError(
            f"paired.discordant is {paired.discordant}: a test takes at most {MOST_TRIALS:g} frames"
        )
    fewer, more = sorted((paired.a_worse, paired.b_worse))
    # At even odds both tails are alike; where the sides are too, they overlap.
    return min(1.0, 2 * float(betainc(more, fewer + 1, 0.5)))
