"""Panels resampled to one fixed grid of K x K samples a cell, with cells of margin, bilinearly.

The projective maps between cells and pixels are those of Heckbert (1989).
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor, nn

from vocc_torch.errors import VoccError
from vocc_torch.receiver.features import checked_greys
from vocc_torch.types import (
    Frames,
    Panels,
    PanelShape,
    holds,
    is_exporting,
)


@dataclass(frozen=True)
class ResampleSettings:
    """Limits of resampling."""

    most_px: float = (
        1e15  # corners farther than this from the sensor's corner are no corners
    )
    # Of one frame: what 8 x 8 LEDs of 200 px with K = 8 take.
    most_readings: int = 1 << 22
    chunk_readings: int = 1 << 18  # on a CPU, whose cache holds so many
    most_factor: int = 64  # readings along a sample's side
    flat_px2: float = (
        1e-9  # least cross product of neighbouring sides where a corner parts them
    )
    flat_share: float = 1e-12  # the same, of the longest side's square


SETTINGS = ResampleSettings()


@lru_cache(maxsize=64)
@torch.inference_mode(False)
def corner_cells(shape: PanelShape) -> Tensor:
    """Return the cell coordinates of the corners, (4,2) float64.

    Example:
        >>> corner_cells(PanelShape(4, 8)).tolist()
        [[0.0, 0.0], [8.0, 0.0], [8.0, 4.0], [0.0, 4.0]]
    """
    right, low = shape.columns, shape.rows
    return torch.tensor([[0, 0], [right, 0], [right, low], [0, low]]).double()


def sample_cells(leds: int, samples: int, margin: int) -> Tensor:
    """Return the cell coordinates (N,) float64 of an axis's samples, ``margin`` cells at both ends included.

    Example:
        >>> sample_cells(1, 4, 0).tolist()
        [0.125, 0.375, 0.625, 0.875]
    """
    return (
        torch.arange((leds + 2 * margin) * samples, dtype=torch.float64) + 0.5
    ) / samples - margin


@lru_cache(maxsize=64)
@torch.inference_mode(False)
def _axes(
    shape: PanelShape, samples: int, margin: int, dtype: torch.dtype
) -> list[Tensor]:
    """Give the samples' cell coordinates along the rows (w,) and down the columns (h,)."""
    return [
        sample_cells(leds, samples, margin).to(dtype)
        for leds in (shape.columns, shape.rows)
    ]


def _on_host(frames: Frames, panels: Panels) -> tuple[Tensor, Tensor]:
    """Bring corners (B,4,2) and the frames' origins (B,2) to the host, in one copy."""
    if frames.grey.is_cpu:
        return panels.corners_px, frames.origin_px
    corners = panels.corners_px.double().flatten(1)
    both = torch.cat([corners, frames.origin_px.double()], 1).cpu()
    return both[:, :8].view(-1, 4, 2), both[:, 8:].long()


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
    corners = corners_px.double()
    if not holds(corners.abs() <= SETTINGS.most_px):
        most = float(corners.abs().max())
        raise VoccError(
            f"corners_px reaches {most:g} px: corners must be finite and within {SETTINGS.most_px:g} px"
        )
    return _homography(corners, shape)


def _homography(corners: Tensor, shape: PanelShape) -> Tensor:
    """Map cells to pixels as :func:`cell_homography` does, without a look at the corners (B,4,2) float64."""
    side = corners.roll(-1, 1) - corners
    after = side.roll(-1, 1)
    turn = side[..., 0] * after[..., 1] - side[..., 1] * after[..., 0]
    longest = side.square().sum(2).amax(1)
    least = SETTINGS.flat_px2 + SETTINGS.flat_share * longest
    convex = (turn.amin(1) > least) | (turn.amax(1) < -least)
    # A corner's homogeneous weight goes with the area of the triangle of the three others.
    weight = turn / torch.where(convex, turn[:, 1], 1.0)[:, None]
    first, second, _, fourth = nn.functional.pad(corners, (0, 1), value=1.0).unbind(1)
    to_x = (weight[:, 2:3] * second - first) * (1 / shape.columns)
    to_y = (weight[:, :1] * fourth - first) * (1 / shape.rows)
    # With zero added, no zero is negative.
    columns = [to_x * convex[:, None] + 0.0, to_y * convex[:, None] + 0.0, first]
    return torch.stack(columns, 2)


