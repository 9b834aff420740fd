"""Second looks at frames in which a locator finds too few panels: at other scales, and beside panels.

Two panels that touch look like one lattice, which is cut in its middle.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.receiver.locators.protocol import PanelLocator
from vocc_torch.receiver.resample import corner_cells, map_points
from vocc_torch.types import Candidates, Frames, PanelShape


@dataclass(frozen=True)
class SecondLookSettings:
    """How frames are seen again."""

    # Thirds of an octave: a pyramid of halvings shows other pitches then.
    scales: tuple[float, ...] = (2 ** (-1 / 3), 2 ** (-2 / 3))
    gaps: tuple[float, ...] = (0.0, 1.0)  # cells between a panel and one beside it
    together: float = 0.3  # cells that a half of a pair without a gap moves at most
    likely: float = 0.5  # least score of a panel beside another
    # Panels whose centres are nearer than this share of a diagonal are one.
    apart: float = 0.35


SETTINGS = SecondLookSettings()


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
    for scale in SETTINGS.scales:
        if len(again := _with_fewer(found, locator, len(frames), 1)):
            more = scaled(locator, frames[again], shape, scale)
            found = _joined([found, replace(more, frame=again[more.frame])])
    for number in _with_fewer(found, locator, len(frames), most).tolist():
        if most > 1:
            sure = sure_of(found[found.frame == number], locator)
            frame = frames[number : number + 1]
            more = replace(sure, frame=0 * sure.frame)
            more = touching(locator, frame, shape, most, more)
            found = _joined([found, replace(more, frame=more.frame + number)])
    return found


def scaled(
    locator: PanelLocator, frames: Frames, shape: PanelShape, scale: float
) -> Candidates:
    """Locate panels at another scale; the false alarms stated are those of all looks."""
    before = frames.grey.shape[:1:-1]
    size = [max(1, round(scale * side)) for side in before]
    grey = functional.interpolate(
        frames.grey.float(), size[::-1], mode="bilinear", antialias=True
    )
    found = locator.locate(Frames.whole(grey.round().byte()), shape)
    ratio = found.corners_px.new_tensor(before) / found.corners_px.new_tensor(size)
    corners = found.corners_px * ratio + frames.origin_px[found.frame][:, None]
    alarms = found.false_alarms * (1 + len(SETTINGS.scales))
    return replace(found, corners_px=corners, false_alarms=alarms)


def touching(
    locator: PanelLocator, frame: Frames, shape: PanelShape, most: int, sure: Candidates
) -> Candidates:
    """Find panels of one frame beside those that are sure, and pairs of panels that touch, up to ``most`` in all."""
    known, chain = sure, sure
    while len(chain.frame) and len(known.frame) < most:
        starts = beside(chain.corners_px, shape)
        placed = sure_of(locator.place(frame, starts, shape), locator)
        chain = new(placed[placed.score >= SETTINGS.likely], known)
        known = Candidates.cat([known, chain])
    for across, down in ((1, 0), (0, 1)):
        if len(known.frame) < most:
            halves = halves_of(locator, frame, shape, across, down)
            known = Candidates.cat([known, new(halves, known)])
    return known[len(sure.frame) :]


def halves_of(
    locator: PanelLocator, frame: Frames, shape: PanelShape, across: int, down: int
) -> Candidates:
    """Locate pairs of panels, one beside or below the other, and cut them apart.

    Args:
        locator: finds several panels.
        frame: one frame.
        shape: rows and columns of a panel.
        across: 1 for pairs side by side, else 0.
        down: 1 for pairs one below the other, else 0.
    """
    rows, columns = shape.sides
    # Without a gap, and with one of a cell.
    steps = [(across * (columns + gap), down * (rows + gap)) for gap in (0, 1)]
    close, wide = (PanelShape(rows + y, columns + x) for x, y in steps)
    pairs = sure_of(locator.locate(frame, close), locator)
    placed = [locator.place(frame, pairs.corners_px, cells) for cells in (close, wide)]
    apart = torch.zeros_like(pairs.frame, dtype=torch.bool)
    if len(placed[1].frame):
        apart = placed[1].score > placed[0].score
    halves = [pairs[:0]]
    for found, cells, step in (
        (pairs[~apart], close, steps[0]),
        (placed[1][apart[: len(placed[1].frame)]], wide, steps[1]),
    ):
        moves = [found.corners_px.new_tensor(move) for move in ((0, 0), step)]
        corners = steps_of(found.corners_px, cells, shape, moves)
        halves.append(replace(Candidates.cat([found, found]), corners_px=corners))
    return Candidates.cat(halves)


def beside(corners_px: Tensor, shape: PanelShape) -> Tensor:
    """Give where panels beside others (n,4,2) px are expected, (m,4,2) px."""
    sides = corner_cells(shape)[2].diag()
    ways = torch.cat([sides, -sides]).to(corners_px)
    steps = [way + gap * way.sign() for gap in SETTINGS.gaps for way in ways]
    return steps_of(corners_px, shape, shape, steps)


def steps_of(
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


def new(found: Candidates, known: Candidates) -> Candidates:
    """Take the candidates of one frame, the best first, that are at no known place and at no better one's."""
    taken = known
    for row in found.false_alarms.argsort(stable=True).tolist():
        one = found[row : row + 1]
        diagonal = (one.corners_px[:, 0] - one.corners_px[:, 2]).norm()
        apart = torch.cdist(one.corners_px.mean(1), taken.corners_px.mean(1))
        if not (apart < SETTINGS.apart * diagonal).any():
            taken = Candidates.cat([taken, one])
    return taken[len(known.frame) :]


def _with_fewer(
    found: Candidates, locator: PanelLocator, frames: int, most: int
) -> Tensor:
    """Give the numbers of frames in which fewer panels than ``most`` are sure."""
    sure = sure_of(found, locator)
    return (torch.bincount(sure.frame, minlength=frames) < most).nonzero()[:, 0]


def _joined(parts: list[Candidates]) -> Candidates:
    """Join candidates in the frames' order, the best of each first."""
    found = Candidates.cat(parts)
    found = found[found.false_alarms.argsort(stable=True)]
    return found[found.frame.argsort(stable=True)]
