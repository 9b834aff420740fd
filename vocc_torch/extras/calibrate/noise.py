"""Grey values of light: the encoding, and the mean and variance of what noisy light is written as."""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from vocc_torch.arrays import Floats
from vocc_torch.simulation.photometry import MIDDLE_GREY

WHITE = 255.0
ROUNDING = 1 / 12
"""Variance of the rounding to whole grey values."""


@dataclass(frozen=True)
class AverageSettings:
    """How light is encoded, and averaged over its noise."""

    least_light: float = 1e-9  # the slope of the encoding is infinite at 0
    widest_sigmas: float = 6.0  # of noise on either side
    nodes: int = 129  # over these: the encoding is bent near black and white
    brightest: float = 4.0  # times white's grey value, beyond which all is white
    levels: int = 4096  # of light, between which is interpolated


AVERAGE = AverageSettings()


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
    return (np.maximum(grey, 1e-3) / MIDDLE_GREY) ** gamma


def encoded(x: Floats, gamma: float, white: float = WHITE) -> Floats:
    """Encode light as grey values, clipped at white (Eq. 1)."""
    return np.minimum(
        MIDDLE_GREY * np.maximum(x, AVERAGE.least_light) ** (1 / gamma), white
    )


def expected(x: Floats, gamma: float, noise: Noise) -> tuple[Floats, Floats]:
    """Give the mean and the variance of the grey values that noisy light is written as."""
    if noise == Noise():
        return encoded(x, gamma), np.full_like(x, ROUNDING)
    levels = np.linspace(0.0, AVERAGE.brightest * WHITE, AVERAGE.levels)
    light = linear(levels, gamma)
    nodes = np.linspace(-AVERAGE.widest_sigmas, AVERAGE.widest_sigmas, AVERAGE.nodes)
    shares = stats.norm.pdf(nodes)
    shares /= shares.sum()
    sigma = np.sqrt(noise.slope * light + noise.floor)
    greys = encoded(light[:, None] + sigma[:, None] * nodes, gamma)
    mean = greys @ shares
    variance = greys**2 @ shares - mean**2
    at = encoded(x, gamma, levels[-1])
    return np.interp(at, levels, mean), np.interp(at, levels, variance) + ROUNDING
