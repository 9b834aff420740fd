"""What speaks for a panel: the network's logit, patterns and levels of cells, their bits, spots of light."""

import math
from dataclasses import replace

import torch
from torch import Tensor

from vocc_torch.receiver.cell_model import (
    ROUNDING_DN2,
    Cells,
    best_places,
    fit_cells,
    randomness,
    read_cells,
)
from vocc_torch.receiver.lattice_search import Pyramid
from vocc_torch.receiver.panel_net import SAMPLES
from vocc_torch.types import PanelShape

SURE_SHARES = (0.95, 0.995)
"""Shares of the picture that round spots explain, between which they say more."""

# Weights of the logit, of what two patterns explain, of what two levels of each cell's brightest spot do, of
# how random bits look, of round spots, of how well light keeps to a lattice and of how unequally many cells
# are bright and dark, and a constant; and the most, or least, of some that counts.
_EVIDENCE = (1.0, 0.8, 0.8, 0.43, 6.9, 3.0, -24.0, -7.0)
_MOST_LOGIT, _MOST_EXPLAINED, _MOST_PARTED, _LEAST_RANDOM = 9.0, 3.0, 5.0, -20.0
_MOST_ALIGNED, _MOST_UNEQUAL = 10.0, 0.125
# LEDs of a large panel; samples along a square one of which finer levels are read, at most; and where two
# patterns explain less than this, spots count for less.
_LARGE_LEDS, _MOST_SAMPLES, _TWO_PATTERNS = 64, 128, 2.0
# How far the light of cells lies from their middles: at least, and where it is of no panel.
_LEAST_OFF_CELLS, _USUAL_OFF_CELLS = 0.03, 0.15


def evidence(clues: Tensor) -> Tensor:
    """Log odds (n,) of panels, from what :func:`clues_of` gives."""
    *weights, constant = _EVIDENCE
    return clues @ clues.new_tensor(weights) + constant


def clues_of(
    scales: Pyramid, quads: Tensor, logit: Tensor, spots: Tensor, shape: PanelShape
) -> Tensor:
    """Measure what tells panels from clutter, of quadrilaterals (n,4,2) px with logits (n,).

    Lattices of clutter that look most like panels are regular: dots, lettering, grilles. The network sees how
    cells look; that their bits follow a rule is seen in the bits. Two patterns need LEDs that look alike; of
    unequal ones, or such as are off their lattice, the brightest spots of cells still have two levels, and of
    points of light most where they are read finely.
    ``spots`` (n,) is the share of the picture that round spots explain; hardly any clutter is so well
    explained, but for lamps of one or of many brightnesses, of which two patterns explain little.

    Returns:
        (n,7): the logit, what two patterns explain, how far two levels part, how random bits look, what round
        spots explain, how well light keeps to a lattice, and the squared share of bright cells less 1/2.
    """
    places = Cells.at(scales, quads, shape)
    cells = best_places(scales, places, shape, 0, by_light=True)
    cells = fit_cells(scales, cells, shape, 0, most_random=0.0)
    random = randomness(cells.bits).clamp(max=0.0)
    explained = cells.score - random
    fine = int(math.log2(max(1.0, _MOST_SAMPLES / SAMPLES / math.sqrt(shape.leds))))
    seen = [_samples(scales, places, shape, one) for one in range(fine + 1)]
    parted = torch.stack([two_levels(one.amax((2, 4))) for one in seen]).amax(0)
    lit = bright_cells(seen[0])[0].float().mean((1, 2))
    low, high = (math.log(1 - one) for one in SURE_SHARES)
    spotted = (low - (1 - spots.clamp(*SURE_SHARES)).log()) / (low - high)
    spotted = spotted * (explained / _TWO_PATTERNS).clamp(0, 1)
    # Where light runs together that of a cell has no middle of its own: how well spots fit tells the same.
    aligned = torch.maximum(
        alignment(seen[0]).clamp(max=_MOST_ALIGNED) / _MOST_ALIGNED, spotted
    )
    # The more LEDs, the more regular look those not half lit; the fewer, the less a perfect lattice is worth.
    many = shape.leds / _LARGE_LEDS
    told = [logit.clamp(max=_MOST_LOGIT), explained.clamp(max=_MOST_EXPLAINED)]
    told += [
        parted.clamp(max=_MOST_PARTED),
        (random * min(1.0, many**-0.5)).clamp(min=_LEAST_RANDOM),
    ]
    told += [
        spotted * min(1.0, many),
        aligned,
        (lit - 0.5).square().clamp(max=_MOST_UNEQUAL),
    ]
    return torch.stack(told, 1)


