"""The LEDs: which are On, how bright each is, and where a fit of them begins."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from scipy import optimize
from torch import Tensor

from vocc_torch.extras.calibrate import model
from vocc_torch.extras.calibrate.fit import RecordingFit, settled
from vocc_torch.extras.calibrate.model import LEVELS, OF_FRAME, PLACED, TURNED, Windows
from vocc_torch.receiver.resample import map_points
from vocc_torch.simulation import raster

BEGUN_WITH = 3
"""Frames by which the blur's size is searched for."""
STRAIGHT = 1.0
"""Grey values over which the encoding is straight."""
DOUBTFUL = 12
"""LEDs of a frame that are turned over."""
BASE = (*PLACED, *LEVELS[:3], "gamma", "blur")
POSED = (*PLACED, *TURNED, *LEVELS[:3], "gamma", "blur")


def start(
    windows: Windows, grey: Tensor, corners_px: Tensor, bits: Tensor | None, gamma: float
) -> RecordingFit:
    """Begin from the corners that the locator found.

    Args:
        windows: what is known.
        grey: (B,H,W) windows of the frames.
        corners_px: (B,4,2) on the sensor.
        bits: (B,R,C) known bits, or None to decide them from the grey values at the LEDs' centres.
        gamma: the camera's.
    """
    shape, at = windows.shape, model.grid(windows.shape)
    middle = torch.tensor([shape.columns / 2, shape.rows / 2]).double()
    points = map_points(corners_px, torch.cat([at + middle, middle[None]])[None], shape)
    side = corners_px.roll(-1, 1) - corners_px
    right, down = side[:, 0] - side[:, 2], side[:, 1] - side[:, 3]
    pitch = (right.norm(dim=1) / shape.columns + down.norm(dim=1) / shape.rows) / 4
    roll = torch.atan2(right[:, 1], right[:, 0])
    inside = (points[:, :-1] - windows.origin_px.double()[:, None]).floor().long()
    x, y = (inside[..., i].clamp(1, windows.size_px[1 - i] - 2) for i in (0, 1))
    frames, near = torch.arange(len(grey))[:, None], (-1, 0, 1)
    centres = torch.stack([grey[frames, y + i, x + j] for i in near for j in near]).mean(0)
    lit = two_levels(centres) if bits is None else bits.flatten(1)
    on, off = ((centres * one).sum(1) / one.sum(1).clamp(min=1) for one in (lit, ~lit))
    behind = torch.cat([grey[:, :2].flatten(1), grey[:, -2:].flatten(1)], 1).median(1).values
    on = torch.where(lit.any(1), on, centres.amax(1) + 20)
    off = torch.where((~lit).any(1), off, behind)
    values = [points[:, -1, 0], points[:, -1, 1], pitch.log(), *(0 * roll, 0 * roll, roll)]
    values += [behind.clamp(min=1), off.clamp(min=1), 1.3 * on.clamp(min=2), off.clamp(min=1)]
    of_all = torch.tensor([gamma, 1.0, 1.0, 0.0]).double()
    begun = RecordingFit(windows, grey, torch.stack(values, 1), of_all, lit.double())
    few, tried = begun.taken(slice(0, BEGUN_WITH)), []
    for share in (0.12, 0.25, 0.45, 0.7):
        moment = float(pitch.median() * share) ** 2
        blurred = replace(few, of_all=of_all.index_fill(0, torch.tensor([1, 2]), moment))
        tried.append(settled(blurred, (*LEVELS[:3], "blur"), steps=2, robust=False))
    best = min(tried, key=lambda one: one.misfit)
    return settled(replace(begun, of_all=best.of_all), LEVELS[:3], steps=3, robust=False)


def two_levels(greys: Tensor) -> Tensor:
    """Part each frame's grey values (B,N) where the variance between the parts is greatest (Otsu)."""
    ordered = greys.sort(1).values
    count = torch.arange(1, greys.shape[1], dtype=greys.dtype)
    total = ordered.cumsum(1)
    low, high = total[:, :-1] / count, (total[:, -1:] - total[:, :-1]) / (greys.shape[1] - count)
    best = (count * (greys.shape[1] - count) * (high - low).square()).argmax(1, keepdim=True)
    return greys > ordered.gather(1, best)


def amplitudes(fit: RecordingFit) -> tuple[Tensor, Tensor]:
    """Solve for each LED's own light by linear least squares, all else being as fitted.

    Returns:
        (B,R*C) light over that of On, and its standard deviation.
    """
    values, errors, leds = [], [], fit.lit.shape[1]
    for frame in range(len(fit.grey)):
        one = fit.taken(slice(frame, frame + 1))
        x = one.light()
        mean, variance = one.predicted()
        # Of the chord, not the tangent: from Off to On the encoding is no straight line.
        grey, seen_x = model.encoded(x, one.of_all[0]), model.linear(one.grey, one.of_all[0])
        chord, tangent = (one.grey - grey) / (seen_x - x), grey / (one.of_all[0] * x)
        steep = torch.where((one.grey - grey).abs() < STRAIGHT, tangent, chord)
        steep = torch.where(torch.minimum(grey, one.grey) < model.WHITE - 0.5, steep, 0.0)
        at = model.seen(one.windows, one.of_frame, one.of_all, model.grid(one.windows.shape))
        patches, left, top = model.stamped(one.windows, *at)
        canvas = torch.zeros(leds, *one.windows.size_px).double()
        raster.add_patches(canvas, patches, torch.arange(leds), left, top)
        spots = model.through_camera(one.windows, canvas, one.of_all) * steep
        spots = (spots * (one.level("on") - one.level("off"))).flatten(1)
        weights = (one.trust / variance).flatten()
        matrix = (spots * weights) @ spots.T
        matrix.diagonal().add_(1e-6 * matrix.diagonal().mean() + 1e-12)
        inverse = torch.linalg.inv(matrix)
        step = inverse @ (spots @ (weights * (one.grey - mean).flatten()))
        values.append(fit.lit[frame] + step)
        errors.append((inverse.diagonal() * fit.scale).sqrt())
    return torch.stack(values), torch.stack(errors)


