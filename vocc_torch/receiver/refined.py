"""Where the panel is, in sub-pixels and in noise: our own locator, which fits the lattice of LEDs."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.receiver.lattice_fit import fit_lattice
from vocc_torch.receiver.lattice_model import Lattice, corner_cells, moved
from vocc_torch.receiver.lattice_search import search_lattice
from vocc_torch.receiver.location import PaperLocator, quantised
from vocc_torch.receiver.regions import bright_regions, cut_windows, ring_statistics
from vocc_torch.types import Frames, Panels, PanelShape

MOST_LEDS_REFINED = 16
"""Most LEDs in a row or a column that are searched for; larger panels are left to the paper's locator."""

# Rise over the background that is taken for light: where nothing else varies, in noise, and by its deviation.
_CLEAN_RISE_DN, _LEAST_RISE_DN, _RISE_SIGMAS = 1.5, 3.0, 5.0
# Below this share a fit is tried again from lattices of these sizes.
_GOOD_SHARE, _SIZES = 0.992, (0.89, 1.12)
# A fit that leaves its start farther behind, in cells, is none.
_FARTHEST_CELLS = 3.5
# Finer lattices are noise: LEDs melt together.
_LEAST_PITCH_PX = 1.5
# Corners are given in whole parts of a pixel: sums may be ordered otherwise in other batches.
_PARTS_PER_PX = 1024.0


