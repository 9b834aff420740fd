"""The paper's locator (section IV-B-2, Fig. 18), with closings at several scales."""

from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn.utils.rnn import pad_sequence

from vocc_torch.errors import VoccError, demand_kind
from vocc_torch.receiver import components, foreground
from vocc_torch.receiver.limits import LocatorLimits
from vocc_torch.receiver.locators.protocol import PanelLocator
from vocc_torch.receiver.quadrilateral import measure_blobs
from vocc_torch.types import Candidates, Frames, Images, Panels, PanelShape


@dataclass(frozen=True)
class LadderSettings:
    """When the closing is repeated at half the resolution, and which blob is taken."""

    most_side_px: int = 1 << 15  # columns of a blob are counted in 16 bits
    merge_ratio: float = 0.75  # of the best score so far: a merged blob explains more, so it may score less
    whole_share: float = (
        0.99  # of the foreground: a blob with this share leaves nothing to merge
    )
    reach_pitches: float = 1.4  # LED pitches that span one Off LED between two On ones
    last_pitches: float = 3.0  # LED pitches that fill all but the widest gaps
    window_px: int = 192  # side up to which masks are processed in batches
    pass_masks: int = 1 << 5  # masks at once; similar sizes need little padding
    most_masks: int = 1 << 12  # the same on an accelerator


LADDER = LadderSettings()


