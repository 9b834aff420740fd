"""How noise grows with light: the photon transfer curve of what a fit leaves."""

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.polynomial.hermite_e import hermegauss
from scipy import optimize
from torch import Tensor

from vocc_torch.extras.calibrate import model
from vocc_torch.extras.calibrate.fit import RecordingFit
from vocc_torch.extras.calibrate.model import Noise
from vocc_torch.extras.calibrate.surround import Array

BINS = 24
"""Levels of light at which residuals are compared."""
CALM = 200.0
"""A residual's square over its level's median beyond which it is no noise; dark noise is skew."""
WHOLE, LEAST = 0.25, 1e-3
"""Least median: whole numbers, most of them alike, have none. Least variance that is fitted."""
PASSED = 1.5
"""Frames whose residuals' mean square exceeds so many times the median show something else, too."""
STILL_PX = 0.1
"""A panel that moves less stands still: its pixels can be compared from frame to frame."""

HERMITE, TURNS = 12, 12
"""Points at which a pattern is averaged over, and turns in which its width is found."""


class Curve(NamedTuple):
    """A photon transfer curve: variances of residuals by level of light, and what explains them.

    Args:
        light: (N,) levels.
        variance: (N,) of the grey values' residuals there.
        noise: the fitted slope and floor.
        covariance: (2,2) of slope and floor; NaN for what was not fitted.
        gains: how much the criterion favours slope, floor, over what is without.
        hidden: the floor that it takes for the criterion to favour one.
        still: whether pixels were compared from frame to frame.
    """

    light: Array
    variance: Array
    noise: Noise
    covariance: Array
    gains: list[float]
    hidden: float
    still: bool

    @property
    def slope_error(self) -> float:
        """Standard deviation of the slope, over the slope."""
        return math.sqrt(self.covariance[0, 0]) / self.noise.slope


def residuals(fit: RecordingFit) -> tuple[Tensor, Tensor, bool]:
    """Give residuals, how much of their variance is left in them, and whether the panel stands still.

    Where it does, each pixel loses its mean over the frames in which the LED next to it is On, and over those
    in which it is Off, so that what the model misses everywhere alike is no noise.
    """
    residual = fit.grey - fit.predicted()[0]
    moved = max(float(fit.value(name).std()) if len(fit.grey) > 1 else 0.0 for name in ("x_px", "y_px"))
    fixed = bool((fit.windows.origin_px == fit.windows.origin_px[0]).all())
    if len(fit.grey) < 4 or moved > STILL_PX or not fixed:
        return residual, torch.ones_like(residual), False
    at = model.seen(fit.windows, fit.of_frame[:1], fit.of_all, model.grid(fit.windows.shape))[0][0]
    sides = (torch.arange(n) + 0.5 for n in fit.windows.size_px[::-1])
    pixels = torch.stack(torch.meshgrid(*sides, indexing="xy"), -1).view(-1, 2).double()
    nearest = torch.cdist(pixels + fit.windows.origin_px[0], at).argmin(1)
    lit = fit.bits[:, nearest].view_as(residual)
    left, kept = residual.clone(), torch.zeros_like(residual)
    for one in (lit, ~lit):
        count = one.sum(0)
        mean = (residual * one).sum(0) / count.clamp(min=1)
        left = torch.where(one, left - mean, left)
        kept = torch.where(one, (1 - 1 / count.clamp(min=1)).expand_as(kept), kept)
    return left, kept, True


def by_level(fit: RecordingFit) -> tuple[Tensor, Tensor, Tensor, Tensor, bool]:
    """Give levels of light, the residuals' variance there, of how many pixels, and if the panel stands.

    Before the last: how near the grey values of a level are to whole ones, from 1 to -1 for halves.
    """
    (left, kept, still), (mean, variance) = residuals(fit), fit.predicted()
    light = fit.light().flatten()
    off = (left.square() / variance).mean((1, 2))
    seen = (off <= PASSED * off.median()).repeat_interleave(left[0].numel())
    use = seen & (model.encoded(light, fit.of_all[0]) < model.WHITE - 8) & (kept.flatten() > 0.4)
    light, square = light[use], (left.flatten()[use].square() / kept.flatten()[use])
    low, high = float(light.min().log()), float(light.max().log())
    place = ((light.log() - low) / max(high - low, 1e-9) * BINS).long().clamp(max=BINS - 1)
    count = torch.bincount(place, minlength=BINS)
    good = count >= 50
    # Far residuals are what passes by, not noise.
    bulk = torch.stack([square[place == i].median() if good[i] else square.sum() for i in range(BINS)])
    calm = square < CALM * bulk.clamp(min=WHOLE)[place]
    near = torch.bincount(place[calm], minlength=BINS).double()[good]
    near_whole = (2 * math.pi * mean.flatten()[use]).cos()
    raw, alike = (
        torch.bincount(place[calm], one[calm], BINS)[good] / near.clamp(min=1) for one in (square, near_whole)
    )
    return torch.bincount(place, light, BINS)[good] / count[good], raw, near, alike, still


