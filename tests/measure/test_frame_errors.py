"""Errors by frame: the one loop counts what each part of it counts, and what is called surely worse is."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from made_up_tallies import tallies

from vocc_torch.measure.counts import Counts, half_errors
from vocc_torch.measure.estimate import Estimate, may_be_least
from vocc_torch.measure.frame_errors import FrameErrors, Key
from vocc_torch.measure.link import Link
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.measure.runner import Banks, Job
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.rng import BlockKey
from vocc_torch.simulation.scene import narrowed

LEDS = 64


def equals(rng, receivers, frames, rate, shared):
    """Receivers that are wrong in as many frames on average, some of these for all alike."""
    alike = rng.random(frames) < rate * shared
    own = rng.random((receivers, frames)) < rate * (1 - shared)
    half = 2 * (alike | own) * np.minimum(LEDS, rng.geometric(0.5, (receivers, frames)))
    return FrameErrors(half.astype(np.int64), half >= 0, LEDS)


@pytest.mark.parametrize(("receivers", "pictures"), [(2, 200), (12, 60), (30, 20)])
def test_among_equals_few_pictures_have_a_false_claim(receivers, pictures):
    """Of lists of equal receivers: is any called surely worse than another?"""
    rng, false = np.random.default_rng(1), 0
    for _ in range(pictures):
        errors = equals(rng, receivers, 1024, 0.02, 0.5)
        totals = errors.half_errors.sum(axis=1)
        false += errors.surely_worse(int(totals.argmax()), int(totals.argmin()))
    assert false <= 0.05 * pictures


def test_the_best_is_hardly_ever_ruled_out_and_worse_ones_are():
    """Equal receivers and one with a third of their errors, over and over."""
    rng, kept, left = np.random.default_rng(3), 0, 0
    for _ in range(60):
        halves = equals(rng, 6, 2048, 0.03, 0.3).half_errors
        halves[2] *= rng.random(2048) < 1 / 3
        places = may_be_least(
            len(halves), FrameErrors(halves, halves >= 0, LEDS).compared
        )
        kept, left = kept + (2 in places), left + len(places)
    assert kept >= 57
    assert left / 60 < 2


def test_an_estimate_leaves_out_what_is_outside_its_interval():
    for ends, real in (
        ((0.1, 0.3), True),
        ((-0.3, -0.1), True),
        ((0.0, 0.2), False),
        ((-0.1, 0.2), False),
    ):
        assert Estimate(0.1, *ends).real is real
        assert Estimate(1.1, ends[0] + 1, ends[1] + 1).leaves_out(1.0) is real
    assert may_be_least(1, lambda *_: pytest.fail("nothing to compare")) == [0]


def test_the_first_frames_are_counted_alone():
    half = np.array([[2, 64, 0, 8], [0, 64, 4, 0]])
    found = half != 64
    first = FrameErrors(half, found, LEDS).first(2)
    # Fmt: skip.
    assert [
        (one.frames, one.half_errors, one.panels_missed) for one in first.counts
    ] == [
        (2, 66, 1),
        (2, 64, 1),
    ]
    assert first.compared(1, 0).value == -2 / (2 * 2 * LEDS)


# Counts


def test_counts_and_pairs_are_those_of_the_decided_bits():
    """The definition, a frame at a time, in plain Python: half a missed panel's bits are wrong."""
    rng = torch.Generator().manual_seed(0)
    sent = torch.rand((90, 3, 3), generator=rng) < 0.5
    decided = [
        sent ^ (torch.rand((90, 3, 3), generator=rng) < rate)
        for rate in (0.0, 0.1, 0.5)
    ]
    found = [torch.rand(90, generator=rng) < rate for rate in (1.0, 0.9, 0.5)]
    halves = torch.stack(
        [half_errors(*one) for one in zip(decided, [sent] * 3, found, strict=True)]
    )
    wrong = [
        [2 * int((bits[i] != sent[i]).sum()) if where[i] else 9 for i in range(90)]
        for bits, where in zip(decided, found, strict=True)
    ]
    assert halves.tolist() == wrong
    counts, pairs = tallies(halves.numpy(), 9, torch.stack(found).numpy())
    assert counts == [
        Counts.of(*one) for one in zip(decided, [sent] * 3, found, strict=True)
    ]
    assert list(pairs) == [(0, 1), (0, 2), (1, 2)]
    for (a, b), pair in pairs.items():
        apart = [x - y for x, y in zip(wrong[a], wrong[b], strict=True)]
        sides = [[max(d, 0) for d in apart], [max(-d, 0) for d in apart]]
        sums = [(sum(s), sum(d * d for d in s), sum(d > 0 for d in s)) for s in sides]
        assert pair == PairedCounts(90, 810, *sums[0], *sums[1])
    assert (
        sum((pairs[0, 1], pairs[0, 1]), PairedCounts()).half_difference
        == 2 * pairs[0, 1].half_difference
    )
    with pytest.raises(TypeError):
        _ = PairedCounts() + Counts()


