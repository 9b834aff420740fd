"""The ledger under fire: kills, torn and damaged lines, strangers' files, full disks, second writers.

Run as a script, this file is the process that forks and kills runs; see ``under_fire``.
"""

import errno
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vocc_torch.errors import VoccError
from vocc_torch.measure import exclusive, ledger_format
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.ledger import Ledger
from vocc_torch.measure.ledger_format import LedgerRow, fingerprint, header, sealed, unsealed
from vocc_torch.measure.montecarlo import Part, StopRule
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.measure.schedule import PointWork, run_point, run_points
from vocc_torch.rng import BlockKey

SETTINGS = {
    "seed": 7,
    "camera": {"focal_length_mm": 25.0, "iso_limits": None},
    "effects": {"saturation": {}},
    "receivers": ["a", "b"],
}
POINT = "distance/distance_m=50"
BITS = 64


def counted(part, point=POINT):
    """Errors of two receivers in two groups; every fifth block has no frame in any group."""
    rng = BlockKey(7, point, part.block).generator("bits")
    halves = 2 * rng.binomial(BITS, 0.01, (2, 64))[:, : part.frames]
    group = rng.integers(0, 2, 64)[: part.frames]
    found = {}
    if part.block % 5 == 4:
        return found
    for index in np.unique(group).tolist():
        for name, mine in zip("ab", halves[:, group == index], strict=True):
            sums = (int(mine.sum()), int((mine**2).sum()), int((mine > 0).sum()))
            found[name, index] = Counts(len(mine), BITS * len(mine), *sums)
    return found


def count(parts):
    return [counted(part) for part in parts]


class Calls:
    """Counts, and remembers which blocks it was asked for."""

    def __init__(self, point=POINT):
        self.blocks, self.point = [], point

    def __call__(self, parts):
        self.blocks += [part.block for part in parts]
        return [counted(part, self.point) for part in parts]


