"""Break the code as each hard case says and see it red: ``python tests/numerics/break_everything.py``.

Every change is made in a copy of the package, one at a time; the checkout stays as it is. A check that stays
green is listed, and the exit status is 1. Arguments: words of which a case's name must hold one.
"""

from __future__ import annotations

import importlib
import os
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from pathlib import Path

import torch

# Imported before the forks, so that each child begins with them; the package itself is imported after.
for _library in (
    "hypothesis",
    "kornia",
    "matplotlib.figure",
    "mpmath",
    "scipy.special",
    "scipy.stats",
):
    importlib.import_module(_library)

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
LIMIT_S = 600
GREEN, RED, NOT_BEGUN, OUT_OF_TIME = range(4)
WORDS = {
    RED: "red",
    GREEN: "STAYED GREEN",
    NOT_BEGUN: "BROKEN BEFORE THE CHECK",
    OUT_OF_TIME: "red (time)",
}


def modules():
    """Name the test modules that hold hard cases."""
    return sorted(path.stem for path in FOLDER.glob("test_*_hard_cases.py"))


def cases(package_root):
    """Import the cases with the package that lies in ``package_root``."""
    sys.path[:0] = [str(package_root), str(FOLDER), str(ROOT / "tests")]
    found = [
        case for name in modules() for case in importlib.import_module(name).hard.cases
    ]
    import vocc_torch

    assert Path(vocc_torch.__file__).is_relative_to(package_root), vocc_torch.__file__
    return found


def in_child(work):
    """Run ``work`` in a fork and give its exit status."""
    sys.stdout.flush()
    child = os.fork()
    if child:
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        return OUT_OF_TIME if status == -signal.SIGALRM else status
    signal.alarm(LIMIT_S)
    os._exit(work())


def outcome(copy, name, log):
    """Run one case against the copy as it stands, in a child of this process."""

    def work():
        with log.open("w") as out:
            os.dup2(out.fileno(), 1)
            os.dup2(out.fileno(), 2)
            try:
                check = next(case.check for case in cases(copy) if case.name == name)
            except BaseException:
                traceback.print_exc()
                return NOT_BEGUN
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    check()
            except BaseException:
                traceback.print_exc()
                return RED
            return GREEN

    return in_child(work)


def listed(copy):
    """Give name and change of each case, read in a child so that this process never imports the package."""
    file = copy / "cases.txt"

    def work():
        rows = [(case.name, case.broken_by) for case in cases(copy)]
        file.write_text(repr([(n, b.path, b.old, b.new) for n, b in rows]))
        return 0

    assert in_child(work) == 0, "the cases cannot be imported"
    import ast

    return ast.literal_eval(file.read_text())


def main(words):
    """Break, run, mend, for each case; give the exit status."""
    torch.set_num_threads(1)
    failed, done = [], 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for part in ("vocc_torch", "conf"):
            shutil.copytree(
                ROOT / part, copy / part, ignore=shutil.ignore_patterns("__pycache__")
            )
        sys.dont_write_bytecode = (
            True  # a mended file keeps the second of its broken one
        )
        for name, path, old, new in listed(copy):
            if words and not any(word in name for word in words):
                continue
            sound, log = (ROOT / path).read_text(), copy / "log.txt"
            if sound.count(old) != 1:
                status = "THE CHANGE DOES NOT FIT"
            elif outcome(copy, name, log) != GREEN:
                status = "RED WITHOUT ANY CHANGE\n" + log.read_text()
            else:
                (copy / path).write_text(sound.replace(old, new))
                status = WORDS.get(outcome(copy, name, log), "red (crash)")
                (copy / path).write_text(sound)
            done += 1
            print(f"{status:<14}{name}", flush=True)
            if not status.startswith("red"):
                failed.append(name)
                print(
                    log.read_text()
                    if log.exists() and status == WORDS[NOT_BEGUN]
                    else "",
                    end="",
                )
    print(f"{done - len(failed)} of {done} checks went red")
    return 1 if failed or not done else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