def cut_about(frame: Frames, corners_px: Tensor, beyond_px: Tensor) -> Frames:
    """Cut one frame to the box of corners (4,2) px and ``beyond_px`` around it, at least a pixel of the frame.

    Example:
        >>> frame = Frames.whole(torch.zeros(1, 40, 60))
        >>> corners = torch.tensor([[20.0, 9.5], [28.0, 9.5], [28.0, 18.0], [20.0, 18.0]])
        >>> cut = cut_about(frame, corners, torch.tensor(2.0))
        >>> tuple(cut.grey.shape[-2:]), cut.origin_px.tolist()
        ((13, 12), [[18, 7]])
    """
    size = corners_px.new_tensor(frame.grey.shape[:1:-1])
    low, high = (corners_px - frame.origin_px[0]).aminmax(dim=0)
    low = (low - beyond_px).floor().clamp(min=0).minimum(size - 1)
    high = (high + beyond_px).ceil().minimum(size).maximum(low + 1)
    (left, top), (right, below) = low.long().tolist(), high.long().tolist()
    grey = frame.grey[..., top:below, left:right]
    return Frames(grey, frame.origin_px + low.long(), frame.sensor_px)


def cell_size_px(corners_px: Tensor, shape: PanelShape) -> tuple[Tensor, Tensor]:
    """Mean width and height of an LED cell in the image, (B,) each, px: the gradients' resampling scale.

    Example:
        >>> corners = torch.tensor([[[0.0, 0.0], [16.0, 0.0], [16.0, 24.0], [0.0, 24.0]]])
        >>> [float(size) for size in cell_size_px(corners, PanelShape(8, 8))]
        [2.0, 3.0]
    """
    corners = corners_px.double()
    length = (corners.roll(-1, 1) - corners).square().sum(2).sqrt()
    width, height = ((length[:, :2] + length[:, 2:]) / 2).unbind(1)
    return width / shape.columns, height / shape.rows


def map_points(corners_px: Tensor, cells: Tensor, shape: PanelShape) -> Tensor:
    """Map points in cell coordinates, (B,P,2) columns and rows, into the image, (B,P,2) px, finite.

    Example:
        >>> corners = torch.tensor([[[2.0, 3.0], [10.0, 3.0], [10.0, 11.0], [2.0, 11.0]]]).double()
        >>> point = torch.tensor([[[8.0, -1.0]]]).double()
        >>> map_points(corners, point, PanelShape(8, 8)).round(decimals=9).tolist()
        [[[10.0, 2.0]]]
    """
    return map_cells(cell_homography(corners_px, shape), cells)


def map_cells(homography: Tensor, cells: Tensor) -> Tensor:
    """Map points (B,P,2) in cell coordinates by homographies (B,3,3) into the image, (B,P,2) px, finite."""
    columns = homography.mT[:, None]
    mapped = (
        cells[..., :1] * columns[:, :, 0]
        + cells[..., 1:] * columns[:, :, 1]
        + columns[:, :, 2]
    )
    # A point on the horizon is as far away as a corner may be.
    return (
        (mapped[..., :2] / mapped[..., 2:])
        .nan_to_num()
        .clamp(-SETTINGS.most_px, SETTINGS.most_px)
    )