def refusal(call, *parts):
    """The refusal's one line."""
    with pytest.raises(VoccError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message
    for part in parts:
        assert str(part) in message, message
    return message


@pytest.fixture
def path(tmp_path):
    return tmp_path / "runs" / "ledger.jsonl"


@pytest.fixture
def unsynced(monkeypatch):
    """Hundreds of ledgers without waiting for the disk; what is tested then is not whether it is asked."""
    monkeypatch.setattr(os, "fsync", lambda _: None)


UNSYNCED = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def filled(path, blocks=4, config=SETTINGS):
    """A ledger file of some whole blocks; its bytes."""
    with Ledger.open(path, config) as ledger:
        outcome_of(ledger, StopRule(64 * blocks))
    return path.read_bytes()


def outcome_of(ledger, rule, function=count, **options):
    (outcome,) = run_points([PointWork(POINT, function, rule, ledger)], **options)
    return outcome


# What is written is what is read.


def test_rows_come_back_as_they_were_written(path):
    paired = PairedCounts(64, 4096, 6, 20, 2, 4, 8, 2)
    mixed = {("flda_2", 0): Counts(60, 3840, 9, 81, 1, 1), ("flda_2", "flda_3", 0): paired}
    with Ledger.open(path, SETTINGS) as ledger:
        ledger.append('µ\n"point"', 3, 64, mixed)
        ledger.append(POINT, 0, 10, {})
        assert not ledger.repaired
    with Ledger.open(path, SETTINGS) as ledger:
        assert ledger.find('µ\n"point"', 3, 64) == LedgerRow('µ\n"point"', 3, 64, mixed)
        assert list(ledger.blocks('µ\n"point"')[3].counts) == list(mixed)
        assert ledger.find(POINT, 0, 10).counts == {}
        assert ledger.find(POINT, 0, 64) is None
        assert ledger.blocks("another") == {}
        assert len(list(ledger)) == len(ledger) == 2
        assert not ledger.repaired


def test_the_header_says_whose_results_these_are(path):
    first = json.loads(filled(path).split(b"\n")[0])
    assert first["format"] == "vocc-torch ledger"
    assert first["version"] == ledger_format.VERSION
    assert first["package"] == ledger_format.__version__
    assert first["fingerprint"] == fingerprint(SETTINGS)
    assert first["settings"] == SETTINGS


def test_the_file_only_grows(path):
    before = filled(path, blocks=2)
    after = filled(path, blocks=5)
    assert after.startswith(before)
    assert after.count(b"\n") == 6


def test_one_write_and_one_fsync_a_row(path, monkeypatch):
    with Ledger.open(path, SETTINGS) as ledger:
        done, write, fsync = [], os.write, os.fsync
        monkeypatch.setattr(os, "write", lambda *a: (done.append("write"), write(*a))[1])
        monkeypatch.setattr(os, "fsync", lambda *a: (done.append("fsync"), fsync(*a))[1])
        ledger.append(POINT, 0, 64, counted(Part(0, 64)))
        assert done == ["write", "fsync"]


# Resuming.


@pytest.mark.parametrize("target", [None, 150])
@pytest.mark.parametrize("blocks_at_once", [1, 3, 8])
def test_a_resumed_run_ends_as_an_undisturbed_one(path, target, blocks_at_once):
    rule = StopRule(1000, target)
    undisturbed = run_point(count, rule)
    assert undisturbed.stopped_by == ("frames" if target is None else "frame_errors")
    filled(path, blocks=5)
    calls = Calls()
    with Ledger.open(path, SETTINGS) as ledger:
        outcome = outcome_of(ledger, rule, calls, blocks_at_once=blocks_at_once)
        assert list(outcome.counts.items()) == list(undisturbed.counts.items())
        assert outcome == undisturbed
        assert min(calls.blocks) == 5
        assert max(Counter(calls.blocks).values()) == 1
        again = Calls()
        assert outcome_of(ledger, rule, again, blocks_at_once=blocks_at_once) == undisturbed
        assert again.blocks == []


@given(st.permutations(range(9)), st.sampled_from([1, 2, 4]))
@settings(UNSYNCED, max_examples=15)
def test_the_order_in_which_blocks_were_counted_does_not_matter(unsynced, order, blocks_at_once):
    rule, calls = StopRule(9 * 64), Calls()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ledger"
        for half in (order[:5], order[5:]):
            with Ledger.open(path, SETTINGS) as ledger:
                for block in half:
                    ledger.append(POINT, block, 64, counted(Part(block, 64)))
        with Ledger.open(path, SETTINGS) as ledger:
            outcome = outcome_of(ledger, rule, calls, blocks_at_once=blocks_at_once)
            assert list(ledger.blocks(POINT)) == list(range(9))
    assert outcome == run_point(count, rule)
    assert calls.blocks == []


@pytest.mark.parametrize("blocks_at_once", [1, 4, 16])
def test_answers_stay_with_their_blocks_where_known_and_missing_ones_alternate(path, blocks_at_once):
    calls, parts = Calls(), list(StopRule(1000).parts())
    with Ledger.open(path, SETTINGS) as ledger:
        for block in (9, 1, 2, 6):
            ledger.append(POINT, block, 64, counted(parts[block]))
        outcome = outcome_of(ledger, StopRule(1000, 150), calls, blocks_at_once=blocks_at_once)
        assert outcome == run_point(count, StopRule(1000, 150))
        assert not {1, 2, 6, 9} & set(calls.blocks)
        assert outcome_of(ledger, StopRule(1000), calls, blocks_at_once=blocks_at_once) == run_point(
            count, StopRule(1000)
        )
        assert sorted(calls.blocks) == [0, 3, 4, 5, 7, 8, *range(10, 16)]
        assert [dict(ledger.find(POINT, part.block, part.frames).counts) for part in parts] == count(parts)


def test_points_do_not_mix(path):
    """Two points of one schedule, whose blocks have the same numbers and other counts."""
    calls = {"near": Calls("near"), "far": Calls("far")}
    rule = StopRule(192)
    with Ledger.open(path, SETTINGS) as ledger:
        ledger.append("far", 1, 64, counted(Part(1, 64), "far"))
        works = [PointWork(name, function, rule, ledger) for name, function in calls.items()]
        outcomes = list(run_points(works))
        assert outcomes == [run_point(Calls(name), rule) for name in calls]
        assert outcomes[0] != outcomes[1]
        assert {name: function.blocks for name, function in calls.items()} == {
            "near": [0, 1, 2],
            "far": [0, 2],
        }
        for name in calls:
            rows = ledger.blocks(name)
            assert {block: dict(row.counts) for block, row in rows.items()} == {
                block: counted(Part(block, 64), name) for block in range(3)
            }


def test_a_block_used_in_part_is_counted_again_when_more_of_it_is_needed_and_both_rows_stay(path):
    with Ledger.open(path, SETTINGS) as ledger:
        for frames, expected in ((100, [0, 1]), (128, [1]), (100, []), (128, []), (90, [1]), (200, [2, 3])):
            calls = Calls()
            assert outcome_of(ledger, StopRule(frames), calls) == run_point(count, StopRule(frames))
            assert calls.blocks == expected
        assert {block: row.frames for block, row in ledger.blocks(POINT).items()} == {
            0: 64,
            1: 64,
            2: 64,
            3: 8,
        }
        assert len(ledger) == 6
    with Ledger.open(path, SETTINGS) as ledger:
        assert ledger.blocks(POINT)[1].frames == 64
        assert len(ledger) == 6


def test_the_caller_may_change_what_it_gets_and_the_counter_what_it_gave(path):
    given = []

    def keeping(parts):
        given.extend(count(parts))
        return given[-len(parts) :]

    with Ledger.open(path, SETTINGS) as ledger:
        outcome = outcome_of(ledger, StopRule(64), keeping)
        for one in (outcome.counts, *given):
            assert one
            one.clear()
        assert ledger.find(POINT, 0, 64).counts == counted(Part(0, 64))
        assert outcome_of(ledger, StopRule(64)) == run_point(count, StopRule(64))


@pytest.mark.parametrize("answers", [slice(1, None), slice(0, 0)])
def test_a_counter_that_gives_too_few_answers_records_nothing(path, answers):
    with Ledger.open(path, SETTINGS) as ledger:
        with pytest.raises(ValueError, match="shorter"):
            outcome_of(ledger, StopRule(128), lambda parts: count(parts)[answers], blocks_at_once=2)
        assert len(ledger) == 0


def test_the_same_row_twice_is_written_once_and_another_is_refused(path):
    before = filled(path, blocks=2)
    with Ledger.open(path, SETTINGS) as ledger:
        ledger.append(POINT, 1, 64, counted(Part(1, 64)))
        assert path.read_bytes() == before
        refusal(lambda: ledger.append(POINT, 1, 64, counted(Part(2, 64))), path, "block 1", POINT)
    assert path.read_bytes() == before


def test_rows_of_one_block_in_a_file_may_repeat_but_not_differ(path):
    before = filled(path, blocks=2)
    row = before.split(b"\n")[1] + b"\n"
    path.write_bytes(before + row)
    with Ledger.open(path, SETTINGS) as ledger:
        assert len(ledger) == 2
        assert not ledger.repaired
    path.write_bytes(before + LedgerRow(POINT, 0, 64, counted(Part(1, 64))).line())
    refusal(lambda: Ledger.open(path, SETTINGS), path, "block 0", "other counts")


# Torn ends.


def test_a_last_row_torn_at_any_byte_is_cut_off_said_and_counted_again(path, unsynced):
    whole = filled(path)
    start = whole[:-1].rindex(b"\n") + 1
    assert len(whole) - start > 100
    for end in range(start, len(whole)):
        path.write_bytes(whole[:end])
        with Ledger.open(path, SETTINGS) as ledger:
            assert list(ledger.blocks(POINT)) == [0, 1, 2]
            assert bool(ledger.repaired) == (end > start)
            if ledger.repaired:
                assert f"torn last line of {end - start} bytes" in ledger.repaired
                assert str(path) in ledger.repaired
            assert path.read_bytes() == whole[:start]
            ledger.append(POINT, 3, 64, counted(Part(3, 64)))
        assert path.read_bytes() == whole


def test_a_torn_header_is_written_again(path, unsynced):
    whole = header(SETTINGS)
    path.parent.mkdir()
    for end in (*range(60), *range(60, len(whole), 9), len(whole) - 1):
        path.write_bytes(whole[:end])
        with Ledger.open(path, SETTINGS) as ledger:
            assert bool(ledger.repaired) == (end > 0)
            assert len(ledger) == 0
        assert path.read_bytes() == whole


@given(st.binary(min_size=1, max_size=40).filter(lambda tail: b"\n" not in tail[:-1]))
@settings(UNSYNCED, max_examples=40)
def test_whatever_follows_the_last_row_is_never_mixed_in(unsynced, tail):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ledger"
        whole = filled(path, blocks=2)
        path.write_bytes(whole + tail)
        with Ledger.open(path, SETTINGS) as ledger:
            assert list(ledger.blocks(POINT)) == [0, 1]
            assert f"of {len(tail)} bytes" in ledger.repaired
        assert path.read_bytes() == whole


def test_a_last_line_with_a_changed_number_is_cut_off(path):
    whole = filled(path)
    start = whole[:-1].rindex(b"\n") + 1
    changed = whole[:start] + whole[start:].replace(b'"block":3', b'"block":9')
    path.write_bytes(changed)
    with Ledger.open(path, SETTINGS) as ledger:
        assert list(ledger.blocks(POINT)) == [0, 1, 2]
        assert ledger.repaired


# Damage, strangers, other versions, other settings: refused, and the file stays as it was.


@given(st.data())
@settings(UNSYNCED, max_examples=60)
def test_a_byte_changed_before_the_last_row_is_refused(unsynced, data):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ledger"
        whole = bytearray(filled(path, blocks=3))
        last = whole[:-1].rindex(b"\n")
        at = data.draw(st.integers(0, last - 1))
        whole[at] = data.draw(st.integers(0, 255).filter(lambda byte: byte != whole[at]))
        path.write_bytes(whole)
        refusal(lambda: Ledger.open(path, SETTINGS), path)
        assert path.read_bytes() == whole


def test_the_damaged_line_is_named(path):
    lines = filled(path).split(b"\n")
    lines[2] = lines[2].replace(b'"frames":64', b'"frames":63')
    path.write_bytes(b"\n".join(lines))
    refusal(lambda: Ledger.open(path, SETTINGS), f"ledger {path} is damaged in line 3 of 5", "copy", "delete")


def test_damage_in_the_last_whole_row_is_no_torn_end_if_another_row_was_begun_after_it(path):
    damaged = filled(path).replace(b'"block":3', b'"block":9') + b'{"point":'
    path.write_bytes(damaged)
    refusal(lambda: Ledger.open(path, SETTINGS), path, "damaged in line 5 of 5")
    assert path.read_bytes() == damaged


def test_a_line_taken_out_of_the_middle_is_only_a_block_to_count_again(path):
    lines = filled(path).split(b"\n")
    path.write_bytes(b"\n".join(lines[:2] + lines[3:]))
    calls = Calls()
    with Ledger.open(path, SETTINGS) as ledger:
        assert outcome_of(ledger, StopRule(256), calls) == run_point(count, StopRule(256))
    assert calls.blocks == [1]


@pytest.mark.parametrize(
    "content",
    [
        b"my notes",
        b"my notes\n",
        b'{"experiment":"distance"}\n{"experiment":"ambient"}\n',
        b"experiment,axis\n",
        b"\n",
        b"\x00" * 100,
        bytes(range(256)) * 10,
        b"\xef\xbb\xbf" + header({}),
    ],
)
def test_a_strangers_file_is_refused_and_left_alone(path, content):
    path.parent.mkdir()
    path.write_bytes(content)
    refusal(lambda: Ledger.open(path, {}), f"ledger {path} is no ledger", "choose another")
    assert path.read_bytes() == content


def test_what_is_no_file_is_refused(tmp_path):
    refusal(lambda: Ledger.open(tmp_path, {}), tmp_path)
    if os.name == "posix":
        refusal(lambda: Ledger.open("/dev/null", {}), "/dev/null", "ordinary file")


def test_a_row_that_no_run_can_have_written_is_refused_though_its_checksum_is_right(path):
    whole = filled(path)
    good = unsealed(whole.split(b"\n")[1])
    for change in ({"frames": 65}, {"block": -1}, {"counts": [["counts", ["a", 0], [1, 2]]]}, {"counts": 3}):
        path.write_bytes(whole + sealed({**good, "block": 77, **change}))
        refusal(lambda: Ledger.open(path, SETTINGS), f"ledger {path} holds what is no row")


@pytest.mark.parametrize("version", ["0", "2", "11", '"1"', "null"])
def test_another_format_version_is_refused(path, version):
    whole = filled(path)
    other = whole.replace(b'"version":1,', f'"version":{version},'.encode(), 1)
    path.write_bytes(other)
    refusal(lambda: Ledger.open(path, SETTINGS), path, f"format version {version}", "reads 1")
    assert path.read_bytes() == other


def test_another_release_of_the_package_is_refused(path, monkeypatch):
    filled(path)
    monkeypatch.setattr(ledger_format, "__version__", "9.9.9")
    refusal(lambda: Ledger.open(path, SETTINGS), path, "9.9.9", "the release that began it")


def test_other_columns_are_refused(path, monkeypatch):
    filled(path)
    monkeypatch.setitem(ledger_format.COLUMNS, "more", ["frames"])
    refusal(lambda: Ledger.open(path, SETTINGS), path, "was written by")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"seed": 8}, "seed is 7 there and 8 here"),
        (
            {"camera": {"focal_length_mm": 18, "iso_limits": None}},
            "camera.focal_length_mm is 25 there and 18 here",
        ),
        (
            {"camera": {"focal_length_mm": 25.0, "iso_limits": [100, 3200]}},
            "camera.iso_limits is null there and [100,3200] here",
        ),
        ({"receivers": ["b", "a"]}, 'receivers is ["a","b"] there and ["b","a"] here'),
        ({"effects": {}}, "effects.saturation is {} there and not set here"),
        ({"seed": True}, "seed is 7 there and true here"),
        ({"more": 1}, "more is not set there and 1 here"),
        ({"seed": 0, "k": 1, "l": 2, "m": 3, "n": 4}, "m is not set there and 3 here and 2 more: go back"),
    ],
)
def test_other_settings_are_refused_and_named(path, change, named):
    before = filled(path)
    torn = before + b'{"point":'
    path.write_bytes(torn)
    refusal(lambda: Ledger.open(path, {**SETTINGS, **change}), path, "other settings", named)
    assert path.read_bytes() == torn


