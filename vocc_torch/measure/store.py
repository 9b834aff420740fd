"""The store of a run: an SQLite file that is ledger, result and checkpoint.

It has a row for each counted block of a point and for each training. A run that is killed at any moment and
started again reads both, and ends with the numbers of an undisturbed run.
"""

import hashlib
import json
import os
import re
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any, Self

from vocc_torch import __version__
from vocc_torch.errors import VoccError
from vocc_torch.sources import package_digest
from vocc_torch.yaml_text import leaves

SUFFIX = ".sqlite"
"""How a store's name ends."""

_APPLICATION = int.from_bytes(b"vocc", "big")
_LEAST_BYTES = 512  # of an SQLite file; shorter ones SQLite takes for empty
_TABLES = (
    "CREATE TABLE identity (settings TEXT, package TEXT)",
    "CREATE TABLE blocks (point TEXT, block INTEGER, frames INTEGER, content BLOB, digest TEXT, "
    "PRIMARY KEY (point, block, frames)) WITHOUT ROWID",
)
_ANOTHER = "give another name= or file"
_DAMAGED = ("is damaged", "bring back a copy, or delete it to count everything again")
_LONGEST = 200
"""Most characters of a refusal, unless the path is very long."""
_UNSAID = r"^(world|made_with)\.|\.(plug_in|arguments|maker|files)\b"
"""Parts of a setting's path that mean nothing to its user."""
_STRANGER = f"is no ledger of vocc-torch: {_ANOTHER}"
_IN_USE = f"is in use by another run: wait until that one ends, or {_ANOTHER}"
_FULL = "cannot be written ({}): make room, then start the same run again"
_SEALED = "cannot be written ({}): make it writable, or " + _ANOTHER
_SAID = {
    sqlite3.SQLITE_NOTADB: _STRANGER,
    sqlite3.SQLITE_BUSY: _IN_USE,
    sqlite3.SQLITE_LOCKED: _IN_USE,
    sqlite3.SQLITE_FULL: _FULL,
    sqlite3.SQLITE_IOERR: _FULL,
    sqlite3.SQLITE_READONLY: _SEALED,
    sqlite3.SQLITE_CANTOPEN: _SEALED,
}
"""What SQLite's errors mean; other errors are damage."""


