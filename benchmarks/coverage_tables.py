"""The tables of ``docs/results/coverage``: how often intervals hold the truth of simulated frames."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from frame_laws import (
    BITS,
    Law,
    alike,
    apart,
    clustered,
    exactly,
    independent,
    mended,
    missed_by_first,
    mixed,
    with_missed,
)
from numpy.typing import NDArray
from scipy.stats import beta
from stopping import at_frame_errors, at_precision

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.intervals import ber_interval, clopper_pearson
from vocc_torch.measure.paired import (
    difference_independent,
    mean_gain,
    paired_interval,
    relative_gain,
)

FRAMES = 2000
"""Frames in a study, the paper's number for a point."""

Ends: TypeAlias = NDArray[np.float64]
"""(studies,2): the low and the high end of each study's interval."""


@dataclass(frozen=True)
class Held:
    """How intervals did against the truth.

    Args:
        studies: how many there were.
        covered: share that held the truth.
        below: share that lay wholly below the truth.
        width: mean width.
    """

    studies: int
    covered: float
    below: float
    width: float

    @classmethod
    def of(cls, ends: Ends, truth: float) -> Held:
        """Judge the intervals of one truth."""
        below, above = ends[:, 1] < truth, ends[:, 0] > truth
        width = float((ends[:, 1] - ends[:, 0]).mean())
        return cls(
            len(ends), float(1 - (below | above).mean()), float(below.mean()), width
        )

    def __str__(self) -> str:
        """Give the coverage in percent, with its Monte Carlo standard error."""
        error = (self.covered * (1 - self.covered) / self.studies) ** 0.5
        return f"{100 * self.covered:.1f} ± {100 * error:.1f}"

    @property
    def sides(self) -> str:
        """Shares of the studies in percent with the truth below and above the interval."""
        return (
            f"{100 * abs(1 - self.covered - self.below):.1f} / {100 * self.below:.1f}"
        )


Table: TypeAlias = list[list[str]]
"""Rows of cells, the heading first."""


def cells(text: str) -> list[str]:
    """Split a row at its bars."""
    return text.split("|")


def ends_of(intervals: Sequence[Estimate]) -> Ends:
    """Line up the ends."""
    return np.array([(one.low, one.high) for one in intervals], dtype=np.float64)


def told(ends: Ends) -> str:
    """Give the share of the studies, in percent, whose interval leaves out 0."""
    return f"{100 * np.mean((ends[:, 0] > 0) | (ends[:, 1] < 0)):.0f}"


def by_bits(counts: Sequence[Counts]) -> Ends:
    """Clopper and Pearson's interval of bits that are taken to be independent."""
    wrong, bits = np.array([(one.bit_errors, one.bits) for one in counts]).T
    with np.errstate(invalid="ignore"):
        low, high = (
            beta.ppf(0.025, wrong, bits - wrong + 1),
            beta.ppf(0.975, wrong + 1, bits - wrong),
        )
    return np.stack([np.nan_to_num(low, nan=0.0), np.nan_to_num(high, nan=1.0)], axis=1)


def gain_by_bits(a: Sequence[Counts], b: Sequence[Counts]) -> Ends:
    """The usual interval of a ratio of two rates, with bits independent and receivers unpaired."""
    wrong_a, wrong_b = (
        np.array([one.bit_errors + 0.5 for one in side]) for side in (a, b)
    )
    reach = 1.96 * np.sqrt(1 / wrong_a + 1 / wrong_b)
    return np.stack(
        [1 - wrong_b / wrong_a * np.exp(reach), 1 - wrong_b / wrong_a * np.exp(-reach)],
        axis=1,
    )


FRAME_LAWS: dict[str, Law] = {
    "single bits": independent(1e-3),
    "correlation 0.05": clustered(1e-3, 0.05),
    "correlation 0.3": clustered(1e-2, 0.3),
    "0.5 % bad frames": mixed(independent(0.5), 0.005, independent(1e-4)),
}
MISS_RATES = (0.0, 0.001, 0.01, 0.1)

