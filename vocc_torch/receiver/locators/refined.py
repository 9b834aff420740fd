"""The refined locator: the detector or a low threshold, then a fit of the lattice of LEDs."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor

from vocc_torch.errors import demand_kind, demand_within
from vocc_torch.receiver import foreground, resample
from vocc_torch.receiver.lattice_fit import FIT, fit_lattice
from vocc_torch.receiver.lattice_model import Lattice, search_lattice
from vocc_torch.receiver.locators.detector import DetectorLocator
from vocc_torch.receiver.locators.paper import (
    PaperLocator,
    exact_frames,
)
from vocc_torch.receiver.locators.protocol import PanelLocator
from vocc_torch.types import (
    Candidates,
    Frames,
    Images,
    Panels,
    PanelShape,
    without_autocast,
)


@dataclass(frozen=True)
class RefinedSettings:
    """Limits of the region and of the lattice fit."""

    most_leds: int = 16  # in a row or a column; larger panels use the paper's locator
    rise_dn: float = (
        1.5  # over the background, from which a pixel of a crop is foreground
    )
    good_share: float = (
        0.9992  # below this share a fit is tried again from other starts
    )
    usual_blur_cells: float = (
        0.45  # of a spot where the fit starts from the edges of the face
    )
    # Sizes of lattices that are tried then: one line of LEDs fewer or more.
    sizes: tuple[float, ...] = (
        0.89,
        1.12,
    )
    farthest_cells: float = 3.5  # a fit that moves farther from its start is rejected
    least_pitch_px: float = 1.5  # finer lattices are noise: LEDs melt together
    parts_per_px: float = 1024.0  # corners are rounded to: sums differ between batches
    face_light: float = 0.1  # a face's light over the background, white being 1, is of this size at most
    ring_px: int = 3  # outermost pixels of a window that give background and noise
    sigma_per_mad: float = 1.4826  # of a normal distribution
    least_probability: float = 0.5  # of a panel that the detector finds
    tie_deg: float = 0.25  # turned by 45 degrees, corners keep their order within it


REFINED = RefinedSettings()


@dataclass(frozen=True)
class RefinedLocator(PanelLocator):
    """Find the panel, then fit the lattice of its LEDs.

    - Region: in a crop with a uniform surround, the blob of brighter pixels with the paper's best score; in any
      other frame the detector's panel, or else the paper's.
    - Lattice: an exhaustive search over pitch, place and blur, then a fit of corners, blur, background and of
      two levels of light, On and Off, to the grey values. A line of Off LEDs is weak, but it is
      part of the picture and of the model. Only the panel's shape is known. Light is assumed to be encoded
      with a gamma of 2.2, and LEDs to be round spots.
    - If the lattice explains less than ``min_share`` of the picture, the panel is the paper's in a crop with a
      uniform surround, and the region in any other frame.

    ``Panels.score`` is the share of the picture's variation that the lattice explains.

    A face between the LEDs that is brighter than the background has its own level in the fit.

    Args:
        paper: the locator ``paper``, for its limits of blobs and for panels that no lattice explains.
        min_share: least share of a picture that a lattice explains, 0 to 1.

    Raises:
        VoccError: ``min_share`` out of its range.

    Example:
        >>> rows = torch.arange(160.0)[:, None] + 0.5
        >>> spots = sum(torch.exp(-(((rows - 62.3 - 5 * n) / 1.7) ** 2) / 2) for n in range(8))
        >>> grey = (255 * (0.15 + 0.5 * spots * spots.mT) ** (1 / 2.2)).round().to(torch.uint8)
        >>> panels = RefinedLocator()(Frames.whole(grey[None]), PanelShape(8, 8))
        >>> panels.corners_px[0, [0, 2]].round(decimals=1).tolist()
        [[59.8, 59.8], [99.8, 99.8]]
    """

    name: ClassVar[str] = "refined"

    paper: PaperLocator = field(default_factory=PaperLocator)
    min_share: float = 0.97

    def __post_init__(self) -> None:
        """Refuse a share out of its range."""
        demand_kind("paper", self.paper, PaperLocator)
        demand_within("location.min_share", self.min_share, 0, 1)

    @classmethod
    def of(cls, paper: PaperLocator, false_alarms: float) -> "RefinedLocator":
        """Build it on the limits of blobs."""
        return cls(paper)

    @classmethod
    def from_settings(cls, values: Mapping[str, Any]) -> "RefinedLocator":
        """Build it from its settings without the name."""
        return cls(**{**values, "paper": PaperLocator(**values["paper"])})

    def locate(self, frames: Images, shape: PanelShape) -> Candidates:
        """Give the panel of each frame.

        Raises:
            VoccError: what :func:`vocc_torch.receiver.locators.paper.exact_frames` refuses.
        """
        return Candidates.of_panels(self(frames, shape))

    def __call__(self, frames: Images, shape: PanelShape) -> Panels:
        """Locate the panel of ``shape`` in each frame; zero corners and score where there is none.

        Raises:
            VoccError: what :func:`vocc_torch.receiver.locators.paper.exact_frames` refuses.
        """
        demand_kind("shape", shape, PanelShape)
        exact = foreground.trimmed(exact_frames(frames))
        if max(shape.sides) > REFINED.most_leds or not exact.grey.numel():
            return self.paper(exact, shape)
        # In half precision a fit would find no lattice.
        with torch.inference_mode(), without_autocast(exact.grey.device):
            is_whole = exact.surround is None
            panels = (self._in_whole if is_whole else self._in_crops)(exact, shape)
        # Copies, for tensors made in inference mode take no part in autograd.
        return panels.each(torch.clone)

    def _in_crops(self, crops: Frames, shape: PanelShape) -> Panels:
        """Find panels in crops with a known surround: fitted, or else the paper's."""
        assert crops.surround is not None
        background = crops.surround.float()
        limit = (background + REFINED.rise_dn).floor().long()
        panels = self.paper.choose(crops, limit, shape)
        rows = panels.found.nonzero()[:, 0]
        if len(rows):
            level = background[rows]
            noise = torch.zeros_like(level)
            panels.found[rows] = self._refit(
                panels, rows, crops[rows], level, noise, shape
            )
        self._left_to_paper(panels, crops, shape)
        return panels

    def _in_whole(self, frames: Frames, shape: PanelShape) -> Panels:
        """Find panels in whole frames: the detector's likeliest or else the paper's, fitted."""
        detected = DetectorLocator(false_alarms=math.inf)(frames, shape)
        likely = detected.score > REFINED.least_probability
        panels = Panels(
            detected.corners_px, likely, detected.score, detected.candidates
        )
        self._left_to_paper(panels, frames, shape)
        for row in panels.found.nonzero():
            corners_px = panels.corners_px[row[0]]
            half = (corners_px.amax(0) - corners_px.amin(0)) / 2
            about = resample.cut_about(frames[row], corners_px, half)
            self._refit(panels, row, about, *ring_level(about.grey), shape)
        return panels

    def _left_to_paper(self, panels: Panels, frames: Frames, shape: PanelShape) -> None:
        """Look for the panels that were not found with the locator ``paper``."""
        rows = (~panels.found).nonzero()[:, 0]
        if len(rows):
            panels.put(rows, self.paper(frames[rows], shape))

    def _refit(
        self,
        panels: Panels,
        rows: Tensor,
        frames: Frames,
        level: Tensor,
        noise: Tensor,
        shape: PanelShape,
    ) -> Tensor:
        """Fit lattices to ``rows`` of the panels, take over the good ones, and say which are good."""
        corners_px = panels.corners_px[rows]
        lattice = _fitted(frames, corners_px, level, noise, shape, self.paper)
        good = lattice.share + _noise_share(lattice, noise) >= self.min_share
        good &= _is_sane(lattice, corners_px)
        corners = _upright(lattice.corners_px[good], shape) * REFINED.parts_per_px
        panels.corners_px[rows[good]] = corners.round() / REFINED.parts_per_px
        panels.score[rows[good]] = lattice.share[good].clamp(0, 1)
        return good


