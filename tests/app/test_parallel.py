"""Jobs of a multirun at the same time: the same results, and every failure heard of."""

import io
import os
import signal
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from joblib import cpu_count

from vocc_torch.app import cli
from vocc_torch.app.jobs import CONFIG, FAILED, JobLines, Jobs, begin_again, write_down
from vocc_torch.errors import VoccError

PARALLEL = ("-m", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2")


# In processes of their own

STAND_IN = """
import multiprocessing, os, sys, time

def run_task(settings, folder):
    print("threads", os.environ.get("MKL_NUM_THREADS"), flush=True)
    if settings.seed == 1:
        raise ValueError("a bug")
    if settings.seed == 2:
        raise cli.VoccError("seed is 2: it must be another")
    if settings.seed >= 8:
        if settings.seed == 9:
            (folder / "ledger.sqlite").write_text("")
        print("waiting", flush=True)
        time.sleep(60)
    # A job with workers starts processes of its own.
    process = multiprocessing.get_context("spawn").Process(target=int)
    process.start()
    process.join()
    (folder / "result.txt").write_text(f"{settings.seed} {process.exitcode}")

# Jobs run in processes of joblib alone.
if "popen_loky" in str(sys.orig_argv):
    from vocc_torch.app import cli
    cli.run_task = run_task
"""


@pytest.fixture
def stand_in(tmp_path, monkeypatch):
    """Put quick tasks in place of the real ones, in every process that is started."""
    site = tmp_path / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(STAND_IN)
    path = os.pathsep.join(filter(None, [str(site), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setenv("PYTHONPATH", path)
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    away = tmp_path / "away"
    away.mkdir()
    return away


def test_a_fault_in_a_worker_is_seen_and_loses_nothing(command, stand_in):
    ran = command(*PARALLEL, "seed=0,1,2", "name=two", cwd=stand_in)
    assert ran.status == 1
    folder = stand_in / "runs" / "two"
    assert (folder / "0" / "result.txt").read_text() == "0 0"
    first, _, trace = (folder / "1" / FAILED).read_text().partition("\n")
    assert first == "ValueError: a bug"
    assert "Traceback (most recent call last)" in trace
    assert 'raise ValueError("a bug")' in trace
    assert (folder / "2" / FAILED).read_text() == "seed is 2: it must be another\n"
    assert ran.err.count("Traceback (most recent call last)") == 1
    lines = ran.err.splitlines()
    for complaint in (
        "job 1: ValueError: a bug",
        "job 2: seed is 2: it must be another",
        "2 of 3 jobs failed (1, 2): failed.txt in their folders says why",
    ):
        assert lines.count(f"vocc-torch: error: {complaint}") == 1
    # Every line says whose it is, and no line is torn.
    assert {line[:8] for line in ran.out.splitlines()} == {
        "job 0 | ",
        "job 1 | ",
        "job 2 | ",
    }
    # The jobs share the cores: as many threads for each as its part of them.
    (threads,) = {
        line.split()[-1] for line in ran.out.splitlines() if "| threads " in line
    }
    assert int(threads) == max(1, cpu_count() // 2)


INTERRUPTIBLE = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
from vocc_torch.__main__ import main
main()
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_workers_end_with_a_killed_parent(stand_in):
    """Those that work, and one that waits for a job."""
    three = (*PARALLEL[:-1], "hydra.launcher.n_jobs=3")
    with subprocess.Popen(
        [sys.executable, "-m", "vocc_torch", *three, "seed=8,9", "name=two"],
        cwd=stand_in,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as run:
        begun = ""
        while begun.count("waiting") < 2:
            begun += run.stdout.readline()
        run.kill()
        # The pipe's end comes when the last worker is gone; their jobs take a minute.
        run.communicate(timeout=40)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals to a group of processes")
def test_interrupted_jobs_end_with_their_parent(stand_in):
    """Ctrl-C reaches every process of the terminal: one line is said, and no empty folder stays."""
    with subprocess.Popen(
        [sys.executable, "-c", INTERRUPTIBLE, *PARALLEL, "seed=8,9", "name=two"],
        cwd=stand_in,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as run:
        try:
            begun = ""
            while begun.count("waiting") < 2:
                begun += run.stdout.readline()
            os.killpg(run.pid, signal.SIGINT)
            # The pipe's end comes when the last worker is gone.
            out, err = run.communicate(timeout=60)
        finally:
            run.kill()
    assert (run.returncode, err) == (130, "vocc-torch: interrupted\n")
    assert out.endswith(
        "interrupted: the same command with name=two goes on from there\n"
    )
    # What had been counted stays.
    left = {
        path.relative_to(stand_in / "runs").as_posix()
        for path in (stand_in / "runs").rglob("*")
    }
    assert left == {"two", "two/multirun.yaml", "two/1", "two/1/ledger.sqlite"}


# One after the other: the same care


def test_a_failed_job_is_run_again_under_the_same_name(app, monkeypatch, tmp_path):
    """Its complaint goes when it succeeds, and is a new one when it fails for another reason."""
    causes = iter(["the disk is full", "the disk is still full", None])

    def run_task(settings, folder):
        assert not list(folder.iterdir())
        if cause := next(causes):
            raise VoccError(cause)
        (folder / "result.txt").write_text("")

    monkeypatch.setattr(cli, "run_task", run_task)
    folder = tmp_path / "runs" / "two" / "0"
    for complaint in ("the disk is full", "the disk is still full"):
        assert app("-m", "seed=1", "name=two").complaint == complaint
        assert (folder / FAILED).read_text() == f"{complaint}\n"
    assert app("-m", "seed=1", "name=two").status == 0
    assert [path.name for path in folder.iterdir()] == ["result.txt"]


MISTAKES = {
    "hydra/launcher=jolib": ["hydra/launcher is 'jolib'", "basic, joblib"],
    "hydra.launcher.n_jobs=2": ["hydra.launcher.n_jobs", "=joblib"],
    "hydra/launcher=joblib hydra.launcher.n_jobs=0": [
        "hydra.launcher.n_jobs is 0",
        "-1 for one a core",
    ],
    "hydra/launcher=joblib hydra.launcher.n_jobs=two": [
        "hydra.launcher.n_jobs is 'two'",
        "a whole number",
    ],
}


@pytest.mark.parametrize("words", MISTAKES)
def test_mistakes_of_the_launcher_are_one_line(app, words):
    complaint = app("-m", "seed=1,2", *words.split()).complaint
    assert all(part in complaint for part in MISTAKES[words])


# What jobs leave


@pytest.mark.parametrize(
    ("held", "left", "mine"),
    [
        ((), (), True),
        ((FAILED,), (), True),
        ((FAILED, CONFIG), (), True),
        (("ledger.sqlite",), ("ledger.sqlite",), True),
        ((FAILED, "ledgers"), ("ledgers",), True),
        ((FAILED, CONFIG, "ledger.sqlite"), (CONFIG, "ledger.sqlite"), True),
        (
            ("ber.csv", CONFIG, "ledger.sqlite"),
            ("ber.csv", CONFIG, "ledger.sqlite"),
            False,
        ),
        (("ber.csv", FAILED, "ledger.sqlite"), ("ber.csv", "ledger.sqlite"), False),
        ((CONFIG,), (CONFIG,), False),
        (("mine.txt",), ("mine.txt",), False),
        ((FAILED, "mine.txt"), (FAILED, "mine.txt"), False),
    ],
)
def test_only_a_failed_attempt_is_taken_away(tmp_path, monkeypatch, held, left, mine):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "runs" / "x"
    folder.mkdir(parents=True)
    for name in held:
        (folder / name).write_text("")
    assert begin_again(folder) is mine
    assert {path.name for path in folder.iterdir()} == set(left)


def test_failures_are_told_in_order_or_raised(tmp_path):
    """Hydra carries to the parent what cannot be told: a full disk must not make a failed job look well."""
    jobs = Jobs(tmp_path, parent=-1)
    for job, complaint, trace in ((10, "ten", "Traceback\n  ä"), (9, "nine", "")):
        jobs.failed(job, complaint, trace)
    assert [tuple(one.values()) for one in jobs.told("failed")] == [
        (9, "nine", ""),
        (10, "ten", "Traceback\n  ä"),
    ]
    assert jobs.elsewhere
    (tmp_path / "file").write_text("")
    with pytest.raises(VoccError, match="no panel"):
        Jobs(tmp_path / "file", os.getpid()).failed(0, "no panel")
    write_down(tmp_path / "file", "no panel", "", "")
    assert (tmp_path / "file").read_text() == ""


@given(st.lists(st.text(alphabet="ab \n", max_size=6), max_size=8))
def test_lines_are_numbered_however_they_are_written(pieces):
    under = io.StringIO()
    lines = JobLines(under, "job 3 | ")
    for piece in pieces:
        assert lines.write(piece) == len(piece)
        assert under.getvalue() == "" or under.getvalue().endswith("\n")
    lines.close()
    text = "".join(pieces)
    wanted = (
        text.split("\n") if text and not text.endswith("\n") else text.split("\n")[:-1]
    )
    assert under.getvalue().splitlines() == [
        f"job 3 | {line}".rstrip() for line in wanted
    ]
