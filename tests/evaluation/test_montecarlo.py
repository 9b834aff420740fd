"""Blocks in index order until a stop rule holds, on counts that are made up."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vocc_torch.evaluation.counts import Counts
from vocc_torch.evaluation.montecarlo import StopRule
from vocc_torch.evaluation.schedule import run_point
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


def test_a_budget_without_end_is_not_laid_out():
    """A target with a huge budget is how one says: until there are enough errors."""
    outcome = run_point(made_up({"a": [5]}), StopRule(10**15, 12), blocks_at_once=4)
    assert (outcome.counts["a", 0].frames, outcome.stopped_by) == (192, "frame_errors")


blocks = st.lists(st.integers(0, BLOCK_FRAMES), min_size=1, max_size=6)


@given(
    wrong=st.fixed_dictionaries({"a": blocks, "b": blocks}),
    frames=st.integers(1, 1000),
    target=st.none() | st.integers(1, 200),
    at_once=st.integers(1, 20),
)
def test_blocks_at_once_change_nothing(wrong, frames, target, at_once):
    rule = StopRule(frames, target)
    alone = run_point(made_up(wrong), rule)
    together = run_point(made_up(wrong), rule, blocks_at_once=at_once)
    assert together == alone


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


def test_errors_of_all_groups_count_towards_the_target():
    """Frames sorted into bins stop on their sum: a bin that never fills does not hold the others up."""

    def count(parts):
        return [{("a", part.block % 2): Counts(part.frames, part.frames, 2, 4, 1)} for part in parts]

    outcome = run_point(count, StopRule(6400, 3))
    assert outcome.stopped_by == "frame_errors"
    assert {label: counts.frames for label, counts in outcome.counts.items()} == {("a", 0): 128, ("a", 1): 64}


def test_no_counts_at_all_is_no_target_reached():
    outcome = run_point(lambda parts: [{} for _ in parts], StopRule(100, 1))
    assert (outcome.counts, outcome.stopped_by) == ({}, "frames")


def test_progress_tells_of_every_block_that_counts():
    seen = []
    run_point(
        made_up({"a": [1]}),
        StopRule(1000, 3),
        blocks_at_once=5,
        progress=lambda frames, counts: seen.append((frames, counts["a", 0].frames)),
    )
    assert seen == [(64, 64), (64, 128), (64, 192)]


def test_a_counter_that_forgets_a_block_is_caught():
    with pytest.raises(ValueError, match="zip"):
        run_point(lambda parts: [], StopRule(100))
