"""Training of judge and placer, on candidates as far off as those of the networks before."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.detector import judge as judging
from vocc_torch.receiver.detector import placer as placing
from vocc_torch.receiver.detector.judge import SQUARE, Judge, judged
from vocc_torch.receiver.detector.placer import SLIPS, Placer, corner_moves, placed
from vocc_torch.receiver.detector.pyramid import Pyramid
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.receiver.resample import corner_cells, map_points
from vocc_torch.studies.train_detector.pool import Form, Pool
from vocc_torch.studies.train_detector.sampling import (
    Found,
    NetworkTraining,
    Pictures,
    Sampler,
    panels_of,
    proposals,
    with_truth,
)
from vocc_torch.types import PanelShape

Look = Callable[[Pyramid, Tensor, PanelShape], tuple[Tensor, Tensor]]
"""Scores (n,) candidates (n,4,2) px of a frame, for panels of a shape, and moves their corners."""


@dataclass(frozen=True)
class JudgeTraining(NetworkTraining):
    """Settings of the judge's training; lengths in cells, of which a candidate's side has 14."""

    shapes: tuple[tuple[int, int, float], ...] = (
        (8, 8, 0.6),
        (8, 16, 0.15),
        (16, 16, 0.17),
        (8, 32, 0.08),
    )
    rendered: int = 50
    near: int = 20
    clutter: int = 58
    # How far candidates are off, one of them with equal chance; what follows is the
    # standard deviation at a roughness of 1.
    rough: tuple[float, ...] = (0.1, 0.3, 0.3, 0.6, 0.6, 1.0, 1.3)
    size: float = 0.16  # of the logarithm
    aspect: float = 0.08  # of the logarithm
    turn: float = 0.15  # radians
    shift: float = 1.3
    bend: float = 0.56  # of each corner
    small: float = 0.28  # shift of candidates that are taken again
    edges: float = 0.1  # share of pictures, for each side, in which the frame ends
    edge_margins: float = 1.2  # deepest edge of the frame, in margins of a picture
    map_weight: float = 0.5
    corner_weight: float = 0.3
    corner_beta_px: float = 0.5


@dataclass(frozen=True)
class PlacerTraining(NetworkTraining):
    """Settings of the placer's training; see :class:`JudgeTraining`."""

    shapes: tuple[tuple[int, int, float], ...] = (
        (8, 8, 3.0),
        (4, 4, 5.0),
        (16, 16, 1.0),
        (4, 8, 1.5),
        (8, 16, 1.0),
        (12, 12, 0.5),
    )
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
    edges: float = 0.1  # share of pictures, for each side, in which the frame ends
    edge_margins: float = 1.2  # deepest edge of the frame, in margins of a picture
    right_cells: float = 0.25  # corners are off at most so much in a right candidate
    wrong_cells: float = 0.6  # and at least so much in a wrong one
    reach_cells: float = 2.0  # farther panels are not learnt to be reached
    move_weight: float = 3.0
    move_beta: float = 0.05  # cells


def looked(
    pool: Pool, found: Found, look: Look, shape: PanelShape | None = None
) -> Found:
    """Let a network score the candidates of each frame and move their corners.

    Args:
        pool: of frames.
        found: candidates, those of a frame one after another.
        look: the network.
        shape: of the panels; None for the one that is looked for in each frame.
    """
    parts = [found[:0]]
    for frame in dict.fromkeys(found.frame.tolist()):
        rows = found[found.frame == frame]
        sought = PanelShape(*pool.sought[frame].tolist())
        score, quads = look(pool.pyramid(frame), rows.quads, shape or sought)
        parts.append(replace(rows, quads=quads, score=score))
    return Found.cat(parts)


