"""Fig. 25 times what it says: each detector gives the bank's bits, alone, on the frames that are named."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from vocc_torch.measure.timing import Timing
from vocc_torch.receiver.bank import Preambles, ReceiverBank
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Distribution, SceneModel
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.studies.paper.evidence import timing
from vocc_torch.studies.paper.evidence.timing import (
    FRAMINGS,
    PAPER_SHARES,
    ProcessingTime,
    bit_detectors,
    in_turn,
    located_frames,
    parts,
    processing_time,
    summary,
)
from vocc_torch.types import Frames

RECEIVERS = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")


@pytest.fixture(scope="module")
def plan(make_plan):
    """Far panels in low light, where the receivers disagree."""
    scene = SceneModel(
        ambient_lx=Distribution("constant", (1000.0,)), distance_m=Distribution("uniform", (55.0, 70.0))
    )
    return make_plan(scene=scene, training_frames=64)


@pytest.fixture(scope="module")
def located(plan):
    return {kind: located_frames(plan, framing) for kind, framing in FRAMINGS.items()}


def decided_by_the_bank(plan, seen, framing, flda):
    """Bits of the receivers that share one reading, with preambles rendered here."""
    simulator = dataclasses.replace(plan.world, framing=framing).simulator()
    scene, bits = plan.world.scene.draw(BlockKey(plan.seed, "figures/timing", 0), plan.world.panel.shape)
    reader, nearest = plan.receiver.reader, plan.world.scene.nearest_m
    sent = simulator.render(scene, bits, nearest_m=nearest)
    torch.testing.assert_close(sent.grey, seen.frames.grey, rtol=0, atol=0)
    levels = [
        reader.read_greys(simulator.render(scene, torch.full_like(bits, on), nearest_m=nearest), seen.panels)
        for on in (True, False)
    ]
    scores = ReceiverBank(RECEIVERS, flda).scores(reader.read(sent, seen.panels), Preambles(*levels))
    return {name: score >= 0 for name, score in scores.items()}, bits


@pytest.fixture(scope="module")
def bank(plan, located, trained):
    """The bank's bits and the sent ones, by the kind of frames."""
    return {kind: decided_by_the_bank(plan, seen, FRAMINGS[kind], trained) for kind, seen in located.items()}


@pytest.mark.parametrize("kind", list(FRAMINGS))
def test_each_detector_gives_the_banks_bits(plan, located, bank, trained, kind):
    seen, (decided, sent) = located[kind], bank[kind]
    detectors = bit_detectors(plan.receiver.reader, trained)
    assert tuple(detectors) == RECEIVERS
    for name, detect in detectors.items():
        assert torch.equal(detect(seen), decided[name]), name
        alone = torch.cat([detect(one) for one in parts(seen, 1)])
        assert torch.equal(alone, decided[name]), name
    # The comparison says something: no two receivers agree here, and none is merely guessing.
    assert len({bits.numpy().tobytes() for bits in decided.values()}) == 4
    assert all((bits != sent).float().mean() < 0.2 for bits in decided.values())


USED = {
    "center_greyscale": {"centre_greys"},
    "average_greyscale": {"rectify", "cell_means"},
    "flda_2": {"rectify", "cell_means", "average_greyscale_ratio", "gradient_radial_inwardness"},
    "flda_3": {
        "rectify",
        "cell_means",
        "average_greyscale_ratio",
        "gradient_radial_inwardness",
        "neighbour_greyscale_ratio",
    },
}


@pytest.mark.parametrize("name", RECEIVERS)
def test_each_detector_does_only_what_it_needs(plan, located, trained, monkeypatch, name):
    detect = bit_detectors(plan.receiver.reader, trained)[name]
    called = []

    def watched(step):
        real = getattr(timing, step)
        monkeypatch.setattr(timing, step, lambda *given: (called.append(step), real(*given))[1])

    for step in (*USED["flda_3"], "centre_greys", "preamble_threshold"):
        watched(step)
    detect(located["crops"])
    assert sorted(called) == sorted(USED[name])


