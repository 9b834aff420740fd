"""Pictures and arrays, from files and from memory, as frames."""

import re
import warnings
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import count
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image, ImageOps, UnidentifiedImageError

from vocc_torch.arrays import Bytes, Numbers
from vocc_torch.errors import VoccError, library, printable
from vocc_torch.files import PICTURE_FORMATS, PICTURE_SUFFIXES
from vocc_torch.recordings.frames import RecordedFrame, to_bytes, to_grey

HEIF_SUFFIXES = (".heic", ".heif", ".hif")
SIDECAR_SUFFIXES = (".csv", ".json", ".md", ".txt", ".xml", ".yaml", ".yml")
"""Files that commonly lie beside pictures and are passed over silently."""
APPLE_DOUBLE = "._"
"""Begin of the names of files that macOS writes beside others on foreign disks."""
DARK = 64
"""Colours of 10 to 14 bits in a file of 16 bits are below this once they are cut to 8 bits."""
DEEP_FORMATS = {"format_whitelist": "image2,png_pipe,tiff_pipe"}
MOST_FAILURES = 5
"""Failures that one message names."""


def natural_key(path: Path) -> list[tuple[int, str]]:
    """Sort key of a file name in which numbers count as numbers: ``2.png`` before ``10.png``.

    Example:
        >>> [path.name for path in sorted([Path("10.png"), Path("2.png")], key=natural_key)]
        ['2.png', '10.png']
    """
    parts = re.split(r"([0-9]+)", path.name)
    return [
        (int(part), "") if part.isdecimal() else (-1, part) for part in parts if part
    ]


def folder_files(folder: Path) -> list[Path]:
    """List the files of a folder in natural order of their names, without those that macOS adds."""
    files = (
        path
        for path in folder.iterdir()
        if path.is_file() and not path.name.startswith(APPLE_DOUBLE)
    )
    return sorted(files, key=natural_key)


def read_folder(folder: Path, channel: str) -> Iterator[RecordedFrame]:
    """Read the pictures of a folder in natural order of their names.

    Raises:
        VoccError: a folder without pictures, at once; at the end, files that cannot be read.
    """
    files = folder_files(folder)
    pictures = [path for path in files if path.suffix.lower() in PICTURE_SUFFIXES]
    if not pictures:
        endings = " ".join(PICTURE_SUFFIXES)
        raise VoccError(f"input {folder} holds no picture: known endings are {endings}")
    known = (*PICTURE_SUFFIXES, *SIDECAR_SUFFIXES)

    def frames() -> Iterator[RecordedFrame]:
        failures = []
        for path in pictures:
            try:
                yield from read_picture(path, channel)
            except VoccError as error:
                failures.append(str(error))
        failures += [
            f"input {printable(path.name)} is not a known kind of picture"
            for path in files
            if path.suffix.lower() not in known and not path.name.startswith(".")
        ]
        if failures:
            further = len(failures) - MOST_FAILURES
            named = "; ".join(failures[:MOST_FAILURES])
            raise VoccError(named + f"; and {further} more" * (further > 0))

    return frames()


def read_picture(path: Path, channel: str) -> Iterator[RecordedFrame]:
    """Read a picture upright as its EXIF orientation says, and all frames or pages of it.

    Transparency is ignored. Of a JPEG with previews only the first picture is read.

    Raises:
        VoccError: a file that is no picture or is damaged, grey values outside 0 to 65535, or the library of
            HEIC pictures is not installed.
    """
    formats = [*PICTURE_FORMATS]
    if path.suffix.lower() in HEIF_SUFFIXES:
        heif = library("pillow_heif", "heif", f"input {path} is a HEIC picture")
        heif.register_heif_opener()
        formats.append("HEIF")
    with ExitStack() as stack:
        image = None
        for index in count():
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter(
                        "ignore"
                    )  # of files that are odd but readable
                    warnings.simplefilter("error", Image.DecompressionBombWarning)
                    image = image or stack.enter_context(
                        Image.open(path, formats=formats)
                    )
                    image.seek(index)
                    is_deep = image.mode == "RGB" and ";16" in str(image.tile)
                    colour, note = to_colour(image)
                    if is_deep and colour.max() < DARK:
                        colour, note = deep_colour(path, image, colour)
            except (
                Exception
            ) as error:  # Pillow's readers raise many kinds for damaged files
                if image and index and isinstance(error, EOFError):
                    return
                reason = " ".join(str(error).split()) or type(error).__name__
                if isinstance(error, UnidentifiedImageError):
                    reason = "not a known picture format"
                kind = "a picture" + f" after {index} frames" * (index > 0)
                raise VoccError(
                    f"input {path} cannot be read as {kind} ({reason})"
                ) from None
            grey = to_grey(colour, channel)
            yield RecordedFrame(
                printable(path.name), index, None, colour, grey, note=note
            )
            if image.format == "MPO":
                return


