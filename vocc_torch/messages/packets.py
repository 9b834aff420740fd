"""Packets: which part of which message, and a checksum; and a message put together from them."""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field

from vocc_torch.errors import VoccError

HEADER = struct.Struct(">III")
"""Sequence number, bytes of the whole message, CRC-32 of the whole message."""

CHECK_BYTES = 4
OVERHEAD_BYTES = HEADER.size + CHECK_BYTES
MOST_BYTES = 1 << 31


@dataclass(frozen=True, slots=True)
class Packet:
    """One part of a message.

    Args:
        sequence: its number, from 0.
        message: length in bytes and CRC-32 of the message that it belongs to.
        payload: its bytes.
    """

    sequence: int
    message: tuple[int, int]
    payload: bytes


def payload_bytes(info_bytes: int) -> int:
    """Give how many bytes of a message a packet of ``info_bytes`` carries.

    Raises:
        VoccError: none.
    """
    if info_bytes <= OVERHEAD_BYTES:
        said = f"a packet of {info_bytes} bytes has no room beside {OVERHEAD_BYTES} of header and checksum"
        raise VoccError(f"{said}: raise transmit.code_rate or transmit.block_symbols")
    return info_bytes - OVERHEAD_BYTES


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
    size = payload_bytes(info_bytes)
    for sequence, begin in enumerate(range(0, len(message), size)):
        head = HEADER.pack(sequence, len(message), zlib.crc32(message))
        body = head + message[begin : begin + size].ljust(size, b"\0")
        yield body + zlib.crc32(body).to_bytes(CHECK_BYTES, "big")


def unpacked(info: bytes) -> Packet | None:
    """Read a packet; None where its checksum, its number or its filling do not fit.

    Example:
        >>> unpacked(bytes(20)) is None
        True
    """
    body, check = info[:-CHECK_BYTES], info[-CHECK_BYTES:]
    if zlib.crc32(body).to_bytes(CHECK_BYTES, "big") != check:
        return None
    sequence, length, crc = HEADER.unpack(body[: HEADER.size])
    payload = body[HEADER.size :]
    used = min(len(payload), length - sequence * len(payload))
    if used <= 0 or length > MOST_BYTES or any(payload[used:]):
        return None
    return Packet(sequence, (length, crc), payload[:used])


@dataclass
class Assembly:
    """Puts messages together from packets in any order; only what a checksum vouched for is in it.

    Args:
        parts: payloads by message and sequence number.
    """

    parts: dict[tuple[int, int], dict[int, bytes]] = field(default_factory=dict)

    def add(self, packet: Packet) -> None:
        """Take a packet in."""
        self.parts.setdefault(packet.message, {})[packet.sequence] = packet.payload

    @property
    def message(self) -> tuple[int, int] | None:
        """The message of which most was received."""
        return max(self.parts, key=lambda one: len(self.parts[one]), default=None)

    def missing(self, info_bytes: int) -> list[int]:
        """Give the sequence numbers of that message that were not received."""
        if self.message is None:
            return []
        count = -(-self.message[0] // payload_bytes(info_bytes))
        return sorted(set(range(count)) - set(self.parts[self.message]))

    def whole(self, info_bytes: int) -> bytes | None:
        """Give the message, if all of it is there and its own checksum agrees."""
        if self.message is None or self.missing(info_bytes):
            return None
        joined = self.partial(info_bytes)
        return joined if zlib.crc32(joined) == self.message[1] else None

    def partial(self, info_bytes: int) -> bytes:
        """Give what there is, with zeros for what is missing."""
        assert self.message is not None
        joined, size = bytearray(self.message[0]), payload_bytes(info_bytes)
        for sequence, payload in self.parts[self.message].items():
            joined[sequence * size : sequence * size + len(payload)] = payload
        return bytes(joined)
