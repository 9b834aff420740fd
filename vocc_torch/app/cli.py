"""The command line: one Hydra application, errors in one line, status 2 for a user's mistake."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from importlib import import_module
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from yaml import MarkedYAMLError

from vocc_torch.app.complaints import one_line
from vocc_torch.app.config import TASKS, AppConfig, inside_runs, register_schema
from vocc_torch.app.jobs import Failure, Jobs, begin_again, beside_others, write_down
from vocc_torch.app.resolve import resolved
from vocc_torch.errors import VoccError
from vocc_torch.measure.config import as_yaml

GRID = "curve:run_grid"
"""What runs ``task=test`` where the experiment has rows."""

MULTIRUN = ("-m", "--multirun")
OUT_OF_MEMORY = (
    "not enough memory: give a smaller batch_frames, or a camera and distances that show smaller LEDs"
)

LOST_WORKER = (
    "a worker process was ended from outside, perhaps for lack of memory: the jobs that had ended keep their "
    "results; run the others with a smaller hydra.launcher.n_jobs or batch_frames"
)


def complain(message: str) -> None:
    """Print a user's mistake."""
    # In one piece, for jobs that complain at the same time.
    sys.stderr.write(f"vocc-torch: error: {' '.join(message.splitlines())}\n")


@contextlib.contextmanager
def one_line_warnings() -> Iterator[None]:
    """Print each warning in one line, once."""
    said: set[str] = set()

    def show(message: Warning | str, *_: object, **__: object) -> None:
        text = " ".join(str(message).split())
        if text not in said:
            print("vocc-torch: warning:", text, file=sys.stderr)
        said.add(text)

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield


def run_task(settings: AppConfig, folder: Path) -> None:
    """Run the task that the configuration names.

    Raises:
        VoccError: whatever the task refuses.
    """
    place, part = TASKS[settings.task]
    if settings.task == "test" and settings.experiment.row_axis is not None:
        place = GRID
    module, name = place.split(":")
    # torch is imported here and not above, so that --help and misspelled keys answer at once.
    run_it = getattr(import_module(f"vocc_torch.studies.{module}"), name)
    run_it(settings, *([] if part is None else [getattr(settings, part)]), folder)


def _discard_if_empty(folder: Path) -> None:
    """Remove a run's folder that holds nothing, and the folders up to ``runs`` that it leaves empty.

    One outside ``runs/``, where hydra.run.dir may lead, may have been there before and stays.
    """
    if not inside_runs(folder):
        return
    runs = Path.cwd() / "runs"
    for empty in (folder, *(parent for parent in folder.parents if parent.is_relative_to(runs))):
        with contextlib.suppress(OSError):  # it holds something
            empty.rmdir()


def _complaint(config: DictConfig, folder: Path) -> str | None:
    """Run one job and give the complaint that ended it."""
    try:
        run_task(resolved(config, HydraConfig.get().overrides.task), folder)
    except BrokenPipeError:
        raise
    except VoccError as error:
        return str(error)
    except OSError as error:
        return f"{error.filename or folder}: {error.strerror or error}"
    except (MemoryError, RuntimeError) as error:
        if not isinstance(error, MemoryError) and "memory" not in str(error):
            raise
        return OUT_OF_MEMORY
    return None


def _run_one_of_many(config: DictConfig, jobs: Jobs) -> None:
    """Run one job of a multirun; what ends it is a result too, and the other jobs are run.

    Raising would end the multirun after this batch of jobs.
    """
    hydra_config = HydraConfig.get()
    number, folder = int(hydra_config.job.num), Path(hydra_config.runtime.output_dir)
    jobs.begun(number, folder)
    heading = " ".join(hydra_config.overrides.task)
    print(heading if jobs.elsewhere else f"\njob {number}: {heading}", flush=True)
    trace, mine = "", begin_again(folder)
    try:
        complaint = _complaint(config, folder)
    except BrokenPipeError:
        raise
    except Exception as error:
        trace = traceback.format_exc()
        complaint = " ".join(f"{type(error).__name__}: {error}".split())
        sys.stderr.write(trace)
    if complaint is None:
        return
    complain(f"job {number}: {complaint}" if jobs.elsewhere or trace else complaint)
    failure = Failure(number, complaint, trace)
    if mine:
        configuration = ""
        with contextlib.suppress(VoccError):  # it may be what failed
            configuration = as_yaml(resolved(config))
        write_down(failure, folder, configuration)
    jobs.failed(failure)


