"""Executors: blocks in any order, twice or never; errors in one line; what goes along with a call."""

import pickle
import socket
import sys
import time
from concurrent.futures import Future
from functools import partial
from unittest.mock import Mock

import pytest
import torch
from composing import composed
from unreliable import GoneError, Unreliable, on

from vocc_torch import plugins
from vocc_torch.errors import VoccError
from vocc_torch.measure import executors, schedule, workers
from vocc_torch.measure.config import Budget
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.executors import about_run, called, demand_answer
from vocc_torch.measure.point_work import PointWork
from vocc_torch.measure.workers import Workers


def counted(parts, frames=64):
    return [{("a", 0): Counts(part.frames, 64 * part.frames)} for part in parts]


def run(engine, monkeypatch, blocks=6, overdue_s=0.2):
    on(monkeypatch, engine, overdue_s)
    with Workers(2, "ray") as pool:
        works = [PointWork("p", partial(counted, frames=64), Budget(64 * blocks))]
        (outcome,) = pool.run(works)
    return outcome.counts["a", 0].frames


@pytest.mark.filterwarnings("ignore:a worker or node was lost")
@pytest.mark.parametrize(
    ("fates", "told"),
    [
        (
            ("lost",),
            r"^a task was lost with its worker or node, 3 times in all \(GoneError\): start again to go on$",
        ),
        (("silent",), r"^block \d of p was handed out 3 times and never came back: start again to go on$"),
    ],
)
def test_what_never_comes_back_is_given_up_after_three_times(fates, told, monkeypatch):
    engine = Unreliable(fates)
    engine.some = (lambda late, some=engine.some: some([])) if fates == ("silent",) else engine.some
    with pytest.raises(VoccError, match=told):
        run(engine, monkeypatch)
    assert max(engine.handed.count(given) for given in engine.handed) == 3


def test_a_block_that_came_twice_is_counted_once(monkeypatch):
    assert run(Unreliable(("done", "silent", "done")), monkeypatch) == 6 * 64


@pytest.mark.parametrize("silent", [0, 3, 5])
def test_a_run_does_not_wait_for_one_silent_node(silent, monkeypatch):
    """Its block is handed out once more when there is no other to hand out, long before it is overdue."""
    engine = Unreliable(["silent" if block == silent else "done" for block in range(6)] + ["done"] * 9)
    monkeypatch.setattr(schedule, "LATE_S", 0.1)
    begun = time.monotonic()
    assert run(engine, monkeypatch, overdue_s=30.0) == 6 * 64
    assert time.monotonic() - begun < 10
    assert engine.handed.count(engine.handed[silent]) == 2


def test_a_copy_that_is_lost_takes_nothing_from_one_that_comes(monkeypatch):
    engine = Unreliable(("done",))
    copies = [Future(), Future()]
    monkeypatch.setattr(engine, "call", Mock(side_effect=copies))
    handed = workers.Handed(engine, ())
    for _ in copies:
        handed.hand_out()
    copies[0].set_exception(GoneError())
    assert not handed.done()
    copies[1].set_result(pickle.dumps((True, 7)))
    assert handed.result(0) == 7


@pytest.mark.parametrize(
    ("slots", "count", "window"), [(2, None, 4), (2, 8, 4), (8, 8, 16), (32, 8, 8), (32, 1, 1)]
)
def test_a_cluster_is_never_given_more_at_a_time_than_was_asked_for(slots, count, window, monkeypatch):
    monkeypatch.setattr(Unreliable, "slots", lambda _: slots)
    on(monkeypatch, Unreliable(("done",)))
    with Workers(count, "ray") as pool:
        assert pool.window == window


# What a worker does


def test_a_node_of_another_release_is_refused_by_its_name():
    wanted, files = pickle.loads(about_run("ray"))
    other = pickle.dumps(({**wanted, "torch": "1.0"}, files))
    well, error = pickle.loads(called(other, pickle.dumps(abs), pickle.dumps(-3)))
    here = ".".join(torch.__version__.split(".")[:2])
    told = (
        f"node {socket.gethostname()} has torch {here}, and this run 1.0: give every node the same releases"
    )
    assert (well, type(error), str(error)) == (False, VoccError, told)


class StubbornError(Exception):
    """An error that no other process can read."""

    def __reduce__(self):
        return int, ("no number",)


