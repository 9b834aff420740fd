"""Where a lattice of LEDs may lie, however bright: texture finds places, the spectrum there finds the lattice.

A panel of random bits has much fine texture along both of its axes, for its contrast. In a window about such
a place the lattice is a peak in two spectra: of the grey values, for LEDs with gaps between them, and of the
absolute differences of neighbours, for LEDs that fill their cells. Both are searched on a pyramid of halved
pictures, on each for pitches of 3 to 6 px.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor, nn

from vocc_torch.types import Batched, PanelShape

PITCHES_PX = (2.9, 6.3)
"""Pitches that are searched on one level of the pyramid, px."""

# A shear or turn of the lattice's lines up to this, as a tangent; LEDs along a side whose light is summed.
_SHEAR, _MOST_CELLS = 0.36, 16
# Proposals of each level, windows of most periodic light in a frame, and peaks of an axis in each.
_PROPOSALS, _WINDOWS, _PEAKS = 28, 32, 2
# Side of the blocks whose texture is summed, px; texture below this deviation is noise of rounding, DN.
_BLOCK_PX, _LEAST_DN = 4, 4.0
_MID_PITCH_PX = 4.0


class Pyramid(NamedTuple):
    """Halved pictures of B frames in one row, so that all are read at once.

    Args:
        values: (N,) float32 grey values, level by level, frame by frame.
        begin: (L,) int64 where a level begins.
        size: (L,2) int64 height and width of a level.
    """

    values: Tensor
    begin: Tensor
    size: Tensor

    @classmethod
    def of(cls, grey: Tensor, least_px: int) -> "Pyramid":
        """Halve (B,1,H,W) grey values down to sides of ``least_px``."""
        level, flat, sizes = grey.to(torch.float32), [], []
        while True:
            flat.append(level.flatten())
            sizes.append(tuple(level.shape[-2:]))
            if min(sizes[-1]) < 2 * least_px:
                break
            level = nn.functional.avg_pool2d(level, 2)
        begin = torch.tensor([0, *(len(one) for one in flat)], device=grey.device).cumsum(0)[:-1]
        return cls(torch.cat(flat), begin, torch.tensor(sizes, device=grey.device))

    def level(self, number: int, frames: int) -> Tensor:
        """Return a level's pictures (B,H,W)."""
        begin, (high, wide) = int(self.begin[number]), self.size[number].tolist()
        return self.values[begin : begin + frames * high * wide].view(frames, high, wide)

    def read(self, frame: Tensor, level: Tensor, x: Tensor, y: Tensor) -> Tensor:
        """Read levels at points (n,P), px of the level, between pixels; beyond the border it is repeated."""
        high, wide = (one[:, None] for one in self.size[level].unbind(1))
        x, y = x - 0.5, y - 0.5
        left, top = x.floor(), y.floor()
        right_share, low_share = x - left, y - top
        base = self.begin[level][:, None] + frame[:, None] * high * wide
        left, top = left.long(), top.long()
        columns = [torch.minimum((left + n).clamp(min=0), wide - 1) for n in (0, 1)]
        rows = [base + torch.minimum((top + n).clamp(min=0), high - 1) * wide for n in (0, 1)]
        lines = []
        for row in rows:
            first, second = (self.values[row + column] for column in columns)
            lines.append(first + (second - first) * right_share)
        return lines[0] + (lines[1] - lines[0]) * low_share


@dataclass(frozen=True, slots=True)
class Hypotheses(Batched):
    """Lattices as they may lie, n of them.

    Args:
        frame: (n,) int64.
        level: (n,) int64 of the pyramid, on which pitches are about 3 to 6 px.
        centre_px: (n,2) the middle of one of the cells, px of the level.
        basis_px: (n,2,2) the steps from a cell to the one right of it and to the one below, as columns.
        strength: (n,) how periodic the light is, 1 where it is not.
    """

    frame: Tensor
    level: Tensor
    centre_px: Tensor
    basis_px: Tensor
    strength: Tensor


