"""Maximum likelihood by ``scipy.optimize.least_squares``: values of each frame beside those of all."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import optimize, sparse, stats

from vocc_torch.arrays import Bools, Floats
from vocc_torch.extras.calibrate.drawing import (
    COLUMN,
    LEVELS,
    PLACED,
    SHARED,
    TURNED,
    PanelDrawing,
)
from vocc_torch.extras.calibrate.noise import ROUNDING, Noise, expected, linear

SURE = 1.959963985
"""Standard deviations of a normal 95 % interval."""

BASE = (*PLACED, *LEVELS[:3], *SHARED)
POSED = (*PLACED, *TURNED, *LEVELS[:3], *SHARED)


@dataclass(frozen=True)
class RecordingFitSettings:
    """How a fit is made."""

    clear_sigmas: float = (
        4.0  # a pixel farther off counts less: reflections are not in the model
    )
    evaluations: int = 12  # of the picture and its derivatives, at most
    tolerance: float = 1e-6  # change of values or misfit that ends a fit
    block_px: int = 8  # neighbours within such a block may hang together
    undithered: float = (
        0.1  # variance of noise below which pixels of one light are rounded alike
    )
    steep_grey: float = (
        2.0  # from a pixel to the next, from which on each rounds for itself
    )


SETTINGS = RecordingFitSettings()

RANGES = {
    "gamma": (1.0, 4.0),
    "blur_px": (0.02, 30.0),
    "yaw_deg": (-75.0, 75.0),
    "pitch_deg": (-75.0, 75.0),
    **dict.fromkeys(LEVELS, (0.01, 1e5)),
}
"""Where values mean something."""

OF_LIGHT = {*LEVELS, "gamma"}
"""Values on which the light depends and its parts do not."""

STEPS = {"log_pitch_px": 1e-5, "yaw_deg": 1e-3, "pitch_deg": 1e-3, "roll_deg": 1e-3}
"""Steps of the finite differences; of other values 1e-4."""

Of = Callable[[Floats], Floats]
"""Makes a value of each frame (B,) from (B,12)."""


@dataclass(frozen=True)
class RecordingFit:
    """Values that explain a recording, and how well.

    Args:
        drawing: the windows, camera and panel.
        grey: (B,H,W) measured.
        table: (B,12) as :data:`NAMES`; what frames share is the same in all rows.
        lit: (B,R*C) share of On's light of each LED.
        noise: of the light.
        trust: (B,H,W) or (1,1,1), how much each pixel counts.
        free: names of the values that were fitted.
        misfit: weighted sum of squared residuals, in units of the noise.
        scale: variance of the residuals over that of the noise.
        covariances: (3,P,P) of the fitted values, each frame's in turn and then the shared ones, by the
            curvature of the likelihood and by the scatter of its slopes between blocks and between frames
            (sandwiches); the widest counts.
        drawn: parts of the light, once they are drawn.
    """

    drawing: PanelDrawing
    grey: Floats
    table: Floats
    lit: Floats
    noise: Noise = field(default_factory=Noise)
    trust: Floats = field(default_factory=lambda: np.ones((1, 1, 1)))
    free: tuple[str, ...] = ()
    misfit: float = math.inf
    scale: float = 1.0
    covariances: Floats = field(default_factory=lambda: np.zeros((3, 0, 0)))
    drawn: list[Floats] = field(default_factory=list, init=False, repr=False)

    @property
    def bits(self) -> Bools:
        """Which LEDs are On, (B,R*C)."""
        return np.asarray(self.lit > 0)

    @property
    def has_board(self) -> bool:
        """Whether a board stands behind the LEDs."""
        return self.drawing.panel.board_reflectance is not None

    @property
    def by_frame(self) -> list[str]:
        """Names of the fitted values that each frame has by itself."""
        return [name for name in self.free if name not in SHARED]

    @property
    def shared(self) -> list[str]:
        """Names of the fitted values that all frames share."""
        return [name for name in self.free if name in SHARED]

    @property
    def values(self) -> int:
        """How many values were fitted."""
        return len(self.by_frame) * len(self.grey) + len(self.shared)

    @property
    def pixels(self) -> float:
        """How many pixels count."""
        return float(np.broadcast_to(self.trust, self.grey.shape).sum())

    @property
    def gamma(self) -> float:
        """The fitted gamma."""
        return float(self.table[0, COLUMN["gamma"]])

    def value(self, name: str) -> Floats:
        """A value of each frame, (B,)."""
        return np.asarray(self.table[:, COLUMN[name]])

    def level(self, name: str) -> Floats:
        """A level of each frame as light, (B,)."""
        return linear(self.value(name), self.gamma)

    def taken(self, frames: slice) -> "RecordingFit":
        """Take some frames."""
        trust = self.trust if len(self.trust) == 1 else self.trust[frames]
        names = ("grey", "table", "lit")
        rows = {name: getattr(self, name)[frames] for name in names}
        return replace(self, drawing=self.drawing.taken(frames), trust=trust, **rows)

    def set(self, name: str, value: Floats | float) -> "RecordingFit":
        """Set a value; levels and gamma leave the light's parts as they are."""
        table = self.table.copy()
        table[:, COLUMN[name]] = value
        return self._at(table, name in OF_LIGHT)

    def _at(self, table: Floats, still: bool) -> "RecordingFit":
        """Take other values, and what is drawn where the panel stays as it is."""
        other = replace(self, table=table)
        if still:
            other.drawn.extend(self.parts())
        return other

    def parts(self) -> list[Floats]:
        """Draw what the light is made of: background, LEDs, their own light, and the board where one is."""
        drawing, table = self.drawing, self.table
        if not self.drawn:
            lit = drawing.cover(table, self.lit)
            self.drawn.extend((drawing.base(table), drawing.cover(table), lit))
            if self.has_board:
                self.drawn.append(drawing.board(table))
        return self.drawn

    def light(self, parts: Sequence[Floats] | None = None) -> Floats:
        """Linear light of the frames, (B,H,W); ``parts`` are those of the same geometry and LEDs."""
        base, leds, lit, *board = parts or self.parts()
        background, off, on, behind = (
            self.level(name)[:, None, None] for name in LEVELS
        )
        surface = behind if board else background
        x = background * base + (off - surface) * leds + (on - off) * lit
        for cover in board:
            x = x + (behind - background) * cover
        return np.maximum(x, 1e-9)

    def predicted(self, parts: Sequence[Floats] | None = None) -> tuple[Floats, Floats]:
        """Mean and variance of the grey values, (B,H,W) each."""
        return expected(self.light(parts), self.gamma, self.noise)

    def packed(self) -> Floats:
        """The fitted values in one vector: each frame's in turn, and the shared ones."""
        own, common = columns(self.by_frame), columns(self.shared)
        return np.concatenate([self.table[:, own].ravel(), self.table[0, common]])

    def moved(self, packed: Floats) -> "RecordingFit":
        """Take the fitted values from a vector."""
        table, count = self.table.copy(), len(packed) - len(self.shared)
        table[:, columns(self.by_frame)] = packed[:count].reshape(len(table), -1)
        table[:, columns(self.shared)] = packed[count:]
        return self._at(table, OF_LIGHT.issuperset(self.free))

    def slopes(self) -> Floats:
        """Derivatives of the mean grey values by the fitted values, (D,B,H,W), by finite differences."""
        mean, slopes = self.predicted()[0], []
        for name in self.free:
            step = STEPS.get(name, 1e-4)
            other = self.set(name, self.value(name) + step)
            slopes.append((other.predicted()[0] - mean) / step)
        return np.stack(slopes)

    def jacobian(self, slopes: Floats) -> sparse.csr_matrix:
        """Lay derivatives out by pixel and fitted value."""
        names = np.isin(self.free, self.by_frame)
        flat = slopes.reshape(len(slopes), len(self.grey), -1)
        blocks = sparse.block_diag(
            [flat[names, frame].T for frame in range(len(self.grey))]
        )
        shared = flat[~names].reshape(len(self.shared), self.grey.size).T
        return sparse.hstack([blocks, shared], format="csr")

    def deviation(self, name: str) -> float:
        """Standard deviation of a value that all share; NaN where it was not fitted."""
        if name not in self.free:
            return math.nan
        at = self.values - len(self.shared) + self.shared.index(name)
        return math.sqrt(max(0.0, float(self.covariances[:, at, at].max())))

    def derived(self, of: Of) -> tuple[Floats, Floats, float]:
        """Derive a value of every frame from the fitted ones, and how sure it is.

        Returns:
            the values (B,), their standard deviations (B,) but for what all frames have in common, and the
            standard deviation of that.
        """
        packed, values = self.packed(), of(self.table)
        steps = np.diag(1e-5 * np.abs(packed).clip(min=1.0))
        turns = [of(self.moved(packed + step).table) - values for step in steps]
        slope = np.stack(turns, 1) / steps.sum(0)
        spreads = slope @ self.covariances @ slope.T
        frames = len(values)
        every = spreads.diagonal(axis1=1, axis2=2).max(0)
        pairs = (spreads.sum((1, 2)) - spreads.trace(axis1=1, axis2=2)) / max(
            frames * (frames - 1), 1
        )
        common = max(0.0, float(pairs.max())) if frames > 1 else 0.0
        return (
            values,
            np.sqrt((every - common).clip(min=1e-3 * every)),
            math.sqrt(common),
        )