def _fitted(
    frames: Frames,
    corners_px: Tensor,
    background: Tensor,
    noise: Tensor,
    shape: PanelShape,
    paper: PaperLocator,
) -> Lattice:
    """Fit lattices from quadrilaterals; where little is explained, with a face, then from other starts."""
    start, blur = search_lattice(frames, corners_px, background, shape)
    lattice = fit_lattice(frames, Lattice.at(start, blur, background, shape))

    def poor() -> Tensor:
        share = lattice.share_of_all + _noise_share(lattice, noise)
        return (share < REFINED.good_share).nonzero()[:, 0]

    def retry(rows: Tensor, corners: Tensor, width: Tensor, face_light: float) -> None:
        begun = Lattice.at(corners, width, background[rows], shape)
        found = fit_lattice(frames[rows], begun, face_light)
        better = found.rms_dn < lattice.rms_dn[rows]
        lattice.put(rows[better], found[better])

    if len(rows := poor()):
        # The edge of a face that is brighter than the background is found by the paper's threshold.
        face = paper(frames[rows], shape)
        found = face.found[:, None, None]
        edges_px = torch.where(found, face.corners_px.to(start), start[rows])
        width = torch.full_like(blur[rows], REFINED.usual_blur_cells)
        retry(rows, edges_px, width, REFINED.face_light)
    if len(rows := poor()):
        cells = resample.corner_cells(shape).to(start.device)
        middle = cells.mean(0)
        for size in REFINED.sizes:
            sized = (middle + size * (cells - middle)).expand(len(rows), 4, 2)
            corners = resample.map_points(start[rows], sized, shape)
            retry(rows, corners, blur[rows], FIT.no_face)
    return lattice


