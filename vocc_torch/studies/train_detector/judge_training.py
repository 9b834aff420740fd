"""Training of the judge, on pictures of candidates near and far from panels."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.detector import judge as judging
from vocc_torch.receiver.detector.judge import Judge, corners_of
from vocc_torch.studies.train_detector.candidates import (
    Found,
    best_of_frames,
    judge_all,
    unit,
    with_truth,
)
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
from vocc_torch.studies.train_detector.scout_training import Proposals


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


SETTINGS = JudgeTraining()


class JudgePictures(NamedTuple):
    """JudgePictures (B,S,S) of candidates, panels' corners (B,4,2) px in them, and whether they show one (B,)."""

    grey: Tensor
    quads: Tensor
    panel: Tensor


def off_candidates(draws: Draws) -> Tensor:
    """Draw where panels' corners (B,4,2), px, lie in pictures of candidates that are off."""
    options = SETTINGS
    edge, side = judging.SETTINGS.edge_px, judging.SETTINGS.side_px
    rough = torch.tensor(options.rough, device=draws.device)
    shares = torch.tensor(options.rough_shares, device=draws.device)
    scale = rough[draws.chosen(shares)][:, None, None]
    square = unit(torch.zeros(draws.count, 4, 2, device=draws.device)) - 0.5
    size = options.size * draws.normal(1, 1) + options.aspect * draws.normal(1, 2)
    quads = square * (scale * size).exp()
    wild = options.wild_turn * draws.coin(options.wild) * draws.normal(1)
    turn = scale[:, 0] * (options.turn * draws.normal(1) + wild)
    (x, y), sine, cosine = quads.unbind(2), turn.sin(), turn.cos()
    quads = torch.stack([x * cosine - y * sine, x * sine + y * cosine], 2)
    moved = options.shift * draws.normal(1, 2) + options.bend * draws.normal(4, 2)
    return (quads + scale * moved) * (side - 2 * edge) + side / 2


class PictureSampler:
    """Draws pictures of candidates.

    Args:
        pool: what they are cut from.
        scale: of the batch, whose usual size is 128.
    """

    def __init__(self, pool: Pool, scale: int = 1) -> None:
        self.pool, self.scale = pool, scale
        self.panels = pool.readable.nonzero()[:, 0]
        self.near: Found | None = None
        self.clutter: Found | None = None

    def batch(self, generator: torch.Generator) -> JudgePictures:
        """Draw a batch of pictures."""
        parts = [self.composed(generator), self.rendered(generator)]
        if self.near is not None and len(self.near.frame):
            parts.append(self.taken(generator, self.near, SETTINGS.proposed))
        found = sum(len(quads) for _, quads in parts)
        draws = Draws(generator, self.scale * SETTINGS.empty)
        empty = finished(empty_crops(self.pool, draws, judging.SETTINGS.side_px), draws)
        parts.append((empty, torch.zeros_like(off_candidates(draws))))
        if self.clutter is not None and len(self.clutter.frame):
            parts.append(self.taken(generator, self.clutter, SETTINGS.mined))
        grey, quads = (torch.cat(part) for part in zip(*parts, strict=True))
        return JudgePictures(
            grey, quads, torch.arange(len(grey), device=grey.device) < found
        )

    def composed(self, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Lay panels into pictures."""
        draws = Draws(generator, self.scale * SETTINGS.composed)
        quads = off_candidates(draws)
        behind = empty_crops(self.pool, draws, judging.SETTINGS.side_px)
        laid = with_panels(behind, quads, draws.shapes(), draws, SETTINGS.soft_px)
        return finished(laid, draws, SETTINGS.blur_px), quads

    def rendered(self, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Read rendered panels so that their corners lie where they are asked for."""
        draws = Draws(generator, self.scale * SETTINGS.rendered)
        frame = self.panels[draws.below(len(self.panels))]
        corners = turned(draws, ordered(self.pool.corners_px[frame].float()))
        quads, side = off_candidates(draws), judging.SETTINGS.side_px
        seen = pictures(self.pool, frame, corners, quads, (side, side))
        return finished(seen, draws), quads

    def taken(
        self, generator: torch.Generator, found: Found, count: int
    ) -> tuple[Tensor, Tensor]:
        """Read candidates, moved a little; corners are zeros where no panel is."""
        draws = Draws(generator, self.scale * count)
        side, edge = judging.SETTINGS.side_px, judging.SETTINGS.edge_px
        rows = found.rows(draws.below(len(found.frame)))
        corners = turned(draws, rows.quads)
        square = unit(corners) + SETTINGS.small * draws.normal(1, 2)
        places = square * (side - 2 * edge) + edge
        seen = pictures(self.pool, rows.frame, corners, places, (side, side))
        truth = mapped(homography(corners, places), rows.truth.mT).mT
        # In a mirrored picture the panel begins at its own top left.
        truth = torch.where(rows.truth.any(2, keepdim=True), ordered(truth), 0.0)
        return finished(seen, draws), truth

    def mine(self, net: Judge, found: Proposals) -> Proposals:
        """Take candidates, also after the judge has moved them once and twice; give the last."""
        first = best_of_frames(found, SETTINGS.mined_of_frame)
        second = best_of_frames(judge_all(net, self.pool, first), SETTINGS.mined_again)
        third = judge_all(net, self.pool, second)
        parts = [with_truth(self.pool, one) for one in (first, second, third)]
        self.near, self.clutter = (
            Found(*map(torch.cat, zip(*kind, strict=True)))
            for kind in zip(*parts, strict=True)
        )
        return third


def judge_loss(logit: Tensor, maps: Tensor, pictures: JudgePictures) -> Tensor:
    """Give the losses of scores, of maps and of the corners in them."""
    side, wide = judging.SETTINGS.side_px, maps.shape[3]
    inside = ((pictures.quads > 1) & (pictures.quads < side - 1)).all(2)
    inside &= pictures.panel[:, None]
    # Each corner is shared among the four places around it.
    place = pictures.quads / judging.SETTINGS.heat_px - 0.5
    place = place.clamp(0, wide - 1.001)
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
