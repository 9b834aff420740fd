"""Panels whose corners are nearly known: their corners put right, and the log odds that they are there."""

from dataclasses import dataclass

import torch
from torch import Tensor

from vocc_torch.receiver.detector.judge import pitch_of
from vocc_torch.receiver.detector.pipeline import flattened
from vocc_torch.receiver.detector.placer import moved, placed
from vocc_torch.receiver.detector.pyramid import Pyramid
from vocc_torch.receiver.detector.weights import Networks
from vocc_torch.receiver.resample import cut_about
from vocc_torch.types import Frames, PanelShape


@dataclass(frozen=True)
class NearbySettings:
    """How far from known corners a panel is looked for."""

    margin_cells: float = 5.0  # of the crop around the corners
    looks: int = 2  # of the placer
    reach_cells: float = 1.2  # between starts of a wide search
    reaches: int = 2  # starts to either side


SETTINGS = NearbySettings()

LEAST_LOG_ODDS = 0.0
"""Log odds of a panel that is known to be near, below which it is not there."""


@dataclass(frozen=True)
class Surroundings:
    """A frame about some corners.

    Args:
        networks: of the detector.
        pyramid: of the crop.
        origin: (2,) px of the crop.
        shape: rows and columns of the panel.
    """

    networks: Networks
    pyramid: Pyramid
    origin: Tensor
    shape: PanelShape

    @classmethod
    def of(
        cls, networks: Networks, frame: Frames, corners: Tensor, shape: PanelShape
    ) -> "Surroundings":
        """Crop one frame about corners (4,2) px."""
        side = (corners.amax(0) - corners.amin(0)).amax()
        room = SETTINGS.margin_cells * side / min(shape.sides)
        crop = cut_about(frame, corners, room)
        return cls(networks, Pyramid.of(crop.grey), crop.origin_px[0], shape)

    def place(self, corners: Tensor, wide: bool = False) -> tuple[Tensor, float]:
        """Correct corners (4,2) px that are off by up to a cell, or by more in a wide search.

        Returns:
            (4,2) corners, and the log odds of a panel at the corners before the last correction.
        """
        starts = corners[None]
        if wide:
            reach = SETTINGS.reaches
            steps = torch.arange(-reach, reach + 1) * SETTINGS.reach_cells
            starts = moved(
                corners, torch.cartesian_prod(steps, steps)[:, None], self.shape
            )
        quads = starts - self.origin
        odds = quads.new_zeros(len(quads))
        for look in range(SETTINGS.looks):
            quads = flattened(quads, self.shape) if look else quads
            odds, quads = placed(self.networks.placer, self.pyramid, quads, self.shape)
        best = int(odds.argmax())
        return quads[best] + self.origin, float(odds[best])

    def pitch_px(self, corners: Tensor) -> float:
        """Give the mean distance of LEDs of a panel at corners (4,2) px."""
        return float(pitch_of(corners[None], self.shape))

    def odds_of(self, corners: Tensor, cells: Tensor) -> Tensor:
        """Give the log odds (n,) of a panel at corners (4,2) px moved by cells (n,2), across and down."""
        quads = moved(corners, cells[:, None], self.shape) - self.origin
        return placed(self.networks.placer, self.pyramid, quads, self.shape)[0]
