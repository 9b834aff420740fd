"""Candidates of the pool's frames, as the networks before give them, and what the next are trained on."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from vocc_torch.receiver.detector import judge as judging
from vocc_torch.receiver.detector import placer as placing
from vocc_torch.receiver.detector.judge import SQUARE, Judge, corners_of
from vocc_torch.receiver.detector.placer import Placer
from vocc_torch.receiver.detector.scout import distinct
from vocc_torch.receiver.resample import corner_cells, map_points
from vocc_torch.studies.train_detector.composition import homography, mapped
from vocc_torch.studies.train_detector.crops import area, ordered, pictures
from vocc_torch.studies.train_detector.pool import Pool
from vocc_torch.studies.train_detector.scout_training import Proposals
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class CandidateSettings:
    """What is a candidate of a panel."""

    near: float = 0.3  # of a side, corners that a network can move to the panel
    clear: float = 0.6  # of a diagonal, centres farther away are of clutter
    batch: int = 2048


SETTINGS = CandidateSettings()


class Found(NamedTuple):
    """Candidates: numbers (n,) of frames, corners (n,4,2) px, and the panel's true corners, zeros without one."""

    frame: Tensor
    quads: Tensor
    truth: Tensor

    def rows(self, chosen: Tensor) -> "Found":
        """Give some of them."""
        return Found(*(part[chosen] for part in self))


def best_of_frames(found: Proposals, most: int) -> Proposals:
    """Take the best candidates of each frame, one of those at nearly the same place."""
    order = found.score.argsort(descending=True, stable=True)
    order = order[found.frame[order].argsort(stable=True)]
    found = found.rows(order)
    parts, start = [order[:0]], 0
    for count in torch.unique_consecutive(found.frame, return_counts=True)[1].tolist():
        rows = slice(start, start + min(count, 4 * most))
        start += count
        chosen = distinct(found.quads[rows], found.score[rows], most)
        parts.append(chosen + rows.start)
    return found.rows(torch.cat(parts))


def judge_all(net: Judge, pool: Pool, found: Proposals, shape: PanelShape) -> Proposals:
    """Judge candidates in pictures of a shape, and move their corners."""
    options, grown = judging.SETTINGS, judging.grown(shape)
    size = options.side_px * grown[0], options.side_px * grown[1]
    square = (corner_cells(SQUARE)[None] + options.margin) * options.samples
    square = square * torch.tensor(grown[::-1])
    parts = [found.rows(slice(0))]
    for rows in found.parts(SETTINGS.batch):
        some = found.rows(rows)
        places = square.to(some.quads).expand_as(some.quads)
        logit, maps = net(pictures(pool, some.frame, some.quads, places, size))
        cut = judging.parts_of(corners_of(maps), shape)
        moved = map_points(some.quads, cut, SQUARE)
        parts.append(some._replace(quads=moved.float(), score=logit))
    return Proposals(*map(torch.cat, zip(*parts, strict=True)))


def place_all(
    net: Placer, pool: Pool, found: Proposals, shape: PanelShape
) -> Proposals:
    """Place candidates of one shape, and move their corners."""
    parts = [found.rows(slice(0))]
    for rows in found.parts(SETTINGS.batch):
        some = found.rows(rows)
        seen = read_patches(pool, some.frame, some.quads, shape, None)
        logit, moves = net(seen, shape)
        cells = corner_cells(shape).to(some.quads) + moves
        moved = map_points(some.quads, cells.double(), shape).float()
        parts.append(some._replace(quads=moved, score=logit))
    return Proposals(*map(torch.cat, zip(*parts, strict=True)))


def read_patches(
    pool: Pool, frame: Tensor, quads: Tensor, shape: PanelShape, cells: Tensor | None
) -> Tensor:
    """Read the placer's patches, in which corners (B,4,2) px lie at places in cells, the panel's own if None."""
    options = placing.SETTINGS
    if cells is None:
        cells = corner_cells(shape).to(quads).expand_as(quads)
    places = (cells + options.margin) * options.samples
    high, wide = (
        (leds + 2 * options.margin) * options.samples
        for leds in (shape.rows, shape.columns)
    )
    return pictures(pool, frame, quads, places, (high, wide))


def with_truth(pool: Pool, found: Proposals) -> tuple[Found, Found]:
    """Part candidates into those near a panel, and those of clutter; what is between is left out."""
    truth = ordered(pool.corners_px[found.frame].float())
    quads = found.quads.float()
    usable = (area(quads) > 1) & quads.isfinite().flatten(1).all(1)
    matrix = homography(quads, unit(quads))
    off = (mapped(matrix, truth.mT).mT - unit(quads)).abs().amax((1, 2))
    readable = pool.readable[found.frame]
    apart = (quads.mean(1) - truth.mean(1)).norm(dim=1)
    size = (truth[:, 0] - truth[:, 2]).norm(dim=1)
    size = torch.maximum(size, (quads[:, 0] - quads[:, 2]).norm(dim=1))
    empty = pool.shapes[found.frame, 0] == 0
    panel = Found(found.frame, quads, truth).rows(
        usable & readable & (off < SETTINGS.near)
    )
    clutter = usable & (empty | (readable & (apart > SETTINGS.clear * size)))
    none = torch.zeros_like(truth)
    return panel, Found(found.frame, quads, none).rows(clutter)


def unit(like: Tensor) -> Tensor:
    """Give the corners (1,4,2) of a square of side 1, expanded."""
    return corner_cells(PanelShape(1, 1)).to(like)[None].expand_as(like)