def test_the_same_settings_written_otherwise_are_the_same(path):
    filled(path)
    same = {
        "receivers": ("a", "b"),
        "effects": {"saturation": {}},
        "camera": {"iso_limits": None, "focal_length_mm": 25},
        "seed": 7.0,
    }
    assert fingerprint(same) == fingerprint(SETTINGS)
    with Ledger.open(path, same) as ledger:
        assert len(ledger) == 4


@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers()
        | st.floats(allow_nan=False, allow_infinity=False)
        | st.text(),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
        max_leaves=8,
    )
)
def test_settings_read_back_from_the_file_are_the_same_settings(value):
    line = header({"value": value})
    assert line.count(b"\n") == 1
    assert fingerprint(unsealed(line[:-1])["settings"]) == fingerprint({"value": value})
    ledger_format.check_header(line[:-1], {"value": value})


@pytest.mark.parametrize(
    ("config", "named"),
    [
        ({"camera": {"gamma": float("nan")}}, "settings.camera.gamma is nan"),
        ({"values": [1.0, float("inf")]}, "settings.values[1] is inf"),
        ({"folder": Path("runs")}, "settings.folder is "),
        ({"bins": {1: 2}}, "settings.bins is {1: 2}"),
    ],
)
def test_settings_that_json_does_not_have_are_refused_before_there_is_a_file(path, config, named):
    refusal(lambda: Ledger.open(path, config), named)
    assert not path.parent.exists()