@dataclass(frozen=True)
class PaperLocator(LocatorLimits, PanelLocator):
    """Find the panel as the paper does: Otsu, closing, components, blob analysis, convex hull, quadrilateral.

    Blobs below a limit are dropped. The panel is the blob with the largest ``rectangularity x compactness x
    proportion^2`` (see :mod:`vocc_torch.receiver.quadrilateral`), among equals the first in raster order.
    ``Panels.candidates`` is the number of blobs within the limits. Without one no panel is found.

    One closing suits one LED pitch, so there are several levels. At level n the mask is halved n times (block
    maxima, laid from the foreground's own top left corner), closed with the same square and labelled. A
    closing only decides which pixels belong together: hulls and rectangles always come from the mask's
    pixels, and from one level to the next components only merge. Every frame starts at level 0. The next
    level follows if

    - it has several components, and the blob chosen so far holds less than 99 % of the foreground; or
    - the closing, ``closing_px * 2^n``, spans less than 1.4 LED pitches of the level's best blob, or less
      than 3 while no blob that holds 99 % is chosen; the pitch is the root of rectangle area / LEDs.

    The best blob of the next level then

    - replaces a chosen blob that it contains with more pixels, at 0.75 of the best score or more: fragments of
      a panel may look like panels, but two panels, or a panel and a lamp, together do not;
    - replaces the same blob after a larger closing, at its score or more;
    - replaces any other blob at a higher score.

    Objects closer to the panel than the first closing cannot be separated; the score is then low. The sensor is
    assumed to be surrounded by background. Floating frames are rounded for location only. A constant frame has
    no panel; a frame of noise may be taken for a panel that fills it. A square panel looks alike from four
    sides: the first side is the one that is turned by more than -45 and at most 45 degrees.

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

    name: ClassVar[str] = "paper"

    @classmethod
    def of(cls, paper: "PaperLocator", false_alarms: float) -> "PaperLocator":
        """Take the limits of blobs."""
        return paper

    def locate(self, frames: Images, shape: PanelShape) -> Candidates:
        """Give the chosen blob of each frame.

        Raises:
            VoccError: what :func:`exact_frames` refuses.
        """
        return Candidates.of_panels(self(frames, shape))

    @torch.no_grad()
    def __call__(self, frames: Images, shape: PanelShape) -> Panels:
        """Locate the panel of ``shape`` in each frame; zero corners and score where there is none.

        Raises:
            VoccError: what :func:`exact_frames` refuses.
        """
        demand_kind("shape", shape, PanelShape)
        exact = foreground.trimmed(exact_frames(frames))
        return self.choose(exact, foreground.sensor_threshold(exact), shape)

    def choose(self, frames: Frames, threshold: Tensor, shape: PanelShape) -> Panels:
        """Choose the blobs above thresholds in uint8 frames.

        On an accelerator all masks up to 192 px go at once, and one copy tells the host what is left to the
        ladder.

        Args:
            frames: B frames; a crop with a surround above its threshold is filled up to its sensor.
            threshold: (B,) int64.
            shape: the panel looked for.

        Raises:
            VoccError: a crop with a surround that is not on its sensor.
        """
        grey, dark = frames.grey, torch.ones_like(threshold, dtype=torch.bool)
        if frames.surround is not None:
            dark = frames.surround.round() <= threshold
        threshold_in_crop = torch.where(dark, threshold, 255)
        boxes = _foreground_boxes(grey, threshold_in_crop)
        place, left = boxes[:, :2] + frames.origin_px, boxes[:, 2] > 0
        panels, sides = no_panels(len(boxes), grey.device), boxes[:, 2:].amax(1)
        order, most = torch.arange(len(boxes), device=grey.device), LADDER.most_masks
        size_px = [min(side, LADDER.window_px) for side in grey.shape[-2:]]
        if grey.is_cpu:
            order = sides.argsort()
            order = order[left[order] & (sides[order] <= LADDER.window_px)]
            most = LADDER.pass_masks
        for rows in torch.split(order, most) if len(order) else ():
            if grey.is_cpu:
                size_px = boxes[rows, 2:].amax(0).tolist()[::-1]
            mask = _cut(grey, threshold_in_crop, boxes, rows, *size_px)
            part, sure = choose_single(mask, place[rows], shape, self)
            panels.put(rows, part)
            left[rows] &= ~sure | (sides[rows] > LADDER.window_px)
        flags = torch.stack([left, dark, _lies_on_sensor(frames)], 1)
        known = torch.cat([boxes, flags], 1).cpu()
        if not known[:, 6].all():
            demand_on_sensor(frames)
        for row in (known[:, 4] > 0).nonzero()[:, 0].tolist():
            x, y, width, height = known[row, :4].tolist()
            plane = grey[row, 0, y : y + height, x : x + width]
            climbed = climb((plane > threshold_in_crop[row]).cpu(), shape, self)
            panels.put(slice(row, row + 1), climbed.to(grey.device))
            panels.corners_px[row] += place[row] * panels.found[row]
        for row in (known[:, 5] == 0).nonzero()[:, 0].tolist():
            at = slice(row, row + 1)
            filled = _on_sensor(frames[at])
            panels.put(at, self.choose(filled, threshold[at], shape))
        return panels


def no_panels(frames: int, device: torch.device) -> Panels:
    """Start with no panel found."""
    corners = torch.zeros(frames, 4, 2, dtype=torch.float64, device=device)
    score = corners.new_zeros(frames)
    return Panels(corners, score > 0, score, score.long())


def exact_frames(frames: Images) -> Frames:
    """Return the frames in uint8, or refuse what no locator can read.

    Floating grey values are rounded, and clamped to 0 to 255.

    Raises:
        VoccError: grey values that are NaN, infinite or of another type, another shape than (B,1,H,W), a side
            above 32,768 px, a surround that is not finite, or a crop with a surround that is not on its sensor.

    Example:
        >>> exact_frames(Frames.whole(torch.tensor([[-3.0, 99.6, 300.0]]))).grey.flatten().tolist()
        [0, 100, 255]
    """
    frames = Frames.of(frames)
    grey, shape = frames.grey, tuple(frames.grey.shape)
    if len(shape) != 4 or shape[1] != 1:
        raise VoccError(f"frames.grey has shape {shape}: it must be (B,1,H,W)")
    if max(shape[2:]) > LADDER.most_side_px:
        size = f"{shape[2]} x {shape[3]} px"
        rule = f"at most {LADDER.most_side_px} px a side"
        raise VoccError.of("frames.grey", size, rule)
    if grey.dtype != torch.uint8:
        if not grey.is_floating_point():
            raise VoccError(
                f"frames.grey is {grey.dtype}: it must be torch.uint8 or floating"
            )
        if not bool(grey.isfinite().all()):
            raise VoccError(
                "frames.grey holds NaN or infinity: it must be grey values, 0 to 255"
            )
        grey = grey.round().clamp(0, 255).to(torch.uint8)
    exact = replace(frames, grey=grey, colour=None)
    if grey.is_cpu:
        demand_on_sensor(exact)
    return exact


def _lies_on_sensor(frames: Frames) -> Tensor:
    """Whether each crop lies on its sensor and has a finite surround, (B,) bool."""
    x, y = frames.origin_px.unbind(1)
    if frames.surround is None:
        return x == x
    (high, wide), (height, width) = frames.sensor_px, frames.grey.shape[-2:]
    inside = (x >= 0) & (x <= wide - width) & (y >= 0) & (y <= high - height)
    return inside & frames.surround.isfinite()


def demand_on_sensor(frames: Frames) -> None:
    """Refuse a surround that is not finite, or a crop with a surround that is not on its sensor.

    Raises:
        VoccError: such frames.

    Example:
        >>> demand_on_sensor(Frames.whole(torch.zeros(1, 2, 2)))
    """
    if bool(_lies_on_sensor(frames).all()) or frames.surround is None:
        return
    if not bool(frames.surround.isfinite().all()):
        raise VoccError(
            "frames.surround holds NaN or infinity: it must be grey values, 0 to 255"
        )
    size = tuple(frames.grey.shape[2:])
    raise VoccError(
        f"frames.origin_px lays a crop, {size}, off its sensor, {frames.sensor_px}"
    )


def _on_sensor(crop: Frames) -> Frames:
    """Fill one crop up to its whole sensor with its surround."""
    assert crop.surround is not None
    (high, wide), (height, width) = crop.sensor_px, crop.grey.shape[-2:]
    x, y = crop.origin_px[0].tolist()
    beyond = (x, wide - width - x, y, high - height - y)
    level = int(crop.surround.round().clamp(0, 255))
    return Frames.whole(nn.functional.pad(crop.grey, beyond, value=level))


def _foreground_boxes(grey: Tensor, threshold: Tensor) -> Tensor:
    """Bound the pixels above the thresholds: (B,4) left, top, width, height; sizes are 0 where there are none."""
    if not grey.numel():
        return threshold.new_zeros(len(grey), 4)
    # Maxima of bytes first: comparing them all would write a mask as large as the frames.
    ends = [
        components.row_ends(grey[:, 0].amax(axis) > threshold[:, None])
        for axis in (1, 2)
    ]
    first, last = (torch.stack(end, 1).long() for end in zip(*ends, strict=True))
    return torch.cat([first, (last - first + 1).clamp(min=0)], 1)


def _cut(
    grey: Tensor,
    threshold: Tensor,
    boxes: Tensor,
    rows: Tensor,
    height: int,
    width: int,
) -> Tensor:
    """Threshold the boxes of some frames into masks of a common size (b,height,width), background beyond."""
    x, y, wide, high = boxes[rows, :, None].unbind(1)
    right = torch.arange(width, device=grey.device)
    down = torch.arange(height, device=grey.device)
    line = rows[:, None] * grey.shape[-2] + (y + down).clamp(max=grey.shape[-2] - 1)
    column = (x + right).clamp(max=grey.shape[-1] - 1)
    lit = grey.take(line[..., None] * grey.shape[-1] + column[:, None])
    within = (right < wide)[:, None] & (down < high)[..., None]
    return (lit > threshold[rows, None, None]) & within


def climb(mask: Tensor, shape: PanelShape, search: LocatorLimits) -> Panels:
    """Choose the panel's blob in a mask by the rule in :class:`PaperLocator`: the ladder of closings.

    Args:
        mask: (H,W) bool in the CPU's memory, its foreground starting in its first row and first column.
        shape: the panel looked for.
        search: limits and settings.

    Returns:
        One panel, in the mask's coordinates.

    Example:
        >>> mask = torch.zeros(9, 40, dtype=torch.bool)
        >>> mask[:, :9] = mask[:5, 30:] = True
        >>> climb(mask, PanelShape(1, 1), LocatorLimits(3, 1, 0.0, 0.0, "upright")).candidates.tolist()
        [2]
    """
    panel, foreground = no_panels(1, mask.device), int(mask.sum())
    first_px, mask_px, score, peak = (0, 0), 0, 0.0, 0.0
    coarse, level = mask[None, None], 0
    while True:
        labels = components.label_components(
            components.close_mask(coarse, search.closing_px)[0, 0]
        )
        blobs = components.collect_blobs(
            mask, labels, min_area_px=search.min_area_px, level=level
        )
        pitch = 0.0
        if blobs:
            area_px = torch.tensor([blob.area_px for blob in blobs])
            place_px = torch.tensor(
                [[blob.left_px, blob.first_px[1]] for blob in blobs]
            )
            measures = measure_blobs(
                pad_sequence([blob.first for blob in blobs], batch_first=True),
                pad_sequence([blob.last for blob in blobs], True, -1),
                area_px,
                place_px,
                shape,
                search,
            )
            # NumPy gives the first of equal scores.
            pitch = float(measures.pitch_px[measures.score.numpy().argmax()])
            best = int(measures.score.where(measures.within, 0.0).numpy().argmax())
            now = float(measures.score[best]) * bool(measures.within[best])
            now_px = blobs[best].mask_px
            x, y = (place >> level for place in first_px)
            holds = mask_px > 0 and int(labels[y, x]) == blobs[best].label
            # A blob that holds the chosen one and more may score a little less; the same blob may not.
            bar = LADDER.merge_ratio * peak if now_px > mask_px else score
            if now > 0 and (now >= bar if holds else now > score):
                peak = max(peak, now) if holds else now
                first_px, mask_px = blobs[best].first_px, now_px
                score, found = now, measures.score[best, None]
                count = measures.within.sum()[None]
                panel = Panels(measures.corners_px[best, None], found > 0, found, count)
        whole = mask_px >= LADDER.whole_share * foreground
        pitches = LADDER.reach_pitches if whole else LADDER.last_pitches
        parted = bool(labels.amax() > 1) and not whole
        if not parted and search.closing_px << level >= pitches * pitch:
            return panel
        coarse, level = components.halve_mask(coarse), level + 1


def is_single(mask: Tensor) -> Tensor:
    """Say of masks (B,H,W) that they are one 8-connected blob; False leaves it open.

    A mask is single where a row has a single run, each run above touches one below it, and each run below
    touches one above it. Of closed panels nearly all are found so, without a label.

    Example:
        >>> is_single(torch.tensor([[[1, 0, 1], [1, 1, 1], [0, 1, 0]], [[1, 0, 1]] * 3]).bool()).tolist()
        [True, False]
    """
    wide = nn.functional.pad(mask, [1, 1])
    starts = mask & ~wide[..., :-2]
    runs = starts.sum(2)
    near = nn.functional.pad(wide[..., :-2] | wide[..., 2:] | mask, [0, 0, 1, 1])
    above = mask & near[:, :-2]
    # On a CPU most masks need no more: one run a row, of which the first alone touches none above.
    free = (runs > 0) & ~above.any(2)
    plain = (runs.amax(1) == 1) & (free.sum(1) == 1)
    rows = (~plain).nonzero()[:, 0] if mask.is_cpu else slice(None)
    number = starts[rows].cumsum(2, dtype=torch.int16)
    runs, alone = runs[rows], []
    for beside in (above[rows], (mask & near[:, 2:])[rows]):
        touched = beside.new_zeros(*beside.shape[:2], mask.shape[2] // 2 + 2)
        touched.scatter_(2, (number * beside).long(), True)
        alone.append(runs - touched[..., 1:].sum(2))
    up, down = alone
    others = up.flip(1).cumsum(1).flip(1) - up + down.cumsum(1) - down
    plain[rows] = ((runs == 1) & (others == 0)).any(1)
    return plain


def choose_single(
    mask: Tensor, place_px: Tensor, shape: PanelShape, search: LocatorLimits
) -> tuple[Panels, Tensor]:
    """Choose as :func:`climb` does where one closing makes a mask a single blob, the most common case.

    No number is looked at on an accelerator.

    Args:
        mask: (B,H,W) bool, each mask's foreground starting in its first row and its first column.
        place_px: (B,2) where the masks' first pixels are, (x, y).
        shape: the panel looked for.
        search: limits and settings.

    Returns:
        The choices, with corners counted as ``place_px`` is, and (B,) bool, where they hold. The ladder is
        left those whose closed mask has several blobs, whose blob is outside the limits, and those that it
        would climb for.

    Example:
        >>> mask, place = torch.ones(1, 20, 20).bool(), torch.tensor([[30, 0]])
        >>> mask[0, 5, 5] = False
        >>> panels, sure = choose_single(mask, place, PanelShape(8, 8), LocatorLimits())
        >>> sure.tolist(), panels.corners_px[0, 2].tolist()
        ([True], [50.0, 20.0])
    """
    closed = components.close_mask(mask[:, None], search.closing_px)[:, 0]
    first, last = components.row_ends(mask)
    area_px = closed.sum((1, 2))
    corners_px, within, score, pitch_px = measure_blobs(
        first, last, area_px, place_px, shape, search, at_once=not mask.is_cpu
    )
    sure = is_single(closed) & (area_px >= search.min_area_px) & within
    sure &= search.closing_px >= LADDER.reach_pitches * pitch_px
    found = sure & (score > 0)
    corners_px = torch.where(sure[:, None, None], corners_px, 0.0)
    return Panels(corners_px, found, torch.where(sure, score, 0.0), sure.long()), sure
