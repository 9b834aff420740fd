"""Training of the judge and of the verdict: candidates of the scout, and places about true panels."""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from vocc_torch.receiver.detector import judge as judging
from vocc_torch.receiver.detector.judge import Judge, judged, pitch_of
from vocc_torch.receiver.detector.pipeline import candidates
from vocc_torch.receiver.detector.pyramid import Pyramid
from vocc_torch.receiver.detector.scout import propose
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.receiver.resample import cell_homography, corner_cells, map_points
from vocc_torch.studies.train_detector.pool import Example
from vocc_torch.studies.train_detector.worlds import SHAPES
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class JudgeTraining:
    """Settings of the training."""

    candidates: int = 12  # of a frame
    again: int = 4  # of a frame, after the judge has moved them
    shaken: int = 6  # places about each true panel
    rough: tuple[float, ...] = (
        0.1,
        0.5,
        1.0,
        2.0,
        4.0,
    )  # by how much these are bent and stretched
    right_cells: float = 0.35  # corners are off at most so much in a right placing
    wrong_cells: float = 0.75  # and at least so much in a wrong one
    near_cells: float = 2.4  # corners are found from so far away
    corner_weight: float = 4.0
    patches: int = 1 << 18  # samples in a batch of one shape
    most: int = 64  # patches in a batch
    rate: float = 3e-3
    decay: float = 1e-3
    easy: float = 0.15  # share of a loss by which easy patches are drawn
    far: float = 99.0  # cells, of corners where there is no panel
    found_weight: float = 3.0  # of right placings: most placings are wrong
    verdict_steps: int = 3000
    verdict_rate: float = 5e-3
    verdict_decay: float = 3e-3


SETTINGS = JudgeTraining()


class Seen(NamedTuple):
    """Candidates of a shape: patches (n,H,W) uint8, their corners' errors, cells (n,4,2), pitches (n,)."""

    patches: Tensor
    off_cells: Tensor
    pitch_px: Tensor


def in_cells(quads: Tensor, truth: Tensor, shape: PanelShape) -> Tensor:
    """Give a panel's corners (4,2) less those of quadrilaterals (n,4,2), in cells, turned to fit best."""
    if not truth.any():
        return torch.full_like(quads, SETTINGS.far)
    inverse = torch.linalg.inv_ex(cell_homography(quads, shape).double()).inverse
    seen = torch.cat([truth, torch.ones_like(truth[:, :1])], 1).double() @ inverse.mT
    places = seen[..., :2] / seen[..., 2:]
    turns = range(4) if shape.rows == shape.columns else (0, 2)
    off = torch.stack([places.roll(turn, 1) for turn in turns]) - corner_cells(shape)
    off = off.nan_to_num(SETTINGS.far, SETTINGS.far, SETTINGS.far).clamp(
        -SETTINGS.far, SETTINGS.far
    )
    best = off.norm(dim=3).amax(2).argmin(0)
    return off[best, torch.arange(len(best))]


def shaken(truth: Tensor, shape: PanelShape, draw: np.random.Generator) -> Tensor:
    """Lay quadrilaterals about a true panel (4,2): shifted by cells, stretched, turned and bent."""
    count = SETTINGS.shaken

    def noise(*size: int) -> Tensor:
        return torch.from_numpy(draw.standard_normal((count, *size)))

    rough = torch.from_numpy(draw.choice(SETTINGS.rough, (count, 1, 1)))
    cells = corner_cells(shape).expand(count, 4, 2)
    middle = cells.mean(1, keepdim=True)
    stretch = 8 / max(shape.rows, shape.columns) * rough
    off = (cells - middle) * (1 + stretch * (0.05 * noise(1, 1) + 0.03 * noise(1, 2)))
    angle = 0.04 * rough * noise(1, 1)
    across = off[..., :1] * angle.cos() - off[..., 1:] * angle.sin()
    down = off[..., :1] * angle.sin() + off[..., 1:] * angle.cos()
    reach = judging.SETTINGS.reach
    shift = torch.from_numpy(draw.integers(-reach, reach + 1, (count, 1, 2)))
    bent = rough * (0.12 * noise(4, 2) + 0.15 * noise(1, 2))
    places = middle + torch.cat([across, down], 2) + bent + shift
    return map_points(truth.expand(count, 4, 2), places, shape)


