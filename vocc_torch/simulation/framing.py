"""Which part of the sensor is rendered, what represents the other pixels, and how frames of equal size are batched."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Tensor

from vocc_torch.errors import VoccError, finite_number, whole_number
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.simulation import photometry
from vocc_torch.simulation.effects import Context, Effect, view
from vocc_torch.simulation.raster import Size as Size
from vocc_torch.types import Batched, Scene


@dataclass(frozen=True)
class FramingSettings:
    """What is rendered at a time, and what is refused."""

    # Width of an LED's image: its cover of a pixel is within 5e-6 of the exact one.
    most_led_px: int = 100_000
    # Of a panel's image from the sensor's middle: float64 places it within 1e-4 px.
    farthest_px: float = 1e12
    window_grid_px: int = 8  # of windows' edges: JPEG's blocks, Bayer's cells
    # Of a frame or crop: a 50-megapixel camera's and 8K video's. Such frames are drawn
    # one at a time; each pixel takes 50 to 100 bytes, the largest frame up to 7 GB.
    most_pixels: int = 1 << 26
    size_step: float = 1.2  # ratio of distances drawn in crops of one size
    # Rendered at a time: planes that outgrow the cache are slower, from 32 MiB on
    # several times.
    chunk_pixels: int = 600_000
    # The same on a GPU: a part costs the host the same calls, however many frames it has.
    device_pixels: int = 8_000_000
    part_frames: int = 32  # of several distances, in crops of one size


SETTINGS = FramingSettings()


def demand_led_px(widest_px: float, distance_m: float) -> None:
    """Refuse by name an LED whose image is wider than is on offer.

    Raises:
        VoccError: one wider than 100000 px.
    """
    if not widest_px <= SETTINGS.most_led_px:
        raise VoccError(
            f"scene.distance_m is {distance_m:g}: "
            f"it must leave an LED's image at most {SETTINGS.most_led_px} px wide, and this is {widest_px:g}"
        )


def demand_in_sight(scene: Scene, camera: Camera, panel: LedPanel) -> None:
    """Refuse by name panels that are so near or so far aside that their images have no exact place.

    Raises:
        VoccError: an LED's image wider than 100000 px, or a panel's that reaches farther than 1e12 px.
    """
    half_m = panel.pitch_m * max(panel.shape.sides) / 2
    if not len(scene):
        return
    scale = camera.pixels_per_metre(scene.distance_m)
    nearest_m = float(scene.distance_m.min())
    demand_led_px(float(panel.led_diameter_m * scale.max()), nearest_m)
    aside_m = torch.maximum(scene.offset_x_m.abs(), scene.offset_y_m.abs())
    farthest, far = ((aside_m + half_m) * scale).max(dim=0)
    if not farthest <= SETTINGS.farthest_px:
        values = ", ".join(
            f"scene.{name} is {float(getattr(scene, name)[far]):g}"
            for name in ("offset_x_m", "offset_y_m", "distance_m")
        )
        raise VoccError(
            f"{values}: the panel's image must lie within {SETTINGS.farthest_px:g} px, "
            f"and this reaches {float(farthest):g}"
        )


def panel_corners_px(scene: Scene, camera: Camera, panel: LedPanel) -> Tensor:
    """True corners of the grid of LED cells (each cell one pitch wide), (B,4,2), clockwise from the top left.

    Example:
        >>> corners = panel_corners_px(Scene.of(distance_m=50.0), Camera(), LedPanel())
        >>> round(float(corners[0, 1, 0] - corners[0, 0, 0]), 3)
        34.909
    """
    camera_view = view.view_of(Context(scene, camera, panel=panel))
    return camera_view.points_px(view.panel_corners_m(panel))


def crop_size_px(
    effects: Sequence[Effect],
    camera: Camera,
    panel: LedPanel,
    nearest_m: float,
    *,
    margin_cells: int = 1,
) -> Size:
    """Height and width of the crop that holds a panel at ``nearest_m``, a cell of margin and its light.

    Its border is then free of the panel's light, so it stands for all the rest; where the sensor cuts the
    panel, that holds for the sides away from it.

    Args:
        effects: those of the scene, each of which may make the image larger or spread its light.
        camera: the camera.
        panel: the panel.
        nearest_m: the nearest distance that the crop must do for, above 0.
        margin_cells: LED cells of margin on each side, for a receiver that looks there.

    Returns:
        Both at most the sensor's, however near the panel or wide its light.

    Raises:
        VoccError: a distance that is not above 0, or at which an LED's image is too large.

    Example:
        >>> crop_size_px([], Camera(), LedPanel(), 50.0)
        (48, 48)
    """
    if not finite_number("nearest_m", nearest_m) > 0:
        raise VoccError(f"nearest_m is {nearest_m:g}: it must be above 0")
    demand_led_px(panel.led_diameter_m / nearest_m * camera.focal_length_px, nearest_m)
    pitch_px = panel.pitch_m * camera.focal_length_px / nearest_m
    rows, columns = (leds + 2 * margin_cells for leds in panel.shape.sides)
    size = rows * pitch_px, columns * pitch_px
    reach = 2
    for effect in effects:
        with effect.blamed():
            size = effect.size_in_px(size, camera, nearest_m)
            effect_reach = effect.reach_in_px(camera, nearest_m)
        reach += whole_number(
            f"scene.effects.{effect.name}.reach_in_px",
            effect_reach,
            0,
            SETTINGS.most_pixels,
        )
    margin, sides = 2 * reach, zip(size, camera.sensor_px, strict=True)
    height, width = (
        min(math.ceil(min(side, full)) + margin, full) for side, full in sides
    )
    return height, width


def demand_pixels(size: Size) -> None:
    """Refuse by name frames or crops, of a height and width, that are too large.

    Raises:
        VoccError: more than 2^26 pixels.

    Example:
        >>> demand_pixels((6144, 8192))
    """
    height, width = size
    if height * width > SETTINGS.most_pixels:
        raise VoccError(
            f"camera.width_px and camera.height_px lead to frames of {width} x {height} px: "
            f"they must hold at most {SETTINGS.most_pixels} pixels ("
            "give a smaller camera, or framing=crop, which draws the panel's surroundings only)"
        )


def window_size_px(crop_px: Size, sensor_px: Size) -> Size:
    """Height and width of the window on the grid that holds a crop wherever it lies.

    Example:
        >>> window_size_px((71, 71), (1080, 1920)), window_size_px((71, 71), (1080, 1919))
        ((80, 80), (80, 1919))
    """
    grid, sides = SETTINGS.window_grid_px, zip(crop_px, sensor_px, strict=True)
    height, width = (
        full if full % grid else min(full, grid * (-(-side // grid) + 1))
        for side, full in sides
    )
    return height, width


def crop_origins_px(
    centre_px: Tensor,
    size_px: Size,
    sensor_px: Size,
    *,
    grid_px: int = 1,
) -> Tensor:
    """Top left pixel of each crop: around the panel, moved inside the sensor however far outside that lies.

    Args:
        centre_px: (B,2) image of each panel's centre, px.
        size_px: height and width of the crops.
        sensor_px: height and width of the sensor.
        grid_px: what the origins are multiples of.

    Returns:
        (B,2) int64, as (x, y).

    Example:
        >>> crop_origins_px(torch.tensor([[100.4, 3.0]]), (40, 40), (1080, 1920), grid_px=8).tolist()
        [[80, 0]]
    """
    sensor, extent = torch.tensor([sensor_px, size_px], device=centre_px.device).flip(1)
    # The crop that this holds begins up to a grid's step later.
    begin = torch.round(centre_px).long() - extent // 2 + grid_px // 2
    return torch.minimum((begin - begin % grid_px).clamp(min=0), sensor - extent)


def read_surround(value: Tensor, centre_px: Tensor, origin_px: Tensor) -> Tensor:
    """Read the corner of each crop that lies farthest from the panel, beyond its light, (B,C,H,W) to (B,)."""
    height, width = value.shape[-2:]
    x, y = (centre_px - origin_px).unbind(dim=-1)
    column = torch.where(x < width / 2, width - 1, 0)
    row = torch.where(y < height / 2, height - 1, 0)
    return value[torch.arange(len(value), device=value.device), 0, row, column]


def demand_even_border(value: Tensor, batch: "Batch") -> None:
    """Refuse by name effects from outside whose light reaches a crop's border, or that change with place.

    Raises:
        VoccError: a side within the sensor that is not one value, but for a hundred-thousandth of the most.
    """
    context, (height, width) = batch.context, batch.size
    names = [f"scene.effects.{part.name}" for part in context.effects if part.target]
    if not names:
        return
    x, y = context.first_px.unbind(-1)
    plane, camera = value[:, 0].double(), context.camera
    corner = read_surround(value, batch.centre_px, context.first_px).unsqueeze(-1)
    for side, inside in (
        (plane[:, 0], y > 0),
        (plane[:, -1], y + height < camera.height_px),
        (plane[..., 0], x > 0),
        (plane[..., -1], x + width < camera.width_px),
    ):
        uneven = (side - corner).abs().amax(-1) > 1e-5 * plane.amax((1, 2))
        if bool((uneven & inside).any()):
            raise VoccError(
                f"{' or '.join(names)} changes the border of a crop of {width} x {height} px: "
                "reach_in_px must say how far it carries light, or leave that and fills_sensor out"
            )


def lay_on_sensor(
    value: Tensor, surround: Tensor, origin_px: Tensor, sensor_px: Size
) -> Tensor:
    """Lay each crop into a full frame of its surround, (B,C,h,w) to (B,C,H,W).

    Example:
        >>> crop, origin = torch.full((1, 1, 1, 2), 5.0), torch.tensor([[1, 0]])
        >>> lay_on_sensor(crop, torch.tensor([3.0]), origin, (2, 4)).tolist()
        [[[[3.0, 5.0, 5.0, 3.0], [3.0, 3.0, 3.0, 3.0]]]]
    """
    height, width = value.shape[-2:]
    shape = -1, value.shape[1], *sensor_px
    full = surround.view(-1, 1, 1, 1).expand(shape).contiguous()
    for index, (x, y) in enumerate(origin_px.tolist()):
        full[index, :, y : y + height, x : x + width] = value[index]
    return full


@dataclass(frozen=True, slots=True)
class Batch(Batched):
    """Frames that are drawn at one size.

    Args:
        context: their scenes, keys and origins.
        bits: (B,R,C) bool.
        centre_px: (B,2) image of each panel's centre on the sensor, px.
        size: height and width of the pictures, px.
    """

    context: Context
    bits: Tensor
    centre_px: Tensor
    size: Size

    @classmethod
    def around(
        cls, context: Context, bits: Tensor, size: Size, *, grid_px: int = 1
    ) -> Self:
        """Place pictures of one size around their panels, and meter them; see :func:`crop_origins_px`.

        Raises:
            VoccError: scenes whose light has no ISO speed.
        """
        middle_m = context.scene.distance_m.new_zeros(1, 2)
        centre = view.view_of(context).points_px(middle_m)[:, 0]
        origin = crop_origins_px(
            centre, size, context.camera.sensor_px, grid_px=grid_px
        )
        placed = replace(context, origin_px=origin, iso=photometry.auto_iso(context))
        return cls(placed, bits, centre, size)

    def __len__(self) -> int:
        """Count the frames."""
        return len(self.context.scene)

    def to(self, device: torch.device | str) -> Self:
        """Move the frames to where they are drawn."""
        if torch.device(device).type == "cpu":
            return self
        moved = self.each(lambda value: value.to(device, non_blocking=True))
        nearest_m = float(self.context.scene.distance_m.min())
        return replace(moved, context=replace(moved.context, nearest_m=nearest_m))

    def taken(self, frames: slice | Tensor, size: Size) -> Self:
        """Take some frames, by a slice or by their numbers; a smaller size keeps the middle."""
        context = self.context.taken(frames)
        moved = context.first_px + inset_px(self.size, size)
        placed = replace(context, origin_px=moved)
        return replace(self[frames], context=placed, size=size)


def inset_px(large: Size, small: Size) -> Tensor:
    """Columns left of and rows above a picture that lies in the middle of a larger one, (2,) int64."""
    inner, outer = (torch.tensor(sides[::-1]) // 2 for sides in (small, large))
    return outer - inner


def drawn_by_distance(
    batch: Batch,
    apart: Tensor,
    tight_px: Callable[[float], Size],
    draw: Callable[[Batch], Tensor],
    drawn_px: Size,
    *,
    on_host: bool,
) -> Tensor:
    """Draw frames in parts, those of far panels in smaller pictures, laid into pictures of the batch's size.

    Most of a picture that holds the nearest panel is uniform about a farther one, and need not be computed.

    Args:
        batch: frames whose panels lie in the middle of their pictures, but for those ``apart``.
        apart: (B,) bool, the frames that are drawn in full size.
        tight_px: height and width of pictures that hold a panel at a distance, or farther.
        draw: gives the pictures (n,1,h,w) of a part, at most as many pixels as are rendered at a time.
        drawn_px: height and width of these pictures, for a part of the batch's size.
        on_host: whether a further part costs less than the pixels that it saves.

    Returns:
        (B,1,H,W), in the batch's order.
    """
    distance_m = torch.where(apart, 0.0, batch.context.scene.distance_m)
    sorted_m, order = distance_m.sort(descending=True, stable=True)
    pixels = SETTINGS.chunk_pixels if on_host else SETTINGS.device_pixels
    most = pixels // math.prod(drawn_px)
    if on_host and sorted_m[0] > SETTINGS.size_step * sorted_m[-1]:
        most = min(most, SETTINGS.part_frames)
    drawn = []
    for frames in torch.split(order, max(1, most)):
        nearest_m, size = float(distance_m[frames[-1]]), batch.size
        if nearest_m:
            height, width = tight_px(nearest_m)
            size = min(height, size[0]), min(width, size[1])
        pictures = draw(batch.taken(frames, size))
        if size != batch.size:
            # The panel lies in the middle, so that every corner is beyond its light.
            origin = inset_px(batch.size, size).expand(len(pictures), 2)
            corner = pictures[:, 0, 0, 0]
            pictures = lay_on_sensor(pictures, corner, origin, batch.size)
        drawn.append(pictures)
    together = torch.cat(drawn)
    return together[order.argsort().to(together.device, non_blocking=True)]
