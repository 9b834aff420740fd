"""Tables, words and board of the price list say what is in it."""

import csv
import dataclasses
import io

import numpy as np
import pytest
from made_up_prices import (
    ALONE_MS,
    BIT_ERRORS,
    FRAMES,
    LEDS,
    REFERENCES,
    SETTINGS,
    made_up_prices,
)
from rich.console import Console
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.measure.genie import GenieReference
from vocc_torch.report.tensorboard import write_boards
from vocc_torch.report.timing_figure import number_text
from vocc_torch.studies.tradeoff.prices import Place
from vocc_torch.studies.tradeoff.report import (
    price_runs,
    print_prices,
    recommendation,
    write_prices,
)


@pytest.fixture(scope="module")
def prices():
    return made_up_prices()


def lines(prices, folder):
    """The lines of the table."""
    write_prices(folder / "tradeoff.csv", prices)
    with (folder / "tradeoff.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def rows(prices, tmp_path_factory):
    return lines(prices, tmp_path_factory.mktemp("tradeoff"))


def test_each_setting_and_place_has_a_row_whose_stages_and_shares_add_up(rows):
    names = (
        "receiver",
        "locator",
        "samples_per_led",
        "gradient",
        "dtype",
        "frames",
        "batch",
    )
    places = [tuple(row[name] for name in names) for row in rows]
    assert len(set(places)) == len(places) == 4 * len(SETTINGS)
    assert all(None not in row.values() for row in rows)
    for row in rows:
        names = ("read", "locate", "rectify", "features", "classify", "preambles")
        stages = sum(float(row[f"{name}_ms"]) for name in names)
        assert stages == pytest.approx(float(row["total_ms"]), rel=1e-4)
        assert float(row["share_of_detection"]) == pytest.approx(0.5)
        assert float(row["frames_per_s"]) == pytest.approx(
            1e3 / float(row["total_ms"]), rel=1e-4
        )
        assert (
            float(row["total_low_ms"])
            < float(row["total_ms"])
            < float(row["total_high_ms"])
        )


def test_rates_and_the_frontier_are_told(rows):
    whole = [row for row in rows if (row["frames"], row["batch"]) == ("whole", "32")]
    for row, wrong, ms in zip(whole, BIT_ERRORS, ALONE_MS, strict=True):
        assert float(row["mixture_ber"]) == pytest.approx(
            wrong / FRAMES / LEDS, rel=1e-4
        )
        assert float(row["mixture_bit_errors"]) == wrong
        assert float(row["total_ms"]) == pytest.approx(ms / 2, rel=1e-4)
        assert row["best_batch"] == "1"
    assert [row["mixture_frontier"] for row in whole] == list("11101110")
    assert [row["mixture_surely_beaten"] for row in whole] == list("00010001")
    assert whole[3]["mixture_beaten_by"] == "mlp-paper-K8-sobel-float32"
    alone = [row for row in rows if (row["frames"], row["batch"]) == ("whole", "1")]
    assert {row["best_batch"] for row in alone} == {"0"}
    assert {row["mixture_frontier_of_best_batches"] for row in alone} == {""}


def plain(text):
    return " ".join(text.split())


def test_words_name_what_the_data_say(prices):
    said = plain(recommendation(prices))
    for part in (
        # 1.95 ms is the quickest in batches; 4 to 6 ms with the refined locator.
        "Compared: 3 receivers with 2 ways to find the panel, 8 settings in all, on the same 1000 frames of",
        "The picture is tradeoff.png, the table tradeoff.csv.",
        "for whole frames, 1920 x 1080 px, in batches; paper scenes, mixture: Under 1.00 ms a frame: none",
        "Under 1.00 ms a frame (1000 frames a second): none; the quickest is average_greyscale, paper's",
        "60 or 30 frames a second): take mlp (MLP on 3 x 3 cells), refined locator: no error, BER < 4.7e-5",
        "For a BER below 1e-2: take flda_3 (FLDA: AGR + GRI + NGR), paper's locator, K 4: BER 4.8e-3",
        "For a BER below 1e-3: take flda_3 (FLDA: AGR + GRI + NGR), refined locator: BER 6.3e-4",
        "For a BER below 1e-4: take mlp (MLP on 3 x 3 cells), refined locator: no error",
        "For a BER below 1e-5: 1000 frames cannot show it; the nearest is mlp (MLP on 3 x 3 cells), refined",
        "A frame at a time, as it comes: Under 1.00 ms a frame (1000 frames a second): none",
        "Only average_greyscale needs frames of known bits. Times include two frames of known bits for every "
        "one of data, which also take the channel: 33 % of the frames carry data.",
        "Whole frames, 1920 x 1080 px; paper scenes, far; times are those of mixture",
        "Crops of the panel's surroundings, 89 x 89 px; paper scenes, mixture In batches",
        # Crops of other scenes were not made, so their size is not known.
        "Crops of the panel's surroundings; paper scenes, far; times are those of mixture",
        "Measured on cpu: a machine with 2 cores, 1 thread, torch 2; one thread.",
        "Stages are timed one by one; flda_3 in one go came within 3 % of the sum.",
        "Only frames of mixture were timed; these times stand for every kind of scenes",
        "by paired intervals that hold for all 28 pairs of a kind of scenes together at 95 %",
    ):
        assert plain(part) in said, part
    assert max(map(len, recommendation(prices).splitlines())) <= 110


def test_graphs_stand_beside_torch_where_they_were_asked_for(prices, tmp_path):
    """Of what is as at the first of all lists, at every locator; the others have none."""
    place = Place("cpu", "crops", 1)
    graphs, why = (
        {("flda_3", place): Estimate(0.4, 0.3, 0.5)},
        "it needs frames of known bits",
    )
    asked = made_up_prices(graphs=graphs, no_graphs={"average_greyscale": why})
    assert not {"onnx_ms"} & {*lines(prices, tmp_path)[0]}
    rows = lines(asked, tmp_path)
    found = [row for row in rows if row["onnx_ms"]]
    assert {(row["receiver"], row["frames"], row["batch"]) for row in found} == {
        ("flda_3", "crops", "1")
    }
    assert {row["samples_per_led"] for row in found} == {"8"}
    assert len({row["locator"] for row in found}) == len(found) == 2
    assert [found[0][f"onnx{end}_ms"] for end in ("", "_low", "_high")] == [
        "0.4",
        "0.3",
        "0.5",
    ]
    own = sum(
        float(found[0][f"{stage}_ms"]) for stage in ("rectify", "features", "classify")
    )
    said = plain(recommendation(asked))
    assert f"1 frame at a time: flda_3 0.400 ({number_text(own)})." in said
    assert f"None: {why}." in said
    assert "ONNXRUNTIME" not in recommendation(prices)


def test_frames_that_cannot_be_cut_are_called_so():
    noisy = made_up_prices(crop_px=(1080, 1920))
    assert "which here are whole: an effect fills the sensor; paper scenes" in plain(
        recommendation(noisy)
    )


def test_a_quicker_one_that_frames_do_not_tell_apart_is_named():
    alike = made_up_prices(SETTINGS[:2], (300, 299), (4.0, 8.0))
    said = plain(recommendation(alike))
    assert (
        "take flda_3 (FLDA: AGR + GRI + NGR), paper's locator: BER 4.7e-3 (4.2e-3 to 5.2e-3), 4.00 ms "
        "(3.92-4.08). "
        "These frames do not tell its rate from that of a quicker one, average_greyscale, paper's locator:"
    ) in said
    # Nobody asks for what is slower and no better, and rates that are apart are no chance.
    for wrong, alone_ms in (((300, 200), (4.0, 8.0)), ((300, 299), (8.0, 4.0))):
        said = plain(recommendation(made_up_prices(SETTINGS[:2], wrong, alone_ms)))
        assert "do not tell its rate" not in said


def test_what_is_possible_is_told(prices, tmp_path):
    marked = dataclasses.replace(prices, references=REFERENCES)
    said = plain(recommendation(marked))
    best = "The best here, mlp (MLP on 3 x 3 cells), refined locator, has no error on the same frames."
    possible = "What is possible, by a decoder that knows the scene, in 500 frames: "
    assert f"{possible}no error, BER < 9.3e-5. {best}" in said
    # 10 bits in 500 frames against none in them: nothing is said of a ratio.
    assert f"{possible}BER 3.1e-4 (1.5e-4 to 6.2e-4). {best}" in said
    searched = "found in 500 of 500 frames (mixture, 30.0 ms each), 490 of 500 frames (far, 40.0 ms each)."
    assert searched in said
    worse = made_up_prices(SETTINGS[:2], (300, 200), (4.0, 8.0), references=REFERENCES)
    # 400 bits in 1000 frames there, all of them in the first 500, and 10 are possible in these.
    assert "has 40 times that on the same frames." in plain(recommendation(worse))
    # No error is possible in the mixture, and there are 200 in the first 500 frames.
    assert "has BER 6.3e-3 on the same frames." in plain(recommendation(worse))
    for place, row in enumerate(lines(marked, tmp_path)):
        wrong = BIT_ERRORS[place % len(BIT_ERRORS)]
        assert (
            float(row["mixture_ber_on_possible_frames"]) == min(wrong, 500) / 500 / LEDS
        )
        assert (row["mixture_possible_test_frames"], row["mixture_possible_ber"]) == (
            "500",
            "0",
        )
        assert (row["far_possible_proven_frames"], row["far_possible_frame_ms"]) == (
            "490",
            "40",
        )
        assert float(row["far_possible_ber"]) == pytest.approx(10 / 500 / LEDS)
        assert 0 < float(row["far_possible_ber_low"]) < float(row["far_possible_ber"])
    console = Console(width=100, record=True, file=io.StringIO())
    print_prices(marked, recommendation(marked), console)
    said = console.export_text().splitlines()
    (row,) = (place for place, one in enumerate(said) if "knows the scene  " in one)
    assert said[row].split()[-4:] == ["500", "frames", "<", "9.3e-5"]
    assert said[row + 1].split() == [
        "mlp",
        "refined",
        "same",
        "500",
        "frames",
        "no",
        "error",
    ]


def test_a_receiver_that_decides_as_the_possible_one_has_once_its_rate(prices):
    """However lucky the first frames are: 3 errors in them, 100 in the others."""
    half = np.zeros((1, FRAMES), dtype=np.int64)
    half[0, :3] = half[0, 500:600] = 2
    mark = GenieReference(Counts(500, 500 * LEDS, 6, 12, 3, 0), 500, 0.03)
    errors = {"mixture": FrameErrors(half, half >= 0, LEDS)}
    same = made_up_prices(
        SETTINGS[:1], alone_ms=(4.0,), errors=errors, references={"mixture": mark}
    )
    assert "has 1 times that on the same frames." in plain(recommendation(same))


def test_what_was_left_out_is_named(tmp_path):
    absent = {"missing": {"cuda": "this machine has 0 CUDA devices"}}
    asked = made_up_prices(**absent, left_out={"svm": "scikit-learn is not installed"})
    said = plain(recommendation(asked))
    assert "Not measured on cuda: this machine has 0 CUDA devices." in said
    assert "Left out: svm, since scikit-learn is not installed." in said
    rows = lines(asked, tmp_path)
    absent = [row for row in rows if row["device"] == "cuda"]
    assert len(absent) == len(rows) / 2 == 4 * len(SETTINGS)
    blank = {(row["machine"], row["total_ms"], row["mixture_ber"]) for row in absent}
    assert blank == {("not measured", "", "")}
    why = made_up_prices(
        no_references={"mixture": "no likelihood", "far": "no likelihood"}
    )
    assert "What is possible was not measured (mixture, far): no likelihood." in plain(
        recommendation(why)
    )


@pytest.mark.parametrize("width", [60, 80, 140])
def test_the_table_fits_and_shows_every_receiver(prices, width):
    console = Console(width=width, record=True, file=io.StringIO())
    print_prices(prices, recommendation(prices), console)
    said = console.export_text()
    lines = said.splitlines()
    assert ("weights" in said) == (width > 112)
    if width >= 80:
        assert sum("flda_3" in line for line in lines[:15]) == 4
        assert "< 4.7e-5" in said
    assert "on the frontier" in plain(said)


def test_the_board_has_a_row_for_each_configuration(prices, tmp_path):
    write_boards(tmp_path, {}, runs=price_runs(prices))
    assert {run.name for run in tmp_path.iterdir()} == {
        "_summary",
        *(one.name for one in SETTINGS),
    }
    events = EventAccumulator(str(tmp_path / SETTINGS[4].name)).Reload()
    assert "_hparams_/session_start_info" in events.summary_metadata
    scalars = {tag: events.Scalars(tag)[0].value for tag in events.Tags()["scalars"]}
    assert scalars["ber/mixture"] == pytest.approx(40 / FRAMES / LEDS)
    assert scalars["ms/whole"] == pytest.approx(5.25)
    assert scalars["latency_ms/whole"] == pytest.approx(10.5)
    assert scalars["making/parameters"] == 80