def decided(fit: RecordingFit, free: Sequence[str], rounds: int = 4) -> tuple[RecordingFit, Tensor, Tensor]:
    """Fit and decide the bits in turns until none changes: the likeliest bits of the likeliest values.

    Returns:
        the fit, and each LED's light over On's with its standard deviation, (B,R*C) each.
    """
    fit = settled(fit, free)
    own, error = amplitudes(fit)
    for _ in range(rounds):
        lit = likelier(fit, own, error)
        if torch.equal(lit > 0, fit.bits):
            break
        fit = settled(replace(fit, lit=lit), free)
        own, error = amplitudes(fit)
    return fit, own, error


def likelier(fit: RecordingFit, own: Tensor, error: Tensor) -> Tensor:
    """Decide bits by each LED's light, or turn the most doubtful over, where that explains a frame better.

    Light that is clipped at white says too little of an LED: only the picture as a whole tells.
    """
    weights, rows = fit.trust / fit.predicted()[1], torch.arange(len(own))

    def misfit(lit: Tensor) -> Tensor:
        left = fit.grey - replace(fit, lit=lit).predicted()[0]
        return (weights * left.square()).sum((1, 2))

    lit = (fit.lit > 0).double()
    doubts, least = ((own - lit) / error).abs().argsort(1, descending=True).T[:DOUBTFUL], misfit(lit)
    for doubtful in (None, *doubts):
        other = (own > 0.5).double() if doubtful is None else lit.clone()
        if doubtful is not None:
            other[rows, doubtful] = 1 - other[rows, doubtful]
        new = misfit(other)
        lit, least = torch.where((new < least).unsqueeze(1), other, lit), torch.minimum(new, least)
    return lit


def mirrored(fit: RecordingFit, free: Sequence[str]) -> tuple[RecordingFit, Tensor]:
    """Turn each panel the other way where that explains its frame better: from afar both look alike.

    Returns:
        the better fit, and by how much the misfit of each frame tells the two ways apart, (B,).
    """
    turned = fit.of_frame * torch.ones(len(OF_FRAME)).double().index_fill(0, torch.tensor([3, 4]), -1.0)
    other = settled(replace(fit, of_frame=turned), free, steps=8)
    here, there = (
        ((fit.grey - mean).square() / variance).sum(dim=(1, 2))
        for mean, variance in (fit.predicted(), other.predicted())
    )
    better, apart = (there < here).unsqueeze(1), (there - here).abs() / fit.scale
    if not bool(better.any()):
        return fit, apart
    return settled(replace(fit, of_frame=torch.where(better, other.of_frame, fit.of_frame)), free), apart


class Scatter(NamedTuple):
    """How the LEDs' light differs.

    Args:
        share: its coefficient of variation.
        deviation: standard deviation of that.
        gain: twice the log-likelihood ratio over LEDs that are alike.
        factors: (R*C,) each LED's own light over the mean.
    """

    share: float
    deviation: float
    gain: float
    factors: Tensor


def scatter(own: Tensor, error: Tensor, bits: Tensor) -> Scatter:
    """Compare the LEDs' light in the frames in which they are On.

    What frames add to an LED's scatter about its own mean beyond the pixels' noise counts as noise.

    Args:
        own: (B,N) each LED's light over On's.
        error: (B,N) its standard deviation.
        bits: (B,N) which are On.
    """
    weights = bits / error.square()
    total = weights.sum(0)
    mean = (weights * own).sum(0) / total.clamp(min=1e-12)
    lit = total > 0
    around = (weights * (own - mean).square()).sum(0)[lit]
    freedom = (bits.sum(0)[lit] - 1).clamp(min=0).sum()
    noise = max(1.0, float(around.sum() / freedom.clamp(min=1))) / total[lit]
    seen, count = mean[lit], int(lit.sum())
    middle = float(seen.mean()) if count else 1.0
    factors = torch.where(lit, (mean / middle).clamp(min=0.05), 1.0)
    if count < 4:
        return Scatter(0.0, math.nan, 0.0, factors)

    def loss(log_share: float) -> float:
        spread = noise + (math.exp(log_share) * middle) ** 2
        centre = (seen / spread).sum() / (1 / spread).sum()
        return float((spread.log() + (seen - centre).square() / spread).sum())

    found = optimize.minimize_scalar(loss, bounds=(math.log(1e-5), math.log(2.0)), method="bounded")
    share = math.exp(float(found.x))
    # Of a variance that is the sum of the LEDs' own and the noise's.
    whole = share**2 + float(noise.mean()) / middle**2
    deviation = whole / max(share, 1e-9) / math.sqrt(2 * count)
    return Scatter(share, deviation, loss(math.log(1e-6)) - float(found.fun), factors)
