"""Freeze what every command leaves, and compare with it: ``golden.py make`` and ``check`` (see README.md)."""

import argparse
import csv
import difflib
import inspect
import math
import os
import re
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import yaml

HERE = Path(__file__).parent
DATA = HERE / "data"
BYTE_EQUAL = {"default/ber.csv"}
"""Kept whole and compared byte for byte."""
MOST_ROWS = 40
"""Of a longer table, every n-th row is kept, and how many there were."""
MEASURED = re.compile(
    r"_ms$|_s$|(waited|median|quartile)_share$|frontier|beaten_by|surely_beaten|best_batch|^rounds$|share_of_detection|frames_per_s"
    r"|^ms(_low|_high)?$|^rank$|^median$|^(lower|upper)_quartile$|^end_to_end|^seconds|^size_bytes$|^threads$|^machine$|^text$|^measured$|^reason$|^where$|^basis$"
)
"""Columns that are times, hang on times or on the machine, or are sentences."""
TIMED = re.compile(r"^(time|fig25)\.")
"""Claims and numbers of the paper's study that are about times: of their rows the name alone is kept."""
NAMES = "names"


def arguments_of(name):
    """The command lines of a name, as lists of arguments."""
    table = yaml.safe_load((HERE / "commands.yaml").read_text())
    root = HERE.parents[1]
    for line in table["commands"][name]:
        words = shlex.split(line.format(root=root, **table["words"]))
        tail = [] if "name=" in line and f"name={name}/" in line else [f"name={name}"]
        yield words if "task=collect" in words else [*words, *tail, "device=cpu"]


