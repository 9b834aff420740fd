"""Following panels in a recording: near their last position, with a search of the whole frame at intervals."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind, whole_number
from vocc_torch.receiver.detector.nearby import LEAST_LOG_ODDS, Surroundings
from vocc_torch.receiver.detector.placer import AXES, moved
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.receiver.locators.detector import networks_of
from vocc_torch.receiver.locators.second_looks import sure_of
from vocc_torch.receiver.resample import cell_size_px
from vocc_torch.types import Frames, PanelShape, StatedPanels


@dataclass(frozen=True)
class TrackerSettings:
    """Thresholds of following, and weights of the newest frame in running means."""

    least_log_odds: float = 2.0  # mean log odds of a panel that is followed
    clear_log_odds: float = 4.0  # with higher log odds the search is not widened
    fallen: float = 3.0  # fall of the log odds that widens the search
    shape_kept: float = 0.3  # weight of a new size and shape
    spread_learned: float = 0.2  # weight of the newest prediction error
    noise_cells2: float = 0.02  # variance of the placer's corners, squared cells
    per_cell: float = 2.0  # log odds subtracted per cell off the expected place
    motion_learned: float = 0.5  # weight of the newest motion
    growth_learned: float = 0.1  # weight of the newest change of size and shape
    odds_learned: float = 0.2  # weight of the newest log odds
    slip_forgotten: float = 0.3  # share of the slips' evidence dropped per frame
    slip: float = 4.0  # log odds by which a moved lattice must be likelier
    soon: int = 3  # frames to the next search if a panel is missed
    most_doubts: int = 2  # searches without the panel before it is dropped
    least_pitch_px: float = 1.0  # smallest pitch of a panel that is followed


SETTINGS = TrackerSettings()

SLIPS = torch.cat([torch.zeros(1, 2), AXES])
"""Cells, across and down, by which a followed lattice may have slipped; the first is none."""


@dataclass(eq=False)
class Track:
    """A panel that is followed.

    Args:
        number: number of the track, from 0.
        corners: (4,2) float64 px, the corners when the panel was last found.
        score: score of the last full search that accepted the panel.
        false_alarms: false alarms that this search expects in a frame without a panel.
        log_odds: running mean of the placer's log odds.
        motion: (4,2) motion of the corners, px per frame.
        slips: (5,) running log odds of :data:`SLIPS`.
        spread: mean square of the prediction error, squared cells.
        misses: processed frames since the panel was last found.
        unseen: frames since then, dropped frames included.
        doubts: full searches in a row that found other panels only.
    """

    number: int
    corners: Tensor
    score: float
    false_alarms: float
    log_odds: float
    motion: Tensor = field(default_factory=lambda: torch.zeros(4, 2).double())
    slips: Tensor = field(default_factory=lambda: torch.zeros(len(SLIPS)))
    spread: float = 0.1
    misses: int = 0
    unseen: int = 0
    doubts: int = 0

    @property
    def expected(self) -> Tensor:
        """Corners (4,2) px where its motion leads."""
        return self.corners + self.motion * self.unseen

    def follow(self, networks: Networks, frame: Frames, shape: PanelShape) -> bool:
        """Look in a frame where the motion leads, and say whether the panel is there."""
        self.misses += 1
        expected = self.expected
        around = Surroundings.of(networks, frame, expected, shape)
        corners, odds = around.place(expected)
        if odds < min(SETTINGS.clear_log_odds, self.log_odds - SETTINGS.fallen):
            other, others_odds = around.place(expected, wide=True)
            far = float((other - expected).mean(0).norm()) / around.pitch_px(expected)
            others_odds -= SETTINGS.per_cell * far
            if others_odds > odds:
                corners, odds = other, others_odds
        limits = corners.new_tensor(frame.grey.shape[:1:-1])
        inside = bool(((corners.mean(0) >= 0) & (corners.mean(0) <= limits)).all())
        if odds < LEAST_LOG_ODDS or not inside:
            return False
        place, shaped = parts(corners - expected)
        off = float(place.norm()) / around.pitch_px(expected)
        self.spread += SETTINGS.spread_learned * (off**2 - self.spread)
        gain = self.spread / (self.spread + SETTINGS.noise_cells2)
        corners = expected + gain * place + SETTINGS.shape_kept * shaped
        evidence = around.odds_of(corners, SLIPS)
        self.slips = (1 - SETTINGS.slip_forgotten) * self.slips + evidence
        slipped = int(self.slips.argmax())
        if self.slips[slipped] > self.slips[0] + SETTINGS.slip:
            corners = moved(corners, SLIPS[slipped, None, None], shape)[0]
            self.slips = torch.zeros(len(SLIPS))
        self.meet(corners, odds)
        return self.log_odds >= SETTINGS.least_log_odds

    def meet(self, corners: Tensor, odds: float) -> None:
        """Use corners (4,2) px as those of the panel in this frame."""
        place, shaped = parts(
            (corners - self.corners) / max(self.unseen, 1) - self.motion
        )
        self.motion = self.motion + SETTINGS.motion_learned * place
        self.motion = self.motion + SETTINGS.growth_learned * shaped
        self.log_odds += SETTINGS.odds_learned * (odds - self.log_odds)
        self.corners, self.misses, self.unseen = corners, 0, 0

    def lies_on(self, corners: Tensor) -> bool:
        """Whether a panel at corners (4,2) px would overlap it."""
        side = float(
            (corners[0] - corners[2]).norm() + (corners[1] - corners[3]).norm()
        )
        return float((self.expected.mean(0) - corners.mean(0)).norm()) < side / 6


@dataclass
class Tracker:
    """Follow panels from frame to frame of one recording.

    The whole frame is searched in the first frame, in each frame while no panel is followed, and every
    ``every`` frames. A search finds new panels and corrects the followed ones. A panel that is not found in
    ``patience`` frames is lost.

    Args:
        locator: locator of the full search. If it finds several panels all are followed, else the best one.
        shape: rows and columns.
        every: frames between full searches, at least 1.
        patience: most frames in which a followed panel may be missed.
        number: number of the next new panel.

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
        whole_number("follow.every", self.every, 1)
        whole_number("follow.patience", self.patience, 1)

    @property
    def networks(self) -> Networks:
        """The detector's networks: those of the locator if it is a detector."""
        return networks_of(self.locator, torch.device("cpu"))

    def __call__(
        self, frame: NDArray[np.uint8] | Tensor, passed: int = 1
    ) -> list[Track]:
        """Process the next frame (H,W) uint8 of the recording, and return its panels.

        Args:
            frame: the frame.
            passed: frames since the last processed one, more than 1 if frames were dropped.

        Raises:
            VoccError: no frame, several, or one of another type or with colours.
        """
        frames = Frames.of(frame, "frame")
        if len(frames) != 1:
            raise VoccError.of("frame", f"{len(frames)} frames", "one at a time, (H,W)")
        for track in self.tracks:
            track.unseen += passed
        with torch.inference_mode():
            return self._next(Frames.whole(frames.grey.cpu()))

    def _next(self, frame: Frames) -> list[Track]:
        """Follow in one frame, and search where it is due."""
        networks = self.networks
        followed = [
            track for track in self.tracks if track.follow(networks, frame, self.shape)
        ]
        visible = _apart(followed)
        self.tracks = [
            track
            for track in self.tracks
            if track in visible or 0 < track.misses <= self.patience
        ]
        self._since += 1
        missed = len(visible) < len(self.tracks) and self._since >= SETTINGS.soon
        if not visible or self._since >= self.every or missed:
            self._since, self.searches = 0, self.searches + 1
            met = [self._met(frame, *found) for found in self._found(frame)]
            for track in self.tracks:
                track.doubts = 0 if not met or track in met else track.doubts + 1
            self.tracks = [
                track for track in self.tracks if track.doubts <= SETTINGS.most_doubts
            ]
            visible = [
                track for track in self.tracks if track in visible or track in met
            ]
        return sorted(visible, key=lambda track: track.number)

    def panels(
        self, greys: Tensor, most: int = 1, passed: Sequence[int] = ()
    ) -> tuple[list[int], list[int], StatedPanels]:
        """Process the next frames (B,H,W) uint8 in order, and return up to ``most`` panels of each.

        Args:
            greys: the frames.
            most: most panels per frame.
            passed: for each frame, as in :meth:`__call__`; by default 1.

        Returns:
            For each panel the index of its frame and the number of its track, and the panels. In a frame the
            longest tracks come first. A frame without a panel has one entry that is not found. Score and
            false alarms are those of the last full search that accepted the panel.
        """
        none = Track(0, torch.zeros(4, 2).double(), 0.0, math.nan, 0.0)
        rows = []
        steps = passed or [1] * len(greys)
        for number, (plane, step) in enumerate(zip(greys, steps, strict=True)):
            tracks = self(plane, step)
            for track in tracks[:most] or [none]:
                row = (track.corners, bool(tracks), track.score, len(tracks))
                rows.append((number, track.number, *row, track.false_alarms))
        whose, numbers, corners, found, score, many, alarms = zip(*rows, strict=True)
        scores, stated = (torch.tensor(part).double() for part in (score, alarms))
        places = torch.stack(corners), torch.tensor(found)
        panels = StatedPanels(*places, scores, torch.tensor(many), stated)
        return list(whose), list(numbers), panels

    def _found(self, frame: Frames) -> Iterator[tuple[Tensor, float, float]]:
        """Search a whole frame: corners, score and false alarms of sure panels."""
        found = self.locator.locate(frame, self.shape)
        if not self.locator.finds_several:
            found = found[:1]
        found = sure_of(found, self.locator)
        pitch = torch.stack(cell_size_px(found.corners_px, self.shape)).amin(0)
        found = found[pitch >= SETTINGS.least_pitch_px]
        corners = found.corners_px.cpu().double()
        columns = corners, found.score.tolist(), found.false_alarms.tolist()
        yield from zip(*columns, strict=True)

    def _met(
        self, frame: Frames, corners: Tensor, score: float, alarms: float
    ) -> Track:
        """Correct the track that a search met, or begin one."""
        around = Surroundings.of(self.networks, frame, corners, self.shape)
        odds = float(around.odds_of(corners, SLIPS[:1]))
        if odds < LEAST_LOG_ODDS:
            other, others_odds = around.place(corners, wide=True)
            if others_odds > odds + SETTINGS.slip:
                corners, odds = other, others_odds
        near = [track for track in self.tracks if track.lies_on(corners)]
        if not near:
            track = Track(self.number, corners, score, alarms, odds)
            self.number += 1
            self.tracks.append(track)
            return track
        track, *_ = near
        track.score, track.false_alarms = score, alarms
        before = float(around.odds_of(track.corners, SLIPS[:1]))
        if track.misses or odds > before + SETTINGS.slip:
            track.slips = torch.zeros(len(SLIPS))
            track.meet(corners, odds)
        return track


def parts(moves: Tensor) -> tuple[Tensor, Tensor]:
    """Split the moves (4,2) of corners into the mean move (1,2) and the remainder."""
    place = moves.mean(0, keepdim=True)
    return place, moves - place


def _apart(tracks: list[Track]) -> list[Track]:
    """Leave of tracks that lie on one panel the one of the lowest number."""
    distinct: list[Track] = []
    for track in sorted(tracks, key=lambda track: (track.doubts, track.number)):
        if not any(other.lies_on(track.corners) for other in distinct):
            distinct.append(track)
    return distinct
