"""Panels found by their lattice of two levels, however bright, with a stated rate of false alarms."""

from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind, finite_number
from vocc_torch.receiver import lattice_fit, lattice_model, rectification
from vocc_torch.receiver.cell_model import Cells, best_places, fit_cells, randomness
from vocc_torch.receiver.false_alarms import calibrated, demand_stated
from vocc_torch.receiver.foreground import ring_statistics
from vocc_torch.receiver.lattice_model import corner_cells
from vocc_torch.receiver.lattice_search import Pyramid, lattice_hypotheses
from vocc_torch.receiver.location import exact_frames
from vocc_torch.types import Frames, Images, PanelShape, Sightings, StatedPanels

# Candidates that are fitted, in cells of both models, and how alike in place and size two are one.
_FITTED, _SAME_PLACE, _SAME_SIZE = 5, 0.05, 0.1
# A step to a neighbouring place may lose as much of what bits explain, a logarithm.
_MOST_LOST = 0.5
# The fit of spots is believed from this share on, and within so many cells of the start; of small panels.
_MIN_SHARE, _FARTHEST_CELLS, _MOST_LEDS, _BLUR_CELLS = 0.97, 0.6, 16, 0.3
_PARTS_PER_PX = 1024.0
_OVERLAP = 0.5


@dataclass(frozen=True, slots=True)
class LatticeLocator:
    """Find panels by what marks them: one pitch, two levels, random bits; whatever is brighter around them.

    - Places of much texture for their contrast, on a pyramid, and in the spectrum there the lattice.
    - The placing by whole cells whose cells two patterns explain best, and a fit of free corners to it.
    - The score: the logarithm of what the bits explain over what they leave, and of how random they look.
    - Where the LEDs look like round spots, corners from :func:`vocc_torch.receiver.lattice_fit.fit_lattice`.

    Of the scene nothing is known but rows and columns.

    Args:
        false_alarms: a panel is found where at most as many false alarms are expected in a frame without one;
            above 0, and with infinity anything is.

    Raises:
        VoccError: a rate that is not above 0.

    Example:
        >>> bits = torch.rand(8, 8, generator=torch.Generator().manual_seed(1)) < 0.5
        >>> grey = torch.full((200, 240), 180.0)
        >>> grey[60:140, 90:170] = 20 + 70 * torch.kron(bits.float(), torch.ones(10, 10))
        >>> panels = LatticeLocator(float("inf"))(Frames.whole(grey.to(torch.uint8)), PanelShape(8, 8))
        >>> panels.found.tolist(), panels.corners_px[0, [0, 2]].round().tolist()
        ([True], [[90.0, 60.0], [170.0, 140.0]])
    """

    false_alarms: float = 1e-3

    def __post_init__(self) -> None:
        """Refuse a rate that is none."""
        if (
            self.false_alarms != float("inf")
            and finite_number("location.false_alarms", self.false_alarms) <= 0
        ):
            raise VoccError.of("location.false_alarms", self.false_alarms, "above 0")

    def __call__(self, frames: Images, shape: PanelShape) -> StatedPanels:
        """Locate the panel of ``shape`` in each frame; zero corners and score where there is none."""
        frames = Frames.of(frames)
        return self.sightings(frames, shape).panels(len(frames), self.false_alarms)[1]

    def sightings(self, frames: Images, shape: PanelShape) -> Sightings:
        """See every panel of ``shape``, those too that are likely false; the best of each frame first.

        Raises:
            VoccError: what :func:`vocc_torch.receiver.location.exact_frames` refuses, or a panel so small
                that no false alarms are stated of it.
        """
        demand_kind("shape", shape, PanelShape)
        exact = exact_frames(frames)
        none = torch.zeros(0, 4, 2, dtype=torch.float64, device=exact.grey.device)
        seen = [Sightings(none[:, 0, 0].long(), none, none[:, 0, 0], none[:, 0, 0])]
        with torch.inference_mode(), torch.autocast(exact.grey.device.type, enabled=False):
            # Frame by frame, so that a batch changes nothing.
            for number in range(len(exact) if exact.grey.numel() else 0):
                seen.append(self._in_one(exact[number : number + 1], shape, number))
        parts = zip(
            *([getattr(one, name) for name in Sightings.__dataclass_fields__] for one in seen), strict=True
        )
        return Sightings(*(torch.cat(part).clone() for part in parts))

    def _in_one(self, frame: Frames, shape: PanelShape, number: int) -> Sightings:
        """See the panels of one frame."""
        cells = _candidates(frame.grey, shape)
        scale = 2.0 ** cells.level.double()[:, None, None]
        corners, score = cells.corners_px * scale, cells.score.double()
        kept: list[int] = []
        middle, size = corners.mean(1), (corners[:, 0] - corners[:, 2]).norm(dim=1)
        for row in score.argsort(descending=True, stable=True).tolist():
            apart = (middle[row] - middle[kept]).norm(dim=1)
            if bool(corners[row].isfinite().all()) and bool((apart > _OVERLAP * size[kept] / 2**0.5).all()):
                kept.append(row)
        corners, score = corners[kept], score[kept]
        any_rate = self.false_alarms == float("inf")
        table = calibrated("lattice", shape) if any_rate else demand_stated("lattice", shape)
        alarms = torch.full_like(score, torch.inf) if table is None else table.expected(score)
        sure = alarms <= self.false_alarms
        corners[sure] = _sharpened(frame, corners[sure], shape)
        corners = (corners * _PARTS_PER_PX).round() / _PARTS_PER_PX + frame.origin_px.double()[:, None]
        return Sightings(torch.full_like(score, number, dtype=torch.int64), corners, score, alarms)


