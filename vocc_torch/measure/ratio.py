"""One bit error rate over another on the same frames, with an interval."""

from __future__ import annotations

import math

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.paired import PairedCounts, paired_interval
from vocc_torch.measure.relative import relative_gain


def mover_ratio(over: Estimate, under: Estimate) -> Estimate:
    """Join the intervals of two rates to that of their ratio, by variance estimates recovery.

    Donner and Zou (Statistical Methods in Medical Research 21, 2012, "Closed-form confidence intervals for
    functions of the normal mean and standard deviation"), without correlation: where the two rates go
    together the interval is wider than need be.

    Args:
        over: the rate above the line, at least 0.
        under: the rate below the line, above 0, its low end too.

    Returns:
        ``low`` to ``high``, which may be above 1. Where ``over`` is 0, low is 0 and high a limit of the same
        confidence as the rate's own high end. A rate below the line whose high end is more than twice the
        rate leaves low above 0 as long as that of the rate above the line is.

    Example:
        >>> ends = mover_ratio(Estimate(0.02, 0.01, 0.04), Estimate(0.2, 0.19, 0.21))
        >>> f"{ends.low:.3f} to {ends.high:.3f}"
        '0.050 to 0.201'
    """
    product = over.value * under.value
    # Both roots without the difference of two alike; what is below the roots cannot be negative but by
    # rounding, since u (2 p - u) is greatest at u = p.
    low = over.low * (2 * over.value - over.low)
    far = product**2 - low * under.high * (2 * under.value - under.high)
    near = under.low * (2 * under.value - under.low)
    high = product**2 - over.high * (2 * over.value - over.high) * near
    return Estimate(
        over.value / under.value,
        low / (product + math.sqrt(max(0.0, far))) if low > 0 else 0.0,
        (product + math.sqrt(max(0.0, high))) / near,
    )


def rate_ratio(reference: Counts, receiver: Counts, paired: PairedCounts) -> Estimate | None:
    """Give a receiver's bit error rate over the reference's.

    Two intervals hold at 95 %: that of the two rates' own intervals (:func:`mover_ratio`), and that of one
    less the relative gain, which knows which errors the two share. The first is the narrower where rates are
    far apart, the second where most errors are shared; what both leave is taken. Simulated pairs of 256 to
    4096 frames with shared, independent and clustered errors missed the truth in at most 4 % (a test holds
    the hardest of them). Whether the difference is real is for the paired interval alone: where that holds 0,
    the ratio's holds 1.

    Args:
        reference: counts of the reference.
        receiver: counts of the receiver on the same frames.
        paired: the reference (a) compared with the receiver (b).

    Returns:
        The ratio, or None where the reference made no error. Where the receiver made none it is 0, with a
        high end from the one-sided 95 % limit of its rate, a wrong frame taken to have as many wrong bits as
        the reference's have.

    Raises:
        VoccError: counts that are not of the same frames.

    Example:
        >>> a, b = Counts(2000, 128_000, 160, 600, 60), Counts(2000, 128_000, 120, 400, 50)
        >>> ratio = rate_ratio(a, b, PairedCounts(2000, 128_000, 60, 160, 25, 20, 40, 10))
        >>> f"{ratio.value:.2f} in [{ratio.low:.2f}, {ratio.high:.2f}]", ratio.leaves_out(1)
        ('0.75 in [0.58, 0.92]', True)
    """
    gain = relative_gain(reference, receiver, paired)
    if gain is None:
        return None
    size = min(max(1.0, reference.bit_errors / reference.frame_errors), reference.bits / reference.frames)
    own = ber_interval(receiver, errors_per_frame_error=size)
    apart = mover_ratio(own, ber_interval(reference))
    low, high = max(apart.low, 1 - gain.high), min(apart.high, 1 - gain.low)
    if not paired_interval(paired).real:
        low, high = min(low, 1.0), max(high, 1.0)
    ratio = receiver.half_errors / reference.half_errors
    return Estimate(ratio, min(low, ratio), max(high, ratio))


Ratio = Estimate  # former name, until nobody imports it
