"""Batches of pictures that a network is trained on: of panels, of clutter, and of what the networks find."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from kornia import augmentation
from torch import Tensor, nn

from vocc_torch.receiver.detector.placer import corner_orders
from vocc_torch.receiver.detector.scout import propose
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.receiver.resample import cell_homography, corner_cells, map_cells
from vocc_torch.studies.train_detector.pool import Form, Pool
from vocc_torch.types import Batched, PanelShape

UNIT = PanelShape(1, 1)


@dataclass(frozen=True)
class SamplingSettings:
    """What counts as a candidate, and how often it is seen."""

    near: float = 0.3  # of a side, corners that a network can move to the panel
    clear: float = 0.6  # of a diagonal, centres farther away are of clutter
    least_weight: float = 0.05  # of unlikely candidates in a draw; likely ones have 1


SETTINGS = SamplingSettings()


def camera_effects() -> nn.Sequential:
    """Give what cameras do to pictures (B,1,H,W) of 0 to 1.

    A share ``p`` of the pictures has each effect. The blur's kernel and standard deviation are in px; light and
    noise are shares of white; contrast, brightness and gamma are factors and exponents.
    """
    return nn.Sequential(
        augmentation.RandomGaussianBlur((9, 9), (0.3, 1.6), "replicate", p=0.4),
        augmentation.RandomSharpness(1.0, p=0.2),
        augmentation.RandomLinearIllumination((0.01, 0.2), p=0.2),
        augmentation.RandomContrast((0.5, 1.5)),
        augmentation.RandomBrightness((0.95, 1.1)),
        augmentation.RandomGamma((0.45, 0.9), p=0.35),
        augmentation.RandomGaussianNoise(std=0.004, p=0.65),
        augmentation.RandomGaussianNoise(std=0.02, p=0.35),
    )


@dataclass(frozen=True, slots=True)
class Found(Batched):
    """Candidates of frames.

    Args:
        frame: (n,) numbers of frames.
        level: (n,) of the pyramid, where the scout found them.
        quads: (n,4,2) float64 corners, px of the frame.
        score: (n,) logits.
        truth: (n,4,2) the panel's true corners, zeros without one.
    """

    frame: Tensor
    level: Tensor
    quads: Tensor
    score: Tensor
    truth: Tensor

    def drawn(self, count: int) -> "Found":
        """Draw some, likely ones more often; none where there are none."""
        if not len(self.frame):
            return self
        weight = self.score.sigmoid() + SETTINGS.least_weight
        return self[weight.multinomial(count, replacement=True)]


class Pictures(NamedTuple):
    """Pictures of candidates.

    Args:
        grey: (B,H,W).
        corners: (B,4,2) panels' corners in the candidates' cells, zeros without one.
        panel: (B,) whether they show one.
        shapes: (B,2) rows and columns of the panel that is looked for.
    """

    grey: Tensor
    corners: Tensor
    panel: Tensor
    shapes: Tensor


@dataclass(frozen=True)
class NetworkTraining:
    """Settings of a network's training."""

    # Rows and columns, of which a batch has one, and how often it is that one.
    shapes: tuple[tuple[int, int, float], ...]
    # Pictures of a batch.
    rendered: int  # with a panel, about its true corners
    near: int  # candidates of the networks before, with a panel
    clutter: int  # candidates of the networks before, without a panel


