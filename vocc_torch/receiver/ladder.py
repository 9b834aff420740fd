"""Which blob of a mask is the panel, at every scale: measures, choice, and the ladder of closings."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import torch
from torch import Tensor

from vocc_torch.receiver.blobs import Blobs, collect_blobs, compactness, proportion, rectangularity
from vocc_torch.receiver.components import Components, joined, label_components
from vocc_torch.receiver.morphology import close_mask, halve_mask
from vocc_torch.receiver.quadrilateral import (
    convex_hull,
    hull_area_and_perimeter,
    minimum_area_rectangle,
    upright_rectangle,
)
from vocc_torch.types import PanelShape

Quadrilateral = Literal["min_area", "upright"]

# A merged blob replaces one of its parts from this share of the best score so far on, for it explains more.
_MERGE_RATIO = 0.75
# A blob with this share of the frame's foreground leaves nothing worth merging.
_WHOLE_SHARE = 0.99
REACH_PITCHES = 1.4
"""From this many LED pitches on a closing spans one Off LED between two On ones."""

# From this many on it has filled all but the widest gaps: no blob will look more like a panel later.
_LAST_PITCHES = 3.0
# Most pairs of rows or of vertices in one step, to bound the memory.
_STEP_PAIRS = 1 << 21


@dataclass(frozen=True, slots=True)
class Search:
    """What to look for; the fields are those of :class:`vocc_torch.receiver.location.PaperLocator`."""

    closing_px: int
    min_area_px: int
    min_rectangularity: float
    min_compactness: float
    quadrilateral: Quadrilateral


@dataclass(slots=True)
class Choice:
    """The best blob of each of B masks, in the mask's coordinates; zeros where there is none.

    Args:
        score: (B,) float64, above 0 where a blob is chosen.
        corners_px: (B,4,2) float64, as in :class:`vocc_torch.receiver.quadrilateral.Rectangles`.
        candidates: (B,) int64, number of blobs within the limits at the blob's level.
        first_px: (B,2) int64, column and row of the blob's first pixel.
        mask_px: (B,) int64, number of the blob's mask pixels.
    """

    score: Tensor
    corners_px: Tensor
    candidates: Tensor
    first_px: Tensor
    mask_px: Tensor

    @classmethod
    def none(cls, masks: int, device: torch.device) -> Choice:
        """Start with nothing chosen."""
        count = torch.zeros(masks, dtype=torch.int64, device=device)
        corners = torch.zeros(masks, 4, 2, dtype=torch.float64, device=device)
        return cls(corners[:, 0, 0].clone(), corners, count, count.new_zeros(masks, 2), count.clone())

    def __getitem__(self, rows: Tensor) -> Choice:
        """Take the masks of an index or a bool mask."""
        return Choice(*(getattr(self, field.name)[rows] for field in fields(self)))

    def put(self, rows: Tensor, other: Choice) -> None:
        """Overwrite the masks ``rows``."""
        for field in fields(self):
            getattr(self, field.name)[rows] = getattr(other, field.name)


@dataclass(frozen=True, slots=True)
class Measures:
    """How panel-like each blob is; ``score`` is rectangularity x compactness x proportion^2.

    Proportion counts twice, for it is what suffers first when a panel is merged with something beside it.

    Args:
        rectangularity: (M,) float64.
        compactness: (M,) float64.
        score: (M,) float64, 0 to 1.
        corners_px: (M,4,2) float64, in the mask's coordinates.
        pitch_px: (M,) float64, LED pitch if the blob were the panel: the root of the rectangle's area by LED.
    """

    rectangularity: Tensor
    compactness: Tensor
    score: Tensor
    corners_px: Tensor
    pitch_px: Tensor


def measure_blobs(blobs: Blobs, shape: PanelShape, quadrilateral: Quadrilateral = "min_area") -> Measures:
    """Measure each blob against the panel looked for.

    Args:
        blobs: M blobs.
        shape: the panel looked for.
        quadrilateral: which rectangle to give; the measures are always those of the minimum-area one.

    Example:
        >>> components = label_components(torch.ones(1, 6, 6, dtype=torch.bool))
        >>> measures = measure_blobs(collect_blobs(components.runs, components), PanelShape(2, 2))
        >>> measures.score.item(), measures.pitch_px.item()
        (1.0, 3.0)
    """
    real = blobs.area_px.new_zeros(len(blobs), dtype=torch.float64)
    out = Measures(real, real.clone(), real.clone(), real.new_zeros(len(blobs), 4, 2), real.clone())
    for rows, height in _steps(blobs):
        hull = convex_hull(blobs.first[rows, :height], blobs.last[rows, :height])
        area, perimeter = hull_area_and_perimeter(hull)
        least = minimum_area_rectangle(hull)
        corners = (least if quadrilateral == "min_area" else upright_rectangle(hull)).corners_px
        # Cells of a coarse level overlap the blob's edge: a true closing stays within the hull.
        closed = torch.minimum(blobs.area_px[rows].double(), area)
        out.rectangularity[rows] = rectangularity(closed, least.area_px)
        out.compactness[rows] = compactness(area, perimeter, shape)
        sides = proportion(least.width_px, least.height_px, shape)
        out.score[rows] = out.rectangularity[rows] * out.compactness[rows] * sides**2
        corner = torch.stack([blobs.left_px[rows], blobs.first_px[rows, 1]], 1)
        out.corners_px[rows] = corners + corner[:, None]
        out.pitch_px[rows] = (least.area_px / shape.leds).sqrt()
    return out


def _steps(blobs: Blobs) -> list[tuple[Tensor, int]]:
    """Part the blobs, sorted by height, in steps of bounded memory: their indices and greatest height."""
    heights, order = blobs.heights_px().sort(stable=True)
    steps: list[tuple[Tensor, int]] = []
    begin, tall = 0, heights.tolist()
    for index, height in enumerate(tall):
        last = index + 1 == len(tall)
        if last or (index + 2 - begin) * tall[index + 1] ** 2 > _STEP_PAIRS:
            steps.append((order[begin : index + 1], height))
            begin = index + 1
    return steps


def _best(blobs: Blobs, masks: int, value: Tensor, allowed: Tensor) -> Tensor:
    """Give the index (B,) of each mask's allowed blob of highest value, the first of equals, M if none."""
    frame = blobs.frame[allowed]
    highest = value.new_zeros(masks).scatter_reduce(0, frame, value[allowed], "amax", include_self=False)
    top = allowed & (value == highest[blobs.frame])
    index = torch.arange(len(blobs), device=value.device)[top]
    none = torch.full((masks,), len(blobs), device=value.device)
    return none.scatter_reduce(0, blobs.frame[top], index, "amin")


