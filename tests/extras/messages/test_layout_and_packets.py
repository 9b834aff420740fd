"""What is written where, what a checksum lets pass, and what the codes correct."""

import struct
import tracemalloc
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vocc_torch.errors import VoccError
from vocc_torch.extras.messages.codes import ReedSolomon
from vocc_torch.extras.messages.layout import Layout
from vocc_torch.extras.messages.packets import messages_of, packed, unpacked
from vocc_torch.extras.messages.receive_task import doubts, lost, write_messages
from vocc_torch.extras.messages.signalling import MessagePlan, Signalling
from vocc_torch.hardware import PanelShape

CODES = ["rs", "none", "ldpc"]


def plan(rows=8, columns=8, **options):
    return MessagePlan(PanelShape(rows, columns), Signalling(**options))


def layout(*args, **options):
    return Layout(plan(*args, **options))


@pytest.mark.parametrize(
    ("rows", "columns", "bands"), [(8, 8, 4), (16, 16, 4), (4, 4, 2), (5, 9, 5)]
)
@pytest.mark.parametrize("code", ["rs", "none"])
def test_every_bit_has_a_cell_of_its_own(rows, columns, bands, code):
    laid = layout(rows, columns, bands=bands, code=code)
    cells, places = laid.symbols * (laid.kind == "data").sum(), laid.places.ravel()
    assert len(set(places)) == len(places) == laid.packets * laid.word_bits
    assert cells - len(places) < 8 * laid.packets
    assert laid.word_bits % 8 == 0
    assert laid.word_bits <= 8 * 255
    words = np.random.default_rng(0).integers(
        2, size=(laid.packets, laid.word_bits), dtype=np.uint8
    )
    film = laid.write(words)
    assert ((laid.read(2 * film.astype(np.float32) - 1) > 0) == words).all()
    corners = film[:, [0, 0, -1, -1], [0, -1, 0, -1]]
    assert corners.all()
    clocks = film[:, laid.kind == "clock"]
    assert clocks.shape[1] == bands
    assert (np.roll(clocks, 1, axis=0) != clocks).all()  # each symbol, round the block


@given(message=st.binary(min_size=1, max_size=400), size=st.integers(17, 200))
def test_packets_in_any_order_are_the_message_again(message, size):
    infos = list(packed(message, size))
    arrived = [unpacked(info) for info in reversed(infos)]
    for count in range(1, len(arrived)):
        assert not messages_of(arrived[:count], size - 16)[0].complete
    (only,) = messages_of(arrived, size - 16)
    assert only.complete
    assert only.content == message
    assert all(len(info) == size for info in infos)


def assembled(*infos, size=36):
    """The messages of packets, as they arrive."""
    return messages_of(map(unpacked, infos), size - 16)


def forged(sequence, length, crc, payload):
    """A packet with a right checksum that nobody sent."""
    body = struct.pack(">III", sequence, length, crc) + payload
    return body + struct.pack(">I", zlib.crc32(body))


def test_a_packet_whose_number_or_filling_does_not_fit_is_refused():
    for sequence, payload in ((9, b"abcd"), (1, b"b\0\0\1")):
        assert unpacked(forged(sequence, 5, zlib.crc32(b"abcdb"), payload)) is None


TEXT = bytes(range(1, 101))
HONEST = list(packed(TEXT, 36))


def test_a_partial_message_says_what_it_lacks(tmp_path):
    messages = assembled(HONEST[0], HONEST[2], HONEST[4])
    (message,) = messages
    assert (message.gaps, message.complete) == ([(1, 1), (3, 3)], False)
    assert write_messages(messages, tmp_path) == [
        ("part", "message.partial"),
        ("missing", "missing.csv"),
    ]
    assert (tmp_path / "message.partial").read_bytes() == TEXT[:20] + TEXT[
        40:60
    ] + TEXT[80:]
    lines = (tmp_path / "missing.csv").read_text().split()
    assert lines[1:] == ["1,1,1,20,40", "1,3,3,60,80"]


