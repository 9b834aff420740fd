"""Training of the judge, on pictures of candidates near and far from panels."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.detector import judge as judging
from vocc_torch.receiver.detector.judge import SQUARE, Judge, corners_of
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.studies.train_detector.candidate_training import (
    CandidateSampler,
    CandidateTraining,
)
from vocc_torch.studies.train_detector.pool import Form
from vocc_torch.studies.train_detector.sampling import Found, Pictures, proposals
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class JudgeTraining(CandidateTraining):
    """Settings of the training; a candidate's side has 14 cells."""

    shapes: tuple[tuple[int, int], ...] = ((8, 8), (8, 16), (16, 16), (8, 32))
    shape_shares: tuple[float, ...] = (0.6, 0.15, 0.17, 0.08)
    rendered: int = 50
    near: int = 20
    clutter: int = 58
    rough: tuple[float, ...] = (0.1, 0.3, 0.3, 0.6, 0.6, 1.0, 1.3)
    size: float = 0.16
    aspect: float = 0.08
    turn: float = 0.15
    shift: float = 1.3
    bend: float = 0.56
    small: float = 0.28
    map_weight: float = 0.5
    corner_weight: float = 0.3
    corner_beta_px: float = 0.5


SETTINGS = JudgeTraining()


class JudgeSampler(CandidateSampler):
    """Draws pictures of the scout's candidates."""

    settings = SETTINGS

    def form(self, shape: PanelShape) -> Form:
        """Give the picture of shapes that the judge sees alike."""
        samples = judging.samples_of(shape)
        return Form(shape, SQUARE, samples, judging.SETTINGS.margin)

    def shows(self, form: Form) -> Tensor:
        """Say in which frames (N,) a panel is looked for whose picture has the form's size."""
        sizes = [
            judging.samples_of(PanelShape(*sides)) == form.samples
            for sides in self.pool.sought.tolist()
        ]
        return torch.tensor(sizes, device=self.pool.device)

    def candidates(self, networks: Networks, frames: Tensor) -> Found:
        """Give the scout's candidates."""
        return proposals(networks.scout, self.pool, frames)

    def looked(
        self, networks: Networks, form: Form, grey: Tensor, shapes: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Give logits (B,) and corners (B,4,2), cells."""
        logit, maps = networks.judge(grey, judging.waves_of(shapes, form.samples))
        return logit, judging.parts_of(corners_of(maps), form.shape)

    def loss(self, net: Judge) -> Tensor:
        """Give the loss of a batch."""
        form, batch = self.batch()
        waves = judging.waves_of(batch.shapes, form.samples)
        logit, maps = net(batch.grey, waves)
        return judge_loss(logit, maps, form, batch)


def judge_loss(logit: Tensor, maps: Tensor, form: Form, pictures: Pictures) -> Tensor:
    """Give the losses of scores, of maps and of the corners in them."""
    options, heat_px = SETTINGS, judging.SETTINGS.heat_px
    down, across = form.samples
    corners = pictures.corners + form.margin
    corners = corners * corners.new_tensor((across, down))
    high, wide = maps.shape[2:]
    most = corners.new_tensor((wide, high))
    inside = ((corners > 1) & (corners < heat_px * most - 1)).all(2)
    inside &= pictures.panel[:, None]
    # Each corner is shared among the four places around it.
    likely = maps.flatten(2).log_softmax(2).view(-1, 1, high, wide)
    place = (2 * corners / (heat_px * most) - 1).view(-1, 1, 1, 2)
    cost = -functional.grid_sample(
        likely, place, padding_mode="border", align_corners=False
    ).view(-1, 4)
    off = functional.smooth_l1_loss(
        corners_of(maps), corners, beta=options.corner_beta_px, reduction="none"
    )
    cost = options.map_weight * cost + options.corner_weight * off.sum(2)
    score = functional.binary_cross_entropy_with_logits(logit, pictures.panel.float())
    loss: Tensor = score + (cost * inside).sum() / inside.sum().clamp(min=1)
    return loss