def transfer(fit: RecordingFit) -> Curve:
    """Fit a photon transfer curve to the residuals of a fit, in grey values as they are written."""
    level, raw, count, alike, still = by_level(fit)
    gamma, most = fit.of_all[0], int(count.argmax())

    def predicted(noise: Array) -> Tensor:
        variance = model.expected(level, gamma, Noise(*noise.tolist()))[1]
        spread = variance - model.ROUNDING  # little of it rounds pixels of one light alike
        alone = alike * torch.exp(-2 * math.pi**2 * spread) * (1 / math.pi**2 + 4 * spread)
        return (variance - alone).clamp(min=LEAST)

    def loss(noise: Array) -> float:
        variance = predicted(noise)
        return float((count * (variance.log() + raw / variance)).sum())

    def part(at: list[int], logs: Array) -> Array:
        noise = np.zeros(2)
        noise[at] = np.exp(logs)
        return noise

    unit = float((gamma * level / model.encoded(level, gamma)).square()[most] * raw[most])
    first = np.log(np.maximum([unit / float(level[most]), unit], 1e-15))

    def best(at: list[int], lower: float) -> tuple[Array, float]:
        how: dict[str, Any] = {"method": "Nelder-Mead", "options": {"xatol": 1e-5, "fatol": 1e-6}}
        found = optimize.minimize(lambda logs: loss(part(at, logs)), first[at] - lower, **how)
        return part(at, found.x), float(found.fun)

    fits = best([0], 0.0), best([1], 0.0), best([0, 1], 0.7)
    (_, slope), (_, floor), (wanted, both) = fits
    # The curve's own misfit: bins that no curve meets say less.
    miss = float((count / 2 * (raw / predicted(wanted) - 1).square()).sum()) / max(len(level) - 2, 1)
    miss, cost = max(1.0, miss), math.log(max(float(count.sum()), 2.0))
    gains = [(alone - both) / miss - cost for alone in (floor, slope)]
    kept = [i for i in (0, 1) if gains[i] > 0]
    if not kept:  # either explains what both do
        gains = [(loss(np.zeros(2)) - alone) / miss - cost for alone in (slope, floor)]
        kept = [int(np.argmax(gains))] if max(gains) > 0 else []
        gains = [gain if i in kept else min(gain, 0.0) for i, gain in enumerate(gains)]
    noise = fits[2 if len(kept) == 2 else kept[0]][0] if kept else np.zeros(2)
    covariance, hidden = np.full((2, 2), math.nan), math.nan
    if kept:
        step = 1e-4 * np.diag(np.exp(first))
        slopes = torch.stack([(predicted(noise + one) - predicted(noise)) / one.sum() for one in step])
        information = (slopes * (count / (2 * miss * predicted(noise).square()))) @ slopes.T
        covariance[np.ix_(kept, kept)] = torch.linalg.pinv(information[kept][:, kept], hermitian=True)
        hidden = math.sqrt(cost * max(0.0, float(torch.linalg.pinv(information, hermitian=True)[1, 1])))
    return Curve(level.numpy(), raw.numpy(), Noise(*noise.tolist()), covariance, gains, hidden, still)


def pattern(greys: float, x: float, gamma: Tensor, curve: Curve) -> float:
    """Say by how much light differs, standard deviation, where mean grey values differ by ``greys``.

    Near black the encoding is steep and clipped, so no slope tells it; what moves over the pixels has the
    pattern in its noise.
    """
    whole = curve.noise.slope * x + curve.noise.floor
    sigma, (t, w) = 0.1 * math.sqrt(whole), (torch.from_numpy(part) for part in hermegauss(HERMITE))
    for _ in range(TURNS):
        rest = max(whole - sigma**2 * (not curve.still), 0.1 * whole)
        place = (x + sigma * t).clamp(min=-model.DARK_SIGMAS * math.sqrt(rest))
        mean = model.expected(place, gamma, Noise(0.0, rest))[0]
        mean = mean - (w * mean).sum() / w.sum()
        sigma *= greys / math.sqrt(float((w * mean.square()).sum() / w.sum()))
    return sigma
