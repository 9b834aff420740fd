"""The price list's receivers decide as all others do, on the same frames, and every stage is timed."""

import dataclasses
import itertools

import numpy as np
import pytest
import torch
from vocc_torch.studies.tradeoff.errors import count_errors, shots
from vocc_torch.studies.tradeoff.renderer import price_renderer
from vocc_torch.studies.tradeoff.supersampling import can_sample, sampled_cover
from vocc_torch.studies.tradeoff.times import measure_times, read, threads
from vocc_torch.studies.tradeoff.training import chains, train_receivers

from vocc_torch.errors import VoccError
from vocc_torch.measure import optional as optional_module
from vocc_torch.measure.frame_errors import Banks, FrameJob
from vocc_torch.measure.genie.genie_likelihood import UnknownLikelihoodError
from vocc_torch.measure.link import block_keys
from vocc_torch.measure.optional import without_absent
from vocc_torch.measure.plug_in import ClassifierPlan
from vocc_torch.measure.timing import Timing
from vocc_torch.measure.train import train
from vocc_torch.measure.workers import Workers
from vocc_torch.receiver.classifiers import Inputs, Patch
from vocc_torch.receiver.classifiers.training import TrainingRecipe
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.simulation import Camera, Distribution, LedPanel, SceneModel
from vocc_torch.simulation.raster import disc_cover
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.studies.tradeoff import study as study_module
from vocc_torch.studies.tradeoff import times as times_module
from vocc_torch.studies.tradeoff.plan import RendererKnobs, TradeoffStudy
from vocc_torch.studies.tradeoff.price_list import STAGES, Place, Setting
from vocc_torch.studies.tradeoff.study import price_receivers
from vocc_torch.types import Frames, Panels

HERE = "vocc_torch.receiver.classifiers"
NAMES = ("center_greyscale", "average_greyscale", "flda_ngr", "flda_2", "flda_3")
PLUGGED_IN = (
    ClassifierPlan(
        "patch", {"_target_": f"{HERE}.FldaClassifier"}, Inputs(("gri",), Patch(3, 4, pitch=True))
    ),
    ClassifierPlan("otsu", {"_target_": f"{HERE}.PanelOtsu"}, Inputs((), Patch(1, 4, relative="white"))),
    ClassifierPlan(
        "net",
        {"_target_": f"{HERE}.Mlp", "hidden": [4]},
        Inputs(("agr", "ngr")),
        training=TrainingRecipe(frames=64, epochs=2),
    ),
)
EVERY = (*NAMES, *(one.name for one in PLUGGED_IN))
FAR = {"ambient_lx": Distribution("constant", (1000.0,)), "distance_m": Distribution("uniform", (60.0, 70.0))}


@pytest.fixture(scope="module")
def make_study(make_plan):
    """Make a study of far panels in low light, where receivers disagree."""

    def make(names=EVERY, test_frames=100, **changes):
        # The middle of the paper's sensor: whole frames are a sixteenth of the work.
        camera = Camera(width_px=480, height_px=272, sensor_width_mm=3.3)
        plan = make_plan(
            names=NAMES, frames=test_frames, training_frames=64, scene=SceneModel(**FAR), camera=camera
        )
        own = tuple(one for one in PLUGGED_IN if one.name in names)
        receiver = dataclasses.replace(plan.receiver, names=names, classifiers=own)
        settings = {
            "locators": ("paper", "truth"),
            "repeats": 1,
            "batch_sizes": (1, 16),
            "frames": ("crops",),
        }
        settings["knobs"] = RendererKnobs(0)
        return TradeoffStudy(dataclasses.replace(plan, receiver=receiver), **{**settings, **changes})

    return make


@pytest.fixture(scope="module")
def study(make_study):
    return make_study(
        samples_per_led=(8, 4), gradients=("sobel", "central"), dtypes=("float32", "float64"),
        varied=("flda_3", "patch"),
        scenes={"far": {}, "near": {"distance_m": Distribution("constant", (61.0,))}},
    )  # fmt: skip


@pytest.fixture(scope="module")
def made(study):
    return train_receivers(study, Workers(1))


