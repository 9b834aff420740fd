"""A batch on its way through the camera, and parts of it: frames of like size are drawn together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from vocc_torch.rng import FrameKey
from vocc_torch.simulation.effects import Context
from vocc_torch.simulation.framing import Size, lay_alike


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
