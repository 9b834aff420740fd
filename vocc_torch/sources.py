"""Digests of Python source: which code counted, and which code a part from outside comes from."""

import functools
import hashlib
from collections.abc import Iterator
from importlib import resources
from importlib.resources.abc import Traversable

DIGITS = 16
"""Hexadecimal digits of a digest: two different sources agree once in 10^19."""


def digest_of(texts: dict[str, bytes]) -> str:
    r"""Digest source texts and their names, whatever their order and their line endings.

    Example:
        >>> digest_of({"a.py": b"x = 1\r\n", "b.py": b""}) == digest_of({"b.py": b"", "a.py": b"x = 1\n"})
        True
    """
    total = hashlib.sha256()
    for name in sorted(texts):
        text = texts[name].replace(b"\r\n", b"\n")
        total.update(f"{name}\0{len(text)}\0".encode() + text)
    return total.hexdigest()[:DIGITS]


@functools.cache
def package_digest(package: str) -> str:
    """Digest every Python file of a package, wherever it is installed; data files are not read.

    The files are read once in each process: code that changes later does not run in it either.

    Args:
        package: its name, as it is imported.

    Raises:
        ImportError: there is no such package.
        TypeError: it is a module and has no files of its own.

    Example:
        >>> package_digest("vocc_torch") != package_digest("json")
        True
    """
    return digest_of(dict(_sources(resources.files(package))))


def _sources(folder: Traversable, prefix: str = "") -> Iterator[tuple[str, bytes]]:
    """Yield the Python files below a folder, or below one in an archive, by their paths."""
    for entry in folder.iterdir():
        name = f"{prefix}{entry.name}"
        if entry.is_dir():
            yield from _sources(entry, f"{name}/")
        elif name.endswith(".py"):
            yield name, entry.read_bytes()