class Sampler(ABC):
    """Draws the batches that a network is trained on, by torch's own generator.

    Args:
        pool: what pictures are read from.
        scale: of a batch, 1 for the usual size.
    """

    settings: NetworkTraining

    def __init__(self, pool: Pool, scale: int = 1) -> None:
        self.pool, self.scale = pool, scale
        self.effects = camera_effects()
        shapes = self.settings.shapes
        self.forms = [self.form(PanelShape(*sides)) for *sides, _ in shapes]
        self.rendered = [self.panels(form) for form in self.forms]
        nothing = [found[:0] for found in self.rendered]
        self.near, self.clutter = nothing, nothing

    @abstractmethod
    def form(self, shape: PanelShape) -> Form:
        """Give what the network sees of panels of a shape."""

    @abstractmethod
    def panels(self, form: Form) -> Found:
        """Give the pool's panels of a form, at their true corners."""

    @abstractmethod
    def moved(self, found: Found, form: Form, rough: bool) -> Tensor:
        """Move the corners (n,4,2) of candidates: of panels as far as candidates are off, or by a little."""

    @abstractmethod
    def mine(self, networks: Networks, frames: Tensor) -> None:
        """Take from frames what the networks find."""

    @abstractmethod
    def loss(self, net: Any) -> Tensor:
        """Give the loss of a batch."""

    def batch(self) -> tuple[Form, Pictures]:
        """Draw a batch of pictures of one form, whose rows are columns in half of the batches."""
        options = self.settings
        there = torch.tensor([len(found.frame) > 0 for found in self.rendered])
        shares = torch.tensor([share for _, _, share in options.shapes])
        number = int((shares * there).multinomial(1))
        form = self.forms[number]
        # Larger pictures take longer.
        share = self.scale * self.forms[0].px / form.px
        sources = (
            (self.rendered, options.rendered),
            (self.near, options.near),
            (self.clutter, options.clutter),
        )
        parts = [
            found[number].drawn(max(1, round(share * count)))
            for found, count in sources
        ]
        quads = torch.cat(
            [self.moved(found, form, found is parts[0]) for found in parts]
        )
        found = Found.cat(parts)
        transposed = bool(torch.rand(()) < 0.5)
        # Pictures are turned and mirrored; in the second half rows are columns.
        orders, others = corner_orders(square=True).chunk(2)
        if transposed:
            form, orders = form.transposed, others
        order = orders[torch.randint(len(orders), (len(quads), 1))]
        order = order.mT.expand(-1, -1, 2).to(quads.device)
        found = replace(found, truth=found.truth.gather(1, order))
        pictures = self.seen(found, quads.gather(1, order), form)
        if transposed:
            pictures = pictures._replace(shapes=pictures.shapes.flip(1))
        return form, pictures

    def seen(self, found: Found, quads: Tensor, form: Form) -> Pictures:
        """Read pictures about corners (n,4,2) px of the frames of candidates."""
        shown = self.pool.read(found.frame, quads, form)[:, None] / 255
        grey = 255 * self.effects(shown)[:, 0].clamp(0, 1)
        panel = found.truth.flatten(1).any(1)
        corners = cells_at(found.truth, quads, form.cells).float()
        corners = corners * panel[:, None, None]
        return Pictures(grey, corners, panel, self.pool.sought[found.frame])


def panels_of(pool: Pool, frame: Tensor, level: Tensor) -> Found:
    """Give the panels of frames (n,) at their true corners, as seen in levels (n,)."""
    corners = pool.corners_px[frame]
    score = torch.zeros_like(frame, dtype=torch.float32)
    return Found(frame, level, corners, score, corners)


def proposals(net: nn.Module, pool: Pool, frames: Tensor) -> Found:
    """Take the scout's candidates of frames."""
    parts = [panels_of(pool, frames[:0], frames[:0])]
    shapes = pool.sought[frames].tolist()
    for frame, sides in zip(frames.tolist(), shapes, strict=True):
        shape = PanelShape(*sides)
        quads, score, level = propose(net, pool.pyramid(frame), shape)
        number = torch.full_like(level, frame)
        parts.append(Found(number, level, quads, score, torch.zeros_like(quads)))
    return Found.cat(parts)


def with_truth(pool: Pool, found: Found) -> tuple[Found, Found]:
    """Split candidates into panels and clutter; candidates in between are left out."""
    truth = ordered(pool.corners_px[found.frame])
    off = cells_at(truth, found.quads, UNIT) - corner_cells(UNIT).to(truth)
    readable = pool.readable[found.frame]
    near = readable & (off.abs().amax((1, 2)) < SETTINGS.near)
    apart = (found.quads.mean(1) - truth.mean(1)).norm(dim=1)
    sizes = [(quads[:, 0] - quads[:, 2]).norm(dim=1) for quads in (truth, found.quads)]
    far = readable & (apart > SETTINGS.clear * torch.maximum(*sizes))
    panels = replace(found, truth=truth)[near]
    return panels, found[far | pool.empty[found.frame]]


def cells_at(points: Tensor, quads: Tensor, shape: PanelShape) -> Tensor:
    """Give the cells (n,P,2) of candidates (n,4,2) px at points (n,P,2) px.

    Corners that are no quadrilateral give finite numbers without meaning.

    Example:
        >>> quads = torch.tensor([[[2.0, 3.0], [10.0, 3.0], [10.0, 11.0], [2.0, 11.0]]]).double()
        >>> cells_at(quads, quads, PanelShape(4, 8))[0].round(decimals=6).tolist()
        [[0.0, 0.0], [8.0, 0.0], [8.0, 4.0], [0.0, 4.0]]
    """
    inverse, _ = torch.linalg.inv_ex(cell_homography(quads, shape))
    return map_cells(inverse.nan_to_num(), points)


def ordered(quads: Tensor) -> Tensor:
    """Begin corners (n,4,2) at the top left, clockwise."""
    area = torch.stack([quads, quads.roll(-1, 1)], 2).det().sum(1)
    quads = torch.where(area[:, None, None] < 0, quads.flip(1), quads)
    first = quads.sum(2).argmin(1)[:, None] + torch.arange(4, device=quads.device)
    return quads.gather(1, (first % 4)[..., None].expand(-1, -1, 2))
