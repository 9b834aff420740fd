"""The located panel resampled to one fixed grid: K x K samples an LED cell, with one cell of margin.

The projective maps between cells and pixels are those of Heckbert (1989).
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from vocc_torch.errors import VoccError
from vocc_torch.receiver.features import checked_greys
from vocc_torch.types import Frames, Panels, PanelShape, holds, is_exporting

MOST_PX = 1e15
"""Corners farther than this from the sensor's corner are no corners."""

MOST_READINGS = 1 << 22
"""Most bilinear readings at a time, and of a frame where its samples alone are not more."""

# Of more readings at a time a processor's cache does not hold what is worked out on the way.
_CACHED_READINGS = 1 << 18

# A corner between sides a and b is one where they part: a x b above this, px^2, and above this share of the
# longest side's square.
_FLAT_PX2, _FLAT_SHARE = 1e-9, 1e-12


def cell_homography(corners_px: Tensor, shape: PanelShape) -> Tensor:
    """Projective map from cell coordinates (column, row; 0 to C, 0 to R) to pixels.

    Args:
        corners_px: (B,4,2) corners of the grid of cells, clockwise from the top left, within 1e15 px. Where
            they are not strictly convex (collinear, coincident, crossed or concave) they are no picture of a
            panel: everything maps onto the first.
        shape: rows and columns.

    Returns:
        (B,3,3) float64 homographies, finite.

    Raises:
        VoccError: a corner that is not finite, or beyond 1e15 px.

    Example:
        >>> corners = torch.tensor([[[2.0, 3.0], [10.0, 3.0], [10.0, 11.0], [2.0, 11.0]]])
        >>> cell_homography(corners, PanelShape(8, 8))[0].round(decimals=6).tolist()
        [[1.0, 0.0, 2.0], [0.0, 1.0, 3.0], [0.0, 0.0, 1.0]]
    """
    xp, corners = _numbers(corners_px)
    return _tensor(_homography(xp, corners, shape), corners_px.device)


def _numbers(*values: Tensor) -> tuple[Any, ...]:
    """Give NumPy and a few numbers in float64 for it; torch and tensors in a graph or for a gradient.

    A call on a tensor costs more than such arithmetic does, and both know the functions that are used here.
    """
    if is_exporting() or any(one.requires_grad for one in values):
        return torch, *(one.to(torch.float64) for one in values)
    return np, *(np.asarray(one.cpu().numpy(), dtype=np.float64) for one in values)


def _tensor(values: Any, device: torch.device) -> Tensor:
    """Give what NumPy or torch made of :func:`_numbers` as a tensor."""
    return values if isinstance(values, Tensor) else torch.from_numpy(values).to(device)


def _cast(values: Any, dtype: Any) -> Any:
    """Give an array or a tensor in a dtype of its own library."""
    return values.to(dtype) if isinstance(values, Tensor) else values.astype(dtype, copy=False)


def _sides(xp: Any, corners: Any) -> Any:
    """Sides of quadrilaterals (B,4,2) as vectors, (B,4,2), from each corner to the next."""
    return xp.concatenate([corners[:, 1:], corners[:, :1]], 1) - corners


def _homography(xp: Any, corners: Any, shape: PanelShape) -> Any:
    """Do what :func:`cell_homography` does, by NumPy or by torch."""
    far = abs(corners) <= MOST_PX
    if not (holds(far) if xp is torch else far.all()):
        most = float(xp.amax(abs(corners)))
        raise VoccError(f"corners_px reaches {most:g} px: corners must be finite and within {MOST_PX:g} px")
    side = _sides(xp, corners)
    skew = corners[:, 2:3] - side[:, :1] - corners[:, 3:]
    # How each side turns to the next; what is askew to the third side; and the second side to what is askew.
    before = xp.concatenate([side, skew, -side[:, 1:2]], 1)
    after = xp.concatenate([side[:, 1:], side[:, :1], side[:, 2:3], skew], 1)
    turn = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
    least = _FLAT_PX2 + _FLAT_SHARE * xp.amax((side * side).sum(2), 1)
    convex = (xp.amin(turn[:, :4], 1) > least) | (xp.amax(turn[:, :4], 1) < -least)
    gh = turn[:, 4:] / xp.where(convex, -turn[:, 1], 1.0)[:, None]
    ends = xp.concatenate([corners, xp.ones_like(corners[..., :1])], 2)
    first, second, fourth = (ends[:, n] for n in (0, 1, 3))
    to_x = (second - first + gh[:, :1] * second) * (1 / shape.columns)
    to_y = (fourth - first + gh[:, 1:] * fourth) * (1 / shape.rows)
    # With zero added, no zero is negative.
    columns = xp.concatenate([to_x[..., None], to_y[..., None]], 2) * convex[:, None, None] + 0.0
    return xp.concatenate([columns, first[..., None]], 2)


