"""Training of the judge, on pictures of candidates near and far from panels."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.detector import judge as judging
from vocc_torch.receiver.detector.judge import SQUARE, Judge, corners_of
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.receiver.resample import corner_cells
from vocc_torch.studies.train_detector.candidates import Found, proposals
from vocc_torch.studies.train_detector.composition import SHAPES
from vocc_torch.studies.train_detector.draws import Draws
from vocc_torch.studies.train_detector.finish import finished
from vocc_torch.studies.train_detector.sampling import (
    CandidateSampler,
    CandidateTraining,
    Form,
    Pictures,
)
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class JudgeTraining(CandidateTraining):
    """Settings of the training; a unit is a px, and a step a side of a candidate."""

    shapes: tuple[tuple[int, int], ...] = ((8, 8), (8, 16), (16, 16), (8, 32))
    shape_shares: tuple[float, ...] = (0.6, 0.15, 0.17, 0.08)
    mirrored: float = 0.5  # share of batches in which rows are columns
    rendered: int = 14
    counterexamples: int = 14
    mined: int = 44
    rough: tuple[float, ...] = (0.1, 0.3, 0.6, 1.0, 1.3)
    rough_shares: tuple[float, ...] = (0.15, 0.2, 0.25, 0.25, 0.15)
    size: float = 0.16
    aspect: float = 0.08
    turn: float = 0.12
    wild_turn: float = 0.35
    wild: float = 0.15  # share of candidates that are turned more
    shift: float = 0.093
    bend: float = 0.04
    small: float = 0.56
    soft_px: float = 0.6
    blur_px: tuple[float, float] = (0.35, 1.6)
    map_weight: float = 0.5
    corner_weight: float = 0.3
    corner_beta_px: float = 0.5
    mined_of_frame: int = 16
    mined_again: int = 8


SETTINGS = JudgeTraining()


class JudgeSampler(CandidateSampler):
    """Draws pictures of the scout's candidates."""

    settings = SETTINGS

    def form(self, number: int, shape: PanelShape) -> Form:
        """Give the pictures of shapes that the judge sees alike."""
        options, shapes, device = judging.SETTINGS, self.pool.shapes, self.pool.device
        down, across = judging.grown(shape)
        parts = torch.tensor((across, down), device=device) * options.samples
        nominal = (corner_cells(SQUARE).float().to(device) + options.margin) * parts
        panels, empty = seen_as(shape, shapes), shapes[:, 0] == 0
        laid = torch.tensor(SHAPES, dtype=torch.float32, device=device)
        # Frames without a panel are shared out, as larger pictures take longer.
        turn = torch.arange(len(shapes), device=device) % len(SETTINGS.shapes)
        mined = panels | (empty & ((turn == number) | (number == 0)))
        return Form(
            shape,
            SQUARE,
            (down * options.side_px, across * options.side_px),
            nominal,
            margin=0.0,
            unit_px=1.0,
            step=nominal[2] - nominal[0],
            laid=laid[seen_as(shape, laid)],
            panels=panels,
            mined=mined,
            share=1 / (down * across),
        )

    def candidates(self, networks: Networks, frames: Tensor) -> Found:
        """Give the scout's candidates."""
        return proposals(networks.scout, self.pool, frames)

    def looked(
        self, networks: Networks, form: Form, grey: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Give logits (B,) and corners (B,4,2), parts of SQUARE."""
        logit, maps = networks.judge(grey)
        return logit, judging.parts_of(corners_of(maps), form.shape)

    def counterexamples(self, draws: Draws, form: Form) -> Tensor:
        """Cut pictures without a panel."""
        return finished(self.behind(draws, form), draws)

    def turn(self, draws: Draws) -> Tensor:
        """Draw angles (B,1), some of them wild."""
        wild = SETTINGS.wild_turn * draws.coin(SETTINGS.wild)
        return super().turn(draws) + wild * draws.normal(1)

    def loss(self, net: Judge, generator: torch.Generator) -> Tensor:
        """Give the loss of a batch, mirrored or not."""
        _, batch = self.batch(generator)
        if bool(Draws(generator, 1).coin(SETTINGS.mirrored)):
            quads = batch.quads.flip(2)[:, [0, 3, 2, 1]]
            batch = batch._replace(grey=batch.grey.mT, quads=quads)
        logit, maps = net(batch.grey)
        return judge_loss(logit, maps, batch)


def seen_as(shape: PanelShape, shapes: Tensor) -> Tensor:
    """Say which shapes (N,2), 0 without a panel, have pictures as large as those of a shape, (N,) bool."""
    sizes = [
        rows > 0 and judging.grown(PanelShape(rows, columns)) == judging.grown(shape)
        for rows, columns in shapes.long().tolist()
    ]
    return torch.tensor(sizes, device=shapes.device)


def judge_loss(logit: Tensor, maps: Tensor, pictures: Pictures) -> Tensor:
    """Give the losses of scores, of maps and of the corners in them."""
    wide = maps.shape[3]
    most = pictures.quads.new_tensor([wide, maps.shape[2]])
    far = judging.SETTINGS.heat_px * most - 1
    inside = ((pictures.quads > 1) & (pictures.quads < far)).all(2)
    inside &= pictures.panel[:, None]
    # Each corner is shared among the four places around it.
    place = pictures.quads / judging.SETTINGS.heat_px - 0.5
    place = place.clamp(min=0).minimum(most - 1)
    numbers = torch.arange(max(maps.shape[2:]), device=maps.device)
    shares = (1 - (place[..., None] - numbers).abs()).clamp(min=0)
    across, down = shares.unbind(2)
    likely = maps.flatten(2).log_softmax(2).view_as(maps)
    heat = down[..., : maps.shape[2], None] * across[..., None, :wide]
    cost = -(heat * likely).sum((2, 3))
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
