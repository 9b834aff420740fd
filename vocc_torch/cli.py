"""The command line: one Hydra application, errors in one line, status 2 for a user's mistake."""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from vocc_torch.complaints import checked, one_line
from vocc_torch.config import AppConfig, register_schema, resolved
from vocc_torch.errors import VoccError

TASKS = ("train", "test", "decode")
MULTIRUN = ("-m", "--multirun")
OUT_OF_MEMORY = (
    "not enough memory: give a smaller batch_frames, or a camera and distances that show smaller LEDs"
)


def complain(message: str) -> None:
    """Print a user's mistake."""
    print("vocc-torch: error:", " ".join(message.splitlines()), file=sys.stderr)


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
        VoccError: an unknown task, or whatever the task refuses.
    """
    if settings.task not in TASKS:
        raise VoccError(f"task is {settings.task!r}: it must be one of {', '.join(TASKS)}")
    # torch is imported here and not above, so that --help and misspelled keys answer at once.
    from vocc_torch import tasks

    {"train": tasks.run_train, "test": tasks.run_test, "decode": tasks.run_decode}[settings.task](
        settings, folder
    )


def _discard_if_empty(folder: Path) -> None:
    """Remove a run's folder that holds nothing, and the folders up to ``runs`` that it leaves empty."""
    runs = Path.cwd() / "runs"
    for empty in (folder, *(parent for parent in folder.parents if parent.is_relative_to(runs)), runs):
        with contextlib.suppress(OSError):  # it holds something
            empty.rmdir()


def _run_job(config: DictConfig) -> str | None:
    """Run one job and give the complaint that ended it.

    Raising would end a multirun; this way the other jobs are run, and the exit status tells of this one.
    """
    hydra_config = HydraConfig.get()
    folder = Path(hydra_config.runtime.output_dir)
    if hydra_config.mode == RunMode.MULTIRUN:
        print(f"\njob {hydra_config.job.num}: {' '.join(hydra_config.overrides.task)}", flush=True)
    try:
        run_task(checked(resolved(config)), folder)
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
    finally:
        _discard_if_empty(folder)
    return None


def _refusal(error: Exception) -> str | None:
    """Say what Hydra refused before or between the jobs; None for an error that is not the user's."""
    if isinstance(error, HydraException | OmegaConfBaseException | ValueError):
        return one_line(error, sys.argv[1:])
    if isinstance(error, OSError):
        where = f" {error.filename}" if error.filename else ""
        return f"cannot make the run's folder{where} ({error.strerror}): choose another with name="
    return None


def run() -> int:
    """Run the application on the process's arguments and give its exit status."""
    failures: list[str] = []
    unforeseen: list[Exception] = []

    @hydra.main(version_base="1.3", config_path="conf", config_name="config")
    def job(config: DictConfig) -> None:
        try:
            complaint = _run_job(config)
        except Exception as error:
            unforeseen.append(error)
            raise
        if complaint is not None:
            failures.append(complaint)
            complain(complaint)

    # argparse takes keys on one side of a flag only, and users write them on both.
    sys.argv[1:] = sorted(sys.argv[1:], key=lambda word: word not in MULTIRUN)
    # Hydra prints errors over several lines and exits unless it is told to let them through.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    register_schema()
    try:
        with one_line_warnings():
            job()
    except BrokenPipeError:
        # Whoever read the output has gone, which is no mistake; nothing is flushed to them at the end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except KeyboardInterrupt:
        print("vocc-torch: interrupted", file=sys.stderr)
        return 130
    except Exception as error:
        complaint = None if error in unforeseen else _refusal(error)
        if complaint is None:
            raise
        complain(complaint)
        return 2
    return 2 if failures else 0


def main() -> None:
    """Entry point of ``vocc-torch`` and of ``python -m vocc_torch``."""
    sys.exit(run())
