"""Blocks of many points in many hands: whatever comes back when, the numbers are those of one at a time.

And the stop rule, on counts that are made up.
"""

import itertools
import math
import random
import tempfile
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from one_point import run_point

from vocc_torch.errors import VoccError
from vocc_torch.measure import schedule, workers
from vocc_torch.measure.config import Budget
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.ledger import Ledger
from vocc_torch.measure.point_work import Outcome, Part, PointWork, parts_of, stop_reason
from vocc_torch.measure.schedule import run_points
from vocc_torch.rng import BLOCK_FRAMES


class Counter:
    """Block b of a point has ``wrong[b]`` frames with one wrong bit; asked blocks are remembered."""

    def __init__(self, wrong, broken=()):
        self.wrong, self.broken, self.asked = wrong, broken, []

    def __call__(self, parts):
        self.asked += [part.block for part in parts]
        if not set(self.broken).isdisjoint(part.block for part in parts):
            raise RuntimeError("broken")
        return [self.of(part) for part in parts]

    def of(self, part):
        wrong = min(self.wrong[part.block % len(self.wrong)], part.frames)
        return {("a", 0): Counts(part.frames, 64 * part.frames, 2 * wrong, 4 * wrong, wrong)}


def by_hand(work):
    """What a point must come to, and how many blocks that takes."""
    total = Counts()
    for blocks, part in enumerate(parts_of(work.rule.frames), start=1):
        total += work.count.of(part)["a", 0]
        target = work.rule.target_frame_errors
        if target is not None and total.frame_errors >= target:
            return Outcome({("a", 0): total}, "frame_errors"), blocks
    return Outcome({("a", 0): total}, "frames"), blocks


