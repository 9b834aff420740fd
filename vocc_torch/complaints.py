"""Hydra's and OmegaConf's errors, said in one line: the key, the value and what is allowed."""

from __future__ import annotations

import dataclasses
import difflib
import re

from vocc_torch.config import AppConfig


def known_keys(schema: type = AppConfig, prefix: str = "") -> list[str]:
    """Every key of the schema, with dots.

    Example:
        >>> "camera.gamma" in known_keys()
        True
    """
    keys: list[str] = []
    for field in dataclasses.fields(schema):
        keys.append(prefix + field.name)
        made = field.default_factory() if field.default_factory is not dataclasses.MISSING else None
        if dataclasses.is_dataclass(made) and not isinstance(made, type):
            keys += known_keys(type(made), f"{prefix}{field.name}.")
    return keys


def _unknown_key(key: str) -> str:
    """Refuse a key that the schema does not have."""
    near = difflib.get_close_matches(key, known_keys(), n=1, cutoff=0.6)
    hint = f"did you mean {near[0]}?" if near else "vocc-torch --help lists the keys"
    return f"{key} is not a known key: {hint}"


def one_line(error: BaseException) -> str:
    r"""Say in one line what Hydra refused.

    Args:
        error: an error of Hydra or OmegaConf; its cause is read too.

    Example:
        >>> one_line(ValueError("Could not override 'sede'.\nKey 'sede' is not in struct"))
        'sede is not a known key: did you mean seed?'
    """
    text = "\n".join(str(e) for e in (error, error.__cause__) if e is not None)
    if match := re.search(r"Could not find '([\w./-]+)/([^']*)'", text):
        group, option = match.groups()
        listed = re.search(rf"Available options in '{group}':\s*\n((?:\s+.+\n?)+)", text)
        allowed = ", ".join(listed.group(1).split()) if listed else "none"
        return f"{group} is '{option}': it must be one of {allowed}"
    match = re.search(r"Could not (?:override|delete from config\.?) '?([\w.@/]+)'?", text)
    if match and re.search(r"is not in struct|not in '|does not exist", text):
        return _unknown_key(match.group(1))
    if match := re.search(r"Key '(\w+)' (?:is )?not in '(\w+)'[\s\S]*?full_key: ([\w.]+)", text):
        return _unknown_key(match.group(3))
    if match := re.search(
        r"Value '([^']*)'.*?could not be converted to (\w+)[\s\S]*?full_key: ([\w.\[\]]+)", text
    ):
        value, kind, key = match.groups()
        names = {"Integer": "a whole number", "Float": "a number", "Boolean": "true or false"}
        return f"{key} is '{value}': it must be {names.get(kind, kind)}"
    return " ".join(text.split("Set the environment variable")[0].split())
