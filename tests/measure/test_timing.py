"""Calls are timed in turns, warmed up, with the device done, and summarised as the statistics module does."""

import os
import statistics

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from vocc_torch.measure import timing
from vocc_torch.measure.timing import describe_machine, interleaved, median_of

CPU, CUDA = torch.device("cpu"), torch.device("cuda")


class World:
    """A clock that only work moves, and a device that works when it is waited for."""

    def __init__(self):
        self.now = 0.0
        self.queued = 0.0
        self.order = []

    def clock(self):
        return self.now

    def synchronize(self, device):
        assert device == CUDA
        self.now += self.queued
        self.queued = 0.0

    def work(self, name, *durations):
        """A call that takes these times, one after the other, and the last for ever."""
        left = list(durations)

        def call():
            self.order.append(name)
            self.now += left.pop(0) if len(left) > 1 else left[0]

        return call

    def queue(self, name, duration):
        """A call that returns at once and leaves work to the device."""

        def call():
            self.order.append(name)
            self.queued += duration

        return call


@pytest.fixture
def world():
    return World()


def test_rounds_are_interleaved_and_turn_back(world, monkeypatch):
    monkeypatch.setattr("time.perf_counter", world.clock)
    calls = {name: world.work(name, 1.0) for name in "abc"}
    interleaved(calls, 4, CPU, warm_up=0)
    assert "".join(world.order) == "abc" + "cba" + "abc" + "cba"


def test_the_device_is_waited_for_within_the_time_and_only_for_the_call(
    world, monkeypatch
):
    monkeypatch.setattr(torch.cuda, "synchronize", world.synchronize)
    monkeypatch.setattr("time.perf_counter", world.clock)
    world.queued = 1000.0  # somebody else's work
    calls = {"a": world.queue("a", 2.0), "b": world.queue("b", 30.0)}
    timed = interleaved(calls, 2, CUDA, warm_up=0)
    assert timed == {"a": (2.0, 2.0), "b": (30.0, 30.0)}
    assert world.queued == 0


@given(st.lists(st.floats(1e-7, 1e3), min_size=2, max_size=40))
def test_quartiles_are_those_of_the_statistics_module(seconds):
    low, median, high = statistics.quantiles(seconds, n=4, method="inclusive")
    of = median_of(seconds)
    assert (of.low, of.value, of.high) == pytest.approx((low, median, high), rel=1e-12)


def test_the_machine_is_named_by_what_times_depend_on(monkeypatch, tmp_path):
    (tmp_path / "cpuinfo").write_text(
        "processor\t: 0\nmodel name\t: Example CPU: 9000\nprocessor\t: 1\n"
    )
    monkeypatch.setattr(timing, "_CPU_FILE", tmp_path / "cpuinfo")
    monkeypatch.setattr(torch, "get_num_threads", lambda: 3)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0}, raising=False)
    said = describe_machine(CPU)
    assert (
        said == f"Example CPU: 9000 with 1 core, 3 threads, torch {torch.__version__}"
    )
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda device: "Example GPU")
    assert describe_machine(CUDA) == f"Example GPU, {said}"