def climb(mask: Tensor, shape: PanelShape, search: Search) -> Choice:
    """Choose the panel's blob in each mask by the rule in :class:`vocc_torch.receiver.location.PaperLocator`.

    Args:
        mask: (B,H,W) bool, each mask's foreground starting in its first row and first column.
        shape: the panel looked for.
        search: limits and settings.

    Returns:
        The choice, of length B.

    Example:
        >>> mask = torch.zeros(1, 9, 40, dtype=torch.bool)
        >>> mask[0, :, :9] = mask[0, :5, 30:] = True
        >>> climb(mask, PanelShape(1, 1), Search(3, 1, 0.0, 0.0, "upright")).candidates.tolist()
        [2]
    """
    choice = Choice.none(mask.shape[0], mask.device)
    peak = choice.score.clone()
    active = torch.arange(mask.shape[0], device=mask.device)
    foreground, coarse, level = mask.sum((1, 2)), mask, 0
    components = _closed_components(mask, search)
    runs = joined(mask, components.runs)
    while True:
        blobs = collect_blobs(runs, components, min_area_px=search.min_area_px, level=level)
        now, pitch, label = _level_choice(blobs, len(active), shape, search)
        before = choice[active]
        column, row = (before.first_px >> level).unbind(1)
        holds = components.at(torch.arange(len(active), device=mask.device), row, column) == label
        better = _replaces(before, now, holds, peak[active])
        choice.put(active[better], now[better])
        peak[active[better]] = torch.where(holds, torch.maximum(peak[active], now.score), now.score)[better]
        whole = choice.mask_px[active] >= _WHOLE_SHARE * foreground[active]
        on = _climbs_on(whole, blobs.components, pitch, search.closing_px << level)
        if not bool(on.any()):
            return choice
        active, runs, coarse = active[on], runs.of(on), halve_mask(coarse[on][:, None])[:, 0]
        components = _closed_components(coarse, search)
        level += 1


def _closed_components(mask: Tensor, search: Search) -> Components:
    """Close masks (B,H,W) and label what comes of them."""
    return label_components(close_mask(mask[:, None], search.closing_px)[:, 0])


def _level_choice(
    blobs: Blobs, masks: int, shape: PanelShape, search: Search
) -> tuple[Choice, Tensor, Tensor]:
    """Choose at one level: the best blobs within limits, the pitch of the best of all, the labels."""
    measures = measure_blobs(blobs, shape, search.quadrilateral)
    passed = measures.rectangularity >= search.min_rectangularity
    passed &= measures.compactness >= search.min_compactness
    best = _best(blobs, masks, measures.score, passed)
    found = (best < len(blobs)).nonzero()[:, 0]
    blob = best[found]
    choice = Choice.none(masks, best.device)
    candidates = torch.bincount(blobs.frame[passed], minlength=masks)[found]
    chosen = (measures.score[blob], measures.corners_px[blob], candidates)
    choice.put(found, Choice(*chosen, blobs.first_px[blob], blobs.mask_px[blob]))
    label = torch.zeros_like(best).index_copy(0, found, blobs.label[blob])
    likely = _best(blobs, masks, measures.score, torch.ones_like(passed))
    pitch = torch.cat([measures.pitch_px, measures.pitch_px.new_zeros(1)])[likely]
    return choice, pitch, label


def _replaces(before: Choice, now: Choice, holds: Tensor, peak: Tensor) -> Tensor:
    """Decide (B,) where a level's choice replaces the one from below."""
    merged = torch.where(
        now.mask_px > before.mask_px, now.score >= _MERGE_RATIO * peak, now.score >= before.score
    )
    return (now.score > 0) & ((before.score == 0) | torch.where(holds, merged, now.score > before.score))


def _climbs_on(whole: Tensor, components: Tensor, pitch: Tensor, reach_px: int) -> Tensor:
    """Decide (B,) which masks need the next level; ``whole`` says where the choice holds nearly all."""
    pitches = torch.where(whole, REACH_PITCHES, _LAST_PITCHES)
    return ((components > 1) & ~whole) | (reach_px < pitches * pitch)
