"""The symbol clock: which symbol each camera frame shows, in each band of rows, from known cells alone."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.stats import theilslopes

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

ENDS = 8
"""Frames at a recording's begin and end that only frames on one side speak for."""

BESIDE = 32
"""Frames beside them that do."""

ASTRAY = 1.25
"""Symbols from where the others place it, from which on such a frame is astray."""

BACK = 16
"""Symbols that a jump may lead back, from a place taken wrongly beside a gap; farther back is far ahead."""

DOUBTFUL = 12.0
"""By how much the frames beside a jump must together be likelier where they are taken to be than where the
frames beyond the jump would have them."""

NEAR = 64
"""Frames beside a jump that are compared so."""


@dataclass(frozen=True)
class Ticks:
    """Settled frames.

    Args:
        first: number of the first one among all frames.
        symbol: (F,B) int64, the symbol that each band of rows shows, counted from the first block's begin.
        agreement: (F,B) float32, how well the band's clock cell agrees with that; 0 or less: not at all.
    """

    first: int
    symbol: Integers
    agreement: Singles


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
        self.layout, self.rate_hz = layout, layout.plan.signalling.symbol_rate_hz
        self.states = layout.symbols * layout.bands
        kind = layout.kind.ravel()
        rows = layout.band_of_row.repeat(layout.kind.shape[1])
        shown = layout.known.reshape(layout.symbols, -1).astype(np.float32)
        self._cells = [
            np.flatnonzero((rows == band) & (kind != "data"))
            for band in range(layout.bands)
        ]
        self._shown = [shown[:, cells].T for cells in self._cells]
        self._clocks = [
            np.flatnonzero((rows == band) & (kind == "clock"))
            for band in range(layout.bands)
        ]
        self._anchors = kind == "anchor"
        self._lit = np.zeros((1, kind.size))
        self._value = np.zeros(self.states, dtype=np.float32)
        self._back: list[NDArray[np.int32]] = []
        self._steps: list[float] = []
        self._llr: list[Singles] = []
        self._seen: list[Singles] = []
        self._last: float | None = None
        self._doubted = np.zeros(0, dtype=bool)
        self._settled, self._place, self._symbols, self._ahead = 0, -1, 0, 0.0

    def push(self, llr: Singles, times_s: Sequence[float | None]) -> Ticks | None:
        """Take frames in.

        Args:
            llr: (F,R,C) log-likelihood ratios, zeros for a frame that shows nothing.
            times_s: when each was taken, s, or None where nobody knows.

        Returns:
            Frames that are settled by now, or None.
        """
        flat = llr.reshape(len(llr), -1).astype(np.float32)
        # A cell that is hidden from the begin on.
        if not self._llr and not self._settled:
            self._lit = (1 - 1 / MEMORY) * np.sign(flat).mean(axis=0, keepdims=True)
        alive, self._lit = lfilter(
            [1 / MEMORY], [1, 1 / MEMORY - 1], np.sign(flat), axis=0, zi=self._lit
        )
        alive = (np.abs(alive) < STUCK) | self._anchors
        likelihoods = self._likelihood(
            np.clip(flat, -SURE, SURE) * alive.astype(np.float32)
        )
        for row, values, time_s in zip(flat, likelihoods, times_s, strict=True):
            # Without a clock of its own the camera is taken to be faster than the panel.
            if time_s is None or self._last is None:
                ahead = 0.5
            else:
                ahead = max(0.0, (time_s - self._last) * self.rate_hz)
            self._last = time_s
            self._advance(values, ahead)
            self._llr.append(row)
            self._seen.append(values)
        return (
            self._settle(len(self._back) - DELAY)
            if len(self._back) >= 2 * DELAY
            else None
        )

    def finish(self) -> Ticks | None:
        """Settle the remaining frames."""
        return self._settle(len(self._back), at_end=True) if self._back else None

    def _likelihood(self, llr: Singles) -> Singles:
        """Give the log-likelihood of every state (F,P*B) from known cells."""
        bands = self.layout.bands
        correlations = np.stack(
            [
                llr[:, c] @ shown / 2
                for c, shown in zip(self._cells, self._shown, strict=True)
            ]
        )
        states = np.empty((len(llr), self.layout.symbols, bands), dtype=np.float32)
        for after in range(bands):  # bands at the bottom that show the next symbol
            following = np.roll(correlations[bands - after :].sum(axis=0), -1, axis=-1)
            states[:, :, after] = (
                correlations[: bands - after].sum(axis=0)
                + following
                - MIXED_COST * (after > 0)
            )
        return states.reshape(len(llr), -1)

    def _advance(self, likelihood: Singles, ahead: float) -> None:
        """Go on by one frame that is expected so many symbols ahead."""
        bands, n, old = self.layout.bands, self.states, self._value
        low, high = math.floor(ahead), math.ceil(ahead)
        least = max(0, (low - MOST_STEPS) * bands)
        steps = np.arange(least, (high + MOST_STEPS) * bands + bands)
        short = low * bands - (bands - 1) - steps
        far = steps - (high * bands + bands - 1)
        cost = STEP_COST / bands * np.maximum(0, np.maximum(short, far))
        # By how uniform phases fall: one symbol more is as likely as what is expected of it.
        odds = np.array([low + 1 - ahead, ahead - low]) + EVEN
        cost = (cost + np.interp(steps / bands, [low, low + 1], -np.log(odds))).astype(
            np.float32
        )
        origin = (np.arange(n) - steps[:, None]) % n
        reached = old[origin] - cost[:, None]
        best = reached.argmax(axis=0)
        value, back = reached[best, np.arange(n)], origin[best, np.arange(n)]
        top = int(old.argmax())
        jumps = value < old[top] - JUMP_COST
        value[jumps], back[jumps] = old[top] - JUMP_COST, top
        self._value = value + likelihood
        self._value -= self._value.max()
        self._back.append(back.astype(np.int32))
        self._steps.append(ahead * bands)

    def _settle(self, count: int, at_end: bool = False) -> Ticks:
        """Trace back from the likeliest state and settle the oldest frames."""
        place, path = int(self._value.argmax()), []
        for back in reversed(self._back):
            path.append(place)
            place = int(back[place])
        path.reverse()
        bands, n = self.layout.bands, self.states
        units = np.empty(count, dtype=np.int64)
        doubtful = self._doubtful(np.array(path))
        # Beside a gap of which the first side is settled.
        doubtful[: len(self._doubted)] |= self._doubted
        doubtful, self._doubted = (
            doubtful[:count],
            np.logical_and.accumulate(doubtful[count:]),
        )
        for i in range(count):
            self._ahead += self._steps[i]
            if self._place < 0:
                self._place, self._symbols, self._ahead = path[i], path[i], 0.0
            step = (path[i] - self._place + BACK * bands) % n - BACK * bands
            # A gap may be longer than a block.
            units[i] = (
                self._symbols + step + n * max(0, round((self._ahead - step) / n))
            )
            if not doubtful[i]:
                self._place, self._symbols, self._ahead = path[i], units[i], 0.0
        expected = np.cumsum(self._steps[:count])
        for begin in [slice(None)] * (not self._settled) + [
            slice(None, None, -1)
        ] * at_end:
            rejoin(units[begin], expected[begin], ASTRAY * bands)
        llr = np.stack(self._llr[:count])
        del (
            self._back[:count],
            self._steps[:count],
            self._llr[:count],
            self._seen[:count],
        )
        steps = np.arange(bands)[None] >= bands - (units % bands)[:, None]
        symbol = (units // bands)[:, None] + steps
        odd = 2 * (symbol % 2) - 1
        clocks = np.stack([llr[:, cells].sum(axis=1) for cells in self._clocks], axis=1)
        agreement = np.where(doubtful[:, None], 0, clocks * odd)
        ticks = Ticks(self._settled, symbol, agreement.astype(np.float32))
        self._settled += count
        return ticks

    def _doubtful(self, path: Integers) -> Bools:
        """Mark the frames near a jump that fit equally well on its other side: few symbols do not determine the place.

        Where frames were lost, nobody knows which symbol is the first one after the gap but the sync cells.
        """
        n, bands, clock = self.states, self.layout.bands, np.cumsum(self._steps)
        apart = (np.diff(path) - np.diff(clock) + n / 2) % n - n / 2
        doubtful, about = np.zeros(len(path), dtype=bool), np.arange(-bands, bands + 1)
        # Beyond what is looked at about a place.
        jumps = np.flatnonzero(np.abs(apart) > (1 + ASTRAY) * bands)
        for begin, last, end in zip(
            [-1, *jumps], jumps, [*jumps[1:], len(path) - 1], strict=False
        ):
            if (
                begin >= 0
                and (path[last] - path[begin + 1]) % n
                < ORDERS[self.layout.symbols] * bands
            ):
                doubtful[begin + 1 : last + 1] = (
                    True  # too few symbols between two jumps
                )
            after = np.arange(last + 1, end + 1)[:NEAR]
            before = np.arange(last, begin, -1)[:NEAR]
            for rows, beyond in ((after, last), (before, last + 1)):
                led = np.rint(path[beyond] + clock[rows] - clock[beyond]).astype(int)
                cells = np.stack([self._seen[row] for row in rows])
                others = np.take_along_axis(
                    cells, (led[:, None] + about) % n, axis=1
                ).max(axis=1)
                sure = (
                    np.cumsum(cells[np.arange(len(rows)), path[rows]] - others)
                    > DOUBTFUL
                )
                doubtful[rows[: int(sure.argmax()) if sure.any() else len(rows)]] = True
        return doubtful


def rejoin(units: Integers, expected: Floats, astray: float) -> None:
    """Move the first frames to the place that later frames imply, if they lie farther away than ``astray``.

    A frame amid a recording pays for the way to a wrong symbol and back; the first and the last pay once.

    Args:
        units: (F,) places of frames, changed.
        expected: (F,) where the camera's clock lets expect them, from any origin and of about any rate.
        astray: in the same unit.

    Example:
        >>> units = np.arange(100)
        >>> units[0] = 9
        >>> rejoin(units, 0.99 * np.arange(100), 5)
        >>> int(units[0])
        0
    """
    others = slice(ENDS, ENDS + BESIDE)
    if len(units) < ENDS + BESIDE or np.ptp(expected[others]) == 0:
        return
    rate, begin = theilslopes(units[others], expected[others])[:2]
    placed = begin + rate * expected[:ENDS]
    far = np.abs(units[:ENDS] - placed) > astray
    units[:ENDS][far] = np.rint(placed[far])
