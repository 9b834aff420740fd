"""From soft values of camera frames to packets: the frames of a symbol add up, blocks are decoded and checked."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize_scalar
from scipy.special import expit

from vocc_torch.arrays import Bools, Singles
from vocc_torch.extras.messages.clock import SoftFrames, SymbolClock
from vocc_torch.extras.messages.layout import Layout
from vocc_torch.extras.messages.packets import Packet, packed, unpacked
from vocc_torch.extras.messages.signalling import MessagePlan
from vocc_torch.report.folder import Cells


@dataclass(frozen=True)
class ReceptionSettings:
    """How frames are weighed, which cells count, and what is said of lost packets."""

    mixed_share: float = 0.3  # of the usual agreement; a band below shows two symbols
    # Of the agreement on average; a clock cell below is hidden or dead.
    deaf_share: float = 0.3
    nearby_frames: int = 32  # over which agreement is averaged
    stuck_symbols: int = 16  # a cell alike in so many in a row is hidden or dead
    least_scale: float = 0.01  # of log-likelihood ratios
    most_scale: float = 4.0
    weak_weight: float = 0.1  # of a band that does not agree, in a frame that does
    unseen: float = 0.1  # share of a packet's bits, beyond which it was lost by that
    hardly: float = 0.9  # share of a block without frames: an end of the recording


SETTINGS = ReceptionSettings()

COLUMNS = (
    "block",
    "packet",
    "time_s",
    "frames",
    "unseen",
    "sequence",
    "arrived",
    "corrected",
    "expected_errors",
    "why",
)
"""Columns of ``report.csv``: ``frames`` that each bit was read from on average; ``corrected``, the wrong bits
before the code of a packet that arrived, and ``expected_errors``, those that the soft values let expect."""


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
        still = (sums > 0).all(axis=0) | (sums < 0).all(axis=0)
        still &= layout.kind != "anchor"
        agreement = (known * sums)[(known != 0) & (sums != 0) & ~still]
        if len(agreement):
            certain = agreement.astype(np.float64)
            found = minimize_scalar(
                lambda scale: np.logaddexp(0.0, -scale * certain).sum(),
                bounds=(SETTINGS.least_scale, SETTINGS.most_scale),
                method="bounded",
            )
            sums = sums * float(found.x)
        if layout.plan.signalling.scramble:
            on = (sums >= 0).reshape(-1, SETTINGS.stuck_symbols, *sums.shape[1:])
            stuck = (on == on[:, :1]).all(axis=1) & (layout.kind == "data")
            sums = np.where(stuck.repeat(SETTINGS.stuck_symbols, axis=0), 0, sums)
        return sums


class Received(NamedTuple):
    """What happened to one packet.

    Args:
        block: number of its block since the recording's begin.
        place: its number in the block.
        unseen: share of its bits that no frame showed.
        packet: what it holds, or None.
        row: its cells of ``report.csv``.
    """

    block: int
    place: int
    unseen: float
    packet: Packet | None
    row: Cells


def film_of(message: bytes, plan: MessagePlan) -> Bools:
    """Write a message as the symbols of a panel.

    Args:
        message: at least 1 byte.
        plan: how.

    Returns:
        (N,R,C) bool, whole blocks; what is left of the last one repeats the first packets.

    Example:
        >>> from vocc_torch.extras.messages.signalling import PanelShape, Signalling
        >>> film_of(b"hello", MessagePlan(PanelShape(8, 8), Signalling(code="none"))).shape
        (128, 8, 8)
    """
    layout = Layout(plan)
    infos = list(packed(message, layout.code.info_bytes))
    infos += [infos[n % len(infos)] for n in range(-len(infos) % layout.packets)]
    blocks = layout.code.encode(infos).reshape(-1, layout.packets, layout.word_bits)
    return np.concatenate([layout.write(block) for block in blocks])


def received(layout: Layout, recording: Iterable[SoftFrames]) -> Iterator[Received]:
    """Receive packets from a stream of soft values, in constant memory.

    Example:
        >>> from vocc_torch.extras.messages.signalling import PanelShape, Signalling
        >>> plan = MessagePlan(PanelShape(8, 8), Signalling(code="none"))
        >>> seen = film_of(b"hello", plan).repeat(2, axis=0) * 12.0 - 6.0
        >>> got = received(Layout(plan), [(seen, [None] * len(seen))])
        >>> [packet.packet.payload for packet in got if packet.packet][0]
        b'hello'
    """
    for block in blocks_of(layout, recording):
        yield from decoded(block, layout)


def blocks_of(layout: Layout, recording: Iterable[SoftFrames]) -> Iterator[Block]:
    """Add the frames of each symbol up, and give blocks as they are over; never more than three are held.

    Args:
        layout: where the known cells are, and what they show.
        recording: its frames, some at a time.

    Example:
        >>> from vocc_torch.extras.messages.signalling import PanelShape, Signalling
        >>> layout = Layout(MessagePlan(PanelShape(8, 8), Signalling()))
        >>> seen = 5.0 * layout.known.repeat(2, axis=0)  # two frames a symbol
        >>> blocks = [*blocks_of(layout, [(seen, [None] * 256)])]
        >>> [(block.number, float(block.counts.mean())) for block in blocks]
        [(0, 2.0)]
    """
    begun: dict[int, Block] = {}
    band = layout.band_of_row
    for ticks in SymbolClock(layout).ticks(recording):
        weights = judged(ticks.agreement)
        blocks, symbols = np.divmod(ticks.symbol, layout.symbols)
        for number in np.unique(blocks).tolist():
            here = blocks == number
            if number not in begun:
                time_s = ticks.times_s[int(here.any(axis=1).argmax())]
                sums = np.zeros(layout.known.shape, dtype=np.float32)
                counts = np.zeros((layout.symbols, layout.bands), dtype=np.int32)
                begun[number] = Block(number, time_s, sums, counts)
            block, weight = begun[number], np.where(here, weights, 0)
            np.add.at(block.counts, (symbols, np.arange(layout.bands)), weight > 0)
            weighted = ticks.llr * weight[:, band, None]
            np.add.at(block.sums, (symbols[:, band], np.arange(len(band))), weighted)
        over = [number for number in sorted(begun) if number < blocks[-1].min()]
        yield from map(begun.pop, over)
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
    usual = uniform_filter1d(share, SETTINGS.nearby_frames, axis=0, mode="nearest")
    heard = usual > SETTINGS.deaf_share
    others = (good & heard).sum(axis=1) > heard.sum(axis=1) / 2
    weights[others] = SETTINGS.weak_weight
    weights[np.where(heard, good, others[:, None])] = 1.0
    return weights


def decoded(block: Block, layout: Layout) -> Iterator[Received]:
    """Decode the packets of a block.

    Args:
        block: what its frames show.
        layout: where its packets are, and their code.
    """
    if (block.counts == 0).mean() > SETTINGS.hardly:
        return
    words = layout.read(block.ratios(layout))
    counts = block.counts[:, layout.band_of_row, None].astype(np.float32)
    frames = layout.take(np.broadcast_to(counts, block.sums.shape))
    infos = layout.code.decode(words)
    for place, (info, word, count) in enumerate(zip(infos, words, frames, strict=True)):
        packet = None if info is None else unpacked(info)
        unseen = float((count == 0).mean())
        sequence = corrected = None
        why = "too many wrong bits" if info is None else "its checksum does not fit"
        if packet is not None and info is not None:
            sequence, why = packet.sequence, ""
            corrected = int(((word >= 0) != layout.code.encode([info])[0]).sum())
        elif unseen > SETTINGS.unseen:
            why = f"no frame showed {100 * unseen:.0f} % of its bits clearly"
        row = (
            block.number,
            place,
            None if block.time_s is None else f"{block.time_s:.4f}",
            f"{count.mean():.2f}",
            f"{unseen:.4f}",
            sequence,
            int(packet is not None),
            corrected,
            f"{expit(-np.abs(word)).sum():.1f}",
            why,
        )
        yield Received(block.number, place, unseen, packet, row)