PAIRS: dict[str, Law] = {
    "b mends 24 %": mended(clustered(1e-3, 0.05), 0.24, 0.0),
    "b mends 30 %, spoils some": mended(clustered(1e-3, 0.05), 0.3, 6e-5),
    "same bad frames, b mends 24 % of the rest": mixed(
        alike(independent(0.5)), 0.005, mended(independent(1e-3), 0.24, 0.0)
    ),
    "own errors, b has 24 % fewer": apart(
        clustered(4e-3, 0.05), clustered(3.04e-3, 0.05)
    ),
    "own errors, equals": apart(clustered(4e-3, 0.05), clustered(4e-3, 0.05)),
    "own errors, b has 90 % fewer": apart(clustered(4e-3, 0.05), clustered(4e-4, 0.05)),
    "13 errors, b mends 24 %": mended(independent(1e-4), 0.24, 0.0),
}
PAIRED_CASES: list[tuple[str, str, Law]] = [
    *((name, "none", law) for name, law in PAIRS.items()),
    *(
        (name, f"{100 * rate:g} %", with_missed(PAIRS[name], rate))
        for name in ("b mends 24 %", "own errors, b has 24 % fewer")
        for rate in (0.001, 0.01)
    ),
    (
        "equals but for location",
        "1 %, by a only",
        missed_by_first(alike(clustered(1e-3, 0.05)), 0.01),
    ),
]


def one_receiver(rng: np.random.Generator, studies: int) -> Table:
    """Intervals of the bit error rate and of the frame error rate."""
    rows = [
        cells(
            "errors in a frame|panels missed|BER|frames in error|covers, %|truth below / above, %|width / BER"
            "|by bits covers, %|width / BER|frame errors: covers, %"
        )
    ]
    exact = lru_cache(maxsize=None)(clopper_pearson)
    for (name, law), rate in itertools.product(FRAME_LAWS.items(), MISS_RATES):
        whole = with_missed(law, rate)
        counts, ber = (
            whole.counts(whole.seen(rng, FRAMES, studies)),
            float(whole.ber[0]),
        )
        ours = Held.of(ends_of([ber_interval(one) for one in counts]), ber)
        naive = Held.of(by_bits(counts), ber)
        in_error = float(whole.frame_error_rate[0])
        frame_errors = Held.of(
            ends_of([exact(one.frame_errors, one.frames) for one in counts]), in_error
        )
        numbers = (
            f"{ber:.2g}",
            f"{FRAMES * in_error:.0f}",
            str(ours),
            ours.sides,
            f"{ours.width / ber:.2f}",
        )
        widths = (str(naive), f"{naive.width / ber:.2f}", str(frame_errors))
        rows.append([name, f"{100 * rate:g} %" if rate else "none", *numbers, *widths])
    return rows


