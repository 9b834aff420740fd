"""The simulator's own drawing of a panel in a fixed window."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from vocc_torch.arrays import Bools, Floats, Integers
from vocc_torch.extras.calibrate.noise import linear
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.view import Pose
from vocc_torch.simulation.simulator import Simulator
from vocc_torch.types import Scene

PLACED = ("x_px", "y_px", "log_pitch_px")
TURNED = ("yaw_deg", "pitch_deg", "roll_deg")
LEVELS = ("background", "off", "on")
SHARED = ("board", "gamma", "blur_px")
NAMES = (*PLACED, *TURNED, *LEVELS, *SHARED)
"""What a frame is made of: the panel's centre on the sensor (px), the logarithm of the image of a pitch (px),
its angles, and grey values, not clipped, of the background and of wide Off and On LEDs. All frames share the
board's reflectance, the encoding and the blur's standard deviation."""

COLUMN = {name: number for number, name in enumerate(NAMES)}

AMBIENT_LX = 1000.0


def columns(*names: str) -> list[int]:
    """Give the columns of values."""
    return [COLUMN[name] for name in names]


def lights(table: Floats) -> Floats:
    """Light of background, Off and On, (3,B)."""
    return linear(table[:, columns(*LEVELS)], table[0, COLUMN["gamma"]]).T


class FramePose(Effect, on=Quantity.PLACEMENT):
    """The pose of each frame, where a scene has one distribution for all.

    Args:
        angles_deg: (B,3) yaw, pitch and roll as of :class:`Pose`.
    """

    name = "frame_pose"
    angles_deg: Tensor

    def __call__(self, value: Tensor, context: Context) -> Tensor:
        """Turn each panel."""
        placements = zip(self.angles_deg.tolist(), value.unsqueeze(1), strict=True)
        return torch.cat(
            [
                Pose(*angles)(planes, context) if any(angles) else planes
                for angles, planes in placements
            ]
        )


class LedWeights(Effect, on=Quantity.LED_LUMINANCE):
    """The light that each LED adds to the background's, in units of it.

    Args:
        weights: (B,R,C).
    """

    name = "led_weights"
    weights: Tensor

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

    def simulator(self, table: Floats, weights: Floats) -> Simulator:
        """Give the simulator whose linear pictures have the background's light as 1.

        Args:
            table: (B,12) as :data:`NAMES`.
            weights: (B,R*C) light that each LED adds.
        """
        angles = table[:, columns(*TURNED)]
        board, _, blur_px = table[0, columns(*SHARED)].tolist()
        shape = len(table), *self.panel.shape.sides
        effects = {
            "blooming": {"sigma_px": blur_px},
            "led_weights": LedWeights(torch.from_numpy(weights).view(shape)),
        }
        if angles.any():
            effects["frame_pose"] = FramePose(torch.from_numpy(angles))
        if self.corner_loss is not None:
            effects["vignetting"] = {"corner_loss": self.corner_loss}
        panel = replace(
            self.panel,
            led_reflectance=self.panel.background_reflectance,
            board_reflectance=None if self.panel.board_reflectance is None else board,
        )
        linear_camera = replace(self.camera, gamma=1.0, iso_limits=None)
        return Simulator(linear_camera, panel, effects, dtype=torch.float64)  # type: ignore[arg-type]

    def distance_m(self, table: Floats) -> Floats:
        """Distances of the panels, (B,)."""
        pitch = self.camera.focal_length_px * self.panel.pitch_m
        return pitch * np.exp(-table[:, COLUMN["log_pitch_px"]])

    def scene(self, table: Floats) -> Scene:
        """Give the scenes of frames: where the panels are, with LEDs as bright as the background."""
        away = self.distance_m(table)
        sides = np.array([self.camera.width_px, self.camera.height_px])
        scale = away[:, None] / self.camera.focal_length_px
        offsets = (table[:, :2] - sides / 2) * scale
        luminance = AMBIENT_LX * self.panel.background_reflectance / np.pi
        rows = np.broadcast_arrays(AMBIENT_LX, luminance, away, 1.0, *offsets.T)
        return Scene(*map(torch.tensor, rows))

    def nearest(self, table: Floats, leds: Integers) -> Integers:
        """Tell which of some LEDs lies nearest to each pixel, (B,H,W)."""
        weights = np.ones((len(table), self.panel.shape.leds))
        at = self.simulator(table, weights).led_centres_px(self.scene(table))
        pixels = np.indices(self.size_px)[::-1].transpose(1, 2, 0) + 0.5
        places = (at - self.origin_px[:, None]).numpy()[:, leds]
        return np.stack([leds[cKDTree(place).query(pixels)[1]] for place in places])

    def light(self, table: Floats, lit: Bools) -> Floats:
        """Draw linear light, of which 1 is encoded as 118, (B,H,W).

        Args:
            table: (B,12) as :data:`NAMES`.
            lit: (B,R*C) which LEDs are On.
        """
        background, off, on = lights(table)[..., None]
        weights = np.where(lit, on, off) / background - 1
        every = torch.ones(len(table), *self.panel.shape.sides, dtype=torch.bool)
        frames = self.simulator(table, weights).render_window(
            self.scene(table), every, self.origin_px, self.size_px
        )
        return np.asarray(background[..., None] * frames.grey[:, 0].numpy())