def _samples(scales: Pyramid, places: Cells, shape: PanelShape, fine: int) -> Tensor:
    """Read cells (n,R,K,C,K) in levels so much finer, in twice as many samples a side for each."""
    level = (places.level - fine).clamp(min=0)
    scale = 2.0 ** (places.level - level).double()[:, None, None]
    samples = SAMPLES << fine
    finer = replace(places, level=level, corners_px=places.corners_px * scale)
    seen = read_cells(scales, finer, shape, samples, 0)
    return seen.view(len(seen), shape.rows, samples, shape.columns, samples)


def two_levels(values: Tensor) -> Tensor:
    """How far values (n,R,C) of cells part in two, (n,): the logarithm of variance between over that within.

    They are split where that is greatest (Otsu 1979). Values that are alike, and a single one, give 0.
    """
    ordered = values.flatten(1).double().sort(1).values
    if ordered.shape[1] < 2:
        return values.new_zeros(len(values))
    between = _between(ordered).amax(1)
    within = (ordered.var(1, correction=0) - between).clamp(min=0)
    return ((between + ROUNDING_DN2) / (within + ROUNDING_DN2)).log().to(values)


def _between(ordered: Tensor) -> Tensor:
    """Give the variance between both parts of rising values (n,N) split after each but the last, (n,N-1)."""
    count = ordered.shape[1]
    low = torch.arange(1, count, device=ordered.device) / count
    below = ordered.cumsum(1) / count
    return (below[:, :-1] - low * below[:, -1:]).square() / (low * (1 - low))


def bright_cells(seen: Tensor) -> tuple[Tensor, Tensor]:
    """Part cells (n,R,K,C,K) by their brightest samples, where :func:`two_levels` does: the bright ones.

    Returns:
        (n,R,C) bool, and (n,1) the limit.
    """
    brightest = seen.amax((2, 4)).double()
    if brightest.shape[1] * brightest.shape[2] < 2:
        return torch.zeros_like(brightest, dtype=torch.bool), brightest.flatten(1)
    ordered = brightest.flatten(1).sort(1).values
    place = _between(ordered).argmax(1, keepdim=True)
    limit = (ordered.gather(1, place) + ordered.gather(1, place + 1)) / 2
    return brightest > limit[..., None], limit


def alignment(seen: Tensor) -> Tensor:
    """How well light of bright cells (n,R,K,C,K) keeps to a lattice: (n,) logarithms, from 0 on.

    What counts is how far the middles of their light lie from those of cells, as a likelihood ratio: normal
    numbers of the spread that is seen, against those of lights anywhere. Corners may be a little off,
    so a shift, a stretch and a perspective, eight numbers, are taken away first: four lamps tell nothing.
    """
    bright, limit = bright_cells(seen)
    count, cells = len(seen), bright.shape[1] * bright.shape[2]
    light = (seen - limit[..., None, None, None]).clamp(min=0)
    at = (torch.arange(seen.shape[2], device=seen.device) + 0.5) / seen.shape[2] - 0.5
    whole = light.sum((2, 4)).clamp(min=1e-9)
    middles = [
        (light.sum(2) * at).sum(3) / whole,
        (light.sum(4) * at[:, None]).sum(2) / whole,
    ]
    v, u = (
        torch.linspace(-1, 1, leds, dtype=torch.float64, device=seen.device)
        for leds in bright.shape[1:]
    )
    u, v = u.expand_as(whole[0]), v[:, None].expand_as(whole[0])
    fields = torch.stack([torch.ones_like(u), u, v, u * v], -1).view(1, cells, 4)
    lit = fields * bright.view(count, cells, 1)
    gram = lit.mT @ fields + 1e-3 * torch.eye(
        4, dtype=torch.float64, device=seen.device
    )
    off = torch.stack(middles, -1).view(count, cells, 2)
    left = (off - fields @ torch.linalg.solve(gram, lit.mT @ off)) * bright.view(
        count, cells, 1
    )
    many = bright.sum((1, 2))
    free = (2 * many - 8).clamp(min=0)
    spread = (left.square().sum((1, 2)) + _LEAST_OFF_CELLS**2 * many) / free.clamp(
        min=1
    )
    told: Tensor = free / 2 * (_USUAL_OFF_CELLS**2 / spread.clamp(min=1e-9)).log()
    return told.clamp(min=0).to(seen)
