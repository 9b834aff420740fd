"""The page about effects names every effect and every scene, and its example is a scene."""

import re
from pathlib import Path

import yaml

from vocc_torch.simulation.effects import PHYSICAL_ORDER

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")


def test_every_effect_is_in_both_tables_and_every_scene_in_its_own():
    vocabulary, _, measured = PAGE.partition("<!-- end of vocabulary -->")
    effects, _, scenes = measured.partition("## The shipped scenes")
    for kind in PHYSICAL_ORDER:
        assert f"| `{kind.name}` |" in vocabulary
        assert f"`{kind.name}`" in effects
    shown = re.findall(r"^\| `(\w+)` \|", scenes, flags=re.MULTILINE)
    assert sorted(shown) == sorted(
        path.stem for path in (ROOT / "conf" / "scene").glob("*.yaml")
    )


def test_the_pages_scene_of_ten_lines_is_one():
    block = re.search(r"```yaml\n(.*?)```", PAGE, flags=re.DOTALL).group(1)
    assert len([line for line in block.splitlines() if not line.startswith("#")]) == 10
    assert set(yaml.safe_load(block)["effects"]) <= {
        kind.name for kind in PHYSICAL_ORDER
    }
