"""From what Hydra composed to the settings: resolved, typed, checked, and nothing passed over in silence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import is_dataclass
from functools import reduce
from typing import Any, get_args, get_origin

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from vocc_torch.app.complaints import GROUPS, one_line
from vocc_torch.app.config import TASKS, AppConfig, keys_of, schema
from vocc_torch.errors import VoccError, section, shown

OWNERS = {part: task for task, (_, part) in TASKS.items() if part is not None}
"""The task of each section."""

OF_MODEL = ("receiver", "panel", "classifier", "classifiers")
"""What a model brings itself, but for the panel's rows and columns, which must agree."""


def resolved(config: DictConfig, words: Sequence[str] = ()) -> AppConfig:
    """Turn Hydra's object into the settings, with every interpolation resolved and everything checked.

    Args:
        config: what Hydra composed.
        words: the overrides of the command line, none of which may be without effect.

    Raises:
        VoccError: a value that is missing, does not resolve, is of another type or breaks a rule.
    """
    try:
        plain = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
        _demand_kinds(plain)
        typed = OmegaConf.merge(schema(), plain)  # what interpolations brought has a type too
        for place in ("rivals.experiments", "figures.experiments"):
            for name, one in OmegaConf.select(typed, place).items():
                with section(f"{place}.{name}", before="experiment"):
                    OmegaConf.to_object(one)
        with section("receiver.location", before="location"):
            settings = OmegaConf.to_object(typed)
    except MissingMandatoryValue as error:
        raise VoccError(f"{error.full_key} is missing: it must have a value") from None
    except OmegaConfBaseException as error:
        raise VoccError(one_line(error)) from None
    assert isinstance(settings, AppConfig)
    refuse_ignored(settings, words)
    return settings


def _demand_kinds(plain: Any) -> None:
    """Refuse a section that is none and a list that is none, which only an interpolation can bring."""
    for key, kind in keys_of(AppConfig).items():
        value = reduce(lambda held, name: held.get(name), key.split("."), plain)
        if (is_dataclass(kind) or get_origin(kind) is dict) and not isinstance(value, dict):
            raise VoccError.of(key, shown(value), "a mapping, as in {key:value}")
        if get_origin(kind) in (list, tuple) and not isinstance(value, list):
            texts = get_args(kind)[0] is str
            rule = "a list of texts, as in [a,b]" if texts else "a list of numbers, as in [1,2]"
            raise VoccError.of(key, shown(value), rule)


def refuse_ignored(settings: AppConfig, words: Sequence[str]) -> None:
    """Refuse what a command line asks for and would not get.

    Args:
        settings: the configuration that came of it.
        words: its overrides.

    Raises:
        VoccError: a setting of the camera that the scene makes itself, effects set to none, several options
            of one group, which would be mixed, a section of another task, or what a model brings itself.

    Example:
        >>> from vocc_torch.measure.config import Experiment
        >>> experiment = Experiment("d", "distance_m", (50.0,))
        >>> settings = AppConfig(task="test", name="x", experiment=experiment)
        >>> refuse_ignored(settings, ["scene.effects={}"])
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: scene.effects={} takes none away: write ~scene.effects.NAME for each
    """
    for word in words:
        key, _, value = word.lstrip("+~").partition("=")
        group, _, name = key.partition(".")
        if group == "camera" and getattr(settings.scene.camera, name, None) is not None:
            raise VoccError(f"{key} is set by the scene {settings.scene.name}: give scene.{key}={value}")
        if key == "scene.effects" and value == "{}":
            raise VoccError("scene.effects={} takes none away: write ~scene.effects.NAME for each")
        if key in GROUPS and value.startswith("["):
            raise VoccError(f"{key} is {value}: it must be one option, several in a multirun (-m {key}=a,b)")
        if (owner := OWNERS.get(group, settings.task)) != settings.task:
            raise VoccError(f"{key} is {value}: only task={owner} uses it, and the task is {settings.task}")
        if settings.model is not None and group in OF_MODEL and name not in ("rows", "columns"):
            raise VoccError(f"{key} is {value}: the model brings its own; leave {key} or model out")
