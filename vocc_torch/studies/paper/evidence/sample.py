"""The paper's 100 sample frames, their LEDs measured at the true corners, and panels cut out of frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from vocc_torch.measure.link import Link, Observation, block_keys
from vocc_torch.measure.plan import Plan
from vocc_torch.receiver.features import FEATURE_NAMES, preamble_threshold
from vocc_torch.receiver.rectification import cell_homography
from vocc_torch.studies.paper.evidence.figure import Bools, Floats, Picture
from vocc_torch.types import Frames, PanelShape, Scene

SAMPLE_FRAMES = 100
"""Section III-B: "100 sample LED panel frames simulated at various conditions"."""


@dataclass(frozen=True)
class Sample:
    """The sample frames and what the reader measures in them at the true corners.

    Args:
        conditions: (B,4) ambient light (lx), LED luminance (cd/m2), distance (m), background grey.
        scene: B scenes.
        bits: (B,R,C).
        greys: (B,R,C) average grey of each LED's cell.
        thresholds: (B,) halfway between the average greys of the all-On and the all-Off frame of the scene.
        features: (B,R,C,3) AGR, GRI, NGR.
        patches: (B,1,(R+2)K,(C+2)K) the rectified panels.
        pictures: B panels with one cell of margin.
    """

    conditions: Floats
    scene: Scene
    bits: Bools
    greys: Floats
    thresholds: Floats
    features: Floats
    patches: Tensor
    pictures: tuple[Picture, ...]

    def feature(self, name: str) -> Floats:
        """Give one feature, (B,R,C)."""
        return self.features[..., FEATURE_NAMES.index(name)]


def draw_sample(plan: Plan, frames: int = SAMPLE_FRAMES) -> Sample:
    """Simulate and measure the sample frames over the ranges of the plan's scenes.

    Args:
        plan: the study; its locator is not used.
        frames: at least 1.
    """
    link = Link(plan.world.simulator(), None, plan.receiver.reader, plan.batch_frames)
    keys = block_keys(plan.seed, "figures/sample", frames)
    seen = list(link.observe(plan.world.scene, keys, preambles=True, frames=frames))
    scene = Scene.cat([piece.scene for piece in seen]).to("cpu")

    def joined(part: Callable[[Observation], Tensor]) -> Tensor:
        return torch.cat([part(piece) for piece in seen]).cpu()

    def threshold(piece: Observation) -> Tensor:
        assert piece.preambles is not None
        return preamble_threshold(piece.preambles.on.average, piece.preambles.off.average)

    return Sample(
        conditions=conditions(scene),
        scene=scene,
        bits=joined(lambda piece: piece.bits).numpy(),
        greys=joined(lambda piece: piece.readings.greys.average).double().numpy(),
        thresholds=joined(threshold).double().flatten().numpy(),
        features=joined(lambda piece: piece.readings.features).numpy(),
        patches=joined(lambda piece: piece.readings.patches),
        pictures=tuple(
            cut_out(piece.frames[i : i + 1], piece.panels.corners_px[i], plan.world.panel.shape)
            for piece in seen
            for i in range(len(piece.frames))
        ),
    )


def conditions(scene: Scene) -> Floats:
    """Ambient light (lx), LED luminance (cd/m2), distance (m) and background grey, (B,4).

    Example:
        >>> conditions(Scene.of(distance_m=40.0)).tolist()
        [[8000.0, 3000.0, 40.0, 102.0]]
    """
    parts = (scene.ambient_lx, scene.led_luminance_cd_m2, scene.distance_m, scene.background_grey)
    return np.stack([part.double().cpu().numpy() for part in parts], axis=1)


def paper_scene(ambient_lx: float = 4000.0, led_luminance_cd_m2: float = 3500.0) -> Scene:
    """Make a scene of section IV-D-1, by default the middle one of its three.

    Distance and background grey, which the paper leaves open there, are in the middle of their ranges.

    Example:
        >>> scene = paper_scene()
        >>> float(scene.distance_m), float(scene.background_grey)
        (50.0, 102.0)
    """
    middle = {"distance_m": 50.0, "background_grey": 102.0}
    return Scene.of(1, ambient_lx=ambient_lx, led_luminance_cd_m2=led_luminance_cd_m2, **middle)


def cut_out(frame: Frames, corners_px: Tensor, shape: PanelShape, margin_cells: float = 1.0) -> Picture:
    """Cut an upright panel and its margin out of a single frame, as whole pixels.

    Args:
        frame: one frame or crop.
        corners_px: (4,2) sensor coordinates of the grid of LED cells, clockwise from the top left.
        shape: rows and columns.
        margin_cells: how much to leave around the grid.

    Returns:
        The pixels that overlap the margin, and their extent in LED cells.

    Example:
        >>> frame = Frames.whole(torch.zeros(1, 1, 20, 20))
        >>> corners = torch.tensor([[4.0, 4.0], [12.0, 4.0], [12.0, 12.0], [4.0, 12.0]])
        >>> grey, extent = cut_out(frame, corners, PanelShape(4, 4))
        >>> grey.shape, extent
        ((12, 12), (-1.0, 5.0, 5.0, -1.0))
    """
    to_cells = torch.linalg.inv(cell_homography(corners_px[None].cpu(), shape))[0]
    origin = frame.origin_px[0].cpu()
    corners = corners_px.double().cpu() - origin
    margin = margin_cells * (corners[2] - corners[0]) / torch.tensor([shape.columns, shape.rows])
    last = torch.tensor(frame.grey.shape[:-3:-1])
    # A hair of tolerance, so that an edge that rounding moved does not add a line of pixels.
    low = torch.floor(corners[0] - margin + 1e-6).long().clamp(min=0)
    high = torch.minimum(torch.ceil(corners[2] + margin - 1e-6).long(), last)
    ends = torch.stack([low, high]) + origin
    (left, right), (top, bottom) = (
        (ends * to_cells.diagonal()[:2] + to_cells[:2, 2]).T.round(decimals=9).tolist()
    )
    grey = frame.grey[0, 0, low[1] : high[1], low[0] : high[0]].double().cpu().numpy()
    return grey, (left, right, bottom, top)
