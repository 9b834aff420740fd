"""HEAD against another commit, in one run: did a change slow it down?

Each side is a process of its own that imports its own sources. Without ``--command`` it renders the same 64
scenes of the paper when it is told to, and the frames' sum is compared too; with it, it is a whole command in
an empty folder. The sides take turns, every other round the other way about, so that a busy spell hits both.
The ratio of each round is taken before the median.

    python benchmarks/against_commit.py HEAD~5 --rounds 60
    python benchmarks/against_commit.py HEAD~5 --rounds 5 --command 'task=figures budget.frames=256'
"""

import argparse
import shlex
import subprocess
import sys
import tempfile
import time
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


def environment(tree: Path) -> dict[str, str]:
    """Give what makes Python import the package of a tree."""
    return {"PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1", "PATH": "/usr/bin:/bin"}


class Renderer:
    """One tree, rendering in a process of its own."""

    frames, warm_up = 64, 5

    def __init__(self, tree: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", CHILD],
            cwd=tree,
            env=environment(tree),
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

    def turn(self) -> tuple[float, int]:
        """Give the seconds of one batch and the sum of its pixels."""
        assert self.process.stdin is not None
        self.process.stdin.write("go\n")
        self.process.stdin.flush()
        seconds, total = self._line().split()
        return float(seconds), int(total)


class Command:
    """One tree, running a command line from start to end."""

    frames, warm_up = 1, 0

    def __init__(self, tree: Path, words: str) -> None:
        self.tree, self.words = tree, shlex.split(words)
        # Installed, the configuration is a part of the package.
        if not (tree / "vocc_torch" / "conf").exists():
            (tree / "vocc_torch" / "conf").symlink_to(tree / "conf")

    def turn(self) -> tuple[float, int]:
        """Give the seconds of one run, and 0."""
        with tempfile.TemporaryDirectory() as folder:
            begin = time.perf_counter()
            subprocess.run(
                [sys.executable, "-m", "vocc_torch", *self.words],
                cwd=folder,
                env=environment(self.tree),
                stdout=subprocess.DEVNULL,
                check=True,
            )
            return time.perf_counter() - begin, 0


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("commit")
    parser.add_argument("--rounds", type=int, default=60)
    parser.add_argument("--command", help="the words after vocc-torch; '' for the default run")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        trees = {"HEAD": Path(folder) / "now", given.commit: Path(folder) / "before"}
        try:
            for commit, tree in trees.items():
                subprocess.run(
                    ["git", "worktree", "add", "-q", "--detach", tree, commit], cwd=ROOT, check=True
                )
            sides = {
                name: Renderer(tree) if given.command is None else Command(tree, given.command)
                for name, tree in trees.items()
            }
            spent: dict[str, list[float]] = {name: [] for name in sides}
            sums: dict[str, int] = {}
            kind = next(iter(sides.values()))
            for turn in range(kind.warm_up + given.rounds):
                for name in list(sides)[:: -1 if turn % 2 else 1]:
                    seconds, sums[name] = sides[name].turn()
                    if turn >= kind.warm_up:
                        spent[name].append(seconds)
        finally:
            for tree in trees.values():
                subprocess.run(["git", "worktree", "remove", "--force", tree], cwd=ROOT, check=False)
    ours, theirs = (np.array(seconds) / kind.frames for seconds in spent.values())
    unit, scale = ("ms a frame", 1e3) if given.command is None else ("s", 1.0)
    for name, values in zip(spent, (ours * scale, theirs * scale), strict=True):
        low, middle, high = np.percentile(values, (25, 50, 75))
        print(f"{name:>12}: {middle:.4f} {unit} [{low:.4f}, {high:.4f}]")
    low, middle, high = np.percentile(ours / theirs, (25, 50, 75))
    print(f"ratio of each round: {middle:.3f} [{low:.3f}, {high:.3f}] over {given.rounds} rounds, one thread")
    if given.command is None:
        print(f"same frames: {'yes' if len(set(sums.values())) == 1 else 'NO'}")


if __name__ == "__main__":
    main()
