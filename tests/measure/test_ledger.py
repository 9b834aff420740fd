"""The ledger under fire: kills, flipped bytes, forged rows, strangers' files, full disks, second writers.

Run as a script, this file is the process that forks and kills runs; see ``under_fire``.
"""

import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
import traceback
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from one_point import run_point

from vocc_torch.errors import VoccError
from vocc_torch.measure import ledger as module
from vocc_torch.measure.config import Budget
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.ledger import Ledger, canonical
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.measure.point_work import PointWork, parts_of
from vocc_torch.measure.schedule import run_points
from vocc_torch.measure.workers import Workers
from vocc_torch.rng import BlockKey

SETTINGS = {
    "seed": 7,
    "world": {"camera": {"focal_length_mm": 25, "iso_limits": None}, "effects": {"saturation": {}}},
    "receiver": {"names": ["a", "b"], "classifiers": [{"name": "b", "file": "mine/qda.py", "digest": "1f"}]},
    "made_with": {"torch": "2.4", "classifiers.b": "1f"},
}
POINT = "distance/distance_m=50"
BITS = 64


def counted(part):
    """Errors of two receivers in two groups; every fifth block has no frame in any group."""
    rng = BlockKey(7, POINT, part.block).generator("bits")
    halves = 2 * rng.binomial(BITS, 0.01, (2, 64))[:, : part.frames]
    group = rng.integers(0, 2, 64)[: part.frames]
    found = {}
    for index in np.unique(group).tolist() if part.block % 5 < 4 else ():
        for name, mine in zip("ab", halves[:, group == index], strict=True):
            sums = (int(mine.sum()), int((mine**2).sum()), int((mine > 0).sum()))
            found[name, index] = Counts(len(mine), BITS * len(mine), *sums)
    return found


def count(parts, asked=None):
    """Counts, and notes which blocks it was asked for."""
    if asked is not None:
        asked.extend(part.block for part in parts)
    return [counted(part) for part in parts]


def refusal(call, *parts):
    """The refusal's one line, which is short but for the path."""
    with pytest.raises(VoccError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) <= 200
    for part in parts:
        assert str(part) in message, message
    return message


@pytest.fixture
def path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path / "runs" / "ledger.sqlite"


def filled(path, blocks=4, config=SETTINGS):
    """A ledger file of some whole blocks; its bytes."""
    with Ledger.open(path, config) as ledger:
        outcome_of(ledger, Budget(64 * blocks))
    return path.read_bytes()


def outcome_of(ledger, rule, function=count, submit=None, **options):
    works = [PointWork(POINT, function, rule, ledger)]
    (outcome,) = run_points(works, submit or Workers(1).submit, **options)
    return outcome


def change(path, *statements):
    """Let SQLite itself change a ledger that is closed."""
    with closing(sqlite3.connect(path)) as connection, connection:
        for statement in statements:
            connection.execute(*statement) if isinstance(statement, tuple) else connection.execute(statement)


def rows_in(path):
    """Blocks that have a row, read without the code under test."""
    if not path.exists() or not path.stat().st_size:
        return set()
    with suppress(sqlite3.OperationalError), closing(sqlite3.connect(path)) as connection:
        return {block for (block,) in connection.execute("SELECT block FROM blocks")}
    return set()


# What is written is what is read.


def test_rows_come_back_as_they_were_written_from_one_file(path):
    mixed = {
        ("flda_2", 0): Counts(60, 3840, 9, 81, 1, 1),
        ("flda_2", "flda_3", 0): PairedCounts(64, 4096, 6, 20, 2, 4, 8, 2),
    }
    with Ledger.open(path, SETTINGS) as ledger:
        ledger.append('µ\n"point"', 3, 64, mixed)
        ledger.append(POINT, 0, 10, {})
    assert [one.name for one in path.parent.iterdir()] == [path.name]
    with Ledger.open(path, SETTINGS) as ledger:
        assert list(ledger.find('µ\n"point"', 3, 64).items()) == list(mixed.items())
        assert ledger.find(POINT, 0, 10) == {}
        assert ledger.find(POINT, 0, 64) is None
        assert ledger.find("another", 0, 10) is None
        assert len(ledger) == 2


