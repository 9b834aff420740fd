"""Locators of one's own in ``task=decode``: weights of the learned one, and code that sees several panels."""

import csv
from importlib import import_module, resources

import numpy as np
import pytest
import torch
from composing import composed
from hydra.utils import instantiate
from PIL import Image

from vocc_torch.app import resolve
from vocc_torch.app.cli import run_task
from vocc_torch.errors import VoccError
from vocc_torch.measure.build import build_plan
from vocc_torch.measure.plan import identity
from vocc_torch.plugins import PlugIn
from vocc_torch.receiver.locators import (
    LOCATORS,
    LearnedLocator,
    PaperLocator,
    RefinedLocator,
    locator_from,
    locator_named,
    locator_settings,
    locator_words,
    plugged_locator,
)
from vocc_torch.receiver.panel_net import SHIPPED, PanelNet, save_weights
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.receiver.tracker import Tracker
from vocc_torch.types import PanelShape

OWN = "+locators.mine={_target_: vocc_torch.receiver.locators.LearnedLocator, weights: mine.json}"
FEW = ("budget.training_frames=16", "receiver=street", "decode.annotate=false")
SIGHTER = """
from dataclasses import dataclass
import torch
from vocc_torch.receiver.locators import LearnedLocator, PanelLocator
from vocc_torch.types import Candidates

@dataclass(frozen=True)
class Own(PanelLocator):
    name = "own"
    finds_several = True
    states_false_alarms = True
    wrong: str = ""
    most_false_alarms: float = 1e-3

    def locate(self, frames, shape):
        found = LearnedLocator().locate(frames, shape)
        if self.wrong == "corners":
            found.corners_px[:] = torch.nan
        if self.wrong == "frames":
            found.frame[:] = 9
        if self.wrong == "turned":
            found.corners_px[:] = found.corners_px.flip(1)
        if self.wrong == "alarms":
            found = Candidates(found.frame, found.corners_px, found.score, found.false_alarms[:-1])
        if self.wrong == "unstated":
            found = Candidates(found.frame, found.corners_px, found.score, None)
        return None if self.wrong == "none" else found
"""


@pytest.fixture
def here(tmp_path, monkeypatch, photo):
    """A folder with a picture of two panels, weights and code."""
    monkeypatch.chdir(tmp_path)
    grey = np.asarray(Image.open(photo).convert("L"))
    gap = np.full((len(grey), 120), 40, np.uint8)
    Image.fromarray(np.concatenate([grey, gap, grey], 1)).save("two.png")
    (tmp_path / "mine.json").write_bytes(
        (resources.files("vocc_torch.receiver") / SHIPPED).read_bytes()
    )
    (tmp_path / "mine.py").write_text(SIGHTER)
    return tmp_path


