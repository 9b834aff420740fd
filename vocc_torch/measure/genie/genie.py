"""The genie that knows the scene: joint maximum likelihood over all bits. A mark, not a receiver."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.measure.genie.genie_light import ForwardModel, overlap, settings
from vocc_torch.measure.genie.genie_likelihood import PixelModel
from vocc_torch.measure.genie.genie_search import descend, likely_bits, relaxed_shares
from vocc_torch.simulation import Simulator
from vocc_torch.types import Frames, Scene

WIDTHS = (64, 4096)
"""Beginnings that the search in breadth keeps, and keeps where those did not do."""

STARTS = 8
"""Results of a search in breadth from which flips begin, until one is proven."""

NOISE_WIDTH = 256
"""Beginnings kept under noise, where nothing proves that a search did."""


@dataclass(frozen=True, slots=True)
class GenieDecision:
    """What the genie says of B frames.

    Args:
        bits: (B,R,C) bool, True = On.
        scores: (B,R,C) float64, misfit with the LED Off less misfit with it On, all others as decided. At
            least 0 for On and below 0 for Off; 0 where no pixel tells the two apart. Under noise it is the
            logarithm of how many times likelier On is.
        proven: (B,) bool, the bits give the very frame that was seen, so none are likelier. Always False
            under noise.
    """

    bits: Tensor
    scores: Tensor
    proven: Tensor


class Genie:
    """Decide all bits of a frame at once, knowing scene, camera, panel and effects, and no random key.

    Without noise the bits are searched whose rendered frame is the one seen: rounded shares of a convex
    relaxation and flips of single LEDs, and where those do not do, a search in breadth and flips. What is
    found is rendered by the simulator itself and compared. Under noise the likelihood is that of a normal
    deviation with the variance that the effects state, cut into the intervals of the grey values. The search
    is the same, and is not exhaustive.

    Where several bits give the very same frame they are equally likely. The genie tosses no coin: it
    answers On for every LED that no pixel tells On from Off, as under white and without contrast, and
    otherwise the first bits that its search meets. Each frame is decided by itself, so no batch changes an
    answer.

    Args:
        simulator: renders the frames.

    Raises:
        UnknownLikelihoodError: effects whose likelihood the genie does not know.

    Example:
        >>> simulator, scene = Simulator(), Scene.of(frames=2, distance_m=70.0)
        >>> bits = torch.arange(128).view(2, 8, 8) % 3 == 0
        >>> decision = Genie(simulator).decide(simulator.render(scene, bits), scene)
        >>> torch.equal(decision.bits, bits), decision.proven.tolist()
        (True, [True, True])
    """

    def __init__(self, simulator: Simulator) -> None:
        self._forward = ForwardModel(simulator)
        self._device = simulator.device
        # The frames may be of any framing: what the genie renders itself is the panel's surroundings.
        self._simulator = Simulator(
            simulator.camera,
            simulator.panel,
            settings(simulator.effects),
            device=simulator.device,
            dtype=simulator.dtype,
        )

    def decide(self, frames: Frames, scene: Scene) -> GenieDecision:
        """Decide the bits of each frame.

        Args:
            frames: B whole frames, crops or windows that show the panels.
            scene: their B scenes.

        Returns:
            The decision, on the simulator's device.

        Raises:
            VoccError: another number of scenes than of frames.
            UnknownLikelihoodError: pixels that are full before they are white.
        """
        if len(scene) != len(frames):
            raise VoccError(f"scene has {len(scene)} frames: it must have {len(frames)}, as frames has")
        scene, shape = scene.checked().to(self._device), self._simulator.panel.shape
        bits = torch.zeros(len(frames), shape.rows, shape.columns, dtype=torch.bool)
        scores = torch.zeros(bits.shape, dtype=torch.float64)
        proven = torch.zeros(len(frames), dtype=torch.bool)
        for i in range(len(frames)):
            frame, own = frames[i : i + 1], scene[i : i + 1]
            found, costs, sure = self._decide_one(frame, own)
            bits[i] = found.view_as(bits[i])
            scores[i] = torch.where(found, costs, -costs).view_as(scores[i])
            proven[i] = sure
        return GenieDecision(*(part.to(self._device) for part in (bits, scores, proven)))

    def _decide_one(self, frame: Frames, scene: Scene) -> tuple[Tensor, Tensor, bool]:
        """Decide one frame: bits (N,), what each flip would cost (N,), and whether they are proven."""
        model = self._forward.pixels(frame, scene)
        found: list[tuple[float, Tensor, Tensor]] = []
        for start in self._starts(model):
            bits, costs = descend(model, start)
            misfit = float(model.misfit(model.exposure(bits)).sum())
            if model.noise is None and self._gives(frame, scene, bits):
                return bits, costs, True
            found.append((misfit, bits, costs))
        _, bits, costs = min(found, key=lambda one: one[0])
        return bits, costs, False

    def _starts(self, model: PixelModel) -> Iterator[Tensor]:
        """Give bits to begin from, each the fruit of more work than the one before."""
        shares = relaxed_shares(model)
        yield shares > 0.5
        if model.noise is not None:
            yield likely_bits(model, shares, NOISE_WIDTH)[0]
            return
        for width in WIDTHS:
            yield from likely_bits(model, shares, width)[:STARTS]

    def _gives(self, frame: Frames, scene: Scene, bits: Tensor) -> bool:
        """Say whether bits give the very frame, around the panel."""
        shape = self._simulator.panel.shape
        again = self._simulator.render(scene, bits.view(1, shape.rows, shape.columns), panel_only=True)
        mine, theirs = overlap(again, frame)
        return torch.equal(again.grey[0, 0][mine], frame.grey[0, 0][theirs].to(self._device))
