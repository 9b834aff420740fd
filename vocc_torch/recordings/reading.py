"""Any input as frames: a path, an array, a picture in memory or a live source."""

import os
from collections.abc import Iterable, Iterator
from itertools import chain, groupby, islice
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from vocc_torch.arrays import read_npy
from vocc_torch.errors import VoccError, shown
from vocc_torch.files import MOST_BYTES, PICTURE_SUFFIXES, VIDEO_SUFFIXES
from vocc_torch.recordings.films import promised_frames, read_film
from vocc_torch.recordings.frames import RecordedFrame
from vocc_torch.recordings.pictures import (
    folder_files,
    read_array,
    read_folder,
    read_picture,
    to_colour,
)
from vocc_torch.recordings.streams import LiveStream, is_stream

ARRAY_SUFFIX = ".npy"
"""A NumPy file of one array."""
MOST_ARRAY_BYTES = 1 << 50
"""Most bytes of such a file of uint8, which is not loaded at once."""
ALLOWED = (
    "give a picture, a folder of pictures, a video, camera:0, an rtsp:// address or -"
)


def read_recording(
    path: Path, channel: str, *, grey_only: bool = False
) -> Iterator[RecordedFrame]:
    """Read the frames of a file or folder one by one.

    Files that cannot be read are named at the end, after all frames that can be read.

    Args:
        path: a picture, which may have several frames or pages, a folder of pictures, a film or an array.
        channel: how colour becomes grey.
        grey_only: leave out the colour of films, which takes most of the time.

    Raises:
        VoccError: an input that is missing or empty, at once; at the end, what cannot be read.
    """
    # Path.exists raises where a name is too long for the system.
    if not os.path.exists(path):  # noqa: PTH110
        raise VoccError(f"input {path} does not exist: {ALLOWED}")
    if path.is_dir():
        return read_folder(path, channel)
    if not path.is_file():
        raise VoccError(f"input {path} is a pipe or a device: {ALLOWED}")
    if path.suffix.lower() in VIDEO_SUFFIXES:
        return read_film(path, channel, grey_only=grey_only and channel == "luma")
    if path.suffix.lower() == ARRAY_SUFFIX:
        values = read_npy(path, "input", MOST_ARRAY_BYTES)
        if values.dtype != np.uint8 and values.nbytes > MOST_BYTES:
            found = f"{values.nbytes} bytes of {values.dtype}"
            rule = f"and at most {MOST_BYTES} are read, or uint8 of any size"
            raise VoccError(f"input {path} holds {found}, {rule}")
        return read_array(values, channel, path)
    return read_picture(path, channel)


def expected_frames(path: Path) -> int:
    """Number of frames that a recording most likely has: those of a film, or the pictures of a folder."""
    if path.is_dir():
        return sum(
            part.suffix.lower() in PICTURE_SUFFIXES for part in folder_files(path)
        )
    return promised_frames(path) if path.suffix.lower() in VIDEO_SUFFIXES else 1


def read_source(source: object, channel: str) -> Iterator[RecordedFrame]:
    """Read the frames of anything that a user has.

    Args:
        source: a path, a live source (``camera:0``, ``rtsp://...``, ``-``), a Pillow picture, or an array or
            tensor of greys or colours.
        channel: how colour becomes grey.

    Raises:
        VoccError: another type, or an input that cannot be read.
    """
    if isinstance(source, str) and is_stream(source):
        return iter(LiveStream(source, channel))
    if isinstance(source, str | Path):
        return read_recording(Path(source), channel)
    if isinstance(source, Image.Image):
        return read_array(to_colour(source)[0], channel)
    allowed = "a path, a picture, an array (H,W), (H,W,3), (B,H,W) or (B,H,W,3), or a live source"
    if not hasattr(source, "__array__"):
        raise VoccError.of("the input", shown(source), allowed)
    try:
        array: Any = source.detach().cpu() if hasattr(source, "detach") else source
        numbers = np.asarray(array)
    except (TypeError, ValueError, RuntimeError) as error:
        # Such as tensors that are sparse, nested, without values or of a type that NumPy lacks.
        reason = " ".join(str(error).split())[:100]
        raise VoccError(f"the input is no array of numbers ({reason})") from None
    return read_array(numbers, channel)


def readable(
    recording: Iterator[RecordedFrame], failures: list[str]
) -> Iterator[RecordedFrame]:
    """Pass on the frames that can be read, and append to ``failures`` what cannot.

    Raises:
        VoccError: a recording of which no frame can be read, at once.
    """

    def frames() -> Iterator[RecordedFrame]:
        try:
            yield from recording
        except VoccError as error:
            failures.append(str(error))

    every = frames()
    for first in every:
        return chain([first], every)
    raise VoccError(failures[0])


def batches(
    recording: Iterable[RecordedFrame], frames: int, pixels: int
) -> Iterator[list[RecordedFrame]]:
    """Batch frames of one size that are read together.

    Args:
        recording: the frames, in order.
        frames: of a batch, at most.
        pixels: of all its frames together, at most, unless one has more.
    """
    for (height, width), run in groupby(recording, key=lambda frame: frame.grey.shape):
        size = max(1, min(frames, pixels // (height * width)))
        while batch := list(islice(run, size)):
            yield batch
