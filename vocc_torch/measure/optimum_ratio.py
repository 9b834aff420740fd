"""Which ratio of LED luminance to ambient light the best luminance keeps."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vocc_torch.errors import VoccError
from vocc_torch.measure.dimming import CONFIDENCE, Bools, Floats, Grid, best_luminance, wrong_bits_near
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import design_effect
from vocc_torch.rng import BlockKey

FEWEST_LEVELS = 3
"""Fewest ambient lights that tell a slope."""
_REDRAWS = 4000


@dataclass(frozen=True, slots=True)
class OptimumRatio:
    """How the best luminance follows the ambient light: in proportion to ``ambient_lx ** slope``.

    Args:
        receiver: its name.
        ambient_lx: ambient lights that it was taken from; at the others the best may lie beyond the grid.
        optimum_cd_m2: the best luminance under each, between the grid's values where they tell.
        slope: of its logarithm over that of the ambient light; 1 is a constant ratio, 0 a constant luminance.
            None with fewer than three ambient lights.
        ratio: geometric mean of luminance over ambient light, cd/m2 a lx; None as for ``slope``.

    Example:
        >>> slope, ratio = Estimate(0.97, 0.8, 1.1), Estimate(0.5, 0.4, 0.6)
        >>> OptimumRatio("flda_3", (2e3, 4e3, 8e3), (1e3, 2e3, 3.8e3), slope, ratio).proportional
        True
    """

    receiver: str
    ambient_lx: tuple[float, ...]
    optimum_cd_m2: tuple[float, ...]
    slope: Estimate | None
    ratio: Estimate | None

    @property
    def proportional(self) -> bool:
        """Whether a constant ratio of luminance to ambient light agrees with the slope's interval."""
        return self.slope is not None and self.slope.low <= 1 <= self.slope.high


def optimum_ratio(grid: Grid, receiver: str) -> OptimumRatio:
    """Fit a line through the logarithms of the best luminance and the ambient light, by least squares.

    Ambient lights where the best may lie beyond the grid are left out: they would flatten the line. The best
    luminance is taken between the grid's values, at the vertex of the parabola through the logarithms of the
    least bit error rate and its two neighbours, or in the middle of a plateau of equal rates, such as one
    without errors. With fewer than three ambient lights left there is no line.

    The intervals are those of a parametric bootstrap: all is done again with each cell's errors drawn anew
    from a binomial distribution with its effective number of independent bits (bits over design effect), and
    a cell without errors is taken to have had half a wrong frame.

    Args:
        grid: ambient light by LED luminance.
        receiver: its name.

    Raises:
        VoccError: an unknown receiver.

    Example:
        >>> from vocc_torch.measure.counts import Counts
        >>> from vocc_torch.measure.curves import Curves
        >>> def curves(place):  # the best luminance at a place on the axis
        ...     wrong = [40 * 4 ** abs(i - place) for i in range(5)]
        ...     cells = [Counts(40960, 2621440, 2 * w, 4 * w, w) for w in wrong]
        ...     values = [500, 1000, 2000, 4000, 8000]
        ...     counts = {("flda_3", value): cell for value, cell in zip(values, cells)}
        ...     stopped = dict.fromkeys(values, "frames")
        ...     axis = "led_luminance_cd_m2"
        ...     return Curves("dimming", axis, "truth", ("flda_3",), tuple(values), counts, {}, stopped)
        >>> grid = Grid("ambient_lx", (2e3, 4e3, 8e3), (curves(1), curves(2), curves(3)))
        >>> followed = optimum_ratio(grid, "flda_3")
        >>> round(followed.slope.value, 6), round(followed.ratio.value, 6), followed.proportional
        (1.0, 0.5, True)
    """
    bests = best_luminance(grid, receiver)
    inside = np.array([not (best.reaches_lowest or best.reaches_highest) for best in bests])
    octaves, at = np.log2(grid.columns), np.log2(grid.rows)[inside]
    optimum = _optima(grid.ber(receiver)[inside], octaves)
    ambient = tuple(row for row, kept in zip(grid.rows, inside, strict=True) if kept)
    luminance = tuple(float(value) for value in 2.0**optimum)
    if len(ambient) < FEWEST_LEVELS:
        return OptimumRatio(receiver, ambient, luminance, None, None)
    redrawn = _optima(_redraws(grid, receiver, inside), octaves)
    part = (at - at.mean()) / ((at - at.mean()) ** 2).sum()
    slope = _estimate(optimum @ part, redrawn @ part)
    ratio = _estimate(2.0 ** (optimum - at).mean(), 2.0 ** (redrawn - at).mean(-1))
    return OptimumRatio(receiver, ambient, luminance, slope, ratio)


