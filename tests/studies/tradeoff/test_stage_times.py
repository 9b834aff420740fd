"""What is timed for a setting is its own: stage, locator, K, gradient and precision."""

import dataclasses
import itertools
from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from vocc_torch.measure.plug_in import ClassifierPlan
from vocc_torch.measure.timing import Timing
from vocc_torch.measure.workers import Workers
from vocc_torch.receiver.classifiers import Inputs, Patch
from vocc_torch.simulation import Camera, Distribution, SceneModel
from vocc_torch.studies.tradeoff import times as times_module
from vocc_torch.studies.tradeoff.chain import Chain
from vocc_torch.studies.tradeoff.plan import RendererKnobs, TradeoffStudy
from vocc_torch.studies.tradeoff.price_list import STAGES, Place, Setting
from vocc_torch.studies.tradeoff.times import measure_times
from vocc_torch.studies.tradeoff.training import chains, train_receivers

NAMES = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")
OTSU = ClassifierPlan(
    "otsu",
    {"_target_": "vocc_torch.receiver.classifiers.PanelOtsu"},
    Inputs((), Patch(1, 4, relative="white")),
)
LOCATORS = ("paper", "refined", "truth")
BATCHES = (3, 24)
LEDS = 8


@dataclass(frozen=True)
class Event:
    """What a timed call did: a stage, for whom, and with which tensor; what came out of it."""

    stage: str
    setting: Setting | None = None
    given: Tensor | None = None
    made: Tensor | None = None
    corners: Tensor | None = None
    locator: str = ""


class Spied:
    """A locator that tells when it looks."""

    def __init__(self, name, locator, log):
        self.name, self.locator, self.log = name, locator, log

    def __call__(self, frames, shape):
        self.log.append(Event("locate", given=frames.grey, locator=self.name))
        return self.locator(frames, shape)


@pytest.fixture(scope="module")
def study(make_plan):
    """Far panels in the middle of the paper's sensor."""
    scene = SceneModel(
        ambient_lx=Distribution("constant", (1000.0,)), distance_m=Distribution("uniform", (60.0, 70.0))
    )
    camera = Camera(width_px=480, height_px=272, sensor_width_mm=3.3)
    plan = make_plan(names=NAMES, frames=64, training_frames=64, scene=scene, camera=camera)
    receiver = dataclasses.replace(plan.receiver, names=(*NAMES, "otsu"), classifiers=(OTSU,))
    return TradeoffStudy(
        dataclasses.replace(plan, receiver=receiver), locators=LOCATORS, samples_per_led=(8, 4),
        gradients=("sobel", "central"), dtypes=("float32", "float64"), varied=("flda_3", "otsu"),
        batch_sizes=BATCHES, frames=("crops",), repeats=1, knobs=RendererKnobs(0),
    )  # fmt: skip


@pytest.fixture(scope="module")
def recorded(study):
    """Times that are the numbers of calls, and what each of these calls did, by number."""
    log, calls_made, numbers = [], {}, itertools.count(1)
    receivers = chains(study, train_receivers(study, Workers(1)))
    spies = {chain.setting.locator: chain.locator for chain in receivers}
    spies = {name: one and Spied(name, one, log) for name, one in spies.items()}
    receivers = [dataclasses.replace(one, locator=spies[one.setting.locator]) for one in receivers]

    def rectify(chain, frames, panels, original=Chain.rectify):
        made = original(chain, frames, panels)
        log.append(Event("rectify", chain.setting, frames.grey, made, panels.corners_px))
        return made

    def features(chain, frames, panels, patches, original=Chain.features):
        made = original(chain, frames, panels, patches)
        log.append(Event("features", chain.setting, patches, made, panels.corners_px))
        return made

    def classify(chain, measured, threshold, original=Chain.classify):
        log.append(Event("classify", chain.setting, measured, threshold))
        return original(chain, measured, threshold)

    def read(host, device, original=times_module.read):
        log.append(Event("read", given=host.grey))
        return original(host, device)

    def numbered(calls, repeats, device, *, warm_up, primed):
        assert primed
        timing = {}
        for name, call in calls.items():
            log.clear()
            call()
            number = next(numbers)
            calls_made[number] = tuple(log)
            timing[name] = Timing((float(number),) * repeats)
        return timing

    with pytest.MonkeyPatch.context() as patch:
        for name, spy in (("rectify", rectify), ("features", features), ("classify", classify)):
            patch.setattr(Chain, name, spy)
        patch.setattr(times_module, "read", read)
        patch.setattr(times_module, "interleaved", numbered)
        return measure_times(study, receivers), calls_made


