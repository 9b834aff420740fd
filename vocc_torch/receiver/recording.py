"""Recordings as grey frames: a picture, a folder of pictures or a video."""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from vocc_torch.errors import VoccError, printable
from vocc_torch.files import PICTURE_FORMATS, PICTURE_SUFFIXES, VIDEO_SUFFIXES

GREYS = ".npy"
"""An array (N,H,W) uint8 of greys, as NumPy writes it."""

JPEG_RANGE = 2
"""FFmpeg's number for greys that use 0 to 255."""

SPREAD = np.rint((np.arange(256) - 16) * 255 / 219).clip(0, 255).astype(np.uint8).tobytes()
"""From greys as most films have them, 16 to 235, to 0 to 255."""


class FilmGrey:
    """Greys (H,W) uint8 as a film has them, 16 to 235, spread over 0 to 255 where they are taken.

    Windows are a NumPy array's; ``numpy.asarray`` gives the whole.

    Args:
        plane: (H,W) uint8 of the film.
    """

    def __init__(self, plane: NDArray[np.uint8]) -> None:
        self.plane, self.shape = plane, plane.shape

    def __getitem__(self, window: tuple[slice, slice]) -> NDArray[np.uint8]:
        """Spread the greys of a window."""
        part = self.plane[window]
        return np.frombuffer(part.tobytes().translate(SPREAD), np.uint8).reshape(part.shape)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[np.uint8]:
        """Spread all greys."""
        return self[:, :]


Grey = NDArray[np.uint8] | FilmGrey
"""A frame's greys (H,W)."""


@dataclass(frozen=True, slots=True)
class RecordedFrame:
    """One frame of a recording.

    Args:
        source: the file's name.
        index: the frame's number in its file, from 0.
        time_s: when the frame was taken, for a video; else None.
        colour: (H,W,3) uint8, for drawing on.
        grey: (H,W) uint8, for decoding; of a film read for its greys alone, worked out where they are taken.
        light: the colour of light that ``grey`` holds, where several are sent at once; else empty.
    """

    source: str
    index: int
    time_s: float | None
    colour: NDArray[np.uint8]
    grey: Grey
    light: str = ""


def to_grey(colour: NDArray[np.uint8], channel: str) -> NDArray[np.uint8]:
    """Turn colour into grey: Rec. 601 luma, the brightest channel or one channel; (H,W,3) to (H,W) uint8.

    Example:
        >>> to_grey(np.array([[[255, 0, 0]]], dtype=np.uint8), "luma").item()
        76
    """
    if channel == "luma":
        return np.asarray(Image.fromarray(colour).convert("L"), dtype=np.uint8)
    if channel == "max":
        brightest: NDArray[np.uint8] = colour.max(axis=2)
        return brightest
    return np.ascontiguousarray(colour[..., ("red", "green", "blue").index(channel)])


def read_recording(path: Path, channel: str, *, grey_only: bool = False) -> Iterator[RecordedFrame]:
    """Read frames one by one, pictures of a folder in the order of their names.

    What cannot be read is passed over and refused at the end, after all the frames that could be.

    Args:
        path: a picture, which may have several frames or pages, a folder of pictures, a video or an array.
        channel: how colour becomes grey.
        grey_only: leave out the colour, which takes a video most of its time; the grey is then the video's
            own, up to a grey value from that of ``luma``.

    Raises:
        VoccError: an input that is missing or empty, at once; at the end, what could not be read.
    """
    wanted = "give a picture, a folder of pictures or a video"
    if not path.exists():
        raise VoccError(f"input {path} does not exist: {wanted}")
    if path.is_dir():
        pictures = sorted(p for p in path.iterdir() if p.suffix.lower() in PICTURE_SUFFIXES and p.is_file())
        if not pictures:
            raise VoccError(f"input {path} holds no picture: known endings are {' '.join(PICTURE_SUFFIXES)}")
        return read_pictures(pictures, channel)
    if not path.is_file():
        raise VoccError(f"input {path} is a pipe or a device: {wanted}")
    if path.suffix.lower() in VIDEO_SUFFIXES:
        return read_video(path, channel, grey_only=grey_only and channel == "luma")
    if path.suffix.lower() == GREYS:
        return read_greys(path)
    return read_picture(path, channel)


def read_pictures(paths: Sequence[Path], channel: str) -> Iterator[RecordedFrame]:
    """Read pictures one after the other.

    Raises:
        VoccError: at the end, which pictures cannot be read.
    """
    bad: list[str] = []
    for path in paths:
        try:
            yield from read_picture(path, channel)
        except VoccError as error:
            bad.append(str(error))
    if bad:
        raise VoccError("; ".join(bad[:5]) + f"; and {len(bad) - 5} more" * (len(bad) > 5))


def read_picture(path: Path, channel: str) -> Iterator[RecordedFrame]:
    """Read a picture the way up that it is shown, and all frames or pages of it.

    16-bit greys are scaled to 8 bits; of transparent pixels the colour is taken, and how transparent they are
    does not matter. Of a JPEG only the picture itself is taken, not the previews that cameras put behind it.

    Raises:
        VoccError: a file that is no picture, is damaged, or has greys of other than 8 or 16 bits.
    """
    image = None
    for index in count():
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # about a file that is odd but readable
                warnings.simplefilter("error", Image.DecompressionBombWarning)
                image = image or Image.open(path, formats=PICTURE_FORMATS)
                image.seek(index)
                colour = to_colour(image)
        except Exception as error:  # Pillow's readers let many kinds through when a file is damaged
            if image and index and isinstance(error, EOFError):
                if image.format == "GIF" and not path.read_bytes().rstrip(b"\0").endswith(b";"):
                    told = f"input {path} has no end: frames after the {index} read may be missing"
                    warnings.warn(told, stacklevel=2)
                return
            reason = " ".join(str(error).split()) or type(error).__name__
            if isinstance(error, UnidentifiedImageError):
                reason = "not a known picture format"
            what = f"a picture after {index} frames" if index else "a picture"
            raise VoccError(f"input {path} cannot be read as {what} ({reason})") from None
        yield RecordedFrame(printable(path.name), index, None, colour, to_grey(colour, channel))
        if image.format == "MPO":
            return


