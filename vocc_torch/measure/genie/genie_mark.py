"""The genie's mark at a point: what is possible on the very frames that the receivers meet there."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median

import torch

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.genie.genie import Genie
from vocc_torch.measure.genie.genie_likelihood import UnknownLikelihoodError
from vocc_torch.measure.plan import World
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.rng import BLOCK_FRAMES, BlockKey, FrameKey
from vocc_torch.simulation import SceneModel

FRAMES_AT_ONCE = 16
"""Frames of one call: a search may take a thousand times as long as another, so calls are short."""


@dataclass(frozen=True)
class GenieMark:
    """What the genie does at one point.

    Args:
        counts: its errors; it misses no panel.
        proven: frames of which no bits are likelier than those that it gave.
        seconds_a_frame: median time of one frame's decision, of one thread's CPU, s.
    """

    counts: Counts
    proven: int
    seconds_a_frame: float


def genie_knows(world: World) -> str | None:
    """Say why the genie cannot decide frames of a world, or None where it can.

    Nothing is rendered, so pixels that are full before they are white in some scenes are not foreseen.

    Raises:
        VoccError: a world that cannot be simulated at all.

    Example:
        >>> genie_knows(World(device="cpu"))
        >>> str(genie_knows(World(device="cpu", effects={"saturation": {}})))
        'the genie reads digital numbers: name scene.effects.quantization'
    """
    simulator = world.simulator()
    try:
        Genie(simulator)
    except UnknownLikelihoodError as error:
        return str(error)
    return None


def genie_mark(
    world: World, model: SceneModel, seed: int, point: str, frames: int, workers: Workers
) -> GenieMark:
    """Let the genie decide a point's first frames, those that every receiver meets there.

    Args:
        world: what is simulated.
        model: the point's scenes.
        seed: the study's root seed.
        point: the point's name, which keys its random draws.
        frames: how many frames, at least 1.
        workers: who does it; they change no count.

    Raises:
        UnknownLikelihoodError: effects whose likelihood the genie does not know, or pixels that are full
            before they are white.
        VoccError: too few frames, or a worker that was ended from outside.

    Example:
        >>> with Workers(1) as alone:
        ...     mark = genie_mark(World(device="cpu"), SceneModel(), 0, "doc", 2, alone)
        >>> mark.counts.frames, mark.counts.bit_errors, mark.proven
        (2, 0.0, 2)
    """
    if frames < 1:
        raise VoccError(f"frames is {frames}: it must be at least 1")
    if (unknown := genie_knows(world)) is not None:
        raise UnknownLikelihoodError(unknown)
    shares = [
        _Share(world, model, BlockKey(seed, point, block), first, min(first + FRAMES_AT_ONCE, end))
        for block in range(-(-frames // BLOCK_FRAMES))
        for end in (min(BLOCK_FRAMES, frames - block * BLOCK_FRAMES),)
        for first in range(0, end, FRAMES_AT_ONCE)
    ]
    with worker_losses_told():
        decided = [future.result() for future in [workers.submit(_decided, share) for share in shares]]
    counts, proven, seconds = zip(*decided, strict=True)
    return GenieMark(sum(counts, Counts()), sum(proven), median(one for part in seconds for one in part))


@dataclass(frozen=True)
class _Share:
    """Frames ``first`` to ``end`` of a block, as they are sent to a worker."""

    world: World
    model: SceneModel
    key: BlockKey
    first: int
    end: int


def _decided(share: _Share) -> tuple[Counts, int, tuple[float, ...]]:
    """Decide some frames of a block: errors, how many are proven, and seconds of each."""
    simulator = share.world.simulator()
    rows = slice(share.first, share.end)
    scene, bits = share.model.draw(share.key, simulator.panel.shape)
    scene, bits = scene[rows].to(simulator.device), bits[rows].to(simulator.device)
    keys = [FrameKey(share.key, frame) for frame in range(share.first, share.end)]
    with torch.autocast(simulator.device.type, enabled=False):
        frames = simulator.render(scene, bits, nearest_m=share.model.nearest_m, keys=keys, panel_only=True)
        genie = Genie(simulator)
        decided, seconds, proven = torch.empty_like(bits), [], 0
        with _one_thread():
            for i in range(len(bits)):
                begun = time.thread_time()
                decision = genie.decide(frames[i : i + 1], scene[i : i + 1])
                seconds.append(time.thread_time() - begun)
                decided[i] = decision.bits[0]
                proven += int(decision.proven)
    # It knows where the panel is.
    found = torch.ones(len(bits), dtype=torch.bool, device=bits.device)
    return Counts.of(decided, bits, found), proven, tuple(seconds)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Work on one thread, whose clock then knows of all the work, and whose sums have one order."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
