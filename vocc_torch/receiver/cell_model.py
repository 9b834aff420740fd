"""A panel's picture as cells that each show On or Off: the places where that explains most, and how much.

What a cell shows is a pattern of its own bit, whatever it looks like, with light of its neighbours on the
near sides; patterns are alike from left and right, and from above and below. Nothing is said of what lies
around the panel, nor which of both is the brighter.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor, nn

from vocc_torch.receiver.lattice_search import PITCHES_PX, Pyramid
from vocc_torch.receiver.resample import (
    cell_homography,
    cell_size_px,
    corner_cells,
    map_points,
)
from vocc_torch.types import Batched, PanelShape

# Samples along a cell's side, where places are compared and where they are fitted.
_COARSE, _FINE = 2, 4
# Of the variance of a picture, what noise of rounding explains.
ROUNDING_DN2 = 1.0
# What the six kinds of pairs of random bits tell by chance, nats; and the fit, a logarithm, beyond which a
# better one says no more.
_MOST_USUAL, _BEST_FIT = 3.0, 4.0
# Changes along the line of cells around a panel that cost nothing, and what each more costs.
_FREE_CHANGES, _CHANGE_COST = 2, 0.5
# How much light that is unlike any LED counts against that of On LEDs, at the lattice's edge.
_UNLIKE_WEIGHT = 3.0
# Expected standard deviations, cells, of the fields 1, u, v and uv of a step in x and in y.
_EXPECTED = (0.5, 0.4, 0.4, 0.1)
_MOST_STEP_CELLS = 0.4


@dataclass(frozen=True, slots=True)
class Cells(Batched):
    """Panels as they may lie in a level of the pyramid, n of them.

    Args:
        level: (n,) int64.
        corners_px: (n,4,2) float64, px of the level, clockwise from the top left.
        bits: (n,R,C) bool.
        score: (n,) logarithm of what bits explain of the picture over what they leave, for its transitions.
    """

    level: Tensor
    corners_px: Tensor
    bits: Tensor
    score: Tensor

    @classmethod
    def at(cls, pyramid: Pyramid, corners_px: Tensor, shape: PanelShape) -> "Cells":
        """Lay panels at corners (n,4,2) px of the one frame, in the levels that suit their pitches."""
        pitch = torch.stack(cell_size_px(corners_px, shape)).prod(0).sqrt()
        most = len(pyramid.levels) - 1
        level = (
            (pitch / PITCHES_PX[0])
            .clamp(min=1e-3)
            .log2()
            .floor()
            .nan_to_num()
            .clamp(0, most)
            .long()
        )
        bits = level.new_zeros(len(level), shape.rows, shape.columns, dtype=torch.bool)
        corners_px = corners_px.double() / 2.0 ** level.double()[:, None, None]
        return cls(level, corners_px, bits, torch.zeros_like(pitch))


def read_cells(
    pyramid: Pyramid,
    cells: Cells,
    shape: PanelShape,
    samples: int,
    margin: int | tuple[int, int],
) -> Tensor:
    """Read K x K samples a cell, (n,(R+2m)K,(C+2m)K); ``margin`` may be one down and one right."""
    margins = (margin, margin) if isinstance(margin, int) else margin
    rows, columns = (
        (torch.arange((leds + 2 * one) * samples, device=cells.level.device) + 0.5)
        / samples
        - one
        for leds, one in zip((shape.rows, shape.columns), margins, strict=True)
    )
    h = cell_homography(cells.corners_px, shape).to(torch.float32)[..., None, None]
    u, v = columns[None, None, :], rows[None, :, None]
    scale = h[:, 2, 0] * u + h[:, 2, 1] * v + h[:, 2, 2]
    x, y = (
        (h[:, axis, 0] * u + h[:, axis, 1] * v + h[:, axis, 2]) / scale
        for axis in (0, 1)
    )
    x, y = (one.nan_to_num().clamp(-1e6, 1e6).flatten(1) for one in (x, y))
    return pyramid.read(cells.level, x, y).view(-1, len(rows), len(columns))


def randomness(bits: Tensor) -> Tensor:
    """How random bits look, (...,R,C) to (...) logarithms: about 0 for random ones, low where a rule is.

    - Pairs of LEDs beside, below, on both diagonals and two apart: half of random ones differ, and what is
      told by their share is half a nat on the average. Strokes of letters differ less from what is beside.
    - Lines: a row or a column of random bits is like no other line, nor like its opposite, nor constant. In
      a grating, in lettering and in lamps in rows they are.
    """
    rule = bits.new_zeros(bits.shape[:-2], dtype=torch.float32)
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0)):
        rows, columns = bits.shape[-2] - down, bits.shape[-1] - abs(right)
        if rows < 1 or columns < 1:
            continue
        one = bits[..., down:, max(right, 0) : max(right, 0) + columns]
        other = bits[..., :rows, max(-right, 0) : max(-right, 0) + columns]
        share = ((one != other).flatten(-2).float().mean(-1)).clamp(1e-6, 1 - 1e-6)
        bits_told = math.log(2) + share * share.log() + (1 - share) * (1 - share).log()
        rule = rule + rows * columns * bits_told
    own = [_unlikeness(bits), _unlikeness(bits.mT)]
    usual = _usual_unlikeness(bits.shape[-2], bits.shape[-1])
    unlike = [
        ((one + 1) / (mean + 1)).clamp(max=1)
        for one, mean in zip(own, usual, strict=True)
    ]
    return (_MOST_USUAL - rule) / 2 + 2 * (unlike[0] * unlike[1]).log()


def _unlikeness(bits: Tensor) -> Tensor:
    """Sum over rows of the LEDs in which each differs from the likest other row, its opposite, or none."""
    rows, columns = bits.shape[-2:]
    sign = 2 * bits.float() - 1
    alike = (sign @ sign.mT).abs() - 2 * columns * torch.eye(rows, device=bits.device)
    alike = torch.maximum(alike.amax(-1), sign.sum(-1).abs())
    return ((columns - alike) / 2).sum(-1)


@lru_cache(maxsize=64)
def _usual_unlikeness(rows: int, columns: int) -> tuple[float, float]:
    """Mean of :func:`_unlikeness` for rows and for columns of random bits, from 256 draws of one key."""
    draws = (
        torch.rand(256, rows, columns, generator=torch.Generator().manual_seed(0)) < 0.5
    )
    return float(_unlikeness(draws).mean()), float(_unlikeness(draws.mT).mean())


def best_places(
    pyramid: Pyramid,
    start: Cells,
    shape: PanelShape,
    reach: int,
    samples: int = _COARSE,
    by_light: bool = False,
) -> Cells:
    """Move panels by up to ``reach`` whole cells to where two patterns explain most; set bits and scores.

    A lattice goes on beyond the panel's edge. ``by_light`` takes the place with most light of On LEDs, less
    what is unlike any LED: how random bits look elsewhere does not count.
    """
    high, wide = shape.rows, shape.columns
    picture = read_cells(pyramid, start, shape, samples, reach)
    n, k = len(picture), samples * samples
    picture = picture.view(n, high + 2 * reach, samples, wide + 2 * reach, samples)
    picture = picture.permute(0, 1, 3, 2, 4).reshape(
        n, high + 2 * reach, wide + 2 * reach, k
    )
    span = 2 * reach + 1
    best: list[tuple[Tensor, ...]] = []
    for down in range(span):
        # (n,shifts along the row,R,C,K*K)
        row = picture[:, down : down + high].unfold(2, wide, 1).permute(0, 2, 1, 4, 3)
        middle = row.mean(-1)
        level = middle.mean((2, 3), keepdim=True)
        for _ in range(2):
            on = (middle > level).float()
            lit = on.sum((2, 3), keepdim=True).clamp(min=1)
            dark = (high * wide - lit).clamp(min=1)
            bright = (middle * on).sum((2, 3), keepdim=True) / lit
            level = (bright + (middle * (1 - on)).sum((2, 3), keepdim=True) / dark) / 2
        on = (middle > level).float()
        lit = on.sum((2, 3)).clamp(min=1)
        flat, weight = row.flatten(2, 3), on.flatten(2)[..., None]
        total = flat.sum(2)
        up = (flat * weight).sum(2)
        mean_on, mean_off = (
            up / lit[..., None],
            (total - up) / (high * wide - lit).clamp(min=1)[..., None],
        )
        square = flat.square().sum((2, 3))
        left = (
            square
            - lit * mean_on.square().sum(2)
            - (high * wide - lit) * mean_off.square().sum(2)
        )
        energy = lit * (mean_on - mean_off).square().sum(2)
        noise = ROUNDING_DN2 * high * wide * k
        if by_light:
            merit = energy - _UNLIKE_WEIGHT * left
        else:
            merit = ((energy + noise) / (left + noise)).log().clamp(
                max=_BEST_FIT
            ) + randomness(on)
        merit, place = merit.max(1)
        bits = (
            on.gather(1, place[:, None, None, None].expand(-1, 1, high, wide))[:, 0] > 0
        )
        best.append((merit, place - reach, torch.full_like(place, down - reach), bits))
    merits = torch.stack([one[0] for one in best], 1)
    merit, line = merits.max(1)
    rows = torch.arange(n, device=merit.device)
    shift = torch.stack(
        [torch.stack([one[axis] for one in best], 1)[rows, line] for axis in (1, 2)], 1
    )
    bits = torch.stack([one[3] for one in best], 1)[rows, line]
    cells = corner_cells(shape).to(shift.device) + shift[:, None]
    corners = map_points(start.corners_px, cells, shape)
    return Cells(start.level, corners, bits, merit)


def edge_changes(pyramid: Pyramid, cells: Cells, picture: Tensor) -> Tensor:
    """Count changes of On and Off along the line of cells around panels, (n,), seen as (n,(R+2)K,(C+2)K).

    A panel ends there: what is around it is of one level along a side, or of few. Letters and other
    lattices go on. Cells outside the picture do not count.
    """
    high, wide = cells.bits.shape[1:]
    middle = nn.functional.avg_pool2d(picture[:, None], _FINE)[:, 0]
    inner, on = middle[:, 1:-1, 1:-1], cells.bits.float()
    bright = (inner * on).sum((1, 2)) / on.sum((1, 2)).clamp(min=1)
    dark = (inner * (1 - on)).sum((1, 2)) / (1 - on).sum((1, 2)).clamp(min=1)
    row, column = (
        torch.arange(high + 2, device=on.device),
        torch.arange(wide + 2, device=on.device),
    )
    y = torch.cat([0 * column, row[1:], 0 * column[1:] + high + 1, row[1:-1].flip(0)])
    x = torch.cat([column, 0 * row[1:] + wide + 1, column[:-1].flip(0), 0 * row[1:-1]])
    lit = middle[:, y, x] > ((bright + dark) / 2)[:, None]
    places = torch.stack([x, y], 1).to(torch.float64).expand(len(on), -1, 2) - 0.5
    at = map_points(cells.corners_px, places, PanelShape(high, wide))
    inside = ((at >= 0) & (at <= pyramid.size_px(cells.level)[:, None])).all(2)
    return ((lit != lit.roll(1, 1)) & inside & inside.roll(1, 1)).sum(1)


@lru_cache(maxsize=16)
@torch.inference_mode(False)
def _fields(shape: PanelShape, device: torch.device) -> tuple[Tensor, Tensor]:
    """Fields 1, u, v and uv, -1 to 1 over the panel, at its samples (4,RK,CK), and at its corners (4,4)."""
    axes = [
        (torch.arange(leds * _FINE) + 0.5) * 2 / (leds * _FINE) - 1
        for leds in (shape.columns, shape.rows)
    ]
    u, v = axes[0].expand(len(axes[1]), -1), axes[1][:, None].expand(-1, len(axes[0]))
    corner = 2 * corner_cells(shape) / torch.tensor([shape.columns, shape.rows]) - 1
    cu, cv = corner.unbind(1)
    inside = torch.stack([torch.ones_like(u), u, v, u * v])
    return inside.to(device), torch.stack([torch.ones_like(cu), cu, cv, cu * cv]).to(
        device
    )


def _quadrants(plane: Tensor) -> Tensor:
    """Fold (n,...,RK,CK) samples: (n,...,4,R,C,K/2*K/2), of each quadrant of a cell from its middle."""
    lead, half = plane.shape[:-2], _FINE // 2
    rows, columns = plane.shape[-2] // _FINE, plane.shape[-1] // _FINE
    cells = plane.reshape(*lead, rows, _FINE, columns, _FINE).transpose(-3, -2)
    up, low = cells[..., :half, :].flip(-2), cells[..., half:, :]
    parts = [
        part
        for line in (up, low)
        for part in (line[..., :half].flip(-1), line[..., half:])
    ]
    return torch.stack([part.flatten(-2) for part in parts], len(lead))


def _regressors(bits: Tensor) -> Tensor:
    """What a sample's light depends on, (n,4,R,C,7): 1, its bit, the near ones, whether they are outside."""
    own = nn.functional.pad(bits.float(), (1, 1, 1, 1))
    inside = nn.functional.pad(torch.ones_like(bits, dtype=torch.float32), (1, 1, 1, 1))
    rows, columns = bits.shape[1:]

    def at(plane: Tensor, down: int, right: int) -> Tensor:
        return plane[:, 1 + down : 1 + down + rows, 1 + right : 1 + right + columns]

    parts = []
    for down in (-1, 1):
        for right in (-1, 1):
            near = [
                at(own, 0, 0),
                at(own, 0, right),
                at(own, down, 0),
                at(own, down, right),
            ]
            beyond = [1 - at(inside, 0, right), 1 - at(inside, down, 0)]
            parts.append(torch.stack([torch.ones_like(near[0]), *near, *beyond], -1))
    return torch.stack(parts, 1)


