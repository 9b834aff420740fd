"""Pages of the documentation: links lead somewhere, the reference is fresh, and code runs as it stands."""

import importlib.util
import re
from pathlib import Path

import pytest
import yaml
from hydra.core.global_hydra import GlobalHydra

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "CHANGELOG.md",
    *sorted(DOCS.rglob("*.md")),
]
LINK = re.compile(r"\]\((?!https?:|mailto:)([^)#\s]*)(?:#([\w-]+))?\)")


def module(name):
    """Import a script of the documentation."""
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def anchors(page):
    """List the anchors of a page's headings as the site and git hosts write them."""
    titles = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {
        re.sub(r"\s+", "-", re.sub(r"[^\w\s-]", "", title.lower()).strip())
        for title in titles
    }


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_and_pictures_exist(page):
    for target, anchor in LINK.findall(page.read_text(encoding="utf-8")):
        path = page.parent / target if target else page
        assert path.exists(), target
        assert not anchor or anchor in anchors(path), f"{target}#{anchor}"


def test_a_run_name_stands_on_one_page():
    """A second command under the name of another run would be refused; the first run is on two pages."""
    pages = {}
    for page in PAGES:
        code = "".join(re.findall(r"```bash\n(.*?)```", page.read_text("utf-8"), re.S))
        for name in re.findall(r"\bname=(\w+)", code):
            pages.setdefault(name, set()).add(page.name)
    assert [name for name in pages if len(pages[name]) > 1] == ["first"]


@pytest.mark.parametrize(
    "name",
    ["classifiers", "effects", "readings", "robustness", "scorecard", "severity"],
)
def test_the_columns_are_those_of_the_measured_file(name):
    head = (DOCS / "results" / f"{name}.csv").read_text("utf-8").partition("\n")[0]
    sections = yaml.safe_load((DOCS / "columns.yaml").read_text("utf-8"))
    assert head.split(",") == list(sections[f"{name}.csv"]["columns"])


@pytest.mark.parametrize("name", ["api", "columns", "effects", "keys"])
def test_the_reference_is_what_the_code_says(name):
    """Run ``python docs/make_reference.py`` where this fails."""
    GlobalHydra.instance().clear()  # another module may have left its own
    written = module("make_reference").PAGES[name]().strip() + "\n"
    assert (DOCS / "reference" / f"{name}.md").read_text(encoding="utf-8") == written


@pytest.mark.parametrize(
    "page",
    [
        "plug-in",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("measure", "decode", "network")
        ),
    ],
)
def test_tutorials_print_what_they_show(page, tmp_path, monkeypatch):
    """Numbers aside, which differ in the last digits from machine to machine."""
    path = DOCS / "tutorials" / f"{page}.md"
    for name in ("tests", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    fresh = module("run_pages").run_page(path, bash=False)

    def words(text):
        return re.sub(r"[-\d.e<+]+", "#", text)

    assert words(fresh) == words(path.read_text(encoding="utf-8"))
