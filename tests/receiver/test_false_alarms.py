"""False alarms stated by a table of scores, against SciPy's exponential tails."""

import math
from dataclasses import replace

import pytest
import torch
from scipy.stats import expon

from vocc_torch import PanelShape
from vocc_torch.errors import VoccError
from vocc_torch.receiver import false_alarms
from vocc_torch.receiver.false_alarms import FalseAlarms
from vocc_torch.receiver.locators import DetectorLocator

SHAPE = PanelShape(8, 8)


def is_near(table, score, rate):
    """Whether an estimate is within 95 % bounds of the rate that SciPy gives."""
    excess = max((score - table.floors[-1]) / table.scale, 0.0)
    spread = 1.96 * math.sqrt((1 + excess**2) / table.above[-1])
    expected = table.expected(torch.tensor([score], dtype=torch.float64))
    return abs(math.log(float(expected[0]) / rate)) < spread


def test_false_alarms_of_an_exponential_tail_are_scipys():
    draw = torch.rand(
        20000, generator=torch.Generator().manual_seed(4), dtype=torch.float64
    )
    table = FalseAlarms.of("mine", SHAPE, -draw.log())
    for score in (4.0, 7.0, 10.0):
        assert is_near(table, score, expon.sf(score))
    assert float(table.expected(torch.tensor([-9.0]))[0]) == 1


def test_where_a_tail_grows_longer_far_out_rates_follow_it():
    """One in 25 is of another kind, with a tail three times as long."""
    generator = torch.Generator().manual_seed(6)
    draw, kind = torch.rand(2, 40000, generator=generator, dtype=torch.float64)
    table = FalseAlarms.of(
        "mine", SHAPE, -draw.log() * torch.where(kind < 0.04, 3.0, 1.0)
    )
    for score in (3.0, 5.0, 7.0, 12.0):
        rate = 0.96 * expon.sf(score) + 0.04 * expon.sf(score, scale=3)
        assert is_near(table, score, rate)


def test_frames_in_which_nothing_is_seen_are_no_floor():
    """Of 40,000 one in 25 has a score."""
    draw = -torch.rand(
        40000, generator=torch.Generator().manual_seed(7), dtype=torch.float64
    ).log()
    some = torch.where(torch.arange(len(draw)) % 25 == 0, draw, -torch.inf)
    table = FalseAlarms.of("mine", SHAPE, some)
    assert len(table.floors) == 2
    for score in (1.0, 3.0, 6.0):
        assert is_near(table, score, 0.04 * expon.sf(score))
    with pytest.raises(VoccError, match=r"maxima is 2 scores: it must be 11 at least"):
        FalseAlarms.of("mine", SHAPE, some[:50])


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