def fit_cells(
    pyramid: Pyramid,
    start: Cells,
    shape: PanelShape,
    steps: int = 6,
    most_random: float = math.inf,
) -> Cells:
    """Move corners freely, by Gauss-Newton steps, to where the bits explain most, and score the best of them.

    ``most_random`` is the most that random bits speak for a place: they can draw the fit to another.

    The patterns are eliminated from each step (variable projection, Golub and Pereyra 1973), and bits are
    decided anew before it.
    """
    inside, corner = _fields(shape, start.level.device)
    best, now, closest = start, start, start.score
    for number in range(steps + 1):
        picture = read_cells(pyramid, now, shape, _FINE, 1)
        grey = picture[:, _FINE:-_FINE, _FINE:-_FINE]
        n = len(grey)
        planes = grey[:, None]
        if number < steps:
            slope_u = (
                picture[:, _FINE:-_FINE, _FINE + 1 : 1 - _FINE]
                - picture[:, _FINE:-_FINE, _FINE - 1 : -1 - _FINE]
            ) * (_FINE / 2)
            slope_v = (
                picture[:, _FINE + 1 : 1 - _FINE, _FINE:-_FINE]
                - picture[:, _FINE - 1 : -1 - _FINE, _FINE:-_FINE]
            ) * (_FINE / 2)
            planes = torch.cat(
                [planes, slope_u[:, None] * inside, slope_v[:, None] * inside], 1
            )
        # (n,4RC,K/2*K/2), and nine times as many with slopes
        folded = (
            _quadrants(planes).permute(0, 2, 3, 4, 1, 5).reshape(n, 4 * shape.leds, -1)
        )
        bits = now.bits
        for _ in range(2):
            a = _regressors(bits).reshape(n, -1, 7)
            gram = a.mT @ a
            gram = gram + torch.eye(7, device=gram.device) * 1e-3 * shape.leds
            weights = torch.linalg.solve(gram, a.mT @ folded)
            quarter = folded.shape[2] // planes.shape[1]
            own = (a[..., :1] * 0 + folded[..., :quarter]) - a @ weights[..., :quarter]
            # A bit is turned where its own cell is then explained better.
            gain = weights[:, 1:2, :quarter]
            sign = (1 - 2 * a[..., 1:2]) * gain
            change = (
                ((own - sign).square() - own.square())
                .sum(2)
                .view(n, 4, shape.rows, shape.columns)
                .sum(1)
            )
            bits = bits ^ (change < 0)
        a = _regressors(bits).reshape(n, -1, 7)
        gram = a.mT @ a + torch.eye(7, device=a.device) * 1e-3 * shape.leds
        rest = folded - a @ torch.linalg.solve(gram, a.mT @ folded)
        rest = rest.view(n, -1, planes.shape[1], quarter)
        left, slopes = (
            rest[:, :, 0].flatten(1),
            rest[:, :, 1:].permute(0, 2, 1, 3).flatten(2),
        )
        energy = left.square().sum(1)
        value = folded[..., :quarter]
        spread = (value - value.mean(1, keepdim=True)).square().sum((1, 2))
        noise = ROUNDING_DN2 * left.shape[1]
        # What the On LEDs add to a panel of Off ones; a line of the dark around it in its place adds nothing.
        light = (weights[:, 1, :quarter].square().sum(1)) * 4 * bits.sum((1, 2))
        fit = (torch.minimum(light, 2 * spread) + noise).log() - (energy + noise).log()
        now = Cells(now.level, now.corners_px, bits, fit)
        beyond = (edge_changes(pyramid, now, picture) - _FREE_CHANGES).clamp(min=0)
        score = (
            fit.clamp(max=_BEST_FIT)
            + randomness(bits).clamp(max=most_random)
            - _CHANGE_COST * beyond
        )
        now = Cells(now.level, now.corners_px, bits, score)
        if number == 0:
            best, closest = now[torch.arange(n, device=score.device)], fit
        else:
            # Beyond the best fit that counts scores are alike: then the closer fit tells where corners are.
            better = (score > best.score) | ((score == best.score) & (fit > closest))
            best.put(better, now[better])
            closest = torch.where(better, fit, closest)
        if number == steps:
            break
        curve = slopes @ slopes.mT
        variance = (energy / left.shape[1] + ROUNDING_DN2)[:, None]
        expected = torch.tensor(_EXPECTED * 2, device=curve.device)
        curve = curve + torch.diag_embed(variance / expected**2)
        step = -torch.linalg.solve(curve, (slopes @ left[..., None])[..., 0])
        step = step.nan_to_num() * (
            _MOST_STEP_CELLS
            / step.abs().amax(1, keepdim=True).clamp(min=_MOST_STEP_CELLS)
        )
        moves = torch.stack(
            [step[:, :4] @ corner.float(), step[:, 4:] @ corner.float()], 2
        ).to(torch.float64)
        corners = map_points(
            now.corners_px, corner_cells(shape).to(moves.device) + moves, shape
        )
        now = Cells(now.level, corners, bits, score)
    return best
