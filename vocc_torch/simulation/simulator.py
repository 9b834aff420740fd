"""The simulator: bits and scenes in, camera frames out, with the named effects and no others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal, get_args

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.rng import FrameKey
from vocc_torch.simulation import framing as crops
from vocc_torch.simulation import photometry
from vocc_torch.simulation.effects import (
    CAMERA_STEPS,
    Context,
    Effect,
    Parameters,
    Quantity,
    build_effects,
    check_chain,
)
from vocc_torch.simulation.effects.light import RollingShutter
from vocc_torch.simulation.effects.view import panel_corners_m, view_of
from vocc_torch.simulation.painter import in_perspective, paint, taking
from vocc_torch.simulation.photometry import grey_value, through_lens
from vocc_torch.types import Frames, Panels, Scene, resolve_device

PAPER_EFFECTS: Mapping[str, Mapping[str, float]] = {
    "attenuation": {"visibility_m": 40_000.0},
    "blooming": {"sigma_px": 1.5},
    "saturation": {},
    "quantization": {"bits": 8},
}
"""The effects of the paper's scenes."""

Framing = Literal["crop", "filled", "full"]

DRAWN = CAMERA_STEPS[: CAMERA_STEPS.index(Quantity.LUMINANCE)]
"""What effects change while the picture is drawn, before luminance reaches the lens."""

Seen = tuple[Tensor, Quantity]
"""Pictures on their way through the camera, (B,1,H,W), and what their numbers mean."""

CHUNK_PIXELS = 600_000
"""Pixels rendered at a time: planes that outgrow the cache are slower, from 32 MiB on several times."""


