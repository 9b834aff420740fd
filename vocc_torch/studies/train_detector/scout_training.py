"""Training of the scout, on crops with and without panels."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.detector import scout
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.studies.train_detector.composition import (
    Draws,
    finished,
    pixels,
    poses,
    with_panels,
)
from vocc_torch.studies.train_detector.crops import empty_crops, ordered, views
from vocc_torch.studies.train_detector.pool import Pool


@dataclass(frozen=True)
class ScoutTraining:
    """Settings of the training."""

    crop_px: int = 128
    # Crops of a batch of 72.
    composed: int = 20  # with a panel that is laid into a picture
    rendered: int = 18  # with a rendered panel
    empty: int = 10  # without a panel
    mined: int = 24  # that the scout took for panels
    least_pitch_px: float = 1.8  # of LEDs that the scout is to find
    most_pitch_px: float = 4.6  # the next level shows larger ones
    most_side_px: float = 110.0  # of a panel in a crop
    blur_px: tuple[float, float] = (0.3, 1.1)
    soft_px: float = 0.45  # of LEDs' edges
    off_px: float = 45.0  # of a panel from a crop's middle, at most
    near_px: float = 6.0  # outputs so near the centre are to find the panel
    spare_share: float = 0.45  # of a side, within which others may
    corner_weight: float = 12.0
    small_px: float = 30.0  # diagonal of panels whose corners' errors count fully
    corner_beta: float = 0.05
    mined_of_level: int = 24
    mined_score: float = -4.0
    mined_batch: int = 32  # frames
    small_share: float = 0.35  # of rendered panels
    alike: float = 1.2  # ratio to a limit of sizes, within which panels may be of both
    other_weight: float = 0.5  # of scores for other sizes where a panel is


SETTINGS = ScoutTraining()


class Crops(NamedTuple):
    """Crops (B,1,S,S), corners (B,4,2) px in the crop, and rows and columns (B,2), 0 without a panel."""

    grey: Tensor
    quads: Tensor
    shapes: Tensor


class Proposals(NamedTuple):
    """Candidates of frames: numbers (n,) of frames and levels, corners (n,4,2) px of the frame, scores (n,)."""

    frame: Tensor
    level: Tensor
    quads: Tensor
    score: Tensor

    def rows(self, chosen: Tensor | slice) -> "Proposals":
        """Give some of them."""
        return Proposals(*(part[chosen] for part in self))

    def parts(self, count: int) -> list[slice]:
        """Part them."""
        starts = range(0, len(self.frame), count)
        return [slice(start, start + count) for start in starts]


def proposals(net: scout.Scout, pool: Pool, frames: Tensor) -> Proposals:
    """Take the best places of each level of frames."""
    parts = []
    for number, (high, wide) in enumerate(pool.sizes.tolist()):
        high, wide = high // 16 * 16, wide // 16 * 16
        if not min(high, wide):
            break
        for some in torch.split(frames, SETTINGS.mined_batch):
            grey = torch.stack([pool.level(number, one) for one in some.tolist()])
            outputs = net(grey[:, None, :high, :wide])
            score = outputs[:, : scout.SCORES].amax(1)
            near = functional.max_pool2d(score, scout.SETTINGS.peak_cells, 1, 1)
            score = score.masked_fill(score < near, -torch.inf).flatten(1)
            values, places = score.topk(min(SETTINGS.mined_of_level, score.shape[1]), 1)
            picture = torch.arange(len(some), device=frames.device)
            picture = picture[:, None].expand_as(places).flatten()
            row, column = (
                places.flatten() // (wide // 8),
                places.flatten() % (wide // 8),
            )
            quads = scout.quads_of(
                outputs[picture, :, row, column], torch.stack([column, row], 1)
            )
            level = torch.full_like(picture, number)
            values = values.flatten()
            found = Proposals(some[picture], level, quads * 2.0**number, values)
            parts.append(found.rows(values.isfinite()))
    return Proposals(*map(torch.cat, zip(*parts, strict=True)))


class CropSampler:
    """Draws crops.

    Args:
        pool: what they are cut from.
        scale: of the batch, whose usual size is 72.
    """

    def __init__(self, pool: Pool, scale: int = 1) -> None:
        self.pool, self.scale = pool, scale
        levels = torch.arange(len(pool.sizes), device=pool.buffer.device)
        pitch = pool.pitch_px[:, None] / 2.0**levels
        seen = (pitch >= SETTINGS.least_pitch_px) & (pitch <= SETTINGS.most_pitch_px)
        self.panels = (seen & pool.readable[:, None]).nonzero()
        # A share of small panels, and of the others.
        small = pool.shapes[self.panels[:, 0]].prod(1) < scout.SIZES[0] ** 2
        share = SETTINGS.small_share
        counts = small.sum(), (~small).sum()
        self.share = torch.where(small, share / counts[0], (1 - share) / counts[1])
        self.mined: Proposals | None = None

    def batch(self, generator: torch.Generator) -> Crops:
        """Draw a batch of crops."""
        greys, quads, shapes = [], [], []
        for part in (self.composed, self.rendered):
            grey, corners, sides = part(generator)
            greys.append(grey)
            quads.append(ordered(corners))
            shapes.append(sides.float())
        found = sum(map(len, greys))
        empty = Draws(generator, self.scale * SETTINGS.empty)
        crops = empty_crops(self.pool, empty, SETTINGS.crop_px)
        greys.append(finished(crops, empty, edges=False))
        if self.mined is not None and len(self.mined.frame):
            greys.append(self.mined_crops(generator))
        grey = torch.cat(greys)
        none = torch.zeros(len(grey) - found, 4, 2, device=grey.device)
        return Crops(
            grey[:, None], torch.cat([*quads, none]), torch.cat([*shapes, none[:, 0]])
        )

    def composed(self, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """Lay panels into pictures."""
        options, draws = SETTINGS, Draws(generator, self.scale * SETTINGS.composed)
        side, shapes = options.crop_px, draws.shapes()
        pitch = draws.geometric(options.least_pitch_px, options.most_pitch_px)
        pitch = torch.minimum(pitch, options.most_side_px / shapes.amax(1))
        middle = draws.uniform(-1, 1, 2) * options.off_px * 0.75 + side / 2
        quads = poses(draws, shapes, pitch, middle)
        behind = empty_crops(self.pool, draws, side)
        shown = with_panels(behind, quads, shapes, draws, options.soft_px)
        return finished(shown, draws, options.blur_px, edges=False), quads, shapes

    def rendered(self, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """Cut crops with rendered panels."""
        draws = Draws(generator, self.scale * SETTINGS.rendered)
        frame, level = self.panels[draws.chosen(self.share)].unbind(1)
        corners = self.pool.corners_px[frame].float()
        at = self.about(draws, corners.mean(1), level)
        cut = views(draws, frame, level, at, SETTINGS.crop_px)
        return (
            finished(cut.read(self.pool), draws, edges=False),
            cut.seen(corners),
            self.pool.shapes[frame],
        )

    def mined_crops(self, generator: torch.Generator) -> Tensor:
        """Cut crops that the scout took for panels."""
        assert self.mined is not None
        draws = Draws(generator, self.scale * SETTINGS.mined)
        chosen = self.mined.rows(draws.below(len(self.mined.frame)))
        at = self.about(draws, chosen.quads.mean(1), chosen.level)
        cut = views(draws, chosen.frame, chosen.level, at, SETTINGS.crop_px)
        return finished(cut.read(self.pool), draws, edges=False)

    def about(self, draws: Draws, middle: Tensor, level: Tensor) -> Tensor:
        """Move places (B,2) px of frames by whole pixels of their level."""
        unit = 2.0 ** level[:, None]
        off = draws.uniform(-SETTINGS.off_px, SETTINGS.off_px, 2)
        return ((middle / unit + off).round() * unit).float()

    def mine(self, networks: Networks, frames: Tensor) -> None:
        """Find places in frames without a panel that the scout takes for one."""
        empty = frames[self.pool.shapes[frames, 0] == 0]
        found = proposals(networks.scout, self.pool, empty)
        self.mined = found.rows(found.score > SETTINGS.mined_score)

    def loss(self, net: scout.Scout, generator: torch.Generator) -> Tensor:
        """Give the loss of a batch."""
        crops = self.batch(generator)
        return scout_loss(net(crops.grey), crops)


def sizes_of(shapes: Tensor) -> tuple[Tensor, Tensor]:
    """Say of the sizes of panels (B,2) which score is theirs, and which are surely not, (B,3,1,1) bool each."""
    side = shapes.prod(1, keepdim=True).sqrt().clamp(min=1e-3)
    limits = side.new_tensor([0.0, *scout.SIZES, math.inf])
    least, most, alike = limits[:-1], limits[1:], SETTINGS.alike
    own = (side >= least) & (side < most)
    others = (side * alike < least) | (side >= most * alike)
    return own[..., None, None], others[..., None, None]


def scout_loss(outputs: Tensor, crops: Crops) -> Tensor:
    """Give the focal loss of scores and the distance of corners where a panel is."""
    high, wide = outputs.shape[2:]
    stride, device = scout.SETTINGS.stride_px, outputs.device
    places = pixels(high, wide, device)[0].mT.view(high, wide, 2)
    centre = crops.quads.mean(1)[:, None, None]
    apart = (places * stride - centre).norm(dim=3)
    size = (crops.quads[:, 0] - crops.quads[:, 2]).norm(dim=1)[:, None, None]
    panel = (crops.shapes[:, 0] > 0)[:, None, None]
    spare = (apart < SETTINGS.spare_share * size) & panel
    nearest = apart <= apart.flatten(1).amin(1)[:, None, None].clamp(min=1e-3)
    inside = ((centre > 0) & (centre < high * stride)).all(3)
    near = (apart < SETTINGS.near_px) | (nearest & (apart < stride))
    there = panel & inside & near
    own, others = sizes_of(crops.shapes)
    logit = outputs[:, : scout.SCORES]
    chance = logit.sigmoid()
    missed = (1 - chance).square() * functional.logsigmoid(logit)
    false = chance.square() * functional.logsigmoid(-logit)
    covered, middle = (spare | there)[:, None], there[:, None]
    weight = torch.where(covered, SETTINGS.other_weight * others, 1.0)
    cost = torch.where(middle & own, missed, weight * false)
    # Corners (B,4,2,h,w). Of small panels a pixel is more of a cell.
    moves = (
        outputs[:, scout.SCORES :].reshape(-1, 4, 2, high, wide)
        * scout.SETTINGS.unit_px
    )
    quads = moves + places.permute(2, 0, 1) * stride
    unit = scout.SETTINGS.unit_px * (size / SETTINGS.small_px).clamp(min=0.1)
    off = (quads - crops.quads[..., None, None]) / unit[:, None, None]
    far = functional.smooth_l1_loss(
        off, torch.zeros_like(off), beta=SETTINGS.corner_beta, reduction="none"
    )
    many = there.sum().clamp(1)
    corners = (far.mean((1, 2)) * there).sum() / many
    loss: Tensor = SETTINGS.corner_weight * corners - cost.sum() / many
    return loss
