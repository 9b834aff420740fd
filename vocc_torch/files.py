"""Reading ordinary files alone, writing them whole or not at all, and locking a folder that is written to."""

import hashlib
import os
import re
import shutil
import stat
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path

from vocc_torch.errors import VoccError, printable

PICTURE_SUFFIXES = (
    ".png",
    ".jpg",
    ".jpeg",
    ".jfif",
    ".bmp",
    ".tif",
    ".tiff",
    ".webp",
    ".gif",
    ".pgm",
    ".ppm",
    ".avif",
    ".heic",
    ".heif",
    ".hif",
    ".jp2",
    ".j2k",
)
PICTURE_FORMATS = (
    "PNG",
    "JPEG",
    "BMP",
    "TIFF",
    "WEBP",
    "GIF",
    "PPM",
    "AVIF",
    "JPEG2000",
)
"""What a picture may be, whatever its name says: others of Pillow's readers run programs."""
VIDEO_SUFFIXES = (
    ".mp4",
    ".mkv",
    ".avi",
    ".mov",
    ".webm",
    ".m4v",
    ".mpg",
    ".mpeg",
    ".mjpeg",
    *(".ts", ".mts", ".m2ts", ".3gp", ".wmv", ".flv", ".ogv", ".y4m"),
)

MOST_BYTES = 1 << 30
"""Most bytes of a file that is read at once, unless its reader allows fewer: more fills a laptop's memory."""


@contextmanager
def ordinary_file(
    path: str | Path, what: str = "file", most_bytes: int = MOST_BYTES
) -> Iterator[BufferedReader]:
    """Open a file for reading; a pipe, a device, a folder or a file beyond the size is refused unread.

    Args:
        path: the file; a link is followed.
        what: name of the file in refusals.
        most_bytes: of it.

    Yields:
        The open file.

    Raises:
        VoccError: it cannot be opened, is no ordinary file or is too large.

    Example:
        >>> with ordinary_file("/dev/null", "model"):
        ...     pass
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: model /dev/null cannot be read: it must be an ordinary file
    """
    try:
        # A pipe without a writer would wait for ever, were it opened otherwise.
        handle = os.open(
            path,
            os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0),
        )
        file = os.fdopen(handle, "rb")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise VoccError(
            f"{what} {printable(str(path))} cannot be read: {reason}"
        ) from None
    with file:
        about, refused = os.fstat(handle), ""
        if not stat.S_ISREG(about.st_mode):
            refused = "it must be an ordinary file"
        elif about.st_size > most_bytes:
            refused = f"it has {about.st_size} bytes, and at most {most_bytes} are read"
        if refused:
            raise VoccError(f"{what} {printable(str(path))} cannot be read: {refused}")
        yield file


def read_file(
    path: str | Path, what: str = "file", most_bytes: int = MOST_BYTES
) -> bytes:
    """Read a file at once, as :func:`ordinary_file` opens it.

    Raises:
        VoccError: as :func:`ordinary_file`.
    """
    with ordinary_file(path, what, most_bytes) as file:
        return file.read()