class Store(AbstractContextManager["Store"]):
    """An open store. No other run can open it until it is closed.

    The key of a row is a point, a block and the number of frames that were used of the block. If a budget
    ends inside a block and a later run needs more of it, the block is counted again and a longer row is
    added. A run with the smaller budget uses the shorter row again. The checksum of a row includes the
    settings, so changed rows and rows of other runs are detected.

    A row is one transaction, on the disk before :meth:`add` returns; :meth:`together` makes one of many.
    SQLite undoes half-written rows at the next :meth:`open`, after a killed run or a power failure.

    Attributes:
        path: the file.
        close: lets the next run have the file; closing twice is harmless.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "ledger.sqlite"
        ...     with Store.open(path, {"seed": 0}) as store:
        ...         store.add("near", 0, 64, b"counts")
        ...     with Store.open(path, {"seed": 0}) as store:
        ...         len(store), store.find("near", 0, 64)
        (1, b'counts')
    """

    def __init__(
        self, path: Path, connection: sqlite3.Connection, settings: str
    ) -> None:
        """Hold an open connection; call :meth:`open` instead."""
        self.path, self.close = path, connection.close
        self._connection, self._settings, self._inode = connection, settings, -1

    @classmethod
    def open(cls, path: str | Path, settings: Mapping[str, object]) -> Self:
        """Open a store, or begin one where there is no file.

        Args:
            path: the file; missing folders are made.
            settings: everything that the numbers depend on, as plain values: seed, scene, camera, panel,
                receivers, training, kind of device. Batch size, folder, budget of frames and stop rule do
                not belong there.

        Raises:
            VoccError: the file is in use by another run, cannot be written, is damaged or is not a store; or it
                has another version or other settings, which are named.
        """
        path, text = Path(path), canonical(settings)
        with _refusing(path):
            _demand_ordinary(path)
            path.parent.mkdir(parents=True, exist_ok=True)
            connection = sqlite3.connect(path, timeout=0, isolation_level=None)
        store = cls(path, connection, text)
        try:
            with _refusing(path):
                store._begin()
                store._inode = path.stat().st_ino
        except BaseException:
            store.close()
            with suppress(OSError):
                if not path.stat().st_size:  # not even the settings could be written
                    path.unlink()
            raise
        return store

    def _begin(self) -> None:
        """Lock the file until it is closed, and write the settings or check all that is there."""
        # Rows of two algorithms do not add.
        code = f"{__version__} {package_digest('vocc_torch')}"
        self._run("PRAGMA locking_mode=EXCLUSIVE")
        self._run("PRAGMA trusted_schema=OFF")
        self._run("BEGIN EXCLUSIVE")
        # What a killed run left has been taken back by now; its journal would stay where nothing is written.
        self.path.with_name(f"{self.path.name}-journal").unlink(missing_ok=True)
        if self._first("SELECT 1 FROM sqlite_master"):
            self._check(code)
        else:
            for statement in (*_TABLES, f"PRAGMA application_id={_APPLICATION}"):
                self._run(statement)
            self._run("INSERT INTO identity VALUES (?, ?)", self._settings, code)
        self._run("COMMIT")

    def _check(self, code: str) -> None:
        """Refuse a file that is not a whole store of these settings, begun by this code."""
        if self._first("PRAGMA application_id") != _APPLICATION:
            raise VoccError(f"{_shown(self.path)} {_STRANGER}")
        ((settings, begun_by),) = self._run("SELECT settings, package FROM identity")
        if begun_by != code:
            raise self._refusal(
                f"was begun by other source code of vocc-torch ({begun_by}, now {code})",
                "go back to that code, or give another name=",
            )
        if settings != self._settings:
            changes = what_changed(json.loads(settings), json.loads(self._settings))
            told = "; ".join(changes) or _DAMAGED[0]
            raise self._refusal(told, f"use the earlier values, or {_ANOTHER}")
        tables = self._run("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL")
        is_whole = tables == [(table,) for table in _TABLES]
        is_whole = is_whole and self._first("PRAGMA integrity_check(1)") == "ok"
        rows = self._run("SELECT * FROM blocks") if is_whole else []
        if not is_whole or any(self._digest(*row) != digest for *row, digest in rows):
            raise self._refusal(*_DAMAGED)

    def _run(self, statement: str, *values: object) -> list[tuple[Any, ...]]:
        """Run a statement, and give the rows that it finds."""
        with _refusing(self.path):
            return self._connection.execute(statement, values).fetchall()

    def _first(self, query: str, *values: object) -> Any:
        """Give the first value that a query finds, or None."""
        return next(iter(self._run(query, *values)), (None,))[0]

    def _digest(self, *row: object) -> str:
        """Give the checksum of a row of these settings."""
        text = json.dumps((self._settings, *row), default=bytes.hex)
        return hashlib.sha256(text.encode()).hexdigest()

    def _refusal(self, told: str, help_: str) -> VoccError:
        """Word a refusal in one line that is not too long."""
        start, end = f"ledger {_shown(self.path)}: ", f": {help_}"
        told = _cut(told, max(20, _LONGEST - len(start + end)))
        return VoccError(start + told + end)

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()

    def __len__(self) -> int:
        """Count the blocks."""
        return int(self._first("SELECT count(*) FROM blocks WHERE frames"))

    def find(self, point: str, block: int, frames: int) -> bytes | None:
        """Give what was counted in exactly this many frames of a block, or None."""
        content = "SELECT content FROM blocks WHERE point=? AND block=? AND frames=?"
        found: bytes | None = self._first(content, point, block, frames)
        return found

    @contextmanager
    def together(self) -> Iterator[None]:
        """Write all appended rows in one transaction, with one wait for the disk.

        Raises:
            VoccError: as :meth:`add`.
        """
        self._demand_file()
        self._run("BEGIN")
        try:
            yield
        finally:  # also what came before an error
            if self._connection.in_transaction:
                self._run("COMMIT")

    def _demand_file(self) -> None:
        """Refuse to write if the file is missing or another one."""
        with _refusing(self.path):
            there = self.path.exists() and self.path.stat().st_ino == self._inode
        if not there:
            raise self._refusal("was deleted under this run", "start it again to go on")

    def add(
        self, point: str, block: int, frames: int, content: bytes, *, anew: bool = False
    ) -> None:
        """Add a row; one that is already there is not written twice.

        Args:
            point: the point's name, which keys its random draws, or another key.
            block: index of the block, at least 0.
            frames: number of used frames of the block, from the first on, 1 to 64; 0 for other rows.
            content: the counts as bytes.
            anew: whether the content replaces that of an existing row.

        Raises:
            VoccError: a row that contradicts an existing one, or the disk is full or cannot be written. The
                file then stays unchanged.
        """
        known, row = self.find(point, block, frames), (point, block, frames, content)
        if known is None or anew:
            if not self._connection.in_transaction:
                self._demand_file()
            line = (*row, self._digest(*row))
            self._run("INSERT OR REPLACE INTO blocks VALUES (?, ?, ?, ?, ?)", *line)
        elif known != content:
            raise self._refusal(
                f"has other counts for block {block} of {point}",
                f"its settings miss what they depend on, {_ANOTHER}",
            )


