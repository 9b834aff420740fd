"""The default run on a busy machine: its time alone, and beside processes that never rest.

    python benchmarks/busy.py --rounds 3
    python benchmarks/busy.py --rounds 3 --program ../before/.venv/bin/vocc-torch

Alone, beside one and beside two busy processes, in turns; medians of wall time and processor time, s.
"""

import argparse
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence

SPIN = "while True: pass"


def run(program: Sequence[str], words: Sequence[str], busy: int) -> tuple[float, float]:
    """Run a command beside busy processes, and give its wall time and its processor time, s."""
    others = [subprocess.Popen([sys.executable, "-c", SPIN]) for _ in range(busy)]
    try:
        with tempfile.TemporaryDirectory() as folder:
            before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
            subprocess.run([*program, *words], cwd=folder, check=True, stdout=subprocess.DEVNULL)
            wall_s, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    finally:
        for one in others:
            one.kill()
            one.wait()
    return wall_s, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3, help="how often each is run")
    parser.add_argument("--most", type=int, default=2, help="most busy processes")
    parser.add_argument("--program", nargs="+", default=[sys.executable, "-m", "vocc_torch"])
    parser.add_argument("--words", nargs="*", default=["name=busy"], help="the run's")
    options = parser.parse_args(arguments)
    spent: dict[int, list[tuple[float, float]]] = {busy: [] for busy in range(options.most + 1)}
    for _ in range(options.rounds):
        for busy, times in spent.items():
            times.append(run(options.program, options.words, busy))
    alone = statistics.median(wall for wall, _ in spent[0])
    for busy, times in spent.items():
        wall, processor = (statistics.median(column) for column in zip(*times, strict=True))
        print(
            f"{busy} busy: {wall:.1f} s, {processor:.1f} s of processor time, {wall / alone:.2f} times alone"
        )


if __name__ == "__main__":
    main()
