"""Jobs of a multirun at the same time: the same results, and every failure heard of."""

import os
import signal
import subprocess
import sys

import pytest
from joblib import cpu_count

from vocc_torch.app.jobs import FAILED

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
    assert out.endswith("interrupted: the same command with name=two resumes\n")
    # What had been counted stays.
    left = {
        path.relative_to(stand_in / "runs").as_posix()
        for path in (stand_in / "runs").rglob("*")
    }
    ledger = {"two/1/.unfinished", "two/1/ledger.sqlite"}
    assert left == {"two", "two/multirun.yaml", "two/1", *ledger}
