"""Each time is that of the stage, the receiver and the batch that it is told for."""

import itertools

import pytest
import torch

from vocc_torch.measure import stage_times
from vocc_torch.measure.link import block_keys
from vocc_torch.measure.stage_times import STAGES, Exposure, read, time_stages
from vocc_torch.measure.timing import Timing, threads
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.receiver.classifiers import Inputs, PanelOtsu, Patch
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.receiver.locators import RefinedLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import StagedReceiver
from vocc_torch.rng import FrameKey
from vocc_torch.simulation import Camera, Distribution, SceneModel
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import Frames, PanelShape, Scene

LOCATORS = {"paper": PaperLocator(), "refined": RefinedLocator(PaperLocator()), "truth": None}
SHAPE, BATCH = PanelShape(8, 8), 24


def receiver(name, locator, samples=8, dtype=torch.float32):
    flda = FLDA(3)
    flda.update(torch.rand(64, 3, generator=torch.Generator().manual_seed(0)), torch.arange(64) % 2)
    otsu = Guarded("otsu", PanelOtsu(), Inputs((), Patch(1, 4, relative="white")))
    return StagedReceiver(
        ReceiverBank([name], flda, {"otsu": otsu}), Reader(SHAPE, samples), LOCATORS[locator], dtype
    )


RECEIVERS = {
    (name, locator, *more): receiver(name, locator, *more)
    for locator in LOCATORS
    for name, *more in (
        *(["center_greyscale"], ["average_greyscale"], ["flda_2"], ["flda_3"], ["otsu"]),
        *(["flda_3", 4], ["flda_3", 8, torch.float64]),
    )
}


@pytest.fixture(scope="module")
def world(make_plan):
    """Far panels in the middle of the paper's sensor."""
    scene = SceneModel(
        ambient_lx=Distribution("constant", (1000.0,)), distance_m=Distribution("uniform", (60.0, 70.0))
    )
    camera = Camera(width_px=480, height_px=272, sensor_width_mm=3.3)
    return make_plan(scene=scene, camera=camera).world


@pytest.fixture(scope="module")
def recorded(world):
    """Times that are the numbers of calls, and what each of these calls did, by number."""
    exposure = Exposure.of(world, world.scene, block_keys(0, "timed", 64), preambles=True)
    log, made, numbers = [], {}, itertools.count(1)
    keys = {str(key): one for key, one in RECEIVERS.items()}

    def spied(stage, original):
        def call(one, *given):
            ended = original(one, *given)
            log.append(
                (stage, one.bank.names[0], one.reader.samples_per_led, one.dtype, one.locator, given, ended)
            )
            return ended

        return call

    def numbered(calls, repeats, device, *, warm_up, primed):
        assert (warm_up, primed) == (1, True)
        timing = {}
        for name, call in calls.items():
            log.clear()
            call()
            number = next(numbers)
            made[number] = tuple(log)
            timing[name] = Timing((float(number),) * repeats)
        return timing

    with pytest.MonkeyPatch.context() as patch:
        for stage in ("locate", "rectify", "measure", "decide"):
            patch.setattr(StagedReceiver, stage, spied(stage, getattr(StagedReceiver, stage)))
        patch.setattr(stage_times, "interleaved", numbered)
        wholes = [str(("flda_3", locator)) for locator in LOCATORS]
        times = time_stages(
            keys, exposure, BATCH, 2, torch.device("cpu"), frames_a_preamble=5, in_one_go=wholes
        )
    return times, made


def test_each_stage_is_the_receivers_own_on_one_batch(recorded):
    times, made = recorded
    corners = {}
    for key, one in RECEIVERS.items():
        rounds = times.by_receiver[str(key)].rounds_ms
        numbers = {stage: round(rounds[stage][0] * BATCH / 1e3) for stage in STAGES if stage != "preambles"}
        did = {stage: made[number] for stage, number in numbers.items() if number}
        absent = {"locate"} if one.locator is None else set()
        absent |= {"rectify"} if key[0] == "center_greyscale" else set()
        assert set(STAGES) - set(did) == absent | {"preambles"}, key
        ((_, name, samples, dtype, locator, given, readings),) = did["features"]
        assert (name, samples, dtype, locator) == (key[0], one.reader.samples_per_led, one.dtype, one.locator)
        frames, panels, patches = given
        assert (frames.grey.dtype, len(frames)) == (torch.uint8, BATCH)
        assert torch.equal(corners.setdefault(one.locator, panels.corners_px), panels.corners_px)
        if "rectify" in did:
            side = (8 + 2) * samples
            assert (patches.dtype, patches.shape) == (dtype, (BATCH, 1, side, side))
            assert torch.equal(did["rectify"][0][-1], patches)
        if "locate" in did:
            assert did["locate"][0][4] == one.locator
        # What is decided on is what this receiver has measured, on the same batch.
        ((_, name, *_, decided, _),) = did["classify"]
        assert name == key[0]
        assert torch.equal(decided[0].features, readings.features)
        greyscale = key[0] in ("center_greyscale", "average_greyscale")
        assert (decided[1] is not None) == greyscale
        # Two frames of known bits, each read and measured, for every five of data.
        one_more = rounds["read"][0] + rounds["rectify"][0] + rounds["features"][0]
        assert rounds["preambles"][0] == pytest.approx(2 / 5 * one_more if greyscale else 0.0)
    for a, b in itertools.combinations(corners.values(), 2):
        assert not torch.equal(a, b)


