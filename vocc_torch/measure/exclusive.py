"""A file that one process at a time may hold open."""

from __future__ import annotations

import errno
import os
import socket
import stat
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from vocc_torch.errors import VoccError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]  # no other module stands in for it

_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP}
"""What ``flock`` answers on file systems that know no locks, some network ones among them."""


@dataclass(slots=True)
class ExclusiveFile:
    """An open file that no other holder can have.

    Held by ``flock``, the file is free again the moment its holder ends, however it ends. Where there is no
    ``flock`` (Windows, some network file systems) a file beside it, with ``.lock`` at the end of its name,
    says who holds it. Killed holders leave that one behind: the refusal names it, and it is deleted by hand.

    Args:
        descriptor: the open file.
        lock_file: the file beside it, where there is one.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     held = ExclusiveFile.open(Path(folder) / "a")
        ...     try:
        ...         ExclusiveFile.open(Path(folder) / "a")
        ...     except VoccError as error:
        ...         print("in use" in str(error))
        ...     held.close()
        True
    """

    descriptor: int
    lock_file: Path | None = None

    @classmethod
    def open(cls, path: Path) -> ExclusiveFile:
        """Open a file to read and append; it and its folders are made where they are missing.

        Raises:
            VoccError: somebody else holds it, it cannot be written, or it is no ordinary file.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)
            held = cls(os.open(path, flags, 0o666))
        except OSError as error:
            raise cannot_write(path, error) from error
        try:
            if not stat.S_ISREG(os.fstat(held.descriptor).st_mode):
                raise VoccError(f"{path} is a device or a pipe: it must be an ordinary file")
            held._lock(path)
        except BaseException:
            held.close()
            raise
        return held

    def _lock(self, path: Path) -> None:
        """Take the lock, or refuse."""
        if fcntl is None:
            self._make_lock_file(path)
            return
        try:
            fcntl.flock(self.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise VoccError(
                f"{path} is in use by another run: wait until that one ends, or choose another file"
            ) from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise cannot_write(path, error) from error
            self._make_lock_file(path)

    def _make_lock_file(self, path: Path) -> None:
        """Stand in for ``flock``."""
        beside = path.with_name(path.name + ".lock")
        try:
            descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL)
        except FileExistsError:
            raise VoccError(
                f"{path} is in use by another run ({_holder(beside)}): "
                f"wait until that one ends, or delete {beside} if it was killed"
            ) from None
        except OSError as error:
            raise cannot_write(beside, error) from error
        self.lock_file = beside
        try:
            os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode())
        except OSError as error:
            raise cannot_write(beside, error) from error
        finally:
            os.close(descriptor)

    def close(self) -> None:
        """Let go of the file; closing twice is harmless."""
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1
        if self.lock_file is not None:
            with suppress(OSError):
                self.lock_file.unlink()
            self.lock_file = None


def _holder(lock_file: Path) -> str:
    """Say who holds a file, as far as the file beside it tells."""
    try:
        return " ".join(lock_file.read_text().split()) or "not named"
    except (OSError, UnicodeDecodeError):
        return "not named"


def cannot_write(path: Path, error: OSError) -> VoccError:
    """Word what the system refused, and what helps.

    Example:
        >>> print(cannot_write(Path("a"), OSError(errno.EROFS, "Read-only file system")))
        cannot write a: Read-only file system: make it writable, or choose another file
    """
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    help_ = "make room, then start the same run again" if full else "make it writable, or choose another file"
    return VoccError(f"cannot write {path}: {error.strerror or error}: {help_}")
