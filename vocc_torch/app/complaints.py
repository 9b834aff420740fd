"""Configuration mistakes, said in one line: the key, the value and what is allowed."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from importlib import resources
from typing import get_origin

from vocc_torch.app.config import AppConfig, keys_of
from vocc_torch.errors import VoccError

_KINDS = {
    "Integer": "a whole number",
    "Float": "a number",
    "Boolean": "true or false",
    "bool": "true or false",
}

GROUPS = ("task", "scene", "camera", "panel", "receiver", "experiment", "budget")
_NO_OPTION = re.compile(
    r"null|true|false|[-+]?([.\d_]+(e[-+]?\d+)?|\.?inf|\.?nan)|(int|float|bool)\(.*|[\[{$].*", re.I | re.S
)
"""What the command line's grammar reads as another thing than a name."""


def unknown_key(key: str) -> str:
    """Say what is wrong with a key that is not there.

    Example:
        >>> unknown_key("camera.gama")
        'camera.gama is not a known key: did you mean camera.gamma?'
    """
    keys = keys_of(AppConfig)
    mappings = [name for name, kind in keys.items() if get_origin(kind) is dict]
    if parent := next((name for name in mappings if key.startswith(f"{name}.")), None):
        return f"{key} is not set here: + adds to {parent}, as in +{key}=..."
    if key == "hydra.launcher.n_jobs":
        return f"{key} is not a known key of this launcher: it belongs to hydra/launcher=joblib"
    near = difflib.get_close_matches(key, keys, n=1, cutoff=0.6)
    hint = f"did you mean {near[0]}?" if near else "vocc-torch --help lists the keys"
    return f"{key} is not a known key: {hint}"


def one_line(error: BaseException, arguments: Sequence[str] = ()) -> str:
    r"""Say in one line what Hydra refused.

    Args:
        error: an error of Hydra or OmegaConf; its cause is read too.
        arguments: the command line, which names the key where the error does not.

    Example:
        >>> one_line(ValueError("Could not override 'sede'.\nKey 'sede' is not in struct"))
        'sede is not a known key: did you mean seed?'
    """
    text = "\n".join(str(e) for e in (error, error.__cause__) if e is not None)
    if match := re.search(rf"{VoccError.__name__} raised while resolving interpolation: (.*)", text):
        return match.group(1)
    override = getattr(error, "override", None)
    if override is not None:
        shown = " ".join(str(override).split())
        return f"{shown} cannot be read: write key=value, a list as [a,b], and quote what is special"
    group = "Config group override must be", "possible interpolation keys"
    if any(words in text for words in group) or isinstance(error, TypeError):
        for key, _, value in (word.lstrip("+").partition("=") for word in arguments):
            if key in ("", *GROUPS) and _NO_OPTION.fullmatch(value):
                return f"{key} is {value}: it must be one of the options that vocc-torch --help lists"
    if isinstance(error, OverflowError) and (match := re.search(r"full_key: ([\w.]+)", text)):
        return f"{match.group(1)} is a whole number of hundreds of digits: it must be a number below 1e308"
    if "integer string conversion" in text:
        word = max(arguments, key=len, default="a value")
        return f"{word.partition('=')[0]} is a number of thousands of digits: it must have at most 4300"
    if "n_jobs == 0" in text:
        return "hydra.launcher.n_jobs is 0: it must be a number of processes, or -1 for one a core"
    said = _of_group(text) or _of_key(text) or _of_value(text)
    return said or " ".join(text.split("Set the environment variable")[0].split())


_SAID = r"""
Multiple values for ([\w/]+)
    {0} is chosen twice: write {0}=option without +
Sweep parameters '\+*([^=]+)=(.*)' requires --multirun
    {0} is {1}: it must be one value; -m runs several
Ambiguous value for argument '([^=]+)=(.*)'
    {0} is {1}: it must be one value; -m runs several, and a list is written [{1}]
Missing mandatory value: ([\w.]+)
    {0} is missing: it must have a value
Interpolation key '([^']+)' not found\s+full_key: ([\w.]+)
    {1} refers to ${{{0}}}: it must be a known key
Could not delete .* value of '([\w.]+)' is (.*) and not (.*)\.
    {0} is {1}, not {2}: write ~{0} to remove it whatever it is
Could not delete from config\.? '?([\w./]+)'?
    {0} is not set: ~ has nothing to remove
does not support deletion[\s\S]*full_key: ([\w.]+)
    {0} cannot be removed: it must have a value
""".strip().splitlines()
"""What Hydra says, as regular expressions, and below each what is said instead."""


def _of_group(text: str) -> str | None:
    """Complain of a group's option, of several values, or of what has no value."""
    if match := re.search(r"Could not find '([\w./-]+)/([^']*)'", text):
        group, option = match.groups()
        listed = re.search(rf"Available options in '{group}':\s*\n((?:\s+.+\n?)+?)Config search path", text)
        allowed = ", ".join(listed.group(1).split()) if listed else "none"
        if (group, option) == ("hydra/launcher", "joblib"):
            return f"{group} is '{option}': jobs at the same time need pip install 'vocc-torch[parallel]'"
        return f"{group} is '{option}': it must be one of {allowed}"
    if match := re.search(r"Could not load '([\w-]+)/([^']*)'", text):  # one of a list, such as [lmmse,mpl]
        group, option = match.groups()
        files = resources.files("vocc_torch.conf").joinpath(group).iterdir()
        known = sorted(file.name.removesuffix(".yaml") for file in files if file.name.endswith(".yaml"))
        return f"{group} has '{option}': it must be of {', '.join(known)}"
    for pattern, words in zip(_SAID[::2], _SAID[1::2], strict=True):
        if match := re.search(pattern, text):
            return words.strip().format(*match.groups())
    return None


def _of_key(text: str) -> str | None:
    """Complain of a key that is not there."""
    unknown = "is not in struct" in text or " not in '" in text or "does not exist" in text
    if unknown and (match := re.search(r"full_key: ([\w.]+)", text)):
        return unknown_key(match.group(1))
    if match := re.search(r"Could not override '?([\w.@/]+)'?", text):
        return unknown_key(match.group(1)) if unknown else f"{match.group(1)} is not a known key or group"
    return None


def _of_value(text: str) -> str | None:
    """Complain of a value of the wrong type."""
    match = re.search(r"full_key: ([\w.\[\]]+)", text)
    if match is None:
        return None
    key = match.group(1)
    patterns = r"Value '(.*?)' (?:of type|is not|could)", r"Error merging override [^=]+=(.*)"
    given = [found.group(1) for pattern in patterns if (found := re.search(pattern, text))]
    value = given[0] if given else ""
    rules = (
        (r"could not be converted to (\w+)", None),
        (r"is not a valid (\w+)", None),
        (r"is not Optional", "given a value"),
        (r"is not a ListConfig", "a list, as in [a,b]"),
        (r"Cannot assign \w+ to Dict|is not a DictConfig", "a mapping, as in {key:value}"),
        (r"Cannot merge DictConfig|is not a subclass of", "a mapping, as in {key:value}"),
        (r"Cannot convert '\w+' to string", "text"),
    )
    for pattern, allowed in rules:
        if found := re.search(pattern, text):
            what = allowed or _KINDS.get(found.group(1), found.group(1))
            return f"{key} is {value if value == 'null' else repr(value)}: it must be {what}"
    return None
