"""Maximum likelihood by damped Gauss-Newton steps: values of each frame beside values of all frames."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch
from scipy import stats
from torch import Tensor, nn

from vocc_torch.extras.calibrate import model
from vocc_torch.extras.calibrate.model import LEVELS, OF_ALL, OF_FRAME, Noise, Windows

CLEAR_SIGMAS = 4.0
"""A pixel farther off than this counts less (Huber): reflections and passers-by are not in the model."""
STEPS = 15
OWN_ROUNDING = 2.0
"""Grey values from a pixel to the next from which on its rounding tells nothing of theirs."""
FIRST_DAMPING, LOOSE = 1e-6, 1e6
"""Share of the diagonal that the first step adds, and beyond which no step helps."""
ROUNDED, TINY = 1e-10, 1e-12
"""What double precision leaves of a diagonal, of each value its own share: units differ. The least of it."""
UNDITHERED = 0.1
"""Variance of noise, in grey values, below which pixels of one light are rounded alike."""
SETTLED = 0.01
"""Twice the log-likelihood that a step must promise: no value then moves by a tenth of its deviation."""
CORRECTIONS = 40
"""Steps in which rounding is taken out."""
GRID_PX = 8
"""Side of the blocks in which residuals hang together: JPEG's."""
SURE = 1.96
"""Standard deviations to either side of a 95 % interval."""
RANGES = {"gamma": (0.4, 4.0), "blur_xx": (1e-3, 900.0), "blur_yy": (1e-3, 900.0), "k1": (-3.0, 3.0)}
RANGES |= dict.fromkeys(("yaw", "pitch"), (-1.3, 1.3)) | dict.fromkeys(LEVELS, (1e-2, 5000.0))
"""Where values mean something."""
STRIDE = 1.0
"""Share of a level and a grey value by which it changes at most in a step."""
Derive = Callable[[Mapping[str, Tensor], Tensor], Tensor]
"""Makes (B,) of what frames have by name, (B,) each, and of what all share, (B,4)."""
Derived = tuple[Tensor, Tensor, float]
"""A value of every frame (B,), its own standard deviation (B,), and what that adds which all share."""


