"""Do the 95 % intervals hold the truth in 95 % of the cases? Simulated on frames whose truth is known.

Writes the tables of ``docs/statistics.md`` into the page, between its markers, in order:

    python benchmarks/interval_coverage.py
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
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

from vocc_torch.errors import VoccError
from vocc_torch.files import write_atomically

BEGIN, END = (
    "<!-- generated: python benchmarks/interval_coverage.py -->",
    "<!-- end -->",
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
"""The page's tables in order, each with how many times fewer studies it takes; these are the slow ones."""


def markdown(table: Table) -> str:
    """Write a table as Markdown."""
    heading, *rows = ("| " + " | ".join(row) + " |" for row in table)
    return "\n".join([heading, "|" + "---|" * len(table[0]), *rows])


def filled(page: str, blocks: Sequence[str]) -> str:
    """Put blocks between the page's markers, in order.

    Raises:
        VoccError: the page has another number of markers.
    """
    first, *rest = page.split(BEGIN)
    if len(rest) != len(blocks) or any(END not in part for part in rest):
        raise VoccError(
            f"the page has {len(rest)} generated blocks: it must have {len(blocks)}, each with its end"
        )
    tails = [part.split(END, 1)[1] for part in rest]
    return first + "".join(
        f"{BEGIN}\n\n{block}\n\n{END}{tail}"
        for block, tail in zip(blocks, tails, strict=True)
    )


def main() -> None:
    """Simulate, and write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--trials",
        type=int,
        default=3000,
        help="studies a row, at least 8 (default 3000)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="root of the random draws (default 0)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("docs/statistics.md"),
        help="the page to fill in",
    )
    given = parser.parse_args()
    if given.trials < 8 or given.seed < 0:
        parser.error(
            f"--trials is {given.trials}, --seed is {given.seed}: at least 8, and at least 0"
        )
    blocks = []
    for index, (simulate, fewer) in enumerate(TABLES):
        start, studies = time.process_time(), given.trials // fewer
        text = markdown(simulate(np.random.default_rng([given.seed, index]), studies))
        blocks.append(f"{text}\n\n{studies} studies a row, seed {given.seed}.")
        print(
            f"{simulate.__name__}, {time.process_time() - start:.0f} s of CPU\n{text}\n",
            flush=True,
        )
    page = (
        given.out.read_text()
        if given.out.exists()
        else f"{BEGIN}\n{END}\n" * len(blocks)
    )
    write_atomically(given.out, filled(page, blocks).encode())


if __name__ == "__main__":
    main()
