"""What a panel loses that cannot dim: one luminance for every ambient light, against the best for each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from vocc_torch.errors import VoccError
from vocc_torch.measure.dimming import (
    CONFIDENCE,
    Best,
    Floats,
    Grid,
    best_luminance,
    least_ends,
    not_worse,
)
from vocc_torch.measure.estimate import Estimate as Estimate

HEADLIGHT_CD_M2 = 3000.0
"""The middle of the paper's LED headlights, 2000 to 4000 cd/m2 (Table 1)."""


@dataclass(frozen=True, slots=True)
class Undimmed:
    """A panel that has one luminance under every ambient light.

    Args:
        luminance_cd_m2: its LEDs' luminance.
        ber: bit error rate under each ambient light, with its interval; where there were no errors the upper
            end is a one-sided limit.
        mean: mean bit error rate over the ambient light, an octave weighing like any other.
        ratio: ``mean`` over that of the dimmed panel: 1 is no loss. The value is infinite where only the
            dimmed panel saw no errors, and 1 where neither saw any; ``ratio.low`` is what is surely lost.

    Example:
        >>> rate = Estimate(1e-3, 8e-4, 1.2e-3)
        >>> Undimmed(4000.0, (rate,), rate, Estimate(2.0, 1.3, 3.1)).ratio.low
        1.3
    """

    luminance_cd_m2: float
    ber: tuple[Estimate, ...]
    mean: Estimate
    ratio: Estimate


@dataclass(frozen=True, slots=True)
class Loss:
    """What a receiver loses where the panel cannot dim.

    Args:
        receiver: its name.
        dimmed: the best luminance under each ambient light.
        dimmed_mean: mean over the ambient light of the least bit error rates. The value, a mean of minima of
            noisy rates, tends to be too low; the interval allows for it.
        fixed: the panel with the one luminance that has the least mean bit error rate.
        candidates_cd_m2: the luminances that cannot be told from it by their means, as in ``Best``.
        headlight: the panel with the luminance of the grid that is nearest to a given one.
    """

    receiver: str
    dimmed: tuple[Best, ...]
    dimmed_mean: Estimate
    fixed: Undimmed
    candidates_cd_m2: tuple[float, ...]
    headlight: Undimmed


def undimmed_loss(grid: Grid, receiver: str, headlight_cd_m2: float = HEADLIGHT_CD_M2) -> Loss:
    """Compare panels of one luminance with one that has the best of the grid under each ambient light.

    Means weigh the ambient lights by their share of the octaves. Intervals of means and of their ratio are
    joined from the cells' by the method of variance estimates recovery (Zou and Donner, 2008), the ratio's
    on its logarithm.

    **The choice of the least.** The dimmed panel takes the least of several noisy rates at every ambient
    light, the fixed panel only once, so the ratio of the two as seen tends to be too high. The ends allow for
    it. The least of k equal rates lies below them by about the mean of the largest of k standard normal
    numbers (Blom's approximation), times the standard error; the upper end of the dimmed panel's mean is
    taken from rates raised by that much, with the number of candidates for k, and ``ratio.low`` rests on it.
    The ends of the fixed panel's mean are those of the least true mean, found as those of the least true rate
    in :func:`~vocc_torch.measure.dimming.best_luminance`. A cell that both panels use counts as if it had
    been measured twice, which widens the ratio's interval. The true ratio is at least 1, since the fixed
    panel's luminance is one of those that the dimmed panel chooses from.

    Args:
        grid: ambient light by LED luminance.
        receiver: its name.
        headlight_cd_m2: luminance of the other panel, cd/m2, above 0; the nearest of the grid in octaves.

    Raises:
        VoccError: an unknown receiver, or a luminance that is not above 0.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curves import Curves
        >>> def curves(*wrong):
        ...     cells = [Counts(1000, 64000, 2 * w, 4 * w, w) for w in wrong]
        ...     counts = dict(zip([("flda_3", 1000), ("flda_3", 4000)], cells))
        ...     axis, stopped = "led_luminance_cd_m2", {1000: "frames", 4000: "frames"}
        ...     return Curves("dimming", axis, "truth", ("flda_3",), (1000, 4000), counts, {}, stopped)
        >>> loss = undimmed_loss(Grid("ambient_lx", (2e3, 8e3), (curves(10, 200), curves(120, 10))), "flda_3")
        >>> loss.fixed.luminance_cd_m2, loss.fixed.ratio.value, round(loss.fixed.ratio.low, 1)
        (1000.0, 6.5, 3.7)
    """
    if not 0 < headlight_cd_m2 < math.inf:
        raise VoccError(f"headlight_cd_m2 is {headlight_cd_m2}: it must be above 0 and finite")
    weights, ber = octave_weights(grid.rows), grid.ber(receiver)
    bests = best_luminance(grid, receiver)
    dimmed = _mean_of_least(grid, receiver, bests)
    means = _means(weights, ber)
    chosen = int(means.argmin())
    low, high = (_mean_ends(weights, ber, ends) for ends in least_ends(grid, receiver))
    least = Estimate(
        float(means[chosen]), min(float(low.min()), means[chosen]), max(float(high.min()), means[chosen])
    )
    plain = grid.one_sided(receiver, (1 - CONFIDENCE) / 2)
    nearest = min(range(len(means)), key=lambda j: abs(math.log(grid.columns[j]) - math.log(headlight_cd_m2)))
    ends = [float(_mean_ends(weights, ber, side)[nearest]) for side in plain]
    panels = [
        _panel(grid, receiver, column, mean, dimmed)
        for column, mean in ((chosen, least), (nearest, Estimate(float(means[nearest]), *ends)))
    ]
    return Loss(receiver, tuple(bests), dimmed, panels[0], _fixed_candidates(grid, receiver), panels[1])


