"""The simulator: bits and scenes in, camera frames out, with the named effects and no others."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal, get_args

import torch
from torch import Tensor

from vocc_torch.errors import VoccError, demand_kind, demand_word, finite_number
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.rng import FrameKey
from vocc_torch.simulation import effects as chain
from vocc_torch.simulation import framing, painter, photometry
from vocc_torch.simulation.effects import Effects, housing, light, view
from vocc_torch.simulation.effects.base import Context, Effect, Quantity, of_kind
from vocc_torch.simulation.effects.coding import Jpeg
from vocc_torch.simulation.effects.colour import CHANNELS, Colour
from vocc_torch.simulation.effects.sensor import Bayer
from vocc_torch.types import Frames, Panels, Scene, resolve_device, tensor_of

PAPER_EFFECTS: dict[str, Mapping[str, float]] = {
    "attenuation": {"visibility_m": 40_000.0},
    "blooming": {"sigma_px": 1.5},
    "saturation": {},
    "quantization": {"bits": 8},
}
"""The effects of the paper's scenes."""

Framing = Literal["crop", "filled", "full"]

DRAWN = chain.CAMERA_STEPS[: chain.CAMERA_STEPS.index(Quantity.LUMINANCE)]
"""What effects change while the picture is drawn, before luminance reaches the lens."""

Seen = tuple[Tensor, Quantity]
"""Pictures on their way through the camera, (B,1,H,W), and what their numbers mean."""

OF_ALL_CHANNELS = (Bayer, Jpeg)
"""Effects that take the three channels of a scene in colour together, (B,3,H,W)."""


