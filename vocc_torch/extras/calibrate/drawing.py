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
SHARED = ("gamma", "blur_px")
NAMES = (*PLACED, *TURNED, *LEVELS, *SHARED)
"""What a frame is made of: the panel's centre on the sensor (px), the logarithm of the image of a pitch (px),
its angles, and grey values, not clipped, of the background, of wide Off and On LEDs and of the board. All
frames share the encoding and the blur's standard deviation."""

COLUMN = {name: number for number, name in enumerate(NAMES)}

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
        self, table: Floats, weights: Floats | None = None, *, board: bool = False
    ) -> Simulator:
        """Give the simulator whose linear pictures have the background's light as 1.

        Args:
            table: (B,12) as :data:`NAMES`.
            weights: (B,R*C) of the LEDs' own light, or None for all alike.
            board: whether a white board with white LEDs is drawn.
        """
        angles = table[:, [COLUMN[name] for name in TURNED]]
        blur_px = float(table[0, COLUMN["blur_px"]])
        effects: dict[str, object] = {"blooming": {"sigma_px": blur_px}}
        if angles.any():
            effects["frame_pose"] = FramePose(torch.from_numpy(angles))
        if self.corner_loss is not None:
            effects["vignetting"] = {"corner_loss": self.corner_loss}
        if weights is not None:
            shape = len(table), *self.panel.shape.sides
            effects["led_weights"] = LedWeights(torch.from_numpy(weights).view(shape))
        panel = replace(
            self.panel,
            led_reflectance=1.0 if board else self.panel.background_reflectance,
            board_reflectance=1.0 if board else None,
        )
        linear = replace(self.camera, gamma=1.0, iso_limits=None)
        return Simulator(linear, panel, effects, dtype=torch.float64)  # type: ignore[arg-type]

    def distance_m(self, table: Floats) -> Floats:
        """Distances of the panels, (B,)."""
        pitch = self.camera.focal_length_px * self.panel.pitch_m
        return np.asarray(pitch * np.exp(-table[:, COLUMN["log_pitch_px"]]))

    def scene(self, table: Floats, luminance: float = 0.0) -> Scene:
        """Give the scenes of frames: where the panels are."""
        away = self.distance_m(table)
        sides = np.array([self.camera.width_px, self.camera.height_px])
        scale = away[:, None] / self.camera.focal_length_px
        offsets = (table[:, :2] - sides / 2) * scale
        columns = np.broadcast_arrays(AMBIENT_LX, luminance, away, 1.0, *offsets.T)
        return Scene(*map(torch.tensor, columns))

    def centres_px(self, table: Floats) -> Floats:
        """Centres of the LEDs in the windows, (B,R*C,2) px."""
        at = self.simulator(table).led_centres_px(self.scene(table))
        return (at - self.origin_px[:, None]).numpy()

    def cover(self, table: Floats, weights: Floats | None = None) -> Floats:
        """Light that LEDs of luminance 1 add, as the lens spreads and dims it, (B,H,W).

        Args:
            table: (B,12).
            weights: (B,R*C), or None for all alike.
        """
        luminance = AMBIENT_LX * self.panel.background_reflectance / np.pi
        lit = self._linear(self.simulator(table, weights), table, luminance)
        return lit - self.base(table)

    def base(self, table: Floats) -> Floats:
        """Light of a background of 1 without a panel, (B,H,W) or (B,1,1)."""
        if self.corner_loss is None:
            return np.ones((len(table), 1, 1))
        return self._linear(self.simulator(table), table)

    def board(self, table: Floats) -> Floats:
        """Light that a board of luminance 1 adds, (B,H,W)."""
        drawn = self._linear(self.simulator(table, board=True), table)
        excess = 1 / self.panel.background_reflectance - 1
        return (drawn - self.base(table)) / excess

    def _linear(
        self, simulator: Simulator, table: Floats, luminance: float = 0.0
    ) -> Floats:
        """Render windows in linear light."""
        lit = torch.ones(len(table), *self.panel.shape.sides, dtype=torch.bool)
        frames = simulator.render_window(
            self.scene(table, luminance), lit, self.origin_px, self.size_px
        )
        return frames.grey[:, 0].numpy()