def file_digest(path: str | Path) -> str:
    """Give the start of a file's SHA-256, in hexadecimal.

    Raises:
        VoccError: as :func:`ordinary_file`.
    """
    with ordinary_file(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


@contextmanager
def atomic_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; it replaces ``path`` when the block ends without an error.

    Missing folders are made. A link stays, and the file that it names is written. After an error inside the
    block the temporary file is gone and ``path`` is as it was.

    Args:
        path: the file to write.

    Yields:
        The temporary path, with the same suffix.

    Raises:
        VoccError: the file cannot be written, with the system's reason, or ``path`` is a pipe or a device.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with atomic_file(Path(folder) / "a.txt") as temporary:
        ...         _ = temporary.write_text("whole")
        ...     [entry.name for entry in Path(folder).iterdir()]
        ['a.txt']
    """
    target = Path(os.path.realpath(path)) if os.path.islink(path) else Path(path)  # noqa: PTH114  # no name is too long for it
    if os.path.lexists(target) and not os.path.isfile(target):  # noqa: PTH113
        raise VoccError(f"cannot write {path}: it must be an ordinary file")
    with _to_replace(target) as temporary:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        with temporary.open("rb+") as file:  # a full disk may speak up only here
            os.fsync(file.fileno())


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Lend a temporary folder that takes the place of ``path`` when the block ends well.

    After an error inside the block the temporary folder is gone.

    Args:
        path: the folder to write; what is there is replaced.

    Yields:
        The temporary folder, beside ``path``.

    Raises:
        VoccError: it cannot be written, with the system's reason.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with atomic_folder(Path(folder) / "a") as temporary:
        ...         _ = (temporary / "b.txt").write_text("whole")
        ...     [str(path.relative_to(folder)) for path in Path(folder).rglob("*")]
        ['a', 'a/b.txt']
    """
    target = Path(path)
    with _to_replace(target) as temporary:
        temporary.mkdir(parents=True)
        yield temporary
        if target.exists():
            shutil.rmtree(target)


@contextmanager
def _to_replace(target: Path) -> Iterator[Path]:
    """Lend a temporary path that takes the target's place at the end, and is gone after an error."""
    if "\0" in str(target):
        raise VoccError(f"cannot write {printable(str(target))}: a path has no zeros")
    # A name that :func:`sweep` knows when this process is gone.
    mine = f".{target.stem}.{os.getpid()}-{time.time_ns()}.tmp{target.suffix}"
    temporary = target.with_name(mine)
    try:
        yield temporary
        temporary.replace(target)
    except OSError as error:
        raise VoccError(f"cannot write {target}: {error.strerror or error}") from error
    finally:
        remove(temporary)


def remove(path: Path) -> None:
    """Remove a file or a folder, where it is there and can be removed."""
    shutil.rmtree(path, ignore_errors=True)
    with suppress(OSError):
        path.unlink(missing_ok=True)


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


def demand_folder(path: str | Path) -> None:
    """Refuse a file that a user names in a folder that there is not: a mistyped folder is not made.

    Raises:
        VoccError: there is no such folder.

    Example:
        >>> demand_folder("no/such/folder/model.pt")
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: cannot write no/such/folder/model.pt: no/such/folder is no folder
    """
    if not os.path.isdir(Path(path).parent):  # noqa: PTH112
        raise VoccError(f"cannot write {path}: {Path(path).parent} is no folder")


UNFINISHED = ".unfinished"
"""In a folder that a command writes to: the command's process and words, while it has not ended."""


@contextmanager
def unfinished(folder: Path, words: str) -> Iterator[None]:
    """Mark a folder while a command fills it; the same command after a kill finds and takes over the mark.

    A folder that holds anything but the mark of these words is not marked. After Ctrl-C the mark stays beside
    whatever was written.

    Args:
        folder: there already.
        words: of the command.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with unfinished(Path(folder), "task=train"):
        ...         is_unfinished(Path(folder))
        ...     is_unfinished(Path(folder))
        True
        False
    """
    mark = folder / UNFINISHED
    begun = read_file(mark, "mark").decode(errors="replace") if mark.is_file() else ""
    goes = begun.partition("\n")[2] == words or not any(folder.iterdir())
    if goes:
        write_atomically(mark, f"{os.getpid()}\n{words}".encode(errors="replace"))
    try:
        yield
        goes = True  # the folder is complete, whichever command began it
    except (KeyboardInterrupt, BrokenPipeError):
        goes &= all(path == mark for path in folder.iterdir())
        raise
    finally:
        if goes:
            mark.unlink(missing_ok=True)


def is_unfinished(folder: Path) -> bool:
    """Whether what a folder holds is of this process's command, begun now or before a kill."""
    mark = folder / UNFINISHED
    return mark.is_file() and mark.read_text().startswith(f"{os.getpid()}\n")


def sweep(paths: Iterable[Path]) -> None:
    """Remove temporary files of :func:`atomic_file` that ended processes left.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     _ = (Path(folder) / ".curve.999999999-0.tmp.png").write_bytes(b"half")
        ...     sweep(Path(folder).iterdir())
        ...     list(Path(folder).iterdir())
        []
    """
    for path in paths if sys.platform != "win32" else ():
        if made := re.fullmatch(r"\..+\.(\d{1,9})(-\d+)?\.tmp(\..+)?", path.name):
            try:
                os.kill(int(made[1]), 0)
            except ProcessLookupError:
                remove(path)
            except OSError:  # the process is another user's
                pass


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder that one process may use at a time; however the process ends, the system lets go of it.

    Raises:
        VoccError: another process holds it.
        OSError: no such folder.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder, locked(Path(folder)), locked(Path(folder)):
        ...     pass  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: ... is in use by another run: wait until that one ends, or give ...
    """
    if sys.platform == "win32":  # which has no locks of folders
        yield
        return
    import fcntl

    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            help_ = "wait until that one ends, or give another name="
            raise VoccError(f"{folder} is in use by another run: {help_}") from None
        yield
    finally:
        os.close(handle)