def to_colour(image: Image.Image) -> NDArray[np.uint8]:
    """Give the picture that an opened file shows now, (H,W,3) uint8.

    Raises:
        ValueError: greys of other than 8 or 16 bits.
    """
    shown: Image.Image = ImageOps.exif_transpose(image)
    if image.mode[0] in "IF":  # 16 bits, in 32 where Pillow has no better mode
        deep = np.asarray(shown)
        if deep.dtype.kind == "f" or deep.min() < 0 or deep.max() > 65535:
            held = f"it holds {deep.dtype} grey values from {deep.min()} to {deep.max()}"
            raise ValueError(f"{held}: it must have 8 or 16 bits")
        shown = Image.fromarray((deep / 257.0).round().astype(np.uint8))
    return np.asarray(shown.convert("RGB"), dtype=np.uint8)


def read_greys(path: Path) -> Iterator[RecordedFrame]:
    """Read an array of greys frame by frame; the file is not read into memory.

    Raises:
        VoccError: another file, or an array of another kind.
    """
    try:
        greys = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError) as error:
        raise VoccError(f"input {path} cannot be read as an array ({' '.join(str(error).split())})") from None
    if greys.dtype != np.uint8 or greys.ndim != 3 or not greys.size:
        given = f"{greys.dtype} of shape {greys.shape}"
        raise VoccError(f"input {path} holds {given}: it must be uint8 of shape (N,H,W), not empty")
    for index, one in enumerate(greys):
        grey = np.array(one)
        colour = np.broadcast_to(grey[..., None], (*grey.shape, 3))
        yield RecordedFrame(printable(path.name), index, None, colour, grey)


def read_video(path: Path, channel: str, *, grey_only: bool = False) -> Iterator[RecordedFrame]:
    """Read a video's frames through PyAV; a warning tells of damaged frames and of missing ones.

    Raises:
        VoccError: PyAV is not installed, or a file that is no video; at the end, frames that cannot be read.
    """
    try:
        import av
    except ImportError:
        extra = "install the extra with pip install 'vocc-torch[video]'"
        raise VoccError(f"input {path} is a video: {extra}") from None
    done = declared = damaged = 0
    reason = ""
    try:
        # A file even where its name reads as an address: FFmpeg would send a request.
        with av.open(f"file:{path.absolute()}") as container:
            stream = container.streams.video[0]
            if grey_only:  # several frames at a time, on all cores, while others are read here
                stream.thread_type = "AUTO"
            length_s = (stream.duration or 0) * float(stream.time_base or 0)
            length_s = length_s or (container.duration or 0) / av.time_base
            declared = stream.frames or round(length_s * float(stream.average_rate or 0))
            for packet in container.demux(stream):
                try:
                    frames = packet.decode()
                except av.error.FFmpegError as error:  # others of its frames may be whole
                    frames, reason = [], str(error)
                for frame in frames:
                    quarter_turns = round(getattr(frame, "rotation", 0) / 90) % 4
                    if grey_only:
                        grey = turned(grey_plane(frame), quarter_turns)
                        colour = np.broadcast_to(np.uint8(0), (*grey.shape, 3))
                    else:
                        colour = turned(frame.to_ndarray(format="rgb24"), quarter_turns)
                        grey = to_grey(colour, channel)
                    yield RecordedFrame(printable(path.name), done, frame.time, colour, grey)
                    done, damaged = done + 1, damaged + frame.is_corrupt
    except (av.error.FFmpegError, IndexError, ValueError) as error:
        reason = str(error)
    if done and (done < declared or damaged):
        told = f"{done} frames were read, {damaged} of them damaged, and its header speaks of {declared}"
        warnings.warn(f"input {path}: {told}", stacklevel=2)
    if reason:
        raise VoccError(f"input {path} cannot be read as a video after {done} frames ({reason})")
    if done == 0:
        raise VoccError(f"input {path} is a video without frames")


def turned(picture: Any, quarter_turns: int) -> Any:
    """Turn a picture (H,W) or (H,W,3) anticlockwise, as a film's header asks for."""
    if not quarter_turns:
        return picture
    if isinstance(picture, FilmGrey):
        return FilmGrey(np.rot90(picture.plane, quarter_turns))
    return np.ascontiguousarray(np.rot90(picture, quarter_turns))


def grey_plane(frame: Any) -> Grey:
    """Take the greys (H,W) of a frame of PyAV as its film has them, 16 to 235 spread over 0 to 255."""
    if frame.format.name != "yuv420p" or frame.color_range == JPEG_RANGE:
        return np.asarray(frame.to_ndarray(format="gray"), dtype=np.uint8)
    plane = frame.planes[0]
    lines = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
    return FilmGrey(lines[: frame.height, : frame.width])


def readable(recording: Iterator[RecordedFrame], failures: list[str]) -> Iterator[RecordedFrame]:
    """Pass on what can be read of a recording, and note what cannot."""
    try:
        yield from recording
    except VoccError as error:
        failures.append(str(error))
