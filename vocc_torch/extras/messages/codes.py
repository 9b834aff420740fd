"""Forward error correction by the field's libraries: words of bits from information, and back."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import torch

from vocc_torch.arrays import Bytes, Singles
from vocc_torch.errors import VoccError, library
from vocc_torch.extras.messages.signalling import Signalling

LONGEST_WORD = 255
"""Most bytes of a Reed-Solomon word."""


@dataclass(frozen=True)
class CodeSettings:
    """How words are decoded."""

    iterations: int = 20  # of belief propagation
    # Shares of the check bytes spent on erasures, tried in turn until a word decodes.
    erased_shares: tuple[float, ...] = (0.0, 0.4, 0.8)


SETTINGS = CodeSettings()


class Code:
    """A code whose words have a fixed length; this one adds nothing.

    Args:
        info_bytes: bytes of information in a word.
    """

    def __init__(self, info_bytes: int) -> None:
        self.info_bytes = info_bytes

    def encode(self, infos: Sequence[bytes]) -> Bytes:
        """Turn information of N words into their bits (N,n) uint8, 0 and 1."""
        joined = np.frombuffer(b"".join(infos), np.uint8)
        return np.unpackbits(joined.reshape(len(infos), -1), axis=1)

    def decode(self, llr: Singles) -> list[bytes | None]:
        """Turn log-likelihood ratios of words, log P(1) / P(0), (N,n), into information.

        None stands where the code knows that it failed; else a packet's checksum vouches.
        """
        return [np.packbits(word >= 0).tobytes() for word in llr]


class ReedSolomon(Code):
    """Shortened Reed-Solomon words over bytes, by reedsolo.

    Bits are decided first. Where a word has too many errors, its least sure bytes are taken for erased, which
    cost one check byte instead of two.

    Source: G. D. Forney, "Generalized minimum distance decoding", IEEE Trans. Inf. Theory 12(2), 1966.

    Args:
        word_bytes: at most 255.
        info_bytes: of these.
    """

    def __init__(self, word_bytes: int, info_bytes: int) -> None:
        need = "transmit.code is rs, which needs reedsolo"
        reedsolo = library("reedsolo", "messages", need, ", or give none")
        super().__init__(info_bytes)
        self.check_bytes = word_bytes - info_bytes
        self.codec = reedsolo.RSCodec(self.check_bytes, nsize=LONGEST_WORD)
        self.failure = reedsolo.ReedSolomonError

    def encode(self, infos: Sequence[bytes]) -> Bytes:
        """Append the check bytes, and give bits."""
        return super().encode([bytes(self.codec.encode(info)) for info in infos])

    def decode(self, llr: Singles) -> list[bytes | None]:
        """Decode words one by one."""
        return list(map(self._decoded, llr))

    def _decoded(self, word: Singles) -> bytes | None:
        """Decode one word, with the more erasures the worse it is."""
        read = np.packbits(word >= 0).tobytes()
        weakest = np.argsort(np.abs(word).reshape(-1, 8).min(axis=1), kind="stable")
        for share in SETTINGS.erased_shares:
            erased = weakest[: int(share * self.check_bytes)].tolist()
            with suppress(self.failure):
                return bytes(self.codec.decode(read, erase_pos=erased)[0])
        return None


class Ldpc(Code):
    """The 5G code for data channels, decoded by belief propagation on soft values; by Sionna.

    Source: 3GPP TS 38.212, section 5.3.2.

    Args:
        word_bits: length of a word.
        info_bytes: bytes of information.
    """

    def __init__(self, word_bits: int, info_bytes: int) -> None:
        super().__init__(info_bytes)
        need = "transmit.code is ldpc, which needs sionna-no-rt"
        fec = library("sionna.phy.fec.ldpc", "ldpc", need, ", or give rs")
        try:
            self.encoder = fec.LDPC5GEncoder(8 * info_bytes, word_bits, device="cpu")
        except ValueError as error:
            raise VoccError(
                f"transmit.code_rate does not suit ldpc: {' '.join(str(error).split())}"
            ) from None
        self.decoder = fec.LDPC5GDecoder(
            self.encoder, num_iter=SETTINGS.iterations, hard_out=True, device="cpu"
        )

    def encode(self, infos: Sequence[bytes]) -> Bytes:
        """Encode bits."""
        words = self.encoder(torch.from_numpy(super().encode(infos)).float())
        bits: Bytes = words.numpy().astype(np.uint8)
        return bits

    def decode(self, llr: Singles) -> list[bytes | None]:
        """Decode words together."""
        with torch.inference_mode():
            bits = self.decoder(torch.from_numpy(llr)).numpy().astype(np.uint8)
        return [word.tobytes() for word in np.packbits(bits, axis=1)]


def code_of(options: Signalling, word_bits: int) -> Code:
    """Build the code that a plan names, for words of so many bits.

    Raises:
        VoccError: a library that is not installed, or a rate that leaves no room for information.
    """
    word_bytes = word_bits // 8
    if options.code == "none":
        return Code(word_bytes)
    info_bytes = int(word_bytes * options.code_rate)
    if not 0 < info_bytes < word_bytes:
        raise VoccError.of(
            "transmit.code_rate", options.code_rate, f"one that fits {word_bytes} bytes"
        )
    if options.code == "rs":
        return ReedSolomon(word_bytes, info_bytes)
    return Ldpc(word_bits, info_bytes)
