"""The file that holds a receiver: JSON text with a checksum, which no reader can be tricked into executing.

A fitted receiver is a few settings and some twenty numbers, so a text that people can read costs nothing, and
Python's shortest decimal form of a float64 reads back to the same float64.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from vocc_torch.errors import VoccError
from vocc_torch.files import write_atomically

FORMAT = "vocc_torch.receiver"
FORMAT_VERSION = 2
_READABLE = (1, FORMAT_VERSION)  # version 1 has one number for each mean and scatter: the second one is 0
_DTYPES = {"float64": torch.float64, "int64": torch.int64}

Settings = dict[str, object]


def _checksum(content: Mapping[str, object]) -> str:
    """Hash everything but the checksum itself, in a canonical form."""
    rest = {key: value for key, value in content.items() if key != "sha256"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def write_model(path: Path, settings: Settings, state: Mapping[str, Tensor]) -> None:
    """Write settings and a classifier's state, whole or not at all.

    Args:
        path: the file, replaced whole.
        settings: what JSON can hold.
        state: float64 and int64 tensors by name.

    Raises:
        VoccError: the file cannot be written.
    """
    names = {dtype: name for name, dtype in _DTYPES.items()}
    numbers = {
        key: {
            "dtype": names[value.dtype],
            "shape": list(value.shape),
            "values": value.cpu().flatten().tolist(),
        }
        for key, value in state.items()
    }
    content: Settings = {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "settings": settings,
        "classifier": numbers,
    }
    content["sha256"] = _checksum(content)
    write_atomically(path, (json.dumps(content, indent=1) + "\n").encode())


def read_model(path: Path) -> tuple[Settings, dict[str, Tensor]]:
    """Read what :func:`write_model` wrote.

    Raises:
        VoccError: a file that is missing, damaged, of another kind or of another version.
    """
    try:
        content = json.loads(path.read_bytes())
    except FileNotFoundError:
        raise VoccError(f"model {path} does not exist: give the receiver.pt that task=train wrote") from None
    except (OSError, ValueError, RecursionError):
        raise VoccError(
            f"model {path} cannot be read as a receiver: it is damaged or of another kind"
        ) from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise VoccError(
            f"model {path} is not a vocc_torch receiver: give the receiver.pt that task=train wrote"
        )
    if (version := content.get("version")) not in _READABLE:
        allowed = " and ".join(map(str, _READABLE))
        raise VoccError(f"model {path} has format version {version}: this package reads versions {allowed}")
    if content.get("sha256") != _checksum(content):
        raise VoccError(f"model {path} is damaged (its checksum does not fit): train it again")
    try:
        state = {
            key: torch.tensor(value["values"], dtype=_DTYPES[value["dtype"]]).reshape(value["shape"])
            for key, value in content["classifier"].items()
        }
        return dict(content["settings"]), state
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
        raise VoccError(f"model {path} is damaged ({type(error).__name__}): train it again") from None
