"""From soft values of camera frames to packets: blocks are decoded and checked."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from vocc_torch.arrays import Bools
from vocc_torch.extras.messages.clock import SoftFrames
from vocc_torch.extras.messages.combine import Block, blocks_of
from vocc_torch.extras.messages.layout import Layout
from vocc_torch.extras.messages.packets import Packet, packed, unpacked
from vocc_torch.extras.messages.signalling import MessagePlan
from vocc_torch.report.folder import Cells

UNSEEN = 0.1
"""Share of a packet's bits that no frame showed clearly, from which on it is the reason of a loss."""

HARDLY = 0.9
"""Share of a block without any frame from which on it is no block, but the begin or end of a recording."""

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


def decoded(block: Block, layout: Layout) -> Iterator[Received]:
    """Decode the packets of a block.

    Args:
        block: what its frames show.
        layout: where its packets are, and their code.
    """
    if (block.counts == 0).mean() > HARDLY:
        return
    words = layout.read(block.ratios(layout))
    counts = block.counts[:, layout.band_of_row, None].repeat(
        layout.kind.shape[1], axis=2
    )
    frames = layout.take(counts.astype(np.float32))
    for place, (info, word, frames_of_word) in enumerate(
        zip(layout.code.decode(words), words, frames, strict=True)
    ):
        packet = None if info is None else unpacked(info)
        unseen = float((frames_of_word == 0).mean())
        sequence = corrected = None
        why = "too many wrong bits" if info is None else "its checksum does not fit"
        if packet is not None and info is not None:
            sequence, why = packet.sequence, ""
            corrected = int(((word >= 0) != layout.code.encode([info])[0]).sum())
        elif unseen > UNSEEN:
            why = f"no frame showed {100 * unseen:.0f} % of its bits clearly"
        row = (
            block.number,
            place,
            None if block.time_s is None else f"{block.time_s:.4f}",
            f"{frames_of_word.mean():.2f}",
            f"{unseen:.4f}",
            sequence,
            int(packet is not None),
            corrected,
            f"{expit(-np.abs(word)).sum():.1f}",
            why,
        )
        yield Received(block.number, place, unseen, packet, row)
