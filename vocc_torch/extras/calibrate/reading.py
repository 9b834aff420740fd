"""A recording read as a stream: some of its frames are kept, and the panel is found in those."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from scipy import sparse, spatial

from vocc_torch.arrays import Bools, Floats, Integers, Numbers
from vocc_torch.errors import VoccError
from vocc_torch.extras.calibrate import CalibrateConfig
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.recordings.frames import RecordedFrame
from vocc_torch.recordings.reading import read_recording, readable
from vocc_torch.types import Frames, Panels, PanelShape


@dataclass(frozen=True)
class ReadingSettings:
    """How panels of one recording are told from false detections."""

    batch: int = 8  # frames located at a time
    alike_size: float = 1.25  # ratio of sizes of one panel, at most
    most_panels: float = 3.0  # from one place of it to the nearest other, at most
    white_share: float = 0.9  # of pixels, from which on a picture is white throughout


SETTINGS = ReadingSettings()


@dataclass(frozen=True)
class Footage:
    """What is kept of a recording: frames spread evenly over it, in which the panel was found.

    Args:
        greys: (B,H,W), grey values.
        numbers: (B,) each frame's number in the recording.
        corners_px: (B,4,2) of the panel, clockwise from the top left.
        read: frames that were read.
        looked: frames in which the panel was looked for.
        failures: what could not be read.
    """

    greys: Numbers
    numbers: Integers
    corners_px: Floats
    read: int
    looked: int
    failures: list[str]

    def taken(self, rows: slice | Numbers) -> "Footage":
        """Take some frames."""
        names = ("greys", "numbers", "corners_px")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    def doubts(self) -> Iterator[str]:
        """Say what these frames cannot tell."""
        count = len(self)
        if count < 4:
            yield (
                f"{count} frame{'s' * (count > 1)} with the panel: "
                "noise and motion cannot be estimated; give a recording"
            )
        if count < self.looked / 2:
            yield f"the panel was found in {count} of {self.looked} frames: the scene describes only these"

    def __len__(self) -> int:
        """Count the frames."""
        return len(self.greys)


def thinned(
    recording: Iterable[RecordedFrame], most: int
) -> tuple[dict[int, RecordedFrame], int]:
    """Keep frames at equal steps, ``most`` to twice as many, however long the recording is.

    Returns:
        the frames by their numbers, and how many were read.

    Raises:
        VoccError: frames of several sizes.

    Example:
        >>> one = np.zeros((2, 2), np.uint8)
        >>> many = (RecordedFrame("a", i, None, one, one) for i in range(1000))
        >>> kept, read = thinned(many, 4)
        >>> [*kept], read
        ([0, 256, 512, 768], 1000)
    """
    chosen: dict[int, RecordedFrame] = {}
    step, number = 1, 0
    # A folder's pictures are numbered from 0 each; these numbers count the frames read.
    for number, frame in enumerate(recording):
        first = chosen.setdefault(0, frame)
        if frame.grey.shape != first.grey.shape:
            (h, w), (height, width) = frame.grey.shape, first.grey.shape
            raise VoccError(
                f"input: {frame.source} is {w} x {h} px and {first.source} is {width} x {height}: "
                "all frames must be of one camera and one size"
            )
        if number % step == 0:
            chosen[number] = frame
        if len(chosen) >= 2 * most:
            step *= 2
            chosen = {n: chosen[n] for n in chosen if n % step == 0}
    return chosen, number + 1


def agreeing(corners_px: Floats) -> Bools:
    """Choose frames of one panel: the largest chain of those alike in size and near in place, (B,) bool."""
    size = np.ptp(corners_px, axis=1).max(1, keepdims=True)
    farthest = SETTINGS.most_panels * np.median(size)
    ratio = np.log(size) / math.log(SETTINGS.alike_size)
    places = np.hstack([corners_px.mean(1) / farthest, ratio])
    near = spatial.distance.cdist(places, places, "chebyshev") < 1
    _, label = sparse.csgraph.connected_components(near)
    return np.asarray(label == np.bincount(label).argmax())


def read_footage(
    source: Path, config: CalibrateConfig, locator: PanelLocator, shape: PanelShape
) -> Footage:
    """Read a recording and find the panel.

    Args:
        source: a picture, a folder of pictures, a video or an array.
        config: how colour becomes grey, and how many frames to keep, at most twice as many.
        locator: what finds the panel.
        shape: rows and columns.

    Raises:
        VoccError: nothing to read, no panel, or a picture that is white throughout.
    """
    failures: list[str] = []
    frames = readable(read_recording(source, config.channel, grey_only=True), failures)
    chosen, read = thinned(frames, config.frames)
    greys = np.stack([frame.grey for frame in chosen.values()])
    white = float((greys >= 255).mean())
    if white > SETTINGS.white_share:
        raise VoccError(
            f"input {source} is white in {white:.0%} of its pixels: "
            "expose less, so that the panel is seen"
        )
    batches = torch.split(torch.from_numpy(greys), SETTINGS.batch)
    parts = [locator(Frames.whole(batch), shape) for batch in batches]
    located = Panels.cat(parts).to("cpu")
    corners, found = located.corners_px.double().numpy(), located.found.numpy()
    if not found.any():
        raise VoccError(
            f"input {source} shows no panel in {len(chosen)} of {len(chosen)} frames: "
            "give panel.rows and panel.columns, another receiver.locator, or calibrate.channel"
        )
    rows = found.nonzero()[0]
    rows = rows[agreeing(corners[rows])]
    if len(rows) == 1 and len(chosen) > 1:
        raise VoccError(
            f"input {source}: at least two frames must show the panel at nearly one place and of one size: "
            f"less than {SETTINGS.most_panels:g} panel sizes apart, and within a factor of {SETTINGS.alike_size:g}; "
            "keep camera and panel still, or give a larger calibrate.frames or another receiver.locator"
        )
    numbers = np.array([*chosen])[rows]
    return Footage(greys[rows], numbers, corners[rows], read, len(chosen), failures)
