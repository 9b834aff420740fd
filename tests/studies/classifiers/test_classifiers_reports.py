"""Reports of many receivers compared, from numbers that are easy to check."""

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import Curves
from vocc_torch.measure.estimate import Estimate
from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.measure.genie import GenieReference
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.measure.train import Making
from vocc_torch.measure.trainings import Trained
from vocc_torch.report.tensorboard import write_boards
from vocc_torch.studies.classifiers.figures import curves_figure, scenes_figure
from vocc_torch.studies.classifiers.results import (
    GENIE,
    Comparison,
    GeniePoint,
    Transfer,
    ratio_text,
    summary,
)
from vocc_torch.studies.classifiers.run import board_numbers, print_table, write_tables

FRAMES = 1000
WRONG = {
    "average_greyscale": (9000, 4000),
    "flda_3": (300, 200),
    "net": (5, 0),
    "plain": (60, 500),
}
"""Wrong bits of each receiver, one a frame where they fit, at 30 and at 70 m."""


def counts(bit_errors, frames=FRAMES):
    """Wrong bits shared out over frames as evenly as can be."""
    each, more = divmod(bit_errors, frames)
    squares = 4 * ((frames - more) * each**2 + more * (each + 1) ** 2)
    return Counts(frames, 64 * frames, 2 * bit_errors, squares, min(frames, bit_errors))