@pytest.mark.parametrize(
    ("block", "frames", "counts", "named"),
    [
        (-1, 64, {}, "block is -1"),
        (True, 64, {}, "block is True"),
        (0, 0, {}, "frames is 0"),
        (0, 65, {}, "frames is 65"),
        (0, 10, {("a", 0): Counts(11, 704)}, "11 frames"),
        (0, 10, {("a", np.int64(0)): Counts(1, 64)}, "filed under"),
    ],
)
def test_impossible_rows_are_refused_and_not_written(path, block, frames, counts, named):
    with Ledger.open(path, SETTINGS) as ledger:
        refusal(lambda: ledger.append(POINT, block, frames, counts), named)
        assert len(ledger) == 0
    assert path.read_bytes() == header(SETTINGS)


# One writer.


def test_a_second_writer_is_refused_until_the_first_has_closed(path):
    with Ledger.open(path, SETTINGS) as first:
        refusal(lambda: Ledger.open(path, SETTINGS), path, "in use by another run")
        first.append(POINT, 0, 64, counted(Part(0, 64)))
        refusal(lambda: Ledger.open(path, SETTINGS), path, "in use by another run")
    with Ledger.open(path, SETTINGS) as second:
        assert len(second) == 1
        first.close()
        refusal(lambda: Ledger.open(path, SETTINGS), path, "in use by another run")
    refusal(lambda: first.append(POINT, 1, 64, {}), path, "is closed")