def cell_size_px(corners_px: Tensor, shape: PanelShape) -> tuple[Tensor, Tensor]:
    """Mean width and height of an LED cell in the image, (B,) each, px: the gradients' resampling scale.

    Example:
        >>> corners = torch.tensor([[[0.0, 0.0], [16.0, 0.0], [16.0, 24.0], [0.0, 24.0]]])
        >>> [float(size) for size in cell_size_px(corners, PanelShape(8, 8))]
        [2.0, 3.0]
    """
    xp, corners = _numbers(corners_px)
    width, height = (_tensor(one, corners_px.device) for one in _cell_size(xp, corners, shape))
    return width, height


def _cell_size(xp: Any, corners: Any, shape: PanelShape) -> tuple[Any, Any]:
    """Do what :func:`cell_size_px` does, by NumPy or by torch."""
    side = _sides(xp, corners)
    length = xp.sqrt((side * side).sum(2))
    both = (length[:, :2] + length[:, 2:]) / 2
    return both[:, 0] / shape.columns, both[:, 1] / shape.rows


def map_points(corners_px: Tensor, cells: Tensor, shape: PanelShape) -> Tensor:
    """Map points in cell coordinates, (B,P,2) columns and rows, into the image, (B,P,2) px, finite.

    Example:
        >>> corners = torch.tensor([[[2.0, 3.0], [10.0, 3.0], [10.0, 11.0], [2.0, 11.0]]]).double()
        >>> point = torch.tensor([[[8.0, -1.0]]]).double()
        >>> map_points(corners, point, PanelShape(8, 8)).round(decimals=9).tolist()
        [[[10.0, 2.0]]]
    """
    columns = cell_homography(corners_px, shape).mT[:, None]
    mapped = cells[..., :1] * columns[:, :, 0] + cells[..., 1:] * columns[:, :, 1] + columns[:, :, 2]
    # A point on the horizon is as far away as a corner may be.
    return (mapped[..., :2] / mapped[..., 2:]).nan_to_num().clamp(-MOST_PX, MOST_PX)


def _map_grid(xp: Any, homography: Any, x: Any, y: Any) -> Any:
    """Map the grid of cell coordinates x (w,) by y (h,), or each (B,1,w) and (B,1,h), to pixels, (B,2,h,w).

    From the horizon on, where there is no image, it is as far away as just before it, and finite or infinite.
    """
    across = homography[:, :, :1] * x + homography[:, :, 2:]
    mapped = across[:, :, None, :] + (homography[:, :, 1:2] * y)[..., None]
    # Of a map without a horizon, two rows long, the third would be ones.
    if homography.shape[1] == 2:
        return mapped
    with np.errstate(over="ignore"):
        return mapped[:, :2] / mapped[:, 2:].clip(xp.finfo(mapped.dtype).tiny)


class _Window(NamedTuple):
    """Where n frames are read, in few numbers of NumPy or torch.

    Args:
        begin: (n,2) float64, on the sensor, the first pixel of a window that holds all that is read.
        first: (n,2) where that pixel is, counted from a whole sensor pixel beside the panel.
        last: (n,2) where the last pixel that is read is, likewise.
        moved: (n,3,3) from cells to places counted likewise, in which whole numbers are pixel centres; only
            two rows, (n,2,3), where no map has a horizon.
    """

    begin: Any
    first: Any
    last: Any
    moved: Any


