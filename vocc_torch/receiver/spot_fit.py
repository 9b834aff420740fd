"""Lattices of round spots fitted to likely places of panels in one picture, each in a level that suits it."""

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from vocc_torch.receiver import lattice_fit, lattice_model, resample
from vocc_torch.receiver.cell_model import Cells, read_cells
from vocc_torch.receiver.lattice_search import Pyramid
from vocc_torch.types import PanelShape

# Share of the picture that is to be explained, cells that corners may move by, and the blur to begin with.
_LEAST_SHARE, _NEAR_CELLS, _BLUR = 0.75, 1.8, 0.3
# Steps for which both backgrounds are tried, the share from which on more follow, and steps in all.
_ROUGH_STEPS, _LEAST_ROUGH, _STEPS = 4, 0.6, 9


def fitted_spots(
    scales: Pyramid, quads: Tensor, shape: PanelShape, least_rough: float = _LEAST_ROUGH
) -> tuple[Tensor, Tensor]:
    """Fit lattices of spots from good corners (n,4,2); those that explain the picture and stay near.

    The background is what is around the panel, or the panel's own dark cells; after a few steps the better of
    both goes on, if it explains more than ``least_rough`` of the picture.

    Returns:
        (n,4,2) corners, and (n,) the share of the picture that they explain, 0 where the corners stay.
    """
    seen = _Seen(scales, Cells.at(scales, quads.repeat(2, 1, 1), shape))
    start, side = seen.cells.corners_px, lattice_model.SAMPLES
    patches = read_cells(
        scales, seen.cells[: len(quads)], shape, side, lattice_model.MARGIN
    )
    dark = patches[:, side:-side, side:-side].flatten(1).quantile(0.1, dim=1)
    patches[:, side:-side, side:-side] = torch.nan
    ring = patches.flatten(1).nanmedian(1).values
    background = torch.cat([ring, dark]).double()
    begun = lattice_model.Lattice.at(
        start, torch.full_like(background, _BLUR), background, shape
    )
    rough = lattice_fit.fit_lattice(seen, begun, range(_ROUGH_STEPS))
    shares, which = rough.share.view(2, -1).max(0)
    rows = (shares > least_rough).nonzero()[:, 0]
    best = rows + which[rows] * len(quads)
    found, shares = quads.clone(), torch.zeros_like(shares)
    if len(rows):
        # What the last of those steps scored is what it began with: it is taken again.
        steps = range(_ROUGH_STEPS - 1, _STEPS)
        lattice = lattice_fit.fit_lattice(seen[best], rough[best], steps)
        cell = torch.maximum(*resample.cell_size_px(start[rows], shape)).clamp(min=1e-6)
        moved = (lattice.corners_px - start[rows]).norm(dim=2).amax(1) / cell
        good = (lattice.share > _LEAST_SHARE) & (moved <= _NEAR_CELLS)
        rows, lattice = rows[good], lattice[good]
        found[rows] = (
            lattice.corners_px * 2.0 ** seen.cells.level[rows].double()[:, None, None]
        )
        shares[rows] = lattice.share
    return found, shares


@dataclass(frozen=True, slots=True)
class _Seen:
    """One picture of which each lattice is read in a level that suits it."""

    scales: Pyramid
    cells: Cells

    def __len__(self) -> int:
        """Count the lattices."""
        return len(self.cells.level)

    def __getitem__(self, rows: Any, /) -> "_Seen":
        """Take some of them."""
        return _Seen(self.scales, self.cells[rows])

    def read(self, lattice: lattice_model.Lattice) -> Tensor:
        """Resample the picture about each."""
        cells = replace(self.cells, corners_px=lattice.corners_px)
        return read_cells(
            self.scales,
            cells,
            lattice.shape,
            lattice_model.SAMPLES,
            lattice_model.MARGIN,
        )
