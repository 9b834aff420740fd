"""How noise grows with light: the photon transfer curve of what a fit leaves."""

import math
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy import optimize

from vocc_torch.arrays import Bools, Floats
from vocc_torch.extras.calibrate.fit import RecordingFit
from vocc_torch.extras.calibrate.noise import ROUNDING, WHITE, Noise, encoded, expected


@dataclass(frozen=True)
class TransferSettings:
    """How a photon transfer curve is made."""

    bins: int = 24  # levels of light at which residuals are compared
    least_pixels: int = 50  # of a bin
    calm: float = (
        200.0  # a residual's square over its level's median beyond which it is no noise
    )
    least_median: float = (
        0.25  # of squares: whole numbers, most of them alike, have none
    )
    least_variance: float = 1e-3  # that is fitted
    passed: float = (
        1.5  # frames whose mean square is so many times the median show something else
    )
    still_px: float = 0.1  # a panel that moves less stands still
    white_margin: float = 8.0  # grey values below white that are used


SETTINGS = TransferSettings()


@dataclass(frozen=True)
class TransferCurve:
    """Variances of residuals by level of light, and what explains them.

    Args:
        light: (N,) levels.
        variance: (N,) of the grey values' residuals there.
        noise: the fitted slope and floor.
        covariance: (2,2) of slope and floor; NaN for what was not fitted.
        gains: how much the criterion favours slope, floor, over what is without.
        hidden: the floor that it takes for the criterion to favour one.
        still: whether pixels were compared from frame to frame.
    """

    light: Floats
    variance: Floats
    noise: Noise
    covariance: Floats
    gains: tuple[float, float]
    hidden: float
    still: bool

    @property
    def slope_error(self) -> float:
        """Standard deviation of the slope, over the slope."""
        return math.sqrt(self.covariance[0, 0]) / self.noise.slope


def residuals(fit: RecordingFit) -> tuple[Floats, Floats]:
    """Give residuals, and how much of their variance is left in them.

    Where the panel stands still, each pixel loses its mean over the frames in which the LED next to it is On,
    and over those in which it is Off, so that what the model misses everywhere alike is no noise.
    """
    residual = fit.grey - fit.predicted()[0]
    frames, height, width = residual.shape
    moved = max(float(np.std(fit.value(name))) for name in ("x_px", "y_px"))
    origin = fit.drawing.origin_px
    if frames < 4 or moved > SETTINGS.still_px or not bool((origin == origin[0]).all()):
        return residual, np.ones_like(residual)
    y, x = np.mgrid[:height, :width] + 0.5
    at = fit.drawing.taken(slice(0, 1)).centres_px(fit.table[:1])[0]
    nearest = np.argmin([(x - led[0]) ** 2 + (y - led[1]) ** 2 for led in at], axis=0)
    lit = fit.bits[:, nearest]
    left, remaining = residual.copy(), np.zeros_like(residual)
    for mask in (lit, np.logical_not(lit)):
        count = mask.sum(0).clip(min=1)
        left -= mask * (residual * mask).sum(0) / count
        remaining += mask * (1 - 1 / count)
    return left, remaining


class Levels(NamedTuple):
    """Residuals by level of light.

    Args:
        light: (N,).
        variance: (N,) of the residuals.
        near_whole: (N,) how near the grey values are to whole ones, from 1 to -1 for halves.
        pixels: (N,) how many.
    """

    light: Floats
    variance: Floats
    near_whole: Floats
    pixels: Floats


