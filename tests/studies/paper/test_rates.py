"""Distances and gains against closed forms, and the paper's own sampling error."""

import math

import numpy as np
import pytest
from made_up_evidence import clustered, counted, curves_of, of_rates

from vocc_torch.studies.paper import rates


def test_the_papers_counts_have_its_rate_and_our_clustering():
    like = counted([clustered(np.random.default_rng(0), 1e-2, 2000)])[0][0]
    theirs = rates.clustered_like(like, 6.6e-4, 2000)
    assert theirs.ber == pytest.approx(6.6e-4, rel=0.01)
    size = like.half_errors_squared / like.half_errors
    assert theirs.half_errors_squared / theirs.half_errors == pytest.approx(
        size, rel=0.05
    )


def test_the_paper_had_a_bins_share_of_its_contrast_frames():
    curves = curves_of(
        "contrast",
        {0.27: {"flda_2": np.ones(300)}, 0.33: {"flda_2": np.ones(100)}},
    )
    assert (rates.paper_frames(curves, 0.33), rates.paper_frames(curves, None)) == (
        5000,
        20_000,
    )
    assert (
        rates.paper_frames(curves_of("ambient", {8e3: {"flda_2": np.ones(100)}}), 8e3)
        == 2000
    )


def test_distances_are_in_decades_and_a_limit_counts_beyond_itself_only():
    evidence = of_rates(frames=20_000, flda_2={8e3: 1e-2}, flda_3={8e3: 0.0})
    curves = evidence.experiments["ambient"]
    found = rates.decades_apart(curves, "flda_2", 8e3, 1e-3)
    assert found.value == pytest.approx(1, abs=1e-6)
    assert found.low < 1 < found.high
    limit = curves.rate("flda_3", 8e3).high
    assert rates.decades_apart(curves, "flda_3", 8e3, 1e-3).value == pytest.approx(
        math.log10(1e-3 / limit)
    )
    assert rates.decades_apart(curves, "flda_3", 8e3, limit / 10).value == 0


def test_the_gain_is_the_share_of_errors_saved():
    evidence = of_rates(flda_2={8e3: 2e-3, 16e3: 4e-3}, flda_3={8e3: 1e-3, 16e3: 3e-3})
    curves = evidence.experiments["ambient"]
    found, apart = rates.gain(curves, 8e3, 0.24)
    assert found.value == pytest.approx(0.5)
    assert apart.value == pytest.approx(0.26)
    average, _ = rates.gain(curves, None, 0.24)
    assert average.value == pytest.approx((0.5 + 0.25) / 2)
