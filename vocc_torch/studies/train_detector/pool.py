"""The pool of training frames: rendered once, kept on disk, read from one buffer on any device."""

import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from vocc_torch.api import load_scene, simulate
from vocc_torch.receiver.detector import pyramid as pyramids
from vocc_torch.receiver.detector.pyramid import Pyramid, bilinear, halved
from vocc_torch.receiver.resample import cell_homography, cell_size_px
from vocc_torch.report.terminal import Console, ProgressView
from vocc_torch.studies.train_detector.clutter import mosaics
from vocc_torch.types import Frames, PanelShape


@dataclass(frozen=True)
class PoolSettings:
    """The rendered scenes."""

    frames: int = 16  # of a block
    width_px: int = 960  # half of the camera's, of pixels as large
    height_px: int = 544
    offset_m: tuple[float, float] = (1.0, 0.4)  # of panels, to the right and down
    samples: int = 4  # along a cell's side, whose middle ones tell the LED
    least_contrast: float = 1.2  # of On and Off cells of a readable panel, deviations
    mosaics: int = 32  # frames put together from photographs and drawings


SETTINGS = PoolSettings()

ABSENT = "+scene.effects.panel_absent={}"

STREETS = ("street", "street_night")
PLAIN = ("paper", "fog", "tunnel", "night", "low_sun")
"""Scenes of which in each round one has a block."""

SHAPES = ((8, 8), (8, 8), (4, 4), (16, 16), (4, 8), (8, 16))
"""Rows and columns of the panels: in each round the first two and one of the others."""


class PoolBlock(NamedTuple):
    """Frames of one scene and shape, 0 rows for those without a panel, and where they are kept."""

    path: Path
    scene: str
    rows: int
    columns: int
    seed: int

    @property
    def name(self) -> str:
        """Name for draws of its own."""
        return self.path.stem


def blocks_of(folder: Path, seed: int, rounds: int) -> list[PoolBlock]:
    """List the blocks: in each round three streets without a panel, three with, and one plain scene, twice."""
    blocks = []
    for number in range(rounds):
        other = SHAPES[2:][number % len(SHAPES[2:])]
        plain = PLAIN[number % len(PLAIN)]
        shapes = (*((0, 0),) * 3, *SHAPES[:2], other)
        for part, (rows, columns) in enumerate(shapes):
            for scene in STREETS:
                path = folder / f"{number:03d}_{scene}_{part}.npz"
                blocks.append(PoolBlock(path, scene, rows, columns, seed))
        path = folder / f"{number:03d}_{plain}.npz"
        blocks.append(PoolBlock(path, plain, *SHAPES[0], seed))
    return blocks


def render(blocks: Sequence[PoolBlock], workers: int, console: Console) -> None:
    """Render the blocks that are missing, in processes."""
    missing = [block for block in blocks if not block.path.exists()]
    context = get_context("spawn")
    with (
        ProgressView(len(missing), console, "rendering", unit="blocks") as view,
        ProcessPoolExecutor(workers, context, torch.set_num_threads, (1,)) as pool,
    ):
        jobs = [pool.submit(render_block, block) for block in missing]
        for done in view.counted(as_completed(jobs), "rendering"):
            done.result()


def render_block(block: PoolBlock) -> None:
    """Write the frames of a block, whole or not at all."""
    options = SETTINGS
    rows, columns = (block.rows, block.columns) if block.rows else SHAPES[0]
    right, down = options.offset_m
    camera = load_scene(block.scene).camera
    width_mm = camera.sensor_width_mm * options.width_px / camera.width_px
    overrides = (
        f"panel.rows={rows}",
        f"panel.columns={columns}",
        f"camera.width_px={options.width_px}",
        f"camera.height_px={options.height_px}",
        f"camera.sensor_width_mm={width_mm}",
        f"scene.offset_x_m=[uniform,{-right},{right}]",
        f"scene.offset_y_m=[uniform,{-down},{down}]",
        *([] if block.rows else [ABSENT]),
    )
    world = load_scene(block.scene, *overrides)
    point = f"train_detector {block.name}"
    parts = list(simulate(world, options.frames, block.seed, point=point))
    grey = torch.cat([whole_frames(one.frames) for one in parts])
    corners = torch.cat([one.corners_px for one in parts]).double()
    bits = torch.cat([one.bits for one in parts])
    contrasts = [
        contrast(one[None, None], quad, sent, PanelShape(rows, columns))
        for one, quad, sent in zip(grey, corners, bits, strict=True)
    ]
    part = block.path.with_suffix(f".{os.getpid()}.part.npz")
    np.savez(
        part,
        grey=grey.numpy(),
        corners=corners.numpy() * bool(block.rows),
        shape=[block.rows, block.columns],
        readable=np.array(contrasts) * bool(block.rows) > options.least_contrast,
    )
    part.rename(block.path)


