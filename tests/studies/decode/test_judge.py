"""Warnings of decoding separate readings with wrong bits from right ones."""

from collections import Counter
from types import SimpleNamespace

import pytest
import torch

import vocc_torch as vt
from vocc_torch.receiver.shipped import shipped_receiver
from vocc_torch.studies.decode.judge import is_doubtful, is_one_level

SCENES = "paper", "fog", "highway", "dashcam", "tunnel", "low_sun"


def test_a_reading_with_an_led_on_the_threshold_is_doubtful():
    """However far On and Off lie apart."""
    scores = torch.tensor([1.0, -1.0]).repeat(2, 32).view(2, 8, 8).double()
    scores[1, 0, 0] = 0.01
    sure = torch.ones(2).double()
    read = SimpleNamespace(
        scores=scores, bits=scores >= 0, panel_score=sure, false_alarms=0 * sure
    )
    assert is_doubtful(read).tolist() == [False, True]


@pytest.mark.slow
def test_a_warning_marks_wrong_readings():
    """Half of the readings that each warning marks are wrong, and half of the wrong ones are marked."""
    receiver, counts = shipped_receiver("street"), Counter()
    for scene in SCENES:
        for batch in vt.simulate(scene, frames=96, point="warnings"):
            with torch.inference_mode():
                read = receiver(batch.frames)
            wrong = (read.bits != batch.bits).flatten(1).any(dim=1)[read.found]
            doubtful, alike = (
                is_doubtful(read)[read.found],
                is_one_level(read)[read.found],
            )
            counts["found"] += int(read.found.sum())
            for name, marked in (
                ("doubtful", doubtful),
                ("alike", alike),
                ("either", doubtful | alike),
            ):
                counts[name] += int(marked.sum())
                counts[f"{name}, wrong"] += int((marked & wrong).sum())
            counts["wrong"] += int(wrong.sum())
    print(dict(counts))
    assert counts["wrong"] > 20
    for name in ("doubtful", "alike", "either"):
        assert 2 * counts[f"{name}, wrong"] >= counts[name] > 0
    assert 2 * counts["either, wrong"] >= counts["wrong"]
    assert 2 * counts["doubtful, wrong"] >= counts["wrong"]
