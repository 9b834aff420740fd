"""The pool of training frames: rendered once, kept on disk, read from one buffer on any device."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from vocc_torch.api import load_scene, simulate
from vocc_torch.files import atomic_file
from vocc_torch.receiver.detector import pyramid as pyramids
from vocc_torch.receiver.detector.pyramid import halved
from vocc_torch.receiver.resample import cell_size_px, rectify
from vocc_torch.report.terminal import Console, ProgressView
from vocc_torch.studies.train_detector.clutter import mosaics
from vocc_torch.types import Frames, Panels, PanelShape


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

SHAPES = ((8, 8), (4, 4), (8, 8), (16, 16), (4, 8), (8, 16))
"""Rows and columns of the panels: in each round the first two and one of the others."""


class PoolBlock(NamedTuple):
    """Frames of one scene and shape, 0 rows for those without a panel, and where they are kept."""

    path: Path
    scene: str
    rows: int
    columns: int
    seed: int


def blocks_of(folder: Path, seed: int, rounds: int) -> list[PoolBlock]:
    """List the blocks: in each round three streets without a panel, three with, and one plain scene, twice."""
    blocks = []
    for number in range(rounds):
        other = SHAPES[2:][number % len(SHAPES[2:])]
        plain = PLAIN[number % len(PLAIN)]
        shapes = (*((0, 0),) * 3, *SHAPES[:2], other)
        scenes = [
            (f"{scene}_{part}", scene, sides)
            for part, sides in enumerate(shapes)
            for scene in STREETS
        ]
        for name, scene, sides in (*scenes, (plain, plain, SHAPES[0])):
            path = folder / f"{number:03d}_{name}.npz"
            blocks.append(PoolBlock(path, scene, *sides, seed))
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
    world = replace(load_scene(block.scene, *overrides), framing="filled", device="cpu")
    point = f"train_detector {block.path.stem}"
    parts = list(simulate(world, options.frames, block.seed, point=point))
    grey = torch.cat([one.frames.grey for one in parts])
    corners = torch.cat([one.corners_px for one in parts]).double()
    bits = torch.cat([one.bits for one in parts])
    with atomic_file(block.path) as temporary:
        np.savez(
            temporary,
            grey=grey[:, 0].numpy(),
            corners=corners.numpy() * bool(block.rows),
            shape=np.tile((block.rows, block.columns), (len(grey), 1)),
            readable=readable(grey, corners, bits).numpy() & bool(block.rows),
        )


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
        size = options.mosaics, options.height_px, options.width_px
        blocks: list[Mapping[str, Any]] = [
            {
                "grey": mosaics(seed, size),
                "corners": np.zeros((options.mosaics, 4, 2)),
                "shape": np.zeros((options.mosaics, 2), int),
                "readable": np.zeros(options.mosaics, bool),
            }
        ]
        blocks[:0] = [np.load(path, allow_pickle=False) for path in sorted(paths)]
        grey, *told = (
            torch.from_numpy(np.concatenate([block[name] for block in blocks]))
            for name in blocks[-1]
        )
        return cls(*levels_of(grey, device), *(part.to(device) for part in told))

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

    def levels(self, number: int, frames: Tensor) -> Tensor:
        """Give a level of frames (n,), (n,H,W) float32."""
        high, wide = self.sizes[number].tolist()
        start = int(self.starts[number])
        many = len(self.shapes)
        planes = self.buffer[start : start + many * high * wide].view(many, high, wide)
        return planes[frames].float()

    def read(self, frame: Tensor, level: Tensor, at: Tensor) -> Tensor:
        """Read (B,P) of frames (B,) bilinearly in levels (B,) at places (B,2,P) px of the frame.

        Beyond a frame its edges go on.
        """
        size = self.sizes[level]
        start = self.starts[level, None] + frame[:, None] * size.prod(1, keepdim=True)
        places = at.double().nan_to_num() * 0.5 ** level[:, None, None]
        return bilinear(self.buffer, start, size, places)


def bilinear(buffer: Tensor, start: Tensor, size: Tensor, at: Tensor) -> Tensor:
    """Read planes in a buffer (P,) at places (n,2,P), px, whose pixel centres lie at halves, to (n,P) float32.

    Args:
        buffer: grey values.
        start: (n,1) int64 where the planes begin.
        size: (n,2) int64 height and width.
        at: across and down; beyond a plane its border pixels go on.

    Example:
        >>> start, size, at = torch.tensor([[0]]), torch.tensor([[1, 2]]), torch.tensor([[[1.0], [0.5]]])
        >>> bilinear(torch.tensor([0.0, 8.0]), start, size, at).tolist()
        [[4.0]]
    """
    last = size.flip(1)[..., None] - 1
    at = (at - 0.5).clamp(min=0).minimum(last.to(at))
    first = at.floor().minimum((last - 1).clamp(min=0).to(at))
    share = (at - first).float().unbind(1)
    column, row = first.long().unbind(1)
    wide = size[:, 1:]
    index = row * wide + column + start
    right, below = (wide > 1).long(), wide * (size[:, :1] > 1)
    corners = torch.stack([index, index + below, index + right, index + right + below])
    near = buffer.index_select(0, corners.flatten()).float().view(2, 2, *index.shape)
    upper, lower = torch.lerp(near[0], near[1], share[0])
    return torch.lerp(upper, lower, share[1])


def levels_of(grey: Tensor, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Lay the halvings of frames (N,H,W) uint8 into one buffer, and say where each begins."""
    parts, starts, sizes, start = [], [], [], 0
    level = grey[:, None].to(device)
    while min(level.shape[2:]) >= pyramids.SETTINGS.least_side_px:
        parts.append(level.flatten())
        starts.append(start)
        sizes.append(level.shape[2:])
        start += level.numel()
        level = torch.cat(
            [halved(some) for some in torch.split(level, SETTINGS.frames)]
        )
    numbers = torch.tensor(starts, device=device), torch.tensor(sizes, device=device)
    return torch.cat(parts), *numbers


def readable(grey: Tensor, corners_px: Tensor, bits: Tensor) -> Tensor:
    """Say in which frames (B,1,H,W) panels are whole and their On and Off cells part at the true corners."""
    wide_high = corners_px.new_tensor(grey.shape[:1:-1])
    inside = (corners_px >= -0.5) & (corners_px <= wide_high + 0.5)
    shape, side = PanelShape(*bits.shape[1:]), SETTINGS.samples
    panels = Panels.known(corners_px)
    cells = rectify(Frames.whole(grey), panels, shape, side, margin=0)
    cells = cells.view(-1, shape.rows, side, shape.columns, side)
    means = cells[:, :, 1:-1, :, 1:-1].mean((2, 4))
    apart = torch.stack(
        [
            contrast(mean[sent], mean[~sent])
            for mean, sent in zip(means, bits, strict=True)
        ]
    )
    return inside.all(2).all(1) & (apart > SETTINGS.least_contrast)


def contrast(on: Tensor, off: Tensor) -> Tensor:
    """Say how far On and Off cells part, in standard deviations; NaN where either are missing."""
    spread = (on.var(correction=0) + off.var(correction=0) + 1).sqrt()
    return (on.mean() - off.mean()) / spread
