"""Training of the judge, on pictures of candidates near and far from panels."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.detector import judge as judging
from vocc_torch.receiver.detector.judge import Judge, corners_of
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.studies.train_detector.candidates import (
    Found,
    best_of_frames,
    judge_all,
    unit,
    with_truth,
)
from vocc_torch.studies.train_detector.composition import SHAPES as COMPOSED
from vocc_torch.studies.train_detector.composition import (
    Draws,
    finished,
    homography,
    mapped,
    with_panels,
)
from vocc_torch.studies.train_detector.crops import (
    empty_crops,
    ordered,
    pictures,
    turned,
)
from vocc_torch.studies.train_detector.pool import Pool
from vocc_torch.studies.train_detector.scout_training import Proposals, proposals
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class JudgeTraining:
    """Settings of the training."""

    # JudgePictures of a batch of 128.
    composed: int = 36  # with a panel that is laid into a picture
    rendered: int = 14  # with a rendered panel
    proposed: int = 20  # candidates of the scout, with a panel
    empty: int = 14  # without a panel
    mined: int = 44  # candidates of the scout, without a panel
    # How far candidates are off, and how often.
    rough: tuple[float, ...] = (0.1, 0.3, 0.6, 1.0, 1.3)
    rough_shares: tuple[float, ...] = (0.15, 0.2, 0.25, 0.25, 0.15)
    # Standard deviations at a roughness of 1; lengths in shares of a side.
    size: float = 0.16
    aspect: float = 0.08
    turn: float = 0.12
    wild_turn: float = 0.35
    wild: float = 0.15  # share of candidates that are turned more
    shift: float = 0.093
    bend: float = 0.04
    small: float = 0.02  # shift of candidates that are taken again, of a side
    soft_px: float = 0.6  # of LEDs' edges
    blur_px: tuple[float, float] = (0.35, 1.6)
    map_weight: float = 0.5
    corner_weight: float = 0.3
    corner_beta_px: float = 0.5
    mined_of_frame: int = 16
    mined_again: int = 8  # of a frame, after the judge has moved them
    shape_shares: tuple[float, ...] = (0.6, 0.15, 0.17, 0.08)


SETTINGS = JudgeTraining()


SHAPES = ((8, 8), (8, 16), (16, 16), (8, 32))
"""Rows and columns, one of them a batch; half of the batches are mirrored, so that rows are columns."""


class JudgePictures(NamedTuple):
    """Pictures (B,H,W) of candidates, panels' corners (B,4,2) px in them, and whether they show one (B,)."""

    grey: Tensor
    quads: Tensor
    panel: Tensor


@dataclass(frozen=True)
class Canvas:
    """The pictures of candidates of one kind of shapes.

    Args:
        shape: one of :data:`SHAPES`.
    """

    shape: PanelShape

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of a picture, px."""
        down, across = judging.grown(self.shape)
        return judging.SETTINGS.side_px * down, judging.SETTINGS.side_px * across

    @property
    def square(self) -> bool:
        """Whether quarter turns leave it as it is."""
        return self.size[0] == self.size[1]

    @property
    def share(self) -> float:
        """Pictures in the time of one of the smallest."""
        return judging.SETTINGS.side_px**2 / math.prod(self.size)

    def shows(self, shapes: Tensor) -> Tensor:
        """Say which of panels' shapes (N,2) have such pictures, (N,) bool."""
        sizes = [
            judging.grown(PanelShape(rows, columns)) == judging.grown(self.shape)
            for rows, columns in shapes.clamp(min=1).tolist()
        ]
        return (shapes[:, 0] > 0) & torch.tensor(sizes, device=shapes.device)

    def lengths(self, like: Tensor) -> Tensor:
        """Width and height (2,) px."""
        return like.new_tensor(self.size[::-1])

    def places(self, square: Tensor) -> Tensor:
        """Put corners (B,4,2) of unit squares where candidates lie, px."""
        edge = judging.SETTINGS.edge_px / judging.SETTINGS.side_px
        return (square * (1 - 2 * edge) + edge) * self.lengths(square)


