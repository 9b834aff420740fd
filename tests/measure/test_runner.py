"""Blocks of many points in many hands: whatever comes back when, the numbers are those of one at a time.

And the stop rule, on counts that are made up.
"""

import itertools
import random
import tempfile
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up_tallies import errors_of
from one_point import LEDS, A, MadeUp

from vocc_torch.errors import VoccError
from vocc_torch.measure import runner
from vocc_torch.measure.config import Budget
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.frame_errors import FrameErrors, Key
from vocc_torch.measure.plan import Experiment, Plan, ReceiverPlan, World
from vocc_torch.measure.runner import Part, PointTask, parts_of
from vocc_torch.measure.store import Store
from vocc_torch.receiver.deciders import bank_of
from vocc_torch.receiver.flda import FLDA
from vocc_torch.rng import BLOCK_FRAMES


def by_hand(point):
    """What a point must come to, why it stops, and how many blocks that takes."""
    total, target = Counts(), point.rule.target_frame_errors
    for blocks, part in enumerate(parts_of(point.rule.frames), start=1):
        total += point.job.of(part).counts[0]
        if target is not None and total.frame_errors >= target:
            return total, "frame_errors", blocks
    return total, "frames", blocks


def ends(outcomes):
    """Sums and reasons, once they are seen to be those of the frames."""
    for outcome in outcomes:
        assert outcome.errors.counts == [outcome.counts[A]]
    return [(outcome.counts[A], outcome.stopped_by) for outcome in outcomes]


def expected(points):
    return [by_hand(point)[:2] for point in points]


