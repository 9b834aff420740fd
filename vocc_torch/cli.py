"""The command line: one Hydra application, errors in one line, status 2 for a user's mistake."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from vocc_torch.complaints import one_line
from vocc_torch.config import AppConfig, register_schema, resolved
from vocc_torch.errors import VoccError

TASKS = ("train", "test", "decode")


def complain(message: str) -> None:
    """Print a user's mistake."""
    print(f"vocc-torch: error: {message}", file=sys.stderr)


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
    """Remove a run's folder that holds only Hydra's own notes, and the folders above that it leaves empty."""
    if not folder.is_dir() or any(entry.name != ".hydra" for entry in folder.iterdir()):
        return
    shutil.rmtree(folder, ignore_errors=True)
    for parent in list(folder.parents)[:3]:
        if parent.name == "runs" or not parent.is_dir() or any(parent.iterdir()):
            return
        parent.rmdir()


def run() -> int:
    """Run the application on the process's arguments and give its exit status."""
    failures: list[str] = []

    @hydra.main(version_base="1.3", config_path="conf", config_name="config")
    def job(config: DictConfig) -> None:
        folder = Path(HydraConfig.get().runtime.output_dir)
        try:
            run_task(resolved(config), folder)
        except VoccError as error:
            # Raising would end a multirun; the other jobs are run, and the status tells of this one.
            failures.append(str(error))
            complain(str(error))
            _discard_if_empty(folder)

    # Hydra prints errors over several lines and exits unless it is told to let them through.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    register_schema()
    try:
        job()
    except (HydraException, OmegaConfBaseException) as error:
        failures.append(one_line(error))
        complain(failures[-1])
    except OSError as error:
        where = f" {error.filename}" if error.filename else ""
        failures.append(f"cannot write the run's folder{where} ({error.strerror}): choose another with name=")
        complain(failures[-1])
    except KeyboardInterrupt:
        print("vocc-torch: interrupted", file=sys.stderr)
        return 130
    return 2 if failures else 0


def main() -> None:
    """Entry point of ``vocc-torch`` and of ``python -m vocc_torch``."""
    sys.exit(run())