def _window(xp: Any, least: Any, most: Any, homography: Any, x_ends: Any, y_ends: Any) -> _Window:
    """Find where n frames are read between the ends of cell coordinates, as :func:`_map_grid` has them.

    On the sensor that is between ``least`` and ``most``, (n,2) float64 or broadcast to it.
    Positions count from a whole sensor pixel beside the panel, so a crop and the full frame give the same
    values to the last bit; ``grid_sample`` normalises by the image's size and does not. Samples beyond the
    horizon are pixels on the border.
    """
    # A gradient goes through the third row too.
    flat = xp is np and not (homography[:, 2, :2] != 0).any()
    maps = homography[:, :2] if flat else homography
    ends = _map_grid(xp, maps, x_ends, y_ends)
    ends = ends.reshape(*ends.shape[:2], -1)
    low, high = (end.clip(least, most) for end in (xp.amin(ends, 2), xp.amax(ends, 2)))
    # The whole pixel from which positions count.
    origin = begin = xp.floor(low - 0.5)
    if not flat:
        # Between the grid's corners and the horizon is no image, or all of it: its corners bound nothing.
        slopes = xp.concatenate([homography[:, 2:, :1] * x_ends, homography[:, 2:, 1:2] * y_ends], 1)
        endless = xp.amin(slopes, 2).sum(1)[:, None] <= -homography[:, 2, 2:]
        low, high = xp.where(endless, least, low), xp.where(endless, most, high)
        begin = xp.floor(low - 0.5)
        corner = xp.minimum(xp.maximum(xp.floor(homography[:, :2, 2]), begin), xp.floor(high))
        origin = xp.where(endless, corner, begin)
    # Half a pixel off, so that whole numbers are pixel centres.
    moved = homography[:, :2] - (origin + 0.5)[..., None] * homography[:, 2:]
    if not flat:
        moved = xp.concatenate([moved, homography[:, 2:]], 1)
    return _Window(begin, begin - origin, xp.ceil(high - origin), moved)


def _places(xp: Any, window: _Window, x: Any, y: Any) -> tuple[Any, Any]:
    """Find the pixels read at cell coordinates x (w,) by y (h,), or (n,1,w) and (n,1,h), of their dtype.

    Returns:
        (n,2,h,w) whole pixels to the left and above, from the window's first, and the share of the pixels to
        the right and below.
    """
    first, last, moved = (_cast(one, x.dtype) for one in window[1:])
    first, last = first[..., None, None], last[..., None, None]
    at = _map_grid(xp, moved, x, y).clip(first, last)
    whole = xp.floor(at)
    at -= whole
    whole -= first
    return whole, at


def _blend(near: Sequence[Tensor], share: Tensor) -> Tensor:
    """Mix four neighbours, (n,...) each, by the shares (n,2,...) of those to the right and below."""
    right_share, lower_share = share.unbind(1)
    upper, lower = (torch.lerp(near[row], near[row + 1], right_share) for row in (0, 2))
    return torch.lerp(upper, lower, lower_share)


def _sample(
    takes: Sequence[Frames],
    chosen: list[int],
    sides: list[list[float]],
    window: _Window,
    x: Tensor,
    y: Tensor,
) -> list[Tensor]:
    """Read n chosen frames bilinearly at cell coordinates x (w,) by y (h,), giving (n,1,h,w) for each take.

    Args:
        takes: see :func:`rectify_takes`.
        chosen: n frames.
        sides: width and height, px, of a window that holds what is read of each.
        window: that of each, of arrays or of tensors, which begins in the takes' own pixels.
        x: columns, in the working precision.
        y: rows.
    """
    xp: Any = torch if isinstance(window.begin, Tensor) else np
    wide, tall = (int(max(each)) for each in zip(*sides, strict=True))
    greys = [_cut(take, chosen, window.begin, sides).to(x.dtype) for take in takes]
    if xp is np and window.moved.shape[1] == 2 and not window.moved[:, (0, 1), (1, 0)].any():
        last, moved = (_cast(one, x.numpy().dtype)[..., None] for one in window[2:])
        both = enumerate((x.numpy(), y.numpy()))
        return _read_upright(
            greys, [(moved[:, n, n] * at + moved[:, n, 2]).clip(0, last[:, n]) for n, at in both]
        )
    size: Any = (-1, 1, len(y), len(x))
    whole, share = _places(xp, window, *((x, y) if xp is torch else (x.numpy(), y.numpy())))
    # Up to 2^24 float32 holds whole numbers exactly.
    exact = whole if wide * tall <= 1 << 24 else _cast(whole, xp.float64)
    places = _cast(exact[:, 0] + exact[:, 1] * wide, xp.int64)
    index, share, read = _tensor(places, x.device).flatten(1), _tensor(share, x.device).flatten(2), []
    for grey in (one.flatten(1) for one in greys):
        near = [grey[:, by:].gather(1, index) for by in (0, 1, wide, wide + 1)]
        read.append(_blend(near, share).view(size))
    return read


