"""One pass over the frames for every receiver and locator: the tallies are those of each alone."""

import dataclasses
import pickle

import pytest
from one_point import banks, counter

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.link import Link
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.measure.plan import Experiment
from vocc_torch.measure.schedule import Outcome, Part
from vocc_torch.measure.sweep import PointJob, Sweep, measured, run_sweeps
from vocc_torch.measure.train import train, train_each
from vocc_torch.measure.workers import Workers
from vocc_torch.simulation import Distribution

LOCATORS = ("truth", "paper")
PARTS = [Part(0, 64), Part(1, 30)]
STRICT = 0.8


@pytest.fixture(scope="module")
def plan(make_plan):
    """A far panel in low light and a strict locator: errors are many, and some panels are missed."""
    scene = {
        "ambient_lx": Distribution("constant", (1000.0,)),
        "distance_m": Distribution("uniform", (50.0, 72.0)),
    }
    made = make_plan(experiment=Experiment("both", "led_luminance_cd_m2", (600.0, 3000.0), scene), frames=94)
    strict = dataclasses.replace(made.receiver.location, min_rectangularity=STRICT)
    return dataclasses.replace(made, receiver=dataclasses.replace(made.receiver, location=strict))


@pytest.fixture(scope="module")
def fldas(plan):
    return {name: training.flda for name, training in train_each(plan, LOCATORS).items()}


@pytest.fixture(scope="module")
def together(plan, fldas):
    """Both locators in one pass, block by block."""
    return PointJob(plan, LOCATORS, banks(plan, fldas), 600.0)(PARTS)


def at(plan, locator, names=None):
    """The plan with one of the locators, and with some of the receivers."""
    receiver = dataclasses.replace(plan.receiver, locator=locator, names=names or plan.receiver.names)
    return dataclasses.replace(plan, receiver=receiver)


def singles(tallies):
    return {label: one for label, one in tallies.items() if isinstance(one, Counts)}


def test_labels_are_of_each_receiver_each_pair_and_each_receivers_two_locations(plan, together):
    names = plan.receiver.names
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    for block in together:
        assert set(block) == {
            *((locator, name, 0) for locator in LOCATORS for name in names),
            *((locator, a, b, 0) for locator in LOCATORS for a, b in pairs),
            *((name, 0) for name in names),
        }
        assert set(singles(block)) == {(locator, name, 0) for locator in LOCATORS for name in names}


def test_training_with_two_locators_is_training_with_each(plan, fldas):
    for locator in LOCATORS:
        alone = train(at(plan, locator)).flda
        for name, tensor in fldas[locator].state_dict().items():
            assert tensor.equal(alone.state_dict()[name]), (locator, name)


def test_two_locators_in_one_pass_count_what_each_alone_counts(plan, fldas, together):
    """Tallies of receivers and of their pairs; and the two locators do not see the same panels."""
    for locator in LOCATORS:
        alone = PointJob(at(plan, locator), (locator,), banks(plan, {locator: fldas[locator]}), 600.0)(PARTS)
        for block, mine in zip(together, alone, strict=True):
            assert {label: one for label, one in block.items() if label[0] == locator} == mine
    located, true = together[0]["paper", "flda_3", 0], together[0]["truth", "flda_3", 0]
    assert (0 < located.panels_missed < 32, true.panels_missed) == (True, 0)
    assert located.half_errors > true.half_errors


def test_order_of_locators_changes_nothing(plan, fldas, together):
    assert PointJob(plan, LOCATORS[::-1], banks(plan, fldas), 600.0)(PARTS) == together


def test_location_pairs_are_the_differences_of_the_two_counts(plan, together):
    for block, part in zip(together, PARTS, strict=True):
        for name in plan.receiver.names:
            pair, paper, truth = (
                block[label] for label in ((name, 0), ("paper", name, 0), ("truth", name, 0))
            )
            assert isinstance(pair, PairedCounts)
            assert (pair.frames, pair.bits) == (part.frames, 64 * part.frames)
            assert pair.half_difference == paper.half_errors - truth.half_errors
            assert pair.a_worse >= paper.frame_errors - truth.frame_errors
    # A lost panel costs a frame nearly half its bits, 64 half errors.
    lost = together[0]["paper", "flda_3", 0].panels_missed
    assert together[0]["flda_3", 0].a_excess > 40 * lost > 0


def test_pairs_of_receivers_are_the_differences_of_their_counts(plan, together):
    seen = 0
    for block in together:
        for label, pair in block.items():
            if len(label) != 4:
                continue
            locator, a, b, group = label
            first, second = block[locator, a, group], block[locator, b, group]
            assert (pair.frames, pair.bits) == (first.frames, first.bits)
            assert pair.half_difference == first.half_errors - second.half_errors
            assert pair.a_worse >= first.frame_errors - second.frame_errors
            seen += pair.discordant
    assert seen > 0


def test_pairs_are_those_of_frames_one_by_one(plan, fldas):
    """A part of one frame after another: squares of the differences, and who was worse, by hand."""
    names = ("average_greyscale", "flda_3")
    two = at(plan, "paper", names)
    count = PointJob(two, LOCATORS, banks(two, fldas), 600.0)
    whole, totals = count([Part(0, 24)])[0], [count([Part(0, frames)])[0] for frames in range(1, 25)]
    for label in (("paper", *names, 0), ("truth", *names, 0), ("flda_3", 0)):
        sides = {3: [], 1: []}
        a, b = (
            ((label[0], label[1], 0), (label[0], label[2], 0))
            if len(label) == 4
            else (
                ("paper", *label),
                ("truth", *label),
            )
        )
        errors = [[block[one].half_errors for block in totals] for one in (a, b)]
        apart = [
            (x - x_before) - (y - y_before)
            for x, x_before, y, y_before in zip(
                errors[0], [0, *errors[0]], errors[1], [0, *errors[1]], strict=False
            )
        ]
        sides = [[max(d, 0) for d in apart], [max(-d, 0) for d in apart]]
        assert whole[label] == PairedCounts(
            24, 24 * 64, *(f(side) for side in sides for f in (sum, squares, positive))
        )