def test_the_same_row_twice_is_written_once_and_another_is_refused(path):
    before = filled(path, blocks=2)
    with Ledger.open(path, SETTINGS) as ledger:
        (first, second) = parts_of(128)
        ledger.append(POINT, 1, 64, counted(second))
        refusal(lambda: ledger.append(POINT, 1, 64, counted(first)), "other counts", "block 1", POINT)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("block", "frames", "counts", "named"),
    [
        (-1, 64, {}, "block is -1"),
        (0, 0, {}, "frames is 0"),
        (0, 65, {}, "frames is 65"),
        (0, 10, {("a", 0): Counts(11, 704)}, "11 frames"),
        (0, 10, {("a", 0.5): Counts(1, 64)}, "filed under"),
    ],
)
def test_impossible_rows_are_refused_and_not_written(path, block, frames, counts, named):
    with Ledger.open(path, SETTINGS) as ledger:
        refusal(lambda: ledger.append(POINT, block, frames, counts), named)
        assert len(ledger) == 0


# Resuming.


@pytest.mark.parametrize("target", [None, 150])
@pytest.mark.parametrize("blocks_at_once", [1, 3])
def test_a_resumed_run_ends_as_an_undisturbed_one(path, target, blocks_at_once):
    """Known blocks lie before, between and behind those that are missing."""
    rule = Budget(1000, target_frame_errors=target)
    undisturbed = run_point(count, rule)
    assert undisturbed.stopped_by == ("frames" if target is None else "frame_errors")
    filled(path, blocks=2)
    asked, parts = [], list(parts_of(1000))
    with Ledger.open(path, SETTINGS) as ledger:
        for block in (9, 6, 4):
            ledger.append(POINT, block, 64, counted(parts[block]))
        outcome = outcome_of(ledger, rule, partial(count, asked=asked), blocks_at_once=blocks_at_once)
        assert outcome == undisturbed
        assert not {0, 1, 4, 6, 9} & set(asked)
        assert len(set(asked)) == len(asked)
        assert outcome_of(ledger, rule, lambda _: pytest.fail("counted again")) == undisturbed


def test_a_block_used_in_part_is_counted_again_when_more_of_it_is_needed_and_both_rows_stay(path):
    with Ledger.open(path, SETTINGS) as ledger:
        for frames, expected in ((100, [0, 1]), (128, [1]), (100, []), (128, []), (90, [1]), (200, [2, 3])):
            asked = []
            outcome = outcome_of(ledger, Budget(frames), partial(count, asked=asked))
            assert (outcome, asked) == (run_point(count, Budget(frames)), expected)
        assert len(ledger) == 6


# Damage, strangers, other versions, other settings: refused, and the file stays as it was.


@pytest.fixture(scope="module")
def three_blocks(tmp_path_factory):
    """A ledger of three blocks: its bytes."""
    return filled(tmp_path_factory.mktemp("three") / "ledger.sqlite", blocks=3)


@given(data=st.data())
@settings(deadline=None, max_examples=80)
def test_a_changed_byte_is_refused_or_changes_no_number(three_blocks, data):
    """Some bytes of a database are unused; a row that is lost is counted again."""
    whole, rule = bytearray(three_blocks), Budget(192)
    at = data.draw(st.integers(0, len(whole) - 1).filter(lambda at: any(three_blocks[at - 8 : at + 8])))
    whole[at] ^= data.draw(st.integers(1, 255))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ledger.sqlite"
        path.write_bytes(whole)
        with suppress(VoccError), Ledger.open(path, SETTINGS) as ledger:
            assert outcome_of(ledger, rule) == run_point(count, rule)


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE blocks SET counts = replace(counts, '64', '63')",
        "UPDATE blocks SET block = block + 100",
        "UPDATE blocks SET digest = 'x'",
        "UPDATE blocks SET counts = x'00'",
        "UPDATE blocks SET counts = NULL",
        "UPDATE trained SET content = '{}'",
        "UPDATE trained SET key = 'other'",
        "DELETE FROM identity",
        "INSERT INTO identity SELECT * FROM identity",
    ],
)
def test_a_changed_row_is_damage(path, statement):
    filled(path)
    with Ledger.open(path, SETTINGS) as ledger:
        ledger.keep("key", '{"a": 1}')
        ledger.keep("key", '{"a": 2}')
        assert (ledger.kept("key"), ledger.kept("other")) == ({"a": 2}, None)
    change(path, statement)
    before = path.read_bytes()
    refusal(lambda: Ledger.open(path, SETTINGS), "runs/ledger.sqlite", "is damaged", "copy", "delete it")
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "row",
    [
        ("p", 77, 65, "[]"),
        ("p", 77, 64, '[["counts", ["a", 0], [1, 2]]]'),
        ("p", 77, 64, '[["another", ["a", 0], []]]'),
        ("p", 77, 64, "not JSON"),
        ("p", 77, 64, "[" * 100_000),
        ("p", 77, 64, '[["counts", ["a", 0], [' + "9" * 5000 + "]]]"),
        ("p", 77, 64, '[["counts", [["a"], 0], [1, 64, 0, 0, 0, 0]]]'),
    ],
)
def test_a_forged_row_is_refused_though_its_checksum_is_right(path, row):
    filled(path)
    digest = module._digest(canonical(SETTINGS), *row)
    change(path, ("INSERT INTO blocks VALUES (?, ?, ?, ?, ?)", (*row, digest)))
    refusal(lambda: Ledger.open(path, SETTINGS))


