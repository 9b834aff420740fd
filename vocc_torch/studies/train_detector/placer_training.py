"""Training of the placer, on cells of candidates that are off by up to a cell, and of clutter."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.detector import placer as placing
from vocc_torch.receiver.detector.placer import Placer
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.receiver.resample import corner_cells
from vocc_torch.studies.train_detector.candidates import Found, joined
from vocc_torch.studies.train_detector.composition import likenesses
from vocc_torch.studies.train_detector.draws import Draws
from vocc_torch.studies.train_detector.judge_training import JudgeSampler
from vocc_torch.studies.train_detector.sampling import (
    CandidateSampler,
    CandidateTraining,
    Form,
    Pictures,
)
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class PlacerTraining(CandidateTraining):
    """Settings of the training; a unit and a step are a cell."""

    shapes: tuple[tuple[int, int], ...] = (
        (8, 8),
        (4, 4),
        (16, 16),
        (4, 8),
        (8, 16),
        (12, 12),
    )
    shape_shares: tuple[float, ...] = (3.0, 5.0, 1.0, 1.5, 1.0, 0.5)
    rendered: int = 24
    counterexamples: int = 28  # with a lattice that is no panel
    mined: int = 48
    rough: tuple[float, ...] = (0.03, 0.15, 0.4, 1.0)
    rough_shares: tuple[float, ...] = (0.25, 0.3, 0.25, 0.2)
    size: float = 0.0
    aspect: float = 0.04
    shift: float = 0.8
    bend: float = 0.3
    slipped: float = 0.35  # share of candidates with a corner or a side some cells off
    slips: tuple[float, float] = (0.6, 1.6)  # cells
    small: float = 0.1
    soft_px: float = 0.7
    blur_px: tuple[float, float] = (0.4, 1.7)
    right_cells: float = 0.25  # corners are off at most so much in a right candidate
    wrong_cells: float = 0.6  # and at least so much in a wrong one
    reach_cells: float = 2.0  # farther panels are not learnt to be reached
    move_weight: float = 3.0
    move_beta: float = 0.05  # cells
    mined_of_frame: int = 5
    mined_again: int = 5


SETTINGS = PlacerTraining()


class PlacerSampler(CandidateSampler):
    """Draws pictures of the judge's candidates."""

    settings = SETTINGS

    def form(self, number: int, shape: PanelShape) -> Form:
        """Give the pictures of a shape."""
        options, shapes, device = placing.SETTINGS, self.pool.shapes, self.pool.device
        high, wide = (
            (leds + 2 * options.margin) * options.samples
            for leds in (shape.rows, shape.columns)
        )
        laid = torch.tensor([[shape.rows, shape.columns]], device=device)
        panels = (shapes == laid).all(1)
        return Form(
            shape,
            shape,
            (high, wide),
            corner_cells(shape).float().to(device),
            options.margin,
            options.samples,
            step=torch.ones(2, device=device),
            laid=laid.float(),
            panels=panels,
            mined=panels | (shapes[:, 0] == 0),
        )

    def candidates(self, networks: Networks, frames: Tensor) -> Found:
        """Give the candidates of all sizes that the judge has moved twice."""
        judged = JudgeSampler(self.pool)
        judged.mine(networks, frames)
        return joined(judged.moved)

    def looked(
        self, networks: Networks, form: Form, grey: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Give logits (B,) and corners (B,4,2), cells."""
        logit, moves = networks.placer(grey, form.shape)
        return logit, form.nominal + moves

    def off(self, draws: Draws, form: Form) -> Tensor:
        """Draw where panels' corners (B,4,2), cells, lie; some slip by a cell."""
        slipped = draws.coin(SETTINGS.slipped)[..., None] * slips(draws)
        return super().off(draws, form) + slipped

    def counterexamples(self, draws: Draws, form: Form) -> Tensor:
        """Lay lattices that are no panels into pictures."""
        likeness = likenesses(draws, form.laid.expand(draws.count, 2))
        return self.laid(draws, form, self.off(draws, form), likeness)

    def loss(self, net: Placer, generator: torch.Generator) -> Tensor:
        """Give the loss of a batch."""
        form, batch = self.batch(generator)
        logit, moves = net(batch.grey, form.shape)
        return placer_loss(logit, moves, form.shape, batch)


def slips(draws: Draws) -> Tensor:
    """Draw moves (B,4,2) of a corner or a side, across or down, cells."""
    first, both, down = (draws.below(count, 1) for count in (4, 2, 2))
    corners = torch.arange(4, device=draws.device)
    chosen = (corners == first) | (corners == (first + both) % 4)
    axes = torch.cat([1 - down, down], 1)[:, None]
    size = draws.uniform(*SETTINGS.slips, 1) * (2 * draws.below(2, 1) - 1)
    return (chosen * size)[..., None] * axes


def placer_loss(
    logit: Tensor, moves: Tensor, shape: PanelShape, patches: Pictures
) -> Tensor:
    """Give the losses of scores and of moves."""
    options = SETTINGS
    truth = patches.quads - corner_cells(shape).to(patches.quads)
    off = truth.norm(dim=2).amax(1)
    reached = patches.panel & (off < options.reach_cells)
    right = patches.panel & (off < options.right_cells)
    clear = right | ~patches.panel | (off > options.wrong_cells)
    score = functional.binary_cross_entropy_with_logits(
        logit, right.float(), reduction="none"
    )
    far = functional.smooth_l1_loss(
        moves, truth, beta=options.move_beta, reduction="none"
    ).mean((1, 2))
    loss: Tensor = (score * clear).sum() / clear.sum().clamp(min=1)
    moved = (far * reached).sum() / reached.sum().clamp(min=1)
    loss = loss + options.move_weight * moved
    return loss
