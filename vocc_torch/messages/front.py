"""From camera frames to soft values: the panel is looked for now and then, and read in every frame."""

from collections import deque

import numpy as np
import torch
from numpy.typing import NDArray

from vocc_torch.receiver.calibration import APPEARANCE
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.types import Frames, Panels

REMEMBERED = 5
"""Places of the panel of which the middle one is taken."""

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

    Attributes:
        found: frames in which the panel was looked for and found.
        looked: frames in which it was looked for.
    """

    def __init__(self, receiver: Receiver, locate_every: int = 8, soft: str = "calibrated") -> None:
        self.receiver, self.locate_every, self.soft = receiver, locate_every, soft
        self.found = self.looked = self.frames = 0
        self.corners_px: torch.Tensor | None = None
        self._places: deque[torch.Tensor] = deque(maxlen=REMEMBERED)
        self._contrast = self._size = 0.0

    def __call__(self, greys: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Read B frames of one size, (B,H,W): log-likelihood ratios (B,R,C), zeros where no panel shows."""
        with torch.inference_mode():
            frames = Frames.of(torch.from_numpy(greys).to(self.receiver.device))
            corners = self._follow(frames)
            known = Panels.known(torch.nan_to_num(corners))
            there = ~corners.isnan().any(dim=2).any(dim=1)
            known.found.copy_(there)
            decoded = self.receiver.forward(frames, known)
            contrast = decoded.appearance[:, APPEARANCE.index("contrast")]
            there &= contrast >= FADED_SHARE * self._contrast
            if bool(there.any()):
                self._contrast = 0.5 * self._contrast + 0.5 * float(contrast[there].median())
            llr = torch.where(decoded.bits, TYPICAL, -TYPICAL) if self.soft == "hard" else decoded.llr
            if self.soft != "hard" and (self.soft == "scores" or self.receiver.calibration is None):
                size = float(decoded.scores[there].abs().median()) if bool(there.any()) else 0.0
                self._size = self._size or size
                llr = decoded.scores * (TYPICAL / (self._size or 1.0))
            given: NDArray[np.float32] = (llr * there.view(-1, 1, 1)).float().cpu().numpy()
        return given

    def _follow(self, frames: Frames) -> torch.Tensor:
        """Give the corners (B,4,2) in each frame; no numbers before the panel was ever found."""
        every = torch.arange(self.frames, self.frames + len(frames))
        looked = every % self.locate_every == 0
        self.frames += len(frames)
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
                self.corners_px = torch.stack([*self._places]).median(dim=0).values
            if self.corners_px is not None:
                corners[row] = self.corners_px
        return corners
