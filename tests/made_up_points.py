"""Made-up points, for every view."""

from vocc_torch.measure.counts import Counts
from vocc_torch.measure.curve import Point


def made_up_point(value, receiver, wrong_frames, axis="ambient_lx", frames=2000):
    """A point with ``wrong_frames`` frames of two wrong bits."""
    counts = Counts(frames, 64 * frames, 4 * wrong_frames, 16 * wrong_frames, wrong_frames)
    return Point("sun", axis, float(value), receiver, "truth", counts, "frames")