def rows_of(folder, *words):
    """Decode into a folder and give its rows."""
    run_task(
        composed("task=decode", "input=two.png", "name=x", *FEW[-1:], *words), folder
    )
    with (folder / "bits.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_own_weights_see_several_panels_and_are_kept(here, photo_bits, monkeypatch):
    rows = rows_of(here / "a", OWN, "receiver.locator=mine", "decode.most=3", *FEW)
    assert [row["bits"] for row in rows] == [photo_bits] * 2
    assert [row["panel"] for row in rows] == ["0", "1"]
    monkeypatch.chdir(here.parent)
    kept = Receiver.load(here / "a" / "receiver.pt")
    assert kept.locator == LearnedLocator(str(here / "mine.json"))
    monkeypatch.chdir(here)
    again = rows_of(here / "b", "model=a/receiver.pt", "decode.most=3")
    assert [row["bits"] for row in again] == [photo_bits] * 2
    text = (here / "b" / "config.yaml").read_text()
    assert f"weights: {here / 'mine.json'}" in text
    (here / "mine.json").write_text((here / "mine.json").read_text() + "\n")
    with pytest.raises(
        VoccError, match=r"mine.json holds other weights than it was made with"
    ):
        Receiver.load(here / "a" / "receiver.pt")


def test_what_own_weights_cannot_do_is_refused(here):
    with pytest.raises(VoccError, match="only learned states them"):
        composed(
            "task=decode",
            "input=two.png",
            "name=x",
            OWN,
            "receiver.locator=mine",
            "receiver.false_alarms=0.1",
        )
    with pytest.raises(
        VoccError,
        match=r"location.false_alarms is 0.1: it must be left out where weights are",
    ):
        LearnedLocator("mine.json", 0.1)
    noise = torch.randint(0, 256, (1, 90, 120), dtype=torch.uint8)
    every = LearnedLocator("mine.json", torch.inf).locate(noise, PanelShape(8, 8))
    assert len(every.score) > len(
        LearnedLocator("mine.json").locate(noise, PanelShape(8, 8)).score
    )
    arguments = {"wieghts": "mine.json"}
    with pytest.raises(
        VoccError,
        match=r"cannot be built \(it takes no wieghts, but weights, false_alarms\)",
    ):
        plugged_locator(
            PlugIn("locators.mine", "mine", OWN.split()[1].rstrip(","), arguments)
        )


def test_a_model_is_read_with_another_rate(here):
    """The picture's panels are expected in 3e-5 of empty frames: at 1e-6 none is sure."""
    rows = rows_of(here / "a", "decode.most=2", *FEW)
    assert [row["found"] for row in rows] == ["1", "1"]
    with pytest.raises(
        VoccError,
        match=r"no panel of 8 x 8 LEDs in 1 of 1 frames: .* give receiver.false_alarms=",
    ):
        rows_of(here / "b", "model=a/receiver.pt", "receiver.false_alarms=1e-6")
    assert rows_of(here / "c", "model=a/receiver.pt", "receiver.false_alarms=0.01")
    assert "false_alarms: 0.01" in (here / "c" / "config.yaml").read_text()
    with pytest.raises(
        VoccError, match=r"^receiver.false_alarms is 0.0: it must be above 0"
    ):
        rows_of(here / "d", "model=a/receiver.pt", "receiver.false_alarms=0")


def test_followed_panels_keep_their_rate_and_number(here, capsys):
    """A picture twice is a recording of two frames: the second is followed, and says what the search said."""
    (here / "film").mkdir()
    for name in ("0.png", "1.png"):
        (here / "film" / name).write_bytes((here / "two.png").read_bytes())
    searched = rows_of(here / "a", "decode.most=2", *FEW)
    followed = rows_of(
        here / "b",
        "input=film",
        "model=a/receiver.pt",
        "decode.most=2",
        "decode.follow=true",
    )
    assert [row["panel"] for row in followed] == ["0", "1"] * 2
    assert [row["false_alarms"] for row in followed] == [
        row["false_alarms"] for row in searched
    ] * 2
    assert "2 of 2 frames show a panel, 4 readings" in capsys.readouterr().out.replace(
        "\n", " "
    )
    rows_of(here / "c", "model=a/receiver.pt")
    assert (
        "a frame shows 2: decode.most=2 reads them"
        in capsys.readouterr().out.replace("\n", " ")
    )


def test_a_locator_from_outside_may_see_several(here, photo_bits):
    rows = rows_of(here / "a", "receiver.locator=mine.py:Own", "decode.most=2", *FEW)
    assert [row["bits"] for row in rows] == [photo_bits] * 2
    grey, shape = np.asarray(Image.open("two.png")), PanelShape(8, 8)
    own = plugged_locator(PlugIn.of("receiver.locator", "mine.py:Own"))
    assert len(Tracker(own, shape)(grey)) == 2
    assert locator_from(locator_settings(own), ["mine.py"]) == own
    for wrong, said in (
        ("corners", "gave corners_px of"),
        ("frames", "saw panels in frames that it was not given"),
        ("turned", "gave corners that enclose nothing"),
        ("alarms", "gave frame of"),
        ("unstated", "gave false_alarms of None"),
        ("none", "its answer is None"),
    ):
        bad = plugged_locator(
            PlugIn("receiver.locator", "Own", "mine.py:Own", {"wrong": wrong})
        )
        with pytest.raises(VoccError, match=said):
            bad.locate(torch.from_numpy(grey), shape)


def test_several_are_refused_before_anything_is_learned(here, monkeypatch):
    monkeypatch.setattr(import_module("vocc_torch.measure.train"), "receiver_for", None)
    with pytest.raises(
        VoccError,
        match=r"decode.most is 2: it must be 1 where the locator sees one panel",
    ):
        rows_of(here / "a", "receiver.locator=refined", "decode.most=2", *FEW)


def test_a_limit_of_its_own_holds_for_one_panel_and_for_several(here):
    """1e-5 is less than what either panel states."""
    strict = "+locators.mine={_target_: mine.py:Own, most_false_alarms: 1e-5}"
    for name, most in (("a", 1), ("b", 2)):
        with pytest.raises(
            VoccError, match=r"one surely enough: check panel.rows"
        ) as said:
            rows_of(
                here / name,
                strict,
                "receiver.locator=mine",
                f"decode.most={most}",
                *FEW,
            )
        assert "receiver.false_alarms" not in str(said.value), "which is refused"


def test_a_limit_that_is_no_number_is_refused(here):
    own = plugged_locator(
        PlugIn("receiver.locator", "Own", "mine.py:Own", {"most_false_alarms": "few"})
    )
    with pytest.raises(
        VoccError, match="its most_false_alarms is 'few': it must be a number above 0"
    ):
        Tracker(own, PanelShape(8, 8))(np.asarray(Image.open("two.png")))


def test_of_own_weights_no_rate_is_stated(here, monkeypatch):
    """Neither of what is found nor of a frame without a panel."""
    (here / "both").mkdir()
    (here / "both" / "0.png").write_bytes((here / "two.png").read_bytes())
    Image.new("L", (640, 480), 90).save(here / "both" / "1.png")
    rows = rows_of(here / "a", "input=both", OWN, "receiver.locator=mine", *FEW)
    assert [(row["found"], row["false_alarms"]) for row in rows] == [
        ("1", ""),
        ("0", ""),
    ]
    with pytest.raises(
        VoccError, match=r"^receiver.false_alarms is 0.001: .* locator is own_learned"
    ):
        rows_of(here / "b", "model=a/receiver.pt", "receiver.false_alarms=1e-3")
    # It is told before anything is learned.
    monkeypatch.setattr(import_module("vocc_torch.measure.train"), "receiver_for", None)
    with pytest.raises(
        VoccError,
        match=r"weights nothing.json does not exist: give a file that benchmarks",
    ):
        rows_of(
            here / "c",
            OWN.replace("mine.json", "nothing.json"),
            "receiver.locator=mine",
        )


def test_other_weights_are_another_study(here):
    """Counts of a run are not those of weights that the same file held before."""
    plan = build_plan(
        composed("task=test", "name=x", OWN, "receiver.locator=mine"), here
    )
    before = identity(plan, ["mine"])
    save_weights(here / "mine.json", PanelNet())
    assert (
        identity(
            build_plan(
                composed("task=test", "name=x", OWN, "receiver.locator=mine"), here
            ),
            ["mine"],
        )
        != before
    )


def test_a_second_panel_keeps_its_number_and_sizes_may_change(here):
    """Of two followed panels the second stays; in pictures of another size panels are new."""
    two = np.asarray(Image.open("two.png"))
    (here / "film").mkdir()
    half = two.shape[1] // 2
    alone = np.concatenate([np.full_like(two[:, :half], 40), two[:, half:]], 1)
    wider = np.concatenate([two, two[:, -40:] * 0 + 40], 1)
    for number, grey in enumerate([two] * 2 + [alone] * 3 + [wider]):
        Image.fromarray(grey).save(here / "film" / f"{number}.png")
    rows = rows_of(
        here / "a", "input=film", "decode.most=2", "decode.follow=true", *FEW
    )
    told = [
        (row["frame"], row["source"], row["panel"])
        for row in rows
        if row["found"] == "1"
    ]
    assert [panel for _, source, panel in told if source in ("0.png", "1.png")] == [
        "0",
        "1",
    ] * 2
    assert [panel for _, source, panel in told if source == "4.png"] == ["1"]
    assert [panel for _, source, panel in told if source == "5.png"] == ["2", "3"]
    one = rows_of(here / "b", "input=film", "model=a/receiver.pt", "decode.follow=true")
    assert len(one) == 6


def test_words_of_a_locator_give_it_back(here):
    for locator in (
        RefinedLocator(PaperLocator(closing_px=9), min_share=0.5),
        LearnedLocator(false_alarms=0.01),
        LearnedLocator(str(here / "mine.json"), float("inf")),
        PaperLocator(),
    ):
        name, words = locator_words(locator)
        if words:
            assert PlugIn.of("locators", words[name]).arguments
            built = instantiate(words[name])
        else:
            built = locator_named(
                name, PaperLocator(), getattr(locator, "false_alarms", 1e-3)
            )
        assert built == locator
    stating = [
        name
        for name in LOCATORS
        if locator_named(name, PaperLocator()).states_false_alarms
    ]
    assert (*stating,) == resolve.STATING


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (np.zeros((9, 9, 3), np.uint8), "frame has dtype torch.uint8 and shape"),
        (np.zeros((9, 9)), "frame has dtype torch.float64"),
        (np.zeros((0, 9), np.uint8), "not empty"),
        (np.zeros((2, 9, 9), np.uint8), "frame is 2 frames: it must be one at a time"),
    ],
)
def test_what_is_no_frame_of_a_recording_is_refused(frame, said):
    with pytest.raises(VoccError, match=said):
        Tracker(LearnedLocator(), PanelShape(8, 8))(frame)