def columns(names: Sequence[str]) -> list[int]:
    """Give the columns of values."""
    return [COLUMN[name] for name in names]


def settled(
    fit: RecordingFit,
    free: Sequence[str],
    evaluations: int = SETTINGS.evaluations,
    *,
    robust: bool = True,
) -> RecordingFit:
    """Fit values by least squares, pixels weighed by the noise that is expected of them.

    Args:
        fit: where to begin.
        free: names of the values to fit.
        evaluations: of the picture, at most.
        robust: whether far residuals count less.
    """
    fit = replace(fit, free=tuple(free))
    mean, variance = fit.predicted()
    weights = fit.trust / variance
    if robust:
        weights = weights * calmed(fit.grey - mean, variance)
    root = np.sqrt(weights)
    names = fit.by_frame * len(fit.grey) + fit.shared
    bounds = np.array([RANGES.get(name, (-math.inf, math.inf)) for name in names]).T

    def residual(packed: Floats) -> Floats:
        return (root * (fit.moved(packed).predicted()[0] - fit.grey)).ravel()

    def jacobian(packed: Floats) -> sparse.csr_matrix:
        moved = fit.moved(packed)
        return moved.jacobian(root * moved.slopes())

    begun = np.clip(fit.packed(), bounds[0] + 1e-6, bounds[1] - 1e-6)
    found = optimize.least_squares(
        residual,
        begun,
        jacobian,
        bounds,
        x_scale="jac",
        max_nfev=evaluations,
        ftol=SETTINGS.tolerance,
        xtol=SETTINGS.tolerance,
        gtol=None,
    )
    return certain(fit.moved(found.x), weights)


