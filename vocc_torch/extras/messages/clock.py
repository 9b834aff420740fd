"""The symbol clock: which symbol each camera frame shows, in each band of rows, from known cells alone."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from vocc_torch.arrays import Integers, Singles
from vocc_torch.extras.messages.layout import Layout


@dataclass(frozen=True)
class ClockSettings:
    """How frames are matched to symbols; costs are log-likelihoods."""

    most_llr: float = 6.0  # log-likelihood ratio of one known cell
    mixed_cost: float = 4.0  # of a frame between two symbols
    step_cost: float = 5.0  # of each symbol beyond what the clock expects
    most_steps: int = 3  # symbols; farther is a jump
    unexpected_chance: float = 0.02  # of a symbol more or less than the time allows
    jump_cost: float = 15.0  # whatever its length
    stuck_share: float = 0.75  # of recent frames; a cell alike in more is hidden
    memory_frames: int = 64  # that count as recent
    delay_frames: int = 256  # after a frame, before its symbol is settled
    least_jump_symbols: float = 4.0  # off the expected place
    most_back_symbols: int = 16  # of a jump; farther back is far ahead
    clear_margin: float = 8.0  # of the likeliest place over places beyond a jump


SETTINGS = ClockSettings()


class Ticks(NamedTuple):
    """Settled frames.

    Args:
        symbol: (F,B) int64, the symbol that each band of rows shows, counted from the first block's begin.
        agreement: (F,B) float32, how well the band's clock cell agrees with that; 0 or less: not at all.
        llr: (F,R,C) float32, as they were pushed.
        times_s: likewise.
    """

    symbol: Integers
    agreement: Singles
    llr: Singles
    times_s: list[float | None]


class PendingFrame(NamedTuple):
    """A frame that is not settled yet.

    Args:
        llr: (R,C) float32.
        time_s: when it was taken, or None.
        likelihood: (P B,) float32, log-likelihood of each state.
        value: (P B,) float32, that of the likeliest way that ends in each state.
        ahead: expected after the frame before, in symbols.
    """

    llr: Singles
    time_s: float | None
    likelihood: Singles
    value: Singles
    ahead: float


SoftFrames = tuple[Singles, Sequence[float | None]]
"""Log-likelihood ratios (F,R,C), zeros for a frame that shows no panel, and when each was taken, s, or None."""


class SymbolClock:
    """Follows the symbols through a recording by dynamic programming over a block's places.

    A state is a symbol of the block and how many bands show the next one already: rows lower in the picture
    are exposed later. Each frame adds the log-likelihood of its known cells; between frames the state goes on
    by what the time between them lets expect, give or take a symbol, so phase, ratio and drift need not be
    known, and a dropped or repeated frame costs a penalty. Nothing is settled until later frames agree.

    Source: the max-log variant of L. R. Bahl et al., "Optimal decoding of linear codes for minimizing symbol
    error rate", IEEE Trans. Inf. Theory 20(2), 1974.

    Args:
        layout: where the known cells are, and what they show.

    Example:
        >>> from vocc_torch.extras.messages.signalling import MessagePlan, PanelShape, Signalling
        >>> clock = SymbolClock(layout := Layout(MessagePlan(PanelShape(8, 8), Signalling())))
        >>> frames = 5.0 * layout.known.repeat(2, axis=0)  # two frames a symbol
        >>> [ticks] = clock.ticks([(frames[7:99], [None] * 92)])
        >>> ticks.symbol[:4, 0].tolist()
        [3, 4, 4, 5]
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        known = layout.known.astype(np.float32)
        rows = layout.band_of_row[:, None]
        cells = [(layout.kind != "data") & (rows == n) for n in range(layout.bands)]
        self._known = [(places, known[:, places].T) for places in cells]
        self._lit: Singles | None = None
        self._frames: list[PendingFrame] = []
        self._value = np.zeros(layout.symbols * layout.bands, dtype=np.float32)
        self._last_s: float | None = None
        self._unit: int | None = None
        self._ahead = 0.0

    def ticks(self, recording: Iterable[SoftFrames]) -> Iterator[Ticks]:
        """Settle the frames of a recording, some hundreds at a time."""
        for llr, times_s in recording:
            self._take(llr.astype(np.float32), times_s)
            if len(self._frames) >= 2 * SETTINGS.delay_frames:
                yield self._settle(len(self._frames) - SETTINGS.delay_frames)
        if self._frames:
            yield self._settle(len(self._frames))

    def _take(self, llr: Singles, times_s: Sequence[float | None]) -> None:
        """Take frames in."""
        lit, newest = np.sign(llr), 1 / SETTINGS.memory_frames
        if self._lit is None:  # a cell may be hidden from the begin on
            self._lit = (1 - newest) * lit.mean(axis=0, keepdims=True)
        recent, self._lit = lfilter(
            [newest], [1, newest - 1], lit, axis=0, zi=self._lit
        )
        alive = np.abs(recent) < SETTINGS.stuck_share
        alive |= self.layout.kind == "anchor"
        clipped = llr.clip(-SETTINGS.most_llr, SETTINGS.most_llr)
        likelihoods = self._likelihood(clipped * alive)
        for frame, likelihood, time_s in zip(llr, likelihoods, times_s, strict=True):
            # Without a clock of its own the camera is taken to be faster than the panel.
            ahead = 0.5
            if time_s is not None and self._last_s is not None:
                rate_hz = self.layout.plan.signalling.symbol_rate_hz
                ahead = max(0.0, (time_s - self._last_s) * rate_hz)
            self._last_s = time_s
            self._value = self._moved(self._value, ahead, 1) + likelihood
            pending = PendingFrame(frame, time_s, likelihood, self._value, ahead)
            self._frames.append(pending)

    def _likelihood(self, llr: Singles) -> Singles:
        """Give the log-likelihood of every state (F,P*B) from known cells."""
        bands = np.stack([llr[:, cells] @ shown / 2 for cells, shown in self._known])
        states = [bands.sum(axis=0)]
        for band in range(len(bands) - 1, 0, -1):  # from which on the next one shows
            following = np.roll(bands[band:].sum(axis=0), -1, axis=-1)
            states.append(bands[:band].sum(axis=0) + following - SETTINGS.mixed_cost)
        return np.stack(states, axis=-1).reshape(len(llr), -1)

    def _moved(self, value: Singles, ahead: float, way: int) -> Singles:
        """Go from one frame to the next, so many symbols ahead, or with a ``way`` of -1 to the one before.

        Args:
            value: (P B,) log-likelihood of the likeliest way through the frames passed, by its last state.
            ahead: expected, in symbols.
            way: 1 or -1.
        """
        bands = self.layout.bands
        low, high = math.floor(ahead), math.ceil(ahead)
        least = max(0, (low - SETTINGS.most_steps) * bands)
        steps = np.arange(least, (high + SETTINGS.most_steps + 1) * bands)
        usual = steps.clip((low - 1) * bands + 1, (high + 1) * bands - 1)
        # By how uniform phases fall: one symbol more is as likely as what is expected of it.
        odds = np.log(
            np.array([low + 1 - ahead, ahead - low]) + SETTINGS.unexpected_chance
        )
        cost = SETTINGS.step_cost / bands * np.abs(steps - usual)
        cost -= np.interp(steps / bands, [low, low + 1], odds)
        origin = (np.arange(len(value)) - way * steps[:, None]) % len(value)
        reached = value[origin] - cost.astype(np.float32)[:, None]
        best: Singles = np.maximum(
            reached.max(axis=0), value.max() - SETTINGS.jump_cost
        )
        best -= best.max()
        return best

    def _settle(self, count: int) -> Ticks:
        """Settle the oldest frames, by all that are there."""
        path, clear = self._path()
        settled, self._frames = self._frames[:count], self._frames[count:]
        bands, n = self.layout.bands, len(self._value)
        if self._unit is None:
            self._unit, self._ahead = path[0], -settled[0].ahead * bands
        units = np.empty((count, 1), dtype=np.int64)
        back = SETTINGS.most_back_symbols * bands
        for i, frame in enumerate(settled):
            self._ahead += frame.ahead * bands
            step = (path[i] - self._unit + back) % n - back
            # A gap may be longer than a block.
            step += n * max(0, round((self._ahead - step) / n))
            units[i] = self._unit + step
            if clear[i]:
                self._unit, self._ahead = self._unit + step, 0.0
        llr = np.stack([frame.llr for frame in settled])
        symbol = units // bands + (np.arange(bands) >= bands - units % bands)
        agreement = llr[:, self.layout.kind == "clock"] * (2 * (symbol % 2) - 1)
        agreement[np.logical_not(clear[:count])] = 0
        times_s = [frame.time_s for frame in settled]
        return Ticks(symbol, agreement.astype(np.float32), llr, times_s)

    def _path(self) -> tuple[list[int], list[bool]]:
        """Give the likeliest state of each frame, and whether states beyond a jump are clearly less likely."""
        n, frames = len(self._value), len(self._frames)
        path, clear = [0] * frames, [False] * frames
        after, states = np.zeros_like(self._value), np.arange(n)
        for i in reversed(range(frames)):
            frame = self._frames[i]
            total = frame.value + after
            path[i] = int(total.argmax())
            apart = np.abs((states - path[i] + n // 2) % n - n // 2)
            far = apart > SETTINGS.least_jump_symbols * self.layout.bands
            clear[i] = bool(total.max() - total[far].max() > SETTINGS.clear_margin)
            after = self._moved(after + frame.likelihood, frame.ahead, -1)
        return path, clear