def texture(plane: Tensor, shape: PanelShape, pitch_px: float) -> Tensor:
    """Texture along both axes for its contrast, (B,h,w) in blocks of 4 px, within boxes of a panel's size."""
    lag = 2 if pitch_px > 3 else 1
    across = (plane[:, ::2, lag:] - plane[:, ::2, :-lag]).abs()
    down = (plane[:, lag:, ::2] - plane[:, :-lag, ::2]).abs()
    level = plane[:, ::2, ::2] - 128
    half = _BLOCK_PX // 2
    high, wide = (side // _BLOCK_PX for side in (plane.shape[1] - lag, plane.shape[2] - lag))
    blocks = []
    for values, size in (
        (across, (half, _BLOCK_PX)),
        (down, (_BLOCK_PX, half)),
        (level, half),
        (level * level, half),
    ):
        blocks.append(nn.functional.avg_pool2d(values[:, None], size)[:, 0, :high, :wide])
    box = [max(1, round(leds * pitch_px * 0.75 / _BLOCK_PX)) | 1 for leds in (shape.rows, shape.columns)]
    box = [min(one, side - 1 + side % 2) for one, side in zip(box, (high, wide), strict=True)]
    pad = (box[1] // 2, box[1] // 2, box[0] // 2, box[0] // 2)
    mean = nn.functional.avg_pool2d(
        nn.functional.pad(torch.stack(blocks, 1), pad, mode="replicate"), tuple(box), 1
    )
    rough = torch.minimum(mean[:, 0], mean[:, 1])
    contrast = (mean[:, 3] - mean[:, 2] ** 2).clamp(min=0).sqrt()
    return rough**2 / (contrast + _LEAST_DN)


def proposals(pyramid: Pyramid, frames: int, shape: PanelShape) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Places of most texture: frame (n,), level (n,), step (n,) px between samples, and centre (n,2) px."""
    found: list[tuple[Tensor, ...]] = []
    jobs = [(0, 0.5)] + [(level, 1.0) for level in range(len(pyramid.begin))]
    for level, step in jobs:
        plane = pyramid.level(level, frames)
        pitch = _MID_PITCH_PX * step
        if min(plane.shape[1:]) < 3 * _BLOCK_PX:
            continue
        value = texture(plane, shape, pitch)
        side = [max(3, round(leds * pitch * 0.6 / _BLOCK_PX)) | 1 for leds in (shape.rows, shape.columns)]
        top = nn.functional.max_pool2d(value[:, None], tuple(side), 1, tuple(one // 2 for one in side))[:, 0]
        value = value.where((value >= top) & (value > 0), 0.0).flatten(1)
        best = value.topk(min(_PROPOSALS, value.shape[1]), 1)
        frame, place = (best.values > 0).nonzero().unbind(1)
        place = best.indices[frame, place]
        wide = top.shape[2]
        centre = torch.stack([place % wide, place // wide], 1) * float(_BLOCK_PX) + _BLOCK_PX / 2 + 0.5
        found.append((frame, torch.full_like(frame, level), torch.full_like(centre[:, 0], step), centre))
    return tuple(torch.cat(part) for part in zip(*found, strict=True))  # type: ignore[return-value]


class _Bank(NamedTuple):
    """Waves along an axis of a window: cosines and sines (F,S) at frequencies (F,), cycles a sample."""

    frequency: Tensor
    wave: Tensor

    @classmethod
    def of(cls, low: float, high: float, step: float, side: int, taper: Tensor, device: torch.device) -> "_Bank":
        count = round((high - low) / step) + 1
        frequency = torch.linspace(low, high, count, dtype=torch.float64)
        place = torch.arange(side, dtype=torch.float64) + 0.5 - side / 2
        phase = 2 * torch.pi * frequency[:, None] * place
        wave = torch.complex(phase.cos(), -phase.sin()) * taper
        return cls(frequency.to(device, torch.float32), wave.to(device, torch.complex64))


@lru_cache(maxsize=16)
@torch.inference_mode(False)
def _banks(leds: tuple[int, int], device: torch.device) -> tuple[int, Tensor, tuple[_Bank, _Bank], tuple[_Bank, _Bank]]:
    """Side of a window, its taper, and for each axis the waves along it and across it."""
    cells = [min(one, _MOST_CELLS) for one in leds]
    side = 2 * round(max(cells) * _MID_PITCH_PX * 0.75) + 2
    place = torch.arange(side, dtype=torch.float64) + 0.5 - side / 2
    tapers = [torch.exp(-((place / (one * 4.5 * 0.35)) ** 2) / 2) for one in cells]
    low, high = 1 / PITCHES_PX[1], 1 / PITCHES_PX[0]
    both = []
    for along, across in ((0, 1), (1, 0)):
        steps = [1 / (one * 4.5 * 2.2) for one in (cells[along], cells[across])]
        slant = _SHEAR * high
        both.append(
            (
                _Bank.of(low, high, steps[0], side, tapers[along], device),
                _Bank.of(-slant, slant, steps[1], side, tapers[across], device),
            )
        )
    taper = (tapers[1][:, None] * tapers[0]).to(device, torch.float32)
    return side, taper, both[0], both[1]


def _waves(windows: Tensor, taper: Tensor, banks: tuple[_Bank, _Bank], axis: int) -> tuple[Tensor, Tensor]:
    """Spectra (2,n,Fy,Fx) of grey values and of differences, and their power (n,Fy,Fx) over the mean one.

    Windows are (n,S,S), of which ``axis`` 0 is searched along x, 1 along y, with Fx the axis's own frequency.
    """
    local = nn.functional.avg_pool2d(nn.functional.pad(windows[:, None], (3,) * 4, mode="replicate"), 7, 1)[:, 0]
    change = torch.zeros_like(windows)
    if axis == 0:
        change[:, :, 1:-1] = (windows[:, :, 2:] - windows[:, :, :-2]).abs()
    else:
        change[:, 1:-1] = (windows[:, 2:] - windows[:, :-2]).abs()
    both = torch.stack([windows - local, change])
    both = both - (both * taper).sum((2, 3), keepdim=True) / taper.sum()
    flat = (both * taper).square().sum((2, 3))
    both = both.mT if axis else both
    own, other = banks
    found = other.wave @ both.to(torch.complex64) @ own.wave.mT
    power = found.abs().square() / (flat + 4.0 * taper.square().sum())[..., None, None]
    slanted = other.frequency[:, None].abs() > _SHEAR * own.frequency
    return found, power.sum(0).masked_fill(slanted, 0.0)


def lattice_hypotheses(pyramid: Pyramid, frames: int, shape: PanelShape) -> Hypotheses:
    """Find lattices in the windows of most texture, the most periodic of each frame."""
    frame, level, step, centre = proposals(pyramid, frames, shape)
    side, taper, *banks = _banks((shape.columns, shape.rows), pyramid.values.device)
    place = torch.arange(side, device=centre.device) + 0.5 - side / 2
    x = centre[:, :1] + (place.repeat(side) * step[:, None])
    y = centre[:, 1:] + (place.repeat_interleave(side) * step[:, None])
    windows = pyramid.read(frame, level, x, y).view(-1, side, side)
    frequency, offset, strength = [], [], []
    for axis in (0, 1):
        own, other = banks[axis]
        waves, power = _waves(windows, taper, banks[axis], axis)
        top = nn.functional.max_pool2d(power[:, None], 3, 1, 1)[:, 0]
        best = power.where(power >= top, 0.0).flatten(1).topk(_PEAKS, 1)
        row, column = best.indices // len(own.frequency), best.indices % len(own.frequency)
        pair = torch.stack([own.frequency[column], other.frequency[row]], 2)
        frequency.append(pair.flip(2) if axis else pair)
        there = waves.flatten(2).gather(2, best.indices.expand(2, -1, -1))
        # Grey values are greatest in the middle of a cell, differences on its border.
        offset.append(torch.stack([there[0].angle(), there[1].angle() + torch.pi]) / (2 * torch.pi))
        strength.append(best.values)
    # All pairs of an axis's peaks, and of the phases that the two spectra give.
    rows = torch.arange(len(frame), device=frame.device)
    found = []
    for one in range(_PEAKS):
        for other_peak in range(_PEAKS):
            waves_2 = torch.stack([frequency[0][:, one], frequency[1][:, other_peak]], 1)
            pair_strength = torch.minimum(strength[0][:, one], strength[1][:, other_peak])
            phases = [torch.stack([offset[0][a, :, one], offset[1][b, :, other_peak]], 1) for a in (0, 1) for b in (0, 1)]
            found.append((rows, waves_2, pair_strength, torch.stack(phases, 1)))
    rows, waves_2, power_2, phases_2 = (torch.cat(part) for part in zip(*found, strict=True))
    keep = _strongest(power_2, frame[rows], frames, _WINDOWS)
    rows, waves_2, power_2, phases_2 = rows[keep], waves_2[keep], power_2[keep], phases_2[keep]
    basis = torch.linalg.inv(waves_2.to(torch.float64)).to(torch.float32)
    # A wave cos(2 pi (f x) + angle) is greatest at f x = -angle / 2 pi.
    middle = (basis[:, None] @ (-phases_2)[..., None])[..., 0]
    size = step[rows]
    many = phases_2.shape[1]
    return Hypotheses(
        frame[rows].repeat_interleave(many),
        level[rows].repeat_interleave(many),
        (centre[rows][:, None] + middle * size[:, None, None]).flatten(0, 1),
        (basis * size[:, None, None]).repeat_interleave(many, 0),
        power_2.repeat_interleave(many),
    )


def _strongest(value: Tensor, frame: Tensor, frames: int, most: int) -> Tensor:
    """Indices of each frame's greatest values, at most ``most``."""
    kept = [
        rows[value[rows].topk(min(most, len(rows))).indices]
        for rows in ((frame == one).nonzero()[:, 0] for one in range(frames))
    ]
    return torch.cat(kept)
