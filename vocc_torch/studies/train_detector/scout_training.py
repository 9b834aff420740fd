"""Training of the scout, on crops with and without panels."""

from dataclasses import dataclass

import torch
from kornia.losses import binary_focal_loss_with_logits
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.detector import scout
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.receiver.resample import (
    cell_homography,
    corner_cells,
    grid_places,
    sample_cells,
)
from vocc_torch.studies.train_detector.pool import Form
from vocc_torch.studies.train_detector.sampling import (
    UNIT,
    Found,
    NetworkTraining,
    Pictures,
    Sampler,
    ordered,
    panels_of,
    proposals,
)
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class ScoutTraining(NetworkTraining):
    """Settings of the training."""

    shapes: tuple[tuple[int, int, float], ...] = ((1, 1, 1.0),)  # whatever they are
    rendered: int = 38
    near: int = 0
    clutter: int = 34
    crop_px: int = 128
    least_pitch_px: float = 1.8  # of LEDs that the scout is to find
    most_pitch_px: float = 4.6  # the next level shows larger ones
    most_side_px: float = 37.0  # of panels of few LEDs, that larger levels show, too
    edges: float = 0.12  # share of crops, for each side, in which the frame ends
    edge_room: float = 0.35  # of a crop without a panel, within which it ends
    off_px: float = 45.0  # of a panel from a crop's middle, at most
    scaled: float = 0.4  # share of crops at another scale than a level's
    scale: tuple[float, float] = (0.75, 1.4)
    near_px: float = 6.0  # outputs so near the centre are to find the panel
    spare_share: float = 0.45  # of a side, within which others may
    corner_weight: float = 12.0
    small_px: float = 30.0  # diagonal of panels whose corners' errors count fully
    corner_beta: float = 0.05
    alike: float = 1.2  # ratio to a limit of sizes, within which panels may be of both
    other_weight: float = 0.5  # of scores for other sizes where a panel is


SETTINGS = ScoutTraining()


