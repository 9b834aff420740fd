"""A price list with numbers that are easy to check."""

from types import SimpleNamespace

import numpy as np

from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.measure.plan import World
from vocc_torch.measure.stage_times import STAGES, StageTimes
from vocc_torch.measure.train import Making
from vocc_torch.studies.compare.prices import Errors, Place, PriceList, Times
from vocc_torch.studies.compare.settings import Setting

LEDS = 64
FRAMES = 1000
BASE = {"samples_per_led": 8, "gradient": "sobel", "dtype": "float32"}
SETTINGS = (
    Setting("average_greyscale", "paper", **BASE),
    Setting("flda_3", "paper", **BASE),
    Setting("mlp", "paper", **BASE),
    Setting("average_greyscale", "refined", **BASE),
    Setting("flda_3", "refined", **BASE),
    Setting("mlp", "refined", **BASE),
    Setting("flda_3", "paper", 4, "sobel", "float32"),
    Setting("flda_3", "paper", 8, "central", "float64"),
)
BIT_ERRORS = (900, 300, 200, 400, 40, 0, 310, 300)
"""Wrong bits in all frames, one a frame."""

ALONE_MS = (3.0, 4.0, 4.5, 9.0, 10.5, 11.5, 3.9, 6.0)
"""Time of a single whole frame; in batches half of it, and of crops a tenth."""

PLACES = tuple(
    Place("cpu", frames, batch) for frames in ("whole", "crops") for batch in (1, 32)
)


def spent(total_ms, rounds=5):
    """Times about a median, two thirds of them for locating; reading takes nothing."""
    steps = 1 + 0.02 * (np.arange(rounds) - rounds // 2)
    shares = {
        "read": 0.0,
        "locate": 2 / 3,
        "rectify": 0.1,
        "features": 0.15,
        "classify": 0.25 / 3,
    }
    return StageTimes(
        {
            stage: tuple((shares.get(stage, 0.0) * total_ms * steps).tolist())
            for stage in STAGES
        }
    )


def errors(wrong=BIT_ERRORS, frames=FRAMES):
    """One wrong bit a frame in the first frames: what the better ones get wrong, the others do too."""
    half = np.zeros((len(wrong), frames), dtype=np.int64)
    for row, count in enumerate(wrong):
        half[row, :count] = 2
    return FrameErrors(half, np.ones_like(half, dtype=bool), LEDS)


def times_of(settings=SETTINGS, alone_ms=ALONE_MS):
    """Times of each at every place."""
    factor = {
        ("whole", 1): 1.0,
        ("whole", 32): 0.5,
        ("crops", 1): 0.5,
        ("crops", 32): 0.1,
    }
    return {
        (one, place): spent(ms * factor[place.frames, place.batch])
        for one, ms in zip(settings, alone_ms, strict=True)
        for place in PLACES
    }


def made_up_prices(settings=SETTINGS, wrong=BIT_ERRORS, alone_ms=ALONE_MS, further=()):
    """Give the list; ``further`` has the wrong bits after further trainings."""
    study = SimpleNamespace(
        settings=settings,
        scene_name="paper",
        plan=SimpleNamespace(world=World(device="cpu")),
        config=SimpleNamespace(frames_a_preamble=1),
        missing={"cuda": "no such device"},
        left_out={},
    )
    times = Times(
        times_of(settings, alone_ms),
        dict.fromkeys(PLACES, 1.03),
        "flda_3",
        {"cpu": "a machine with 2 cores, 1 thread, torch 2"},
        threads=1,
        waited_share=0.0,
        crop_px=(89, 89),
    )
    trained = [wrong, *further]
    far = [tuple(min(FRAMES, 2 * n) for n in bits) for bits in trained]
    return PriceList(
        study,
        dict.fromkeys(settings, Making(1.5, 1.0, 1000, 80, 1700)),
        {
            "mixture": Errors([errors(bits) for bits in trained]),
            "far": Errors([errors(bits) for bits in far]),
        },
        times,
    )
