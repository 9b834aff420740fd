"""What repeated frames and the picture around the panel tell without a fit of the panel."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import fft, ndimage, optimize
from torch import Tensor

from vocc_torch.simulation.photometry import MIDDLE_GREY
from vocc_torch.studies.calibrate import model
from vocc_torch.studies.calibrate.fit import UNDITHERED, RecordingFit
from vocc_torch.studies.calibrate.model import Noise

Array = NDArray[np.float64]

BINS = 24
"""Levels of light at which residuals are compared."""
STILL_PX = 0.1
"""A panel that moves less stands still: its pixels can be compared from frame to frame."""
CELL_PX = 16
"""Side of the blocks over which the background is averaged."""
LUMINANCE_TABLE = (
    *(16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56),
    *(14, 17, 22, 29, 51, 87, 80, 62, 18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92),
    *(49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99),
)
"""Of ITU-R T.81, Table K.1."""


@dataclass(frozen=True)
class Curve:
    """A photon transfer curve: variances of residuals by level of light, and what explains them.

    Args:
        light: (N,) levels.
        variance: (N,) of the grey values' residuals there.
        pixels: (N,) how many.
        noise: the fitted slope and floor.
        deviation: standard deviations of slope and floor; NaN for what was not fitted.
        gains: how much the criterion favours slope, floor, over what is without.
        still: whether pixels were compared from frame to frame.
    """

    light: Array
    variance: Array
    pixels: Array
    noise: Noise
    deviation: tuple[float, float]
    gains: tuple[float, float]
    still: bool


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
    height, width = fit.windows.size_px
    y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    pixels = torch.stack([x, y], -1).view(-1, 2).double() + fit.windows.origin_px[0]
    nearest = torch.cdist(pixels, at).argmin(1)
    lit = fit.bits[:, nearest].view_as(residual)
    left, kept = residual.clone(), torch.zeros_like(residual)
    for one in (lit, ~lit):
        count = one.sum(0)
        mean = (residual * one).sum(0) / count.clamp(min=1)
        left = torch.where(one, left - mean, left)
        kept = torch.where(one, (1 - 1 / count.clamp(min=1)).expand_as(kept), kept)
    return left, kept, True


def transfer(fit: RecordingFit) -> Curve:
    """Fit a photon transfer curve to the residuals of a fit, in grey values as they are written."""
    left, kept, still = residuals(fit)
    light = fit.light().flatten()
    mean = model.encoded(light, fit.of_all[0])
    use = (mean < model.WHITE - 8) & (kept.flatten() > 0.4)
    light, square = light[use], (left.flatten()[use].square() / kept.flatten()[use])
    low, high = float(light.min().log()), float(light.max().log())
    place = ((light.log() - low) / max(high - low, 1e-9) * BINS).long().clamp(max=BINS - 1)
    count = torch.bincount(place, minlength=BINS).double()
    good = count >= 50
    level = (torch.bincount(place, light, BINS) / count.clamp(min=1))[good]
    # Far residuals are what passes by, not noise.
    bulk = torch.stack([square[place == i].median() if good[i] else count[i] for i in range(BINS)]) / 0.455
    calm = square < 16 * bulk[place]
    calm_count = torch.bincount(place[calm], minlength=BINS).double()[good]
    raw = torch.bincount(place[calm], square[calm], BINS)[good] / calm_count.clamp(min=1)
    gamma = fit.of_all[0]

    def predicted(slope: float, floor: float) -> Tensor:
        return model.expected(level, gamma, Noise(slope, floor))[1]

    def loss(slope: float, floor: float) -> float:
        variance = predicted(slope, floor)
        return float((calm_count * (variance.log() + raw / variance)).sum())

    middle = level[calm_count.argmax()]
    unit = float((gamma * middle / model.encoded(middle, gamma)) ** 2 * raw[calm_count.argmax()])
    starts = (math.log(max(unit / float(middle), 1e-12)), math.log(max(unit, 1e-15)))
    none = loss(0.0, 0.0)
    alone = [
        least(lambda p: loss(math.exp(p[0]), 0.0), starts[:1]),
        least(lambda p: loss(0.0, math.exp(p[0])), starts[1:]),
    ]
    both = least(lambda p: loss(math.exp(p[0]), math.exp(p[1])), (starts[0] - 0.7, starts[1] - 0.7))
    cost = math.log(max(float(calm_count.sum()), 2.0))
    # The curve's own misfit: bins that no curve meets say less.
    dof = max(len(level) - 2, 1)
    wanted = predicted(math.exp(both[0][0]), math.exp(both[0][1]))
    misfit = max(1.0, float((calm_count / 2 * (raw / wanted - 1).square()).sum()) / dof)
    gains = tuple((without - both[1]) / misfit - cost for without in (alone[1][1], alone[0][1]))
    kept_parts = tuple(gain > 0 for gain in gains)
    if kept_parts == (False, False):  # either explains what both do
        kept_parts = (alone[0][1] <= alone[1][1], alone[0][1] > alone[1][1])
        if (none - min(alone[0][1], alone[1][1])) / misfit <= cost:
            kept_parts = (False, False)
            gains = ((none - alone[0][1]) / misfit - cost, (none - alone[1][1]) / misfit - cost)
    found = both if kept_parts == (True, True) else alone[0] if kept_parts[0] else alone[1]
    values = [0.0, 0.0]
    free = [i for i in (0, 1) if kept_parts[i]]
    for i, log_value in zip(free, found[0], strict=False):
        values[i] = math.exp(log_value)
    deviation = [math.nan, math.nan]
    if free:
        steps = []
        base = predicted(*values)
        for i in free:
            more = [v * (1 + 1e-4 * (j == i)) for j, v in enumerate(values)]
            steps.append((predicted(*more) - base) / (1e-4 * values[i]))
        slopes = torch.stack(steps)
        information = (slopes * (calm_count / (2 * base.square()))) @ slopes.T
        errors = torch.linalg.pinv(information, hermitian=True).diagonal().clamp(min=0).sqrt()
        for i, error in zip(free, errors.tolist(), strict=True):
            deviation[i] = error * math.sqrt(misfit)
    return Curve(
        level.numpy(),
        raw.numpy(),
        calm_count.numpy(),
        Noise(*values),
        (deviation[0], deviation[1]),
        (gains[0], gains[1]),
        still,
    )


def least(loss: Callable[[Array], float], begin: tuple[float, ...]) -> tuple[Array, float]:
    """Find the least of a function of a few numbers (Nelder and Mead)."""
    found = optimize.minimize(
        loss, np.array(begin), method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-6}
    )
    return np.asarray(found.x, dtype=np.float64), float(found.fun)


@dataclass(frozen=True)
class Scatter:
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


@dataclass(frozen=True)
class Surround:
    """The picture around the panel, in all kept frames.

    Args:
        greys: (B,H,W).
        box: rows and columns of the ring's outer border: top, bottom, left, right.
        outside: (H,W) bool, where no frame has the panel.
    """

    greys: NDArray[Any]
    box: tuple[int, int, int, int]
    outside: NDArray[np.bool_]

    @classmethod
    def of(cls, greys: NDArray[Any], corners_px: Tensor, shape_cells: int) -> "Surround":
        """Leave the panel out, with two cells and 8 px around it, in every frame."""
        height, width = greys.shape[1:]
        outside = np.ones((height, width), dtype=bool)
        bounds = []
        for corners in corners_px.numpy():
            low, high = corners.min(0), corners.max(0)
            margin = 2 * float((high - low).max()) / shape_cells + 8
            (left, top), (right, bottom) = np.floor(low - margin), np.ceil(high + margin)
            bounds.append((top, bottom, left, right))
            outside[max(0, int(top)) : max(0, int(bottom)), max(0, int(left)) : max(0, int(right))] = False
        edges = np.array(bounds)
        wide = int(0.5 * (edges[:, 1] - edges[:, 0]).max()) + 24
        top, left = (max(0, int(edges[:, i].min()) - wide) for i in (0, 2))
        bottom = min(height, int(edges[:, 1].max()) + wide)
        return cls(greys, (top, bottom, left, min(width, int(edges[:, 3].max()) + wide)), outside)

    def noise(self) -> float:
        """Variance of the background from pixel to pixel next to it, in grey values; 0 where all is panel."""
        apart = np.diff(self.greys.astype(np.float64), axis=2)
        both = self.outside[:, 1:] & self.outside[:, :-1]
        return float((apart[:, both] ** 2).mean()) / 2 if both.any() else math.inf

    def ring(self) -> tuple[Array, NDArray[np.bool_]]:
        """Give the greys around the panel (B,h,w), each frame less its own median, and which are outside."""
        top, bottom, left, right = self.box
        part = self.greys[:, top:bottom, left:right].astype(np.float64)
        outside = self.outside[top:bottom, left:right]
        middles = np.array([np.median(frame[outside]) if outside.any() else 0.0 for frame in part])
        return part - middles[:, None, None], outside


@dataclass(frozen=True)
class Pattern:
    """Noise that stays, or that rows share, in grey values of the background.

    Args:
        fixed: standard deviation of the pattern that stays.
        fixed_deviation: of that.
        fixed_gain: log-likelihood ratio over what noise alone leaves, times two.
        row: standard deviation of rows' own offsets.
        row_deviation: of that.
        row_gain: as ``fixed_gain``.
        pixels: how many were looked at.
    """

    fixed: float = 0.0
    fixed_deviation: float = math.nan
    fixed_gain: float = 0.0
    row: float = 0.0
    row_deviation: float = math.nan
    row_gain: float = 0.0
    pixels: int = 0


def variance_gain(found: float, expected: float, count: float) -> float:
    """Say how much likelier a variance is that is as found than one as expected: 2 log of their ratio.

    Example:
        >>> variance_gain(1.0, 1.0, 100), round(variance_gain(2.0, 1.0, 100), 1)
        (0.0, 30.7)
    """
    if found <= expected or expected <= 0:
        return 0.0
    return count * (found / expected - 1 - math.log(found / expected))


def patterns(around: Surround) -> Pattern:
    """Part what stays in a pixel, and what a row shares, from noise that is new in each frame."""
    rest, outside = around.ring()
    frames = len(rest)
    if frames < 4 or outside.sum() < 400:
        return Pattern()
    mean = rest.mean(0)
    temporal = rest.var(0, ddof=1)
    calm = outside & (temporal < 16 * np.median(temporal[outside]) + 1)
    # Each pixel less its four neighbours: light that changes slowly over the picture is no pattern.
    kernel = np.array([[0, -0.25, 0], [-0.25, 1, -0.25], [0, -0.25, 0]])
    sharp = ndimage.convolve(mean, kernel)
    whole = ndimage.minimum_filter(calm, size=3)
    if whole.sum() < 200:
        return Pattern()
    bulk = sharp[whole]
    bulk = bulk[np.abs(bulk) < 6 * np.median(np.abs(bulk)) + 1e-9]
    found, noise = float(bulk.var()) / 1.25, float(temporal[whole].mean()) / frames
    # Neighbours share a part: fewer pixels than there are count.
    count = len(bulk) / 1.8
    fixed = math.sqrt(max(0.0, found - noise))
    error = found * math.sqrt(2 / count) / (2 * fixed) if fixed > 0 else math.nan
    moving = rest - mean
    wide = calm.sum(1)
    rows = wide >= 16
    shared = (moving * calm).sum(2)[:, rows] / wide[rows]
    shared = shared - shared.mean(1, keepdims=True)
    left = (1 - 1 / frames) * (1 - 1 / max(rows.sum(), 2))
    each = (temporal * calm).sum(1)[rows] / wide[rows] / wide[rows]
    row_found, row_noise = float((shared**2).mean()) / left, float(each.mean())
    row_count = frames * int(rows.sum()) * left
    row = math.sqrt(max(0.0, row_found - row_noise))
    row_error = row_found * math.sqrt(2 / row_count) / (2 * row) if row > 0 else math.nan
    gains = variance_gain(found, noise, count), variance_gain(row_found, row_noise, row_count)
    return Pattern(fixed, error, gains[0], row, row_error, gains[1], int(whole.sum()))


@dataclass(frozen=True)
class Falloff:
    """How light falls off from the middle of the sensor.

    Args:
        natural_gain: how much the criterion favours cos^4 over even light.
        barrel_gain: how much it favours a loss in the lens barrel over cos^4 alone.
        corner_loss: that loss.
        deviation: its standard deviation.
        blocks: how many blocks of background were compared.
    """

    natural_gain: float = 0.0
    barrel_gain: float = 0.0
    corner_loss: float = 0.0
    deviation: float = math.nan
    blocks: int = 0


def natural(height: int, width: int, focal_px: float) -> tuple[Array, Array]:
    """Give cos^4 of each pixel's field angle, and its distance from the middle over the corner's, (H,W)."""
    y, x = np.mgrid[:height, :width] + 0.5
    square = (x - width / 2) ** 2 + (y - height / 2) ** 2
    return 1 / (1 + square / focal_px**2) ** 2, np.sqrt(square) / (math.hypot(height, width) / 2)


def falloff(around: Surround, focal_px: float, gamma: float) -> Falloff:
    """Compare the background's blocks with even light, with cos^4 and with a lens barrel's loss."""
    height, width = around.greys.shape[1:]
    rows, columns = height // CELL_PX, width // CELL_PX
    if rows * columns < 40 or not around.outside.any():
        return Falloff()
    inside = np.s_[: rows * CELL_PX, : columns * CELL_PX]

    def blocks(plane: Array) -> Array:
        return (
            plane[inside]
            .reshape(rows, CELL_PX, columns, CELL_PX)
            .transpose(0, 2, 1, 3)
            .reshape(rows, columns, -1)
        )

    light = np.zeros((rows, columns))
    for frame in around.greys:
        cells = np.mean(blocks(frame.astype(np.float64)), axis=2)
        light += (cells / np.median(cells)) ** gamma
    light /= len(around.greys)
    free = blocks(around.outside.astype(np.float64)).min(2) > 0
    free &= np.isfinite(light) & (light > 0)
    shade, out = (blocks(plane).mean(2) for plane in natural(height, width, focal_px))
    for _ in range(3):
        rest = light - np.median(light[free])
        free &= np.abs(rest) < 6 * 1.48 * np.median(np.abs(rest[free])) + 0.02
    count = int(free.sum())
    if count < 40:
        return Falloff()
    y, shade, out = light[free], shade[free], out[free]

    # Without noise all of a block is rounded alike.
    pixels = 1.0 if around.noise() < UNDITHERED else float(len(around.greys) * CELL_PX**2)
    typical = float(np.median(around.greys[:, around.outside]))
    rounding = count * (gamma / max(typical, 1.0)) ** 2 / 12 / pixels

    def explained(*parts: Array) -> tuple[float, Array, Array]:
        design = np.stack(parts, 1)
        solution, *_ = np.linalg.lstsq(design, y, rcond=None)
        misfit = float(((y - design @ solution) ** 2).sum()) + rounding
        return misfit, solution, np.linalg.pinv(design.T @ design) * misfit / max(count - len(parts), 1)

    flat, cosine, barrel = explained(np.ones(count)), explained(shade), explained(shade, shade * out)
    cost = math.log(count)
    barrel_gain = count * math.log(cosine[0] / barrel[0]) - cost
    natural_gain = (
        count * math.log(flat[0] / min(cosine[0], barrel[0] if barrel_gain > 0 else cosine[0])) - cost
    )
    loss = -barrel[1][1] / barrel[1][0]
    turn = np.array([loss, 1.0]) / barrel[1][0]
    deviation = math.sqrt(max(0.0, float(turn @ barrel[2] @ turn)))
    return Falloff(natural_gain, barrel_gain, float(loss), deviation, count)


def quantisation_table(quality: int) -> Array:
    """Give libjpeg's table of luminance steps at a quality, (8,8)."""
    scale = 5000 / quality if quality < 50 else 200 - 2 * quality
    table = np.floor((np.array(LUMINANCE_TABLE, dtype=np.float64) * scale + 50) / 100)
    return table.clip(1, 255).reshape(8, 8)


