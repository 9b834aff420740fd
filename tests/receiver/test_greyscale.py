"""The baselines' threshold and scores, by hand and against plain means."""

import numpy as np
import pytest
import torch

from vocc_torch.receiver.features import greyscale_scores, preamble_threshold


def test_the_threshold_is_the_midpoint_of_the_mean_levels():
    """On LEDs at 190, 210, 200, 240 average 210, Off LEDs at 100, 90, 110, 120 average 105: halfway 157.5."""
    on = torch.tensor([[[190.0, 210.0], [200.0, 240.0]]])
    off = torch.tensor([[[100.0, 90.0], [110.0, 120.0]]])
    assert preamble_threshold(on, off).tolist() == [[[157.5]]]


def test_each_frame_has_its_own_threshold():
    rng = np.random.default_rng(0)
    on, off = rng.random((5, 3, 4)) * 255, rng.random((5, 3, 4)) * 255
    threshold = preamble_threshold(torch.from_numpy(on), torch.from_numpy(off))
    assert threshold.shape == (5, 1, 1)
    expected = [(a.mean() + b.mean()) / 2 for a, b in zip(on, off, strict=True)]
    np.testing.assert_allclose(threshold.flatten().numpy(), expected, rtol=1e-13)


@pytest.mark.parametrize(
    ("grey", "on"), [(149.0, False), (149.99, False), (150.0, True), (150.01, True), (255.0, True)]
)
def test_a_grey_at_the_threshold_is_on(grey, on):
    """Eq. 18's rule, Off below and On at the threshold: a score of exactly 0 is On."""
    threshold = preamble_threshold(torch.full((1, 2, 2), 200.0), torch.full((1, 2, 2), 100.0))
    scores = greyscale_scores(torch.full((1, 2, 2), grey), threshold)
    assert bool(((scores >= 0) == on).all())
    if grey == 150.0:
        assert scores.unique().tolist() == [0.0]
