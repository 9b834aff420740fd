"""A run that ends early and is started again under its name: the numbers of one that nobody disturbed."""

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing

import pytest
import yaml
from running import run_in

from vocc_torch.measure import kept_training, runner

BLOCKS = 8
"""Two points of four blocks."""

RUN = (
    *(
        "budget.frames=256",
        "budget.training_frames=64",
        "experiment.values=[1000,2000]",
        "tensorboard=false",
    ),
    *(
        "receiver.names=[average_greyscale,flda_2,flda_3]",
        "experiment.scene.distance_m=66",
        "name=x",
    ),
)
RESULTS = ("ber.csv", "paired.csv")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The folder of a run that nobody disturbed."""
    folder = tmp_path_factory.mktemp("undisturbed")
    assert run_in(folder, *RUN).status == 0
    return folder / "runs" / "x"


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "runs" / "x"


@pytest.fixture
def ended_after(undisturbed, folder):
    """Leave what a run leaves that was killed when it had counted some blocks."""

    def leave(blocks, *changes):
        folder.mkdir(parents=True)
        for name in ("ledger.sqlite", "config.yaml"):
            shutil.copy(undisturbed / name, folder)
        later = rows_in(undisturbed / "ledger.sqlite")[blocks:]
        change(
            folder,
            ("DELETE FROM blocks WHERE point=? AND block=? AND frames=?", later),
            *changes,
        )

    return leave


@pytest.fixture
def asked(monkeypatch):
    """The blocks that are counted in this process."""
    blocks, count = [], runner.Job.__call__

    def watched(self, parts):
        blocks.extend((self.rows, part.block, part.frames) for part in parts)
        return count(self, parts)

    monkeypatch.setattr(runner.Job, "__call__", watched)
    return blocks


def rows_in(ledger, alive=False):
    """Point, block and frames of each row, in order, read without the code under test."""
    try:
        where = f"file:{ledger}?mode=ro{'&immutable=1' * alive}"
        with closing(sqlite3.connect(where, uri=True)) as connection:
            return connection.execute(
                "SELECT point, block, frames FROM blocks WHERE frames ORDER BY 1, 2, 3"
            ).fetchall()
    except sqlite3.Error:
        return []


def change(folder, *changes):
    """Let SQLite itself change the ledger: statements, each with its rows of values."""
    with closing(sqlite3.connect(folder / "ledger.sqlite")) as connection, connection:
        for statement, rows in changes:
            connection.executemany(statement, rows)


def assert_as(folder, undisturbed):
    """Tables are equal to the last byte, and every block stands in the ledger once."""
    for name in RESULTS:
        assert (folder / name).read_bytes() == (undisturbed / name).read_bytes()
    rows = rows_in(folder / "ledger.sqlite")
    assert len(rows) == len(set(rows))
    assert set(rows) == set(rows_in(undisturbed / "ledger.sqlite"))


# Killed and interrupted, in processes of their own

INTERRUPTIBLE = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
from vocc_torch.__main__ import main
if __name__ == "__main__":
    main()
"""