def test_what_is_timed_is_panel_detection_and_the_detectors(plan, located, bank, trained, monkeypatch):
    """Every call that the clock sees, run here: its frames, its batch and its answer."""
    ran = []

    def run_once(calls, repeats, device):
        assert device == torch.device("cpu")
        ran.append((repeats, {name: [call() for _ in range(2)] for name, call in calls.items()}))
        return {name: Timing((1.0,) * repeats) for name in calls}

    watched = []
    locate = type(plan.receiver.location).__call__

    def watching(self, frames, shape):
        watched.append(frames)
        return locate(self, frames, shape)

    monkeypatch.setattr(timing, "interleaved", run_once)
    monkeypatch.setattr(timing, "train", lambda plan: type("Training", (), {"flda": trained}))
    monkeypatch.setattr(type(plan.receiver.location), "__call__", watching)
    shown = processing_time(plan, 5, 3)
    monkeypatch.undo()
    assert (shown.batches, shown.rounds, shown.frames) == ((1, 64), (5, 3), ("whole_frames", "crops"))
    assert [repeats for repeats, _ in ran] == [5, 3, 5, 3]
    # For each kind: one call locates the frames that the detectors start from, then come the timed ones.
    timed = [frames for frames in watched if frames is not watched[0] and frames is not watched[5]]
    for index, (_, answers) in enumerate(ran):
        kind, batch = list(FRAMINGS)[index // 2], shown.batches[index % 2]
        seen, (decided, _) = located[kind], bank[kind]
        for turn in range(2):
            rows = slice(turn, turn + 1) if batch == 1 else slice(0, 64)
            frames = timed[2 * index + turn]
            assert frames.grey.dtype == torch.uint8
            assert torch.equal(frames.grey, seen.frames.grey[rows])
            assert (frames.surround is None) == (kind == "whole_frames")
            assert frames.sensor_px == (1080, 1920)
            assert (frames.grey.shape[-2:] == (1080, 1920)) == (kind == "whole_frames")
            panels = answers["panel_detection"][turn]
            assert torch.equal(panels.corners_px, seen.panels.corners_px[rows])
            for name in RECEIVERS:
                assert torch.equal(answers[name][turn], decided[name][rows]), (kind, batch, name)


def test_whole_frames_and_crops_show_the_same(located):
    whole, crops = located["whole_frames"], located["crops"]
    assert torch.equal(whole.panels.corners_px, crops.panels.corners_px)
    assert torch.equal(whole.centre_threshold, crops.centre_threshold)
    assert torch.equal(whole.average_threshold, crops.average_threshold)
    assert bool(crops.panels.found.all())


def test_frames_are_uint8_whatever_the_effects(make_plan):
    effects = {name: given for name, given in PAPER_EFFECTS.items() if name != "quantization"}
    assert located_frames(make_plan(effects=effects), "crop").frames.grey.dtype == torch.uint8


def test_stages_meet_the_same_batch_in_a_round(located):
    met = {"a": [], "b": []}
    calls = in_turn({name: met[name].append for name in met}, parts(located["crops"], 30))
    for round_ in range(5):
        for name in ("ab", "ba")[round_ % 2]:
            calls[name]()
    assert [id(seen) for seen in met["a"]] == [id(seen) for seen in met["b"]]
    first = [float(seen.panels.corners_px[0, 0, 0]) for seen in met["a"]]
    corners = located["crops"].panels.corners_px[:, 0, 0].tolist()
    assert first == [corners[0], corners[30]] * 2 + [corners[0]]
    assert all(len(seen.frames) == len(seen.average_threshold) == 30 for seen in met["a"])


# --- the numbers


def made_up(times):
    """Data from seconds by stage, one kind of frames."""
    spent, shares, costs = summary({name: Timing(seconds) for name, seconds in times.items()})
    return ProcessingTime(
        frames=("whole_frames",),
        batches=(1,),
        stages=tuple(times),
        times_ms=1e3 * spent[None, None],
        shares=shares[None, None],
        ngr_costs=costs[None, None],
        paper_shares=np.array(list(PAPER_SHARES.values())),
        rounds=(len(times["flda_2"]),),
        sensor_px=(1080, 1920),
        machine="none",
        threads=1,
        waited_share=0.0,
    )


def test_the_papers_shares_give_the_papers_extra_costs():
    found = made_up({name: (share, share) for name, share in PAPER_SHARES.items()}).findings()
    assert round(100 * found["extra_cost_of_ngr_whole_frames_batch_1"]) == 17
    # The paper states 1.78, cut off; 2 / 112 is 1.786.
    assert found["extra_total_cost_of_ngr_whole_frames_batch_1"] == pytest.approx(0.0178, abs=1e-4)
    assert found["share_flda_3_whole_frames_batch_1"] == pytest.approx(0.14)
    assert found["ms_panel_detection_whole_frames_batch_1"] == pytest.approx(1e3)


def test_ratios_are_of_the_same_round():
    # The second round is slow for all alike: times spread, ratios do not.
    data = made_up({name: (share, 9 * share, share) for name, share in PAPER_SHARES.items()})
    np.testing.assert_allclose(data.shares[0, 0], np.array([list(PAPER_SHARES.values())] * 3).T)
    np.testing.assert_allclose(data.ngr_costs[0, 0], [[1 / 6] * 3, [2 / 112] * 3])
    assert data.times_ms[0, 0, 0].tolist() == pytest.approx([1e3, 1e3, 5e3])


@pytest.fixture(scope="module")
def data(plan):
    return processing_time(plan, 3, 2)


def test_there_is_a_line_for_each_stage(data):
    head, *lines = data.rows()
    assert head[:6] == (
        "frames",
        "batch_frames",
        "stage",
        "median_ms",
        "lower_quartile_ms",
        "upper_quartile_ms",
    )
    assert head[6:10] == ("median_share", "lower_quartile_share", "upper_quartile_share", "paper_share")
    assert [line[:3] for line in lines] == [
        (kind, batch, stage) for kind in FRAMINGS for batch in (1, 64) for stage in PAPER_SHARES
    ]
    for line in lines:
        assert len(line) == len(head)
        median, low, high, share, low_share, high_share, paper, rounds, threads, waited, machine = line[3:]
        assert 0 < low <= median <= high
        assert 0 < low_share <= share <= high_share
        assert paper == PAPER_SHARES[line[2]]
        assert (rounds, threads) == (3 if line[1] == 1 else 2, torch.get_num_threads())
        assert waited == data.waited_share
        assert f"torch {torch.__version__}" in machine
        if line[2] == "panel_detection":
            assert (low_share, share, high_share) == (1, 1, 1)


def test_findings_are_the_lines_numbers(data):
    found = data.findings()
    assert all(isinstance(value, int | float) and math.isfinite(value) for value in found.values())
    assert len(found) == 3 * 4 * (5 + 4 + 2) + 2
    for kind, batch, stage, *numbers in data.rows()[1:]:
        at, ends = f"{stage}_{kind}_batch_{batch}", ("", "_low", "_high")
        assert [found[f"ms_{at}{end}"] for end in ends] == numbers[:3]
        assert [found.get(f"share_{at}{end}", 1.0) for end in ends] == numbers[3:6]


def test_times_are_of_one_frame(plan, monkeypatch):
    monkeypatch.setattr(
        timing, "interleaved", lambda calls, repeats, device: {name: Timing((0.128,)) for name in calls}
    )
    shown = processing_time(plan, 1, 1)
    assert shown.times_ms[:, 0].flatten() == pytest.approx(128.0)
    assert shown.times_ms[:, 1].flatten() == pytest.approx(2.0)


@pytest.mark.parametrize(("batch_frames", "batches"), [(1, (1,)), (10, (1, 10)), (4096, (1, 64))])
def test_batches_are_one_and_the_plans(plan, batch_frames, batches, monkeypatch):
    sizes = []

    def once(calls, repeats, device):
        sizes.append(len(calls["average_greyscale"]()))
        return {name: Timing((1.0,)) for name in calls}

    monkeypatch.setattr(timing, "interleaved", once)
    shown = processing_time(dataclasses.replace(plan, batch_frames=batch_frames), 1, 1)
    assert shown.batches == batches
    assert tuple(sizes) == batches * 2


def test_a_slice_keeps_frames_panels_and_thresholds_together(located):
    seen = located["crops"]
    one = seen[5:6]
    assert isinstance(one.frames, Frames)
    for whole, part in (
        (seen.frames.grey, one.frames.grey),
        (seen.panels.score, one.panels.score),
        (seen.panels.candidates, one.panels.candidates),
        (seen.centre_threshold, one.centre_threshold),
    ):
        assert torch.equal(part, whole[5:6])


@pytest.mark.parametrize(("processor_s", "waited"), [(4.0, 0.6), (10.0, 0.0), (18.0, 0.0)])
def test_time_without_the_processor_is_told(plan, monkeypatch, processor_s, waited):
    clock, processor = iter([100.0, 110.0]), iter([7.0, 7.0 + processor_s])
    monkeypatch.setattr(timing.time, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(timing.time, "process_time", lambda: next(processor))
    monkeypatch.setattr(
        timing, "interleaved", lambda calls, repeats, device: {name: Timing((1.0,)) for name in calls}
    )
    shown = processing_time(plan, 1, 1)
    assert shown.waited_share == pytest.approx(waited)
    assert shown.findings()["waited_share"] == shown.waited_share
