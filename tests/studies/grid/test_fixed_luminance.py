"""The example that works out what one fixed luminance loses, on a grid whose truth is known."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from made_up_dimming import AMBIENT, LUMINANCE, grid_of, sure_grid, true_ber

from vocc_torch.measure.counts import Counts
from vocc_torch.report.folder import write_grid

EXAMPLE = Path(__file__).parents[3] / "examples" / "fixed_luminance.py"


@pytest.fixture(scope="module")
def example():
    return runpy.run_path(str(EXAMPLE))


@pytest.mark.parametrize("slope", [0.5, 1.0])
def test_ratios_and_power_are_the_true_ones(example, tmp_path, capsys, slope):
    # The truth depends on luminance / ambient ** slope.
    truth = true_ber(np.array(AMBIENT) ** slope * 4000 ** (1 - slope), LUMINANCE, bloom=1.3, dark=1.3)
    write_grid(tmp_path / "ber.csv", {"truth": sure_grid(truth)})
    example["main"](tmp_path / "ber.csv")
    said = capsys.readouterr().out
    means, dimmed = truth.mean(0), truth.min(1).mean()
    assert f"{LUMINANCE[means.argmin()]:g} cd/m2: {means.min():.2e}, {means.min() / dimmed:.2f} times" in said
    # 3000 cd/m2: 0.42 octaves to 4000, 0.58 to 2000.
    assert f"headlight's 3000, 4000 cd/m2: {means[LUMINANCE.index(4000)]:.2e}" in said
    power = float(said.splitlines()[0].rpartition(" ")[2])
    assert power == pytest.approx(slope, abs=0.1)


def test_octaves_weigh_alike(example):
    assert example["octave_weights"](np.array(AMBIENT)).tolist() == pytest.approx([1 / 6] * 6)
    # The middle one stands for one octave and a half, the ends for one and for two.
    assert example["octave_weights"](np.array([1e3, 2e3, 8e3])) == pytest.approx([2 / 9, 3 / 9, 4 / 9])


def test_without_errors_or_levels_it_says_so(example, tmp_path, capsys):
    clean = grid_of({"a": [[Counts(64, 4096)] * 2]}, AMBIENT[:1], LUMINANCE[:2])
    write_grid(tmp_path / "ber.csv", {"truth": clean})
    example["main"](tmp_path / "ber.csv")
    said = capsys.readouterr().out
    assert "too few ambient lights" in said
    assert "no errors dimmed" in said
