"""Panels that touch: a locator sees two of them as one lattice, which is cut in its middle."""

from dataclasses import replace

import torch

from vocc_torch.receiver.locators.protocol import PanelLocator
from vocc_torch.receiver.resample import corner_cells, map_points
from vocc_torch.types import Candidates, Frames, PanelShape

APART_SIDES = 0.35
"""Panels whose centres are nearer than this share of a diagonal are one."""


def locate_several(
    locator: PanelLocator, frames: Frames, shape: PanelShape, most: int
) -> Candidates:
    """Locate panels, and where fewer than ``most`` are sure in a frame, pairs of panels that touch.

    Args:
        locator: finds several panels.
        frames: B frames.
        shape: rows and columns of one panel.
        most: panels of a frame.
    """
    found = locator.locate(frames, shape)
    for down, across in ((0, 1), (1, 0)):
        sure = sure_of(found, locator)
        few = torch.bincount(sure.frame, minlength=len(frames)) < most
        numbers = few.nonzero()[:, 0]
        if most < 2 or not len(numbers):
            break
        step = torch.tensor([across * shape.columns, down * shape.rows])
        pair = PanelShape((1 + down) * shape.rows, (1 + across) * shape.columns)
        pairs = sure_of(locator.locate(frames[numbers], pair), locator)
        parts = [found]
        for begin in (0 * step, step):
            cells = (corner_cells(shape) + begin).to(pairs.corners_px)
            corners = map_points(
                pairs.corners_px, cells.expand(len(pairs.score), 4, 2), pair
            )
            half = replace(pairs, frame=numbers[pairs.frame], corners_px=corners)
            parts.append(half[~_overlaps(half, sure)])
        found = Candidates.cat(parts)
        # In the frames' order, the best of each first.
        found = found[found.false_alarms.argsort(stable=True)]
        found = found[found.frame.argsort(stable=True)]
    return found


def sure_of(found: Candidates, locator: PanelLocator) -> Candidates:
    """Take the candidates that a locator takes for panels."""
    return found[~(found.false_alarms > locator.most_false_alarms)]


def _overlaps(some: Candidates, others: Candidates) -> torch.Tensor:
    """Say of candidates (N,) whether one of the others is at the same place."""
    diagonal = some.corners_px[:, 0] - some.corners_px[:, 2]
    apart = torch.cdist(some.corners_px.mean(1), others.corners_px.mean(1))
    near = apart < APART_SIDES * diagonal.norm(dim=1, keepdim=True)
    overlapping: torch.Tensor = (near & (some.frame[:, None] == others.frame)).any(1)
    return overlapping
