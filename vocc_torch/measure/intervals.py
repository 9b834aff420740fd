"""Confidence intervals of a bit error rate whose errors come in clusters, a frame at a time.

Bits of one frame share its panel location, blur and brightness, so frames are the independent trials, not
bits. Korn and Graubard (Survey Methodology 24, 1998, "Confidence intervals for proportions with small
expected number of positive counts estimated from survey data") give the way to carry Clopper and Pearson's
exact interval over to clusters: with an effective number of trials.
"""

import math
import sys
from collections.abc import Callable

from scipy.optimize import bisect
from scipy.special import (
    betainc,
    betaincc,
    betainccinv,
    betaincinv,
    stdtrit,
)

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate

MOST_TRIALS = 1e13
"""Most trials of an interval or a test: SciPy's beta integral loses its digits beyond."""
_TAIL_TOLERANCE = 1e-3


def clopper_pearson(
    successes: float, trials: float, confidence: float = 0.95
) -> Estimate:
    """Give the exact two-sided interval of a binomial proportion (Clopper and Pearson, Biometrika 26, 1934).

    Either end leaves out half of what ``confidence`` leaves, to a thousandth of it; without successes the low
    end is 0, and without failures the high end is 1. An end below the smallest normal number (2e-308) or
    within 1e-16 of 1 is given to that.

    Args:
        successes: 0 to ``trials``; need not be whole.
        trials: above 0, at most ``MOST_TRIALS``; need not be whole.
        confidence: above 0, below 1.

    Returns:
        The share ``successes / trials`` with its interval.

    Example:
        >>> interval = clopper_pearson(1, 20)
        >>> round(interval.low, 5), round(interval.high, 5)
        (0.00127, 0.24873)
    """
    tail = (1 - confidence) / 2
    low, high, share = 0.0, 1.0, successes / trials
    if successes > 0:
        low = _inverse(betainc, betaincinv, successes, trials - successes + 1, tail)
    if successes < trials:
        # By its complement, since 1 - tail is 1 at confidences near 1.
        high = _inverse(betaincc, betainccinv, successes + 1, trials - successes, tail)
    return Estimate(share, min(low, share), max(high, share))


def _inverse(
    integral: Callable[..., float],
    inverse: Callable[..., float],
    a: float,
    b: float,
    tail: float,
) -> float:
    """Give x at which a beta distribution's ``integral(a, b, x)``, monotone in x, is ``tail``."""
    x = float(inverse(a, b, tail))
    if abs(integral(a, b, x) - tail) <= _TAIL_TOLERANCE * tail:
        return x
    # The inverse of SciPy 1.17 is out by factors at a = 1000 and b above 1e7, for one; its integral is not. x
    # is sought on a logarithmic axis, since it may be of any order.
    least = math.log(sys.float_info.min)

    def excess(logarithm: float) -> float:
        return float(integral(a, b, math.exp(logarithm))) - tail

    if excess(least) * excess(0.0) > 0:
        return x
    return math.exp(bisect(excess, least, 0.0, xtol=1e-17))


def design_effect(counts: Counts) -> float:
    """Return the variance of the bit error rate, divided by the variance of a binomial.

    The variance between frames is divided by that of independent bits. The ratio is set to at least 1. Errors
    of one frame share causes, so a ratio below 1 is chance, or comes from missed panels, which count a
    constant half of their bits. Neither gives more trials than there are bits.

    A single frame has no spread: the effect is then the largest possible one, the bits of the frame. If no
    bit or every bit is wrong there is no spread either, and the effect is 1. The result is exact to rounding
    for counts of any size.

    Args:
        counts: at least one frame.

    Example:
        >>> ten_in_one_frame = Counts(100, 6400, half_errors=20, half_errors_squared=400, frame_errors=1)
        >>> round(design_effect(ten_in_one_frame), 2)
        10.02
    """
    halves, right = counts.half_errors, 2 * counts.bits - counts.half_errors
    if counts.frames == 1:
        return float(counts.bits)
    if halves == 0 or right == 0:
        return 1.0
    # In integers up to the division, so that nothing cancels: 1 - ber does at rates near 1.
    return max(
        1.0, counts.spread * counts.bits / ((counts.frames - 1) * halves * right)
    )


