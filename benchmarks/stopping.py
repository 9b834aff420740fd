"""Points that are stopped by what they have seen, and what this does to their bit error rate.

A point that stops at a number of frame errors stops a little sooner when the errors come thick; one that
stops at a precision gets many chances to stop by luck. Here points are stopped thousands of times, on frames
whose bit error rate is known.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from frame_laws import BITS, Law
from numpy.typing import NDArray

from vocc_torch.measure.config import Budget
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.frame_errors import Key
from vocc_torch.measure.runner import stop_reason
from vocc_torch.rng import BLOCK_FRAMES

ENDLESS = 10**12
"""A budget of frames that no point here comes near."""


def at_frame_errors(
    law: Law, rng: np.random.Generator, studies: int, target: int
) -> list[Counts]:
    """Stop each study after the first block with which it has its frame errors.

    What is wrong in a frame in error does not depend on when the study stops, so only the frames in error are
    counted block by block.
    """
    rate = float(law.frame_error_rate[0])
    wrong = np.zeros(studies, dtype=np.int64)
    blocks = np.zeros(studies, dtype=np.int64)
    together = max(1, round(target / rate / BLOCK_FRAMES / 8))
    while (going := np.flatnonzero(wrong < target)).size:
        drawn = wrong[going, None] + rng.binomial(
            BLOCK_FRAMES, rate, (going.size, together)
        ).cumsum(axis=1)
        reached = drawn >= target
        used = np.where(reached.any(axis=1), reached.argmax(axis=1), together - 1)
        wrong[going] = drawn[np.arange(going.size), used]
        blocks[going] += used + 1
    in_error = law.halves[:, 0] > 0
    seen = np.zeros((studies, len(law.share)), dtype=np.int64)
    seen[:, in_error] = rng.multinomial(wrong, law.share[in_error] / rate)
    seen[:, np.flatnonzero(~in_error)[0]] = blocks * BLOCK_FRAMES - wrong
    return law.counts(seen)


def looks() -> Iterator[int]:
    """Name the numbers of blocks at which :func:`stop_reason` looks at the precision, without end."""
    for blocks in itertools.count(16, 16):
        if blocks % max(16, (1 << (blocks.bit_length() - 1)) // 16) == 0:
            yield blocks


def at_precision(
    law: Law, rng: np.random.Generator, studies: int, precision: float
) -> list[Counts]:
    """Stop each study at the first look at which both arms of its interval are short enough."""
    rule = Budget(frames=ENDLESS, precision=precision)
    seen = np.zeros((studies, len(law.share)), dtype=np.int64)
    going, done = np.arange(studies), 0
    for blocks in looks():
        seen[going] += law.seen(rng, (blocks - done) * BLOCK_FRAMES, going.size)
        done = blocks
        near = going[_may_be_precise(law, seen[going], precision)]
        precise = [
            study
            for study, counts in zip(near, law.counts(seen[near]), strict=True)
            if stop_reason(rule, {(Key("truth", "receiver"), 0): counts}, blocks)
        ]
        going = np.setdiff1d(going, precise, assume_unique=True)
        if not going.size:
            break
    return law.counts(seen)


def _may_be_precise(
    law: Law, seen: NDArray[np.int64], precision: float
) -> NDArray[np.bool_]:
    """Say where the normal interval is short enough: the interval in use has a longer upper arm."""
    halves, frames = law.halves[:, 0], seen.sum(axis=1)
    mean, square = seen @ halves / frames, seen @ halves**2 / frames
    spread = np.sqrt((square - mean**2) / frames)
    return np.asarray(
        (mean > 0) & (1.959 * spread <= precision * np.maximum(mean, 1 / BITS / frames))
    )
