"""A study with the refined locator: it trains, counts, keeps its locator and reads recordings."""

import pytest

from vocc_torch.errors import VoccError
from vocc_torch.measure.link import Link, block_keys
from vocc_torch.measure.plan import ReceiverPlan
from vocc_torch.measure.train import Training, train, trained_receiver
from vocc_torch.receiver.locators import PaperLocator, RefinedLocator


def test_the_plan_names_what_finds_the_panel():
    plan = ReceiverPlan(locator="refined")
    finders = plan.finders(["truth", "paper", "refined"])
    assert finders == {
        "truth": None,
        "paper": plan.location,
        "refined": RefinedLocator(plan.location),
    }
    with pytest.raises(
        VoccError, match="it must be one of truth, paper, refined, detector"
    ):
        ReceiverPlan(locator="guess")


def test_a_link_locates_with_the_plans_locator(make_plan):
    assert Link.of(make_plan(locator="refined")).locator == RefinedLocator()
    assert Link.of(make_plan(locator="truth")).locator is None


def test_training_on_refined_corners_is_nearly_training_on_the_true_ones(make_plan):
    plan = make_plan(locator="refined", training_frames=64)
    trainings = {name: train(plan.locating_with(name)) for name in ("truth", "refined")}
    directions = [trainings[name].flda.direction for name in ("truth", "refined")]
    assert trainings["refined"].missed == 0
    assert (directions[0] - directions[1]).norm() < 0.05 * directions[0].norm()


@pytest.mark.parametrize(
    ("name", "locator"),
    [
        ("truth", PaperLocator()),
        ("paper", PaperLocator()),
        ("refined", RefinedLocator()),
    ],
)
def test_a_kept_receiver_never_needs_the_truth(name, locator, make_plan, trained):
    training = Training(trained, 0, 0, trained.direction, trained.direction)
    assert trained_receiver(make_plan(locator=name), training).locator == locator


def test_the_kept_receiver_reads_frames_with_its_locator(make_plan):
    plan = make_plan(locator="refined", training_frames=64, framing="filled")
    receiver = trained_receiver(plan, train(plan))
    assert receiver.locator == RefinedLocator()
    link = Link.of(plan)
    (seen,) = link.observe(
        plan.world.scene, block_keys(0, "test", 8), preambles=False, frames=8
    )
    decoded = receiver.decode(seen.frames.grey)
    assert decoded.found.all()
    assert (decoded.bits == seen.bits).double().mean() > 0.97