def rare_kinds(rng: np.random.Generator, studies: int) -> Table:
    """Frames of a kind so rare that many studies never see one."""
    rows = [
        cells(
            "bad frames expected|share of the BER|never seen, %|covers, %|truth below / above, %"
        )
    ]
    for expected in (0.3, 1, 2, 3, 5, 10, 30):
        law = mixed(exactly(BITS // 2), expected / FRAMES, independent(1e-4))
        counts, ber = law.counts(law.seen(rng, FRAMES, studies)), float(law.ber[0])
        held = Held.of(ends_of([ber_interval(one) for one in counts]), ber)
        share = expected / FRAMES / 2 / ber
        never = 100 * np.exp(-expected)
        rows.append(
            [
                f"{expected:g}",
                f"{100 * share:.0f} %",
                f"{never:.1f}",
                str(held),
                held.sides,
            ]
        )
    return rows


def no_errors(rng: np.random.Generator, studies: int) -> Table:
    """The one-sided limit of an error-free point, where the truth lies just above it."""
    rows = [
        cells(
            "wrong bits in a wrong frame|taken|frames|BER|error-free studies, %|limit holds, %"
        )
    ]
    for bits, taken, frames in (
        (1, 1, 64),
        (1, 1, FRAMES),
        (20, 20, FRAMES),
        (5, 20, FRAMES),
        (20, 1, FRAMES),
    ):
        limit = ber_interval(
            Counts(frames, BITS * frames), errors_per_frame_error=float(taken)
        ).high
        law = mixed(exactly(bits), 1.0001 * limit * BITS / bits, exactly(0))
        clean = np.mean(
            [one.half_errors == 0 for one in law.counts(law.seen(rng, frames, studies))]
        )
        error = 100 * (clean * (1 - clean) / studies) ** 0.5
        numbers = (
            f"{bits}",
            f"{taken}",
            f"{frames}",
            f"{law.ber[0]:.2g}",
            f"{100 * clean:.1f}",
        )
        rows.append([*numbers, f"{100 * (1 - clean):.1f} ± {error:.1f}"])
    return rows


def two_receivers(rng: np.random.Generator, studies: int) -> Table:
    """Paired differences and relative gains."""
    rows = [
        cells(
            "receivers|panels missed|BER of a|frames that differ|difference: covers, %|gain|gain: covers, %"
            "|truth below / above, %|told from 0, %|by bits: covers, %|by bits: told, %"
        )
    ]
    for name, missed, law in PAIRED_CASES:
        seen = law.seen(rng, FRAMES, studies)
        a, b, paired = law.counts(seen, 0), law.counts(seen, 1), law.paired(seen)
        ber_a, ber_b = map(float, law.ber)
        difference = Held.of(
            ends_of([paired_interval(one) for one in paired]), ber_a - ber_b
        )
        gains = [relative_gain(*one) for one in zip(a, b, paired, strict=True)]
        ours, usual = (
            ends_of([one for one in gains if one is not None]),
            gain_by_bits(a, b),
        )
        gain, naive = (
            Held.of(ours, 1 - ber_b / ber_a),
            Held.of(usual, 1 - ber_b / ber_a),
        )
        differ = FRAMES * float(law.share @ (law.halves[:, 0] != law.halves[:, 1]))
        truth = round(100 * (1 - ber_b / ber_a), 6) + 0.0
        first = (f"{ber_a:.2g}", f"{differ:.0f}", str(difference), f"{truth:.2g} %")
        second = (str(gain), gain.sides, told(ours), str(naive), told(usual))
        rows.append([name, missed, *first, *second])
    return rows


def averages(rng: np.random.Generator, studies: int) -> Table:
    """The average gain over nine points, and differences of independent points."""
    rows = [cells("statement|truth|covers, %|truth below / above, %|told from 0, %")]
    gains, fewer = np.linspace(0.03, 0.19, 9), max(1, studies // 4)
    for name, rate in (("none", 0.0), ("1 %", 0.01)):
        laws = [
            with_missed(mended(clustered(1e-3, 0.05), float(gain), 0.0), rate)
            for gain in gains
        ]
        drawn = [
            list(
                zip(
                    law.counts(seen, 0),
                    law.counts(seen, 1),
                    law.paired(seen),
                    strict=True,
                )
            )
            for law in laws
            for seen in [law.seen(rng, FRAMES, fewer)]
        ]
        means = [mean_gain(points) for points in zip(*drawn, strict=True)]
        truth = float(np.mean([1 - law.ber[1] / law.ber[0] for law in laws]))
        ends = ends_of([one for one in means if one is not None])
        held = Held.of(ends, truth)
        title = f"mean gain over nine points, panels missed: {name}"
        rows.append([title, f"{100 * truth:.0f} %", str(held), held.sides, told(ends)])
    for first, second in ((1e-3, 1e-3), (2e-3, 1e-3), (1e-3, 0.0)):
        one, other = (
            clustered(first, 0.05),
            clustered(second, 0.05) if second else exactly(0),
        )
        pairs = zip(
            *(law.counts(law.seen(rng, FRAMES, studies)) for law in (one, other)),
            strict=True,
        )
        ends = ends_of([difference_independent(a, b) for a, b in pairs])
        held = Held.of(ends, first - second)
        title = f"difference of two points, BER {first:g} and {second:g}"
        rows.append([title, f"{first - second:g}", str(held), held.sides, told(ends)])
    return rows


def stopped(rng: np.random.Generator, studies: int) -> Table:
    """What stopping by what was seen does to rates and intervals."""
    rows = [
        cells(
            "errors in a frame|stopped|frames, mean|bias of the BER, %|covers, %|truth below / above, %"
        )
    ]
    laws = {
        "correlation 0.05, BER 1e-3": clustered(1e-3, 0.05),
        "correlation 0.05, BER 1e-5": clustered(1e-5, 0.05),
        "0.5 % bad frames": FRAME_LAWS["0.5 % bad frames"],
    }

    def add(name: str, how: str, counts: Sequence[Counts]) -> None:
        ber = float(laws[name].ber[0])
        rates, frames = (
            np.array([one.ber for one in counts]),
            np.mean([one.frames for one in counts]),
        )
        bias, error = (
            100 * (rates.mean() / ber - 1),
            100 * rates.std() / ber / len(rates) ** 0.5,
        )
        held = Held.of(ends_of([ber_interval(one) for one in counts]), ber)
        rows.append(
            [
                name,
                how,
                f"{frames:.0f}",
                f"{bias:+.1f} ± {error:.1f}",
                str(held),
                held.sides,
            ]
        )

    for name, law in laws.items():
        for target in (10, 30, 100):
            counts = at_frame_errors(law, rng, studies, target)
            add(name, f"at {target} frame errors", counts)
        precise = at_precision(law, rng, max(1, studies // 4), 0.1)
        add(name, "at 10 % precision", precise)
        fixed = round(np.mean([one.frames for one in precise]))
        add(name, "at a number of frames", law.counts(law.seen(rng, fixed, studies)))
    return rows
