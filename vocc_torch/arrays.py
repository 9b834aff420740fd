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
        what: name of the file in refusals.
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


def read_bits(path: Path, what: str, sides: tuple[int, int]) -> Bools:
    """Read what a panel showed, (N,R,C) bool, at least one symbol.

    Args:
        path: the file ``.npy``.
        what: name of the file in refusals.
        sides: rows and columns of the panel.

    Raises:
        VoccError: another file, or bits of another panel.
    """
    bits = np.array(read_npy(path, what))
    if bits.dtype != np.bool_ or bits.shape[1:] != sides or not len(bits):
        rule = f"it must be bool of shape (N,{sides[0]},{sides[1]})"
        raise VoccError(
            f"{what} {path} holds {bits.dtype} of shape {bits.shape}: {rule}"
        )
    return bits
