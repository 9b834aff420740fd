"""Recordings as grey frames: a picture, a folder of pictures or a video."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from vocc_torch.errors import VoccError

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm")
PICTURE_FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "WEBP", "PPM")
"""What a picture may be, whatever its name says: others of Pillow's readers run programs."""
VIDEO_SUFFIXES = (".mp4", ".mkv", ".avi", ".mov", ".webm", ".m4v", ".mpg", ".mpeg", ".mjpeg")


@dataclass(frozen=True, slots=True)
class RecordedFrame:
    """One frame of a recording.

    Args:
        source: the file's name.
        index: the frame's number in its file, from 0.
        time_s: when the frame was taken, for a video; else None.
        colour: (H,W,3) uint8, for drawing on.
        grey: (H,W) uint8, for decoding.
    """

    source: str
    index: int
    time_s: float | None
    colour: NDArray[np.uint8]
    grey: NDArray[np.uint8]


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


def read_recording(path: Path, channel: str) -> Iterator[RecordedFrame]:
    """Read frames one by one, pictures of a folder in the order of their names.

    Args:
        path: a picture, a folder of pictures or a video.
        channel: how colour becomes grey.

    Raises:
        VoccError: an input that is missing, empty or cannot be read.
    """
    wanted = "give a picture, a folder of pictures or a video"
    if not path.exists():
        raise VoccError(f"input {path} does not exist: {wanted}")
    if path.is_dir():
        pictures = sorted(p for p in path.iterdir() if p.suffix.lower() in PICTURE_SUFFIXES and p.is_file())
        if not pictures:
            raise VoccError(f"input {path} holds no picture: known endings are {' '.join(PICTURE_SUFFIXES)}")
        return (read_picture(picture, channel) for picture in pictures)
    if not path.is_file():
        raise VoccError(f"input {path} is a pipe or a device: {wanted}")
    if path.suffix.lower() in VIDEO_SUFFIXES:
        return read_video(path, channel)
    return iter([read_picture(path, channel)])


def read_picture(path: Path, channel: str) -> RecordedFrame:
    """Read one picture the way up that it is shown.

    16-bit greys are scaled to 8 bits; of transparent pixels the colour is taken, and how transparent they are
    does not matter.

    Raises:
        VoccError: a file that is no picture, is damaged, or has greys of other than 8 or 16 bits.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about a file that is odd but readable
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(path, formats=PICTURE_FORMATS) as image:
                shown: Image.Image = ImageOps.exif_transpose(image)
                held = "floating grey values" if image.mode == "F" else ""
                if image.mode.startswith("I"):  # 16 bits, in 32 where Pillow has no better mode
                    deep = np.asarray(shown)
                    if deep.min() < 0 or deep.max() > 65535:
                        held = f"grey values from {deep.min()} to {deep.max()}"
                    shown = Image.fromarray((deep / 257.0).round().astype(np.uint8))
                if held:
                    raise VoccError(f"input {path} holds {held}: it must have 8 or 16 bits")
                colour = np.asarray(shown.convert("RGB"), dtype=np.uint8)
    except VoccError:
        raise
    except Exception as error:  # Pillow's readers let many kinds through when a file is damaged
        reason = " ".join(str(error).split()) or type(error).__name__
        if isinstance(error, UnidentifiedImageError):
            reason = "not a known picture format"
        raise VoccError(f"input {path} cannot be read as a picture ({reason})") from None
    return RecordedFrame(path.name, 0, None, colour, to_grey(colour, channel))


def read_video(path: Path, channel: str) -> Iterator[RecordedFrame]:
    """Read a video's frames through PyAV.

    Raises:
        VoccError: PyAV is not installed, or a file that is no video or is damaged.
    """
    try:
        import av
    except ImportError:
        extra = "install the extra with pip install 'vocc-torch[video]'"
        raise VoccError(f"input {path} is a video: {extra}") from None
    done = 0
    try:
        # A file even where its name reads as an address: FFmpeg would send a request.
        with av.open(f"file:{path.absolute()}") as container:
            for frame in container.decode(video=0):
                colour = np.asarray(frame.to_ndarray(format="rgb24"), dtype=np.uint8)
                yield RecordedFrame(path.name, done, frame.time, colour, to_grey(colour, channel))
                done += 1
    except (av.error.FFmpegError, IndexError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise VoccError(f"input {path} cannot be read as a video after {done} frames ({reason})") from None
    if done == 0:
        raise VoccError(f"input {path} is a video without frames")
