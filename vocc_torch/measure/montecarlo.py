"""Monte Carlo at the points of an axis: blocks in index order until a stop rule holds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.rng import BLOCK_FRAMES

Label: TypeAlias = tuple[str | int, ...]
"""What is counted: its last part is the group of frames (a contrast bin; 0 where frames are not sorted)."""

Tally: TypeAlias = Counts | PairedCounts
"""What is counted under a label: one receiver's errors, or two receivers compared."""

_FIRST_CHECK = 16
"""Blocks between looks at the precision, at first; later a sixteenth of the blocks so far."""


@dataclass(frozen=True, slots=True)
class Part:
    """A block, or the first frames of it.

    Args:
        block: index of the block.
        frames: how many of its frames are used, from the first on, 1 to 64.
    """

    block: int
    frames: int


@dataclass(frozen=True, slots=True)
class StopRule:
    """When a point has enough frames.

    Args:
        frames: the budget, at least 1.
        target_frame_errors: stop once every receiver has this many frames in error, at least 1, or None.
        precision: stop once every receiver's 95 % interval reaches at most this share of its bit error rate
            to either side, above 0, or None. A receiver without errors never gets there.
        least_ber: a receiver whose interval lies below this rate, 0 to 1, needs no more precision. One
            without errors goes on until even wrong frames with half their bits wrong would lie below it.

    Raises:
        VoccError: a number outside its range. A rule that can never hold is none: the budget ends the point.
    """

    frames: int
    target_frame_errors: int | None = None
    precision: float | None = None
    least_ber: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a rule under which a point would never end, or would end before it began."""
        for name, value in (("frames", self.frames), ("target_frame_errors", self.target_frame_errors)):
            if value is not None and not value >= 1:
                raise VoccError(f"rule.{name} is {value}: it must be at least 1")
        if self.precision is not None and not self.precision > 0:
            raise VoccError(f"rule.precision is {self.precision}: it must be above 0")
        if not 0 <= self.least_ber <= 1:
            raise VoccError(f"rule.least_ber is {self.least_ber}: it must be 0 to 1")

    def parts(self) -> Iterator[Part]:
        """Name the blocks of the whole budget, in order.

        Example:
            >>> list(StopRule(frames=100).parts())
            [Part(block=0, frames=64), Part(block=1, frames=36)]
        """
        for start in range(0, self.frames, BLOCK_FRAMES):
            yield Part(start // BLOCK_FRAMES, min(BLOCK_FRAMES, self.frames - start))

    def reached(self, tallies: Mapping[Label, Tally], blocks: int) -> str | None:
        """Say why a point needs no more frames: ``frame_errors`` or ``precision``; None if it does.

        Args:
            tallies: what was counted so far; comparisons do not matter here.
            blocks: blocks counted so far, at least 1. The precision is looked at after 16, 32, ... blocks and
                later at steps of about a sixteenth: each look is a chance to stop by luck.

        Example:
            >>> StopRule(6400, target_frame_errors=2).reached({("a", 0): Counts(64, 64, 6, 12, 3)}, 1)
            'frame_errors'
        """
        counts = {label: one for label, one in tallies.items() if isinstance(one, Counts)}
        if not counts:
            return None
        if self.target_frame_errors is not None:
            errors: dict[Label, int] = {}
            for label, one in counts.items():
                errors[label[:-1]] = errors.get(label[:-1], 0) + one.frame_errors
            if min(errors.values()) >= self.target_frame_errors:
                return "frame_errors"
        if self.precision is not None and blocks % max(_FIRST_CHECK, _power_of_two(blocks) // 16) == 0:
            return "precision" if all(map(self._precise, counts.values())) else None
        return None

    def _precise(self, counts: Counts) -> bool:
        """Whether a rate is known well enough, or is too low to matter."""
        if self.precision is None or not counts.frames:
            return False
        # Without errors nothing tells how many bits a wrong frame would have: half, as in a lost panel.
        lost = counts.bits / counts.frames / 2
        interval, ber = ber_interval(counts, errors_per_frame_error=lost), counts.ber
        if interval.high <= self.least_ber:
            return True
        reach = self.precision * ber
        return counts.half_errors > 0 and interval.high - ber <= reach and ber - interval.low <= reach


def _power_of_two(blocks: int) -> int:
    """Give the greatest power of two up to a positive number."""
    return 1 << (blocks.bit_length() - 1)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a point gave: tallies by label, and why it stopped.

    ``stopped_by`` is ``frame_errors``, ``precision`` or ``frames``.
    """

    counts: dict[Label, Tally]
    stopped_by: str
