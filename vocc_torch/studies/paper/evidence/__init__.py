"""The paper's figures other than bit error rates: what they are computed from, and what a figure holds."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.grid import Bools, Floats
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.plan import Plan
from vocc_torch.receiver.features import FEATURE_NAMES, preamble_threshold
from vocc_torch.report import plots
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Simulator
from vocc_torch.types import Frames, PanelShape, Scene

SAMPLE_FRAMES = 100
"""Section III-B: "100 sample LED panel frames simulated at various conditions"."""

Rows = list[tuple[str | int | float, ...]]
"""Lines of a CSV file, its head first."""
Draw = Callable[[plots.Axes], None]
"""Draws on empty axes."""


@dataclass(frozen=True)
class PaperFigure:
    """One figure of the paper.

    Args:
        rows: the lines of its CSV file.
        numbers: what the figure shows, by name; a measured number has an interval.
        panels: what is drawn, by the heading.
        columns: most panels in a row.
    """

    rows: Rows
    numbers: Mapping[str, float | Estimate]
    panels: Mapping[str, Draw]
    columns: int = 3

    def drawn(self, title: str, footnote: str = "") -> plots.Figure:
        """Draw the panels beside each other."""
        layout = plots.rows_of(range(len(self.panels)), self.columns)
        figure, axes = plots.sheet(layout, plots.panel_size(layout), title, footnote)
        for at, (heading, draw) in enumerate(self.panels.items()):
            draw(axes[at])
            axes[at].set_title(heading, loc="left", fontsize=10)
        return figure

    def estimates(self, name: str) -> dict[str, Estimate]:
        """The numbers under the figure's name; one without an interval is exact."""
        return {
            f"{name}.{key}": found
            if isinstance(found, Estimate)
            else Estimate(found, found, found)
            for key, found in self.numbers.items()
        }


@dataclass(frozen=True)
class Sample:
    """The sample frames and what the reader measures in them at the true corners.

    Args:
        scene: B scenes.
        bits: (B,R,C).
        greys: (B,R,C) average grey of each LED's cell.
        thresholds: (B,) halfway between the average greys of the all-On and the all-Off frame of the scene.
        features: AGR, GRI and NGR by name, (B,R,C) each.
        panels: (B,(R+2)K,(C+2)K) the rectified panels.
    """

    scene: Scene
    bits: Bools
    greys: Floats
    thresholds: Floats
    features: Mapping[str, Floats]
    panels: Floats

    @property
    def distance_m(self) -> Floats:
        """Distance of each frame's panel, (B,)."""
        return self.scene.distance_m.double().numpy()


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
        """The sample frames over the ranges of the plan's scenes.

        Raises:
            VoccError: all of their LEDs are On, or all are Off.
        """
        plan = self.plan
        link = Link(
            plan.world.simulator(), None, plan.receiver.reader, plan.batch_frames
        )
        keys = block_keys(plan.seed, "figures/sample", self.sample_frames)
        observed = list(
            link.observe(
                plan.world.scene, keys, preambles=True, frames=self.sample_frames
            )
        )
        preambles = [part.preambles for part in observed if part.preambles is not None]
        thresholds = [
            preamble_threshold(known.on.average, known.off.average)
            for known in preambles
        ]
        features = array([part.readings.features for part in observed])
        bits = torch.cat([part.bits for part in observed]).cpu().numpy()
        if bits.all() or not bits.any():
            raise VoccError(
                "the sample frames have no Off LED, or no On LED: the figures compare them"
            )
        return Sample(
            scene=Scene.cat([part.scene for part in observed]).to("cpu"),
            bits=bits,
            greys=array([part.readings.greys.average for part in observed]),
            thresholds=array(thresholds).ravel(),
            features={name: features[..., at] for at, name in enumerate(FEATURE_NAMES)},
            panels=array([part.readings.patches for part in observed])[:, 0],
        )

    def bits(self, name: str) -> Tensor:
        """The bits that a figure shows in all its scenes, (1,R,C) bool, by the figure's name."""
        world = self.plan.world
        return world.scene.draw(
            BlockKey(self.plan.seed, f"figures/{name}", 0), world.panel.shape
        )[1][:1]

    def without_blooming(self) -> Simulator:
        """The plan's simulator without the blooming effect.

        Raises:
            VoccError: the scenes have none.
        """
        effects = dict(self.plan.world.effects)
        if effects.pop("blooming", None) is None:
            raise VoccError(
                "scene.effects has no blooming: this figure shows what it does"
            )
        return replace(self.plan.world, effects=effects).simulator()

    def average_greys(self, simulator: Simulator, scene: Scene, bits: Tensor) -> Floats:
        """Average grey of each LED's cell at the true corners, (B,R,C)."""
        frames, panels = simulator.render(scene, bits), simulator.true_panels(scene)
        return array([self.plan.receiver.reader.read_greys(frames, panels).average])


