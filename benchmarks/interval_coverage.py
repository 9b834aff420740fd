"""Coverage of the 95 % intervals, on simulated frames whose true error rate is known.

Writes a CSV file for each table of ``docs/results/coverage``:

    python benchmarks/interval_coverage.py
"""

import argparse
import csv
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
from frame_laws import (
    BITS,
    Law,
    clustered,
    corrected,
    exactly,
    independent,
    mixed,
    separate,
    with_missed,
)
from numpy.typing import NDArray
from scipy.stats import beta

from vocc_torch.measure.config import Budget
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.frame_errors import Key
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.paired import paired_interval, relative_gain
from vocc_torch.measure.runner import stop_reason
from vocc_torch.rng import BLOCK_FRAMES

FRAMES = 2000
"""Frames in a study, the paper's number for a point."""
ENDLESS = 10**12
"""A budget of frames that no study reaches."""
KEY = Key("truth", "receiver"), 0

Ends: TypeAlias = NDArray[np.float64]
"""(studies,2): the low and the high end of each study's interval."""
Table: TypeAlias = list[tuple[object, ...]]
"""Rows of cells, the heading first."""

FRAME_LAWS: dict[str, Law] = {
    "single bits": independent(1e-3),
    "correlation 0.05": clustered(1e-3, 0.05),
    "correlation 0.3": clustered(1e-2, 0.3),
    "0.5 % bad frames": mixed(independent(0.5), 0.005, independent(1e-4)),
}
MISS_RATES = (0.0, 0.001, 0.01, 0.1)
PAIRS: dict[str, Law] = {
    "b corrects 24 %": corrected(clustered(1e-3, 0.05), 0.24),
    "13 errors, b corrects 24 %": corrected(independent(1e-4), 0.24),
    "separate errors, b has 24 % fewer": separate(
        clustered(4e-3, 0.05), clustered(3.04e-3, 0.05)
    ),
    "separate errors, equal rates": separate(
        clustered(4e-3, 0.05), clustered(4e-3, 0.05)
    ),
}


def ends_of(intervals: Sequence[Estimate]) -> Ends:
    """Stack the ends of intervals, (studies,2)."""
    return np.array([(found.low, found.high) for found in intervals])


def coverage(ends: Ends, truth: float) -> tuple[str, str]:
    """Give the coverage with its standard error, and the shares with the truth below and above, all in %."""
    below, above = truth < ends[:, 0], truth > ends[:, 1]
    share = 1 - float((below | above).mean())
    error = (share * (1 - share) / len(ends)) ** 0.5
    sides = f"{100 * below.mean():.1f} / {100 * above.mean():.1f}"
    return f"{100 * share:.1f} ± {100 * error:.1f}", sides


def detected(ends: Ends) -> str:
    """Give the share of the studies whose interval leaves out 0, %."""
    return f"{100 * np.mean((ends[:, 0] > 0) | (ends[:, 1] < 0)):.0f}"


def by_bits(counts: Sequence[Counts]) -> Ends:
    """Clopper and Pearson's interval of bits that are taken to be independent."""
    wrong, bits = np.array([(count.bit_errors, count.bits) for count in counts]).T
    low = beta.ppf(0.025, wrong, bits - wrong + 1)
    high = beta.ppf(0.975, wrong + 1, bits - wrong)
    return np.stack([np.nan_to_num(low, nan=0.0), np.nan_to_num(high, nan=1.0)], 1)


def gain_by_bits(a: Sequence[Counts], b: Sequence[Counts]) -> Ends:
    """The usual interval of a ratio of two rates, with bits independent and receivers unpaired."""
    wrong_a, wrong_b = (
        np.array([count.bit_errors + 0.5 for count in side]) for side in (a, b)
    )
    reach = 1.96 * np.sqrt(1 / wrong_a + 1 / wrong_b)
    ratios = [wrong_b / wrong_a * np.exp(sign * reach) for sign in (1, -1)]
    return 1 - np.stack(ratios, axis=1)


def one_receiver(rng: np.random.Generator, studies: int) -> Table:
    """Intervals of the bit error rate, beside those of independent bits."""
    heads = ("errors in a frame", "panels missed, %", "BER", "covers, %")
    rows: Table = [(*heads, "truth below / above, %", "by bits covers, %")]
    for (name, law), rate in itertools.product(FRAME_LAWS.items(), MISS_RATES):
        missing = with_missed(law, rate)
        counts, ber = missing.counts(missing.draw(rng, FRAMES, studies)), missing.ber[0]
        found = coverage(ends_of([ber_interval(count) for count in counts]), ber)
        naive, _ = coverage(by_bits(counts), ber)
        rows.append((name, 100 * rate, f"{ber:.2g}", *found, naive))
    return rows


