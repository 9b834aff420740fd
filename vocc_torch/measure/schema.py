"""From plain values and words of the command line to typed settings; refusals are one line with the key."""

import difflib
import types
import typing
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, get_args, get_origin

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    MissingMandatoryValue,
    OmegaConfBaseException,
)

from vocc_torch.errors import VoccError, shown

if TYPE_CHECKING:
    from vocc_torch.measure.config import SceneSettings

KINDS: dict[object, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text",
    list: "a list, as in [a,b]",
    tuple: "a list, as in [a,b]",
    dict: "a mapping, as in {key:value}",
}
"""What a value must be, by its type."""


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


def unknown_key(key: str, schema: type) -> str:
    """Say that a schema does not have a key, and which of its keys is meant.

    Example:
        >>> from vocc_torch.measure.config import WorldSettings
        >>> unknown_key("camera.gama", WorldSettings)
        'camera.gama is not a known key: did you mean camera.gamma?'
    """
    keys = keys_of(schema)
    mappings = [name for name, kind in keys.items() if get_origin(kind) is dict]
    parent = next((name for name in mappings if key.startswith(f"{name}.")), None)
    if parent is not None:
        return f"{key} is not set here: + adds to {parent}, as in +{key}=..."
    near = difflib.get_close_matches(key, keys, n=1, cutoff=0.6)
    hint = f"did you mean {near[0]}?" if near else "vocc-torch --help lists the keys"
    return f"{key} is not a known key: {hint}"


def kind_text(kind: Any) -> str:
    """Say what a value of a type must be.

    Example:
        >>> kind_text(list[str]), kind_text(int | None)
        ('a list, as in [a,b]', 'a whole number, or null')
    """
    if get_origin(kind) in (types.UnionType, typing.Union):
        (inner,) = (part for part in get_args(kind) if part is not types.NoneType)
        return f"{kind_text(inner)}, or null"
    if is_dataclass(kind):
        return KINDS[dict]
    return KINDS.get(get_origin(kind) or kind, "of another type")


def refusal(error: OmegaConfBaseException, schema: type) -> str:
    """Say in one line what OmegaConf refused.

    Args:
        error: with the key and the value.
        schema: the dataclass of the settings, which names the keys and their types.
    """
    key = error.full_key or str(error.key or "")
    if isinstance(error, MissingMandatoryValue):
        return f"{key} is missing: it must have a value"
    if isinstance(error, ConfigKeyError | ConfigAttributeError):
        return unknown_key(key, schema)
    kind = keys_of(schema).get(key)
    if kind is None:
        return f"{key}: {' '.join(str(error.msg or error).split())}"
    return f"{key} is {shown(error.value)}: it must be {kind_text(kind)}"


@cache
def empty(schema: type) -> DictConfig:
    """Give a schema as an OmegaConf object with its defaults; copy it before values are merged in."""
    config: DictConfig = OmegaConf.structured(schema)
    OmegaConf.set_readonly(config, None)
    for key, kind in keys_of(schema).items():
        if isinstance(kind, type) and is_dataclass(kind):
            # Frozen dataclasses take values too.
            OmegaConf.set_readonly(OmegaConf.select(config, key), None)
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
    try:
        config = OmegaConf.merge(empty(schema), *plain)
        OmegaConf.set_struct(config, True)
        for word, override in zip(words, _parsed(words), strict=True):
            try:
                _apply(config, override, word)
            except (ConfigKeyError, ConfigAttributeError):
                raise VoccError(unknown_key(override.key_or_group, schema)) from None
        return OmegaConf.to_object(config)
    except OmegaConfBaseException as error:
        raise VoccError(refusal(error, schema)) from None


def _parsed(words: Sequence[str]) -> list[Override]:
    """Parse words as Hydra does."""
    parsed = []
    for word in words:
        try:
            parsed += OverridesParser.create().parse_overrides([word])
        except HydraException:
            rule = "write key=value, a list as [a,b], and quote what is special"
            raise VoccError(
                f"{' '.join(str(word).split())} cannot be read: {rule}"
            ) from None
    return parsed


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
    elif override.is_add() or override.is_force_add():
        OmegaConf.update(config, key, override.value(), merge=True, force_add=True)
    else:
        OmegaConf.update(config, key, override.value(), merge=True)


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