@dataclass(frozen=True)
class RecordingFit:
    """Values that explain a recording, and how well.

    Args:
        windows: what is known of the frames.
        grey: (B,H,W) measured.
        of_frame: (B,10).
        of_all: (4,).
        lit: (B,R*C) share of On's light of each LED.
        noise: of the light.
        trust: (B,H,W) how much each pixel counts, as :func:`trusted` says; all alike where it is one number.
        free: names of the values that were fitted.
        misfit: weighted sum of squared residuals, in units of the noise.
        scale: variance of the residuals over that of the noise.
        shared: (3,M,M) covariances of the fitted values that all share, of which the widest counts: by the
            curvature of the likelihood times ``scale``, by the scatter of its slopes from block to block of 8
            x 8 px, and by that from frame to frame (sandwiches), with Student's t for the frames there are.
        alone: (2,B,N,N) of each frame's values, were those that all share known: by curvature, by blocks.
        lead: (B,N,M) by how much a frame's values follow those that all share.
    """

    windows: Windows
    grey: Tensor
    of_frame: Tensor
    of_all: Tensor
    lit: Tensor
    noise: Noise = field(default_factory=Noise)
    trust: Tensor = field(default_factory=lambda: torch.ones(1, 1, 1).double())
    free: tuple[str, ...] = ()
    misfit: float = math.inf
    scale: float = 1.0
    shared: Tensor = field(default_factory=lambda: torch.zeros(3, 0, 0))
    alone: Tensor = field(default_factory=lambda: torch.zeros(2, 0, 0, 0))
    lead: Tensor = field(default_factory=lambda: torch.zeros(0, 0, 0))

    @property
    def bits(self) -> Tensor:
        """Which LEDs are On, (B,R*C)."""
        return self.lit > 0

    @property
    def values(self) -> int:
        """How many values were fitted."""
        own = sum(name in OF_FRAME for name in self.free)
        return own * len(self.grey) + len(self.free) - own

    @property
    def pixels(self) -> float:
        """How many pixels count."""
        return float(self.trust.expand_as(self.grey).sum())

    def deviation(self, name: str) -> float:
        """Standard deviation of a value that all share; NaN where it was not fitted."""
        if name not in self.free:
            return math.nan
        at = [one for one in self.free if one not in OF_FRAME].index(name)
        return math.sqrt(max(0.0, float(self.shared[:, at, at].max())))

    def derived(self, of: Derive) -> Derived:
        """Derive a value of every frame from the fitted ones, and how sure it is.

        Returns:
            the values (B,), their standard deviations (B,) were that known which all share, and the standard
            deviation that this adds to their mean.
        """
        own = self.of_frame.clone().requires_grad_()
        all_ = self.of_all.expand(len(own), -1).clone().requires_grad_()
        made = of(model.columns(own), all_)
        own_slope, all_slope = torch.autograd.grad(made.sum(), (own, all_), materialize_grads=True)
        turns = Turns.of(self.free)
        (frame, shared), count = turns.along, len(turns.own)
        a, b = own_slope @ frame[:count].mT, all_slope @ shared[count:].mT
        variance = torch.einsum("bi,wbij,bj->wb", a, self.alone, a).amax(0)
        pulled = (b - torch.einsum("bi,bij->bj", a, self.lead)).mean(0)
        added = float((pulled @ self.shared @ pulled).max())
        return made.detach(), variance.clamp(min=0).sqrt(), math.sqrt(max(0.0, added))

    def sure(self, blocks: "Blocks", scores: Tensor) -> "RecordingFit":
        """Note how sure the values are, by the normal equations and what each pixel adds (D,B,H,W)."""
        shared, alone, lead = covariances(*blocks[:3], scores, self.scale)
        return replace(self, shared=shared, alone=alone, lead=lead)

    def value(self, name: str) -> Tensor:
        """A value: of each frame (B,), or of all."""
        own = name in OF_FRAME
        return self.of_frame[:, OF_FRAME.index(name)] if own else self.of_all[OF_ALL.index(name)]

    def level(self, name: str) -> Tensor:
        """A level of each frame as light, (B,)."""
        return model.linear(self.value(name), self.of_all[0])

    def bent(self, step: float) -> "RecordingFit":
        """Move gamma, and with it what each frame has of its own."""
        turns = Turns.of(self.free)
        own = -step * self.lead[..., turns.shared.index("gamma")] @ turns.along[0][: len(turns.own)]
        shared = step * model.directions(["gamma"])[1][0]
        return replace(self, of_frame=self.of_frame + own, of_all=self.of_all + shared)

    def taken(self, rows: slice) -> "RecordingFit":
        """Take some frames."""
        parts = {name: getattr(self, name)[rows] for name in ("grey", "of_frame", "lit")}
        parts["trust"] = self.trust if len(self.trust) == 1 else self.trust[rows]
        return replace(self, windows=self.windows.taken(rows), **parts)

    def light(self) -> Tensor:
        """Linear light of the fitted frames, (B,H,W)."""
        return model.light(self.windows, self.of_frame, self.of_all, self.lit)

    def predicted(self) -> tuple[Tensor, Tensor]:
        """Mean and variance of the grey values, (B,H,W) each."""
        return model.expected(self.light(), self.of_all[0], self.noise)

    def slopes(self, turns: "Turns") -> tuple[Tensor, Tensor]:
        """Give that mean, and its derivatives (D,B,H,W)."""
        return model.slopes(self.windows, self.of_frame, self.of_all, self.lit, self.noise, turns.along)


def settled(
    fit: RecordingFit, free: Sequence[str], steps: int = STEPS, *, robust: bool = True
) -> RecordingFit:
    """Take damped Gauss-Newton steps until the misfit settles (Levenberg and Marquardt).

    The frames' own values are eliminated first, so that the work grows with the number of frames only.

    Args:
        fit: where to begin.
        free: names of the values to fit; ``blur`` is both axes alike.
        steps: most steps.
        robust: whether far residuals count less.
    """
    turns, variance, damping = Turns.of(free), fit.predicted()[1], FIRST_DAMPING
    own = len(turns.own)
    for step in range(steps + 1):
        mean, slopes = fit.slopes(turns)
        residual = fit.grey - mean
        weights = fit.trust / variance * (calmed(residual, variance) if robust else 1.0)
        misfit = float((weights * residual.square()).sum())
        counted = max(fit.pixels - own * len(fit.grey) - len(turns.shared), 1.0)
        scale = max(misfit / counted, 1e-12)
        blocks = normal(slopes, residual, weights, own)
        if step == steps:
            break
        held = turns.held(fit, blocks)
        while True:
            taken, new = arrow_step(*held, damping), math.inf
            if float((taken[0] * held[3]).sum() + (taken[1] * held[4]).sum()) < SETTLED * scale:
                break
            other = turns.moved(fit, *taken)
            new = float((weights * (fit.grey - other.predicted()[0]).square()).sum())
            if new <= misfit or damping > LOOSE:
                break
            damping *= 8
        if not new < misfit:
            break
        fit, damping = other, max(damping / 10, 1e-10)
    made = replace(fit, free=tuple(free), misfit=misfit, scale=scale)
    return made.sure(blocks, slopes * (weights * residual))


