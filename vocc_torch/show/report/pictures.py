"""A report's pictures and their data: where they lie, and their bytes for a file that holds them."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from PIL import Image, UnidentifiedImageError

from vocc_torch.errors import VoccError


@dataclass(frozen=True, slots=True)
class Png:
    """A picture in memory.

    Args:
        width_px: width, pixels.
        height_px: height, pixels.
        content: the PNG file's bytes.
    """

    width_px: int
    height_px: int
    content: bytes


def relative_url(base: Path, path: Path) -> str:
    """Give a file's address relative to the report's folder.

    Args:
        base: the report's folder.
        path: the file, relative to that folder.

    Raises:
        VoccError: a path that leads out of the folder, or no such file.

    Example:
        >>> relative_url(Path("runs/a"), Path("figures/fig 22.png"))
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: figures/fig 22.png is not in runs/a: write it before the report
    """
    if path.is_absolute() or ".." in path.parts:
        raise VoccError(f"{path} leads out of the report's folder: give a path inside it, such as fig22.png")
    if not (base / path).is_file():
        raise VoccError(f"{path} is not in {base}: write it before the report")
    return quote(path.as_posix())


def read_png(path: Path) -> Png:
    """Read a PNG file and pack the same pixels smaller, where that is quickly done.

    An alpha channel that is opaque everywhere is left out.

    Args:
        path: the file.

    Raises:
        VoccError: it cannot be read, or it is no PNG file.

    Example:
        >>> read_png(Path("no/such.png"))
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: cannot read no/such.png: No such file or directory
    """
    try:
        original = path.read_bytes()
        with Image.open(io.BytesIO(original), formats=["PNG"]) as picture:
            picture.load()
            content = min(original, _packed(picture), key=len)
            return Png(picture.width, picture.height, content)
    except (UnidentifiedImageError, SyntaxError, ValueError) as error:
        raise VoccError(f"{path} is not a PNG picture: {error}") from error
    except OSError as error:
        raise VoccError(f"cannot read {path}: {error.strerror or error}") from error


def _packed(picture: Image.Image) -> bytes:
    """Encode the pixels again."""
    opaque = picture.mode == "RGBA" and picture.getchannel("A").getextrema() == (255, 255)
    buffer = io.BytesIO()
    (picture.convert("RGB") if opaque else picture).save(buffer, format="PNG")
    return buffer.getvalue()
