"""Where the panel is in each frame: the paper's locator (section IV-B-2, Fig. 18) at every scale."""

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind
from vocc_torch.receiver import components, foreground
from vocc_torch.receiver.limits import LocatorLimits
from vocc_torch.receiver.locators.protocol import PanelLocator
from vocc_torch.receiver.quadrilateral import Measures, measure_blobs
from vocc_torch.types import Candidates, Frames, Images, Panels, PanelShape


@dataclass(frozen=True)
class LadderSettings:
    """How the ladder of closings is climbed."""

    pass_px: int = 1 << 21  # most pixels in one pass, for bounded memory
    small_pass_px: int = 1 << 18  # passes below this are not worth parting further
    small_mask_px: int = 1 << 15  # up to this size masks are tried without the ladder
    most_side_px: int = 1 << 15  # columns of a blob are counted in 16 bits
    merge_ratio: float = 0.75  # of the best score so far: a merged blob explains more, so it may score less
    whole_share: float = (
        0.99  # of the foreground: a blob that holds it leaves nothing worth merging
    )
    reach_pitches: float = 1.4  # LED pitches that span one Off LED between two On ones
    last_pitches: float = 3.0  # LED pitches that fill all but the widest gaps


LADDER = LadderSettings()

_TOUCHING = np.ones((3, 3), dtype=bool)


class Stages(NamedTuple):
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
        raise VoccError(
            f"frames.grey is {grey.dtype}: it must be torch.uint8 or floating"
        )
    if not bool(grey.isfinite().all()):
        raise VoccError(
            "frames.grey holds NaN or infinity: it must be grey values, 0 to 255"
        )
    return grey.round().clamp(0, 255).to(torch.uint8)


def paper_stages(frames: Frames, closing_px: int = 11) -> Stages:
    """Compute the threshold, the mask and the closed mask of each frame, for figures.

    Example:
        >>> stages = paper_stages(Frames.whole(torch.tensor([[[0, 9, 0, 9, 0]]], dtype=torch.uint8)), 3)
        >>> stages.threshold.tolist(), stages.closed.int().flatten().tolist()
        ([0], [0, 1, 1, 1, 0])
    """
    exact = exact_frames(frames)
    threshold = foreground.otsu_threshold(foreground.sensor_histogram(exact))
    mask = exact.grey > threshold.view(-1, 1, 1, 1)
    return Stages(threshold, mask, components.close_mask(mask, closing_px))


@dataclass(frozen=True, slots=True)
class Choice(Panels):
    """The panels chosen so far, of which some can be taken and overwritten; zeros where there is none.

    Args:
        first_px: (B,2) int64, column and row of the first pixel of the chosen blob, in its mask.
        mask_px: (B,) int64, number of the blob's mask pixels.
    """

    first_px: Tensor
    mask_px: Tensor

    @classmethod
    def none(cls, masks: int, device: torch.device) -> Self:
        """Start with nothing chosen."""
        count = torch.zeros(masks, dtype=torch.int64, device=device)
        corners = count.new_zeros(masks, 4, 2, dtype=torch.float64)
        score = corners[:, 0, 0].clone()
        return cls(
            corners, score > 0, score, count, count.new_zeros(masks, 2), count.clone()
        )


@dataclass(frozen=True)
class PaperLocator(LocatorLimits, PanelLocator):
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
        exact = exact_frames(frames)
        exact = foreground.trimmed(exact)
        threshold = foreground.otsu_threshold(foreground.sensor_histogram(exact))
        levels = (
            ()
            if exact.surround is None
            else zip(exact.surround.tolist(), threshold.tolist(), strict=True)
        )
        bright = [
            row for row, (level, limit) in enumerate(levels) if round(level) > limit
        ]
        choice = self.choose(
            exact,
            threshold.index_fill(0, torch.tensor(bright), 255) if bright else threshold,
            shape,
        )
        for at in (slice(row, row + 1) for row in bright):
            choice.put(at, self.choose(_on_sensor(exact[at]), threshold[at], shape))
        return Panels(choice.corners_px, choice.found, choice.score, choice.candidates)

    def choose(self, frames: Frames, threshold: Tensor, shape: PanelShape) -> Choice:
        """Choose the blobs above thresholds (B,) in uint8 frames whose surround is background.

        Returns:
            The choice, with corners on the sensor.
        """
        boxes, grey = _foreground_boxes(frames.grey, threshold), frames.grey
        place, choice = boxes[:, :2] + frames.origin_px.cpu().numpy(), None
        for some, width, height in _passes(boxes):
            mask = _cut(grey, threshold, boxes, some, width, height)
            if grey.device.type == "cpu" and width * height <= LADDER.small_mask_px:
                chosen, part = choose_single(mask.numpy(), place[some], shape, self)
                if len(chosen) == len(boxes) == 1:
                    return part
                choice = choice or Choice.none(len(boxes), grey.device)
                choice.put(torch.from_numpy(some[chosen]), part)
                mask, some = (
                    mask[np.delete(np.arange(len(some)), chosen)],
                    np.delete(some, chosen),
                )
            if len(some):
                rows, at = (
                    torch.from_numpy(rows).to(grey.device)
                    for rows in (some, place[some])
                )
                part = climb(mask, shape, self)
                part.corners_px.add_((at * part.found[:, None])[:, None])
                choice = choice or Choice.none(len(boxes), grey.device)
                choice.put(rows, part)
        return choice or Choice.none(len(boxes), grey.device)


