"""Annotated pictures of a recording."""

from collections.abc import Sequence
from itertools import count
from pathlib import Path

import numpy as np

from vocc_torch.files import atomic_file
from vocc_torch.report.annotation import annotated, enlarged
from vocc_torch.studies.decode.reading import Reading

MOST_NAME_BYTES = 200
"""Bytes of a picture's name that its copy keeps, so that the rest fits into the 255 of a file system."""


class Album:
    """Annotated pictures in a run's folder, one for each frame of a picture.

    Args:
        folder: the run's folder.
        scale: by how much a picture is enlarged.
    """

    def __init__(self, folder: Path, scale: int) -> None:
        self.folder, self.scale = folder / "annotated", scale
        self.names: set[str] = set()

    def add(self, panels: Sequence[Reading]) -> None:
        """Draw the panels that were found in a frame.

        Args:
            panels: of one frame, at least one.

        Raises:
            OSError: the disk is full.
        """
        frame = panels[0].frame
        picture = enlarged(frame.colour, self.scale)
        for panel in panels:
            corners_px = panel.corners_px * self.scale
            picture = annotated(np.asarray(picture), corners_px, panel.bits)
        name = self._free_name(frame.source, frame.light)
        with atomic_file(self.folder / f"{name}.png") as temporary:
            picture.save(temporary, format="PNG")

    def _free_name(self, source: str, light: str) -> str:
        """Choose a name that no picture has, also on a disk that does not tell upper from lower case."""
        stem = Path(source).stem.encode()[:MOST_NAME_BYTES].decode(errors="ignore")
        stem += f"-{light}" * bool(light)
        name, numbers = stem, count(1)
        while name.casefold() in self.names:
            name = f"{stem}-{next(numbers)}"
        self.names.add(name.casefold())
        return name
