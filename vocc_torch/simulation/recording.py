"""A camera that is not synchronised with the panel: the frames that it takes of a film."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.random import Generator
from torch import Tensor

from vocc_torch.arrays import Floats
from vocc_torch.errors import VoccError
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.effects.light import Playback, RollingShutter
from vocc_torch.simulation.simulator import Simulator
from vocc_torch.types import Frames, Panels, Scene


class NoFrameLeftError(VoccError):
    """A recording of which every frame was lost."""


@dataclass(frozen=True, slots=True)
class Shutter:
    """When a camera opens its shutter.

    Args:
        fps: frames a second by the panel's clock, above 0.
        start_s: middle of the first exposure of the panel's centre, s from the film's begin.
        readout_s: from the first row's exposure to the last row's, s, above 0.
        dropped: chance that a frame is lost; those after it follow without a gap.
        repeated: chance that a frame is the one before it once more.
        black: chance that a frame is black.
        burst_frames: frames that are lost in a row, at least 1; bursts may meet.
    """

    fps: float
    start_s: float = 0.0
    readout_s: float = 1e-9
    dropped: float = 0.0
    repeated: float = 0.0
    black: float = 0.0
    burst_frames: int = 1

    def taken_s(self, length_s: float, draws: Generator) -> Floats:
        """Give the moments of the frames of a film of ``length_s``: those that were lost are left out.

        A moment that comes twice is a repeated frame; a black one is no number.

        Raises:
            NoFrameLeftError: so it is.

        Example:
            >>> Shutter(fps=200.0).taken_s(0.02, np.random.default_rng(0)).tolist()
            [0.0, 0.005, 0.01, 0.015]
        """
        count = max(1, math.ceil((length_s - self.start_s) * self.fps))
        times = self.start_s + np.arange(count) / self.fps
        fate = draws.random((3, len(times)))
        for i in np.flatnonzero(fate[1] < self.repeated).tolist():
            times[i] = times[max(0, i - 1)]
        times[fate[2] < self.black] = np.nan
        begun = np.concatenate(
            [draws.random(self.burst_frames - 1), fate[0]]
        )  # some before the recording
        begun = begun < 1 - (1 - self.dropped) ** (
            1 / self.burst_frames
        )  # so the share lost is ``dropped``
        lost = np.convolve(begun, np.ones(self.burst_frames), "valid") > 0
        if lost.all():
            raise NoFrameLeftError(
                f"record.dropped and burst_frames lose all of {len(times)} frames: lower them"
            )
        return times[~lost]


def further_films(
    simulator: Simulator, film: Tensor, key: BlockKey
) -> dict[str, Tensor]:
    """Draw the films (N,R,C) bool that a recording's LEDs of further colours play beside the first's.

    Args:
        simulator: its effects name the colours, ``.second`` and ``.third``.
        film: (N,R,C) bool, that of the first.
        key: the recording's.

    Example:
        >>> further_films(Simulator(), torch.ones(2, 8, 8, dtype=torch.bool), BlockKey(0, "doc", 0))
        {}
    """
    drawn = {
        f".{name}": key.generator(f"film.{name}").integers(2, size=tuple(film.shape))
        for name in simulator.further
    }
    return {name: torch.from_numpy(bits).bool() for name, bits in drawn.items()}


@dataclass(frozen=True)
class Recorded:
    """Some frames of a recording, with their truth.

    Args:
        frames: F frames, or crops of one size.
        panels: where the panel truly was.
        taken_s: (F,) the moments; no number where the frame is black.
        symbols: the number of the symbol that showed in the middle of each exposure.
    """

    frames: Frames
    panels: Panels
    taken_s: Floats
    symbols: Sequence[int | None]


def record(
    simulator: Simulator,
    scene: Scene,
    film: Tensor,
    symbol_s: float,
    shutter: Shutter,
    key: BlockKey,
    *,
    speed_m_s: float = 0.0,
    window: float | None = 1.5,
    batch: int = 64,
) -> Iterator[Recorded]:
    """Take a recording of a film.

    What belongs to the scene, the panel's pose and its stuck LEDs, is the same in every frame; noise is of
    each frame. LEDs of further colours play :func:`further_films`. A ``rolling_shutter`` among the
    simulator's effects gives way to the shutter's own.

    Args:
        simulator: camera, panel and effects.
        scene: one scene, at the recording's begin.
        film: (N,R,C) bool, the symbols; the panel is dark before and after.
        symbol_s: how long each shows, at least the exposure.
        shutter: when frames are taken.
        key: names the draws.
        speed_m_s: by which the panel's distance grows.
        window: how many times the panel's surroundings are rendered, at least 1; None for whole frames.
        batch: frames rendered at a time, which changes none of them.

    Raises:
        VoccError: what :meth:`Simulator.render` refuses, such as a distance that shrinks to nothing.

    Example:
        >>> film, scene = torch.ones(2, 8, 8, dtype=torch.bool), Scene.of(distance_m=50.0)
        >>> taken = record(Simulator(), scene, film, 0.01, Shutter(200.0), BlockKey(0, "doc", 0))
        >>> next(taken).symbols
        [0, 0, 1, 1]
    """
    taken = shutter.taken_s(len(film) * symbol_s, key.generator("shutter"))
    takes = [repr(time) for time in taken.tolist()]
    middles = dict(zip(takes, np.nan_to_num(taken).tolist(), strict=True))
    further = further_films(simulator, film, key)
    playback = Playback(
        shutter.readout_s, symbol_s, film=film, middles_s=middles, further=further
    )
    effects = [
        effect for effect in simulator.effects if not isinstance(effect, RollingShutter)
    ]
    camera = Simulator(
        simulator.camera,
        simulator.panel,
        [*effects, playback],
        framing=simulator.framing,
        device=simulator.device,
        dtype=simulator.dtype,
    )
    ends = (
        scene.distance_m
        + speed_m_s * torch.tensor([0.0, len(film) * symbol_s]).double()
    )
    nearest = float(ends.min()) / (window or 1.0)
    for begin in range(0, len(taken), batch):
        times, names = taken[begin : begin + batch], takes[begin : begin + batch]
        shown = np.nan_to_num(
            times
        )  # a black frame is rendered too, so that all frames have one size
        rows = torch.zeros(len(times), dtype=torch.int64)
        moved = scene[rows].distance_m + speed_m_s * torch.from_numpy(shown)
        scenes = replace(scene[rows], distance_m=moved)
        keys = [FrameKey(key, 0, name) for name in names]
        symbols = [playback.symbol_at(key.take) for key in keys]
        bits = playback.symbols(torch.tensor(symbols))
        frames = camera.render(
            scenes, bits, nearest_m=nearest, keys=keys, panel_only=window is not None
        )
        dark = torch.from_numpy(np.isnan(times)).to(frames.grey.device)
        for pixels in (frames.grey, frames.colour):
            if pixels is not None:
                pixels[dark] = 0
        numbers_shown = [
            None if math.isnan(time) else number
            for time, number in zip(times, symbols, strict=True)
        ]
        yield Recorded(frames, camera.true_panels(scenes, keys), times, numbers_shown)