def exact_frames(frames: Images) -> Frames:
    """Return the frames in uint8, or refuse what no locator can read.

    Raises:
        VoccError: what :func:`quantised` refuses, another shape than (B,1,H,W), a side above 32,768 px, a
            surround that is not finite, or a crop with a surround that is not on its sensor.

    Example:
        >>> exact_frames(Frames.whole(torch.full((1, 2, 2), 9.4))).grey.unique().tolist()
        [9]
    """
    frames = Frames.of(frames)
    shape, surround = tuple(frames.grey.shape), frames.surround
    if len(shape) != 4 or shape[1] != 1:
        raise VoccError(f"frames.grey has shape {shape}: it must be (B,1,H,W)")
    if max(shape[2:]) > LADDER.most_side_px:
        raise VoccError.of(
            "frames.grey",
            f"{shape[2]} x {shape[3]} px",
            f"at most {LADDER.most_side_px} px a side",
        )
    if surround is not None:
        if not bool(surround.isfinite().all()):
            raise VoccError(
                "frames.surround holds NaN or infinity: it must be grey values, 0 to 255"
            )
        room = frames.origin_px.new_tensor(
            frames.sensor_px[::-1]
        ) - frames.origin_px.new_tensor(shape[:1:-1])
        if not bool(((frames.origin_px >= 0) & (frames.origin_px <= room)).all()):
            raise VoccError(
                f"frames.origin_px lays a crop, {shape[2:]}, off its sensor, {frames.sensor_px}"
            )
    return Frames(quantised(frames.grey), frames.origin_px, frames.sensor_px, surround)


def _on_sensor(crop: Frames) -> Frames:
    """Fill one crop up to its whole sensor with its surround."""
    assert crop.surround is not None
    level = int(crop.surround.round().clamp(0, 255))
    grey = torch.full(
        (1, 1, *crop.sensor_px), level, dtype=torch.uint8, device=crop.grey.device
    )
    x, y = crop.origin_px[0].tolist()
    height, width = crop.grey.shape[-2:]
    grey[..., y : y + height, x : x + width] = crop.grey
    return Frames.whole(grey)


def _foreground_boxes(grey: Tensor, threshold: Tensor) -> NDArray[np.int64]:
    """Bound the pixels above the thresholds: (B,4) left, top, width, height; zeros where there are none."""
    boxes = np.zeros((len(grey), 4), dtype=np.int64)
    on_host = grey.device.type == "cpu"
    planes: Any = grey[:, 0].numpy() if on_host else grey[:, 0]
    limit = threshold.cpu().numpy()[:, None]
    for place, axis in enumerate((1, 2) if grey.numel() else ()):
        # Maxima of bytes first: comparing them all would write a mask as large as the frames.
        most = (
            np.amax(planes, axis) if on_host else torch.amax(planes, axis).cpu().numpy()
        )
        lit = most > limit
        first = lit.argmax(1)
        boxes[:, place] = first
        boxes[:, place + 2] = (lit.shape[1] - lit[:, ::-1].argmax(1) - first) * lit.any(
            1
        )
    return boxes


def _passes(boxes: NDArray[np.int64]) -> list[tuple[NDArray[np.int64], int, int]]:
    """Group frames by the size of their box of foreground: indices, common width and height of each pass."""
    area = boxes[:, 2] * boxes[:, 3]
    order = area.argsort(kind="stable")
    order = order[area[order] > 0]
    sizes = boxes[order, 2:].tolist()
    passes: list[tuple[NDArray[np.int64], int, int]] = []
    begin = width = height = pixels = 0
    for index, (wide, high) in enumerate(sizes):
        padded = (index + 1 - begin) * max(width, wide) * max(height, high)
        if index > begin and padded > min(
            LADDER.pass_px, max(LADDER.small_pass_px, 4 * (pixels + wide * high))
        ):
            passes.append((order[begin:index], width, height))
            begin, width, height, pixels = index, 0, 0, 0
        width, height, pixels = (
            max(width, wide),
            max(height, high),
            pixels + wide * high,
        )
    if sizes:
        passes.append((order[begin:], width, height))
    return passes


