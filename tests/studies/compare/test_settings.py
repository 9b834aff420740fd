"""What ``task=tradeoff`` compares, and what it refuses."""

import dataclasses

import pytest

from vocc_torch.errors import VoccError
from vocc_torch.measure.plan import ClassifierPlan
from vocc_torch.plugins import PlugIn
from vocc_torch.receiver.classifiers import Inputs, Patch
from vocc_torch.receiver.classifiers.training import TrainingRecipe
from vocc_torch.simulation import Camera, Distribution, SceneModel
from vocc_torch.studies.compare import TradeoffConfig
from vocc_torch.studies.compare.settings import TradeoffStudy

HERE = "vocc_torch.receiver.classifiers"
NAMES = ("center_greyscale", "average_greyscale", "flda_ngr", "flda_2", "flda_3")
SEEN = {
    "patch": ("FldaClassifier", Inputs(("gri",), Patch(3, 4, pitch=True)), {}),
    "otsu": ("PanelOtsu", Inputs((), Patch(1, 4, relative="white")), {}),
    "net": ("Mlp", Inputs(("agr", "ngr")), {"hidden": [4]}),
}
RECIPE = TrainingRecipe(frames=64, epochs=2)
PLUGGED_IN = tuple(
    ClassifierPlan(
        name, PlugIn("c", name, f"{HERE}.{kind}", more), inputs, training=RECIPE
    )
    for name, (kind, inputs, more) in SEEN.items()
)
EVERY = (*NAMES, *(one.name for one in PLUGGED_IN))
FAR = {
    "ambient_lx": Distribution("constant", (1000.0,)),
    "distance_m": Distribution("uniform", (60.0, 70.0)),
}
MORE = {
    "samples_per_led": [8, 4],
    "gradients": ["sobel", "central"],
    "dtypes": ["float32", "float64"],
}


@pytest.fixture(scope="module")
def make_study(make_plan):
    """Make a study of far panels in low light, where receivers disagree."""

    def make(names=EVERY, test_frames=100, **changes):
        # The middle of the paper's sensor: whole frames are a sixteenth of the work.
        camera = Camera(width_px=480, height_px=272, sensor_width_mm=3.3)
        plan = make_plan(
            names=NAMES,
            frames=test_frames,
            training_frames=64,
            scene=SceneModel(**FAR),
            camera=camera,
        )
        own = tuple(one for one in PLUGGED_IN if one.name in names)
        receiver = dataclasses.replace(plan.receiver, names=names, classifiers=own)
        usual = {
            **{
                "locators": ["paper", "truth"],
                "samples_per_led": [8],
                "gradients": ["sobel"],
            },
            **{
                "dtypes": ["float32"],
                "varied": [],
                "devices": ["cpu"],
                "batch_sizes": [1, 16],
            },
            **{
                "frames": ["crops"],
                "repeats": 1,
                "threads": 1,
                "scenes": {"mixture": {}},
            },
        }
        config = TradeoffConfig(**{**usual, **changes})
        return TradeoffStudy(
            dataclasses.replace(plan, receiver=receiver), config, "made up"
        )

    return make


@pytest.fixture(scope="module")
def study(make_study):
    near = {"distance_m": Distribution("constant", (61.0,))}
    return make_study(
        **MORE, varied=["flda_3", "patch"], scenes={"far": {}, "near": near}
    )


def test_every_receiver_is_measured_with_every_locator_and_the_varied_ones_at_more(
    study,
):
    at = [(one.receiver, one.locator) for one in study.settings[: 2 * len(EVERY)]]
    assert at == [(name, locator) for locator in ("paper", "truth") for name in EVERY]
    further = {
        (one.receiver, one.samples_per_led, one.gradient, one.dtype)
        for one in study.settings[2 * len(EVERY) :]
        if one.locator == "truth"
    }
    others = (
        (4, "sobel", "float32"),
        (8, "central", "float32"),
        (8, "sobel", "float64"),
    )
    assert further == {
        (name, *values) for name in ("flda_3", "patch") for values in others
    }
    assert len({one.name for one in study.settings}) == len(study.settings)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"locators": []}, "tradeoff.locators is empty"),
        (
            {"locators": ["gps"]},
            "tradeoff.locators has 'gps': it must be of truth, paper, refined",
        ),
        (
            {"samples_per_led": [8, 1]},
            "tradeoff.samples_per_led has 1: it must be from 2 to 64",
        ),
        (
            {"samples_per_led": [6]},
            "must be a multiple of classifiers.patch.inputs.patch.samples, 4",
        ),
        ({"gradients": ["prewitt"]}, "tradeoff.gradients has 'prewitt'"),
        (
            {"dtypes": ["float16"]},
            "tradeoff.dtypes has 'float16': it must be of float32, float64",
        ),
        ({"varied": ["flda_9"]}, "tradeoff.varied has 'flda_9'"),
        ({"combine": "some"}, "tradeoff.combine has 'some'"),
        ({"batch_sizes": [0]}, "tradeoff.batch_sizes has 0: it must be from 1 to 1024"),
        (
            {"frames": ["halves"]},
            "tradeoff.frames has 'halves': it must be of whole, crops",
        ),
        ({"repeats": 0}, "tradeoff.repeats is 0: it must be at least 1"),
        ({"threads": -1}, "tradeoff.threads is -1: it must be at least 0"),
        (
            {"frames_a_preamble": 0},
            "tradeoff.frames_a_preamble is 0: it must be at least 1",
        ),
        ({"scenes": {}}, "tradeoff.scenes is empty"),
        ({"scenes": {"odd": {"distance_m": -1.0}}}, "tradeoff.scenes.odd.distance_m"),
        (
            {"scenes": {"odd": 5}},
            "tradeoff.scenes.odd is 5: it must be a word with values of scenes",
        ),
    ],
)
def test_impossible_studies_are_refused(make_study, changes, said):
    with pytest.raises(VoccError) as raised:
        make_study(**{"varied": ["flda_3"], **changes})
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_stop_rule_is_refused(study):
    budget = dataclasses.replace(study.plan.budget, target_frame_errors=10)
    said = r"budget\.target_frame_errors is 10: it must be null for task=tradeoff"
    with pytest.raises(VoccError, match=said):
        dataclasses.replace(study, plan=dataclasses.replace(study.plan, budget=budget))
