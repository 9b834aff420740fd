"""Who counts: the same results from processes as from one, no trace of them, one line for errors."""

import os
import signal
import sys
import time
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch
from composing import composed
from one_point import banks, job_of

from vocc_torch.errors import VoccError
from vocc_torch.measure import executors, pools
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.plan import Experiment, resolve_device
from vocc_torch.measure.pools import WorkerPool, called
from vocc_torch.measure.store import Store
from vocc_torch.measure.sweep import curves_at, outcomes
from vocc_torch.measure.train import train
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
        make_plan(
            experiment=Experiment("spending", "distance_m", (50.0, 70.0), dusk),
            frames=100,
        ),
        batch_frames=16,
    )
    fldas = {name: train(stopping.locating_with(name)).flda for name in LOCATORS}
    plans = stopping, spending
    return [
        (value, job_of(plan, banks(plan, fldas), value))
        for plan in plans
        for value in plan.experiment.values
    ]


def results(sweeps, workers, progress=lambda *_: None, store=None):
    """What each experiment came to with each locator, by its name."""
    values, jobs = zip(*sweeps, strict=True)
    found = {job.plan.experiment.name: {} for job in jobs}
    for value, job, outcome in zip(
        values, jobs, outcomes(jobs, workers, store, progress), strict=True
    ):
        found[job.plan.experiment.name][value] = outcome
    plans = {job.plan.experiment.name: job.plan for job in jobs}
    return {
        name: {of: stated(curves_at(plan, of, found[name])) for of in LOCATORS}
        for name, plan in plans.items()
    }


def stated(curves):
    """All that a curve says: rows, counts, and errors by frame."""
    packed = {
        value: [errors.packed() for errors in both]
        for value, both in curves.errors.items()
    }
    return {**vars(curves), "errors": packed}


IS_DEAF = (
    "(__import__('os').getpid(), 2 in __import__('signal').pthread_sigmask(0, []))"
)
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

    with pytest.MonkeyPatch.context() as patch, Workers(2) as workers:
        patch.setenv("OMP_NUM_THREADS", "2")
        # Torch's way to send tensors; it keeps files of this process open until they are fetched.
        patch.setattr("multiprocessing.resource_sharer.DupFd", None)
        story = SimpleNamespace(
            results=results(sweeps, workers, told.append), told=told, path=path, deaf={}
        )
        story.threads = workers.result(
            workers.submit(eval, "__import__('torch').get_num_threads()")
        )
        story.tensor = workers.result(workers.submit(torch.neg, torch.arange(5)))
        while len(story.deaf) < 2:
            pid, deaf = workers.result(workers.submit(eval, IS_DEAF))
            story.deaf[pid] = deaf
        story.bad_call = caught(
            lambda: workers.result(workers.submit(resolve_device, "abacus"))
        )

        first = next(pid for pid in story.deaf)

        def kill(*_):
            # More blocks may have come before the loss is noticed.
            with suppress(ProcessLookupError):
                os.kill(first, signal.SIGKILL)

        with Store.open(path, {}) as store:
            story.killed = caught(lambda: results(sweeps, workers, kill, store))
            story.known = len(store)
        story.after = caught(lambda: workers.submit(abs, -1))
    return story


def test_two_processes_measure_what_one_measures(sweeps, story):
    """Counts, comparisons of receivers, and why each point stopped."""
    with Workers(1) as workers:
        told = []
        alone = results(sweeps, workers, told.append)
    assert story.results == alone
    for name, locator, why in (
        ("stopping", "truth", "frame_errors"),
        ("spending", "paper", "frames"),
    ):
        assert {row.stopped_by for row in alone[name][locator]["rows"]} == {why}
    assert sorted(story.told) == sorted(told)


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
        assert str(error).startswith(
            "a worker process was ended from outside, perhaps for lack of memory: "
        )


def test_what_was_counted_before_a_worker_was_killed_is_known(sweeps, story):
    assert story.known > 0
    with Store.open(story.path, {}) as store, Workers(1) as workers:
        assert len(store) == story.known
        assert results(sweeps, workers, store=store) == story.results
        assert len(store) > story.known


# One worker is this process


def test_one_worker_starts_nothing():
    with Workers(1) as workers:
        call = workers.submit(eval, "__import__('os').getpid()")
        assert workers.result(call) == os.getpid()
        assert workers._pool is None
        with pytest.raises(ValueError, match="invalid literal"):
            workers.submit(int, "x")


@pytest.mark.parametrize("count", [-1, 257])
def test_impossible_numbers_are_refused(count):
    refusal = rf"^workers is {count}: it must be from 0 \(one a core\) to 256$"
    with pytest.raises(VoccError, match=refusal):
        Workers(count)


