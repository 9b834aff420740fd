"""Estimators of scikit-learn in a model file: packed by skops, and read within a bound of memory."""

import zipfile
from collections import defaultdict
from collections.abc import Callable, Mapping
from io import BytesIO
from typing import Any

from vocc_torch.errors import VoccError, library
from vocc_torch.receiver.model_file import MOST_BYTES, MOST_VALUES, parse_json

TRUSTED = ("sklearn.ensemble._hist_gradient_boosting.predictor.TreePredictor",)
"""Classes of estimators that ship, arrays alone, which skops does not trust by itself."""

SCHEMA = "schema.json"
"""The part of skops's archive that describes the object; the others are arrays."""

ARRAY = b"\x93NUMPY"
"""How a part that holds an array begins: skops also reads archives within the archive."""

VALUE_BYTES = MOST_BYTES // MOST_VALUES
"""Bytes that a value of the description takes at least, once it is built."""


def skops_io(name: str) -> tuple[Any, str]:
    """Import skops.io, which is an extra, and give scikit-learn's release.

    Args:
        name: of the classifier, for the refusal.

    Raises:
        VoccError: skops is not installed.
    """
    need = f"classifier {name} is an estimator"
    io = library("skops.io", "classifiers", need, " to keep it")
    return io, library("sklearn", "classifiers", need).__version__


def unpacked(packed: bytes, io: Any, trusts: Callable[[str], bool]) -> Any:
    """Build an estimator from skops's archive.

    Args:
        packed: the archive.
        io: skops's module.
        trusts: whether a class that skops does not know may be built.

    Raises:
        VoccError: the archive would take more memory than :func:`demand_bounded` allows.
        Exception: whatever skops refuses.
    """
    demand_bounded(packed)
    unknown = io.get_untrusted_types(data=packed)
    return io.loads(packed, trusted=[name for name in unknown if trusts(name)])


def demand_bounded(packed: bytes) -> None:
    """Refuse an archive that takes more memory when it is read than a model file may have.

    Parts must lie there as they are, since a compressed one may unpack to more than it states. A part or a
    value that several places name counts once for each: builders copy.

    Raises:
        VoccError: a compressed part, one that is no array, or more than 64 MiB or 2^20 values.
    """
    if packed.count(b"PK\1\2") > MOST_VALUES >> 4:
        raise VoccError("it has too many parts")
    with zipfile.ZipFile(BytesIO(packed)) as archive:
        parts = archive.infolist()
        if any(part.compress_type != zipfile.ZIP_STORED for part in parts):
            raise VoccError("its parts are compressed")
        sizes = {part.filename: part.file_size for part in parts}
        if (stated := sum(part.file_size for part in parts)) > MOST_BYTES:
            raise VoccError(f"it unpacks to {stated} bytes, at most {MOST_BYTES}")
        for name in sizes.keys() - {SCHEMA}:
            with archive.open(name) as part:
                if part.read(len(ARRAY)) != ARRAY:
                    raise VoccError("it has a part that is no array")
        schema = parse_json(archive.read(SCHEMA))
    if bytes_built(schema, sizes) > MOST_BYTES:
        raise VoccError(f"it builds more than {MOST_BYTES} bytes")


def bytes_built(schema: Any, sizes: Mapping[str, int]) -> int:
    """Estimate the bytes of an object of which nothing is shared.

    Args:
        schema: skops's description. A node with an ``__id__`` stands wherever this number does.
        sizes: bytes of the archive's parts, by name.

    Example:
        >>> array = {"__id__": 1, "file": "0.npy"}
        >>> bytes_built([array, array, {"__id__": 1}], {"0.npy": 1000}) >= 3000
        True
    """
    named, left = defaultdict[object, list[Any]](list), [schema]
    while left:
        if isinstance(node := left.pop(), dict):
            named[node.get("__id__")].append(node)
        if isinstance(node, dict | list):
            left += node.values() if isinstance(node, dict) else node
    named.pop(None, None)
    known: dict[object, int] = {}

    def inside(node: Any) -> int:
        if isinstance(node, dict):
            part = sizes.get(node["file"], 0) if "file" in node else 0
            return VALUE_BYTES + part + sum(map(built, node.values()))
        return VALUE_BYTES + (sum(map(built, node)) if isinstance(node, list) else 0)

    def built(node: Any) -> int:
        key = node.get("__id__") if isinstance(node, dict) else None
        if key is None:
            return inside(node)
        if key not in known:
            known[key] = 0  # what holds itself adds nothing
            known[key] = max(map(inside, named[key]))
        return known[key]

    return built(schema)
