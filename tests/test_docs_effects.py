"""docs/effects.md: its tables are those of the registry and of the results that it names."""

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
PAGE = ROOT / "docs" / "effects.md"
script = SimpleNamespace(**runpy.run_path(str(ROOT / "docs" / "update_effects.py")))


def test_the_page_is_up_to_date():
    """Else run ``python docs/update_effects.py``."""
    assert script.written(PAGE.read_text(encoding="utf-8"), script.RESULTS) == PAGE.read_text(
        encoding="utf-8"
    )


def test_every_effect_is_in_both_tables():
    vocabulary, _, measured = PAGE.read_text(encoding="utf-8").partition("<!-- end of vocabulary -->")
    with (script.RESULTS / "effects.csv").open(newline="", encoding="utf-8") as file:
        rows = {row["differs_in"] for row in csv.DictReader(file) if row["row"] == "effect"}
    covered = {name for differs in rows for name in differs.split(" + ")}
    for kind in PHYSICAL_ORDER:
        assert f"| `{kind.name}` |" in vocabulary
        assert kind.name in covered
        assert f"`{kind.name}`" in measured.partition("## The shipped scenes")[0]


def test_the_table_of_scenes_is_that_of_the_folder():
    section = PAGE.read_text(encoding="utf-8").partition("## The shipped scenes")[2]
    shown = re.findall(r"^\| `(\w+)` \|", section, flags=re.MULTILINE)
    shipped = [path.stem for path in (ROOT / "conf" / "scene").glob("*.yaml")]
    assert sorted(shown) == sorted(shipped)


def test_each_scene_carries_its_files_name():
    for path in (ROOT / "conf" / "scene").glob("*.yaml"):
        assert yaml.safe_load(path.read_text(encoding="utf-8"))["name"] == path.stem


def test_the_pages_scene_of_ten_lines_is_one():
    block = re.search(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL).group(1)
    scene = yaml.safe_load(block)
    assert len([line for line in block.splitlines() if not line.startswith("#")]) == 10
    assert set(scene["effects"]) <= {kind.name for kind in PHYSICAL_ORDER}


def test_every_picture_that_the_pages_show_is_there():
    for page in (PAGE, ROOT / "README.md"):
        for link in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).is_file(), link
