"""Training of the placer, on cells of candidates that are off by up to a cell, and of clutter."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.detector import placer as placing
from vocc_torch.receiver.detector.placer import SLIPS, Placer, corner_moves
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.receiver.resample import corner_cells
from vocc_torch.studies.train_detector.candidate_training import (
    CandidateSampler,
    CandidateTraining,
)
from vocc_torch.studies.train_detector.judge_training import JudgeSampler
from vocc_torch.studies.train_detector.pool import Form
from vocc_torch.studies.train_detector.sampling import Found, Pictures, joined
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class PlacerTraining(CandidateTraining):
    """Settings of the training."""

    shapes: tuple[tuple[int, int], ...] = (
        *((8, 8), (4, 4), (16, 16)),
        *((4, 8), (8, 16), (12, 12)),
    )
    shape_shares: tuple[float, ...] = (3.0, 5.0, 1.0, 1.5, 1.0, 0.5)
    rendered: int = 60
    near: int = 20
    clutter: int = 76
    rough: tuple[float, ...] = (0.03, 0.15, 0.4, 1.0)
    size: float = 0.0
    aspect: float = 0.04
    turn: float = 0.0
    shift: float = 0.8
    bend: float = 0.3
    slipped: float = 0.35  # share of candidates with a corner or a side some cells off
    slips: tuple[float, float] = (0.6, 1.6)  # cells
    small: float = 0.1
    right_cells: float = 0.25  # corners are off at most so much in a right candidate
    wrong_cells: float = 0.6  # and at least so much in a wrong one
    reach_cells: float = 2.0  # farther panels are not learnt to be reached
    move_weight: float = 3.0
    move_beta: float = 0.05  # cells


SETTINGS = PlacerTraining()


class PlacerSampler(CandidateSampler):
    """Draws pictures of the judge's candidates."""

    settings = SETTINGS

    def form(self, shape: PanelShape) -> Form:
        """Give the picture of a shape."""
        options = placing.SETTINGS
        return Form(shape, shape, (options.samples,) * 2, options.margin)

    def shows(self, form: Form) -> Tensor:
        """Say which frames (N,) show a panel of the shape; each form has its share of frames without one."""
        shapes, forms = self.pool.shapes, SETTINGS.shapes
        numbers = torch.arange(len(shapes), device=shapes.device)
        shared = numbers % len(forms) == forms.index(form.shape.sides)
        right = (shapes == shapes.new_tensor(form.shape.sides)).all(1)
        return right | (self.pool.empty & shared)

    def candidates(self, networks: Networks, frames: Tensor) -> Found:
        """Give the candidates that the judge has moved twice."""
        judged = JudgeSampler(self.pool)
        judged.mine(networks, frames)
        return joined(judged.last)

    def looked(
        self, networks: Networks, form: Form, grey: Tensor, shapes: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Give logits (B,) and corners (B,4,2), cells."""
        logit, cells = networks.placer(grey)
        moves = corner_moves(cells, form.shape)
        return logit, corner_cells(form.shape).to(moves) + moves

    def off(self, count: int, form: Form) -> Tensor:
        """Draw moves (n,4,2) of corners, cells; some slip by a cell."""
        draw = torch.rand(2, count, 1, 1, device=self.pool.device).double()
        low, high = SETTINGS.slips
        size = (draw[0] < SETTINGS.slipped) * (low + (high - low) * draw[1])
        slips = SLIPS[torch.randint(len(SLIPS), (count,))]
        return super().off(count, form) + size * slips.to(size)

    def loss(self, net: Placer) -> Tensor:
        """Give the loss of a batch."""
        form, batch = self.batch()
        logit, cells = net(batch.grey)
        return placer_loss(logit, corner_moves(cells, form.shape), form.shape, batch)


def placer_loss(
    logit: Tensor, moves: Tensor, shape: PanelShape, pictures: Pictures
) -> Tensor:
    """Give the losses of scores and of moves."""
    options, panel = SETTINGS, pictures.panel
    truth = pictures.corners - corner_cells(shape).to(pictures.corners)
    off = truth.norm(dim=2).amax(1)
    reached = panel & (off < options.reach_cells)
    right = panel & (off < options.right_cells)
    clear = right | ~panel | (off > options.wrong_cells)
    score = functional.binary_cross_entropy_with_logits(
        logit[clear], right[clear].float(), reduction="sum"
    )
    far = functional.smooth_l1_loss(
        moves[reached], truth[reached], beta=options.move_beta, reduction="sum"
    )
    far = far / (8 * reached.sum().clamp(min=1))
    loss: Tensor = score / clear.sum().clamp(min=1) + options.move_weight * far
    return loss
