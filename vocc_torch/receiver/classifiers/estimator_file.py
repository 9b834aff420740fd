"""Estimators of scikit-learn in a model file: packed by skops, and read within a bound of memory."""

import zipfile
from collections.abc import Callable
from io import BytesIO
from typing import Any

from vocc_torch.errors import VoccError
from vocc_torch.receiver.model_file import MOST_BYTES, MOST_VALUES, parse_json

TRUSTED = ("sklearn.ensemble._hist_gradient_boosting.predictor.TreePredictor",)
"""Classes of estimators that ship, arrays alone, which skops does not trust by itself."""

SCHEMA = "schema.json"
"""The part of skops's archive that describes the object; the others are arrays."""

ARRAY = b"\x93NUMPY"
"""How a part that holds an array begins: skops also reads archives within the archive."""


def skops_io(name: str) -> tuple[Any, str]:
    """Import skops.io, which is an extra, and give scikit-learn's release.

    Args:
        name: of the classifier, for the refusal.

    Raises:
        VoccError: skops is not installed.
    """
    try:
        import skops.io
    except ImportError:
        extra = "pip install 'vocc-torch[classifiers]' to keep it"
        raise VoccError(f"classifier {name} is an estimator: {extra}") from None
    import sklearn

    return skops.io, str(sklearn.__version__)


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

    Parts must lie there as they are, since a compressed one may unpack to more than it states.

    Raises:
        VoccError: a compressed part, one that is no array, or more than 64 MiB or 2^20 values.
    """
    if packed.count(b"PK\1\2") > MOST_VALUES >> 4:
        raise VoccError("it has too many parts")
    with zipfile.ZipFile(BytesIO(packed)) as archive:
        parts = archive.infolist()
        if any(part.compress_type != zipfile.ZIP_STORED for part in parts):
            raise VoccError("its parts are compressed")
        if (stated := sum(part.file_size for part in parts)) > MOST_BYTES:
            raise VoccError(f"it unpacks to {stated} bytes, at most {MOST_BYTES}")
        for part in parts:
            with archive.open(part) as content:
                if part.filename != SCHEMA and content.read(len(ARRAY)) != ARRAY:
                    raise VoccError("it has a part that is no array")
        parse_json(archive.read(SCHEMA))
