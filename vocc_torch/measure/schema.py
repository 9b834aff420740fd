"""From plain values and words of the command line to typed settings; refusals are one line with the key."""

import difflib
import typing
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import resources
from pathlib import PurePath
from types import NoneType
from typing import TYPE_CHECKING, Any, cast, get_origin

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    ConfigTypeError,
    InterpolationResolutionError,
    MissingMandatoryValue,
    OmegaConfBaseException,
)

from vocc_torch.boundary import WORDS, allowed
from vocc_torch.errors import VoccError, shown

if TYPE_CHECKING:
    from vocc_torch.measure.config import SceneSettings


MOST_BRACKETS = 64
"""Most brackets of a kind in a word: the parser calls itself for each."""

KINDS = {
    **WORDS,
    float: "a number",
    list: "a list, as in [a,b]",
    tuple: "a list, as in [a,b]",
    dict: "a mapping, as in {key:value}",
    NoneType: "null",
}
"""What a value must be, by its type."""


def options_of(group: str) -> list[str]:
    """List the options of a group of the configuration that ship.

    Example:
        >>> options_of("panel")
        ['paper']
    """
    folder = resources.files("vocc_torch.conf").joinpath(group)
    files = folder.iterdir() if folder.is_dir() else ()
    paths = [PurePath(entry.name) for entry in files]
    return sorted(path.stem for path in paths if path.suffix == ".yaml")


@cache
def keys_of(schema: type, prefix: str = "") -> dict[str, Any]:
    """List every key of a schema, with dots, and its type.

    Example:
        >>> from vocc_torch.measure.config import Settings
        >>> keys_of(Settings)["camera.gamma"]
        <class 'float'>
    """
    keys: dict[str, Any] = {}
    hints = typing.get_type_hints(schema)
    for item in fields(schema):
        kind = keys[prefix + item.name] = hints[item.name]
        if isinstance(kind, type) and is_dataclass(kind):
            keys |= keys_of(kind, f"{prefix}{item.name}.")
    return keys


def has_key(schema: type, key: str) -> bool:
    """Whether a schema has a key or section; below a mapping every key is possible.

    Example:
        >>> from vocc_torch.measure.config import Settings
        >>> has_key(Settings, "locators.mine._target_"), has_key(Settings, "panel.row")
        (True, False)
    """
    keys = keys_of(schema)
    parent = key
    while parent not in keys and "." in parent:
        parent = parent.rpartition(".")[0]
    return key in keys or get_origin(keys.get(parent)) is dict


RENAMED = {"rivals": "comparison"}
"""Sections by an earlier name."""


def unknown_key(key: str, keys: Mapping[str, Any]) -> str:
    """Return the refusal of an unknown key, with the nearest known key.

    Example:
        >>> from vocc_torch.measure.config import WorldSettings
        >>> unknown_key("camera.gama", keys_of(WorldSettings))
        'camera.gama is not a known key: did you mean camera.gamma?'
        >>> unknown_key("rows", keys_of(WorldSettings))
        'rows is not a known key: did you mean panel.rows?'
    """
    mappings = [name for name, kind in keys.items() if get_origin(kind) is dict]
    parent = next((name for name in mappings if key.startswith(f"{name}.")), None)
    if parent is not None:
        return f"{key} is not set here: + adds to {parent}, as in +{key}=..."
    section, point, name = key.partition(".")
    if section in RENAMED:
        return f"{key} is not a known key: it is {RENAMED[section]}{point}{name} now"
    last = key.rpartition(".")[2]
    same = [known for known in keys if known.rpartition(".")[2] == last]
    # A slip of a letter, the same name in another section, or what is spelled alike.
    tries = (keys, 0.9), (same, 0.0), (keys, 0.6)
    near = [
        one
        for names, least in tries
        for one in difflib.get_close_matches(key, names, 1, least)
    ]
    hint = f"did you mean {near[0]}?" if near else "vocc-torch --help lists the keys"
    return f"{key} is not a known key: {hint}"


def refusal(error: OmegaConfBaseException, keys: Mapping[str, Any]) -> str:
    """Say in one line what OmegaConf refused.

    Args:
        error: with the key and the value.
        keys: with their types.
    """
    key = error.full_key or str(error.key or "")
    if isinstance(error, MissingMandatoryValue):
        return f"{key} is missing: it must have a value"
    if isinstance(error, ConfigKeyError | ConfigAttributeError):
        return unknown_key(key, keys)
    if isinstance(error, ConfigTypeError):
        return (
            f"{key} has a mapping where a list belongs, or a list where a mapping does"
        )
    kind = keys.get(key.partition("[")[0])
    if kind is None or isinstance(error, InterpolationResolutionError):
        return f"{key}: {' '.join(str(error.msg or error).split())}"
    value = "null" if error.value is None else shown(error.value)
    return f"{key} is {value}: it must be {rule_of(kind)}"