def paired(a, b):
    """Two receivers whose wrong bits come in the same frames first."""
    more, less = counts(max(a, b)), counts(min(a, b))
    excess = more.half_errors - less.half_errors
    each, rest = divmod(excess // 2, FRAMES)
    squares = 4 * ((FRAMES - rest) * each**2 + rest * (each + 1) ** 2)
    side = (excess, squares, min(FRAMES, excess // 2))
    return PairedCounts(
        FRAMES,
        64 * FRAMES,
        *(side if a > b else (0, 0, 0)),
        *((0, 0, 0) if a > b else side),
    )


def curves(experiment="distance"):
    names, values = tuple(WRONG), (30.0, 70.0)
    return Curves(
        experiment,
        "distance_m",
        "truth",
        names,
        values,
        {
            (name, value): counts(WRONG[name][i])
            for name in names
            for i, value in enumerate(values)
        },
        {
            (a, b, value): paired(WRONG[a][i], WRONG[b][i])
            for i, value in enumerate(values)
            for place, a in enumerate(names)
            for b in names[place + 1 :]
        },
        dict.fromkeys(values, "frames"),
    )


def genie_point(wrong=0, **receivers):
    """64 frames; every receiver has 8 wrong bits in them, if nothing else is said, and "net" none."""
    wrongs = {**dict.fromkeys(WRONG, 8), "net": 0, **receivers}
    counted = {name: counts(bits, 64) for name, bits in wrongs.items()}
    return GeniePoint(GenieReference(counts(wrong, 64), 64, 0.025), counted)


def words_of(comparison):
    return " ".join(summary(comparison).split())


def transfer(receiver, trained_on, tested_on, wrong, at_home):
    return Transfer(
        receiver,
        trained_on,
        tested_on,
        counts(wrong),
        counts(at_home),
        paired(at_home, wrong),
    )


PAIRS = (("paper", "paper"), ("night", "paper"), ("paper", "night"), ("night", "night"))


@pytest.fixture
def made_up():
    errors = {
        "flda_3": (200, 900, 250, 250),
        "net": (0, 40, 30, 0),
        "plain": (100, 100, 120, 110),
    }
    transfers = []
    for place, pair in enumerate(PAIRS):
        home = 0 if pair[1] == "paper" else 3
        transfers += [
            transfer(name, *pair, wrong[place], wrong[home])
            for name, wrong in errors.items()
        ]
    return Comparison(
        reference="flda_3",
        curves={"distance": curves()},
        costs={
            "average_greyscale": Making(parameters=0),
            "flda_3": Making(0.7, None, 1000, 4, 2600),
            "net": Making(12.0, 6.0, 8000, 5185, 25_300),
            "plain": Making(0.6, 0.5, 1000, None, 1340),
        },
        decision_ms={
            "average_greyscale": 0.002,
            "flda_3": 0.004,
            "net": 0.08,
            "plain": 0.02,
        },
        points={"distance": 70.0},
        genie={"distance": {30.0: genie_point(), 70.0: genie_point()}},
        transfers=transfers,
        home="paper",
        most_training_frames=500,
    )


def lines_of(path):
    with Path(path).open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize(
    ("ratio", "text"),
    [
        ((0.0, 0.0, 0.01), "< 1/100"),
        ((0.97, 0.9, 1.1), "0.97 x"),
        ((1906.0, 900.0, 3000.0), "1906 x"),
        ((0.001234, 0.001, 0.002), "1/810"),
    ],
)
def test_ratios_are_fractions_or_multiples(ratio, text):
    assert ratio_text(Estimate(*ratio)) == text


def test_the_tables_state_what_was_counted(made_up, tmp_path):
    write_tables(tmp_path, made_up)
    rows = lines_of(tmp_path / "classifiers.csv")
    assert [row["receiver"] for row in rows] == [
        "net",
        "flda_3",
        "plain",
        "average_greyscale",
    ]
    by = {row["receiver"]: row for row in rows}
    assert (
        by["net"]["training_s"],
        by["net"]["parameters"],
        by["plain"]["parameters"],
    ) == ("12", "5185", "")
    assert (
        float(by["net"]["distance_70_ber_high"])
        > float(by["net"]["distance_70_ber"])
        == 0
    )
    assert float(by["plain"]["distance_70_ratio"]) == pytest.approx(2.5)
    pair = {
        (row["receiver"], row["value"]): row
        for row in lines_of(tmp_path / "paired.csv")
    }
    assert float(pair["net", "30"]["ratio"]) == pytest.approx(1 / 60)
    assert pair["net", "30"]["reference_worse"] == "295"
    scenes = {
        (row["trained_on"], row["tested_on"], row["receiver"]): row
        for row in lines_of(tmp_path / "robustness.csv")
    }
    assert scenes["paper", "night", "net"]["ratio"] == ""
    assert float(scenes["night", "paper", "flda_3"]["ratio"]) == pytest.approx(4.5)
    (first, _) = lines_of(tmp_path / "genie.csv")
    assert (first["best_receivers"], first["best_bit_errors"], first["proven"]) == (
        "net",
        "0",
        "64",
    )


def test_after_several_trainings_the_algorithms_are_compared(made_up, tmp_path):
    """The net's second training was bad, and so its ratio is another one, in a wider interval."""
    worse = WRONG | {"net": (50, 40)}

    def trained(name, i):
        """As counts() shares wrong bits out, frame by frame."""
        each, frames = [], np.arange(FRAMES)
        for of in (WRONG, worse):
            whole, more = divmod(of[name][i], FRAMES)
            each.append(
                FrameErrors(2 * (whole + (frames < more))[None], frames[None] >= 0, 64)
            )
        return Trained(
            tuple(one.counts[0] for one in each), FrameErrors.pooled(each).counts[0]
        )

    of = {
        (name, value): trained(name, i)
        for name in WRONG
        for i, value in enumerate((30.0, 70.0))
    }
    twice = replace(made_up, curves={"distance": replace(curves(), trained=of)})
    ratio, first = (one.ratio("distance", "net", 70.0) for one in (twice, made_up))
    assert (ratio.value, first.value) == (pytest.approx(20 / 200), 0)
    # 0 and 40 wrong bits scatter by a factor that two trainings hardly bound.
    assert ratio.low < 0.02 < ratio.high
    assert ratio.high > 1
    assert twice.first_ratio("distance", "net", 70.0) == first
    assert "means over 2 trainings" in words_of(twice)
    assert "means over" not in words_of(made_up)
    write_tables(tmp_path, twice)
    (row,) = (
        row
        for row in lines_of(tmp_path / "classifiers.csv")
        if row["receiver"] == "net"
    )
    assert [row[f"distance_70_{name}"] for name in ("ber", "ratio")] == ["0", "0"]
    assert float(row["distance_70_algorithm_ratio"]) == pytest.approx(0.1)
    assert row["trainings"] == "2"


@pytest.mark.parametrize("width", [80, 120])
def test_the_terminal_shows_the_best_first_and_fits(made_up, width):
    console = Console(width=width, record=True, file=io.StringIO())
    print_table(made_up, console)
    text = console.export_text()
    lines = text.splitlines()
    starts = [
        line.split()[0] for line in lines if line.split() and line.split()[0] in WRONG
    ]
    assert starts == list(made_up.ranked)
    assert max(map(len, lines)) <= width
    assert ("para-" in text) == (width == 120)
    assert lines[3].split() == ["knows", "the", "scene", "0", "of"]
    assert lines[4].split() == ["4096", "bits"]


def test_the_words_are_the_numbers(made_up):
    words = words_of(made_up)
    for said in (
        "Best of those that learn: net, at 70 m no errors in 64000 bits",
        "It was chosen on these very frames",
        "12.0 s of training on 8000 frames, 5185 parameters, 25.3 kB, 0.08 ms a frame",
        "0 wrong bits of 8192 in the first 64 frames of each point, at 25 ms a frame",
        "In 128 of 128 frames it is proven",
        "no receiver has fewer wrong bits at any point",
        "night (4.7e-4 against none)",
        "flda_3 trained on paper is as good everywhere",
        "night (4.5 times)",
        "at 95 % for all 4 comparisons stated here.",
    ):
        assert said in words
    assert "As few" not in words
    assert " ," not in words
    assert " ." not in words
    assert max(map(len, summary(made_up, 70).splitlines())) <= 70


def test_what_is_sure_by_itself_may_not_be_among_many(made_up):
    """Six wrong frames more, and none less, are told apart alone (p = 1/32), but not among four."""
    one = transfer("flda_3", "paper", "night", 6, 0)
    assert one.surely_worse()
    assert not one.surely_worse(4)
    others = [each for each in made_up.transfers if each.receiver != "flda_3"]
    both = [transfer("flda_3", "paper", "night", wrong, 0) for wrong in (6, 60)]
    for pair, said in zip(both, (False, True), strict=True):
        words = words_of(replace(made_up, transfers=[*others, pair]))
        assert ("flda_3 trained on paper is surely worse" in words) == said


def test_what_is_missing_or_odd_is_said(made_up):
    beaten = {"distance": {30.0: genie_point(), 70.0: genie_point(wrong=3, net=1)}}
    why = "the genie knows no likelihood for scene.effects.jpeg"
    curves = made_up.curves["distance"]
    same = {
        **curves.counts,
        **{("plain", value): curves.counts["net", value] for value in curves.values},
    }
    tied = replace(curves, counts=same)
    cases = {
        "Left out: svm, since scikit-learn is not installed.": {
            "left_out": {"svm": "scikit-learn is not installed"}
        },
        "receivers have fewer wrong bits than the genie at distance 70 (net);": {
            "genie": beaten
        },
        f"No genie for distance: {why}.": {"genie": {}, "no_genie": {"distance": why}},
        "Without the scenes fog: no panel.": {"lost_scenes": {"fog": "no panel"}},
        "As few wrong bits over all points: plain.": {"curves": {"distance": tied}},
    }
    for said, changes in cases.items():
        assert said in words_of(replace(made_up, **changes))
    assert "What is possible" not in words_of(replace(made_up, genie={}))


def test_each_receiver_has_a_picture_of_its_own(made_up):
    figure = curves_figure(made_up, "distance")
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles == [
        "1. net",
        "2. FLDA: AGR + GRI + NGR",
        "3. plain",
        "4. Average greyscale",
    ]
    # All pictures show the same rates.
    assert len({axes.get_ylim() for axes in figure.axes}) == 1
    notes = [
        "".join(text.get_text() for text in axes.texts if "at" in text.get_text())
        for axes in figure.axes
    ]
    assert notes[0].endswith("at 70")
    assert notes[1:3] == ["", "2.5 \N{MULTIPLICATION SIGN} at 70"]
    assert any(
        "knows the scene" in text.get_text() for text in figure.legends[0].get_texts()
    )
    # A genie without errors lies along the foot, and the faint lines are the others' rates.
    foot = figure.axes[0].get_ylim()[0]
    dashed = [line for line in figure.axes[0].lines if line.get_linestyle() == "--"]
    assert [list(line.get_ydata()) for line in dashed] == [[foot, foot]]
    drawn = [list(line.get_ydata()) for line in figure.axes[0].lines]
    assert [9000 / 64000, 4000 / 64000] in drawn
    figure.draw_without_rendering()


def test_the_map_of_scenes_says_what_is_certain(made_up):
    out, back = scenes_figure(made_up).axes[:2]
    assert [text.get_text() for text in out.get_xticklabels()] == ["paper", "night"]
    assert [text.get_text() for text in back.get_xticklabels()] == ["night"]
    assert [text.get_text() for text in out.get_yticklabels()] == [
        "net",
        "FLDA: AGR + GRI + NGR",
        "plain",
    ]
    shown = [[text.get_text() for text in axes.texts] for axes in (out, back)]
    of_home = ["< 4.7e-5", "", "3.1e-3", "", "1.6e-3", ""]
    at_night = [
        "4.7e-4",
        "0 there",
        "3.9e-3",
        "",
        "1.9e-3",
        "1.1 \N{MULTIPLICATION SIGN}",
    ]
    assert shown[0] == [
        *of_home[:2],
        *at_night[:2],
        *of_home[2:4],
        *at_night[2:4],
        *of_home[4:],
        *at_night[4:],
    ]
    assert shown[1] == [
        "6.3e-4",
        "0 there",
        "1.4e-2",
        "4.5 \N{MULTIPLICATION SIGN}",
        "1.6e-3",
        "",
    ]


def test_the_board_has_the_prices_in_each_receivers_row(made_up, tmp_path):
    write_boards(
        tmp_path, {"": list(made_up.tables.values())}, numbers=board_numbers(made_up)
    )
    assert {path.name for path in tmp_path.iterdir()} == {*WRONG, GENIE, "_summary"}
    events = EventAccumulator(str(tmp_path / "net"))
    events.Reload()
    assert events.Scalars("making/training_s")[0].value == 12
    assert events.Scalars("making/parameters")[0].value == 5185
    assert events.Scalars("of_flda_3/distance_70")[0].value == 0
    assert [one.step for one in events.Scalars("BER/distance_m")] == [300, 700]
    genie = EventAccumulator(str(tmp_path / GENIE))
    genie.Reload()
    assert "making/training_s" not in genie.Tags()["scalars"]
