"""Laws of the errors in a frame, whose bit error rate is known, and counts drawn from them.

A law is a table: what can happen in a frame, and with which probability. How often each of its lines comes up
in N frames is multinomial, so thousands of studies are drawn at once.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import betabinom, binom

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.paired import PairedCounts

BITS = 64
"""Bits in a frame."""
WRONG = np.arange(BITS + 1)
RAREST_LINE = 1e-10
"""Rarer outcomes are left out, also of the true rate."""


@dataclass(frozen=True)
class Law:
    """Distribution of the outcomes of a frame: K outcomes, L receivers.

    Args:
        halves: (K,L) int64, the half errors of each of L receivers.
        missed: (K,) bool, whether the panel was not found; the half of the bits is then in ``halves``.
        share: (K,) probability, in sum 1.
    """

    halves: NDArray[np.int64]
    missed: NDArray[np.bool_]
    share: NDArray[np.float64]

    @property
    def ber(self) -> NDArray[np.float64]:
        """True bit error rate of each receiver."""
        return self.share @ self.halves / (2 * BITS)

    def draw(
        self, rng: np.random.Generator, frames: int, studies: int
    ) -> NDArray[np.int64]:
        """Draw how often each outcome occurs in each study, (studies,K)."""
        return rng.multinomial(frames, self.share, size=studies)

    def counts(self, drawn: NDArray[np.int64], receiver: int = 0) -> list[Counts]:
        """Count the errors of one receiver in each study."""
        halves, frames = self.halves[:, receiver], drawn.sum(axis=1)
        sums = drawn @ np.stack([halves, halves**2, halves > 0, self.missed], axis=1)
        rows = zip(frames.tolist(), sums.tolist(), strict=True)
        return [Counts(count, BITS * count, *row) for count, row in rows]

    def paired(self, drawn: NDArray[np.int64]) -> list[PairedCounts]:
        """Compare the first receiver with the second in each study."""
        difference, frames = self.halves[:, 0] - self.halves[:, 1], drawn.sum(axis=1)
        sides = []
        for side in (np.maximum(difference, 0), np.maximum(-difference, 0)):
            sums = drawn @ np.stack([side, side**2, side > 0], axis=1)
            rows = zip(frames.tolist(), sums.tolist(), strict=True)
            sides.append([Counts(count, BITS * count, *row) for count, row in rows])
        return [PairedCounts(*pair) for pair in zip(*sides, strict=True)]


def of_bits(share: NDArray[np.float64]) -> Law:
    """Make the law of 0 to 64 wrong bits of one receiver from their probabilities."""
    return Law(2 * WRONG[:, None], np.zeros(BITS + 1, dtype=bool), share / share.sum())


def independent(ber: float) -> Law:
    """Bits are wrong independently of each other."""
    return of_bits(binom.pmf(WRONG, BITS, ber))


def clustered(ber: float, correlation: float) -> Law:
    """Each frame has an error probability of its own, from a beta law; its bits correlate."""
    scale = (1 - correlation) / correlation
    return of_bits(betabinom.pmf(WRONG, BITS, ber * scale, (1 - ber) * scale))


def exactly(bits: int) -> Law:
    """Every frame has this number of wrong bits."""
    return of_bits((bits == WRONG).astype(np.float64))


def mixed(rare: Law, probability: float, usual: Law) -> Law:
    """Draw a frame from one law with this probability, otherwise from the other."""
    shares = probability * rare.share, (1 - probability) * usual.share
    return Law(
        np.concatenate([rare.halves, usual.halves]),
        np.concatenate([rare.missed, usual.missed]),
        np.concatenate(shares),
    )


def with_missed(law: Law, probability: float) -> Law:
    """Miss the panel in some frames, for all receivers: half their bits count wrong."""
    halves = np.full((1, law.halves.shape[1]), BITS)
    return mixed(Law(halves, np.ones(1, dtype=bool), np.ones(1)), probability, law)


def joint(law: Law, second: NDArray[np.float64]) -> Law:
    """Make the joint law of two receivers.

    Args:
        law: of the first receiver alone, without missed panels.
        second: (65,65) or (1,65) probability of the second one's wrong bits, by those of the first.
    """
    shares = (law.share[:, None] * second).ravel()
    pairs = np.stack([np.repeat(2 * WRONG, BITS + 1), np.tile(2 * WRONG, BITS + 1)], 1)
    lines = shares > RAREST_LINE
    missed = np.zeros(lines.sum(), dtype=bool)
    return Law(pairs[lines], missed, shares[lines] / shares[lines].sum())


def corrected(law: Law, share: float) -> Law:
    """Add a second receiver that corrects a share of the first one's wrong bits."""
    return joint(law, binom.pmf(WRONG[None], WRONG[:, None], 1 - share))


def separate(first: Law, second: Law) -> Law:
    """Make the joint law of two receivers with independent errors."""
    return joint(first, second.share[None])
