"""The whole configuration: what all studies share, and a section for each study that has one."""

from __future__ import annotations

from dataclasses import dataclass, field

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
