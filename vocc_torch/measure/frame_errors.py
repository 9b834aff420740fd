"""What every receiver got wrong in each of the same frames; counts and comparisons follow from it."""

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

ARRAYS = ("half_errors", "found", "groups", "misplaced")


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
    """What L receivers got wrong in each of the same N frames of one kind of scenes.

    Args:
        half_errors: (L,N) int64, wrong bits, times two, 0 to twice ``leds``; ``leds`` where no panel was
            found, since every bit is then a coin toss.
        found: (L,N) bool, whether the receiver's locator found the panel.
        leds: bits in a frame, at least 1.
        groups: (N,) int64, what the frames were sorted by; all 0 by default.
        misplaced: (L,N) bool, whether the panel was missed or located off its place; nowhere by default.
        keys: whose errors the rows are; none where rows are known by their places alone.

    Example:
        >>> half = np.array([[4, 0, 64], [0, 2, 64]])
        >>> errors = FrameErrors(half, np.array([[True, True, False]] * 2), leds=64)
        >>> [counts.half_errors for counts in errors.counts]
        [68, 66]
        >>> errors.pairs[0, 1].half_difference, errors.pairs[0, 1].discordant
        (2, 2)
    """

    def __init__(
        self,
        half_errors: Integers,
        found: Bools,
        leds: int,
        groups: Integers | None = None,
        misplaced: Bools | None = None,
        keys: Sequence[Key] = (),
    ) -> None:
        frames = half_errors.shape[1]
        self.half_errors, self.found = half_errors, found
        self.leds, self.keys = leds, tuple(keys)
        self.groups = np.zeros(frames, np.int64) if groups is None else groups
        self.misplaced = np.zeros_like(found) if misplaced is None else misplaced

    @classmethod
    def joined(cls, parts: Iterable[Self]) -> Self:
        """Join parts with the same receivers, at least one: the frames of the first, then of the second."""
        first, *others = parts
        halves, found, groups, misplaced = (
            np.concatenate([getattr(part, name) for part in (first, *others)], axis=-1)
            for name in ARRAYS
        )
        return cls(halves, found, first.leds, groups, misplaced, first.keys)

    @classmethod
    def stacked(cls, parts: Sequence[Self]) -> Self:
        """Join the rows of parts with the same frames, at least one."""
        halves = np.concatenate([part.half_errors for part in parts])
        found = np.concatenate([part.found for part in parts])
        return cls(halves, found, parts[0].leds)

    def packed(self) -> bytes:
        """Write the numbers as bytes; leds and keys are not among them."""
        rows = [self.half_errors, self.found, self.misplaced, self.groups]
        table = np.vstack(rows).astype("<i4")
        return zlib.compress(table.tobytes(), level=1)

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
        rows = len(keys)
        size = 4 * frames * (3 * rows + 1)
        try:
            unzipped = zlib.decompressobj().decompress(content, size + 1)
            numbers = np.frombuffer(unzipped, "<i4").reshape(3 * rows + 1, frames)
        except (zlib.error, ValueError) as error:
            described = f"counts of {rows} receivers in {frames} frames"
            raise VoccError(f"{described} cannot be read: {error}") from None
        halves, flags = numbers[:rows], numbers[rows : 3 * rows]
        if (
            halves.min() < 0
            or halves.max() > 2 * leds
            or flags.min() < 0
            or flags.max() > 1
        ):
            raise VoccError(f"counts have a frame with more wrong bits than its {leds}")
        found, off = flags.astype(bool).reshape(2, rows, frames)
        groups = numbers[-1].astype(np.int64)
        return cls(halves.astype(np.int64), found, leds, groups, off, keys)

    def of(
        self,
        receivers: slice | Sequence[int] = slice(None),
        frames: slice | Bools = slice(None),
    ) -> Self:
        """Give the same of some receivers, by their places, and of some frames, by place or where True."""
        rows = np.arange(len(self.half_errors))[receivers]
        halves = self.half_errors[rows][:, frames]
        found = self.found[rows][:, frames]
        misplaced = self.misplaced[rows][:, frames]
        keys = [self.keys[row] for row in rows if self.keys]
        groups = self.groups[frames]
        return type(self)(halves, found, self.leds, groups, misplaced, keys)

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
        found = np.all([training.found for training in trainings], axis=0)
        leds = first.leds * len(trainings)
        return cls(halves, found, leds, first.groups, first.misplaced, first.keys)

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
    def pairs(self) -> dict[tuple[int, int], PairedCounts]:
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
