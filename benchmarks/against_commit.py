"""The paper scene rendered by this tree against another commit, in one run: did a change slow it down?

Each side is a process of its own that imports its own sources and renders the same 64 scenes when it is told
to; the sides take turns, every other round the other way about, so that a busy spell hits both. The ratio of
each round is taken before the median. The frames' sum is compared too.

    python benchmarks/against_commit.py HEAD~5 --rounds 60
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
CHILD = """
import sys, time, torch
torch.set_num_threads(1)
from vocc_torch import PanelShape, Simulator
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import SceneModel
model = SceneModel()
scene, bits = model.draw(BlockKey(0, "against", 0), PanelShape())
simulator = Simulator()
print(sys.modules["vocc_torch"].__file__, flush=True)
for line in sys.stdin:
    begin = time.perf_counter()
    frames = simulator.render(scene, bits, nearest_m=model.nearest_m)
    spent = time.perf_counter() - begin
    print(spent, int(frames.grey.long().sum()), flush=True)
"""


class Side:
    """One tree, rendering in a process of its own."""

    def __init__(self, tree: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", CHILD],
            cwd=tree,
            env={"PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1", "PATH": "/usr/bin:/bin"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        loaded = self._line()
        if not loaded.startswith(str(tree)):
            raise SystemExit(f"{tree} was not the tree that was imported: {loaded}")

    def _line(self) -> str:
        """Read a line, or say that the process ended."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit("a side ended early")
        return line.strip()

    def render(self) -> tuple[float, int]:
        """Give the seconds of one batch and the sum of its pixels."""
        assert self.process.stdin is not None
        self.process.stdin.write("go\n")
        self.process.stdin.flush()
        seconds, total = self._line().split()
        return float(seconds), int(total)


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("commit")
    parser.add_argument("--rounds", type=int, default=60)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "before"
        subprocess.run(["git", "worktree", "add", "-q", "--detach", tree, given.commit], cwd=ROOT, check=True)
        try:
            sides = {"this tree": Side(ROOT), given.commit: Side(tree)}
            spent: dict[str, list[float]] = {name: [] for name in sides}
            sums: dict[str, int] = {}
            for turn in range(5 + given.rounds):
                for name in list(sides)[:: -1 if turn % 2 else 1]:
                    seconds, sums[name] = sides[name].render()
                    if turn >= 5:
                        spent[name].append(seconds)
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", tree], cwd=ROOT, check=True)
    ours, theirs = (np.array(seconds) / 64 * 1e3 for seconds in spent.values())
    for name, values in zip(spent, (ours, theirs), strict=True):
        low, middle, high = np.percentile(values, (25, 50, 75))
        print(f"{name:>12}: {middle:.4f} ms a frame [{low:.4f}, {high:.4f}]")
    low, middle, high = np.percentile(ours / theirs, (25, 50, 75))
    print(f"ratio of each round: {middle:.3f} [{low:.3f}, {high:.3f}] over {given.rounds} rounds, one thread")
    print(f"same frames: {'yes' if len(set(sums.values())) == 1 else 'NO'}")


if __name__ == "__main__":
    main()
