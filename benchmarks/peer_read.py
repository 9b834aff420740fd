"""The peer's receiver: one full-HD frame to LED features and bits, in plain NumPy and OpenCV.

It finds the panel as in section IV-B-2 (Otsu, closing, blob analysis, rectangle) and works on the whole frame
in 8 bits only; from the closing on, it sees no more than the region that holds the foreground.
"""

from functools import lru_cache

import cv2
import numpy as np
from peer_render import Bits, ByteImage, FloatImage, Floats, PeerConfig

RING = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.float32) / 8
"""Mean of a cell's eight neighbours (Eq. 9)."""


@lru_cache(maxsize=1)
def scratch(shape: tuple[int, ...]) -> ByteImage:
    """Keep the frame's mask between calls: a fresh one would double the threshold's time in page faults."""
    return np.empty(shape, np.uint8)


def close_foreground(
    frame: ByteImage, closing_px: int
) -> tuple[ByteImage, int, int] | None:
    """Binarise by Otsu's threshold, then close the region that holds the foreground.

    The region keeps a margin of the closing's length, beyond which closing changes nothing: the result is the
    whole frame's.

    Returns:
        The closed mask, and the frame row and column of its first pixel; None without any foreground.
    """
    _, mask = cv2.threshold(
        frame, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU, scratch(frame.shape)
    )
    x, y, width, height = cv2.boundingRect(mask)
    if width == 0:
        return None
    top, left = max(y - closing_px, 0), max(x - closing_px, 0)
    region = mask[top : y + height + closing_px, left : x + width + closing_px]
    kernel = cv2.getStructuringElement(cv2.MORPH_RECT, (closing_px, closing_px))
    return cv2.morphologyEx(region, cv2.MORPH_CLOSE, kernel), top, left


def find_panel(mask: ByteImage, cfg: PeerConfig) -> FloatImage | None:
    """Pick the largest compact, rectangular blob, and give the corners of its minimum-area rectangle.

    Contours run through pixel centres: a blob's outline lies half a pixel further out.

    Returns:
        (4,2) corners in pixels of the mask, clockwise from the top left; None where no blob qualifies.
    """
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    best: FloatImage | None = None
    best_area = cfg.min_area_px
    for contour in contours:
        area = cv2.contourArea(contour) + cv2.arcLength(contour, True) / 2 + 1
        if (
            not best_area
            <= area
            <= cfg.max_area_share * cfg.sensor_px[0] * cfg.sensor_px[1]
        ):
            continue
        (x, y), (width, height), angle = cv2.minAreaRect(contour)
        if area >= cfg.min_rectangularity * (width + 1) * (height + 1):
            box = cv2.boxPoints(((x + 0.5, y + 0.5), (width + 1, height + 1), angle))
            best, best_area = clockwise_from_top_left(box), area
    return best


def clockwise_from_top_left(corners: FloatImage) -> FloatImage:
    """Reorder a rectangle's (4,2) corners, given in either sense of rotation.

    Example:
        >>> clockwise_from_top_left(np.float32([[4, 0], [0, 0], [0, 2], [4, 2]])).tolist()
        [[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]]
    """
    (ax, ay), (bx, by) = corners[1] - corners[0], corners[2] - corners[1]
    ordered = corners if ax * by - ay * bx > 0 else corners[::-1]
    return np.roll(ordered, -int(np.argmin(ordered.sum(axis=1))), axis=0)


def rectify(frame: ByteImage, corners_px: FloatImage, cfg: PeerConfig) -> FloatImage:
    """Resample the panel and one cell of margin to K x K samples a cell, bilinearly.

    Returns:
        (H,W) = ((R+2)K, (C+2)K) grey values.
    """
    k = cfg.samples_per_cell
    right, bottom = k * (cfg.columns + 1) - 0.5, k * (cfg.rows + 1) - 0.5
    grid = np.array(
        [(k - 0.5, k - 0.5), (right, k - 0.5), (right, bottom), (k - 0.5, bottom)],
        np.float32,
    )
    to_frame = cv2.getPerspectiveTransform(grid, corners_px - np.float32(0.5))
    # Only the samples' surroundings become floats; the margin is a cell, here at most the panel's own extent.
    low, high = corners_px.min(axis=0), corners_px.max(axis=0)
    reach = (high - low) / min(cfg.rows, cfg.columns) * 1.5 + 2
    left, top = np.maximum(low - reach, 0).astype(int)
    stop_x, stop_y = (high + reach).astype(int)
    crop = frame[top:stop_y, left:stop_x].astype(np.float32)
    shift = np.array([[1, 0, -left], [0, 1, -top], [0, 0, 1]], np.float64)
    size = (k * (cfg.columns + 2), k * (cfg.rows + 2))
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpPerspective(
        crop, shift @ to_frame, size, flags=flags, borderMode=cv2.BORDER_REPLICATE
    )


