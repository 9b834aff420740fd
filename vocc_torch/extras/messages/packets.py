"""Packets: which part of which message, and a checksum; and messages put together from them."""

import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

from vocc_torch.errors import VoccError

HEADER = struct.Struct(">III")
"""Sequence number, bytes of the whole message, CRC-32 of the whole message."""

CHECK_BYTES = 4
OVERHEAD_BYTES = HEADER.size + CHECK_BYTES
MOST_BYTES = 1 << 31


class Packet(NamedTuple):
    """One part of a message.

    Args:
        sequence: its number, from 0.
        length: bytes of the whole message.
        crc: CRC-32 of the whole message.
        payload: its bytes.
    """

    sequence: int
    length: int
    crc: int
    payload: bytes


def payload_bytes(info_bytes: int) -> int:
    """Give how many bytes of a message a packet of ``info_bytes`` carries.

    Raises:
        VoccError: no room for any.
    """
    if info_bytes <= OVERHEAD_BYTES:
        raise VoccError(
            f"a packet of {info_bytes} bytes has no room beside {OVERHEAD_BYTES} of header and checksum: "
            "raise transmit.code_rate or transmit.block_symbols"
        )
    return info_bytes - OVERHEAD_BYTES


def with_checksum(body: bytes) -> bytes:
    """Append the CRC-32 of bytes."""
    return body + zlib.crc32(body).to_bytes(CHECK_BYTES, "big")


def packed(message: bytes, info_bytes: int) -> Iterator[bytes]:
    """Cut a message into packets of ``info_bytes`` each, the last one filled up with zeros.

    Args:
        message: at least 1 byte.
        info_bytes: of each packet.

    Example:
        >>> sent = list(packed(b"a message", 20))
        >>> [unpacked(one).payload for one in sent]
        [b'a me', b'ssag', b'e']
    """
    if not 0 < len(message) <= MOST_BYTES:
        raise VoccError.of("input", f"of {len(message)} bytes", f"of 1 to {MOST_BYTES}")
    size, crc = payload_bytes(info_bytes), zlib.crc32(message)
    for sequence, begin in enumerate(range(0, len(message), size)):
        payload = message[begin : begin + size].ljust(size, b"\0")
        yield with_checksum(HEADER.pack(sequence, len(message), crc) + payload)


def unpacked(info: bytes) -> Packet | None:
    """Read a packet; None where its checksum, its number or its filling do not fit.

    Example:
        >>> unpacked(bytes(20)) is None
        True
    """
    body = info[:-CHECK_BYTES]
    if with_checksum(body) != info:
        return None
    sequence, length, crc = HEADER.unpack_from(body)
    payload = body[HEADER.size :]
    used = min(len(payload), length - sequence * len(payload))
    if used <= 0 or length > MOST_BYTES or any(payload[used:]):
        return None
    return Packet(sequence, length, crc, payload[:used])


@dataclass
class Message:
    """The arrived packets of one message. Their number, not the stated length, bounds the memory.

    Args:
        length: bytes of the whole message, as its packets say.
        crc: CRC-32 of the whole message, likewise.
        payload: bytes of a packet.
        parts: payloads by sequence number.
        contradictions: packets whose payload differs from the first of the same number.
    """

    length: int
    crc: int
    payload: int
    parts: dict[int, bytes] = field(default_factory=dict)
    contradictions: int = 0

    @property
    def packets(self) -> int:
        """Packets of the whole message."""
        return -(-self.length // self.payload)

    @property
    def gaps(self) -> list[tuple[int, int]]:
        """First and last sequence number of each run of missing packets.

        Example:
            >>> Message(14, 0, 2, {0: b"ab", 3: b"cd", 4: b"ef"}).gaps
            [(1, 2), (5, 6)]
        """
        numbers = [-1, *sorted(self.parts), self.packets]
        return [(a + 1, b - 1) for a, b in pairwise(numbers) if b > a + 1]

    @property
    def content(self) -> bytes:
        """The parts that arrived, in order and without holes."""
        return b"".join(self.parts[number] for number in sorted(self.parts))

    @property
    def complete(self) -> bool:
        """Whether all packets arrived and the message's own checksum fits."""
        return len(self.parts) == self.packets and zlib.crc32(self.content) == self.crc


def messages_of(packets: Iterable[Packet], payload: int) -> list[Message]:
    """Sort packets by message: complete ones first, then by how many packets of them arrived.

    The first payload of a number stays: a packet whose checksum is right may still contradict another one.

    Args:
        packets: as they arrived.
        payload: bytes of a message in a packet.
    """
    messages: dict[tuple[int, int], Message] = {}
    for packet in packets:
        name = packet.length, packet.crc
        message = messages.setdefault(name, Message(*name, payload))
        first = message.parts.setdefault(packet.sequence, packet.payload)
        message.contradictions += first != packet.payload
    return sorted(
        messages.values(),
        key=lambda message: (not message.complete, -len(message.parts)),
    )