@pytest.mark.parametrize("content", [b"my notes", b"experiment,axis\n" * 100])
def test_a_strangers_file_is_refused_and_left_alone(path, content):
    path.parent.mkdir()
    path.write_bytes(content)
    refusal(lambda: Ledger.open(path, {}), "runs/ledger.sqlite is no ledger", "choose another")
    assert path.read_bytes() == content
    assert list(path.parent.iterdir()) == [path]


def test_what_is_no_ordinary_file_of_its_own_is_refused(path):
    path.parent.mkdir()
    change(path, "CREATE TABLE mine (x)")
    refusal(lambda: Ledger.open(path, {}), "is no ledger")
    for name, make in (("a", Path.mkdir), ("b", os.mkfifo), ("c", lambda one: one.symlink_to("/nowhere/x"))):
        make(path.with_name(name))
        refusal(lambda name=name: Ledger.open(path.with_name(name), {}), f"runs/{name}", "ordinary file")
    refusal(lambda: Ledger.open("/dev/null", {}), "/dev/null", "ordinary file")
    old = path.with_name("old.jsonl")
    old.write_text("{}")
    refusal(lambda: Ledger.open(old.with_suffix(".sqlite"), {}), "runs/old.jsonl", "older version")
    assert not old.with_suffix(".sqlite").exists()


def test_another_release_of_the_package_is_refused(path, monkeypatch):
    filled(path)
    monkeypatch.setattr(module, "__version__", "9.9.9")
    refusal(lambda: Ledger.open(path, SETTINGS), "is of vocc-torch", "9.9.9", "the release that began it")


CAMERA, RECEIVER = SETTINGS["world"], SETTINGS["receiver"]
QDA = [{"name": "b", "file": "mine/qda.py", "digest": "2e"}]


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"seed": 8}, "ledger runs/ledger.sqlite: seed was 7, is 8: go back, or choose another ledger"),
        (
            {"world": {**CAMERA, "camera": {"focal_length_mm": 18, "iso_limits": [100, 3200]}}},
            ": camera.focal_length_mm was 25, is 18; camera.iso_limits was null, is [100, 3200]: go back",
        ),
        ({"world": {**CAMERA, "effects": {}}}, "effects was not set, is {}; effects.saturation was {}"),
        (
            {
                "receiver": {**RECEIVER, "classifiers": QDA},
                "made_with": {"torch": "2.4", "classifiers.b": "2e"},
            },
            ": mine/qda.py changed since this run began: go back",
        ),
        ({"made_with": {"torch": "2.5", "classifiers.b": "1f"}}, ": torch was 2.4, is 2.5: go back"),
        ({"seed": True}, "seed was 7, is true"),
        ({f"k{n:03}": n for n in range(99)}, "k000 was not set, is 0; k001"),
    ],
)
def test_other_settings_are_refused_in_one_short_line_that_names_what_changed(path, changes, named):
    before = filled(path)
    refusal(lambda: Ledger.open(path, {**SETTINGS, **changes}), named)
    assert path.read_bytes() == before


@pytest.mark.parametrize("value", [float("nan"), float("inf"), Path("runs")])
def test_settings_that_json_does_not_have_are_refused_before_there_is_a_file(path, value):
    refusal(lambda: Ledger.open(path, {"a": [value]}), "settings cannot be written")
    assert not path.parent.exists()


# One writer, and a system that refuses.