def timed(recorded, setting, batch):
    """What the calls did whose times a setting has, by stage."""
    times, calls = recorded
    rounds = times.spent[setting, Place("cpu", "crops", batch)].rounds_ms
    numbers = {stage: round(rounds[stage][0] * batch / 1e3) for stage in STAGES if stage != "preambles"}
    return {stage: calls[number] for stage, number in numbers.items() if number}


def patch_of(setting, batch):
    """Type and shape of a setting's rectified panels: the LEDs and a cell more on each side."""
    side = (LEDS + 2) * setting.samples_per_led
    return getattr(torch, setting.dtype), (batch, 1, side, side)


def kind(tensor):
    return tensor.dtype, tuple(tensor.shape)


@pytest.mark.parametrize("batch", BATCHES)
def test_each_stage_is_the_settings_own(study, recorded, batch):
    assert len(study.settings) == 3 * (5 + 3 + 2)
    for setting in study.settings:
        stages = timed(recorded, setting, batch)
        one_each = {stage: [event.stage for event in events] for stage, events in stages.items()}
        assert one_each == {stage: [stage] for stage in stages}, setting
        absent = {"locate"} if setting.locator == "truth" else set()
        absent |= {"rectify"} if setting.receiver == "center_greyscale" else set()
        assert set(STAGES) - set(stages) == absent | {"preambles"}, setting
        (read,), (measured,), (decided,) = stages["read"], stages["features"], stages["classify"]
        assert (read.given.dtype, len(read.given)) == (torch.uint8, batch)
        assert measured.setting == decided.setting == setting
        if "locate" in stages:
            (located,) = stages["locate"]
            assert (located.locator, len(located.given)) == (setting.locator, batch)
        # What is decided on is what this receiver has measured, on the same batch.
        assert torch.equal(decided.given, measured.made)
        assert len(decided.given) == batch
        greyscale = setting.receiver in ("center_greyscale", "average_greyscale")
        assert (decided.made is not None) == greyscale, setting
        if "rectify" in stages:
            (rectified,) = stages["rectify"]
            assert kind(rectified.made) == kind(measured.given) == patch_of(setting, batch), setting
            assert torch.equal(rectified.made, measured.given)
        else:
            assert measured.given is None


def test_corners_are_those_of_the_settings_locator(study, recorded):
    corners = {}
    for setting in study.settings:
        stages = timed(recorded, setting, 24)
        for event in (*stages.get("rectify", ()), *stages["features"]):
            first = corners.setdefault(setting.locator, event.corners)
            assert torch.equal(first, event.corners), setting
    for a, b in itertools.combinations(LOCATORS, 2):
        assert not torch.equal(corners[a], corners[b])


@pytest.mark.parametrize("batch", BATCHES)
def test_in_one_go_a_receiver_does_all_of_its_stages_once(study, recorded, batch):
    times, calls = recorded
    assert times.in_one_go == "flda_3"
    wholes = [one for one in calls.values() if len(one) > 1 and len(one[0].given) == batch]
    settings = [next(event.setting for event in one if event.setting) for one in wholes]
    assert settings == [Setting("flda_3", name, 8, "sobel", "float32") for name in LOCATORS]
    for setting, events in zip(settings, wholes, strict=True):
        wanted = ["read", "locate", "rectify", "features", "classify"]
        if setting.locator == "truth":
            wanted.remove("locate")
        assert [event.stage for event in events] == wanted
        assert {event.setting for event in events if event.setting} == {setting}
        assert [event.locator for event in events if event.locator] == [
            name for name in (setting.locator,) if name != "truth"
        ]
        (patches,) = (event.made for event in events if event.stage == "rectify")
        assert kind(patches) == patch_of(setting, batch)


def test_settings_that_differ_in_anything_have_times_of_their_own(study, recorded):
    """No two settings share what they measure and decide; patches are shared by all who cut the same ones."""
    times, _ = recorded
    place = Place("cpu", "crops", 24)
    for stage, of in (
        ("features", lambda one: one),
        ("classify", lambda one: one),
        ("rectify", lambda one: (one.locator, one.samples_per_led, one.dtype)),
    ):
        numbers = {}
        for setting in study.settings:
            if (stage, setting.receiver) != ("rectify", "center_greyscale"):
                numbers.setdefault(of(setting), set()).add(times.spent[setting, place].rounds_ms[stage])
        assert all(len(one) == 1 for one in numbers.values())
        assert len(set.union(*numbers.values())) == len(numbers)
