"""Second looks at frames in which a locator finds too few panels: at smaller sizes, beside panels, and at rows.

A row of panels that touch looks like one lattice, which is cut apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.locators.paper import exact_frames
from vocc_torch.receiver.locators.protocol import PARTS_PER_PX, PanelLocator
from vocc_torch.receiver.resample import corner_cells, map_points
from vocc_torch.types import Candidates, Frames, PanelShape


@dataclass(frozen=True)
class SecondLookSettings:
    """How frames are seen again."""

    # Of smaller frames, thirds of an octave: their pyramids of halvings show other pitches.
    scales: tuple[float, ...] = (2 ** (-1 / 3), 2 ** (-2 / 3))
    # Factor on the false alarms stated of a smaller frame, so that all looks together
    # have at most 1.2 times the false alarms of one.
    alarms: float = 10.0
    gaps: tuple[float, ...] = (0.0, 1.0)  # cells between a panel and one beside it
    most_in_row: int = 4  # panels that are seen as one lattice
    likely: float = 0.5  # least score of a panel beside another
    overlap: float = 0.5  # cells; panels that overlap by more are one


SETTINGS = SecondLookSettings()

MOST_LEDS = 1024
"""Along a side of a lattice."""


def locate_several(
    locator: PanelLocator, frames: Frames, shape: PanelShape, most: int
) -> Candidates:
    """Locate panels, and look again at frames without a sure one and at frames with fewer than ``most``.

    Args:
        locator: finds several panels.
        frames: B frames.
        shape: rows and columns of one panel.
        most: panels of a frame.
    """
    found = locator.locate(frames, shape)
    if not frames.grey.numel():
        return found
    for scale in SETTINGS.scales:
        if len(again := _with_fewer(found, locator, len(frames), 1)):
            more = scaled(locator, frames[again], shape, scale)
            found = _joined([found, replace(more, frame=again[more.frame])])
    for number in _with_fewer(found, locator, len(frames), most).tolist():
        if most > 1:
            sure = sure_of(found[found.frame == number], locator)
            sure = replace(sure, frame=0 * sure.frame)
            frame = frames[number : number + 1]
            more = touching(locator, frame, shape, most, sure)
            found = _joined([found, replace(more, frame=more.frame + number)])
    return found


def scaled(
    locator: PanelLocator, frames: Frames, shape: PanelShape, scale: float
) -> Candidates:
    """Locate panels in smaller frames."""
    grey = exact_frames(frames).grey
    before = grey.shape[:1:-1]
    size = [max(1, round(scale * side)) for side in before]
    grey = functional.interpolate(
        grey.double(), size[::-1], mode="bilinear", antialias=True
    )
    smaller = replace(Frames.whole(grey.round().byte()), surround=frames.surround)
    found = locator.locate(smaller, shape)
    ratio = found.corners_px.new_tensor(before) / found.corners_px.new_tensor(size)
    corners = found.corners_px * ratio + frames.origin_px[found.frame][:, None]
    corners = (corners * PARTS_PER_PX).round() / PARTS_PER_PX
    alarms = found.false_alarms * SETTINGS.alarms
    return replace(found, corners_px=corners, false_alarms=alarms)


def touching(
    locator: PanelLocator, frame: Frames, shape: PanelShape, most: int, sure: Candidates
) -> Candidates:
    """Find panels of one frame beside those that are sure, and rows of panels that touch, up to ``most`` in all."""
    known, chain = sure, sure
    while len(chain.frame) and len(known.frame) < most:
        starts = within(frame, beside(chain.corners_px, shape))
        placed = sure_of(locator.place(frame, starts, shape), locator)
        chain = new_panels(placed[placed.score >= SETTINGS.likely], known, shape)
        known = Candidates.cat([known, chain])
    for count in range(min(most, SETTINGS.most_in_row), 1, -1):
        for across, down in ((1, 0), (0, 1)):
            longest = count * (max(shape.sides) + 1)
            if len(known.frame) < most and longest <= MOST_LEDS:
                row = row_of(locator, frame, shape, count, across, down)
                known = Candidates.cat([known, new_panels(row, known, shape)])
    return known[len(sure.frame) :]


def row_of(
    locator: PanelLocator,
    frame: Frames,
    shape: PanelShape,
    count: int,
    across: int,
    down: int,
) -> Candidates:
    """Locate rows of panels as one lattice, and cut them apart.

    Args:
        locator: finds several panels.
        frame: one frame.
        shape: rows and columns of a panel.
        count: panels in a row.
        across: 1 for panels side by side, else 0.
        down: 1 for panels one below the other, else 0.
    """
    rows, columns = shape.sides
    # Without gaps, and with gaps of a cell.
    steps = [(across * (columns + gap), down * (rows + gap)) for gap in (0, 1)]
    close, wide = (
        PanelShape(rows + (count - 1) * y, columns + (count - 1) * x) for x, y in steps
    )
    found = sure_of(locator.locate(frame, close), locator)
    without, spaced = (
        locator.place(frame, found.corners_px, cells) for cells in (close, wide)
    )
    if len(spaced.frame):
        apart = spaced.score > without.score
        apart &= ~(spaced.false_alarms > locator.most_false_alarms)
    else:
        # The locator places nothing.
        spaced, apart = found, torch.zeros_like(found.frame, dtype=torch.bool)
    parts = [found[:0]]
    for lattices, cells, step in (
        (found[~apart], close, steps[0]),
        (spaced[apart], wide, steps[1]),
    ):
        step_cells = lattices.corners_px.new_tensor(step)
        moves = [number * step_cells for number in range(count)]
        corners = panels_at(lattices.corners_px, cells, shape, moves)
        parts.append(replace(Candidates.cat([lattices] * count), corners_px=corners))
    return Candidates.cat(parts)


def beside(corners_px: Tensor, shape: PanelShape) -> Tensor:
    """Give where panels beside others (n,4,2) px are expected, (m,4,2) px."""
    sides = corner_cells(shape)[2].diag()
    ways = torch.cat([sides, -sides]).to(corners_px)
    steps = [way + gap * way.sign() for gap in SETTINGS.gaps for way in ways]
    return panels_at(corners_px, shape, shape, steps)


def within(frame: Frames, corners_px: Tensor) -> Tensor:
    """Take the quadrilaterals (n,4,2) px that lie in a frame as a whole."""
    first = frame.origin_px[0]
    size = first.new_tensor(frame.grey.shape[:1:-1])
    inside = (corners_px >= first) & (corners_px <= first + size)
    return corners_px[inside.all(2).all(1)]


def panels_at(
    corners_px: Tensor, cells: PanelShape, shape: PanelShape, steps: Sequence[Tensor]
) -> Tensor:
    """Give the corners (m,4,2) px of panels that lie some cells (2,) from the first cells of lattices (n,4,2) px."""
    corners = corner_cells(shape).to(corners_px)
    moved = [
        map_points(corners_px, (corners + step).expand(len(corners_px), 4, 2), cells)
        for step in steps
    ]
    return torch.cat(moved)


def sure_of(found: Candidates, locator: PanelLocator) -> Candidates:
    """Take the candidates that a locator takes for panels."""
    return found[~(found.false_alarms > locator.most_false_alarms)]


def new_panels(found: Candidates, known: Candidates, shape: PanelShape) -> Candidates:
    """Take the candidates of one frame, the best first, that are at no known place and at no better one's."""
    taken, found = known, _joined([found])
    for row in range(len(found.frame)):
        one = found[row : row + 1]
        if not overlap(one.corners_px[0], taken.corners_px, shape).any():
            taken = Candidates.cat([taken, one])
    return taken[len(known.frame) :]


