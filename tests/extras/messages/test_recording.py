"""Frames of a film by a camera that is not synchronised: what each row of each frame saw."""

import numpy as np
import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.hardware import Camera
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.recording import Shutter, record
from vocc_torch.simulation.simulator import Simulator
from vocc_torch.types import Scene

KEY = BlockKey(0, "recording", 0)
FILM = torch.from_numpy(
    np.random.default_rng(0).integers(2, size=(6, 8, 8)).astype(bool)
)
SCENE = Scene.of(distance_m=40.0)
LINEAR = {"attenuation": {"visibility_m": 40000.0}}


def taken(shutter, simulator=None, film=FILM, symbol_s=0.01, **options):
    return list(
        record(simulator or Simulator(), SCENE, film, symbol_s, shutter, KEY, **options)
    )


def test_frames_amid_a_symbol_are_those_of_the_symbol_alone():
    (part,) = taken(Shutter(200.0, start_s=0.003))
    assert part.symbols == [n for n in range(6) for _ in (0, 1)]
    nearest = 40.0 / 1.5
    scenes, keys = SCENE[torch.zeros(12, dtype=torch.int64)], [FrameKey(KEY, 0)] * 12
    alone = Simulator().render(scenes, FILM[part.symbols], nearest_m=nearest, keys=keys)
    assert torch.equal(part.frames.grey, alone.grey)


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_an_exposure_that_catches_two_symbols_has_the_light_of_both_by_its_share(share):
    camera = Camera(exposure_time_s=0.004, gamma=1.0)
    simulator = Simulator(camera, effects=LINEAR, dtype=torch.float64)
    middle = 0.01 + 0.004 * (share - 0.5)  # so much of it lies behind the edge

    def grey(moment):
        return taken(Shutter(1e3, start_s=moment), simulator, FILM[:2])[0].frames.grey[
            0
        ]

    mixed, before, after = grey(middle), grey(0.005), grey(0.015)
    assert torch.allclose(mixed, (1 - share) * before + share * after, rtol=1e-6)
    assert not torch.allclose(before, after, rtol=0.01)


def test_drops_repeats_and_black_frames_are_told_and_batches_change_nothing():
    shutter = Shutter(700.0, 0.001, dropped=0.1, repeated=0.1, black=0.1)
    one, many = taken(shutter), taken(shutter, batch=7)
    grey = torch.cat([part.frames.grey for part in many])
    assert torch.equal(one[0].frames.grey, grey)
    dark = [symbol is None for symbol in one[0].symbols]
    assert 0 < sum(dark) < 12
    assert ((grey == 0).flatten(1).all(dim=1).numpy() == dark).all()
    assert np.isnan(one[0].taken_s[dark]).all()
    repeats = np.flatnonzero(np.diff(one[0].taken_s) == 0)
    assert len(repeats)
    assert all(torch.equal(grey[i], grey[i + 1]) for i in repeats)
    assert 30 < len(grey) < 42
    assert (np.diff(one[0].taken_s[~np.array(dark)]) >= 0).all()


@pytest.mark.parametrize(("dropped", "burst"), [(0.1, 30), (0.4, 5), (0.3, 1)])
def test_lost_frames_come_in_runs_and_their_share_is_what_was_asked_for(dropped, burst):
    shutter = Shutter(1.0, dropped=dropped, burst_frames=burst)
    lost = np.diff(shutter.taken_s(2e5, np.random.default_rng(1))) - 1
    runs = lost[lost > 0]
    assert runs.min() == burst
    # Runs that meet are longer: from the begin of one, each further frame is lost by the chance of a burst.
    begins = 1 - (1 - dropped) ** (1 / burst)
    mean = ((1 - begins) ** -burst - 1) / begins
    assert runs.mean() == pytest.approx(mean, rel=0.05)
    assert lost.sum() / 2e5 == pytest.approx(dropped, rel=0.05)
    with pytest.raises(VoccError, match="lose all of 9 frames"):
        Shutter(1.0, dropped=0.999, burst_frames=9000).taken_s(
            9.0, np.random.default_rng(1)
        )
