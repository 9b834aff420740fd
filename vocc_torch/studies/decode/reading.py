"""Frames of a recording to what was read from each."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch

from vocc_torch.arrays import Bools, Floats
from vocc_torch.errors import VoccError
from vocc_torch.receiver.calibration import APPEARANCE, harder
from vocc_torch.receiver.locators import LOCATORS, PanelLocator
from vocc_torch.receiver.receiver import Decoded, Receiver
from vocc_torch.receiver.tracker import Tracker
from vocc_torch.recordings.frames import RecordedFrame
from vocc_torch.recordings.reading import batches
from vocc_torch.studies.decode.colour import Mix
from vocc_torch.studies.decode.judge import is_doubtful, is_one_level
from vocc_torch.types import Frames

COLUMNS = (
    "source",
    "frame",
    "time_s",
    "found",
    "x_top_left",
    "y_top_left",
    "x_top_right",
    "y_top_right",
    "x_bottom_right",
    "y_bottom_right",
    "x_bottom_left",
    "y_bottom_left",
    "bits",
    "margin",
    "panel_score",
    "candidates",
    "expected_errors",
    "panel",
    "false_alarms",
    "light",
)
"""Columns of ``bits.csv``."""
BATCH_PIXELS = 32_000_000
"""Pixels decoded at a time."""


@dataclass(frozen=True, slots=True)
class Reading:
    """What was read from one recorded frame.

    Args:
        frame: the frame that was read; pictures are dropped after drawing.
        found: whether a panel was found.
        corners_px: (4,2) corners, clockwise from the top left.
        bits: (R,C) bool.
        unlike: pitch or contrast, by name, if below all training panels.
        margin: smallest distance of an LED's score from the threshold.
        panel_score: the locator's score of the panel, 0 to 1.
        candidates: number of places in the frame that could be a panel.
        is_doubtful: whether this may be no panel or have wrong bits, by a low score or similar scores of On and Off.
        expected_errors: expected number of wrong bits, from the log-likelihood ratios.
        one_level: all LEDs look alike, so all may be On or all Off.
        false_alarms: expected false alarms in a frame without a panel at this score; NaN if unknown.
        panel: number of the panel in the frame, from 0, best first; while followed, the number of its
            track.
    """

    frame: RecordedFrame
    found: bool
    corners_px: Floats
    bits: Bools
    unlike: Mapping[str, float]
    margin: float
    panel_score: float
    candidates: int
    is_doubtful: bool
    expected_errors: float
    one_level: bool
    false_alarms: float = math.nan
    panel: int = 0

    @property
    def text(self) -> str:
        """The bits as 0 and 1 in raster order; empty where no panel was found."""
        return "".join("01"[bit] for bit in self.bits.ravel().tolist()) * self.found

    @property
    def place(self) -> str:
        """Name of the picture, or of the film with the frame's number."""
        numbered = self.frame.index or self.frame.time_s is not None
        return self.frame.source + (f", frame {self.frame.index}" if numbered else "")

    @property
    def judged(self) -> str:
        """The reading and its warnings, in words."""
        text = f"{self.place}: least margin {self.margin:.3g}, panel score {self.panel_score:.2f}"
        text += ", doubtful" * self.is_doubtful + ", LEDs look alike" * self.one_level
        if not math.isnan(self.false_alarms):
            return f"{text}; {self.false_alarms:.2g} false alarms expected per frame without a panel"
        return text + f"; best of {self.candidates} candidates" * (self.candidates > 1)

    def row(self) -> list[str]:
        """The frame's row of ``bits.csv``."""
        frame = self.frame
        cells = [
            *(f"{c:.2f}" for c in self.corners_px.ravel()),
            self.text,
            f"{self.margin:.4g}",
            f"{self.panel_score:.3f}",
            f"{self.expected_errors:.3g}",
        ]
        *judged, errors = cells if self.found else [""] * len(cells)
        return [
            frame.source,
            str(frame.index),
            "" if frame.time_s is None else f"{frame.time_s:.6f}",
            str(int(self.found)),
            *judged,
            str(self.candidates),
            errors,
            str(self.panel),
            "" if math.isnan(self.false_alarms) else f"{self.false_alarms:.3g}",
            frame.light,
        ]