def shape_of(example: Example, draw: np.random.Generator) -> PanelShape:
    """Give the shape to look for: the panel's, or any where there is none."""
    return (
        PanelShape(*SHAPES[draw.integers(len(SHAPES))])
        if example.empty
        else example.shape
    )


def collected(
    networks: Networks, examples: Sequence[Example], seed: int, again: bool
) -> dict[PanelShape, Seen]:
    """Look at the candidates of each frame, and ``again`` at the likeliest where the judge moves them."""
    parts = defaultdict(list)
    margin = judging.SETTINGS.reach + judging.SETTINGS.context
    with torch.inference_mode():
        for number, one in enumerate(examples):
            if not (one.empty or one.readable):
                continue
            draw = np.random.default_rng((seed, number))
            shape, pyramid = shape_of(one, draw), Pyramid.of(one.grey)
            proposed, _ = propose(networks.scout, pyramid)
            quads = [proposed[: SETTINGS.candidates]]
            if again:
                logit, _, moved = judged(networks.judge, pyramid, proposed, shape)
                quads.append(moved[logit.topk(min(SETTINGS.again, len(logit))).indices])
            if not one.empty:
                quads.append(shaken(one.corners_px, shape, draw))
            every = torch.cat(quads)
            off = in_cells(every, one.corners_px, shape)
            patches = pyramid.read_cells(every, shape, judging.SETTINGS.samples, margin)
            seen = Seen(
                patches.round().to(torch.uint8), off.float(), pitch_of(every, shape)
            )
            parts[shape].append(seen)
    return {
        shape: Seen(*(torch.cat(one).clone() for one in zip(*part, strict=True)))
        for shape, part in parts.items()
    }


def mirrored(seen: Seen, square: bool, draw: np.random.Generator) -> Seen:
    """Mirror and transpose patches with their corners, pale them and add noise, each at random."""
    patches, off = seen.patches.float(), seen.off_cells
    if draw.random() < 0.5:
        patches, off = (
            patches.flip(2),
            (off * torch.tensor([-1.0, 1.0]))[:, [1, 0, 3, 2]],
        )
    if draw.random() < 0.5:
        patches, off = (
            patches.flip(1),
            (off * torch.tensor([1.0, -1.0]))[:, [3, 2, 1, 0]],
        )
    if square and draw.random() < 0.5:
        patches, off = patches.mT, off.flip(2)[:, [0, 3, 2, 1]]
    patches = (
        patches * torch.from_numpy(draw.uniform(0.3, 1.0, (len(patches), 1, 1))).float()
    )
    if draw.random() < 0.4:
        patches = patches + torch.from_numpy(
            draw.standard_normal(patches.shape)
        ).float() * draw.uniform(0.2, 5)
    return Seen(patches.contiguous(), off, seen.pitch_px)


def judge_loss(logit: Tensor, moves: Tensor, off_cells: Tensor) -> Tensor:
    """Say how wrong logits (n,P,P) and moves (n,4,2) are for each candidate, (n,)."""
    steps = torch.arange(logit.shape[-1]) - logit.shape[-1] // 2
    down, right = torch.meshgrid(steps, steps, indexing="ij")
    rest = off_cells[:, None, None] - torch.stack([right, down], 2)[None, :, :, None]
    apart = rest.norm(dim=4).amax(3)
    panel = (apart < SETTINGS.right_cells).float()
    cost = functional.binary_cross_entropy_with_logits(logit, panel, reduction="none")
    clear = (apart < SETTINGS.right_cells) | (apart > SETTINGS.wrong_cells)
    focus = 0.2 + (logit.sigmoid() - panel).abs()
    cost = cost * clear * focus * (1 + SETTINGS.found_weight * panel)
    near = (off_cells.abs().amax(2) < SETTINGS.near_cells).float()
    off = functional.smooth_l1_loss(moves, off_cells, beta=0.1, reduction="none").sum(2)
    loss: Tensor = cost.flatten(1).sum(1) + SETTINGS.corner_weight * (off * near).mean(
        1
    )
    return loss