def calmed(residual: Floats, variance: Floats) -> Floats:
    """Weigh residuals: 1 up to four standard deviations of the bulk, and less beyond."""
    off = np.abs(residual) / np.sqrt(variance)
    bulk = np.quantile(off.reshape(len(off), -1), 0.68, axis=1).clip(min=0.5)
    weights: Floats = (
        SETTINGS.clear_sigmas * bulk[:, None, None] / off.clip(min=1e-9)
    ).clip(max=1)
    return weights


def certain(fit: RecordingFit, weights: Floats) -> RecordingFit:
    """Note how well values explain the frames, and how sure they are."""
    residual = fit.grey - fit.predicted()[0]
    slopes = fit.slopes()
    misfit = float((weights * residual**2).sum())
    scale = max(misfit / max(fit.pixels - fit.values, 1.0), 1e-12)
    spread = covariances(fit, slopes, weights, residual, scale)
    return replace(fit, misfit=misfit, scale=scale, covariances=spread)


def covariances(
    fit: RecordingFit, slopes: Floats, weights: Floats, residual: Floats, scale: float
) -> Floats:
    """Say how sure the values are; see :class:`RecordingFit`.

    Args:
        fit: whose values.
        slopes: (D,B,H,W) derivatives of the mean grey values.
        weights: (B,H,W) of the pixels.
        residual: (B,H,W).
        scale: variance of the residuals over that of the noise.
    """
    matrix = fit.jacobian(slopes)
    normal = (matrix.T @ matrix.multiply(weights.reshape(-1, 1))).toarray()
    unit = np.sqrt(normal.diagonal().clip(min=1e-12))
    inverse = np.linalg.pinv(normal / np.outer(unit, unit), rcond=1e-10, hermitian=True)
    inverse = inverse / np.outer(unit, unit)
    scores = matrix.multiply((weights * residual).reshape(-1, 1)).tocsr()
    frames, height, width = fit.grey.shape
    down, across = (np.arange(side) // SETTINGS.block_px for side in (height, width))
    frame = np.arange(frames)[:, None, None]
    block = (frame * height + down[:, None]) * width + across
    freedom = max(frames - 1, 1)
    wide = frames / freedom * (float(stats.t.ppf(0.975, freedom)) / SURE) ** 2
    found = [inverse * scale]
    for groups, factor in ((block, 1.0), (frame, wide)):
        index = np.broadcast_to(groups, fit.grey.shape).ravel()
        rows = sparse.csr_matrix((np.ones(len(index)), (index, np.arange(len(index)))))
        pulls = (rows @ scores) @ inverse
        found.append(factor * pulls.T @ pulls)
    return np.stack(found)


def trusted(fit: RecordingFit) -> RecordingFit:
    """Let pixels without noise count less the flatter the picture is there: neighbours are rounded alike."""
    mean, variance = fit.predicted()
    if float(np.median(variance - ROUNDING)) > SETTINGS.undithered:
        return replace(fit, trust=np.ones((1, 1, 1)))
    down, across = np.gradient(mean, axis=(1, 2))
    steep = (down**2 + across**2) / SETTINGS.steep_grey**2
    return replace(fit, trust=(steep**2).clip(min=1 / mean.size, max=1.0))
