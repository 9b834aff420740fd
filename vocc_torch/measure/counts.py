"""What a receiver got wrong: exact integers that add over blocks of frames, in any order."""

import operator
from dataclasses import astuple, dataclass
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from vocc_torch.measure.estimate import Estimate


@dataclass(frozen=True, slots=True)
class Counts:
    """Errors of one receiver over some frames, as Python integers.

    Errors are counted in halves of a bit error: half of the bits of a missed panel count as wrong, and a
    panel of 3 x 3 LEDs has an odd number of bits. The integers have no limit, so sums over any number of
    frames are exact. Counts of no frames are the zero of addition.

    Args:
        frames: frames decoded.
        bits: bits sent in them.
        half_errors: wrong bits, times two.
        half_errors_squared: sum over the frames of the square of the frame's ``half_errors``; with
            ``half_errors`` it gives the spread of errors between frames, which the interval needs.
        frame_errors: frames with at least one wrong bit, frames without a panel among them.
        panels_missed: frames whose panel was not found.
        misplaced: frames whose panel was missed, or has a corner too far off.
        misplaced_half_errors: ``half_errors`` in the misplaced frames.

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
    misplaced: int = 0
    misplaced_half_errors: int = 0
    least_frames: ClassVar[int] = 1
    """Frames before the first look at the precision."""

    def __add__(self, other: Self | int) -> Self:
        """Join what was counted on disjoint frames; the 0 that ``sum`` starts from is let through."""
        if isinstance(other, int) and other == 0:
            return self
        if isinstance(other, int) or type(other) is not type(self):
            return NotImplemented
        return type(self)(*map(operator.add, astuple(self), astuple(other)))

    __radd__ = __add__

    @property
    def columns(self) -> dict[str, Any]:
        """Columns of ``ber.csv`` that only counts of another kind have."""
        return {}

    def interval(
        self, confidence: float, errors_per_frame_error: float
    ) -> Estimate | None:
        """Give the interval of a rate whose frames do not weigh alike; None where they do."""
        return None

    @property
    def spread(self) -> int:
        """Variance of half errors between frames, times the square of the frames: whole, so exact."""
        return self.frames * self.half_errors_squared - self.half_errors**2

    @property
    def bit_errors(self) -> float:
        """Wrong bits, a multiple of one half."""
        return self.half_errors / 2

    @property
    def errors_per_frame_error(self) -> float:
        """Mean wrong bits of a wrong frame, at least 1; 1 without errors."""
        return max(1.0, self.bit_errors / max(1, self.frame_errors))

    @property
    def location_share(self) -> float | None:
        """Share of the wrong bits in frames whose panel was missed or misplaced; None without errors."""
        return (
            self.misplaced_half_errors / self.half_errors if self.half_errors else None
        )

    @property
    def ber(self) -> float:
        """Bit error rate, 0 to 1; at least one frame was counted."""
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

    Example:
        >>> sent = torch.zeros(2, 3, 3, dtype=torch.bool)
        >>> half_errors(~sent, sent, torch.tensor([True, False])).tolist()
        [18, 9]
    """
    leds = sent.shape[1:].numel()
    return torch.where(found, 2 * (decided != sent).flatten(1).sum(1), leds)
