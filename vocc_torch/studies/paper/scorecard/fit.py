"""Which reading of the paper fits its quoted numbers best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from vocc_torch.measure.curve import Row
from vocc_torch.measure.intervals import Interval
from vocc_torch.studies.paper.scorecard.judgement import Verdict
from vocc_torch.studies.paper.scorecard.quoted import QUOTED_BERS, QUOTED_GAINS, gain_of, paper_interval
from vocc_torch.studies.paper.scorecard.reading import Reading
from vocc_torch.studies.paper.scorecard.score import Scorecard


@dataclass(frozen=True, slots=True)
class Distance:
    """How far measured rates are from the quoted ones: mean ``|log10 (measured / quoted)|``, in decades.

    A point without errors is known by its limit only: it counts as far as the limit lies below the quoted
    rate, and not at all where it lies above. The interval takes each measured rate and each quoted one
    anywhere in its own.

    Args:
        decades: the mean; 0.3 is a factor of two.
        low: its lower end.
        high: its upper end; infinite where a point saw no error.
        points: quoted rates that could be compared.
        error_free: those of them where no error was seen.
    """

    decades: float
    low: float
    high: float
    points: int
    error_free: int


@dataclass(frozen=True, slots=True)
class Fit:
    """How well a reading fits.

    Args:
        reading: its name.
        tally: verdicts of the claims that depend on the reading.
        rates: distance to the quoted bit error rates; None where none was measured.
        gain_points: mean distance to the quoted gains, in percentage points; None where none is defined.
        gains: quoted gains that could be compared.
    """

    reading: str
    tally: dict[Verdict, int]
    rates: Distance | None
    gain_points: float | None
    gains: int


@dataclass(frozen=True, slots=True)
class BestReading:
    """The reading that fits the quoted numbers best.

    Args:
        reading: the nearest to the quoted bit error rates; empty where none was measured.
        clear: whether every other reading is farther away beyond doubt.
        why: in words, with what the quoted gains and the verdicts prefer.
    """

    reading: str
    clear: bool
    why: str


def rate_distance(reading: Reading) -> Distance | None:
    """Measure how far a reading's rates are from the four quoted ones; None where none was measured."""
    parts = []
    silent = 0
    for quoted in QUOTED_BERS:
        row = reading.row(quoted.experiment, quoted.receiver, quoted.value)
        theirs = paper_interval(reading, quoted)
        if row is None or theirs is None:
            continue
        silent += row.error_free
        parts.append(decades_apart(row, quoted.ber, theirs))
    if not parts:
        return None
    means = [math.fsum(column) / len(parts) for column in zip(*parts, strict=True)]
    return Distance(means[0], means[1], means[2], len(parts), silent)


def decades_apart(row: Row, quoted: float, theirs: Interval) -> tuple[float, float, float]:
    """Give ``|log10 (measured / quoted)|`` and its ends, as :class:`Distance` takes it.

    Args:
        row: the measured point.
        quoted: the quoted rate, above 0.
        theirs: the interval of the rate behind it.

    Example:
        >>> row = Row("s", "x", 1.0, "r", "truth", 9, 576, 1.0, 1e-2, 9e-3, 2e-2, 1, 0, "frames")
        >>> [round(number, 2) for number in decades_apart(row, 1e-3, Interval(9e-4, 2e-3))]
        [1.0, 0.65, 1.35]
    """
    least = math.log10(row.ber_low / theirs.high) if row.ber_low > 0 else -math.inf
    most = math.log10(row.ber_high / theirs.low) if theirs.low > 0 else math.inf
    near = 0.0 if least <= 0 <= most else min(abs(least), abs(most))
    far = max(abs(least), abs(most))
    if row.error_free:
        return max(0.0, math.log10(quoted / row.ber_high)), near, far
    return abs(math.log10(row.ber / quoted)), near, far


def gain_distance(reading: Reading) -> tuple[float | None, int]:
    """Give the mean distance to the quoted gains in percentage points, and how many could be compared."""
    found = ((gain_of(reading, quoted), quoted) for quoted in QUOTED_GAINS)
    apart = [100 * abs(gain.gain - quoted.gain) for gain, quoted in found if gain is not None]
    return (math.fsum(apart) / len(apart) if apart else None), len(apart)


def fits(scorecard: Scorecard) -> tuple[Fit, ...]:
    """Give how well each reading fits, in the scorecard's order."""
    found = []
    for reading in scorecard.readings:
        points, count = gain_distance(reading)
        tally = scorecard.tally(reading, curves_only=True)
        found.append(Fit(reading.name, tally, rate_distance(reading), points, count))
    return tuple(found)


def best_reading(candidates: Sequence[Fit]) -> BestReading:
    """Say which reading fits the quoted bit error rates best, whether that is clear, and what else says so.

    The rates decide: they are what the paper quotes most exactly. The choice is clear where the upper end of
    the best one's distance lies below the lower end of every other one's. Readings share frames, so this asks
    for more than it need.

    Example:
        >>> verdicts = {"agree": 9, "differ": 1, "cannot say": 0}
        >>> near = Fit("25 mm, paper", verdicts, Distance(0.1, 0.05, 0.2, 4, 0), 4.0, 5)
        >>> far = Fit("18 mm, paper", {**verdicts, "agree": 2}, Distance(1.1, 0.9, 1.2, 4, 0), 9.0, 5)
        >>> best = best_reading([far, near])
        >>> best.reading, best.clear
        ('25 mm, paper', True)
    """
    known = [fit for fit in candidates if fit.rates is not None]
    if not known:
        return BestReading("", False, "no quoted rate was measured under any reading")
    best = min(known, key=_decades)
    others = [fit for fit in known if fit is not best]
    rates = best.rates
    assert rates is not None
    near = [fit.reading for fit in others if fit.rates is not None and fit.rates.low <= rates.high]
    texts = [f"nearest to the quoted rates: {rates.decades:.2f} decades off on average"]
    if near:
        texts.append(f"not told beyond doubt from {'; '.join(near)}")
    with_gains = [fit for fit in candidates if fit.gain_points is not None]
    if with_gains:
        by_gains = min(with_gains, key=lambda fit: fit.gain_points or 0.0)
        texts.append(
            f"nearest to the quoted gains is {by_gains.reading} ({by_gains.gain_points:.0f} points off)"
        )
    most = max(fit.tally["agree"] for fit in candidates)
    names = [fit.reading for fit in candidates if fit.tally["agree"] == most]
    texts.append(f"most claims ({most}) agree under {' and '.join(names)}")
    return BestReading(best.reading, bool(others) and not near, "; ".join(texts))


def _decades(fit: Fit) -> float:
    """Give the distance to the quoted rates."""
    return fit.rates.decades if fit.rates is not None else math.inf