def off_candidates(draws: Draws, canvas: Canvas) -> Tensor:
    """Draw where panels' corners (B,4,2), px, lie in pictures of candidates that are off."""
    options = SETTINGS
    rough = torch.tensor(options.rough, device=draws.device)
    shares = torch.tensor(options.rough_shares, device=draws.device)
    scale = rough[draws.chosen(shares)][:, None, None]
    quads = unit(torch.zeros(draws.count, 4, 2, device=draws.device)) - 0.5
    size = options.size * draws.normal(1, 1) + options.aspect * draws.normal(1, 2)
    lengths = canvas.lengths(quads)
    quads = quads * (scale * size).exp() * lengths
    wild = options.wild_turn * draws.coin(options.wild) * draws.normal(1)
    turn = scale[:, 0] * (options.turn * draws.normal(1) + wild)
    (x, y), sine, cosine = quads.unbind(2), turn.sin(), turn.cos()
    quads = torch.stack([x * cosine - y * sine, x * sine + y * cosine], 2) / lengths
    moved = options.shift * draws.normal(1, 2) + options.bend * draws.normal(4, 2)
    return canvas.places(quads + scale * moved + 0.5)


class PictureSampler:
    """Draws pictures of candidates.

    Args:
        pool: what they are cut from.
        scale: of the batch, whose usual size is 128.
    """

    def __init__(self, pool: Pool, scale: int = 1) -> None:
        self.pool, self.scale = pool, scale
        self.canvases = [Canvas(PanelShape(*shape)) for shape in SHAPES]
        self.of_canvas = [canvas.shows(pool.shapes) for canvas in self.canvases]
        shapes = torch.tensor(COMPOSED, device=pool.buffer.device)
        self.composable = [shapes[canvas.shows(shapes)] for canvas in self.canvases]
        self.near: list[Found] = []
        self.clutter: list[Found] = []

    def batch(self, generator: torch.Generator) -> JudgePictures:
        """Draw a batch of pictures of one size."""
        shares = torch.tensor(SETTINGS.shape_shares, device=generator.device)
        kind = int(torch.multinomial(shares, 1, generator=generator))
        parts = [self.composed(generator, kind)]
        panels = (self.of_canvas[kind] & self.pool.readable).nonzero()[:, 0]
        if len(panels):
            parts.append(self.rendered(generator, kind, panels))
        if self.near and len(self.near[kind].frame):
            near = self.near[kind]
            parts.append(self.taken(generator, kind, near, SETTINGS.proposed))
        found = sum(len(quads) for _, quads in parts)
        draws = self.draws(generator, kind, SETTINGS.empty)
        empty = finished(self.behind(draws, kind), draws)
        parts.append((empty, empty.new_zeros(len(empty), 4, 2)))
        if self.clutter and len(self.clutter[kind].frame):
            clutter = self.clutter[kind]
            parts.append(self.taken(generator, kind, clutter, SETTINGS.mined))
        grey, quads = (torch.cat(part) for part in zip(*parts, strict=True))
        panel = torch.arange(len(grey), device=grey.device) < found
        if bool(draws.coin(0.5)[0]):
            grey, quads = grey.mT, ordered(quads.flip(2))
        return JudgePictures(grey, quads, panel)

    def draws(self, generator: torch.Generator, kind: int, count: int) -> Draws:
        """Give the draws of some pictures; there are fewer of larger ones."""
        count = round(self.scale * count * self.canvases[kind].share)
        return Draws(generator, max(1, count))

    def behind(self, draws: Draws, kind: int) -> Tensor:
        """Cut pictures without a panel."""
        high, wide = self.canvases[kind].size
        crops = empty_crops(self.pool, draws, max(high, wide))
        return crops[:, :high, :wide].contiguous()

    def composed(self, generator: torch.Generator, kind: int) -> tuple[Tensor, Tensor]:
        """Lay panels into pictures."""
        draws = self.draws(generator, kind, SETTINGS.composed)
        quads = off_candidates(draws, self.canvases[kind])
        shapes = self.composable[kind]
        shapes = shapes[draws.below(len(shapes))].float()
        behind = self.behind(draws, kind)
        laid = with_panels(behind, quads, shapes, draws, SETTINGS.soft_px)
        return finished(laid, draws, SETTINGS.blur_px), quads

    def rendered(
        self, generator: torch.Generator, kind: int, panels: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Read rendered panels so that their corners lie where they are asked for."""
        draws = self.draws(generator, kind, SETTINGS.rendered)
        canvas, frame = self.canvases[kind], panels[draws.below(len(panels))]
        corners = ordered(self.pool.corners_px[frame].float())
        corners = turned(draws, corners, canvas.square)
        quads = off_candidates(draws, canvas)
        seen = pictures(self.pool, frame, corners, quads, canvas.size)
        return finished(seen, draws), quads

    def taken(
        self, generator: torch.Generator, kind: int, found: Found, count: int
    ) -> tuple[Tensor, Tensor]:
        """Read candidates, moved a little; corners are zeros where no panel is."""
        draws, canvas = self.draws(generator, kind, count), self.canvases[kind]
        rows = found.rows(draws.below(len(found.frame)))
        corners = turned(draws, rows.quads, canvas.square)
        places = canvas.places(unit(corners) + SETTINGS.small * draws.normal(1, 2))
        seen = pictures(self.pool, rows.frame, corners, places, canvas.size)
        truth = mapped(homography(corners, places), rows.truth.mT).mT
        # In a mirrored picture the panel begins at its own top left.
        truth = torch.where(rows.truth.any(2, keepdim=True), ordered(truth), 0.0)
        return finished(seen, draws), truth

    def mine(self, networks: Networks, frames: Tensor) -> None:
        """Take the scout's candidates of frames."""
        self.judged(networks, frames)

    def judged(self, networks: Networks, frames: Tensor) -> list[Proposals]:
        """Take candidates, also after the judge has moved them once and twice; give the last of each size."""
        net, found = networks.judge, proposals(networks.scout, self.pool, frames)
        found = best_of_frames(found, SETTINGS.mined_of_frame)
        self.near, self.clutter, last = [], [], []
        for kind, canvas in enumerate(self.canvases):
            first = found.rows(self.mined_by(kind, found.frame))
            second = judge_all(net, self.pool, first, canvas.shape)
            second = best_of_frames(second, SETTINGS.mined_again)
            third = judge_all(net, self.pool, second, canvas.shape)
            parts = [with_truth(self.pool, one) for one in (first, second, third)]
            near, clutter = (
                Found(*map(torch.cat, zip(*some, strict=True)))
                for some in zip(*parts, strict=True)
            )
            self.near.append(near)
            self.clutter.append(clutter)
            last.append(third)
        return last

    def loss(self, net: Judge, generator: torch.Generator) -> Tensor:
        """Give the loss of a batch."""
        pictures = self.batch(generator)
        logit, maps = net(pictures.grey)
        return judge_loss(logit, maps, pictures)

    def mined_by(self, kind: int, frame: Tensor) -> Tensor:
        """Say which frames (n,) are for pictures of a size: of its panels, and its part of the empty ones."""
        part = frame % len(SHAPES) == kind
        empty = (self.pool.shapes[frame, 0] == 0) & (part | (kind == 0))
        return self.of_canvas[kind][frame] | empty


def judge_loss(logit: Tensor, maps: Tensor, pictures: JudgePictures) -> Tensor:
    """Give the losses of scores, of maps and of the corners in them."""
    wide = maps.shape[3]
    most = pictures.quads.new_tensor([wide, maps.shape[2]])
    far = judging.SETTINGS.heat_px * most - 1
    inside = ((pictures.quads > 1) & (pictures.quads < far)).all(2)
    inside &= pictures.panel[:, None]
    # Each corner is shared among the four places around it.
    place = pictures.quads / judging.SETTINGS.heat_px - 0.5
    place = place.clamp(min=0).minimum(most - 1.001)
    first = place.floor().long()
    part = place - first
    likely = maps.flatten(2).log_softmax(2)
    cost = torch.zeros_like(likely[..., 0])
    for right in (0, 1):
        for below in (0, 1):
            share = (1 - right + (2 * right - 1) * part[..., 0]) * (
                1 - below + (2 * below - 1) * part[..., 1]
            )
            row = (first[..., 1] + below) * wide + first[..., 0] + right
            cost = cost - share * likely.gather(2, row[..., None])[..., 0]
    off = functional.smooth_l1_loss(
        corners_of(maps),
        pictures.quads,
        beta=SETTINGS.corner_beta_px,
        reduction="none",
    )
    cost = SETTINGS.map_weight * cost + SETTINGS.corner_weight * off.sum(2)
    score = functional.binary_cross_entropy_with_logits(logit, pictures.panel.float())
    loss: Tensor = score + (cost * inside).sum() / inside.sum().clamp(min=1)
    return loss
