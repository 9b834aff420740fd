"""The peer's renderer: bits and a scene to one full-HD frame, in plain NumPy and OpenCV.

Image coordinates are continuous ``(x, y)``: pixel (row i, column j) covers ``[j, j+1) x [i, i+1)``. Equations
and tables are those of T.-H. Do and M. Yoo, IEEE Access 7, 2019.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from cv2.typing import MatLike
from numpy.typing import NDArray

Bits = NDArray[np.bool_]
Floats = NDArray[np.floating]
# OpenCV's stubs do not tell one kind of image from the other; the names do.
ByteImage = MatLike
FloatImage = MatLike


@dataclass(frozen=True, slots=True)
class PeerConfig:
    """Panel, camera and receiver; the defaults are the paper's Table 1 and, below the sensor, our choices.

    Example:
        >>> round(PeerConfig().px_per_m(50.0), 2)
        72.73
    """

    rows: int = 8
    columns: int = 8
    led_diameter_m: float = 0.03
    led_pitch_m: float = 0.06
    led_reflectance: float = 0.4
    background_reflectance: float = 0.18
    board_reflectance: float = 0.4
    visibility_m: float = 40_000.0
    focal_length_m: float = 0.025
    pixel_m: float = 13.2e-3 / 1920
    sensor_px: tuple[int, int] = (1080, 1920)
    gamma: float = 2.2
    blur_sigma_px: float = 1.5
    blur_kernel_px: int = 13
    closing_px: int = 11
    min_area_px: float = 50.0
    max_area_share: float = 0.25
    min_rectangularity: float = 0.5
    samples_per_cell: int = 8

    def px_per_m(self, distance_m: float) -> float:
        """Scale of the pinhole image, in pixels a metre at ``distance_m``."""
        return self.focal_length_m / (self.pixel_m * distance_m)


def disc_coverage(x_edges: Floats, y_edges: Floats, radius_px: float) -> Floats:
    """Measure exactly how much of each pixel a disc at the origin covers.

    The area of the disc left of x and above y has a closed form; its second difference is a pixel's share.

    Args:
        x_edges: (..., 1, W+1) pixel edges relative to the disc's centre, px.
        y_edges: (..., H+1, 1) likewise.
        radius_px: above 0.

    Returns:
        (..., H, W) covered areas, 0 to 1 px2.

    Example:
        >>> edges = np.arange(-2.0, 3.0)
        >>> round(float(disc_coverage(edges[None, :], edges[:, None], 1.5).sum() / math.pi), 9)
        2.25
    """
    x, y = np.clip(x_edges / radius_px, -1, 1), np.clip(y_edges / radius_px, -1, 1)
    left = x * np.sqrt(1 - x * x) + np.arcsin(x) + math.pi / 2
    above = y * np.sqrt(1 - y * y) + np.arcsin(y) + math.pi / 2
    both = left + above
    corner_inside = x * y + both / 2 - math.pi / 4
    # Outside the disc a corner cuts off the left part, the upper part, neither or both.
    corner_outside = np.where(
        (x > 0) & (y > 0), both - math.pi, np.minimum(left, above)
    )
    corner_outside = np.where((x < 0) & (y < 0), 0.0, corner_outside)
    area = np.where(x * x + y * y < 1, corner_inside, corner_outside) * radius_px**2
    covered: Floats = np.diff(np.diff(area, axis=-1), axis=-2)
    return covered


def share_covered(first: int, count: int, centre: float, length: float) -> Floats:
    """Share of each of ``count`` pixels from ``first`` on that an interval about ``centre`` covers."""
    low = np.maximum(first + np.arange(count), centre - length / 2)
    high = np.minimum(first + np.arange(1, count + 1), centre + length / 2)
    covered: Floats = np.clip(high - low, 0, None)
    return covered


def draw_panel(
    led_excess: Floats,
    board_excess: float,
    centre_px: tuple[float, float],
    px_per_m: float,
    cfg: PeerConfig,
) -> tuple[FloatImage, int, int]:
    """Draw the exposure of board and LEDs above the background's on a canvas that holds them.

    Args:
        led_excess: (R,C) exposure of each LED less the board's, in units of the background's.
        board_excess: exposure of the board less the background's, in units of the background's.
        centre_px: ``(x, y)`` of the panel's centre on the sensor.
        px_per_m: image scale.
        cfg: panel geometry.

    Returns:
        The canvas (H,W), and the sensor row and column of its first pixel.
    """
    rows, columns = led_excess.shape
    pitch, radius = cfg.led_pitch_m * px_per_m, cfg.led_diameter_m / 2 * px_per_m
    x = centre_px[0] + (np.arange(columns) - (columns - 1) / 2) * pitch
    y = centre_px[1] + (np.arange(rows) - (rows - 1) / 2) * pitch
    window = np.arange(math.ceil(2 * radius) + 1)
    edges = np.arange(len(window) + 1)
    first_x, first_y = (
        np.floor(x - radius).astype(int),
        np.floor(y - radius).astype(int),
    )
    coverage = disc_coverage(
        ((first_x - x)[:, None] + edges)[None, :, None, :],
        ((first_y - y)[:, None] + edges)[:, None, :, None],
        radius,
    )
    # As wide as the lattice of cells, and a pixel more for the windows of the outer LEDs.
    left, top = (
        math.floor(middle - count * pitch / 2) - 1
        for middle, count in zip(centre_px, (columns, rows), strict=True)
    )
    width, height = (math.ceil(count * pitch) + 4 for count in (columns, rows))
    pixel_x = (first_x[:, None] + window - left)[None, :, None, :]
    pixel_y = (first_y[:, None] + window - top)[:, None, :, None]
    light = led_excess[:, :, None, None] * coverage
    index = np.broadcast_to(pixel_y * width + pixel_x, light.shape)
    canvas = np.bincount(index.ravel(), light.ravel(), minlength=height * width)
    across = share_covered(left, width, centre_px[0], columns * pitch)
    down = share_covered(top, height, centre_px[1], rows * pitch)
    board = board_excess * np.outer(down, across)
    return (canvas.reshape(height, width) + board).astype(np.float32), top, left


def encode(
    exposure: FloatImage, background_grey: float, gamma: float, out: ByteImage
) -> None:
    """Gamma-encode, clip and round exposure in units of the background's (Eq. 1), overwriting ``exposure``.

    A logarithm, a product and an exponential are what ``cv2.pow`` computes (equal to 3e-7), at half its time.
    """
    cv2.log(exposure, exposure)
    exposure *= np.float32(1 / gamma)
    cv2.exp(exposure, exposure)
    cv2.convertScaleAbs(exposure, out, background_grey)


def overlap(start: int, length: int, limit: int) -> tuple[slice, slice]:
    """Cut an interval to a sensor axis: where it lies on the sensor, and which part of itself that is.

    Example:
        >>> overlap(-2, 5, 100)
        (slice(0, 3, None), slice(2, 5, None))
    """
    first, last = max(start, 0), min(start + length, limit)
    if first >= last:
        raise ValueError(
            f"the panel covers pixels {start} to {start + length}: all are off the sensor"
        )
    return slice(first, last), slice(first - start, last - start)


@lru_cache(maxsize=1)
def scratch(sensor_px: tuple[int, int]) -> tuple[FloatImage, FloatImage]:
    """Keep two frames of floats between calls: fresh ones cost 2 ms in page faults each time."""
    return np.empty(sensor_px, np.float32), np.empty(sensor_px, np.float32)


def render_frame(
    bits: Bits,
    ambient_lx: float,
    led_luminance_cd_m2: float,
    distance_m: float,
    background_grey: float,
    offset_x_m: float,
    offset_y_m: float,
    cfg: PeerConfig,
    *,
    full: bool = True,
    out: ByteImage | None = None,
) -> ByteImage:
    """Render one frame: exposure (Eqs. 2, 3, 20), blooming, then gamma, clipping and rounding (Eq. 1).

    Auto-ISO gives the background its grey value, so exposure is counted in units of the background's.
    One thread of a process at a time: float frames are kept between calls.

    Args:
        bits: (R,C), True is On.
        ambient_lx: above 0.
        led_luminance_cd_m2: an On LED's own light, the only light that the air attenuates.
        distance_m: above 0.
        background_grey: grey value of the background, digital numbers.
        offset_x_m: panel centre right of the optical axis.
        offset_y_m: panel centre below the optical axis.
        cfg: panel and camera.
        full: blur and encode the whole sensor; False does so around the panel only and fills the rest with
            the background's grey value, which gives the same frame.
        out: (H,W) uint8 to write to, which saves the page faults of a new frame.

    Returns:
        (H,W) grey values of the whole sensor.

    Raises:
        ValueError: no part of the panel is on the sensor.
    """
    background = cfg.background_reflectance * ambient_lx / math.pi
    board = cfg.board_reflectance * ambient_lx / math.pi
    off = cfg.led_reflectance * ambient_lx / math.pi
    emitted = led_luminance_cd_m2 * math.exp(-3.91 * distance_m / cfg.visibility_m)
    scale = cfg.px_per_m(distance_m)
    height, width = cfg.sensor_px
    centre = (width / 2 + offset_x_m * scale, height / 2 + offset_y_m * scale)
    leds = (off + emitted * bits - board) / background
    light, top, left = draw_panel(leds, board / background - 1, centre, scale, cfg)
    if not full:
        reach = cfg.blur_kernel_px // 2
        light, top, left = np.pad(light, reach), top - reach, left - reach
    rows, light_rows = overlap(top, light.shape[0], height)
    columns, light_columns = overlap(left, light.shape[1], width)
    exposure = light[light_rows, light_columns] + 1
    blurred = np.empty_like(exposure)
    if full:
        region = exposure
        exposure, blurred = scratch(cfg.sensor_px)
        exposure.fill(1)
        exposure[rows, columns] = region

    kernel = (cfg.blur_kernel_px, cfg.blur_kernel_px)
    cv2.GaussianBlur(
        exposure, kernel, cfg.blur_sigma_px, blurred, borderType=cv2.BORDER_REPLICATE
    )

    frame = np.empty(cfg.sensor_px, np.uint8) if out is None else out
    if not full:
        frame.fill(min(round(background_grey), 255))
    encode(blurred, background_grey, cfg.gamma, frame if full else frame[rows, columns])
    return frame
