"""Hard cases: each a name, the answer that holds, a check, and a change of the code that it must notice.

The names are the test report's, the answers are the table in docs/numerics.md, and the changes are made one
by one, in a copy of the package, by break_everything.py, which fails where a check stays green. Answers and
changes are in hard_cases.yaml, by floor and name.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
TOLD = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text())


@dataclass(frozen=True)
class Breakage:
    """A change that breaks the code: in the file at ``path``, the only ``old`` becomes ``new``."""

    path: str
    old: str
    new: str

    def fits(self):
        """Say whether the text to change is there, once."""
        return (ROOT / self.path).read_text().count(
            self.old
        ) == 1 and self.old != self.new


@dataclass(frozen=True)
class HardCase:
    """What happens in one hard case; ``answer`` is a sentence of Markdown for the reader of the docs."""

    name: str
    answer: str
    broken_by: Breakage
    check: Callable[[], None]


class HardCases:
    """The hard cases of one floor, in the order in which they are told."""

    def __init__(self, floor):
        self.floor = floor
        self.cases = []

    def __call__(self, name):
        """Take a function without arguments as the check of the case of this name."""
        assert name not in [case.name for case in self.cases], (
            f"two cases are named {name!r}"
        )
        (told,) = (one for one in TOLD[self.floor] if one["name"] == name)
        broken_by = Breakage(told["file"], told["old"], told["new"])

        def take(check):
            self.cases.append(HardCase(name, told["answer"], broken_by, check))
            return check

        return take

    def each(self, test):
        """Run a test for every case, named by it; the last thing in a file."""
        return pytest.mark.parametrize(
            "case", self.cases, ids=[case.name for case in self.cases]
        )(test)
