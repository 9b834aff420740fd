"""The fit: corners of a candidate moved to where a lattice of spots explains the picture best."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from vocc_torch.receiver import frame_fit
from vocc_torch.receiver.detector.pyramid import Pyramid
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class FitSettings:
    """How candidates are fitted."""

    cell_px: int = 6  # a cell's side in the level that is fitted, nearly
    steps: int = 5
    # Cells right and down by which a candidate is shifted to begin with.
    starts: tuple[tuple[float, float], ...] = (
        (0.0, 0.0),
        (0.4, 0.0),
        (-0.4, 0.0),
        (0.0, 0.4),
        (0.0, -0.4),
    )
    blurs: tuple[float, ...] = (0.2, 0.35)  # of spots, cells, to begin with
    least_share: float = (
        0.3  # of the picture that a lattice explains, for its corners to be taken
    )
    most_move_cells: float = 1.0  # farther, and the fit has slipped


SETTINGS = FitSettings()


def fitted(pyramid: Pyramid, quads: Tensor, shape: PanelShape) -> tuple[Tensor, Tensor]:
    """Fit lattices of spots from candidates (n,4,2), px, within half a cell of the truth.

    Returns:
        (n,4,2) corners, unchanged where the fit fails, and (n,) the share of the picture that two levels of
        spots explain.
    """
    level = pyramid.level_of(quads, shape, SETTINGS.cell_px)
    found, shares = quads.clone(), torch.zeros(len(quads), dtype=torch.float64)
    for row, number in enumerate(level.tolist()):
        start = quads[row].numpy() / 2.0**number
        grey, origin = pyramid.window(number, start, shape)
        right = (start[1] + start[2] - start[0] - start[3]) / (2 * shape.columns)
        down = (start[3] + start[2] - start[0] - start[1]) / (2 * shape.rows)
        fits = [
            frame_fit.fit(
                grey,
                start - origin + across * right + below * down,
                shape,
                blur,
                SETTINGS.steps,
            )
            for blur in SETTINGS.blurs
            for across, below in SETTINGS.starts
        ]
        corners, _, share = max(fits, key=lambda one: one[2])
        shares[row] = share
        side = np.sqrt(abs(frame_fit.area(start)) / shape.leds)
        moved = float(np.abs(corners + origin - start).max()) / max(side, 1e-6)
        if share > SETTINGS.least_share and moved < SETTINGS.most_move_cells:
            found[row] = torch.from_numpy((corners + origin) * 2.0**number)
    return found, shares