@lru_cache(maxsize=8)
def inward_field(rows: int, columns: int, k: int) -> tuple[FloatImage, FloatImage]:
    """Tile the unit vectors that point to each cell's centre (Eq. 8) over R x C cells of K x K samples."""
    across = (k - 1) / 2 - np.arange(k)
    length = np.hypot(across[None, :], across[:, None])
    length[length == 0] = 1
    x = (across[None, :] / length).astype(np.float32)
    return np.tile(x, (rows, columns)), np.tile(x.T, (rows, columns))


def extract_features(
    patch: FloatImage, corners_px: FloatImage, cfg: PeerConfig
) -> FloatImage:
    """Compute AGR (Eq. 4), GRI (Eq. 7, Sobel's gradient in grey values an original pixel) and NGR (Eq. 9).

    Returns:
        (R,C,3) features.
    """
    k, rows, columns = cfg.samples_per_cell, cfg.rows, cfg.columns
    cells = cv2.resize(patch, (columns + 2, rows + 2), interpolation=cv2.INTER_AREA)
    panel_mean = cells[1:-1, 1:-1].mean()
    edges_px = np.linalg.norm(np.roll(corners_px, -1, axis=0) - corners_px, axis=1)
    samples_per_px_x = k * columns * 2 / (edges_px[0] + edges_px[2])
    samples_per_px_y = k * rows * 2 / (edges_px[1] + edges_px[3])
    inner = (slice(k, -k), slice(k, -k))
    inward_x, inward_y = inward_field(rows, columns, k)
    inwardness = (
        cv2.Sobel(patch, cv2.CV_32F, 1, 0, scale=samples_per_px_x / 8)[inner] * inward_x
    )
    inwardness += (
        cv2.Sobel(patch, cv2.CV_32F, 0, 1, scale=samples_per_px_y / 8)[inner] * inward_y
    )
    features = np.empty((rows, columns, 3), np.float32)
    features[..., 0] = cells[1:-1, 1:-1] / panel_mean
    features[..., 1] = cv2.resize(
        inwardness, (columns, rows), interpolation=cv2.INTER_AREA
    )
    features[..., 2] = cv2.filter2D(cells, -1, RING)[1:-1, 1:-1] / panel_mean
    return features


def read_frame(
    frame: ByteImage, cfg: PeerConfig
) -> tuple[FloatImage | None, FloatImage]:
    """Locate the panel in one frame and measure the features of its LEDs.

    Args:
        frame: (H,W) grey values of the whole sensor.
        cfg: panel and receiver.

    Returns:
        (4,2) corners on the sensor, clockwise from the top left, and (R,C,3) features AGR, GRI, NGR; None and
        zeros where no panel was found.
    """
    closed = close_foreground(frame, cfg.closing_px)
    corners = None if closed is None else find_panel(closed[0], cfg)
    if closed is None or corners is None:
        return None, np.zeros((cfg.rows, cfg.columns, 3), np.float32)
    corners += np.array([closed[2], closed[1]], np.float32)
    patch = rectify(frame, corners, cfg)
    features = extract_features(patch, corners, cfg)
    return corners, features


def decide(features: FloatImage, direction: Floats, threshold: float) -> Bits:
    """Decide (R,C) bits by Eq. 18: On where the features' projection is at least the threshold."""
    bits: Bits = features @ direction >= threshold
    return bits


def read_bits(
    frames: ByteImage, direction: Floats, threshold: float, cfg: PeerConfig
) -> Bits:
    """Read the bits (B,R,C) of frames (B,H,W), one after the other; Off where no panel was found."""
    decided = []
    for frame in frames:
        corners, features = read_frame(frame, cfg)
        decided.append(decide(features, direction, threshold) & (corners is not None))
    return np.stack(decided)
