"""docs/mutation.md: its tables are those of the run, and few changes go unnoticed."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest

pytestmark = pytest.mark.breakage

ROOT = Path(__file__).resolve().parent.parent
script = SimpleNamespace(**runpy.run_path(str(ROOT / "benchmarks" / "mutation.py")))


def test_the_page_is_up_to_date():
    """Else run ``python benchmarks/mutation.py --page``."""
    page = script.PAGE.read_text(encoding="utf-8")
    assert script.written(page, script.load()) == page


def test_every_module_was_run_and_less_than_a_tenth_of_its_changes_survived():
    modules = script.load()
    assert list(modules) == list(script.TESTS)
    assert sum(len(m.survivors) for m in modules.values()) < 0.1 * sum(m.mutants for m in modules.values())


def test_every_survivor_is_explained():
    assert all(module.explained == len(module.survivors) for module in script.load().values())


def test_the_tests_that_are_run_are_there():
    assert all((ROOT / test).is_file() for tests in script.TESTS.values() for test in tests)