def test_stages_are_shared_by_all_that_begin_alike_and_by_no_others(recorded):
    by_receiver = recorded[0].by_receiver
    for stage, of in (
        ("features", lambda key, one: key),
        ("classify", lambda key, one: key),
        ("locate", lambda key, one: one.locator),
        ("rectify", lambda key, one: (one.locator, one.reader.samples_per_led, one.dtype)),
    ):
        numbers = {}
        for key, one in RECEIVERS.items():
            if by_receiver[str(key)].rounds_ms[stage][0]:
                numbers.setdefault(of(key, one), set()).add(by_receiver[str(key)].rounds_ms[stage])
        assert all(len(one) == 1 for one in numbers.values())
        assert len(set.union(*numbers.values())) == len(numbers)


def test_in_one_go_a_receiver_does_all_of_its_stages_once(recorded):
    wholes = [did for did in recorded[1].values() if len(did) > 1]
    for locator, did in zip(LOCATORS, wholes, strict=True):
        assert [stage for stage, *_ in did] == [
            *(["locate"] if LOCATORS[locator] else []), "rectify", "measure", "decide"
        ]  # fmt: skip
        assert {(name, where) for _, name, _, _, where, *_ in did} == {("flda_3", LOCATORS[locator])}


def test_preambles_have_noise_of_their_own(make_plan):
    noise = {"read_noise": {"electrons": 30.0}, "photoelectrons": {"quantum_efficiency": 0.6}, "gain": {}}
    camera = Camera(width_px=96, height_px=64, sensor_width_mm=0.66)
    centred = {name: Distribution("constant", (0.0,)) for name in ("offset_x_m", "offset_y_m")}
    model = SceneModel(distance_m=Distribution("constant", (60.0,)), **centred)
    world = make_plan(camera=camera, scene=model, effects={**PAPER_EFFECTS, **noise}).world
    (key,) = keys = block_keys(0, "noise", 64)
    seen = Exposure.of(world, model, keys, preambles=True)
    scene, bits = model.draw(key, SHAPE)
    every = torch.ones_like(bits)
    names = [FrameKey(key, frame) for frame in range(64)]

    def again(sent, take):
        own = [FrameKey(key, frame, take) for frame in range(64)] if take else names
        return world.simulator().render(Scene.cat([scene]), sent, nearest_m=model.nearest_m, keys=own).grey

    assert torch.equal(again(bits, ""), seen.frames.grey)
    assert torch.equal(again(every, "on"), seen.preambles[0].grey)
    assert not torch.equal(again(every, ""), seen.preambles[0].grey)


@pytest.mark.parametrize("count", [1, 3])
def test_reading_gives_the_very_frames(count):
    grey = torch.arange(count * 12, dtype=torch.uint8).view(count, 1, 3, 4)
    frames = read(Frames(grey, torch.zeros(count, 2).long(), (3, 4), torch.zeros(count)), torch.device("cpu"))
    assert torch.equal(frames.grey, grey)
    # A batch is put together from single frames, which costs a copy.
    assert (frames.grey.data_ptr() == grey.data_ptr()) == (count == 1)


def test_threads_are_put_back_and_scikit_learn_has_as_many():
    # Imported first: its threads are limited where it is in use.
    pytest.importorskip("sklearn.ensemble")
    pools = pytest.importorskip("threadpoolctl")

    def counts():
        pooled = [pool["num_threads"] for pool in pools.threadpool_info() if pool["user_api"] == "openmp"]
        return torch.get_num_threads(), pooled

    before = counts()
    with threads(3):
        assert counts()[0] == 3
        assert set(counts()[1]) == {3}
    assert counts() == before
