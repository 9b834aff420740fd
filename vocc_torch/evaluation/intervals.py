"""Confidence intervals of a bit error rate whose errors come in clusters, a frame at a time.

Bits of one frame share its panel location, blur and brightness, so frames are the independent trials, not
bits. Korn and Graubard (Survey Methodology 24, 1998, "Confidence intervals for proportions with small
expected number of positive counts estimated from survey data") give the way to carry Clopper and Pearson's
exact interval over to clusters: with an effective number of trials.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scipy.special import betaincinv, stdtrit

from vocc_torch.errors import VoccError
from vocc_torch.evaluation.counts import Counts


@dataclass(frozen=True, slots=True)
class Interval:
    """A closed interval of probabilities, ``0 <= low <= high <= 1``.

    Example:
        >>> Interval(low=0.1, high=0.3).high
        0.3
    """

    low: float
    high: float


def clopper_pearson(successes: float, trials: float, confidence: float = 0.95) -> Interval:
    """Give the exact two-sided interval of a binomial proportion (Clopper and Pearson, Biometrika 26, 1934).

    Args:
        successes: 0 to ``trials``; need not be whole.
        trials: above 0; need not be whole.
        confidence: above 0, below 1.

    Raises:
        VoccError: an argument outside its range.

    Example:
        >>> interval = clopper_pearson(1, 20)
        >>> round(interval.low, 5), round(interval.high, 5)
        (0.00127, 0.24873)
    """
    _check_confidence(confidence)
    if not 0 < trials < math.inf:
        raise VoccError(f"trials is {trials}: it must be above 0 and finite")
    if not 0 <= successes <= trials:
        raise VoccError(f"successes is {successes}: it must be 0 to trials, {trials}")
    tail = (1 - confidence) / 2
    low = betaincinv(successes, trials - successes + 1, tail) if successes > 0 else 0.0
    high = betaincinv(successes + 1, trials - successes, 1 - tail) if successes < trials else 1.0
    return Interval(float(low), float(high))


def design_effect(counts: Counts) -> float:
    """Say how many times wider than a binomial's the variance of the bit error rate is.

    The variance between frames is divided by that of independent bits. It is floored at 1. Errors of one
    frame share its causes, so a ratio below 1 is chance, or the constant half with which a missed panel
    enters the counts in the place of its coin tosses, and neither is a reason to claim more trials than there
    were bits.

    One frame has no spread: the effect is then the greatest there is, the frame's bits.

    Args:
        counts: at least one frame.

    Raises:
        VoccError: no frames.

    Example:
        >>> ten_in_one_frame = Counts(100, 6400, half_errors=20, half_errors_squared=400, frame_errors=1)
        >>> round(design_effect(ten_in_one_frame), 2)
        10.02
    """
    ber, frames = counts.ber, counts.frames
    bits_per_frame = counts.bits / frames
    if frames == 1:
        return bits_per_frame
    if counts.half_errors in (0, 2 * counts.bits):
        return 1.0
    # In integers up to the division, so that nothing cancels; 4 turns squared halves into squared bits.
    spread = frames * counts.half_errors_squared - counts.half_errors**2
    variance = spread / (4 * frames * (frames - 1))
    return max(1.0, variance / (bits_per_frame * ber * (1 - ber)))


def ber_interval(counts: Counts, confidence: float = 0.95, errors_per_frame_error: float = 1.0) -> Interval:
    """Give the interval of the bit error rate, with frames as the independent units.

    **Some errors.** Korn and Graubard's interval: Clopper and Pearson's with ``bits / design_effect`` trials,
    times a ratio of t quantiles that pays for a design effect which is itself an estimate. Their degrees of
    freedom are the clusters less one. A frame without errors tells nothing of how errors cluster, so where
    errors are rare that is far too many; here it is at most one more than the effective number of frames in
    error, ``(sum e)^2 / sum e^2`` over the frames' errors e (Kish's effective size). Many frames in error
    make the two the same.

    The interval is then cut to what holds however errors cluster: a wrong frame has one wrong bit at least
    and all its bits wrong at most, so the rate lies between P(frame error) / (bits per frame) and P(frame
    error), and the number of wrong frames is binomial.

    **No errors.** The low end is 0. The high end is a one-sided limit: P(frame error) is at most ``1 - (1 -
    confidence)^(1 / frames)``. Error-free frames cannot tell how many bits a wrong one would have. Taken is
    ``errors_per_frame_error``, by default 1, because where errors become rare the typical wrong frame has a
    single LED on the wrong side of the threshold. It is an assumption, and the limit grows in proportion:
    where errors come from lost panels, half the frame's bits is the number to give. A
    :class:`~vocc_torch.evaluation.curve.BerTable` gives what the receiver's other points show.

    What no interval from these counts covers: a kind of wrong frame that is so rare that none came up (a lost
    panel with a probability below about 3 / frames) though its many errors make up much of the rate.

    Args:
        counts: at least one frame.
        confidence: above 0, below 1.
        errors_per_frame_error: mean wrong bits in a wrong frame, above 0, at most the bits of a frame; used
            only where no errors were seen.

    Raises:
        VoccError: no frames, or an argument outside its range.

    Example:
        >>> interval = ber_interval(Counts(frames=2000, bits=128_000))
        >>> interval.low, round(interval.high, 7)
        (0.0, 2.34e-05)
    """
    _check_confidence(confidence)
    ber, bits_per_frame = counts.ber, counts.bits / counts.frames
    if not 0 < errors_per_frame_error <= bits_per_frame:
        raise VoccError(
            f"errors_per_frame_error is {errors_per_frame_error}: "
            f"it must be above 0 and at most the bits of a frame, {bits_per_frame:g}"
        )
    if counts.half_errors == 0:
        # 1 - (1 - confidence)^(1 / frames), without its cancellation at many frames.
        frame_error_limit = -math.expm1(math.log1p(-confidence) / counts.frames)
        return Interval(0.0, frame_error_limit * errors_per_frame_error / bits_per_frame)
    trials = _effective_trials(counts, confidence)
    clustered = clopper_pearson(ber * trials, trials, confidence)
    frame_error = clopper_pearson(counts.frame_errors, counts.frames, confidence)
    # A missed panel of a single LED is half a bit error: the only wrong frame with less than one.
    fewest = min(1.0, bits_per_frame / 2)
    low = max(clustered.low, frame_error.low * fewest / bits_per_frame)
    return Interval(min(low, ber), max(min(clustered.high, frame_error.high), ber))


def _effective_trials(counts: Counts, confidence: float) -> float:
    """Give Korn and Graubard's effective number of independent bits; there is at least one error."""
    frames_in_error = counts.half_errors**2 / counts.half_errors_squared
    freedom = max(1.0, min(counts.frames - 1, frames_in_error + 1))
    quantile = (1 + confidence) / 2
    correction = (stdtrit(max(1, counts.bits - 1), quantile) / stdtrit(freedom, quantile)) ** 2
    return float(counts.bits / design_effect(counts) * min(1.0, correction))


def _check_confidence(confidence: float) -> None:
    """Refuse what is no probability of a statement."""
    if not 0 < confidence < 1:
        raise VoccError(f"confidence is {confidence}: it must be above 0 and below 1")
