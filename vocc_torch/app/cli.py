"""The command line: one Hydra application, errors in one line, status 2 for a user's mistake."""

import contextlib
import functools
import gc
import io
import os
import re
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import hydra
from hydra._internal.utils import get_args_parser
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.types import Quote, QuotedString
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from vocc_torch.app.config import AppConfig, inside_runs, register
from vocc_torch.app.jobs import (
    JobState,
    Mailbox,
    begin_again,
    beside_others,
    watch_joblib,
    write_down,
)
from vocc_torch.app.resolve import ended_by, hydra_words, resolved
from vocc_torch.app.tasks import TASKS
from vocc_torch.errors import VoccError, printable, shown, stdout_refusal
from vocc_torch.files import UNFINISHED, locked, sweep, unfinished
from vocc_torch.measure.config import as_yaml
from vocc_torch.plugins import one_line

MULTIRUN = ("-m", "--multirun")
SWEEP = "multirun.yaml"  # Hydra writes it before the first job
OUT_OF_MEMORY = "not enough memory: give a smaller batch_frames, or a camera and distances that show smaller LEDs"


class ReaderGoneError(BaseException):
    """The output's reader is gone; Hydra passes this exception on silently."""


def complain(message: str) -> None:
    """Print a user's mistake in one line on standard error."""
    # On a full disk only the exit status can report it.
    with contextlib.suppress(OSError):
        # In one write, because several jobs may print at the same time.
        sys.stderr.write(
            f"vocc-torch: error: {printable(' '.join(message.splitlines()))}\n"
        )


@contextlib.contextmanager
def terminal_lines() -> Iterator[None]:
    """Print each warning once, in one line, and escape characters that the terminal cannot show."""

    @functools.cache
    def say(text: str) -> None:
        print("vocc-torch: warning:", text, file=sys.stderr)

    def show(message: Warning | str, *_: object, **__: object) -> None:
        say(printable(" ".join(str(message).split())))

    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    with warnings.catch_warnings():
        warnings.showwarning = show
        yield


@contextlib.contextmanager
def ctrl_c_first(heard: list[int]) -> Iterator[None]:
    """Raise Ctrl-C again where a library has made another error of it.

    Args:
        heard: takes the number of the signal.
    """

    def hear(number: int, _: object) -> None:
        heard.append(number)
        raise KeyboardInterrupt

    usual = signal.getsignal(signal.SIGINT)
    # A shell's background job hears nothing.
    listens = usual is signal.default_int_handler
    if listens:
        signal.signal(signal.SIGINT, hear)
    try:
        yield
    except Exception as error:
        if heard:
            raise KeyboardInterrupt from error
        raise
    finally:
        if listens:
            signal.signal(signal.SIGINT, usual)


def words_of(about: Any) -> list[str]:
    """Give a job's overrides as they were typed, from Hydra's own configuration of the job."""
    # What a word interpolates is not resolved here.
    typed: Any = OmegaConf.to_container(about.overrides.task, resolve=False)
    return [str(word).removeprefix("++") for word in typed]


def run_task(settings: AppConfig, folder: Path) -> None:
    """Run the task that the configuration names.

    Raises:
        VoccError: whatever the task refuses.
    """
    task = TASKS[settings.task]
    section = [] if task.part is None else [getattr(settings, task.part)]
    # Imported here and not above, so that --help and misspelled keys answer at once.
    from vocc_torch.report.folder import refuse_results

    run_it = resolve_name(f"vocc_torch.{task.run}")
    refuse_results(folder, task.resumed)
    collect_again()
    run_it(settings, *section, folder)