@pytest.fixture(scope="module")
def receivers(study, made):
    return chains(study, made)


@pytest.fixture(scope="module")
def counted(study, receivers):
    return count_errors(study, receivers, Workers(1))


def test_every_receiver_is_measured_with_every_locator_and_the_varied_ones_at_more(study):
    at = [(one.receiver, one.locator) for one in study.settings[: 2 * len(EVERY)]]
    assert at == [(name, locator) for locator in ("paper", "truth") for name in EVERY]
    further = {
        (one.receiver, one.samples_per_led, one.gradient, one.dtype)
        for one in study.settings[2 * len(EVERY) :]
        if one.locator == "truth"
    }
    others = ((4, "sobel", "float32"), (8, "central", "float32"), (8, "sobel", "float64"))
    assert further == {(name, *values) for name in ("flda_3", "patch") for values in others}


def test_all_combinations_on_demand(make_study):
    study = make_study(
        names=("flda_3",), locators=("truth",), samples_per_led=(8, 4), gradients=("sobel", "central"),
        dtypes=("float32", "float64"), varied=("flda_3",), combine="all",
    )  # fmt: skip
    assert len(study.settings) == 8


def test_what_a_receiver_does_not_look_at_makes_no_setting(make_study):
    study = make_study(
        names=("center_greyscale", "flda_ngr", "otsu"), locators=("truth",), samples_per_led=(8, 4),
        gradients=("sobel", "central"), dtypes=("float32", "float64"),
        varied=("center_greyscale", "flda_ngr", "otsu"),
    )  # fmt: skip
    found = [(one.receiver, one.samples_per_led, one.gradient, one.dtype) for one in study.settings]
    assert found == [
        *((name, 8, "sobel", "float32") for name in ("center_greyscale", "flda_ngr", "otsu")),
        *((name, 8, "sobel", "float64") for name in ("flda_ngr",)),
        ("flda_ngr", 4, "sobel", "float32"),
        ("otsu", 8, "sobel", "float64"),
        ("otsu", 4, "sobel", "float32"),
    ]


def test_errors_are_those_of_the_sweep(study, made, receivers, counted):
    """Every receiver at the base, against the counter that all experiments use, on the same blocks."""
    plan, names = study.plan, EVERY
    for locator in study.locators:
        base = [one for one in study.settings if one.locator == locator][: len(EVERY)]
        training = train(
            dataclasses.replace(plan, receiver=dataclasses.replace(plan.receiver, locator=locator))
        )
        bank = training.bank(names)
        for name in (one.name for one in PLUGGED_IN):
            # Trained by the very same recipe.
            (setting,) = (one for one in base if one.receiver == name)
            bank.plugged_in[name] = made[setting].decider
        receivers = Banks([(locator, bank)])
        job = FrameJob(
            plan, study.model("far"), study.point("far"), (locator,), receivers, receivers.needs_preambles
        )
        for wanted, setting in zip(job(range(plan.budget.frames)).counts, base, strict=True):
            assert counted["far"].counts[study.settings.index(setting)] == wanted, setting
    rates = [one.ber for one in counted["far"].counts]
    assert len(set(rates)) > len(rates) / 2
    assert 0 < min(rates) < 0.05


def test_the_kinds_of_scenes_are_scenes_of_their_own(counted):
    assert list(counted) == ["far", "near"]
    assert not np.array_equal(counted["far"].half_errors, counted["near"].half_errors)
    assert counted["far"].half_errors.shape[1] == 100


def test_no_frame_is_trained_on_and_tested_on(study):
    """Training and tests name their draws differently, whatever a kind of scenes is called."""
    plan = study.plan
    trained = {key.point for key in block_keys(plan.seed, "train", 64)}
    assert trained == {"train"}
    assert all(study.point(name).startswith("tradeoff/") for name in (*study.scenes, "train"))


def test_neither_batches_nor_workers_change_a_count(study, receivers, counted):
    other = dataclasses.replace(study, plan=dataclasses.replace(study.plan, batch_frames=24))
    # Every third is enough: all kinds are among them, and neither do the others change a count.
    again = count_errors(other, receivers[::3], Workers(1))
    for name, errors in counted.items():
        assert np.array_equal(errors.half_errors[::3], again[name].half_errors)
        assert np.array_equal(errors.found[::3], again[name].found)


