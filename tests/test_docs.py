"""The pages' tables are those of the registry, of the tests and of the results that they name."""

import csv
import re
import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from vocc_torch.simulation.effects import PHYSICAL_ORDER

pytestmark = pytest.mark.breakage

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
SCENES = sorted((ROOT / "conf" / "scene").glob("*.yaml"))


def script(path):
    """The names of a script that writes a page."""
    return SimpleNamespace(**runpy.run_path(str(ROOT / path)))


def text_of(page):
    return (DOCS / f"{page}.md").read_text(encoding="utf-8")


def rows(made, name):
    with (made.RESULTS / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("page", ["effects", "numerics", "rivals", "receivers", "mutation"])
def test_the_page_is_up_to_date(page):
    """Else run ``python docs/update_PAGE.py``, or ``python benchmarks/mutation.py --page``."""
    made = script("benchmarks/mutation.py" if page == "mutation" else f"docs/update_{page}.py")
    results = {"mutation": lambda: [made.load()], "numerics": list}.get(page, lambda: [made.RESULTS])()
    assert made.written(text_of(page), *results) == text_of(page)


def test_every_effect_is_in_both_tables_and_every_scene_in_its_own():
    vocabulary, _, measured = text_of("effects").partition("<!-- end of vocabulary -->")
    told = [row for row in rows(script("docs/update_effects.py"), "effects.csv") if row["row"] == "effect"]
    covered = {name for row in told for name in row["differs_in"].split(" + ")}
    effects, _, scenes = measured.partition("## The shipped scenes")
    for kind in PHYSICAL_ORDER:
        assert f"| `{kind.name}` |" in vocabulary
        assert kind.name in covered
        assert f"`{kind.name}`" in effects
    shown = re.findall(r"^\| `(\w+)` \|", scenes, flags=re.MULTILINE)
    assert sorted(shown) == [path.stem for path in SCENES]
    assert [yaml.safe_load(path.read_text(encoding="utf-8"))["name"] for path in SCENES] == sorted(shown)


def test_the_pages_scene_of_ten_lines_is_one():
    block = re.search(r"```yaml\n(.*?)```", text_of("effects"), flags=re.DOTALL).group(1)
    assert len([line for line in block.splitlines() if not line.startswith("#")]) == 10
    assert set(yaml.safe_load(block)["effects"]) <= {kind.name for kind in PHYSICAL_ORDER}


def test_less_than_a_tenth_of_the_changes_survived_and_each_survivor_is_explained():
    made = script("benchmarks/mutation.py")
    modules = made.load()
    assert list(modules) == list(made.TESTS)
    assert sum(len(m.survivors) for m in modules.values()) < 0.1 * sum(m.mutants for m in modules.values())
    assert all(module.explained == len(module.survivors) for module in modules.values())
    assert all((ROOT / test).is_file() for tests in made.TESTS.values() for test in tests)


def test_the_page_of_calibration_shows_what_was_measured():
    made, page = script("docs/update_calibration.py"), text_of("calibration")
    assert made.written(page, made.RESULTS) == page


def test_every_hard_case_is_a_row():
    for floor in script("docs/update_numerics.py").floors():
        section = text_of("numerics").partition(f"### {floor.floor}\n")[2]
        table = section.partition("\n### ")[0].partition("<!--")[0]
        shown = re.findall(r"^\| (.+?) \| .+ \|$", table, flags=re.MULTILINE)[1:]
        assert shown == [case.name for case in floor.cases]
        assert not [case.name for case in floor.cases if set("|\n") & set(case.name + case.answer)]


def test_every_shipped_classifier_is_in_the_table_and_the_best_has_a_thirtieth_of_the_papers_errors():
    """Of the rates that the page tells, by the upper end of their intervals; the genie has none lower."""
    made = script("docs/update_rivals.py")
    told = {row["receiver"]: row for row in rows(made, "classifiers.csv")}
    assert {path.stem for path in (ROOT / "conf" / "classifier").glob("*.yaml")} <= {*told, "own", "sklearn"}
    for at in ("ambient_1000", "distance_70"):
        assert float(told["mlp"][f"{at}_ratio_high"]) <= 1 / 30
    for row in rows(made, "genie.csv"):
        assert int(row["bit_errors"]) <= int(row["best_bit_errors"])
