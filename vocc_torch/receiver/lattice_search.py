"""Where a lattice of LEDs may lie, however bright: texture finds places, their spectrum the lattice.

A panel of random bits has much fine texture along both of its axes, for its contrast. In a window about such
a place the lattice is a peak in the spectra of the grey values, for LEDs with gaps between them, of the
absolute differences of neighbours, for LEDs that fill their cells, and of how light bends, for LEDs that run
into one another. It is searched on a pyramid of halved pictures, on each for pitches of 3 to 6.5 px, at most
1.65 times as long along one axis: the spectrum of the bits themselves may be stronger along one.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor, nn

from vocc_torch.types import Batched, PanelShape

PITCHES_PX = (2.9, 7.0)
"""Pitches that are searched on one level of the pyramid, px."""

MOST_CELLS = 12
"""LEDs along a side that a window shows."""

# A shear or turn of the lattice's lines up to this, as a tangent.
_SHEAR = 0.36
# How far the pitches along both axes differ, as a logarithm; pairs of them that are kept of a window; what
# power counts that is no peak; and lattices that are kept of a frame, as it is or turned, and stretched.
_MOST_OBLONG, _PAIRS, _FLANK, _LATTICES = 0.5, 4, 0.25, (50, 16)
# Windows of each level, their least texture for their contrast, and the least that their light is periodic.
_WINDOWS, _LEAST_TEXTURE, _LEAST_STRENGTH = 8, 0.1, 1.0
# Side of the blocks whose texture is summed and pixels between which light changes, px; texture of much less
# than this deviation counts less, DN.
_BLOCK_PX, _LAG_PX, _LEAST_DN = 4, 2, 7.0
# Share of a picture that is as rough as noise is, or less, and the step to the next block that tells.
_GRAIN, _GRAIN_STEP = 0.1, 13
_MID_PITCH_PX = 4.0
# A picture's share of a cell, samples, where a panel of such pitches may fill it or a good part of it.
_FILLED_PX = (2.6, 10.0)
# Samples of a window about which its light is levelled.
_LOCAL = 7
# How windows are sampled: as they are, turned by an eighth, and by steps that are stretched along x or y,
# which makes up for a panel seen from above or from aside; and how many of each level are stretched.
_STRETCH, _STRETCHED = 1.5, 3
_VIEWS = (
    ((1.0, 0.0), (0.0, 1.0)),
    ((math.sqrt(0.5), -math.sqrt(0.5)), (math.sqrt(0.5), math.sqrt(0.5))),
    ((_STRETCH, 0.0), (0.0, 1.0)),
    ((1.0, 0.0), (0.0, _STRETCH)),
)


class Pyramid(NamedTuple):
    """Halved pictures (H,W) float32 of one frame, the largest first."""

    levels: tuple[Tensor, ...]

    @classmethod
    def of(cls, grey: Tensor, least_px: int) -> "Pyramid":
        """Halve (1,1,H,W) grey values down to sides of ``least_px``."""
        levels = [grey[0, 0].to(torch.float32)]
        while min(levels[-1].shape) >= 2 * least_px:
            levels.append(_blocks(levels[-1], 2, 2))
        return cls(tuple(levels))

    def size_px(self, level: Tensor) -> Tensor:
        """Give width and height (n,2) of levels (n,)."""
        return torch.tensor(
            [one.shape[::-1] for one in self.levels], device=level.device
        )[level]

    def read(self, level: Tensor, x: Tensor, y: Tensor) -> Tensor:
        """Read levels at points (n,P), px of the level, between pixels; beyond the border is the mean.

        Where the picture ends at the panel its repeated border would be stripes of light, as no board has.
        """
        values, mean = torch.empty_like(x), self.levels[-1].mean()
        for number in sorted(set(level.tolist())):
            rows, plane = (level == number).nonzero()[:, 0], self.levels[number]
            places = [(x[rows], plane.shape[1]), (y[rows], plane.shape[0])]
            at = torch.stack([one * (2 / side) - 1 for one, side in places], 2)
            read = nn.functional.grid_sample(
                plane[None, None], at[None], padding_mode="border", align_corners=False
            )[0, 0]
            for one, side in places:
                least, most = one.aminmax()
                if not 0 <= least <= most <= side:
                    read = read.where((one >= 0) & (one <= side), mean)
            values[rows] = read
        return values


@dataclass(frozen=True, slots=True)
class Hypotheses(Batched):
    """Lattices as they may lie in a frame, n of them.

    Args:
        level: (n,) int64 of the pyramid, on which pitches are about 3 to 6 px.
        centre_px: (n,2) the middle of one of the cells, px of the level.
        basis_px: (n,2,2) the steps from a cell to the one right of it and to the one below, as columns.
        strength: (n,) how periodic the light is, 1 where it is not.
    """

    level: Tensor
    centre_px: Tensor
    basis_px: Tensor
    strength: Tensor


def _blocks(plane: Tensor, high: int, wide: int) -> Tensor:
    """Means over blocks of (H,W), sides of powers of two: sums of slices, many times faster than pooling."""
    for axis, size in ((0, high), (1, wide)):
        while size > 1:
            even = plane.narrow(axis, 0, plane.shape[axis] // 2 * 2)
            plane = (
                even[::2] + even[1::2] if axis == 0 else even[:, ::2] + even[:, 1::2]
            )
            plane *= 0.5
            size //= 2
    return plane


def _boxes(
    planes: Tensor, size: tuple[int, int], join: Callable[[Tensor, Tensor], Tensor]
) -> Tensor:
    """Join values over boxes of odd sides about each place of (n,H,W); borders go on.

    Spans of 1, 2, 4, ... values are joined to those of the sides: many times faster than pooling.
    """
    around = (size[1] // 2, size[1] // 2, size[0] // 2, size[0] // 2)
    planes = nn.functional.pad(planes[:, None], around, mode="replicate")[:, 0]
    for axis, side in ((1, size[0]), (2, size[1])):
        many, at, span, whole = planes.shape[axis] - side + 1, 0, 1, None
        while True:
            if side & span:
                piece = planes.narrow(axis, at, many)
                whole, at = piece if whole is None else join(whole, piece), at + span
            if 2 * span > side:
                break
            left = planes.shape[axis] - span
            planes = join(planes.narrow(axis, 0, left), planes.narrow(axis, span, left))
            span *= 2
        planes = planes if whole is None else whole
    return planes


def _texture_blocks(plane: Tensor) -> Tensor:
    """Means over blocks of 4 px of changes along both axes, of grey values, and of their squares (4,h,w)."""
    few = plane[::_LAG_PX, ::_LAG_PX] - 128
    side = _BLOCK_PX // _LAG_PX
    parts = (
        (few[:, 1:] - few[:, :-1]).abs_(),
        (few[1:] - few[:-1]).abs_(),
        few,
        few * few,
    )
    blocks = [_blocks(one, side, side) for one in parts]
    high, wide = (min(one.shape[axis] for one in blocks) for axis in (0, 1))
    return torch.stack([one[:high, :wide] for one in blocks])


def texture(blocks: Tensor, shape: PanelShape, pitch_px: float) -> Tensor:
    """Texture along both axes for its contrast, (h,w) in blocks (4,h,w), within boxes of a panel's size."""
    box = [
        max(1, round(leds * pitch_px * 0.75 / _BLOCK_PX)) | 1
        for leds in (shape.rows, shape.columns)
    ]
    box = [
        min(one, side - 1 + side % 2)
        for one, side in zip(box, blocks.shape[1:], strict=True)
    ]
    mean = _boxes(blocks, (box[0], box[1]), torch.add) / (box[0] * box[1])
    contrast = (mean[3] - mean[2] ** 2).clamp(min=0).sqrt()
    rough = torch.minimum(mean[0], mean[1])
    grain = rough.flatten()[::_GRAIN_STEP].quantile(_GRAIN)
    return (rough - grain).clamp(min=0) / (contrast + _LEAST_DN)