def rare_kinds(rng: np.random.Generator, studies: int) -> Table:
    """Coverage where a kind of frame is so rare that many studies have none."""
    heads = ("bad frames expected", "share of the BER, %", "never occur, %")
    rows: Table = [(*heads, "covers, %", "truth below / above, %")]
    for expected in (0.3, 1, 2, 3, 5, 10, 30):
        law = mixed(exactly(BITS // 2), expected / FRAMES, independent(1e-4))
        counts, ber = law.counts(law.draw(rng, FRAMES, studies)), law.ber[0]
        share, never = 50 * expected / FRAMES / ber, 100 * np.exp(-expected)
        found = coverage(ends_of([ber_interval(count) for count in counts]), ber)
        rows.append((expected, f"{share:.0f}", f"{never:.1f}", *found))
    return rows


def two_receivers(rng: np.random.Generator, studies: int) -> Table:
    """Paired differences and relative gains, beside gains of unpaired independent bits."""
    heads = ("receivers", "panels missed, %", "BER of a", "difference covers, %")
    heads += ("gain, %", "gain covers, %", "truth below / above, %", "detected, %")
    rows: Table = [(*heads, "detected with unpaired bits, %")]
    for (name, pair), rate in itertools.product(PAIRS.items(), (0.0, 0.01)):
        law = with_missed(pair, rate)
        drawn = law.draw(rng, FRAMES, studies)
        a, b, paired = law.counts(drawn, 0), law.counts(drawn, 1), law.paired(drawn)
        ber_a, ber_b = map(float, law.ber)
        differences = ends_of([paired_interval(study) for study in paired])
        covered, _ = coverage(differences, ber_a - ber_b)
        gains = [relative_gain(*study) for study in zip(a, b, paired, strict=True)]
        ends = ends_of([gain for gain in gains if gain is not None])
        truth = round(1 - ber_b / ber_a, 6)
        first = (name, 100 * rate, f"{ber_a:.2g}", covered, f"{100 * truth:.2g}")
        shares = detected(ends), detected(gain_by_bits(a, b))
        rows.append((*first, *coverage(ends, truth), *shares))
    return rows


def stop(
    law: Law, rng: np.random.Generator, studies: int, rule: Budget
) -> list[Counts]:
    """Count each study up to the block at which the rule stops it."""
    lines = np.zeros((studies, len(law.share)), dtype=np.int64)
    going, blocks = np.arange(studies), 0
    while going.size:
        lines[going] += law.draw(rng, BLOCK_FRAMES, going.size)
        blocks += 1
        counts = law.counts(lines[going])
        stopped = [
            stop_reason(rule, {KEY: count}, blocks) is not None for count in counts
        ]
        going = going[~np.array(stopped)]
    return law.counts(lines)


def stopping(rng: np.random.Generator, studies: int) -> Table:
    """What stopping by errors does to rates and intervals."""
    heads = ("errors in a frame", "stopped", "frames, mean", "bias of the BER, %")
    rows: Table = [(*heads, "covers, %", "truth below / above, %")]
    rules = {
        f"at {errors} frame errors": Budget(frames=ENDLESS, target_frame_errors=errors)
        for errors in (10, 30, 100)
    }
    rules["at 10 % precision"] = Budget(frames=ENDLESS, precision=0.1)
    for name, (title, rule) in itertools.product(
        ("correlation 0.05", "0.5 % bad frames"), rules.items()
    ):
        law = FRAME_LAWS[name]
        counts = stop(law, rng, max(1, studies // 4), rule)
        rates, ber = np.array([count.ber for count in counts]), float(law.ber[0])
        bias, error = rates.mean() / ber - 1, rates.std() / ber / len(rates) ** 0.5
        frames = np.mean([count.frames for count in counts])
        found = coverage(ends_of([ber_interval(count) for count in counts]), ber)
        shown = f"{100 * bias:+.1f} ± {100 * error:.1f}"
        rows.append((name, title, f"{frames:.0f}", shown, *found))
    return rows


TABLES: tuple[Callable[[np.random.Generator, int], Table], ...] = (
    one_receiver,
    rare_kinds,
    two_receivers,
    stopping,
)


def main() -> None:
    """Simulate, and write the tables."""
    parser = argparse.ArgumentParser(description="Coverage of the intervals.")
    parser.add_argument("--trials", type=int, default=3000, help="studies per row")
    parser.add_argument("--seed", type=int, default=0, help="root of the random draws")
    parser.add_argument("--out", type=Path, default=Path("docs/results/coverage"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for index, simulate in enumerate(TABLES):
        rng = np.random.default_rng([options.seed, index])
        path = options.out / f"{simulate.__name__}.csv"
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerows(simulate(rng, options.trials))
        print(path, flush=True)


if __name__ == "__main__":
    main()
