"""Following the panel, greys of a film, and what a study of messages counts."""

from dataclasses import replace

import av
import numpy as np
import pytest
import torch

from vocc_torch.extras.messages.codes import code_of
from vocc_torch.extras.messages.combine import Block
from vocc_torch.extras.messages.comparison import (
    Carried,
    SweepPoint,
    Variant,
    counted,
    pairs,
)
from vocc_torch.extras.messages.comparison_task import reach
from vocc_torch.extras.messages.front import Front
from vocc_torch.extras.messages.layout import Layout
from vocc_torch.extras.messages.packets import packed
from vocc_torch.extras.messages.reception import decoded
from vocc_torch.extras.messages.signalling import MessagePlan, Signalling
from vocc_torch.hardware import PanelShape
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.intervals import ber_interval
from vocc_torch.receiver.locators import PanelLocator, RefinedLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.recordings.films import read_film
from vocc_torch.report.video import write_video
from vocc_torch.rng import BlockKey
from vocc_torch.simulation.recording import Shutter, record
from vocc_torch.simulation.simulator import Simulator
from vocc_torch.types import Candidates, Frames, Panels, Scene


class Looking(PanelLocator):
    """A locator that is a function of frames and a shape."""

    name = "looking"

    def __init__(self, look):
        self.look = look

    def __call__(self, frames, shape):
        return self.look(frames, shape)

    def locate(self, frames, shape):
        return Candidates.of_panels(self(frames, shape))


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
    both = [([*part.frames.grey[:, 0].numpy()], part.symbols) for part in parts]
    return [grey for greys, _ in both for grey in greys], [
        n for _, symbols in both for n in symbols
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
        assert (front.tracker is not None) == (moves and follow == "auto")
    assert wrong["auto"] < 0.01
    assert (wrong["false"] > 0.05) == moves


@pytest.mark.parametrize("astray", [0, 8])
def test_a_single_look_that_errs_is_no_motion(trained, astray):
    """Of the first five looks, one in each eighth frame, the first, or the last, is a cell off."""

    def erring(frames, shape):
        panels = RefinedLocator()(frames, shape)
        if len(frames) == 9:  # of forty frames the first five, and 8, 16, 24 and 32
            panels.corners_px[astray] += (
                panels.corners_px[0, 1] - panels.corners_px[0, 0]
            ) / 8
        return panels

    front = Front(Receiver("flda_3", Looking(erring), Reader(), trained))
    front(frames_of(0.0)[0][:40])
    assert (front.looked, front.tracker) == (9, None)


def test_a_panel_that_stands_is_looked_for_where_it_was_and_found_again_where_it_jumps_to(
    trained,
):
    """The locator errs by a third of a cell to the right; the panel jumps 30 px to the left in frame 150."""
    searched = []

    def searching(frames, shape):
        searched.append(len(frames))
        panels = RefinedLocator()(frames, shape)
        panels.corners_px[..., 0] += (
            (panels.corners_px[:, 1, :1] - panels.corners_px[:, 0, :1]) / 8 / 3
        )
        return panels

    greys, symbols = (3 * part for part in frames_of(0.0))
    pads = [((0, 0), (30, 0) if n < 150 else (0, 30)) for n in range(len(greys))]
    greys = [np.pad(grey, pad, "edge") for grey, pad in zip(greys, pads, strict=True)]
    true = RefinedLocator()(
        Frames.whole(torch.from_numpy(greys[0])), PanelShape(8, 8)
    ).corners_px[0]
    front, wrong = Front(Receiver("flda_3", Looking(searching), Reader(), trained)), []
    for at in range(0, 180, 20):
        wrong += [*((front(greys[at : at + 20]) >= 0) != FILM[symbols[at : at + 20]])]
        if at < 130:
            assert float((front.corners_px - true).abs().max()) < 0.3
    assert not np.any(wrong[:150])
    assert np.mean(wrong[150:]) > 0.05  # up to the middle of five places
    assert float((front.corners_px - true).abs().max()) == pytest.approx(30, abs=0.3)
    assert sum(searched) < 12
    assert front.found == front.looked == 23 + 4


def test_a_recording_is_read_from_the_first_frame_that_shows_the_panel(receiver):
    greys, front = frames_of(0.0)[0][:20], Front(receiver)
    read = front([np.zeros_like(grey) for grey in greys[:13]] + greys[13:])
    assert not read[:13].any()
    assert read[13:].all()


def test_a_window_is_read_as_the_whole_frame_is(receiver):
    greys, _ = frames_of(0.0)
    large = [
        np.pad(grey, ((300, 90), (11, 400)), constant_values=int(grey[0, 0]))
        for grey in greys[:6]
    ]
    front = Front(receiver)
    frames, corners = front.locate(large)
    assert frames.grey[0].numel() < large[0].size / 4
    whole, known = (
        Frames.whole(torch.from_numpy(np.stack(large))),
        Panels.known(corners),
    )
    with torch.inference_mode():
        expected = receiver.forward(whole, known).scores
        found, there = front.read(frames, corners)
    assert there.all()
    torch.testing.assert_close(found.scores, expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("width", "height"), [(64, 48), (38, 26)])
def test_greys_of_a_film_are_those_that_ffmpeg_gives(tmp_path, width, height):
    """Widths that no line of memory fits, and every grey."""
    draws = np.random.default_rng(0)
    write_video(
        tmp_path / "a.mp4",
        list(draws.integers(256, size=(5, height, width), dtype=np.uint8)),
        25.0,
    )
    with av.open(str(tmp_path / "a.mp4")) as container:
        expected = [
            frame.to_ndarray(format="gray") for frame in container.decode(video=0)
        ]
    read = [one.grey for one in read_film(tmp_path / "a.mp4", "luma", grey_only=True)]
    assert len(read) == 5
    assert (np.stack(read) == np.stack(expected)).all()
    assert (read[2][5:19, 3:30] == expected[2][5:19, 3:30]).all()
    assert np.stack(read).min() < 5
    assert np.stack(read).max() > 250


@pytest.mark.parametrize("interleave", [True, False])
@pytest.mark.parametrize("code", ["rs", "none"])
def test_any_film_is_that_of_any_code(code, interleave):
    plan = MessagePlan(PanelShape(8, 8), Signalling(code=code, interleave=interleave))
    layout, draws = Layout(plan), np.random.default_rng(1)
    coder, shown = (
        code_of(layout),
        Layout(MessagePlan(PanelShape(8, 8), Signalling(code="none"))).known > 0,
    )
    shown |= (draws.random(shown.shape) < 0.5) & (layout.kind == "data")
    text = draws.bytes(4 * (coder.info_bytes - 16))
    words = coder.encode(
        np.stack(
            [np.frombuffer(one, np.uint8) for one in packed(text, coder.info_bytes)]
        )
    )
    twin, sums = (
        layout.rescrambled(words, shown),
        np.where(shown, 4, -4).astype(np.float32),
    )
    block = Block(
        0, None, sums, np.ones((layout.symbols, layout.bands), dtype=np.int32)
    )
    got = [one.packet for one in decoded(block, twin, coder)]
    assert b"".join(one.payload for one in got) == text
    # The usual scrambling.
    assert all(one.packet is None for one in decoded(block, layout, coder))


def result(receiver, distance, each, code="ldpc-0.5", packets=4):
    lost = counted(each, packets)
    variant = Variant(receiver, "scores", True, code)
    return Carried(
        SweepPoint("distance_m", distance), variant, lost, lost, tuple(each), 3.2, 9, 0
    )


def test_packets_are_counted_by_recording_and_compared_on_the_same():
    each, others = [0, 4, 4, 1, 0, 0], [0, 4, 0, 1, 0, 1]
    a, b = result("a", 50.0, each), result("b", 50.0, others)
    total = sum((Counts(1, 4, 2 * n, 4 * n * n, int(n > 0)) for n in each), Counts())
    assert a.lost == total
    assert a.loss == ber_interval(total)
    # Recordings are lost as a whole: fewer than 24 packets' worth of knowledge.
    assert a.loss.high - a.loss.low > 0.5
    assert a.goodput.value == pytest.approx(3.2 * (1 - 9 / 24))
    assert a.goodput.high == pytest.approx(3.2 * (1 - a.loss.low))
    ((first, second, paired),) = pairs(
        [a, b, result("b", 60.0, each), result("c", 50.0, each, "none")]
    )
    assert (first, second) == (a, b)
    assert paired.difference == pytest.approx((9 - 6) / 24)
    assert (paired.a_worse, paired.b_worse) == (1, 1)


def test_how_far_a_message_carries_is_up_to_the_first_distance_at_which_every_code_loses_much():
    near, mid, far = (
        result("a", at, each)
        for at, each in ((30.0, [0, 0]), (50.0, [4, 4]), (70.0, [0, 0]))
    )
    assert reach([near, mid, far]) == "to 30 m"
    assert (
        reach([near, mid, replace(result("a", 50.0, [0, 0], "rs-0.7")), far])
        == "to 70 m"
    )
    assert reach([mid]) == "not to 50 m"
