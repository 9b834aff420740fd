"""Each time is that of the stage, the receiver and the batch that it is told for."""

import itertools

import pytest
import torch

from vocc_torch.measure import link, stage_times, timing
from vocc_torch.measure.stage_times import STAGES, Exposure
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.receiver.classifiers import Inputs, PanelOtsu, Patch
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PaperLocator, RefinedLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import StagedReceiver
from vocc_torch.rng import FrameKey
from vocc_torch.simulation import Camera, Distribution, SceneModel
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import Frames, PanelShape

LOCATORS = {
    "paper": PaperLocator(),
    "refined": RefinedLocator(PaperLocator()),
    "truth": None,
}
SHAPE, BATCH = PanelShape(8, 8), 24
CPU = torch.device("cpu")
GREYSCALE = ("center_greyscale", "average_greyscale")


def receiver(locator, name, samples=8, dtype=torch.float32):
    flda = FLDA(3)
    flda.update(
        torch.rand(64, 3, generator=torch.Generator().manual_seed(0)),
        torch.arange(64) % 2,
    )
    otsu = Guarded("otsu", PanelOtsu(), Inputs((), Patch(1, 4, relative="white")))
    bank = ReceiverBank([name], flda, {"otsu": otsu})
    return StagedReceiver(bank, Reader(SHAPE, samples), LOCATORS[locator], dtype)


KINDS = [[name] for name in (*GREYSCALE, "flda_2", "flda_3", "otsu")]
KINDS += [["flda_3", 4], ["flda_3", 8, torch.float64]]
RECEIVERS = {
    (locator, *kind): receiver(locator, *kind) for locator in LOCATORS for kind in KINDS
}


@pytest.fixture(scope="module")
def recorded(make_plan):
    """Times that are the numbers of calls, and what each of these calls did, by number.

    On far panels in the middle of the paper's sensor.
    """
    given = {
        "ambient_lx": ("constant", (1000.0,)),
        "distance_m": ("uniform", (60.0, 70.0)),
    }
    scene = SceneModel(**{name: Distribution(*one) for name, one in given.items()})
    camera = Camera(width_px=480, height_px=272, sensor_width_mm=3.3)
    keys = link.block_keys(0, "timed", 64)
    exposure = Exposure.of(
        make_plan(scene=scene, camera=camera).world, scene, keys, preambles=True
    )
    log, made, numbers = [], {}, itertools.count(1)

    def spied(stage, original):
        def call(one, *given):
            ended = original(one, *given)
            log.append((stage, one, given, ended))
            return ended

        return call

    def numbered(calls, repeats, device, *, warm_up, primed):
        assert (warm_up, primed) == (1, True)
        timed = {}
        for name, call in calls.items():
            log.clear()
            call()
            number = next(numbers)
            made[number] = tuple(log)
            timed[name] = timing.Timing((float(number),) * repeats)
        return timed

    with pytest.MonkeyPatch.context() as patch:
        for stage in ("locate", "rectify", "measure", "decide"):
            patch.setattr(
                StagedReceiver, stage, spied(stage, getattr(StagedReceiver, stage))
            )
        patch.setattr(stage_times.timing, "interleaved", numbered)
        named = {str(key): one for key, one in RECEIVERS.items()}
        wholes = [str((locator, "flda_3")) for locator in LOCATORS]
        options = {"frames_a_preamble": 5, "in_one_go": wholes}
        return stage_times.time_stages(named, exposure, BATCH, 2, CPU, **options), made


def test_each_stage_is_the_receivers_own_on_one_batch(recorded):
    times, made = recorded
    corners = {}
    for key, one in RECEIVERS.items():
        rounds = times.by_receiver[str(key)].rounds_ms
        numbers = {
            stage: round(rounds[stage][0] * BATCH / 1e3)
            for stage in STAGES
            if stage != "preambles"
        }
        did = {stage: made[number] for stage, number in numbers.items() if number}
        absent = {"locate"} if one.locator is None else set()
        absent |= {"rectify"} if key[1] == "center_greyscale" else set()
        assert set(STAGES) - set(did) == absent | {"preambles"}, key
        ((_, own, (frames, panels, patches), readings),) = did["features"]
        assert (own.bank.names, own.reader, own.dtype) == (
            one.bank.names,
            one.reader,
            one.dtype,
        )
        assert own.locator == one.locator
        assert (frames.grey.dtype, len(frames)) == (torch.uint8, BATCH)
        assert torch.equal(
            corners.setdefault(one.locator, panels.corners_px), panels.corners_px
        )
        if "rectify" in did:
            side = (8 + 2) * one.reader.samples_per_led
            assert (patches.dtype, patches.shape) == (one.dtype, (BATCH, 1, side, side))
            assert torch.equal(did["rectify"][0][-1], patches)
        if "locate" in did:
            assert did["locate"][0][1].locator == one.locator
        # What is decided on is what this receiver has measured, on the same batch.
        ((_, own, decided, _),) = did["classify"]
        assert own.bank.names == one.bank.names
        assert torch.equal(decided[0].features, readings.features)
        assert (decided[1] is not None) == (key[1] in GREYSCALE)
        # Two frames of known bits, each read and measured, for every five of data.
        one_more = rounds["read"][0] + rounds["rectify"][0] + rounds["features"][0]
        assert rounds["preambles"][0] == pytest.approx(
            2 / 5 * one_more * (key[1] in GREYSCALE)
        )
    for a, b in itertools.combinations(corners.values(), 2):
        assert not torch.equal(a, b)


