"""The symbol clock: which symbol each camera frame shows, in each band of rows, from known cells alone."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from vocc_torch.arrays import Bools, Floats, Integers, Singles
from vocc_torch.extras.messages.layout import Layout
from vocc_torch.extras.messages.signalling import ORDERS

SURE = 6.0
"""Most that one known cell's log-likelihood ratio counts."""

MIXED_COST = 4.0
"""What it costs to take a frame for one between two symbols."""

STEP_COST = 5.0
"""What each symbol costs by which a frame is farther from the last one than the clock lets expect."""

MOST_STEPS = 3
"""Symbols farther than that are no step but a jump."""

EVEN = 0.02
"""Chance left to a symbol more, or less, where the time between two frames speaks against it."""

JUMP_COST = 15.0
"""What a jump to any place costs."""

STUCK = 0.75
"""A cell that shows the same in more than this share of the last frames is hidden or dead."""

MEMORY = 64
"""How many frames these are."""

DELAY = 256
"""Frames that are looked ahead before a frame's symbol is settled."""

LEAST_JUMP = 2.25
"""Symbols from where the camera's clock expects the next frame, from which on a step is a jump."""

BACK = 16
"""Symbols that a jump may lead back, from a place taken wrongly beside a gap; farther back is far ahead."""

DOUBTFUL = 12.0
"""By how much the frames beside a jump must together be likelier where they are taken to be than where the
frames beyond the jump would have them."""

