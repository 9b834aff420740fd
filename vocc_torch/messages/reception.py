"""From soft values of camera frames to packets: frames of a symbol add up, blocks are decoded and checked."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize_scalar
from scipy.special import expit

from vocc_torch.messages.clock import SymbolClock, Ticks
from vocc_torch.messages.codes import Code, code_of
from vocc_torch.messages.layout import Layout
from vocc_torch.messages.packets import Packet, packed, unpacked
from vocc_torch.messages.signalling import MessagePlan

MIXED_SHARE = 0.3
"""A band whose clock cell agrees less than this share of what is usual is taken to show two symbols."""

DEAF_SHARE, NEARBY = 0.3, 32
"""A clock cell whose agreement is less than this on average over so many frames is hidden or dead."""

STUCK_SYMBOLS = 16
"""A cell that decides alike in so many symbols in a row carries no scrambled data: it is hidden or dead."""

LEAST_WORTH = 0.01
"""Least that ratios are multiplied by."""

WEAK = 0.1
"""What a band counts whose clock cell does not agree, in a frame that does."""

HARDLY = 0.9
"""Share of a block without any frame from which on it is no block, but the begin or end of a recording."""

UNSEEN = 0.1
"""Share of a packet's bits without any frame that is told as the reason of a loss."""

COLUMNS = (
    *("block", "packet", "time_s", "frames", "unseen", "sequence", "arrived"),
    *("corrected", "expected_errors", "why"),
)
"""Columns of ``report.csv``."""


@dataclass(frozen=True)
class Received:
    """What happened to one packet.

    Args:
        block: number of its block since the recording's begin.
        place: its number in the block.
        time_s: when the block's first frame was taken, or None.
        frames: frames that each of its bits was read from, on average.
        unseen: share of its bits that no frame showed.
        packet: what it holds, or None.
        corrected: wrong bits before the code, counted where the packet arrived.
        expected_errors: wrong bits before the code that the soft values let expect.
        why: why it was lost; empty where it arrived.
    """

    block: int
    place: int
    time_s: float | None
    frames: float
    unseen: float
    packet: Packet | None
    corrected: int | None
    expected_errors: float
    why: str

    def row(self) -> list[str | int | float | None]:
        """The packet's row of ``report.csv``."""
        time_s = None if self.time_s is None else f"{self.time_s:.4f}"
        sequence = None if self.packet is None else self.packet.sequence
        told = f"{self.frames:.2f}", f"{self.unseen:.4f}", sequence, int(self.packet is not None)
        return [
            *(self.block, self.place, time_s, *told),
            *(self.corrected, f"{self.expected_errors:.1f}", self.why),
        ]


def film_of(message: bytes, plan: MessagePlan) -> NDArray[np.bool_]:
    """Write a message as the symbols of a panel.

    Args:
        message: at least 1 byte.
        plan: how.

    Returns:
        (N,R,C) bool, whole blocks; what is left of the last one repeats the first packets.

    Example:
        >>> from vocc_torch.messages.signalling import PanelShape, Signalling
        >>> film_of(b"hello", MessagePlan(PanelShape(8, 8), Signalling(code="none"))).shape
        (128, 8, 8)
    """
    layout = Layout(plan)
    code = code_of(layout)
    infos = list(packed(message, code.info_bytes))
    infos += [infos[n % len(infos)] for n in range(-len(infos) % layout.packets)]
    words = code.encode(np.stack([np.frombuffer(info, np.uint8) for info in infos]))
    blocks = words.reshape(-1, layout.packets, layout.word_bits)
    return np.concatenate([layout.write(block) for block in blocks])


def judged(agreement: NDArray[np.float32]) -> NDArray[np.float32]:
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


