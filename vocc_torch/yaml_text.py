"""YAML as plain values: the core schema of YAML 1.2, without what multiplies, repeats or misleads."""

import re
from collections.abc import Hashable, Iterator
from pathlib import Path
from typing import Any

import yaml

from vocc_torch.errors import VoccError, printable
from vocc_torch.files import read_file

MOST_BYTES = 1 << 17
"""Most bytes of a file: the configurations that runs write have 20 thousand, and reading is slow."""
MOST_LEVELS = 32
"""Most mappings and lists within one another: far beyond any configuration, far below Python's own limit."""

_PREFIX = "tag:yaml.org,2002:"
_SCALARS = {
    "null": (r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    "bool": (r"true|True|TRUE|false|False|FALSE", "tTfF"),
    "int": (r"[-+]?[0-9]+", "-+0123456789"),
    "float": (
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        "-+.0123456789",
    ),
}
"""What a text without quotes is, and the characters that it begins with; anything else is text."""


class _PlainLoader(yaml.SafeLoader):  # type: ignore[misc]  # PyYAML has no hints
    """A loader of plain values; numbers are decimal."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012  # PyYAML's own name
    levels = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node, unless it repeats another or lies too deep."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("it has an alias (*): write the value out")
        if self.levels == MOST_LEVELS:
            raise yaml.YAMLError(f"it has more than {MOST_LEVELS} levels")
        self.levels += 1
        node = super().compose_node(parent, index)
        self.levels -= 1
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Hashable, Any]:
        """Construct a mapping whose keys differ."""
        mapping: dict[Hashable, Any] = {}
        for key, value in node.value:
            name, line = self.construct_object(key, deep=True), key.start_mark.line + 1
            if isinstance(name, dict | list | None):
                raise yaml.YAMLError(
                    f"a key is null, a list or a mapping (line {line})"
                )
            if name in mapping:
                raise yaml.YAMLError(f"key {name} is there twice (line {line})")
            mapping[name] = self.construct_object(value, deep)
        return mapping


_CONSTRUCTED = ("null", "bool", "float", "str", "seq", "map")
_PlainLoader.yaml_constructors = {
    f"{_PREFIX}{kind}": yaml.SafeLoader.yaml_constructors[f"{_PREFIX}{kind}"]
    for kind in _CONSTRUCTED
} | {
    f"{_PREFIX}int": lambda loader, node: int(loader.construct_scalar(node)),
    None: yaml.SafeLoader.construct_undefined,
}
for _kind, (_pattern, _first) in _SCALARS.items():
    _known = re.compile(rf"^(?:{_pattern})$")
    _PlainLoader.add_implicit_resolver(f"{_PREFIX}{_kind}", _known, _first)


def parse_yaml(text: str | bytes, what: str = "YAML") -> Any:
    """Read YAML as numbers, texts, booleans, None, lists and mappings.

    Args:
        text: one document.
        what: name of the document in refusals.

    Raises:
        VoccError: no YAML, an alias, a key that is there twice, a tag, or too many levels.

    Example:
        >>> parse_yaml("{a: 030, b: 1:30, c: 1e3, d: off, e: [true, ~]}")
        {'a': 30, 'b': '1:30', 'c': 1000.0, 'd': 'off', 'e': [True, None]}
    """
    try:
        return yaml.load(text, Loader=_PlainLoader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        reason = printable(" ".join(str(error).split()))
        raise VoccError(f"{what} cannot be read: {reason}") from None


def read_yaml(path: str | Path, what: str = "file") -> Any:
    """Read a YAML file as :func:`parse_yaml` does.

    Raises:
        VoccError: no ordinary file, more than 128 KiB, or what :func:`parse_yaml` refuses.
    """
    return parse_yaml(
        read_file(path, what, MOST_BYTES), f"{what} {printable(str(path))}"
    )


def leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Walk nested mappings and lists of mappings: each value with its name, the keys joined by dots.

    Example:
        >>> dict(leaves({"a": {"b": 1}, "c": [{"d": [2, 3]}]}))
        {'a.b': 1, 'c.0.d': [2, 3]}
    """
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        value = dict(enumerate(value))
    if isinstance(value, dict) and value:
        for key, inner in value.items():
            yield from leaves(inner, f"{name}.{key}" if name else str(key))
    else:
        yield name, value
