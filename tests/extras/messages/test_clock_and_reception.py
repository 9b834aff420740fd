"""The symbol clock over ratios, drift and phase; and messages through cut, faulty and occluded recordings."""

import numpy as np
import pytest
from channels import parts, seen

from vocc_torch.extras.messages.clock import SymbolClock
from vocc_torch.extras.messages.layout import Layout
from vocc_torch.extras.messages.packets import messages_of
from vocc_torch.extras.messages.reception import film_of, judged
from vocc_torch.extras.messages.reception import received as receive
from vocc_torch.extras.messages.signalling import MessagePlan, Signalling
from vocc_torch.hardware import PanelShape

PLAN = MessagePlan(PanelShape(8, 8), Signalling())
MESSAGE = np.random.default_rng(16).bytes(1000)
FILM = film_of(MESSAGE, PLAN)


def slowly(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


RATIOS = [
    slowly(ratio, drift, True)
    for ratio in (1.7, 2.0, 3.0, 4.0, 6.0)
    for drift in (-0.01, 0.0, 0.01)
]


@pytest.mark.parametrize(
    ("ratio", "drift", "timed"),
    [
        (1.5, 0.01, True),
        (2.4, 0.005, False),
        slowly(1.5, -0.01, False),
        slowly(6.0, -0.01, False),
        *RATIOS,
    ],
)
def test_the_clock_finds_every_symbol_and_none_twice(ratio, drift, timed):
    draws, layout = np.random.default_rng(3), Layout(PLAN)
    for _ in range(1 if ratio < 3 else 2):
        llr, times, stamps = seen(FILM, ratio, draws, drift=drift)
        own = [stamp / 100 if timed else None for stamp in stamps]
        settled = SymbolClock(layout).ticks(parts(llr, own, 100))
        bands = np.concatenate([ticks.symbol for ticks in settled])
        first, last = np.floor(times).astype(int), np.floor(times + 0.1).astype(int)
        assert len(bands) == len(times)
        assert (bands[0] % 128 == first[0] % 128).all() or (
            bands[0] % 128 == last[0] % 128
        ).all()
        bands = bands - bands[0, 0] + first[0]
        right = (bands >= first[:, None]) & (bands <= last[:, None])
        assert right.mean() > 0.995
        assert {*range(first[0] + 1, last[-1])} <= {*bands[right].tolist()}


@pytest.mark.parametrize("second", [0, 16])
def test_frames_beside_a_gap_are_believed_only_where_the_sync_cells_place_them(second):
    """Shorter runs of sync bits come twice in a block, so a jump fits as well some frames early or late.

    The four symbols between two gaps may be taken for others, but the block is not counted twice for them.
    """
    astray = doubted = frames = 0
    for begin in (20, 35, 45, 55, 65, 75):

        def gaps(times, _, begin=begin):
            lost = [(at < times) & (times < at + 12) for at in (begin, begin + second)]
            return times[~(lost[0] | lost[1])]

        llr, times, stamps = seen(
            FILM[:150], 2.4, np.random.default_rng(begin), faults=gaps, begin=0.0
        )
        # The stamps know nothing of the gaps.
        (ticks,) = SymbolClock(Layout(PLAN)).ticks([(llr, stamps[: len(llr)] / 100)])
        believed, off = ticks.agreement.any(axis=1), np.abs(ticks.symbol[:, 0] - times)
        assert off[-60:].max() < 2
        astray += int((off[believed] > 2).sum())
        doubted += int((~believed).sum())
        frames += len(times)
    # The frames of four symbols, in six recordings.
    assert astray <= (4 * 2.4 * 6 if second else 0)
    assert 0 < doubted < 0.08 * frames


def dropped(times, draws):
    return times[draws.random(len(times)) > 0.1]


def repeated(times, draws):
    twice = np.flatnonzero(draws.random(len(times)) < 0.1)
    times[twice] = times[np.maximum(twice - 1, 0)]
    return times


def received(llr, stamps, plan=PLAN):
    layout = Layout(plan)
    got = [*receive(layout, parts(llr, stamps / 100))]
    arrived = [each.packet for each in got if each.packet]
    return messages_of(arrived, layout.code.info_bytes - 16), got, layout


@pytest.mark.parametrize("faults", [dropped, slowly(repeated), slowly(None)])
def test_the_message_arrives_through_faulty_recordings(faults):
    llr, _, stamps = seen(FILM, 2.4, np.random.default_rng(4), faults=faults, begin=0.0)
    # The camera's own stamps know nothing of what was lost or repeated.
    messages, _, _ = received(llr, stamps)
    assert [message.content for message in messages if message.complete] == [MESSAGE]
    ticks = SymbolClock(Layout(PLAN)).ticks([(llr, list(stamps / 100))])
    weights = np.concatenate([judged(one.agreement) for one in ticks])
    assert 0.02 < (weights < 1).mean() < 0.3


def test_known_cells_that_are_hidden_do_not_mislead_the_clock():
    plan = MessagePlan(PanelShape(8, 8), Signalling(code_rate=0.5))
    film = film_of(MESSAGE[:300], plan)
    llr, _, stamps = seen(film, 2.4, np.random.default_rng(6), ber=0.01)
    hidden = np.isin(Layout(plan).kind, ["clock", "sync"])
    hidden[4:] = False
    llr[:, hidden] = -np.abs(llr[:, hidden])
    messages, _, _ = received(llr, stamps, plan)
    assert messages[0].content == MESSAGE[:300]


@pytest.mark.parametrize(("begin", "end"), [(0.0, 190.4), slowly(100.3, 256)])
def test_of_a_recording_that_was_cut_every_whole_block_arrives_and_the_rest_is_named(
    begin, end
):
    llr, _, stamps = seen(FILM, 2.4, np.random.default_rng(5), begin=begin, end=end)
    messages, got, layout = received(llr, stamps)
    blocks = [
        b
        for b in range(len(FILM) // 128)
        if begin <= 128 * b + 1 and 128 * (b + 1) <= end + 1
    ]
    expected = {4 * block + place for block in blocks for place in range(4)}
    count = -(-len(MESSAGE) // (layout.code.info_bytes - 16))
    (message,) = messages
    assert expected - {*range(count, 99)} <= set(message.parts)
    assert message.complete == (len(message.parts) == count)
    for number, part in message.parts.items():
        assert part == MESSAGE[number * message.payload :][: message.payload]
    assert all(
        "no frame showed" in received_packet.row[-1]
        for received_packet in got
        if received_packet.unseen > 0.5
    )


def test_nothing_is_received_where_nothing_was_sent():
    draws = np.random.default_rng(8)
    for llr in (
        4 * draws.standard_normal((330, 8, 8)),
        np.zeros((330, 8, 8)),
        np.full((330, 8, 8), -6.0),
    ):
        messages, got, _ = received(llr.astype(np.float32), np.arange(330) / 2.4)
        assert not messages
        assert all(received_packet.row[-1] for received_packet in got)
