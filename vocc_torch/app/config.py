"""The whole configuration: what all studies share, the sections of studies, and the run's folder."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, fields
from pathlib import Path

from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf

from vocc_torch.app.help import described
from vocc_torch.errors import VoccError
from vocc_torch.measure.config import Settings
from vocc_torch.studies.classifiers.config import RivalsConfig
from vocc_torch.studies.decode.config import DecodeConfig
from vocc_torch.studies.effects.config import EffectsConfig
from vocc_torch.studies.paper.config import FiguresConfig
from vocc_torch.studies.tradeoff.config import TradeoffConfig

TASKS = {
    "train": ("training.run:run_train", None),
    "test": ("curve.run:run_test", None),
    "decode": ("decode.run:run_decode", "decode"),
    "figures": ("paper.run:run_figures", "figures"),
    "effects": ("effects.run:run_effects_task", "effects"),
    "tradeoff": ("tradeoff.run:run_tradeoff", "tradeoff"),
    "classifiers": ("classifiers.run:run_classifiers", "rivals"),
    "collect": ("collect.run:run_collect", None),
}
"""What runs each task, below ``vocc_torch.studies``, and the section that is its own."""


@dataclass
class AppConfig(Settings):
    """The whole configuration.

    Args:
        decode: what task=decode writes besides the bits.
        figures: what task=figures makes.
        effects: what task=effects looks at.
        tradeoff: what task=tradeoff prices.
        rivals: what task=classifiers compares.
    """

    decode: DecodeConfig = field(default_factory=DecodeConfig)
    figures: FiguresConfig = field(default_factory=FiguresConfig)
    effects: EffectsConfig = field(default_factory=EffectsConfig)
    tradeoff: TradeoffConfig = field(default_factory=TradeoffConfig)
    rivals: RivalsConfig = field(default_factory=RivalsConfig)

    def __post_init__(self) -> None:
        """Check what no section can check alone."""
        super().__post_init__()
        run_folder(self.name)
        if self.task not in TASKS:
            raise VoccError.of("task", repr(self.task), f"one of {', '.join(TASKS)}")
        if (self.task, self.model, self.receiver.locator) == ("decode", None, "truth"):
            rule = "paper or refined for task=decode: a recording does not tell its corners"
            raise VoccError.of("receiver.locator", "'truth'", rule)


def inside_runs(folder: str | Path) -> bool:
    """Whether a folder is below ``runs/``, where links have led too; ``runs`` itself may be a link.

    Example:
        >>> inside_runs("runs/a"), inside_runs("runs"), inside_runs("runs/../a")
        (True, False, False)
    """
    # Path.resolve raises for links in a circle.
    return Path(os.path.realpath("runs")) in Path(os.path.realpath(folder)).parents


def run_folder(name: str) -> str:
    """Give the folder of a run, in which Hydra makes it, or refuse one that is not below ``runs/``.

    Raises:
        VoccError: the name leads out of ``runs/``, by itself or through a link.

    Example:
        >>> run_folder("two/words")
        'runs/two/words'
    """
    path = Path(name)
    if not path.parts or ".." in path.parts or not inside_runs("runs" / path):
        raise VoccError.of("name", repr(name), "a folder below runs/, without .. or links out")
    return str("runs" / path)


def job_folder(name: str, job: int) -> str:
    """Give the folder of a multirun's job in that of its run, or refuse one that is a link out of it."""
    run_folder(f"{name}/{job}")
    return str(job)


# Here, because worker processes of a multirun import this and do not register the schema.
OmegaConf.register_new_resolver("run_folder", run_folder, replace=True)
OmegaConf.register_new_resolver("job_folder", job_folder, replace=True)
OmegaConf.register_new_resolver("described", lambda _root_: described(_root_, AppConfig), replace=True)


def is_written_configuration(path: Path) -> bool:
    """Whether a file has all keys of a ``config.yaml`` that a run wrote; one that is not there has none."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return False
    return {line.partition(":")[0] for line in lines} >= {key.name for key in fields(AppConfig)}


def schema() -> DictConfig:
    """Make the schema; its sections take values although some are built as frozen dataclasses."""
    made: DictConfig = OmegaConf.structured(AppConfig)
    for frozen in (made.camera, made.receiver.location):
        OmegaConf.set_readonly(frozen, None)
    return made


def register_schema() -> None:
    """Make the schema known to Hydra; calling it again changes nothing."""
    ConfigStore.instance().store(name="schema", node=schema())
