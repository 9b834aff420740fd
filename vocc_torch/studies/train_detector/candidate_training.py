"""Training of the networks that see candidates: as far off as those of the networks before."""

from abc import abstractmethod
from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.receiver.resample import corner_cells, map_points
from vocc_torch.studies.train_detector.pool import Form
from vocc_torch.studies.train_detector.sampling import (
    Found,
    NetworkTraining,
    Pictures,
    Sampler,
    joined,
    panels_of,
    with_truth,
)

BATCH = 128
"""Candidates that are looked at together."""


@dataclass(frozen=True)
class CandidateTraining(NetworkTraining):
    """Settings of the training; lengths in the candidates' cells."""

    rough: tuple[
        float, ...
    ]  # how far candidates are off, one of them with equal chance
    # Standard deviations at a roughness of 1.
    size: float  # of the logarithm
    aspect: float  # of the logarithm
    turn: float  # radians
    shift: float
    bend: float  # of each corner
    small: float  # shift of candidates that are taken again
    edges: float = 0.1  # share of pictures, for each side, in which the frame ends
    edge_margins: float = 1.2  # deepest edge of the frame, in margins of a picture


class CandidateSampler(Sampler):
    """Draws pictures of candidates."""

    settings: CandidateTraining

    @abstractmethod
    def shows(self, form: Form) -> Tensor:
        """Say of which frames (N,) pictures of a form are taken, with a panel or without one."""

    @abstractmethod
    def candidates(self, networks: Networks, frames: Tensor) -> Found:
        """Give what the networks before find."""

    @abstractmethod
    def looked(
        self, networks: Networks, form: Form, grey: Tensor, shapes: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Give logits (B,) and corners (B,4,2), cells, as the network sees them in pictures of shapes (B,2)."""

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
        self.near, self.clutter, self.last = [], [], list[Found]()
        for form in self.forms:
            looks = [found.rows(self.shows(form)[found.frame])]
            for _ in range(2):
                looks.append(self.look(networks, form, looks[-1]))
            near, clutter = with_truth(self.pool, joined(looks))
            self.near.append(near)
            self.clutter.append(clutter)
            self.last.append(looks[-1])

    def seen(self, found: Found, quads: Tensor, form: Form) -> Pictures:
        """Read pictures; in some the frame ends near the panel, or cuts a little of it off."""
        pictures = super().seen(found, quads, form)
        options, grey = self.settings, pictures.grey
        for axis, sides in ((1, form.cells.rows), (2, form.cells.columns)):
            deepest = options.edge_margins * form.margin / (sides + 2 * form.margin)
            grey = with_edges(grey, axis, options.edges, deepest)
        return pictures._replace(grey=grey)

    def look(self, networks: Networks, form: Form, found: Found) -> Found:
        """Let the network score candidates and move their corners."""
        parts = [found.rows(slice(0))]
        for start in range(0, len(found.frame), BATCH):
            some = found.rows(slice(start, start + BATCH))
            grey = self.pool.read(some.frame, some.quads, form)
            shapes = self.pool.sought[some.frame]
            logit, cells = self.looked(networks, form, grey, shapes)
            quads = map_points(some.quads, cells.double(), form.cells)
            parts.append(some._replace(quads=quads, score=logit))
        return joined(parts)


def with_edges(grey: Tensor, axis: int, share: float, deepest: float) -> Tensor:
    """Let the frame end within some pictures (n,H,W): beyond its edge its last line is repeated.

    Args:
        grey: the pictures.
        axis: 1 for rows, 2 for columns.
        share: of pictures with an edge at the one end, and at the other.
        deepest: how far an edge lies within a picture at most, as a share of its side.

    Example:
        >>> grey = torch.arange(20.0).expand(1000, 1, 20)
        >>> ends = with_edges(grey, 2, 0.5, 0.2)[:, 0, [0, -1]]
        >>> ends.amin(0).tolist(), ends.amax(0).tolist()
        ([0.0, 15.0], [4.0, 19.0])
    """
    count, length = len(grey), grey.shape[axis]
    cut, depth = torch.rand(2, 2, count, device=grey.device)
    off = ((cut < share) * depth * (deepest * length + 1)).long()[..., None]
    lines = torch.arange(length, device=grey.device).expand(count, length)
    lines = lines.maximum(off[0]).minimum(length - 1 - off[1])
    lines = lines[..., None] if axis == 1 else lines[:, None]
    return grey.gather(axis, lines.expand(grey.shape))