def compression(greys: NDArray[Any]) -> tuple[int, float]:
    """Say at which JPEG quality frames were coded, and how sure that is.

    Cosine coefficients of coded blocks lie on multiples of their steps: the mean of ``cos(2 pi c / step)``
    over coefficients beyond half a step is then near 1, and near 0 where nothing was coded. That over its
    standard deviation by chance is the criterion.

    Args:
        greys: (B,H,W), the blocks' grid beginning at the first pixel.

    Returns:
        the likeliest quality, and its criterion.
    """
    height, width = (side // 8 * 8 for side in greys.shape[1:])
    if not height or not width:
        return 0, 0.0
    frames = greys[:: max(1, len(greys) // 8), :height, :width].astype(np.float64) - 128
    blocks = (
        frames.reshape(len(frames), height // 8, 8, width // 8, 8).transpose(0, 1, 3, 2, 4).reshape(-1, 8, 8)
    )
    blocks = blocks[:: max(1, len(blocks) // 20_000)]
    coefficients = fft.dctn(blocks, axes=(1, 2), norm="ortho")
    coefficients[:, 0, 0] = 0
    best = 0, 0.0
    for quality in range(30, 97):
        table = quantisation_table(quality)
        coarse = np.broadcast_to(table >= 4, coefficients.shape)
        steps = coefficients / table
        used = steps[coarse & (np.abs(steps) > 0.5)]
        if len(used) < 100:
            continue
        score = float(np.cos(2 * np.pi * used).mean()) * math.sqrt(2 * len(used))
        if score > best[1]:
            best = quality, score
    return best


def lamps(around: Surround) -> tuple[float, float, float]:
    """Count round bright things beyond the panel: how many a frame, their median diameter (px) and grey."""
    counts, wide, greys = [], [], []
    for frame in around.greys[:: max(1, len(around.greys) // 8)]:
        middle = float(np.median(frame[around.outside])) if around.outside.any() else 255.0
        marked, _ = ndimage.label((frame > middle + 0.6 * (255 - middle)) & around.outside)
        found = 0
        for number, place in enumerate(ndimage.find_objects(marked), 1):
            height, width = (part.stop - part.start for part in place)
            mask = marked[place] == number
            if min(height, width) >= 3 and 0.6 < height / width < 1.7 and mask.mean() > 0.6:
                found += 1
                wide.append(math.sqrt(4 * mask.sum() / math.pi))
                greys.append(float(np.median(frame[place][mask])))
        counts.append(found)
    if not wide:
        return 0.0, 0.0, 0.0
    return float(np.mean(counts)), float(np.median(wide)), float(np.median(greys))


def middle_slope(x: float, gamma: Tensor, noise: Noise) -> float:
    """Derivative of the mean grey value of noisy light by the light."""
    step = max(1e-3 * x, 1e-7)
    ends = model.expected(torch.tensor([x - step, x + step]).double().clamp(min=1e-9), gamma, noise)[0]
    return float((ends[1] - ends[0]) / (2 * step))


def light_of(grey: float, gamma: float) -> float:
    """Give the light that is encoded as a grey value."""
    return float((grey / MIDDLE_GREY) ** gamma)
