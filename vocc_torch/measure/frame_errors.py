"""What every receiver got wrong in each of the same frames; counts and comparisons follow from it."""

import math
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from vocc_torch.arrays import Bools, Integers
from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.paired import PairedCounts

Pairs = dict[tuple[int, int], PairedCounts]
"""Comparisons by the places (a, b) of two receivers, a before b."""


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


class FrameErrors:
    """Errors of L receivers in each of the same N frames of one kind of scenes.

    Args:
        numbers: (3L+1,N) int64. L rows of wrong bits, times two, 0 to twice ``leds``, and ``leds`` if no
            panel was found. L rows with 1 if the receiver's locator found the panel. L rows with 1 if the
            panel was missed or has a corner too far off. The last row is the group of each frame, 0 without
            groups.
        leds: bits in a frame, at least 1.
        keys: whose errors the L rows are; none where rows are known by their places alone.

    Example:
        >>> half, found = np.array([[4, 0, 64], [0, 2, 64]]), np.array([[1, 1, 0]] * 2)
        >>> errors = FrameErrors(np.vstack([half, found, 1 - found, [0, 0, 0]]), leds=64)
        >>> [counts.half_errors for counts in errors.counts]
        [68, 66]
        >>> errors.pairs[0, 1].half_difference, errors.pairs[0, 1].discordant
        (2, 2)
    """

    def __init__(self, numbers: Integers, leds: int, keys: Sequence[Key] = ()) -> None:
        self.numbers, self.leds, self.keys = numbers, leds, tuple(keys)
        self.groups = numbers[-1]
        self.table = numbers[:-1].reshape(3, len(numbers) // 3, numbers.shape[1])
        self.half_errors, self.found, self.misplaced = self.table

    @classmethod
    def joined(cls, parts: Iterable[Self]) -> Self:
        """Join parts with the same receivers, at least one: the frames of the first, then of the second."""
        first, *others = parts
        numbers = np.hstack([part.numbers for part in (first, *others)])
        return cls(numbers, first.leds, first.keys)

    @classmethod
    def stacked(cls, parts: Sequence[Self]) -> Self:
        """Join the rows of parts with the same frames, at least one."""
        rows = np.concatenate([part.table for part in parts], axis=1)
        return cls(np.vstack([*rows, parts[0].groups]), parts[0].leds)

    def packed(self) -> bytes:
        """Write the numbers as bytes; leds and keys are not among them."""
        return zlib.compress(self.numbers.astype("<i4").tobytes(), level=1)

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
        shape = 3 * len(keys) + 1, frames
        try:
            size = 4 * math.prod(shape) + 1
            unzipped = zlib.decompressobj().decompress(content, size)
            numbers = np.frombuffer(unzipped, "<i4").reshape(shape).astype(np.int64)
        except (zlib.error, ValueError) as error:
            raise VoccError(
                f"counts of {len(keys)} receivers in {frames} frames cannot be read: {error}"
            ) from None
        errors = cls(numbers, leds, keys)
        most = np.array([2 * leds, 1, 1])[:, None, None]
        if ((errors.table < 0) | (errors.table > most)).any():
            raise VoccError(f"counts have a frame with more wrong bits than its {leds}")
        return errors

    def of(
        self,
        receivers: slice | Sequence[int] = slice(None),
        frames: slice | Bools = slice(None),
    ) -> Self:
        """Give the same of some receivers, by their places, and of some frames, by place or where True."""
        table = self.table[:, receivers, :][:, :, frames]
        places = np.arange(len(self.keys))
        keys = [self.keys[place] for place in places[receivers]] if self.keys else []
        numbers = np.vstack([*table, self.groups[frames]])
        return type(self)(numbers, self.leds, keys)

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
        first = trainings[0]
        halves = np.sum([training.half_errors for training in trainings], axis=0)
        found = np.min([training.found for training in trainings], axis=0)
        numbers = np.vstack([halves, found, first.misplaced, first.groups])
        return cls(numbers, first.leds * len(trainings), first.keys)

    @cached_property
    def counts(self) -> list[Counts]:
        """Errors of each receiver, in the order of the rows."""
        frames = self.half_errors.shape[1]
        missed = frames - self.found.sum(axis=1, keepdims=True)
        off = [self.misplaced, self.half_errors * self.misplaced]
        of_location = np.sum(off, axis=2).T
        rows = np.hstack([_sums(self.half_errors), missed, of_location]).tolist()
        return [Counts(frames, frames * self.leds, *sums) for sums in rows]

    @cached_property
    def pairs(self) -> Pairs:
        """Comparisons by the places (a, b), a before b.

        All in one pass, at a small part of the time: 16 receivers make 120 pairs.
        """
        receivers, frames = self.half_errors.shape
        first, second = np.triu_indices(receivers, k=1)
        apart = self.half_errors[first] - self.half_errors[second]
        sides = np.hstack(
            [_sums(np.maximum(apart, 0)), _sums(np.maximum(-apart, 0))]
        ).tolist()
        places = zip(first.tolist(), second.tolist(), sides, strict=True)
        return {
            (a, b): PairedCounts(frames, frames * self.leds, *sums)
            for a, b, sums in places
        }


def _sums(errors: Integers) -> Integers:
    """Give the sum, the sum of squares and the number above 0 of each row, (L,3)."""
    squared = np.einsum("ln,ln->l", errors, errors)
    return np.stack(
        [errors.sum(axis=1), squared, np.count_nonzero(errors, axis=1)], axis=1
    )