@dataclass(frozen=True, slots=True)
class RefinedLocator:
    """Find the panel by a low threshold over the local background, then fit the lattice of its LEDs.

    - Region: blocks brighter than the local background by 8 of their own standard deviations; pixels above
      the background of the region by 5 of theirs; of those the blob that the paper's measures take for the
      panel. Where a crop's surround is known, it is the background, and all else the noise.
    - Lattice: an exhaustive search over pitch, place and blur, then a fit of corners, blur, background and of
      two levels of light, On and Off, to the grey values. A line of LEDs that are all Off is weak, but it is
      part of the picture and of the model. Nothing is known of the scene but the panel's shape; light is
      taken to be encoded with a gamma of 2.2, and LEDs to look like round spots.
    - Where no region is found, or the lattice explains less than ``min_share`` of the picture, the panel is
      the paper's.

    ``Panels.score`` is the share of the picture's variation that the lattice explains.

    Args:
        paper: the paper's locator: its limits of blobs, and what falls to it.
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

    paper: PaperLocator = field(default_factory=PaperLocator)
    min_share: float = 0.95

    def __post_init__(self) -> None:
        """Refuse a share out of its range."""
        if not 0 <= self.min_share <= 1:
            raise VoccError(f"location.min_share is {self.min_share}: it must be 0 to 1")

    @torch.no_grad()
    def __call__(self, frames: Frames, shape: PanelShape) -> Panels:
        """Locate the panel of ``shape`` in each frame; zero corners and score where there is none.

        Raises:
            VoccError: grey values that are neither uint8 nor floating, or NaN.
        """
        exact = Frames(quantised(frames.grey), frames.origin_px, frames.sensor_px, frames.surround)
        if max(shape.rows, shape.columns) > MOST_LEDS_REFINED or not len(exact):
            return self.paper(exact, shape)
        panels = Panels.known(exact.origin_px.new_zeros(len(exact), 4, 2))
        panels.found[:] = False
        if exact.surround is not None:
            noise = torch.zeros_like(exact.surround, dtype=torch.float32)
            found = self._fit(exact, exact.surround.to(torch.float32), noise, shape)[0]
            _put(panels, found.found.nonzero()[:, 0], _of(found, found.found))
        else:
            self._fit_regions(exact, shape, panels)
        left = (~panels.found).nonzero()[:, 0]
        if len(left):
            _put(panels, left, self.paper(_taken(exact, left), shape))
        return panels

    def _fit_regions(self, frames: Frames, shape: PanelShape, panels: Panels) -> None:
        """Find panels in the regions of whole frames, in place; of several, the likeliest."""
        regions = bright_regions(frames.grey)
        best = torch.zeros(len(frames), dtype=torch.float64, device=frames.grey.device)
        for side in sorted(set(regions.side_px.tolist())):
            chosen = (regions.side_px == side).nonzero()[:, 0]
            windows = cut_windows(frames, regions, chosen)
            background, noise = ring_statistics(windows.grey)
            found, merit = self._fit(replace(windows, surround=background), background, noise, shape)
            for index in found.found.nonzero()[:, 0]:
                frame = regions.frame[chosen[index]]
                if merit[index] > best[frame]:
                    best[frame] = merit[index]
                    _put(panels, frame[None], _of(found, index[None]))

    def _fit(
        self, crops: Frames, background: Tensor, noise: Tensor, shape: PanelShape
    ) -> tuple[Panels, Tensor]:
        """Find panels in crops, where no lattice fits as the paper does: panels, and their merits (W,)."""
        rise = (_RISE_SIGMAS * noise).clamp(min=_LEAST_RISE_DN).where(noise > 0, _CLEAN_RISE_DN)
        choice = self.paper.choose(crops, (background + rise).floor().long(), shape)
        panels = Panels(choice.corners_px, choice.score > 0, choice.score, choice.candidates)
        seen = panels.found.nonzero()[:, 0]
        if not len(seen):
            return panels, choice.score
        lattice = _fitted(_taken(crops, seen), choice.corners_px[seen], background[seen], noise[seen], shape)
        share = _share_beyond_noise(lattice, noise[seen])
        good = (share >= self.min_share) & _is_sane(lattice, choice.corners_px[seen])
        panels.corners_px[seen[good]] = (lattice.corners_px[good] * _PARTS_PER_PX).round() / _PARTS_PER_PX
        panels.score[seen[good]] = lattice.share[good].clamp(0, 1)
        poor = seen[~good]
        if len(poor):
            _put(panels, poor, self.paper(_taken(crops, poor), shape))
        return panels, choice.score * panels.score**2


def _fitted(
    frames: Frames, corners_px: Tensor, background: Tensor, noise: Tensor, shape: PanelShape
) -> Lattice:
    """Fit lattices from quadrilaterals; where little is explained, again from other starts."""
    start, blur = search_lattice(frames, corners_px, background, shape)
    lattice = fit_lattice(frames, Lattice.at(start, blur, background, shape))
    poor = (_share_beyond_noise(lattice, noise) < _GOOD_SHARE).nonzero()[:, 0]
    if not len(poor):
        return lattice
    seen, level = _taken(frames, poor), background[poor]
    cells = corner_cells(shape).to(start.device)
    middle = cells.mean(0)
    sized = [(middle + size * (cells - middle)).expand(len(poor), 4, 2) for size in _SIZES]
    others = [(moved(start[poor], to, shape), blur[poor]) for to in sized]
    others.append(search_lattice(seen, corners_px[poor], level, shape, square=False))
    for again, width in others:
        found = fit_lattice(seen, Lattice.at(again, width, level, shape))
        better = found.rms_dn < lattice.rms_dn[poor]
        lattice.put(poor[better], found[better])
    return lattice


def _share_beyond_noise(lattice: Lattice, noise: Tensor) -> Tensor:
    """Give the share (B,) that lattices explain of what is not noise."""
    rest = lattice.rms_dn.square()
    spread = rest / (1 - lattice.share).clamp(min=1e-9)
    share: Tensor = 1 - (rest - noise.square()).clamp(min=0) / spread.clamp(min=1e-9)
    return share


def _is_sane(lattice: Lattice, corners_px: Tensor) -> Tensor:
    """Say which lattices (B,) are finite, not too fine, and not far from where they began."""
    leds = max(lattice.shape.rows, lattice.shape.columns)
    cell = (corners_px - corners_px.roll(1, 1)).norm(dim=2).amax(1) / leds
    strayed = (lattice.corners_px - corners_px).norm(dim=2).amax(1) > _FARTHEST_CELLS * cell
    pitch = (lattice.corners_px - lattice.corners_px.roll(1, 1)).norm(dim=2).amin(1) / leds
    sane: Tensor = lattice.corners_px.isfinite().flatten(1).all(1) & ~strayed & (pitch >= _LEAST_PITCH_PX)
    return sane


def _taken(frames: Frames, rows: Tensor) -> Frames:
    """Take some of the frames."""
    surround = None if frames.surround is None else frames.surround[rows]
    return Frames(frames.grey[rows], frames.origin_px[rows], frames.sensor_px, surround)


def _of(panels: Panels, rows: Tensor) -> Panels:
    """Take some of the panels."""
    return Panels(*(getattr(panels, name)[rows] for name in Panels.__slots__))


def _put(panels: Panels, rows: Tensor, others: Panels) -> None:
    """Overwrite some of the panels."""
    for name in Panels.__slots__:
        getattr(panels, name)[rows] = getattr(others, name).to(getattr(panels, name).dtype)