def read_panels(
    receiver: Receiver,
    recording: Iterator[RecordedFrame],
    most: int = 1,
    follow: str = "false",
    lights: Sequence[Mix] = (),
    frames_at_once: int = 64,
) -> Iterator[Reading]:
    """Decode a recording frame by frame, in batches of equal size.

    Args:
        receiver: a trained receiver.
        recording: its frames, as :func:`~vocc_torch.recordings.reading.read_recording` gives them.
        most: panels that are read in a frame, at most.
        follow: ``true`` where they are in order and the panel is followed, ``auto`` for videos, ``false``.
        lights: planes of the colours to read at each panel, where several are sent at once.
        frames_at_once: frames of a batch, at most; 1 for the least latency.

    Raises:
        VoccError: a frame that cannot be read, or several panels asked of a locator that sees one.
    """
    demand_several(receiver.locator, most)
    tracker = Tracker(receiver.locator, receiver.shape)
    size, last = None, 0
    for batch in batches(recording, frames_at_once, BATCH_PIXELS):
        if (frame_size := batch[0].grey.shape) != size:
            size = frame_size
            tracker = Tracker(receiver.locator, receiver.shape, number=tracker.number)
        greys = torch.from_numpy(np.stack([frame.grey for frame in batch]))
        images = Frames.whole(greys.to(receiver.device))
        whose = [*range(len(batch))]
        tracks: list[int] = []
        if follow == "true" or (follow == "auto" and batch[0].time_s is not None):
            numbers = [last, *(frame.index for frame in batch)]
            # More than 1 where a live source dropped frames.
            passed = [max(1, after - before) for before, after in pairwise(numbers)]
            last = numbers[-1]
            with torch.inference_mode():
                whose, tracks, followed = tracker.panels(greys, most, passed)
                read = receiver(
                    images[torch.tensor(whose)], followed.to(receiver.device)
                )
        elif most > 1 or (batch[0].time_s is None and receiver.locator.finds_several):
            whose, read = receiver.decode_several(images, most)
        else:
            read = receiver.decode(images)
        tracks = tracks or [row - whose.index(at) for row, at in enumerate(whose)]
        frames = [batch[place] for place in whose]
        found = [] if lights else [*_readings(receiver, frames, tracks, read)]
        for mix in lights:
            planes = torch.from_numpy(np.stack([mix(frame.colour) for frame in frames]))
            lit = [replace(frame, light=mix.name) for frame in frames]
            with torch.inference_mode():
                decoded = receiver(planes.to(receiver.device), read.panels)
            found += _readings(receiver, lit, tracks, decoded)
        # Stable: of a frame the panels of each colour, one colour after another.
        rows = zip(whose * max(1, len(lights)), found, strict=True)
        yield from (reading for _, reading in sorted(rows, key=lambda row: row[0]))


def demand_several(locator: PanelLocator | None, most: int) -> None:
    """Refuse several panels of a frame where a locator sees one.

    Raises:
        VoccError: several are asked of such a one.
    """
    if most > 1 and (locator is None or not locator.finds_several):
        rule = "1 where the locator sees one panel: detector sees several"
        raise VoccError.of("decode.most", most, rule)


def is_adjustable(locator: PanelLocator) -> bool:
    """Whether ``receiver.false_alarms`` holds for a locator: it ships, and states false alarms."""
    return LOCATORS.get(locator.name) is type(locator) and locator.states_false_alarms


def _readings(
    receiver: Receiver,
    frames: Sequence[RecordedFrame],
    tracks: Sequence[int],
    read: Decoded,
) -> Iterator[Reading]:
    """Say what was read at the panel of each frame, and how surely."""
    looks, beyond = read.appearance.cpu(), harder(read.appearance, receiver.trained_on)
    columns = (
        read.found,
        read.scores.abs().amin(dim=(1, 2)),
        read.panel_score,
        read.candidates,
        is_doubtful(read),
        torch.sigmoid(-read.llr.abs()).sum(dim=(1, 2)),
        is_one_level(read),
        read.false_alarms,
    )
    corners, bits = read.corners_px.cpu().numpy(), read.bits.cpu().numpy()
    rows = zip(frames, *(one.tolist() for one in columns), tracks, strict=True)
    for i, (frame, found, *judged) in enumerate(rows):
        unlike = {
            name: float(looks[i, APPEARANCE.index(name)])
            for name, far in beyond.items()
            if far[i] and found
        }
        yield Reading(frame, found, corners[i], bits[i], unlike, *judged)