def _candidates(grey: Tensor, shape: PanelShape) -> Cells:
    """Fit the likeliest panels of one frame (1,1,H,W)."""
    pyramid = Pyramid.of(grey, 3 * max(shape.rows, shape.columns) // 2)
    guess = lattice_hypotheses(pyramid, shape)
    if not len(guess.level):
        none = guess.centre_px.new_zeros(0, 4, 2, dtype=torch.float64)
        bits = guess.level.new_zeros(0, shape.rows, shape.columns, dtype=torch.bool)
        return Cells(guess.level, none, bits, guess.strength)
    most = max(shape.rows, shape.columns)
    cell = corner_cells(shape).to(guess.centre_px) - (
        torch.tensor([shape.columns // 2, shape.rows // 2], device=grey.device) + 0.5
    )
    corners = (guess.centre_px[:, None] + cell @ guess.basis_px.mT).double()
    bits = torch.zeros(len(corners), shape.rows, shape.columns, dtype=torch.bool, device=grey.device)
    reach = min(4, max(2, round(0.4 * most)))
    cells = best_places(pyramid, Cells(guess.level, corners, bits, guess.strength), shape, reach)
    scale = 2.0 ** cells.level.double()
    middle = cells.corners_px.mean(1) * scale[:, None]
    size = (cells.corners_px[:, 0] - cells.corners_px[:, 2]).norm(dim=1) * scale
    kept: list[int] = []
    for row in cells.score.argsort(descending=True, stable=True).tolist():
        near = (middle[row] - middle[kept]).norm(dim=1) < _SAME_PLACE * size[row]
        if not bool((near & ((size[row] / size[kept]).log().abs() < _SAME_SIZE)).any()):
            kept.append(row)
        if len(kept) == _FITTED:
            break
    fitted = fit_cells(pyramid, cells[torch.tensor(kept, dtype=torch.int64, device=grey.device)], shape)
    # The lattice's edge: a neighbouring place may have more light of On LEDs.
    for _ in range(2):
        moved = fit_cells(pyramid, best_places(pyramid, fitted, shape, 1, 4, by_light=True), shape, 3)
        explained = [one.score - randomness(one.bits) for one in (fitted, moved)]
        better = explained[1] > explained[0] - _MOST_LOST
        fitted.put(better, moved[better])
    return fitted


def _sharpened(frame: Frames, corners_px: Tensor, shape: PanelShape) -> Tensor:
    """Fit the lattice of spots from corners (n,4,2) px of one frame, where spots they are."""
    if not len(corners_px) or max(shape.rows, shape.columns) > _MOST_LEDS:
        return corners_px
    many = len(corners_px)
    origin_px = torch.zeros_like(frame.origin_px).expand(many, -1)
    frames = Frames(frame.grey.expand(many, -1, -1, -1), origin_px, frame.sensor_px)
    patches = lattice_model.read_patches(frames, corners_px, shape, 2)
    level, _ = ring_statistics(patches[:, None])
    blur = torch.full_like(corners_px[:, 0, 0], _BLUR_CELLS)
    start = lattice_model.Lattice.at(corners_px, blur, level, shape)
    lattice = lattice_fit.fit_lattice(frames, start)
    cell = torch.maximum(*rectification.cell_size_px(corners_px, shape))
    strayed = (lattice.corners_px - corners_px).norm(dim=2).amax(1) > _FARTHEST_CELLS * cell
    good = (lattice.share >= _MIN_SHARE) & ~strayed & lattice.corners_px.isfinite().flatten(1).all(1)
    return torch.where(good[:, None, None], lattice.corners_px, corners_px)