def grid_places(homography: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """Map the grid of cell coordinates x (w,) by y (h,), or (n,w) and (n,h), to pixels, (n,2,h,w).

    From the horizon on, where there is no image, it is as far away as just before it, and finite or infinite.
    """
    across = homography[:, :, :1] * x[..., None, :] + homography[:, :, 2:]
    mapped = (
        across[:, :, None, :] + (homography[:, :, 1:2] * y[..., None, :])[..., None]
    )
    return mapped[:, :2] / mapped[:, 2:].clamp(min=torch.finfo(mapped.dtype).tiny)


def _read(
    frames: Frames,
    origin_px: Tensor,
    rows: Tensor,
    homography: Tensor,
    x: Tensor,
    y: Tensor,
) -> Tensor:
    """Read frames ``rows`` (n,) bilinearly at cell coordinates x by y, as :func:`grid_places` has them: (n,h,w).

    Positions count from a whole sensor pixel at the panel, so a crop and the full frame give the same values
    to the last bit. Beyond the frame its border pixels go on. All but the frames is on the host, and so is
    what is computed of upright panels: on an accelerator each look at a number waits for all work before it.
    """
    device = frames.grey.device
    origin = homography[:, :2, 2].detach().floor()
    # Half a pixel off, so that whole numbers are pixel centres.
    moved = homography[:, :2] - (origin + 0.5)[..., None] * homography[:, 2:]
    moved = torch.cat([moved, homography[:, 2:]], 1).to(x.dtype)
    begin = origin.long() - origin_px[rows]
    turned = (
        is_exporting()
        or moved.requires_grad
        or bool(moved[:, (0, 1, 2, 2), (1, 0, 0, 1)].any())
    )
    if turned:
        moved, begin, x, y = (
            one.to(device, non_blocking=True) for one in (moved, begin, x, y)
        )
        at = grid_places(moved, x, y).unbind(1)
    else:
        at = (
            (moved[:, 0, :1] * x + moved[:, 0, 2:])[:, None],
            (moved[:, 1, 1:2] * y + moved[:, 1, 2:])[..., None],
        )
    wholes, shares, firsts = [], [], []
    for axis, (places, size) in enumerate(
        zip(at, frames.grey.shape[:1:-1], strict=True)
    ):
        from_first = begin[:, axis, None, None].to(x.dtype)
        places = places.clamp(-1 - from_first, size - 1 - from_first)
        corner = places.detach().floor()
        first = (
            (-1 - from_first) if is_exporting() else corner.amin((1, 2), keepdim=True)
        )
        wholes.append(corner - first)
        shares.append(places - corner)
        firsts.append((first + from_first)[:, 0, 0])
    windows = _windows(frames, rows, firsts, wholes).to(x.dtype)
    wholes, shares = (
        [one.to(device, non_blocking=True) for one in parts]
        for parts in (wholes, shares)
    )
    read = _turned if turned else _upright
    return read(windows, wholes, shares)


def _turned(windows: Tensor, wholes: list[Tensor], shares: list[Tensor]) -> Tensor:
    """Mix four pixels of windows (n,tall,wide) for each sample, (n,h,w).

    Args:
        windows: grey values.
        wholes: columns and rows (n,h,w) of the samples' upper left pixels.
        shares: how far the samples lie from there, across and down.
    """
    wide = windows.shape[2]
    index = (wholes[1].long() * wide + wholes[0].long()).flatten(1)
    flat = windows.flatten(1)
    near = [
        flat[:, by:].gather(1, index).view_as(shares[0])
        for by in (0, 1, wide, wide + 1)
    ]
    upper, lower = (
        torch.lerp(near[line], near[line + 1], shares[0]) for line in (0, 2)
    )
    return torch.lerp(upper, lower, shares[1])


def _upright(windows: Tensor, wholes: list[Tensor], shares: list[Tensor]) -> Tensor:
    """Do what :func:`_turned` does for upright panels: columns (n,1,w) and rows (n,h,1).

    A column of samples lies in one column of the image. So pixels are mixed along the windows' rows first, and
    then whole rows are mixed.
    """
    count, tall, _ = windows.shape
    columns = wholes[0].long().expand(-1, tall, -1).contiguous()
    left, right = (windows[..., by:].gather(2, columns) for by in (0, 1))
    mixed = torch.lerp(left, right, shares[0]).flatten(0, 1)
    first = torch.arange(count, device=windows.device)[:, None] * tall
    lines = (wholes[1][..., 0].long() + first).flatten()
    size = (count, shares[1].shape[1], shares[0].shape[2])
    upper, lower = (mixed.index_select(0, lines + by).view(size) for by in (0, 1))
    return torch.lerp(upper, lower, shares[1])


def _windows(
    frames: Frames, rows: Tensor, firsts: list[Tensor], wholes: list[Tensor]
) -> Tensor:
    """Cut windows (n,tall,wide) that hold the pixels read and their next ones; border pixels go on.

    Args:
        frames: whole or crops.
        rows: n frames.
        firsts: first column and first row of each window, (n,) both.
        wholes: columns and rows that are read, from the window's first.
    """
    if is_exporting():
        return nn.functional.pad(frames.grey.float(), (1, 1, 1, 1), mode="replicate")[
            :, 0
        ]
    height, width = frames.grey.shape[-2:]
    columns, lines = (
        (
            first.long()[:, None]
            + torch.arange(int(count.amax()) + 2, device=first.device)
        ).clamp(0, size - 1)
        for first, count, size in zip(firsts, wholes, (width, height), strict=True)
    )
    rows, columns, lines = (
        one.to(frames.grey.device, non_blocking=True) for one in (rows, columns, lines)
    )
    index = ((rows[:, None] * height + lines) * width)[..., None] + columns[:, None]
    return frames.grey.reshape(-1).take(index)


def rectify(
    frames: Frames,
    panels: Panels,
    shape: PanelShape,
    samples_per_led: int,
    margin: int = 1,
) -> Tensor:
    """Resample each panel to K x K samples an LED cell, bilinearly, with cells of margin on every side.

    Where a sample stands for several pixels (a near panel) it is the mean of as many bilinear readings, so
    that detail finer than the grid is averaged and not aliased. Beyond the frame its border pixels go on. A
    panel whose corners enclose nothing (see :func:`cell_homography`) reads one grey value everywhere.

    Args:
        frames: B frames or crops, not empty.
        panels: B located panels; a panel not found is read at its zero corners and means nothing.
        shape: rows and columns.
        samples_per_led: K, at least 1.
        margin: m, cells around the panel.

    Returns:
        (B,1,(R+2m)K,(C+2m)K) grey values, float64 of float64 frames, else float32.

    Raises:
        VoccError: empty frames, another number of panels, or corners that are not finite.

    Example:
        >>> ramp = torch.arange(16.0).view(1, 1, 1, 16).expand(1, 1, 16, 16)
        >>> corners = torch.tensor([[[4.0, 4.0], [12.0, 4.0], [12.0, 12.0], [4.0, 12.0]]])
        >>> patches = rectify(Frames.whole(ramp), Panels.known(corners), PanelShape(4, 4), 2)
        >>> tuple(patches.shape), patches[0, 0, 0, :4].tolist()
        ((1, 1, 12, 12), [2.0, 3.0, 4.0, 5.0])
    """
    _check(frames, panels)
    grey = frames.grey
    dtype = torch.promote_types(grey.dtype, torch.float32)
    corners_px, origin_px = _on_host(frames, panels)
    homography = cell_homography(corners_px, shape)
    cells = (shape.rows + 2 * margin) * (shape.columns + 2 * margin)
    most = max(1, math.isqrt(SETTINGS.most_readings // cells) // samples_per_led)
    pixels = torch.maximum(*cell_size_px(corners_px, shape)).detach() / samples_per_led
    # A graph does not refuse corners that are no numbers.
    pixels = pixels.round().nan_to_num()
    factors = pixels.clamp(1, min(SETTINGS.most_factor, most)).long()
    if is_exporting():
        return _rectified_in_graph(
            frames, homography, factors, shape, samples_per_led, margin, dtype
        )
    sides = [(leds + 2 * margin) * samples_per_led for leds in shape.sides]
    patches = grey.new_empty(len(frames), 1, *sides, dtype=dtype)
    for factor in sorted(set(factors.tolist())):
        x, y = _axes(shape, samples_per_led * factor, margin, dtype)
        chunk = SETTINGS.chunk_readings if grey.is_cpu else SETTINGS.most_readings
        chosen = (factors == factor).nonzero()[:, 0]
        for rows in chosen.split(max(1, chunk // (len(x) * len(y)))):
            read = _read(frames, origin_px, rows, homography[rows], x, y)[:, None]
            if factor > 1:
                read = nn.functional.avg_pool2d(read, factor)
            patches[rows.to(grey.device, non_blocking=True)] = read
    return patches


def _rectified_in_graph(
    frames: Frames,
    homography: Tensor,
    factors: Tensor,
    shape: PanelShape,
    samples: int,
    margin: int,
    dtype: torch.dtype,
) -> Tensor:
    """Do what :func:`rectify` does without a loop over the factors (B,).

    Every sample is the mean of as many readings as the largest factor asks for; those that a frame's own
    factor has none of weigh nothing.
    """
    most: Any = factors.amax(0).item()  # in a graph no number yet
    torch._check(most >= 1)  # type: ignore[no-untyped-call, unused-ignore]
    factor, within = factors[:, None, None], torch.arange(most)
    axes = []
    wide, high = ((leds + 2 * margin) * samples for leds in shape.sides[::-1])
    for side in (wide, high):
        places = torch.arange(side)[:, None] * factor
        places = places + torch.minimum(within, factor - 1)
        axes.append(
            (((places.double() + 0.5) / (samples * factor)) - margin)
            .flatten(1)
            .to(dtype)
        )
    # Its len() would be a constant of the graph.
    rows = torch.arange(factors.shape[0], device=factors.device)
    read = _read(frames, frames.origin_px, rows, homography, *axes)
    weight = (within < factor).to(dtype)
    read = read.view(-1, high, most, wide, most)
    summed = (read * weight[:, :, :, None, None] * weight[:, :, None, None, :]).sum(
        (2, 4)
    )
    return (summed / factor.square())[:, None]


def _check(frames: Frames, panels: Panels) -> None:
    """Refuse frames that cannot be read at the panels."""
    size, corners = tuple(frames.grey.shape), tuple(panels.corners_px.shape)
    if len(size) != 4 or size[1] != 1 or 0 in size[2:]:
        raise VoccError(
            f"frames.grey has shape {size}: it must be (B,1,H,W), not empty"
        )
    if corners != (size[0], 4, 2):
        raise VoccError.of(
            "panels.corners_px",
            f"shape {corners}",
            f"({size[0]},4,2), one a frame",
            "has",
        )


def centre_greys(frames: Frames, panels: Panels, shape: PanelShape) -> Tensor:
    """Grey value of the pixel that holds each LED cell's centre, (B,R,C); beyond the frame its border's.

    On an accelerator corners are not looked at: :func:`rectify` has seen those of the same panels.

    Raises:
        VoccError: what :func:`rectify` refuses, or a value that is no grey value.

    Example:
        >>> ramp = torch.arange(16.0).view(1, 1, 1, 16).expand(1, 1, 16, 16)
        >>> corners = torch.tensor([[[4.0, 4.0], [13.0, 4.0], [13.0, 13.0], [4.0, 13.0]]])
        >>> centre_greys(Frames.whole(ramp), Panels.known(corners), PanelShape(3, 3))[0, 0].tolist()
        [5.0, 8.0, 11.0]
    """
    _check(frames, panels)
    mapped = cell_homography if frames.grey.is_cpu else _homography
    homography = mapped(panels.corners_px.double(), shape)
    middles = (
        torch.arange(leds, dtype=torch.float64, device=homography.device) + 0.5
        for leds in (shape.columns, shape.rows)
    )
    height, width = frames.grey.shape[-2:]
    place = grid_places(homography, *middles).floor() - frames.origin_px.view(
        -1, 2, 1, 1
    )
    # Clamped before it is whole: a centre on the horizon is beyond what an integer holds.
    column = place[:, 0].clamp(0, width - 1).long()
    row = place[:, 1].clamp(0, height - 1).long()
    index = (row * width + column).flatten(1)
    read = frames.grey.flatten(1).gather(1, index).view(row.shape)
    if read.dtype == torch.uint8:  # bytes are grey values
        return read.float()
    dtype = torch.promote_types(read.dtype, torch.float32)
    return checked_greys(read.to(dtype), "frames.grey at the LEDs' centres")