class Simulator:
    """Render LED-panel frames from physics.

    Args:
        camera: the camera; by default the paper's.
        panel: the LED panel; by default the paper's.
        effects: effect name to parameters; by default the paper's. What is not named is never built.
        framing: ``crop`` renders the panel's surroundings only and states the uniform rest as a grey value;
            ``filled`` lays that crop into a full frame of that grey value; ``full`` renders the whole sensor.
            All three give the same pixels, once quantised to the last bit; an effect that fills the sensor
            makes every framing ``full``.
        device: where the tensors live.
        dtype: working precision, ``torch.float32`` or ``torch.float64``.

    Raises:
        VoccError: an unknown framing, effect or device, or a precision that is not offered.

    Example:
        >>> simulator = Simulator()
        >>> scene = Scene.of(frames=3, distance_m=50.0)
        >>> frames = simulator.render(scene, torch.ones(3, 8, 8, dtype=torch.bool))
        >>> frames.grey.dtype, int(frames.grey.max()), frames.surround.tolist()
        (torch.uint8, 166, [102, 102, 102])
    """

    def __init__(
        self,
        camera: Camera | None = None,
        panel: LedPanel | None = None,
        effects: Mapping[str, Parameters] | None = None,
        *,
        framing: Framing = "crop",
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> None:
        """Build the named effects and no others."""
        if framing not in get_args(Framing):
            raise VoccError(f"framing is {framing!r}: it must be one of {', '.join(get_args(Framing))}")
        if dtype not in (torch.float32, torch.float64):
            raise VoccError(f"dtype is {dtype}: it must be torch.float32 or torch.float64")
        self.camera = camera or Camera()
        self.panel = panel or LedPanel()
        self.effects: tuple[Effect, ...] = build_effects(PAPER_EFFECTS if effects is None else effects)
        self.output = check_chain(self.effects)
        self.framing: Framing = framing
        self.device = resolve_device(str(device))
        self.dtype = dtype
        self._filling = next((effect for effect in self.effects if effect.fills_sensor), None)

    def true_panels(self, scene: Scene, keys: Sequence[FrameKey] = (), *, rendered: bool = False) -> Panels:
        """Where panels truly are, for evaluation; ``keys`` as for render, which checked if ``rendered``."""
        scene = scene.to(self.device) if rendered else self._checked(scene)
        if not in_perspective(self.effects):
            return Panels.known(crops.panel_corners_px(scene, self.camera, self.panel))
        view = view_of(self._context(scene, keys))
        return Panels.known(view.points_px(panel_corners_m(self.panel)))

    def contrast(self, scene: Scene) -> Tensor:
        """Contrast ``(G_on - G_off) / 255`` of the LEDs before any blur (section IV-D-1), (B,) float64.

        Both greys are clipped at white where the scene names saturation. What a sensor clips or adds
        (``full_well``, ``dark_current``) is not in it. LEDs without light of their own have contrast 0.
        """
        scene = self._checked(scene)
        context, light = self._context(scene), scene.led_luminance_cd_m2.view(-1, 1, 1)
        for effect in taking(self.effects, Quantity.LED_LUMINANCE):
            light = light if effect.sampled else effect(light, context)
        off, iso = (
            photometry.reflected_luminance_cd_m2(scene.ambient_lx, self.panel.led_reflectance),
            photometry.auto_iso(context),
        )
        seen = (photometry.as_seen(off, context, own) for own in (light.view(-1), torch.zeros_like(off)))
        exposures = (through_lens(luminance, self.camera) for luminance in seen)
        greys = [grey_value(exposure, iso, gamma=self.camera.gamma) for exposure in exposures]
        if self.output in (Quantity.BOUNDED_GREY, Quantity.DIGITAL):
            greys = [grey.clamp(max=255.0) for grey in greys]
        return (greys[0] - greys[1]) / 255.0

    def crop_px(self, nearest_m: float) -> tuple[int, int]:
        """Height and width of the crop for panels at ``nearest_m`` or farther."""
        return crops.crop_size_px(self.effects, self.camera, self.panel, nearest_m)

    def render(
        self,
        scene: Scene,
        bits: Tensor,
        *,
        nearest_m: float | None = None,
        keys: Sequence[FrameKey] = (),
        panel_only: bool = False,
    ) -> Frames:
        """Render a frame for each scene; a panel that lies outside the sensor, or in part, is cut there.

        Args:
            scene: B scenes, at least 1.
            bits: (B,R,C) bool, True = On.
            nearest_m: the distance that fixes the crop's size, at most the nearest of this batch, which is
                the default. Give it where batches of one study must have one size.
            keys: a key a frame, for effects that draw random numbers; not needed without such effects.
            panel_only: leave out what lies far from the panel even where an effect fills the sensor: enough,
                and many times faster, for a receiver that knows the corners.

        Returns:
            B frames or crops, as the framing says.

        Raises:
            VoccError: bits of another type or of another shape than the scenes and the panel, scenes out of
                their range, a crop too small for a panel, a panel too near, or frames of too many pixels.
        """
        wanted = (len(scene), self.panel.shape.rows, self.panel.shape.columns)
        if tuple(bits.shape) != wanted:
            raise VoccError(f"bits has shape {tuple(bits.shape)}: it must be {wanted}")
        if bits.dtype != torch.bool:
            raise VoccError(f"bits has the type {bits.dtype}: it must be torch.bool, True = On")
        if not len(scene):
            raise VoccError("scene holds no frames: it must hold at least 1")
        scene, bits = self._checked(scene), bits.to(self.device)
        nearest, sensor = float(scene.distance_m.min()), self.camera.sensor_px
        if nearest_m is not None and nearest_m > nearest * (1 + 1e-9):
            raise VoccError(f"nearest_m is {nearest_m:g}: it must be at most the nearest scene's {nearest:g}")
        window = panel_only and self._filling is not None
        drawn_full = self._filling is not None and self._filling.takes in DRAWN
        if not window and (self.framing == "full" or drawn_full):
            size = sensor
        else:
            size = self.crop_px(nearest if nearest_m is None else nearest_m)
            size = crops.window_size_px(size, sensor) if window else size
        if in_perspective(self.effects):
            view = view_of(self._context(scene, keys))
            centre = view.points_px(scene.distance_m.new_zeros(1, 2))[:, 0]
        else:
            centre = crops.panel_centre_px(scene, self.camera)
        whole = self.framing != "crop" or (self._filling is not None and not window)
        crops.demand_pixels(sensor if whole else size)
        origin = crops.crop_origins_px(centre, size, sensor, grid_px=crops.WINDOW_GRID_PX if window else 1)
        context = self._context(scene, keys, origin)
        context = replace(context, iso=photometry.auto_iso(context))
        pictures = self._pictures(crops.Batch(context, bits, centre, size), window)
        if self.output == Quantity.GREY:
            photometry.demand_greys(pictures)
        if size == sensor or window:
            return Frames(pictures, origin, sensor)
        if tuple(pictures.shape[-2:]) == sensor:
            return Frames(pictures, torch.zeros_like(origin), sensor)
        surround = crops.read_surround(pictures, centre, origin)
        if self.framing == "crop":
            return Frames(pictures, origin, sensor, surround)
        laid = crops.lay_on_sensor(pictures, surround, origin, sensor)
        return Frames(laid, torch.zeros_like(origin), sensor)

    def _pictures(self, batch: crops.Batch, window: bool) -> Tensor:
        """Render frames, those of far panels in small crops that are laid into those asked for."""
        size, sensor = batch.size, self.camera.sensor_px
        if self._filling is not None or size == sensor:
            return self._in_chunks(batch, window)
        # A crop at the sensor's border need not lie about its panel's middle.
        last = batch.context.first_px.new_tensor([sensor[1] - size[1], sensor[0] - size[0]])
        moved = ((batch.context.first_px == 0) | (batch.context.first_px == last)).any(dim=1)
        tight = partial(crops.crop_size_px, self.effects, self.camera, self.panel, margin_cells=0)
        groups = crops.like_sized(batch.context.scene, moved, size, tight)
        return crops.in_groups(batch, groups, lambda group: self._in_chunks(group, window))

    def _in_chunks(self, batch: crops.Batch, window: bool) -> Tensor:
        """Render frames of one size, as many at a time as the cache holds."""
        chunk = max(1, CHUNK_PIXELS // (batch.size[0] * batch.size[1]))
        grey: list[Tensor] = []
        for start in range(0, len(batch), chunk):
            part = batch if len(batch) <= chunk else batch.taken(slice(start, start + chunk))
            grey += self._expose(part, window)
        return torch.cat(grey)

    def _checked(self, scene: Scene) -> Scene:
        """Move scenes to the device, or refuse by name those that cannot be rendered."""
        scene = scene.checked().to(self.device)
        crops.demand_in_sight(scene, self.camera, self.panel)
        return scene

    def _context(self, scene: Scene, keys: Sequence[FrameKey] = (), origin: Tensor | None = None) -> Context:
        """What effects may know about frames."""
        return Context(scene, self.camera, keys, origin, self.effects, self.panel)

    def _expose(self, batch: crops.Batch, window: bool) -> list[Tensor]:
        """Carry the LEDs' light through the camera, laying crops on the sensor once an effect fills it."""
        painted = self._paint(batch), Quantity.LUMINANCE
        after = [effect for effect in self.effects if effect.takes not in DRAWN]
        if self._filling not in after or window or batch.size == self.camera.sensor_px:
            return [self._run(painted, after, batch.context, to_end=True)[0]]
        before = after[: after.index(self._filling)]
        value, current = self._run(painted, before, batch.context)
        surround = crops.read_surround(value, batch.centre_px, origin := batch.context.first_px)
        pictures = []
        for i in range(len(value)):
            row = slice(i, i + 1)
            frame = crops.lay_on_sensor(value[row], surround[row], origin[row], self.camera.sensor_px)
            whole = replace(batch.taken(row).context, origin_px=torch.zeros_like(origin[row]))
            pictures.append(self._run((frame, current), after[len(before) :], whole, to_end=True)[0])
        return pictures

    def _paint(self, batch: crops.Batch) -> Tensor:
        """Draw the picture that the lens sees, (B,1,H,W) cd/m2."""
        context, shares = batch.context, None
        symbols = batch.bits.unsqueeze(1)
        for effect in self.effects:
            if isinstance(effect, RollingShutter):
                symbols = effect(batch.bits, context)
                shares = effect.row_shares(context, batch.size[0])
        leds = symbols * context.scene.led_luminance_cd_m2.view(-1, 1, 1, 1)
        for effect in taking(self.effects, Quantity.LED_LUMINANCE):
            leds = torch.stack([effect(one, context) for one in leds.unbind(1)], dim=1)
        return paint(leds, shares, context, batch.size, self.dtype)

    def _run(self, seen: Seen, effects: Sequence[Effect], context: Context, *, to_end: bool = False) -> Seen:
        """Apply effects in order, with the camera's own steps between them, or until the grey values."""
        for effect in effects:
            while seen[1] != effect.takes:
                seen = self._advance(*seen, context)
            seen = effect(seen[0], context), effect.gives
        while to_end and seen[1] in CAMERA_STEPS[:-1]:
            seen = self._advance(*seen, context)
        return seen

    def _advance(self, value: Tensor, current: Quantity, context: Context) -> Seen:
        """Do the camera's next step: lens or gamma encoding."""
        if current == Quantity.LUMINANCE:
            return through_lens(value, self.camera), Quantity.EXPOSURE
        iso = photometry.auto_iso(context).to(self.dtype).view(-1, 1, 1, 1)
        return grey_value(value, iso, gamma=self.camera.gamma), Quantity.GREY
