"""Training of the placer, on cells of candidates that are off by up to a cell, and of clutter."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.detector import placer as placing
from vocc_torch.receiver.detector.placer import Placer
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.receiver.resample import corner_cells
from vocc_torch.studies.train_detector.candidates import (
    Found,
    best_of_frames,
    place_all,
    read_patches,
    with_truth,
)
from vocc_torch.studies.train_detector.composition import (
    Draws,
    Likeness,
    finished,
    homography,
    likenesses,
    mapped,
    with_panels,
)
from vocc_torch.studies.train_detector.crops import empty_crops, ordered, turned
from vocc_torch.studies.train_detector.judge_training import PictureSampler
from vocc_torch.studies.train_detector.pool import Pool
from vocc_torch.studies.train_detector.scout_training import Proposals
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class PlacerTraining:
    """Settings of the training."""

    # Patches of a batch of 156.
    composed: int = 36  # with a panel that is laid into a picture
    alike: int = 28  # with a lattice that is no panel
    rendered: int = 24  # with a rendered panel
    proposed: int = 20  # candidates of the judge, with a panel
    mined: int = 48  # candidates of the judge, without a panel
    # How far candidates are off, and how often.
    rough: tuple[float, ...] = (0.03, 0.15, 0.4, 1.0)
    rough_shares: tuple[float, ...] = (0.25, 0.3, 0.25, 0.2)
    # Standard deviations at a roughness of 1; lengths in cells, the last of a cell and of a side.
    shift: float = 0.8
    bend: float = 0.3
    size: float = 0.04
    slipped: float = 0.35  # share of candidates with a corner or a side some cells off
    slips: tuple[float, float] = (0.6, 1.6)  # cells
    small: float = 0.1  # shift of candidates that are taken again, cells
    soft_px: float = 0.7  # of LEDs' edges
    blur_px: tuple[float, float] = (0.4, 1.7)
    right_cells: float = 0.25  # corners are off at most so much in a right candidate
    wrong_cells: float = 0.6  # and at least so much in a wrong one
    reach_cells: float = 2.0  # farther panels are not learnt to be reached
    move_weight: float = 3.0
    move_beta: float = 0.05  # cells
    mined_of_frame: int = 5
    shape_shares: tuple[float, ...] = (3.0, 5.0, 1.0, 1.5, 1.0, 0.5)


SETTINGS = PlacerTraining()

SHAPES = ((8, 8), (4, 4), (16, 16), (4, 8), (8, 16), (12, 12))
"""Rows and columns, one of them a batch."""


class Patches(NamedTuple):
    """Patches of candidates, the panel's corners (B,4,2) in their cells, and whether they show one (B,)."""

    grey: Tensor
    cells: Tensor
    panel: Tensor


def off_cells(draws: Draws, shape: PanelShape) -> Tensor:
    """Draw where panels' corners (B,4,2), cells, lie in patches of candidates that are off."""
    options = SETTINGS
    rough = torch.tensor(options.rough, device=draws.device)
    shares = torch.tensor(options.rough_shares, device=draws.device)
    scale = rough[draws.chosen(shares)][:, None, None]
    nominal = corner_cells(shape).to(rough)[None]
    middle = nominal.mean(1, keepdim=True)
    stretch = (scale * options.size * draws.normal(1, 2)).exp()
    moved = options.shift * draws.normal(1, 2) + options.bend * draws.normal(4, 2)
    quads = middle + (nominal - middle) * stretch + scale * moved
    return quads + draws.coin(options.slipped)[..., None] * slips(draws)


def slips(draws: Draws) -> Tensor:
    """Draw moves (B,4,2) of a corner or a side, across or down, cells."""
    first, both, down = (draws.below(count, 1) for count in (4, 2, 2))
    corners = torch.arange(4, device=draws.device)
    chosen = (corners == first) | (corners == (first + both) % 4)
    axes = torch.cat([1 - down, down], 1)[:, None]
    size = draws.uniform(*SETTINGS.slips, 1) * (2 * draws.below(2, 1) - 1)
    return (chosen * size)[..., None] * axes


