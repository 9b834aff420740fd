"""A recorded frame, and how colour, bit depth and the camera's position become one plane of greys."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from PIL import Image

from vocc_torch.arrays import Bytes, Numbers

WHITE_LEVELS = (1, 255, 1023, 4095, 16383, 65535)
"""Grey value of white in pictures of floats and of 8, 10, 12, 14 and 16 bits."""


@dataclass(frozen=True, slots=True)
class RecordedFrame:
    """One frame of a recording.

    Args:
        source: the file's name.
        index: the frame's number in its file, from 0.
        time_s: when the frame was taken, for a film or a camera; else None.
        colour: (H,W,3) uint8, for drawing.
        grey: (H,W) uint8, for decoding.
        light: the colour of light that ``grey`` holds, where several are sent at once; else empty.
        note: what the reader assumed about the file, such as its bit depth; else empty.
        arrived_s: monotonic clock when a live frame arrived; else None.
    """

    source: str
    index: int
    time_s: float | None
    colour: Bytes = field(repr=False)
    grey: Bytes = field(repr=False)
    light: str = ""
    note: str = ""
    arrived_s: float | None = None


def to_grey(colour: Bytes, channel: str) -> Bytes:
    """Reduce colour (H,W,3) to grey (H,W): Rec. 601 luma, the brightest channel or one channel.

    Example:
        >>> to_grey(np.array([[[255, 0, 0]]], dtype=np.uint8), "luma").item()
        76
    """
    if channel == "luma":
        return np.asarray(Image.fromarray(colour).convert("L"), dtype=np.uint8)
    if channel == "max":
        brightest: Bytes = colour.max(axis=2)
        return brightest
    return np.ascontiguousarray(colour[..., ("red", "green", "blue").index(channel)])


def to_bytes(values: Numbers) -> tuple[Bytes, str]:
    """Scale grey values of any depth to 8 bits by the smallest usual white level that holds them.

    Args:
        values: integers from 0 to 65535, or floats from 0 to 1 or to one of the integer white levels.

    Returns:
        The 8-bit values, and a note where a white level other than that of the type was taken.

    Raises:
        ValueError: negative, infinite or larger values.

    Example:
        >>> to_bytes(np.array([[0, 1023]], dtype=np.uint16))
        (array([[  0, 255]], dtype=uint8), 'grey values up to 1023 are read as 10 bits')
    """
    if values.dtype == np.uint8:
        return values, ""
    if values.dtype.kind not in "biuf":
        raise ValueError(f"it holds {values.dtype}: it must hold integers or floats")
    # In Python's numbers, for 65535 is none of float16.
    lowest = values.min(initial=0).item()
    highest = values.max(initial=0).item()
    if not (lowest >= 0 and highest <= WHITE_LEVELS[-1]):
        raise ValueError(
            f"it holds {values.dtype} from {lowest} to {highest}: "
            f"it must hold values from 0 to {WHITE_LEVELS[-1]}"
        )
    levels = WHITE_LEVELS if values.dtype.kind in "bf" else WHITE_LEVELS[2:]
    white = next(level for level in levels if highest <= level)
    note = f"grey values up to {highest:g} are read as {white.bit_length()} bits"
    scaled = np.rint(values * (255.0 / white)).astype(np.uint8)
    return scaled, "" if white in (1, WHITE_LEVELS[-1]) else note


def turned(
    recording: Iterator[RecordedFrame], turn: int, mirror: bool
) -> Iterator[RecordedFrame]:
    """Turn each frame clockwise and then mirror it left to right, so that the panel stands upright.

    Args:
        recording: the frames.
        turn: 0, 90, 180 or 270 degrees.
        mirror: whether left and right are exchanged.
    """
    if not turn and not mirror:
        return recording

    def upright(plane: Bytes) -> Bytes:
        rotated = np.rot90(plane, -turn // 90)
        return np.ascontiguousarray(rotated[:, ::-1] if mirror else rotated)

    return (
        replace(frame, colour=upright(frame.colour), grey=upright(frame.grey))
        for frame in recording
    )