def test_precision_shares_its_training_and_k_does_not(study, made):
    trained = {(one.receiver, one.locator, one.samples_per_led, one.gradient, one.dtype) for one in made}
    assert not any(one[-1] == "float64" for one in trained)
    assert ("flda_3", "truth", 4, "sobel", "float32") in trained
    assert ("flda_3", "truth", 8, "central", "float32") in trained


def test_double_precision_decides_nearly_alike(study, receivers, counted):
    rows = {
        one.dtype: counted["far"].half_errors[place]
        for place, one in enumerate(study.settings)
        if (one.receiver, one.locator, one.samples_per_led, one.gradient) == ("flda_3", "truth", 8, "sobel")
    }
    assert set(rows) == {"float32", "float64"}
    for chain in receivers:
        grey = torch.full((1, 1, 60, 60), 9, dtype=torch.uint8)
        corners = torch.tensor([[[9.0, 9.0], [49.0, 9.0], [49.0, 49.0], [9.0, 49.0]]])
        patches = chain.rectify(Frames.whole(grey), Panels.known(corners))
        assert patches is None or str(patches.dtype) == f"torch.{chain.setting.dtype}"
    assert np.abs(rows["float32"] - rows["float64"]).sum() <= 0.01 * rows["float32"].sum()


def test_what_training_took_is_told(study, made):
    for setting, one in made.items():
        learned = setting.receiver not in ("center_greyscale", "average_greyscale", "otsu")
        assert (one.making.frames > 0) == learned, setting
        assert (one.making.training_s > 0.01) == learned or setting.receiver == "otsu"
    sizes = {setting.receiver: one.making.parameters for setting, one in made.items()}
    # 2 inputs, 4 neurons, 1 score; FLDA has a weight a feature and a threshold.
    assert (sizes["net"], sizes["flda_3"], sizes["flda_ngr"]) == (2 * 4 + 4 + 4 + 1, 4, 2)


def test_a_receiver_moved_elsewhere_decides_the_same(study, receivers):
    (shot,) = shots(
        study.plan.world.simulator(), study.model("far"), block_keys(0, "moved", 64), 64, preambles=True
    )
    panels = study.plan.world.simulator().true_panels(shot.scene)
    for chain in receivers[len(EVERY) : 2 * len(EVERY)]:
        threshold = chain.threshold(shot.preambles, panels)
        moved = chain.to(torch.device("cpu"))
        assert moved.decider is None or moved.decider is not chain.decider
        assert torch.equal(
            moved.decide(shot.frames, panels, threshold), chain.decide(shot.frames, panels, threshold)
        )


def test_preambles_have_noise_of_their_own(make_plan):
    noise = {"read_noise": {"electrons": 30.0}, "photoelectrons": {"quantum_efficiency": 0.6}, "gain": {}}
    camera = Camera(width_px=96, height_px=64, sensor_width_mm=0.66)
    centred = {name: Distribution("constant", (0.0,)) for name in ("offset_x_m", "offset_y_m")}
    model = SceneModel(distance_m=Distribution("constant", (60.0,)), **centred)
    plan = make_plan(camera=camera, scene=model, effects={**PAPER_EFFECTS, **noise})
    simulator, keys = plan.world.simulator(), block_keys(0, "noise", 64)
    (shot,) = shots(simulator, model, keys, 64, preambles=True)
    every = torch.ones_like(shot.bits)
    for sent, take, seen in ((shot.bits, "", shot.frames), (every, "on", shot.preambles[0])):
        own = [dataclasses.replace(key, take=take) if take else key for key in shot.keys]
        again = simulator.render(shot.scene, sent, nearest_m=model.nearest_m, keys=own)
        assert torch.equal(again.grey, seen.grey)
    with_the_frames_noise = simulator.render(shot.scene, every, nearest_m=model.nearest_m, keys=shot.keys)
    assert not torch.equal(with_the_frames_noise.grey, shot.preambles[0].grey)


