"""Each time is that of the stage, the receiver and the batch that it is told for."""

import itertools

import pytest
import torch

from vocc_torch.measure import link, stage_times
from vocc_torch.measure.stage_times import Exposure, TimedReceiver
from vocc_torch.receiver.classifiers import Inputs, PanelOtsu, Patch
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.deciders import bank_of
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PaperLocator, RefinedLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.simulation import Camera, Distribution, SceneModel
from vocc_torch.types import PanelShape

LOCATORS = {
    "paper": PaperLocator(),
    "refined": RefinedLocator(PaperLocator()),
    "truth": None,
}
SHAPE, BATCH = PanelShape(8, 8), 24
CPU = torch.device("cpu")
GREYSCALE = ("center_greyscale", "average_greyscale")


def receiver(locator, name, samples=8):
    flda = FLDA(3)
    flda.update(
        torch.rand(64, 3, generator=torch.Generator().manual_seed(0)),
        torch.arange(64) % 2,
    )
    otsu = Guarded("otsu", PanelOtsu(), Inputs((), Patch(1, 4, relative="white")))
    decider = bank_of([name], flda, {"otsu": otsu})[name]
    return TimedReceiver(decider, Reader(SHAPE, samples), LOCATORS[locator])


KINDS = [[name] for name in (*GREYSCALE, "flda_2", "flda_3", "otsu")]
KINDS += [["flda_3", 4]]
RECEIVERS = {
    (locator, *kind): receiver(locator, *kind) for locator in LOCATORS for kind in KINDS
}


def test_each_stage_is_the_receivers_own_on_one_batch(make_plan, monkeypatch):
    """Times are the numbers of calls, on far panels in the middle of the paper's sensor."""
    given = {
        "ambient_lx": ("constant", (1000.0,)),
        "distance_m": ("uniform", (60.0, 70.0)),
    }
    scene = SceneModel(**{name: Distribution(*one) for name, one in given.items()})
    camera = Camera(width_px=480, height_px=272, sensor_width_mm=3.3)
    world = make_plan(scene=scene, camera=camera).world
    keys = link.block_keys(0, "timed", 64)
    exposure = Exposure.of(world, scene, keys, preambles=True)
    log = [None]

    def numbered(device, call, *pairs):
        before, now = ([pair[part] for pair in pairs] for part in (0, 1))
        assert all(one is not two or one is None for one, two in pairs)
        log.append((call, now, result := call(*now)))
        return [call(*before), result], len(log) - 1

    monkeypatch.setattr(stage_times, "timed", numbered)
    times = stage_times.time_stages(RECEIVERS, exposure, BATCH, 2, CPU)
    corners = {}
    for key, one in RECEIVERS.items():
        rounds = {
            stage: ms[0] * BATCH / 1e3 for stage, ms in times[key].rounds_ms.items()
        }
        twice = rounds.pop("preambles")
        did = {stage: log[round(number)] for stage, number in rounds.items() if number}
        absent = {"locate"} if one.locator is None else set()
        absent |= {"rectify"} if key[1] == "center_greyscale" else set()
        assert set(rounds) - set(did) == absent, key
        frames = did["read"][2]
        assert (frames.grey.dtype, len(frames)) == (torch.uint8, BATCH)
        _, (measured, panels, patches), readings = did["features"]
        assert measured is frames
        seen = corners.setdefault(one.locator, panels.corners_px)
        assert seen is panels.corners_px
        if "locate" in did:
            assert did["locate"][1][0] is frames
            assert did["locate"][2] is panels
        if "rectify" in did:
            side = (8 + 2) * one.reader.samples_per_led
            assert did["rectify"][1] == [[frames], panels]
            assert did["rectify"][2][0] is patches
            size = BATCH, 1, side, side
            assert (patches.dtype, patches.shape) == (torch.float32, size)
        # What is decided on is what this receiver has measured, on the same batch.
        call, (decided, lit), bits = did["classify"]
        assert (call.args[0].name, decided) == (key[1], readings)
        assert (lit is not None) == (key[1] in GREYSCALE)
        assert torch.equal(bits, one.decider.score(readings, lit) >= 0)
        # Two frames of known bits are read and measured for each.
        measuring = sum(rounds[stage] for stage in ("read", "rectify", "features"))
        assert twice == pytest.approx(2 * measuring * (key[1] in GREYSCALE))
    for a, b in itertools.combinations(corners.values(), 2):
        assert not torch.equal(a, b)


def test_the_call_on_the_second_batch_is_timed(monkeypatch):
    """By a clock that the call itself moves on."""
    now = [0.0]
    monkeypatch.setattr(stage_times.time, "perf_counter", lambda: now[0])

    def call(spent, answer):
        now[0] += spent
        return answer

    found = stage_times.timed(CPU, call, (1.0, 10.0), ("before", "after"))
    assert found == (["before", "after"], 10.0)


def test_the_first_round_is_left_out(make_plan, monkeypatch):
    world = make_plan(camera=Camera(width_px=480, height_px=272)).world
    keys = link.block_keys(0, "timed", 64)
    exposure = Exposure.of(world, world.scene, keys, preambles=False)
    ticks = itertools.count()

    def numbered(device, call, *pairs):
        return [call(*part) for part in zip(*pairs, strict=True)], next(ticks)

    monkeypatch.setattr(stage_times, "timed", numbered)
    receivers = {"otsu": RECEIVERS["truth", "otsu"]}
    times = stage_times.time_stages(receivers, exposure, 8, 3, CPU)
    reads = times["otsu"].rounds_ms["read"] * 8 / 1e3
    assert reads.tolist() == [4, 8, 12]
