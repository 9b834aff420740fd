"""Receivers that are called surely worse are: among equal ones hardly any, and real differences are found."""

import numpy as np
import pytest
from made_up_prices import BASE, made_up_prices

from vocc_torch.errors import VoccError
from vocc_torch.measure import frame_errors as frame_errors_module
from vocc_torch.measure.estimate import all_pairs, joint_confidence
from vocc_torch.measure.frame_errors import FrameErrors
from vocc_torch.studies.tradeoff.price_list import Setting

LEDS = 64


def equals(rng, receivers, frames, rate, shared):
    """Receivers that are wrong in as many frames on average, some of these for all alike."""
    alike = rng.random(frames) < rate * shared
    own = rng.random((receivers, frames)) < rate * (1 - shared)
    half = 2 * (alike | own) * np.minimum(LEDS, rng.geometric(0.5, (receivers, frames)))
    return FrameErrors(half.astype(np.int64), half >= 0, LEDS)


def pictures_with_a_false_claim(receivers, pictures):
    """Share of price lists of equal receivers in which any is called surely beaten."""
    rng = np.random.default_rng(1)
    settings = tuple(Setting(f"own_{n}", "paper", **BASE) for n in range(receivers))
    false = 0
    for _ in range(pictures):
        errors = equals(rng, receivers, 1024, 0.02, 0.5)
        # Their order in time is chance too.
        times = tuple(rng.uniform(4.0, 4.1, receivers).tolist())
        prices = made_up_prices(settings, alone_ms=times, errors={"mixture": errors})
        beaten = prices.beaten_by("mixture", prices.offers("mixture", "cpu", "whole", 1))
        false += any(sure for _, sure in beaten)
    return false / pictures


@pytest.mark.parametrize(("receivers", "pictures"), [(2, 200), (12, 100), (30, 50)])
def test_among_equals_few_pictures_have_a_false_claim(receivers, pictures):
    assert pictures_with_a_false_claim(receivers, pictures) <= 0.05


def test_intervals_of_single_pairs_would_not_do(monkeypatch):
    """The simulation can tell: with 95 % for each pair, some receiver is falsely beaten in many pictures."""
    monkeypatch.setattr(frame_errors_module, "joint_confidence", lambda receivers: 0.95)
    assert pictures_with_a_false_claim(12, 30) > 0.2


def test_a_real_difference_is_still_found():
    errors = equals(np.random.default_rng(2), 30, 4096, 0.02, 0.5)
    worse = errors.half_errors.copy()
    worse[0, ::16] = 2
    errors = FrameErrors(worse, errors.found, LEDS)
    assert all(errors.surely_worse(0, other) for other in range(1, 30))
    assert not any(errors.surely_worse(other, 0) for other in range(1, 30))


def test_all_pairs_share_the_chance_of_a_miss():
    assert joint_confidence(all_pairs(1)) == joint_confidence(all_pairs(2)) == 0.95
    assert joint_confidence(all_pairs(42)) == pytest.approx(1 - 0.05 / 861)


def test_the_first_frames_are_counted_alone():
    half = np.array([[2, 64, 0, 8], [0, 64, 4, 0]])
    found = half != 64
    first = FrameErrors(half, found, LEDS).first(2)
    assert [(one.frames, one.half_errors, one.panels_missed) for one in first.tallied[0]] == [
        (2, 66, 1), (2, 64, 1),
    ]  # fmt: skip
    assert first.compared(1, 0).difference == -2 / (2 * 2 * LEDS)
    for frames in (0, 5):
        with pytest.raises(VoccError, match=f"frames is {frames}: it must be from 1 to 4"):
            FrameErrors(half, found, LEDS).first(frames)