def _cut(
    grey: Tensor,
    threshold: Tensor,
    boxes: NDArray[np.int64],
    some: NDArray[np.int64],
    width: int,
    height: int,
) -> Tensor:
    """Threshold the boxes of some frames into masks of a common size (b,height,width), background beyond."""
    if grey.device.type == "cpu":
        planes, limits = grey[:, 0].numpy(), threshold.tolist()
        masks = np.zeros((len(some), height, width), dtype=bool)
        for mask, row, (left, top, wide, high) in zip(
            masks, some.tolist(), boxes[some].tolist(), strict=True
        ):
            mask[:high, :wide] = (
                planes[row, top : top + high, left : left + wide] > limits[row]
            )
        return torch.from_numpy(masks)
    rows, box = (
        torch.from_numpy(column).to(grey.device) for column in (some, boxes[some])
    )
    down = torch.arange(height, device=grey.device)
    right = torch.arange(width, device=grey.device)
    y, x = box[:, 1, None] + down, box[:, 0, None] + right
    inside_y, inside_x = y < grey.shape[-2], x < grey.shape[-1]
    y, x = y.clamp(max=grey.shape[-2] - 1), x.clamp(max=grey.shape[-1] - 1)
    values = grey[rows[:, None, None], 0, y[:, :, None], x[:, None, :]]
    return (
        (values > threshold[rows, None, None])
        & inside_y[:, :, None]
        & inside_x[:, None, :]
    )


def climb(mask: Tensor, shape: PanelShape, search: LocatorLimits) -> Choice:
    """Choose the panel's blob in each mask by the rule in :class:`PaperLocator`: the ladder of closings.

    Args:
        mask: (B,H,W) bool, each mask's foreground starting in its first row and first column.
        shape: the panel looked for.
        search: limits and settings.

    Returns:
        The choice, of length B, in the masks' coordinates.

    Example:
        >>> mask = torch.zeros(1, 9, 40, dtype=torch.bool)
        >>> mask[0, :, :9] = mask[0, :5, 30:] = True
        >>> climb(mask, PanelShape(1, 1), LocatorLimits(3, 1, 0.0, 0.0, "upright")).candidates.tolist()
        [2]
    """
    choice = Choice.none(len(mask), mask.device)
    peak, foreground = choice.score.clone(), mask.sum((1, 2))
    active = torch.arange(len(mask), device=mask.device)
    coarse, level, runs = mask, 0, None
    while True:
        closed = components.close_mask(coarse[:, None], search.closing_px)[:, 0]
        labelled = components.label_components(closed)
        runs = components.joined(mask, labelled.runs) if runs is None else runs
        blobs = components.collect_blobs(
            runs, labelled, min_area_px=search.min_area_px, level=level
        )
        now, pitch, label = _level_choice(blobs, len(active), shape, search)
        before = choice[active]
        column, row = (before.first_px >> level).unbind(1)
        holds = (
            labelled.at(torch.arange(len(active), device=mask.device), row, column)
            == label
        )
        # A blob that holds the chosen one and more may score a little less; the same blob may not.
        bar = torch.where(
            now.mask_px > before.mask_px,
            LADDER.merge_ratio * peak[active],
            before.score,
        )
        better = (
            torch.where(holds, now.score >= bar, now.score > before.score)
            | ~before.found
        )
        better &= now.found
        choice.put(active[better], now[better])
        peak[active[better]] = torch.where(
            holds, torch.maximum(peak[active], now.score), now.score
        )[better]
        whole_panels = choice.mask_px[active] >= LADDER.whole_share * foreground[active]
        pitches = torch.where(whole_panels, LADDER.reach_pitches, LADDER.last_pitches)
        on = ((blobs.components > 1) & ~whole_panels) | (
            (search.closing_px << level) < pitches * pitch
        )
        if not bool(on.any()):
            return choice
        active, runs, coarse = (
            active[on],
            runs.of(on),
            components.halve_mask(coarse[on][:, None])[:, 0],
        )
        level += 1