def corrected(fit: RecordingFit, free: Sequence[str], sigma: float) -> RecordingFit:
    """Compare the frames with what rounding makes of the expected ones, so that it moves no value.

    Rounding without noise is no random error: it has the same sign wherever the picture is alike. At the true
    values the rounded picture differs from the measured one by noise alone, so the steps of :func:`settled`
    are taken on with that difference. Intervals keep the width that they had with rounding
    as noise, or take that of the slopes' scatter where it is wider.

    Args:
        fit: a settled one.
        free: names of the values to fit.
        sigma: standard deviation of the noise, in grey values.
    """
    turns, (mean, variance) = Turns.of(free), fit.predicted()
    weights = fit.trust / variance * calmed(fit.grey - mean, variance)
    slopes = fit.slopes(turns)[1]
    for _ in range(CORRECTIONS):
        residual = fit.grey - model.written(fit.predicted()[0], sigma)
        blocks = normal(slopes, residual, weights, len(turns.own))
        fit = turns.moved(fit, *arrow_step(*blocks, FIRST_DAMPING))
    return replace(fit, free=tuple(free)).sure(blocks, slopes * (weights * residual))


@dataclass(frozen=True)
class Turns:
    """The ways in which values are changed.

    Args:
        own: names of those that each frame has.
        shared: names of those that all share.
        along: (D,10) the change of a frame's values by each, ``own`` first, and (D,4) of what all share.
    """

    own: tuple[str, ...]
    shared: tuple[str, ...]
    along: tuple[Tensor, Tensor]

    @classmethod
    def of(cls, free: Sequence[str]) -> "Turns":
        """Sort names: each frame's first."""
        own, shared = (tuple(n for n in free if (n in OF_FRAME) == is_own) for is_own in (True, False))
        return cls(own, shared, model.directions((*own, *shared)))

    def moved(self, fit: RecordingFit, own: Tensor, shared: Tensor) -> RecordingFit:
        """Take a step, and hold values where they mean something."""
        (frame, all_), count = self.along, len(self.own)
        of_frame, of_all = fit.of_frame + own @ frame[:count], fit.of_all + shared @ all_[count:]
        made = replace(fit, of_frame=of_frame, of_all=of_all)
        levels = slice(OF_FRAME.index(LEVELS[0]), None)  # near black a level has next to no slope
        old, new = fit.of_frame[:, levels], made.of_frame[:, levels]
        new.clamp_(old - STRIDE * (1 + old), old + STRIDE * (1 + old))
        for name, ends in RANGES.items():
            made.value(name).clamp_(*ends)
        return made

    def held(self, fit: RecordingFit, blocks: "Blocks") -> "Blocks":
        """Take values out of the normal equations that are at the end of their range and would leave it."""
        own, mixed, shared, *right = blocks
        a, b = free = [torch.ones_like(part) for part in right]
        for names, part, pulls in zip((self.own, self.shared), free, right, strict=True):
            for at, name in enumerate(names):
                if name in RANGES:
                    (low, high), value, pull = RANGES[name], fit.value(name), pulls[..., at]
                    part[..., at] = ~(((value <= low) & (pull < 0)) | ((value >= high) & (pull > 0)))
        own = own * a.unsqueeze(-1) * a.unsqueeze(-2) + torch.diag_embed(1 - a)
        shared = shared * b.unsqueeze(-1) * b + torch.diag(1 - b)
        return own, mixed * a.unsqueeze(-1) * b, shared, right[0] * a, right[1] * b


