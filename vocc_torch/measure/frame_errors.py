"""What every receiver got wrong in each of the same frames; counts and comparisons follow from it."""

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from vocc_torch.arrays import Bools, Integers
from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.paired import PairedCounts


@dataclass(frozen=True, slots=True)
class Key:
    """Whose errors a row holds.

    Args:
        locator: where the panel's corners came from.
        receiver: what decided.
        training: number of the training that it had, from 0 on.
    """

    locator: str
    receiver: str
    training: int = 0


@dataclass(eq=False)
class FrameErrors:
    """Errors of L receivers in each of the same N frames of one kind of scenes.

    Args:
        table: (3,L,N) int64. First wrong bits, times two: 0 to twice ``leds``, and ``leds`` if no panel was
            found. Then 1 if the receiver's locator found the panel. Last 1 if the panel was missed or has a
            corner too far off.
        groups: (N,) int64, the group of each frame, 0 without groups.
        leds: bits in a frame, at least 1.
        keys: whose errors the L rows are; none where rows are known by their places alone.

    Attributes:
        half_errors: (L,N) wrong bits, times two.
        found: (L,N) 1 where the panel was found.
        misplaced: (L,N) 1 where the panel was missed or has a corner too far off.

    Example:
        >>> half, found = np.array([[4, 0, 64], [0, 2, 64]]), np.array([[1, 1, 0]] * 2)
        >>> errors = FrameErrors(np.stack([half, found, 1 - found]), np.zeros(3, int), leds=64)
        >>> [counts.half_errors for counts in errors.counts]
        [68, 66]
        >>> errors.pair(0, 1).half_difference, errors.pair(0, 1).discordant
        (2, 2)
    """

    table: Integers
    groups: Integers
    leds: int
    keys: tuple[Key, ...] = ()

    def __post_init__(self) -> None:
        """Name the three parts of the table."""
        self.half_errors, self.found, self.misplaced = self.table

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Join parts with the same receivers, at least one: the frames of the first, then of the second."""
        table = np.concatenate([part.table for part in parts], axis=2)
        groups = np.concatenate([part.groups for part in parts])
        return replace(parts[0], table=table, groups=groups)

    @classmethod
    def stacked(cls, parts: Sequence[Self]) -> Self:
        """Join the rows of parts with the same frames, at least one."""
        table = np.concatenate([part.table for part in parts], axis=1)
        return replace(parts[0], table=table, keys=())

    def packed(self) -> bytes:
        """Write the numbers as bytes; leds and keys are not among them."""
        numbers = np.concatenate([self.table.ravel(), self.groups])
        return zlib.compress(numbers.astype("<i4").tobytes(), level=1)

    @classmethod
    def unpacked(
        cls, content: bytes, frames: int, leds: int, keys: Sequence[Key]
    ) -> Self:
        """Read what :meth:`packed` wrote.

        Args:
            content: the bytes.
            frames: how many there are.
            leds: bits in a frame.
            keys: whose errors the rows are.

        Raises:
            VoccError: bytes that no such frames can give.
        """
        rows = 3 * len(keys) + 1
        try:
            # A byte more than there may be shows bytes that are too many.
            size = 4 * rows * frames + 1
            unzipped = zlib.decompressobj().decompress(content, size)
            numbers = np.frombuffer(unzipped, "<i4").reshape(rows, frames)
        except (zlib.error, ValueError) as error:
            raise VoccError(
                f"counts of {len(keys)} receivers in {frames} frames cannot be read: {error}"
            ) from None
        *table, groups = numbers.astype(np.int64)
        shaped = np.reshape(table, (3, len(keys), frames))
        most = np.array([2 * leds, 1, 1])[:, None, None]
        if ((shaped < 0) | (shaped > most)).any():
            raise VoccError(f"counts have a frame with more wrong bits than its {leds}")
        return cls(shaped, groups, leds, tuple(keys))

    def of(
        self,
        receivers: slice | Sequence[int] = slice(None),
        frames: slice | Bools = slice(None),
    ) -> Self:
        """Give the same of some receivers, by their places, and of some frames, by place or where True."""
        table = self.table[:, receivers][:, :, frames]
        places = np.arange(len(self.keys))
        keys = tuple(self.keys[place] for place in places[receivers] if self.keys)
        return replace(self, table=table, groups=self.groups[frames], keys=keys)

    def place(self, key: Key) -> int:
        """Give the row of a receiver; one that learns nothing is the same after each training."""
        return self.keys.index(key if key in self.keys else replace(key, training=0))

    def by_group(self) -> Iterator[tuple[int, Self]]:
        """Return the frames of each non-empty group; frames of a negative group are in none."""
        for group in np.unique(self.groups[self.groups >= 0]).tolist():
            yield group, self.of(frames=self.groups == group)

    @classmethod
    def pooled(cls, trainings: Sequence[Self]) -> Self:
        """Give the errors of several trainings together: a frame holds the bits of all of them.

        Args:
            trainings: of the same receivers on the same frames.
        """
        first, tables = trainings[0], np.stack([errors.table for errors in trainings])
        halves, found = tables[:, 0].sum(0), tables[:, 1].min(0)
        table = np.stack([halves, found, first.misplaced])
        return replace(first, table=table, leds=first.leds * len(trainings))

    @cached_property
    def counts(self) -> list[Counts]:
        """Errors of each receiver, in the order of the rows."""
        halves, found, off = self.table
        frames = halves.shape[1]
        of_location = [frames - found.sum(1), off.sum(1), (halves * off).sum(1)]
        rows = np.vstack([_sums(halves), of_location]).T.tolist()
        return [Counts(frames, frames * self.leds, *sums) for sums in rows]

    def pair(self, a: int, b: int) -> PairedCounts:
        """Compare the receivers of two rows."""
        apart = self.half_errors[a] - self.half_errors[b]
        frames, excess = len(apart), np.stack([apart, -apart]).clip(min=0)
        sums_of_sides = _sums(excess).T.tolist()
        bits = frames * self.leds
        return PairedCounts(*(Counts(frames, bits, *sums) for sums in sums_of_sides))


def _sums(errors: Integers) -> Integers:
    """Give the sum, the sum of squares and the number above 0 of each of L rows, (3,L)."""
    squares = np.einsum("ln,ln->l", errors, errors)
    return np.stack([errors.sum(1), squares, np.count_nonzero(errors, axis=1)])