def to_colour(image: Image.Image) -> tuple[Bytes, str]:
    """Take the picture that an opened file shows now, (H,W,3) uint8, and a note on its bit depth.

    Raises:
        ValueError: grey values that are not from 0 to 65535.
    """
    shown = ImageOps.exif_transpose(image)
    note = ""
    if image.mode[0] in "IF":
        greys, note = to_bytes(np.asarray(shown))
        shown = Image.fromarray(greys)
    return np.asarray(shown.convert("RGB"), dtype=np.uint8), note


def deep_colour(path: Path, image: Image.Image, coarse: Bytes) -> tuple[Bytes, str]:
    """Read colours of 16 bits, of which Pillow keeps the upper eight; as :func:`to_colour`.

    Args:
        path: of the picture.
        image: as Pillow has opened it, at the page to read.
        coarse: what Pillow keeps, which is all where PyAV is not installed.
    """
    try:
        av = library("av", "video", "only the upper 8 of 16 bits are read")
    except VoccError as error:
        return coarse, str(error)
    with av.open(f"file:{path.absolute()}", options=DEEP_FORMATS) as container:
        stream = container.streams.video[0]
        stream.codec_context.options = {"page": str(image.tell() + 1)}
        picture = next(container.decode(stream))
    colour, note = to_bytes(picture.to_ndarray(format="rgb48le"))
    shown = Image.fromarray(colour)
    shown.getexif()[ExifTags.Base.Orientation] = image.getexif().get(
        ExifTags.Base.Orientation, 1
    )
    return to_colour(shown)[0], note


def read_array(
    values: Numbers, channel: str, path: Path | None = None
) -> Iterator[RecordedFrame]:
    """Read an array as frames.

    Args:
        values: (H,W), (H,W,3), (H,W,4), (B,H,W) or (B,H,W,3), of integers or of floats from 0 to 1.
        channel: how colour becomes grey.
        path: of its file; None for one in memory.

    Raises:
        VoccError: another shape, an empty array or values that are no greys.

    Example:
        >>> frames = read_array(np.zeros((2, 4, 5)), "luma")
        >>> [frame.grey.shape for frame in frames]
        [(4, 5), (4, 5)]
    """
    name, what = (
        ("array", "the array") if path is None else (path.name, f"input {path}")
    )
    try:
        pictures, note = to_bytes(values)
    except ValueError as error:
        raise VoccError(f"{what} cannot be read: {error}") from None
    is_colour = values.ndim >= 3 and values.shape[-1] in (3, 4)
    if values.ndim == 2 + is_colour:
        pictures = pictures[None]
    if pictures.ndim != 3 + is_colour or not pictures.size:
        allowed = "(H,W), (H,W,3), (B,H,W) or (B,H,W,3), not empty"
        raise VoccError.of(f"{what}'s shape", values.shape, allowed)
    for index, picture in enumerate(pictures):
        if is_colour:
            colour = np.ascontiguousarray(picture[..., :3])
            grey = to_grey(colour, channel)
        else:
            grey = np.array(picture)
            colour = np.broadcast_to(grey[..., None], (*grey.shape, 3))
        yield RecordedFrame(printable(name), index, None, colour, grey, note=note)