@cache
def empty(schema: type) -> DictConfig:
    """Give a schema as an OmegaConf object with its defaults; copy it before values are merged in."""
    config: DictConfig = OmegaConf.structured(schema)
    OmegaConf.set_readonly(config, None)
    for key, kind in keys_of(schema).items():
        section = OmegaConf.select(config, key) if is_dataclass(kind) else None
        # Frozen dataclasses take values too; a missing section has none.
        if section is not None:
            OmegaConf.set_readonly(section, None)
    return config


def typed(schema: type, *plain: Any, words: Sequence[str] = ()) -> Any:
    """Build settings from plain values.

    Args:
        schema: the dataclass.
        plain: mappings, of which later ones change what earlier ones say.
        words: ``key=value``, ``+key=value`` and ``~key``, in the grammar of the command line.

    Returns:
        An object of the schema.

    Raises:
        VoccError: an unknown key, a value of another type, or one that the dataclass refuses.

    Example:
        >>> from vocc_torch.hardware import Camera
        >>> typed(Camera, {"gamma": 2}, words=["f_number=1.8"]).f_number
        1.8
    """
    with refusals(keys_of(schema)):
        config = merge(schema, *plain)
        for word, override in zip(words, parsed(words), strict=True):
            demand_shape(override, keys_of(schema))
            try:
                _apply(config, override, word)
            except (ConfigKeyError, ConfigAttributeError):
                unknown = unknown_key(override.key_or_group, keys_of(schema))
                raise VoccError(unknown) from None
        return OmegaConf.to_object(config)


@contextmanager
def refusals(keys: Mapping[str, Any]) -> Iterator[None]:
    """Say in one line what OmegaConf refuses in a block."""
    try:
        yield
    except OmegaConfBaseException as error:
        raise VoccError(refusal(error, keys)) from None


def merge(schema: type, *plain: Any) -> DictConfig:
    """Merge plain values into a schema.

    Raises:
        VoccError: an unknown key, or a value of another type.
    """
    for values in plain:
        demand_shapes(values, keys_of(schema))
    with refusals(keys_of(schema)):
        config: Any = OmegaConf.merge(empty(schema), *plain)
        OmegaConf.set_struct(config, True)
        return cast(DictConfig, config)


def demand_shapes(plain: Any, keys: Mapping[str, Any], section: str = "") -> None:
    """Refuse another value than a mapping for a section, and a mapping for a key that is none.

    Args:
        plain: the values of a section.
        keys: with their types.
        section: where the values are, with a point at its end.

    Raises:
        VoccError: with the key and what it must be.
    """
    for name, value in plain.items():
        kind = keys.get(key := f"{section}{name}")
        nested = get_origin(kind) is dict or is_dataclass(kind)
        if kind is not None and isinstance(value, Mapping) != nested:
            raise VoccError.of(key, shown(value), rule_of(kind))
        if nested:
            demand_shapes(value, keys, f"{key}.")


def demand_shape(override: Override, keys: Mapping[str, Any]) -> None:
    """Refuse a word as :func:`demand_shapes` refuses plain values."""
    if isinstance(value := override.value(), dict | list):
        demand_shapes({override.key_or_group: value}, keys)


def rule_of(kind: Any) -> str:
    """Say what a key of a type must be."""
    return KINDS[dict] if is_dataclass(kind) else allowed(kind, KINDS)


def parsed(words: Sequence[str]) -> list[Override]:
    """Parse words as Hydra does.

    Raises:
        VoccError: a word that is none of its grammar.
    """
    found = []
    for word in words:
        try:
            if max(map(word.count, "[{")) > MOST_BRACKETS:
                raise RecursionError
            found += OverridesParser.create().parse_overrides([word])
        except (HydraException, RecursionError, ValueError):
            key, is_set, value = " ".join(str(word).split()).partition("=")
            text = key.lstrip("+") + is_set + shown(value)[1:-1]
            raise VoccError(
                f"{text} cannot be read: write key=value, a list as [a,b], and quote what is special"
            ) from None
    return found


def _apply(config: Any, override: Override, word: str) -> None:
    """Change a configuration by one word."""
    key = override.key_or_group
    if override.is_sweep_override():
        raise VoccError(f"{key} is {word.partition('=')[2]}: it must be one value")
    if override.is_delete():
        parent, _, name = key.rpartition(".")
        section = OmegaConf.select(config, parent) if parent else config
        if not isinstance(section, DictConfig) or name not in section:
            raise VoccError(f"{key} is not set: ~ has nothing to remove")
        with open_dict(section):
            del section[name]
    else:
        adds = override.is_add() or override.is_force_add()
        OmegaConf.update(config, key, override.value(), merge=True, force_add=adds)


def refuse_shadowed(scene: "SceneSettings", word: str) -> None:
    """Refuse a word without effect: a camera's value that the scene sets, or effects set to none.

    Raises:
        VoccError: with the word that has the effect.
    """
    key, _, value = word.lstrip("+~").partition("=")
    section, _, name = key.partition(".")
    if section == "camera" and getattr(scene.camera, name, None) is not None:
        raise VoccError(
            f"{key} is set by the scene {scene.name}: give scene.{key}={value}"
        )
    if key == "scene.effects" and value == "{}":
        raise VoccError(
            "scene.effects={} takes none away: write ~scene.effects.NAME for each"
        )
