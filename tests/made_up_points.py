"""Made-up points, for every view."""

import pytest

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import BerTable, Point


def made_up_point(value, receiver, wrong_frames, axis="ambient_lx", frames=2000):
    """A point with ``wrong_frames`` frames of two wrong bits."""
    counts = Counts(
        frames, 64 * frames, 4 * wrong_frames, 16 * wrong_frames, wrong_frames
    )
    return Point("sun", axis, float(value), receiver, "truth", counts, "frames")


@pytest.fixture
def table():
    """Two receivers over three values out of order; flda_3 has no errors at 8000 lx."""
    wrong = {("flda_2", 32000): 90, ("flda_2", 8000): 3, ("flda_2", 1000): 200}
    wrong |= {("flda_3", 1000): 100, ("flda_3", 8000): 0, ("flda_3", 32000): 60}
    return BerTable(
        [
            made_up_point(value, receiver, number)
            for (receiver, value), number in wrong.items()
        ]
    )