def by_level(fit: RecordingFit, left: Floats, remaining: Floats) -> Levels:
    """Sort residuals by light."""
    mean, variance = fit.predicted()
    light = fit.light()
    off = (left**2 / variance).mean((1, 2))
    used = np.broadcast_to(
        (off <= SETTINGS.passed * np.median(off))[:, None, None], light.shape
    )
    used = (
        used
        & (encoded(light, fit.gamma) < WHITE - SETTINGS.white_margin)
        & (remaining > 0.4)
    )
    light, square = light[used], left[used] ** 2 / remaining[used]
    near_whole = np.cos(2 * math.pi * mean[used])
    edges = np.geomspace(
        light.min(), light.max() * (1 + 1e-9) + 1e-12, SETTINGS.bins + 1
    )
    place = (np.searchsorted(edges, light, "right") - 1).clip(0, SETTINGS.bins - 1)
    rows = []
    for level in range(SETTINGS.bins):
        inside = place == level
        if inside.sum() < SETTINGS.least_pixels:
            continue
        bulk = max(float(np.median(square[inside])), SETTINGS.least_median)
        # Far residuals are what passes by.
        calm = inside & (square < SETTINGS.calm * bulk)
        means = (values[calm].mean() for values in (square, near_whole))
        rows.append((light[inside].mean(), *means, calm.sum()))
    return Levels(*np.array(rows).reshape(-1, 4).T)


def transfer(fit: RecordingFit) -> TransferCurve:
    """Fit a photon transfer curve to the residuals of a fit, in grey values as they are written."""
    left, remaining = residuals(fit)
    light, raw, near_whole, count = by_level(fit, left, remaining)
    most = int(count.argmax())
    unit = (fit.gamma * light / encoded(light, fit.gamma))[most] ** 2 * raw[most]
    first = np.maximum([unit / light[most], unit], 1e-15)

    def predicted(noise: Floats) -> Floats:
        variance = expected(light, fit.gamma, Noise(*noise.tolist()))[1]
        spread = variance - ROUNDING  # little of it rounds pixels of one light alike
        alike = np.exp(-2 * math.pi**2 * spread) * (1 / math.pi**2 + 4 * spread)
        return (variance - near_whole * alike).clip(min=SETTINGS.least_variance)

    def loss(noise: Floats) -> float:
        variance = predicted(noise)
        return float((count * (np.log(variance) + raw / variance)).sum())

    def best(free: Bools) -> tuple[Floats, float]:
        """Fit slope, floor or both; what is not free is 0."""

        def noise_of(logs: Floats) -> Floats:
            noise = np.zeros(2)
            noise[free] = np.exp(logs)
            return noise

        if not free.any():
            return np.zeros(2), loss(np.zeros(2))
        found = optimize.minimize(
            lambda logs: loss(noise_of(logs)),
            np.log(first[free] / free.sum()),
            method="Nelder-Mead",
            options={"xatol": 1e-5, "fatol": 1e-6},
        )
        return noise_of(found.x), float(found.fun)

    models = np.array(list(product((False, True), repeat=2)))
    fitted, losses = zip(*map(best, models), strict=True)
    # Bins that no curve meets say less.
    miss = count / 2 * (raw / predicted(fitted[-1]) - 1) ** 2
    doubt = max(1.0, float(miss.sum()) / max(len(light) - 2, 1))
    cost = math.log(max(float(count.sum()), 2.0))
    criterion = np.array(losses) / doubt + models.sum(1) * cost
    gains = [
        float(criterion[~with_it].min() - criterion[with_it].min())
        for with_it in models.T
    ]
    chosen = int(criterion.argmin())
    noise, used = fitted[chosen], np.flatnonzero(models[chosen])
    covariance, hidden = np.full((2, 2), math.nan), math.nan
    if len(used):
        slopes = optimize.approx_fprime(noise, predicted, 1e-4 * first).T
        information = (slopes * count / (2 * doubt * predicted(noise) ** 2)) @ slopes.T
        block = np.ix_(used, used)
        covariance[block] = np.linalg.pinv(information[block], rcond=1e-14)
        floor = np.linalg.pinv(information, rcond=1e-14)[1, 1]
        hidden = math.sqrt(cost * max(0.0, float(floor)))
    noise_model = Noise(*noise.tolist())
    return TransferCurve(
        light,
        raw,
        noise_model,
        covariance,
        (gains[0], gains[1]),
        hidden,
        bool((remaining < 1).any()),
    )


def bent(fit: RecordingFit) -> RecordingFit:
    """Move gamma by its deviation, and what each frame has by itself as it follows."""
    at = fit.values - len(fit.shared)
    covariance = fit.covariances[0]
    step = covariance[:, at] / max(covariance[at, at], 1e-300) * fit.deviation("gamma")
    return fit.moved(fit.packed() + step)
