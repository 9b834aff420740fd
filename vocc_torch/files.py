"""Writing files whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from vocc_torch.errors import VoccError


@contextmanager
def atomic_file(path: str | Path) -> Iterator[Path]:
    """Lend a temporary path beside ``path``; what is written there takes its place when the block ends well.

    Missing folders are made. After an error inside the block the temporary file is gone and ``path`` is as it
    was.

    Args:
        path: the file to write.

    Yields:
        The temporary path, with the same suffix.

    Raises:
        VoccError: the file cannot be written, with the system's reason.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with atomic_file(Path(folder) / "a.txt") as temporary:
        ...         _ = temporary.write_text("whole")
        ...     [entry.name for entry in Path(folder).iterdir()]
        ['a.txt']
    """
    target = Path(path)
    temporary = target.with_name(f".{target.stem}.{os.getpid()}.tmp{target.suffix}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        with temporary.open("rb+") as file:  # a full disk may speak up only here
            os.fsync(file.fileno())
        temporary.replace(target)
    except OSError as error:
        raise VoccError(f"cannot write {target}: {error.strerror or error}") from error
    finally:
        with suppress(OSError):  # that it cannot be deleted is not the error to tell of
            temporary.unlink(missing_ok=True)


def write_atomically(path: str | Path, content: bytes) -> None:
    """Write all the bytes of a file, whole or not at all.

    Raises:
        VoccError: as :func:`atomic_file`.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_atomically(Path(folder) / "a" / "b.txt", b"text")
        ...     (Path(folder) / "a" / "b.txt").read_bytes()
        b'text'
    """
    with atomic_file(path) as temporary:
        temporary.write_bytes(content)
