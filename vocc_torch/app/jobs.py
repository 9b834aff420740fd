"""Jobs of a multirun: their lines on the terminal, and the files that a failed job leaves."""

import contextlib
import functools
import importlib
import io
import json
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from vocc_torch.app.config import inside_runs
from vocc_torch.errors import VoccError
from vocc_torch.files import UNFINISHED, write_atomically

FAILED, CONFIG = "failed.txt", "config.yaml"


@dataclass(frozen=True)
class Jobs:
    """Messages of the jobs of one command to their parent process, through a file.

    A job may run in a worker process, which cannot change this object in the parent. The object is small and
    can be pickled.

    Args:
        mailbox: an empty file that lasts as long as the command.
        parent: number of the process that started the jobs.

    Example:
        >>> import tempfile
        >>> with tempfile.NamedTemporaryFile() as mailbox:
        ...     jobs = Jobs(Path(mailbox.name), os.getpid())
        ...     jobs.tell(3, folder="runs/two/3")
        ...     jobs.tell(3, complaint="panel.rows is 0: it must be at least 1")
        ...     jobs.told(), jobs.parallel
        ([{'job': 3, 'elsewhere': False, 'folder': 'runs/two/3', 'complaint': 'panel.rows ...'}], False)
    """

    mailbox: Path
    parent: int

    @property
    def elsewhere(self) -> bool:
        """Whether this is another process than the one that started the jobs."""
        return os.getpid() != self.parent

    def tell(self, job: int, **about: str) -> None:
        """Write a message of a job: its ``folder``, or its ``complaint`` and a ``trace`` if it failed.

        Raises:
            VoccError: the message cannot be written.
        """
        word = json.dumps({"job": job, "elsewhere": self.elsewhere, **about})
        try:
            with self.mailbox.open("a", encoding="utf-8") as file:
                file.write(f"{word}\n")
        except OSError as error:
            said = about.get("complaint") or f"{self.mailbox}: {error.strerror}"
            raise VoccError(said) from None

    def told(self) -> list[dict[str, Any]]:
        """Return the messages of each job, by its number."""
        words: dict[int, dict[str, Any]] = {}
        for line in self.mailbox.read_text("utf-8").splitlines():
            word = json.loads(line)
            words.setdefault(word["job"], {}).update(word)
        return [words[job] for job in sorted(words)]

    def folders(self) -> list[Path]:
        """Give the folders of all jobs that have begun."""
        return [Path(word["folder"]) for word in self.told()]

    @property
    def parallel(self) -> bool:
        """Whether jobs have begun in other processes than the one that started them."""
        return any(word["elsewhere"] for word in self.told())

    def to_go_on(self) -> str | None:
        """Give the name under which jobs of other processes go on that had counted something, or None."""
        for folder in self.folders() if self.parallel else ():
            if any(folder.rglob("*.sqlite")):
                return os.path.relpath(folder.parent, "runs")
        return None


def begin_again(folder: Path) -> bool:
    """Take away what a failed attempt left in a job's folder.

    Outside ``runs/``, where hydra.run.dir may lead, nothing is taken away.

    Args:
        folder: the job's folder, which need not be there.

    Returns:
        Whether a failure may be written down here: not beside the results of others.

    Example:
        >>> begin_again(Path("no/such/folder"))
        True
    """
    names = {entry.name for entry in folder.iterdir()} if folder.is_dir() else set()
    names.discard(UNFINISHED)
    if not inside_runs(folder):
        return not names
    attempted = names <= {FAILED, CONFIG}
    resumable = "ledger.sqlite" in names
    if attempted:
        (folder / CONFIG).unlink(missing_ok=True)
    if attempted or resumable:
        (folder / FAILED).unlink(missing_ok=True)
    return attempted or (resumable and "ber.csv" not in names)


def write_down(folder: Path, complaint: str, trace: str, configuration: str) -> None:
    """Leave ``failed.txt`` in a job's folder, as far as that can be written.

    Args:
        folder: the job's folder.
        complaint: its first line.
        trace: the traceback of an error that is not the user's, else empty.
        configuration: the job's ``config.yaml``, where it came so far; an empty text is not written.
    """
    text = f"{complaint}\n" + (f"\n{trace}" if trace else "")
    with contextlib.suppress(VoccError):  # a full disk may be what the job failed of
        write_atomically(folder / FAILED, text.encode(errors="backslashreplace"))
        if configuration and not (folder / CONFIG).exists():
            write_atomically(folder / CONFIG, configuration.encode())


class JobLines(io.TextIOBase):
    r"""Output of a parallel job: whole lines, each after the job's number.

    It is no terminal, so that live views write plain lines to it. What is written in one piece stays in one
    piece.

    Args:
        under: where the lines go.
        prefix: what stands before each.

    Example:
        >>> lines = JobLines(sys.stdout, "job 3 | ")
        >>> _ = lines.write("two\nlines\nand a half")
        job 3 | two
        job 3 | lines
        >>> lines.close()
        job 3 | and a half
    """

    def __init__(self, under: TextIO, prefix: str) -> None:
        self._under, self._prefix, self._rest = under, prefix, ""

    @property
    def encoding(self) -> str:  # type: ignore[override]  # read-only, as io.TextIOWrapper has it
        """The encoding of what lies under it."""
        return self._under.encoding

    def write(self, text: str) -> int:
        """Pass on the lines that are whole."""
        *lines, self._rest = (self._rest + text).split("\n")
        if lines:
            self._under.write(
                "".join(f"{self._prefix}{line}".rstrip() + "\n" for line in lines)
            )
            self._under.flush()
        return len(text)

    def close(self) -> None:
        """Pass on what is left; nothing can be written afterwards."""
        if self._rest and not self.closed:
            self.write("\n")
        super().close()


def end_with(parent: int) -> None:
    """End this process once its parent is gone: a killed parent cannot tell its workers to end."""

    def wait() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def watch_joblib() -> None:
    """Have joblib's workers end with this process, also those that wait for a job."""
    with contextlib.suppress(ImportError):  # which Hydra says
        parallel: Any = importlib.import_module("joblib.parallel")

        watched = {"initializer": end_with, "initargs": (os.getpid(),)}
        loky = functools.partial(parallel.BACKENDS["loky"], **watched)
        parallel.register_parallel_backend("loky", loky)


@contextlib.contextmanager
def beside_others(job: int) -> Iterator[None]:
    """Set a worker process up for a job: number its lines of output, and ignore Ctrl-C.

    Ctrl-C reaches every process of the terminal. The process that started the jobs ends them.

    Args:
        job: the job's number.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    # The launcher leaves its own method here, which the processes that a job starts in turn do not know.
    multiprocessing.set_start_method("spawn", force=True)
    with (
        contextlib.closing(JobLines(sys.stdout, f"job {job} | ")) as lines,
        contextlib.redirect_stdout(lines),
    ):
        yield