class Simulator:
    """Render LED-panel frames from physics.

    Args:
        camera: the camera; by default the paper's.
        panel: the LED panel; by default the paper's.
        effects: effect names with parameters, or built effects; by default the paper's. Other effects are
            never built.
        framing: ``crop`` renders the panel's surroundings and states the uniform grey around them;
            ``filled`` pastes this crop into a full frame; ``full`` renders the whole sensor. Quantised
            pixels are equal. An effect that fills the sensor always makes whole frames.
        device: device of the tensors.
        dtype: working precision, ``torch.float32`` or ``torch.float64``.

    Raises:
        VoccError: an unknown framing, effect, device or precision.

    Example:
        >>> simulator = Simulator()
        >>> scene = Scene.of(frames=3, distance_m=50.0)
        >>> frames = simulator.render(scene, torch.ones(3, 8, 8, dtype=torch.bool))
        >>> frames.grey.dtype, int(frames.grey.max()), frames.surround.tolist()
        (torch.uint8, 188, [102, 102, 102])
    """

    def __init__(
        self,
        camera: Camera | None = None,
        panel: LedPanel | None = None,
        effects: Effects | None = None,
        *,
        framing: Framing = "crop",
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> None:
        """Build the named effects and no others."""
        demand_word("framing", framing, get_args(Framing))
        if dtype not in (torch.float32, torch.float64):
            raise VoccError(
                f"dtype is {dtype}: it must be torch.float32 or torch.float64"
            )
        self.camera = camera or Camera()
        self.panel = panel or LedPanel()
        demand_kind("camera", self.camera, Camera)
        demand_kind("panel", self.panel, LedPanel)
        self.effects: tuple[Effect, ...] = chain.build_effects(
            PAPER_EFFECTS if effects is None else effects
        )
        self.output = chain.check_chain(self.effects)
        self.framing: Framing = framing
        self.device = resolve_device(str(device))
        self.dtype = dtype
        self._filling = next((e for e in self.effects if e.fills_sensor), None)
        self._colour = of_kind(self.effects, Colour)
        self.further = self._colour.further if self._colour else ()
        self._channels = range(len(CHANNELS)) if self._colour else (None,)
        mosaic = {effect.name for effect in self.effects} & {"bayer", "demosaicing"}
        if self._colour and self._colour.grey != "luma" and mosaic == {"bayer"}:
            raise VoccError.of(
                "scene.effects.colour.grey",
                repr(self._colour.grey),
                "luma, or with scene.effects.demosaicing: a raw mosaic is one plane",
            )

    def true_panels(
        self, scene: Scene, keys: Sequence[FrameKey] = (), *, rendered: bool = False
    ) -> Panels:
        """Give the true corners, for evaluation; ``rendered``: ``render`` has checked the same arguments."""
        scene = scene.to("cpu") if rendered else self._checked(scene)
        context = self._context(scene, keys)
        corners_m = view.panel_corners_m(self.panel)
        panels = Panels.known(view.view_of(context).points_px(corners_m))
        present = housing.present(context)
        return panels.each(
            lambda part: part * present.view(-1, *[1] * (part.ndim - 1))
        ).to(self.device)

    def led_centres_px(self, scene: Scene, keys: Sequence[FrameKey] = ()) -> Tensor:
        """Give the centres of the LEDs on the sensor, (B,R*C,2) px in raster order.

        Example:
            >>> Simulator().led_centres_px(Scene.of(distance_m=50.0))[0, 0].round().tolist()
            [945.0, 525.0]
        """
        context = self._context(self._checked(scene), keys)
        places = view.led_centres_m(self.panel)
        return view.view_of(context).points_px(places).to(self.device)

    def render_window(
        self,
        scene: Scene,
        bits: Tensor,
        origin_px: Tensor,
        size_px: framing.Size,
        keys: Sequence[FrameKey] = (),
    ) -> Frames:
        """Render a fixed window of the sensor for each scene.

        Args:
            scene: B scenes, at least 1.
            bits: (B,R,C) bool, True = On; or the light of each LED over that of an On LED.
            origin_px: (B,2) int64, the sensor coordinates ``(x, y)`` of each window's top left pixel.
            size_px: height and width of the windows; they lie on the sensor.
            keys: as for :meth:`render`.

        Example:
            >>> bits, origin = torch.ones(1, 8, 8, dtype=torch.bool), torch.tensor([[940, 520]])
            >>> tuple(Simulator().render_window(Scene.of(), bits, origin, (30, 40)).grey.shape)
            (1, 1, 30, 40)
        """
        context = self._context(self._checked(scene), keys)
        batch = framing.Batch.around(context, bits.cpu(), size_px)
        placed = replace(batch.context, origin_px=origin_px.cpu())
        batch = replace(batch, context=placed).to(self.device)
        origin = batch.context.first_px
        return Frames(self.expose(batch, window=True), origin, self.camera.sensor_px)

    def further_bits(self, scene: Scene, keys: Sequence[FrameKey]) -> dict[str, Tensor]:
        """Bits (B,R,C) bool of LEDs of further colours, ``second`` and ``third``, by keys as for render.

        Example:
            >>> from vocc_torch.rng import BlockKey
            >>> simulator = Simulator(effects=PAPER_EFFECTS | {"colour": {"second_nm": 525}})
            >>> bits = simulator.further_bits(Scene.of(), [FrameKey(BlockKey(0, "doc", 0), 0)])
            >>> {name: tuple(one.shape) for name, one in bits.items()}
            {'second': (1, 8, 8)}
        """
        return {
            colour_context.leds[1:]: bits.to(self.device)
            for colour_context, bits in self._further(
                self._context(scene.to("cpu"), keys)
            )
        }

    def contrast(self, scene: Scene) -> Tensor:
        """Contrast ``(G_on - G_off) / 255`` of the LEDs before any blur (section IV-D-1), (B,) float64.

        Both greys are clipped at white where the scene names saturation. What a sensor clips or adds
        (``full_well``, ``dark_current``) is not in it. LEDs without light of their own have contrast 0.
        """
        scene = self._checked(scene)
        context = self._context(scene)
        led_luminance = scene.led_luminance_cd_m2.view(-1, 1, 1)
        for effect in painter.taking(self.effects, Quantity.LED_LUMINANCE):
            if not effect.sampled:
                led_luminance = effect.applied(led_luminance, context)
        off = photometry.reflected_luminance_cd_m2(
            scene.ambient_lx, self.panel.led_reflectance
        )
        clipped = self.output in (Quantity.BOUNDED_GREY, Quantity.DIGITAL)
        greys = []
        for shining in (led_luminance.view(-1), torch.zeros_like(off)):
            luminance = photometry.as_seen(off, context, shining)
            grey, _ = self._run((luminance, Quantity.LUMINANCE), [], context)
            greys.append(grey.clamp(max=255.0 if clipped else math.inf))
        return ((greys[0] - greys[1]) / 255.0).to(self.device)

    def crop_px(self, nearest_m: float) -> framing.Size:
        """Height and width of the crop for panels at ``nearest_m`` or farther."""
        return framing.crop_size_px(self.effects, self.camera, self.panel, nearest_m)

    def render(
        self,
        scene: Scene,
        bits: Tensor,
        *,
        nearest_m: float | None = None,
        keys: Sequence[FrameKey] = (),
        panel_only: bool = False,
    ) -> Frames:
        """Render a frame for each scene; a panel is cut at the edges of the sensor.

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
        demand_kind("keys", keys, list, tuple)
        for key in keys:
            demand_kind("keys", key, FrameKey)
        scene, bits = self._checked(scene), self._checked_bits(bits, len(scene))
        sensor, window = self.camera.sensor_px, panel_only and self._has_windows
        size = self._drawn_px(scene, nearest_m, window)
        grid_px = framing.SETTINGS.window_grid_px if window else 1
        batch = framing.Batch.around(
            self._context(scene, keys), bits.cpu(), size, grid_px=grid_px
        )
        origin, apart = batch.context.first_px, torch.ones(len(batch)).bool()
        if self._filling is None and size != sensor:
            # A crop at the sensor's border need not lie about its panel's middle.
            last = origin.new_tensor([sensor[1] - size[1], sensor[0] - size[0]])
            apart = ((origin == 0) | (origin == last)).any(dim=1)
        world = self.effects, self.camera, self.panel
        pictures = framing.drawn_by_distance(
            batch,
            apart,
            partial(framing.crop_size_px, *world, margin_cells=0),
            lambda part: self.expose(part.to(self.device), window),
            sensor if self._filling and not window else size,
            on_host=self.device.type == "cpu",
        )
        if self.output == Quantity.GREY:
            photometry.demand_greys(pictures)
        origin, surround = origin.to(self.device, non_blocking=True), None
        if not window and tuple(pictures.shape[-2:]) != sensor:
            centre = batch.centre_px.to(self.device, non_blocking=True)
            surround = framing.read_surround(pictures, centre, origin)
            if self.framing != "crop":
                pictures = framing.lay_on_sensor(pictures, surround, origin, sensor)
                surround = None
        if tuple(pictures.shape[-2:]) == sensor:
            origin = torch.zeros_like(origin)
        if self._colour is None or pictures.shape[1] == 1:  # a raw mosaic has one plane
            return Frames(pictures, origin, sensor, surround)
        grey = self._colour.grey_of(pictures)
        return Frames(grey, origin, sensor, surround, pictures)

    @property
    def _has_windows(self) -> bool:
        """Whether a part of a frame can be rendered alone though an effect fills the sensor."""
        if self._filling is None or any(effect.unbounded for effect in self.effects):
            return False
        # The chroma's blocks are wider than a window's grid.
        return not (self._colour and of_kind(self.effects, Jpeg))

    def _drawn_px(
        self, scene: Scene, nearest_m: float | None, window: bool
    ) -> framing.Size:
        """Height and width of what is drawn of each frame; frames of too many pixels are refused."""
        nearest, sensor = float(scene.distance_m.min()), self.camera.sensor_px
        if nearest_m is None:
            nearest_m = nearest
        elif finite_number("nearest_m", nearest_m) > nearest * (1 + 1e-9):
            raise VoccError(
                f"nearest_m is {nearest_m:g}: it must be at most the nearest scene's {nearest:g}"
            )
        size, filling = sensor, self._filling
        if window:
            size = framing.window_size_px(self.crop_px(nearest_m), sensor)
        elif self.framing != "full" and not (
            filling and (self._colour or filling.takes in DRAWN)
        ):
            size = self.crop_px(nearest_m)
        is_part = self.framing == "crop" and (window or filling is None)
        framing.demand_pixels(size if is_part else sensor)
        return size

    def _checked(self, scene: Scene) -> Scene:
        """Give scenes in the host's memory, or refuse by name those that cannot be rendered."""
        demand_kind("scene", scene, Scene)
        scene = scene.to("cpu").checked()
        framing.demand_in_sight(scene, self.camera, self.panel)
        return scene

    def _checked_bits(self, bits: Tensor, frames: int) -> Tensor:
        """Refuse bits that are no (B,R,C) bool of the frames, and no frames."""
        bits = tensor_of("bits", bits)
        expected = (frames, *self.panel.shape.sides)
        if tuple(bits.shape) != expected:
            raise VoccError(
                f"bits has shape {tuple(bits.shape)}: it must be {expected}"
            )
        if bits.dtype != torch.bool:
            raise VoccError(
                f"bits has the type {bits.dtype}: it must be torch.bool, True = On"
            )
        if not frames:
            raise VoccError("scene holds no frames: it must hold at least 1")
        return bits

    def _context(self, scene: Scene, keys: Sequence[FrameKey] = ()) -> Context:
        """What effects may know about frames."""
        return Context(scene, self.camera, keys, None, self.effects, self.panel)

    def expose(self, batch: framing.Batch, window: bool) -> Tensor:
        """Pass light through lens and sensor; a crop becomes a whole frame before an effect that fills it."""
        context, sensor = batch.context, self.camera.sensor_px
        after = [effect for effect in self.effects if effect.takes not in DRAWN]
        is_crop, channels = batch.size != sensor, self._channels
        is_laid = is_crop and not window and self._filling is not None
        stops = [
            isinstance(effect, OF_ALL_CHANNELS)
            if self._colour
            else is_laid and effect.fills_sensor
            for effect in after
        ]
        apart, planes = [*stops, True].index(True), []
        for channel in channels:
            part = replace(batch, context=replace(context, channel=channel))
            painted = self.paint(part), Quantity.LUMINANCE
            to_end = apart == len(after)
            value, current = self._run(painted, after[:apart], part.context, to_end)
            if is_laid or (is_crop and self._filling is None):
                framing.demand_even_border(value, batch)
            planes.append(value)
        pictures = torch.cat(planes, dim=1)
        if is_laid:
            surround = framing.read_surround(
                pictures, batch.centre_px, context.first_px
            )
            pictures = framing.lay_on_sensor(
                pictures, surround, context.first_px, sensor
            )
            context = replace(context, origin_px=torch.zeros_like(context.first_px))
        return self._run((pictures, current), after[apart:], context)[0]

    def paint(self, batch: framing.Batch) -> Tensor:
        """Draw the picture that the lens sees, (B,1,H,W) cd/m2."""
        context, shares = batch.context, None
        if shutter := of_kind(self.effects, light.RollingShutter):
            shares = shutter.row_shares(context, batch.size[0])
        leds = self._lights(batch.bits, context)
        for colour_context, bits in self._further(context):
            leds = leds + self._lights(bits, colour_context)
        return painter.paint(leds, shares, context, batch.size, self.dtype)

    def _lights(self, bits: Tensor, context: Context) -> Tensor:
        """Light of LEDs of one colour in each of K symbols, (B,K,R,C) cd/m2, by the (B,R,C) sent."""
        shutter = of_kind(self.effects, light.RollingShutter)
        symbols = shutter(bits, context) if shutter else bits.unsqueeze(1)
        leds = symbols * context.scene.led_luminance_cd_m2.view(-1, 1, 1, 1)
        for effect in painter.taking(self.effects, Quantity.LED_LUMINANCE):
            applied = [effect.applied(shown, context) for shown in leds.unbind(1)]
            leds = torch.stack(applied, dim=1)
        return leds

    def _further(self, context: Context) -> Iterator[tuple[Context, Tensor]]:
        """Give the context and the bits (B,R,C) of LEDs of each further colour."""
        if self._colour is not None:
            for name in self.further:
                colour_context = replace(context, leds=f".{name}")
                yield colour_context, self._colour.sent(colour_context)

    def _run(
        self,
        pictures: Seen,
        effects: Sequence[Effect],
        context: Context,
        to_end: bool = True,
    ) -> Seen:
        """Apply effects in order, with the camera's own steps before each, or on to the grey values."""
        value, current = pictures
        for effect in [*effects, None] if to_end else effects:
            while current in chain.CAMERA_STEPS[:-1] and (
                effect is None or current != effect.takes
            ):
                if current == Quantity.LUMINANCE:
                    value = photometry.through_lens(value, self.camera)
                    current = Quantity.EXPOSURE
                else:
                    iso = photometry.auto_iso(context).to(value.dtype)
                    iso = iso.view(-1, *[1] * (value.ndim - 1))
                    value = photometry.grey_value(value, iso, gamma=self.camera.gamma)
                    current = Quantity.GREY
            if effect is not None:
                value, current = effect.applied(value, context), effect.gives
        return value, current