class Hands:
    """An executor whose calls come back in an order that ``rng`` draws, when somebody waits for them."""

    def __init__(self, rng, window=1):
        self.rng, self.window, self.pending, self.handed, self.most = (
            rng,
            window,
            [],
            [],
            0,
        )

    def submit(self, job, parts):
        future = Future()
        self.pending.append((future, job, parts))
        self.handed += [(job, part) for part in parts]
        self.most = max(
            self.most, sum(not call[0].cancelled() for call in self.pending)
        )
        if self.rng.random() < 0.5:
            future.set_running_or_notify_cancel()
        return future

    def result(self, future):
        return future.result()

    def wait(self, futures, return_when):
        self.pending = [
            call
            for call in self.pending
            if call[0] in futures or not call[0].cancelled()
        ]
        assert set(futures) == {future for future, *_ in self.pending}
        for chosen in self.rng.sample(
            self.pending, self.rng.randint(1, len(self.pending))
        ):
            self.pending.remove(chosen)
            self.finish(*chosen)
        return {one for one in futures if one.done()}, None

    def finish(self, future, job, parts):
        if not future.running() and not future.set_running_or_notify_cancel():
            return
        try:
            future.set_result(job(parts))
        except RuntimeError as error:
            future.set_exception(error)

    def run(self, points, batch_frames=64):
        """All outcomes, with every wait in these hands."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(runner.futures, "wait", self.wait)
            return list(runner.count(points, self, batch_frames))


def in_order(window):
    """Hands that give back one call at a time, the oldest first."""

    class Oldest(random.Random):
        def randint(self, low, high):
            return 1

        def sample(self, pending, k):
            return pending[:1]

    return Hands(Oldest(0), window)


@pytest.fixture
def store(tmp_path):
    with Store.open(tmp_path / "ledger", {}) as opened:
        yield opened


def blocks_of(store, rows):
    """Frames of each block of a point."""
    return dict(store._run("SELECT block, frames FROM blocks WHERE point=?", rows))


def again(points, **changes):
    """The same points, of which nothing is counted."""
    return [
        replace(one, job=MadeUp(one.job.wrong, one.job.rows), **changes)
        for one in points
    ]


FREE = settings(deadline=None, max_examples=8)
HANDS = st.builds(Hands, st.integers(0, 2**32).map(random.Random), st.integers(1, 6))
BATCH = st.integers(1, 5).map(lambda blocks: blocks * BLOCK_FRAMES)


@st.composite
def many_points(draw, target=True):
    """Points of up to a dozen blocks, some with a target if they may have one."""
    targets = st.none() | st.integers(1, 100) if target else st.none()
    points = []
    for index in range(draw(st.integers(1, 5))):
        wrong = draw(st.lists(st.integers(0, BLOCK_FRAMES), min_size=1, max_size=5))
        rule = Budget(draw(st.integers(1, 700)), target_frame_errors=draw(targets))
        points.append(PointTask(MadeUp(wrong, f"point {index}"), rule))
    return points


@given(points=many_points(), hands=HANDS, batch=BATCH)
@FREE
def test_no_order_window_or_batch_changes_an_outcome(points, hands, batch):
    """Each stops at the first block that is enough, however many blocks ahead were in flight."""
    told = [[] for _ in points]
    for point, mine in zip(points, told, strict=True):
        point.progress = lambda frames, mine=mine, point=point: mine.append(
            (frames, point.counts[A].frames)
        )
    assert ends(hands.run(points, batch)) == expected(points)
    assert hands.most <= hands.window
    for point, mine in zip(points, told, strict=True):
        frames = [
            part.frames
            for part in itertools.islice(parts_of(point.rule.frames), by_hand(point)[2])
        ]
        assert mine == list(zip(frames, itertools.accumulate(frames), strict=True))
        assert len(point.job.asked) == len(set(point.job.asked))


@given(points=many_points(), hands=HANDS, data=st.data(), batch=BATCH)
@FREE
def test_with_a_store_known_blocks_are_not_counted_and_all_others_are_recorded(
    points, hands, data, batch
):
    """Blocks beyond the stop, too: a run with a longer budget has them for nothing."""
    with (
        tempfile.TemporaryDirectory() as folder,
        Store.open(Path(folder) / "ledger", {}) as store,
    ):
        points = again(points, store=store)
        known = {point.job.rows: set() for point in points}
        for point in points:
            for part in parts_of(point.rule.frames):
                if data.draw(st.booleans()):
                    store.add(point.job.rows, *part, point.job.of(part).packed())
                    known[point.job.rows].add(part.block)
        outcomes = ends(hands.run(points, batch))
        assert outcomes == expected(points)
        for point in points:
            rows = blocks_of(store, point.job.rows)
            assert not set(point.job.asked) & known[point.job.rows]
            assert set(range(by_hand(point)[2])) <= set(rows)
            for block, frames in rows.items():
                part = Part(block, frames)
                assert store.find(point.job.rows, *part) == point.job.of(part).packed()
        # What was asked is what was recorded, but for the last point's calls that nobody waits for.
        for point in points[:-1]:
            assert set(blocks_of(store, point.job.rows)) >= known[point.job.rows] | set(
                point.job.asked
            )
        later = again(points)
        assert ends(Hands(hands.rng, hands.window).run(later, batch)) == outcomes
        for point, before in zip(later, points, strict=True):
            assert not set(point.job.asked) & (
                known[point.job.rows] | set(range(by_hand(before)[2]))
            )


@given(points=many_points(target=False), hands=HANDS, data=st.data(), batch=BATCH)
@FREE
def test_an_error_in_a_call_ends_the_run_and_loses_nothing_that_came_back(
    points, hands, data, batch
):
    at = data.draw(st.integers(0, len(points) - 1))
    bad = data.draw(st.integers(0, len(list(parts_of(points[at].rule.frames))) - 1))
    with (
        tempfile.TemporaryDirectory() as folder,
        Store.open(Path(folder) / "ledger", {}) as store,
    ):
        broken = again(points, store=store)
        broken[at].job.broken = (bad,)
        finished = {point.job.rows: set() for point in points}

        def finish(future, job, parts, finish=hands.finish):
            finish(future, job, parts)
            if not future.cancelled() and not future.exception():
                finished[job.rows] |= {part.block for part in parts}

        hands.finish = finish
        with pytest.raises(RuntimeError, match="broken"):
            hands.run(broken, batch)
        assert {rows: set(blocks_of(store, rows)) for rows in finished} == finished
        # What had not been begun is called off.
        assert all(
            future.cancelled() or future.running() for future, *_ in hands.pending
        )
        fresh = again(broken)
        assert ends(Hands(hands.rng, hands.window).run(fresh, batch)) == expected(
            points
        )
        assert all(
            not finished[point.job.rows] & set(point.job.asked) for point in fresh
        )


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_what_is_done_when_something_else_ends_the_run_is_recorded(store, error):
    """Two calls have come back; the first is being added when the run is interrupted."""
    hands = in_order(4)

    def interrupted(*_):
        hands.finish(*hands.pending.pop())
        raise error

    with pytest.raises(error):
        hands.run([PointTask(MadeUp([1]), Budget(640), store, interrupted)])
    assert sorted(blocks_of(store, "p")) == [0, 3]
    assert all(future.cancelled() or future.running() for future, *_ in hands.pending)


# What a block's bytes say


def test_a_blocks_bytes_are_its_numbers_and_others_are_refused():
    rng = np.random.default_rng(0)
    keys = Key("paper", "b"), Key("truth", "c", 2)
    halves, flags = (
        rng.integers(0, 2 * LEDS + 1, (2, 10)),
        rng.integers(0, 2, (2, 2, 10)).astype(bool),
    )
    groups = rng.integers(-1, 3, 10)
    errors = errors_of(halves, LEDS, flags[0], keys, flags[1], groups)
    read = FrameErrors.unpacked(errors.packed(), 10, LEDS, keys)
    assert np.array_equal(read.table, errors.table)
    assert np.array_equal(read.groups, errors.groups)
    assert read.keys == keys
    assert read.counts == errors.counts
    bomb = errors_of(np.zeros((2, 10**6), np.int64), LEDS).packed()
    for content in (b"", b"x", errors.packed()[:-9], bomb):
        with pytest.raises(VoccError, match="cannot be read"):
            FrameErrors.unpacked(content, 10, LEDS, keys)
    for frames, leds, of in ((9, LEDS, keys), (10, LEDS, keys[:1]), (10, 3, keys)):
        with pytest.raises(VoccError, match="counts"):
            FrameErrors.unpacked(errors.packed(), frames, leds, of)


# Precision


@pytest.mark.parametrize(
    ("axis", "values", "group", "fits"),
    [
        ("distance_m", (50.0,), 0, True),
        ("distance_m", (50.0,), -1, False),
        ("distance_m", (50.0,), 7, False),
        ("contrast", (0.1, 0.2, 0.3), -1, True),
        ("contrast", (0.1, 0.2, 0.3), 2, False),
    ],
)
def test_a_block_of_a_group_that_its_point_does_not_have_is_refused(
    axis, values, group, fits
):
    """As a ledger that is forged and sealed may have it."""
    world, budget = World(device="cpu"), Budget(64)
    plan = Plan(world, ReceiverPlan(), Experiment("e", axis, values), budget)
    bank = bank_of(["average_greyscale"], FLDA(3))
    job = runner.Job(plan, world.scene, "e", [("truth", bank, 0)])
    groups = np.full(64, group)
    errors = errors_of(0 * groups[None], 64, keys=job.keys, groups=groups)
    (part,) = parts_of(64)
    if fits:
        assert job.read(errors.packed(), part).groups[0] == group
        return
    with pytest.raises(VoccError, match="a group that its point does not have"):
        job.read(errors.packed(), part)
