"""Maximum likelihood by ``scipy.optimize.least_squares``: values of each frame beside those of all."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, sparse, stats

from vocc_torch.arrays import Floats
from vocc_torch.extras.calibrate.model import (
    LEVELS,
    PLACED,
    SHARED,
    TURNED,
    RecordingFit,
)

SURE = 1.959963985
"""Standard deviations of a normal 95 % interval."""

BASE = (*PLACED, *LEVELS, *SHARED[1:])
POSED = (*BASE, *TURNED)

Range = tuple[float, float]


@dataclass(frozen=True)
class RecordingFitSettings:
    """How a fit is made."""

    clear_sigmas: float = 4.0  # a pixel farther off counts less: it may be a reflection
    evaluations: int = 12  # of the picture and its derivatives, at most
    tolerance: float = 1e-6  # change of values or misfit that ends a fit
    block_px: int = 8  # neighbours within such a block may hang together
    # Ranges in which values mean something.
    angles_deg: Range = (-75.0, 75.0)
    levels: Range = (0.01, 1e5)
    board: Range = (0.0, 1.0)
    gamma: Range = (1.0, 4.0)
    blur_px: Range = (0.02, 30.0)


SETTINGS = RecordingFitSettings()

RANGES = {
    **dict.fromkeys(PLACED, (-math.inf, math.inf)),
    **dict.fromkeys(TURNED, SETTINGS.angles_deg),
    **dict.fromkeys(LEVELS, SETTINGS.levels),
    "board": SETTINGS.board,
    "gamma": SETTINGS.gamma,
    "blur_px": SETTINGS.blur_px,
}


def settled(
    fit: RecordingFit,
    free: Sequence[str],
    evaluations: int = SETTINGS.evaluations,
) -> RecordingFit:
    """Fit values by least squares, pixels weighed by the noise that is expected of them.

    Args:
        fit: where to begin.
        free: names of the values to fit.
        evaluations: of the picture, at most.
    """
    fit = replace(fit, free=tuple(free))
    mean, variance = fit.predicted()
    off = np.abs(fit.grey - mean) / np.sqrt(variance)
    bulk = np.quantile(off, 0.68, axis=(1, 2), keepdims=True).clip(min=0.5)
    # Residuals count in full up to four standard deviations of the bulk, and less beyond.
    calm = np.minimum(SETTINGS.clear_sigmas * bulk / off.clip(min=1e-9), 1.0)
    root: Floats = np.sqrt(calm / variance)
    low, high = np.array([RANGES[name] for name in fit.names]).T
    dense = np.ones((fit.grey[0].size, len(fit.by_frame)))
    common = np.ones((fit.grey.size, len(fit.shared)))
    sparsity = [sparse.kron(sparse.eye(len(fit.grey)), dense), common]

    def residual(vector: Floats) -> Floats:
        return (root * (fit.moved(vector).predicted()[0] - fit.grey)).ravel()

    found = optimize.least_squares(
        residual,
        fit.vector.clip(low + 1e-6, high - 1e-6),
        bounds=(low, high),
        x_scale="jac",
        jac_sparsity=sparse.hstack(sparsity),
        max_nfev=evaluations,
        ftol=SETTINGS.tolerance,
        xtol=SETTINGS.tolerance,
        gtol=None,
    )
    misfit = 2 * float(found.cost)
    scale = max(misfit / max(fit.grey.size - len(low), 1.0), 1e-12)
    spread = covariances(found.jac, found.fun, scale, fit.grey.shape)
    return replace(fit.moved(found.x), misfit=misfit, scale=scale, covariances=spread)


def covariances(
    jacobian: sparse.csr_matrix, residual: Floats, scale: float, shape: tuple[int, ...]
) -> Floats:
    """Say how sure the values are; see :class:`RecordingFit`.

    Args:
        jacobian: (B*H*W,P) of the weighted residuals.
        residual: (B*H*W,) weighted residuals.
        scale: their variance.
        shape: (B,H,W).
    """
    normal = (jacobian.T @ jacobian).toarray()
    unit = np.sqrt(normal.diagonal().clip(min=1e-12))
    units = np.outer(unit, unit)
    inverse = np.linalg.pinv(normal / units, rcond=1e-10, hermitian=True) / units
    scores = jacobian.multiply(residual[:, None]).tocsr()
    frame, y, x = np.indices(shape).reshape(3, -1)
    down, across = (axis // SETTINGS.block_px for axis in (y, x))
    block = (frame * shape[1] + down) * shape[2] + across
    freedom = max(shape[0] - 1, 1)
    wide = shape[0] / freedom * (float(stats.t.ppf(0.975, freedom)) / SURE) ** 2
    found = [inverse * scale]
    for groups, factor in ((block, 1.0), (frame, wide)):
        rows = sparse.csr_matrix((np.ones(len(x)), (groups, np.arange(len(x)))))
        pulls = (rows @ scores) @ inverse
        found.append(factor * pulls.T @ pulls)
    return np.stack(found)
