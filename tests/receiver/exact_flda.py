"""Training sets built to be nasty, and Fisher's discriminant of them to 50 digits."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import mpmath
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.linalg import hilbert

from vocc_torch.receiver.discriminant import FLDAWarning, discriminant

DIGITS = 50
SAMPLES = 40
Array = NDArray[np.float64]
Bits = NDArray[np.bool_]


@dataclass(frozen=True)
class Exact:
    """The discriminant of the very float64 numbers given, as mpmath numbers.

    Args:
        direction: w, F numbers.
        threshold: w times the midpoint.
        midpoint: of the class means, F numbers.
        scale: the features' standard deviations within the classes, F numbers.
    """

    direction: list[mpmath.mpf]
    threshold: mpmath.mpf
    midpoint: list[mpmath.mpf]
    scale: list[mpmath.mpf]

    @classmethod
    def of(cls, x: Array, on: Bits) -> Exact:
        """Solve Eqs. 14, 15 and 19 for features (N,F) and bits (N,)."""
        with mpmath.workdps(DIGITS):
            features = x.shape[1]
            scatter, means = mpmath.zeros(features), []
            for bit in (False, True):
                rows = [[mpmath.mpf(value) for value in row] for row in x[on == bit]]
                means.append(
                    [
                        mpmath.fsum(column) / len(rows)
                        for column in zip(*rows, strict=True)
                    ]
                )
                centred = mpmath.matrix(rows) - mpmath.matrix([means[-1]] * len(rows))
                scatter += centred.T * centred
            scale = [mpmath.sqrt(scatter[j, j] / len(x)) for j in range(features)]
            units = mpmath.diag([1 / s for s in scale])
            gap = mpmath.matrix([b - a for a, b in zip(*means, strict=True)])
            direction = list(
                units * mpmath.lu_solve(units * scatter * units / len(x), units * gap)
            )
            midpoint = [(a + b) / 2 for a, b in zip(*means, strict=True)]
            return cls(direction, mpmath.fdot(direction, midpoint), midpoint, scale)

    def errors(self, direction: Array, threshold: float) -> tuple[float, float]:
        """Relative errors of a direction (F,) and a threshold, neither of which depends on units.

        A direction's is the length of the difference over the length, each coordinate times the feature's
        standard deviation: that is what it adds to the score of a typical sample. A threshold is the product
        of a direction and a midpoint, and may vanish though neither does; its error is relative to the
        product of their lengths in those coordinates.
        """
        with mpmath.workdps(DIGITS):
            pairs = list(zip(self.direction, self.scale, strict=True))
            length = mpmath.norm([w * s for w, s in pairs])
            apart = mpmath.norm(
                [(w - float(v)) * s for (w, s), v in zip(pairs, direction, strict=True)]
            )
            reach = mpmath.norm(
                [m / s for m, s in zip(self.midpoint, self.scale, strict=True)]
            )
            return float(apart / length), float(
                abs(self.threshold - threshold) / length / reach
            )


def condition_number(x: Array, on: Bits) -> float:
    """Condition number of the within-class covariance of features (N,F) in units of their deviations.

    By the singular values of the centred samples, whose ratio is only the root of it: good to 1e-8 at 1e16.
    """
    centred = x.copy()
    for bit in (False, True):
        # Exact where the features lie at an offset.
        rows = x[on == bit] - x[on == bit][0]
        centred[on == bit] = rows - rows.mean(axis=0)
    values = np.linalg.svd(
        centred / np.sqrt((centred**2).mean(axis=0)), compute_uv=False
    )
    return float((values[0] / values[-1]) ** 2)


def _two_classes(
    rng: np.random.Generator, root: Array, gap: Array
) -> tuple[Array, Bits]:
    """Draw samples with covariance ``root root'``, their classes a gap apart, in an order of no meaning."""
    on = rng.permutation(np.arange(SAMPLES) % 2 == 1)
    return rng.normal(size=(SAMPLES, len(root))) @ root.T + on[:, None] * gap, on


