"""What a receiver got wrong: exact integers that add over blocks of frames, in any order."""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from vocc_torch.errors import VoccError


@dataclass(frozen=True, slots=True)
class Counts:
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

    Raises:
        VoccError: a count is not an integer, is below 0, or contradicts another.

    Example:
        >>> first = Counts(frames=64, bits=4096, half_errors=6, half_errors_squared=20, frame_errors=2)
        >>> total = sum([first, first], Counts())
        >>> total.bits, total.bit_errors, total.ber
        (8192, 6.0, 0.000732421875)
    """

    frames: int = 0
    bits: int = 0
    half_errors: int = 0
    half_errors_squared: int = 0
    frame_errors: int = 0
    panels_missed: int = 0

    def __post_init__(self) -> None:
        """Refuse numbers that no set of frames can give, such as a damaged ledger row."""
        for field in fields(self):
            value = getattr(self, field.name)
            if type(value) is not int or value < 0:
                raise VoccError(f"counts.{field.name} is {value!r}: it must be an integer of at least 0")
        if self.bits and not self.frames:
            raise VoccError(f"counts.bits is {self.bits}: it must be 0 where there are no frames")
        limits = (
            ("frames", self.bits, "bits"),
            ("half_errors", 2 * self.bits, "twice bits"),
            ("half_errors_squared", self.half_errors**2, "half_errors squared"),
            ("frame_errors", min(self.frames, self.half_errors), "frames and half_errors"),
            ("panels_missed", self.frame_errors, "frame_errors"),
        )
        for name, limit, reason in limits:
            if getattr(self, name) > limit:
                raise VoccError(
                    f"counts.{name} is {getattr(self, name)}: it must be at most {limit} ({reason})"
                )
        if self.half_errors_squared * self.frame_errors < self.half_errors**2:
            raise VoccError(
                f"counts.half_errors_squared is {self.half_errors_squared}: too small for "
                f"{self.half_errors} half errors in {self.frame_errors} frames"
            )

    @classmethod
    def of(cls, decided: Tensor, sent: Tensor, found: Tensor) -> Counts:
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
        leds = sent.shape[1] * sent.shape[2]
        sums = torch.stack([half.sum(), (half * half).sum(), (half > 0).sum(), (~found).sum()])
        return cls(len(sent), len(sent) * leds, *(int(value) for value in sums.tolist()))

    def __add__(self, other: Counts | int) -> Counts:
        """Join the counts of disjoint frames; the 0 that ``sum`` starts from is let through."""
        if isinstance(other, int) and other == 0:
            return self
        if not isinstance(other, Counts):
            return NotImplemented
        return Counts(*(getattr(self, field.name) + getattr(other, field.name) for field in fields(self)))

    __radd__ = __add__

    @property
    def bit_errors(self) -> float:
        """Wrong bits, a multiple of one half."""
        return self.half_errors / 2

    @property
    def ber(self) -> float:
        """Bit error rate, 0 to 1.

        Raises:
            VoccError: no bits were counted.
        """
        if self.bits == 0:
            raise VoccError("counts.bits is 0: a bit error rate needs at least one frame")
        return self.half_errors / (2 * self.bits)


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
    if sent.dtype != torch.bool or sent.ndim != 3 or sent.shape[1] * sent.shape[2] == 0:
        raise VoccError(
            f"sent is {sent.dtype} of shape {tuple(sent.shape)}: "
            "it must be torch.bool of shape (B,R,C) with at least one LED"
        )
    for name, bits, shape in (("decided", decided, sent.shape), ("found", found, sent.shape[:1])):
        if bits.dtype != torch.bool or bits.shape != shape:
            raise VoccError(
                f"{name} is {bits.dtype} of shape {tuple(bits.shape)}: "
                f"it must be torch.bool of shape {tuple(shape)}"
            )
    return torch.where(found, 2 * (decided != sent).flatten(1).sum(1), sent.shape[1] * sent.shape[2])
