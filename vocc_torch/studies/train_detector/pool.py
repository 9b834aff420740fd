"""The pool of training frames on disk: rendered once, read by both trainings."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from vocc_torch.receiver.detector.pyramid import Pyramid
from vocc_torch.receiver.resample import cell_size_px
from vocc_torch.types import PanelShape

READ_SAMPLES = 4
"""Samples along a cell's side, of which the middle ones say whether its LED can be told."""

LEAST_CONTRAST = 1.2
"""Difference of On and Off cells, in their standard deviations, from which on a panel can be read."""


@dataclass(frozen=True)
class Example:
    """One frame of the pool.

    Args:
        grey: (1,1,H,W) uint8.
        corners_px: (4,2) float64 true corners; zeros where there is no panel.
        shape: of the panel.
        readable: whether the panel is whole in the frame and its bits can be told at the true corners.
    """

    grey: Tensor
    corners_px: Tensor
    shape: PanelShape
    readable: bool

    @property
    def empty(self) -> bool:
        """Whether no panel is in the frame."""
        return not bool(self.corners_px.any())

    @property
    def pitch_px(self) -> float:
        """Mean distance of LEDs."""
        return float(
            torch.stack(cell_size_px(self.corners_px[None], self.shape)).prod().sqrt()
        )


def save_block(
    path: Path, grey: Tensor, corners_px: Tensor, shape: PanelShape, bits: Tensor
) -> None:
    """Write frames (B,H,W) of one panel's shape, whole or not at all."""
    part = path.with_suffix(".part.npz")
    np.savez(
        part,
        grey=grey,
        corners=corners_px,
        shape=[shape.rows, shape.columns],
        bits=bits,
    )
    part.rename(path)


def read_block(path: Path) -> Iterator[Example]:
    """Read what :func:`save_block` wrote."""
    with np.load(path, allow_pickle=False) as block:
        shape = PanelShape(*block["shape"].tolist())
        grey, corners, bits = (
            torch.from_numpy(block[name]) for name in ("grey", "corners", "bits")
        )
    for frame, quad, sent in zip(
        grey[:, None, None], corners.double(), bits, strict=True
    ):
        readable = (
            bool(quad.any()) and contrast(frame, quad, sent, shape) > LEAST_CONTRAST
        )
        yield Example(frame, quad, shape, readable)


def read_pool(paths: Sequence[Path]) -> list[Example]:
    """Read blocks in the order of their names."""
    return [example for path in sorted(paths) for example in read_block(path)]


def contrast(
    grey: Tensor, corners_px: Tensor, bits: Tensor, shape: PanelShape
) -> float:
    """Say how far On and Off cells part at the true corners, in standard deviations; 0 beyond the frame."""
    high, wide = grey.shape[2:]
    inside = (corners_px >= -0.5) & (
        corners_px <= corners_px.new_tensor([wide, high]) + 0.5
    )
    if not bool(inside.all()) or bits.all() or not bits.any():
        return 0.0
    cells = Pyramid.of(grey).read_cells(corners_px[None], shape, READ_SAMPLES, 0)[0]
    cells = cells.view(shape.rows, READ_SAMPLES, shape.columns, READ_SAMPLES)[
        :, 1:-1, :, 1:-1
    ].mean((1, 3))
    on, off = cells[bits], cells[~bits]
    spread = (on.var(correction=0) + off.var(correction=0) + 1).sqrt()
    return float((on.mean() - off.mean()) / spread)