def overlap(quad: Tensor, others: Tensor, shape: PanelShape) -> Tensor:
    """Say which panels (n,4,2) px overlap one (4,2) px.

    Example:
        >>> wide = torch.tensor([[0.0, 0.0], [32.0, 0.0], [32.0, 8.0], [0.0, 8.0]])
        >>> moved = torch.stack([wide + torch.tensor([31.0, 0.0]), wide + torch.tensor([0.0, 8.0])])
        >>> overlap(wide, moved, PanelShape(8, 32)).tolist()
        [True, False]
    """
    across = quad[1] + quad[2] - quad[0] - quad[3]
    down = quad[2] + quad[3] - quad[0] - quad[1]
    inverse, _ = torch.linalg.inv_ex(torch.stack([across, down], 1) / 2)
    off = (inverse @ (others.mean(1) - quad.mean(0)).mT).abs()
    rows, columns = shape.sides
    near = off < 1 - SETTINGS.overlap / off.new_tensor([[columns], [rows]])
    both: Tensor = near.all(0)
    return both


def _with_fewer(
    found: Candidates, locator: PanelLocator, frames: int, most: int
) -> Tensor:
    """Give the numbers of frames in which fewer panels than ``most`` are sure."""
    sure = sure_of(found, locator)
    return (torch.bincount(sure.frame, minlength=frames) < most).nonzero()[:, 0]


def _joined(parts: list[Candidates]) -> Candidates:
    """Join candidates in the frames' order, the best of each first."""
    found = Candidates.cat(parts)
    found = found[found.score.argsort(descending=True, stable=True)]
    found = found[found.false_alarms.argsort(stable=True)]
    return found[found.frame.argsort(stable=True)]