class Reception:
    """Receives a message from soft values, as they come; what it holds does not grow with the recording.

    Args:
        plan: how the message was written.

    Example:
        >>> from vocc_torch.messages.signalling import PanelShape, Signalling
        >>> plan = MessagePlan(PanelShape(8, 8), Signalling(code="none"))
        >>> seen = film_of(b"hello", plan).repeat(2, axis=0) * 12.0 - 6.0
        >>> reception = Reception(plan)
        >>> got = [*reception.push(seen, [None] * len(seen)), *reception.finish()]
        >>> [one.packet.payload for one in got if one.packet][0]
        b'hello'
    """

    def __init__(self, plan: MessagePlan) -> None:
        self.plan, self.layout = plan, Layout(plan)
        self.code: Code = code_of(self.layout)
        self.clock = SymbolClock(self.layout)
        self.used = self.passed_over = 0
        self._waiting: list[tuple[NDArray[np.float32], float | None]] = []
        self._sums: dict[int, NDArray[np.float32]] = {}
        self._counts: dict[int, NDArray[np.int32]] = {}
        self._begun: dict[int, float | None] = {}

    def push(self, llr: NDArray[np.float32], times_s: Sequence[float | None]) -> Iterator[Received]:
        """Take frames in and give the packets of blocks that are over.

        Args:
            llr: (F,R,C) log-likelihood ratios, log P(On) / P(Off); zeros for a frame that shows no panel.
            times_s: when each was taken, s, or None.
        """
        # A copy: a batch's array would be kept for a frame of it.
        self._waiting += zip(np.array(llr, dtype=np.float32), times_s, strict=True)
        yield from self._combined(self.clock.push(llr, times_s))

    def finish(self) -> Iterator[Received]:
        """Give the packets of what is left."""
        yield from self._combined(self.clock.finish())
        for block in sorted(self._sums):
            yield from self._decoded(block)

    def _combined(self, ticks: Ticks | None) -> Iterator[Received]:
        """Add settled frames to their symbols."""
        if ticks is None:
            return
        count, symbols = len(ticks.symbol), self.layout.symbols
        taken, self._waiting = self._waiting[:count], self._waiting[count:]
        llr = np.stack([one for one, _ in taken])
        weights = judged(ticks.agreement)
        self.used += int((weights == 1).sum())
        self.passed_over += int((weights < 1).sum())
        blocks = ticks.symbol // symbols
        for block in np.unique(blocks):
            if block not in self._sums:
                self._sums[block] = np.zeros((symbols, *self.layout.kind.shape), dtype=np.float32)
                self._counts[block] = np.zeros((symbols, self.layout.bands), dtype=np.int32)
                self._begun[block] = taken[int((blocks == block).any(axis=1).argmax())][1]
            for band in range(self.layout.bands):
                rows = self.layout.band_of_row == band
                frames = np.flatnonzero((blocks[:, band] == block) & (weights[:, band] > 0))
                index = ticks.symbol[frames, band] % symbols
                np.add.at(self._counts[block][:, band], index, 1)
                where = np.ix_(frames, rows)
                part = np.zeros((symbols, int(rows.sum()), llr.shape[2]), dtype=np.float32)
                np.add.at(part, index, llr[where] * weights[frames, band, None, None])
                self._sums[block][:, rows] += part
        for block in sorted(one for one in self._sums if one < blocks[-1].min()):
            yield from self._decoded(block)

    def _worth(self, sums: NDArray[np.float32]) -> float:
        """Say by what a block's ratios are to be multiplied, at most 1, to make its known cells likeliest.

        Far from what a receiver learned, and where frames of a symbol err together, ratios are too sure.
        """
        known = self.layout.known
        stuck = ((sums > 0).all(axis=0) | (sums < 0).all(axis=0)) & (self.layout.kind != "anchor")
        agreement = (known * sums)[(known != 0) & (sums != 0) & ~stuck]
        if not len(agreement):
            return 1.0

        def unlikely(scale: float) -> float:
            return float(np.logaddexp(0.0, -scale * agreement.astype(np.float64)).sum())

        return float(minimize_scalar(unlikely, bounds=(LEAST_WORTH, 1.0), method="bounded").x)

    def _decoded(self, block: int) -> Iterator[Received]:
        """Decode a block and forget it."""
        sums, counts, begun = self._sums.pop(block), self._counts.pop(block), self._begun.pop(block)
        if (counts == 0).mean() > HARDLY:
            return
        if self.plan.signalling.scramble:
            on = (sums >= 0).reshape(-1, STUCK_SYMBOLS, *sums.shape[1:])
            stuck = (on == on[:, :1]).all(axis=1) & (self.layout.kind == "data")
            sums[stuck.repeat(STUCK_SYMBOLS, axis=0)] = 0
        words = self.layout.read(sums * self._worth(sums))
        each = counts[:, self.layout.band_of_row, None].repeat(sums.shape[2], axis=2)
        frames = self.layout.take(each.astype(np.float32))
        for place, (info, word, seen) in enumerate(zip(self.code.decode(words), words, frames, strict=True)):
            packet = None if info is None else unpacked(info)
            unseen, expected = float((seen == 0).mean()), float(expit(-np.abs(word)).sum())
            corrected, why = None, ""
            if packet is not None and info is not None:
                sent = self.code.encode(np.frombuffer(info, np.uint8)[None])[0]
                corrected = int(((word >= 0) != sent.astype(bool))[: len(sent)].sum())
            elif unseen > UNSEEN:
                why = f"{unseen:.0%} of its bits were in no frame"
            else:
                why = "too many wrong bits" if info is None else "its checksum does not fit"
            mean = float(seen.mean())
            yield Received(int(block), place, begun, mean, unseen, packet, corrected, expected, why)
