"""Offers of accuracy for time: which of them nothing beats, and which to take within a limit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from vocc_torch.errors import VoccError


@dataclass(frozen=True, slots=True)
class Offer:
    """What a receiver costs and gives.

    Args:
        name: the receiver.
        low_ms: lower quartile of the time a frame, ms, above 0.
        median_ms: median, ms.
        high_ms: upper quartile, ms.
        ber: bit error rate, 0 to 1.
        ber_low: lower end of its 95 % interval.
        ber_high: upper end; where no error was seen, a limit.

    Raises:
        VoccError: numbers that are not in ascending order or outside their range.

    Example:
        >>> Offer("a", 0.9, 1.0, 1.2, 0.0, 0.0, 1e-5).error_free
        True
    """

    name: str
    low_ms: float
    median_ms: float
    high_ms: float
    ber: float
    ber_low: float
    ber_high: float

    def __post_init__(self) -> None:
        """Check both orders."""
        if not 0 < self.low_ms <= self.median_ms <= self.high_ms < math.inf:
            times = f"{self.low_ms:g}, {self.median_ms:g}, {self.high_ms:g}"
            raise VoccError(f"times of {self.name} are {times} ms: they must be above 0 and ascending")
        if not 0 <= self.ber_low <= self.ber <= self.ber_high <= 1:
            rates = f"{self.ber_low:g}, {self.ber:g}, {self.ber_high:g}"
            raise VoccError(f"ber of {self.name} is {rates}: it must be ascending from 0 to 1")

    @property
    def error_free(self) -> bool:
        """Whether no error was seen, so that only a limit is known."""
        return self.ber == 0

    @property
    def frames_per_s(self) -> float:
        """Frames a second, by the median."""
        return 1e3 / self.median_ms


def beats(a: Offer, b: Offer) -> bool:
    """Say whether a is no slower and no worse than b, and one of both better; by medians and rates as seen.

    Example:
        >>> slow, quick = Offer("s", 2, 2, 2, 0.1, 0.1, 0.1), Offer("q", 1, 1, 1, 0.1, 0.1, 0.1)
        >>> beats(quick, slow), beats(slow, quick), beats(slow, slow)
        (True, False, False)
    """
    no_worse = a.median_ms <= b.median_ms and a.ber <= b.ber
    return no_worse and (a.median_ms < b.median_ms or a.ber < b.ber)


def frontier(offers: Sequence[Offer]) -> list[Offer]:
    """Give the offers that no other beats, from the quickest to the most accurate.

    Args:
        offers: any number, in any order; of equal ones all are kept.

    Example:
        >>> times, rates = (1.0, 2.0, 3.0), (1e-2, 2e-2, 0.0)
        >>> offers = [Offer(f"{t}", t, t, t, r, r, max(r, 1e-5)) for t, r in zip(times, rates)]
        >>> [offer.name for offer in frontier(offers)]
        ['1.0', '3.0']
    """
    kept: list[Offer] = []
    for offer in sorted(offers, key=lambda one: (one.median_ms, one.ber)):
        if not any(beats(other, offer) for other in kept):
            kept.append(offer)
    return kept


def most_accurate(offers: Sequence[Offer]) -> Offer:
    """Give the offer with the lowest rate; among equal rates the end of the interval decides, then the time.

    Args:
        offers: at least one.

    Example:
        >>> most_accurate([Offer("a", 1, 1, 1, 0.2, 0.1, 0.3), Offer("b", 2, 2, 2, 0.1, 0.0, 0.2)]).name
        'b'
    """
    return min(offers, key=lambda one: (one.ber, one.ber_high, one.median_ms))


def most_accurate_within(offers: Sequence[Offer], limit_ms: float) -> Offer | None:
    """Give the offer with the lowest rate among those whose upper quartile keeps within a time.

    Among equal rates the interval's upper end decides, then the time: of two without errors the one counted
    on frames that rule out more.

    Args:
        offers: any number.
        limit_ms: time a frame, ms, above 0.

    Raises:
        VoccError: a limit outside its range.

    Example:
        >>> most_accurate_within([Offer("a", 1, 2, 3, 0.1, 0.1, 0.1)], 2.5) is None
        True
    """
    if not limit_ms > 0:
        raise VoccError(f"limit_ms is {limit_ms:g}: it must be above 0")
    within = [offer for offer in offers if offer.high_ms <= limit_ms]
    return most_accurate(within) if within else None


def quickest_below(offers: Sequence[Offer], limit_ber: float) -> Offer | None:
    """Give the quickest of the offers whose whole interval lies below a bit error rate.

    Args:
        offers: any number.
        limit_ber: above 0, at most 1.

    Raises:
        VoccError: a limit outside its range.

    Example:
        >>> quick, sure = Offer("q", 1, 1, 1, 9e-5, 8e-5, 2e-4), Offer("s", 2, 2, 2, 5e-5, 4e-5, 6e-5)
        >>> quickest_below([quick, sure], 1e-4).name
        's'
    """
    if not 0 < limit_ber <= 1:
        raise VoccError(f"limit_ber is {limit_ber:g}: it must be above 0 and at most 1")
    below = [offer for offer in offers if offer.ber_high < limit_ber]
    return min(below, key=lambda one: (one.median_ms, one.ber), default=None)