@pytest.mark.parametrize("count", [1, 3])
def test_reading_gives_the_very_frames(count):
    grey = torch.arange(count * 12, dtype=torch.uint8).view(count, 1, 3, 4)
    frames = read(Frames(grey, torch.zeros(count, 2).long(), (3, 4), torch.zeros(count)), torch.device("cpu"))
    assert torch.equal(frames.grey, grey)
    assert frames.grey.dtype == torch.uint8
    # A batch is put together from single frames, which costs a copy.
    assert (frames.grey.data_ptr() == grey.data_ptr()) == (count == 1)


@pytest.fixture(scope="module")
def timed(study, receivers):
    """Each call is made, and takes as many seconds as it has letters."""

    def counted_seconds(calls, repeats, device, **given):
        for call in calls.values():
            call()
        return {name: Timing((float(len(name)),) * repeats) for name in calls}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(times_module, "interleaved", counted_seconds)
        return measure_times(
            dataclasses.replace(study, frames=("crops", "whole"), batch_sizes=(6, 24)), receivers
        )


def test_every_setting_is_timed_everywhere(study, timed):
    places = [Place("cpu", kind, batch) for kind in ("crops", "whole") for batch in (6, 24)]
    assert set(timed.spent) == set(itertools.product(study.settings, places))
    assert timed.crop_px == (71, 71) or max(timed.crop_px) < 100
    assert set(timed.end_to_end) == set(places)
    for (setting, place), spent in timed.spent.items():
        # Small batches have more rounds, so that all meet 48 frames.
        assert len(spent.rounds_ms["read"]) == 48 // place.batch
        nothing = {stage for stage in STAGES if spent.rounds_ms[stage][0] == 0}
        known = setting.receiver in ("center_greyscale", "average_greyscale")
        wanted = set() if known else {"preambles"}
        wanted |= {"locate"} if setting.locator == "truth" else set()
        wanted |= {"rectify"} if setting.receiver == "center_greyscale" else set()
        assert nothing == wanted, setting
        # ms a frame: here a second a letter of the call's name.
        assert spent.rounds_ms["read"][0] == pytest.approx(4e3 / place.batch)
        if setting.locator == "paper":
            assert spent.rounds_ms["locate"][0] == pytest.approx(len("locate paper") * 1e3 / place.batch)


def test_receivers_that_share_a_stage_share_its_time(study, timed):
    place = Place("cpu", "crops", 24)
    rectified = {
        (one.locator, one.samples_per_led, one.dtype): timed.spent[one, place].rounds_ms["rectify"]
        for one in study.settings
        if one.receiver != "center_greyscale"
    }
    for one in study.settings:
        if one.receiver != "center_greyscale":
            own = rectified[one.locator, one.samples_per_led, one.dtype]
            assert timed.spent[one, place].rounds_ms["rectify"] is own or (
                timed.spent[one, place].rounds_ms["rectify"] == own
            )


def test_frames_of_known_bits_are_paid_for(study, receivers):
    """Two frames, each read and measured, for every so many of data."""
    bench = times_module._Bench(receivers, [], torch.device("cpu"), 5)
    for chain in receivers:
        timing = {name: Timing((1.0, 2.0)) for name in bench.calls}
        rounds = bench.spent(chain.setting, timing, 1).rounds_ms
        one = rounds["read"][1] + rounds["rectify"][1] + rounds["features"][1]
        greyscale = chain.setting.receiver in ("center_greyscale", "average_greyscale")
        assert rounds["preambles"][1] == pytest.approx(2 / 5 * one if greyscale else 0.0)


def test_threads_are_put_back():
    before = torch.get_num_threads()
    with threads(before + 1):
        assert torch.get_num_threads() == before + 1
    assert torch.get_num_threads() == before


def test_scikit_learn_has_as_many_threads_as_torch():
    # Imported first: its threads are limited where it is in use.
    pytest.importorskip("sklearn.ensemble")
    pools = pytest.importorskip("threadpoolctl")

    def counts():
        return [pool["num_threads"] for pool in pools.threadpool_info() if pool["user_api"] == "openmp"]

    before = counts()
    with threads(3):
        assert set(counts()) == {3}
    assert counts() == before


