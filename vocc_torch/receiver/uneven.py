"""Which part of a frame is not of one grey value, so that the rest of it is looked at only once."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

# In smaller frames looking costs more than it saves.
_LEAST_PX = 1 << 16


@dataclass(frozen=True, slots=True)
class UnevenParts:
    """A box in each of B frames, beyond which every pixel has one grey value.

    Args:
        boxes: B boxes: left, top, width, height, px; the whole frame where nothing is known of it.
        levels: B grey values beyond the boxes, which mean nothing where the box is the frame.
        size_px: height and width of the frames.
    """

    boxes: list[tuple[int, int, int, int]]
    levels: list[int]
    size_px: tuple[int, int]

    def cut(self, grey: Tensor, index: int) -> Tensor:
        """Give the uneven part (h,w) of frame ``index`` of (B,1,H,W), without a copy."""
        left, top, width, height = self.boxes[index]
        return grey[index, 0, top : top + height, left : left + width]

    def outside_px(self, index: int) -> int:
        """Count the pixels beyond the box of frame ``index``."""
        _, _, width, height = self.boxes[index]
        return self.size_px[0] * self.size_px[1] - width * height


def uneven_parts(grey: Tensor) -> UnevenParts:
    """Bound what differs from the grey value of the first pixel, in frames that lie in the CPU's memory.

    A frame that is uneven already in its first row, as one with noise is, is not looked at further; nor is a
    small one, or one on an accelerator.

    Args:
        grey: (B,1,H,W) uint8.

    Example:
        >>> import torch
        >>> grey = torch.full((1, 1, 300, 400), 9, dtype=torch.uint8)
        >>> grey[0, 0, 100:120, 50:90] = 200
        >>> parts = uneven_parts(grey)
        >>> parts.boxes, parts.levels, parts.outside_px(0)
        ([(50, 100, 40, 20)], [9], 119200)
    """
    frames, _, height, width = grey.shape
    whole = (0, 0, width, height)
    if grey.device.type != "cpu" or height * width < _LEAST_PX:
        return UnevenParts([whole] * frames, [0] * frames, (height, width))
    found = [_uneven_part(frame) or (whole, 0) for frame in grey[:, 0]]
    return UnevenParts([box for box, _ in found], [level for _, level in found], (height, width))


def _uneven_part(frame: Tensor) -> tuple[tuple[int, int, int, int], int] | None:
    """Bound what differs in one frame (H,W) from its first pixel; None if that is nearly all of it."""
    plane = frame.numpy()
    level = plane[0, 0]
    if (plane[0] != level).any():
        return None
    columns = ((plane.max(0) != level) | (plane.min(0) != level)).nonzero()[0]
    if not len(columns):
        return (0, 0, 0, 0), int(level)
    left, right = int(columns[0]), int(columns[-1]) + 1
    if 2 * (right - left) > plane.shape[1]:
        return None
    rows = (plane[:, left:right] != level).any(1).nonzero()[0]
    top = int(rows[0])
    return (left, top, right - left, int(rows[-1]) + 1 - top), int(level)