def _demand_ordinary(path: Path) -> None:
    """Refuse what is no file that SQLite would open for writing, or would take for an empty store."""
    # SQLite would block on a pipe beside the store.
    for suffix in ("", "-journal", "-wal"):
        part = path.with_name(path.name + suffix)
        if part.is_symlink() or (part.exists() and not part.is_file()):
            raise VoccError(
                f"{_shown(part)} is a link, a folder, a device or a pipe: it must be an ordinary file"
            )
    if path.exists() and 0 < path.stat().st_size < _LEAST_BYTES:
        raise VoccError(f"{_shown(path)} {_STRANGER}")
    # SQLite would open it read-only.
    if path.exists() and not os.access(path, os.W_OK):
        raise PermissionError(None, "it is read-only")


@contextmanager
def _refusing(path: Path) -> Iterator[None]:
    """Say in one line what SQLite or the system refused, and what helps."""
    try:
        yield
    except VoccError:
        raise
    except (
        sqlite3.Error,
        OSError,
        ValueError,
        TypeError,
        KeyError,
        RecursionError,
    ) as error:
        code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT) & 0xFF
        told = _SAID.get(code, ": ".join(_DAMAGED))
        if isinstance(error, sqlite3.ProgrammingError):
            told = "is closed: open it again"
        if isinstance(error, OSError):
            told = _SEALED
        reason = getattr(error, "strerror", None) or error
        raise VoccError(f"{_shown(path)} {told.format(reason)}") from None


def _shown(path: Path) -> Path:
    """Return a path for messages, relative if it is in the working directory."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def _cut(text: str, length: int) -> str:
    """Shorten a text that is too long for a line."""
    return text if len(text) <= length else text[: max(0, length - 3)] + "..."


def canonical(settings: Mapping[str, object]) -> str:
    """Write settings as JSON with sorted keys, so that equal settings have equal text.

    Raises:
        VoccError: a value that JSON does not have.

    Example:
        >>> canonical({"seed": 0, "camera": {"focal_length_mm": 25, "iso_limits": (100, 3200)}})
        '{"camera": {"focal_length_mm": 25, "iso_limits": [100, 3200]}, "seed": 0}'
    """
    try:
        return json.dumps(settings, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise VoccError(f"settings cannot be written: {error}") from None


def what_changed(there: object, here: object) -> list[str]:
    """Say in which settings a store and this run differ.

    Example:
        >>> what_changed({"seed": 0, "world": {"dtype": "a"}}, {"seed": 1, "world": {"dtype": "b"}})
        ['seed was 0, is 1', 'dtype was a, is b']
    """
    # Texts without their quotes.
    old, new = (
        {
            name: value
            if isinstance(value, str)
            else json.dumps(value).replace('"', "")
            for name, value in leaves(of)
        }
        for of in (there, here)
    )
    changes = []
    for name in sorted(name for name in {*old, *new} if old.get(name) != new.get(name)):
        was, now = (_cut(texts.get(name, "not set"), 40) for texts in (old, new))
        key = re.sub(_UNSAID, "", name)
        changes.append(f"{key} was {was}, is {now}")
    return changes
