"""The simulator: bits and scenes in, camera frames out, with the named effects and no others."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal, get_args

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.rng import FrameKey
from vocc_torch.simulation.effects import CAMERA_STEPS, Context, Effect, Quantity, build_effects, check_chain
from vocc_torch.simulation.geometry import Camera, LedPanel, led_centres_px, panel_centre_px, panel_corners_px
from vocc_torch.simulation.photometry import (
    auto_iso_speed,
    grey_value,
    luminous_exposure_lx_s,
    reflected_luminance_cd_m2,
)
from vocc_torch.simulation.raster import add_patches, disc_cover, interval_cover
from vocc_torch.types import Frames, Panels, Scene

PAPER_EFFECTS: Mapping[str, Mapping[str, float]] = {
    "attenuation": {"visibility_m": 40_000.0},
    "blooming": {"sigma_px": 1.5},
    "saturation": {},
    "quantization": {"bits": 8},
}
"""The effects of the paper's scenes."""

Framing = Literal["crop", "filled", "full"]

PROJECTED = (Quantity.LED_LUMINANCE, Quantity.BACKGROUND, Quantity.UNLIT)
"""What effects change while the picture is drawn, before luminance reaches the lens."""

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
            All three give the same pixels; an effect that fills the sensor makes every framing ``full``.
        device: where the tensors live.
        dtype: working precision, ``torch.float32`` or ``torch.float64``.

    Raises:
        VoccError: an unknown framing or effect, or a precision that is not offered.

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
        effects: Mapping[str, Mapping[str, float]] | None = None,
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
        fills = any(effect.fills_sensor for effect in self.effects)
        self.framing: Framing = "full" if fills else framing
        self.device = torch.device(device)
        self.dtype = dtype

    def true_panels(self, scene: Scene) -> Panels:
        """Where the panel really is, for the evaluation only."""
        return Panels.known(panel_corners_px(scene.to(self.device), self.camera, self.panel))

    def contrast(self, scene: Scene) -> Tensor:
        """Contrast ``(G_on - G_off) / 255`` of the LEDs before any blur (section IV-D-1), (B,) float64.

        Both greys are clipped at white where the scene names saturation.
        """
        scene = scene.to(self.device)
        context, light = Context(scene, self.camera), scene.led_luminance_cd_m2.view(-1, 1, 1)
        for effect in self._taking(Quantity.LED_LUMINANCE):
            light = light if effect.sampled else effect(light, context)
        off, iso = (
            reflected_luminance_cd_m2(scene.ambient_lx, self.panel.led_reflectance),
            self._iso_speed(scene),
        )
        seen = (self._metered(off, scene, own) for own in (light.view(-1), torch.zeros_like(off)))
        greys = [grey_value(self._lens(luminance), iso, gamma=self.camera.gamma) for luminance in seen]
        if self.output in (Quantity.BOUNDED_GREY, Quantity.DIGITAL):
            greys = [grey.clamp(max=255.0) for grey in greys]
        return (greys[0] - greys[1]) / 255.0

    def crop_px(self, nearest_m: float) -> tuple[int, int]:
        """Height and width of the crop that holds a panel at ``nearest_m``, a cell of margin and its light.

        Its border is then free of the panel's light, so it stands for all the rest; where the sensor cuts the
        panel, that holds for the sides away from it.
        """
        pitch_px = self.panel.pitch_m * self.camera.focal_length_px / nearest_m
        margin = 2 * (sum(effect.reach_in_px(self.camera, nearest_m) for effect in self.effects) + 2)
        wanted = (
            math.ceil(n * pitch_px) + margin
            for n in (self.panel.shape.rows + 2, self.panel.shape.columns + 2)
        )
        height, width = (min(size, full) for size, full in zip(wanted, self.camera.sensor_px, strict=True))
        return height, width

    def render(
        self,
        scene: Scene,
        bits: Tensor,
        *,
        nearest_m: float | None = None,
        keys: Sequence[FrameKey] = (),
    ) -> Frames:
        """Render a frame for each scene.

        Args:
            scene: B scenes.
            bits: (B,R,C) bool, True = On.
            nearest_m: the distance that fixes the crop's size, at most the nearest of this batch, which is
                the default. Give it where batches of one study must have one size.
            keys: a key a frame, for effects that draw random numbers; not needed without such effects.

        Returns:
            B frames or crops, as the framing says.

        Raises:
            VoccError: bits of another shape than the scenes and the panel, or a crop too small for a panel.
        """
        wanted = (len(scene), self.panel.shape.rows, self.panel.shape.columns)
        if tuple(bits.shape) != wanted:
            raise VoccError(f"bits has shape {tuple(bits.shape)}: it must be {wanted}")
        scene, bits = scene.checked().to(self.device), bits.to(self.device)
        size = self.camera.sensor_px
        if self.framing != "full":
            nearest = float(scene.distance_m.min())
            if nearest_m is not None and nearest_m > nearest * (1 + 1e-9):
                raise VoccError(
                    f"nearest_m is {nearest_m:g}: it must be at most the nearest scene's {nearest:g}"
                )
            size = self.crop_px(nearest if nearest_m is None else nearest_m)
        origin = self._origins(scene, size)
        chunk = max(1, CHUNK_PIXELS // (size[0] * size[1]))
        rows = [slice(start, start + chunk) for start in range(0, len(scene), chunk)]
        grey = torch.cat([self._expose(scene[r], bits[r], origin[r], size, keys[r]) for r in rows])
        surround = None if size == self.camera.sensor_px else self._surround(grey, scene, origin)
        crops = Frames(grey, origin, self.camera.sensor_px, surround)
        return _filled(crops) if self.framing == "filled" and surround is not None else crops

    def _origins(self, scene: Scene, size: tuple[int, int]) -> Tensor:
        """Top left pixel of each crop: around the panel, moved inside the sensor; (B,2) as (x, y)."""
        extent = torch.tensor([size[1], size[0]], device=self.device)
        sensor = torch.tensor([self.camera.width_px, self.camera.height_px], device=self.device)
        centred = torch.round(panel_centre_px(scene, self.camera)).long() - extent // 2
        return torch.minimum(centred.clamp(min=0), sensor - extent)

    def _surround(self, grey: Tensor, scene: Scene, origin: Tensor) -> Tensor:
        """Read the corner of each crop that lies farthest from the panel, beyond its light, (B,)."""
        height, width = grey.shape[-2:]
        x, y = (panel_centre_px(scene, self.camera) - origin).unbind(dim=-1)
        column = torch.where(x < width / 2, width - 1, 0)
        row = torch.where(y < height / 2, height - 1, 0)
        return grey[torch.arange(len(scene), device=self.device), 0, row, column]

    def _expose(
        self, scene: Scene, bits: Tensor, origin: Tensor, size: tuple[int, int], keys: Sequence[FrameKey]
    ) -> Tensor:
        """Carry the LEDs' light through the camera, applying each effect where its quantity is at hand."""
        context = Context(scene, self.camera, keys, origin, self.effects)
        leds = bits * scene.led_luminance_cd_m2.view(-1, 1, 1)
        for effect in self._taking(Quantity.LED_LUMINANCE):
            leds = effect(leds, context)
        value, current = self._project(leds, context, origin, size), Quantity.LUMINANCE
        for effect in self.effects:
            if effect.takes in PROJECTED:
                continue
            while current != effect.takes:
                value, current = self._advance(value, current, scene)
            value, current = effect(value, context), effect.gives
        while current in CAMERA_STEPS[:-1]:
            value, current = self._advance(value, current, scene)
        return value

    def _taking(self, quantity: Quantity) -> tuple[Effect, ...]:
        """The effects that take a quantity."""
        return tuple(effect for effect in self.effects if effect.takes == quantity)

    def _metered(self, surface: Tensor, scene: Scene, own: Tensor | None = None) -> Tensor:
        """Luminance of a surface, and of its own light, as seen through air and veil, all (B,)."""
        seen, context = surface.view(-1, 1, 1, 1), Context(scene, self.camera)
        for quantity in (Quantity.UNLIT, Quantity.LUMINANCE):
            if quantity == Quantity.LUMINANCE and own is not None:
                seen = seen + own.view(-1, 1, 1, 1)
            for effect in self._taking(quantity):
                seen = effect(seen, context) if effect.metered else seen
        return seen.view(-1)

    def _advance(self, value: Tensor, current: Quantity, scene: Scene) -> tuple[Tensor, Quantity]:
        """Do the camera's next step: lens or gamma encoding."""
        if current == Quantity.LUMINANCE:
            return self._lens(value), Quantity.EXPOSURE
        iso = self._iso_speed(scene).to(self.dtype).view(-1, 1, 1, 1)
        return grey_value(value, iso, gamma=self.camera.gamma), Quantity.GREY

    def _iso_speed(self, scene: Scene) -> Tensor:
        """ISO speed of each frame, (B,): what auto-ISO wants, within the camera's limits."""
        background = reflected_luminance_cd_m2(scene.ambient_lx, self.panel.background_reflectance)
        background = self._metered(background, scene)
        iso = auto_iso_speed(self._lens(background), scene.background_grey, gamma=self.camera.gamma)
        return iso if self.camera.iso_limits is None else iso.clamp(*self.camera.iso_limits)

    def _lens(self, luminance: Tensor) -> Tensor:
        """Eqs 2 and 3 with this camera's settings."""
        return luminous_exposure_lx_s(
            luminance,
            exposure_time_s=self.camera.exposure_time_s,
            f_number=self.camera.f_number,
            calibration_constant=self.camera.calibration_constant,
        )

    def _project(
        self, led_luminance: Tensor, context: Context, origin: Tensor, size: tuple[int, int]
    ) -> Tensor:
        """Draw background, board and LEDs onto the pixels, (B,R,C) cd/m2 to (B,1,H,W) cd/m2."""
        scene, panel, frames = context.scene, self.panel, len(context.scene)
        behind, before = self._taking(Quantity.BACKGROUND), self._taking(Quantity.UNLIT)
        scale = self.camera.pixels_per_metre(scene.distance_m)
        background = reflected_luminance_cd_m2(scene.ambient_lx, panel.background_reflectance)
        canvas = background.view(-1, 1, 1).expand(frames, *size).contiguous()
        for effect in behind:
            canvas = effect(canvas.unsqueeze(1), context).squeeze(1)
        between = background
        if panel.board_reflectance is not None:
            between = reflected_luminance_cd_m2(scene.ambient_lx, panel.board_reflectance)
            corners = panel_corners_px(scene, self.camera, panel) - origin.unsqueeze(1)
            across = interval_cover(corners[:, 0, 0], corners[:, 2, 0], size[1]).unsqueeze(-2)
            down = interval_cover(corners[:, 0, 1], corners[:, 2, 1], size[0]).unsqueeze(-1)
            if behind:
                canvas += down * across * (between.view(-1, 1, 1) - canvas)
            else:
                canvas += down * across * (between - background).view(-1, 1, 1)
        radius = panel.led_diameter_m / 2 * scale
        patch = math.ceil(2 * float(radius.max())) + 1
        x, y = led_centres_px(scene, self.camera, panel)
        x = (x - origin[:, :1]).unsqueeze(-2).expand_as(led_luminance)
        y = (y - origin[:, 1:]).unsqueeze(-1).expand_as(led_luminance)
        radii = radius.view(-1, 1, 1).expand_as(led_luminance)
        cover, left, top = disc_cover(x.reshape(-1), y.reshape(-1), radii.reshape(-1), patch)
        reflected = reflected_luminance_cd_m2(scene.ambient_lx, panel.led_reflectance)
        step = led_luminance + (reflected - between).view(-1, 1, 1)
        frame = torch.arange(frames, device=self.device).repeat_interleave(panel.shape.leds)
        if behind or before:
            covered = torch.zeros_like(canvas)
            add_patches(covered, cover, frame, left, top)
            canvas += covered * (reflected.view(-1, 1, 1) - canvas)
            for effect in before:
                canvas = effect(canvas.unsqueeze(1), context).squeeze(1)
            step = led_luminance
        add_patches(canvas, cover * step.reshape(-1, 1, 1), frame, left, top)
        # Rounding can leave a black LED a hair below zero, where gamma encoding has no value.
        return canvas.clamp_(min=0).unsqueeze(1).to(self.dtype)


def _filled(crops: Frames) -> Frames:
    """Lay each crop into a full frame of its surround's grey value."""
    assert crops.surround is not None
    height, width = crops.grey.shape[-2:]
    grey = crops.surround.view(-1, 1, 1).expand(-1, *crops.sensor_px).contiguous()
    for index, (x, y) in enumerate(crops.origin_px.tolist()):
        grey[index, y : y + height, x : x + width] = crops.grey[index, 0]
    return Frames(grey.unsqueeze(1), torch.zeros_like(crops.origin_px), crops.sensor_px)