def _optima(rate: Floats, octaves: Floats) -> Floats:
    """Give the best luminances (...) in octaves, from bit error rates (...,K)."""
    least = rate == rate.min(-1, keepdims=True)
    first, last = least.argmax(-1), len(octaves) - 1 - least[..., ::-1].argmax(-1)
    i = np.clip(first, 1, len(octaves) - 2)
    near = np.take_along_axis(rate, i[..., None] + np.arange(-1, 2), -1)
    # A parabola through the logarithms needs one least rate, above 0, with a neighbour on both sides. Rates
    # that differ by rounding alone may have the same logarithm.
    bent = (first == last) & (first == i) & (near.min(-1) > 0)
    y = np.log(np.where(bent[..., None], near, 1.0))
    bent &= np.minimum(y[..., 0], y[..., 2]) > y[..., 1]
    left, right = octaves[i - 1] - octaves[i], octaves[i + 1] - octaves[i]
    # a x^2 + b x through 0 and both neighbours has its vertex at -b / 2a.
    slopes = (y[..., 0] - y[..., 1]) / left, (y[..., 2] - y[..., 1]) / right
    a = np.where(bent, (slopes[0] - slopes[1]) / (left - right), 1.0)
    b = slopes[0] - a * left
    return np.asarray(np.where(bent, octaves[i] - b / (2 * a), (octaves[first] + octaves[last]) / 2))


def _redraws(grid: Grid, receiver: str, rows: Bools) -> Floats:
    """Draw the bit error rates (draws, rows, K) of some rows again."""
    counts = grid.counts(receiver)
    sizes = np.array(wrong_bits_near(counts))
    effects = [[design_effect(cell) for cell in row] for row in counts]
    errors, bits = (
        np.array([[getattr(cell, name) for cell in row] for row in counts]) for name in ("bit_errors", "bits")
    )
    effect = np.where(errors == 0, sizes, effects)[rows]
    trials = np.maximum(1, (bits[rows] / effect).round()).astype(np.int64)
    rate = np.where(errors == 0, sizes / 2, errors)[rows] / bits[rows]
    random = BlockKey(0, f"dimming/{receiver}", 0).generator("redraws")
    return np.asarray(random.binomial(trials, rate, (_REDRAWS, *rate.shape)) / trials)


def _estimate(value: float, redrawn: Floats) -> Estimate:
    """Give a number with the interval of its redraws."""
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(redrawn, (tail, 1 - tail))
    return Estimate(float(value), min(float(low), float(value)), max(float(high), float(value)))


def on_off_ratio(luminance_cd_m2: float, ambient_lx: float, led_reflectance: float = 0.4) -> float:
    """Give the luminous exposure of an On LED over that of an Off one, ``1 + pi L / (E R)`` (Eqs 2 and 3).

    The air between, which takes 1 % of the LED's light at 70 m in the paper, is left out.

    Args:
        luminance_cd_m2: of the LED's own light, cd/m2, at least 0.
        ambient_lx: illuminance, lx, above 0.
        led_reflectance: above 0, at most 1; 0.4 is the paper's.

    Raises:
        VoccError: an argument outside its range.

    Example:
        >>> round(on_off_ratio(4000.0, 8000.0), 3)
        4.927
    """
    if not 0 <= luminance_cd_m2 < math.inf:
        raise VoccError(f"luminance_cd_m2 is {luminance_cd_m2}: it must be at least 0 and finite")
    if not 0 < ambient_lx < math.inf:
        raise VoccError(f"ambient_lx is {ambient_lx}: it must be above 0 and finite")
    if not 0 < led_reflectance <= 1:
        raise VoccError(f"led_reflectance is {led_reflectance}: it must be above 0 and at most 1")
    ratio = 1 + math.pi * (luminance_cd_m2 / ambient_lx) / led_reflectance
    if ratio == math.inf:
        raise VoccError(
            f"led_reflectance is {led_reflectance}: it is too small for {luminance_cd_m2:g} cd/m2 at "
            f"{ambient_lx:g} lx, whose ratio no number holds"
        )
    return ratio