class ScoutSampler(Sampler):
    """Draws crops of levels."""

    settings = SETTINGS

    def form(self, shape: PanelShape) -> Form:
        """Give the crop."""
        return Form(shape, UNIT, (SETTINGS.crop_px,) * 2)

    def panels(self, form: Form) -> Found:
        """Give the readable panels on each level on which the scout is to find them."""
        options, pool = SETTINGS, self.pool
        levels = torch.arange(len(pool.sizes), device=pool.device)
        pitch = pool.pitch_px[:, None] / 2.0**levels
        side = pitch * pool.shapes.prod(1, keepdim=True).sqrt()
        small = (pitch <= options.most_pitch_px) | (side <= options.most_side_px)
        seen = (pitch >= options.least_pitch_px) & small
        return panels_of(pool, *(seen & pool.readable[:, None]).nonzero().unbind(1))

    def moved(self, found: Found, form: Form, rough: bool) -> Tensor:
        """Lay crops about candidates (n,4,2) px, at whole pixels of their levels; some at another scale."""
        options, count = SETTINGS, (len(found.frame), 1, 1)
        draw = torch.rand(2, *count, device=self.pool.device).double()
        low, high = options.scale
        scale = torch.where(
            draw[0] < options.scaled, low * (high / low) ** draw[1], 1.0
        )
        size = 2.0 ** found.level[:, None, None]
        off = 2 * torch.rand(len(found.frame), 1, 2, device=size.device) - 1
        centre = found.quads.mean(1, keepdim=True) + off * options.off_px * size
        centre = (centre / size).round() * size
        corners = corner_cells(UNIT).to(centre) - 0.5
        return centre + options.crop_px * size * scale * corners

    def seen(self, found: Found, quads: Tensor, form: Form) -> Pictures:
        """Read crops; what lies beyond a frame has a mean grey value, as in the scout's pictures of levels."""
        crops = super().seen(found, quads, form)
        across = sample_cells(1, SETTINGS.crop_px, 0).to(quads)
        at = grid_places(cell_homography(quads, UNIT), across, across)
        most = at.new_tensor(self.pool.sizes[0]).flip(0)[:, None, None]
        inside = ((at > 0) & (at < most)).all(1) & self.within(crops)
        mean = crops.grey.mean((1, 2), keepdim=True)
        return crops._replace(grey=torch.where(inside, crops.grey, mean))

    def within(self, crops: Pictures) -> Tensor:
        """Say where crops are within frames (n,H,W) that end, in some, between the crop's edge and the panel."""
        options, corners = SETTINGS, crops.corners
        room = torch.stack([corners.amin(1), 1 - corners.amax(1)])
        room = room.where(crops.panel[:, None], options.edge_room).clamp(min=0)
        ends, deep = torch.rand(2, *room.shape, device=room.device)
        first, last = ((ends < options.edges) * deep.sqrt() * room)[..., None]
        at = sample_cells(1, options.crop_px, 0).to(room)
        across, down = ((at > first) & (at < 1 - last)).unbind(1)
        inside: Tensor = down[:, :, None] & across[:, None]
        return inside

    def mine(self, networks: Networks, frames: Tensor) -> None:
        """Find places in frames without a panel that the scout takes for one."""
        empty = frames[self.pool.empty[frames]]
        self.clutter = [proposals(networks.scout, self.pool, empty)]

    def loss(self, net: scout.Scout) -> Tensor:
        """Give the focal loss of scores and the distance of corners where a panel is, of a batch."""
        _, batch = self.batch()
        outputs = net(batch.grey[:, None])
        options, stride = SETTINGS, scout.SETTINGS.stride_px
        high, wide = outputs.shape[2:]
        quads = ordered(batch.corners) * options.crop_px
        places = torch.cartesian_prod(torch.arange(high), torch.arange(wide))
        places = ((places.view(high, wide, 2).flip(2) + 0.5) * stride).to(outputs)
        centre = quads.mean(1)[:, None, None]
        apart = (places - centre).norm(dim=3)
        size = (quads[:, 0] - quads[:, 2]).norm(dim=1)[:, None, None]
        panel = batch.panel[:, None, None]
        spare = (apart < options.spare_share * size) & panel
        nearest = apart <= apart.amin((1, 2), keepdim=True)
        inside = ((centre > 0) & (centre < high * stride)).all(3)
        near = (apart < options.near_px) | (nearest & (apart < stride))
        there = panel & inside & near
        own, others = sizes_of(batch.shapes)
        logit = outputs[:, : scout.SCORES]
        right = (there[:, None] & own).float()
        cost = binary_focal_loss_with_logits(logit, right, alpha=None)
        rare = torch.where((spare | there)[:, None], options.other_weight * others, 1.0)
        cost = cost * torch.maximum(right, rare)
        picture, row, column = there.nonzero().unbind(1)
        found = scout.quads_of(
            outputs[picture, :, row, column], torch.stack([column, row], 1)
        )
        # Of small panels a pixel is more of a cell.
        unit = (size / options.small_px).clamp(min=0.1)[
            picture
        ] * scout.SETTINGS.unit_px
        off = (found - quads[picture]) / unit
        corners = functional.smooth_l1_loss(
            off, torch.zeros_like(off), beta=options.corner_beta, reduction="sum"
        )
        loss = options.corner_weight * corners / 8 + cost.sum()
        mean: Tensor = loss / there.sum().clamp(min=1)
        return mean


def sizes_of(shapes: Tensor) -> tuple[Tensor, Tensor]:
    """Say of the sizes of panels (B,2) which score is theirs, and which are surely not, (B,3,1,1) bool each."""
    side = shapes.float().prod(1, keepdim=True).sqrt()
    limits, alike = side.new_tensor(scout.SETTINGS.sizes), SETTINGS.alike
    least, own, most = (
        torch.bucketize(side * ratio, limits, right=True)
        for ratio in (1 / alike, 1, alike)
    )
    number = torch.arange(scout.SCORES, device=side.device)
    others = (number < least) | (number > most)
    return (number == own)[..., None, None], others[..., None, None]