class PatchSampler:
    """Draws patches of candidates.

    Args:
        pool: what they are cut from.
        scale: of the batch, whose usual size is 128.
    """

    def __init__(self, pool: Pool, scale: int = 1) -> None:
        self.pool, self.scale = pool, scale
        self.pictures = PictureSampler(pool)
        self.near: dict[PanelShape, Found] = {}
        self.clutter: dict[PanelShape, Found] = {}

    def batch(self, generator: torch.Generator) -> tuple[PanelShape, Patches]:
        """Draw a batch of patches of one shape."""
        shares = torch.tensor(SETTINGS.shape_shares, device=generator.device)
        number = int(torch.multinomial(shares, 1, generator=generator))
        shape = PanelShape(*SHAPES[number])
        parts = [self.composed(generator, shape)]
        of_shape = self.pool.shapes == torch.tensor(SHAPES[number]).to(shares.device)
        panels = (of_shape.all(1) & self.pool.readable).nonzero()[:, 0]
        if len(panels):
            parts.append(self.rendered(generator, shape, panels))
        near = self.near.get(shape)
        if near is not None and len(near.frame):
            parts.append(self.taken(generator, shape, near, SETTINGS.proposed))
        found = sum(len(cells) for _, cells in parts)
        parts.append(self.alike(generator, shape))
        clutter = self.clutter.get(shape)
        if clutter is not None and len(clutter.frame):
            parts.append(self.taken(generator, shape, clutter, SETTINGS.mined))
        grey, cells = (torch.cat(part) for part in zip(*parts, strict=True))
        panel = torch.arange(len(grey), device=grey.device) < found
        return shape, Patches(grey, cells, panel)

    def composed(
        self, generator: torch.Generator, shape: PanelShape
    ) -> tuple[Tensor, Tensor]:
        """Lay panels into pictures."""
        draws = Draws(generator, self.scale * SETTINGS.composed)
        cells = off_cells(draws, shape)
        return self.laid(draws, shape, cells, None), cells

    def alike(
        self, generator: torch.Generator, shape: PanelShape
    ) -> tuple[Tensor, Tensor]:
        """Lay lattices that are no panels into pictures; their corners are zeros."""
        draws = Draws(generator, self.scale * SETTINGS.alike)
        cells = off_cells(draws, shape)
        shapes = cells.new_tensor([shape.rows, shape.columns]).expand(len(cells), 2)
        likeness = likenesses(draws, shapes)
        return self.laid(draws, shape, cells, likeness), torch.zeros_like(cells)

    def laid(
        self,
        draws: Draws,
        shape: PanelShape,
        cells: Tensor,
        likeness: Likeness | None,
    ) -> Tensor:
        """Draw patches with lattices whose corners lie at places (B,4,2) in cells."""
        options = placing.SETTINGS
        side = (max(shape.rows, shape.columns) + 2 * options.margin) * options.samples
        high, wide = (
            (leds + 2 * options.margin) * options.samples
            for leds in (shape.rows, shape.columns)
        )
        behind = empty_crops(self.pool, draws, side)[:, :high, :wide].contiguous()
        shapes = cells.new_tensor([shape.rows, shape.columns]).expand(len(cells), 2)
        quads = (cells + options.margin) * options.samples
        shown = with_panels(behind, quads, shapes, draws, SETTINGS.soft_px, likeness)
        return finished(shown, draws, SETTINGS.blur_px)

    def rendered(
        self, generator: torch.Generator, shape: PanelShape, panels: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Read rendered panels so that their corners lie where they are asked for."""
        draws = Draws(generator, self.scale * SETTINGS.rendered)
        frame = panels[draws.below(len(panels))]
        square = shape.rows == shape.columns
        corners = turned(draws, ordered(self.pool.corners_px[frame].float()), square)
        cells = off_cells(draws, shape)
        seen = read_patches(self.pool, frame, corners, shape, cells)
        return finished(seen, draws), cells

    def taken(
        self, generator: torch.Generator, shape: PanelShape, found: Found, count: int
    ) -> tuple[Tensor, Tensor]:
        """Read candidates, moved a little; corners are zeros where no panel is."""
        draws = Draws(generator, self.scale * count)
        rows = found.rows(draws.below(len(found.frame)))
        nominal = corner_cells(shape).to(rows.quads)[None].expand_as(rows.quads)
        places = nominal + SETTINGS.small * draws.normal(1, 2)
        # The corners of the candidate and of the panel begin alike.
        order = turned(
            draws,
            torch.arange(4.0, device=nominal.device)[None, :, None].expand(
                draws.count, 4, 2
            ),
            shape.rows == shape.columns,
        )
        order = order.long()
        corners, truth = rows.quads.gather(1, order), rows.truth.gather(1, order)
        seen = read_patches(self.pool, rows.frame, corners, shape, places)
        cells = mapped(homography(corners, places), truth.mT).mT
        cells = torch.where(truth.any(2, keepdim=True), cells, 0.0)
        return finished(seen, draws), cells

    def mine(self, networks: Networks, frames: Tensor) -> None:
        """Take the judge's candidates of each shape, also after the placer has moved them."""
        net, judged = networks.placer, self.pictures.judged(networks, frames)
        found = Proposals(*map(torch.cat, zip(*judged, strict=True)))
        found = best_of_frames(found, SETTINGS.mined_of_frame)
        for rows, columns in SHAPES:
            shape = PanelShape(rows, columns)
            of_shape = self.pool.shapes[found.frame] == found.frame.new_tensor(
                [rows, columns]
            )
            empty = self.pool.shapes[found.frame, 0] == 0
            some = found.rows(of_shape.all(1) | empty)
            first = place_all(net, self.pool, some, shape)
            second = place_all(net, self.pool, first, shape)
            parts = [with_truth(self.pool, one) for one in (some, first, second)]
            near, clutter = (
                Found(*map(torch.cat, zip(*kind, strict=True)))
                for kind in zip(*parts, strict=True)
            )
            self.near[shape], self.clutter[shape] = near, clutter

    def loss(self, net: Placer, generator: torch.Generator) -> Tensor:
        """Give the loss of a batch."""
        shape, patches = self.batch(generator)
        logit, moves = net(patches.grey, shape)
        return placer_loss(logit, moves, shape, patches)


def placer_loss(
    logit: Tensor, moves: Tensor, shape: PanelShape, patches: Patches
) -> Tensor:
    """Give the losses of scores and of moves."""
    options = SETTINGS
    truth = patches.cells - corner_cells(shape).to(patches.cells)
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