def test_stages_are_shared_by_all_that_begin_alike_and_by_no_others(recorded):
    by_receiver = recorded[0].by_receiver
    for stage, of in (
        ("features", lambda key, one: key),
        ("classify", lambda key, one: key),
        ("locate", lambda key, one: one.locator),
        (
            "rectify",
            lambda key, one: (one.locator, one.reader.samples_per_led, one.dtype),
        ),
    ):
        numbers = {}
        for key, one in RECEIVERS.items():
            if (rounds := by_receiver[str(key)].rounds_ms[stage])[0]:
                numbers.setdefault(of(key, one), set()).add(rounds)
        assert all(len(one) == 1 for one in numbers.values())
        assert len(set.union(*numbers.values())) == len(numbers)


def test_in_one_go_a_receiver_does_all_of_its_stages_once(recorded):
    wholes = [did for did in recorded[1].values() if len(did) > 1]
    for locator, did in zip(LOCATORS.values(), wholes, strict=True):
        located = ["locate"] if locator else []
        assert [stage for stage, *_ in did] == [
            *located,
            "rectify",
            "measure",
            "decide",
        ]
        assert {(*one.bank.names, one.locator) for _, one, *_ in did} == {
            ("flda_3", locator)
        }


def test_preambles_have_noise_of_their_own(make_plan):
    noise = {
        "read_noise": {"electrons": 30.0},
        "photoelectrons": {"quantum_efficiency": 0.6},
        "gain": {},
    }
    camera = Camera(width_px=96, height_px=64, sensor_width_mm=0.66)
    fixed = {"offset_x_m": 0.0, "offset_y_m": 0.0, "distance_m": 60.0}
    model = SceneModel(
        **{name: Distribution("constant", (value,)) for name, value in fixed.items()}
    )
    world = make_plan(
        camera=camera, scene=model, effects={**PAPER_EFFECTS, **noise}
    ).world
    (key,) = keys = link.block_keys(0, "noise", 64)
    seen = Exposure.of(world, model, keys, preambles=True)
    scene, bits = model.draw(key, SHAPE)

    def again(sent, take):
        own = [
            FrameKey(key, frame, take) if take else FrameKey(key, frame)
            for frame in range(64)
        ]
        return (
            world.simulator()
            .render(scene, sent, nearest_m=model.nearest_m, keys=own)
            .grey
        )

    assert torch.equal(again(bits, ""), seen.frames.grey)
    assert torch.equal(again(torch.ones_like(bits), "on"), seen.preambles[0].grey)
    assert not torch.equal(again(torch.ones_like(bits), ""), seen.preambles[0].grey)


@pytest.mark.parametrize("count", [1, 3])
def test_reading_gives_the_very_frames(count):
    grey = torch.arange(count * 12, dtype=torch.uint8).view(count, 1, 3, 4)
    frames = stage_times.read(
        Frames(grey, torch.zeros(count, 2).long(), (3, 4), torch.zeros(count)), CPU
    )
    assert torch.equal(frames.grey, grey)
    # A batch is put together from single frames, which costs a copy.
    assert (frames.grey.data_ptr() == grey.data_ptr()) == (count == 1)


def test_threads_are_put_back_and_scikit_learn_has_as_many():
    # Imported first: its threads are limited where it is in use.
    pytest.importorskip("sklearn.ensemble")
    pools = pytest.importorskip("threadpoolctl")

    def counts():
        pooled = [
            pool["num_threads"]
            for pool in pools.threadpool_info()
            if pool["user_api"] == "openmp"
        ]
        return torch.get_num_threads(), pooled

    before = counts()
    with timing.threads(3):
        assert counts()[0] == 3
        assert set(counts()[1]) == {3}
    assert counts() == before