def ber_interval(
    counts: Counts, confidence: float = 0.95, errors_per_frame_error: float = 1.0
) -> Estimate:
    """Give the interval of the bit error rate, with frames as the independent units.

    **Some errors.** Korn and Graubard's interval: Clopper and Pearson's with ``bits / design_effect`` trials.
    The trials are multiplied by a ratio of squared t quantiles, because the design effect is an estimate.
    Korn and Graubard's degrees of freedom are the clusters less one. Frames without errors do not show how
    errors cluster, so here the degrees of freedom are at most one more than the effective number of wrong
    frames, ``(sum e)^2 / sum e^2`` over the frames' errors e (Kish). With many wrong frames both agree.

    The interval is then cut to limits that hold for any clustering. A wrong frame has between one and all of
    its bits wrong, so the rate lies between P(frame error) / (bits per frame) and P(frame error). The number
    of wrong frames is binomial.

    **No errors.** The low end is 0. The high end is a one-sided limit: P(frame error) is at most ``1 - (1 -
    confidence)^(1 / frames)``, times ``errors_per_frame_error`` wrong bits. Its default is 1, because rare
    wrong frames typically have a single wrong LED. If errors come from lost panels, give half of the frame's
    bits. :class:`~vocc_torch.measure.curve.BerTable` takes the number from the receiver's other points.

    **All errors.** The high end is 1. **One frame** with errors: its bits count as one trial at most, so the
    interval covers most of 0 to 1.

    No interval covers a kind of wrong frame that never occurred, such as a lost panel with a probability
    below about 3 / frames, even if its many errors are much of the rate.

    Args:
        counts: at least one frame; where there are errors, at most ``MOST_TRIALS`` bits.
        confidence: above 0, below 1.
        errors_per_frame_error: mean wrong bits in a wrong frame, above 0; a number above the bits of a frame
            counts as these. Used only where no errors were seen.

    Returns:
        The bit error rate of ``counts`` with its interval.

    Example:
        >>> interval = ber_interval(Counts(frames=2000, bits=128_000))
        >>> interval.low, round(interval.high, 7)
        (0.0, 2.34e-05)
    """
    ber, bits_per_frame = counts.ber, counts.bits / counts.frames
    size = min(errors_per_frame_error, bits_per_frame)
    if (weighed := counts.interval(confidence, size)) is not None:
        return weighed
    if counts.half_errors == 0:
        limit = error_free_limit(counts.frames, confidence)
        return Estimate(ber, 0.0, limit * size / bits_per_frame)
    # A missed panel of a single LED is half a bit error: the only wrong frame with less than one.
    fewest = min(1.0, bits_per_frame / 2)
    frames_in_error = counts.half_errors**2 / counts.half_errors_squared
    return clustered_interval(
        counts, design_effect(counts), frames_in_error, fewest, confidence
    )


def error_free_limit(frames: float, confidence: float) -> float:
    """Give the probability of a frame error that frames without one leave possible."""
    # 1 - (1 - confidence)^(1 / frames), without its cancellation at many frames.
    return -math.expm1(math.log1p(-confidence) / frames)


def precise_enough(counts: Counts, share: float, least_ber: float) -> bool:
    """Say whether an interval reaches at most a share of the rate to either side, or lies below a rate.

    Args:
        counts: what was counted so far.
        share: above 0, below 1.
        least_ber: the rate below which nothing more is asked.
    """
    if counts.frames < max(1, counts.least_frames):
        return False
    # Without errors nothing tells how many bits a wrong frame would have: half, as in a lost panel.
    interval = ber_interval(
        counts, errors_per_frame_error=counts.bits / counts.frames / 2
    )
    reach = max(interval.high - counts.ber, counts.ber - interval.low)
    narrow = counts.half_errors > 0 and reach <= share * counts.ber
    return narrow or interval.high <= least_ber


def clustered_interval(
    counts: Counts,
    effect: float,
    frames_in_error: float,
    fewest: float,
    confidence: float,
) -> Estimate:
    """Korn and Graubard's interval of a rate, cut to what holds however errors cluster.

    Args:
        counts: at least one frame, at most ``MOST_TRIALS`` bits.
        effect: the design effect, at least 1.
        frames_in_error: effective number of frames that the effect was estimated from; not used without
            errors.
        fewest: wrong bits that a wrong frame has at least, above 0.
        confidence: above 0, below 1.
    """
    trials, rate = counts.bits / effect, counts.ber
    if counts.half_errors:
        freedom = max(1.0, min(counts.frames - 1, frames_in_error + 1))
        trials *= t_correction(counts.bits, freedom, confidence)
    clustered = clopper_pearson(rate * trials, trials, confidence)
    frame_error = clopper_pearson(counts.frame_errors, counts.frames, confidence)
    low = max(clustered.low, frame_error.low * fewest / (counts.bits / counts.frames))
    return Estimate(
        rate, min(low, rate), max(min(clustered.high, frame_error.high), rate)
    )


def t_correction(bits: float, freedom: float, confidence: float) -> float:
    """Give the squared ratio of t quantiles that pays for a design effect estimated from few frames.

    Args:
        bits: bits sent; one less are the degrees of freedom that independent bits would have.
        freedom: degrees of freedom of the estimate, at least 1.
        confidence: above 0, below 1.

    Returns:
        Above 0, at most 1. It tends to 0 as ``confidence`` tends to 1, and to the squared ratio of the
        densities at 0, at least 2 / pi, as it tends to 0.

    Example:
        >>> round(t_correction(bits=1_000_000, freedom=4, confidence=0.95), 3)
        0.498
    """
    # The lower quantile: the upper one's (1 + confidence) / 2 is 1 at confidences near 1, and infinite. At a
    # confidence near 0 both quantiles lose their digits, but below 1e-6 their ratio no longer changes.
    tail = min((1 - confidence) / 2, 0.5 - 5e-7)
    ratio = float(stdtrit(max(1.0, bits - 1.0), tail)) / float(stdtrit(freedom, tail))
    return min(1.0, ratio**2)
