"""What a figure of the paper is and rests on: the sample frames, and panels cut out of frames."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
import torch
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.plan import Plan
from vocc_torch.receiver.features import FEATURE_NAMES, preamble_threshold
from vocc_torch.rng import BlockKey
from vocc_torch.show.canvas import new_figure, write_title
from vocc_torch.simulation import Simulator
from vocc_torch.types import Frames, PanelShape, Scene

SAMPLE_FRAMES = 100
"""Section III-B: "100 sample LED panel frames simulated at various conditions"."""

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Cell = str | int | float
Rows = list[tuple[Cell, ...]]
"""Lines of a CSV file, its head first."""
Picture = tuple[Floats, tuple[float, float, float, float]]
"""Grey values (h,w), and their extent in LED cells from the panel's corner: left, right, bottom, top."""


@dataclass(frozen=True)
class Sample:
    """The sample frames and what the reader measures in them at the true corners.

    Args:
        scene: B scenes.
        bits: (B,R,C).
        greys: (B,R,C) average grey of each LED's cell.
        thresholds: (B,) halfway between the average greys of the all-On and the all-Off frame of the scene.
        features: (B,R,C,3) AGR, GRI, NGR.
        patches: (B,1,(R+2)K,(C+2)K) the rectified panels.
        pictures: B panels with one cell of margin.
    """

    scene: Scene
    bits: Bools
    greys: Floats
    thresholds: Floats
    features: Floats
    patches: Tensor
    pictures: tuple[Picture, ...]

    def feature(self, name: str) -> Floats:
        """One of the features, (B,R,C)."""
        return self.features[..., FEATURE_NAMES.index(name)]

    @property
    def conditions(self) -> Floats:
        """(B,4) ambient light (lx), LED luminance (cd/m2), distance (m), background grey."""
        return conditions(self.scene)


@dataclass(frozen=True)
class Source:
    """What figures are computed from: a plan, and the sample, which is simulated when first asked for.

    Args:
        plan: the study; its locator is not used for the sample.
        sample_frames: at least 1.
    """

    plan: Plan
    sample_frames: int = SAMPLE_FRAMES

    @cached_property
    def sample(self) -> Sample:
        """The sample frames over the ranges of the plan's scenes."""
        plan = self.plan
        link = Link(plan.world.simulator(), None, plan.receiver.reader, plan.batch_frames)
        keys = block_keys(plan.seed, "figures/sample", self.sample_frames)
        seen = list(link.observe(plan.world.scene, keys, preambles=True, frames=self.sample_frames))
        readings = [piece.readings for piece in seen]
        preambles = [piece.preambles for piece in seen if piece.preambles is not None]
        shape = plan.world.panel.shape
        pictures = [cut_out(piece.frames, piece.panels.corners_px, shape) for piece in seen]
        thresholds = [preamble_threshold(one.on.average, one.off.average) for one in preambles]

        def joined(parts: Iterable[Tensor]) -> Tensor:
            return torch.cat(list(parts)).cpu()

        return Sample(
            scene=Scene.cat([piece.scene for piece in seen]).to("cpu"),
            bits=joined(piece.bits for piece in seen).numpy(),
            greys=joined(one.greys.average for one in readings).double().numpy(),
            thresholds=joined(thresholds).double().flatten().numpy(),
            features=joined(one.features for one in readings).numpy(),
            patches=joined(one.patches for one in readings),
            pictures=tuple(picture for part in pictures for picture in part),
        )

    def bits(self, name: str) -> Tensor:
        """(1,R,C) bool, the bits that a figure shows in all its scenes.

        Args:
            name: of the figure's own block of random numbers.
        """
        world = self.plan.world
        return world.scene.draw(BlockKey(self.plan.seed, f"figures/{name}", 0), world.panel.shape)[1][:1]

    def without_blooming(self) -> Simulator:
        """The plan's simulator without the blooming effect.

        Raises:
            VoccError: the scenes have none.
        """
        effects = dict(self.plan.world.effects)
        if effects.pop("blooming", None) is None:
            raise VoccError("scene.effects has no blooming: this figure shows what it does")
        return replace(self.plan.world, effects=effects).simulator()


class PaperFigure(ABC):
    """One figure of the paper: a frozen dataclass whose fields are what is drawn."""

    name: ClassVar[str]
    title: ClassVar[str]
    caption: ClassVar[str]
    height_in: ClassVar[float] = 6.0

    @classmethod
    @abstractmethod
    def compute(cls, source: Source) -> Self:
        """Simulate and measure what the figure shows; the plan's locator is used where the figure says so."""

    @abstractmethod
    def rows(self) -> Rows:
        """Lay out the CSV file."""

    @abstractmethod
    def findings(self) -> dict[str, float]:
        """State the numbers that the figure shows, by name, for the report."""

    @abstractmethod
    def draw_on(self, figure: Figure) -> str:
        """Draw on an empty figure, and return the footnote."""

    def draw(self) -> Figure:
        """Draw the picture, with its title and what it rests on."""
        figure = new_figure(10, self.height_in)
        write_title(figure, self.title, self.draw_on(figure))
        return figure


