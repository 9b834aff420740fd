"""The store under fire: kills, flipped bytes, forged rows, strangers' files, full disks, second writers.

Run as a script, this file is the process that forks and kills runs; see ``under_fire``.
"""

import os
import sqlite3
import tempfile
from contextlib import closing, suppress
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from one_point import A, MadeUp, run_point

from vocc_torch.errors import VoccError
from vocc_torch.measure.config import Budget
from vocc_torch.measure.runner import parts_of
from vocc_torch.measure.store import Store

SETTINGS = {
    "seed": 7,
    "world": {
        "camera": {"focal_length_mm": 25, "iso_limits": None},
        "effects": {"saturation": {}},
    },
    "receiver": {
        "names": ["a", "b"],
        "classifiers": [{"name": "b", "file": "mine/qda.py", "digest": "1f"}],
    },
    "made_with": {"torch": "2.4", "classifiers.b": "1f"},
}
POINT = "distance/distance_m=50"
WRONG = [3, 0, 64, 7, 1]


def job(asked=None):
    """Counts, and notes which blocks it was asked for."""
    return MadeUp(WRONG, POINT, asked=[] if asked is None else asked)


def content(part):
    return job().of(part).packed()


def ends(outcome):
    """What a point came to."""
    return outcome.counts[A], outcome.stopped_by, outcome.errors.half_errors.tolist()


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
    with Store.open(path, config) as store:
        run_point(job(), Budget(64 * blocks), store=store)
    return path.read_bytes()


def change(path, *statements):
    """Let SQLite itself change a ledger that is closed."""
    with closing(sqlite3.connect(path)) as connection, connection:
        for statement in statements:
            connection.execute(*statement) if isinstance(
                statement, tuple
            ) else connection.execute(statement)


# What is written is what is read.


def test_rows_come_back_as_they_were_written_from_one_file(path):
    with Store.open(path, SETTINGS) as store:
        store.add('µ\n"point"', 3, 64, bytes(range(256)))
        store.add(POINT, 0, 10, b"")
    assert [one.name for one in path.parent.iterdir()] == [path.name]
    with Store.open(path, SETTINGS) as store:
        assert store.find('µ\n"point"', 3, 64) == bytes(range(256))
        assert store.find(POINT, 0, 10) == b""
        assert store.find(POINT, 0, 64) is None
        assert store.find("another", 0, 10) is None
        assert len(store) == 2


def test_the_same_row_twice_is_written_once_and_another_is_refused(path):
    before = filled(path, blocks=2)
    with Store.open(path, SETTINGS) as store:
        (first, second) = parts_of(128)
        store.add(POINT, *second, content(second))
        refusal(
            lambda: store.add(POINT, *second, content(first)),
            "other counts",
            "block 1",
            POINT,
        )
    assert path.read_bytes() == before


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
    written = [at for at in range(len(whole)) if any(whole[at - 8 : at + 8])]
    at = data.draw(st.sampled_from(written))
    whole[at] ^= data.draw(st.integers(1, 255))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ledger.sqlite"
        path.write_bytes(whole)
        with suppress(VoccError), Store.open(path, SETTINGS) as store:
            assert ends(run_point(job(), rule, store=store)) == ends(
                run_point(job(), rule)
            )


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE blocks SET content = x'0011'",
        "UPDATE blocks SET frames = frames - 1",
        "UPDATE blocks SET block = block + 100",
        "UPDATE blocks SET digest = 'x'",
        "UPDATE blocks SET content = NULL",
        "UPDATE blocks SET content = 7",
        "UPDATE blocks SET content = '{}' WHERE point = 'key'",
        "UPDATE blocks SET point = 'other' WHERE point = 'key'",
        "DELETE FROM identity",
        "INSERT INTO identity SELECT * FROM identity",
    ],
)
def test_a_changed_row_is_damage(path, statement):
    filled(path)
    with Store.open(path, SETTINGS) as store:
        store.add("key", 0, 0, b"1", anew=True)
        store.add("key", 0, 0, b"2", anew=True)
        assert (store.find("key", 0, 0), store.find("other", 0, 0)) == (b"2", None)
    change(path, statement)
    before = path.read_bytes()
    refusal(
        lambda: Store.open(path, SETTINGS),
        "runs/ledger.sqlite",
        "is damaged",
        "copy",
        "delete it",
    )
    assert path.read_bytes() == before


