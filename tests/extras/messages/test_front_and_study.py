"""Following the panel, greys of a film, and what a study of messages counts."""

from dataclasses import astuple

import numpy as np
import pytest
import torch

from vocc_torch.extras.messages.comparison import Carried, Place, counted, rows_of
from vocc_torch.extras.messages.front import Front
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.receiver.locators import RefinedLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.rng import BlockKey
from vocc_torch.simulation.recording import Shutter, record
from vocc_torch.simulation.simulator import Simulator
from vocc_torch.types import Scene

FILM = np.random.default_rng(5).integers(2, size=(30, 8, 8)).astype(bool)


@pytest.fixture(scope="module")
def receiver(trained):
    return Receiver("flda_3", RefinedLocator(), Reader(), trained)


def frames_of(speed_m_s):
    """Greys, and the symbol of each."""
    scene, key = Scene.of(distance_m=45.0, offset_x_m=4.0), BlockKey(0, "front", 0)
    shutter = Shutter(200.0, 0.0025)
    parts = record(
        Simulator(),
        scene,
        torch.from_numpy(FILM),
        0.01,
        shutter,
        key,
        speed_m_s=speed_m_s,
        window=1.5,
    )
    taken = [([*part.frames.grey[:, 0].numpy()], part.symbols) for part in parts]
    return [grey for greys, _ in taken for grey in greys], [
        n for _, symbols in taken for n in symbols
    ]


@pytest.mark.parametrize(("speed_m_s", "moves"), [(0.0, False), (-60.0, True)])
def test_a_panel_that_moves_is_followed_and_one_that_stands_is_not(
    receiver, speed_m_s, moves
):
    greys, symbols = frames_of(speed_m_s)
    wrong = {}
    for follow in ("auto", "false"):
        front = Front(receiver, follow=follow)
        read = np.concatenate([front(greys[:40]), front(greys[40:])])
        wrong[follow] = ((read >= 0) != FILM[symbols])[40:].mean()
        assert front.follows == (moves and follow == "auto")
    assert wrong["auto"] < 0.01
    assert (wrong["false"] > 0.05) == moves


def test_a_recording_is_read_from_the_first_frame_that_shows_the_panel(receiver):
    greys, front = frames_of(0.0)[0][:20], Front(receiver)
    read = front([np.zeros_like(grey) for grey in greys[:13]] + greys[13:])
    assert not read[:13].any()
    assert read[13:].all()


def test_packets_are_counted_by_recording():
    """Recordings are lost as a whole: fewer than 24 packets' worth of knowledge."""
    counts = [counted(lost, 4) for lost in (0, 4, 4, 1, 0, 0)]
    place = Place("distance_m", 40.0, "flda_3", "none")
    parts = [Carried(each, each, each.frame_errors, 9, 3.2) for each in counts]
    (row,) = rows_of({place: parts})
    loss = ber_interval(Counts(6, 24, 18, 132, 3))
    ends = ("packet_error_rate", "packet_error_low", "packet_error_high")
    counted_cells = {"recordings": 6, "packets": 24, "lost": 9, "frames": 54}
    cells = counted_cells | {"false_packets": 3, "raw_ber": loss, "best": 1}
    assert row | cells | dict(zip(ends, astuple(loss), strict=True)) == row
    assert loss.high - loss.low > 0.5
    assert row["kbit_s"].value == pytest.approx(3.2 * (1 - 9 / 24))
    assert row["kbit_s"].high == pytest.approx(3.2 * (1 - loss.low))