class CandidateSampler(Sampler):
    """Draws pictures of candidates."""

    settings: JudgeTraining | PlacerTraining

    @abstractmethod
    def shows(self, form: Form) -> Tensor:
        """Say of which frames (N,) pictures of a form are taken, with a panel or without one."""

    @abstractmethod
    def look(self, networks: Networks, found: Found, form: Form) -> Found:
        """Let the network score candidates of a form and move their corners."""

    def candidates(self, networks: Networks, frames: Tensor) -> Found:
        """Give what the networks before find."""
        return proposals(networks.scout, self.pool, frames)

    def panels(self, form: Form) -> Found:
        """Give the readable panels of a form."""
        frame = (self.shows(form) & self.pool.readable).nonzero()[:, 0]
        return panels_of(self.pool, frame, torch.zeros_like(frame))

    def moved(self, found: Found, form: Form, rough: bool) -> Tensor:
        """Move corners (n,4,2) px in the candidates' cells."""
        count = len(found.frame)
        off = self.settings.small * self.normal(count, 1, 2)
        off = self.off(count, form) if rough else off
        return map_points(
            found.quads, corner_cells(form.cells).to(off) + off, form.cells
        )

    def normal(self, *size: int) -> Tensor:
        """Draw standard normal numbers, float64."""
        return torch.randn(size, device=self.pool.device).double()

    def off(self, count: int, form: Form) -> Tensor:
        """Draw moves (n,4,2) of corners, cells."""
        options = self.settings
        rough = torch.tensor(options.rough, device=self.pool.device).double()
        rough = rough[torch.randint(len(rough), (count, 1, 1))]
        corners = corner_cells(form.cells).to(rough)
        away = corners - corners.mean(0)
        stretch = (rough * options.aspect * self.normal(count, 1, 2)).exp()
        growth, turn = (
            spread * self.normal(count, 1) for spread in (options.size, options.turn)
        )
        power = (rough[:, 0] * torch.complex(growth, turn)).exp()
        turned = torch.view_as_real(torch.view_as_complex(away * stretch) * power)
        shift = options.shift * self.normal(count, 1, 2)
        shift = shift + options.bend * self.normal(count, 4, 2)
        return turned - away + rough * shift

    def mine(self, networks: Networks, frames: Tensor) -> None:
        """Take the candidates of each form, also after the network has moved them once and twice."""
        found = self.candidates(networks, frames)
        self.near, self.clutter = [], []
        for form in self.forms:
            looks = [found[self.shows(form)[found.frame]]]
            for _ in range(2):
                looks.append(self.look(networks, looks[-1], form))
            near, clutter = with_truth(self.pool, Found.cat(looks))
            self.near.append(near)
            self.clutter.append(clutter)

    def seen(self, found: Found, quads: Tensor, form: Form) -> Pictures:
        """Read pictures; in some the frame ends near the panel, or cuts a little of it off."""
        pictures = super().seen(found, quads, form)
        options, grey = self.settings, pictures.grey
        for sides in form.cells.sides:
            deepest = options.edge_margins * form.margin / (sides + 2 * form.margin)
            grey = with_edges(grey.mT, options.edges, deepest)
        return pictures._replace(grey=grey)


class JudgeSampler(CandidateSampler):
    """Draws pictures of the scout's candidates."""

    settings = JudgeTraining()

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

    def look(self, networks: Networks, found: Found, form: Form) -> Found:
        """Let the judge see candidates, each for the panel that is looked for in its frame."""
        return looked(self.pool, found, partial(judged, networks.judge))

    def loss(self, net: Judge) -> Tensor:
        """Give the losses of scores, of maps and of the corners in them, of a batch."""
        form, batch = self.batch()
        logit, maps = net(batch.grey, judging.waves_of(batch.shapes, form.samples))
        options, heat_px = self.settings, judging.SETTINGS.heat_px
        down, across = form.samples
        corners = batch.corners + form.margin
        corners = corners * corners.new_tensor((across, down))
        high, wide = maps.shape[2:]
        most = corners.new_tensor((wide, high))
        inside = ((corners > 1) & (corners < heat_px * most - 1)).all(2)
        inside &= batch.panel[:, None]
        # Each corner is shared among the four places around it.
        likely = maps.flatten(2).log_softmax(2).view(-1, 1, high, wide)
        place = (2 * corners / (heat_px * most) - 1).view(-1, 1, 1, 2)
        cost = -functional.grid_sample(
            likely, place, padding_mode="border", align_corners=False
        ).view(-1, 4)
        off = functional.smooth_l1_loss(
            judging.corners_of(maps),
            corners,
            beta=options.corner_beta_px,
            reduction="none",
        )
        cost = options.map_weight * cost + options.corner_weight * off.sum(2)
        score = functional.binary_cross_entropy_with_logits(logit, batch.panel.float())
        loss: Tensor = score + (cost * inside).sum() / inside.sum().clamp(min=1)
        return loss


