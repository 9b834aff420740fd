"""The whole configuration: what all studies share, and a section for each study that has one."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, fields
from pathlib import Path

from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from vocc_torch.errors import VoccError
from vocc_torch.measure.config import Settings
from vocc_torch.studies.classifiers.config import RivalsConfig
from vocc_torch.studies.decode.config import DecodeConfig
from vocc_torch.studies.effects.config import EffectsConfig
from vocc_torch.studies.paper.config import FiguresConfig
from vocc_torch.studies.tradeoff.config import TradeoffConfig


@dataclass
class AppConfig(Settings):
    """The whole configuration."""

    decode: DecodeConfig = field(default_factory=DecodeConfig)
    figures: FiguresConfig = field(default_factory=FiguresConfig)
    effects: EffectsConfig = field(default_factory=EffectsConfig)
    tradeoff: TradeoffConfig = field(default_factory=TradeoffConfig)
    rivals: RivalsConfig = field(default_factory=RivalsConfig)


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
        raise VoccError(f"name is {name!r}: it must be a folder below runs/, without .. or links out")
    return str("runs" / path)


def job_folder(name: str, job: int) -> str:
    """Give the folder of a multirun's job in that of its run, or refuse one that is a link out of it."""
    run_folder(f"{name}/{job}")
    return str(job)


# Here, because worker processes of a multirun import this and do not register the schema.
OmegaConf.register_new_resolver("run_folder", run_folder, replace=True)
OmegaConf.register_new_resolver("job_folder", job_folder, replace=True)


def is_written_configuration(path: Path) -> bool:
    """Whether a file has all keys of a ``config.yaml`` that a run wrote; one that is not there has none."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return False
    return {line.partition(":")[0] for line in lines} >= {key.name for key in fields(AppConfig)}


def register_schema() -> None:
    """Make the schema known to Hydra; calling it again changes nothing."""
    ConfigStore.instance().store(name="schema", node=AppConfig)


def resolved(config: DictConfig) -> AppConfig:
    """Turn Hydra's object into plain dataclasses, with every interpolation resolved and type checked.

    Raises:
        VoccError: a value that is missing or does not resolve.
    """
    try:
        settings = OmegaConf.to_object(config)
    except MissingMandatoryValue as error:
        raise VoccError(f"{error.full_key} is missing: it must have a value") from None
    except OmegaConfBaseException as error:
        said, _, place = " ".join(str(error).split()).partition(" full_key: ")
        key = place.split(" ")[0]
        raise VoccError(f"{key} cannot be resolved: {said}" if key else said) from None
    if not isinstance(settings, AppConfig):
        raise VoccError(
            "the configuration does not follow the schema: keep `schema` first in conf/config.yaml"
        )
    return settings
