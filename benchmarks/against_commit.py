"""HEAD against another commit, in one run: did a change slow it down?

Each commit has a process that imports its sources. Without ``--command`` a round renders 64 of the paper's scenes,
or reads 32 full-HD frames, or runs the whole link on 256 crops. The sum of the pixels or bits is compared, too. With
``--command`` a round is one command in an empty folder. The commits take turns, and the order changes with each round,
so that other load on the machine affects both. The result is the median of the ratios of single rounds.

    python benchmarks/against_commit.py HEAD~5 --rounds 60
    python benchmarks/against_commit.py HEAD~5 --work receiver --batch 1 --processor-time
    python benchmarks/against_commit.py HEAD~5 --work link --batch 64
    python benchmarks/against_commit.py HEAD~5 --rounds 5 --command 'task=figures budget.frames=256'
"""

import argparse
import os
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
from vocc_torch import PanelShape, Scene, Simulator
from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import SceneModel

work, batch, clock = sys.argv[1], int(sys.argv[2]), getattr(time, sys.argv[3])
model, shape = SceneModel(), PanelShape()
locator, reader, simulator = PaperLocator(), Reader(shape), Simulator()

def drawn(blocks):
    parts = [model.draw(BlockKey(0, "against", block), shape) for block in range(blocks)]
    return Scene.cat([scene for scene, _ in parts]), torch.cat([bits for _, bits in parts])

def locate_and_measure(frames):
    panels = locator(frames, shape)
    return panels, reader.measure(frames, panels, *reader.rectify([frames], panels), FEATURE_NAMES).features

def trained():
    scene, bits = drawn(8)
    panels, features = locate_and_measure(simulator.render(scene, bits))
    return FLDA(3).fit(features[panels.found], bits[panels.found])

def turns():
    if work == "render":
        scene, bits = drawn(1)
        while True:
            yield simulator.render(scene, bits, nearest_m=model.nearest_m).grey
    flda = trained()
    if work == "receiver":
        scene, bits = drawn(1)
        receiver = Receiver("flda_3", locator, reader, flda)
        whole = Simulator(framing="filled")
        parts = [whole.render(scene[at : at + 8], bits[at : at + 8]).grey.clone() for at in range(0, 32, 8)]
        parts = torch.cat(parts).split(batch)
        while True:
            yield torch.cat([receiver.decode(part).bits for part in parts])
    scene, bits = drawn(4)
    while True:
        with torch.inference_mode():
            found = []
            for at in range(0, 256, batch):
                rows = slice(at, at + batch)
                frames = simulator.render(scene[rows], bits[rows], nearest_m=model.nearest_m)
                panels, features = locate_and_measure(frames)
                found.append(flda.predict(features) & panels.found.view(-1, 1, 1))
        yield torch.cat(found)

print(sys.modules["vocc_torch"].__file__, flush=True)
turn = turns()
for line in sys.stdin:
    begin = clock()
    made = next(turn)
    print(clock() - begin, int(made.long().sum()), flush=True)
"""
FRAMES = {"render": 64, "receiver": 32, "link": 256}
"""The work of a round, and its number of frames."""


def environment(tree: Path) -> dict[str, str]:
    """Give the environment in which Python imports the package of a tree, and glibc keeps freed memory."""
    kept = {
        "MALLOC_MMAP_THRESHOLD_": str(32 << 20),
        "MALLOC_TRIM_THRESHOLD_": str(256 << 20),
    }
    return {
        "PYTHONPATH": str(tree),
        "OMP_NUM_THREADS": "1",
        "PATH": "/usr/bin:/bin",
        **kept,
    }


class Side:
    """A process that works with the package of one tree."""

    warm_up = 5

    def __init__(self, tree: Path, work: str, batch: int, clock: str) -> None:
        self.frames = FRAMES[work]
        self.process = subprocess.Popen(
            [sys.executable, "-c", CHILD, work, str(batch), clock],
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
        """Give the seconds of one round and the sum of its pixels or bits."""
        assert self.process.stdin is not None
        self.process.stdin.write("go\n")
        self.process.stdin.flush()
        seconds, total = self._line().split()
        return float(seconds), int(total)


class Command:
    """A command line that runs with the package of one tree."""

    frames, warm_up = 1, 0

    def __init__(self, tree: Path, words: str, clock: str) -> None:
        self.tree, self.words, self.clock = tree, shlex.split(words), clock
        # Installed, the configuration is a part of the package.
        if not (tree / "vocc_torch" / "conf").exists():
            (tree / "vocc_torch" / "conf").symlink_to(tree / "conf")

    def turn(self) -> tuple[float, int]:
        """Give the seconds of one run, and 0."""
        with tempfile.TemporaryDirectory() as folder:
            begin = self._now()
            subprocess.run(
                [sys.executable, "-m", "vocc_torch", *self.words],
                cwd=folder,
                env=environment(self.tree),
                stdout=subprocess.DEVNULL,
                check=True,
            )
            return self._now() - begin, 0

    def _now(self) -> float:
        """Give the time of the clock, or the processor time of all ended processes, s."""
        return (
            time.perf_counter()
            if self.clock == "perf_counter"
            else sum(os.times()[2:4])
        )


def main() -> None:
    """Compare and print."""
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0] if __doc__ else None
    )
    parser.add_argument("commit")
    parser.add_argument("--rounds", type=int, default=60)
    parser.add_argument(
        "--work", choices=FRAMES, default="render", help="what is timed"
    )
    parser.add_argument(
        "--batch", type=int, default=1, help="frames a call of the receiver or the link"
    )
    parser.add_argument(
        "--processor-time",
        action="store_true",
        help="processor time, on a busy machine",
    )
    parser.add_argument(
        "--command", help="the words after vocc-torch; '' for the default run"
    )
    given = parser.parse_args()
    clock = "process_time" if given.processor_time else "perf_counter"
    with tempfile.TemporaryDirectory() as folder:
        trees = {"HEAD": Path(folder) / "now", given.commit: Path(folder) / "before"}
        try:
            for commit, tree in trees.items():
                subprocess.run(
                    ["git", "worktree", "add", "-q", "--detach", tree, commit],
                    cwd=ROOT,
                    check=True,
                )
            sides = {
                name: Side(tree, given.work, given.batch, clock)
                if given.command is None
                else Command(tree, given.command, clock)
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
                subprocess.run(
                    ["git", "worktree", "remove", "--force", tree],
                    cwd=ROOT,
                    check=False,
                )
    ours, theirs = (np.array(seconds) / kind.frames for seconds in spent.values())
    unit, scale = ("ms a frame", 1e3) if given.command is None else ("s", 1.0)
    for name, values in zip(spent, (ours * scale, theirs * scale), strict=True):
        low, middle, high = np.percentile(values, (25, 50, 75))
        print(f"{name:>12}: {middle:.4f} {unit} [{low:.4f}, {high:.4f}]")
    low, middle, high = np.percentile(ours / theirs, (25, 50, 75))
    print(
        f"ratio of each round: {middle:.3f} [{low:.3f}, {high:.3f}] over {given.rounds} rounds, one thread"
    )
    if given.command is None:
        print(f"same sum: {'yes' if len(set(sums.values())) == 1 else 'NO'}")


if __name__ == "__main__":
    main()
