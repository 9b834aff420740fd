"""Reports of many receivers compared, from numbers that are easy to check."""

from dataclasses import replace

import numpy as np
import pytest
from made_up_tallies import curves_of, errors_of, spread

from vocc_torch.measure.frame_errors import Key
from vocc_torch.measure.plan import ClassifierPlan
from vocc_torch.measure.train import Making, Training
from vocc_torch.plugins import PlugIn
from vocc_torch.simulation import Distribution
from vocc_torch.studies.compare import ComparisonConfig
from vocc_torch.studies.compare.classifiers import (
    classifier_rows,
    few_frames,
    scene_rows,
)
from vocc_torch.studies.compare.figures import curves_figure, scenes_figure
from vocc_torch.studies.compare.report import flat

FRAMES = 1000
WRONG = {
    "average_greyscale": (9000, 4000),
    "flda_3": (300, 200),
    "net": (5, 0),
    "plain": (60, 500),
}
"""Wrong bits of each receiver, one a frame where they fit, at 30 and at 70 m."""


def curves():
    bits = {
        value: {name: spread(wrong[place], FRAMES) for name, wrong in WRONG.items()}
        for place, value in enumerate((30.0, 70.0))
    }
    return curves_of(bits, locator="truth")


PAIRS = (("paper", "paper"), ("night", "paper"), ("paper", "night"), ("night", "night"))


COSTS = {
    "average_greyscale": Making(parameters=0),
    "flda_3": Making(0.7, None, 1000, 4, 2600),
    "net": Making(12.0, 6.0, 8000, 5185, 25_300),
    "plain": Making(0.6, 0.5, 1000, None, 1340),
}


@pytest.fixture
def made_up():
    """Rows of three receivers that trained on two kinds of scenes, and what they were made of."""
    wrong = {
        "flda_3": (200, 900, 250, 250),
        "net": (0, 40, 30, 0),
        "plain": (100, 100, 120, 110),
    }
    scenes = []
    for tested_on, rows in (("paper", (0, 1)), ("night", (2, 3))):
        keys = [
            Key("truth", name, number) for number in range(len(rows)) for name in wrong
        ]
        halves = [
            2 * spread(wrong[name][row], FRAMES) for row in rows for name in wrong
        ]
        found = errors_of(np.array(halves), 64, keys=keys)
        scenes += scene_rows(found, tested_on, [PAIRS[row][0] for row in rows])
    every = {"distance": curves()}
    config = ComparisonConfig(reference="flda_3", points={"distance": 70.0})
    training = Training(costs=COSTS)
    return every, classifier_rows(config, every, training), scenes


def test_the_tables_state_what_was_counted(made_up):
    rows = {row["receiver"]: flat(row) for row in made_up[1]}
    assert list(rows) == ["net", "flda_3", "plain", "average_greyscale"]
    assert (rows["net"]["parameters"], rows["plain"]["parameters"]) == (5185, None)
    net = rows["net"]
    assert net["distance_70_ber_high"] > net["distance_70_ber"] == 0
    assert rows["plain"]["distance_70_ratio"] == pytest.approx(2.5)
    scenes = {
        (row["trained_on"], row["tested_on"], row["receiver"]): flat(row)
        for row in made_up[2]
    }
    assert scenes["paper", "night", "net"]["ratio"] is None
    assert scenes["night", "paper", "flda_3"]["ratio"] == pytest.approx(4.5)


def test_figures_have_a_panel_a_receiver_and_a_cell_a_pair_of_scenes(made_up):
    tables, rows, scenes = made_up
    figure = curves_figure(tables["distance"], rows, "flda_3", "distance_70")
    assert [axes.get_title(loc="left") for axes in figure.axes] == [
        "1. net\n< 1/66 at 70",
        "2. FLDA: AGR + GRI + NGR",
        "3. plain\n2.5 x at 70",
        "4. Average greyscale\n20 x at 70",
    ]
    assert figure.axes[0].get_ylabel() == "Bit error rate"
    assert figure.axes[0].get_xlabel() == "Distance (m)"
    axes, _ = scenes_figure(scenes, "paper", list(WRONG)).axes
    arrow = "\n\N{DOWNWARDS ARROW}\n"
    labels = [label.get_text().split(arrow) for label in axes.get_xticklabels()]
    assert labels == [list(pair) for pair in PAIRS[:3]]
    assert "1.4e-2\n4.5 x" in {text.get_text() for text in axes.texts}


NET = ClassifierPlan(
    "net",
    PlugIn("c", "net", "vocc_torch.receiver.classifiers.Mlp", {"hidden": [8]}),
    scene={"ambient_lx": Distribution("log_uniform", (1000.0, 32000.0))},
)


def test_a_mix_of_scenes_is_of_those_of_its_home(make_plan):
    plan = make_plan(names=("flda_3",))
    receiver = replace(plan.receiver, names=("flda_3", "net"), classifiers=(NET,))
    plan = replace(plan, receiver=receiver)
    config = ComparisonConfig(scene_frames=70, scene_training_frames=64)
    for at_home, scene in ((True, NET.scene), (False, {})):
        few = few_frames(plan, config, "fog", at_home=at_home)
        assert few.receiver.classifiers[0].scene == scene
        assert few.budget.training_frames == 64