class Hands:
    """An executor whose calls come back in an order that ``rng`` draws, when somebody waits for them."""

    def __init__(self, rng):
        self.rng, self.pending, self.handed, self.most = rng, [], [], 0

    def submit(self, count, parts):
        future = Future()
        self.pending.append((future, count, parts))
        self.handed += [(count, part) for part in parts]
        self.most = max(self.most, sum(not call[0].cancelled() for call in self.pending))
        if self.rng.random() < 0.5:
            future.set_running_or_notify_cancel()
        return future

    def wait(self, futures, timeout, return_when):
        self.pending = [call for call in self.pending if call[0] in futures or not call[0].cancelled()]
        assert set(futures) == {future for future, *_ in self.pending}
        for chosen in self.rng.sample(self.pending, self.rng.randint(1, len(self.pending))):
            self.pending.remove(chosen)
            self.finish(*chosen)
        return {one for one in futures if one.done()}, None

    def finish(self, future, count, parts):
        if not future.running() and not future.set_running_or_notify_cancel():
            return
        try:
            future.set_result(count(parts))
        except RuntimeError as error:
            future.set_exception(error)

    def run(self, works, **options):
        """All outcomes, with every wait in these hands."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(schedule.futures, "wait", self.wait)
            return list(run_points(works, self.submit, **options))


def in_order(window=1):
    """Hands that give back one call at a time, the oldest first."""

    class Oldest(random.Random):
        def randint(self, low, high):
            return 1

        def sample(self, pending, k):
            return pending[:1]

    return Hands(Oldest(0))


@pytest.fixture
def ledger(tmp_path):
    with Ledger.open(tmp_path / "ledger", {}) as opened:
        yield opened


def blocks_of(ledger, point):
    """Frames of each block of a point."""
    return dict(ledger._run("SELECT block, frames FROM blocks WHERE point=?", (point,)).fetchall())


FREE = settings(deadline=None, max_examples=12)
RNG = st.integers(0, 2**32).map(random.Random)
WINDOW = {"window": st.integers(1, 6), "blocks_at_once": st.integers(1, 5)}


@st.composite
def many_points(draw, target=True):
    """Points of up to a dozen blocks, some with a target if they may have one."""
    targets = st.none() | st.integers(1, 100) if target else st.none()
    points = []
    for index in range(draw(st.integers(1, 5))):
        wrong = draw(st.lists(st.integers(0, BLOCK_FRAMES), min_size=1, max_size=5))
        rule = Budget(draw(st.integers(1, 700)), target_frame_errors=draw(targets))
        points.append(PointWork(f"point {index}", Counter(wrong), rule))
    return points


# The same numbers


@given(works=many_points(), rng=RNG, **WINDOW)
@FREE
def test_no_order_window_or_batch_changes_an_outcome(works, rng, window, blocks_at_once):
    """Each stops at the first block that is enough, however many blocks ahead were in flight."""
    hands, told = Hands(rng), [[] for _ in works]
    for work, mine in zip(works, told, strict=True):
        work.told = lambda frames, counts, mine=mine: mine.append((frames, counts["a", 0].frames))
    assert hands.run(works, window=window, blocks_at_once=blocks_at_once) == [by_hand(w)[0] for w in works]
    assert hands.most <= window
    for work, mine in zip(works, told, strict=True):
        frames = [part.frames for part in itertools.islice(parts_of(work.rule.frames), by_hand(work)[1])]
        assert mine == list(zip(frames, itertools.accumulate(frames), strict=True))
        assert len(work.count.asked) == len(set(work.count.asked))


@given(works=many_points(), rng=RNG, data=st.data(), **WINDOW)
@FREE
def test_with_a_ledger_known_blocks_are_not_counted_and_all_others_are_recorded(
    works, rng, data, window, blocks_at_once
):
    """Blocks beyond the stop, too: a run with a longer budget has them for nothing."""
    with tempfile.TemporaryDirectory() as folder, Ledger.open(Path(folder) / "ledger", {}) as ledger:
        works = [replace(work, ledger=ledger) for work in works]
        known = {work.point: set() for work in works}
        for work in works:
            for part in parts_of(work.rule.frames):
                if data.draw(st.booleans()):
                    ledger.append(work.point, part.block, part.frames, work.count.of(part))
                    known[work.point].add(part.block)
        outcomes = Hands(rng).run(works, window=window, blocks_at_once=blocks_at_once)
        assert outcomes == [by_hand(work)[0] for work in works]
        for work in works:
            asked, rows = set(work.count.asked), blocks_of(ledger, work.point)
            assert not asked & known[work.point]
            assert set(range(by_hand(work)[1])) <= set(rows)
            for block, frames in rows.items():
                assert ledger.find(work.point, block, frames) == work.count.of(Part(block, frames))
        # What was asked is what was recorded, but for the last point's calls that nobody waits for.
        for work in works[:-1]:
            assert set(blocks_of(ledger, work.point)) >= known[work.point] | set(work.count.asked)
        again = [replace(work, count=Counter(work.count.wrong)) for work in works]
        assert Hands(rng).run(again, window=window, blocks_at_once=blocks_at_once) == outcomes
        for work, before in zip(again, works, strict=True):
            new = set(work.count.asked)
            assert not new & (known[work.point] | set(range(by_hand(before)[1])))


# No idle hands


@given(works=many_points(target=False), rng=RNG, **WINDOW)
@FREE
def test_nobody_waits_while_there_is_a_block_left_to_hand_out(works, rng, window, blocks_at_once):
    hands, blocks = Hands(rng), sum(len(list(parts_of(work.rule.frames))) for work in works)
    waits, wait = [], hands.wait

    def watched(futures, timeout, return_when):
        waits.append(len(futures) == window or len(hands.handed) == blocks)
        return wait(futures, timeout, return_when)

    hands.wait = watched
    hands.run(works, window=window, blocks_at_once=blocks_at_once)
    assert waits
    assert all(waits)
    assert len(hands.handed) == blocks


# Errors


@given(works=many_points(target=False), rng=RNG, data=st.data(), **WINDOW)
@FREE
def test_an_error_in_a_call_ends_the_run_and_loses_nothing_that_came_back(
    works, rng, data, window, blocks_at_once
):
    at = data.draw(st.integers(0, len(works) - 1))
    bad = data.draw(st.integers(0, len(list(parts_of(works[at].rule.frames))) - 1))
    with tempfile.TemporaryDirectory() as folder, Ledger.open(Path(folder) / "ledger", {}) as ledger:
        works = [replace(work, ledger=ledger) for work in works]
        broken = list(works)
        broken[at] = replace(works[at], count=Counter(works[at].count.wrong, broken=[bad]))
        hands = Hands(rng)
        finished = [set() for _ in works]

        def finish(future, count, parts, finish=hands.finish):
            finish(future, count, parts)
            if not future.cancelled() and not future.exception():
                index = next(n for n, work in enumerate(broken) if work.count is count)
                finished[index] |= {part.block for part in parts}

        hands.finish = finish
        with pytest.raises(RuntimeError, match="broken"):
            hands.run(broken, window=window, blocks_at_once=blocks_at_once)
        assert [set(blocks_of(ledger, work.point)) for work in works] == finished
        # What had not been begun is called off.
        assert all(future.cancelled() or future.running() for future, *_ in hands.pending)
        fresh = [replace(work, count=Counter(work.count.wrong)) for work in works]
        again = Hands(rng)
        assert again.run(fresh, window=window, blocks_at_once=blocks_at_once) == [
            by_hand(work)[0] for work in works
        ]
        assert all(not done & set(work.count.asked) for done, work in zip(finished, fresh, strict=True))


def test_one_silent_worker_is_not_waited_for_as_long_as_workers_begin(monkeypatch):
    """Two begin for 40 s, by a clock of the test; one then does its block, the other never says a word."""
    now, due, work = 0.0, {}, PointWork("p", Counter([1]), Budget(128))

    def submit(count, parts):
        due[future := Future()] = (math.inf if due else 40.0), count, parts
        return future

    def again(future):
        due[future] = now + 1, *due[future][1:]

    def wait(futures, timeout, return_when):
        nonlocal now
        now = min(now + timeout, *(due[one][0] for one in futures))
        done = [one for one in futures if due[one][0] <= now]
        for one in done:
            one.set_result(due[one][1](due[one][2]))
        return done, None

    monkeypatch.setattr(schedule, "time", Mock(monotonic=lambda: now))
    monkeypatch.setattr(schedule.futures, "wait", wait)
    assert [one.counts["a", 0].frames for one in run_points([work], submit, window=4, again=again)] == [128]
    assert now < 50


def test_a_ledger_that_cannot_be_written_ends_the_run(ledger, monkeypatch):
    append, rows = Ledger.append, []

    def full(self, *row):
        if len(rows) == 3:
            raise VoccError("cannot write")
        rows.append(append(self, *row))

    monkeypatch.setattr(Ledger, "append", full)
    work = PointWork("p", Counter([1]), Budget(640), ledger)
    with pytest.raises(VoccError, match="cannot write"):
        list(run_points([work], workers.Workers(1).submit, window=1))
    assert sorted(blocks_of(ledger, "p")) == [0, 1, 2]


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_what_is_done_when_something_else_ends_the_run_is_recorded(ledger, error):
    """Two calls have come back; the first is being added when the run is interrupted."""
    hands = in_order()

    def interrupted(*_):
        hands.finish(*hands.pending.pop())
        raise error

    work = PointWork("p", Counter([1]), Budget(640), ledger, interrupted)
    with pytest.raises(error):
        hands.run([work], window=4)
    assert sorted(blocks_of(ledger, "p")) == [0, 3]
    assert all(future.cancelled() or future.running() for future, *_ in hands.pending)


# Precision


def drawn(seed, rates, groups=1, bits=64):
    """A counter of receivers whose frames are in error at these rates, each with one wrong bit or more."""
    rng = np.random.default_rng(seed)

    def count(parts):
        blocks = []
        for part in parts:
            group, tallies = rng.integers(0, groups, part.frames), {}
            for name, rate in rates.items():
                halves = 2 * rng.geometric(0.4, part.frames).clip(max=bits) * (rng.random(part.frames) < rate)
                for index in range(groups):
                    mine = halves[group == index]
                    sums = (int(mine.sum()), int((mine**2).sum()), int((mine > 0).sum()))
                    tallies[name, index] = Counts(len(mine), bits * len(mine), *sums)
            blocks.append(tallies)
        return blocks

    return count


def narrow(counts, precision, least_ber=0.0):
    """What the rule asks of one receiver, in other words."""
    interval, ber = ber_interval(counts, errors_per_frame_error=counts.bits / counts.frames / 2), counts.ber
    reach = max(interval.high - ber, ber - interval.low)
    return interval.high <= least_ber or (ber > 0 and reach <= precision * ber)


SURE = {("a", 0): Counts(10**6, 64 * 10**6, 2 * 10**5, 4 * 10**5, 10**5)}


def test_precision_is_looked_at_in_steps_of_at_least_16_blocks_and_of_a_sixteenth():
    """Looks at every block would stop a point by luck; too few would waste frames."""
    rule = Budget(10**9, precision=0.1)
    looks = [blocks for blocks in range(1, 4097) if stop_reason(rule, SURE, blocks) == "precision"]
    assert looks[:20] == list(range(16, 321, 16))
    steps = {b: b - a for a, b in itertools.pairwise(looks)}
    assert min(steps.values()) == 16
    assert all(step == 16 or blocks / 32 <= step <= blocks / 16 for blocks, step in steps.items())
    assert looks[-1] == 4096


@given(
    seed=st.integers(0, 2**32 - 1),
    rates=st.fixed_dictionaries({"a": st.sampled_from([0.0, 0.02, 0.2]), "b": st.sampled_from([0.05, 0.5])}),
    groups=st.integers(1, 2),
    precision=st.sampled_from([0.05, 0.15, 0.3]),
    least_ber=st.sampled_from([0.0, 1e-4, 1e-2]),
    at_once=st.integers(1, 20),
)
@settings(max_examples=30, deadline=None)
def test_a_precise_point_stops_at_the_first_look_at_which_everyone_is(
    seed, rates, groups, precision, least_ber, at_once
):
    rule, seen = Budget(64 * 130, precision=precision, least_ber=least_ber), []
    outcome = run_point(
        drawn(seed, rates, groups),
        rule,
        blocks_at_once=at_once,
        told=lambda _, tallies: seen.append(dict(tallies)),
    )
    enough = [
        blocks
        for blocks in range(16, 131, 16)
        if blocks <= len(seen)
        and all(narrow(counts, precision, least_ber) for counts in seen[blocks - 1].values())
    ]
    if outcome.stopped_by == "precision":
        assert enough == [len(seen)]
        assert all(narrow(counts, precision, least_ber) for counts in outcome.counts.values())
    else:
        assert (outcome.stopped_by, enough, len(seen)) == ("frames", [], 130)


def test_without_errors_a_point_is_precise_only_below_the_least_rate():
    free = drawn(0, {"a": 0.0})
    assert run_point(free, Budget(64 * 40, precision=0.9)).stopped_by == "frames"
    # The upper limit of n error-free frames is about 3 / n frames in error, each a lost panel: 32 of 64 bits.
    for least_ber, frames in ((3e-4, 5000), (1e-4, 15000)):
        outcome = run_point(free, Budget(10**6, precision=0.1, least_ber=least_ber))
        assert outcome.stopped_by == "precision"
        assert ber_interval(outcome.counts["a", 0], errors_per_frame_error=32).high <= least_ber
        assert frames <= outcome.counts["a", 0].frames <= 1.3 * frames
    with_errors = drawn(0, {"a": 0.0, "b": 0.001})
    outcome = run_point(with_errors, Budget(64 * 40, precision=0.1, least_ber=1e-5))
    assert outcome.stopped_by == "frames"


def test_every_group_must_be_precise_though_frame_errors_add_over_them():
    counts = {("a", 0): SURE["a", 0], ("a", 1): Counts(64, 4096, 2, 4, 1)}
    assert stop_reason(Budget(10**9, precision=0.1), counts, 16) is None
    assert stop_reason(Budget(10**9, target_frame_errors=10**5 + 1), counts, 16) == "frame_errors"
    assert stop_reason(Budget(10**9, target_frame_errors=10**5 + 2), counts, 16) is None