def _read_upright(greys: list[Tensor], places: list[Any]) -> list[Tensor]:
    """Do what :func:`_sample` does at places (n,w) along and (n,h) down the windows of panels not turned.

    A column of samples is then a column of the image: pixels are mixed along the rows, and these once.
    """
    wholes = [np.floor(at) for at in places]
    index = [whole.astype(np.int64) for whole in wholes]
    share = [torch.from_numpy(at - whole) for at, whole in zip(places, wholes, strict=True)]
    (frames, tall, _), (wide, high) = greys[0].shape, (at.shape[1] for at in places)
    columns = torch.from_numpy(index[0])[:, None].expand(-1, tall, -1)
    lines = index[1] + np.arange(0, frames * tall, tall)[:, None]
    both, read = torch.from_numpy(np.concatenate([lines, lines + 1], axis=None)), []
    for grey in greys:
        near, near_by = (grey[..., by:].gather(2, columns) for by in (0, 1))
        rows = torch.lerp(near, near_by, share[0][:, None]).view(-1, wide).index_select(0, both)
        upper, lower = rows.view(2, frames, 1, high, wide)
        read.append(torch.lerp(upper, lower, share[1][:, None, :, None]))
    return read


def _rectified_in_graph(
    frames: Frames, homography: Tensor, factors: Tensor, shape: PanelShape, side: int, dtype: torch.dtype
) -> Tensor:
    """Do what :func:`rectify_takes` does with whole frames, without a loop over what the panels need.

    Every sample is the mean of as many readings as the largest of the factors (B,) asks for; those that a
    frame's own factor has none of weigh nothing.
    """
    most: Any = factors.amax(0).item()  # in a graph no number yet
    torch._check(most >= 1)
    own, within = factors[:, None, None], torch.arange(most)
    axes = []
    for cells in (shape.columns, shape.rows):
        samples = torch.arange((cells + 2) * side)[:, None] * own + torch.minimum(within, own - 1)
        axes.append(((samples.double() + 0.5) / (side * own) - 1).flatten(1)[:, None])
    height, width = frames.grey.shape[-2:]
    ends = torch.stack([homography.new_full((), side) for side in (width, height)])
    x_ends, y_ends = (axis[..., [0, -1]] for axis in axes)
    window = _window(torch, torch.zeros_like(ends), ends, homography, x_ends, y_ends)
    whole, share = _places(torch, window, axes[0].to(dtype), axes[1].to(dtype))
    left, top = (whole.long() + window.begin.long().view(-1, 2, 1, 1)).unbind(1)
    rows, columns = (
        [(one + by).clamp(0, size - 1) for by in (0, 1)] for one, size in ((top, height), (left, width))
    )
    pixels = frames.grey.flatten(1)
    near = [pixels.gather(1, (row * width + column).flatten(1)) for row in rows for column in columns]
    read = _blend([one.to(dtype).view_as(left) for one in near], share)
    weight = (within < own).to(dtype)
    read = read.view(-1, (shape.rows + 2) * side, most, (shape.columns + 2) * side, most)
    summed = (read * weight[:, :, :, None, None] * weight[:, :, None, None, :]).sum((2, 4))
    return (summed / own.square())[:, None]


def _cut(frames: Frames, chosen: list[int], place: Any, sides: list[list[float]]) -> Tensor:
    """Cut windows out of n frames, in a common size; border pixels go on.

    Args:
        frames: whole or crops.
        chosen: n of them.
        place: (n,2) whole numbers, from a frame's first pixel to its window's, an array or a tensor.
        sides: width and height of each window, px; what lies beyond it is never read.
    """
    (wide, tall), (height, width) = map(int, map(max, zip(*sides, strict=True))), frames.grey.shape[-2:]
    if frames.grey.device.type == "cpu" and frames.grey.dtype == torch.uint8:
        planes, cut = frames.grey.numpy()[:, 0], np.zeros((len(chosen), tall, wide), dtype=np.uint8)
        for part, row, corner, side in zip(cut, chosen, place.tolist(), sides, strict=True):
            x, y, w, h = map(int, (*corner, *side))
            if 0 <= x <= width - w and 0 <= y <= height - h:
                part[:h, :w] = planes[row, y : y + h, x : x + w]
            else:
                down, right = np.arange(y, y + h).clip(0, height - 1), np.arange(x, x + w).clip(0, width - 1)
                part[:h, :w] = planes[row, down[:, None], right]
        return torch.from_numpy(cut)
    place = _tensor(place, frames.grey.device).long()
    rows = (place[:, 1:] + torch.arange(tall, device=place.device)).clamp(0, height - 1)
    columns = (place[:, :1] + torch.arange(wide, device=place.device)).clamp(0, width - 1)
    taken = torch.tensor(chosen, device=place.device).view(-1, 1, 1)
    return frames.grey[taken, 0, rows[:, :, None], columns[:, None]]