NEAR = 64
"""Frames beside a jump that are compared so."""


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
        llr: (R C,) float32.
        time_s: when it was taken, or None.
        likelihood: (P B,) float32, log-likelihood of each state.
        back: (P B,) the likeliest state of the frame before.
        ahead: expected after that frame, in bands.
    """

    llr: Singles
    time_s: float | None
    likelihood: Singles
    back: NDArray[np.int32]
    ahead: float


class SymbolClock:
    """Follows the symbols through a recording by dynamic programming over a block's places.

    A state is a symbol of the block and how many bands show the next one already: rows lower in the picture
    are exposed later. Each frame adds the log-likelihood of its known cells; between frames the state goes on
    by what the time between them lets expect, give or take a symbol, so phase, ratio and drift need not be
    known, and a dropped or repeated frame costs a penalty. Nothing is settled until later frames agree.

    Source: A. J. Viterbi, "Error bounds for convolutional codes and an asymptotically optimum decoding
    algorithm", IEEE Trans. Inf. Theory 13(2), 1967.

    Args:
        layout: where the known cells are, and what they show.

    Example:
        >>> from vocc_torch.extras.messages.signalling import MessagePlan, PanelShape, Signalling
        >>> clock = SymbolClock(layout := Layout(MessagePlan(PanelShape(8, 8), Signalling())))
        >>> frames = 5.0 * layout.known.repeat(2, axis=0)  # two frames a symbol
        >>> clock.push(frames[7:99], [None] * 92) is None
        True
        >>> clock.finish().symbol[:4, 0].tolist()
        [3, 4, 4, 5]
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        kind = layout.kind.ravel()
        rows = layout.band_of_row.repeat(layout.kind.shape[1])
        shown = layout.known.reshape(layout.symbols, -1).T.astype(np.float32)
        known = [(rows == band) & (kind != "data") for band in range(layout.bands)]
        self._known = [(cells, shown[cells]) for cells in known]
        self._anchors = kind == "anchor"
        self._lit: Floats | None = None
        self._value = np.zeros(layout.symbols * layout.bands, dtype=np.float32)
        self._frames: list[PendingFrame] = []
        self._last: float | None = None
        self._doubted = np.zeros(0, dtype=bool)
        self._unit: int | None = None
        self._ahead = 0.0

    def push(self, llr: Singles, times_s: Sequence[float | None]) -> Ticks | None:
        """Take frames in.

        Args:
            llr: (F,R,C) log-likelihood ratios, zeros for a frame that shows nothing.
            times_s: when each was taken, s, or None where nobody knows.

        Returns:
            Frames that are settled by now, or None.
        """
        flat = llr.reshape(len(llr), -1).astype(np.float32)
        if self._lit is None:  # a cell may be hidden from the begin on
            self._lit = (1 - 1 / MEMORY) * np.sign(flat).mean(axis=0, keepdims=True)
        alive, self._lit = lfilter(
            [1 / MEMORY], [1, 1 / MEMORY - 1], np.sign(flat), axis=0, zi=self._lit
        )
        alive = (np.abs(alive) < STUCK) | self._anchors
        likelihoods = self._likelihood(flat.clip(-SURE, SURE) * alive)
        for row, likelihood, time_s in zip(flat, likelihoods, times_s, strict=True):
            # Without a clock of its own the camera is taken to be faster than the panel.
            ahead = 0.5
            if time_s is not None and self._last is not None:
                rate_hz = self.layout.plan.signalling.symbol_rate_hz
                ahead = max(0.0, (time_s - self._last) * rate_hz)
            self._last = time_s
            back, units = self._advance(likelihood, ahead), ahead * self.layout.bands
            self._frames.append(PendingFrame(row, time_s, likelihood, back, units))
        settled = len(self._frames) - DELAY
        return self._settle(settled) if settled >= DELAY else None

    def finish(self) -> Ticks | None:
        """Settle the remaining frames."""
        return self._settle(len(self._frames)) if self._frames else None

    def _likelihood(self, llr: Singles) -> Singles:
        """Give the log-likelihood of every state (F,P*B) from known cells."""
        bands = np.stack([llr[:, cells] @ shown / 2 for cells, shown in self._known])
        states = [bands.sum(axis=0)]
        for band in range(len(bands) - 1, 0, -1):  # from which on the next one shows
            following = np.roll(bands[band:].sum(axis=0), -1, axis=-1)
            states.append(bands[:band].sum(axis=0) + following - MIXED_COST)
        return np.stack(states, axis=-1).reshape(len(llr), -1)

    def _advance(self, likelihood: Singles, ahead: float) -> NDArray[np.int32]:
        """Go on by one frame that is expected so many symbols ahead, and say where each state came from."""
        bands, old = self.layout.bands, self._value
        low, high = math.floor(ahead), math.ceil(ahead)
        least = max(0, (low - MOST_STEPS) * bands)
        steps = np.arange(least, (high + MOST_STEPS + 1) * bands)
        usual = steps.clip((low - 1) * bands + 1, (high + 1) * bands - 1)
        # By how uniform phases fall: one symbol more is as likely as what is expected of it.
        odds = np.log(np.array([low + 1 - ahead, ahead - low]) + EVEN)
        cost = STEP_COST / bands * np.abs(steps - usual)
        cost -= np.interp(steps / bands, [low, low + 1], odds)
        origin = (np.arange(len(old)) - steps[:, None]) % len(old)
        reached = old[origin] - cost.astype(np.float32)[:, None]
        best = reached.argmax(axis=0, keepdims=True)
        value, jump = reached.max(axis=0), old.max() - JUMP_COST
        back = np.take_along_axis(origin, best, axis=0)[0]
        self._value = np.maximum(value, jump) + likelihood
        self._value -= self._value.max()
        return np.where(value < jump, old.argmax(), back).astype(np.int32)

    def _settle(self, count: int) -> Ticks:
        """Trace back from the likeliest state and settle the oldest frames."""
        bands, n = self.layout.bands, len(self._value)
        path = [int(self._value.argmax())]
        for frame in self._frames[:0:-1]:
            path.append(int(frame.back[path[-1]]))
        path.reverse()
        doubtful = self._doubtful(np.array(path))
        # Beside a gap of which the first side is settled.
        doubtful[: len(self._doubted)] |= self._doubted
        self._doubted = np.logical_and.accumulate(doubtful[count:])
        settled, self._frames = self._frames[:count], self._frames[count:]
        if self._unit is None:
            self._unit, self._ahead = path[0], -settled[0].ahead
        units = np.empty(count, dtype=np.int64)
        for i, frame in enumerate(settled):
            self._ahead += frame.ahead
            step = (path[i] - self._unit + BACK * bands) % n - BACK * bands
            # A gap may be longer than a block.
            step += n * max(0, round((self._ahead - step) / n))
            units[i] = self._unit + step
            if not doubtful[i]:
                self._unit, self._ahead = self._unit + step, 0.0
        llr = np.stack([frame.llr for frame in settled])
        is_next = np.arange(bands) >= bands - units[:, None] % bands
        symbol = units[:, None] // bands + is_next
        agreement = llr[:, self.layout.kind.ravel() == "clock"] * (2 * (symbol % 2) - 1)
        agreement[doubtful[:count]] = 0
        return Ticks(
            symbol,
            agreement.astype(np.float32),
            llr.reshape(count, *self.layout.kind.shape),
            [frame.time_s for frame in settled],
        )

    def _doubtful(self, path: Integers) -> Bools:
        """Mark the frames near a jump that fit equally well on its other side: few symbols do not determine the place.

        Where frames were lost, nobody knows which symbol is the first one after the gap but the sync cells.
        """
        n, bands = len(self._value), self.layout.bands
        clock = np.cumsum([frame.ahead for frame in self._frames])
        seen = np.stack([frame.likelihood for frame in self._frames])
        apart = (np.diff(path) - np.diff(clock) + n / 2) % n - n / 2
        doubtful, about = np.zeros(len(path), dtype=bool), np.arange(-bands, bands + 1)
        jumps = np.flatnonzero(np.abs(apart) > LEAST_JUMP * bands).tolist()
        ends = [-1, *jumps, len(path) - 1]
        for begin, last, end in zip(ends, jumps, ends[2:], strict=False):
            between = (path[last] - path[begin + 1]) % n
            if begin >= 0 and between < ORDERS[self.layout.symbols] * bands:
                doubtful[begin + 1 : last + 1] = True
            after = np.arange(last + 1, end + 1)[:NEAR]
            before = np.arange(last, begin, -1)[:NEAR]
            for rows, beyond in ((after, last), (before, last + 1)):
                led = np.rint(path[beyond] + clock[rows] - clock[beyond]).astype(int)
                others = np.take_along_axis(
                    seen[rows], (led[:, None] + about) % n, axis=1
                )
                gain = np.cumsum(seen[rows, path[rows]] - others.max(axis=1))
                doubtful[rows[np.maximum.accumulate(gain) <= DOUBTFUL]] = True
        return doubtful
