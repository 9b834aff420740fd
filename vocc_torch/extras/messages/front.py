"""From camera frames to soft values: the panel is followed, and read in every frame."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from vocc_torch.arrays import Bytes, Singles
from vocc_torch.receiver.calibration import APPEARANCE
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.receiver.resample import cell_size_px
from vocc_torch.receiver.tracker import Tracker
from vocc_torch.types import Frames, Panels


@dataclass(frozen=True)
class FrontSettings:
    """Where a panel is read, and when it moves."""

    remembered: int = 5  # places of the panel of which the middle one is taken
    moved_cells: float = 0.1  # from the first remembered look to the last, at least
    steady: float = (
        0.2  # least part of its share of the way in each step: errors go to and fro
    )
    around: float = 0.5  # share of the panel's extent that is read around it
    least_around_px: int = 16  # beyond that
    faded_share: float = 0.25  # of the usual contrast; a frame of less shows no panel
    typical: float = (
        4.0  # size of decided bits and of the median score without calibration
    )


SETTINGS = FrontSettings()


@dataclass(eq=False)
class Front:
    """Reads frame after frame of one recording.

    Args:
        receiver: decides the bits; its locator finds the panel.
        locate_every: look for the panel in each so manieth frame, and take the median of the last places in
            those between; at least 1.
        soft: ``calibrated`` (log-likelihood ratios), ``scores`` (the receiver's own, to a common scale) or
            ``hard`` (bits).
        follow: ``true``: the panel is followed from frame to frame; ``auto``: from where it is seen to move;
            ``false``: never.

    Attributes:
        found: frames in which the panel was looked for and found.
        looked: frames in which it was looked for.
        follows: whether the panel is followed from frame to frame.
    """

    receiver: Receiver
    locate_every: int = 8
    soft: str = "scores"
    follow: str = "auto"

    def __post_init__(self) -> None:
        """Begin before the panel is found."""
        self.auto = self.follow == "auto"
        self.follows = self.follow == "true"
        self.tracker = Tracker(self.receiver.locator, self.receiver.shape)
        self.found = self.looked = self.frames = 0
        self.corners_px: Tensor | None = None
        self._places: deque[Tensor] = deque(maxlen=SETTINGS.remembered)
        self._looks: deque[Tensor] = deque(maxlen=SETTINGS.remembered)
        self._contrast = self._size = 0.0

    def __call__(self, greys: Sequence[Bytes]) -> Singles:
        """Read B frames (H,W) of one size: log-likelihood ratios (B,R,C), zeros where no panel shows."""
        with torch.inference_mode():
            return self.read(*self.locate(greys))

    @property
    def led_pitch_px(self) -> float | None:
        """Pitch of the LEDs in the last located panel, along the shorter side of a cell."""
        if self.corners_px is None:
            return None
        sizes = cell_size_px(self.corners_px[None], self.receiver.shape)
        return float(torch.cat(sizes).amin())

    def read(self, frames: Frames, corners: Tensor) -> Singles:
        """Read soft values (B,R,C) of frames at corners (B,4,2), zeros where no panel shows."""
        known = Panels.known(corners.nan_to_num())
        shows = ~corners.isnan().flatten(1).any(dim=1)
        known.found.copy_(shows)
        decoded = self.receiver.forward(frames, known)
        contrast = decoded.appearance[:, APPEARANCE.index("contrast")]
        shows &= contrast >= SETTINGS.faded_share * self._contrast
        if bool(shows.any()):
            usual = float(contrast[shows].median())
            self._contrast = 0.5 * self._contrast + 0.5 * usual
            self._size = self._size or float(decoded.scores[shows].abs().median())
        if self.soft == "hard":
            llr = torch.where(decoded.bits, SETTINGS.typical, -SETTINGS.typical)
        elif self.soft == "scores" or self.receiver.calibration is None:
            llr = decoded.scores * (SETTINGS.typical / (self._size or 1.0))
        else:
            llr = decoded.llr
        return (llr * shows.view(-1, 1, 1)).float().cpu().numpy()

    def locate(self, greys: Sequence[Bytes]) -> tuple[Frames, Tensor]:
        """Give frames cropped to where the panel is, and its corners (B,4,2); no numbers where unknown."""
        corners = torch.stack([self._place(grey) for grey in greys])
        if self.auto and not self.follows and self._moves():
            self.follows, self.frames = True, self.frames - len(greys)
            self.tracker = Tracker(self.receiver.locator, self.receiver.shape)
            return self.locate(greys)
        # One window holds the panel in all frames; other pixels are never copied.
        known = corners.nan_to_num().flatten(0, 1)
        low, high = known.amin(dim=0), known.amax(dim=0)
        room = SETTINGS.around * (high - low).max() + SETTINGS.least_around_px
        begin = (low - room).clamp(min=0).long()
        (left, top), (right, bottom) = begin.tolist(), (high + room).long().tolist()
        planes = np.stack([grey[top:bottom, left:right] for grey in greys])[:, None]
        origin = begin.expand(len(greys), 2)
        frames = Frames(torch.from_numpy(planes), origin, greys[0].shape)
        return frames.to(self.receiver.device), corners.to(self.receiver.device)

    def _place(self, grey: Bytes) -> Tensor:
        """Give the panel's corners (4,2) in the next frame, no numbers where they are unknown."""
        due = self.frames % self.locate_every == 0
        self.frames += 1
        place = None
        if due or self.follows or len(self._places) < SETTINGS.remembered:
            tracks = self.tracker(grey)
            place = tracks[0].corners if tracks else None
            self.looked += 1
            self.found += place is not None
        if place is not None:
            self._places.append(place)
            self._looks += [place] * due
            steady = torch.stack([*self._places]).median(dim=0).values
            self.corners_px = place if self.follows else steady
        if self.corners_px is None or (self.follows and place is None):
            return torch.full((4, 2), torch.nan, dtype=torch.float64)
        return self.corners_px

    def _moves(self) -> bool:
        """Say whether the last looks saw the panel move."""
        if len(self._looks) < SETTINGS.remembered:
            return False
        looks = torch.stack([*self._looks])
        cell = float((looks[-1, 1] - looks[-1, 0]).norm()) / self.receiver.shape.columns
        way = (looks[-1] - looks[0]).flatten()
        share = looks.diff(dim=0).flatten(1) @ way / way.square().sum()
        steady = bool((share > SETTINGS.steady / (SETTINGS.remembered - 1)).all())
        # Half of the way of all four corners is that of one of them.
        return steady and float(way.norm()) / 2 > SETTINGS.moved_cells * cell
