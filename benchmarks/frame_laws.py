"""Laws of the errors in a frame, whose bit error rate is known, and counts drawn from them.

A law is a table: what can happen in a frame, and with which probability. How often each of its lines comes up
in N frames is multinomial, so thousands of studies are drawn at once, and the truth that an interval should
hold is a sum over the table.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import betabinom, binom

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.paired import PairedCounts

BITS = 64
"""Bits in a frame."""


@dataclass(frozen=True)
class Law:
    """What happens in a frame.

    Args:
        halves: (K,L) int64, the half errors of each of L receivers.
        missed: (K,L) bool, whether a receiver's panel was not found; the half of it is then in ``halves``.
        share: (K,) probability, in sum 1.
    """

    halves: NDArray[np.int64]
    missed: NDArray[np.bool_]
    share: NDArray[np.float64]

    @property
    def ber(self) -> NDArray[np.float64]:
        """True bit error rate of each receiver."""
        return self.share @ self.halves / (2 * BITS)

    @property
    def frame_error_rate(self) -> NDArray[np.float64]:
        """True probability of a wrong bit in a frame, for each receiver."""
        return self.share @ (self.halves > 0)

    def seen(
        self, rng: np.random.Generator, frames: int, studies: int
    ) -> NDArray[np.int64]:
        """Draw how often each line comes up in each of some studies, (studies,K)."""
        return rng.multinomial(frames, self.share, size=studies)

    def counts(self, seen: NDArray[np.int64], receiver: int = 0) -> list[Counts]:
        """Sum up what one receiver got wrong in each study."""
        halves, frames = self.halves[:, receiver], seen.sum(axis=1)
        sums = seen @ np.stack(
            [halves, halves**2, halves > 0, self.missed[:, receiver]], axis=1
        )
        return [
            Counts(n, BITS * n, *row)
            for n, row in zip(frames.tolist(), sums.tolist(), strict=True)
        ]

    def paired(self, seen: NDArray[np.int64]) -> list[PairedCounts]:
        """Compare the first receiver with the second in each study."""
        apart, frames = self.halves[:, 0] - self.halves[:, 1], seen.sum(axis=1)
        sides = [np.maximum(apart, 0), np.maximum(-apart, 0)]
        sums = seen @ np.stack(
            [column for one in sides for column in (one, one**2, one > 0)], axis=1
        )
        return [
            PairedCounts(n, BITS * n, *row)
            for n, row in zip(frames.tolist(), sums.tolist(), strict=True)
        ]


def _of_bits(share: NDArray[np.float64]) -> Law:
    """Make the law of 0 to 64 wrong bits of one receiver from their probabilities."""
    return Law(
        2 * np.arange(BITS + 1)[:, None],
        np.zeros((BITS + 1, 1), dtype=bool),
        share / share.sum(),
    )


def independent(ber: float) -> Law:
    """Every bit is wrong by itself."""
    return _of_bits(binom.pmf(np.arange(BITS + 1), BITS, ber))


def clustered(ber: float, correlation: float) -> Law:
    """Each frame has an error probability of its own, from a beta law; its bits correlate."""
    scale = (1 - correlation) / correlation
    return _of_bits(
        betabinom.pmf(np.arange(BITS + 1), BITS, ber * scale, (1 - ber) * scale)
    )


def exactly(bits: int) -> Law:
    """So many bits of every frame are wrong."""
    return Law(np.array([[2 * bits]]), np.zeros((1, 1), dtype=bool), np.ones(1))


def mixed(rare: Law, probability: float, usual: Law) -> Law:
    """Take a frame of one law with a probability, and else of another."""
    return Law(
        np.concatenate([rare.halves, usual.halves]),
        np.concatenate([rare.missed, usual.missed]),
        np.concatenate([probability * rare.share, (1 - probability) * usual.share]),
    )


def with_missed(law: Law, probability: float) -> Law:
    """Miss the panel in some frames, for all receivers: half their bits count wrong."""
    if not probability:
        return law
    shape = (1, law.halves.shape[1])
    return mixed(
        Law(np.full(shape, BITS), np.ones(shape, dtype=bool), np.ones(1)),
        probability,
        law,
    )


def missed_by_first(law: Law, probability: float) -> Law:
    """Let the first of two receivers miss the panel in some frames in which the second finds it."""
    halves, missed = law.halves.copy(), law.missed.copy()
    halves[:, 0], missed[:, 0] = BITS, True
    return mixed(Law(halves, missed, law.share), probability, law)


def mended(law: Law, share: float, spoiled: float) -> Law:
    """Add a second receiver: it mends a share of the first one's wrong bits and spoils some others.

    Args:
        law: of the first receiver alone, without missed panels.
        share: probability that a wrong bit of the first is right.
        spoiled: probability that a right bit of the first is wrong.
    """
    wrong, bits = law.halves[:, 0] // 2, np.arange(BITS + 1)
    kept, new = (
        binom.pmf(bits[None], wrong[:, None], 1 - share),
        binom.pmf(bits[None], BITS - wrong[:, None], spoiled),
    )
    both = np.stack(
        [
            np.convolve(one, other)[: BITS + 1]
            for one, other in zip(kept, new, strict=True)
        ]
    )
    joint = (law.share[:, None] * both).ravel()
    # A line this rare never comes up, and the truth is taken from the lines that are left.
    lines = joint > 1e-10
    halves = np.stack(
        [np.repeat(2 * wrong, BITS + 1), np.tile(2 * bits, len(wrong))], axis=1
    )[lines]
    return Law(
        halves, np.zeros(halves.shape, dtype=bool), joint[lines] / joint[lines].sum()
    )


def apart(first: Law, second: Law) -> Law:
    """Put two receivers side by side whose errors have nothing to do with each other."""
    shares = (first.share[:, None] * second.share[None]).ravel()
    lines = shares > 1e-10
    halves = np.stack(
        [
            np.repeat(first.halves[:, 0], len(second.share)),
            np.tile(second.halves[:, 0], len(first.share)),
        ],
        axis=1,
    )[lines]
    return Law(
        halves, np.zeros(halves.shape, dtype=bool), shares[lines] / shares[lines].sum()
    )


def alike(law: Law) -> Law:
    """Give two receivers the errors of one."""
    return Law(
        np.repeat(law.halves, 2, axis=1), np.repeat(law.missed, 2, axis=1), law.share
    )