def squares(values):
    return sum(value**2 for value in values)


def positive(values):
    return sum(value > 0 for value in values)


@pytest.mark.parametrize("locators", [("truth",), ("paper",)])
def test_one_locator_has_no_location_pairs(plan, fldas, locators):
    (block,) = PointJob(plan, locators, banks(plan, fldas), 600.0)([Part(0, 10)])
    assert all(label[0] in locators for label in block)


def test_groups_keep_their_pairs_apart(make_plan, fldas):
    """In the contrast experiment every tally is a bin's own, and bins add up to what they split."""
    edges = (0.0, 0.1, 0.2, 0.6)
    plan = make_plan(experiment=Experiment("c", "contrast", edges), frames=20, names=("flda_2", "flda_3"))
    (block,) = PointJob(plan, LOCATORS, banks(plan, fldas), 0.0)([Part(0, 60)])
    groups = {label[-1] for label in block}
    assert len(groups) >= 2
    one_bin = dataclasses.replace(plan, experiment=dataclasses.replace(plan.experiment, values=(0.0, 0.6)))
    (whole,) = PointJob(one_bin, LOCATORS, banks(plan, fldas), 0.0)([Part(0, 60)])
    for label, total in whole.items():
        parts = [block[*label[:-1], group] for group in groups]
        assert sum(parts, type(total)()) == total
    assert sum(block["truth", "flda_3", group].frames for group in groups) == 60


def test_a_job_counts_the_same_after_a_journey_to_another_process(plan, fldas):
    job = PointJob(plan, LOCATORS, banks(plan, fldas), 600.0)
    copy = pickle.loads(pickle.dumps(job))
    assert copy.point == job.point
    assert copy([Part(3, 20)]) == job([Part(3, 20)])


# What a sweep makes of it


@pytest.fixture(scope="module")
def whole(plan, fldas):
    with Workers(1) as workers:
        outcomes = {
            value: outcome
            for _, value, outcome in run_sweeps([Sweep(plan, LOCATORS, banks(plan, fldas))], workers)
        }
    return measured(plan, LOCATORS, outcomes)


def test_a_sweep_puts_every_tally_in_its_place(plan, whole, together):
    names = plan.receiver.names
    for locator in LOCATORS:
        curves = whole.curves[locator]
        assert (curves.locator, curves.receivers, curves.values) == (locator, names, (600.0, 3000.0))
        for index, a in enumerate(names):
            assert curves.counts[a, 600.0] == sum((block[locator, a, 0] for block in together), Counts())
            for b in names[index + 1 :]:
                pair = sum((block[locator, a, b, 0] for block in together), PairedCounts())
                assert curves.pair(a, b, 600.0) == pair
                assert curves.pair(b, a, 600.0) == pair.swapped()
    for name in names:
        assert whole.location[name, 600.0] == sum((block[name, 0] for block in together), PairedCounts())
    assert set(whole.location) == {(name, value) for name in names for value in (600.0, 3000.0)}


def test_a_sweep_of_one_locator_is_the_same_as_its_part_of_a_sweep_of_two(plan, fldas, whole):
    with Workers(1) as workers:
        sweep = Sweep(plan, ("truth",), banks(plan, {"truth": fldas["truth"]}))
        outcomes = {value: outcome for _, value, outcome in run_sweeps([sweep], workers)}
    alone = measured(plan, ["truth"], outcomes)
    assert alone.curves == {"truth": whole.curves["truth"]}
    assert alone.location == {}


def test_groups_of_a_sweep_are_values_and_empty_ones_are_left_out(make_plan):
    """In the contrast experiment one outcome holds the tallies of all values."""
    plan = make_plan(experiment=Experiment("c", "contrast", (0.0, 0.2, 0.4, 0.6)), names=("flda_2", "flda_3"))
    errors = {group: Counts(10, 640, 2 * group, 4 * group, group) for group in (0, 2)}
    pairs = {group: PairedCounts(10, 640, 2 * group, 4 * group, group) for group in (0, 2)}
    tallies = {}
    for group in (0, 2):
        tallies |= {(at, name, group): errors[group] for at in LOCATORS for name in plan.receiver.names}
        tallies |= {(at, *plan.receiver.names, group): pairs[group] for at in LOCATORS}
        tallies |= {(name, group): pairs[group] for name in plan.receiver.names}
    found = measured(plan, LOCATORS, {0.0: Outcome(tallies, "frames")})
    for curves in found.curves.values():
        assert curves.values == (0.1, 0.5)
        assert curves.stopped_by == {0.1: "frames", 0.5: "frames"}
        assert curves.counts == {
            (n, at): errors[g] for n in curves.receivers for g, at in ((0, 0.1), (2, 0.5))
        }
        assert curves.paired == {(*curves.receivers, at): pairs[g] for g, at in ((0, 0.1), (2, 0.5))}
    assert found.location == {
        (name, at): pairs[group] for name in plan.receiver.names for group, at in ((0, 0.1), (2, 0.5))
    }


def test_the_plans_own_locator_counts_as_the_links(plan, fldas):
    """The helper of the other tests counts what a job counts."""
    own = at(plan, "paper")
    assert counter(own, Link.of(own), fldas["paper"], 600.0)([Part(0, 16)]) == PointJob(
        own, ("paper",), banks(own, {"paper": fldas["paper"]}), 600.0
    )([Part(0, 16)])