def octave_weights(values: Sequence[float]) -> Floats:
    """Give each value's share of the octaves: half the way to either neighbour, and as far beyond the ends.

    Args:
        values: above 0, ascending; evenly spaced octaves weigh the same.

    Returns:
        (N,) shares that sum to 1.

    Example:
        >>> octave_weights([1000, 2000, 8000]).round(3).tolist()
        [0.222, 0.333, 0.444]
    """
    if len(values) == 1:
        return np.ones(1)
    gaps = np.diff(np.log2(values))
    widths = (np.append(gaps[0], gaps) + np.append(gaps, gaps[-1])) / 2
    return np.asarray(widths / widths.sum())


def _means(weights: Floats, rate: Floats) -> Floats:
    """Give the weighted means (K,) of rates (N,K): within the rates, which rounding may leave."""
    return np.asarray(np.clip(weights @ rate, rate.min(0), rate.max(0)))


def _mean_ends(weights: Floats, rate: Floats, ends: Floats) -> Floats:
    """Give one side's ends (K,) of the weighted means of independent rates (N,K), from the rates' own."""
    side = np.sign((ends - rate).sum(0))
    distance = np.sqrt(weights**2 @ (ends - rate) ** 2)
    return np.asarray(np.clip(_means(weights, rate) + side * distance, 0.0, 1.0))


def _mean_of_least(grid: Grid, receiver: str, bests: Sequence[Best]) -> Estimate:
    """Give the mean of the least rates, with an upper end that allows for the choice of them."""
    weights, rate = octave_weights(grid.rows), np.array([[best.ber] for best in bests])
    low = np.array([[best.ber_low] for best in bests])
    plain = grid.one_sided(receiver, (1 - CONFIDENCE) / 2)[1]
    # Of equally many errors in unequally many frames, the more frames tell more.
    least = np.where(grid.ber(receiver) == rate, plain, np.inf)
    above = least.min(1, keepdims=True) - rate
    choices = np.array([[len(best.candidates_cd_m2)] for best in bests])
    raised = rate + above * norm.ppf((choices - 0.375) / (choices + 0.25)) / norm.ppf((1 + CONFIDENCE) / 2)
    value = float(_means(weights, rate)[0])
    high = float(_mean_ends(weights, raised, raised + above)[0])
    return Estimate(value, float(_mean_ends(weights, rate, low)[0]), max(value, high))


def _panel(grid: Grid, receiver: str, column: int, mean: Estimate, dimmed: Estimate) -> Undimmed:
    """Give the panel that has one column's luminance."""
    low, high = grid.intervals(receiver)
    sides = (grid.ber(receiver)[:, column], low[:, column], high[:, column])
    cells = tuple(Estimate(*(float(side[i]) for side in sides)) for i in range(len(grid.rows)))
    return Undimmed(float(grid.columns[column]), cells, mean, _ratio(mean, dimmed))


def _ratio(rate: Estimate, least: Estimate) -> Estimate:
    """Give the ratio of a rate to the least there is, at least 1."""
    if rate.value == 0:
        return Estimate(1.0, 1.0, math.inf)
    if least.value == 0:
        return Estimate(math.inf, max(1.0, rate.low / least.high), math.inf)
    value = max(1.0, rate.value / least.value)
    low = _joined(rate.value / rate.low if rate.low else math.inf, least.high / least.value)
    high = _joined(rate.high / rate.value, least.value / least.low if least.low else math.inf)
    return Estimate(value, min(max(1.0, value / low), value), value * high)


def _joined(*factors: float) -> float:
    """Join the factors by which two independent rates may be off."""
    return math.exp(math.hypot(*(math.log(factor) for factor in factors)))


def _fixed_candidates(grid: Grid, receiver: str) -> tuple[float, ...]:
    """Give the luminances whose mean rate no other one's beats beyond doubt."""
    weights, ber = octave_weights(grid.rows), grid.ber(receiver)
    tail = (1 - CONFIDENCE) / max(1, len(grid.columns) - 1)
    ends = (_mean_ends(weights, ber, side) for side in grid.one_sided(receiver, tail))
    kept = not_worse(_means(weights, ber), *ends)
    return tuple(float(value) for value, keep in zip(grid.columns, kept, strict=True) if keep)
