"""The genie: joint maximum likelihood over all bits, by a decoder that knows the scene as no receiver can.

The search for the likeliest bits: a convex relaxation, the M-algorithm, and flips of single LEDs.
"""

import copy
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.measure import link, runner, timing
from vocc_torch.measure.config import Budget
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.frame_errors import Key
from vocc_torch.measure.likelihood import ForwardModel, PixelModel, overlap
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.store import Store
from vocc_torch.rng import BLOCK_FRAMES
from vocc_torch.simulation import SceneModel, Simulator
from vocc_torch.types import Frames, Scene

WIDTHS = (64, 4096)
"""How many partial decisions the M-algorithm keeps; the second where the first gave no proven bits."""

STARTS = 8
"""How many results of the M-algorithm are improved by flips, the likeliest first, until one is proven."""

NOISE_WIDTH = 256
"""How many partial decisions the M-algorithm keeps under noise, where nothing can be proven."""

NEWTON_STEPS = 40
"""Most steps of the relaxation; scenes of the paper take two to six."""

CENTRING = 4.0
"""Weight of a bit's squared distance from 1/2: the inverse of its variance."""

JUDGED_SHARE = 8
"""Of the M-algorithm's results, one in so many has its true misfit computed: those of the least squares."""

MOST_FLIPS = 8
"""Most flips for each LED of the panel, on average; more than one is rare."""


def relaxed_shares(model: PixelModel) -> Tensor:
    """Find the share of each LED's light, 0 to 1, for which the grey values are met best in least squares.

    A pixel counts with its distance from the grey value over its standard deviation; a white one counts only
    where the light stays below white. That is convex, and solved by projected Newton steps with halving.

    Args:
        model: N LEDs and P pixels.

    Returns:
        (N,) float64, 0 to 1.

    Source: D. P. Bertsekas, "Projected Newton Methods for Optimization Problems with Simple Constraints",
    SIAM J. Control Optim. 20, 1982.

    Example:
        >>> one = torch.ones(1, dtype=torch.float64)
        >>> seen = PixelModel(one, one.view(1, 1), 1.2 * one, 1.3 * one, 1.25 * one, 0.1 * one, 0 * one, None)
        >>> relaxed_shares(seen).tolist()
        [0.25]
    """
    if not model.light.numel():
        return model.light.new_full((len(model.light),), 0.5)
    light, target = _weighted(model, model.deviation(model.centre))
    white = torch.isinf(model.high)
    ridge = 1e-9 * float((light * light).sum(1).max())
    shares = light.new_full((len(light),), 0.5)
    residual = shares @ light - target
    for _ in range(NEWTON_STEPS):
        counted = ~(white & (residual > 0))
        active, missed = light[:, counted], residual[counted]
        slope = active @ missed
        free = ~(((shares <= 0) & (slope >= 0)) | ((shares >= 1) & (slope <= 0)))
        step = torch.zeros_like(shares)
        if bool(free.any()):
            moving = active[free]
            curvature = moving @ moving.T + ridge * torch.eye(
                len(moving), dtype=light.dtype
            )
            step[free] = torch.linalg.solve(curvature, slope[free])
        cost = float(missed @ missed)
        for halving in range(12):
            tried = (shares - step * 0.5**halving).clamp(0, 1)
            left = tried @ light - target
            fit = left[~(white & (left > 0))]
            if float(fit @ fit) < cost:
                break
        else:
            break
        shares, residual = tried, left
        if cost - float(fit @ fit) < 1e-4 * cost:
            break
    return shares


def descend(model: PixelModel, bits: Tensor) -> tuple[Tensor, Tensor]:
    """Flip one LED at a time, the one that lowers the misfit most, until no flip lowers it.

    An LED that no pixel tells On from Off becomes On. Under white that is the likelier of the two: more light
    never unmakes white, so of the bits that give the very same frame at least half have the LED On.

    Args:
        model: N LEDs and P pixels.
        bits: (N,) bool, where to begin.

    Returns:
        Bits (N,) bool and the misfit that each one's flip would add, (N,) float64.

    Example:
        >>> dark, bright = (torch.full((1,), value, dtype=torch.float64) for value in (1.0, torch.inf))
        >>> seen = PixelModel(dark, dark.view(1, 1), dark - 1, bright, dark, dark, 0 * dark, None)
        >>> descend(seen, torch.zeros(1, dtype=torch.bool))[0].tolist()
        [True]
    """
    # A flip changes no pixel that the LED's light does not reach, so no other is computed.
    reach = int((model.light > 0).sum(1).max()) if model.light.numel() else 0
    light, pixels = model.light.topk(reach, dim=1, sorted=False)

    def flip_costs(bits: Tensor) -> Tensor:
        exposure = model.exposure(bits)
        before = model.misfit(exposure)
        flipped = exposure[pixels] + torch.where(bits, -1.0, 1.0).unsqueeze(1) * light
        return (model.misfit(flipped, pixels) - before[pixels]).sum(1)

    bits = bits.clone()
    costs = flip_costs(bits)
    for _ in range(MOST_FLIPS * len(bits)):
        # Equal misfits tip to On, so the walk cannot go in circles.
        worse = (costs < 0) | ((costs == 0) & ~bits)
        if not bool(worse.any()):
            break
        best = int(torch.where(worse, costs, torch.inf).argmin())
        bits[best] = ~bits[best]
        costs = flip_costs(bits)
    return bits, costs


