"""Every hard case names a change of the code that turns it red: the changes still fit the code.

``python tests/numerics/break_everything.py`` makes them, one by one, and sees the reds.
"""

import collections
import importlib

import pytest
from break_everything import modules

pytestmark = pytest.mark.breakage

CASES = [
    case for name in modules() for case in importlib.import_module(name).hard.cases
]


@pytest.mark.parametrize("case", CASES, ids=[case.name for case in CASES])
def test_its_breakage_fits(case):
    assert case.broken_by.fits(), (
        f"{case.broken_by.path} does not hold this once: {case.broken_by.old!r}"
    )


def test_names_are_unique():
    counted = collections.Counter(case.name for case in CASES)
    assert [name for name, count in counted.items() if count > 1] == []
    assert CASES