def _noise_share(lattice: Lattice, noise: Tensor) -> Tensor:
    """Return the share (B,) of a picture's variation that is noise, which no lattice explains."""
    spread = lattice.rms_dn.square() / (1 - lattice.share).clamp(min=1e-9)
    return torch.div(noise.square(), spread.clamp(min=1e-9))


def _is_sane(lattice: Lattice, corners_px: Tensor) -> Tensor:
    """Whether lattices (B,) are finite, not too fine, and near the corners that they began with."""
    cell = torch.maximum(*resample.cell_size_px(corners_px, lattice.shape))
    strayed_px = (lattice.corners_px - corners_px).norm(dim=2).amax(1)
    pitch = torch.minimum(*resample.cell_size_px(lattice.corners_px, lattice.shape))
    # Comparisons with corners that are not finite are false.
    is_near: Tensor = strayed_px <= REFINED.farthest_cells * cell
    return is_near & (pitch >= REFINED.least_pitch_px)


def _upright(corners_px: Tensor, shape: PanelShape) -> Tensor:
    """Rotate the corners' order so that the first side is turned by -45 to 45 degrees, or half a turn off it.

    A square panel looks alike from four sides: the paper's rectangles begin so, and so do these. Turned by 45
    degrees it begins with its topmost corner.
    """
    x, y = (corners_px[:, 1] - corners_px[:, 0]).unbind(1)
    quarter = torch.ceil(
        (torch.atan2(y, x).rad2deg() - 45 - REFINED.tie_deg) / 90
    ).long()
    if shape.rows != shape.columns:
        quarter = torch.where(quarter.abs() == 2, 2, 0)
    index = (torch.arange(4, device=x.device) - quarter[:, None]) % 4
    return corners_px.gather(1, index[..., None].expand(-1, -1, 2))


def ring_level(grey: Tensor) -> tuple[Tensor, Tensor]:
    """Give the background of one frame (1,1,H,W), the median of its outermost pixels, and their deviation."""
    wide, lines = REFINED.ring_px, (grey, grey.mT)
    ends = [end for line in lines for end in (line[..., :wide], line[..., -wide:])]
    ring = torch.cat([end.flatten() for end in ends]).float()
    level = ring.median()[None]
    return level, (ring - level).abs().median()[None] * REFINED.sigma_per_mad
