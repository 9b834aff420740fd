"""Locators of one's own in ``task=decode``: weights of the detector, and code that sees several panels."""

from importlib import resources

import numpy as np
import pytest
import torch
from composing import composed
from PIL import Image
from run_files import rows_of

from vocc_torch.app.cli import run_task
from vocc_torch.errors import VoccError
from vocc_torch.plugins import PlugIn
from vocc_torch.receiver.detector.weights import SHIPPED
from vocc_torch.receiver.locators import (
    DetectorLocator,
    locator_from,
    locator_settings,
    plugged_locator,
)
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.receiver.tracker import Tracker
from vocc_torch.types import PanelShape

OWN = "+locators.mine={_target_: vocc_torch.receiver.locators.DetectorLocator, weights: mine.json}"
FEW = ("budget.training_frames=16", "receiver=street", "decode.annotate=false")
SIGHTER = """
from dataclasses import dataclass
import torch
from vocc_torch.receiver.locators import DetectorLocator, PanelLocator
from vocc_torch.types import Candidates

@dataclass(frozen=True)
class Own(PanelLocator):
    name = "own"
    finds_several = True
    states_false_alarms = True
    wrong: str = ""
    most_false_alarms: float = 1e-3

    def locate(self, frames, shape):
        found = DetectorLocator().locate(frames, shape)
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
        (resources.files("vocc_torch.receiver.detector") / SHIPPED).read_bytes()
    )
    (tmp_path / "mine.py").write_text(SIGHTER)
    return tmp_path


def decoded(folder, *words):
    """Decode into a folder and give its rows."""
    run_task(
        composed("task=decode", "input=two.png", "name=x", *FEW[-1:], *words), folder
    )
    return rows_of(folder / "bits.csv")


def test_own_weights_see_several_panels_and_are_kept(here, photo_bits, monkeypatch):
    rows = decoded(here / "a", OWN, "receiver.locator=mine", "decode.most=3", *FEW)
    assert [row["bits"] for row in rows] == [photo_bits] * 2
    assert [row["panel"] for row in rows] == ["0", "1"]
    monkeypatch.chdir(here.parent)
    kept = Receiver.load(here / "a" / "receiver.pt")
    assert kept.locator == DetectorLocator(str(here / "mine.json"))
    monkeypatch.chdir(here)
    again = decoded(here / "b", "model=a/receiver.pt", "decode.most=3")
    assert [row["bits"] for row in again] == [photo_bits] * 2
    text = (here / "b" / "config.yaml").read_text()
    assert f"weights: {here / 'mine.json'}" in text
    (here / "mine.json").write_text((here / "mine.json").read_text() + "\n")
    with pytest.raises(
        VoccError, match=r"mine.json holds other weights than the model was made"
    ):
        Receiver.load(here / "a" / "receiver.pt")


def test_a_locator_from_outside_may_see_several(here, photo_bits):
    rows = decoded(here / "a", "receiver.locator=mine.py:Own", "decode.most=2", *FEW)
    assert [row["bits"] for row in rows] == [photo_bits] * 2
    grey, shape = np.array(Image.open("two.png")), PanelShape(8, 8)
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
