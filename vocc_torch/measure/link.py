"""The whole link on blocks of frames: simulate, locate, read; one observation for every receiver."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import Self

import torch

from vocc_torch.hardware import PanelShape
from vocc_torch.measure.plan import Plan
from vocc_torch.receiver.deciders import Preambles
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.receiver.reader import GREYS, Reader, Readings
from vocc_torch.rng import BLOCK_FRAMES, BlockKey, FrameKey
from vocc_torch.simulation import SceneModel, Simulator
from vocc_torch.types import Frames, Panels, Scene, without_autocast


@dataclass(frozen=True)
class LinkLimits:
    """Limits of a batch, and of a corner."""

    most_samples: int = 1 << 26  # of rectified panels: 512 MiB in float64
    # Of a corner from its place: up to there features belong to the right LED.
    most_off_cells: float = 0.25


LIMITS = LinkLimits()


@dataclass(frozen=True, eq=False)
class Observation:
    """One batch of B frames in a study: the ground truth, the frames, and where a locator found the panel.

    Readings are computed on first use, so a receiver with its own measurement causes no other.

    Args:
        scene: the scenes.
        bits: (B,R,C) bool, what was sent.
        places: where the panel was located, for each of the takes.
        takes: the frames; with preambles also the all-On and the all-Off frames of the same scenes.
        reader: measures the LEDs.
        truth: gives the true panels; receivers must not call it.
    """

    scene: Scene
    bits: torch.Tensor
    places: Sequence[Panels]
    takes: tuple[Frames, ...]
    reader: Reader
    truth: Callable[[], Panels]

    @property
    def frames(self) -> Frames:
        """The frames."""
        return self.takes[0]

    @property
    def panels(self) -> Panels:
        """Where the panel was located in the frames."""
        return self.places[0]

    @cached_property
    def misplaced(self) -> torch.Tensor:
        """Whether a panel in the frame was missed, or located off its place, (B,) bool."""
        return misplaced(self.panels, self.truth(), self.reader.shape)

    @cached_property
    def readings(self) -> Readings:
        """What the reader measures of every LED."""
        return self.reader.read(self.frames, self.panels)

    @cached_property
    def preambles(self) -> Preambles | None:
        """Grey levels of the preambles, if they were rendered."""
        pairs = zip(self.takes[1:], self.places[1:], strict=True)
        lit = [self.reader.read(*pair, GREYS).greys for pair in pairs]
        return Preambles(*lit) if lit else None


class Link:
    """Transmitter, channel and the receiver's front end.

    The observations do not depend on ``batch_frames``, on torch's threads and default dtype, on inference
    mode, or on an autocast around the link, which is switched off: its convolutions are of half precision.

    Args:
        simulator: renders frames.
        locator: finds the panel, or None to take the simulator's true corners.
        reader: measures the LEDs.
        batch_frames: frames at a time; fewer where their rectified panels would have over 2^26 samples.
        locates_preambles: whether the panel is located in each preamble, else in the test frame alone. A
            preamble without a located panel is read at the corners of the test frame.

    Example:
        >>> link = Link(Simulator(), None, Reader())
        >>> batches = link.observe(SceneModel(), [BlockKey(seed=0, point="doc", block=0)], preambles=False)
        >>> next(batches).readings.features.shape
        torch.Size([64, 8, 8, 3])
    """

    def __init__(
        self,
        simulator: Simulator,
        locator: PanelLocator | None,
        reader: Reader,
        batch_frames: int = 64,
        *,
        locates_preambles: bool = False,
    ) -> None:
        self.simulator, self.locator, self.reader = simulator, locator, reader
        self.locates_preambles = locates_preambles
        samples = math.prod(
            (n + 2) * reader.samples_per_led for n in reader.shape.sides
        )
        self.batch_frames = max(1, min(batch_frames, LIMITS.most_samples // samples))

    @classmethod
    def of(cls, plan: Plan) -> Self:
        """Build the link that a plan describes."""
        receiver = plan.receiver
        return cls(
            plan.world.simulator(),
            receiver.finder,
            receiver.reader,
            plan.batch_frames,
            locates_preambles=receiver.preambles == "located",
        )

    def observe(
        self,
        model: SceneModel,
        keys: Sequence[BlockKey],
        *,
        preambles: bool,
        frames: int | None = None,
    ) -> Iterator[Observation]:
        """Run blocks through the link, in order, in batches of at most ``batch_frames`` frames.

        Args:
            model: the scenes' distributions.
            keys: the blocks.
            preambles: whether to render the all-On and all-Off frames of each scene too.
            frames: how many frames of the blocks to use, from the first on; all by default.
        """
        every = self.observe_each(
            {"": self.locator}, model, keys, preambles=preambles, frames=frames
        )
        return (observation[""] for observation in every)

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
        drawn, simulator = len(keys) * BLOCK_FRAMES, self.simulator
        total = drawn if frames is None else min(frames, drawn)
        every = range(0, total, self.batch_frames)
        # Nobody who knows the corners looks anywhere else.
        panel_only = all(locator is None for locator in locators.values())
        for scene, bits, names, takes in rendered(
            simulator, model, keys, every, preambles, panel_only
        ):
            truth = cache(partial(simulator.true_panels, scene, names, rendered=True))
            observations = {}
            for name, locator in locators.items():
                with without_autocast(simulator.device):
                    places = self._located(locator, takes, truth)
                observations[name] = Observation(
                    scene, bits, places, takes, self.reader, truth
                )
            yield observations

    def _located(
        self,
        locator: PanelLocator | None,
        takes: tuple[Frames, ...],
        truth: Callable[[], Panels],
    ) -> list[Panels]:
        """Locate the panel in the test frames, and in each preamble where that is wanted."""
        if locator is None:
            return [truth()] * len(takes)
        places = [first := locator(takes[0], self.reader.shape)]
        for take in takes[1:]:
            if self.locates_preambles:
                panels = locator(take, self.reader.shape)
                is_found = panels.found[:, None, None]
                corners_px = torch.where(is_found, panels.corners_px, first.corners_px)
                places.append(Panels.known(corners_px))
            else:
                places.append(first)
        return places


def misplaced(
    panels: Panels,
    truth: Panels,
    shape: PanelShape,
    most_cells: float = LIMITS.most_off_cells,
) -> torch.Tensor:
    """Say in which frames the panel was missed, or a corner lies too far off.

    Args:
        panels: as located.
        truth: the true panels; a frame that has none has no misplaced one.
        shape: the panel's.
        most_cells: that a corner may be off.

    Returns:
        (B,) bool.

    Example:
        >>> square = torch.tensor([[[0.0, 0.0], [80.0, 0.0], [80.0, 80.0], [0.0, 80.0]]])
        >>> moved, truth = Panels.known(square + torch.tensor([2.0, 0.0])), Panels.known(square)
        >>> [misplaced(moved, truth, PanelShape(side, 8)).item() for side in (8, 20)]
        [False, True]
    """
    if panels is truth:
        return torch.zeros_like(truth.found)
    sides = (truth.corners_px - truth.corners_px.roll(-1, dims=1)).norm(dim=-1)
    widths, heights = sides.view(-1, 2, 2).amin(1).unbind(1)
    cell = torch.minimum(widths / shape.columns, heights / shape.rows)
    off = (panels.corners_px - truth.corners_px).norm(dim=-1).amax(1)
    near: torch.Tensor = panels.found & (off <= most_cells * cell)
    return truth.found & ~near


Batch = tuple[Scene, torch.Tensor, list[FrameKey], tuple[Frames, ...]]
"""Scenes, the bits (B,R,C) bool sent in them, the names of their frames, and these."""


def rendered(
    simulator: Simulator,
    model: SceneModel,
    keys: Sequence[BlockKey],
    frames: range,
    preambles: bool,
    panel_only: bool = False,
) -> Iterator[Batch]:
    """Draw the scenes of blocks and render them.

    Args:
        simulator: renders them.
        model: the scenes' distributions.
        keys: the blocks.
        frames: which of their frames; its step is the size of a batch.
        preambles: whether the all-On and the all-Off frame of each scene follow it.
        panel_only: whether the panel's corners are known to all that look.
    """
    drawn = (model.draw(key, simulator.panel.shape) for key in keys)
    of_blocks, bits_of_blocks = zip(*drawn, strict=True)
    scenes, sent = Scene.cat(of_blocks), torch.cat(bits_of_blocks)
    device = simulator.device
    names = [FrameKey(key, frame) for key in keys for frame in range(BLOCK_FRAMES)]
    # Small crops are rendered together, which costs less; whole frames take by take, for their memory.
    far = any(
        effect.unbounded or (effect.fills_sensor and not panel_only)
        for effect in simulator.effects
    )
    together = simulator.framing == "crop" and not far
    for start in frames:
        rows = slice(start, min(start + frames.step, frames.stop))
        scene, bits = scenes[rows], sent[rows]
        shown, takes = {"frame": bits}, list[Frames]()
        if preambles:
            shown |= {"on": torch.ones_like(bits), "off": torch.zeros_like(bits)}
        for some in [list(shown)] if together else [[take] for take in shown]:
            with without_autocast(device):
                pictures = simulator.render(
                    Scene.cat([scene] * len(some)),
                    torch.cat([shown[take] for take in some]),
                    nearest_m=model.nearest_m,
                    keys=[
                        replace(key, take=take) for take in some for key in names[rows]
                    ],
                    panel_only=panel_only,
                )
            size = len(scene)
            takes += [pictures[at : at + size] for at in range(0, len(pictures), size)]
        yield scene, bits.to(device, non_blocking=True), names[rows], tuple(takes)


def block_keys(seed: int, point: str, frames: int, first: int = 0) -> list[BlockKey]:
    """Name the blocks that hold ``frames`` frames from the one of frame ``first`` on; the last may be cut.

    Example:
        >>> len(block_keys(0, "train", 1000))
        16
    """
    blocks = range(first // BLOCK_FRAMES, -(-frames // BLOCK_FRAMES))
    return [BlockKey(seed, point, block) for block in blocks]