def _level_choice(
    blobs: components.Blobs, masks: int, shape: PanelShape, search: LocatorLimits
) -> tuple[Choice, Tensor, Tensor]:
    """Choose at one level: the best blobs within limits, the pitch of the best of all, the labels."""
    blobs_of = (
        blobs.first,
        blobs.last,
        blobs.area_px,
        blobs.left_px,
        blobs.first_px[:, 1],
    )
    first, last, area_px, left, top = (blob.cpu().numpy() for blob in blobs_of)
    measures = measure_blobs(
        first, last, area_px, np.stack([left, top], 1), shape, search
    )
    parts = (measures.corners_px, measures.within, measures.score, measures.pitch_px)
    corners_px, passed, score, pitch_px = (
        torch.from_numpy(part).to(blobs.frame.device) for part in parts
    )
    chosen = []
    # Each mask's allowed blob of highest score, the first of equals, M if there is none.
    for allowed in (passed, torch.ones_like(passed)):
        frame = blobs.frame[allowed]
        highest = score.new_zeros(masks)
        highest = highest.scatter_reduce(
            0, frame, score[allowed], "amax", include_self=False
        )
        top_blob = (allowed & (score == highest[blobs.frame])).nonzero()[:, 0]
        none = torch.full_like(blobs.components, len(blobs))
        chosen.append(none.scatter_reduce(0, blobs.frame[top_blob], top_blob, "amin"))
    best, likely = chosen
    found = (best < len(blobs)).nonzero()[:, 0]
    blob = best[found]
    candidates = torch.bincount(blobs.frame[passed], minlength=masks)[found]
    values = (
        corners_px[blob],
        score[blob] > 0,
        score[blob],
        candidates,
        blobs.first_px[blob],
    )
    choice = Choice.none(masks, best.device)
    choice.put(found, Choice(*values, blobs.mask_px[blob]))
    label = torch.zeros_like(best).index_copy(0, found, blobs.label[blob])
    return choice, torch.cat([pitch_px, pitch_px.new_zeros(1)])[likely], label


def _row_ends(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last foreground column of each row (B,H) of masks (B,H,W); 0 and -1 where there is none."""
    first, last = mask.argmax(2), mask.shape[2] - 1 - mask[..., ::-1].argmax(2)
    last[~mask.any(2)] = -1
    return first, last


def _is_sure(measures: Measures, search: LocatorLimits) -> NDArray[np.bool_]:
    """Say of blobs that are alone in their masks whether the ladder would stop at them."""
    return measures.within & (
        search.closing_px >= LADDER.reach_pitches * measures.pitch_px
    )


def choose_single(
    mask: NDArray[np.bool_],
    place_px: NDArray[np.int64],
    shape: PanelShape,
    search: LocatorLimits,
) -> tuple[NDArray[np.int64], Choice]:
    """Choose as :func:`climb` does where one closing makes a mask a single blob, the most common case.

    Args:
        mask: (B,H,W) bool, each mask's foreground starting in its first row and its first column.
        place_px: (B,2) where the masks' first pixels are, (x, y).
        shape: the panel looked for.
        search: limits and settings.

    Returns:
        The indices (n,) of the masks whose choice is made, and the choice, with corners counted as
        ``place_px`` is; the ladder is left those whose closed mask has several blobs, whose blob is outside
        the limits, and those that it would climb for.

    Example:
        >>> mask, place = np.ones((1, 20, 20), dtype=bool), np.array([[30, 0]])
        >>> mask[0, 5, 5] = False
        >>> chosen, choice = choose_single(mask, place, PanelShape(8, 8), LocatorLimits())
        >>> chosen.tolist(), choice.corners_px[0, 2].tolist()
        ([0], [50.0, 20.0])
    """
    closed = components.close_mask(torch.from_numpy(mask)[:, None], search.closing_px)[
        :, 0
    ].numpy()
    (first, last), area_px = _row_ends(closed), closed.sum((1, 2))
    # With one run in every row, each of which touches the next, it is a blob and need not be labelled.
    touching = (
        (first[:, 1:] <= last[:, :-1] + 1)
        & (first[:, :-1] <= last[:, 1:] + 1)
        & (last[:, :-1] >= 0)
    )
    plain = ((last - first + 1).sum(1) == area_px) & (touching | (last[:, 1:] < 0)).all(
        1
    )
    # Loaded here because the other locators need no SciPy.
    from scipy.ndimage import label

    several = [r for r in (~plain).nonzero()[0] if label(closed[r], _TOUCHING)[1] != 1]
    area_px[several] = 0
    single = (area_px >= search.min_area_px).nonzero()[0]
    lit = mask[single]
    first, last = _row_ends(lit)
    measures = measure_blobs(
        first, last, area_px[single], place_px[single], shape, search
    )
    sure = _is_sure(measures, search)
    score, full = measures.score, np.ones_like(single)
    seed = np.zeros((len(single), 2), dtype=np.int64)
    seed[:, 0] = first[:, 0]
    parts = (measures.corners_px, score > 0, score, full, seed, lit.sum((1, 2)))
    rows = slice(None) if sure.all() else sure
    return single[rows], Choice(*(torch.from_numpy(part[rows]) for part in parts))
