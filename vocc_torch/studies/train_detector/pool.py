"""The pool of training frames: rendered once, kept on disk, read as the detector reads frames."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from vocc_torch.api import load_scene
from vocc_torch.files import atomic_file
from vocc_torch.hardware import Camera
from vocc_torch.measure.executors import Workers
from vocc_torch.receiver.detector.pyramid import Pyramid, halved, places_of_cells
from vocc_torch.receiver.resample import cell_homography, cell_size_px, centre_greys
from vocc_torch.report.terminal import Console, ProgressView
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.studies.train_detector.clutter import copy_photographs
from vocc_torch.types import Frames, Panels, PanelShape
from vocc_torch.yaml_text import read_yaml


@dataclass(frozen=True)
class PoolSettings:
    """The rendered frames."""

    frames: int = 48  # of a block
    read_at_once: int = 8  # candidates whose frames are copied together
    width_px: int = 480  # a quarter of the camera's, of pixels as large
    height_px: int = 272
    offset_m: tuple[float, float] = (0.5, 0.2)  # of panels, to the right and down
    lit: tuple[float, float] = (0.2, 0.8)  # share of LEDs that are On
    pictured: float = 0.25  # share of panels whose On LEDs stand together
    together: float = 0.35  # of their share, in the mean of 3 x 3 random numbers
    least_correlation: float = 0.6  # of a readable panel's bits and its LEDs' grey
    least_spread: float = 2.0  # deviation of its LEDs' grey
    # Rows and columns of panels that each round has in each scene, and others of which
    # it has one.
    common: tuple[tuple[int, int], ...] = ((8, 8), (4, 4))
    others: tuple[tuple[int, int], ...] = (
        *((16, 16), (4, 8), (8, 16), (12, 12), (5, 7)),
        *((6, 6), (8, 32), (32, 32), (5, 5), (4, 5)),
    )
    # Cameras of the blocks, in turn: how often a frame is halved, and overrides of the
    # scene. A frame that is halved is rendered with smaller pixels.
    cameras: tuple[tuple[int, tuple[str, ...]], ...] = (
        (0, ()),
        (1, ("++scene.effects.blooming.sigma_px=0.3",)),
        (0, ("+scene.effects.jpeg.quality=85",)),
        (1, ("+scene.effects.jpeg.quality=60",)),
        (
            0,
            (
                "++scene.effects.blooming.sigma_px=0.3",
                "+scene.effects.jpeg.quality=40",
            ),
        ),
    )


SETTINGS = PoolSettings()

ABSENT = "+scene.effects.panel_absent={}"

PHOTOGRAPHS = "photographs"
"""Folder of the photographs, beside the blocks."""

OWN = ("clutter", "photographs")
"""Scenes of files in this folder."""

SCENES = ("street", "street_night", *OWN)
PLAIN = ("paper", "fog", "tunnel", "night", "low_sun")
"""Scenes of which in each round one has a block."""

SHAPES = SETTINGS.common + SETTINGS.others


class PoolBlock(NamedTuple):
    """Frames of one scene and shape, 0 rows for those without a panel, and where they are kept."""

    path: Path
    scene: str
    rows: int
    columns: int
    camera: int
    seed: int


def blocks_of(folder: Path, seed: int, rounds: int) -> list[PoolBlock]:
    """List the blocks: in each round two of each scene without a panel, three with, and one plain scene."""
    blocks, common = [], SETTINGS.common
    plains, others = cycle(PLAIN), cycle(SETTINGS.others)
    for number in range(rounds):
        kinds = [(next(plains), 0, common[0])]
        for scene in SCENES:
            shapes = ((0, 0), (0, 0), *common, next(others))
            kinds += [(scene, part, sides) for part, sides in enumerate(shapes)]
        for scene, part, sides in kinds:
            path = folder / f"{number:03d}_{scene}_{part}.npz"
            camera = (number + part) % len(SETTINGS.cameras)
            blocks.append(PoolBlock(path, scene, *sides, camera, seed))
    return blocks


def render(blocks: Sequence[PoolBlock], console: Console) -> None:
    """Render the blocks that are missing, one on each core."""
    missing = [block for block in blocks if not block.path.exists()]
    if missing:
        copy_photographs(missing[0].path.parent / PHOTOGRAPHS)
    with (
        ProgressView(len(missing), console, "rendering", unit="blocks") as view,
        Workers(0) as workers,
    ):
        for _ in view.counted(workers.map(render_block, missing), "rendering"):
            pass


def render_block(block: PoolBlock) -> None:
    """Write the frames of a block, whole or not at all."""
    options = SETTINGS
    rows, columns = (block.rows, block.columns) if block.rows else options.common[0]
    right, down = options.offset_m
    halvings, changes = options.cameras[block.camera]
    camera = Camera()
    width_mm = camera.sensor_width_mm * options.width_px / camera.width_px
    overrides = (
        f"panel.rows={rows}",
        f"panel.columns={columns}",
        f"camera.width_px={options.width_px << halvings}",
        f"camera.height_px={options.height_px << halvings}",
        f"camera.sensor_width_mm={width_mm}",
        f"scene.offset_x_m=[uniform,{-right},{right}]",
        f"scene.offset_y_m=[uniform,{-down},{down}]",
        *([] if block.rows else [ABSENT]),
        *changes,
    )
    scene: Any = block.scene
    if scene in OWN:
        scene = read_yaml(Path(__file__).with_name(f"{scene}.yaml"))
        photographs = block.path.parent / PHOTOGRAPHS
        scene["effects"]["backdrop"]["folder"] = str(photographs)
    world = replace(load_scene(scene, *overrides), framing="filled", device="cpu")
    simulator = world.simulator()
    key = BlockKey(block.seed, f"train_detector {block.path.stem}", 0)
    scenes, _ = world.scene.draw(key, simulator.panel.shape)
    scenes = scenes[: options.frames]
    bits = bits_of(key, len(scenes), simulator.panel.shape)
    names = [FrameKey(key, frame) for frame in range(len(scenes))]
    grey = simulator.render(scenes, bits, keys=names).grey
    panels = simulator.true_panels(scenes, names)
    for _ in range(halvings):
        grey = halved(grey)
        panels = replace(panels, corners_px=panels.corners_px / 2)
    with atomic_file(block.path) as temporary:
        np.savez(
            temporary,
            grey=grey[:, 0].numpy(),
            corners=panels.corners_px.double().numpy(),
            shape=np.tile((block.rows, block.columns), (len(grey), 1)),
            readable=(panels.found & readable(grey, panels, bits)).numpy(),
        )


def bits_of(key: BlockKey, count: int, shape: PanelShape) -> Tensor:
    """Draw which LEDs are On (B,R,C): shares of them at random, and in some frames together."""
    options, generator = SETTINGS, key.generator("bits")
    noise = torch.from_numpy(generator.random((count, *shape.sides)))
    share = torch.from_numpy(generator.uniform(*options.lit, (count, 1, 1)))
    pictured = torch.from_numpy(generator.random((count, 1, 1))) < options.pictured
    mean = functional.avg_pool2d(noise, 3, 1, 1, count_include_pad=False)
    together = mean < 0.5 + options.together * (share - 0.5)
    return torch.where(pictured, together, noise < share)


def readable(grey: Tensor, panels: Panels, bits: Tensor) -> Tensor:
    """Say in which frames (B,1,H,W) panels are whole and their bits (B,R,C) can be told by their LEDs' grey."""
    corners_px = panels.corners_px
    wide_high = corners_px.new_tensor(grey.shape[:1:-1])
    inside = (corners_px >= -0.5) & (corners_px <= wide_high + 0.5)
    light = centre_greys(Frames.whole(grey), panels, PanelShape(*bits.shape[1:]))
    light, sent = (
        part - part.mean(1, keepdim=True)
        for part in (light.flatten(1), bits.flatten(1).float())
    )
    alike = functional.cosine_similarity(light, sent) > SETTINGS.least_correlation
    apart = light.square().mean(1).sqrt() > SETTINGS.least_spread
    return inside.all(2).all(1) & alike & apart


