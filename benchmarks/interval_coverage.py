"""Do the 95 % intervals hold the truth in 95 % of the cases? Simulated on frames whose truth is known.

Writes a CSV file for each table of ``docs/results/coverage``, in about two minutes of one core:

    python benchmarks/interval_coverage.py
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import numpy as np
from coverage_tables import (
    Table,
    averages,
    no_errors,
    one_receiver,
    rare_kinds,
    stopped,
    two_receivers,
)

Simulate: TypeAlias = Callable[[np.random.Generator, int], Table]

TABLES: tuple[tuple[Simulate, int], ...] = (
    (one_receiver, 1),
    (rare_kinds, 1),
    (no_errors, 1),
    (two_receivers, 2),
    (averages, 2),
    (stopped, 1),
)
"""The tables, each with the factor by which it takes fewer studies, because it is slow."""


def write_table(folder: Path, name: str, table: Table) -> None:
    """Write a table as a CSV file."""
    with (folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(table)


def main() -> None:
    """Simulate, and write the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=3000, help="studies per row")
    parser.add_argument("--seed", type=int, default=0, help="root of the random draws")
    parser.add_argument("--out", type=Path, default=Path("docs/results/coverage"))
    options = parser.parse_args()
    if options.trials < 8 or options.seed < 0:
        parser.error("--trials must be at least 8 and --seed at least 0")
    options.out.mkdir(parents=True, exist_ok=True)
    for index, (simulate, fewer) in enumerate(TABLES):
        start = time.process_time()
        rng = np.random.default_rng([options.seed, index])
        table = simulate(rng, options.trials // fewer)
        write_table(options.out, simulate.__name__, table)
        seconds = time.process_time() - start
        print(f"{simulate.__name__}: {seconds:.0f} s of CPU", flush=True)


if __name__ == "__main__":
    main()