def test_no_number_is_one_a_core(monkeypatch):
    monkeypatch.setattr(executors.timing, "usable_cores", lambda: 3)
    assert (Workers(0).count, Workers(0).window) == (3, 6)
    assert (Workers(1).window, Workers(2).window) == (1, 4)


# Refused in one line


def test_where_nothing_listens_is_told_in_seconds(monkeypatch):
    ray = SimpleNamespace(init=None)  # is not reached
    monkeypatch.setitem(sys.modules, "ray", ray)
    begun = time.monotonic()
    for address, why in (
        ("127.0.0.1:1", "ConnectionRefusedError: .*"),
        ("ray://host:x", "ValueError: .*"),
    ):
        refusal = (
            rf"^executor.address is {address}: no ray cluster answers there \({why}\)$"
        )
        with pytest.raises(VoccError, match=refusal):
            Workers(1, "ray", address).__enter__()
    assert time.monotonic() - begun < 5


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ("executor=ray", "task=export"),
            "executor.kind is ray: it must be auto, here or processes for task=exp",
        ),
        (
            ("executor.kind=rya",),
            "executor.kind is 'rya': it must be one of auto, here, processes, ray, dask",
        ),
        (
            ("executor.address=a:1",),
            "executor.address is a:1: it must be auto for executor=auto",
        ),
        (
            (
                "executor=ray",
                "classifier=cnn",
                "+classifiers.cnn.training.checkpoints=c",
            ),
            "classifiers.cnn.training.checkpoints is c: it must be null for executor=ray",
        ),
    ],
)
def test_what_cannot_be_elsewhere_is_refused(words, told):
    with pytest.raises(VoccError) as refusal:
        Workers.of(composed(*words))
    assert str(refusal.value).startswith(told)


@pytest.mark.parametrize("kind", ["ray", "dask"])
def test_an_engine_that_is_not_installed_is_named(kind, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(
        VoccError,
        match=rf"^executor.kind is {kind}, which is not installed: pip install 'vocc-",
    ):
        Workers(1, kind, "127.0.0.1:1").__enter__()


# Where it begins when nobody says


def pool_here(slots=2, lost=None, ended=None):
    """A pool that does its calls at once, and loses them where it is told so."""

    def submit(*packed):
        future = Future()
        if lost is None:
            future.set_result(called(*packed))
        else:
            future.set_exception(lost)
        return future

    return WorkerPool(submit, lambda: slots, lambda at_once: ended and ended(at_once))


def test_unasked_it_begins_here_and_takes_processes(monkeypatch):
    opened, ended = [], []

    def open_pool(count):
        opened.append(count)
        return pool_here(count, ended=ended.append)

    monkeypatch.setattr(pools, "process_pool", open_pool)
    monkeypatch.setattr(executors, "LIMITS", replace(executors.LIMITS, patience_s=0.05))
    monkeypatch.setattr(executors.timing, "usable_cores", lambda: 64)
    with Workers(None) as pool:
        assert (pool.window, pool.result(pool.submit(abs, -1)), opened) == (1, 1, [])
        # One thread, whatever torch's number is.
        assert pool.result(pool.submit(spin, 0.1)) == 1
        assert pool.result(pool.submit(abs, -2)) == 2
    assert (opened, ended) == ([8], [False])
    assert Workers.of(composed("executor=here", "workers=4")).window == 1
    with Workers(None, "here") as pool:
        assert pool.result(pool.submit(spin, 0.1)) == 1
        assert pool.window == 1


@pytest.mark.parametrize(
    ("slots", "count", "window"),
    [(2, None, 4), (2, 8, 4), (8, 8, 16), (32, 8, 8), (32, 1, 1)],
)
def test_a_cluster_is_never_given_more_at_a_time_than_was_asked_for(
    slots, count, window, monkeypatch
):
    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace())
    monkeypatch.setattr(pools, "ray_pool", lambda *_: pool_here(slots))
    with Workers(count, "ray") as pool:
        assert pool.window == window


class NodeDiedError(Exception):
    """What a cluster says of a node that it lost for good."""

    __module__ = "ray.exceptions"


def test_a_call_that_a_cluster_lost_for_good_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace())
    lost = pool_here(lost=NodeDiedError("gone"))
    monkeypatch.setattr(pools, "ray_pool", lambda *_: lost)
    refusal = r"^a cluster lost a task 3 times \(NodeDiedError: gone\): .*start again to go on$"
    with Workers(2, "ray") as pool, pytest.raises(VoccError, match=refusal):
        pool.result(pool.submit(abs, -1))


def spin(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass
    return torch.get_num_threads()
