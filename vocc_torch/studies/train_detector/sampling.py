"""Batches of pictures of candidates, whichever network they are for: near and far from panels, and of clutter."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.receiver.resample import map_points
from vocc_torch.studies.train_detector.candidates import (
    Found,
    best_of_frames,
    joined,
    with_truth,
)
from vocc_torch.studies.train_detector.composition import Likeness, with_panels
from vocc_torch.studies.train_detector.crops import empty_crops, pictures
from vocc_torch.studies.train_detector.draws import Draws
from vocc_torch.studies.train_detector.finish import finished
from vocc_torch.studies.train_detector.geometry import (
    homography,
    mapped,
    ordered,
    rearranged,
    turns,
)
from vocc_torch.studies.train_detector.pool import Pool
from vocc_torch.types import PanelShape


class Pictures(NamedTuple):
    """Pictures (B,H,W), panels' corners (B,4,2) in them, zeros without one, and whether they show one (B,)."""

    grey: Tensor
    quads: Tensor
    panel: Tensor


def pictures_of(
    panels: Sequence[tuple[Tensor, Tensor]], others: Sequence[Tensor]
) -> Pictures:
    """Put pictures with panels' corners and pictures without a panel into a batch."""
    grey = torch.cat([*(picture for picture, _ in panels), *others])
    quads = torch.cat([corners for _, corners in panels])
    empty = len(grey) - len(quads)
    panel = torch.arange(len(grey), device=grey.device) < len(quads)
    return Pictures(grey, functional.pad(quads, (0, 0, 0, 0, 0, empty)), panel)


class Sampler(ABC):
    """Draws the batches that a network is trained on.

    Args:
        pool: what pictures are cut from.
        scale: of a batch, 1 for the usual size.
    """

    def __init__(self, pool: Pool, scale: int = 1) -> None:
        self.pool, self.scale = pool, scale

    @abstractmethod
    def mine(self, networks: Networks, frames: Tensor) -> None:
        """Take from frames what the networks find."""

    @abstractmethod
    def loss(self, net: Any, generator: torch.Generator) -> Tensor:
        """Give the loss of a batch."""


@dataclass(frozen=True)
class CandidateTraining:
    """Settings of the training of a network that sees candidates; lengths in the units of its pictures."""

    shapes: tuple[tuple[int, int], ...]  # rows and columns, one of them a batch
    shape_shares: tuple[float, ...]
    # Pictures of a batch.
    rendered: int  # with a rendered panel
    counterexamples: int  # without a panel
    mined: int  # candidates of the network before, without a panel
    # How far candidates are off, and how often.
    rough: tuple[float, ...]
    rough_shares: tuple[float, ...]
    # Standard deviations at a roughness of 1.
    size: float  # of the logarithm
    aspect: float  # of the logarithm
    shift: float  # steps
    bend: float  # of each corner, steps
    small: float  # shift of candidates that are taken again
    soft_px: float  # of LEDs' edges
    blur_px: tuple[float, float]
    mined_of_frame: int
    mined_again: int  # of a frame, after the network has moved them
    turn: float = 0.0
    composed: int = 36  # with a panel that is laid into a picture
    proposed: int = 20  # candidates of the network before, with a panel


@dataclass(frozen=True)
class Form:
    """Pictures of candidates of one kind of shapes.

    Args:
        shape: of the panels.
        cells: in whose cells the network moves corners.
        size: height and width, px.
        nominal: (4,2) a candidate's corners, in units.
        margin: of a picture, units.
        unit_px: px of a unit.
        step: (2,) units by which candidates are shifted.
        laid: (K,2) rows and columns of panels that are laid into pictures.
        panels: (N,) bool, which of the pool's frames show such a panel.
        mined: (N,) bool, which frames are mined.
        share: pictures in the time of one of the smallest.
    """

    shape: PanelShape
    cells: PanelShape
    size: tuple[int, int]
    nominal: Tensor
    margin: float
    unit_px: float
    step: Tensor
    laid: Tensor
    panels: Tensor
    mined: Tensor
    share: float = 1.0

    def px(self, places: Tensor) -> Tensor:
        """Give places in px of the picture."""
        return (places + self.margin) * self.unit_px

    def turns(self, draws: Draws) -> Tensor:
        """Draw orders of corners that leave the picture's size as it is."""
        return turns(draws, self.size[0] == self.size[1])

    def read(self, pool: Pool, frame: Tensor, quads: Tensor, places: Tensor) -> Tensor:
        """Read pictures in which corners (B,4,2) px of frames lie at places (B,4,2)."""
        return pictures(pool, frame, quads, self.px(places), self.size)


