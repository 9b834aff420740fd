"""Errors by frame: the one loop counts what each part of it counts, and what is called surely worse is."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from made_up_tallies import tallies

from vocc_torch.measure.counts import Counts, half_errors
from vocc_torch.measure.estimate import Estimate, may_be_least
from vocc_torch.measure.link import Link
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.measure.runner import Banks, Job
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.rng import BlockKey
from vocc_torch.simulation.scene import narrowed


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
