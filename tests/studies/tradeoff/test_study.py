"""The price list's receivers decide as all others do, on the same frames; what it refuses."""

import dataclasses

import numpy as np
import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.measure import build, link, runner, stage_times
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.likelihood import UnknownLikelihoodError
from vocc_torch.measure.plan import ClassifierPlan
from vocc_torch.measure.train import train
from vocc_torch.plugins import PlugIn
from vocc_torch.receiver.classifiers import Guarded, Inputs, Patch
from vocc_torch.receiver.classifiers.training import TrainingRecipe
from vocc_torch.report.terminal import Stopwatch
from vocc_torch.simulation import Camera, Distribution, SceneModel
from vocc_torch.studies.tradeoff import TradeoffConfig, run
from vocc_torch.studies.tradeoff.plan import TradeoffStudy
from vocc_torch.types import Frames, Panels

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


@pytest.fixture(scope="module")
def trained(study):
    return run.train_receivers(study, Workers(1))


@pytest.fixture(scope="module")
def counted(study, trained):
    (errors,) = run.count_receivers(study, trained[0], Workers(1))
    return errors


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


def test_what_is_varied_is_as_it_is_asked_for(make_study):
    every = make_study(
        names=("flda_3",), locators=["truth"], **MORE, varied=["flda_3"], combine="all"
    )
    assert len(every.settings) == 8
    # Not those that are not compared, unless they are named.
    for names in (("flda_3", "patch"), ("patch",)):
        usual = make_study(names=names, **MORE, varied=None).settings
        assert {one.receiver for one in usual if one.samples_per_led == 4} == {
            "flda_3"
        } & {*names}
    # What a receiver does not look at makes no setting.
    names = ("center_greyscale", "flda_ngr", "otsu")
    study = make_study(names=names, locators=["truth"], **MORE, varied=list(names))
    found = [
        (one.receiver, one.samples_per_led, one.gradient, one.dtype)
        for one in study.settings
    ]
    more = ((8, "sobel", "float64"), (4, "sobel", "float32"))
    others = [(name, *values) for name in names[1:] for values in more]
    assert found == [*((name, 8, "sobel", "float32") for name in names), *others]


def test_a_graph_is_drawn_of_the_very_receiver_and_timed_at_true_corners(
    make_study, monkeypatch
):
    """What is timed beside a graph decides as the receiver that it is drawn of."""
    drawn, seen = {}, []
    monkeypatch.setattr(
        run.onnx_graph,
        "write_graph",
        lambda one, path, *given: drawn.update({path: one}),
    )
    monkeypatch.setattr(
        run.onnx_graph, "read_graph", lambda path, _: lambda *given: seen.append(given)
    )
    names = ("average_greyscale", "flda_ngr", "patch")
    study = make_study(names, locators=["truth"], batch_sizes=[48], onnx=True)
    receivers, _ = run.train_receivers(study, Workers(1))
    times = run.measure_times(study, receivers)
    assert {*times["no_graphs"]} == {"average_greyscale"}
    assert (
        {name for name, _ in times["graphs"]}
        == {path.stem for path in drawn}
        == {"flda_ngr", "patch"}
    )
    assert all(0 < one.low <= one.value <= one.high for one in times["graphs"].values())
    frames, corners = seen[-1]
    assert (frames.dtype, frames.dim(), corners.shape) == (torch.uint8, 3, (48, 4, 2))
    of, panels = (
        {setting.receiver: one for setting, one in receivers.items()},
        Panels.known(corners),
    )
    for path, one in drawn.items():
        (scores,) = of[path.stem](Frames.whole(frames), panels).values()
        assert torch.equal(one(Frames.whole(frames), panels).scores, scores)
        assert float(scores.std()) > 0


def test_errors_are_those_of_the_sweep(study, trained, counted):
    """Every receiver at the base, against the counter that all experiments use, on the same blocks."""
    plan, receivers = study.plan, trained[0]
    for locator in study.config.locators:
        base = [one for one in study.settings if one.locator == locator][: len(EVERY)]
        own = dataclasses.replace(plan.receiver, locator=locator)
        bank = train(dataclasses.replace(plan, receiver=own)).bank(EVERY)
        for setting in base:
            # Trained by the very same recipe.
            bank.deciders |= {
                name: decider
                for name, decider in receivers[setting].bank.deciders.items()
                if isinstance(decider, Guarded)
            }
        deciding = runner.Banks([(locator, bank, 0)])
        job = runner.Job(plan, study.model("far"), study.point("far"), deciding)
        for wanted, setting in zip(
            job.count(range(2), plan.budget.frames).counts, base, strict=True
        ):
            assert counted["far"].counts[study.settings.index(setting)] == wanted, (
                setting
            )
    rates = [one.ber for one in counted["far"].counts]
    assert len(set(rates)) > len(rates) / 2
    assert 0 < min(rates) < 0.05


