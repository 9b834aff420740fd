"""Annotated pictures of a recording."""

from itertools import count
from pathlib import Path

import numpy as np
from PIL import Image

from vocc_torch.files import atomic_file
from vocc_torch.report.annotation import annotated
from vocc_torch.studies.decode.reading import Reading

MOST_NAME_BYTES = 200
"""Bytes of a picture's name that its copy keeps, so that the rest fits into the 255 of a file system."""


class Album:
    """Annotated pictures in a run's folder, one a frame of a picture.

    Args:
        folder: the run's folder.
        scale: by how much a picture is enlarged.
    """

    def __init__(self, folder: Path, scale: int) -> None:
        self.folder = folder / "annotated"
        self.scale = scale
        self.names: set[str] = set()
        self._picture: Image.Image | None = None
        self._frame: tuple[str, int, str] | None = None
        self._name = ""

    def add(self, reading: Reading) -> None:
        """Draw a reading; further panels of a frame are drawn into the same picture.

        Raises:
            OSError: the disk is full.
        """
        frame = reading.frame.source, reading.frame.index, reading.frame.light
        picture, scale = reading.frame.colour, self.scale
        if frame == self._frame:
            picture, scale = np.asarray(self._picture), 1
        else:
            self._frame = frame
            self._name = self._free_name(reading.frame.source, reading.frame.light)
        corners_px = reading.corners_px * (self.scale / scale)
        self._picture = annotated(picture, corners_px, reading.bits, scale)
        with atomic_file(self.folder / f"{self._name}.png") as temporary:
            self._picture.save(temporary, format="PNG")

    def _free_name(self, source: str, light: str) -> str:
        """Choose a name that no picture has, also on a disk that does not tell upper from lower case."""
        stem = Path(source).stem.encode()[:MOST_NAME_BYTES].decode(errors="ignore")
        if light:
            stem += f"-{light}"
        name = stem
        for number in count(1):
            if name.casefold() not in self.names:
                break
            name = f"{stem}-{number}"
        self.names.add(name.casefold())
        return name
