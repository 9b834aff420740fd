"""Training of the scout, on crops with and without panels."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.detector import scout
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.studies.train_detector.candidates import Found, proposals
from vocc_torch.studies.train_detector.composition import (
    poses,
    shapes_of,
    with_panels,
)
from vocc_torch.studies.train_detector.crops import crops, empty_crops, views
from vocc_torch.studies.train_detector.draws import Draws
from vocc_torch.studies.train_detector.finish import finished
from vocc_torch.studies.train_detector.geometry import (
    homography,
    mapped,
    ordered,
    pixels,
    unit,
)
from vocc_torch.studies.train_detector.pool import Pool
from vocc_torch.studies.train_detector.sampling import Pictures, Sampler, pictures_of


@dataclass(frozen=True)
class ScoutTraining:
    """Settings of the training."""

    crop_px: int = 128
    # Crops of a batch of 72.
    composed: int = 20  # with a panel that is laid into a picture
    rendered: int = 18  # with a rendered panel
    counterexamples: int = 10  # without a panel
    mined: int = 24  # that the scout took for panels
    least_pitch_px: float = 1.8  # of LEDs that the scout is to find
    most_pitch_px: float = 4.6  # the next level shows larger ones
    most_side_px: float = 110.0  # of a panel in a crop
    blur_px: tuple[float, float] = (0.3, 1.1)
    soft_px: float = 0.45  # of LEDs' edges
    off_px: float = 45.0  # of a rendered panel from a crop's middle, at most
    laid_off_px: float = 33.75  # of a panel that is laid into it
    near_px: float = 6.0  # outputs so near the centre are to find the panel
    spare_share: float = 0.45  # of a side, within which others may
    corner_weight: float = 12.0
    small_px: float = 30.0  # diagonal of panels whose corners' errors count fully
    corner_beta: float = 0.05
    mined_score: float = -4.0
    small_share: float = 0.35  # of rendered panels
    alike: float = 1.2  # ratio to a limit of sizes, within which panels may be of both
    other_weight: float = 0.5  # of scores for other sizes where a panel is
    framed: float = 0.15  # share of crops in which the frame ends
    # Distance of a frame's end from a panel, in sides of the panel.
    framed_off: tuple[float, float] = (-0.02, 0.6)


SETTINGS = ScoutTraining()


class ScoutSampler(Sampler):
    """Draws crops."""

    settings = SETTINGS

    def __init__(self, pool: Pool, scale: int = 1) -> None:
        super().__init__(pool, scale)
        levels = torch.arange(len(pool.sizes), device=pool.device)
        pitch = pool.pitch_px[:, None] / 2.0**levels
        seen = (pitch >= SETTINGS.least_pitch_px) & (pitch <= SETTINGS.most_pitch_px)
        self.panels = (seen & pool.readable[:, None]).nonzero()
        # A share of small panels, and of the others.
        small = pool.shapes[self.panels[:, 0]].prod(1) < scout.SIZES[0] ** 2
        share = SETTINGS.small_share
        counts = small.sum(), (~small).sum()
        self.share = torch.where(small, share / counts[0], (1 - share) / counts[1])
        self.mined: Found | None = None

    def batch(self, generator: torch.Generator) -> tuple[Tensor, Pictures]:
        """Draw a batch of crops, and give rows and columns (B,2) of the panels, 0 without one."""
        options = self.settings

        def draws(count: int) -> Draws:
            return Draws(generator, self.scale * count)

        composed, laid = self.composed(draws(options.composed))
        rendered, shown = self.rendered(draws(options.rendered))
        empty = draws(options.counterexamples)
        behind = empty_crops(self.pool, empty, options.crop_px)
        others = [finished(behind, empty, edges=False)]
        if self.mined is not None and len(self.mined.frame):
            drawn = draws(options.mined)
            some = self.mined.rows(drawn.below(len(self.mined.frame)))
            others.append(self.cut(drawn, some.frame, some.level, some.quads)[0])
        batch = pictures_of([composed, rendered], others)
        shapes = torch.zeros(len(batch.grey), 2, device=empty.device)
        shapes[batch.panel] = torch.cat([laid, shown])
        return shapes, batch._replace(grey=framed(batch, generator))

    def composed(self, draws: Draws) -> tuple[tuple[Tensor, Tensor], Tensor]:
        """Lay panels into pictures; give these, the corners and the shapes."""
        options, shapes = SETTINGS, shapes_of(draws)
        side = options.crop_px
        pitch = draws.geometric(options.least_pitch_px, options.most_pitch_px)
        pitch = torch.minimum(pitch, options.most_side_px / shapes.amax(1))
        middle = draws.uniform(-1, 1, 2) * options.laid_off_px + side / 2
        quads = poses(draws, shapes, pitch, middle)
        behind = empty_crops(self.pool, draws, side)
        shown = with_panels(behind, quads, shapes, draws, options.soft_px)
        shown = finished(shown, draws, options.blur_px, edges=False)
        return (shown, ordered(quads)), shapes

    def rendered(self, draws: Draws) -> tuple[tuple[Tensor, Tensor], Tensor]:
        """Cut crops with rendered panels; give these, the corners and the shapes."""
        frame, level = self.panels[draws.numbers(self.share)].unbind(1)
        corners = self.pool.corners_px[frame].float()
        grey, quads = self.cut(draws, frame, level, corners)
        matrix = homography(quads, SETTINGS.crop_px * unit(quads))
        seen = ordered(mapped(matrix, corners.mT).mT)
        return (grey, seen), self.pool.shapes[frame].float()

    def cut(
        self, draws: Draws, frame: Tensor, level: Tensor, quads: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Cut crops about quadrilaterals (B,4,2) px of frames, and give their corners there."""
        off = draws.uniform(-SETTINGS.off_px, SETTINGS.off_px, 2)
        at = quads.mean(1) + off * 2.0 ** level[:, None]
        corners = views(draws, level, at, SETTINGS.crop_px)
        grey = crops(self.pool, frame, corners, SETTINGS.crop_px)
        return finished(grey, draws, edges=False), corners

    def mine(self, networks: Networks, frames: Tensor) -> None:
        """Find places in frames without a panel that the scout takes for one."""
        empty = frames[self.pool.shapes[frames, 0] == 0]
        found = proposals(networks.scout, self.pool, empty)
        self.mined = found.rows(found.score > SETTINGS.mined_score)

    def loss(self, net: scout.Scout, generator: torch.Generator) -> Tensor:
        """Give the loss of a batch."""
        shapes, batch = self.batch(generator)
        return scout_loss(net(batch.grey[:, None]), shapes, batch)


