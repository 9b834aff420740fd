"""Frames of a film by a camera that is not synchronised: what each row of each frame saw."""

import numpy as np
import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.hardware import Camera
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.recording import Shutter, further_films, record
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


def test_leds_of_a_further_colour_play_a_film_of_their_own():
    """Amid symbols and across their edges a frame's light is that of both films, each in its colour."""
    camera, shutter = (
        Camera(exposure_time_s=0.004, gamma=1.0),
        Shutter(130.0, 0.003, readout_s=0.02),
    )

    def light(film, **colour):
        simulator = Simulator(
            camera, effects=LINEAR | {"colour": colour}, dtype=torch.float64
        )
        parts = taken(shutter, simulator, film, batch=3)
        return torch.cat([part.frames.colour for part in parts]), further_films(
            simulator, film, KEY
        )

    both, more = light(FILM, peak_nm=630, second_nm=470)
    assert 0.4 < float((more[".second"] ^ FILM).float().mean()) < 0.6
    red, blue = light(FILM, peak_nm=630)[0], light(more[".second"], peak_nm=470)[0]
    none = light(torch.zeros_like(FILM))[0]
    torch.testing.assert_close(both, red + blue - none)


def test_rows_below_the_edge_show_the_next_symbol():
    lit = torch.stack([torch.ones(8, 8), torch.zeros(8, 8)]).bool()
    camera = Camera(exposure_time_s=1e-6)
    part = taken(Shutter(1e4, 0.01, readout_s=0.1), Simulator(camera), lit)[0]
    greys = part.frames.grey[0, 0].float().amax(dim=1)
    panel = greys[greys.shape[0] // 4 : -greys.shape[0] // 4]
    top, bottom = panel[: len(panel) // 2 - 3], panel[len(panel) // 2 + 3 :]
    assert top.max() > 150
    assert bottom.max() < top.max() - 30


def test_drops_repeats_and_black_frames_are_told_and_batches_change_nothing():
    shutter = Shutter(700.0, 0.001, dropped=0.1, repeated=0.1, black=0.1)
    one, many = taken(shutter), taken(shutter, batch=7)
    grey = torch.cat([part.frames.grey for part in many])
    assert torch.equal(one[0].frames.grey, grey)
    dark = [symbol is None for symbol in one[0].symbols]
    assert 0 < sum(dark) < 12
    assert ((grey == 0).flatten(1).all(dim=1).numpy() == dark).all()
    assert np.isnan(one[0].taken_s[dark]).all()
    again = np.flatnonzero(np.diff(one[0].taken_s) == 0)
    assert len(again)
    assert all(torch.equal(grey[i], grey[i + 1]) for i in again)
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


def test_a_panel_that_moves_keeps_its_truth():
    far = list(
        record(Simulator(), SCENE, FILM, 0.01, Shutter(200.0), KEY, speed_m_s=-100.0)
    )
    corners = far[0].panels.corners_px
    width = corners[:, 1, 0] - corners[:, 0, 0]
    assert torch.allclose(
        width * (40.0 - 100.0 * torch.from_numpy(far[0].taken_s)), width[0] * 40.0
    )
    with pytest.raises(VoccError, match="distance_m"):
        list(
            record(
                Simulator(), SCENE, FILM, 0.01, Shutter(200.0), KEY, speed_m_s=-1000.0
            )
        )