def proposals(pyramid: Pyramid, shape: PanelShape) -> tuple[Tensor, Tensor, Tensor]:
    """Places of most texture: level (n,), step (n,) px between samples, and centre (n,2) px.

    The middle of a picture is one too where a panel may fill it.
    """
    none = pyramid.levels[0].new_zeros(0)
    found: list[tuple[Tensor, ...]] = [(none.long(), none, none.view(0, 2))]
    for level, plane in enumerate(pyramid.levels):
        if min(plane.shape) < 3 * _BLOCK_PX:
            continue
        blocks = _texture_blocks(plane)
        for step in (0.5, 1.0) if level == 0 else (1.0,):
            pitch = _MID_PITCH_PX * step
            value = texture(blocks, shape, pitch)
            side = [
                max(3, round(leds * pitch * 0.6 / _BLOCK_PX)) | 1
                for leds in (shape.rows, shape.columns)
            ]
            top = _boxes(value[None], (side[0], side[1]), torch.maximum)[0]
            value = value.where(value >= top, 0.0).flatten()
            best = value.topk(min(_WINDOWS, len(value)))
            place = best.indices[best.values > _LEAST_TEXTURE]
            wide = top.shape[1]
            centre = (
                torch.stack([place % wide, place // wide], 1) * float(_BLOCK_PX)
                + _BLOCK_PX / 2
                + 0.5
            )
            filled = (
                min(plane.shape[0] / shape.rows, plane.shape[1] / shape.columns) / step
            )
            if _FILLED_PX[0] <= filled <= _FILLED_PX[1]:
                place = nn.functional.pad(place, (1, 0))
                middle = centre.new_tensor([[plane.shape[1] / 2, plane.shape[0] / 2]])
                centre = torch.cat([middle, centre])
            found.append(
                (
                    torch.full_like(place, level),
                    torch.full_like(centre[:, 0], step),
                    centre,
                )
            )
    return tuple(torch.cat(part) for part in zip(*found, strict=True))  # type: ignore[return-value]


class _Bank(NamedTuple):
    """Waves along an axis of a window: cosines and sines (F,S) at frequencies (F,), cycles a sample."""

    frequency: Tensor
    wave: Tensor

    @classmethod
    def of(
        cls,
        low: float,
        high: float,
        step: float,
        side: int,
        taper: Tensor,
        device: torch.device,
    ) -> "_Bank":
        count = round((high - low) / step) + 1
        frequency = torch.linspace(low, high, count, dtype=torch.float64)
        place = torch.arange(side, dtype=torch.float64) + 0.5 - side / 2
        phase = 2 * torch.pi * frequency[:, None] * place
        wave = torch.complex(phase.cos(), -phase.sin()) * taper
        return cls(
            frequency.to(device, torch.float32), wave.to(device, torch.complex64)
        )


@lru_cache(maxsize=16)
@torch.inference_mode(False)
def _banks(
    leds: tuple[int, int], device: torch.device
) -> tuple[int, Tensor, tuple[_Bank, ...]]:
    """Side of a window, its taper, and for each axis the waves along it and across it."""
    cells = [min(one, MOST_CELLS) for one in leds]
    side = 2 * round(max(cells) * _MID_PITCH_PX * 0.75) + 2
    place = torch.arange(side, dtype=torch.float64) + 0.5 - side / 2
    tapers = [torch.exp(-((place / (one * 4.5 * 0.35)) ** 2) / 2) for one in cells]
    low, high = 1 / PITCHES_PX[1], 1 / PITCHES_PX[0]
    slant, banks = _SHEAR * high, []
    for along, across in ((0, 1), (1, 0)):
        steps = [1 / (one * 4.5 * 2.2) for one in (cells[along], cells[across])]
        banks.append(_Bank.of(low, high, steps[0], side, tapers[along], device))
        banks.append(_Bank.of(-slant, slant, steps[1], side, tapers[across], device))
    return (
        side,
        (tapers[1][:, None] * tapers[0]).to(device, torch.float32),
        tuple(banks),
    )


class _Lines(NamedTuple):
    """Spectra of n windows along one axis: at each own frequency (F,) the strongest across it.

    Args:
        power: (n,F) over the mean one, less where it is no peak.
        across: (n,F) int64, which frequency across.
        waves: (P,n,G,F) complex light of P planes over its root of variance.
    """

    power: Tensor
    across: Tensor
    waves: Tensor

    @classmethod
    def of(
        cls,
        planes: Sequence[Tensor],
        bent: Tensor,
        taper: Tensor,
        own: _Bank,
        other: _Bank,
    ) -> "_Lines":
        """Look along x of planes (n,S,S) each; of the last there are those of the windows ``bent`` alone."""
        seen = torch.cat(list(planes))
        seen = seen - (seen * taper).sum((1, 2), keepdim=True) / taper.sum()
        flat = (seen * taper).square().sum((1, 2)) + 4.0 * taper.square().sum()
        # Real pictures by real waves, which come as pairs of real and imaginary parts.
        lines = seen @ torch.view_as_real(own.wave).permute(1, 0, 2).flatten(1)
        pairs = lines.view(*lines.shape[:2], len(own.frequency), 2)
        found = (other.wave @ torch.view_as_complex(pairs)) / flat.sqrt()[:, None, None]
        waves = found.new_zeros(len(planes), len(planes[0]), *found.shape[1:])
        whole = (len(planes) - 1) * len(planes[0])
        waves[:-1], waves[-1, bent] = found[:whole].view_as(waves[:-1]), found[whole:]
        power = torch.view_as_real(waves).square().sum((0, -1))
        power = power.masked_fill(
            other.frequency[:, None].abs() > _SHEAR * own.frequency, 0.0
        )
        power, across = power.max(1)
        # Random bits have most power at low frequencies; a lattice is a peak, and the lowest of all is none.
        beside = nn.functional.pad(power, (1, 1))
        peak = (power >= beside[:, :-2]) & (power >= beside[:, 2:])
        peak[:, 0], power[:, 0] = False, 0.0
        return cls(power.where(peak, _FLANK * power), across, waves)


def lattice_hypotheses(
    pyramid: Pyramid, shape: PanelShape, turned: int = 0
) -> Hypotheses:
    """Find lattices in the windows of most texture, the most periodic first, then those of stretched windows.

    Along each axis a cell's middle lies where grey values are greatest, where they change least or where they
    bend most, by the spectrum that has most power there. Of each level so many windows are ``turned`` by an
    eighth, too: with these lattices of any turn are seen. A few are half as wide, or half as high, again,
    in as many samples: in them a panel seen aslant has nearly equal pitches.
    """
    level, step, centre = proposals(pyramid, shape)
    group = level - step
    rank = (group[:, None] == group).tril().sum(1)
    many = (len(level), turned, _STRETCHED, _STRETCHED)
    chosen = [(rank <= one).nonzero()[:, 0] for one in many]
    views = centre.new_tensor(_VIEWS)
    turn = torch.cat(
        [one.expand(len(few), 2, 2) for one, few in zip(views, chosen, strict=True)]
    )
    level, step, centre = (one[torch.cat(chosen)] for one in (level, step, centre))
    side, taper, banks = _banks((shape.columns, shape.rows), pyramid.levels[0].device)
    place = torch.arange(side, device=centre.device) + 0.5 - side / 2
    at = torch.stack([place.repeat(side), place.repeat_interleave(side)])
    x, y = (centre[..., None] + turn @ at * step[:, None, None]).unbind(1)
    windows = pyramid.read(level, x, y).view(-1, side, side)
    plain = windows - _boxes(windows, (_LOCAL, _LOCAL), torch.add) / _LOCAL**2
    spectra, bent = [], (level == 0).nonzero()[:, 0]
    for axis in (0, 1):
        seen, own = (one.mT if axis else one for one in (windows, plain))
        # Light of LEDs that run into one another bends in their middles, whatever their bits; on halved
        # pictures they do not.
        smooth = _boxes(seen[bent], (3, 1), torch.add) / 3
        change, bend = torch.zeros_like(own), torch.zeros_like(smooth)
        change[..., 1:-1] = (seen[..., 2:] - seen[..., :-2]).abs()
        bend[..., 1:-1] = (
            2 * smooth[..., 1:-1] - smooth[..., 2:] - smooth[..., :-2]
        ).abs()
        banked = banks[2 * axis : 2 * axis + 2]
        spectra.append(
            _Lines.of((own, change, bend), bent, taper.mT if axis else taper, *banked)
        )
    rows, pairs = _alike(
        [one.power for one in spectra], [banks[0].frequency, banks[2].frequency]
    )
    frequency, offset, strength = [], [], []
    for axis, (lines, at) in enumerate(zip(spectra, pairs, strict=True)):
        across = lines.across[rows, at]
        own, other = (
            banks[2 * axis].frequency[at],
            banks[2 * axis + 1].frequency[across],
        )
        frequency.append(torch.stack([other, own] if axis else [own, other], 1))
        # A wave cos(2 pi (f x) + angle) is greatest at f x = -angle / 2 pi: of grey values in the middle of
        # a cell, of differences on its border.
        there = lines.waves[:, rows, across, at]
        strongest = there.abs().argmax(0)
        angle = there.gather(0, strongest[None])[0].angle() + torch.pi * (
            strongest == 1
        )
        offset.append(-angle / (2 * torch.pi))
        strength.append(lines.power[rows, at])
    periodic, ordered = torch.minimum(*strength).sort(descending=True, stable=True)
    ordered = ordered[periodic >= _LEAST_STRENGTH]
    # Apart: else the stretched ones crowd out those that most panels need.
    stretched = rows[ordered] >= sum(map(len, chosen[:2]))
    ordered = torch.cat(
        [ordered[~stretched][: _LATTICES[0]], ordered[stretched][: _LATTICES[1]]]
    )
    basis = torch.linalg.inv(torch.stack(frequency, 1)[ordered].to(torch.float64)).to(
        torch.float32
    )
    middle = (basis @ torch.stack(offset, 1)[ordered, :, None])[..., 0]
    rows = rows[ordered]
    size, turn = step[rows, None], turn[rows]
    basis = turn @ basis
    # Of a lattice turned by more than an eighth the lines down are the rows.
    steep = basis[:, 1, 0] > basis[:, 0, 0]
    basis = torch.where(
        steep[:, None, None], torch.stack([-basis[..., 1], basis[..., 0]], 2), basis
    )
    return Hypotheses(
        level[rows],
        centre[rows] + (turn @ middle[..., None])[..., 0] * size,
        basis * size[..., None],
        torch.minimum(*strength)[ordered],
    )


def _alike(
    powers: list[Tensor], frequencies: list[Tensor]
) -> tuple[Tensor, list[Tensor]]:
    """Choose own frequencies for both axes by powers (n,F): windows (m,), and which along x and y (m,) each.

    Cells are nearly square. Of such pairs the strongest few are taken: random bits may be stronger somewhere
    than the lattice that shows them.
    """
    apart = (frequencies[0][:, None] / frequencies[1]).log().abs()
    both = powers[0][:, :, None] * powers[1][:, None] * (apart < _MOST_OBLONG)
    value, place = both.flatten(1).topk(_PAIRS)
    rows, which = (value > 0).nonzero().unbind(1)
    many, place = len(frequencies[1]), place[rows, which]
    return rows, [place // many, place % many]