def array(parts: list[Tensor]) -> Floats:
    """Join tensors along the batch."""
    joined: Floats = torch.cat(parts).detach().cpu().double().numpy()
    return joined


def paper_scene(
    ambient_lx: float = 4000.0, led_luminance_cd_m2: float = 3500.0, grey: float = 102.0
) -> Scene:
    """Scene of section IV-D-1, by default the middle one of its three.

    Distance and background grey, which the paper leaves open there, are in the middle of their ranges.

    Example:
        >>> float(paper_scene().distance_m)
        50.0
    """
    light = {"ambient_lx": ambient_lx, "led_luminance_cd_m2": led_luminance_cd_m2}
    return Scene.of(1, **light, distance_m=50.0, background_grey=grey)


def cut_out(frames: Frames, corners_px: Tensor, shape: PanelShape) -> Floats:
    """Cut the first frame's upright panel out, with a margin of one LED cell, as (h,w) pixels.

    Args:
        frames: frames or crops.
        corners_px: (B,4,2) sensor coordinates of the grid of LED cells, clockwise from the top left.
        shape: rows and columns.

    Example:
        >>> frame = Frames.whole(torch.zeros(1, 1, 20, 20))
        >>> corners = torch.tensor([[[4.0, 4.0], [12.0, 4.0], [12.0, 12.0], [4.0, 12.0]]])
        >>> cut_out(frame, corners, PanelShape(4, 4)).shape
        (12, 12)
    """
    first, last = (corners_px[0, [0, 2]] - frames.origin_px[0]).double().cpu().numpy()
    cell = (last - first) / (shape.columns, shape.rows)
    # A hair of tolerance, so that an edge that rounding moved does not add a line of pixels.
    left, top = np.floor(first - cell + 1e-6).astype(int).clip(min=0)
    right, bottom = np.ceil(last + cell - 1e-6).astype(int)
    return array([frames.grey[0, 0, top:bottom, left:right]])


def led_rows(bits: Bools, values: Mapping[str, Floats]) -> Rows:
    """Lay values of LEDs out as lines, their head first.

    Frames count from 0, rows and columns from 1 as in the paper's text.

    Args:
        bits: (B,R,C).
        values: (B,R,C) each, by name.

    Example:
        >>> led_rows(np.array([[[True]]]), {"grey": np.array([[[150.0]]])})
        [('frame', 'led_row', 'led_column', 'bit', 'grey'), (0, 1, 1, 1, 150.0)]
    """
    lines: Rows = [("frame", "led_row", "led_column", "bit", *values)]
    for at, bit in np.ndenumerate(bits):
        frame, row, column = at
        numbers = (float(value[at]) for value in values.values())
        lines.append((frame, row + 1, column + 1, int(bit), *numbers))
    return lines


def pixel_rows(pictures: Mapping[str, Floats]) -> Rows:
    """Lay pictures out as lines, their head first; pixels count from 0 at each picture's top left.

    Example:
        >>> pixel_rows({"a": np.array([[7.0]])})
        [('picture', 'row_px', 'column_px', 'grey'), ('a', 0, 0, 7.0)]
    """
    lines: Rows = [("picture", "row_px", "column_px", "grey")]
    for name, picture in pictures.items():
        lines += [(name, *at, float(grey)) for at, grey in np.ndenumerate(picture)]
    return lines
