"""The whole link on blocks of frames: simulate, locate, read; one observation for every receiver."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from vocc_torch.measure.plan import Plan
from vocc_torch.receiver.bank import Preambles
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.receiver.reader import Reader, Readings
from vocc_torch.rng import BLOCK_FRAMES, BlockKey, FrameKey
from vocc_torch.simulation import SceneModel, Simulator
from vocc_torch.types import Frames, Panels, Scene

MOST_SAMPLES = 1 << 26
"""Most samples of rectified panels in a batch: 512 MiB where frames are float64."""


@dataclass(frozen=True)
class Observation:
    """One batch as a study sees it: the truth (scene, bits) and what the receiver made of it."""

    scene: Scene
    bits: Tensor
    frames: Frames
    panels: Panels
    readings: Readings
    preambles: Preambles | None


class Link:
    """Transmitter, channel and the receiver's front end.

    The observations do not depend on ``batch_frames``, on torch's threads and default dtype, on inference
    mode, or on an autocast around the link, which is switched off: its convolutions are of half precision.

    Args:
        simulator: renders frames.
        locator: finds the panel, or None to take the simulator's true corners.
        reader: measures the LEDs.
        batch_frames: frames at a time; fewer where their rectified panels would have over 2^26 samples.

    Example:
        >>> link = Link(Simulator(), None, Reader())
        >>> batches = link.observe(SceneModel(), [BlockKey(seed=0, point="doc", block=0)], preambles=False)
        >>> next(batches).readings.features.shape
        torch.Size([64, 8, 8, 3])
    """

    def __init__(
        self, simulator: Simulator, locator: PanelLocator | None, reader: Reader, batch_frames: int = 64
    ) -> None:
        self.simulator = simulator
        self.locator = locator
        self.reader = reader
        samples = (reader.shape.rows + 2) * (reader.shape.columns + 2) * reader.samples_per_led**2
        self.batch_frames = max(1, min(batch_frames, MOST_SAMPLES // samples))

    @classmethod
    def of(cls, plan: Plan) -> Link:
        """Build the link that a plan describes."""
        (locator,) = plan.receiver.finders([plan.receiver.locator]).values()
        return cls(plan.world.simulator(), locator, plan.receiver.reader, plan.batch_frames)

    def observe(
        self, model: SceneModel, keys: Sequence[BlockKey], *, preambles: bool, frames: int | None = None
    ) -> Iterator[Observation]:
        """Run blocks through the link, in order, in batches of at most ``batch_frames`` frames.

        Args:
            model: the scenes' distributions.
            keys: the blocks.
            preambles: whether to render the all-On and all-Off frames of each scene too.
            frames: how many frames of the blocks to use, from the first on; all by default.
        """
        locators = {"": self.locator}
        for seen in self.observe_each(locators, model, keys, preambles=preambles, frames=frames):
            yield seen[""]

    def observe_each(
        self,
        locators: Mapping[str, PanelLocator | None],
        model: SceneModel,
        keys: Sequence[BlockKey],
        *,
        preambles: bool,
        frames: int | None = None,
    ) -> Iterator[dict[str, Observation]]:
        """Run blocks through the link, rendered once and read with each of several locators.

        Args:
            locators: by name; None takes the simulator's true corners.
            model: the scenes' distributions.
            keys: the blocks.
            preambles: whether to render the all-On and all-Off frames of each scene too.
            frames: how many frames of the blocks to use, from the first on; all by default.
        """
        drawn = [model.draw(key, self.simulator.panel.shape) for key in keys]
        scene, bits = Scene.cat([s for s, _ in drawn]), torch.cat([b for _, b in drawn])
        names = [FrameKey(key, frame) for key in keys for frame in range(BLOCK_FRAMES)]
        total = min(len(scene), len(scene) if frames is None else frames)
        for start in range(0, total, self.batch_frames):
            rows = slice(start, min(start + self.batch_frames, total))
            batch = scene[rows].to(self.simulator.device), bits[rows].to(self.simulator.device)
            with torch.autocast(self.simulator.device.type, enabled=False):
                seen = self._observe(locators, *batch, names[rows], model.nearest_m, preambles)
            yield seen

    def _render(
        self, scene: Scene, bits: Tensor, keys: Sequence[FrameKey], nearest_m: float, panel_only: bool
    ) -> Frames:
        """Render one take of a batch."""
        return self.simulator.render(scene, bits, nearest_m=nearest_m, keys=keys, panel_only=panel_only)

    def _observe(
        self,
        locators: Mapping[str, PanelLocator | None],
        scene: Scene,
        bits: Tensor,
        keys: Sequence[FrameKey],
        nearest_m: float,
        preambles: bool,
    ) -> dict[str, Observation]:
        """Run one batch."""
        # Nobody who knows the corners looks anywhere else.
        panel_only = all(locator is None for locator in locators.values())
        frames = self._render(scene, bits, keys, nearest_m, panel_only)
        takes = [frames]
        if preambles:
            for take, sent in (("on", torch.ones_like(bits)), ("off", torch.zeros_like(bits))):
                own = [replace(key, take=take) for key in keys]
                takes.append(self._render(scene, sent, own, nearest_m, panel_only))
        seen = {}
        for name, locator in locators.items():
            panels = (
                self.simulator.true_panels(scene, keys, rendered=True)
                if locator is None
                else locator(frames, self.reader.shape)
            )
            # Preambles are read where the panel was located in the frame itself.
            readings, levels = self.reader.read_takes(takes, panels)
            known = Preambles(*levels) if preambles else None
            seen[name] = Observation(scene, bits, frames, panels, readings, known)
        return seen


def block_keys(seed: int, point: str, frames: int) -> list[BlockKey]:
    """Name the blocks that hold ``frames`` frames; the last may be used in part.

    Example:
        >>> len(block_keys(0, "train", 1000))
        16
    """
    return [BlockKey(seed, point, block) for block in range(-(-frames // BLOCK_FRAMES))]
