"""The manifest of a folder: size and digest of each file, written once all of them are on the disk."""

import hashlib
import json
import os
from pathlib import Path

from vocc_torch.files import read_file, write_atomically
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
    files = sorted(folder.iterdir())
    for path in (*files, folder):
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    entries = {path.name: [path.stat().st_size, digest(path)] for path in files}
    write_atomically(folder / NAME, json.dumps(entries, indent=0).encode())


def agrees(folder: Path) -> bool:
    """Whether a folder holds the files of its manifest, with their sizes and digests, and no others."""
    try:
        entries = json.loads(read_file(folder / NAME))
        files = {path.name: path for path in folder.iterdir() if path.name != NAME}
        return files.keys() == entries.keys() and all(
            path.is_file() and entries[name] == [path.stat().st_size, digest(path)]
            for name, path in files.items()
        )
    except (OSError, ValueError, AttributeError, RecursionError):
        return False


def digest(path: Path) -> str:
    """Give the SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
