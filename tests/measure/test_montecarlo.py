"""Blocks in index order until a stop rule holds, on counts that are made up."""

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from one_point import run_point

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.workers import StopRule
from vocc_torch.rng import BLOCK_FRAMES


def made_up(wrong_frames):
    """A counter in which block b of receiver r has ``wrong_frames[r][b]`` frames with one wrong bit."""

    def count(parts):
        return [
            {
                (name, 0): Counts(part.frames, 64 * part.frames, 2 * wrong, 4 * wrong, wrong)
                for name, blocks in wrong_frames.items()
                for wrong in [min(blocks[part.block % len(blocks)], part.frames)]
            }
            for part in parts
        ]

    return count


def test_parts_cover_the_budget_once():
    for frames in (1, 63, 64, 65, 100, 128, 1000):
        parts = list(StopRule(frames).parts())
        assert [part.block for part in parts] == list(range(len(parts)))
        assert sum(part.frames for part in parts) == frames
        assert all(part.frames == BLOCK_FRAMES for part in parts[:-1])


blocks = st.lists(st.integers(0, BLOCK_FRAMES), min_size=1, max_size=6)


@given(
    wrong=st.fixed_dictionaries({"a": blocks, "b": blocks}),
    frames=st.integers(1, 1000),
    target=st.integers(1, 200),
)
def test_stops_at_the_first_block_that_is_enough(wrong, frames, target):
    outcome = run_point(made_up(wrong), StopRule(frames, target))
    running, used = {"a": 0, "b": 0}, 0
    expected = "frames"
    for part in StopRule(frames).parts():
        used += part.frames
        for name, by_block in wrong.items():
            running[name] += min(by_block[part.block % len(by_block)], part.frames)
        if min(running.values()) >= target:
            expected = "frame_errors"
            break
    assert outcome.stopped_by == expected
    assert {count.frames for count in outcome.counts.values()} == {used}
    assert {name: count.frame_errors for (name, _), count in outcome.counts.items()} == running


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
    rule = StopRule(10**9, precision=0.1)
    looks = [blocks for blocks in range(1, 4097) if rule.reached(SURE, blocks) == "precision"]
    assert looks[:20] == list(range(16, 321, 16))
    steps = {b: b - a for a, b in pairwise(looks)}
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
@settings(max_examples=60, deadline=None)
def test_a_precise_point_stops_at_the_first_look_at_which_everyone_is(
    seed, rates, groups, precision, least_ber, at_once
):
    rule, seen = StopRule(64 * 130, precision=precision, least_ber=least_ber), []
    outcome = run_point(
        drawn(seed, rates, groups),
        rule,
        blocks_at_once=at_once,
        progress=lambda _, tallies: seen.append(dict(tallies)),
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
    assert run_point(free, StopRule(64 * 40, precision=0.9)).stopped_by == "frames"
    # The upper limit of n error-free frames is about 3 / n frames in error, each a lost panel: 32 of 64 bits.
    for least_ber, frames in ((3e-4, 5000), (1e-4, 15000)):
        outcome = run_point(free, StopRule(10**6, precision=0.1, least_ber=least_ber))
        assert outcome.stopped_by == "precision"
        assert ber_interval(outcome.counts["a", 0], errors_per_frame_error=32).high <= least_ber
        assert frames <= outcome.counts["a", 0].frames <= 1.3 * frames
    with_errors = drawn(0, {"a": 0.0, "b": 0.001})
    outcome = run_point(with_errors, StopRule(64 * 40, precision=0.1, least_ber=1e-5))
    assert outcome.stopped_by == "frames"


def test_every_group_must_be_precise_though_frame_errors_add_over_them():
    counts = {("a", 0): SURE["a", 0], ("a", 1): Counts(64, 4096, 2, 4, 1)}
    assert StopRule(10**9, precision=0.1).reached(counts, 16) is None
    assert StopRule(10**9, target_frame_errors=10**5 + 1).reached(counts, 16) == "frame_errors"
    assert StopRule(10**9, target_frame_errors=10**5 + 2).reached(counts, 16) is None
