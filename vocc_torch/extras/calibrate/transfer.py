"""How noise grows with light: the photon transfer curve of what a fit leaves."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from vocc_torch.arrays import Floats
from vocc_torch.extras.calibrate.model import RecordingFit
from vocc_torch.extras.calibrate.noise import WHITE, Noise, encoded, expected


@dataclass(frozen=True)
class TransferSettings:
    """How a photon transfer curve is made."""

    levels: int = (
        48  # of light, of as many pixels each, at which residuals are compared
    )
    calm: float = (
        200.0  # a residual's square over its level's median beyond which it is no noise
    )
    least_median: float = (
        0.25  # of squares: whole numbers, most of them alike, have none
    )
    still_px: float = 0.1  # a panel that moves less stands still
    white_margin: float = 8.0  # grey values below white that are used
    left_share: float = 0.4  # of a residual's variance, below which it is not used


SETTINGS = TransferSettings()


@dataclass(frozen=True)
class TransferCurve:
    """Variances of residuals by level of light, and what explains them.

    Args:
        light: (N,) levels.
        variance: (N,) of the grey values' residuals there.
        noise: the fitted slope and floor.
        covariance: (2,2) of slope and floor.
        gains: how much the criterion favours slope and floor; one that it does not favour is 0.
    """

    light: Floats
    variance: Floats
    noise: Noise
    covariance: Floats
    gains: list[float]


def by_level(fit: RecordingFit) -> Floats:
    """Give levels of light, the residuals' variance there, and how many pixels tell it, (3,N).

    Where the panel stands still, each pixel loses its mean over the frames in which the LED next to it is On,
    and over those in which it is Off, so that what the model misses everywhere alike is no noise.
    """
    light = fit.light()
    left = fit.grey - fit.predicted()[0]
    remaining, origin = np.ones_like(left), fit.origin_px
    moved = np.std([fit.values["x_px"], fit.values["y_px"]], axis=1).max()
    if moved < SETTINGS.still_px and bool((origin == origin[0]).all()):
        every = np.arange(fit.panel.shape.leds)
        lit = fit.lit[:, fit.nearest(every)[0]]
        for mask in (lit, np.logical_not(lit)):
            share = mask / mask.sum(0).clip(min=1)
            left -= mask * (left * share).sum(0)
            remaining -= share
    used = encoded(light, fit.gamma) < WHITE - SETTINGS.white_margin
    used &= remaining > SETTINGS.left_share
    light, square = light[used], left[used] ** 2 / remaining[used]
    rows = []
    for part in np.array_split(np.argsort(light), SETTINGS.levels):
        bulk = max(float(np.median(square[part])), SETTINGS.least_median)
        # Far residuals are what passes by.
        calm = part[square[part] < SETTINGS.calm * bulk]
        rows.append((light[calm].mean(), square[calm].mean(), len(calm)))
    return np.array(rows).T


def transfer(fit: RecordingFit) -> TransferCurve:
    """Fit a photon transfer curve to the residuals of a fit, in grey values as they are written."""
    light, raw, count = by_level(fit)
    slope = fit.gamma * light / encoded(light, fit.gamma)
    unit = float(np.median(slope**2 * raw).clip(min=1e-15))
    first = np.array([unit / np.median(light), unit])

    def misfit(values: Floats) -> Floats:
        noise = Noise(*(values * first).tolist())
        expected_variance = expected(light, fit.gamma, noise)[1]
        return np.asarray(np.sqrt(count / 2) * np.log(raw / expected_variance))

    found = optimize.least_squares(misfit, (0.5, 0.5), bounds=(0, math.inf))
    # Levels that no curve meets say less.
    doubt = max(1.0, 2 * found.cost / max(len(light) - 2, 1))
    spread = doubt * np.linalg.pinv(found.jac.T @ found.jac, rcond=1e-10)
    # Wald's statistic beyond the price of a parameter by the Bayesian information criterion.
    gains = found.x**2 / spread.diagonal().clip(min=1e-30)
    gains -= math.log(max(float(count.sum()), 2.0))
    return TransferCurve(
        light,
        raw,
        Noise(*(found.x * first * (gains > 0)).tolist()),
        spread * np.outer(first, first),
        gains.tolist(),
    )
