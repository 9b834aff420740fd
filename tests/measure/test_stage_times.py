"""Each time is that of the stage, the receiver and the batch that it is told for."""

import itertools

import pytest
import torch

from vocc_torch.measure import link, stage_times
from vocc_torch.measure.stage_times import STAGES, Exposure
from vocc_torch.receiver.bank import ReceiverBank
from vocc_torch.receiver.classifiers import Inputs, PanelOtsu, Patch
from vocc_torch.receiver.classifiers.protocol import Guarded
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import PaperLocator, RefinedLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import StagedReceiver
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
            timed[name] = (float(number),) * repeats
        return timed

    with pytest.MonkeyPatch.context() as patch:
        for stage in ("locate", "rectify", "measure", "decide"):
            patch.setattr(
                StagedReceiver, stage, spied(stage, getattr(StagedReceiver, stage))
            )
        patch.setattr(stage_times.timing, "interleaved", numbered)
        named = {str(key): one for key, one in RECEIVERS.items()}
        return stage_times.time_stages(named, exposure, BATCH, 2, CPU), made


def test_each_stage_is_the_receivers_own_on_one_batch(recorded):
    times, made = recorded
    corners = {}
    for key, one in RECEIVERS.items():
        rounds = times[str(key)].rounds_ms
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
        # Two frames of known bits are read and measured for each.
        one_more = rounds["read"][0] + rounds["rectify"][0] + rounds["features"][0]
        assert rounds["preambles"][0] == pytest.approx(
            2 * one_more * (key[1] in GREYSCALE)
        )
    for a, b in itertools.combinations(corners.values(), 2):
        assert not torch.equal(a, b)
