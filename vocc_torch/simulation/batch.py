"""A batch on its way through the camera, and parts of it: frames of like size are drawn together."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from vocc_torch.rng import FrameKey
from vocc_torch.simulation.effects import Context
from vocc_torch.simulation.framing import Size
from vocc_torch.types import Scene

SIZE_STEP = 1.2
"""Ratio of the distances between which panels are drawn in crops of one size."""

GROUP_PIXELS, GROUP_PIXELS_ELSEWHERE = 40_000, 10_000_000
"""Pixels in whose time a CPU begins another group of frames, and an accelerator does."""


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

    @property
    def origin_px(self) -> Tensor:
        """First pixel of each picture on the sensor, (B,2) int64."""
        assert self.context.origin_px is not None
        return self.context.origin_px

    def taken(self, rows: slice | Tensor, size: Size | None = None) -> Batch:
        """Take some frames, by a slice or by their numbers (n,) int64; a smaller size keeps the middle."""
        context, keys, origin = self.context, self._keys(rows), self.origin_px[rows]
        if size is not None and size != self.size:
            inset = [whole // 2 - small // 2 for whole, small in zip(self.size, size, strict=True)]
            origin = origin + torch.tensor(inset[::-1], device=origin.device)
        iso = None if context.iso is None else context.iso[rows]
        part = replace(context, scene=context.scene[rows], keys=keys, origin_px=origin, iso=iso)
        return Batch(part, self.bits[rows], self.centre_px[rows], size or self.size)

    def _keys(self, rows: slice | Tensor) -> Sequence[FrameKey]:
        """Keys of some frames, where there are keys at all."""
        keys = self.context.keys
        return keys[rows] if isinstance(rows, slice) else [keys[row] for row in rows.tolist() if keys]


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
