"""From soft values of camera frames to blocks of symbols: the frames of a symbol add up."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize_scalar

from vocc_torch.arrays import Singles
from vocc_torch.extras.messages.clock import SoftFrames, SymbolClock
from vocc_torch.extras.messages.layout import Layout


@dataclass(frozen=True)
class CombineSettings:
    """How frames are weighed, and which cells count."""

    mixed_share: float = 0.3  # of the usual agreement; a band below shows two symbols
    # Of the agreement on average; a clock cell below is hidden or dead.
    deaf_share: float = 0.3
    nearby_frames: int = 32  # over which agreement is averaged
    stuck_symbols: int = 16  # a cell alike in so many in a row is hidden or dead
    least_scale: float = 0.01  # of log-likelihood ratios
    most_scale: float = 4.0
    weak_weight: float = 0.1  # of a band that does not agree, in a frame that does


SETTINGS = CombineSettings()


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
        """Give log-likelihood ratios (P,R,C); zeros for cells that are hidden or dead.

        Scores are of any size, and far from what a receiver learned, or where frames of a symbol err
        together, ratios are too sure. So the sums are scaled to make the block's known cells likeliest.
        """
        known, sums = layout.known, self.sums
        still = ((sums > 0).all(axis=0) | (sums < 0).all(axis=0)) & (
            layout.kind != "anchor"
        )
        agreement = (known * sums)[(known != 0) & (sums != 0) & ~still]
        scale = 1.0
        if len(agreement):
            certain = agreement.astype(np.float64)
            found = minimize_scalar(
                lambda scale: np.logaddexp(0.0, -scale * certain).sum(),
                bounds=(SETTINGS.least_scale, SETTINGS.most_scale),
                method="bounded",
            )
            scale = float(found.x)
        sums = sums * scale
        if layout.plan.signalling.scramble:
            on = (sums >= 0).reshape(-1, SETTINGS.stuck_symbols, *sums.shape[1:])
            stuck = (on == on[:, :1]).all(axis=1) & (layout.kind == "data")
            sums[stuck.repeat(SETTINGS.stuck_symbols, axis=0)] = 0
        return sums


def blocks_of(layout: Layout, recording: Iterable[SoftFrames]) -> Iterator[Block]:
    """Add the frames of each symbol up, and give blocks as they are over; never more than three are held.

    Args:
        layout: where the known cells are, and what they show.
        recording: its frames, some at a time.

    Example:
        >>> from vocc_torch.extras.messages.signalling import MessagePlan, PanelShape, Signalling
        >>> layout = Layout(MessagePlan(PanelShape(8, 8), Signalling()))
        >>> seen = 5.0 * layout.known.repeat(2, axis=0)  # two frames a symbol
        >>> blocks = [*blocks_of(layout, [(seen, [None] * 256)])]
        >>> [(block.number, float(block.counts.mean())) for block in blocks]
        [(0, 2.0)]
    """
    begun = {}
    rows = layout.band_of_row
    for ticks in SymbolClock(layout).ticks(recording):
        weights = judged(ticks.agreement)
        blocks, symbols = np.divmod(ticks.symbol, layout.symbols)
        for number in np.unique(blocks).tolist():
            here = blocks == number
            if number not in begun:
                time_s = ticks.times_s[int(here.any(axis=1).argmax())]
                sums = np.zeros((layout.symbols, *layout.kind.shape), dtype=np.float32)
                counts = np.zeros((layout.symbols, layout.bands), dtype=np.int32)
                begun[number] = Block(number, time_s, sums, counts)
            block, weight = begun[number], np.where(here, weights, 0)
            np.add.at(block.counts, (symbols, np.arange(layout.bands)), weight > 0)
            weighted = ticks.llr * weight[:, rows, None]
            np.add.at(block.sums, (symbols[:, rows], np.arange(len(rows))), weighted)
        yield from [
            begun.pop(number) for number in sorted(begun) if number < blocks[-1].min()
        ]
    yield from [begun[number] for number in sorted(begun)]


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
    good = share > SETTINGS.mixed_share
    heard = (
        uniform_filter1d(share, SETTINGS.nearby_frames, axis=0, mode="nearest")
        > SETTINGS.deaf_share
    )
    others = ((good & heard).sum(axis=1) > heard.sum(axis=1) / 2)[:, None]
    weights[np.broadcast_to(others, good.shape)] = SETTINGS.weak_weight
    weights[np.where(heard, good, others)] = 1.0
    return weights
