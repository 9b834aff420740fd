"""What explains the frames of a recording: values of each frame and of all, drawn by the simulator itself."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from scipy import optimize
from scipy.spatial import cKDTree
from torch import Tensor

from vocc_torch.arrays import Bools, Floats, Integers
from vocc_torch.extras.calibrate.noise import Noise, expected, linear
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.simulation.effects.base import Context, Effect, Quantity
from vocc_torch.simulation.effects.view import Pose
from vocc_torch.simulation.simulator import Simulator
from vocc_torch.types import Scene

PLACED = ("x_px", "y_px", "log_pitch_px")
TURNED = ("yaw_deg", "pitch_deg", "roll_deg")
LEVELS = ("background", "off", "on")
SHARED = ("board", "gamma", "blur_px")

AMBIENT_LX = 1000.0


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


@dataclass(frozen=True)
class RecordingFit:
    """Values that explain a recording, and how well.

    By name they are the panel's centre on the sensor (px), the logarithm of the image of a pitch (px), its
    angles, and grey values, not clipped, of the background and of wide Off and On LEDs, (B,) each. All frames
    share the board's reflectance, the encoding and the blur's standard deviation, (1,).

    Args:
        camera: the camera; its gamma is not used.
        panel: the panel.
        origin_px: (B,2) int64, first pixel of each window of the sensor, x and y.
        grey: (B,H,W) measured in the windows.
        lit: (B,R*C) which LEDs are On.
        values: by name.
        corner_loss: of vignetting; None for none.
        noise: of the light.
        free: names of the values that were fitted.
        misfit: weighted sum of squared residuals, in units of the noise.
        scale: variance of the residuals over that of the noise.
        covariances: (3,P,P) of the fitted values as :attr:`vector`, by the curvature of the likelihood and by
            the scatter of its slopes between blocks and between frames (sandwiches); the widest counts.
    """

    camera: Camera
    panel: LedPanel
    origin_px: Tensor
    grey: Floats
    lit: Bools
    values: Mapping[str, Floats] = field(default_factory=dict)
    corner_loss: float | None = None
    noise: Noise = field(default_factory=Noise)
    free: tuple[str, ...] = ()
    misfit: float = math.inf
    scale: float = 1.0
    covariances: Floats = field(default_factory=lambda: np.zeros((3, 0, 0)))

    @property
    def gamma(self) -> float:
        """The gamma of the encoding."""
        return self.values["gamma"].item()

    @property
    def lights(self) -> Floats:
        """Light of background, Off and On, (3,B)."""
        return linear(np.stack([self.values[name] for name in LEVELS]), self.gamma)

    @property
    def distance_m(self) -> Floats:
        """Distances of the panels, (B,)."""
        pitch = self.camera.focal_length_px * self.panel.pitch_m
        return pitch * np.exp(-self.values["log_pitch_px"])

    @property
    def scene(self) -> Scene:
        """The scenes of the frames: where the panels are, with LEDs as bright as the background."""
        scale = self.distance_m / self.camera.focal_length_px
        x_m = (self.values["x_px"] - self.camera.width_px / 2) * scale
        y_m = (self.values["y_px"] - self.camera.height_px / 2) * scale
        luminance = AMBIENT_LX * self.panel.background_reflectance / np.pi
        rows = np.broadcast_arrays(
            AMBIENT_LX, luminance, self.distance_m, 1.0, x_m, y_m
        )
        return Scene(*map(torch.tensor, rows))

    @property
    def simulator(self) -> Simulator:
        """The simulator whose linear pictures have the background's light as 1."""
        angles = np.stack([self.values[name] for name in TURNED], axis=1)
        blur_px = self.values["blur_px"].item()
        effects: dict[str, Any] = {"blooming": {"sigma_px": blur_px}}
        if angles.any():
            effects["frame_pose"] = FramePose(torch.from_numpy(angles))
        if self.corner_loss is not None:
            effects["vignetting"] = {"corner_loss": self.corner_loss}
        panel = replace(self.panel, led_reflectance=self.panel.background_reflectance)
        if panel.board_reflectance is not None:
            panel = replace(panel, board_reflectance=self.values["board"].item())
        linear_camera = replace(self.camera, gamma=1.0, iso_limits=None)
        return Simulator(linear_camera, panel, effects, dtype=torch.float64)

    @property
    def first(self) -> "RecordingFit":
        """The first frame alone."""
        values = {name: value[:1] for name, value in self.values.items()}
        return replace(self, grey=self.grey[:1], lit=self.lit[:1], values=values)

    def light(self) -> Floats:
        """Draw linear light, of which 1 is encoded as 118, (B,H,W)."""
        background, off, on = self.lights[..., None]
        weights = torch.from_numpy(np.where(self.lit, on, off) / background - 1)
        leds = weights.view(-1, *self.panel.shape.sides)
        frames = self.simulator.render_window(
            self.scene, leds, self.origin_px, self.grey.shape[1:]
        )
        return np.asarray(background[..., None] * frames.grey[:, 0].numpy())

    def predicted(self) -> tuple[Floats, Floats]:
        """Mean and variance of the grey values, (B,H,W) each."""
        return expected(self.light(), self.gamma, self.noise)

    def nearest(self, leds: Integers) -> Integers:
        """Tell which of some LEDs lies nearest to each pixel, (B,H,W)."""
        at = self.simulator.led_centres_px(self.scene)
        pixels = np.indices(self.grey.shape[1:])[::-1].transpose(1, 2, 0) + 0.5
        places = (at - self.origin_px[:, None]).numpy()[:, leds]
        return np.stack([leds[cKDTree(place).query(pixels)[1]] for place in places])

    @property
    def by_frame(self) -> list[str]:
        """Names of the fitted values that each frame has by itself."""
        return [name for name in self.free if name not in SHARED]

    @property
    def shared(self) -> list[str]:
        """Names of the fitted values that all frames share."""
        return [name for name in self.free if name in SHARED]

    @property
    def names(self) -> list[str]:
        """The name of each of the P numbers that were fitted, each frame's in turn and then the shared ones."""
        return self.by_frame * len(self.lit) + self.shared

    @property
    def vector(self) -> Floats:
        """The numbers that were fitted, (P,)."""
        frames = np.stack([self.values[name] for name in self.by_frame], axis=1)
        return np.append(frames, [self.values[name] for name in self.shared])

    def set(self, **values: Floats | float) -> "RecordingFit":
        """Set values by name."""
        sized = {
            name: np.full(1 if name in SHARED else len(self.lit), value, np.float64)
            for name, value in values.items()
        }
        return replace(self, values={**self.values, **sized})

    def moved(self, vector: Floats) -> "RecordingFit":
        """Take the fitted values from a vector."""
        frames, shared = np.split(vector, [len(vector) - len(self.shared)])
        columns = [*frames.reshape(len(self.lit), -1).T, *shared]
        return self.set(**dict(zip(self.by_frame + self.shared, columns, strict=True)))

    def deviation(self, name: str) -> float:
        """Standard deviation of a value that all share; 0 where it was not fitted."""
        if name not in self.free:
            return 0.0
        at = self.names.index(name)
        return math.sqrt(self.covariances[:, at, at].max())

    def derived(self, of: "Of") -> tuple[Floats, Floats, float]:
        """Derive a value of every frame from the fitted ones, and how sure it is.

        Args:
            of: gives the value of every frame, (B,).

        Returns:
            the values (B,), their standard deviations (B,) but for what all frames have in common, and the
            standard deviation of that.
        """
        vector, frames = self.vector, len(self.lit)
        steps = 1e-6 * np.abs(vector).clip(min=1.0)
        slope = np.atleast_2d(
            optimize.approx_fprime(vector, lambda v: of(self.moved(v)), steps)
        )
        spreads = slope @ self.covariances @ slope.T
        spread = max(spreads, key=np.trace)
        pairs = (spread.sum() - spread.trace()) / max(frames * (frames - 1), 1)
        common, every = max(0.0, float(pairs)), spread.diagonal()
        deviation = np.sqrt((every - common).clip(min=1e-3 * every))
        return of(self), deviation, math.sqrt(common)


Of = Callable[[RecordingFit], Floats]
"""Makes a value of each frame, (B,)."""


def by_name(name: str) -> Of:
    """Give a value of each frame by its name."""
    return lambda fit: fit.values[name]
