"""Films as frames: upright, with each field of interlaced film as a frame of its own."""

import warnings
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from vocc_torch.arrays import Bytes
from vocc_torch.errors import VoccError, library, printable
from vocc_torch.recordings.frames import RecordedFrame, to_grey

FULL_RANGE = 2
"""FFmpeg's number for films whose greys use 0 to 255 (AVCOL_RANGE_JPEG)."""
STUDIO_BLACK = 16
"""Grey value of black in most films (ITU-R BT.601)."""
STUDIO_RANGE = 219
"""Grey values from black to white in most films (ITU-R BT.601)."""
STUDIO_TO_FULL = (
    np.rint((np.arange(256) - STUDIO_BLACK) * 255 / STUDIO_RANGE)
    .clip(0, 255)
    .astype(np.uint8)
    .tobytes()
)
"""Full-range grey value of each grey value of a film."""
FILMS = {
    "format_whitelist": "matroska,webm,mov,mp4,m4a,3gp,3g2,mj2,avi,mpeg,mpegvideo,mpegts,mjpeg,h264,hevc,m4v,"
    "asf,flv,ogg,yuv4mpegpipe,ivf,mxf,image2,png_pipe,jpeg_pipe,gif"
}
"""What a film may be, whatever its name says: playlists would open other files and wait for pipes."""
TURN_DEGREES = 90
INTERLACED = "interlaced film: each of its two fields is read as a frame"


def av_library(source: str) -> Any:
    """Import PyAV, which reads films.

    Raises:
        VoccError: it is not installed.
    """
    return library("av", "video", f"input {source} is a film")


def read_film(
    path: Path, channel: str, *, grey_only: bool = False
) -> Iterator[RecordedFrame]:
    """Read a film's frames; a warning says how many are damaged or missing.

    Args:
        path: the film.
        channel: how colour becomes grey.
        grey_only: leave out the colour, which takes most of the time; greys are then the film's own, within
            one grey value of ``luma``.

    Raises:
        VoccError: PyAV is not installed, or a file that is no film; at the end, frames that cannot be read.
    """
    av = av_library(str(path))
    done = declared = damaged = 0
    name, numbers, reason = printable(path.name), count(), ""
    try:
        # The prefix keeps FFmpeg from reading a file's name as an address.
        with av.open(f"file:{path.absolute()}", options=FILMS) as container:
            stream = container.streams.video[0]
            if grey_only:
                stream.thread_type = "AUTO"
            declared = declared_frames(container, stream, av.time_base)
            for packet in container.demux(stream):
                try:
                    pictures = packet.decode()
                except av.error.FFmpegError as error:  # later frames may be whole
                    reason = str(error)
                    continue
                for picture in pictures:
                    yield from frames_of(picture, name, numbers, channel, grey_only)
                    done += 1
                    damaged += picture.is_corrupt
    except (av.error.FFmpegError, IndexError, ValueError) as error:
        reason = str(error)
    if done and (done < declared or damaged):
        counts = f"{done} frames were read, {damaged} of them damaged, and its header speaks of {declared}"
        warnings.warn(f"input {path}: {counts}", stacklevel=2)
    if reason:
        raise VoccError(
            f"input {path} cannot be read as a video after {done} frames ({reason})"
        )
    if done == 0:
        raise VoccError(f"input {path} is a video without frames")


def promised_frames(path: Path) -> int:
    """Number of frames that the header of a film speaks of; 0 where it cannot be read."""
    av = av_library(str(path))
    try:
        with av.open(f"file:{path.absolute()}", options=FILMS) as container:
            return declared_frames(container, container.streams.video[0], av.time_base)
    except (av.error.FFmpegError, IndexError, ValueError):
        return 0


def declared_frames(container: Any, stream: Any, ticks_per_s: int) -> int:
    """Number of frames that a film's header speaks of, or that follow from its length and rate."""
    length_s = (stream.duration or 0) * float(stream.time_base or 0)
    length_s = length_s or (container.duration or 0) / ticks_per_s
    return stream.frames or round(length_s * float(stream.average_rate or 0))


def frames_of(
    picture: Any,
    source: str,
    numbers: Iterator[int],
    channel: str,
    grey_only: bool,
    arrived_s: float | None = None,
) -> Iterator[RecordedFrame]:
    """Convert a frame of PyAV: one frame, or two fields where the film is interlaced.

    Args:
        picture: the frame of PyAV.
        source: name of the film.
        numbers: of the frames of the film that are still to come.
        channel: how colour becomes grey.
        grey_only: whether the colour is left out.
        arrived_s: monotonic clock when it arrived.
    """
    turns = round((picture.rotation or 0) / TURN_DEGREES) % 4
    if grey_only:
        grey = grey_plane(picture)
        colour = np.broadcast_to(np.uint8(0), (*grey.shape, 3))
    else:
        colour = np.asarray(picture.to_ndarray(format="rgb24"), dtype=np.uint8)
        grey = to_grey(colour, channel)
    shown, time_s, later_s = [(colour, grey)], picture.time, 0.0
    note = f"turned by {-turns % 4 * TURN_DEGREES} degrees as the film's header says"
    if picture.interlaced_frame:
        note = INTERLACED
        # The second field is taken half a frame after the first.
        later_s = float((picture.duration or 0) * (picture.time_base or 0)) / 2
        shown = [(field(colour, parity), field(grey, parity)) for parity in (0, 1)]
    elif not turns:
        note = ""
    for colour, grey in shown:
        if turns:
            colour = np.ascontiguousarray(np.rot90(colour, turns))
            grey = np.ascontiguousarray(np.rot90(grey, turns))
        place = source, next(numbers), time_s
        yield RecordedFrame(*place, colour, grey, note=note, arrived_s=arrived_s)
        time_s = None if time_s is None else time_s + later_s


def field(plane: Bytes, parity: int) -> Bytes:
    """Fill a field of an interlaced frame up to full height, by the mean of its lines above and below.

    Args:
        plane: (H,W) or (H,W,3) of the frame, of at least two lines.
        parity: 0 for the upper field, whose lines are even; 1 for the lower field.

    Example:
        >>> field(np.array([[10], [0], [30], [0]], dtype=np.uint8), 0).ravel().tolist()
        [10, 20, 30, 30]
    """
    lines = plane[parity::2].astype(np.uint16)
    halves = np.arange(len(plane)) - parity
    above = lines.take(halves // 2, axis=0, mode="clip")
    below = lines.take((halves + 1) // 2, axis=0, mode="clip")
    return ((above + below + 1) // 2).astype(np.uint8)


def grey_plane(picture: Any) -> Bytes:
    """Take the greys (H,W) of a frame of PyAV."""
    if picture.format.name != "yuv420p" or picture.color_range == FULL_RANGE:
        return np.asarray(picture.to_ndarray(format="gray"), dtype=np.uint8)
    plane = picture.planes[0]
    lines = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
    greys = lines[: picture.height, : picture.width]
    converted = greys.tobytes().translate(STUDIO_TO_FULL)
    return np.frombuffer(converted, np.uint8).reshape(greys.shape)
