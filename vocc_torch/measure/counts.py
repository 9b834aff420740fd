"""What a receiver got wrong: exact integers that add over blocks of frames, in any order."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from operator import attrgetter
from typing import ClassVar, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.rng import BLOCK_FRAMES


@dataclass(frozen=True, slots=True)
class Tally:
    """Whole numbers that were counted over some frames; those of disjoint frames add, field by field.

    Args:
        frames: frames looked at.
        bits: bits sent in them.
    """

    frames: int = 0
    bits: int = 0

    @property
    def numbers(self) -> tuple[int, ...]:
        """All of them, in the order of the fields."""
        return _numbers_of(self.__match_args__)(self)

    def __add__(self, other: Self | int) -> Self:
        """Join what was counted on disjoint frames; the 0 that ``sum`` starts from is let through."""
        if isinstance(other, int) and other == 0:
            return self
        if not isinstance(other, type(self)):
            return NotImplemented
        return type(self)(
            *(
                mine + theirs
                for mine, theirs in zip(self.numbers, other.numbers, strict=True)
            )
        )

    __radd__ = __add__


@cache
def _numbers_of(names: tuple[str, ...]) -> Callable[[Tally], tuple[int, ...]]:
    """What reads the fields; ``dataclasses.astuple`` takes ten times as long, for it copies deeply."""
    return attrgetter(*names)


@dataclass(frozen=True, slots=True)
class Counts(Tally):
    """Errors of one receiver over some frames, as Python integers.

    Errors are kept in halves of a bit error: in a frame whose panel was not found every bit is a coin toss,
    which counts as half the frame's bits wrong, and a 3 x 3 panel has an odd number of them. They are
    integers without limit, so sums of any number of frames are exact; no frames at all, the empty counts, are
    the zero of addition.

    Args:
        frames: frames decoded.
        bits: bits sent in them.
        half_errors: wrong bits, times two.
        half_errors_squared: sum over the frames of the square of the frame's ``half_errors``; with
            ``half_errors`` it gives the spread of errors between frames, which the interval needs.
        frame_errors: frames with at least one wrong bit, frames without a panel among them.
        panels_missed: frames whose panel was not found.
        misplaced: frames whose panel was missed, or located off its place.
        misplaced_half_errors: ``half_errors`` in those.

    Raises:
        VoccError: a count is not an integer, is below 0, or contradicts another.

    Example:
        >>> first = Counts(frames=64, bits=4096, half_errors=6, half_errors_squared=20, frame_errors=2)
        >>> total = sum([first, first], Counts())
        >>> total.bits, total.bit_errors, total.ber
        (8192, 6.0, 0.000732421875)
    """

    half_errors: int = 0
    half_errors_squared: int = 0
    frame_errors: int = 0
    panels_missed: int = 0
    misplaced: int = 0
    misplaced_half_errors: int = 0
    least_frames: ClassVar[int] = 1
    """Frames before the first look at the precision."""

    def __post_init__(self) -> None:
        """Refuse numbers that no set of frames can give, such as a damaged ledger row."""
        for name, value in zip(self.__match_args__, self.numbers, strict=True):
            if type(value) is not int or value < 0:
                raise VoccError(
                    f"counts.{name} is {value!r}: it must be an integer of at least 0"
                )
        limits = (
            ("bits", self.bits if self.frames else 0, "no frames"),
            ("frames", self.bits, "bits"),
            ("half_errors", 2 * self.bits, "twice bits"),
            ("half_errors_squared", self.half_errors**2, "half_errors squared"),
            (
                "frame_errors",
                min(self.frames, self.half_errors),
                "frames and half_errors",
            ),
            ("panels_missed", self.frame_errors, "frame_errors"),
            ("misplaced", self.frames, "frames"),
            (
                "misplaced_half_errors",
                self.half_errors if self.misplaced else 0,
                "half_errors",
            ),
        )
        for name, limit, reason in limits:
            if getattr(self, name) > limit:
                raise VoccError.of(
                    f"counts.{name}", getattr(self, name), f"at most {limit} ({reason})"
                )
        if self.half_errors_squared * self.frame_errors < self.half_errors**2:
            rule = f"large enough for {self.half_errors} half errors in {self.frame_errors} frames"
            raise VoccError.of(
                "counts.half_errors_squared", self.half_errors_squared, rule
            )

    @classmethod
    def of(cls, decided: Tensor, sent: Tensor, found: Tensor) -> Self:
        """Compare decided bits with sent ones.

        Args:
            decided: (B,R,C) bool, the receiver's bits; ignored where no panel was found.
            sent: (B,R,C) bool, the bits sent.
            found: (B,) bool, whether the panel was found.

        Raises:
            VoccError: a tensor of another shape or type.

        Example:
            >>> sent = torch.zeros(2, 3, 3, dtype=torch.bool)
            >>> counts = Counts.of(sent, sent, torch.tensor([True, False]))
            >>> counts.half_errors, counts.bit_errors, counts.panels_missed
            (9, 4.5, 1)
        """
        half = half_errors(decided, sent, found)
        sums = torch.stack(
            [half.sum(), (half * half).sum(), (half > 0).sum(), (~found).sum()]
        )
        return cls(len(sent), sent.numel(), *sums.tolist())

    @property
    def spread(self) -> int:
        """Variance of half errors between frames, times the square of the frames: whole, so exact."""
        return self.frames * self.half_errors_squared - self.half_errors**2

    @property
    def bit_errors(self) -> float:
        """Wrong bits, a multiple of one half."""
        return self.half_errors / 2

    @property
    def location_share(self) -> float | None:
        """Share of the wrong bits in frames whose panel was missed or misplaced; None without errors."""
        return (
            self.misplaced_half_errors / self.half_errors if self.half_errors else None
        )

    @property
    def ber(self) -> float:
        """Bit error rate, 0 to 1.

        Raises:
            VoccError: no bits were counted.
        """
        if self.bits == 0:
            raise VoccError(
                "counts.bits is 0: a bit error rate needs at least one frame"
            )
        return self.half_errors / (2 * self.bits)


WEIGHT_UNIT = 2.0**-100
"""What weights are counted in, so that their sums are exact; below it a weight is 0."""


@dataclass(frozen=True, slots=True)
class WeightedCounts(Counts):
    """Errors over frames that were drawn from other scenes than those meant, each with a weight.

    A frame's weight w is the ratio of its probability in the scenes that are meant to that in those it was
    drawn from, so that the mean of w h over the frames is that of h over frames as they are meant. The fields
    of :class:`Counts` count the frames as they were drawn. The weighted sums are whole numbers of
    :data:`WEIGHT_UNIT` (of its square, where weights are squared), so they add exactly in any order.

    Args:
        nominal: sum over the frames of the share, in 64ths, with which such a frame comes from the scenes
            that are meant; no weight is above 64 over that share.
        weighted: sum of w h over the frames, h a frame's ``half_errors``.
        weighted_squares: sum of w h^2.
        squares: sum of (w h)^2.
        fourths: sum of (w h)^4, which tells whether a few frames are most of ``squares``.

    Example:
        >>> halves, found = np.array([0, 2, 0, 4]), np.ones(4, dtype=bool)
        >>> rare = WeightedCounts.weigh(halves, found, 64, np.array([2.0, 1e-3, 0.5, 1e-4]), nominal=16)
        >>> rare.bit_errors, round(rare.ber * rare.bits, 6), round(rare.effective_frames, 1)
        (3.0, 0.0012, 5384.6)
    """

    nominal: int = 0
    weighted: int = 0
    weighted_squares: int = 0
    squares: int = 0
    fourths: int = 0
    # Few frames may have most of the weight.
    least_frames: ClassVar[int] = 128 * BLOCK_FRAMES

    def __post_init__(self) -> None:
        """Refuse numbers that no set of frames can give."""
        Counts.__post_init__(self)
        limits = (
            ("nominal", BLOCK_FRAMES * self.frames, "64 times frames"),
            (
                "weighted",
                self.weighted_squares if self.half_errors else 0,
                "weighted_squares",
            ),
            # By Cauchy and Schwarz.
            (
                "weighted",
                math.isqrt(self.squares * self.frame_errors),
                "the root of squares by frame_errors",
            ),
            (
                "squares",
                math.isqrt(self.fourths * self.frame_errors),
                "the root of fourths by frame_errors",
            ),
            ("fourths", self.squares**2, "squares squared"),
        )
        for name, limit, reason in limits:
            if getattr(self, name) > limit:
                raise VoccError.of(
                    f"counts.{name}", getattr(self, name), f"at most {limit} ({reason})"
                )

    @classmethod
    def weigh(
        cls,
        halves: NDArray[np.int64],
        found: NDArray[np.bool_],
        leds: int,
        weights: NDArray[np.float64],
        nominal: int,
    ) -> Self:
        """Count the errors of N frames.

        Args:
            halves: (N,) each frame's wrong bits, times two.
            found: (N,) whether its panel was found.
            leds: bits in a frame.
            weights: (N,) each frame's weight, at least 0.
            nominal: share of the frames, in 64ths, that come from the scenes that are meant.
        """
        wrong = np.flatnonzero(halves).tolist()
        pairs = [
            (round(float(weights[i]) / WEIGHT_UNIT), int(halves[i])) for i in wrong
        ]
        return cls(
            frames=len(halves),
            bits=len(halves) * leds,
            half_errors=sum(h for _, h in pairs),
            half_errors_squared=sum(h * h for _, h in pairs),
            frame_errors=len(wrong),
            panels_missed=int((~found).sum()),
            nominal=len(halves) * nominal,
            weighted=sum(w * h for w, h in pairs),
            weighted_squares=sum(w * h * h for w, h in pairs),
            squares=sum((w * h) ** 2 for w, h in pairs),
            fourths=sum((w * h) ** 4 for w, h in pairs),
        )

    @property
    def ber(self) -> float:
        """Bit error rate of the scenes that are meant; by chance it may lie above 1.

        Raises:
            VoccError: no bits were counted.
        """
        if self.bits == 0:
            raise VoccError(
                "counts.bits is 0: a bit error rate needs at least one frame"
            )
        return self.weighted * WEIGHT_UNIT / (2 * self.bits)

    @property
    def nominal_frames(self) -> float:
        """Frames drawn as they are meant: those that would find a kind of error that nothing else seeks."""
        return self.nominal / BLOCK_FRAMES

    @property
    def effective_frames(self) -> float:
        """How many frames that are drawn as they are meant would tell the rate as well.

        The ratio of the two sampling variances, as these frames estimate both: mean w h^2 over mean (w h)^2.
        Without errors :attr:`nominal_frames`, which then limit the rate.
        """
        if not self.squares:
            return self.nominal_frames
        return self.frames * self.weighted_squares / (self.squares * WEIGHT_UNIT)


def half_errors(decided: Tensor, sent: Tensor, found: Tensor) -> Tensor:
    """Count each frame's wrong bits in halves, as :class:`Counts` does.

    Nothing is moved off the device.

    Args:
        decided: (B,R,C) bool, a receiver's bits; ignored where no panel was found.
        sent: (B,R,C) bool, the bits sent.
        found: (B,) bool, whether the panel was found.

    Returns:
        (B,) int64, wrong bits times two; where no panel was found, R times C.

    Raises:
        VoccError: a tensor of another shape or type.

    Example:
        >>> sent = torch.zeros(2, 3, 3, dtype=torch.bool)
        >>> half_errors(~sent, sent, torch.tensor([True, False])).tolist()
        [18, 9]
    """
    leds = sent.shape[1:].numel()
    expected = (
        sent.shape if sent.ndim == 3 and leds else "(B,R,C) with at least one LED"
    )
    demands = (
        ("sent", sent, expected),
        ("decided", decided, sent.shape),
        ("found", found, sent.shape[:1]),
    )
    for name, bits, shape in demands:
        if bits.dtype != torch.bool or bits.shape != shape:
            rule = f"torch.bool of shape {tuple(shape) if isinstance(shape, torch.Size) else shape}"
            raise VoccError.of(name, f"{bits.dtype} of shape {tuple(bits.shape)}", rule)
    return torch.where(found, 2 * (decided != sent).flatten(1).sum(1), leds)
