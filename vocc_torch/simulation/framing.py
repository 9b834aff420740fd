"""Which part of the sensor is rendered, what stands for the rest, and how frames of like size go together."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects import Context, Effect
from vocc_torch.simulation.geometry import Camera, LedPanel, demand_led_px
from vocc_torch.types import Scene

Size = tuple[int, int]

WINDOW_GRID_PX = 8
"""Where windows begin and end on sensors whose sides are multiples of it: JPEG's blocks, Bayer's cells."""

MOST_PIXELS = 1 << 26
"""Most pixels of a frame or crop: a 50-megapixel camera's and 8K video's.

Frames of such a size are drawn one at a time; each pixel takes 50 to 100 bytes, the largest up to 7 GB.
"""

SIZE_STEP = 1.2
"""Ratio of the distances between which panels are drawn in crops of one size."""

GROUP_PIXELS, GROUP_PIXELS_ELSEWHERE = 40_000, 10_000_000
"""Pixels in whose time a CPU begins another group of frames, and an accelerator does."""


def crop_size_px(
    effects: Sequence[Effect], camera: Camera, panel: LedPanel, nearest_m: float, *, margin_cells: int = 1
) -> Size:
    """Height and width of the crop that holds a panel at ``nearest_m``, a cell of margin and its light.

    Its border is then free of the panel's light, so it stands for all the rest; where the sensor cuts the
    panel, that holds for the sides away from it.

    Args:
        effects: those of the scene, each of which may make the image larger or spread its light.
        camera: the camera.
        panel: the panel.
        nearest_m: the nearest distance that the crop must do for, above 0.
        margin_cells: LED cells of margin on each side, for a receiver that looks there.

    Returns:
        Both at most the sensor's, however near the panel or wide its light.

    Raises:
        VoccError: a distance that is not above 0, or at which an LED's image is too large.

    Example:
        >>> crop_size_px([], Camera(), LedPanel(), 50.0)
        (48, 48)
    """
    if not nearest_m > 0:
        raise VoccError(f"nearest_m is {nearest_m:g}: it must be above 0")
    demand_led_px(panel.led_diameter_m / nearest_m * camera.focal_length_px, nearest_m)
    pitch_px = panel.pitch_m * camera.focal_length_px / nearest_m
    rows, columns = (leds + 2 * margin_cells for leds in (panel.shape.rows, panel.shape.columns))
    size = rows * pitch_px, columns * pitch_px
    for effect in effects:
        size = effect.size_in_px(size, camera, nearest_m)
    margin = 2 * (sum(effect.reach_in_px(camera, nearest_m) for effect in effects) + 2)
    height, width = (
        min(math.ceil(min(side, full)) + margin, full)
        for side, full in zip(size, camera.sensor_px, strict=True)
    )
    return height, width


def demand_pixels(size: tuple[int, int]) -> None:
    """Refuse by name frames or crops, of a height and width, that are too large.

    Raises:
        VoccError: more than 2^26 pixels.

    Example:
        >>> demand_pixels((6144, 8192))
    """
    height, width = size
    if height * width > MOST_PIXELS:
        shown = f"camera.width_px and camera.height_px lead to frames of {width} x {height} px"
        hint = "give a smaller camera, or framing=crop, which draws the panel's surroundings only"
        raise VoccError(f"{shown}: they must hold at most {MOST_PIXELS} pixels ({hint})")


def window_size_px(crop_px: Size, sensor_px: Size) -> Size:
    """Height and width of the window on the grid that holds a crop wherever it lies.

    Example:
        >>> window_size_px((71, 71), (1080, 1920)), window_size_px((71, 71), (1080, 1919))
        ((80, 80), (80, 1919))
    """
    height, width = (
        full if full % WINDOW_GRID_PX else min(full, WINDOW_GRID_PX * (-(-side // WINDOW_GRID_PX) + 1))
        for side, full in zip(crop_px, sensor_px, strict=True)
    )
    return height, width


def crop_origins_px(
    centre_px: Tensor, size_px: tuple[int, int], sensor_px: tuple[int, int], *, grid_px: int = 1
) -> Tensor:
    """Top left pixel of each crop: around the panel, moved inside the sensor however far outside that lies.

    Args:
        centre_px: (B,2) image of each panel's centre, px.
        size_px: height and width of the crops.
        sensor_px: height and width of the sensor.
        grid_px: what the origins are multiples of.

    Returns:
        (B,2) int64, as (x, y).

    Example:
        >>> crop_origins_px(torch.tensor([[100.4, 3.0]]), (40, 40), (1080, 1920), grid_px=8).tolist()
        [[80, 0]]
    """
    extent = torch.tensor([size_px[1], size_px[0]], device=centre_px.device)
    sensor = torch.tensor([sensor_px[1], sensor_px[0]], device=centre_px.device)
    # Beyond the sensor the distance does not matter, and may be more than whole numbers hold.
    near = torch.minimum(torch.maximum(centre_px, -extent), sensor + extent)
    centred = torch.round(near).long() - extent // 2
    # The crop that this holds begins up to a grid's step later.
    centred = centred + grid_px // 2
    return torch.minimum((centred - centred % grid_px).clamp(min=0), sensor - extent)


def read_surround(value: Tensor, centre_px: Tensor, origin_px: Tensor) -> Tensor:
    """Read the corner of each crop that lies farthest from the panel, beyond its light, (B,1,H,W) to (B,)."""
    height, width = value.shape[-2:]
    x, y = (centre_px - origin_px).unbind(dim=-1)
    column = torch.where(x < width / 2, width - 1, 0)
    row = torch.where(y < height / 2, height - 1, 0)
    return value[torch.arange(len(value), device=value.device), 0, row, column]


def lay_on_sensor(value: Tensor, surround: Tensor, origin_px: Tensor, sensor_px: tuple[int, int]) -> Tensor:
    """Lay each crop into a full frame of its surround, (B,1,h,w) to (B,1,H,W).

    Example:
        >>> crop, origin = torch.full((1, 1, 1, 2), 5.0), torch.tensor([[1, 0]])
        >>> lay_on_sensor(crop, torch.tensor([3.0]), origin, (2, 4)).tolist()
        [[[[3.0, 5.0, 5.0, 3.0], [3.0, 3.0, 3.0, 3.0]]]]
    """
    height, width = value.shape[-2:]
    full = surround.view(-1, 1, 1, 1).expand(-1, 1, *sensor_px).contiguous()
    for index, (x, y) in enumerate(origin_px.tolist()):
        full[index, 0, y : y + height, x : x + width] = value[index, 0]
    return full


@dataclass(frozen=True, slots=True)
class Batch:
    """Frames that are drawn at one size.

    Args:
        context: their scenes, keys and origins.
        bits: (B,R,C) bool.
        centre_px: (B,2) image of each panel's centre on the sensor, px.
        size: height and width of the pictures, px.
    """

    context: Context
    bits: Tensor
    centre_px: Tensor
    size: Size

    def __len__(self) -> int:
        """Count the frames."""
        return len(self.context.scene)

    def taken(self, rows: slice | Tensor, size: Size | None = None) -> Batch:
        """Take some frames, by a slice or by their numbers (n,) int64; a smaller size keeps the middle."""
        context, keys, origin = self.context, self.context.keys, self.context.first_px[rows]
        keys = keys[rows] if isinstance(rows, slice) else [keys[row] for row in rows.tolist() if keys]
        if size is not None and size != self.size:
            inset = [whole // 2 - small // 2 for whole, small in zip(self.size, size, strict=True)]
            origin = origin + torch.tensor(inset[::-1], device=origin.device)
        iso = None if context.iso is None else context.iso[rows]
        part = replace(context, scene=context.scene[rows], keys=keys, origin_px=origin, iso=iso)
        return Batch(part, self.bits[rows], self.centre_px[rows], size or self.size)


def like_sized(
    scene: Scene, apart: Tensor, size_px: Size, tight_px: Callable[[float], Size]
) -> list[tuple[list[int], Size]]:
    """Split a batch into groups of frames whose panels fit into small crops of one size.

    Most of a crop that holds the nearest panel is uniform about a farther one, and need not be computed.

    Args:
        scene: B scenes.
        apart: (B,) bool, the frames that must have ``size_px``.
        size_px: height and width of crops that hold any of the panels.
        tight_px: height and width of crops that hold a panel at a distance, or farther.

    Returns:
        Of each group the frames' numbers, and the height and width, at most ``size_px``. Few frames go
        with those of the next larger size, where that costs less than a group of their own.

    Example:
        >>> scene = Scene.cat([Scene.of(40, distance_m=30.0), Scene.of(40, distance_m=70.0)])
        >>> sides = {30.0: (74, 74), 70.0: (40, 40)}
        >>> groups = like_sized(scene, torch.zeros(80, dtype=torch.bool), (89, 89), lambda m: sides[m])
        >>> [(len(rows), size) for rows, size in groups]
        [(40, (40, 40)), (40, (74, 74))]
    """
    members: dict[float, list[int]] = {}
    distances = torch.where(apart, 0.0, scene.distance_m).tolist()
    for frame, distance in enumerate(distances):
        step = math.floor(math.log(distance) / math.log(SIZE_STEP)) if distance else -math.inf
        members.setdefault(step, []).append(frame)
    ordered = [members[step] for step in sorted(members, reverse=True)]
    nearest = [min(distances[frame] for frame in group) for group in ordered]
    tight = [tight_px(each) if each else size_px for each in nearest]
    sizes = [(min(height, size_px[0]), min(width, size_px[1])) for height, width in tight]
    worth = GROUP_PIXELS if apart.device.type == "cpu" else GROUP_PIXELS_ELSEWHERE
    groups: list[tuple[list[int], Size]] = []
    waiting: list[int] = []
    for index, group in enumerate(ordered):
        waiting, own, larger = waiting + group, sizes[index], (*sizes[index + 1 :], None)[0]
        if larger is None or len(waiting) * (math.prod(larger) - math.prod(own)) > worth:
            groups.append((waiting, own))
            waiting = []
    return groups


def in_groups(
    batch: Batch, groups: Sequence[tuple[Sequence[int], Size]], draw: Callable[[Batch], Tensor]
) -> Tensor:
    """Draw frames in groups, each in pictures of its own size, laid into pictures of the batch's size.

    Args:
        batch: frames whose panels lie in the middle of their pictures, or that are in a group of full size.
        groups: frames' numbers, each in one group, and the size in which a panel's light has room.
        draw: gives the pictures (n,1,h,w) of a batch.

    Returns:
        (B,1,H,W), in the batch's order.
    """
    order = [row for rows, _ in groups for row in rows]
    together = len(groups) == 1
    if not together:
        batch = batch.taken(torch.tensor(order, device=batch.bits.device))
    laid, begin = [], 0
    for rows, size in groups:
        drawn = draw(batch.taken(slice(begin, begin + len(rows)), size))
        # The panel lies in the middle, so that every corner is beyond its light.
        laid.append(drawn if size == batch.size else lay_alike(drawn, drawn[:, 0, 0, 0], batch.size))
        begin += len(rows)
    pictures = torch.cat(laid)
    if together:
        return pictures
    return pictures.index_select(0, torch.tensor(order, device=pictures.device).argsort())


def lay_alike(value: Tensor, surround: Tensor, size_px: Size) -> Tensor:
    """Lay crops into larger ones of their surround that have the same middle, (B,1,h,w) to (B,1,H,W).

    Example:
        >>> lay_alike(torch.full((1, 1, 1, 2), 5.0), torch.tensor([3.0]), (1, 4)).tolist()
        [[[[3.0, 5.0, 5.0, 3.0]]]]
    """
    height, width = value.shape[-2:]
    if (height, width) == size_px:
        return value
    top, left = size_px[0] // 2 - height // 2, size_px[1] // 2 - width // 2
    larger = surround.view(-1, 1, 1, 1).expand(-1, 1, *size_px).contiguous()
    larger[:, :, top : top + height, left : left + width] = value
    return larger
