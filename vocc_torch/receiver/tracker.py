"""Following panels in a recording: the last frame says where to look, a full search comes now and then."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind
from vocc_torch.receiver.frame_fit import (
    BLURS,
    LEAST_TO_BEGIN,
    SAMPLES,
    Corners,
    area,
    cell_levels,
    fit,
    read_cells,
    spot_energy,
)
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.receiver.resample import cell_size_px
from vocc_torch.receiver.track import STANDS, Track
from vocc_torch.types import Frames, PanelShape, StatedPanels

# Of less likely candidates so many are watched at a time.
_WATCHED = 3
# A panel that so many full searches pass over for others is none.
_MOST_DOUBTS = 2
# Cells up to which what a search and a fit say of the corners is the same.
_CLOSE = 0.5


@dataclass
class Tracker:
    """Follow panels from frame to frame of one recording.

    A full search begins, goes on while nothing is seen, and comes again every ``every`` frames: it finds new
    panels and corrects the followed ones. A panel that is not seen in ``patience`` frames is lost, and one
    beyond whose side lights change as its LEDs do is dropped at once: it was not the whole of it. While
    there is none, candidates that a search is not sure of are watched: panels once their LEDs change.

    Args:
        locator: does the full search; of one that finds several every panel is followed, else the best.
        shape: rows and columns.
        every: frames between full searches, at least 1.
        patience: frames that a panel may be out of sight.
        number: of the next panel that is new.

    Raises:
        VoccError: a number below 1.
    """

    locator: PanelLocator
    shape: PanelShape
    every: int = 30
    patience: int = 8
    number: int = 0
    tracks: list[Track] = field(default_factory=list)
    searches: int = 0
    _since: int = 0

    def __post_init__(self) -> None:
        """Check the numbers."""
        demand_kind("shape", self.shape, PanelShape)
        for name in ("every", "patience"):
            if type(value := getattr(self, name)) is not int or value < 1:
                raise VoccError.of(
                    f"follow.{name}", value, "a whole number of at least 1"
                )

    def __call__(self, frame: NDArray[np.uint8] | Tensor) -> list[Track]:
        """Take the recording's next frame (H,W) uint8, and give the panels that are seen in it.

        Raises:
            VoccError: no frame, several, or one of another type or with colours.
        """
        frames = Frames.of(frame, "frame")
        if len(frames) != 1:
            raise VoccError.of("frame", f"{len(frames)} frames", "one at a time, (H,W)")
        plane: NDArray[np.uint8] = frames.grey[0, 0].cpu().numpy()
        followed = [track for track in self.tracks if track.follow(plane, self.shape)]
        for track in followed:
            if track.sure and track.number < 0:
                self._admit(track)
        followed = _apart([track for track in followed if track.sure])
        # What is watched stays while it is followed and there is no panel; panels while not missed for long.
        self.tracks = [
            track
            for track in self.tracks
            if track in followed
            or (
                0 < track.misses <= self.patience
                if track.sure
                else not (followed or track.misses)
            )
        ]
        self._since += 1
        # All the time while nothing is followed, and soon where something is missed.
        missed = len(followed) < sum(track.sure for track in self.tracks)
        if not followed or self._since >= self.every or (missed and self._since >= 3):
            self._since, self.searches = 0, self.searches + 1
            met = [self._anchored(plane, *track) for track in self._found(plane)]
            for track in self.tracks:
                track.doubts = 0 if not any(met) or track in met else track.doubts + 1
            self.tracks = [
                track for track in self.tracks if track.doubts <= _MOST_DOUBTS
            ]
            followed = [
                track
                for track in self.tracks
                if track.sure and (track in followed or track in met)
            ]
        return sorted(followed, key=lambda track: track.number)

    def panels(
        self, greys: Tensor, most: int = 1
    ) -> tuple[list[int], list[int], StatedPanels]:
        """Take the next frames (B,H,W) uint8 in order, and give up to ``most`` panels of each.

        Returns:
            The frame of each panel, in order, and the number of its track, those followed longest first; a
            frame without a panel has one that was not found. And the panels, with the score and false alarms
            of the last search that was sure of them.
        """
        rows = []
        for i, plane in enumerate(greys):
            tracks = self(plane)
            answers = [
                (
                    track.number,
                    True,
                    track.corners.copy(),
                    track.score,
                    track.false_alarms,
                )
                for track in tracks
            ]
            none = (0, False, np.zeros((4, 2)), 0.0, math.nan)
            rows += [(i, len(tracks), *answer) for answer in answers[:most] or [none]]
        whose, many, numbers, found, corners, *judged = zip(*rows, strict=True)
        score, alarms = (torch.tensor(answer, dtype=torch.float64) for answer in judged)
        places = torch.from_numpy(np.stack(corners)), torch.tensor(found)
        return (
            list(whose),
            list(numbers),
            StatedPanels(*places, score, torch.tensor(many), alarms),
        )

    def _admit(self, track: Track) -> None:
        """Take for a panel what was watched, or is begun."""
        track.flicker, track.number = math.inf, self.number
        self.number += 1

    def _found(
        self, plane: NDArray[np.uint8]
    ) -> Iterator[tuple[Corners, float, float, bool]]:
        """Search a whole frame: corners, score, false alarms, and whether it is surely a panel."""
        frames = Frames.whole(torch.from_numpy(plane))
        found = self.locator.locate(frames, self.shape)
        if not self.locator.finds_several:
            found = found[:1]
        sure = ~(found.false_alarms > self.locator.most_false_alarms)
        columns = (part.tolist() for part in (found.score, found.false_alarms, sure))
        rows = zip(found.corners_px.cpu().numpy(), *columns, strict=True)
        for corners, score, alarms, good in sorted(rows, key=lambda row: not row[3]):
            cell = min(
                float(size)
                for size in cell_size_px(torch.from_numpy(corners)[None], self.shape)
            )
            if cell >= 1:
                yield corners, score, alarms, good

    def _anchored(
        self,
        plane: NDArray[np.uint8],
        corners: Corners,
        score: float,
        alarms: float,
        good: bool,
    ) -> Track | None:
        """Correct the track that a search met, or begin one, where a lattice explains what is there.

        What is not ``good`` corrects nothing, and is watched while there is no panel.
        """
        watched = sum(track.flicker > STANDS for track in self.tracks)
        if not good and any(track.sure for track in self.tracks):
            return None
        fits = (fit(plane, corners, self.shape, blur) for blur in BLURS)
        fitted, blur, share = max(fits, key=lambda one: one[2])
        cell = math.sqrt(abs(area(corners)) / self.shape.leds)
        if np.abs(fitted - corners).max() < _CLOSE * cell:
            corners = fitted
        middle, reach = corners.mean(0), math.sqrt(abs(area(corners))) / 2
        if share < LEAST_TO_BEGIN:
            return None
        for track in self.tracks:
            expected = track.corners + track.motion * track.misses
            if float(np.linalg.norm(expected.mean(0) - middle)) < reach:
                if good:
                    track.score, track.false_alarms = score, alarms
                if not good or (
                    not track.misses
                    and np.abs(track.corners - corners).max() < _CLOSE * cell
                ):
                    return track
                track.corners, track.misses, track.on = corners, 0, track.on[:0]
                break
        else:
            if not good and watched >= _WATCHED:
                return None
            alarms = alarms if good else math.nan
            track = Track(
                -1, corners, score, blur, share, false_alarms=alarms, flicker=0.0
            )
            self.tracks.append(track)
        if good and track.number < 0:
            self._admit(track)
        light = read_cells(plane, track.corners, self.shape, 2)
        track.watch(cell_levels(light, self.shape)[..., SAMPLES, SAMPLES])
        track.energy = spot_energy(light)
        track.blur, track.share = blur, share
        return track


def _apart(tracks: list[Track]) -> list[Track]:
    """Leave of tracks that lie on one panel the one of the lowest number."""
    distinct: list[Track] = []
    for track in sorted(tracks, key=lambda one: (one.doubts, one.number)):
        middle, reach = track.corners.mean(0), math.sqrt(abs(area(track.corners))) / 2
        if all(
            np.linalg.norm(other.corners.mean(0) - middle) >= reach
            for other in distinct
        ):
            distinct.append(track)
    return distinct
