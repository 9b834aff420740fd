"""What the package raises when the user asks for something it cannot do, and the checks that raise it."""

import difflib
import math
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import MISSING, field, fields
from importlib import import_module
from numbers import Integral, Real
from typing import Any, Self, TypeGuard

MOST_COUNT = 1e15
"""Most of anything that is counted; float64 holds every whole number up to it."""


class VoccError(ValueError):
    """A mistake of the user: one line that names the key or argument, its value and what is allowed.

    The line begins with the key, so that a :func:`section` can say where the key came from. The command line
    prints it without a traceback and exits with status 2.

    Example:
        >>> raise VoccError.of("scene.distance_m", -3, "above 0")
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: scene.distance_m is -3: it must be above 0
    """

    @classmethod
    def of(cls, key: str, value: object, rule: str, verb: str = "is") -> Self:
        """Make the error of a key, its value and the rule that the value breaks.

        Args:
            key: with dots, as a user writes it.
            value: as it is to be shown.
            rule: what the value must be.
            verb: ``is``, or ``has`` for a value that is one of the key's.
        """
        return cls(f"{key} {verb} {value}: it must be {rule}")


def stdout_refusal(error: OSError) -> str:
    """Say that standard output cannot be written, where that is what ended the work; empty otherwise.

    Args:
        error: what the system said. It names no file, and an empty line fails as well.
    """
    try:
        if error.filename is None:
            print(flush=True)
    except OSError as again:
        return f"standard output cannot be written: {again.strerror or again}"
    return ""


@contextmanager
def section(key: str, before: str = "") -> Iterator[None]:
    """Say under which key the values of a block are: refusals inside name that key.

    Args:
        key: of the section, as a user writes it.
        before: what the refusals call the section, which ``key`` replaces; refusals of other keys pass as
            they are. Empty where their keys lack the section: then ``key`` is put before each that has not
            got it.

    Example:
        >>> with section("comparison.scenes.fog", before="scene"):
        ...     raise VoccError.of("scene.distance_m", -3, "above 0")
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: comparison.scenes.fog.distance_m is -3: it must be above 0
    """
    try:
        yield
    except VoccError as error:
        said = str(error)
        begins = (f"{before}.", f"{before} ") if before else f"{key}."
        if said.startswith(begins) != bool(before):
            raise
        rest = f".{said}"
        if before:
            rest = said[len(before) :].replace(f"{before}.", f"{key}.")
        raise type(error)(f"{key}{rest}") from None


def shown(value: object) -> str:
    """Write a refused value in one line of at most 41 characters.

    Example:
        >>> shown("50"), shown(10**400)
        ("'50'", '1000000000000000000...0000000000000000000')
    """
    # An object may refuse to be written, as whole numbers of over 4300 digits do.
    try:
        text = " ".join(repr(value).split())
    except Exception:
        return f"of the type {type(value).__name__}"
    return text if len(text) <= 41 else f"{text[:19]}...{text[-19:]}"


def printable(text: str) -> str:
    r"""Escape characters that are not printable: terminal codes, and bytes that are not UTF-8.

    Example:
        >>> print(printable("red\x1b[31m.png"))
        red\x1b[31m.png
    """
    return "".join(one if one.isprintable() else ascii(one)[1:-1] for one in text)


def library(module: str, extra: str, need: str, otherwise: str = "") -> Any:
    """Import a library that an extra of the package installs.

    Args:
        module: its name.
        extra: the name of the extra.
        need: what needs it.
        otherwise: what may be done instead.

    Raises:
        VoccError: it is not installed.

    Example:
        >>> library("no_such_module", "video", "input a.mp4 is a film")
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: input a.mp4 is a film: install the extra with pip install 'vocc-torch[video]'
    """
    try:
        return import_module(module)
    except ImportError:
        command = f"install the extra with pip install 'vocc-torch[{extra}]'"
        raise VoccError(f"{need}: {command}{otherwise}") from None