class JudgeTrainer:
    """Draws batches of candidates, the harder ones more often.

    Args:
        data: candidates by shape.
    """

    def __init__(self, data: dict[PanelShape, Seen]) -> None:
        self.data = data
        self.shapes = list(data)
        counts = np.array([len(data[shape].pitch_px) for shape in self.shapes]) ** 0.7
        self.share = counts / counts.sum()
        self.hardness = {
            shape: np.ones(len(seen.pitch_px)) for shape, seen in data.items()
        }

    def step(
        self, net: Judge, optimiser: torch.optim.Optimizer, draw: np.random.Generator
    ) -> float:
        """Take one step, and give its loss."""
        shape = self.shapes[draw.choice(len(self.shapes), p=self.share)]
        seen, hardness = self.data[shape], self.hardness[shape]
        many = max(8, min(SETTINGS.most, SETTINGS.patches // seen.patches[0].numel()))
        odds = hardness + SETTINGS.easy * hardness.mean()
        rows = draw.choice(len(odds), many, p=odds / odds.sum())
        batch = mirrored(
            Seen(*(part[rows] for part in seen)), shape.rows == shape.columns, draw
        )
        logit, moves = net(batch.patches, batch.pitch_px, shape)
        loss = judge_loss(logit, moves, batch.off_cells)
        hardness[rows] = loss.detach().numpy()
        optimiser.zero_grad()
        # Hard ones are drawn more often and count the less.
        weight = torch.from_numpy((1 / odds[rows]) ** 0.5).float()
        ((loss * weight).sum() / weight.sum()).backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(net.parameters(), 5.0)
        optimiser.step()
        return float(loss.detach().mean())


def train_steps(
    net: Judge,
    optimiser: torch.optim.Optimizer,
    trainer: JudgeTrainer,
    seed: int,
    steps: range,
    whole: int,
) -> float:
    """Take some steps of a training of ``whole`` steps, and give their mean loss."""
    total = 0.0
    for step in steps:
        for group in optimiser.param_groups:
            group["lr"] = (
                SETTINGS.rate
                * min(1.0, (step + 1) / 100)
                * (1 + math.cos(math.pi * step / whole))
                / 2
            )
        total += trainer.step(net, optimiser, np.random.default_rng((seed, step)))
    return total / max(len(steps), 1)


class Judged(NamedTuple):
    """Clues (n,CLUES) of candidates, 1, 0 or -1 (n,) for right, wrong or neither, and their frames (n,)."""

    clues: Tensor
    right: Tensor
    frame: Tensor


def judged_candidates(
    networks: Networks, examples: Sequence[Example], seed: int
) -> Judged:
    """Take the clues of the fitted candidates of each frame."""
    clues, right, frame = [], [], []
    with torch.inference_mode():
        for number, one in enumerate(examples):
            if not (one.empty or one.readable):
                continue
            shape = shape_of(one, np.random.default_rng((seed, number)))
            found = candidates(networks, Pyramid.of(one.grey), shape)
            off = in_cells(found.quads, one.corners_px, shape).norm(dim=2).amax(1)
            clues.append(found.clues.clone())
            right.append(
                torch.where(
                    off < SETTINGS.right_cells,
                    1,
                    torch.where(off > SETTINGS.wrong_cells, 0, -1),
                )
            )
            frame.append(torch.full((len(off),), number))
    return Judged(torch.cat(clues), torch.cat(right), torch.cat(frame))


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
        rows = torch.randint(len(right), (512,), generator=draw)
        loss = functional.binary_cross_entropy_with_logits(
            verdict(clues[rows]), right[rows]
        )
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
    return float(loss.detach())