def test_a_forged_row_is_refused_though_its_checksum_is_right(path):
    """It claims more errors than a frame has bits."""
    filled(path)
    forged = job().of(parts_of(64).__next__())
    forged.half_errors[0, 0] = 2 * 64 + 1
    with Store.open(path, SETTINGS) as store:
        digest = store._digest(POINT, 9, 64, forged.packed())
    change(
        path,
        (
            "INSERT INTO blocks VALUES (?, ?, ?, ?, ?)",
            (POINT, 9, 64, forged.packed(), digest),
        ),
    )
    with Store.open(path, SETTINGS) as store:
        refusal(
            lambda: run_point(job(), Budget(640), store=store), "counts", "wrong bits"
        )


def test_what_is_no_ordinary_file_of_its_own_is_refused(path):
    path.parent.mkdir()
    change(path, "CREATE TABLE mine (x)")
    refusal(lambda: Store.open(path, {}), "is no ledger")
    for name, make in (
        ("a", Path.mkdir),
        ("b", os.mkfifo),
        ("c", lambda one: one.symlink_to("/nowhere/x")),
        ("d-journal", os.mkfifo),
        ("e-wal", os.mkfifo),
    ):
        make(path.with_name(name))
        opened = path.with_name(name.partition("-")[0])
        refusal(
            lambda opened=opened: Store.open(opened, {}),
            f"runs/{name}",
            "ordinary file",
        )
    refusal(lambda: Store.open("/dev/null", {}), "/dev/null", "ordinary file")


CAMERA, RECEIVER = SETTINGS["world"], SETTINGS["receiver"]
QDA = [{"name": "b", "file": "mine/qda.py", "digest": "2e"}]


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        (
            {"seed": 8},
            "ledger runs/ledger.sqlite: seed was 7, is 8: use the earlier values, or give another name= or file",
        ),
        (
            {
                "world": {
                    **CAMERA,
                    "camera": {"focal_length_mm": 18, "iso_limits": [100, 3200]},
                }
            },
            ": camera.focal_length_mm was 25, is 18; camera.iso_limits was null, is [100, 3200]: use the earlier",
        ),
        (
            {"world": {**CAMERA, "effects": {}}},
            "effects was not set, is {}; effects.saturation was {}",
        ),
        (
            {
                "receiver": {**RECEIVER, "classifiers": QDA},
                "made_with": {"torch": "2.4", "classifiers.b": "2e"},
            },
            ": classifiers.b was 1f, is 2e; receiver.classifiers.0.digest was 1f, is 2e: use the earlier values",
        ),
        (
            {"made_with": {"torch": "2.5", "classifiers.b": "1f"}},
            ": torch was 2.4, is 2.5: use the earlier values",
        ),
        ({"seed": True}, "seed was 7, is true"),
        ({f"k{n:03}": n for n in range(99)}, "k000 was not set, is 0; k001"),
    ],
)
def test_other_settings_are_refused_in_one_short_line_that_names_what_changed(
    path, changes, named
):
    before = filled(path)
    refusal(lambda: Store.open(path, {**SETTINGS, **changes}), named)
    assert path.read_bytes() == before


# One writer, and a system that refuses.


def test_a_second_writer_is_refused_until_the_first_has_closed(path):
    with Store.open(path, SETTINGS) as first:
        for _ in range(2):
            refusal(
                lambda: Store.open(path, SETTINGS),
                "runs/ledger.sqlite is in use by another run",
            )
        first.add(POINT, 0, 64, b"")
    with Store.open(path, SETTINGS) as second:
        assert len(second) == 1
        first.close()
        refusal(lambda: Store.open(path, SETTINGS), "in use by another run")
    refusal(lambda: first.add(POINT, 1, 64, b""), "is closed")
    refusal(lambda: Store.open(path, {**SETTINGS, "seed": 8}), "seed was 7")
    Store.open(path, SETTINGS).close()


# Kills. A process of its own, with one thread, forks a run, kills it with SIGKILL, and forks the next.
