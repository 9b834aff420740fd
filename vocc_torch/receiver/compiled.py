"""One whole frame located and read by compiled loops, to the last bit as without them.

NumPy and torch take dozens of small steps for it, and each costs some microseconds whatever its size. The
loops are used from ``import vocc_torch.receiver.loops`` on, which needs the extra ``compiled`` (Numba).
"""

import sys
from types import ModuleType
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from vocc_torch.receiver.components import close_mask
from vocc_torch.receiver.foreground import BLOCK_PX
from vocc_torch.receiver.limits import LocatorLimits
from vocc_torch.receiver.quadrilateral import Measures, measures_of, upright_alone
from vocc_torch.types import Frames, PanelShape

Floats = NDArray[np.float32]


class Alone(NamedTuple):
    """A blob whose least rectangle is upright, and the area of its closing, px^2."""

    measures: Measures
    area_px: int


def measure_alone(frames: Frames, shape: PanelShape, search: LocatorLimits, most_px: int) -> Alone | None:
    """Measure the one blob of a whole frame whose light lies in a small box on one grey value.

    Args:
        frames: uint8 frames.
        shape: the panel looked for.
        search: limits and settings.
        most_px: of the box.

    Returns:
        None where there are several blobs or a turned one, or more light, and without the loops.
    """
    grey, (height, width) = frames.grey, frames.grey.shape[-2:]
    whole = frames.surround is None and frames.sensor_px == (height, width)
    if len(grey) != 1 or not whole or width % BLOCK_PX or grey.device.type != "cpu":
        return None
    plane, loops = grey.numpy()[0, 0], _loops()
    if loops is None or not plane.flags.c_contiguous:
        return None
    limit, left, top, wide, high = loops.lit_box(plane, plane.view(np.uint64))
    if not 0 < wide * high <= most_px:
        return None
    mask = plane[top : top + high, left : left + wide] > limit
    closed = close_mask(torch.from_numpy(mask)[None, None], search.closing_px)[0, 0].numpy()
    area_px, area, perimeter, *ends = loops.upright_blob(mask, closed)
    if not area_px:
        return None
    least = upright_alone(*ends)
    place = frames.origin_px.numpy() + np.array([[left, top]])
    area, perimeter, area_px = (np.array([one]) for one in (area, perimeter, area_px))
    return Alone(measures_of(area, perimeter, area_px, least, least, place, shape, search), area_px[0])


def read_alone(frames: Frames, begin: NDArray[np.float64], x: Floats, y: Floats) -> torch.Tensor | None:
    """Read one frame bilinearly at places x (w,) by y (h,), (1,1,h,w); beyond the frame its border goes on.

    Args:
        frames: one uint8 frame or crop.
        begin: (1,2) its column and row from which places count.
        x: float32, at least 0.
        y: likewise.

    Returns:
        None without the loops, or where the frame is no plain plane of bytes.
    """
    grey, loops = frames.grey, _loops()
    if loops is None or grey.dtype != torch.uint8 or x.dtype != np.float32 or not grey.is_contiguous():
        return None
    read = np.empty((1, 1, len(y), len(x)), np.float32)
    (left, top), plane = begin[0].tolist(), grey.numpy()[0, 0]
    loops.read_lines(plane, int(left), int(top), x, y, read[0, 0])
    return torch.from_numpy(read)


def _loops() -> ModuleType | None:
    """Give the loops if they were imported: compiling takes seconds, which a few frames never repay."""
    return sys.modules.get("vocc_torch.receiver.loops")
