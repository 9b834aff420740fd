"""The work of one point: which blocks it has, what of them is known, and when it has enough.

Blocks may come back in any order. Each is written to the ledger at once and added in index order, so that the
result is the same whoever counts.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

from vocc_torch.measure import intervals
from vocc_torch.measure.config import Budget
from vocc_torch.measure.counts import Counts, Tally, WeightedCounts
from vocc_torch.measure.ledger import Label, Ledger
from vocc_torch.measure.trainings import TRAININGS
from vocc_torch.rng import BLOCK_FRAMES

FIRST_CHECK = 16
"""Blocks between looks at the precision, at first; later a sixteenth of the blocks so far."""

FIRST_RARE_CHECK = 128
"""Blocks before the first look where frames are weighed: few of them may have most of the weight."""


class Part(NamedTuple):
    """A block, or the first frames of it.

    Args:
        block: index of the block.
        frames: how many of its frames are used, from the first on, 1 to 64.
    """

    block: int
    frames: int


def parts_of(frames: int) -> Iterator[Part]:
    """Name the blocks of a budget, in order.

    Example:
        >>> list(parts_of(100))
        [Part(block=0, frames=64), Part(block=1, frames=36)]
    """
    for start in range(0, frames, BLOCK_FRAMES):
        yield Part(start // BLOCK_FRAMES, min(BLOCK_FRAMES, frames - start))


def stop_reason(rule: Budget, tallies: Mapping[Label, Tally], blocks: int) -> str | None:
    """Say why a point needs no more frames: ``frame_errors`` or ``precision``; None if it does.

    Args:
        rule: when a point has enough. A rule that can never hold is none: the frames end the point.
        tallies: what was counted so far; comparisons and further trainings do not matter here.
        blocks: blocks counted so far, at least 1. The precision is looked at after 16, 32, ... blocks and
            later at steps of about a sixteenth: each look is a chance to stop by luck.

    Example:
        >>> stop_reason(Budget(6400, target_frame_errors=2), {("a", 0): Counts(64, 64, 6, 12, 3)}, 1)
        'frame_errors'
    """
    # A receiver gets the frames that it would get alone, so its numbers do not depend on other trainings.
    counts = {
        label: one for label, one in tallies.items() if isinstance(one, Counts) and TRAININGS not in label
    }
    if counts and rule.target_frame_errors is not None:
        errors: dict[Label, int] = {}
        for label, one in counts.items():
            errors[label[:-1]] = errors.get(label[:-1], 0) + one.frame_errors
        if min(errors.values()) >= rule.target_frame_errors:
            return "frame_errors"
    power_of_two = 1 << (blocks.bit_length() - 1)
    if not counts or rule.precision is None or blocks % max(FIRST_CHECK, power_of_two // 16):
        return None
    for one in counts.values():
        if not one.frames or (isinstance(one, WeightedCounts) and blocks < FIRST_RARE_CHECK):
            return None
        # Without errors nothing tells how many bits a wrong frame would have: half, as in a lost panel.
        interval = intervals.ber_interval(one, errors_per_frame_error=one.bits / one.frames / 2)
        reach = max(interval.high - one.ber, one.ber - interval.low)
        narrow = one.half_errors > 0 and reach <= rule.precision * one.ber
        if not narrow and interval.high > rule.least_ber:
            return None
    return "precision"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a point gave: tallies by label, and why it stopped.

    ``stopped_by`` is ``frame_errors``, ``precision`` or ``frames``.
    """

    counts: dict[Label, Tally]
    stopped_by: str


Counted: TypeAlias = Sequence[Mapping[Label, Tally]]
Count: TypeAlias = Callable[[Sequence[Part]], Counted]


@dataclass(eq=False)
class PointWork:
    """A point that is to be counted: blocks that are known and wait for their turn, and the sums so far.

    Args:
        point: its name, which keys its random draws and its rows in the ledger.
        count: counts each of the parts, giving a list of as many mappings; it must be picklable where other
            processes do it.
        rule: when to stop.
        ledger: where its blocks are recorded and known blocks are taken from, or None.
        told: called for each block as it is added, with its frames and the tallies so far.

    Attributes:
        counts: the tallies so far.
        stopped_by: why it has enough; empty until then.
        exhausted: whether all of its blocks have been taken.
    """

    point: str
    count: Count
    rule: Budget
    ledger: Ledger | None = None
    told: Callable[[int, Mapping[Label, Tally]], object] = lambda frames, tallies: None
    counts: dict[Label, Tally] = field(default_factory=dict, init=False)
    stopped_by: str = field(default="", init=False)
    exhausted: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        """Lay the blocks out."""
        self._parts = parts_of(self.rule.frames)
        self._known: dict[int, tuple[Part, Mapping[Label, Tally]]] = {}
        self._blocks = 0

    def take(self, blocks: int) -> list[Part]:
        """Take the next blocks, and give those of them that the ledger does not know."""
        taken, missing = list(itertools.islice(self._parts, blocks)), []
        self.exhausted = not taken or BLOCK_FRAMES * (taken[-1].block + 1) >= self.rule.frames
        for part in taken:
            if self.ledger is None or (counts := self.ledger.find(self.point, *part)) is None:
                missing.append(part)
            else:
                self._known[part.block] = part, counts
        return missing

    def record(self, parts: Sequence[Part], counted: Counted) -> None:
        """Write down what has come back, and keep it for its turn; what comes twice is counted once."""
        for part, counts in list(zip(parts, counted, strict=True)):
            if self.ledger is not None:
                self.ledger.append(self.point, *part, counts)
            if part.block >= self._blocks:
                self._known[part.block] = part, counts

    def add_known(self) -> None:
        """Add what is known, in order, until the rule holds; what lies beyond it is dropped."""
        while not self.stopped_by and self._blocks in self._known:
            part, counts = self._known.pop(self._blocks)
            for label, one in counts.items():
                self.counts[label] = self.counts[label] + one if label in self.counts else one
            self._blocks += 1
            spent = "frames" if self._blocks * BLOCK_FRAMES >= self.rule.frames else ""
            self.stopped_by = stop_reason(self.rule, self.counts, self._blocks) or spent
            self.told(part.frames, self.counts)