def likely_bits(model: PixelModel, shares: Tensor, width: int) -> Tensor:
    """Decide LED after LED by least squares, keeping the best ``width`` partial decisions (M-algorithm).

    The squares are those of the relaxation about its solution: a quadratic form, which a triangular factor
    turns into a sum that grows with every LED decided. As ``(b - 1/2)^2`` is the same for both bits, it may
    be added; it keeps the shares of LEDs yet to be decided from running far beyond 0 and 1. Complete
    decisions are ordered by their true misfit: least squares know neither the ends of the grey values'
    intervals nor white.

    Args:
        model: N LEDs and P pixels.
        shares: (N,) from :func:`relaxed_shares`.
        width: partial decisions kept, at least 1.

    Returns:
        (K,N) bool, the likeliest first.

    Source: J. B. Anderson and S. Mohan, "Sequential Coding Algorithms: A Survey and Cost Analysis", IEEE
    Trans. Commun. 32, 1984 (the M-algorithm); M. O. Damen, H. El Gamal and G. Caire, "On Maximum-Likelihood
    Detection and the Search for the Closest Lattice Point", IEEE Trans. Inf. Theory 49, 2003.

    Example:
        >>> one = torch.ones(1, dtype=torch.float64)
        >>> seen = PixelModel(one, one.view(1, 1), 1.9 * one, 2.1 * one, 2 * one, 0.2 * one, 0 * one, None)
        >>> likely_bits(seen, relaxed_shares(seen), width=2)[0].tolist()
        [True]
    """
    light, target = _weighted(model, model.deviation(model.exposure(shares)))
    counted = ~(torch.isinf(model.high) & (shares @ light > target))
    light, target = light[:, counted], target[counted]
    form = light @ light.T + CENTRING * torch.eye(len(light), dtype=light.dtype)
    middle = torch.linalg.solve(form, light @ target + CENTRING / 2)
    factor = torch.linalg.cholesky(form, upper=True)
    away = light.new_zeros(1, len(light))
    cost = light.new_zeros(1)
    choice = torch.tensor([0.0, 1.0], dtype=light.dtype)
    for led in reversed(range(len(light))):
        decided = away[:, led + 1 :] @ factor[led, led + 1 :]
        costs = (
            cost.unsqueeze(1)
            + (decided.unsqueeze(1) + factor[led, led] * (choice - middle[led])) ** 2
        )
        cost, cheapest = costs.flatten().topk(min(width, costs.numel()), largest=False)
        away = away[cheapest // 2]
        away[:, led] = cheapest % 2 - middle[led]
    candidates = (away + middle)[: -(-width // JUDGED_SHARE)] > 0.5
    misfits = model.misfit(model.exposure(candidates)).sum(1)
    ordered: Tensor = candidates[misfits.argsort(stable=True)]
    return ordered


def _weighted(model: PixelModel, deviation: Tensor) -> tuple[Tensor, Tensor]:
    """Give the light (N,P) and what it should add up to (P,), both over the pixels' standard deviations."""
    target = torch.where(torch.isinf(model.high), model.low, model.centre) - model.base
    return model.light / deviation, target / deviation


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
        seconds: CPU time of this thread that each frame took, s.
    """

    bits: Tensor
    scores: Tensor
    proven: Tensor
    seconds: tuple[float, ...]


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
            raise VoccError.of(
                "scene",
                f"of {len(scene)} scenes",
                f"one for each of {len(frames)} frames",
            )
        device, shape, seconds = self._simulator.device, self._simulator.panel.shape, []
        scene = scene.checked().to(device)
        bits = torch.zeros(len(frames), shape.rows, shape.columns, dtype=torch.bool)
        scores, proven = bits.double(), torch.zeros(len(frames), dtype=torch.bool)
        for i in range(len(frames)):
            begun = time.thread_time()
            found, costs, proven[i] = self.decide_one(
                frames[i : i + 1], scene[i : i + 1]
            )
            seconds.append(time.thread_time() - begun)
            bits[i] = found.view_as(bits[i])
            scores[i] = torch.where(found, costs, -costs).view_as(scores[i])
        return GenieDecision(
            bits.to(device), scores.to(device), proven.to(device), tuple(seconds)
        )

    def decide_one(self, frame: Frames, scene: Scene) -> tuple[Tensor, Tensor, bool]:
        """Decide one frame: bits (N,), what each flip would cost (N,), and whether they are proven."""
        model, shape = self._forward.pixels(frame, scene), self._simulator.panel.shape
        found: list[tuple[float, Tensor, Tensor]] = []
        shares = relaxed_shares(model)
        widths, starts = (
            (WIDTHS, STARTS) if model.noise is None else ((NOISE_WIDTH,), 1)
        )
        later = (
            bits
            for width in widths
            for bits in likely_bits(model, shares, width)[:starts]
        )
        # Each has more work behind it than the one before.
        for start in chain([shares > 0.5], later):
            bits, costs = descend(model, start)
            if model.noise is None:
                sent = bits.view(1, shape.rows, shape.columns)
                rendered = self._simulator.render(scene, sent, panel_only=True)
                mine, theirs = overlap(rendered, frame)
                # Bits that give the very frame, around the panel, are proven.
                if torch.equal(
                    rendered.grey[0, 0][mine],
                    frame.grey[0, 0][theirs].to(rendered.grey.device),
                ):
                    return bits, costs, True
            found.append((float(model.misfit(model.exposure(bits)).sum()), bits, costs))
        _, bits, costs = min(found, key=lambda one: one[0])
        return bits, costs, False


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
    plan: Plan,
    model: SceneModel,
    point: str,
    frames: int,
    workers: Workers,
    store: Store | None = None,
) -> GenieReference:
    """Let the genie decide a point's first frames, the same that every receiver decides there.

    Args:
        plan: world, seed and batch size.
        model: the point's scenes.
        point: the point's name, which keys its random draws.
        frames: how many frames, at least 1.
        workers: who does it; they change no count.
        store: where blocks are recorded, or None.

    Raises:
        UnknownLikelihoodError: effects whose likelihood the genie does not know, or pixels that are full
            before they are white.
        VoccError: a worker that was ended from outside.
    """
    decider = GenieDecider(plan)
    job = runner.Job(
        plan, model, point, decider, ProvenFrames(decider), f"{point}/genie"
    )
    (outcome,) = runner.count(
        [runner.Point(job, Budget(frames), store)], workers, BLOCK_FRAMES
    )
    (counts,) = outcome.errors.counts
    assert outcome.errors.groups is not None
    return GenieReference(
        counts,
        int((outcome.errors.groups == PROVEN).sum()),
        seconds_a_frame(job, frames),
    )


PROVEN = 1
"""Group of the frames of which no bits are likelier than the genie's."""

TIMED_FRAMES = 8
"""Frames on which the genie is timed."""


@dataclass(frozen=True, eq=False)
class GenieDecider:
    """Lets the genie decide; see :class:`vocc_torch.measure.runner.Deciders`.

    Args:
        plan: whose world the frames are of.
    """

    plan: Plan
    keys: tuple[Key, ...] = (Key("truth", "genie"),)
    needs_preambles: bool = False

    def finders(self, plan: Plan) -> dict[str, None]:
        """Take the true corners."""
        return {"truth": None}

    def decision(self, seen: link.Observation) -> GenieDecision:
        """Decide a batch, once."""

        def decide() -> GenieDecision:
            # One thread, whose clock then knows of all the work, and whose sums have one order.
            with (
                timing.threads(1),
                torch.autocast(seen.bits.device.type, enabled=False),
            ):
                return Genie(self.plan.world.simulator()).decide(
                    seen.frames, seen.scene
                )

        return seen.once("genie", decide)

    def __call__(
        self, views: Mapping[str, link.Observation], /
    ) -> Iterator[tuple[Tensor, link.Observation]]:
        """Decide one batch."""
        (observation,) = views.values()
        yield self.decision(observation).bits, observation


@dataclass(frozen=True, eq=False)
class ProvenFrames:
    """Sorts frames by whether the genie's bits are proven to be the likeliest."""

    decider: GenieDecider

    def __call__(self, _: link.Link, seen: link.Observation) -> Tensor:
        """Give the groups of a batch."""
        return self.decider.decision(seen).proven.long()


def seconds_a_frame(job: runner.Job, frames: int) -> float:
    """Time the genie on a point's first frames, the median, s."""
    keys, decider = link.block_keys(job.plan.seed, job.point, 1), GenieDecider(job.plan)
    few = min(frames, TIMED_FRAMES)
    batches = link.Link.of(job.plan).observe_each(
        {"truth": None}, job.model, keys, preambles=False, frames=few
    )
    return timing.median_of(
        [
            second_s
            for views in batches
            for second_s in decider.decision(views["truth"]).seconds
        ]
    ).value
