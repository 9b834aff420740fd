"""The paper's trends, with the panel's corners known."""

import pytest
from one_point import sweep_point

from vocc_torch.measure.intervals import ber_interval
from vocc_torch.measure.plan import Experiment
from vocc_torch.measure.train import train
from vocc_torch.simulation import Distribution

pytestmark = pytest.mark.slow


def whole_sweep(plan, flda):
    """Points by receiver and value."""
    points = [
        p for value in plan.experiment.values for p in sweep_point(plan, flda, value)
    ]
    return {(point.receiver, point.value): point for point in points}


def interval(point):
    """The 95 % interval of a point, its upper end a limit where there were no errors."""
    return ber_interval(point.counts)


def assert_worse(worse, better):
    """The two 95 % intervals do not touch: a stricter test at the 5 % level than one on the difference."""
    assert interval(worse).low > interval(better).high, (worse, better)


@pytest.fixture(scope="module")
def paper_trained(make_plan):
    """Trained as the paper says: 1000 frames of Table 1."""
    return train(make_plan(training_frames=1000)).flda


BETWEEN = {"distance_m": Distribution("uniform", (40.0, 60.0))}
LEDS = {"led_luminance_cd_m2": Distribution("uniform", (2000.0, 4000.0))}
DUSK = {"ambient_lx": Distribution("uniform", (4000.0, 8000.0))}


def test_ambient_light_has_a_best_level(make_plan, paper_trained):
    """Fig. 22: both ends are worse than 8000 lx, and three features beat the average greyscale everywhere."""
    values = (1000.0, 2000.0, 4000.0, 8000.0, 16000.0, 32000.0)
    names = ("average_greyscale", "flda_2", "flda_3")
    plan = make_plan(
        experiment=Experiment("ambient", "ambient_lx", values, BETWEEN | LEDS),
        frames=384,
        names=names,
    )
    at = whole_sweep(plan, paper_trained)
    for name in ("average_greyscale", "flda_2"):
        assert_worse(at[name, 1000.0], at[name, 8000.0])
        assert_worse(at[name, 32000.0], at[name, 8000.0])
    assert_worse(at["flda_3", 1000.0], at["flda_3", 8000.0])
    for value in values:
        assert_worse(at["average_greyscale", value], at["flda_3", value])


def test_errors_rise_with_distance(make_plan, paper_trained):
    """Fig. 24: every receiver is worse at 70 m than at 60 m, and none does better farther away."""
    values = (30.0, 50.0, 60.0, 70.0)
    names = ("average_greyscale", "flda_2", "flda_3")
    experiment = Experiment("distance", "distance_m", values, DUSK | LEDS)
    at = whole_sweep(
        make_plan(experiment=experiment, frames=384, names=names), paper_trained
    )
    for name in names:
        assert_worse(at[name, 70.0], at[name, 60.0])
        bers = [at[name, value].counts.ber for value in values]
        assert bers == sorted(bers)
    for value in (60.0, 70.0):
        assert_worse(at["average_greyscale", value], at["flda_3", value])
