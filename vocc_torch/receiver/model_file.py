"""The file that keeps a receiver: settings, arrays and a checksum as JSON text, which executes nothing."""

import base64
import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from vocc_torch.errors import VoccError, printable, shown
from vocc_torch.files import read_file, write_atomically

FORMAT = "vocc_torch.receiver"
FORMAT_VERSION = 3
MOST_BYTES = 1 << 26
"""Most bytes of a model's file; the networks that ship take less than one in a hundred."""
MOST_VALUES = 1 << 20
"""Most values of a JSON text, each of which takes up to 100 bytes of memory."""
_DTYPES = ("float64", "float32", "float16", "int64", "uint8", "bool")

UNFIT = (
    LookupError,
    TypeError,
    ValueError,
    RuntimeError,
    AttributeError,
    ArithmeticError,
)
"""What reading raises where a file holds values of another kind."""

Settings = dict[str, Any]


def _checksum(content: Mapping[str, object]) -> str:
    """Hash everything but the checksum itself, in a canonical form."""
    signed = {key: value for key, value in content.items() if key != "sha256"}
    text = json.dumps(signed, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def write_model(path: Path, settings: Settings, state: Mapping[str, Tensor]) -> None:
    """Write settings and a classifier's state, whole or not at all.

    Args:
        path: the file, replaced whole.
        settings: what JSON can hold.
        state: tensors by name.

    Raises:
        VoccError: a tensor of another type than float64, float32, float16, int64, uint8 and bool, more than 64 MiB, or
            the file cannot be written.
    """
    content: Settings = {"format": FORMAT, "version": FORMAT_VERSION}
    content |= {"settings": settings, "classifier": arrays_as_json(state)}
    content["sha256"] = _checksum(content)
    text = (json.dumps(content, indent=1) + "\n").encode()
    if len(text) > MOST_BYTES:
        raise VoccError(
            f"model {path} would have {len(text)} bytes: at most {MOST_BYTES} are allowed"
        )
    write_atomically(path, text)


def arrays_as_json(state: Mapping[str, Tensor]) -> Settings:
    """Write tensors as what JSON can hold; :func:`array_of` reads one back.

    Raises:
        VoccError: a tensor of another type than float64, float32, float16, int64, uint8 and bool.
    """
    arrays: Settings = {}
    for name, value in state.items():
        array = value.detach().cpu().contiguous().numpy()
        if str(array.dtype) not in _DTYPES:
            raise VoccError(
                f"the classifier's {name} is {array.dtype}: a model holds {', '.join(_DTYPES)}"
            )
        # Little-endian, whatever the machine.
        raw = array.astype(array.dtype.newbyteorder("<")).tobytes()
        data = base64.b64encode(raw).decode()
        arrays[name] = {
            "dtype": str(array.dtype),
            "shape": list(array.shape),
            "base64": data,
        }
    return arrays


def read_model(
    path: Path,
    what: str = "model",
    wanted: str = "the receiver.pt that task=train wrote",
) -> tuple[Settings, dict[str, Tensor]]:
    """Read a file of :func:`write_model`; refusals name ``what`` it should be and what is ``wanted``.

    Raises:
        VoccError: a file that is missing, damaged, of another kind or of another version.
    """
    # Path.exists raises where a name is too long for the system.
    if not os.path.exists(path):  # noqa: PTH110
        raise VoccError(f"{what} {printable(str(path))} does not exist: give {wanted}")
    try:
        content = parse_json(read_file(path, what, MOST_BYTES))
        fits = isinstance(content, dict) and content.get("sha256") == _checksum(content)
    except VoccError as error:
        raise VoccError(f"{error}: give {wanted}") from None
    except (ValueError, RecursionError):
        raise VoccError(
            f"{what} {path} is damaged or of another kind: give {wanted}"
        ) from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise VoccError(f"{what} {path} is not of vocc_torch: give {wanted}")
    if (version := content.get("version")) != FORMAT_VERSION:
        raise VoccError(
            f"{what} {path} has format version {shown(version)}: this package reads version {FORMAT_VERSION}"
        )
    if not fits:
        raise VoccError(
            f"{what} {path} is damaged (its checksum does not fit): train it again"
        )
    try:
        return dict(content["settings"]), {
            k: array_of(value) for k, value in content["classifier"].items()
        }
    except UNFIT as error:
        raise VoccError(
            f"{what} {path} is damaged ({type(error).__name__}): train it again"
        ) from None


def parse_json(text: bytes) -> Any:
    """Read JSON text of at most 2^20 values, whole numbers of at most 64 bits.

    Raises:
        ValueError: more values, a larger number, or no JSON.
    """
    if sum(map(text.count, (b",", b"[", b"{"))) > MOST_VALUES:
        raise ValueError(f"more than {MOST_VALUES} values")
    return json.loads(text, parse_int=whole)


def whole(digits: str) -> int:
    """Read a whole number of at most 64 bits.

    Raises:
        ValueError: a larger one.

    Example:
        >>> whole("-7")
        -7
    """
    if abs(number := int(digits)) >> 64:
        raise ValueError(f"a whole number of {len(digits)} digits")
    return number


def array_of(array: Mapping[str, Any]) -> Tensor:
    """Read one array that :func:`arrays_as_json` wrote."""
    if (name := array["dtype"]) not in _DTYPES:
        raise ValueError
    kind = np.dtype(name)
    raw = base64.b64decode(array["base64"], validate=True)
    flat = np.frombuffer(raw, dtype=kind.newbyteorder("<")).astype(kind)
    if not np.isfinite(flat).all():
        raise ValueError
    return torch.from_numpy(flat.reshape(array["shape"]))