def test_a_whole_price_list(make_study):
    told = []
    study = make_study(names=("flda_3", "otsu"), test_frames=64, locators=("paper",), scene_name="made up")
    prices = price_receivers(study, Workers(1), told.append)
    assert told == ["training", "bit errors", "what is possible", "times"]
    assert (prices.marks, prices.no_marks) == ({}, {"mixture": "tradeoff.genie_frames is 0"})
    assert (prices.timed_scenes, prices.in_one_go) == ("mixture", "flda_3")
    assert prices.settings == study.settings
    assert (prices.threads, prices.scene, prices.error_device) == (1, "made up", "cpu")
    for frames, batch in itertools.product(("crops",), (1, 16)):
        for offer in prices.offers("mixture", "cpu", frames, batch):
            assert 0 < offer.median_ms < 1e4
            assert offer.ber_low <= offer.ber <= offer.ber_high
    for ratio in prices.end_to_end.values():
        # No timing is asserted: only that it is the ratio of like to like.
        assert 0.05 < ratio < 20


def test_without_scikit_learn_its_classifiers_are_left_out_and_named(study, monkeypatch):
    trees = ClassifierPlan("trees", {"_target_": "sklearn.ensemble.HistGradientBoostingClassifier"})
    nested = ClassifierPlan(
        "svm", {"_target_": f"{HERE}.scaled", "estimator": {"_target_": "sklearn.svm.LinearSVC"}}
    )
    receiver = dataclasses.replace(
        study.plan.receiver, names=(*EVERY, "trees", "svm"), classifiers=(*PLUGGED_IN, trees, nested)
    )
    assert without_absent(receiver) == (receiver, {})
    monkeypatch.setattr(optional_module, "find_spec", lambda name: None)
    kept, left_out = without_absent(receiver)
    assert (kept.names, kept.classifiers) == (EVERY, PLUGGED_IN)
    said = "scikit-learn is not installed; pip install scikit-learn adds it"
    assert left_out == {"trees": said, "svm": said}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"locators": ()}, "tradeoff.locators is empty"),
        ({"locators": ("gps",)}, "tradeoff.locators has 'gps': it must be of truth, paper, refined"),
        ({"samples_per_led": (8, 1)}, "tradeoff.samples_per_led has 1: it must be from 2 to 64"),
        ({"samples_per_led": (6,)}, "must be a multiple of classifiers.patch.inputs.patch.samples, 4"),
        ({"gradients": ("prewitt",)}, "tradeoff.gradients has 'prewitt'"),
        ({"dtypes": ("float16",)}, "tradeoff.dtypes has 'float16': it must be of float32, float64"),
        ({"varied": ("flda_9",)}, "tradeoff.varied has 'flda_9'"),
        ({"combine": "some"}, "tradeoff.combine has 'some'"),
        ({"batch_sizes": (0,)}, "tradeoff.batch_sizes has 0: it must be from 1 to 1024"),
        ({"frames": ("halves",)}, "tradeoff.frames has 'halves': it must be of whole, crops"),
        ({"repeats": 0}, "tradeoff.repeats is 0: it must be at least 1"),
        ({"threads": -1}, "tradeoff.threads is -1: it must be at least 0"),
        ({"frames_a_preamble": 0}, "tradeoff.frames_a_preamble is 0: it must be at least 1"),
        (
            {"knobs": RendererKnobs(1, margins_px=(-500,))},
            "tradeoff.simulation.margins_px has -500: it must be",
        ),
        ({"genie_frames": -1}, "tradeoff.genie_frames is -1: it must be at least 0"),
        ({"scenes": {}}, "tradeoff.scenes is empty"),
        ({"devices": ("tpu",)}, "tpu"),
        (
            {"scenes": {"odd": {"distance_m": Distribution("constant", (-1.0,))}}},
            "tradeoff.scenes.odd.distance_m",
        ),
    ],
)
def test_impossible_studies_are_refused(make_study, changes, said):
    with pytest.raises(VoccError) as raised:
        make_study(**changes, **({} if "samples_per_led" not in changes else {"varied": ("flda_3",)}))
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("knobs", "said"),
    [
        ((-1,), "frames is -1"),
        ((1, (0.0,)), "kernel_sigmas has 0"),
        ((1, (), (), (0,)), "supersampling has 0"),
    ],
)
def test_impossible_knobs_are_refused(knobs, said):
    with pytest.raises(VoccError, match=said):
        RendererKnobs(*knobs)