class PlacerSampler(CandidateSampler):
    """Draws pictures of the judge's candidates."""

    settings = PlacerTraining()

    def form(self, shape: PanelShape) -> Form:
        """Give the picture of a shape."""
        options = placing.SETTINGS
        return Form(shape, shape, (options.samples,) * 2, options.margin)

    def shows(self, form: Form) -> Tensor:
        """Say which frames (N,) show a panel of the shape; each form has its share of frames without one."""
        shapes, number = self.pool.shapes, self.forms.index(form)
        numbers = torch.arange(len(shapes), device=shapes.device)
        shared = numbers % len(self.forms) == number
        right = (shapes == shapes.new_tensor(form.shape.sides)).all(1)
        return right | (self.pool.empty & shared)

    def candidates(self, networks: Networks, frames: Tensor) -> Found:
        """Give the candidates that the judge has moved twice."""
        found = super().candidates(networks, frames)
        for _ in range(2):
            found = looked(self.pool, found, partial(judged, networks.judge))
        return found

    def look(self, networks: Networks, found: Found, form: Form) -> Found:
        """Let the placer see candidates as panels of the form."""
        look = partial(placed, networks.placer)
        return looked(self.pool, found, look, form.shape)

    def off(self, count: int, form: Form) -> Tensor:
        """Draw moves (n,4,2) of corners, cells; some slip by a cell."""
        draw = torch.rand(2, count, 1, 1, device=self.pool.device).double()
        low, high = self.settings.slips
        size = (draw[0] < self.settings.slipped) * (low + (high - low) * draw[1])
        slips = SLIPS[torch.randint(len(SLIPS), (count,))]
        return super().off(count, form) + size * slips.to(size)

    def loss(self, net: Placer) -> Tensor:
        """Give the losses of scores and of moves, of a batch."""
        form, batch = self.batch()
        logit, cells = net(batch.grey)
        moves = corner_moves(cells, form.shape)
        options, panel = self.settings, batch.panel
        truth = batch.corners - corner_cells(form.shape).to(batch.corners)
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


def with_edges(grey: Tensor, share: float, deepest: float) -> Tensor:
    """Let the frame end within some pictures (n,H,W): beyond its edge its last column is repeated.

    Args:
        grey: the pictures.
        share: of pictures with an edge on the left, and on the right.
        deepest: how far an edge lies within a picture at most, as a share of its width.

    Example:
        >>> grey = torch.arange(20.0).expand(1000, 1, 20)
        >>> ends = with_edges(grey, 0.5, 0.2)[:, 0, [0, -1]]
        >>> ends.amin(0).tolist(), ends.amax(0).tolist()
        ([0.0, 15.0], [4.0, 19.0])
    """
    count, _, wide = grey.shape
    cut, depth = torch.rand(2, 2, count, device=grey.device)
    off = ((cut < share) * depth * (deepest * wide + 1)).long()[..., None]
    columns = torch.arange(wide, device=grey.device)
    columns = columns.maximum(off[0]).minimum(wide - 1 - off[1])
    return grey.gather(2, columns[:, None].expand(grey.shape))
