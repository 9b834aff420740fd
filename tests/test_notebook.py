"""The notebook of the documentation, run from its own folder as a reader would."""

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOK = Path(__file__).resolve().parents[1] / "docs" / "notebooks" / "first.ipynb"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Its cells after they ran, in a folder as deep as its own, so that it finds the photograph."""
    root = tmp_path_factory.mktemp("copy")
    (root / "docs" / "notebooks").mkdir(parents=True)
    (root / "tests").symlink_to(NOTEBOOK.parents[2] / "tests")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    settings = {"metadata": {"path": root / "docs" / "notebooks"}}
    NotebookClient(notebook, timeout=120, kernel_name="python3", resources=settings).execute()
    return notebook


def texts(notebook):
    outputs = [one for cell in notebook.cells if cell.cell_type == "code" for one in cell.outputs]
    return "\n".join(one.get("text") or one.get("data", {}).get("text/plain", "") for one in outputs)


def test_the_notebook_runs_and_reads_the_photograph(run, photo_bits):
    said = texts(run)
    rows = re.findall(r"^[#.](?: [#.]){7}$", said, flags=re.M)
    assert "".join(rows).replace(" ", "").replace("#", "1").replace(".", "0") == photo_bits
    assert sum("image/png" in one.get("data", {}) for c in run.cells for one in c.get("outputs", [])) == 2


def test_what_the_notebook_shows_is_what_it_gives(run):
    """The rates that are stored in it come from this very code, numbers of the machine aside."""
    stored, found = (re.findall(r"\d\.\de-\d", texts(one)) for one in (nbformat.read(NOTEBOOK, 4), run))
    assert stored == found
