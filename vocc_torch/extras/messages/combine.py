"""From soft values of camera frames to blocks of symbols: the frames of a symbol add up."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize_scalar

from vocc_torch.arrays import Singles
from vocc_torch.extras.messages.clock import SymbolClock, Ticks
from vocc_torch.extras.messages.layout import Layout

MIXED_SHARE = 0.3
"""A band whose clock cell agrees less than this share of what is usual is taken to show two symbols."""

DEAF_SHARE = 0.3
"""A clock cell whose agreement is less than this on average is hidden or dead."""

NEARBY = 32
"""Frames over which that is averaged."""

STUCK_SYMBOLS = 16
"""A cell that decides alike in so many symbols in a row carries no scrambled data: it is hidden or dead."""

WORTH_RANGE = (0.01, 4.0)
"""Bounds of what ratios are multiplied by."""

WEAK = 0.1
"""What a band counts whose clock cell does not agree, in a frame that does."""

HARDLY = 0.9
"""Share of a block without any frame from which on it is no block, but the begin or end of a recording."""


@dataclass(frozen=True)
class Block:
    """A block of P symbols, as all its frames together show it.

    Args:
        number: counted from the recording's begin.
        time_s: when its first frame was taken, or None.
        sums: (P,R,C) float32, the frames' ratios, added up by their weights.
        counts: (P,bands) int32, how many frames there were.
    """

    number: int
    time_s: float | None
    sums: Singles
    counts: NDArray[np.int32]

    def ratios(self, layout: Layout) -> Singles:
        """Give log-likelihood ratios (P,R,C); zeros for cells that are hidden or dead."""
        sums = self.sums * self._worth(layout)
        if layout.plan.signalling.scramble:
            on = (sums >= 0).reshape(-1, STUCK_SYMBOLS, *sums.shape[1:])
            stuck = (on == on[:, :1]).all(axis=1) & (layout.kind == "data")
            sums[stuck.repeat(STUCK_SYMBOLS, axis=0)] = 0
        return sums

    def _worth(self, layout: Layout) -> float:
        """Say by what the sums are to be multiplied to make the block's known cells likeliest.

        Scores are of any size, and far from what a receiver learned, or where frames of a symbol err
        together, ratios are too sure.
        """
        known, sums = layout.known, self.sums
        still = ((sums > 0).all(axis=0) | (sums < 0).all(axis=0)) & (
            layout.kind != "anchor"
        )
        agreement = (known * sums)[(known != 0) & (sums != 0) & ~still]
        if not len(agreement):
            return 1.0
        ratios = agreement.astype(np.float64)
        found = minimize_scalar(
            lambda scale: np.logaddexp(0.0, -scale * ratios).sum(),
            bounds=WORTH_RANGE,
            method="bounded",
        )
        return float(found.x)


class Combiner:
    """Adds the frames of each symbol up, and gives blocks that are over; it never holds more than three.

    Args:
        layout: where the known cells are, and what they show.

    Example:
        >>> from vocc_torch.extras.messages.signalling import MessagePlan, PanelShape, Signalling
        >>> layout = Layout(MessagePlan(PanelShape(8, 8), Signalling()))
        >>> combiner, seen = Combiner(layout), 5.0 * layout.known.repeat(2, axis=0)  # two frames a symbol
        >>> blocks = [*combiner.push(seen, [None] * 256), *combiner.finish()]
        >>> [(block.number, float(block.counts.mean())) for block in blocks]
        [(0, 2.0)]
    """

    def __init__(self, layout: Layout) -> None:
        self.layout, self.clock = layout, SymbolClock(layout)
        self._open: dict[int, Block] = {}

    def push(self, llr: Singles, times_s: Sequence[float | None]) -> Iterator[Block]:
        """Take frames in and give the blocks that are over.

        Args:
            llr: (F,R,C) log-likelihood ratios, log P(On) / P(Off); zeros for a frame that shows no panel.
            times_s: when each was taken, s, or None.
        """
        if (ticks := self.clock.push(llr, times_s)) is not None:
            yield from self._over(self._combined(ticks))

    def finish(self) -> Iterator[Block]:
        """Give what is left."""
        if (ticks := self.clock.finish()) is not None:
            self._combined(ticks)
        yield from self._over(math.inf)

    def _combined(self, ticks: Ticks) -> int:
        """Add settled frames to their symbols, and give the block of the last one."""
        layout, rows = self.layout, self.layout.band_of_row
        weights = judged(ticks.agreement)
        blocks, symbols = np.divmod(ticks.symbol, layout.symbols)
        for number in np.unique(blocks).tolist():
            here = blocks == number
            if number not in self._open:
                begun = ticks.times_s[int(here.any(axis=1).argmax())]
                sums = np.zeros((layout.symbols, *layout.kind.shape), dtype=np.float32)
                counts = np.zeros((layout.symbols, layout.bands), dtype=np.int32)
                self._open[number] = Block(number, begun, sums, counts)
            block, weight = self._open[number], np.where(here, weights, 0)
            np.add.at(block.counts, (symbols, np.arange(layout.bands)), weight > 0)
            part, places = np.zeros_like(block.sums), np.arange(len(rows))
            weighted = ticks.llr * weight[:, rows, None]
            np.add.at(part, (symbols[:, rows], places), weighted)
            block.sums[:] += part
        return int(blocks[-1].min())

    def _over(self, before: float) -> Iterator[Block]:
        """Give the blocks before one; those of hardly any frame are none."""
        for number in sorted(self._open):
            if number < before:
                block = self._open.pop(number)
                if (block.counts == 0).mean() <= HARDLY:
                    yield block


def judged(agreement: Singles) -> Singles:
    """Weigh the bands of frames by whether they show the one symbol that they are taken for, (F,B).

    A band whose clock cell does not agree counts little, which matters only where no other frame shows its
    symbol, and nothing where most of the frame's other bands do not agree either. Where a band's clock cell
    is hidden or dead, the other bands speak for it.

    Example:
        >>> agreement = np.full((64, 3), 5.0, dtype=np.float32)
        >>> agreement[8, :2], agreement[9, 0], agreement[:, 2] = 0.5, 0.5, 0.0  # and a dead clock cell
        >>> judged(agreement)[7:10].tolist()
        [[1.0, 1.0, 1.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    """
    weights = np.zeros(agreement.shape, dtype=np.float32)
    if not agreement.any():
        return weights
    share = np.clip(agreement / np.median(np.abs(agreement[agreement != 0])), -1, 1)
    good = share > MIXED_SHARE
    heard = uniform_filter1d(share, NEARBY, axis=0, mode="nearest") > DEAF_SHARE
    others = ((good & heard).sum(axis=1) > heard.sum(axis=1) / 2)[:, None]
    weights[np.broadcast_to(others, good.shape)] = WEAK
    weights[np.where(heard, good, others)] = 1.0
    return weights
