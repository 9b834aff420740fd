"""Loops over the pixels of one frame, compiled by Numba: import this where many frames come one at a time.

From then on a whole frame alone is located and read by them, with the very same result. The first call
compiles them, some five seconds, or takes them from Numba's cache, half a second.

Example:
    >>> plane = np.zeros((128, 256), np.uint8)
    >>> plane[20:40, 30:60] = 200
    >>> lit_box(plane, plane.view(np.uint64))
    (0, 30, 20, 30, 20)
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vocc_torch.receiver.foreground import BLOCK_PX, MOST_EXACT_PX, TIE_SHARE
from vocc_torch.receiver.quadrilateral import LENGTH_UNIT, TIE

Floats = NDArray[np.float32]

compiled = njit(cache=True, nogil=True)


@compiled
def lit_box(plane: NDArray[np.uint8], words: NDArray[np.uint64]) -> tuple[int, int, int, int, int]:
    """Find Otsu's threshold of a frame (H,W), and what lies above it: left, top, width and height.

    As :mod:`vocc_torch.receiver.foreground` does; all zeros where the first row is uneven, or more than half
    of the width, where what is around is foreground, or where thresholds are equally good.

    Args:
        plane: the frame.
        words: (H,W/8), its bytes by eight.
    """
    nothing = (0, 0, 0, 0, 0)
    (height, width), across, level, first = plane.shape, words.shape[1], plane[0, 0], words[0, 0]
    top, low, left, right = -1, -1, across, -1
    for row in range(height):
        uneven = np.uint64(0)
        for column in range(across):
            uneven |= words[row, column] ^ first
        if uneven and row == 0:
            return nothing
        if uneven:
            top, low = (row if top < 0 else top), row
            column = 0
            while words[row, column] == first:
                column += 1
            left, column = min(left, column), across - 1
            while words[row, column] == first:
                column -= 1
            right = max(right, column)
    for column in range(BLOCK_PX):
        if plane[0, column] != level:
            return nothing
    if top < 0 or 2 * (right + 1 - left) * BLOCK_PX > width or height * width > MOST_EXACT_PX:
        return nothing
    left, right = left * BLOCK_PX, right * BLOCK_PX + BLOCK_PX
    counts = np.zeros(256, np.int64)
    for row in range(top, low + 1):
        for column in range(left, right):
            counts[plane[row, column]] += 1
    counts[level] += height * width - (low + 1 - top) * (right - left)
    total, total_mass = height * width, 0
    for value in range(256):
        total_mass += value * counts[value]
    below, mass, best, second, limit = 0, 0, -1.0, -1.0, -1
    for value in range(256):
        below += counts[value]
        mass += value * counts[value]
        if counts[value] and below < total:
            apart = float(total_mass * below - mass * total)
            between = apart * apart / (float(below) * float(total - below))
            if between > best:
                second, best, limit = best, between, value
            elif between > second:
                second = between
    if level > limit or second >= best * (1 - TIE_SHARE):
        return nothing
    x0, x1, y0, y1 = width, -1, -1, -1
    for row in range(top, low + 1):
        for column in range(left, right):
            if plane[row, column] > limit:
                x0, x1, y0, y1 = min(x0, column), max(x1, column), (row if y0 < 0 else y0), row
    return limit, x0, y0, x1 + 1 - x0, y1 + 1 - y0


@compiled
def upright_blob(
    mask: NDArray[np.bool_], closed: NDArray[np.bool_]
) -> tuple[int, float, float, int, int, int, int]:
    """Measure what is foreground in a mask (H,W) that its closing (H,W) makes one 8-connected blob.

    As :mod:`vocc_torch.receiver.quadrilateral` does with the blob's hull.

    Returns:
        The closed area, px^2, and the hull's; its perimeter, px; its first and last column and row. All zeros
        where there are several blobs, or where a turned rectangle is smaller than the upright one.
    """
    nothing = (0, 0.0, 0.0, 0, 0, 0, 0)
    height, width = mask.shape
    # What touches the first pixel, to be compared with all that is there.
    area_px, reached, waiting = 0, 0, 0
    seen, stack = np.zeros((height, width), np.bool_), np.empty(height * width, np.int64)
    for row in range(height):
        for column in range(width):
            if closed[row, column]:
                if not area_px:
                    seen[row, column], stack[0], waiting = True, row * width + column, 1
                area_px += 1
    while waiting:
        waiting -= 1
        reached += 1
        row, column = divmod(stack[waiting], width)
        for y in range(max(row - 1, 0), min(row + 2, height)):
            for x in range(max(column - 1, 0), min(column + 2, width)):
                if closed[y, x] and not seen[y, x]:
                    seen[y, x], stack[waiting] = True, y * width + x
                    waiting += 1
    if reached < area_px:
        return nothing
    # The hull: down the last pixels of the rows, and up the first (Andrew 1979).
    xs, ys, count, begun = np.empty(2 * height, np.int64), np.empty(2 * height, np.int64), 0, 0
    for step in range(2 * height):
        row = step if step < height else 2 * height - 1 - step
        begun = count if step == height else begun
        column = width - 1 if step < height else 0
        while 0 <= column < width and not mask[row, column]:
            column += -1 if step < height else 1
        if not 0 <= column < width:
            continue
        while count > begun + 1 and (column - xs[count - 1]) * (ys[count - 1] - ys[count - 2]) >= (
            xs[count - 1] - xs[count - 2]
        ) * (row - ys[count - 1]):
            count -= 1
        xs[count], ys[count] = column, row
        count += 1
    xs, ys = xs[:count], ys[:count]
    left, right, top, low = xs.min(), xs.max(), ys.min(), ys.max()
    twice, around = 0, 0
    for one in range(count):
        after = (one + 1) % count
        across, down = xs[after] - xs[one], ys[after] - ys[one]
        square = across * across + down * down
        twice += xs[one] * ys[after] - ys[one] * xs[after]
        around += int(np.rint(math.sqrt(square) / LENGTH_UNIT))
        if across and down:
            along, beside = xs * across + ys * down, ys * across - xs * down
            spans = (along.max() - along.min()) * (beside.max() - beside.min())
            if (right - left) * (low - top) > spans / square * (1 + TIE):
                return nothing
    extent = right - left + low - top
    return area_px, twice / 2 + extent + 1, around * LENGTH_UNIT + 4, left, top, right, low


# As torch mixes: with one rounding, where the processor multiplies and adds at once.
@njit(cache=True, nogil=True, fastmath={"contract"})
def _mix(one: np.float32, other: np.float32, share: np.float32) -> np.float32:
    """Mix two numbers by the share of the other."""
    if share < np.float32(0.5):
        return one + share * (other - one)
    return other - (other - one) * (np.float32(1) - share)


@compiled
def read_lines(plane: NDArray[np.uint8], left: int, top: int, x: Floats, y: Floats, read: Floats) -> None:
    """Read a plane (H,W) bilinearly at places x (w,) from column ``left`` and y (h,) from row ``top``.

    Args:
        plane: grey values; beyond them the border goes on.
        left: column from which x counts.
        top: row from which y counts.
        x: at least 0.
        y: likewise.
        read: (h,w), written.
    """
    last_row, last = plane.shape[0] - 1, plane.shape[1] - 1
    for row in range(len(y)):
        whole = math.floor(y[row])
        down = y[row] - np.float32(whole)
        upper, lower = min(max(top + whole, 0), last_row), min(max(top + whole + 1, 0), last_row)
        for column in range(len(x)):
            whole = math.floor(x[column])
            right = x[column] - np.float32(whole)
            near, far = min(max(left + whole, 0), last), min(max(left + whole + 1, 0), last)
            read[row, column] = _mix(
                _mix(np.float32(plane[upper, near]), np.float32(plane[upper, far]), right),
                _mix(np.float32(plane[lower, near]), np.float32(plane[lower, far]), right),
                down,
            )
