"""Training of the judge, on pictures of candidates near and far from panels, and of the verdict."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.detector import judge as judging
from vocc_torch.receiver.detector.judge import (
    SQUARE,
    Judge,
    corners_of,
    judged,
    pictures_of,
    pitch_of,
)
from vocc_torch.receiver.detector.pipeline import candidates
from vocc_torch.receiver.detector.pyramid import Pyramid
from vocc_torch.receiver.detector.scout import propose
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.studies.train_detector.composition import (
    Draws,
    cells_of,
    finished,
    mirrored,
    with_panels,
)
from vocc_torch.studies.train_detector.material import Material
from vocc_torch.studies.train_detector.pool import SHAPES, Example
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class JudgeTraining:
    """Settings of the training."""

    composed: int = 40  # pictures of a batch with a panel that is laid into a picture
    rendered: int = 24  # with a rendered panel
    empty: int = 24  # without a panel
    mined: int = 24  # candidates of the scout, without a panel
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
    around: float = 1.5  # of a rendered panel, sides that are read about it
    soft_px: float = 0.6  # of LEDs' edges
    blur_px: tuple[float, float] = (0.35, 1.6)
    map_weight: float = 0.5
    corner_weight: float = 0.3
    corner_beta_px: float = 0.5
    mined_frames: int = 40
    mined_of_frame: int = 14
    mined_again: int = 5  # of a frame, after the judge has moved them
    right_cells: float = 0.35  # corners are off at most so much in a right candidate
    wrong_cells: float = 0.75  # and at least so much in a wrong one
    verdict_steps: int = 3000
    verdict_rate: float = 5e-3
    verdict_decay: float = 3e-3
    verdict_batch: int = 512


SETTINGS = JudgeTraining()


class Pictures(NamedTuple):
    """Pictures (B,S,S) of candidates, panels' corners (B,4,2) px in them, and whether they show one (B,)."""

    grey: Tensor
    quads: Tensor
    panel: Tensor


def off_candidates(draws: Draws) -> Tensor:
    """Draw where panels' corners (B,4,2), px, lie in pictures of candidates that are off."""
    options = SETTINGS
    edge, side = judging.SETTINGS.edge_px, judging.SETTINGS.side_px
    square = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) - 0.5
    rough = draws.generator.choice(options.rough, draws.count, p=options.rough_shares)
    scale = torch.from_numpy(rough).float()[:, None, None]
    size = options.size * draws.normal(1, 1) + options.aspect * draws.normal(1, 2)
    quads = square * (scale * size).exp()
    wild = options.wild_turn * draws.coin(options.wild) * draws.normal(1)
    turn = scale[:, 0] * (options.turn * draws.normal(1) + wild)
    (x, y), sine, cosine = quads.unbind(2), turn.sin(), turn.cos()
    quads = torch.stack([x * cosine - y * sine, x * sine + y * cosine], 2)
    moved = options.shift * draws.normal(1, 2) + options.bend * draws.normal(4, 2)
    return (quads + scale * moved) * (side - 2 * edge) + side / 2


class Sampler:
    """Draws pictures of candidates.

    Args:
        material: what they are cut from.
    """

    def __init__(self, material: Material) -> None:
        self.material = material
        margin = round(SETTINGS.around * SQUARE.rows)
        samples = judging.SETTINGS.samples
        read = [
            Pyramid.of(one.grey).read_cells(
                one.corners_px[None], SQUARE, samples, margin
            )
            for one in material.found
        ]
        self.panels = torch.cat(read) if read else torch.zeros(0, 1, 1)
        self.mined = torch.zeros(0, 1, 1)

    def batch(self, draw: np.random.Generator) -> Pictures:
        """Draw a batch of pictures."""
        options, side = SETTINGS, judging.SETTINGS.side_px
        draws = Draws(draw, options.composed)
        quads = off_candidates(draws)
        pictures = self.material.patches(side, options.composed, draw)
        laid = with_panels(pictures, quads, draws.shapes(), draws, options.soft_px)
        parts, corners = [finished(laid, draws, options.blur_px)], [quads]
        if len(self.panels):
            draws = Draws(draw, options.rendered)
            quads = off_candidates(draws)
            parts.append(finished(self.warped(quads, draw), draws))
            corners.append(quads)
        found = sum(map(len, corners))
        pictures = self.material.patches(side, options.empty, draw)
        if len(self.mined):
            rows = draw.integers(len(self.mined), size=options.mined)
            pictures = torch.cat([pictures, self.mined[rows]])
        parts.append(finished(pictures, Draws(draw, len(pictures))))
        corners.append(torch.zeros(len(pictures), 4, 2))
        grey, quads = mirrored(torch.cat(parts), torch.cat(corners), draw)
        return Pictures(grey, quads, torch.arange(len(grey)) < found)

    def warped(self, quads: Tensor, draw: np.random.Generator) -> Tensor:
        """Read rendered panels so that their corners lie at places (B,4,2) of a picture."""
        panels = self.panels[draw.integers(len(self.panels), size=len(quads))]
        side = judging.SETTINGS.side_px
        places = cells_of(quads, torch.ones(len(quads), 2), side)
        grid = (places.mT - 0.5) * (2 / (1 + 2 * SETTINGS.around))
        grid = grid.view(-1, side, side, 2)
        return functional.grid_sample(
            panels[:, None], grid, padding_mode="border", align_corners=False
        )[:, 0]

    def mine(self, networks: Networks, draw: np.random.Generator) -> None:
        """Take the candidates of frames without a panel, the likeliest also after a move."""
        pictures = []
        chosen = draw.permutation(len(self.material.empty))[: SETTINGS.mined_frames]
        for number in chosen:
            planes = self.material.empty[number]
            pyramid = Pyramid(tuple(torch.from_numpy(one).float() for one in planes))
            quads, _ = propose(networks.scout, pyramid)
            quads = quads[: SETTINGS.mined_of_frame]
            logit, moved = judged(networks.judge, pyramid, quads)
            again = logit.topk(min(SETTINGS.mined_again, len(logit))).indices
            every = torch.cat([quads, moved[again]])
            pictures.append(pictures_of(pyramid, every))
        self.mined = torch.cat(pictures).clone() if pictures else self.mined