def test_a_refused_ledger_is_let_go_of(path):
    filled(path)
    refusal(lambda: Ledger.open(path, {}), "other settings")
    with Ledger.open(path, SETTINGS) as ledger:
        assert len(ledger) == 4


def no_flock(*_):
    raise OSError(errno.ENOLCK, "No locks available")


@pytest.mark.parametrize("missing", ["module", "locks"])
def test_without_flock_a_file_beside_it_holds_the_place(path, monkeypatch, missing):
    if missing == "module":
        monkeypatch.setattr(exclusive, "fcntl", None)
    else:
        monkeypatch.setattr(exclusive.fcntl, "flock", no_flock)
    beside = path.with_name("ledger.jsonl.lock")
    with Ledger.open(path, SETTINGS):
        assert f"process {os.getpid()} on " in beside.read_text()
        refusal(lambda: Ledger.open(path, SETTINGS), path, f"process {os.getpid()}", f"delete {beside}")
        assert beside.exists()
    assert not beside.exists()
    beside.write_bytes(b"\xff")
    refusal(lambda: Ledger.open(path, SETTINGS), "not named", f"delete {beside}")
    beside.unlink()
    Ledger.open(path, SETTINGS).close()


def test_a_ledger_deleted_or_written_by_somebody_else_during_the_run_is_noticed(path):
    with Ledger.open(path, SETTINGS) as ledger:
        with path.open("ab") as stranger:
            stranger.write(b"x")
        refusal(lambda: ledger.append(POINT, 0, 64, {}), path, "changed or deleted", "start the run again")
        assert path.read_bytes() == header(SETTINGS) + b"x"
    with Ledger.open(path, SETTINGS) as ledger:
        assert ledger.repaired
        path.unlink()
        refusal(lambda: ledger.append(POINT, 0, 64, {}), path, "changed or deleted")


# A system that refuses.


@pytest.fixture
def unprivileged():
    """Root may write anything: give up its rights for a while."""
    if os.name != "posix":
        pytest.skip("needs POSIX permissions")
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        was_root = os.geteuid() == 0
        if was_root:
            os.seteuid(65534)
        try:
            yield Path(folder)
        finally:
            if was_root:
                os.seteuid(0)