def call(arguments, folder):
    """Run the command line in a process of its own, on one thread; returns what it printed."""
    done = subprocess.run(
        [sys.executable, "-m", "vocc_torch", *arguments],
        cwd=folder,
        env={**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": "120"},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        sys.exit(
            f"vocc-torch {shlex.join(arguments)}\nended with {done.returncode}: {done.stderr[-2000:]}"
        )
    return done.stdout


def normal(path):
    """A file's name without what differs between runs, or between ways to keep a ledger."""
    name = re.sub(r"events\.out\.tfevents\..*", "events", path)
    return re.sub(r"(^|.*/)ledgers?(\..*|/.*)$", r"\1ledger", name)


def reduced(source, target):
    """Keep the columns that are the same in every run, of ``MOST_ROWS`` rows; returns the table's length."""
    with source.open(newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    kept = [at for at, column in enumerate(head) if not MEASURED.search(column)]
    step = math.ceil(max(len(rows), 1) / MOST_ROWS) if head[0] != "claim" else 1
    target.parent.mkdir(parents=True, exist_ok=True)
    with target.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([head[at] for at in kept])
        for row in rows[::step]:
            timed = head[0] in ("claim", "number") and TIMED.match(row[0])
            writer.writerow(["" if timed and at else row[at] for at in kept])
    return len(rows)


def keep_run(run, into):
    """Write what is compared of one run's folder."""
    said = set()
    for path in sorted(path for path in run.rglob("*") if path.is_file()):
        name = path.relative_to(run).as_posix()
        said.add(f"file {normal(name)}")
        if f"{into.name}/{name}" in BYTE_EQUAL:
            into.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, into / name)
        elif path.suffix == ".csv":
            said.add(f"rows {name} {reduced(path, into / name)}")
        elif path.suffix == ".md":
            said |= {
                f"heading {name} {line}"
                for line in path.read_text().splitlines()
                if line.startswith("#")
            }
    write_lines(said, into)


def write_lines(lines, into):
    """Write a folder's list of facts."""
    into.mkdir(parents=True, exist_ok=True)
    (into / "facts.txt").write_text("".join(f"{line}\n" for line in sorted(lines)))


def leaves(tree, path=""):
    """The keys of a configuration with their values, a line each."""
    if isinstance(tree, dict) and tree:
        for key, below in tree.items():
            yield from leaves(below, f"{path}.{key}" if path else str(key))
    else:
        yield f"{path}: {tree}"


def public_names():
    """The names of the package, and of its classes with their parameters."""
    import vocc_torch

    for name in sorted({*vocc_torch.__all__, "__version__"}):
        thing = getattr(vocc_torch, name)
        yield f"name {name}{parameters(thing)}"
        for base in thing.__mro__ if inspect.isclass(thing) else ():
            if base.__module__.startswith("vocc_torch"):
                for part in (part for part in vars(base) if not part.startswith("_")):
                    yield f"name {name}.{part}{parameters(getattr(thing, part))}"


def parameters(thing):
    """The names of what a class or function takes."""
    if not callable(thing):
        return ""
    try:
        return f"({', '.join(word for word in inspect.signature(thing).parameters if word != 'self')})"
    except ValueError:
        return ""  # an exception's is not written in Python


def keep_names(folder, into):
    """Write the package's names, the groups of ``--help``, and each task's keys with their values."""
    lines = set(public_names())
    groups = re.findall(
        r"^(\w+): ([\w, ]+)$", call(["--help"], folder).split("\nKeys")[0], re.MULTILINE
    )
    options = {group: words.split(", ") for group, words in groups}
    lines |= {
        f"option {group}={word}" for group, words in options.items() for word in words
    }
    for task in options["task"]:
        keys = yaml.safe_load(call([f"task={task}", "--cfg", "job"], folder))
        lines |= {f"key {task} {line}" for line in leaves(keys)}
    common = {line.split(" ", 2)[2] for line in lines if line.startswith("key test ")}
    write_lines(
        {
            line
            for line in lines
            if not re.match(r"key (?!test)", line)
            or line.split(" ", 2)[2] not in common
        },
        into,
    )


def make(names, into):
    """Run the commands of some names and keep what is compared."""
    for name in names:
        shutil.rmtree(into / name, ignore_errors=True)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        with tempfile.TemporaryDirectory() as folder:
            if name == NAMES:
                keep_names(folder, into / name)
            else:
                for arguments in arguments_of(name):
                    call(arguments, folder)
                keep_run(Path(folder) / "runs" / name, into / name)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        print(f"{name:16}{spent:6.1f} s of processor time", flush=True)


def same(column, old, new):
    """Counts, words and rates are equal as text; other numbers agree to five digits."""
    if old == new or column in ("ber", "bits", "bit_errors", "frame_errors", "frames"):
        return old == new
    try:
        return math.isclose(float(old), float(new), rel_tol=1e-5, abs_tol=1e-6) and {
            old,
            new,
        }.isdisjoint("01")
    except ValueError:
        return False


def table_differences(old, new):
    """What differs between two tables; new columns are no difference."""
    with old.open(newline="") as first, new.open(newline="") as second:
        before, after = list(csv.DictReader(first)), list(csv.DictReader(second))
    if len(before) != len(after):
        yield f"{len(before)} rows before, {len(after)} now"
        return
    gone = [column for column in before[0] if column not in after[0]] if before else []
    yield from (f"column {column} is gone" for column in gone)
    for at, (row, other) in enumerate(zip(before, after, strict=True), 2):
        for column, value in row.items():
            if column not in gone and not same(column, value, other[column]):
                yield f"line {at}, {column}: {value or 'nothing'} before, {other[column] or 'nothing'} now"


def differences(names, frozen, made):
    """A line for each difference between what is frozen and what was made."""
    for name in names:
        paths = {
            path.relative_to(root)
            for root in (frozen, made)
            for path in (root / name).rglob("*.*")
        }
        for path in sorted(paths):
            old, new = frozen / path, made / path
            if not (old.exists() and new.exists()):
                yield f"{path}: {'is gone' if old.exists() else 'is new'}"
            elif path.as_posix() in BYTE_EQUAL:
                if old.read_bytes() != new.read_bytes():
                    yield f"{path}: not equal byte for byte"
                    yield from (
                        f"{path}: {line}" for line in table_differences(old, new)
                    )
            elif path.suffix == ".csv":
                yield from (f"{path}: {line}" for line in table_differences(old, new))
            else:
                for line in difflib.ndiff(
                    *(file.read_text().splitlines() for file in (old, new))
                ):
                    if line[0] == "-" or (line[0] == "+" and name != NAMES):
                        yield f"{path}: {'is gone' if line[0] == '-' else 'is new'}: {line[2:]}"


def main(words=None):
    """Make or check; the exit status is 1 where something differs."""
    names = [NAMES, *yaml.safe_load((HERE / "commands.yaml").read_text())["commands"]]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("verb", choices=("make", "check", "compare"))
    parser.add_argument(
        "--only",
        nargs="+",
        choices=names,
        default=names,
        metavar="NAME",
        help=", ".join(names),
    )
    parser.add_argument(
        "--into",
        type=Path,
        help="a folder for what is made; compare takes it from there",
    )
    chosen = parser.parse_args(words)
    if chosen.verb == "make":
        make(chosen.only, chosen.into or DATA)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        into = chosen.into or Path(folder)
        if chosen.verb == "check":
            make(chosen.only, into)
        found = list(differences(chosen.only, DATA, into))
    print(*found, f"{len(found)} differences in {len(chosen.only)} commands", sep="\n")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