@dataclass(frozen=True)
class Form:
    """What a network sees of a candidate.

    Args:
        shape: rows and columns of the panels.
        cells: rows and columns that the candidate's sides are cut into.
        samples: px of a cell, down and across.
        margin: cells around the candidate.
    """

    shape: PanelShape
    cells: PanelShape
    samples: tuple[int, int]
    margin: int = 0

    @property
    def px(self) -> int:
        """Pixels of the picture without its margin."""
        return self.cells.leds * self.samples[0] * self.samples[1]

    @property
    def transposed(self) -> "Form":
        """Rows for columns."""
        shape, cells = (
            PanelShape(sides.columns, sides.rows) for sides in (self.shape, self.cells)
        )
        down, across = self.samples
        return Form(shape, cells, (across, down), self.margin)


@dataclass(frozen=True)
class Pool:
    """Frames, each with its halvings in one picture.

    Args:
        atlases: (N,h,w) uint8, those of :class:`Pyramid`.
        sizes: rows and columns of each level, the frame's first.
        corners_px: (N,4,2) float64 true corners; zeros where there is no panel.
        shapes: (N,2) int64 rows and columns; zeros where there is no panel.
        readable: (N,) bool, whether a panel is whole in the frame and its bits can be told at the corners.
    """

    atlases: Tensor
    sizes: tuple[tuple[int, int], ...]
    corners_px: Tensor
    shapes: Tensor
    readable: Tensor

    @classmethod
    def of(cls, paths: Sequence[Path], device: torch.device) -> Self:
        """Read blocks in the order of their names."""
        blocks = [np.load(path, allow_pickle=False) for path in sorted(paths)]
        grey, *truths = (
            torch.from_numpy(np.concatenate([block[name] for block in blocks]))
            for name in ("grey", "corners", "shape", "readable")
        )
        return cls.from_frames(grey, *(truth.to(device) for truth in truths))

    @classmethod
    def from_frames(
        cls, grey: Tensor, corners_px: Tensor, shapes: Tensor, readable: Tensor
    ) -> Self:
        """Halve frames (N,H,W) uint8."""
        sizes = Pyramid.of(grey[:1, None]).sizes
        atlases = [Pyramid.of(frame[None, None]).atlas.byte() for frame in grey]
        atlas = torch.stack(atlases).to(shapes.device)
        return cls(atlas, sizes, corners_px, shapes, readable)

    @property
    def device(self) -> torch.device:
        """Where the frames are."""
        return self.atlases.device

    @property
    def empty(self) -> Tensor:
        """Which frames (N,) are without a panel."""
        return self.shapes[:, 0] == 0

    @property
    def sought(self) -> Tensor:
        """Rows and columns (N,2) of the panel that is looked for, also in frames without a panel."""
        shapes = torch.tensor(SHAPES, device=self.device)
        numbers = torch.arange(len(self.shapes), device=self.device) % len(shapes)
        return torch.where(self.empty[:, None], shapes[numbers], self.shapes)

    @property
    def pitch_px(self) -> Tensor:
        """Mean distance of LEDs (N,), NaN without a panel."""
        sides = torch.stack(cell_size_px(self.corners_px, PanelShape(1, 1)))
        return (sides.prod(0) / self.shapes.prod(1)).sqrt()

    def pyramid(self, frame: int) -> Pyramid:
        """Give one frame's halvings."""
        high, wide = self.sizes[0]
        return Pyramid.of(self.atlases[frame, :high, :wide][None, None])

    def read(self, frame: Tensor, quads: Tensor, form: Form) -> Tensor:
        """Read the pictures (n,h,w) of candidates (n,4,2) px of frames (n,), as :meth:`Pyramid.read_cells` does."""
        homography = cell_homography(quads, form.cells)
        grid = places_of_cells(
            self.sizes, quads, homography, form.cells, form.samples, form.margin
        )
        # Copies of a few frames stay in a processor's cache.
        count = SETTINGS.read_at_once
        parts = zip(torch.split(frame, count), torch.split(grid, count), strict=True)
        pictures = [
            functional.grid_sample(
                self.atlases[numbers][:, None].float(),
                places,
                padding_mode="border",
                align_corners=False,
            )
            for numbers, places in parts
        ]
        return torch.cat(pictures)[:, 0]