def test_a_stop_rule_is_refused(make_study, study):
    budget = dataclasses.replace(study.plan.budget, target_frame_errors=10)
    with pytest.raises(
        VoccError, match=r"budget\.target_frame_errors is 10: it must be null for task=tradeoff"
    ):
        dataclasses.replace(study, plan=dataclasses.replace(study.plan, budget=budget))


@pytest.fixture(scope="module")
def knobs(make_plan):
    """A small sensor, whose whole frames are a sixteenth of the work."""
    camera = Camera(width_px=480, height_px=272, sensor_width_mm=3.3)
    centred = {name: Distribution("constant", (0.0,)) for name in ("offset_x_m", "offset_y_m")}
    plan = make_plan(
        camera=camera, scene=SceneModel(distance_m=Distribution("uniform", (40.0, 70.0)), **centred)
    )
    study = TradeoffStudy(
        plan,
        repeats=1,
        knobs=RendererKnobs(2, (1.0, 2.0, 3.0, 8.0), (-20, -4, 16), (1, 4, 16)),
        scenes={"mixture": {}},
    )
    return {(one.knob, one.value): one for one in price_renderer(study)}


def test_each_knob_is_turned_by_itself(knobs):
    assert list(knobs) == [
        ("none", "as set"), ("dtype", "float64"), ("framing", "filled"), ("framing", "full"),
        ("kernel", "1 sigma"), ("kernel", "2 sigma"), ("kernel", "3 sigma"), ("kernel", "8 sigma"),
        ("margin", "-20 px"), ("margin", "-4 px"), ("margin", "+16 px"),
        ("sampled", "1 x 1"), ("sampled", "4 x 4"), ("sampled", "16 x 16"),
    ]  # fmt: skip
    assert all(one.cost_ms[0] > 0 for one in knobs.values())
    assert knobs["framing", "full"].frames_a_call == 1


def test_a_wider_kernel_is_nearer_to_the_truth(knobs):
    worst = [knobs["kernel", f"{sigmas} sigma"].worst_dn for sigmas in (1, 2, 3)]
    worst += [knobs["none", "as set"].worst_dn, knobs["kernel", "8 sigma"].worst_dn]
    assert all(a > 3 * b for a, b in itertools.pairwise(worst))
    # At the reference's own kernel what is left is float32's rounding, 255 / 2^24 a step.
    assert worst[-1] < 40 * 255 / 2**24
    assert knobs["kernel", "8 sigma"].changed <= knobs["kernel", "1 sigma"].changed


def test_framings_give_the_same_pixels(knobs):
    usual = knobs["none", "as set"]
    for value in ("filled", "full"):
        one = knobs["framing", value]
        assert (one.worst_dn, one.rms_dn, one.changed) == (usual.worst_dn, usual.rms_dn, usual.changed)


def test_a_margin_that_cuts_the_panels_light_off_shows(knobs):
    usual = knobs["none", "as set"]
    assert knobs["margin", "-20 px"].worst_dn > 100 * usual.worst_dn
    for value in ("-4 px", "+16 px"):
        assert knobs["margin", value].worst_dn == usual.worst_dn


def test_more_samples_are_nearer_to_exact_areas_and_never_there(knobs):
    rms = [knobs["sampled", f"{n} x {n}"].rms_dn for n in (1, 4, 16)]
    assert all(a > 3 * b for a, b in itertools.pairwise(rms))
    assert rms[-1] > 10 * knobs["none", "as set"].rms_dn


