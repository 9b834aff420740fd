"""Which cell of which symbol is known to the receiver, and which carries which bit of which packet."""

import hashlib
import math
from copy import copy
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.signal import max_len_seq

from vocc_torch.arrays import Bools, Bytes, Integers, Numbers, Singles
from vocc_torch.errors import VoccError
from vocc_torch.extras.messages.codes import LONGEST_WORD, Code, code_of
from vocc_torch.extras.messages.signalling import ORDERS, MessagePlan


def stream(name: str, count: int) -> Bytes:
    """Derive random bytes from a name that sender and receiver know: SHAKE-128.

    Example:
        >>> stream("scramble", 3).tolist()
        [136, 5, 252]
    """
    return np.frombuffer(
        hashlib.shake_128(f"vocc_torch {name}".encode()).digest(count), np.uint8
    )


def sync_bits(order: int) -> Bools:
    """Give a de Bruijn sequence: of its 2^order bits in a circle any ``order`` in a row occur once.

    Source: a maximal-length sequence (scipy.signal.max_len_seq) with a 0 added to its longest run of 0.

    Example:
        >>> "".join(map(str, sync_bits(3).astype(int)))
        '00011101'
    """
    bits = max_len_seq(order)[0]
    doubled = "".join(map(str, [*bits, *bits]))
    begin = doubled.index("0" * (order - 1))
    return np.array([0, *np.roll(bits, -begin)], dtype=bool)


class Layout:
    """Every cell of a block of P symbols: known ones, and the places of packets' bits.

    - Anchors: the corners, always On. A receiver finds the panel's extent by them.
    - Clock: a cell in each band of rows that is the other in each symbol. Where a camera's exposure caught
      two symbols, or its shutter passes from one to the next, the bands say so.
    - Sync: where in its block a symbol stands: cells with a sequence that is told by a few of its bits, and
      each second one with that turned over in two symbols of four, so that a symbol that no frame shows is
      missed at once. Either alone will do.
    - The rest carries packets: ``packets`` words of ``word_bits`` each, spread over all of the block where
      they are interleaved. The eight bits of a byte keep to one cell in eight symbols that follow each other
      where the code corrects bytes: a dead cell then hits no more bytes than it must.

    Args:
        plan: the panel's shape and the options.

    Raises:
        VoccError: a panel too small for its known cells, or more bands than rows.

    Example:
        >>> from vocc_torch.extras.messages.signalling import PanelShape, Signalling
        >>> layout = Layout(MessagePlan(PanelShape(8, 8), Signalling()))
        >>> layout.packets, layout.word_bits, len(layout.data)
        (4, 1728, 54)
    """

    def __init__(self, plan: MessagePlan) -> None:
        options = plan.signalling
        rows, columns = plan.shape.sides
        self.plan, self.symbols, self.bands = plan, options.block_symbols, options.bands
        if self.bands > rows:
            raise VoccError.of(
                "transmit.bands", self.bands, f"at most the panel's rows, {rows}"
            )
        self.band_of_row = np.arange(rows) * self.bands // rows
        kind = np.full((rows, columns), "data", dtype="<U6")
        if options.anchors:
            kind[[0, 0, -1, -1], [0, -1, 0, -1]] = "anchor"
        syncs = [
            (2 * n + 1) * self.bands // (2 * options.sync_cells)
            for n in range(options.sync_cells)
        ]
        for name, bands in (("clock", range(self.bands)), ("sync", syncs)):
            for number, band in enumerate(bands):
                free = np.argwhere(
                    (kind == "data") & (self.band_of_row == band)[:, None]
                )
                if not len(free):
                    raise VoccError(
                        f"panel of {rows} x {columns} LEDs is too small: "
                        f"{self.bands} bands and {options.sync_cells} sync cells leave no data"
                    )
                kind[tuple(free[(3 * number + 2) * len(free) // 7 % len(free)])] = name
        self.kind = kind
        self.data = np.flatnonzero(kind == "data")
        capacity = self.symbols * len(self.data)  # a multiple of 8, as the symbols are
        self.packets = max(1, -(-(capacity // 8) // LONGEST_WORD))
        self.word_bits = capacity // self.packets // 8 * 8

    @cached_property
    def code(self) -> Code:
        """The code of the words.

        Raises:
            VoccError: as :func:`~vocc_torch.extras.messages.codes.code_of`.
        """
        return code_of(self.plan.signalling, self.word_bits)

    @cached_property
    def known(self) -> NDArray[np.int8]:
        """What the known cells show, (P,R,C): 1 On, -1 Off, 0 a cell that carries data."""
        index = np.arange(self.symbols)
        shown = np.zeros((self.symbols, *self.kind.shape), dtype=np.int8)
        shown[:, self.kind == "anchor"] = 1
        shown[:, self.kind == "clock"] = (2 * (index % 2) - 1)[:, None]
        places = sync_bits(ORDERS[self.symbols]).astype(np.int8)
        signs = places, places ^ (index // 2 % 2)
        for number, (row, column) in enumerate(np.argwhere(self.kind == "sync")):
            shown[:, row, column] = 2 * signs[number % 2] - 1
        return shown

    @cached_property
    def places(self) -> Integers:
        """Where the bits of the block's words stand, (packets, word_bits), in (P,R,C) flattened."""
        unit = 8 if self.plan.signalling.code == "rs" else 1
        cells = np.arange(self.symbols)[:, None] * self.kind.size + self.data
        groups = (
            cells.reshape(-1, unit, len(self.data)).swapaxes(1, 2).reshape(-1, unit)
        )
        if self.plan.signalling.interleave:
            keys = stream("interleave", 8 * len(groups)).view("<u8")
            groups = groups[np.argsort(keys, kind="stable")]
        size = self.packets, self.word_bits
        return groups.ravel()[: math.prod(size)].reshape(size)

    @cached_property
    def _blank(self) -> Bools:
        """A block without words, (P,R,C): known cells, and random ones that sender and receiver know."""
        film = self.known > 0
        cells = film.reshape(self.symbols, -1)
        random = np.unpackbits(stream("scramble", self.symbols * len(self.data) // 8))
        cells[:, self.data] = random.reshape(self.symbols, -1)
        return film

    @cached_property
    def _mask(self) -> Numbers:
        """The bits by which words are scrambled, (packets, word_bits)."""
        return self.take(self._blank) * self.plan.signalling.scramble

    def write(self, words: Bytes) -> Bools:
        """Write a block's code words (packets, word_bits) on its symbols, (P,R,C); other cells are random."""
        film = self._blank.copy()
        film.ravel()[self.places] = words ^ self._mask
        return film

    def rescrambled(self, words: Bytes, shown: Bools) -> Self:
        """Give the layout with the scrambling by which a block that shows ``shown`` (P,R,C) has ``words``.

        So any random film is the film of any code, and codes are compared on the same recordings.
        """
        twin = copy(self)
        twin._mask = words ^ self.take(shown)
        return twin

    def read(self, cells: Singles) -> Singles:
        """Take the words' bits, as :meth:`write` wrote them, from soft values of a block's cells, (P,R,C)."""
        found = self.take(cells)
        return np.where(self._mask == 1, -found, found)

    def take(self, cells: Numbers) -> Numbers:
        """Take what belongs to the words' bits (packets, word_bits) from a block's cells, (P,R,C)."""
        return cells.reshape(-1)[self.places]
