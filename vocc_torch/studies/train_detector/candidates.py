"""Candidates of the pool's frames: what one network finds, and what the next one is trained on."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from vocc_torch.receiver.detector import scout
from vocc_torch.studies.train_detector.geometry import (
    homography,
    mapped,
    ordered,
    signed_area,
    unit,
)
from vocc_torch.studies.train_detector.pool import Pool


@dataclass(frozen=True)
class CandidateSettings:
    """Criteria for a candidate."""

    of_level: int = 24  # proposals of the scout on each level of a frame
    looked_through: int = 4  # times as many proposals as are chosen
    near: float = 0.3  # of a side, corners that a network can move to the panel
    clear: float = 0.6  # of a diagonal, centres farther away are of clutter
    batch: int = 2048
    pixels: int = 1 << 21  # of a batch of levels


SETTINGS = CandidateSettings()


class Found(NamedTuple):
    """Candidates of frames.

    Args:
        frame: (n,) numbers of frames.
        level: (n,) of the pyramid, where the scout found them.
        quads: (n,4,2) corners, px of the frame.
        score: (n,) logits.
        truth: (n,4,2) the panel's true corners, zeros without one.
    """

    frame: Tensor
    level: Tensor
    quads: Tensor
    score: Tensor
    truth: Tensor

    def rows(self, chosen: Tensor | slice) -> "Found":
        """Give some of them."""
        return Found(*(part[chosen] for part in self))

    def parts(self) -> list["Found"]:
        """Part them into batches."""
        starts = range(0, len(self.frame), SETTINGS.batch)
        return [self.rows(slice(start, start + SETTINGS.batch)) for start in starts]


def joined(parts: Sequence[Found]) -> Found:
    """Put candidates together."""
    return Found(*map(torch.cat, zip(*parts, strict=True)))


def proposals(net: scout.Scout, pool: Pool, frames: Tensor) -> Found:
    """Take the scout's best places of each level of frames."""
    parts = []
    for level, (high, wide) in enumerate(pool.sizes.tolist()):
        high, wide = high // 16 * 16, wide // 16 * 16
        if not min(high, wide):
            break
        for some in torch.split(frames, max(1, SETTINGS.pixels // (high * wide))):
            grey = pool.levels(level, some)[:, None, :high, :wide]
            outputs = net(grey)
            flat = scout.summits(outputs[:, : scout.SCORES].amax(1)).flatten(1)
            values, order = flat.topk(min(SETTINGS.of_level, flat.shape[1]))
            picture = torch.arange(len(some), device=order.device)[:, None]
            order = (order + picture * flat.shape[1])[values > -torch.inf]
            peaks = scout.peaks_at(outputs, order, flat.flatten())
            quads = peaks.quads * 2.0**level
            numbers = some[peaks.picture], torch.full_like(peaks.picture, level)
            truth = torch.zeros_like(quads)
            parts.append(Found(*numbers, quads, peaks.score, truth))
    return joined(parts)


def best_of_frames(found: Found, most: int) -> Found:
    """Take the best candidates of each frame, at most one for each place."""
    found = found.rows(found.score.argsort(descending=True, stable=True))
    found = found.rows(found.frame.argsort(stable=True))
    # A table (F,M) of rows, a frame a line, the best first.
    _, line, counts = torch.unique_consecutive(found.frame, True, True)
    column = torch.arange(len(line), device=line.device)
    column -= (counts.cumsum(0) - counts)[line]
    deep = (column < SETTINGS.looked_through * most).nonzero()[:, 0]
    table = line.new_full((len(counts), SETTINGS.looked_through * most), -1)
    table[line[deep], column[deep]] = deep
    same, left = scout.same_place(found.quads[table]), table >= 0
    chosen = torch.zeros_like(left)
    lines = torch.arange(len(table), device=table.device)
    for _ in range(most):
        first = left.int().argmax(1)
        chosen[lines, first] |= left[lines, first]
        left &= ~same[lines, first]
    return found.rows(table[chosen])


def with_truth(pool: Pool, found: Found) -> tuple[Found, Found]:
    """Split candidates into panels and clutter; candidates in between are left out."""
    truth = ordered(pool.corners_px[found.frame].float())
    quads = found.quads
    square = unit(quads)
    off = (mapped(homography(quads, square), truth.mT).mT - square).abs()
    near = off.amax((1, 2)) < SETTINGS.near
    usable = signed_area(quads).abs() > 1
    readable = pool.readable[found.frame]
    apart = (quads.mean(1) - truth.mean(1)).norm(dim=1)
    sizes = [(corners[:, 0] - corners[:, 2]).norm(dim=1) for corners in (truth, quads)]
    far = apart > SETTINGS.clear * torch.maximum(*sizes)
    empty = pool.shapes[found.frame, 0] == 0
    panel = found._replace(truth=truth).rows(usable & readable & near)
    return panel, found.rows(usable & (empty | (readable & far)))
