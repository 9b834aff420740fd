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
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any, TextIO

from vocc_torch.app.config import inside_runs
from vocc_torch.errors import VoccError
from vocc_torch.files import UNFINISHED, write_atomically

FAILED, CONFIG = "failed.txt", "config.yaml"


@dataclass(frozen=True)
class JobState:
    """What is known of a job of a command.

    Args:
        number: its place in a multirun; 0 for a single run.
        folder: of its run.
        is_apart: whether it runs in another process than the one that started the jobs.
        complaint: why it failed, else empty.
        trace: the traceback of an error that is not the user's, else empty.
    """

    number: int
    folder: Path
    is_apart: bool = False
    complaint: str = ""
    trace: str = ""


@dataclass(frozen=True)
class Mailbox:
    """What the jobs of one command say to the process that started them, through a file.

    A job may run in a worker process, which cannot change this object in the parent. The object is small and
    can be pickled.

    Args:
        file: an empty file that lasts as long as the command.
        parent: number of the process that started the jobs.

    Example:
        >>> import tempfile
        >>> with tempfile.NamedTemporaryFile() as file:
        ...     mailbox = Mailbox(Path(file.name), os.getpid())
        ...     mailbox.put(JobState(3, Path("runs/two/3")))
        ...     mailbox.put(JobState(3, Path("runs/two/3"), complaint="panel.rows is 0: it must be at least 1"))
        ...     [job.complaint for job in mailbox.jobs()]
        ['panel.rows is 0: it must be at least 1']
    """

    file: Path
    parent: int

    def put(self, job: JobState) -> None:
        """Write down what is known of a job.

        Raises:
            VoccError: it cannot be written.
        """
        line = json.dumps(astuple(job), default=str)
        try:
            with self.file.open("a", encoding="utf-8") as file:
                file.write(f"{line}\n")
        except OSError as error:
            reason = job.complaint or f"{self.file}: {error.strerror}"
            raise VoccError(reason) from None

    def jobs(self) -> list[JobState]:
        """Give the jobs that have begun, by number, as they were last written down."""
        jobs: dict[int, JobState] = {}
        for line in self.file.read_text("utf-8").splitlines():
            number, folder, *about = json.loads(line)
            jobs[number] = JobState(number, Path(folder), *about)
        return [jobs[number] for number in sorted(jobs)]


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
    names = {path.name for path in folder.glob("*")} - {UNFINISHED}
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
