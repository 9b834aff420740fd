"""The ledger: a file that only grows, with one row for each block of a point that has been counted.

A run that is killed at any moment and started again takes the blocks that it had counted from the ledger and
counts the others. It ends with the numbers of a run that nobody disturbed.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import TypeVar

from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.exclusive import ExclusiveFile, cannot_write
from vocc_torch.measure.ledger_format import (
    MAGIC,
    DamagedLine,
    Key,
    LedgerRow,
    check_header,
    header,
    is_torn_header,
)
from vocc_torch.measure.paired import PairedCounts

K = TypeVar("K", bound=Key)
V = TypeVar("V", bound=Counts | PairedCounts)


class Ledger:
    """An open ledger, which nobody else can open until it is closed.

    Rows are only ever added. A row belongs to a point, a block and the number of the block's frames that were
    used: where a budget ended in the middle of a block and a later run needs more of it, the block is counted
    again and the longer row is added after the shorter one, which stays and is used again by a run of the
    smaller budget. Rows may come in any order; the same row twice is harmless, and two rows that contradict
    each other are refused.

    A row is written in one piece and is on the disk before :meth:`append` returns. A run killed while it
    writes leaves a torn last line, which the next :meth:`open` cuts off. A power failure does the same.

    Attributes:
        path: the file.
        repaired: what was cut off the file's end when it was opened, in words; empty if it was whole.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = Path(folder) / "ledger.jsonl"
        ...     with Ledger.open(path, {"seed": 0}) as ledger:
        ...         _ = ledger.append("near", 0, 64, {("flda_3", 0): Counts(64, 4096)})
        ...     with Ledger.open(path, {"seed": 0}) as ledger:
        ...         sorted(ledger.blocks("near")), len(ledger), ledger.repaired
        ([0], 1, '')
    """

    path: Path
    repaired: str

    def __init__(self, path: Path, file: ExclusiveFile, end: int, repaired: str) -> None:
        """Take what :meth:`open` has checked; use that."""
        self.path, self.repaired = path, repaired
        self._file, self._end = file, end
        # Rows are kept as compressed lines: as objects they would take some twenty times the memory.
        self._rows: dict[str, dict[tuple[int, int], bytes]] = {}

    @classmethod
    def open(cls, path: str | Path, settings: Mapping[str, object]) -> Ledger:
        """Open a ledger, or begin one where there is no file.

        Args:
            path: the file; missing folders are made.
            settings: what the numbers depend on, as plain values: seed, scene, camera, panel, receivers,
                training, kind of device. Not what only changes how long it takes or how far it goes: batch
                size, the folder, the budget of frames and the stop rule.

        Raises:
            VoccError: the file is in use by another run, cannot be written, is damaged, is no ledger, or is
                that of another version or of other settings, with the settings that differ.
        """
        path, first = Path(path), header(settings)
        file = ExclusiveFile.open(path)
        try:
            content = _content(path, file.descriptor)
            if is_torn_header(content):
                repaired = f"{path}: cut off a torn first line of {len(content)} bytes" if content else ""
                ledger = cls(path, file, 0, repaired)
                if content:
                    ledger._cut()
                ledger._write(first)
                _sync_folder(path.parent)
                return ledger
            ledger = cls(path, file, 0, "")
            ledger._end = _parsed(path, content, settings, ledger._file_away)
            if torn := len(content) - ledger._end:
                ledger.repaired = f"{path}: cut off a torn last line of {torn} bytes"
                ledger._cut()
            return ledger
        except BaseException:
            _remove_empty(path, file.descriptor)
            file.close()
            raise

    def __enter__(self) -> Ledger:
        """Give the ledger itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()

    def close(self) -> None:
        """Let the next run have the file; closing twice is harmless."""
        self._file.close()

    def __len__(self) -> int:
        """Count the rows, each once."""
        return sum(len(rows) for rows in self._rows.values())

    def __iter__(self) -> Iterator[LedgerRow]:
        """Walk the rows, a point at a time."""
        for rows in self._rows.values():
            yield from map(_unpacked, rows.values())

    def blocks(self, point: str) -> dict[int, LedgerRow]:
        """Give the longest row of each block of a point, by ascending block."""
        longest = {block: row for (block, _), row in sorted(self._rows.get(point, {}).items())}
        return {block: _unpacked(row) for block, row in longest.items()}

    def find(self, point: str, block: int, frames: int) -> LedgerRow | None:
        """Give the row of exactly this many frames of a block, or None."""
        row = self._rows.get(point, {}).get((block, frames))
        return None if row is None else _unpacked(row)

    def append(self, point: str, block: int, frames: int, counts: Mapping[K, V]) -> LedgerRow:
        """Add a row; one that is already there is not written twice.

        Args:
            point: the point's name, which keys its random draws.
            block: index of the block, at least 0.
            frames: how many of its frames were used, from the first on, 1 to 64.
            counts: by label.

        Raises:
            VoccError: a row that contradicts one that is there, or the disk is full or refuses. The file is
                then as it was before.
        """
        kept: dict[Key, Counts | PairedCounts] = {key: one for key, one in counts.items()}
        row = LedgerRow(point, block, frames, kept)
        line = row.line()
        if (block, frames) not in self._rows.get(point, {}):
            self._write(line)
        self._file_away(row, line)
        return row

    def _file_away(self, row: LedgerRow, line: bytes) -> None:
        """Remember a row, or refuse one that contradicts what is there."""
        packed, rows = zlib.compress(line.rstrip(b"\n"), 1), self._rows.setdefault(row.point, {})
        known = rows.setdefault((row.block, row.frames), packed)
        if known != packed and _unpacked(known).counts != row.counts:
            raise VoccError(
                f"ledger {self.path} has other counts for block {row.block} of {row.point}: something that "
                "the results depend on is missing from its settings; choose another ledger"
            )

    def _write(self, line: bytes) -> None:
        """Put a line at the end and on the disk, or leave the file as it was."""
        if self._file.descriptor < 0:
            raise VoccError(f"ledger {self.path} is closed: open it again")
        status = os.fstat(self._file.descriptor)
        if status.st_size != self._end or not status.st_nlink:
            raise VoccError(
                f"ledger {self.path} was changed or deleted under this run: start the run again to go on"
            )
        try:
            left = memoryview(line)
            while left:
                left = left[os.write(self._file.descriptor, left) :]
            os.fsync(self._file.descriptor)
        except BaseException as error:
            with suppress(VoccError):  # it would leave a torn last line, which the next open cuts off
                self._cut()
            if isinstance(error, OSError):
                raise cannot_write(self.path, error) from error
            raise
        self._end += len(line)

    def _cut(self) -> None:
        """Cut off what follows the last whole line."""
        try:
            os.ftruncate(self._file.descriptor, self._end)
            os.fsync(self._file.descriptor)
        except OSError as error:
            raise cannot_write(self.path, error) from error