def told_known(given: object, known: Iterable[str]) -> str:
    """Say for a refusal which names are known, and first the one that is meant, where one is near.

    Example:
        >>> told_known("gama", ["gain", "gamma"])
        'did you mean gamma? known: gain, gamma'
    """
    names = list(known)
    near = difflib.get_close_matches(str(given), names, n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    return f"{hint}known: {', '.join(names) or 'none'}"


def demand_kind(name: str, value: object, *kinds: type) -> None:
    """Refuse, by name, a value that has none of the types.

    Raises:
        VoccError: with the value and what it may be.

    Example:
        >>> demand_kind("scene", 3, int)
    """
    if not isinstance(value, kinds):
        raise VoccError.of(
            name,
            shown(value),
            f"of type {' or '.join(kind.__name__ for kind in kinds)}",
        )


def is_finite(value: object) -> TypeGuard[float]:
    """Whether a value is a number that float64 holds, also one of NumPy; true and false are none.

    Example:
        >>> is_finite(10**400), is_finite(True), is_finite(3)
        (False, False, True)
    """
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    return is_number and bool(abs(value) <= sys.float_info.max)  # type: ignore[arg-type]


def finite_number(name: str, value: object, allowed: str = "a finite number") -> float:
    """Give a finite real number, also one of NumPy, as a float, or refuse it by name.

    Args:
        name: the argument's.
        value: what is given for it; true and false, text, and numbers beyond float64 are not numbers here.
        allowed: what it must be, for the refusal.

    Raises:
        VoccError: anything else.

    Example:
        >>> finite_number("scene.distance_m", 50)
        50.0
    """
    if is_finite(value):
        return float(value)
    raise VoccError.of(name, shown(value), allowed)


def demand_within(
    name: str,
    value: Any,
    low: float,
    high: float = math.inf,
    *,
    above: bool = False,
    null: bool = False,
    hint: str = "",
    whole: bool = False,
) -> Any:
    """Give a number from ``low`` (or ``above`` it) to ``high`` as a float or an int, or refuse it by name.

    Args:
        name: the key's.
        value: what is given for it.
        low: the least allowed, or what it must exceed.
        high: the most; infinity itself is not allowed.
        above: whether ``low`` itself is refused.
        null: whether None is allowed too.
        hint: what to do instead, said where the value is ``low``.
        whole: whether it must be a whole number.

    Example:
        >>> demand_within("record.fps", 0, 0, 1e6, above=True)
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: record.fps is 0: it must be above 0 and at most 1e+06
    """
    if null and value is None:
        return None
    text = str if whole else "{:g}".format
    rule = f"{'above' if above else 'at least'} {text(low)}"
    rule += f" and at most {text(high)}" if high < math.inf else ""
    rule += ", or null" * null
    is_kind = is_whole(value) if whole else is_finite(value)
    if is_kind and low <= value <= high and not (above and value == low):
        return int(value) if whole else float(value)
    if whole and (high < math.inf or not is_kind):
        rule = f"a whole number, {rule}"
    elif not is_kind and not isinstance(value, float):
        rule = f"a number, {rule}"
    rule += f" ({hint})" if hint and is_kind and value == low else ""
    given = shown(value) if whole or not is_kind else f"{float(value):g}"
    raise VoccError.of(name, given, rule)


def demand_word(name: str, value: str, words: Iterable[str], hint: str = "") -> None:
    """Refuse, by name, a value that is none of the words; the hint follows them.

    Example:
        >>> demand_word("receive.soft", "hard", ("scores", "hard"))
    """
    if value not in words:
        raise VoccError.of(name, repr(value), f"one of {', '.join(words)}{hint}")


def demand_least(section: str, owner: object, **least: int) -> None:
    """Refuse by name the first attribute that is no whole number, too low or endless; None is nothing given.

    Args:
        section: what its keys begin with, with the point.
        owner: whose attributes they are.
        **least: the least allowed by name.
    """
    for name, low in least.items():
        if (value := getattr(owner, name)) is not None:
            whole_number(f"{section}{name}", value, low)
            demand_within(f"{section}{name}", value, low, MOST_COUNT)


def is_whole(value: object) -> bool:
    """Whether a value is a whole number, also one of NumPy; 8.0 and true are none."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def whole_number(name: str, value: object, low: int, high: float = math.inf) -> int:
    """Give a whole number from ``low`` to ``high``, also one of NumPy, as an int, or refuse it by name.

    Raises:
        VoccError: anything else, such as 8.0 and true.

    Example:
        >>> whole_number("panel.rows", 8, 1, 1024)
        8
    """
    return int(demand_within(name, value, low, high, whole=True))


def within(
    low: float,
    high: float = math.inf,
    *,
    default: object = MISSING,
    **rules: str | bool,
) -> Any:
    """Declare a number of a dataclass with its range; values outside it are refused by name.

    Args:
        low: the least value allowed, or with ``above`` the bound that it must exceed.
        high: the greatest value allowed; infinity itself is not a value.
        default: what holds where the number is left out; without one it must be given. None may stand for
            nothing given.
        **rules: ``above``, whether ``low`` itself is refused; ``hint``, what to do instead, said where the
            value is ``low``; ``null``, whether None is a value; ``whole``, whether it is a whole number.
    """
    return field(default=default, metadata={"low": low, "high": high, **rules})


def demand_ranges(section: str, owner: Any) -> None:
    """Refuse the first number of a dataclass that is not as declared, and make ints and floats of them.

    Args:
        section: what its keys begin with.
        owner: may be frozen.

    Raises:
        VoccError: with the key, the value and the range.
    """
    for item in fields(owner):
        if item.metadata:
            value = getattr(owner, item.name)
            number = demand_within(f"{section}.{item.name}", value, **item.metadata)
            object.__setattr__(owner, item.name, number)
