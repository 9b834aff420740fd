"""Grey values of light: the encoding, and the mean and variance of what noisy light is written as."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss

from vocc_torch.arrays import Floats
from vocc_torch.simulation.photometry import MIDDLE_GREY

WHITE = 255.0
LEAST_LIGHT = 1e-9
ROUNDING = 1 / 12
"""Variance of the rounding to whole grey values."""


@dataclass(frozen=True)
class DarkSettings:
    """How noise near black and white is averaged over."""

    nodes: int = 24  # of Gauss and Legendre
    widest_sigmas: float = 6.0  # of noise on either side
    dark_sigmas: float = (
        5.0  # light below so many of its deviations is dark: the encoding is bent there
    )
    least_grey: float = 0.3  # of the noise near white


DARK = DarkSettings()


@dataclass(frozen=True)
class Noise:
    """The variance of linear light, ``slope x + floor``: a photon transfer curve.

    Args:
        slope: of light, one over the electrons that make the grey value 118.
        floor: variance in the dark.
    """

    slope: float = 0.0
    floor: float = 0.0


def linear(grey: Floats, gamma: float) -> Floats:
    """Give the light that is encoded as grey values which no white clips."""
    return np.asarray((np.maximum(grey, 1e-3) / MIDDLE_GREY) ** gamma)


def encoded(x: Floats, gamma: float) -> Floats:
    """Encode light as grey values, clipped at white (Eq. 1)."""
    return np.minimum(MIDDLE_GREY * np.maximum(x, LEAST_LIGHT) ** (1 / gamma), WHITE)


def expected(x: Floats, gamma: float, noise: Noise) -> tuple[Floats, Floats]:
    """Give the mean and the variance of the grey values that noisy light is written as.

    Where light is far above its noise, by the encoding's derivatives; where it is dark, or clipped at white,
    by an average over the noise.
    """
    grey = encoded(x, gamma)
    if not (noise.slope or noise.floor):
        return grey, np.full_like(x, ROUNDING)
    variance = noise.slope * x + noise.floor
    steep = np.where(grey < WHITE, grey / (gamma * x), 0.0)
    mean = grey + steep * (1 / gamma - 1) / x * variance / 2
    spread = steep**2 * variance
    near = x < DARK.dark_sigmas * np.sqrt(variance)
    near |= np.abs(grey - WHITE) < DARK.dark_sigmas * np.maximum(
        np.sqrt(spread), DARK.least_grey
    )
    if near.any():
        mean[near], spread[near] = averaged(x[near], np.sqrt(variance[near]), gamma)
    return mean, spread + ROUNDING


def averaged(x: Floats, sigma: Floats, gamma: float) -> tuple[Floats, Floats]:
    """Average encoded light over normal noise, in the root of the light, where the encoding is smooth."""
    nodes, shares = leggauss(DARK.nodes)
    level = (x / sigma)[:, None]
    low = np.sqrt(np.maximum(level - DARK.widest_sigmas, 0.0))
    half = (np.sqrt(level + DARK.widest_sigmas) - low) / 2
    root = low + half * (nodes + 1)
    density = np.exp(-((root**2 - level) ** 2) / 2) / math.sqrt(2 * math.pi)
    weights = half * shares * 2 * root * density
    greys = encoded(sigma[:, None] * root**2, gamma)
    first = (greys * weights).sum(1)
    return first, (greys**2 * weights).sum(1) - first**2