def test_sampled_covers_come_to_the_exact_ones():
    rng = np.random.default_rng(0)
    x, y = torch.from_numpy(rng.uniform(5, 20, (2, 40)))
    radius = torch.from_numpy(rng.uniform(0.6, 3.5, 40))
    exact, left, top = disc_cover(x, y, radius, 8)
    sampled, its_left, its_top = sampled_cover(x, y, radius, 8, 64)
    assert torch.equal(left, its_left)
    assert torch.equal(top, its_top)
    # A circle crosses at most about 4 s of a pixel's s x s parts, and half of each is in doubt.
    assert float((sampled - exact).abs().max()) < 2 / 64
    coarse, _, _ = sampled_cover(x, y, radius, 8, 1)
    assert set(coarse.unique().tolist()) == {0.0, 1.0}


def test_scenes_that_are_not_plain_are_not_sampled(make_plan):
    assert can_sample(make_plan().world)
    tilted = {**PAPER_EFFECTS, "pose": {"yaw_deg": 10.0}}
    assert not can_sample(make_plan(effects=tilted).world)
    assert not can_sample(make_plan(panel=LedPanel(board_reflectance=0.1)).world)


def test_what_is_possible_is_measured_on_the_very_frames(make_study):
    study = make_study(names=("flda_3",), test_frames=20, locators=("truth",), genie_frames=64)
    prices = price_receivers(study, Workers(1))
    mark = prices.marks["mixture"]
    # No more frames than the receivers have.
    assert mark.counts.frames == 20
    assert mark.counts.bit_errors <= prices.counts("mixture")[study.settings[0]].bit_errors
    plan = dataclasses.replace(study.plan.world, effects={"saturation": {}})
    strange = dataclasses.replace(study, plan=dataclasses.replace(study.plan, world=plan))
    unknown = price_receivers(strange, Workers(1))
    assert unknown.marks == {}
    assert "the genie reads digital numbers" in unknown.no_marks["mixture"]


def test_a_kind_of_scenes_that_the_genie_refuses_costs_no_other_its_mark(make_study, monkeypatch):
    study = make_study(
        names=("flda_3",),
        test_frames=4,
        locators=("truth",),
        genie_frames=2,
        scenes={"a": {}, "b": {}, "c": {}},
    )
    genie = study_module.genie_mark

    def refusing(world, model, seed, point, frames, workers):
        if point == study.point("b"):
            raise UnknownLikelihoodError(
                "the genie knows no likelihood for pixels full before they are white"
            )
        return genie(world, model, seed, point, frames, workers)

    monkeypatch.setattr(study_module, "genie_mark", refusing)
    marks, refused = study_module._marks(study, Workers(1))
    assert list(marks) == ["a", "c"]
    assert refused == {"b": "the genie knows no likelihood for pixels full before they are white"}


@pytest.mark.parametrize("error", [VoccError("a worker was ended from outside"), VoccError("the genie ...")])
def test_no_other_mistake_is_taken_for_a_refusal(make_study, monkeypatch, error):
    study = make_study(names=("flda_3",), test_frames=4, locators=("truth",), genie_frames=2)

    def failing(*given):
        raise error

    monkeypatch.setattr(study_module, "genie_mark", failing)
    with pytest.raises(VoccError, match=str(error)):
        study_module._marks(study, Workers(1))


def test_the_reference_itself_has_no_error(make_plan):
    camera = Camera(width_px=240, height_px=136, sensor_width_mm=1.65)
    centred = {name: Distribution("constant", (0.0,)) for name in ("offset_x_m", "offset_y_m")}
    near = SceneModel(distance_m=Distribution("constant", (60.0,)), **centred)
    plan = make_plan(camera=camera, scene=near, framing="full", dtype=torch.float64)
    study = TradeoffStudy(plan, repeats=1, knobs=RendererKnobs(1, (8.0,), (), ()), scenes={"mixture": {}})
    (exact,) = (one for one in price_renderer(study) if one.knob == "kernel")
    assert (exact.worst_dn, exact.rms_dn, exact.changed) == (0.0, 0.0, 0.0)
    assert exact.exact


def test_the_renderer_may_be_left_out(make_study):
    assert price_renderer(make_study(names=("flda_3",))) == []


def test_the_locator_is_the_plans(study, receivers):
    assert isinstance(receivers[0].locator, PaperLocator)
    assert receivers[len(EVERY)].locator is None
    assert receivers[0].setting == Setting("center_greyscale", "paper", 8, "sobel", "float32")