def test_every_training_is_counted_on_the_same_frames(make_study):
    """The first is as it is alone, the second as trained by itself; what learns nothing stays the same."""
    names = ("average_greyscale", "flda_3", "net")
    study = make_study(names, 64, locators=["truth"])
    budget = dataclasses.replace(study.plan.budget, trainings=2)
    twice = dataclasses.replace(
        study, plan=dataclasses.replace(study.plan, budget=budget)
    )
    (alone,) = run.count_receivers(
        study, run.train_receivers(study, Workers(1))[0], Workers(1)
    )
    receivers, _ = run.train_receivers(twice, Workers(1))
    first, second = run.count_receivers(twice, receivers, Workers(1))
    assert np.array_equal(first["mixture"].half_errors, alone["mixture"].half_errors)
    assert np.array_equal(
        first["mixture"].half_errors[0], second["mixture"].half_errors[0]
    )
    own = dataclasses.replace(twice.plan.receiver, locator="truth")
    (further,) = train(dataclasses.replace(twice.plan, receiver=own)).more
    deciding = runner.Banks([("truth", further.bank(["flda_3"]), 0)])
    job = runner.Job(
        study.plan, study.model("mixture"), study.point("mixture"), deciding
    )
    assert (
        job.count([0], 64).counts[0]
        == second["mixture"].counts[1]
        != first["mixture"].counts[1]
    )


def test_the_kinds_of_scenes_are_scenes_of_their_own(study, counted):
    assert list(counted) == ["far", "near"]
    assert not np.array_equal(counted["far"].half_errors, counted["near"].half_errors)
    assert counted["far"].half_errors.shape[1] == 100
    # Nor are they those of training, whatever a kind of scenes is called.
    assert study.point("train") == "tradeoff/train"


def test_neither_batches_nor_rivals_change_a_count(study, trained, counted):
    other = dataclasses.replace(
        study, plan=dataclasses.replace(study.plan, batch_frames=24)
    )
    # Every third is enough: all kinds are among them, and neither do the others change a count.
    some = dict(list(trained[0].items())[::3])
    (again,) = run.count_receivers(other, some, Workers(1))
    for name, errors in counted.items():
        assert np.array_equal(errors.half_errors[::3], again[name].half_errors)
        assert np.array_equal(errors.found[::3], again[name].found)


def test_precision_shares_its_training_and_decides_nearly_alike(
    study, trained, counted
):
    places = {
        one.dtype: place
        for place, one in enumerate(study.settings)
        if (one.receiver, one.locator, one.samples_per_led, one.gradient)
        == ("flda_3", "truth", 8, "sobel")
    }
    single, double = (study.settings[places[name]] for name in ("float32", "float64"))
    assert trained[1][single] == trained[1][double]
    assert [trained[0][one].dtype for one in (single, double)] == [
        torch.float32,
        torch.float64,
    ]
    rows = [counted["far"].half_errors[place] for place in places.values()]
    assert np.abs(rows[0] - rows[1]).sum() <= 0.01 * rows[0].sum()


def test_what_training_took_is_told(trained):
    costs = trained[1]
    for setting, one in costs.items():
        learned = setting.receiver not in (
            "center_greyscale",
            "average_greyscale",
            "otsu",
        )
        assert (one.frames > 0) == learned, setting
        assert (one.training_s > 0) == learned or setting.receiver == "otsu"
    sizes = {setting.receiver: one.parameters for setting, one in costs.items()}
    # 2 inputs, 4 neurons, 1 score; FLDA has a weight a feature and a threshold.
    assert (sizes["net"], sizes["flda_3"], sizes["flda_ngr"]) == (
        2 * 4 + 4 + 4 + 1,
        4,
        2,
    )


