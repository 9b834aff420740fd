"""The pool of training frames on disk: rendered once, read by all trainings."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from vocc_torch.api import load_scene, simulate
from vocc_torch.receiver.detector.pyramid import Pyramid
from vocc_torch.receiver.resample import cell_size_px
from vocc_torch.types import PanelShape


@dataclass(frozen=True)
class PoolSettings:
    """What is rendered."""

    scenes: tuple[str, ...] = ("street", "street_night")
    frames: int = 16  # of a block
    width_px: int = 960  # half of the camera's, of pixels as large
    height_px: int = 544
    offset_m: tuple[float, float] = (1.0, 0.4)  # of panels, to the right and down
    samples: int = 4  # along a cell's side, whose middle ones tell the LED
    least_contrast: float = 1.2  # of On and Off cells of a readable panel, deviations


SETTINGS = PoolSettings()

ABSENT = "+scene.effects.panel_absent={}"

SHAPES = ((8, 8), (8, 8), (4, 4), (16, 16), (4, 8), (8, 16))
"""Rows and columns of the panels: in each round the first two and one of the others."""


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


def render_round(folder: Path, seed: int, number: int) -> list[Path]:
    """Render the blocks of a round that are missing: for each scene one without panels and three with."""
    others = SHAPES[2:]
    shapes = (None, *SHAPES[:2], others[number % len(others)])
    paths = []
    for scene in SETTINGS.scenes:
        for block, shape in enumerate(shapes):
            name = f"{scene}_{number:03d}_{block}"
            paths.append(folder / f"{name}.npz")
            if not paths[-1].exists():
                render_block(paths[-1], scene, shape, seed, name)
    return paths


def render_block(
    path: Path, scene: str, shape: tuple[int, int] | None, seed: int, name: str
) -> None:
    """Write the frames of a block, whole or not at all.

    Args:
        path: of the file.
        scene: that ships.
        shape: rows and columns of panels; None for frames without a panel.
        seed: of the pool.
        name: of the block, for draws of its own.
    """
    options, (rows, columns) = SETTINGS, shape or SHAPES[0]
    right, down = options.offset_m
    camera = load_scene(scene).camera
    width_mm = camera.sensor_width_mm * options.width_px / camera.width_px
    overrides = (
        f"panel.rows={rows}",
        f"panel.columns={columns}",
        f"camera.width_px={options.width_px}",
        f"camera.height_px={options.height_px}",
        f"camera.sensor_width_mm={width_mm}",
        f"scene.offset_x_m=[uniform,{-right},{right}]",
        f"scene.offset_y_m=[uniform,{-down},{down}]",
        *([] if shape else [ABSENT]),
    )
    world = load_scene(scene, *overrides)
    parts = list(simulate(world, options.frames, seed, point=f"train_detector {name}"))
    part = path.with_suffix(".part.npz")
    np.savez(
        part,
        grey=torch.cat([one.frames.grey[:, 0] for one in parts]),
        corners=torch.cat([one.corners_px for one in parts]),
        shape=[rows, columns],
        bits=torch.cat([one.bits for one in parts]),
    )
    part.rename(path)


def read_block(path: Path) -> Iterator[Example]:
    """Read what :func:`render_block` wrote."""
    with np.load(path, allow_pickle=False) as block:
        shape = PanelShape(*block["shape"].tolist())
        grey, corners, bits = (
            torch.from_numpy(block[name]) for name in ("grey", "corners", "bits")
        )
    for frame, quad, sent in zip(
        grey[:, None, None], corners.double(), bits, strict=True
    ):
        readable = (
            bool(quad.any())
            and contrast(frame, quad, sent, shape) > SETTINGS.least_contrast
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
    side = SETTINGS.samples
    cells = Pyramid.of(grey).read_cells(corners_px[None], shape, side, 0)[0]
    cells = cells.view(shape.rows, side, shape.columns, side)[:, 1:-1, :, 1:-1]
    means = cells.mean((1, 3))
    on, off = means[bits], means[~bits]
    spread = (on.var(correction=0) + off.var(correction=0) + 1).sqrt()
    return float((on.mean() - off.mean()) / spread)