def collect_again() -> None:
    """Collect garbage from now on. The objects of loaded modules are left out: they stay."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()


def discard_if_empty(folder: Path) -> None:
    """Remove a run's folder that holds no result, and the folders up to ``runs`` that it leaves empty.

    One outside ``runs/``, where hydra.run.dir may lead, may have been there before and stays.
    """
    if not inside_runs(folder):
        return
    runs = Path.cwd() / "runs"
    for empty in (
        folder,
        *(parent for parent in folder.parents if parent.is_relative_to(runs)),
    ):
        # It holds something, or another run has begun in it.
        with contextlib.suppress(OSError, VoccError), locked(empty):
            marks = list(empty.iterdir())
            if [path.name for path in marks] in ([UNFINISHED], [SWEEP]):
                marks[0].unlink()
            empty.rmdir()


def complaint_of(error: Exception, folder: Path) -> str:
    """Say what ended a job, if it is the user's or the machine's; empty otherwise."""
    if isinstance(error, OSError):
        place = error.filename or folder
        return stdout_refusal(error) or f"{place}: {error.strerror or error}"
    if isinstance(error, UnicodeEncodeError):
        return f"{shown(error.object)} cannot be written as {error.encoding}: give the file another name"
    if isinstance(error, MemoryError) or (
        isinstance(error, RuntimeError) and "memory" in str(error)
    ):
        return OUT_OF_MEMORY
    return str(error) if isinstance(error, VoccError) else ""


def run_job(config: DictConfig, mailbox: Mailbox, heard: Sequence[int]) -> None:
    """Run one job; what ends it is a result too, because raising would end a multirun with it.

    Args:
        config: its configuration.
        mailbox: hears of it.
        heard: Ctrl-C.
    """
    about = HydraConfig.get()
    one_of_many, words = about.mode == RunMode.MULTIRUN, words_of(about)
    folder, said = Path(about.runtime.output_dir), " ".join(words)
    number = int(about.job.num) if one_of_many else 0
    job = JobState(number, folder, is_apart=os.getpid() != mailbox.parent)
    mailbox.put(job)
    trace, mine = "", False
    try:
        if one_of_many:
            print(said if job.is_apart else f"\njob {number}: {said}", flush=True)
        with locked(folder):
            if inside_runs(folder):
                sweep(folder.rglob(".*.tmp*"))
            mine = begin_again(folder) and one_of_many
            settings = resolved(config, words)
            if job.is_apart and settings.workers is None:
                settings.workers = 1  # the jobs share the cores
            with unfinished(folder, said):
                run_task(settings, folder)
        return
    except BrokenPipeError as error:
        raise ReaderGoneError from error
    except Exception as error:
        if heard:
            raise KeyboardInterrupt from error
        if not (complaint := complaint_of(error, folder)):
            trace, complaint = traceback.format_exc(), one_line(error)
            sys.stderr.write(trace)
    if mine:
        configuration = ""
        with contextlib.suppress(VoccError):  # it may be what failed
            configuration = as_yaml(resolved(config))
        write_down(folder, complaint, trace, configuration)
    mailbox.put(replace(job, complaint=complaint, trace=trace))
    first, *_ = (other for other in mailbox.jobs() if other.complaint == complaint)
    if first.number != number and not trace:
        print(f"failed for the reason of job {first.number}", flush=True)
    else:
        named = job.is_apart or (trace and one_of_many)
        complain(f"job {number}: {complaint}" if named else complaint)


def run_jobs(mailbox: Mailbox) -> int:
    """Run the application, all its jobs, and give its exit status.

    Returns:
        0 for well, 2 for a user's mistake, 1 for a fault that is not the user's, 130 for Ctrl-C.
    """

    @hydra.main(
        version_base="1.3", config_path="pkg://vocc_torch.conf", config_name="config"
    )
    def run_hydra(config: DictConfig) -> None:
        with contextlib.ExitStack() as stack:
            if os.getpid() != mailbox.parent:
                stack.enter_context(terminal_lines())
                stack.enter_context(beside_others(int(HydraConfig.get().job.num)))
            run_job(config, mailbox, heard)

    heard: list[int] = []
    try:
        with terminal_lines(), ctrl_c_first(heard):
            sys.argv[1:] = for_hydra(sys.argv[1:])
            run_hydra()
            sys.stdout.flush()
    except (BrokenPipeError, ReaderGoneError):
        return 1  # whoever read the output has gone, which is no mistake
    except KeyboardInterrupt:
        for job in mailbox.jobs():
            # A job of this process has said so itself.
            if job.is_apart and any(job.folder.rglob("*.sqlite")):
                name = os.path.relpath(job.folder.parent, "runs")
                print(f"interrupted: the same command with name={name} resumes")
                break
        print("vocc-torch: interrupted", file=sys.stderr)
        return 130
    except Exception as error:
        complaint = ended_by(error)
        if complaint is None:
            raise
        complain(complaint)
        return 2
    finally:
        jobs = mailbox.jobs()
        for job in jobs:
            discard_if_empty(job.folder)
    measured = [job.folder for job in jobs if (job.folder / "ber.csv").exists()]
    if len(measured) > 1:
        print(
            f"all jobs in one table: vocc-torch task=collect input={os.path.relpath(measured[0].parent)}"
        )
    failed = [job for job in jobs if job.complaint]
    is_fault = any(job.trace for job in failed)
    if (
        len({job.complaint for job in failed}) == 1 < len(failed) == len(jobs)
        and not is_fault
    ):
        # A mistake of the command, which no job's folder need tell of.
        for job in jobs:
            begin_again(job.folder)
            discard_if_empty(job.folder)
    elif any(job.is_apart for job in failed):
        numbers = ", ".join(str(job.number) for job in failed)
        complain(
            f"{len(failed)} of {len(jobs)} jobs failed ({numbers}): failed.txt in their folders says why"
        )
    return 1 if is_fault else 2 * bool(failed)


def for_hydra(arguments: Sequence[str]) -> list[str]:
    """Give a command line as Hydra takes it: flags first, since argparse takes keys on one side of them only."""
    read = get_args_parser().parse_intermixed_args(arguments)
    words, sweeps = read.overrides, read.multirun
    flags = [word for word in arguments if word not in words]
    named = hydra_words([with_quoted_input(word, sweeps) for word in words], sweeps)
    return [*flags, *named, *own_scenes(words)]


def with_quoted_input(word: str, sweeps: bool) -> str:
    """Quote the name of an input that Hydra's grammar would read as another thing than a name.

    Args:
        word: of the command line.
        sweeps: whether commas separate values; then only a name that exists is one.

    Example:
        >>> with_quoted_input("input=a=b, c.png", False), with_quoted_input("seed=1,2", True)
        ("input='a=b, c.png'", 'seed=1,2')
    """
    key, _, name = word.partition("=")
    if key != "input" or re.fullmatch(r"[\w./:@-]*", name, re.ASCII) or "${" in name:
        return word
    may_be_other = sweeps or name[0] == name[-1] in ("'", '"')
    if may_be_other and not os.path.exists(name):  # noqa: PTH110  # no name is too long for it
        return word
    return f"{key}={QuotedString(name, Quote.single).with_quotes()}"


def own_scenes(words: Sequence[str]) -> list[str]:
    """Give the search path for scenes that task=calibrate wrote into runs' folders, as a word of Hydra's.

    A run NAME keeps its scene as ``runs/NAME/scene/NAME.yaml``, so that ``scene=NAME`` is found there.
    """
    names = [
        name
        for word in words
        if word.startswith("scene=")
        for name in word.removeprefix("scene=").split(",")
        # No path, and nothing that is too long for one.
        if re.fullmatch(r"\w[\w.-]{0,99}", name)
        and Path("runs", name, "scene", f"{name}.yaml").is_file()
    ]
    if not names or any(word.startswith("hydra.searchpath=") for word in words):
        return []
    paths = (QuotedString(f"file://runs/{name}", Quote.single) for name in names)
    return [f"hydra.searchpath=[{','.join(path.with_quotes() for path in paths)}]"]


def run() -> int:
    """Run the application on the process's arguments and give its exit status."""
    if not {*MULTIRUN}.isdisjoint(sys.argv):
        watch_joblib()
    # Hydra prints errors over several lines and exits unless it is told to let them through.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    register()
    sweep(Path(tempfile.gettempdir()).glob(".vocc-torch.*"))
    ours = f".vocc-torch.{os.getpid()}.tmp."
    with tempfile.TemporaryDirectory(prefix=ours, ignore_cleanup_errors=True) as folder:
        mailbox = Mailbox(Path(folder, "jobs"), os.getpid())
        mailbox.file.touch()
        return run_jobs(mailbox)