def fail(kind):
    raise kind("why")


@pytest.mark.parametrize(
    ("kind", "came", "text"),
    [
        (VoccError, VoccError, "why"),
        (MemoryError, MemoryError, "why"),
        (StubbornError, RuntimeError, "StubbornError: why"),
    ],
)
def test_an_error_of_a_call_comes_back_as_a_value(kind, came, text):
    well, error = pickle.loads(called(about_run("ray"), pickle.dumps(fail), pickle.dumps(kind)))
    assert (well, type(error), str(error)) == (False, came, text)


def test_the_users_files_go_along_to_another_machine(tmp_path, monkeypatch):
    """With what they import from beside them; there they are read from the copies."""
    for name in ("READ", "COPIES", "EXPECTED"):
        monkeypatch.setattr(plugins, name, type(getattr(plugins, name))())
    monkeypatch.setattr(sys, "path", list(sys.path))
    path = tmp_path / "mine_to_carry.py"
    monkeypatch.syspath_prepend(str(tmp_path))
    path.write_text("from beside_to_carry import TWO\nANSWER = 40 + TWO")
    (tmp_path / "beside_to_carry.py").write_text("TWO = 2")
    digest, answer = plugins.ModuleFile(str(path)).digest, plugins.ModuleFile(str(path)).named("ANSWER")
    (_, files) = pickle.loads(about_run("ray"))
    with pytest.raises(VoccError, match=r"executor.kind is dask, and .*mine_to_carry.py cannot go with it"):
        about_run("dask")
    text = path.read_text()
    path.write_text("ANSWER = 43")
    with pytest.raises(VoccError, match=r"mine_to_carry.py has changed since this run began"):
        about_run("ray")
    # There, neither file lies where it was.
    path.unlink()
    (tmp_path / "beside_to_carry.py").unlink()
    for name in [one for one in sys.modules if "to_carry" in one]:
        monkeypatch.delitem(sys.modules, name)
    plugins.receive(files)
    there = plugins.ModuleFile(str(path))
    assert (there.digest, there.named("ANSWER"), there.place.read_text()) == (digest, answer, text)


# Refused in one line


@pytest.fixture
def deaf():
    """The address of something that takes calls and says nothing."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        yield f"127.0.0.1:{listening.getsockname()[1]}"


def test_silence_at_an_address_is_told_in_seconds(deaf, monkeypatch):
    monkeypatch.setattr(executors, "CONNECT_S", 0.3)
    begun = time.monotonic()
    for address, why in ((deaf, "timed out"), ("127.0.0.1:1", "Connection refused")):
        with pytest.raises(
            VoccError, match=rf"^executor.address is {address}: nothing answers there \({why}\)$"
        ):
            demand_answer(address)
    assert time.monotonic() - begun < 5


@pytest.mark.parametrize("address", ["here", "host:", ":1", "host:0", "host:99999", "ray://host:x"])
def test_what_is_no_address_is_refused(address):
    with pytest.raises(VoccError, match=r"^executor.address is .*: it must be HOST:PORT, auto or local$"):
        demand_answer(address)


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
        (("executor.address=a:1",), "executor.address is a:1: it has no meaning for executor=auto"),
        (
            ("executor=ray", "classifier=cnn", "+classifiers.cnn.training.checkpoints=c"),
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
        VoccError, match=rf"^executor.kind is {kind}, which is not installed: pip install 'vocc-"
    ):
        executors.engine_of(kind, 1, "127.0.0.1:1")


# Where it begins when nobody says


def test_unasked_it_begins_here_and_takes_processes(monkeypatch):
    opened = []

    def opening(kind, count, address):
        opened.append((kind, count))
        return Unreliable(("done",))

    monkeypatch.setattr(workers, "engine_of", opening)
    monkeypatch.setattr(workers, "PATIENCE_S", 0.05)
    monkeypatch.setattr(workers.timing, "usable_cores", lambda: 64)
    with Workers(None) as pool:
        assert (pool.window, pool.submit(abs, -1).result(), opened) == (1, 1, [])
        assert pool.submit(spin, 0.1).result() == 1  # one thread, whatever torch's number is
        assert pool.submit(abs, -2).result() == 2
    assert opened == [("processes", 8)]
    assert Workers.of(composed("executor=here", "workers=4")).window == 1


def spin(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass
    return torch.get_num_threads()
