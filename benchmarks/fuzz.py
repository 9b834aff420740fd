"""Fuzz whole studies: each answers with finite numbers in range, or is refused in one line.

    python benchmarks/fuzz.py --scenes 100000 --seed 0 --workers 2

Scene after scene is drawn from all that a configuration may say (tests/numerics/fuzzing.py) and run through
the whole link (tests/numerics/fuzz_demands.py). What comes of each goes to ``--folder`` at once, so that the
same command goes on where it was stopped. At the end the counts are printed and written to
docs/results/fuzz.csv.

A scene that takes more than 10 s of the processor or 2 GB of memory is a defect, and so is one that ends its
process. Sensors of more than 2000 px a side may take as many times more as they are longer, squared, and
panels of more than 4096 LEDs or four million samples as many times more as they have more.

    python benchmarks/fuzz.py --one 4711        shows one scene and what comes of it
"""

from __future__ import annotations

import argparse
import collections
import csv
import json
import os
import pprint
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "numerics"))

MOST_S = 10.0
MOST_BYTES = 2 << 30
RESTART = 3
"""Exit status of a worker whose memory a scene has swollen."""


def main():
    """Fuzz, or show one scene."""
    options = _options()
    if options.one is not None:
        return _show(options.seed, options.one)
    if options.shard is not None:
        return _work(options)
    options.folder.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    shards = [_Shard(options, number) for number in range(options.workers)]
    while not all([shard.looked_after() for shard in shards]):
        time.sleep(1)
        if int(time.monotonic() - started) % 60 == 0:
            print(f"{len(_results(options))} of {options.scenes}", flush=True)
    results = _results(options)
    rows = _rows(results)
    _tell(rows, results, time.monotonic() - started)
    if not options.folder_only:
        _write(rows, ROOT / "docs" / "results" / "fuzz.csv")
    return 1 if any(row[0] == "defect" for row in rows) else 0


def _options():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument(
        "--folder", type=Path, default=Path("runs/fuzz"), help="where each scene's outcome goes"
    )
    parser.add_argument("--folder-only", action="store_true", help="leave docs/results/fuzz.csv as it is")
    parser.add_argument("--one", type=int, help="show the scene of this index")
    parser.add_argument("--shard", type=int, help=argparse.SUPPRESS)
    return parser.parse_args()


class _Shard:
    """A worker process that is started again while it has scenes left."""

    def __init__(self, options, number):
        self.options, self.number, self.process = options, number, None

    def looked_after(self):
        """Start the worker, or start it again; say whether it has done all."""
        if self.process is None:
            self.process = self._started()
        status = self.process.poll()
        if status is None:
            return False
        if status == 0:
            return True
        if status != RESTART:
            begun = _begun_path(self.options, self.number)
            index = int(begun.read_text())
            # A worker that cannot even begin would be started for ever.
            if index in _done(self.options, self.number):
                raise SystemExit(f"worker {self.number} ended with status {status} before a scene")
            _record(
                self.options,
                self.number,
                {"index": index, "kind": "defect", "words": f"ended its process ({status})"},
            )
        self.process = self._started()
        return False

    def _started(self):
        own = [
            "--seed",
            self.options.seed,
            "--scenes",
            self.options.scenes,
            "--workers",
            self.options.workers,
        ]
        words = [*own, "--folder", self.options.folder, "--shard", self.number]
        environment = os.environ | {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
        return subprocess.Popen([sys.executable, __file__, *map(str, words)], env=environment)


def _work(options):
    """Do one worker's scenes, those whose index it has modulo the number of workers."""
    import torch
    from fuzz_demands import paper_flda
    from fuzzing import case_of

    torch.set_num_threads(1)
    done = _done(options, options.shard)
    begun = _begun_path(options, options.shard)
    paper_flda()
    signal.signal(signal.SIGALRM, _too_slow)
    _limit_memory()
    usual = _peak_bytes()
    with _path(options, options.shard).open("a") as file:
        for index in range(options.shard, options.scenes, options.workers):
            if index in done:
                continue
            begun.write_text(str(index))
            case = case_of(options.seed, index)
            record = _run(case)
            grown = _peak_bytes() - usual
            if grown > MOST_BYTES * _size(case) and record["kind"] != "defect":
                record |= {"kind": "defect", "words": "takes over 2 GB"}
            file.write(json.dumps({"index": index, **record}) + "\n")
            file.flush()
            if grown > MOST_BYTES // 2:
                return RESTART
    return 0


def _run(case):
    """Run a case and give what is recorded of it."""
    from fuzz_demands import DefectError, first_words, run

    signal.alarm(int(6 * MOST_S * _size(case)))
    started = time.process_time()
    try:
        outcome = run(case)
        locator = case.changes["receiver.locator"]
        words = first_words(outcome.line) if outcome.line else f"{locator} locator"
        record = {"kind": outcome.kind, "words": words, "found": outcome.found, "frames": outcome.frames}
    except DefectError as error:
        record = {"kind": "defect", "words": str(error)}
    finally:
        signal.alarm(0)
    took = time.process_time() - started
    if took > MOST_S * _size(case) and record["kind"] != "defect":
        record |= {"kind": "defect", "words": "takes over 10 s"}
    return record | {"ms": round(1000 * took)}


def _size(case):
    """How many times larger than usual a case's sensor or panel is, at least 1."""
    keys = "panel.rows", "panel.columns", "camera.width_px", "camera.height_px", "receiver.samples_per_led"
    rows, columns, width, height, samples = (min(max(case.changes[key], 1), 32768) for key in keys)
    leds = min(rows * columns, 1 << 20)
    return max(1, (max(width, height) / 2000) ** 2, leds / 4096, leds * min(samples, 64) ** 2 / 4e6)


def _too_slow(*_):
    raise TimeoutError("a scene takes minutes")


def _limit_memory():
    """Let an allocation fail before the machine does."""
    here = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (here + 4 * MOST_BYTES, resource.RLIM_INFINITY))


