"""Frames that the figures are computed from: a sample over all scenes, and single scenes."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from vocc_torch.arrays import Bools, Floats
from vocc_torch.errors import VoccError
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.plan import Plan
from vocc_torch.receiver.features import FEATURE_NAMES, preamble_threshold
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.reader import Readings
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Simulator
from vocc_torch.types import Scene

SAMPLE_FRAMES = 100
"""Section III-B: "100 sample LED panel frames simulated at various conditions"."""


class Sample(NamedTuple):
    """The sample frames and what the reader measures in them at the true corners.

    Args:
        bits: (B,R,C).
        thresholds: (B,1,1) halfway between the average greys of the all-On and the all-Off frame of the scene.
        features: (B,R,C,3) AGR, GRI and NGR of each LED.
        values: ``average_grey``, ``agr``, ``gri`` and ``ngr`` of each LED, (B,R,C) each.
        panels: (B,(R+2)K,(C+2)K) the rectified panels.
    """

    bits: Bools
    thresholds: Floats
    features: Floats
    values: Mapping[str, Floats]
    panels: Floats


@dataclass(frozen=True)
class Source:
    """What figures are computed from: a plan, and the sample, which is simulated when first asked for.

    Args:
        plan: the study; corners are the true ones.
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
        plan, count = self.plan, self.sample_frames
        link = Link.of(plan.locating_with("truth"))
        keys = block_keys(plan.seed, "figures/sample", count)
        parts = list(link.observe(plan.world.scene, keys, preambles=True, frames=count))
        bits = array([part.bits for part in parts]) > 0
        if bits.all() or not bits.any():
            raise VoccError(
                "the sample frames have no Off LED, or no On LED: the figures compare them"
            )
        features = array([part.readings.features for part in parts])
        values = {name: features[..., at] for at, name in enumerate(FEATURE_NAMES)}
        values["average_grey"] = array([part.readings.greys.average for part in parts])
        known = [part.preambles for part in parts if part.preambles is not None]
        return Sample(
            bits,
            array([preamble_threshold(at.on.average, at.off.average) for at in known]),
            features,
            values,
            array([part.readings.patches for part in parts])[:, 0],
        )

    @cached_property
    def flda(self) -> FLDA:
        """FLDA trained on the sample."""
        samples = map(torch.from_numpy, (self.sample.features, self.sample.bits))
        return FLDA(len(FEATURE_NAMES)).fit(*samples)

    def bits(self, name: str) -> Tensor:
        """The bits that a figure shows in all its scenes, (1,R,C) bool, by the figure's name."""
        key = BlockKey(self.plan.seed, f"figures/{name}", 0)
        return self.plan.world.scene.draw(key, self.plan.world.panel.shape)[1][:1]

    def without_blooming(self) -> Simulator:
        """The plan's simulator without the blooming effect: the same where the scenes have none."""
        effects = dict(self.plan.world.effects)
        effects.pop("blooming", None)
        return replace(self.plan.world, effects=effects).simulator()

    def read(self, simulator: Simulator, scene: Scene, bits: Tensor) -> Readings:
        """Render scenes and measure every LED at the true corners."""
        frames, panels = simulator.render(scene, bits), simulator.true_panels(scene)
        return self.plan.receiver.reader.read(frames, panels)


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
