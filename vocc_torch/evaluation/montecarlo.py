"""Monte Carlo at one point of an axis: blocks in index order until a stop rule holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

from vocc_torch.evaluation.counts import Counts
from vocc_torch.rng import BLOCK_FRAMES

Label = tuple[str, int]
"""A receiver's name and the group of frames (a contrast bin; 0 where frames are not sorted)."""


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
        target_frame_errors: stop once every receiver has this many frames in error, or None.
    """

    frames: int
    target_frame_errors: int | None = None

    def parts(self) -> Iterator[Part]:
        """Name the blocks of the whole budget, in order.

        Example:
            >>> list(StopRule(frames=100).parts())
            [Part(block=0, frames=64), Part(block=1, frames=36)]
        """
        for start in range(0, self.frames, BLOCK_FRAMES):
            yield Part(start // BLOCK_FRAMES, min(BLOCK_FRAMES, self.frames - start))

    def reached(self, counts: Mapping[Label, Counts]) -> bool:
        """Whether every receiver has its frames in error."""
        if self.target_frame_errors is None:
            return False
        errors: dict[str, int] = {}
        for (receiver, _), count in counts.items():
            errors[receiver] = errors.get(receiver, 0) + count.frame_errors
        return bool(errors) and min(errors.values()) >= self.target_frame_errors


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a point gave: counts by label, and why it stopped (``frame_errors`` or ``frames``)."""

    counts: dict[Label, Counts]
    stopped_by: str


def run_point(
    count: Callable[[Sequence[Part]], list[dict[Label, Counts]]],
    rule: StopRule,
    *,
    blocks_at_once: int = 1,
    progress: Callable[[int, Mapping[Label, Counts]], None] | None = None,
) -> Outcome:
    """Add blocks in index order until the rule holds.

    Blocks may be counted several at once; those beyond the one at which the rule first held are thrown away,
    so that the result does not depend on how many are counted together.

    Args:
        count: counts each of the parts, giving a list of as many mappings.
        rule: when to stop.
        blocks_at_once: blocks counted in one call, at least 1.
        progress: called after each block with its frames and the counts so far.

    Example:
        >>> def one_error(parts):
        ...     return [{("a", 0): Counts(p.frames, p.frames, 2, 4, 1)} for p in parts]
        >>> outcome = run_point(one_error, StopRule(frames=640, target_frame_errors=3), blocks_at_once=2)
        >>> outcome.counts["a", 0].frames, outcome.stopped_by
        (192, 'frame_errors')
    """
    total: dict[Label, Counts] = {}
    parts = rule.parts()
    while together := list(islice(parts, blocks_at_once)):
        for part, counts in zip(together, count(together), strict=True):
            for label, one in counts.items():
                total[label] = total.get(label, Counts()) + one
            if progress is not None:
                progress(part.frames, total)
            if rule.reached(total):
                return Outcome(total, "frame_errors")
    return Outcome(total, "frames")