def life(cwd, rows, end, *arguments):
    """Start the command, end it once its ledger holds some rows, and give what it leaves behind.

    The workers hold the pipes too: these end when the last process is gone.
    """
    ledger = cwd / "runs" / "x" / "ledger.sqlite"
    with subprocess.Popen(
        [sys.executable, "-u", "-c", INTERRUPTIBLE, *RUN, *arguments],
        cwd=cwd,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as run:
        try:
            while len(rows_in(ledger, alive=True)) < rows:
                assert run.poll() is None
                time.sleep(0.02)
            end(run.pid)
            out, err = run.communicate(timeout=60)
        finally:
            run.kill()
    return {"status": run.returncode, "out": out, "err": err, "rows": rows_in(ledger)}


@pytest.fixture(scope="module")
def lives(tmp_path_factory, undisturbed):
    """A run of two workers that is killed, goes on, is interrupted, and is ready to go on to its end."""
    if os.name != "posix":
        pytest.skip("sends signals to groups of processes")
    cwd = tmp_path_factory.mktemp("lives")
    killed = life(cwd, 2, lambda pid: os.kill(pid, signal.SIGKILL), "workers=2")
    interrupted = life(
        cwd, len(rows_in(cwd / "runs/x/ledger.sqlite")) + 1, interrupt_all, "workers=2"
    )
    return {"cwd": cwd, "killed": killed, "interrupted": interrupted}


def interrupt_all(pid):
    """Ctrl-C in a terminal reaches every process of the command."""
    os.killpg(pid, signal.SIGINT)


@pytest.mark.slow
def test_workers_end_with_a_killed_parent_and_an_interrupted_run_says_how_to_go_on(
    lives,
):
    """Only the parent was killed; that its pipes came to their end says that nobody holds them."""
    killed, interrupted = lives["killed"], lives["interrupted"]
    assert killed["status"] == -signal.SIGKILL
    assert 2 <= len(killed["rows"]) < BLOCKS
    assert (interrupted["status"], interrupted["err"]) == (
        130,
        "vocc-torch: interrupted\n",
    )
    assert interrupted["out"].endswith(
        "interrupted: the same command with name=x resumes\n"
    )
    known = len(killed["rows"])
    where = lives["cwd"] / "runs" / "x" / "ledger.sqlite"
    assert (
        f"resuming: {known} blocks of frames are already counted in {where}\n"
        in interrupted["out"]
    )


@pytest.mark.slow
def test_a_run_killed_and_interrupted_ends_as_an_undisturbed_one(
    app, lives, undisturbed, monkeypatch, asked
):
    """With one worker, or with two."""
    monkeypatch.chdir(lives["cwd"])
    known = rows_in(lives["cwd"] / "runs" / "x" / "ledger.sqlite")
    assert (
        set(lives["killed"]["rows"]) <= set(lives["interrupted"]["rows"]) == set(known)
    )
    ran = app(*RUN)
    assert (ran.status, ran.err) == (0, "")
    assert_as(lives["cwd"] / "runs" / "x", undisturbed)
    assert not set(asked) & set(known)
    assert len(asked) == BLOCKS - len(known)


# As killed runs leave it


def test_what_was_counted_is_not_counted_again(
    app, ended_after, folder, undisturbed, asked, monkeypatch
):
    """And what was trained is not trained again."""
    ended_after(3)
    monkeypatch.setattr(
        kept_training, "train_part", lambda *_: pytest.fail("trained again")
    )
    known = rows_in(folder / "ledger.sqlite")
    ran = app(*RUN)
    assert (ran.status, ran.err) == (0, "")
    told = (
        f"resuming: 3 blocks of frames are already counted in {folder}/ledger.sqlite\n"
    )
    assert ran.out.startswith(told)
    assert "\nresuming: the receivers are trained already\n" in ran.out
    assert_as(folder, undisturbed)
    assert not set(asked) & set(known)
    assert (len(known), len(asked)) == (3, BLOCKS - 3)


def test_another_budget_and_more_values_take_what_is_there(
    app, undisturbed, folder, asked, tmp_path
):
    """They end as a run of their own would, and count only what is missing."""
    shutil.copytree(undisturbed, folder)
    longer = ("budget.frames=300", "experiment.values=[1000,1500,2000]")
    assert app(*RUN, *longer).status == 0
    new = [
        ("1000", 4, 44),
        *(("1500", block, 64) for block in range(4)),
        ("1500", 4, 44),
        ("2000", 4, 44),
    ]
    counted = [(point.partition(" ")[0], *part) for point, *part in asked]
    assert counted == [(f"ambient/ambient_lx={value}", *part) for value, *part in new]
    assert app(*RUN, *longer, "name=own").status == 0
    own = tmp_path / "runs" / "own"
    first, second = (
        yaml.safe_load((one / "config.yaml").read_text()) for one in (folder, own)
    )
    assert {**first, "name": "own"} == second
    for name in RESULTS:
        assert (folder / name).read_bytes() == (own / name).read_bytes()
        assert (folder / name).read_bytes() != (undisturbed / name).read_bytes()