def rectify(
    frames: Frames, panels: Panels, shape: PanelShape, samples_per_led: int, dtype: torch.dtype | None = None
) -> Tensor:
    """Resample each panel to K x K samples an LED cell, bilinearly, with one cell of margin on every side.

    Where a sample stands for several pixels (a near panel) it is the mean of as many bilinear readings, so
    that detail finer than the grid is averaged and not aliased. Beyond the frame its border pixels go on. A
    panel whose corners enclose nothing (see :func:`cell_homography`) reads one grey value everywhere.

    Args:
        frames: B frames or crops, not empty.
        panels: B located panels; a panel not found is read at its zero corners and means nothing.
        shape: rows and columns.
        samples_per_led: K, at least 1.
        dtype: working precision, float32 or float64; by default float64 for float64 frames, else float32.

    Returns:
        (B,1,(R+2)K,(C+2)K) grey values; positions need float32 at least.

    Raises:
        VoccError: empty frames, another number of panels, or corners that are not finite.

    Example:
        >>> ramp = torch.arange(16.0).view(1, 1, 1, 16).expand(1, 1, 16, 16)
        >>> corners = torch.tensor([[[4.0, 4.0], [12.0, 4.0], [12.0, 12.0], [4.0, 12.0]]])
        >>> patches = rectify(Frames.whole(ramp), Panels.known(corners), PanelShape(4, 4), 2)
        >>> tuple(patches.shape), patches[0, 0, 0, :4].tolist()
        ((1, 1, 12, 12), [2.0, 3.0, 4.0, 5.0])
    """
    return rectify_takes([frames], panels, shape, samples_per_led, dtype)[0]