# The loop


@pytest.fixture(scope="module")
def job(make_plan, trained):
    """Two banks with known corners and one with the paper's locator, where some panels are missed."""
    plan = make_plan(frames=150)
    strict = replace(plan.receiver.location, min_rectangularity=0.8)
    plan = replace(plan, receiver=replace(plan.receiver, location=strict))
    banks = [
        ("truth", ["average_greyscale", "flda_3"]),
        ("paper", ["flda_3"]),
        ("truth", ["flda_2"]),
    ]
    receivers = Banks(
        [(name, ReceiverBank(names, trained), 0) for name, names in banks]
    )
    return Job(plan, plan.experiment.model_at(plan.world, 66.0), "p", receivers)


def test_rows_are_in_the_order_of_the_banks_each_with_its_own_locator(job):
    errors = job.count(range(2), 100)
    assert errors.keys[1:3] == (Key("truth", "flda_3"), Key("paper", "flda_3"))
    assert errors.place(Key("truth", "flda_2", 4)) == 3
    assert errors.found[[0, 1, 3]].all()
    assert 0 < errors.counts[2].panels_missed < 100
    for place, bank in (
        (slice(0, 2), job.receivers.banks[0]),
        (slice(2, 3), job.receivers.banks[1]),
    ):
        alone = replace(job, receivers=Banks([bank])).count(range(2), 100)
        assert np.array_equal(alone.half_errors, errors.half_errors[place])
    late = job.count([1], 16, first=6)
    assert np.array_equal(late.half_errors, errors.half_errors[:, 70:80])
    assert errors.paired(1, 1).discordant == 0
    assert errors.paired(3, 1) == errors.paired(1, 3).swapped()


def test_errors_of_misplaced_panels_are_those_off_the_pinhole_camera_s_corners(job):
    """Corners by the pinhole's own formula, a quarter of a cell by hand; blocks add."""
    job = replace(job, model=narrowed(job.model, {"distance_m": 45.0}))
    errors, off = job.count(range(3), 150), []
    link, camera, panel = Link.of(job.plan), job.plan.world.camera, job.plan.world.panel
    finders = job.plan.receiver.finders(["paper"])
    keys = [BlockKey(job.plan.seed, "p", block) for block in range(3)]
    pixel_m = camera.sensor_width_mm / 1e3 / camera.width_px
    for views in link.observe_each(
        finders, job.model, keys, preambles=False, frames=150
    ):
        panels, scene = views["paper"].panels, views["paper"].scene
        for i, found in enumerate(panels.found.tolist()):
            cell_px = (
                panel.pitch_m
                * camera.focal_length_mm
                / 1e3
                / float(scene.distance_m[i])
                / pixel_m
            )
            shift = [float(scene.offset_x_m[i]), float(scene.offset_y_m[i])]
            centre = (
                np.array([camera.width_px, camera.height_px]) / 2
                + np.array(shift) / panel.pitch_m * cell_px
            )
            corners = centre + np.array([(-4, -4), (4, -4), (4, 4), (-4, 4)]) * cell_px
            apart = np.linalg.norm(panels.corners_px[i].numpy() - corners, axis=1).max()
            off.append(not found or apart > cell_px / 4)
    assert 10 < sum(off) < 140
    assert errors.counts[2].misplaced == sum(off)
    expected = errors.half_errors[2][off].sum()
    assert errors.counts[2].misplaced_half_errors == expected > 0
    assert errors.counts[2].location_share == expected / errors.half_errors[2].sum()
    assert (
        errors.counts[0].misplaced_half_errors
        == errors.counts[3].misplaced_half_errors
        == 0
    )
    parts = job.count([0], 64).counts[2], job.count([1, 2], 86).counts[2]
    assert sum(parts, Counts()) == errors.counts[2]
