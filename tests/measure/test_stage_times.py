"""Each time is that of the stage, the receiver and the batch that it is told for."""

import itertools
from functools import partial

import pytest
import torch

from vocc_torch.measure import link, stage_times
from vocc_torch.measure.stage_times import STAGES, Exposure, TimedReceiver
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
    chain = stage_times.chain

    def spied(name, one, device):
        def call(stage, run, batch):
            ended = run(batch)
            log.append((stage, one, batch, ended))
            return ended

        return {
            stage: (key, partial(call, stage, run))
            for stage, (key, run) in chain(name, one, device).items()
        }

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
        patch.setattr(stage_times, "chain", spied)
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
        ((_, own, batch, readings),) = did["features"]
        assert own == one
        frames, panels = batch["read",], batch["locate", one.locator]
        assert (frames.grey.dtype, len(frames)) == (torch.uint8, BATCH)
        assert torch.equal(
            corners.setdefault(one.locator, panels.corners_px), panels.corners_px
        )
        if "rectify" in did:
            samples = one.reader.samples_per_led
            patches = did["rectify"][0][-1]
            side = (8 + 2) * samples
            assert (patches.dtype, patches.shape) == (
                torch.float32,
                (BATCH, 1, side, side),
            )
            assert torch.equal(batch["rectify", one.locator, samples], patches)
        if "locate" in did:
            assert torch.equal(did["locate"][0][-1].corners_px, panels.corners_px)
        # What is decided on is what this receiver has measured, on the same batch.
        ((_, own, decided, bits),) = did["classify"]
        assert own == one
        measured = decided["features", str(key)]
        assert torch.equal(measured.features, readings.features)
        lit = decided.get(("preambles", str(key)))
        assert (lit is not None) == (key[1] in GREYSCALE)
        assert torch.equal(bits, one.decider.score(measured, lit) >= 0)
        # Two frames of known bits are read and measured for each.
        one_more = rounds["read"][0] + rounds["rectify"][0] + rounds["features"][0]
        assert rounds["preambles"][0] == pytest.approx(
            2 * one_more * (key[1] in GREYSCALE)
        )
    for a, b in itertools.combinations(corners.values(), 2):
        assert not torch.equal(a, b)
