"""The manifest of a folder: size and digest of each file, written once all of them are on the disk."""

import hashlib
import json
import os
from pathlib import Path

from vocc_torch.files import ordinary_file, read_file, write_atomically
from vocc_torch.report.folder import MANIFEST

NAME = MANIFEST


def write(folder: Path) -> None:
    """Flush every file of a folder, and then write its manifest.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     _ = (Path(folder) / "a.txt").write_text("text")
        ...     write(Path(folder))
        ...     agrees(Path(folder))
        True
    """
    for path in (*folder.iterdir(), folder):
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    write_atomically(folder / NAME, json.dumps(entries_of(folder), indent=0).encode())


def agrees(folder: Path) -> bool:
    """Whether a folder holds the files of its manifest, with their sizes and digests, and no others."""
    try:
        return bool(json.loads(read_file(folder / NAME)) == entries_of(folder))
    except (OSError, ValueError, RecursionError):
        return False


def entries_of(folder: Path) -> dict[str, list[int | str]]:
    """Give size and SHA-256, hexadecimal, of each file of a folder but the manifest.

    Raises:
        VoccError: a folder inside, a pipe or a device.
    """
    entries: dict[str, list[int | str]] = {}
    for path in sorted(folder.iterdir()):
        if path.name != NAME:
            with ordinary_file(path) as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            entries[path.name] = [path.stat().st_size, digest]
    return entries