class CandidateSampler(Sampler):
    """Draws pictures of candidates, as far off as those of the network before."""

    settings: CandidateTraining

    def __init__(self, pool: Pool, scale: int = 1) -> None:
        super().__init__(pool, scale)
        shapes = enumerate(self.settings.shapes)
        self.forms = [self.form(number, PanelShape(*shape)) for number, shape in shapes]
        self.near: list[Found] = []
        self.clutter: list[Found] = []
        self.moved: list[Found] = []

    @abstractmethod
    def form(self, number: int, shape: PanelShape) -> Form:
        """Give the pictures of one of the shapes."""

    @abstractmethod
    def candidates(self, networks: Networks, frames: Tensor) -> Found:
        """Give what the networks before find."""

    @abstractmethod
    def looked(
        self, networks: Networks, form: Form, grey: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Give logits (B,) and corners (B,4,2), cells, as the network sees them in pictures."""

    @abstractmethod
    def counterexamples(self, draws: Draws, form: Form) -> Tensor:
        """Draw pictures without a panel."""

    def batch(self, generator: torch.Generator) -> tuple[Form, Pictures]:
        """Draw a batch of pictures of one form."""
        options = self.settings
        shares = torch.tensor(options.shape_shares, device=generator.device)
        number = int(torch.multinomial(shares, 1, generator=generator))
        form = self.forms[number]

        def draws(count: int) -> Draws:
            count = round(self.scale * count * form.share)
            return Draws(generator, max(1, count))

        panels = [self.composed(draws(options.composed), form)]
        frames = (form.panels & self.pool.readable).nonzero()[:, 0]
        if len(frames):
            panels.append(self.rendered(draws(options.rendered), form, frames))
        if self.near and len(self.near[number].frame):
            near = self.near[number]
            panels.append(self.taken(draws(options.proposed), form, near))
        others = [self.counterexamples(draws(options.counterexamples), form)]
        if self.clutter and len(self.clutter[number].frame):
            clutter = self.clutter[number]
            others.append(self.taken(draws(options.mined), form, clutter)[0])
        return form, pictures_of(panels, others)

    def off(self, draws: Draws, form: Form) -> Tensor:
        """Draw where panels' corners (B,4,2) lie in pictures of candidates that are off."""
        options = self.settings
        rough = draws.chosen(options.rough, options.rough_shares)[:, None, None]
        size = options.size * draws.normal(1, 1) + options.aspect * draws.normal(1, 2)
        middle = form.nominal.mean(0)
        quads = (form.nominal - middle) * (rough * size).exp()
        turn = rough[:, 0] * self.turn(draws)
        (x, y), sine, cosine = quads.unbind(2), turn.sin(), turn.cos()
        quads = torch.stack([x * cosine - y * sine, x * sine + y * cosine], 2)
        moved = options.shift * draws.normal(1, 2) + options.bend * draws.normal(4, 2)
        return middle + quads + rough * moved * form.step

    def turn(self, draws: Draws) -> Tensor:
        """Draw angles (B,1) at a roughness of 1."""
        return self.settings.turn * draws.normal(1)

    def behind(self, draws: Draws, form: Form) -> Tensor:
        """Cut pictures without a panel."""
        high, wide = form.size
        crops = empty_crops(self.pool, draws, max(high, wide))
        return crops[:, :high, :wide].contiguous()

    def laid(
        self, draws: Draws, form: Form, places: Tensor, likeness: Likeness | None = None
    ) -> Tensor:
        """Lay panels, or lattices that are none, into pictures with their corners at places."""
        shapes = form.laid[draws.below(len(form.laid))]
        behind, soft_px = self.behind(draws, form), self.settings.soft_px
        shown = with_panels(behind, form.px(places), shapes, draws, soft_px, likeness)
        return finished(shown, draws, self.settings.blur_px)

    def composed(self, draws: Draws, form: Form) -> tuple[Tensor, Tensor]:
        """Lay panels into pictures."""
        places = self.off(draws, form)
        return self.laid(draws, form, places), places

    def rendered(
        self, draws: Draws, form: Form, panels: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Read rendered panels so that their corners lie where they are asked for."""
        frame = panels[draws.below(len(panels))]
        corners = ordered(self.pool.corners_px[frame].float())
        corners = rearranged(corners, form.turns(draws))
        places = self.off(draws, form)
        return finished(form.read(self.pool, frame, corners, places), draws), places

    def taken(self, draws: Draws, form: Form, found: Found) -> tuple[Tensor, Tensor]:
        """Read candidates, moved a little, and give the panels' corners."""
        some = found.rows(draws.below(len(found.frame)))
        places = form.nominal + self.settings.small * draws.normal(1, 2)
        # The corners of the candidate and of the panel begin alike.
        order = form.turns(draws)
        corners, truth = (rearranged(quad, order) for quad in (some.quads, some.truth))
        seen = form.read(self.pool, some.frame, corners, places)
        truth = mapped(homography(corners, places), truth.mT).mT
        return finished(seen, draws), truth

    def mine(self, networks: Networks, frames: Tensor) -> None:
        """Take the candidates of each form, also after the network has moved them once and twice."""
        found = self.candidates(networks, frames)
        found = best_of_frames(found, self.settings.mined_of_frame)
        self.near, self.clutter, self.moved = [], [], []
        for form in self.forms:
            looks = [found.rows(form.mined[found.frame])]
            for _ in range(2):
                looks.append(self.look(networks, form, looks[-1]))
            parts = [with_truth(self.pool, look) for look in looks]
            self.near.append(joined([near for near, _ in parts]))
            self.clutter.append(joined([clutter for _, clutter in parts]))
            self.moved.append(looks[-1])

    def look(self, networks: Networks, form: Form, found: Found) -> Found:
        """Let the network score candidates and move their corners."""
        parts = [found.rows(slice(0))]
        for some in found.parts():
            places = form.nominal.expand_as(some.quads)
            grey = form.read(self.pool, some.frame, some.quads, places)
            logit, cells = self.looked(networks, form, grey)
            quads = map_points(some.quads, cells.double(), form.cells).float()
            parts.append(some._replace(quads=quads, score=logit))
        return best_of_frames(joined(parts), self.settings.mined_again)