def _content(path: Path, descriptor: int) -> bytes:
    """Read the whole file, or of a file that is no ledger only its beginning."""
    try:
        with open(descriptor, "rb", closefd=False) as file:
            first = file.read(len(MAGIC))
            return first + file.read() if first == MAGIC else first + file.read(1)
    except OSError as error:
        raise VoccError(f"cannot read ledger {path}: {error.strerror or error}") from error


def _parsed(
    path: Path, content: bytes, settings: Mapping[str, object], keep: Callable[[LedgerRow, bytes], None]
) -> int:
    """Hand the rows of a ledger on and say where the last whole line ends; only the last may be torn."""
    first, *lines = content.split(b"\n")
    end = len(first) + 1
    try:
        check_header(first, settings)
    except VoccError as error:
        raise VoccError(f"ledger {path} {error}") from None
    tail = lines.pop()  # what follows the last newline: nothing, or a torn line
    for number, line in enumerate(lines):
        try:
            row = LedgerRow.read(line)
        except DamagedLine:
            if number == len(lines) - 1 and not tail:
                break
            raise VoccError(
                f"ledger {path} is damaged in line {number + 2} of {len(lines) + 1}: "
                "bring back a copy, or delete it to count everything again"
            ) from None
        except VoccError as error:
            raise VoccError(f"ledger {path} {error}") from None
        keep(row, line)
        end += len(line) + 1
    return end


def _unpacked(row: bytes) -> LedgerRow:
    """Read a row that is kept as its compressed line."""
    return LedgerRow.read(zlib.decompress(row))


def _remove_empty(path: Path, descriptor: int) -> None:
    """Delete a file in which not even a header could be written, while nobody else can hold it."""
    with suppress(OSError):
        if not os.fstat(descriptor).st_size:
            path.unlink()


def _sync_folder(folder: Path) -> None:
    """Put a new file's entry in its folder on the disk, where a system can do that."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
