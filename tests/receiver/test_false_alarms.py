"""False alarms stated by a table of scores."""

import math
from dataclasses import replace

import pytest
import torch

from vocc_torch import PanelShape
from vocc_torch.errors import VoccError
from vocc_torch.receiver import false_alarms
from vocc_torch.receiver.false_alarms import FalseAlarms
from vocc_torch.receiver.locators import DetectorLocator

SHAPE = PanelShape(8, 8)


def test_a_table_is_read_and_serves_no_smaller_panel(tmp_path):
    row = FalseAlarms("mine", 4, 8, 5000, (350, 100), (1.25, 2.5), 0.5)
    text = "locator,...\nmine,4,8,5000,350 100,1.25 2.5,0.5\n"
    (tmp_path / "table.csv").write_text(text)
    assert false_alarms.read_table(tmp_path / "table.csv") == (row,)
    assert (
        false_alarms.calibrated("mine", PanelShape(8, 8), tmp_path / "table.csv") == row
    )
    assert (
        false_alarms.calibrated("mine", PanelShape(4, 4), tmp_path / "table.csv")
        is None
    )
    assert false_alarms.calibrated("other", SHAPE, tmp_path / "table.csv") is None


def test_a_panel_too_small_for_a_statement_is_refused():
    locator, grey = DetectorLocator(), torch.zeros(1, 64, 64, dtype=torch.uint8)
    with pytest.raises(
        VoccError,
        match=r"panel is 3 x 4: it must be of at least 16 LEDs for receiver\.locator",
    ):
        locator(grey, PanelShape(3, 4))
    at_any_rate = replace(locator, false_alarms=math.inf)
    found = at_any_rate.locate(grey, PanelShape(3, 4))
    panels = at_any_rate(grey, PanelShape(3, 4))
    assert bool(panels.found[0]) == bool(len(found.score))
