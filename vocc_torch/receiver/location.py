"""Where the panel is in each frame: the paper's locator (section IV-B-2, Fig. 18) at every scale."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.receiver.components import close_mask
from vocc_torch.receiver.ladder import Choice, choose_single, climb
from vocc_torch.receiver.limits import LocatorLimits
from vocc_torch.receiver.otsu import UnevenParts, otsu_threshold, sensor_histogram, uneven_parts
from vocc_torch.types import Frames, Panels, PanelShape

# Most pixels in one pass, to bound the memory; passes below the small size are not worth parting further.
_PASS_PX = 1 << 21
_SMALL_PASS_PX = 1 << 18
# Up to this size masks are tried one by one before they are laid in passes.
_SMALL_MASK_PX = 1 << 15
# More frames than these are quicker together.
_MOST_ALONE = 4
# Columns of a blob are counted in 16 bits.
_MOST_SIDE_PX = 1 << 15


@dataclass(frozen=True, slots=True)
class Stages:
    """What the locator computes on its way, for figures.

    Args:
        threshold: (B,) int64, Otsu's threshold.
        mask: (B,1,H,W) bool, the foreground.
        closed: (B,1,H,W) bool, the foreground closed at the first level.
    """

    threshold: Tensor
    mask: Tensor
    closed: Tensor


def quantised(grey: Tensor) -> Tensor:
    """Round floating grey values to uint8, clamped to 0 to 255; uint8 passes as it is.

    Raises:
        VoccError: a value is NaN or infinite, or ``grey`` is of another type.

    Example:
        >>> quantised(torch.tensor([-3.0, 99.6, 300.0])).tolist()
        [0, 100, 255]
    """
    if grey.dtype == torch.uint8:
        return grey
    if not grey.is_floating_point():
        raise VoccError(f"frames.grey is {grey.dtype}: it must be torch.uint8 or floating")
    if not bool(grey.isfinite().all()):
        raise VoccError("frames.grey holds NaN or infinity: it must be grey values, 0 to 255")
    return grey.round().clamp(0, 255).to(torch.uint8)


def paper_stages(frames: Frames, closing_px: int = 11) -> Stages:
    """Compute the threshold, the mask and the closed mask of each frame, for figures.

    Example:
        >>> stages = paper_stages(Frames.whole(torch.tensor([[[0, 9, 0, 9, 0]]], dtype=torch.uint8)), 3)
        >>> stages.threshold.tolist(), stages.closed.int().flatten().tolist()
        ([0], [0, 1, 1, 1, 0])
    """
    exact = exact_frames(frames)
    threshold = otsu_threshold(sensor_histogram(exact))
    mask = exact.grey > threshold.view(-1, 1, 1, 1)
    return Stages(threshold, mask, close_mask(mask, closing_px))


@dataclass(frozen=True, slots=True)
class PaperLocator(LocatorLimits):
    """Find the panel as the paper does: Otsu, closing, components, blob analysis, convex hull, quadrilateral.

    Blobs below a limit are dropped. Of the others the best by ``rectangularity x compactness x proportion^2``
    (see :mod:`vocc_torch.receiver.quadrilateral`) is the panel, of equals the first in raster order;
    ``Panels.candidates`` says how many there were. Nothing is found where none is left.

    One closing serves one LED pitch, so there is a ladder. At level n the mask is halved n times (block
    maxima, laid from the foreground's own top left corner), closed with the same square and labelled. A
    closing only decides which pixels belong together: hulls and rectangles always come from the mask's own
    pixels, and from one level to the next components only merge. Every frame starts at level 0. It climbs
    where

    - it has several components, and the blob chosen so far holds less than 99 % of the foreground; or
    - the closing, ``closing_px * 2^n``, spans less than 1.4 LED pitches of the level's best blob, or less
      than 3 while no blob that holds 99 % is chosen; the pitch is the root of rectangle area / LEDs.

    The best blob of the next level then

    - replaces a chosen blob that it holds, and more, at no less than 0.75 of the best score so far: fragments
      of a panel may look like panels, but two panels, or a panel and a lamp, together do not;
    - replaces the same blob, closed further, at no less than its score;
    - replaces any other blob at a higher score.

    Objects nearer to the panel than the first closing cannot be parted; a low score tells of them. The sensor
    is taken to be surrounded by background. Floating frames are rounded for location only. Nothing is found
    in a constant frame; one that is all noise may be taken for a panel that fills it. A square panel looks
    alike from four sides: the first corner is the one from which the first side is turned by more than -45
    and at most 45 degrees.

    Args:
        closing_px: side of the closing's square, px, odd, 1 to 65535; 1.5 times the greatest LED pitch
            expected at level 0.
        min_area_px: least area of a closed blob, px^2, at least 1.
        min_rectangularity: least rectangularity, 0 to 1.
        min_compactness: least compactness, 0 to 1; for a square panel discs have 0.785 to 0.805, panels of
            random bits more than 0.82.
        quadrilateral: ``min_area``, the minimum-area rectangle, or ``upright``, the bounding box.

    Raises:
        VoccError: a parameter out of its range.

    Example:
        >>> grey = torch.zeros(1, 1, 40, 60, dtype=torch.uint8)
        >>> grey[:, :, 10:30, 15:35] = 200
        >>> panels = PaperLocator()(Frames.whole(grey), PanelShape(8, 8))
        >>> panels.corners_px[0].tolist(), panels.score.item(), panels.candidates.item()
        ([[15.0, 10.0], [35.0, 10.0], [35.0, 30.0], [15.0, 30.0]], 1.0, 1)
    """

    @torch.no_grad()
    def __call__(self, frames: Frames, shape: PanelShape) -> Panels:
        """Locate the panel of ``shape`` in each frame; zero corners and score where there is none.

        Raises:
            VoccError: what :func:`exact_frames` refuses.
        """
        exact = exact_frames(frames)
        parts = uneven_parts(exact.grey)
        threshold = otsu_threshold(sensor_histogram(exact, parts))
        dark = threshold
        bright: list[int] = []
        if exact.surround is not None:
            lit = exact.surround.round() > threshold
            dark, bright = threshold.masked_fill(lit, 255), lit.nonzero()[:, 0].tolist()
        choice = self.choose(exact, dark, shape, parts)
        for index in bright:
            one = slice(index, index + 1)
            choice.put(torch.tensor([index]), self.choose(_on_sensor(exact[one]), threshold[one], shape))
        return Panels(choice.corners_px, choice.score > 0, choice.score, choice.candidates)

    def choose(
        self, frames: Frames, threshold: Tensor, shape: PanelShape, parts: UnevenParts | None = None
    ) -> Choice:
        """Choose the blobs above thresholds (B,) in uint8 frames whose surround is background.

        Args:
            frames: B frames.
            threshold: (B,) int64.
            shape: the panel looked for.
            parts: what :func:`vocc_torch.receiver.otsu.uneven_parts` says of the frames, where it is known.

        Returns:
            The choice, with corners on the sensor.
        """
        boxes = _foreground_boxes(frames.grey, threshold, parts)
        corner = boxes[:, :2]
        choice = Choice.none(len(frames), frames.grey.device)
        if boxes.device.type == "cpu" and len(boxes) <= _MOST_ALONE:
            small = boxes[:, 2] * boxes[:, 3] <= _SMALL_MASK_PX
            for rows, width, height in _passes(boxes * small[:, None]):
                mask = _cut(frames.grey, threshold, boxes, rows, width, height)
                made, part = choose_single(mask, shape, self)
                choice.put(rows[made], part)
            boxes = boxes.index_fill(0, choice.score.nonzero()[:, 0], 0)
        for rows, width, height in _passes(boxes):
            mask = _cut(frames.grey, threshold, boxes, rows, width, height)
            choice.put(rows, climb(mask, shape, self))
        place = (corner + frames.origin_px.to(corner))[:, None]
        choice.corners_px = torch.where((choice.score > 0)[:, None, None], choice.corners_px + place, 0.0)
        return choice


def exact_frames(frames: Frames) -> Frames:
    """Return the frames in uint8, or refuse what no locator can read.

    Raises:
        VoccError: what :func:`quantised` refuses, another shape than (B,1,H,W), a side above 32,768 px, a
            surround that is not finite, or a crop with a surround that is not on its sensor.

    Example:
        >>> exact_frames(Frames.whole(torch.full((1, 2, 2), 9.4))).grey.unique().tolist()
        [9]
    """
    shape, surround = tuple(frames.grey.shape), frames.surround
    if len(shape) != 4 or shape[1] != 1:
        raise VoccError(f"frames.grey has shape {shape}: it must be (B,1,H,W)")
    if max(shape[2:]) > _MOST_SIDE_PX:
        given = f"frames.grey is {shape[2]} x {shape[3]} px"
        raise VoccError(f"{given}: it must be at most {_MOST_SIDE_PX} px a side")
    if surround is not None:
        if not bool(surround.isfinite().all()):
            raise VoccError("frames.surround holds NaN or infinity: it must be grey values, 0 to 255")
        room = frames.origin_px.new_tensor(frames.sensor_px[::-1]) - frames.origin_px.new_tensor(shape[:1:-1])
        if not bool(((frames.origin_px >= 0) & (frames.origin_px <= room)).all()):
            size = f"{shape[2]} x {shape[3]} px"
            raise VoccError(f"frames.origin_px lays a crop of {size} off its sensor, {frames.sensor_px}")
    return Frames(quantised(frames.grey), frames.origin_px, frames.sensor_px, surround)


def _on_sensor(crop: Frames) -> Frames:
    """Fill one crop up to its whole sensor with its surround."""
    assert crop.surround is not None
    level = int(crop.surround.round().clamp(0, 255))
    grey = torch.full((1, 1, *crop.sensor_px), level, dtype=torch.uint8, device=crop.grey.device)
    x, y = crop.origin_px[0].tolist()
    height, width = crop.grey.shape[-2:]
    grey[..., y : y + height, x : x + width] = crop.grey
    return Frames.whole(grey)


def _foreground_boxes(grey: Tensor, threshold: Tensor, parts: UnevenParts | None = None) -> Tensor:
    """Bound the pixels above the thresholds: (B,4) left, top, width, height; zeros where there are none."""
    if not grey.numel():
        return torch.zeros(grey.shape[0], 4, dtype=torch.int64, device=grey.device)
    if parts and any(map(parts.outside_px, range(len(grey)))):
        limits = threshold.tolist()
        return torch.tensor([_foreground_box(grey, limit, parts, one) for one, limit in enumerate(limits)])
    ends = []
    for axis in (-2, -1):
        # Maxima of bytes first: comparing them all would write a mask as large as the frames.
        lit = (grey.amax(axis)[:, 0] > threshold[:, None]).to(torch.uint8)
        first, length = lit.argmax(1), lit.shape[1]
        ends.append((first, (length - lit.flip(1).argmax(1) - first) * lit.amax(1)))
    (left, width), (top, height) = ends
    return torch.stack([left, top, width, height], 1)


def _foreground_box(grey: Tensor, limit: int, parts: UnevenParts, index: int) -> tuple[int, int, int, int]:
    """Bound the pixels above ``limit``, in a frame's uneven part alone where the rest is dark."""
    left = top = 0
    plane = grey[index, 0].numpy()
    if parts.levels[index] <= limit:
        (left, top, _, _), plane = parts.boxes[index], parts.cut(grey, index).numpy()
    if not plane.size:
        return 0, 0, 0, 0
    x, y = ((plane.max(axis) > limit).nonzero()[0] for axis in (0, 1))
    if not len(x):
        return 0, 0, 0, 0
    return left + int(x[0]), top + int(y[0]), int(x[-1] - x[0]) + 1, int(y[-1] - y[0]) + 1


def _passes(boxes: Tensor) -> list[tuple[Tensor, int, int]]:
    """Group frames by the size of their box of foreground: indices, common width and height of each pass."""
    area = boxes[:, 2] * boxes[:, 3]
    order = area.argsort(stable=True)
    order = order[area[order] > 0]
    sizes = boxes[order, 2:].tolist()
    passes: list[tuple[Tensor, int, int]] = []
    begin = width = height = own = 0
    for index, (wide, high) in enumerate(sizes):
        padded = (index + 1 - begin) * max(width, wide) * max(height, high)
        if index > begin and padded > min(_PASS_PX, max(_SMALL_PASS_PX, 4 * (own + wide * high))):
            passes.append((order[begin:index], width, height))
            begin, width, height, own = index, 0, 0, 0
        width, height, own = max(width, wide), max(height, high), own + wide * high
    if sizes:
        passes.append((order[begin:], width, height))
    return passes


def _cut(grey: Tensor, threshold: Tensor, boxes: Tensor, rows: Tensor, width: int, height: int) -> Tensor:
    """Threshold the boxes of some frames into masks of a common size (b,height,width), background beyond."""
    if len(rows) == 1:
        left, top = boxes[int(rows), :2].tolist()
        whole = grey[rows, 0, top : top + height, left : left + width]
        return whole > threshold[rows, None, None]
    down = torch.arange(height, device=grey.device)
    right = torch.arange(width, device=grey.device)
    y, x = boxes[rows, 1, None] + down, boxes[rows, 0, None] + right
    inside_y, inside_x = y < grey.shape[-2], x < grey.shape[-1]
    y, x = y.clamp(max=grey.shape[-2] - 1), x.clamp(max=grey.shape[-1] - 1)
    values = grey[rows[:, None, None], 0, y[:, :, None], x[:, None, :]]
    return (values > threshold[rows, None, None]) & inside_y[:, :, None] & inside_x[:, None, :]