def whole_frames(frames: Frames) -> Tensor:
    """Put crops back into their frames (B,H,W) uint8."""
    if frames.surround is None:
        return frames.grey[:, 0]
    high, wide = frames.grey.shape[2:]
    surround = frames.surround.round().byte()[:, None, None]
    out = surround.repeat(1, *frames.sensor_px)
    for row, (left, top) in enumerate(frames.origin_px.tolist()):
        out[row, top : top + high, left : left + wide] = frames.grey[row, 0]
    return out


@dataclass(frozen=True)
class Pool:
    """Frames and their halvings in one buffer.

    Args:
        buffer: uint8, the levels one after another, each of all frames.
        starts: (L,) int64 first pixel of a level.
        sizes: (L,2) int64 rows and columns of a level.
        corners_px: (N,4,2) float64 true corners; zeros where there is no panel.
        shapes: (N,2) int64 rows and columns; zeros where there is no panel.
        readable: (N,) bool, whether a panel is whole in the frame and its bits can be told at the corners.
    """

    buffer: Tensor
    starts: Tensor
    sizes: Tensor
    corners_px: Tensor
    shapes: Tensor
    readable: Tensor

    @classmethod
    def of(cls, paths: Sequence[Path], seed: int, device: torch.device) -> Self:
        """Read blocks in the order of their names, and put photographs and drawings beside them."""
        options = SETTINGS
        greys, corners, shapes, readable = [], [], [], []
        for path in sorted(paths):
            with np.load(path, allow_pickle=False) as block:
                greys.append(torch.from_numpy(block["grey"]))
                corners.append(torch.from_numpy(block["corners"]))
                shapes.append(
                    torch.from_numpy(block["shape"]).expand(len(greys[-1]), 2)
                )
                readable.append(torch.from_numpy(block["readable"]))
        size = (options.height_px, options.width_px)
        extra = torch.from_numpy(mosaics(seed, options.mosaics, size))
        greys.append(extra)
        corners.append(torch.zeros(len(extra), 4, 2, dtype=torch.float64))
        shapes.append(torch.zeros(len(extra), 2, dtype=torch.int64))
        readable.append(torch.zeros(len(extra), dtype=torch.bool))
        return cls(
            *levels_of(torch.cat(greys), device),
            torch.cat(corners).to(device),
            torch.cat(shapes).to(device),
            torch.cat(readable).to(device),
        )

    @property
    def device(self) -> torch.device:
        """Where the frames are."""
        return self.buffer.device

    @property
    def empty(self) -> Tensor:
        """Numbers of the frames without a panel."""
        return (self.shapes[:, 0] == 0).nonzero()[:, 0]

    @property
    def pitch_px(self) -> Tensor:
        """Mean distance of LEDs (N,), NaN without a panel."""
        sides = torch.stack(cell_size_px(self.corners_px, PanelShape(1, 1)))
        return (sides.prod(0) / self.shapes.prod(1)).sqrt().float()

    def level(self, number: int, frame: int) -> Tensor:
        """Give a level (H,W) of a frame, float32."""
        high, wide = self.sizes[number].tolist()
        start = int(self.starts[number]) + frame * high * wide
        return self.buffer[start : start + high * wide].view(high, wide).float()

    def read(self, frame: Tensor, level: Tensor, at: Tensor) -> Tensor:
        """Read (B,P) of frames (B,) bilinearly in levels (B,) at places (B,2,P) px of the frame.

        Beyond a frame its edges go on.
        """
        size = self.sizes[level]
        start = self.starts[level, None] + frame[:, None] * size.prod(1, keepdim=True)
        places = at.double().nan_to_num() * 0.5 ** level[:, None, None]
        return bilinear(self.buffer, start, size, places)


def levels_of(grey: Tensor, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Lay the halvings of frames (N,H,W) uint8 into one buffer, and say where each begins."""
    parts, starts, sizes, start = [], [], [], 0
    level = grey[:, None]
    while min(level.shape[2:]) >= pyramids.SETTINGS.least_side_px:
        parts.append(level.flatten().to(device))
        starts.append(start)
        sizes.append(level.shape[2:])
        start += level.numel()
        level = torch.cat(
            [halved(some) for some in torch.split(level, SETTINGS.frames)]
        )
    numbers = torch.tensor(starts, device=device), torch.tensor(sizes, device=device)
    return torch.cat(parts), *numbers


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
    quads = corners_px[None]
    homography = cell_homography(quads, shape)
    cells = Pyramid.of(grey).read_cells(quads, homography, shape, (side, side), 0)[0]
    cells = cells.view(shape.rows, side, shape.columns, side)[:, 1:-1, :, 1:-1]
    means = cells.mean((1, 3))
    on, off = means[bits], means[~bits]
    spread = (on.var(correction=0) + off.var(correction=0) + 1).sqrt()
    return float((on.mean() - off.mean()) / spread)