def test_a_second_writer_is_refused_until_the_first_has_closed(path):
    with Ledger.open(path, SETTINGS) as first:
        for _ in range(2):
            refusal(lambda: Ledger.open(path, SETTINGS), "runs/ledger.sqlite is in use by another run")
        first.append(POINT, 0, 64, {})
    with Ledger.open(path, SETTINGS) as second:
        assert len(second) == 1
        first.close()
        refusal(lambda: Ledger.open(path, SETTINGS), "in use by another run")
    refusal(lambda: first.append(POINT, 1, 64, {}), "is closed")
    refusal(lambda: Ledger.open(path, {**SETTINGS, "seed": 8}), "seed was 7")
    Ledger.open(path, SETTINGS).close()


def test_a_ledger_deleted_during_the_run_is_noticed(path):
    with Ledger.open(path, SETTINGS) as ledger:
        path.unlink()
        refusal(lambda: ledger.append(POINT, 0, 64, {}), "deleted under this run", "start it again")


def test_what_cannot_be_written_is_refused(path, monkeypatch):
    """A read-only file system binds root too."""
    filled(path)
    monkeypatch.setattr(os, "access", lambda *_: False)
    refusal(lambda: Ledger.open(path, SETTINGS), "cannot write runs/ledger.sqlite", "make it writable")
    monkeypatch.undo()
    refusal(lambda: Ledger.open(path / "below" / "ledger", SETTINGS), "cannot write")


# Kills. A process of its own, with one thread, forks a run, kills it with SIGKILL, and forks the next.

KILLED_BLOCKS, THREADS = 20, 3


def live(folder):
    """One life of a run: it says which blocks it counts, and writes its result if it gets so far."""
    said = os.open(folder / "calls", os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def slow(parts):
        for part in parts:
            os.write(said, f"{part.block}\n".encode())
        # Blocks do not take equally long, so that threads end them out of order.
        time.sleep(0.001 * sum(1 + part.block % 3 for part in parts) / 2)
        return count(parts)

    with Ledger.open(folder / "ledger", SETTINGS) as ledger, ThreadPoolExecutor(THREADS) as pool:
        rule = Budget(KILLED_BLOCKS * 64 - 10)
        outcome = outcome_of(ledger, rule, slow, pool.submit, window=2 * THREADS)
    (folder / "result").write_text(repr(outcome))


def forked(function, *arguments):
    """Run a function in a forked process that ends with it."""
    child = os.fork()
    if child:
        return child
    try:
        function(*arguments)
        os._exit(0)
    except BaseException:
        traceback.print_exc()
        os._exit(1)


def under_fire(folder):
    """Fork lives, each killed after a random time, until one ends well; told as JSON."""
    told, draw = [], random.Random(2)
    for number in range(2000):
        (folder / "calls").write_text("")
        known = rows_in(folder / "ledger")
        child = forked(live, folder)
        # Ever longer, so that the run comes to its end on a machine of any speed.
        time.sleep(draw.uniform(0, 0.01 + 0.006 * number))
        os.kill(child, signal.SIGKILL)
        status = os.waitpid(child, 0)[1]
        calls = [int(line) for line in (folder / "calls").read_text().split()]
        told.append((sorted(known), calls, sorted(rows_in(folder / "ledger")), status))
        if not os.WIFSIGNALED(status):
            break
    left = sorted(one.name for one in folder.iterdir())
    print(json.dumps({"lives": told, "result": (folder / "result").read_text(), "left": left}))


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_run_killed_at_random_moments_ends_as_an_undisturbed_one(tmp_path):
    """A life counts nothing that is recorded, and loses only what was under way; one file is left."""
    single = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    environment = {**os.environ, **single, "PYTHONPATH": str(Path(__file__).parents[1])}
    options = {"env": environment, "capture_output": True, "text": True, "check": False, "timeout": 300}
    done = subprocess.run([sys.executable, __file__, tmp_path], **options)
    assert (done.returncode, "Traceback" in done.stderr) == (0, False), done.stderr
    report = json.loads(done.stdout)
    *killed, (*_, ended) = report["lives"]
    assert report["result"] == repr(run_point(count, Budget(KILLED_BLOCKS * 64 - 10)))
    assert report["left"] == ["calls", "ledger", "result"]
    assert ended == 0
    assert len(killed) >= 5
    for known, calls, after, _ in report["lives"]:
        assert not set(calls) & set(known)
        assert len(calls) == len(set(calls))
        assert set(known) <= set(after)
        assert len(set(calls) - set(after)) <= 2 * THREADS


if __name__ == "__main__":
    under_fire(Path(sys.argv[1]))