def test_a_read_only_ledger_and_folder_are_refused(unprivileged):
    folder = unprivileged
    if os.geteuid() == 65534:
        os.seteuid(0)
        filled(folder / "ledger")
        (folder / "ledger").chmod(0o444)
        os.seteuid(65534)
    else:
        filled(folder / "ledger")
        (folder / "ledger").chmod(0o444)
        folder.chmod(0o555)
    try:
        for target in (folder / "ledger", folder / "another", folder / "new" / "ledger"):
            refusal(
                lambda at=target: Ledger.open(at, SETTINGS), target, "Permission denied", "make it writable"
            )
    finally:
        if os.geteuid() != 65534:
            folder.chmod(0o755)


def test_a_read_only_file_system_is_refused(path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(os, "open", refuse)
    refusal(lambda: Ledger.open(path, SETTINGS), path, "Read-only file system", "choose another")


class FullDisk:
    """Stands in for the calls that reach the disk; at chosen calls it writes some bytes and is full."""

    def __init__(self, failing, part):
        self.failing, self.part, self.calls = failing, part, 0
        self.real = {name: getattr(os, name) for name in ("write", "fsync", "ftruncate")}

    def full(self):
        self.calls += 1
        if self.calls in self.failing:
            raise OSError(errno.ENOSPC, "No space left on device")

    def write(self, descriptor, data):
        if self.calls + 1 in self.failing:  # the kernel gives a short count first, and refuses the rest
            self.real["write"](descriptor, bytes(data)[: self.part])
        self.full()
        return self.real["write"](descriptor, data)

    def fsync(self, descriptor):
        self.full()
        self.real["fsync"](descriptor)

    def ftruncate(self, descriptor, size):
        self.full()
        self.real["ftruncate"](descriptor, size)

    def stands_in(self, monkeypatch):
        for name in self.real:
            monkeypatch.setattr(os, name, getattr(self, name))


@given(st.sets(st.integers(1, 16)), st.integers(0, 60))
@settings(UNSYNCED, max_examples=150)
def test_a_disk_that_is_full_at_any_moment_loses_nothing(unsynced, failing, part):
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as monkeypatch:
        path, kept = Path(folder) / "ledger", set()
        FullDisk(failing, part).stands_in(monkeypatch)

        def fill():
            with Ledger.open(path, SETTINGS) as ledger:
                for block in range(4):
                    ledger.append(POINT, block, 64, counted(Part(block, 64)))
                    kept.add(block)

        # Calls 1 and 2 are the header, 4 to 11 the rows; 3 is the folder, which some systems cannot sync.
        if failing & {1, 2, *range(4, 12)}:
            refusal(fill, f"cannot write {path}: No space left on device: make room")
        else:
            fill()
        monkeypatch.undo()
        calls = Calls()
        with Ledger.open(path, SETTINGS) as ledger:
            assert kept <= set(ledger.blocks(POINT))
            assert outcome_of(ledger, StopRule(256), calls) == run_point(count, StopRule(256))
        assert not kept & set(calls.blocks)
        assert path.read_bytes() == header(SETTINGS) + b"".join(
            LedgerRow(POINT, block, 64, counted(Part(block, 64))).line() for block in range(4)
        )


def test_a_system_that_writes_a_few_bytes_at_a_time_gets_all_of_them(path, monkeypatch):
    write = os.write
    monkeypatch.setattr(os, "write", lambda descriptor, data: write(descriptor, bytes(data)[:7]))
    content = filled(path)
    monkeypatch.undo()
    assert content == filled(path.with_name("another"))


@pytest.mark.parametrize("failing", [{1}, {2}])
def test_after_a_full_disk_the_file_is_as_before_and_the_run_can_go_on(path, monkeypatch, failing):
    before = filled(path)
    with Ledger.open(path, SETTINGS) as ledger:
        with monkeypatch.context() as patches:
            FullDisk(failing, 40).stands_in(patches)
            refusal(lambda: ledger.append(POINT, 4, 64, {("a", 0): Counts(64, 4096)}), path, "No space left")
        assert path.read_bytes() == before
        assert ledger.find(POINT, 4, 64) is None
        ledger.append(POINT, 4, 64, {("a", 0): Counts(64, 4096)})
    with Ledger.open(path, SETTINGS) as ledger:
        assert len(ledger) == 5


def test_a_failed_write_that_cannot_be_undone_ends_the_run_and_the_next_one_repairs(path, monkeypatch):
    before = filled(path)
    with Ledger.open(path, SETTINGS) as ledger:
        with monkeypatch.context() as patches:
            FullDisk({1, 2}, 40).stands_in(patches)
            refusal(lambda: ledger.append(POINT, 5, 64, {("a", 0): Counts(64, 4096)}), "No space left")
        assert len(path.read_bytes()) > len(before)
        refusal(lambda: ledger.append(POINT, 6, 64, {}), "start the run again")
    with Ledger.open(path, SETTINGS) as ledger:
        assert ledger.repaired
        assert len(ledger) == 4
    assert path.read_bytes() == before


@pytest.mark.parametrize("failing", [{1}, {2}])
@pytest.mark.parametrize("begun", [False, True])
def test_a_ledger_that_cannot_be_begun_leaves_no_file(path, monkeypatch, failing, begun):
    if begun:
        path.parent.mkdir()
        path.write_bytes(b"")
    with monkeypatch.context() as patches:
        FullDisk(failing, 40).stands_in(patches)
        refusal(lambda: Ledger.open(path, SETTINGS), path, "No space left")
    assert list(path.parent.iterdir()) == []
    assert filled(path) == filled(path.with_name("another"))


def test_an_interrupt_in_the_middle_of_a_write_leaves_the_file_as_it_was(path, monkeypatch):
    before, write = filled(path), os.write

    def interrupted(descriptor, data):
        write(descriptor, bytes(data)[:30])
        raise KeyboardInterrupt

    with Ledger.open(path, SETTINGS) as ledger:
        with monkeypatch.context() as patches:
            patches.setattr(os, "write", interrupted)
            with pytest.raises(KeyboardInterrupt):
                ledger.append(POINT, 4, 64, {})
        assert path.read_bytes() == before
        ledger.append(POINT, 4, 64, {})


# Kills. A process of its own, with one thread, forks a run, kills it with SIGKILL, and forks the next.

KILLED_BLOCKS, CALL_BLOCKS, THREADS = 30, 24, 3


def rows_in(path):
    """Blocks that have a whole row, read without the code under test."""
    if not path.exists():
        return set()
    return {json.loads(line)["block"] for line in path.read_bytes().split(b"\n")[1:-1]}


def live(folder, blocks, blocks_at_once, threads, fault=None):
    """One life of a run: it says which blocks it counts, and writes its result if it gets so far."""
    said = os.open(folder / "calls", os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def slow(parts):
        for part in parts:
            os.write(said, f"{part.block}\n".encode())
        # Blocks do not take equally long, so that threads end them out of order.
        time.sleep(0.001 * sum(1 + part.block % 3 for part in parts) / 2)
        return count(parts)

    if fault is not None:
        fault(said)
    with Ledger.open(folder / "ledger", SETTINGS) as ledger:
        if ledger.repaired:
            (folder / "repairs").open("a").write(ledger.repaired + "\n")
        with ThreadPoolExecutor(threads) as pool:
            hands = {"submit": pool.submit, "window": 2 * threads} if threads > 1 else {}
            rule = StopRule(blocks * 64 - 10)
            outcome = outcome_of(ledger, rule, slow, blocks_at_once=blocks_at_once, **hands)
        (folder / "result").write_text(repr(outcome))


def forked(function, *arguments):
    """Run a function in a forked process that ends with it."""
    child = os.fork()
    if child:
        return child
    try:
        function(*arguments)
        os._exit(0)
    except BaseException:
        traceback.print_exc()
        os._exit(1)


def killed_at_call(number, part):
    """A fault: the process kills itself at a call that reaches the ledger, having written some bytes."""

    def install(said):
        real, calls = {name: getattr(os, name) for name in ("write", "fsync", "ftruncate")}, 0

        def stand_in(name):
            def call(descriptor, *arguments):
                nonlocal calls
                if descriptor == said:
                    return real[name](descriptor, *arguments)
                calls += 1
                if calls == number:
                    if name == "write":
                        real[name](descriptor, bytes(arguments[0])[:part])
                    os.kill(os.getpid(), signal.SIGKILL)
                return real[name](descriptor, *arguments)

            return call

        for name in real:
            setattr(os, name, stand_in(name))

    return install


def lives(folder, blocks, blocks_at_once, plan, threads=1):
    """Fork lives until one ends well; ``plan`` gives each its fault and the seconds until it is killed."""
    folder.mkdir()
    told = []
    for fault, delay_s in plan:
        (folder / "calls").write_text("")
        known = rows_in(folder / "ledger")
        child = forked(live, folder, blocks, blocks_at_once, threads, fault)
        if delay_s is not None:
            time.sleep(delay_s)
            os.kill(child, signal.SIGKILL)
        status = os.waitpid(child, 0)[1]
        calls = [int(line) for line in (folder / "calls").read_text().split()]
        after = rows_in(folder / "ledger")
        told.append({"known": sorted(known), "calls": calls, "after": sorted(after), "status": status})
        if not os.WIFSIGNALED(status):
            break
    repairs = folder / "repairs"
    return {
        "lives": told,
        "result": (folder / "result").read_text(),
        "repairs": repairs.read_text().splitlines() if repairs.exists() else [],
    }


def random_plan(seed):
    draw = random.Random(seed)
    for life in range(2000):
        # Ever longer, so that the run comes to its end on a machine of any speed.
        yield None, draw.uniform(0, 0.008 + 0.0005 * life)


def call_plan():
    for life in range(2000):
        yield killed_at_call(1 + life * 5 % 6, (life * 37 + 5) % 160), None


def second_writer(folder):
    """While this process holds the ledger, another one tries; then the holder's holder is killed."""
    path = folder / "held"
    reader, writer = os.pipe()

    def hold():
        with Ledger.open(path, SETTINGS) as ledger:
            ledger.append(POINT, 0, 64, {})
            os.write(writer, b"!")
            time.sleep(60)

    child = forked(hold)
    os.read(reader, 1)
    try:
        Ledger.open(path, SETTINGS).close()
        refused = ""
    except VoccError as error:
        refused = str(error)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    with Ledger.open(path, SETTINGS) as ledger:
        return {"refused": refused, "rows_after": len(ledger)}


def really_full(folder):
    """The kernel itself writes half a row and refuses the rest: a limit on the size of files."""
    import resource

    path = folder / "full"
    reader, writer = os.pipe()

    def run():
        sizes = [len(LedgerRow(POINT, block, 64, counted(Part(block, 64))).line()) for block in range(3)]
        limit = len(header(SETTINGS)) + sum(sizes) - 50
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        try:
            with Ledger.open(path, SETTINGS) as ledger:
                outcome_of(ledger, StopRule(640))
        except VoccError as error:
            os.write(writer, str(error).encode())

    os.waitpid(forked(run), 0)
    os.close(writer)
    calls = Calls()
    content = path.read_bytes()
    with Ledger.open(path, SETTINGS) as ledger:
        outcome_of(ledger, StopRule(640), calls)
        repaired = ledger.repaired
    message = os.read(reader, 10_000).decode()
    whole = content.endswith(b"\n") and content.count(b"\n") == 3
    return {"message": message, "whole": whole, "repaired": repaired, "calls": calls.blocks}


def under_fire(folder):
    """Everything that needs forks, told as JSON."""
    report = {f"random {n}": lives(folder / f"r{n}", KILLED_BLOCKS, n, random_plan(n)) for n in (1, 3)}
    report["threads"] = lives(folder / "threads", KILLED_BLOCKS, 1, random_plan(2), THREADS)
    report["calls"] = lives(folder / "calls", CALL_BLOCKS, 1, call_plan())
    report["second"] = second_writer(folder)
    report["full"] = really_full(folder)
    print(json.dumps(report))


@pytest.fixture(scope="module")
def fire(tmp_path_factory):
    if not hasattr(os, "fork"):
        pytest.skip("needs fork")
    single = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    done = subprocess.run(
        [sys.executable, __file__, tmp_path_factory.mktemp("fire")],
        env={**os.environ, **single},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    ("name", "blocks_lost"), [("random 1", 1), ("random 3", 3), ("threads", 2 * THREADS)]
)
def test_a_run_killed_at_random_moments_ends_as_an_undisturbed_one(fire, name, blocks_lost):
    check_lives(fire[name], KILLED_BLOCKS, blocks_lost, least_kills=5)


def test_a_run_killed_at_every_call_that_reaches_the_disk_ends_as_an_undisturbed_one(fire):
    check_lives(fire["calls"], CALL_BLOCKS, 1, least_kills=10)
    assert any("torn first line" in line for line in fire["calls"]["repairs"])
    assert any("torn last line" in line for line in fire["calls"]["repairs"])


def check_lives(report, blocks, blocks_lost, least_kills):
    """The numbers are right; a life counts nothing recorded, and loses only what was under way."""
    *killed, last = report["lives"]
    assert report["result"] == repr(run_point(count, StopRule(blocks * 64 - 10)))
    assert last["status"] == 0
    assert len(killed) >= least_kills
    for life in killed:
        assert os.WTERMSIG(life["status"]) == signal.SIGKILL
        assert len(set(life["calls"]) - set(life["after"])) <= blocks_lost
    for life in report["lives"]:
        assert not set(life["calls"]) & set(life["known"])
        assert len(life["calls"]) == len(set(life["calls"]))
    calls = sum(len(life["calls"]) for life in report["lives"])
    print(f"{len(killed)} kills, {calls} blocks counted for {blocks}, {len(report['repairs'])} repairs")
    assert blocks <= calls <= blocks + blocks_lost * len(killed)


def test_a_second_process_is_refused_and_a_killed_holder_lets_go(fire):
    assert "in use by another run" in fire["second"]["refused"]
    assert "held" in fire["second"]["refused"]
    assert fire["second"]["rows_after"] == 1


def test_a_disk_that_really_is_full_keeps_the_whole_rows(fire):
    full = fire["full"]
    assert "make room, then start the same run again" in full["message"]
    assert full["whole"]
    assert not full["repaired"]
    assert full["calls"] == list(range(2, 10))


if __name__ == "__main__":
    under_fire(Path(sys.argv[1]))