def framed(batch: Pictures, generator: torch.Generator) -> Tensor:
    """Let the frame end in some crops, beside a panel or where one of another crop is.

    As in the scout's pictures of whole levels, what lies beyond has a mean grey value.
    """
    options, draws = SETTINGS, Draws(generator, len(batch.grey))
    others = draws.below(int(batch.panel.sum()))
    quads = torch.where(batch.panel[:, None, None], batch.quads, batch.quads[others])
    low, high = quads.amin(1), quads.amax(1)
    off, ends = draws.uniform(*options.framed_off, 4), draws.uniform(0, 1, 4) < 0.5
    off = torch.where(ends, off, torch.inf) * (high - low).amax(1, keepdim=True)
    low, high = low - off[:, :2], high + off[:, 2:]
    at = torch.arange(options.crop_px, device=draws.device)[:, None] + 0.5
    inside = (at > low[:, None]) & (at < high[:, None])
    across, down = inside.unbind(2)
    shown = (down[:, :, None] & across[:, None]) | ~draws.coin(options.framed)[
        ..., None
    ]
    return torch.where(shown, batch.grey, batch.grey.mean((1, 2), keepdim=True))


def sizes_of(shapes: Tensor) -> tuple[Tensor, Tensor]:
    """Say of the sizes of panels (B,2) which score is theirs, and which are surely not, (B,3,1,1) bool each."""
    side = shapes.prod(1, keepdim=True).sqrt().clamp(min=1e-3)
    limits = side.new_tensor([0.0, *scout.SIZES, math.inf])
    least, most, alike = limits[:-1], limits[1:], SETTINGS.alike
    own = (side >= least) & (side < most)
    others = (side * alike < least) | (side >= most * alike)
    return own[..., None, None], others[..., None, None]


def scout_loss(outputs: Tensor, shapes: Tensor, batch: Pictures) -> Tensor:
    """Give the focal loss of scores and the distance of corners where a panel is."""
    high, wide = outputs.shape[2:]
    stride, device = scout.SETTINGS.stride_px, outputs.device
    places = pixels(high, wide, device)[0].mT.view(high, wide, 2)
    centre = batch.quads.mean(1)[:, None, None]
    apart = (places * stride - centre).norm(dim=3)
    size = (batch.quads[:, 0] - batch.quads[:, 2]).norm(dim=1)[:, None, None]
    panel = batch.panel[:, None, None]
    spare = (apart < SETTINGS.spare_share * size) & panel
    nearest = apart <= apart.flatten(1).amin(1)[:, None, None].clamp(min=1e-3)
    inside = ((centre > 0) & (centre < high * stride)).all(3)
    near = (apart < SETTINGS.near_px) | (nearest & (apart < stride))
    there = panel & inside & near
    own, others = sizes_of(shapes)
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
    off = (quads - batch.quads[..., None, None]) / unit[:, None, None]
    far = functional.smooth_l1_loss(
        off, torch.zeros_like(off), beta=SETTINGS.corner_beta, reduction="none"
    )
    many = there.sum().clamp(1)
    corners = (far.mean((1, 2)) * there).sum() / many
    loss: Tensor = SETTINGS.corner_weight * corners - cost.sum() / many
    return loss
