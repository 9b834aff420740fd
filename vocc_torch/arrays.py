"""NumPy's arrays by the kind of their numbers, and files of one plain array."""

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vocc_torch.errors import VoccError
from vocc_torch.files import MOST_BYTES, ordinary_file

Numbers = NDArray[Any]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]
Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


def read_npy(path: Path, what: str, most_bytes: int = MOST_BYTES) -> NDArray[Any]:
    """Map a file ``.npy`` into memory; nothing in it is executed, and no shape asks for more than it holds.

    Args:
        path: the file.
        what: it is, for refusals.
        most_bytes: of it.

    Raises:
        VoccError: no ordinary file, or not one array of numbers.
    """
    with ordinary_file(path, what, most_bytes):
        try:
            return np.lib.format.open_memmap(path, mode="r")
        except (
            Exception
        ) as error:  # a header is parsed as Python, and fails as Python does
            why = textwrap.shorten(str(error), 200, placeholder="...")
            rule = "cannot be read as one array .npy"
            raise VoccError(f"{what} {path} {rule} ({why})") from None
