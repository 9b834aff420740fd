"""The genie: joint maximum likelihood over all bits, by a decoder that knows the scene as no receiver can."""

from __future__ import annotations

import copy
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import chain
from statistics import median

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.frame_errors import FrameErrors, FrameJob
from vocc_torch.measure.genie.forward import ForwardModel, overlap
from vocc_torch.measure.genie.likelihood import PixelModel
from vocc_torch.measure.genie.search import descend, likely_bits, relaxed_shares
from vocc_torch.measure.link import Observation
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.timing import threads
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.simulation import SceneModel, Simulator
from vocc_torch.types import Frames, Scene

WIDTHS = (64, 4096)
"""How many partial decisions the M-algorithm keeps; the second where the first gave no proven bits."""

STARTS = 8
"""How many results of the M-algorithm are improved by flips, the likeliest first, until one is proven."""

NOISE_WIDTH = 256
"""How many partial decisions the M-algorithm keeps under noise, where nothing can be proven."""

FRAMES_AT_ONCE = 16
"""Frames of one call: one frame's search may take a thousand times as long as another's."""


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
    """Decide all bits of a frame at once, knowing scene, camera, panel and effects, but no random draw.

    Without noise it searches for bits whose rendered frame is the one seen. It first rounds the solution of a
    convex relaxation and flips single LEDs; where that does not do, it starts from the M-algorithm's results.
    The simulator renders what was found, and the frames are compared. Under noise the likelihood is that of a
    normal deviation with the variance that the effects state, integrated over each grey value's interval. The
    search is the same, and is not exhaustive.

    Bits that give the very same frame are equally likely. The genie draws no random number: it answers On for
    every LED that no pixel tells On from Off, as under white and without contrast, and otherwise takes the
    first bits that its search finds. Each frame is decided by itself, so no batch changes an answer.

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
        # The frames may be of any framing; what the genie renders itself is the panel's surroundings.
        self._simulator = copy.copy(simulator)
        self._simulator.framing = "crop"

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
        device, shape = self._simulator.device, self._simulator.panel.shape
        scene = scene.checked().to(device)
        bits = torch.zeros(len(frames), shape.rows, shape.columns, dtype=torch.bool)
        scores = torch.zeros(bits.shape, dtype=torch.float64)
        proven = torch.zeros(len(frames), dtype=torch.bool)
        for i in range(len(frames)):
            found, costs, proven[i] = self._decide_one(frames[i : i + 1], scene[i : i + 1])
            bits[i] = found.view_as(bits[i])
            scores[i] = torch.where(found, costs, -costs).view_as(scores[i])
        return GenieDecision(*(part.to(device) for part in (bits, scores, proven)))

    def _decide_one(self, frame: Frames, scene: Scene) -> tuple[Tensor, Tensor, bool]:
        """Decide one frame: bits (N,), what each flip would cost (N,), and whether they are proven."""
        model = self._forward.pixels(frame, scene)
        found: list[tuple[float, Tensor, Tensor]] = []
        for start in self._starts(model):
            bits, costs = descend(model, start)
            if model.noise is None and self._gives(frame, scene, bits):
                return bits, costs, True
            found.append((float(model.misfit(model.exposure(bits)).sum()), bits, costs))
        _, bits, costs = min(found, key=lambda one: one[0])
        return bits, costs, False

    def _starts(self, model: PixelModel) -> Iterator[Tensor]:
        """Give bits to begin from, each with more work behind it than the one before."""
        shares = relaxed_shares(model)
        yield shares > 0.5
        if model.noise is not None:
            yield likely_bits(model, shares, NOISE_WIDTH)[0]
            return
        for width in WIDTHS:
            yield from likely_bits(model, shares, width)[:STARTS]

    def _gives(self, frame: Frames, scene: Scene, bits: Tensor) -> bool:
        """Say whether the rendered bits are the very frame, around the panel."""
        shape = self._simulator.panel.shape
        again = self._simulator.render(scene, bits.view(1, shape.rows, shape.columns), panel_only=True)
        mine, theirs = overlap(again, frame)
        return torch.equal(again.grey[0, 0][mine], frame.grey[0, 0][theirs].to(again.grey.device))


@dataclass(frozen=True)
class GenieReference:
    """What is possible on some frames.

    Args:
        counts: the genie's errors; it misses no panel.
        proven: frames of which no bits are likelier than the genie's.
        seconds_a_frame: median time of one frame's decision, of one thread's CPU, s.
    """

    counts: Counts
    proven: int
    seconds_a_frame: float


def genie_reference(
    plan: Plan, model: SceneModel, point: str, frames: int, workers: Workers
) -> GenieReference:
    """Let the genie decide a point's first frames, the same that every receiver decides there.

    Args:
        plan: world, seed and batch size.
        model: the point's scenes.
        point: the point's name, which keys its random draws.
        frames: how many frames, at least 1.
        workers: who does it; they change no count.

    Raises:
        UnknownLikelihoodError: effects whose likelihood the genie does not know, or pixels that are full
            before they are white.
        VoccError: too few frames, or a worker that was ended from outside.
    """
    if frames < 1:
        raise VoccError(f"frames is {frames}: it must be at least 1")
    parts = [range(first, min(first + FRAMES_AT_ONCE, frames)) for first in range(0, frames, FRAMES_AT_ONCE)]
    with worker_losses_told():
        calls = [workers.submit(partial(_decide_part, plan, model, point), part) for part in parts]
        errors, proven, seconds = zip(*(call.result() for call in calls), strict=True)
    (counts,) = FrameErrors.joined(errors).counts
    return GenieReference(counts, sum(proven), median(chain.from_iterable(seconds)))


def _decide_part(
    plan: Plan, model: SceneModel, point: str, frames: range
) -> tuple[FrameErrors, int, list[float]]:
    """Decide some of a point's frames: errors, how many are proven, and the seconds of each."""
    genie = Genie(plan.world.simulator())
    proven: list[bool] = []
    seconds: list[float] = []

    def decide(views: Mapping[str, Observation], /) -> Iterator[tuple[Tensor, Tensor]]:
        (seen,) = views.values()
        decided = torch.empty_like(seen.bits)
        # One thread, whose clock then knows of all the work, and whose sums have one order.
        with threads(1), torch.autocast(decided.device.type, enabled=False):
            for i in range(len(decided)):
                begun = time.thread_time()
                decision = genie.decide(seen.frames[i : i + 1], seen.scene[i : i + 1])
                seconds.append(time.thread_time() - begun)
                proven.append(bool(decision.proven))
                decided[i] = decision.bits[0]
        yield decided, seen.panels.found

    return FrameJob(plan, model, point, ("truth",), decide)(frames), sum(proven), seconds
