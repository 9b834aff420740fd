"""From camera frames to soft values: the panel is followed, and read in every frame."""

from collections import deque
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from vocc_torch.arrays import Singles
from vocc_torch.receiver.calibration import APPEARANCE
from vocc_torch.receiver.detector.nearby import LEAST_LOG_ODDS, Surroundings
from vocc_torch.receiver.locators.detector import networks_of
from vocc_torch.receiver.receiver import Decoded, Receiver
from vocc_torch.receiver.tracker import Tracker
from vocc_torch.recordings.frames import Grey
from vocc_torch.types import Frames, Panels

REMEMBERED = 5
"""Places of the panel of which the middle one is taken."""

MOVED_CELLS = 0.1
"""Corners of a panel that moves are farther than this from where the first of the remembered looks saw them."""

STEADY = 0.2
"""Least part of its share of the way that a corner goes in each step: errors of location go to and fro."""

CORNERS = 3
"""Corners that must move so: a single look that errs makes one step."""

WHOLE = 32
"""One look of so many is at the whole frame, the others are where the panel was last."""

AROUND = 0.5
"""Share of the panel's extent that is read around it."""

LEAST_AROUND_PX = 16
"""What is read beyond that."""

FADED_SHARE = 0.25
"""A frame whose contrast is less than this share of what is usual shows no panel."""

TYPICAL = 4.0
"""Size given to decided bits, and to the median of scores that nobody calibrated."""


