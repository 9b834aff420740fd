"""The lines of a ledger file: a header that says whose results these are, then rows, each with a checksum.

A line is a JSON object whose last key, ``check``, is the beginning of the SHA-256 of the object without it. A
line that was written in part, or changed afterwards, is thereby known.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import astuple, dataclass, fields
from typing import cast

from vocc_torch import __version__
from vocc_torch.errors import VoccError
from vocc_torch.measure.counts import Counts
from vocc_torch.measure.paired import PairedCounts
from vocc_torch.rng import BLOCK_FRAMES

VERSION = 1
"""Version of the format; another one is refused."""

MAGIC = b'{"format":"vocc-torch ledger","version":'
"""What every ledger begins with."""

KINDS: dict[str, type[Counts] | type[PairedCounts]] = {"counts": Counts, "paired": PairedCounts}
"""What a row can hold, by the name that stands in the file."""

Key = tuple[str | int, ...]
"""What counts are filed under; the package's own labels are those of ``studies.counter``."""

COLUMNS = {name: [field.name for field in fields(kind)] for name, kind in KINDS.items()}
"""What the numbers in a row mean, in order."""

_CHECK_DIGITS = 16
_SEAL = len(',"check":""}') + _CHECK_DIGITS


class DamagedLine(ValueError):  # noqa: N818  # never seen outside: the ledger turns it into a refusal
    """A line that does not have its checksum."""


def canonical(settings: Mapping[str, object]) -> dict[str, object]:
    """Give settings as plain JSON values with sorted keys, so that what is equal is written the same.

    Whole floats become integers and tuples become lists: 25, 25.0 and a value read back are one.

    Raises:
        VoccError: a value that JSON does not have, named by its key.

    Example:
        >>> canonical({"seed": 0, "camera": {"focal_length_mm": 25.0, "iso_limits": (100, 3200)}})
        {'camera': {'focal_length_mm': 25, 'iso_limits': [100, 3200]}, 'seed': 0}
    """
    return {key: _plain(settings[key], key) for key in sorted(settings)}


def _plain(value: object, key: str) -> object:
    """Turn one value into what JSON has."""
    if isinstance(value, float) and math.isfinite(value):
        return int(value) if value.is_integer() else float(value)
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, (list, tuple)):
        return [_plain(item, f"{key}[{index}]") for index, item in enumerate(value)]
    if isinstance(value, Mapping) and all(isinstance(name, str) for name in value):
        return {name: _plain(value[name], f"{key}.{name}") for name in sorted(value)}
    raise VoccError(
        f"settings.{key} is {value!r}: "
        "it must be text, a finite number, true, false, null, a list or a mapping"
    )


