"""Processes that count: the same results as one alone, and no trace of them afterwards."""

import os
import signal
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from one_point import banks

from vocc_torch.errors import VoccError
from vocc_torch.measure import workers as workers_module
from vocc_torch.measure.ledger import Ledger
from vocc_torch.measure.plan import Experiment, resolve_device
from vocc_torch.measure.sweep import Study, measured, run_studies
from vocc_torch.measure.train import train_each
from vocc_torch.measure.workers import Workers
from vocc_torch.simulation import Distribution

LOCATORS = ("truth", "paper")


@pytest.fixture(scope="module")
def sweeps(make_plan):
    """Two experiments: one stops points by frame errors, the other spends a budget of three blocks."""
    dusk = {"ambient_lx": Distribution("constant", (1000.0,))}
    stopping = make_plan(
        experiment=Experiment("stopping", "distance_m", (60.0, 66.0), dusk),
        frames=256,
        target=40,
        names=("average_greyscale", "flda_2", "flda_3"),
    )
    spending = replace(
        make_plan(experiment=Experiment("spending", "distance_m", (50.0, 70.0), dusk), frames=100),
        batch_frames=16,
    )
    fldas = {name: training.flda for name, training in train_each(stopping, LOCATORS).items()}
    studies = [Study(plan.experiment.name, plan, LOCATORS) for plan in (stopping, spending)]
    return studies, {study.key: banks(study.plan, fldas) for study in studies}


def results(sweeps, workers, progress=lambda *_: None, ledger=None):
    """What each experiment came to, by its name."""
    studies, of_studies = sweeps
    outcomes = {study.key: {} for study in studies}
    ledgers = {} if ledger is None else dict.fromkeys(outcomes, ledger)
    for study, value, outcome in run_studies(studies, of_studies, ledgers, workers, progress):
        outcomes[study.key][value] = outcome
    return {study.key: measured(study, outcomes[study.key]) for study in studies}


IS_DEAF = "(__import__('os').getpid(), 2 in __import__('signal').pthread_sigmask(0, []))"
"""Who calls, and whether it has put off Ctrl-C, signal 2, from its beginning."""


def caught(call):
    """The error of a call."""
    try:
        call()
    except Exception as error:
        return error
    return None


@pytest.fixture(scope="module")
def story(sweeps, tmp_path_factory):
    """One start of two processes serves all that is asked of them; the last thing ends them."""
    path, told = tmp_path_factory.mktemp("workers") / "ledger", []

    def tell(study, value, frames, _):
        told.append((study.key, value, frames))

    with pytest.MonkeyPatch.context() as patch, Workers(2) as workers:
        patch.setenv("OMP_NUM_THREADS", "2")
        # Torch's way to send tensors; it keeps files of this process open until they are fetched.
        patch.setattr("multiprocessing.resource_sharer.DupFd", None)
        story = SimpleNamespace(results=results(sweeps, workers, tell), told=told, path=path, deaf={})
        story.threads = workers.submit(eval, "__import__('torch').get_num_threads()").result()
        story.tensor = workers.submit(torch.neg, torch.arange(5)).result()
        while len(story.deaf) < 2:
            pid, deaf = workers.submit(eval, IS_DEAF).result()
            story.deaf[pid] = deaf
        story.bad_call = caught(lambda: workers.submit(resolve_device, "abacus").result())

        first = next(iter(workers._engine._processes))

        def kill(*_):
            # More blocks may have come before the loss is noticed.
            with suppress(ProcessLookupError):
                os.kill(first, signal.SIGKILL)

        with Ledger.open(path, {}) as ledger:
            story.killed = caught(lambda: results(sweeps, workers, kill, ledger))
            story.known = len(ledger)
        story.after = caught(lambda: workers.submit(abs, -1))
    return story


def test_two_processes_measure_what_one_measures(sweeps, story):
    """Counts, comparisons of receivers and of locations, and why each point stopped."""
    with Workers(1) as workers:
        told = []
        alone = results(sweeps, workers, lambda sweep, value, frames, _: told.append((value, frames)))
    assert story.results == alone
    assert set(alone["stopping"].curves["truth"].stopped_by.values()) == {"frame_errors"}
    assert set(alone["spending"].curves["paper"].stopped_by.values()) == {"frames"}
    # Blocks come in their order within a point, whatever happens between the points.
    for name, value in (("stopping", 60.0), ("stopping", 66.0), ("spending", 50.0), ("spending", 70.0)):
        mine = [frames for at, on, frames in story.told if (at, on) == (name, value)]
        assert mine == [frames for on, frames in told if on == value]


def test_each_process_has_one_thread_takes_tensors_whole_and_never_hears_ctrl_c(story):
    assert story.threads == 1
    assert story.tensor.tolist() == [0, -1, -2, -3, -4]
    assert os.name != "posix" or set(story.deaf.values()) == {True}


def test_an_error_in_a_process_comes_back_as_it_is(story):
    assert isinstance(story.bad_call, VoccError)
    assert str(story.bad_call) == str(caught(lambda: resolve_device("abacus")))


def test_a_killed_worker_is_one_line(story):
    for error in (story.killed, story.after):
        assert isinstance(error, VoccError)
        assert str(error).startswith("a worker process was ended from outside, perhaps for lack of memory: ")


def test_what_was_counted_before_a_worker_was_killed_is_known(sweeps, story):
    assert story.known > 0
    with Ledger.open(story.path, {}) as ledger, Workers(1) as workers:
        assert len(ledger) == story.known
        assert results(sweeps, workers, ledger=ledger) == story.results
        assert len(ledger) > story.known


# One worker is this process


def test_one_worker_starts_nothing():
    with Workers(1) as workers:
        assert workers.submit(eval, "__import__('os').getpid()").result() == os.getpid()
        assert workers._engine is None
        with pytest.raises(ValueError, match="invalid literal"):
            workers.submit(int, "x")


@pytest.mark.parametrize("count", [-1, 257])
def test_impossible_numbers_are_refused(count):
    with pytest.raises(VoccError, match=rf"^workers is {count}: it must be from 0 \(one a core\) to 256$"):
        Workers(count)


def test_no_number_is_one_a_core(monkeypatch):
    monkeypatch.setattr(workers_module.timing, "usable_cores", lambda: 3)
    assert (Workers(0).count, Workers(0).window) == (3, 6)
    assert (Workers(1).window, Workers(2).window) == (1, 4)