class Front:
    """Reads frame after frame of one recording.

    Args:
        receiver: decides the bits; its locator finds the panel.
        locate_every: look for the panel in each so manieth frame, and take the median of the last places in
            those between; at least 1. Most looks are where it was last, and at the whole frame if it is not.
        soft: ``calibrated`` (log-likelihood ratios), ``scores`` (the receiver's own, to a common scale) or
            ``hard`` (bits).
        follow: ``true``: a tracker follows the panel from frame to frame; ``auto``: from where it is seen to
            move; ``false``: never.

    Attributes:
        found: frames in which the panel was looked for and found.
        looked: frames in which it was looked for.
    """

    def __init__(
        self,
        receiver: Receiver,
        locate_every: int = 8,
        soft: str = "scores",
        follow: str = "auto",
    ) -> None:
        self.receiver, self.locate_every, self.soft, self.auto = (
            receiver,
            locate_every,
            soft,
            follow == "auto",
        )
        self.tracker = (
            Tracker(receiver.locator, receiver.shape) if follow == "true" else None
        )
        self.found = self.looked = self.frames = 0
        self.corners_px: Tensor | None = None
        self._places: deque[Tensor] = deque(maxlen=REMEMBERED)
        self._looks: deque[Tensor] = deque(maxlen=REMEMBERED)
        self._contrast = self._size = 0.0
        self._placed = False  # whether the last search met what the placer knows

    def __call__(self, greys: Sequence[Grey]) -> Singles:
        """Read B frames (H,W) of one size: log-likelihood ratios (B,R,C), zeros where no panel shows."""
        with torch.inference_mode():
            return self.values(*self.read(*self.locate(greys)), self.soft)

    @property
    def led_pitch_px(self) -> float | None:
        """Distance of neighbouring LEDs where the panel was last seen, along its shorter cells."""
        if self.corners_px is None:
            return None
        width, height = (
            (self.corners_px[end] - self.corners_px[0]).norm() for end in (1, 3)
        )
        return min(
            float(width) / self.receiver.shape.columns,
            float(height) / self.receiver.shape.rows,
        )

    def read(self, frames: Frames, corners: Tensor) -> tuple[Decoded, Tensor]:
        """Read frames at corners (B,4,2), and say which of them show a panel, (B,)."""
        known = Panels.known(torch.nan_to_num(corners))
        located = ~corners.isnan().any(dim=2).any(dim=1)
        known.found.copy_(located)
        decoded = self.receiver.forward(frames, known)
        contrast = decoded.appearance[:, APPEARANCE.index("contrast")]
        located &= contrast >= FADED_SHARE * self._contrast
        if bool(located.any()):
            self._contrast = 0.5 * self._contrast + 0.5 * float(
                contrast[located].median()
            )
            self._size = self._size or float(decoded.scores[located].abs().median())
        return decoded, located

    def values(self, decoded: Decoded, located: Tensor, soft: str) -> Singles:
        """Give soft values (B,R,C) of frames that were read, zeros where no panel shows."""
        if soft == "hard":
            llr = torch.where(decoded.bits, TYPICAL, -TYPICAL)
        elif soft == "scores" or self.receiver.calibration is None:
            llr = decoded.scores * (TYPICAL / (self._size or 1.0))
        else:
            llr = decoded.llr
        return (llr * located.view(-1, 1, 1)).float().cpu().numpy()

    def locate(self, greys: Sequence[Grey]) -> tuple[Frames, Tensor]:
        """Give frames cropped to where the panel is, and its corners (B,4,2); no numbers where unknown."""
        first, self.frames, corners = self.frames, self.frames + len(greys), None
        if self.tracker is None:
            corners = self._looked_up(greys, first)
            if self.auto and self._moves():
                self.tracker = Tracker(self.receiver.locator, self.receiver.shape)
                corners = None
        if corners is None:
            corners = self._tracked(greys)
        return self._cropped(greys, corners), corners.to(self.receiver.device)

    def _cropped(self, greys: Sequence[Grey], corners: Tensor) -> Frames:
        """Crop frames to one window that holds the panel in all of them: the rest is never copied."""
        height, width = greys[0].shape
        known = corners[~corners.isnan().any(dim=2).any(dim=1)].flatten(0, 1)
        if not len(known):
            known = torch.zeros(1, 2, dtype=torch.float64)
        low, high = known.amin(dim=0), known.amax(dim=0)
        room = AROUND * (high - low).max() + LEAST_AROUND_PX
        left, top = (low - room).floor().int().clamp(min=0).tolist()
        right, bottom = (high + room).ceil().int().tolist()
        left, top = min(left, width - 1), min(top, height - 1)
        right = min(max(right, left + 1), width)
        bottom = min(max(bottom, top + 1), height)
        grey = torch.from_numpy(
            np.stack([grey[top:bottom, left:right] for grey in greys])
        )
        origin = torch.tensor([[left, top]]).expand(len(greys), 2)
        device = self.receiver.device
        return Frames(grey[:, None].to(device), origin.to(device), (height, width))

    def _tracked(self, greys: Sequence[Grey]) -> Tensor:
        """Follow the panel from frame to frame."""
        assert self.tracker is not None
        corners = torch.full((len(greys), 4, 2), torch.nan, dtype=torch.float64)
        for row, plane in enumerate(greys):
            searches, tracks = self.tracker.searches, self.tracker(np.asarray(plane))
            if tracks:
                corners[row] = self.corners_px = tracks[0].corners
            self.looked += self.tracker.searches - searches
            self.found += bool(tracks) and self.tracker.searches > searches
        return corners

    def _looked_up(self, greys: Sequence[Grey], first: int) -> Tensor:
        """Look for the panel now and then, and take the median place between."""
        due = [
            row for row in range(len(greys)) if (first + row) % self.locate_every == 0
        ]
        if self.corners_px is None:
            found = self._found(
                greys, sorted({*due, *range(min(REMEMBERED, len(greys)))})
            )
            # There is nothing to go by before the first place: each of those frames is searched.
            before = range(REMEMBERED, min(found, default=len(greys)))
            found |= self._found(greys, [row for row in before if row not in due])
        else:
            whole_frames = [
                row for row in due if (first + row) % (WHOLE * self.locate_every) == 0
            ]
            found = self._found(greys, whole_frames)
            others = [row for row in due if row not in whole_frames]
            found |= self._found_near(greys, others)
            found |= self._found(greys, [row for row in others if row not in found])
        corners = torch.full((len(greys), 4, 2), torch.nan, dtype=torch.float64)
        for row in range(len(greys)):
            if row in found:
                self._places.append(found[row])
                self._looks += [found[row]] * (row in due)
                self.corners_px = torch.stack([*self._places]).median(dim=0).values
            if self.corners_px is not None:
                corners[row] = self.corners_px
        return corners

    def _found(self, greys: Sequence[Grey], rows: list[int]) -> dict[int, Tensor]:
        """Look for the panel in some of the frames, and give the corners of those where it is found."""
        if not rows:
            return {}
        frames = Frames.of(
            torch.from_numpy(np.stack([np.asarray(greys[row]) for row in rows]))
        )
        frames = Frames.whole(frames.grey.to(self.receiver.device))
        panels = self.receiver.locator(frames, self.receiver.shape)
        places = zip(rows, panels.corners_px.cpu(), panels.found.tolist(), strict=True)
        found = {row: place.double() for row, place, is_found in places if is_found}
        self.looked += len(rows)
        self.found += len(found)
        for row, place in found.items():
            fitted, odds = self._placed_near(greys[row], place)
            self._placed = odds >= LEAST_LOG_ODDS
            if self._placed:
                found[row] = fitted
        return found

    def _placed_near(self, grey: Grey, corners: Tensor) -> tuple[Tensor, float]:
        """Put corners (4,2) right in a frame, and give the log odds of the panel."""
        plane = torch.from_numpy(np.asarray(grey).copy())
        networks = networks_of(self.receiver.locator, plane.device)
        near = Surroundings.of(networks, plane, corners, self.receiver.shape)
        return near.place(corners)

    def _found_near(self, greys: Sequence[Grey], rows: list[int]) -> dict[int, Tensor]:
        """Look for the panel where it was last, and give its corners where it is still."""
        found: dict[int, Tensor] = {}
        if not self._placed:
            return found
        places = deque(self._places, maxlen=REMEMBERED)
        for row in rows:
            # The last place follows a panel that moves; the median one does not stray in noise.
            starts = places[-1], torch.stack([*places]).median(dim=0).values
            fits = [self._placed_near(greys[row], start) for start in starts]
            corners, odds = max(fits, key=lambda fit: fit[1])
            if odds >= LEAST_LOG_ODDS:
                places.append(corners)
                found[row] = corners
        self.looked += len(found)
        self.found += len(found)
        return found

    def _moves(self) -> bool:
        """Say whether the last looks saw the panel move."""
        if len(self._looks) < REMEMBERED:
            return False
        looks = torch.stack([*self._looks])
        cell = float((looks[-1, 1] - looks[-1, 0]).norm()) / self.receiver.shape.columns
        way = looks[-1] - looks[0]
        share = (looks.diff(dim=0) * way).sum(dim=2) / way.square().sum(dim=1)
        steady = (share > STEADY / (REMEMBERED - 1)).all(dim=0)
        moved = (way.norm(dim=1) > MOVED_CELLS * cell) & steady
        return int(moved.sum()) >= CORNERS
