"""Which blob of a mask is the panel, at every scale: the ladder of closings."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import scipy.ndimage
import torch
from torch import Tensor

from vocc_torch.receiver.components import (
    Blobs,
    Components,
    close_mask,
    collect_blobs,
    halve_mask,
    joined,
    label_components,
)
from vocc_torch.receiver.limits import LocatorLimits
from vocc_torch.receiver.quadrilateral import Measures, measure_blobs
from vocc_torch.types import PanelShape

# A merged blob replaces one of its parts from this share of the best score so far on, for it explains more.
_MERGE_RATIO = 0.75
# A blob with this share of the frame's foreground leaves nothing worth merging.
_WHOLE_SHARE = 0.99
REACH_PITCHES = 1.4
"""From this many LED pitches on a closing spans one Off LED between two On ones."""

# From this many on it has filled all but the widest gaps: no blob will look more like a panel later.
_LAST_PITCHES = 3.0


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
        """Return the choices of an index or a bool mask."""
        return Choice(*(getattr(self, field.name)[rows] for field in fields(self)))

    def put(self, rows: Tensor, other: Choice) -> None:
        """Overwrite the masks ``rows``."""
        for field in fields(self):
            getattr(self, field.name)[rows] = getattr(other, field.name)


def _best(blobs: Blobs, masks: int, value: Tensor, allowed: Tensor) -> Tensor:
    """Return the index (B,) of each mask's allowed blob of highest value, the first of equals, M if none."""
    frame = blobs.frame[allowed]
    highest = value.new_zeros(masks).scatter_reduce(0, frame, value[allowed], "amax", include_self=False)
    top = allowed & (value == highest[blobs.frame])
    index = torch.arange(len(blobs), device=value.device)[top]
    none = torch.full((masks,), len(blobs), device=value.device)
    return none.scatter_reduce(0, blobs.frame[top], index, "amin")


def climb(mask: Tensor, shape: PanelShape, search: LocatorLimits) -> Choice:
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
        >>> climb(mask, PanelShape(1, 1), LocatorLimits(3, 1, 0.0, 0.0, "upright")).candidates.tolist()
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
        # A blob that holds the chosen one and more may score a little less; the same blob may not.
        bar = torch.where(now.mask_px > before.mask_px, _MERGE_RATIO * peak[active], before.score)
        better = torch.where(holds, now.score >= bar, now.score > before.score) | (before.score == 0)
        better &= now.score > 0
        choice.put(active[better], now[better])
        peak[active[better]] = torch.where(holds, torch.maximum(peak[active], now.score), now.score)[better]
        whole = choice.mask_px[active] >= _WHOLE_SHARE * foreground[active]
        pitches = torch.where(whole, REACH_PITCHES, _LAST_PITCHES)
        on = ((blobs.components > 1) & ~whole) | ((search.closing_px << level) < pitches * pitch)
        if not bool(on.any()):
            return choice
        active, runs, coarse = active[on], runs.of(on), halve_mask(coarse[on][:, None])[:, 0]
        components = _closed_components(coarse, search)
        level += 1


def _closed_components(mask: Tensor, search: LocatorLimits) -> Components:
    """Close masks (B,H,W) and label what comes of them."""
    return label_components(close_mask(mask[:, None], search.closing_px)[:, 0])


def _level_choice(
    blobs: Blobs, masks: int, shape: PanelShape, search: LocatorLimits
) -> tuple[Choice, Tensor, Tensor]:
    """Choose at one level: the best blobs within limits, the pitch of the best of all, the labels."""
    measures = measure_blobs(blobs, shape, search.quadrilateral)
    passed = _within(measures, search)
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


def choose_single(mask: Tensor, shape: PanelShape, search: LocatorLimits) -> tuple[Tensor, Choice]:
    """Choose as :func:`climb` does where one closing makes a mask a single blob, the most common case.

    In the CPU's memory a call on a tensor costs more than the arithmetic of a small mask; SciPy labels there.

    Args:
        mask: (B,H,W) bool in the CPU's memory, each mask's foreground starting in its first row and column.
        shape: the panel looked for.
        search: limits and settings.

    Returns:
        The indices (n,) of the masks whose choice is made, and the choice; the ladder is left those whose
        closed mask has several blobs, whose blob is outside the limits, and those that it would climb for.

    Example:
        >>> mask = torch.ones(1, 20, 20, dtype=torch.bool)
        >>> mask[0, 5, 5] = False
        >>> chosen, choice = choose_single(mask, PanelShape(8, 8), LocatorLimits())
        >>> chosen.tolist(), choice.corners_px[0, 2].tolist()
        ([0], [20.0, 20.0])
    """
    closed = close_mask(mask[:, None], search.closing_px)[:, 0].numpy()
    single = [row for row, one in enumerate(closed) if scipy.ndimage.label(one, np.ones((3, 3)))[1] == 1]
    single = [row for row in single if np.count_nonzero(closed[row]) >= search.min_area_px]
    if not single:
        return torch.zeros(0, dtype=torch.int64), Choice.none(0, mask.device)
    lit, area_px = mask[single].numpy(), torch.from_numpy(closed[single].sum((1, 2)))
    some = lit.any(2)
    first = torch.from_numpy(np.where(some, lit.argmax(2), 0))
    last = torch.from_numpy(np.where(some, lit.shape[2] - 1 - lit[..., ::-1].argmax(2), -1))
    one, mask_px = torch.ones_like(area_px), torch.from_numpy(lit.sum((1, 2)))
    seed = torch.stack([first[:, 0], 0 * one], 1)
    blobs = Blobs(one.cumsum(0) - 1, one.cumsum(0), seed, 0 * one, area_px, mask_px, first, last, one)
    measures = measure_blobs(blobs, shape, search.quadrilateral)
    sure = _within(measures, search) & (search.closing_px >= REACH_PITCHES * measures.pitch_px)
    choice = Choice(measures.score, measures.corners_px, one, seed, mask_px)
    return torch.tensor(single)[sure], choice[sure]


def _within(measures: Measures, search: LocatorLimits) -> Tensor:
    """Whether each blob (M,) is within the limits."""
    passed = measures.rectangularity >= search.min_rectangularity
    return passed & (measures.compactness >= search.min_compactness)
