"""The light that each LED adds to each pixel, as the simulator renders it.

Before gamma encoding, clipping and rounding the exposure of a pixel is an affine function of the bits.
"""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from vocc_torch.measure.genie.likelihood import PixelModel, UnknownLikelihoodError, sensor_noise
from vocc_torch.simulation import Simulator
from vocc_torch.simulation.effects import Context, Effect, Parameters
from vocc_torch.simulation.effects.coding import Quantization
from vocc_torch.simulation.effects.view import led_centres_m
from vocc_torch.simulation.photometry import MIDDLE_GREY
from vocc_torch.types import Frames, PanelShape, Scene

AFFINE = (
    *("lens_distortion", "attenuation", "airlight", "veiling_glare", "motion_blur", "defocus", "diffraction"),
    *("blooming", "vignetting", "bayer", "photoelectrons", "dark_current", "gain"),
)
"""Effects that leave the exposure an affine function of the bits."""

NOISE = ("prnu", "shot_noise", "dsnu", "read_noise")
"""Effects that add independent noise to each pixel, of known variance."""

CODING = ("full_well", "saturation", "quantization")
"""Effects that clip and round."""

SLACK = 5e-5
"""Digital numbers by which single precision may move a value before it is rounded."""

Window = tuple[slice, slice]


def overlap(mine: Frames, theirs: Frames) -> tuple[Window, Window]:
    """Find what two pictures of one frame both show: its rows and columns in each picture.

    Example:
        >>> picture = torch.zeros(1, 1, 4, 4)
        >>> here, there = (Frames(picture, torch.tensor([[x, 0]]), (9, 9)) for x in (2, 3))
        >>> overlap(here, there)[0]
        (slice(0, 4, None), slice(1, 4, None))
    """
    x, y = (theirs.origin_px[0].cpu() - mine.origin_px[0].cpu()).tolist()
    sizes = zip(mine.grey.shape[-2:], theirs.grey.shape[-2:], (y, x), strict=True)
    (rows, their_rows), (columns, their_columns) = (clipped(at, theirs, mine) for mine, theirs, at in sizes)
    return (rows, columns), (their_rows, their_columns)


def clipped(start: int, length: int, size: int) -> tuple[slice, slice]:
    """Cut ``length`` places from ``start`` on to those within ``size``: slices of the whole and of the part.

    Example:
        >>> clipped(-2, 5, 10)
        (slice(0, 3, None), slice(2, 5, None))
    """
    low, high = min(max(start, 0), size), max(min(start + length, size), 0)
    return slice(low, max(low, high)), slice(low - start, max(low, high) - start)


