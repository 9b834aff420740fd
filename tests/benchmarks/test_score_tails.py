"""False alarms fitted to greatest scores, against SciPy's exponential tails."""

import math
import runpy
from pathlib import Path

import torch
from scipy.stats import expon

from vocc_torch import PanelShape

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "false_alarms.py"
SHAPE = PanelShape(8, 8)
fitted = runpy.run_path(str(SCRIPT))["fitted"]


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
    table = fitted(SHAPE, -draw.log())
    for score in (4.0, 7.0, 10.0):
        assert is_near(table, score, expon.sf(score))
    assert float(table.expected(torch.tensor([-9.0]))[0]) == 1


def test_where_a_tail_grows_longer_far_out_rates_follow_it():
    """One in 25 is of another kind, with a tail three times as long."""
    generator = torch.Generator().manual_seed(6)
    draw, kind = torch.rand(2, 40000, generator=generator, dtype=torch.float64)
    table = fitted(SHAPE, -draw.log() * torch.where(kind < 0.04, 3.0, 1.0))
    for score in (3.0, 5.0, 7.0, 12.0):
        rate = 0.96 * expon.sf(score) + 0.04 * expon.sf(score, scale=3)
        assert is_near(table, score, rate)


def test_frames_in_which_nothing_is_seen_are_no_floor():
    """Of 40,000 one in 25 has a score."""
    draw = -torch.rand(
        40000, generator=torch.Generator().manual_seed(7), dtype=torch.float64
    ).log()
    some = torch.where(torch.arange(len(draw)) % 25 == 0, draw, -torch.inf)
    table = fitted(SHAPE, some)
    assert len(table.floors) == 2
    for score in (1.0, 3.0, 6.0):
        assert is_near(table, score, 0.04 * expon.sf(score))
