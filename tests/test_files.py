"""A file is there whole or not at all, whatever goes wrong on the way."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from vocc_torch.arrays import read_bits
from vocc_torch.errors import VoccError
from vocc_torch.files import (
    UNFINISHED,
    atomic_file,
    demand_folder,
    locked,
    ordinary_file,
    read_file,
    sweep,
    unfinished,
    write_atomically,
)
from vocc_torch.plugins import ModuleFile
from vocc_torch.receiver.locators import DetectorLocator
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.recordings.reading import read_recording
from vocc_torch.report.folder import refuse_results
from vocc_torch.report.rate_tables import read_tables
from vocc_torch.simulation.effects.backdrops import pictures_of


def names(folder):
    return sorted(entry.name for entry in folder.iterdir())


@pytest.mark.parametrize(
    "failure", [OSError(errno.ENOSPC, "No space left on device"), OSError("odd")]
)
def test_a_full_disk_leaves_the_old_file_and_no_other(tmp_path, monkeypatch, failure):
    path = tmp_path / "ledger.csv"
    write_atomically(path, b"old")

    def full(_):
        raise failure

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(VoccError) as refusal:
        write_atomically(path, b"new")
    message = str(refusal.value)
    assert message.startswith(f"cannot write {path}")
    assert (failure.strerror or "odd") in message
    assert "\n" not in message
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["ledger.csv"]


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, RuntimeError])
def test_an_interruption_leaves_the_old_file_and_no_other(tmp_path, interruption):
    path = tmp_path / "model.pt"
    write_atomically(path, b"old")

    def write():
        with atomic_file(path) as temporary:
            temporary.write_bytes(b"half of the ne")
            raise interruption

    with pytest.raises(interruption):
        write()
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["model.pt"]


def test_what_stands_in_the_place_is_refused_by_name(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_bytes(b"")
    for place in ("folder", "file/inside", "zero\0", "long" * 99, f"{'long' * 99}/a"):
        with pytest.raises(VoccError, match=f"^cannot write .*{place[:4]}"):
            write_atomically(tmp_path / place, b"")
    assert names(tmp_path) == ["file", "folder"]
    with pytest.raises(VoccError, match="is no folder"):
        demand_folder(tmp_path / ("long" * 99) / "a")


def killed(code):
    """Run a program that kills itself, and give its number."""
    end = "import os; os.kill(os.getpid(), 9)"
    process = subprocess.Popen([sys.executable, "-c", f"{code}\n    {end}"])
    assert process.wait() == -9
    return process.pid


def test_what_a_killed_process_left_is_swept_and_nothing_else(tmp_path):
    where = repr(str(tmp_path / "a.csv"))
    write = f"from vocc_torch.files import atomic_file\nwith atomic_file({where}) as temporary:"
    killed(f"{write}\n    temporary.write_bytes(b'half')")
    assert [name.startswith(".a.") for name in names(tmp_path)] == [True]
    kept = {f".b.{os.getpid()}-0.tmp.csv", ".tmp", ".x.tmp", "a.1.tmp", ".mine.tmp.csv"}
    for name in kept:
        (tmp_path / name).write_bytes(b"")
    sweep(tmp_path.iterdir())
    assert set(names(tmp_path)) == kept


def test_the_same_command_alone_goes_on_over_what_a_killed_one_left(tmp_path):
    """And not over results that a command ended well with."""
    result = tmp_path / "receiver.pt"
    killed(
        "from pathlib import Path\nfrom vocc_torch.files import unfinished\n"
        f"with unfinished(Path({str(tmp_path)!r}), 'task=train'):\n"
        f"    Path({str(result)!r}).write_text('half')"
    )
    refusal = pytest.raises(VoccError, match=r"already holds receiver\.pt")
    with refusal, unfinished(tmp_path, "task=decode"):
        refuse_results(tmp_path)
    with unfinished(tmp_path, "task=train"):
        refuse_results(tmp_path)
    assert names(tmp_path) == ["receiver.pt"]
    with unfinished(tmp_path, "task=train"), pytest.raises(VoccError):
        refuse_results(tmp_path)


@pytest.mark.parametrize("left", [["a.png"], []])
def test_an_interrupted_command_goes_on_where_it_had_written_anything(tmp_path, left):
    def work():
        with unfinished(tmp_path, "task=tradeoff"):
            for name in left:
                (tmp_path / name).write_text("")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    assert [name for name in names(tmp_path) if name != UNFINISHED] == left
    assert (tmp_path / UNFINISHED).exists() == bool(left)
    with unfinished(tmp_path, "task=tradeoff"):
        refuse_results(tmp_path)


def test_a_folder_is_held_by_one_process_until_it_ends_or_is_killed(tmp_path):
    hold = f"from vocc_torch.files import locked\nwith locked({str(tmp_path)!r}):"
    killed(f"{hold}\n    pass")
    with locked(tmp_path):
        code = f"{hold}\n    pass"
        second = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=False
        )
        assert "is in use by another run: wait until that one ends" in second.stderr
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    assert names(tmp_path) == []


def test_a_link_stays_and_its_file_is_written(tmp_path):
    """Also one that names nothing yet."""
    (tmp_path / "far").mkdir()
    for name in ("there", "missing"):
        (tmp_path / name).symlink_to(tmp_path / "far" / name)
    (tmp_path / "far" / "there").write_bytes(b"old")
    for name in ("there", "missing"):
        write_atomically(tmp_path / name, b"new")
        assert (tmp_path / name).is_symlink()
        assert (tmp_path / "far" / name).read_bytes() == b"new"
    assert names(tmp_path / "far") == ["missing", "there"]


def unreadable(tmp_path, kind):
    """A path that is no ordinary file."""
    path = tmp_path / "odd"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "link to a device":
        path.symlink_to("/dev/zero")
    elif kind == "loop":
        path.symlink_to(path)
    else:
        path.mkdir()
    return path


@pytest.mark.parametrize("kind", ["pipe", "link to a device", "loop", "folder"])
def test_what_is_no_ordinary_file_is_neither_read_nor_replaced(tmp_path, kind):
    path = unreadable(tmp_path, kind)
    before = path.lstat()
    for refused in (
        lambda: write_atomically(path, b"x"),
        lambda: read_file(path, "model"),
    ):
        with pytest.raises(VoccError, match=r"^(cannot write|model) .*odd") as error:
            refused()
        assert "\n" not in str(error.value)
    after = path.lstat()
    assert (after.st_mode, after.st_ino) == (before.st_mode, before.st_ino)
    assert names(tmp_path) == ["odd"]


READERS = {
    "model": lambda path: Receiver.load(path),
    "code": lambda path: ModuleFile(str(path)).module(),
    "table": read_tables,
    "bits of a calibration": lambda path: read_bits(path, "calibrate.bits", (8, 8)),
    "message": lambda path: read_file(path, "input"),
    "weights": lambda path: DetectorLocator(weights=str(path)).settings,
    "recording": lambda path: list(read_recording(path, "luma")),
    "folder with a picture of it": lambda path: pictures_of(str(path.parent), Path()),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("kind", ["pipe", "link to a device"])
def test_no_reader_waits_for_a_pipe_or_reads_a_device(tmp_path, reader, kind):
    path = unreadable(tmp_path, kind)
    path = path.rename(path.with_suffix(".png"))
    with pytest.raises(VoccError) as error:
        READERS[reader](path)
    assert "\n" not in str(error.value)


def test_a_file_beyond_a_size_is_not_read(tmp_path):
    """A hole of a terabyte takes no room on the disk."""
    with (tmp_path / "large").open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(VoccError, match="has 1099511627776 bytes, and at most"):
        read_file(tmp_path / "large")
    (tmp_path / "small").write_bytes(b"1234")
    with pytest.raises(VoccError, match="has 4 bytes, and at most 3 are read"):
        read_file(tmp_path / "small", most_bytes=3)
    (tmp_path / "large").rename(tmp_path / UNFINISHED)
    with pytest.raises(VoccError, match=r"mark .* at most"), unfinished(tmp_path, "a"):
        pass
    with (
        pytest.raises(ValueError, match="of the block"),
        ordinary_file(tmp_path / "small"),
    ):
        raise ValueError("of the block")


def test_the_mark_of_a_killed_command_goes_when_another_ends_well(tmp_path):
    mark = tmp_path / UNFINISHED
    mark.write_text("1\ntask=export workers=2")
    (tmp_path / "frame.png").touch()
    with pytest.raises(ValueError), unfinished(tmp_path, "task=export"):  # noqa: PT011
        raise ValueError
    assert mark.exists()
    with unfinished(tmp_path, "task=export"):
        pass
    assert not mark.exists()
