"""The simulator's own drawing of a panel in a fixed window, in parts of which any light is made."""

from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from vocc_torch.arrays import Floats
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.view import Pose
from vocc_torch.simulation.simulator import Simulator
from vocc_torch.types import Scene

PLACED = ("x_px", "y_px", "log_pitch_px")
TURNED = ("yaw_deg", "pitch_deg", "roll_deg")
LEVELS = ("background", "off", "on", "board")
OF_FRAME = (*PLACED, *TURNED, *LEVELS)
"""What each frame has by itself: the panel's centre on the sensor (px), the
logarithm of the image of a pitch (px), its angles, and grey values, not clipped, of the background, of wide
Off and On LEDs and of the board."""

OF_ALL = ("gamma", "blur_px")
"""What all frames share: the encoding, and the blur's standard deviation."""

AMBIENT_LX = 1000.0


@dataclass(frozen=True)
class FramePose(Effect, on=Quantity.PLACEMENT):
    """The pose of each frame, where a scene has one distribution for all.

    Args:
        angles_deg: (B,3) yaw, pitch and roll as of :class:`Pose`.
    """

    name = "frame_pose"
    angles_deg: Tensor = field(default_factory=lambda: torch.zeros(1, 3))

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Turn each panel."""
        placements = zip(self.angles_deg.tolist(), value.unsqueeze(1), strict=True)
        return torch.cat(
            [
                Pose(*angles)(planes, context) if any(angles) else planes
                for angles, planes in placements
            ]
        )


@dataclass(frozen=True)
class LedWeights(Effect, on=Quantity.LED_LUMINANCE):
    """The share of On's own light that each LED has.

    Args:
        weights: (B,R,C).
    """

    name = "led_weights"
    weights: Tensor = field(default_factory=lambda: torch.ones(1, 1, 1))

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Scale the LEDs' light."""
        return value * self.weights


@dataclass(frozen=True)
class PanelDrawing:
    """Windows of the sensor, and what is known of camera and panel.

    Args:
        camera: the camera; its gamma is not used.
        panel: the panel.
        origin_px: (B,2) int64, first pixel of each window, x and y.
        size_px: height and width of the windows.
        corner_loss: of vignetting; None for none.
    """

    camera: Camera
    panel: LedPanel
    origin_px: Tensor
    size_px: tuple[int, int]
    corner_loss: float | None = None

    def taken(self, frames: slice) -> "PanelDrawing":
        """Take some frames."""
        return replace(self, origin_px=self.origin_px[frames])

    def simulator(
        self, by_frame: Floats, shared: Floats, weights: Floats | None = None
    ) -> Simulator:
        """Give the simulator whose linear pictures have the background's light as 1.

        Args:
            by_frame: (B,10) as :data:`OF_FRAME`.
            shared: (2,) as :data:`OF_ALL`.
            weights: (B,R*C) of the LEDs' own light, or None for all alike.
        """
        blur_px = float(shared[1])
        angles = by_frame[:, len(PLACED) : len(PLACED) + len(TURNED)]
        effects: dict[str, object] = {"blooming": {"sigma_px": blur_px}}
        if angles.any():
            effects["frame_pose"] = FramePose(torch.from_numpy(angles.copy()))
        if self.corner_loss is not None:
            effects["vignetting"] = {"corner_loss": self.corner_loss}
        if weights is not None:
            shape = len(by_frame), *self.panel.shape.sides
            effects["led_weights"] = LedWeights(torch.from_numpy(weights).view(shape))
        panel = replace(
            self.panel,
            led_reflectance=self.panel.background_reflectance,
            board_reflectance=None,
        )
        linear = replace(self.camera, gamma=1.0, iso_limits=None)
        return Simulator(linear, panel, effects, dtype=torch.float64)  # type: ignore[arg-type]

    def distance_m(self, by_frame: Floats) -> Floats:
        """Distances of the panels, (B,)."""
        away: Floats = (
            self.camera.focal_length_px * self.panel.pitch_m * np.exp(-by_frame[:, 2])
        )
        return away

    def scene(self, by_frame: Floats, luminance: float) -> Scene:
        """Give the scenes of frames: where the panels are."""
        away = self.distance_m(by_frame)
        sides = np.array([self.camera.width_px, self.camera.height_px])
        offsets = (
            (by_frame[:, :2] - sides / 2) * away[:, None] / self.camera.focal_length_px
        )
        columns = np.broadcast_arrays(AMBIENT_LX, luminance, away, 1.0, *offsets.T)
        return Scene(*map(torch.tensor, columns))

    def centres_px(self, by_frame: Floats, shared: Floats) -> Floats:
        """Centres of the LEDs in the windows, (B,R*C,2) px."""
        simulator = self.simulator(by_frame, shared)
        at = simulator.led_centres_px(self.scene(by_frame, 0.0))
        return (at - self.origin_px[:, None]).numpy()

    def cover(
        self, by_frame: Floats, shared: Floats, weights: Floats | None = None
    ) -> Floats:
        """Light that LEDs of luminance 1 add, as the lens spreads and dims it, (B,H,W).

        Args:
            by_frame: (B,10).
            shared: (2,).
            weights: (B,R*C), or None for all alike.
        """
        luminance = AMBIENT_LX * self.panel.background_reflectance / np.pi
        lit = self._linear(
            self.simulator(by_frame, shared, weights), by_frame, luminance
        )
        return lit - self.base(by_frame)

    def base(self, by_frame: Floats) -> Floats:
        """Light of a background of 1 without a panel, (B,H,W) or (B,1,1)."""
        if self.corner_loss is None:
            return np.ones((len(by_frame), 1, 1))
        still = np.ones(2)
        return self._linear(self.simulator(by_frame, still), by_frame, 0.0)

    def board(self, by_frame: Floats, shared: Floats) -> Floats:
        """Light that a board of luminance 1 adds, (B,H,W)."""
        simulator = self.simulator(by_frame, shared)
        shares = {"led_reflectance": 1.0, "board_reflectance": 1.0}
        white = replace(simulator.panel, **shares)  # type: ignore[arg-type]
        drawn = Simulator(
            simulator.camera, white, simulator.effects, dtype=torch.float64
        )
        excess = 1 / self.panel.background_reflectance - 1
        return (self._linear(drawn, by_frame, 0.0) - self.base(by_frame)) / excess

    def _linear(
        self, simulator: Simulator, by_frame: Floats, luminance: float
    ) -> Floats:
        """Render windows in linear light."""
        shape = self.panel.shape
        lit = torch.ones(len(by_frame), *shape.sides, dtype=torch.bool)
        frames = simulator.render_window(
            self.scene(by_frame, luminance), lit, self.origin_px, self.size_px
        )
        return frames.grey[:, 0].numpy()