def rectify_takes(
    takes: Sequence[Frames],
    panels: Panels,
    shape: PanelShape,
    samples_per_led: int,
    dtype: torch.dtype | None = None,
) -> list[Tensor]:
    """Resample several takes of the same scenes at the same corners; where to read is worked out once.

    Args:
        takes: frames or crops of one size and place, such as test frames and their preambles; at least one.
        panels: see :func:`rectify`.
        shape: rows and columns.
        samples_per_led: K, at least 1.
        dtype: see :func:`rectify`.

    Returns:
        (B,1,(R+2)K,(C+2)K) for each take, as :func:`rectify` gives it.

    Raises:
        VoccError: takes of different sizes, and what :func:`rectify` refuses.

    Example:
        >>> frames = Frames.whole(torch.arange(16.0).view(1, 1, 1, 16).expand(1, 1, 16, 16))
        >>> panels = Panels.known(torch.tensor([[[4.0, 4.0], [12.0, 4.0], [12.0, 12.0], [4.0, 12.0]]]))
        >>> len(rectify_takes([frames, frames], panels, PanelShape(4, 4), 2))
        2
    """
    _check_takes(takes, panels)
    grey, device = takes[0].grey, takes[0].grey.device
    size = (grey.shape[0], 1, (shape.rows + 2) * samples_per_led, (shape.columns + 2) * samples_per_led)
    xp, corners, place = _numbers(panels.corners_px, takes[0].origin_px)
    dtype = dtype or (torch.float64 if grey.dtype == torch.float64 else torch.float32)
    # Image pixels that a sample stands for along an axis, rounded; a frame has at most MOST_READINGS, which
    # for 8 x 8 LEDs and K = 8 are cells of 200 px.
    cells = (shape.rows + 2) * (shape.columns + 2)
    most = min(64, max(1, math.isqrt(MOST_READINGS // cells) // samples_per_led))
    sides = [grey.shape[:1:-1], takes[0].sensor_px[::-1]]
    homography, cell_px = _homography(xp, corners, shape), xp.maximum(*_cell_size(xp, corners, shape))
    factors = (cell_px / samples_per_led).round().clip(1, most)
    if is_exporting():
        rest = homography, factors.long(), shape, samples_per_led, dtype
        return [_rectified_in_graph(one, *rest) for one in takes]
    fine, each = samples_per_led * factors[:, None], factors.tolist()
    x_ends, y_ends = (
        xp.concatenate([0.5 / fine, ((leds + 2) * fine - 0.5) / fine], 1)[:, None] - 1
        for leds in (shape.columns, shape.rows)
    )
    extent, sensor = np.array(sides) if xp is np else place.new_tensor(sides)
    # On the sensor, to a crop's size around it: farther out the border pixels go on, so a wild
    # quadrilateral of a false panel needs no larger window.
    least, farthest = (place - extent).clip(0), xp.minimum(place + 2 * extent, sensor)
    with np.errstate(over="ignore", invalid="ignore"):
        window = _window(xp, least, farthest, homography, x_ends, y_ends)
    window = window._replace(begin=window.begin - place)
    reach = window.last - window.first
    if device.type != "cpu":
        window = _Window(*(_tensor(one, device) for one in window))
    patches: list[Tensor] = []
    for factor in sorted(set(each)):
        x, y = _grid(shape, samples_per_led * int(factor), dtype, device)
        rows = [row for row, one in enumerate(each) if one == factor]
        step = max(1, (_CACHED_READINGS if xp is np else MOST_READINGS) // (len(x) * len(y)))
        for some in (rows[begin : begin + step] for begin in range(0, len(rows), step)):
            at = slice(None) if len(some) == len(each) else some
            part, sides = _Window(*(one[at] for one in window)), (reach[at] + 2).tolist()
            reads = _sample(takes, some, sides, part, x, y)
            if factor > 1:
                reads = [nn.functional.avg_pool2d(one, int(factor)) for one in reads]
            if len(some) == len(each):
                return reads
            patches = patches or [torch.empty(size, dtype=dtype, device=device) for _ in takes]
            for patch, read in zip(patches, reads, strict=True):
                patch[at] = read
    return patches


@lru_cache(maxsize=64)
def _grid(shape: PanelShape, fine: int, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """Cell coordinates of ``fine`` samples a cell's side, margin included: (w,) and (h,)."""
    # Normal tensors even inside inference_mode, for they are kept.
    with torch.inference_mode(False):
        ends = ((cells + 2) * fine for cells in (shape.columns, shape.rows))
        x, y = ((torch.arange(end, dtype=torch.float64) + 0.5) / fine - 1 for end in ends)
        return x.to(device, dtype), y.to(device, dtype)


def _check_takes(takes: Sequence[Frames], panels: Panels) -> None:
    """Refuse takes that cannot be read at the panels."""
    shapes = [tuple(take.grey.shape) for take in takes]
    size, corners = shapes[0], tuple(panels.corners_px.shape)
    if any(shape != size for shape in shapes):
        raise VoccError(f"takes have shapes {', '.join(map(str, shapes))}: they must be of one shape")
    if len(size) != 4 or size[1] != 1 or 0 in size[2:]:
        raise VoccError(f"frames.grey has shape {size}: it must be (B,1,H,W), not empty")
    if corners != (size[0], 4, 2):
        raise VoccError.of("panels.corners_px", f"shape {corners}", f"({size[0]},4,2), one a frame", "has")


def centre_greys(frames: Frames, panels: Panels, shape: PanelShape) -> Tensor:
    """Grey value of the pixel that holds each LED cell's centre, (B,R,C); beyond the frame its border's.

    Raises:
        VoccError: what :func:`rectify` refuses, or a value that is no grey value.

    Example:
        >>> ramp = torch.arange(16.0).view(1, 1, 1, 16).expand(1, 1, 16, 16)
        >>> corners = torch.tensor([[[4.0, 4.0], [13.0, 4.0], [13.0, 13.0], [4.0, 13.0]]])
        >>> centre_greys(Frames.whole(ramp), Panels.known(corners), PanelShape(3, 3))[0, 0].tolist()
        [5.0, 8.0, 11.0]
    """
    _check_takes([frames], panels)
    homography = cell_homography(panels.corners_px, shape)
    middles = (torch.arange(cells).to(homography) + 0.5 for cells in (shape.columns, shape.rows))
    height, width = frames.grey.shape[-2:]
    place = torch.floor(_map_grid(torch, homography, *middles)) - frames.origin_px.view(-1, 2, 1, 1)
    # Clamped before it is whole: a centre on the horizon is beyond what an integer holds.
    column, row = place[:, 0].clamp(0, width - 1).long(), place[:, 1].clamp(0, height - 1).long()
    read = frames.grey.flatten(1).gather(1, (row * width + column).flatten(1)).view(row.shape)
    dtype = torch.float64 if read.dtype == torch.float64 else torch.float32
    return checked_greys(read.to(dtype), "frames.grey at the LEDs' centres")