def _dumped(value: object) -> str:
    """Write JSON without spaces, in ASCII."""
    return json.dumps(value, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


def fingerprint(settings: Mapping[str, object]) -> str:
    """Give the SHA-256 of settings, in hexadecimal; equal settings have equal fingerprints.

    Example:
        >>> fingerprint({"a": 1, "b": 2.5}) == fingerprint({"b": 2.5, "a": 1.0})
        True
    """
    return hashlib.sha256(_dumped(canonical(settings)).encode()).hexdigest()


def sealed(content: Mapping[str, object]) -> bytes:
    r"""Write one line with its checksum.

    Example:
        >>> sealed({"block": 3})
        b'{"block":3,"check":"26ae23e630096b81"}\n'
    """
    body = _dumped(content)
    return f'{body[:-1]},"check":"{_check(body.encode())}"}}\n'.encode()


def unsealed(line: bytes) -> dict[str, object]:
    """Read one line, given without its newline, and take the checksum off.

    Raises:
        DamagedLine: the line does not have its checksum.

    Example:
        >>> unsealed(sealed({"block": 3})[:-1])
        {'block': 3}
    """
    body = line[:-_SEAL] + b"}"
    if line[-_SEAL:] != f',"check":"{_check(body)}"}}'.encode():
        raise DamagedLine
    content = json.loads(body)
    if not isinstance(content, dict):
        raise DamagedLine
    return content


def _check(body: bytes) -> str:
    """Give the checksum of a line's content."""
    return hashlib.sha256(body).hexdigest()[:_CHECK_DIGITS]


@dataclass(frozen=True, slots=True)
class LedgerRow:
    """What was counted in a block of a point, or in the first frames of it.

    Args:
        point: the point's name, which keys its random draws.
        block: index of the block, at least 0.
        frames: how many of its frames were used, from the first on, 1 to 64.
        counts: by label; none where no frame fell into a group.

    Raises:
        VoccError: a value outside its range, or counts of more frames than were used.

    Example:
        >>> LedgerRow("distance/distance_m=5", 0, 64, {("flda_3", 0): Counts(65, 4160)})
        Traceback (most recent call last):
        ...
        vocc_torch.errors.VoccError: counts of ('flda_3', 0) have 65 frames: block 0 has at most 64
    """

    point: str
    block: int
    frames: int
    counts: Mapping[Key, Counts | PairedCounts]

    def __post_init__(self) -> None:
        """Refuse what no run can have counted."""
        if type(self.block) is not int or self.block < 0:
            raise VoccError(f"block is {self.block!r}: it must be an integer of at least 0")
        if type(self.frames) is not int or not 1 <= self.frames <= BLOCK_FRAMES:
            raise VoccError(f"frames is {self.frames!r}: it must be an integer of 1 to {BLOCK_FRAMES}")
        for key, counts in self.counts.items():
            if not all(type(part) in (str, int) for part in key):
                raise VoccError(f"counts are filed under {key}: it must be text and integers")
            if counts.frames > self.frames:
                raise VoccError(
                    f"counts of {key} have {counts.frames} frames: "
                    f"block {self.block} has at most {self.frames}"
                )

    def line(self) -> bytes:
        """Write the row as a line of the file."""
        names = {kind: name for name, kind in KINDS.items()}
        counts = [[names[type(one)], list(key), list(astuple(one))] for key, one in self.counts.items()]
        content = {"point": self.point, "block": self.block, "frames": self.frames, "counts": counts}
        return sealed(content)

    @classmethod
    def read(cls, line: bytes) -> LedgerRow:
        """Read a line of the file, given without its newline.

        Raises:
            DamagedLine: the line does not have its checksum.
            VoccError: it has, and is no row.
        """
        row = unsealed(line)
        try:
            entries = cast("list[tuple[str, list[str | int], list[int]]]", row["counts"])
            counts = {
                tuple(key): KINDS[name](**dict(zip(COLUMNS[name], values, strict=True)))
                for name, key, values in entries
            }
            return cls(str(row["point"]), cast("int", row["block"]), cast("int", row["frames"]), counts)
        except (KeyError, TypeError, ValueError) as error:
            raise VoccError(f"holds what is no row ({error})") from None


def header(settings: Mapping[str, object]) -> bytes:
    """Write the first line of a ledger of these settings.

    Raises:
        VoccError: settings that cannot be written.
    """
    content = {
        "format": "vocc-torch ledger",
        "version": VERSION,
        "package": __version__,
        "fingerprint": fingerprint(settings),
        "settings": canonical(settings),
        "columns": COLUMNS,
    }
    return sealed(content)


def is_torn_header(content: bytes) -> bool:
    """Whether a whole file is the beginning of a header, as a run leaves it that is killed at once.

    Example:
        >>> is_torn_header(header({})[:60]), is_torn_header(header({})), is_torn_header(b"my notes")
        (True, False, False)
    """
    return b"\n" not in content and (content.startswith(MAGIC) or MAGIC.startswith(content))


def check_header(line: bytes, settings: Mapping[str, object]) -> None:
    """Refuse a first line, given without its newline, that is not that of a ledger of these settings.

    Raises:
        VoccError: what differs, and what to do; to be read after the ledger's name.
    """
    if not line.startswith(MAGIC):
        raise VoccError("is no ledger of vocc-torch: move that file away, or choose another ledger")
    version = line[len(MAGIC) :].split(b",", 1)[0].decode(errors="replace")
    another = "continue it with the release that began it, or choose another ledger"
    if version != str(VERSION):
        raise VoccError(f"has format version {version[:20]} and this release reads {VERSION}: {another}")
    try:
        content = unsealed(line)
    except DamagedLine:
        raise VoccError(
            "is damaged in line 1, which says whose results it holds: bring back a copy, or delete it"
        ) from None
    expected = unsealed(header(settings)[:-1])
    if (content["package"], content["columns"]) != (expected["package"], expected["columns"]):
        package = content["package"]
        raise VoccError(f"was written by vocc-torch {package} and this is {__version__}: {another}")
    if content["fingerprint"] != expected["fingerprint"]:
        differing = difference(content["settings"], expected["settings"])
        raise VoccError(
            f"holds results of other settings: {differing}: go back to them, or choose another ledger"
        )


def difference(there: object, here: object) -> str:
    """Say in which settings a ledger and this run differ: the first three with both values.

    Example:
        >>> difference({"seed": 0, "camera": {"gamma": 2.2}}, {"seed": 1, "camera": {"gamma": 2.2}})
        'seed is 0 there and 1 here'
    """
    old, new, absent = dict(_leaves(there)), dict(_leaves(here)), "not set"
    names = sorted(name for name in {*old, *new} if old.get(name) != new.get(name))
    told = [f"{name} is {old.get(name, absent)} there and {new.get(name, absent)} here" for name in names]
    return ", ".join(told[:3]) + (f" and {len(told) - 3} more" if len(told) > 3 else "")


def _leaves(value: object, name: str = "") -> Iterator[tuple[str, str]]:
    """Walk nested mappings and give each value's dotted name and its JSON."""
    if isinstance(value, dict) and value:
        for key, inner in value.items():
            yield from _leaves(inner, f"{name}.{key}" if name else key)
    else:
        yield name, _dumped(value)