def _peak_bytes():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _path(options, shard):
    return options.folder / f"seed-{options.seed}-{shard}-of-{options.workers}.jsonl"


def _begun_path(options, shard):
    return _path(options, shard).with_suffix(".begun")


def _record(options, shard, record):
    with _path(options, shard).open("a") as file:
        file.write(json.dumps(record) + "\n")


def _read(path):
    """Read what is whole of a file that may have been cut."""
    records = []
    for line in path.read_text().splitlines() if path.exists() else []:
        try:
            records.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return records


def _done(options, shard):
    return {record["index"] for record in _read(_path(options, shard))}


def _results(options):
    """Every scene's record by its index."""
    paths = [_path(options, shard) for shard in range(options.workers)]
    return {record["index"]: record for path in paths for record in _read(path)}


def _rows(results):
    """Count the outcomes: kind, words, how often, and the first index."""
    counts, first = collections.Counter(), {}
    for index, record in sorted(results.items()):
        key = record["kind"], record["words"]
        counts[key] += 1
        first.setdefault(key, index)
    order = sorted(counts, key=lambda key: (key[0], -counts[key], key[1]))
    return [(*key, counts[key], first[key]) for key in order]


def _tell(rows, results, seconds):
    kinds = collections.Counter(record["kind"] for record in results.values())
    for kind, words, scenes, first in rows:
        print(f"{scenes:7}  {kind:9} {words}  (first: {first})")
    milliseconds = sum(record.get("ms", 0) for record in results.values()) / max(1, len(results))
    found, frames = (sum(record.get(name, 0) for record in results.values()) for name in ("found", "frames"))
    print(f"{len(results)} scenes: " + ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items())))
    print(f"{frames} frames answered, a panel in {found}")
    print(f"{milliseconds:.1f} ms of the processor a scene, {seconds:.0f} s in all")


def _write(rows, path):
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["outcome", "words", "scenes", "first_index"])
        writer.writerows(rows)


def _show(seed, index):
    from fuzz_demands import DefectError, run
    from fuzzing import case_of

    case = case_of(seed, index)
    pprint.pprint(case, sort_dicts=False)
    try:
        print(run(case))
    except DefectError as error:
        if error.__cause__ is not None:
            sys.excepthook(type(error.__cause__), error.__cause__, error.__cause__.__traceback__)
        print("defect:", error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
