"""Maximum likelihood by ``scipy.optimize.least_squares``: values of each frame beside those of all."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import optimize, sparse, stats

from vocc_torch.arrays import Bools, Floats, Integers
from vocc_torch.extras.calibrate.drawing import (
    COLUMN,
    LEVELS,
    NAMES,
    PLACED,
    SHARED,
    TURNED,
    PanelDrawing,
    columns,
)
from vocc_torch.extras.calibrate.noise import Noise, expected

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

Of = Callable[[Floats], Floats]
"""Makes a value of each frame (B,) from (B,12)."""


@dataclass(frozen=True)
class RecordingFit:
    """Values that explain a recording, and how well.

    Args:
        drawing: the windows, camera and panel.
        grey: (B,H,W) measured.
        table: (B,12) as :data:`NAMES`; what frames share is the same in all rows.
        lit: (B,R*C) which LEDs are On.
        noise: of the light.
        free: names of the values that were fitted.
        misfit: weighted sum of squared residuals, in units of the noise.
        scale: variance of the residuals over that of the noise.
        covariances: (3,P,P) of the fitted values, each frame's in turn and then the shared ones, by the
            curvature of the likelihood and by the scatter of its slopes between blocks and between frames
            (sandwiches); the widest counts.
    """

    drawing: PanelDrawing
    grey: Floats
    table: Floats
    lit: Bools
    noise: Noise = field(default_factory=Noise)
    free: tuple[str, ...] = ()
    misfit: float = math.inf
    scale: float = 1.0
    covariances: Floats = field(default_factory=lambda: np.zeros((3, 0, 0)))

    @property
    def by_frame(self) -> list[str]:
        """Names of the fitted values that each frame has by itself."""
        return [name for name in self.free if name not in SHARED]

    @property
    def shared(self) -> list[str]:
        """Names of the fitted values that all frames share."""
        return [name for name in self.free if name in SHARED]

    @property
    def places(self) -> Integers:
        """Where the fitted values stand in the table, each frame's in turn and then the shared ones, (P,)."""
        starts = np.arange(len(self.table))[:, None] * len(NAMES)
        frames = (starts + columns(*self.by_frame)).ravel()
        return np.concatenate([frames, columns(*self.shared)]).astype(int)

    @property
    def gamma(self) -> float:
        """The fitted gamma."""
        return float(self.table[0, COLUMN["gamma"]])

    def value(self, name: str) -> Floats:
        """A value of each frame, (B,)."""
        return self.table[:, COLUMN[name]]

    def set(self, **values: Floats | float) -> "RecordingFit":
        """Set values by name."""
        table = self.table.copy()
        for name, value in values.items():
            table[:, COLUMN[name]] = value
        return replace(self, table=table)

    def moved(self, values: Floats) -> "RecordingFit":
        """Take the fitted values from a vector."""
        table, shared = self.table.copy(), columns(*SHARED)
        table.ravel()[self.places] = values
        table[:, shared] = table[0, shared]
        return replace(self, table=table)

    def predicted(self) -> tuple[Floats, Floats]:
        """Mean and variance of the grey values, (B,H,W) each."""
        light = self.drawing.light(self.table, self.lit)
        return expected(light, self.gamma, self.noise)

    def deviation(self, name: str) -> float:
        """Standard deviation of a value that all share; 0 where it was not fitted."""
        if name not in self.free:
            return 0.0
        at = self.shared.index(name) - len(self.shared)
        return math.sqrt(self.covariances[:, at, at].max())

    def derived(self, of: Of) -> tuple[Floats, Floats, float]:
        """Derive a value of every frame from the fitted ones, and how sure it is.

        Returns:
            the values (B,), their standard deviations (B,) but for what all frames have in common, and the
            standard deviation of that.
        """
        values, frames = self.table.ravel()[self.places], len(self.table)
        steps = 1e-6 * np.abs(values).clip(min=1.0)
        slope = np.atleast_2d(
            optimize.approx_fprime(values, lambda v: of(self.moved(v).table), steps)
        )
        spreads = slope @ self.covariances @ slope.T
        spread = max(spreads, key=np.trace)
        pairs = (spread.sum() - spread.trace()) / max(frames * (frames - 1), 1)
        common, every = max(0.0, float(pairs)), spread.diagonal()
        deviation = np.sqrt((every - common).clip(min=1e-3 * every))
        return of(self.table), deviation, math.sqrt(common)


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
    frames = len(fit.grey)
    names = fit.by_frame * frames + fit.shared
    low, high = np.array([RANGES[name] for name in names]).T
    dense = np.ones((fit.grey[0].size, len(fit.by_frame)))
    common = np.ones((fit.grey.size, len(fit.shared)))

    def residual(values: Floats) -> Floats:
        return (root * (fit.moved(values).predicted()[0] - fit.grey)).ravel()

    found = optimize.least_squares(
        residual,
        fit.table.ravel()[fit.places].clip(low + 1e-6, high - 1e-6),
        bounds=(low, high),
        x_scale="jac",
        jac_sparsity=sparse.hstack([sparse.kron(sparse.eye(frames), dense), common]),
        max_nfev=evaluations,
        ftol=SETTINGS.tolerance,
        xtol=SETTINGS.tolerance,
        gtol=None,
    )
    misfit = 2 * float(found.cost)
    scale = max(misfit / max(fit.grey.size - len(names), 1.0), 1e-12)
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