def _refusal(error: Exception) -> str | None:
    """Say what Hydra refused before or between the jobs; None for an error that is not the user's."""
    if isinstance(error, BrokenProcessPool):
        return LOST_WORKER
    if isinstance(error, multiprocessing.TimeoutError):
        return "hydra.launcher.timeout is shorter than a job: give more seconds, or null"
    if isinstance(error, MarkedYAMLError):
        mark = error.problem_mark
        return f"{mark.name} is not YAML at line {mark.line + 1}: {error.problem}" if mark else str(error)
    # Hydra trips over a group whose option is a list of numbers, and over a number that no float holds.
    if isinstance(error, HydraException | OmegaConfBaseException | ValueError | TypeError | OverflowError):
        return one_line(error, sys.argv[1:])
    if isinstance(error, OSError):
        where = f" {error.filename}" if error.filename else ""
        return f"cannot make the run's folder{where} ({error.strerror}): choose another with name="
    return None


def _status(jobs: Jobs) -> int:
    """Sum up how the jobs ended: 0 for well, 2 for a user's mistake, 1 for a fault that is not the user's."""
    failures, count = jobs.failures(), len(jobs.folders())
    if failures and jobs.parallel:
        numbers = ", ".join(str(failure.job) for failure in failures)
        complain(f"{len(failures)} of {count} jobs failed ({numbers}): failed.txt in their folders says why")
    if any(failure.trace for failure in failures):
        return 1
    return 2 if failures else 0


def _run_jobs(jobs: Jobs) -> int:
    """Run the application, all its jobs, and give its exit status."""
    unforeseen: list[Exception] = []

    @hydra.main(version_base="1.3", config_path="pkg://vocc_torch.conf", config_name="config")
    def job(config: DictConfig) -> None:
        if HydraConfig.get().mode != RunMode.MULTIRUN:
            folder = Path(HydraConfig.get().runtime.output_dir)
            try:
                begin_again(folder)
                complaint = _complaint(config, folder)
            except Exception as error:
                unforeseen.append(error)
                raise
            finally:
                _discard_if_empty(folder)
            if complaint is not None:
                complain(complaint)
                jobs.failed(Failure(0, complaint))
        elif jobs.elsewhere:
            with beside_others(int(HydraConfig.get().job.num)), one_line_warnings():
                _run_one_of_many(config, jobs)
        else:
            _run_one_of_many(config, jobs)

    try:
        with one_line_warnings():
            job()
        return _status(jobs)
    except BrokenPipeError:
        # Whoever read the output has gone, which is no mistake; nothing is flushed to them at the end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except KeyboardInterrupt:
        if (name := jobs.to_go_on()) is not None:
            print(f"interrupted: the same command with name={name} goes on from there")
        print("vocc-torch: interrupted", file=sys.stderr)
        return 130
    except Exception as error:
        complaint = None if error in unforeseen else _refusal(error)
        if complaint is None:
            raise
        complain(complaint)
        return 2
    finally:
        for folder in jobs.folders():
            _discard_if_empty(folder)


def run() -> int:
    """Run the application on the process's arguments and give its exit status."""
    # argparse takes keys on one side of a flag only, and users write them on both.
    sys.argv[1:] = sorted(sys.argv[1:], key=lambda word: word not in MULTIRUN)
    # Hydra prints errors over several lines and exits unless it is told to let them through.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    register_schema()
    with tempfile.TemporaryDirectory(prefix="vocc-torch-", ignore_cleanup_errors=True) as mailbox:
        return _run_jobs(Jobs(Path(mailbox), os.getpid()))


def main() -> None:
    """Entry point of ``vocc-torch`` and of ``python -m vocc_torch``."""
    sys.exit(run())