class ForwardModel:
    """The forward model of a frame's pixels, which the genie knows and no receiver does.

    Args:
        simulator: renders the frames.

    Raises:
        UnknownLikelihoodError: an effect whose likelihood is not known, by name, or frames that are not
            quantised.

    Example:
        >>> simulator, scene = Simulator(), Scene.of(distance_m=50.0)
        >>> frames = simulator.render(scene, torch.ones(1, 8, 8, dtype=torch.bool))
        >>> model = ForwardModel(simulator).pixels(frames, scene)
        >>> float(model.misfit(model.exposure(torch.ones(64))).sum())
        0.0
    """

    def __init__(self, simulator: Simulator) -> None:
        self.camera, self.panel, self.effects = simulator.camera, simulator.panel, simulator.effects
        known = (*AFFINE, *NOISE, *CODING)
        if others := [f"scene.effects.{one.name}" for one in self.effects if one.name not in known]:
            raise UnknownLikelihoodError(
                f"the genie knows no likelihood for {', '.join(others)}: known are {', '.join(known)}"
            )
        coding = next((effect for effect in self.effects if isinstance(effect, Quantization)), None)
        if coding is None:
            raise UnknownLikelihoodError("the genie reads digital numbers: name scene.effects.quantization")
        self._half_step = 127.5 / (coding.levels - 1)
        kept = {effect.name: _parameters(effect) for effect in self.effects if effect.name in AFFINE}
        # Each LED is rendered as a panel of one LED at its place: small pictures, not the whole panel's.
        # Off, it is as grey as what lies behind it.
        grey = simulator.panel.background_reflectance
        single = dataclasses.replace(
            simulator.panel, shape=PanelShape(1, 1), led_reflectance=grey, board_reflectance=None
        )
        self._whole, self._led = (
            Simulator(self.camera, panel, kept, device=simulator.device, dtype=torch.float64)
            for panel in (simulator.panel, single)
        )

    def pixels(self, frame: Frames, scene: Scene) -> PixelModel:
        """Model the pixels of one frame that any LED's light reaches.

        Args:
            frame: one frame, whole, crop or window.
            scene: its scene.

        Returns:
            The model, on the CPU.

        Raises:
            UnknownLikelihoodError: pixels that are full before they are white.
        """
        context = Context(scene, self.camera, effects=self._whole.effects, panel=self.panel)
        noise = sensor_noise(self.effects, context)
        none = torch.zeros(1, self.panel.shape.rows, self.panel.shape.columns, dtype=torch.bool)
        unlit = self._whole.render(scene, none, panel_only=True)
        mine, theirs = overlap(unlit, frame)
        light = self._light(scene, unlit)[(slice(None), *mine)].flatten(1)
        reached = (light > 0).any(0)
        base = self._exposure(unlit.grey[0, 0])[mine].flatten()[reached]
        grey = frame.grey[0, 0][theirs].flatten().to("cpu", torch.float64)[reached]
        sides = (grey - self._half_step).clamp(min=0), grey + self._half_step, grey
        low, high, centre = (self._exposure(side) for side in sides)
        open_low, open_high = low.masked_fill(grey <= 0, -torch.inf), high.masked_fill(grey >= 255, torch.inf)
        slack = (high - low) * (SLACK / (2 * self._half_step))
        return PixelModel(base, light[:, reached], open_low, open_high, centre, high - low, slack, noise)

    def _exposure(self, grey: Tensor) -> Tensor:
        """Undo gamma encoding (Eq. 1): relative exposure, on the CPU."""
        return (grey.to("cpu") / MIDDLE_GREY) ** self.camera.gamma

    def _light(self, scene: Scene, whole: Frames) -> Tensor:
        """Render what each LED adds to the pixels of a picture, (N,H,W)."""
        at = led_centres_m(self.panel).to(scene.distance_m)
        leds = Scene(*(getattr(scene, field.name).expand(len(at)) for field in dataclasses.fields(Scene)))
        x, y = (offset + own for offset, own in zip((leds.offset_x_m, leds.offset_y_m), at.T, strict=True))
        leds = dataclasses.replace(leds, offset_x_m=x, offset_y_m=y)
        on = torch.ones(len(at), 1, 1, dtype=torch.bool)
        lit = self._led.render(leds, on, panel_only=True)
        alike = slice(0, None if any(effect.fills_sensor for effect in self._led.effects) else 1)
        without = self._exposure(self._led.render(leds[alike], ~on[alike], panel_only=True).grey[:, 0])
        added = self._exposure(lit.grey[:, 0]) - without
        # Gamma and back leave rounding where an LED adds nothing.
        added = torch.where(added > 1e-12 * without, added, 0.0)
        light = added.new_zeros(len(at), *whole.grey.shape[-2:])
        for led, (left, top) in enumerate((lit.origin_px - whole.origin_px).tolist()):
            rows, own_rows = clipped(top, added.shape[-2], light.shape[-2])
            columns, own_columns = clipped(left, added.shape[-1], light.shape[-1])
            light[led, rows, columns] = added[led, own_rows, own_columns]
        return light


def _parameters(effect: Effect) -> Parameters:
    """Read the parameters of an effect back, as they were given."""
    assert dataclasses.is_dataclass(effect)
    given = {f.name: getattr(effect, f.name) for f in dataclasses.fields(effect) if f.init}
    # A parameter that may be left out is None where it was.
    return {name: value for name, value in given.items() if value is not None}
