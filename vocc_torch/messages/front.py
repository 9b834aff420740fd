"""From camera frames to soft values: the panel is followed, and read in every frame."""

from collections import deque

import numpy as np
import torch
from numpy.typing import NDArray

from vocc_torch.receiver.calibration import APPEARANCE
from vocc_torch.receiver.receiver import Decoded, Receiver
from vocc_torch.receiver.track import Tracker
from vocc_torch.types import Frames, Panels

REMEMBERED = 5
"""Places of the panel of which the middle one is taken."""

MOVED_CELLS, STRAIGHT, CORNERS = 0.2, 0.4, 3
"""A panel moves of which so many corners are farther than that from where the first of the remembered looks
saw them, and have gone there on a way of which so much is straight: errors of location go to and fro."""

FADED_SHARE = 0.25
"""A frame whose contrast is less than this share of what is usual shows no panel."""

TYPICAL = 4.0
"""Size given to decided bits, and to the median of scores that nobody calibrated."""


class Front:
    """Reads frame after frame of one recording.

    Args:
        receiver: decides the bits; its locator finds the panel.
        locate_every: look for the panel in each so manieth frame, and take the median of the last places in
            those between; at least 1.
        soft: ``calibrated`` (log-likelihood ratios), ``scores`` (the receiver's own, to a common scale) or
            ``hard`` (bits).
        follow: ``true``: a tracker follows the panel from frame to frame; ``auto``: from where it is seen to
            move; ``false``: never.

    Attributes:
        found: frames in which the panel was looked for and found.
        looked: frames in which it was looked for.
    """

    def __init__(
        self, receiver: Receiver, locate_every: int = 8, soft: str = "scores", follow: str = "auto"
    ) -> None:
        self.receiver, self.locate_every, self.soft, self.auto = (
            receiver,
            locate_every,
            soft,
            follow == "auto",
        )
        self.tracker = Tracker(receiver.locator, receiver.shape) if follow == "true" else None
        self.found = self.looked = self.frames = 0
        self.corners_px: torch.Tensor | None = None
        self._places: deque[torch.Tensor] = deque(maxlen=REMEMBERED)
        self._looks: deque[torch.Tensor] = deque(maxlen=REMEMBERED)
        self._contrast = self._size = 0.0

    def __call__(self, greys: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Read B frames of one size, (B,H,W): log-likelihood ratios (B,R,C), zeros where no panel shows."""
        with torch.inference_mode():
            return self.values(*self.read(*self.locate(greys)), self.soft)

    def read(self, frames: Frames, corners: torch.Tensor) -> tuple[Decoded, torch.Tensor]:
        """Read frames at corners (B,4,2), and say which of them show a panel, (B,)."""
        known = Panels.known(torch.nan_to_num(corners))
        there = ~corners.isnan().any(dim=2).any(dim=1)
        known.found.copy_(there)
        decoded = self.receiver.forward(frames, known)
        contrast = decoded.appearance[:, APPEARANCE.index("contrast")]
        there &= contrast >= FADED_SHARE * self._contrast
        if bool(there.any()):
            self._contrast = 0.5 * self._contrast + 0.5 * float(contrast[there].median())
            self._size = self._size or float(decoded.scores[there].abs().median())
        return decoded, there

    def values(self, decoded: Decoded, there: torch.Tensor, soft: str) -> NDArray[np.float32]:
        """Give soft values (B,R,C) of frames that were read, zeros where no panel shows."""
        if soft == "hard":
            llr = torch.where(decoded.bits, TYPICAL, -TYPICAL)
        elif soft == "scores" or self.receiver.calibration is None:
            llr = decoded.scores * (TYPICAL / (self._size or 1.0))
        else:
            llr = decoded.llr
        given: NDArray[np.float32] = (llr * there.view(-1, 1, 1)).float().cpu().numpy()
        return given

    def locate(self, greys: NDArray[np.uint8]) -> tuple[Frames, torch.Tensor]:
        """Give frames, and the corners (B,4,2) in each; no numbers where the panel is not known."""
        frames = Frames.of(torch.from_numpy(greys).to(self.receiver.device))
        first, self.frames = self.frames, self.frames + len(frames)
        if self.tracker is None:
            corners = self._looked_up(frames, first)
            if not (self.auto and self._moves()):
                return frames, corners
            self.tracker = Tracker(self.receiver.locator, self.receiver.shape)
        searches, panels = self.tracker.searches, self.tracker.panels(frames.grey[:, 0])
        self.looked += self.tracker.searches - searches
        self.found += min(self.tracker.searches - searches, int(panels.found.sum()))
        lost = ~panels.found.view(-1, 1, 1)
        return frames, panels.corners_px.to(frames.grey.device).double().masked_fill(lost, torch.nan)

    def _looked_up(self, frames: Frames, first: int) -> torch.Tensor:
        """Look for the panel now and then, and take the median place between."""
        looked = torch.arange(first, first + len(frames)) % self.locate_every == 0
        due = looked.clone()
        corners = torch.full((len(frames), 4, 2), torch.nan, dtype=torch.float64, device=frames.grey.device)
        if not self._places:
            looked |= True
        rows = looked.nonzero()[:, 0]
        panels = self.receiver.locator(frames[rows], self.receiver.shape)
        self.looked += len(rows)
        self.found += int(panels.found.sum())
        at = dict(zip(rows.tolist(), range(len(rows)), strict=True))
        for row in range(len(frames)):
            if row in at and bool(panels.found[at[row]]):
                self._places.append(panels.corners_px[at[row]])
                self._looks += [self._places[-1]] * bool(due[row])
                self.corners_px = torch.stack([*self._places]).median(dim=0).values
            if self.corners_px is not None:
                corners[row] = self.corners_px
        return corners

    def _moves(self) -> bool:
        """Say whether the last looks saw the panel move."""
        if len(self._looks) < REMEMBERED:
            return False
        seen = torch.stack([*self._looks])
        cell = float((seen[-1, 1] - seen[-1, 0]).norm()) / self.receiver.shape.columns
        way, net = seen.diff(dim=0).norm(dim=2).sum(dim=0), (seen[-1] - seen[0]).norm(dim=1)
        return int(((net > MOVED_CELLS * cell) & (net > STRAIGHT * way)).sum()) >= CORNERS
