"""The best receiver of full-HD frames that we can write in plain NumPy and OpenCV, beside ours.

It locates the panel with the paper's steps (Otsu, closing, components, blob analysis, rectangle), resamples
it with ``cv2.remap`` to our grid and measures the same features; it shares no code with ``vocc_torch``. It
passes over the whole frame with OpenCV's own functions or, if ``skipping``, has taken over our shortcut: to
look only once at what is of one grey value.

It has one closing where ours has a ladder: it does not read panels nearer than some 28 m.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import lru_cache
from threading import get_ident

import cv2
import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float32]
Bits = NDArray[np.bool_]

RING = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.float32) / 8
"""Mean of a cell's eight neighbours (Eq. 9)."""

LEAST_COMPACTNESS = 0.81
LEAST_RECTANGULARITY = 0.5


@dataclass
class PeerReceiver:
    """Bits of full-HD frames, one frame after the other or in threads.

    Args:
        direction: (3,) Fisher's weights of AGR, GRI and NGR.
        threshold: of the projection.
        skipping: whether it looks only once at what is of one grey value.
        rows: LED rows.
        columns: LED columns.
        samples: K, samples along a cell's side.
        closing_px: side of the closing's square, px, odd.
        min_area_px: least area of a closed blob, px^2.
    """

    direction: NDArray[np.float64]
    threshold: float
    skipping: bool = False
    rows: int = 8
    columns: int = 8
    samples: int = 8
    closing_px: int = 11
    min_area_px: int = 100
    masks: dict[int, Bytes] = field(default_factory=dict)

    def read(self, frame: Bytes) -> tuple[Bits, Floats | None]:
        """Read the (R,C) bits of one frame, and the (4,2) corners; all Off and None where none is found."""
        found = self.foreground(frame)
        corners = None if found is None else self.corners(*found)
        if corners is None:
            return np.zeros((self.rows, self.columns), bool), None
        features = self.features(self.rectified(frame, corners), corners)
        return features @ self.direction >= self.threshold, corners

    def read_all(self, frames: Bytes, pool: ThreadPoolExecutor | None = None) -> Bits:
        """Read the bits (B,R,C) of frames (B,H,W), in a pool's threads if one is given."""
        each = map if pool is None else pool.map
        return np.stack([bits for bits, _ in each(self.read, frames)])

    def foreground(self, frame: Bytes) -> tuple[Bytes, int, int] | None:
        """Threshold by Otsu: the mask of the foreground's box, and the box's first column and row."""
        left = top = 0
        if self.skipping and (box := uneven_box(frame)) is not None:
            left, top, width, height = box
            if not width:
                return None
            level, part = (
                int(frame[0, 0]),
                frame[top : top + height, left : left + width],
            )
            threshold = otsu(part, level, frame.size - part.size)
            if level > threshold:
                left, top, part = 0, 0, frame
            mask = cv2.threshold(part, threshold, 255, cv2.THRESH_BINARY)[1]
        else:
            # The mask is kept between calls: fresh pages would double the threshold's time. One a thread.
            kept = self.masks.get(get_ident())
            if kept is None or kept.shape != frame.shape:
                kept = self.masks[get_ident()] = np.empty(frame.shape, np.uint8)
            mask = cv2.threshold(
                frame, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU, kept
            )[1]
        x, y, width, height = cv2.boundingRect(mask)
        if not width:
            return None
        return mask[y : y + height, x : x + width], left + x, top + y

    def corners(self, mask: Bytes, left: int, top: int) -> Floats | None:
        """Close the box of the foreground, and give the rectangle around the most panel-like component."""
        edge = self.closing_px
        room = cv2.copyMakeBorder(
            mask, edge, edge, edge, edge, cv2.BORDER_CONSTANT, value=0
        )
        closed = cv2.morphologyEx(room, cv2.MORPH_CLOSE, square(edge))[
            edge:-edge, edge:-edge
        ]
        best, best_score = None, 0.0
        outlines, _ = cv2.findContours(
            closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
        )
        for outline in outlines:
            if len(outlines) == 1:
                area, lit = cv2.countNonZero(closed), mask
            else:
                inside = cv2.drawContours(
                    np.zeros_like(mask), [outline], -1, 255, cv2.FILLED
                )
                area, lit = (
                    cv2.countNonZero(cv2.bitwise_and(inside, closed)),
                    cv2.bitwise_and(inside, mask),
                )
            if area < self.min_area_px:
                continue
            score, corners = self.judged(lit, area)
            if score > best_score:
                best, best_score = corners, score
        return None if best is None else best + np.array([left, top], np.float32)

    def judged(self, lit: Bytes, closed_px: int) -> tuple[float, Floats]:
        """Say how panel-like the foreground of a component is, 0 if it is none; give its rectangle."""
        hull = cv2.convexHull(cv2.findNonZero(lit))
        (x, y), (width, height), angle = cv2.minAreaRect(hull)
        width, height = width + 1, height + 1
        box = clockwise(cv2.boxPoints(((x + 0.5, y + 0.5), (width, height), angle)))
        _, _, wide, high = cv2.boundingRect(hull)
        area = cv2.contourArea(hull) + (wide - 1) + (high - 1) + 1
        around = cv2.arcLength(hull, True) + 4
        ideal = math.pi * self.rows * self.columns / (self.rows + self.columns) ** 2
        compact = 4 * math.pi / ideal * area / around**2
        compact = min(compact, 1 / compact)
        filled = min(closed_px, area) / (width * height)
        if compact < LEAST_COMPACTNESS or filled < LEAST_RECTANGULARITY:
            return 0.0, box
        first, second = np.linalg.norm(box[1] - box[0]), np.linalg.norm(box[2] - box[1])
        sides = float(first * self.rows / (second * self.columns))
        return filled * compact * min(sides, 1 / sides) ** 2, box

    def rectified(self, frame: Bytes, corners: Floats) -> Floats:
        """Resample the panel and a cell of margin bilinearly to K x K samples a cell."""
        k = self.samples
        edges = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        cell = (
            max(
                float(edges[0] + edges[2]) / self.columns,
                float(edges[1] + edges[3]) / self.rows,
            )
            / 2
        )
        finer = max(1, round(cell / k))
        low, high = corners.min(axis=0), corners.max(axis=0)
        reach = (high - low) / min(self.rows, self.columns) * 1.5 + 3
        left, top = np.maximum(low - reach, 0).astype(int)
        right, bottom = (high + reach).astype(int)
        # Only the samples' surroundings become floats.
        crop = frame[top:bottom, left:right].astype(np.float32)
        across, down = grid(self.rows, self.columns, k * finer)
        origin = corners[0] - np.array([left, top], np.float32) - np.float32(0.5)
        step_x, step_y = (
            (corners[1] - corners[0]) / self.columns,
            (corners[3] - corners[0]) / self.rows,
        )
        at_x = origin[0] + across * step_x[0] + down * step_y[0]
        at_y = origin[1] + across * step_x[1] + down * step_y[1]
        fine = cv2.remap(
            crop, at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        size = (k * (self.columns + 2), k * (self.rows + 2))
        return (
            fine if finer == 1 else cv2.resize(fine, size, interpolation=cv2.INTER_AREA)
        )

    def features(self, patch: Floats, corners: Floats) -> Floats:
        """Measure AGR (Eq. 4), GRI (Eq. 7, Sobel, in grey values a pixel) and NGR (Eq. 9), (R,C,3)."""
        k, rows, columns = self.samples, self.rows, self.columns
        cells = cv2.resize(patch, (columns + 2, rows + 2), interpolation=cv2.INTER_AREA)
        mean = cells[1:-1, 1:-1].mean()
        edges = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        inner, (to_x, to_y) = (slice(k, -k), slice(k, -k)), inward(rows, columns, k)
        scale_x, scale_y = (
            k * columns * 2 / (edges[0] + edges[2]),
            k * rows * 2 / (edges[1] + edges[3]),
        )
        towards = cv2.Sobel(patch, cv2.CV_32F, 1, 0, scale=scale_x / 8)[inner] * to_x
        towards += cv2.Sobel(patch, cv2.CV_32F, 0, 1, scale=scale_y / 8)[inner] * to_y
        found = np.empty((rows, columns, 3), np.float32)
        found[..., 0] = cells[1:-1, 1:-1] / mean
        found[..., 1] = cv2.resize(
            towards, (columns, rows), interpolation=cv2.INTER_AREA
        )
        found[..., 2] = cv2.filter2D(cells, -1, RING)[1:-1, 1:-1] / mean
        return found


def uneven_box(frame: Bytes) -> tuple[int, int, int, int] | None:
    """Bound what is not of the first pixel's grey value: left, top, width, height; None if that is most."""
    level = frame[0, 0]
    if (frame[0] != level).any():
        return None
    columns = np.flatnonzero((frame.max(0) != level) | (frame.min(0) != level))
    if not len(columns):
        return 0, 0, 0, 0
    left, right = int(columns[0]), int(columns[-1]) + 1
    if 2 * (right - left) > frame.shape[1]:
        return None
    rows = np.flatnonzero((frame[:, left:right] != level).any(1))
    return left, int(rows[0]), right - left, int(rows[-1]) + 1 - int(rows[0])


def otsu(part: Bytes, level: int, outside_px: int) -> int:
    """Find Otsu's threshold of a frame of which all but ``part`` is of one grey value."""
    counts = np.bincount(part.ravel(), minlength=256).astype(np.float64)
    counts[level] += outside_px
    below, mass = counts.cumsum(), (counts * np.arange(256)).cumsum()
    rest = below[-1] - below
    apart = mass[-1] * below - mass * below[-1]
    between = apart * apart / np.maximum(below * rest, 1.0)
    between[(counts == 0) | (rest == 0)] = -1.0
    return (
        int(between.argmax()) if np.count_nonzero(counts) > 1 else int(counts.argmax())
    )


@lru_cache(maxsize=4)
def square(side: int) -> Bytes:
    """Lay the closing's kernel."""
    return cv2.getStructuringElement(cv2.MORPH_RECT, (side, side))


def clockwise(corners: Floats) -> Floats:
    """Order a rectangle's (4,2) corners clockwise, the first side turned by -45 to 45 degrees."""
    (ax, ay), (bx, by) = corners[1] - corners[0], corners[2] - corners[1]
    ordered = corners if ax * by - ay * bx > 0 else corners[::-1]
    for first in range(4):
        turned = np.roll(ordered, -first, axis=0)
        x, y = turned[1] - turned[0]
        if x > 0 and -x < y <= x:
            return turned
    return ordered


@lru_cache(maxsize=16)
def grid(rows: int, columns: int, fine: int) -> tuple[Floats, Floats]:
    """Give the samples' cell coordinates, (1,w) columns and (h,1) rows, with a cell of margin."""
    x, y = (
        (np.arange((cells + 2) * fine) + 0.5) / fine - 1 for cells in (columns, rows)
    )
    return x.astype(np.float32)[None], y.astype(np.float32)[:, None]


@lru_cache(maxsize=8)
def inward(rows: int, columns: int, k: int) -> tuple[Floats, Floats]:
    """Tile the unit vectors that point to each cell's centre (Eq. 8) over R x C cells of K x K samples."""
    across = (k - 1) / 2 - np.arange(k)
    length = np.hypot(across[None, :], across[:, None])
    length[length == 0] = 1
    x = (across[None, :] / length).astype(np.float32)
    return np.tile(x, (rows, columns)), np.tile(x.T, (rows, columns))
