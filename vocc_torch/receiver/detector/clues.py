"""What tells a panel from clutter besides the judge: levels of cells, their bits, places of light."""

import math
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor

from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class ClueSettings:
    """Constants of the clues."""

    least_off_cells: float = (
        0.03  # light is seen off a cell's middle by this much, of rounding alone
    )
    usual_off_cells: float = 0.15  # where it is of no panel
    grey_variance: float = 1.0  # of rounding and grain, grey values squared
    draws: int = 256  # of random bits, for what is usual


SETTINGS = ClueSettings()


def two_levels(values: Tensor) -> tuple[Tensor, Tensor]:
    """Part values (n,N) in two where the variance between is greatest (Otsu 1979).

    Returns:
        (n,) the logarithm of the variance between over that within, and (n,) the limit.
    """
    ordered = values.double().sort(1).values
    count = ordered.shape[1]
    low = torch.arange(1, count, device=values.device) / count
    below = ordered.cumsum(1) / count
    between, place = (
        (below[:, :-1] - low * below[:, -1:]).square() / (low * (1 - low))
    ).max(1)
    within = (ordered.var(1, correction=0) - between).clamp(min=0)
    sides = ordered.gather(1, torch.stack([place, place + 1], 1))
    ratio = (
        (between + SETTINGS.grey_variance) / (within + SETTINGS.grey_variance)
    ).log()
    return ratio, sides.mean(1)


def alignment(cells: Tensor, bright: Tensor, limit: Tensor) -> Tensor:
    """Say how well light of bright cells (n,R,K,C,K) keeps to a lattice, (n,) log-likelihood ratios.

    The middles of each bright cell's light are compared with the cell's own middle, as normal numbers of the
    spread that is seen against that of lights anywhere. A shift, a stretch and a perspective are taken away.
    """
    count, samples = len(cells), cells.shape[2]
    light = (cells - limit[:, None, None, None, None]).clamp(min=0).double()
    at = (torch.arange(samples, device=cells.device) + 0.5) / samples - 0.5
    total = light.sum((2, 4)).clamp(min=1e-9)
    middles = (
        torch.stack(
            [(light.sum(2) * at).sum(3), (light.sum(4) * at[:, None]).sum(2)], -1
        )
        / total[..., None]
    )
    v, u = torch.meshgrid(
        *(torch.linspace(-1, 1, leds).double() for leds in bright.shape[1:]),
        indexing="ij",
    )
    fields = torch.stack([torch.ones_like(u), u, v, u * v], -1).view(1, -1, 4)
    chosen = bright.reshape(count, -1, 1).double()
    lit = fields * chosen
    gram = lit.mT @ fields + 1e-3 * torch.eye(4).double()
    off = middles.view(count, -1, 2)
    rest = (off - fields @ torch.linalg.solve(gram, lit.mT @ off)) * chosen
    many = chosen.sum((1, 2))
    free = (2 * many - 8).clamp(min=1)
    spread = (rest.square().sum((1, 2)) + SETTINGS.least_off_cells**2 * many) / free
    ratio: Tensor = (SETTINGS.usual_off_cells**2 / spread.clamp(min=1e-9)).log() / 2
    return ratio


def randomness(bits: Tensor) -> tuple[Tensor, Tensor]:
    """Say how random bits (n,R,C) look: near 0 for random ones, and lower where a rule is.

    Returns:
        (n,) minus the information, nats, that the shares of unlike neighbours hold, and (n,) the logarithm of
        how unlike the lines are over what is usual.
    """
    rule = torch.zeros(len(bits), dtype=torch.float64)
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0)):
        rows, columns = bits.shape[1] - down, bits.shape[2] - abs(right)
        first = bits[:, down:, max(right, 0) : max(right, 0) + columns]
        second = bits[:, :rows, max(-right, 0) : max(-right, 0) + columns]
        share = (first != second).flatten(1).double().mean(1).clamp(1e-6, 1 - 1e-6)
        rule += (
            rows
            * columns
            * (math.log(2) + share * share.log() + (1 - share) * (1 - share).log())
        )
    usual = _usual_unlikeness(bits.shape[1], bits.shape[2])
    lines = [
        ((_unlikeness(one) + 1) / (mean + 1)).clamp(max=1)
        for one, mean in zip((bits, bits.mT), usual, strict=True)
    ]
    return -rule, (lines[0] * lines[1]).log()


def _unlikeness(bits: Tensor) -> Tensor:
    """Sum over rows of the LEDs in which each differs from the likest other row, its opposite, or none."""
    sign = 2 * bits.double() - 1
    columns = bits.shape[2]
    alike = (sign @ sign.mT).abs() - 2 * columns * torch.eye(
        bits.shape[1], device=bits.device
    )
    nearest = torch.maximum(alike.amax(2), sign.sum(2).abs())
    return ((columns - nearest) / 2).sum(1)


@lru_cache(maxsize=64)
def _usual_unlikeness(rows: int, columns: int) -> tuple[float, float]:
    """Give the mean of :func:`_unlikeness` for the rows and for the columns of random bits."""
    draws = (
        torch.rand(
            SETTINGS.draws, rows, columns, generator=torch.Generator().manual_seed(0)
        )
        < 0.5
    )
    return float(_unlikeness(draws).mean()), float(_unlikeness(draws.mT).mean())


def clues_of(patches: Tensor, shape: PanelShape, samples: int) -> Tensor:
    """Measure cells (n,R*K,C*K) of candidates.

    Returns:
        (n,6): how far the levels of whole cells part, and those of their brightest samples, how well light
        keeps to a lattice, how random the bits look in two ways, and how unequal the numbers of bits are.
    """
    cells = patches.view(len(patches), shape.rows, samples, shape.columns, samples)
    means, brightest = cells.mean((2, 4)).flatten(1), cells.amax((2, 4)).flatten(1)
    by_mean, _ = two_levels(means)
    by_peak, limit = two_levels(brightest)
    bright = (brightest > limit[:, None]).view(-1, shape.rows, shape.columns)
    aligned = alignment(cells, bright, limit)
    pairs, lines = randomness(bright)
    share = bright.double().mean((1, 2))
    return torch.stack(
        [by_mean, by_peak, aligned, pairs, lines, (share - 0.5).square()], 1
    )
