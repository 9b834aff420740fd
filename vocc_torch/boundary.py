"""Arguments of public functions, checked against their annotations before anything is done."""

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import GenericAlias, NoneType, UnionType
from typing import (
    Any,
    Literal,
    ParamSpec,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

from vocc_torch.errors import VoccError, is_finite, is_whole, shown, whole_number

P = ParamSpec("P")
R = TypeVar("R")

LEAST = {"seed": 0, "turn": 0}
"""The least of a whole number by its name; of any other it is 1."""

WORDS = {
    int: "a whole number",
    float: "a finite number",
    str: "text",
    bool: "true or false",
    Path: "a path",
    NoneType: "None",
    Callable: "a function",
    object: "anything",
    Any: "a number or a list",
}


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Refuse by name an argument that its annotation does not allow.

    Example:
        >>> @checked
        ... def repeated(frames: int, names: Sequence[str] = ()) -> int:
        ...     return frames
        >>> repeated(2, names=["a"])
        2
        >>> repeated(1.5)
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: frames is 1.5: it must be a whole number, at least 1
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        for name, value in signature.bind(*args, **kwargs).arguments.items():
            parameter = signature.parameters[name]
            hint = parameter.annotation
            if parameter.kind is parameter.VAR_POSITIONAL:
                hint = GenericAlias(Sequence, (hint,))
            if hint is int:
                whole_number(name, value, LEAST.get(name, 1))
            elif hint is not parameter.empty and not fits(value, hint):
                raise VoccError.of(name, shown(value), allowed(hint))
        return function(*args, **kwargs)

    return call


def demand_fields(key: str, part: Any) -> None:
    """Refuse a field of a dataclass, or of one within it, of another type than its annotation.

    Args:
        key: of the part, for refusals.
        part: checks the ranges of its numbers itself.

    Raises:
        VoccError: there is one.
    """
    hints = get_type_hints(type(part))
    for field in fields(part):
        value, hint, name = getattr(part, field.name), hints[field.name], field.name
        if is_dataclass(value):
            demand_fields(f"{key}.{name}", value)
        elif (hint, type(value)) != (float, float) and not fits(value, hint):
            raise VoccError.of(f"{key}.{name}", shown(value), allowed(hint))


def fits(value: Any, hint: Any) -> bool:
    """Whether an annotation allows a value: a class, a union, a sequence, a mapping or a function.

    Example:
        >>> fits([1, 2.5], Sequence[float]), fits("12", Sequence[str]), fits(None, str | None)
        (True, False, True)
    """
    if isinstance(hint, UnionType):
        return any(fits(value, part) for part in get_args(hint))
    kind, parts = get_origin(hint) or hint, get_args(hint)
    if kind is Literal:
        return value in parts
    if kind in (int, float):
        return is_whole(value) if kind is int else is_finite(value)
    if kind is Sequence:
        with suppress(Exception):  # a tensor without values has no list of them
            value = getattr(value, "tolist", lambda: value)()
        if isinstance(value, str | bytes) or not isinstance(value, Sequence):
            return False
        return all(fits(item, parts[0]) for item in value)
    if kind is Mapping:
        return isinstance(value, Mapping) and all(
            fits(key, parts[0]) and fits(item, parts[1]) for key, item in value.items()
        )
    return isinstance(value, kind)


def allowed(hint: Any, words: Mapping[Any, str] = WORDS) -> str:
    """Say what an annotation allows.

    Args:
        hint: the annotation.
        words: what to say of a class.

    Example:
        >>> allowed(Sequence[float] | None), allowed(Mapping[str, int])
        ('a list, each of it a finite number, or None', 'a mapping of text to a whole number')
    """
    if isinstance(hint, UnionType):
        return ", or ".join(allowed(part, words) for part in get_args(hint))
    kind, parts = get_origin(hint) or hint, get_args(hint)
    if kind is Sequence:
        return f"a list, each of it {allowed(parts[0])}"
    if kind is Mapping:
        return f"a mapping of {allowed(parts[0])} to {allowed(parts[1])}"
    if kind is Literal:
        return " or ".join(map(str, parts))
    return words.get(kind, f"a {kind.__name__}")
