"""Writing files whole or not at all."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

from vocc_torch.errors import VoccError


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file through a temporary one beside it, so that a reader never meets half of it.

    Args:
        path: the file; its folder is made where it is missing.
        content: all of its bytes.

    Raises:
        VoccError: the folder or the file cannot be written, for instance because the disk is full.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_atomically(Path(folder) / "a" / "b.txt", b"text")
        ...     (Path(folder) / "a" / "b.txt").read_bytes()
        b'text'
    """
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        Path(temporary).chmod(0o644)
        Path(temporary).replace(path)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise VoccError(f"cannot write {path} ({reason}): nothing was left half-written") from None
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                Path(temporary).unlink(missing_ok=True)