def _root(rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw a covariance of 2 to 8 features, of condition number about 10 to 1e17: its root and its axes."""
    features, powers = int(rng.integers(2, 9)), rng.uniform(1, 17)
    axes, _ = np.linalg.qr(rng.normal(size=(features, features)))
    return axes * np.logspace(0, -powers / 2, features), axes


def rotated(rng: np.random.Generator) -> tuple[Array, Bits]:
    """Draw any axes and any gap, at scales from 1e-6 to 1e6."""
    root, _ = _root(rng)
    x, on = _two_classes(rng, root, rng.normal(size=len(root)))
    return x * 10.0 ** rng.uniform(-6, 6, len(root)), on


def hilberts(rng: np.random.Generator) -> tuple[Array, Bits]:
    """Draw a covariance that is Hilbert's matrix, of 2 to 8 features, at scales from 1e-12 to 1e12."""
    root = np.linalg.cholesky(hilbert(int(rng.integers(2, 9))))
    x, on = _two_classes(rng, root, rng.normal(size=len(root)))
    return x * 10.0 ** rng.uniform(-12, 12, len(root)), on


def far_away(rng: np.random.Generator) -> tuple[Array, Bits]:
    """Draw unit spreads at offsets of 1e4."""
    root, _ = _root(rng)
    x, on = _two_classes(rng, root, rng.normal(size=len(root)))
    return x + 1e4 * rng.choice([-1.0, 1.0], len(root)), on


def gap_along_most(rng: np.random.Generator) -> tuple[Array, Bits]:
    """Draw the gap along the axis of most variance, where an error along that of least weighs most."""
    root, axes = _root(rng)
    return _two_classes(rng, root, 3 * axes[:, 0])


def twins(rng: np.random.Generator) -> tuple[Array, Bits]:
    """Draw two to seven features, the last of which comes twice but for a little noise."""
    features = int(rng.integers(2, 8))
    x, on = _two_classes(rng, np.eye(features), rng.normal(size=features))
    twin = x[:, -1:] + 10 ** rng.uniform(-8.5, -0.5) * rng.normal(size=(SAMPLES, 1))
    return np.concatenate([x, -3 * twin + 7], axis=1), on


FAMILIES: tuple[Callable[[np.random.Generator], tuple[Array, Bits]], ...] = (
    rotated,
    hilberts,
    far_away,
    gap_along_most,
    twins,
)


def float64_error(x: Array, on: Bits) -> tuple[float, float]:
    """Compare the discriminant of a training set with the exact one.

    Returns:
        The greater relative error of direction and threshold, as :meth:`Exact.errors`, or 0 where the
        discriminant says that the set does not determine it. And what amplifies the machine epsilon: the
        condition number, times the greatest distance of the classes' midpoint from 0 in a feature's standard
        deviations where that is above 1.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", FLDAWarning)
        rule = discriminant(torch.from_numpy(x), torch.from_numpy(on))
    exact = Exact.of(x, on)
    pairs = zip(exact.midpoint, exact.scale, strict=True)
    offset = max(float(abs(middle / scale)) for middle, scale in pairs)
    errors = exact.errors(rule.direction.numpy(), float(rule.threshold))
    reach = condition_number(x, on) * max(1.0, offset)
    return 0.0 if caught else max(errors), reach


def clouds(
    seed: int, samples: int = 200, features: int = 3
) -> tuple[torch.Tensor, torch.Tensor]:
    """Draw two overlapping clouds of correlated features, on a grid that float64 resolves at 1e8; their bits."""
    rng = np.random.default_rng(seed)
    bits = rng.random(samples) < 0.4
    bits[:4] = False, True, False, True
    mix = np.eye(features) + rng.uniform(-0.5, 0.5, (features, features)) / features
    x = rng.normal(size=(samples, features)) @ mix + 1.5 * bits[:, None]
    return torch.from_numpy(np.round(x * 2**20) / 2**20), torch.from_numpy(bits)