def test_a_receiver_moved_elsewhere_decides_the_same(study, trained):
    keys = link.block_keys(0, "moved", 64)
    seen = stage_times.Exposure.of(
        study.plan.world, study.model("far"), keys, preambles=True
    )
    for one in list(trained[0].values())[len(EVERY) : 2 * len(EVERY)]:
        moved = stage_times.on_device(one, torch.device("cpu"))
        ends = []
        for receiver in (one, moved):
            preambles = receiver.preambles(*seen.preambles, seen.truth)
            ends += receiver(seen.frames, seen.truth, preambles).values()
        assert torch.equal(*ends)
        mine, its = one.bank.deciders, moved.bank.deciders
        assert all(
            mine[name] is not its[name]
            for name in mine
            if mine[name].needs_patches and name != "average_greyscale"
        )


def test_a_whole_price_list_with_what_is_possible_on_the_very_frames(make_study):
    watch = Stopwatch()
    study = make_study(
        names=("flda_3", "otsu"), test_frames=20, locators=["truth"], genie_frames=64
    )
    prices = run.price_receivers(study, Workers(1), watch.stage)
    assert list(watch.seconds) == [
        "training",
        "bit errors",
        "what is possible",
        "times",
    ]
    assert (prices.timed_scenes, prices.in_one_go, prices.threads) == (
        "mixture",
        "flda_3",
        1,
    )
    for batch in (1, 16):
        for one in prices.points("mixture", "cpu", "crops", batch):
            assert 0 < one.time_ms.value < 1e4
    # No timing is asserted: only that it is the ratio of like to like.
    assert all(0.05 < ratio < 20 for ratio in prices.end_to_end.values())
    reference = prices.references["mixture"]
    # No more frames than the receivers have.
    assert reference.counts.frames == 20
    assert reference.counts.bit_errors <= prices.errors["mixture"].counts[0].bit_errors


def test_a_kind_of_scenes_that_the_genie_refuses_costs_no_other_its_reference(
    make_study, monkeypatch
):
    kinds = {"a": {}, "b": {}, "c": {}}
    study = make_study(
        names=("flda_3",),
        test_frames=4,
        locators=["truth"],
        genie_frames=2,
        scenes=kinds,
    )

    def refusing(plan, model, point, frames, workers, store):
        if point == study.point("b"):
            raise UnknownLikelihoodError("the genie knows no likelihood")
        return point

    monkeypatch.setattr(run.genie, "genie_reference", refusing)
    references, refused = run.measure_references(study, Workers(1))
    assert (list(references), refused) == (
        ["a", "c"],
        {"b": "the genie knows no likelihood"},
    )
    none = dataclasses.replace(
        study, config=dataclasses.replace(study.config, genie_frames=0)
    )
    assert (
        run.measure_references(none, Workers(1))[1]["a"] == "tradeoff.genie_frames is 0"
    )

    def failing(*given):
        raise VoccError("a worker was ended from outside")

    # No other mistake is taken for a refusal.
    monkeypatch.setattr(run.genie, "genie_reference", failing)
    with pytest.raises(VoccError, match="ended from outside"):
        run.measure_references(study, Workers(1))


def test_without_scikit_learn_its_classifiers_are_left_out_and_named(
    study, monkeypatch
):
    trees = {"_target_": "sklearn.ensemble.HistGradientBoostingClassifier"}
    nested = {
        "_target_": f"{HERE}.scaled",
        "estimator": {"_target_": "sklearn.svm.LinearSVC"},
    }
    absent = (
        ClassifierPlan("trees", PlugIn.of("c", trees)),
        ClassifierPlan("svm", PlugIn.of("c", nested)),
    )
    names = (*EVERY, "trees", "svm")
    receiver = dataclasses.replace(
        study.plan.receiver, names=names, classifiers=(*PLUGGED_IN, *absent)
    )
    assert build.without_absent(receiver) == (receiver, {})
    monkeypatch.setattr(build, "find_spec", lambda name: None)
    kept, left_out = build.without_absent(receiver)
    assert (kept.names, kept.classifiers) == (EVERY, PLUGGED_IN)
    said = "scikit-learn is not installed; pip install scikit-learn adds it"
    assert left_out == {"trees": said, "svm": said}


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
        ({"genie_frames": -1}, "tradeoff.genie_frames is -1: it must be at least 0"),
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