def test_packets_that_claim_gigabytes_hide_no_complete_message_and_fill_no_memory(
    tmp_path,
):
    claims = [forged(9 * n, 1 << 31, 7, bytes([n + 1] * 20)) for n in range(12)]
    tracemalloc.start()
    messages = assembled(*claims, *HONEST)
    assert write_messages(messages, tmp_path) == [("message", "message.bin")]
    assert (tmp_path / "message.bin").read_bytes() == TEXT
    assert list(doubts(messages)) == [
        "12 packets of 1 other, incomplete messages are not written"
    ]
    alone = assembled(*claims)
    write_messages(alone, tmp_path / "alone")
    assert tracemalloc.get_traced_memory()[1] < 1e6
    tracemalloc.stop()
    assert sum(path.stat().st_size for path in (tmp_path / "alone").iterdir()) < 1000
    assert "more than the 16 that the recording has time for" in lost(alone, 16, None)


def test_messages_of_two_transmitters_are_written_both(tmp_path):
    other = list(packed(b"another transmitter's text", 36))
    messages = assembled(*HONEST[:2], *other, *HONEST[2:])
    places = write_messages(messages, tmp_path)
    assert places == [("message", "message.bin"), ("message", "message_2.bin")]
    assert [(tmp_path / name).read_bytes() for _, name in places] == [
        TEXT,
        b"another transmitter's text",
    ]
    assert not list(doubts(messages))


def test_the_first_payload_of_a_packet_stays_and_a_contradiction_is_reported(tmp_path):
    false = forged(1, len(TEXT), zlib.crc32(TEXT), bytes([99] * 20))
    messages = assembled(*HONEST[:3], false, *HONEST[3:])
    write_messages(messages, tmp_path)
    assert (tmp_path / "message.bin").read_bytes() == TEXT
    assert list(doubts(messages)) == [
        "1 packets contradict the first packet of the same message and number: they are ignored"
    ]


def test_leds_that_are_too_near_each_other_are_the_reason_that_no_packet_arrived():
    assert "LEDs are 1.7 px apart, and 2 px are needed" in lost([], 4, 1.7)
    assert "report.csv says why" in lost([], 4, 2.1)


def coded(code):
    if code == "ldpc":
        pytest.importorskip("sionna")
    laid = layout(code=code)
    return laid, laid.code


def test_reed_solomon_corrects_half_as_many_bytes_as_it_adds_and_all_that_are_known_to_be_lost():
    code, draws = ReedSolomon(216, 150), np.random.default_rng(0)
    info = draws.integers(256, size=(1, 150), dtype=np.uint8)
    sure = 8.0 * code.encode([info.tobytes()]).astype(np.float32) - 4
    for wrong, unsure, right in (
        (33, False, True),
        (34, False, False),
        (58, True, True),
    ):
        soft = sure.copy().reshape(216, 8)
        at = draws.permutation(216)[:wrong]
        soft[at] *= -0.01 if unsure else -1
        decoded = code.decode(soft.reshape(1, -1))[0]
        assert (decoded == info.tobytes()) == right


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("rs", 10),
        ("none", 50),
        *(pytest.param(code, 1000, marks=pytest.mark.slow) for code in CODES),
    ],
)
def test_noise_is_no_packet(code, words):
    laid, coder = coded(code)
    draws = np.random.default_rng(2)
    llr = (3 * draws.standard_normal((words, laid.word_bits))).astype(np.float32)
    infos = [info for info in coder.decode(llr) if info is not None]
    assert [info for info in infos if unpacked(info)] == []


def test_a_plan_reads_back_and_a_strange_one_is_refused(tmp_path):
    path = tmp_path / "plan.yaml"
    path.write_text((laid := plan(code="ldpc", bands=2)).text)
    assert MessagePlan.read(path) == laid
    path.write_text("rows: 8")
    with pytest.raises(VoccError, match="is no plan of task=transmit"):
        MessagePlan.read(path)
    with pytest.raises(VoccError, match="cannot be read"):
        MessagePlan.read(tmp_path / "none.yaml")