def judge_loss(logit: Tensor, maps: Tensor, pictures: Pictures) -> Tensor:
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


def judge_step(net: Judge, sampler: Sampler, draw: np.random.Generator) -> Tensor:
    """Give the loss of a batch."""
    pictures = sampler.batch(draw)
    logit, maps = net(pictures.grey)
    return judge_loss(logit, maps, pictures)


class Judged(NamedTuple):
    """Clues (n,CLUES) of candidates, and 1, 0 or -1 (n,) for right, wrong or neither."""

    clues: Tensor
    right: Tensor


def off_cells(quads: Tensor, truth: Tensor, shape: PanelShape) -> Tensor:
    """Say how far the worst corner of candidates (n,4,2) is from the panel's (4,2), cells, turned to fit best."""
    turns = range(4) if shape.rows == shape.columns else (0, 2)
    turned = torch.stack([truth.roll(turn, 0) for turn in turns])
    off: Tensor = (quads - turned[:, None]).norm(dim=3).amax(2).amin(0)
    return off / pitch_of(truth[None], shape)


def judged_candidates(
    networks: Networks, examples: Sequence[Example], seed: int
) -> Judged:
    """Take the clues of the fitted candidates of each frame."""
    clues, right = [], []
    with torch.inference_mode():
        for number, one in enumerate(examples):
            if not (one.empty or one.readable):
                continue
            draw = np.random.default_rng((seed, number))
            some = PanelShape(*SHAPES[draw.integers(len(SHAPES))])
            shape = some if one.empty else one.shape
            found = candidates(networks, Pyramid.of(one.grey), shape)
            clues.append(found.clues.clone())
            label = torch.zeros(len(found.quads), dtype=torch.int64)
            if not one.empty:
                off = off_cells(found.quads, one.corners_px, shape)
                label -= (off < SETTINGS.wrong_cells).long()
                label += 2 * (off < SETTINGS.right_cells)
            right.append(label)
    return Judged(torch.cat(clues), torch.cat(right))


def train_verdict(networks: Networks, seen: Judged, seed: int) -> float:
    """Fit the verdict to candidates; give its last loss."""
    clear = seen.right >= 0
    clues, right = seen.clues[clear], seen.right[clear].float()
    verdict = networks.verdict
    verdict.mean.copy_(clues.mean(0))
    verdict.spread.copy_(clues.std(0).clamp(min=1e-3))
    optimiser = torch.optim.AdamW(
        verdict.parameters(), SETTINGS.verdict_rate, weight_decay=SETTINGS.verdict_decay
    )
    draw = torch.Generator().manual_seed(seed)
    loss = torch.zeros(())
    for step in range(SETTINGS.verdict_steps):
        for group in optimiser.param_groups:
            group["lr"] = SETTINGS.verdict_rate * (1 - step / SETTINGS.verdict_steps)
        rows = torch.randint(len(right), (SETTINGS.verdict_batch,), generator=draw)
        loss = functional.binary_cross_entropy_with_logits(
            verdict(clues[rows]), right[rows]
        )
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
    return float(loss.detach())