def led_rows(bits: Bools, values: Mapping[str, Floats]) -> Rows:
    """Lay values of LEDs out as lines, their head first.

    Args:
        bits: (B,R,C).
        values: (B,R,C) each, by name.

    Returns:
        A line an LED. Frames count from 0, rows and columns from 1 as in the paper's text.

    Example:
        >>> led_rows(np.array([[[True]]]), {"grey": np.array([[[150.0]]])})
        [('frame', 'led_row', 'led_column', 'bit', 'grey'), (0, 1, 1, 1, 150.0)]
    """
    lines = [
        (frame, row + 1, column + 1, int(bit), *(float(v[frame, row, column]) for v in values.values()))
        for (frame, row, column), bit in np.ndenumerate(bits)
    ]
    return [("frame", "led_row", "led_column", "bit", *values), *lines]


def pixel_rows(pictures: Mapping[str, Picture]) -> Rows:
    """Lay pictures out as lines, their head first; pixels count from 0 at each picture's top left.

    Example:
        >>> pixel_rows({"a": (np.array([[7.0]]), (0.0, 1.0, 1.0, 0.0))})
        [('picture', 'row_px', 'column_px', 'grey'), ('a', 0, 0, 7.0)]
    """
    lines = [(name, *at, float(v)) for name, (grey, _) in pictures.items() for at, v in np.ndenumerate(grey)]
    return [("picture", "row_px", "column_px", "grey"), *lines]


def conditions(scene: Scene) -> Floats:
    """Ambient light (lx), LED luminance (cd/m2), distance (m) and background grey, (B,4).

    Example:
        >>> conditions(Scene.of(distance_m=40.0)).tolist()
        [[8000.0, 3000.0, 40.0, 102.0]]
    """
    parts = (scene.ambient_lx, scene.led_luminance_cd_m2, scene.distance_m, scene.background_grey)
    return torch.stack(parts, dim=1).double().cpu().numpy()


def paper_scene(ambient_lx: float = 4000.0, led_luminance_cd_m2: float = 3500.0) -> Scene:
    """Scene of section IV-D-1, by default the middle one of its three.

    Distance and background grey, which the paper leaves open there, are in the middle of their ranges.

    Example:
        >>> scene = paper_scene()
        >>> float(scene.distance_m), float(scene.background_grey)
        (50.0, 102.0)
    """
    middle = {"distance_m": 50.0, "background_grey": 102.0}
    return Scene.of(1, ambient_lx=ambient_lx, led_luminance_cd_m2=led_luminance_cd_m2, **middle)


def cut_out(
    frames: Frames, corners_px: Tensor, shape: PanelShape, margin_cells: float = 1.0
) -> list[Picture]:
    """Cut upright panels and their margins out of frames, as whole pixels.

    Args:
        frames: B frames or crops.
        corners_px: (B,4,2) sensor coordinates of the grid of LED cells, clockwise from the top left.
        shape: rows and columns.
        margin_cells: how much to leave around the grid.

    Returns:
        Of each frame the pixels that overlap the margin, and their extent in LED cells.

    Example:
        >>> frame = Frames.whole(torch.zeros(1, 1, 20, 20))
        >>> corners = torch.tensor([[[4.0, 4.0], [12.0, 4.0], [12.0, 12.0], [4.0, 12.0]]])
        >>> [(grey, extent)] = cut_out(frame, corners, PanelShape(4, 4))
        >>> grey.shape, extent
        ((12, 12), (-1.0, 5.0, 5.0, -1.0))
    """
    pictures: list[Picture] = []
    corners = (corners_px - frames.origin_px[:, None]).double().cpu().numpy()
    for grey, first, last in zip(frames.grey[:, 0], corners[:, 0], corners[:, 2], strict=True):
        cell = (last - first) / (shape.columns, shape.rows)
        # A hair of tolerance, so that an edge that rounding moved does not add a line of pixels.
        low = np.floor(first - margin_cells * cell + 1e-6).astype(int).clip(min=0)
        high = np.minimum(np.ceil(last + margin_cells * cell - 1e-6).astype(int), grey.shape[::-1])
        left, top, right, bottom = ((np.stack([low, high]) - first) / cell).round(9).ravel().tolist()
        cut = grey[low[1] : high[1], low[0] : high[0]].double().cpu().numpy()
        pictures.append((cut, (left, right, bottom, top)))
    return pictures