def trusted(fit: RecordingFit) -> RecordingFit:
    """Let pixels without noise count less the flatter the picture is there: neighbours are rounded alike.

    Where the picture rises by two grey values a pixel, each pixel's rounding is its own; a flat area of the
    recording, where all are rounded alike, counts as one pixel. Noise of a third of a grey value rounds each
    pixel by itself, and then all count.
    """
    mean, variance = fit.predicted()
    if float((variance - model.ROUNDING).median()) > UNDITHERED:
        return replace(fit, trust=torch.ones(1, 1, 1).double())
    steep = torch.stack(torch.gradient(mean, dim=(1, 2))).square().sum(0) / OWN_ROUNDING**2
    return replace(fit, trust=steep.square().clamp(min=1 / mean.numel(), max=1.0))


def calmed(residual: Tensor, variance: Tensor) -> Tensor:
    """Weigh residuals: 1 up to four standard deviations of the bulk, and less beyond."""
    off = residual.abs() / variance.sqrt()
    bulk = off.flatten(1).quantile(0.68, dim=1) if off[0].numel() < 1 << 22 else off.flatten(1).mean(1)
    return (CLEAR_SIGMAS * bulk.clamp(min=0.5).view(-1, 1, 1) / off.clamp(min=1e-9)).clamp(max=1)


Blocks = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]
"""The normal equations' blocks: own (B,N,N), mixed (B,N,M), shared (M,M), and right sides (B,N), (M,)."""


def normal(slopes: Tensor, residual: Tensor, weights: Tensor, own: int) -> Blocks:
    """Make the normal equations of derivatives (D,B,H,W), the first ``own`` of which are a frame's."""
    flat, weighed = slopes.flatten(2), (slopes * weights).flatten(2)
    whole = torch.einsum("ibp,jbp->bij", weighed, flat)
    right = torch.einsum("ibp,bp->bi", weighed, residual.flatten(1))
    mixed, shared = whole[:, :own, own:], whole[:, own:, own:].sum(0)
    return whole[:, :own, :own], mixed, shared, right[:, :own], right[:, own:].sum(0)


def arrow_step(
    own: Tensor, mixed: Tensor, shared: Tensor, right_own: Tensor, right_all: Tensor, damping: float
) -> tuple[Tensor, Tensor]:
    """Solve the damped normal equations: steps of each frame's values (B,N) and of those of all (M,)."""
    inverse = torch.linalg.inv(damped(own, damping))
    lead = mixed.mT @ inverse
    whole = damped(shared, damping) - (lead @ mixed).sum(0)
    all_step = torch.linalg.lstsq(whole, right_all - (lead @ right_own.unsqueeze(-1)).sum(0)[:, 0]).solution
    rest = right_own - (mixed @ all_step)
    return (inverse @ rest.unsqueeze(-1))[..., 0], all_step


def damped(matrix: Tensor, damping: float) -> Tensor:
    """Raise the diagonal by a share of itself."""
    diagonal = matrix.diagonal(dim1=-2, dim2=-1).clamp(min=TINY)
    return matrix + torch.diag_embed((damping + ROUNDED) * diagonal)


def covariances(
    own: Tensor, mixed: Tensor, shared: Tensor, scores: Tensor, scale: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Say how sure the values are; see :class:`RecordingFit` for the parts.

    Args:
        own: the normal equations' blocks, as ``mixed`` and ``shared``.
        mixed: likewise.
        shared: likewise.
        scores: (D,B,H,W) what each pixel adds to the slopes of the likelihood.
        scale: variance of the residuals over that of the noise.
    """
    inverse = torch.linalg.inv(damped(own, 0.0))
    lead = inverse @ mixed
    whole = torch.linalg.pinv(shared - (mixed.mT @ lead).sum(0), hermitian=True)
    parts = nn.functional.avg_pool2d(scores, GRID_PX, ceil_mode=True, divisor_override=1).flatten(2)
    parts, count = parts.movedim(0, 1), own.shape[1]
    of_own = parts[:, :count]
    of_all = parts[:, count:] - lead.mT @ of_own  # (B,M,K): what a block pulls at that which all share
    frames, freedom = len(own), max(len(own) - 1, 1)
    wide = frames / freedom * (float(stats.t.ppf(0.975, freedom)) / SURE) ** 2
    by_frame = of_all.sum(2)
    meats = (of_all @ of_all.mT).sum(0), wide * by_frame.mT @ by_frame
    common = torch.stack([whole * scale, *(whole @ meat @ whole for meat in meats)])
    return common, torch.stack([inverse * scale, inverse @ (of_own @ of_own.mT) @ inverse]), lead
