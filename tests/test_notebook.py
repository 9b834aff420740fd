"""The notebook of the documentation, run from its own folder as a reader would."""

import ast
import contextlib
import io
import re
from pathlib import Path

import matplotlib.pyplot as plt
import nbformat
import pytest
from matplotlib.figure import Figure
from nbclient import NotebookClient

from vocc_torch.measure import timing

NOTEBOOK = Path(__file__).resolve().parents[1] / "docs" / "notebooks" / "first.ipynb"


def outputs_of(source, known):
    """Run a cell in this process and give what a kernel would show: prints, the last value, pictures."""
    *lines, last = ast.parse(source).body
    told, value = io.StringIO(), None
    with contextlib.redirect_stdout(told):
        if isinstance(last, ast.Expr):
            exec(compile(ast.Module(lines, []), "cell", "exec"), known)
            value = eval(compile(ast.Expression(last.value), "cell", "eval"), known)
        else:
            exec(compile(ast.Module([*lines, last], []), "cell", "exec"), known)
    pictures = len(plt.get_fignums()) + isinstance(value, Figure)
    plt.close("all")
    shown = [] if value is None else [{"data": {"text/plain": repr(value)}}]
    return [
        {"text": told.getvalue()},
        *shown,
        *[{"data": {"image/png": ""}}] * pictures,
    ]


@pytest.fixture(
    scope="module", params=["here", pytest.param("kernel", marks=pytest.mark.slow)]
)
def run(request, tmp_path_factory):
    """Its cells after they ran, in a folder as deep as its own, so that it finds the photograph."""
    root = tmp_path_factory.mktemp("copy")
    folder = root / "docs" / "notebooks"
    folder.mkdir(parents=True)
    (root / "tests").symlink_to(NOTEBOOK.parents[2] / "tests")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    if request.param == "kernel":
        settings = {"metadata": {"path": folder}}
        NotebookClient(
            notebook, timeout=120, kernel_name="python3", resources=settings
        ).execute()
        return notebook
    known = {"__name__": "notebook"}
    with contextlib.chdir(folder), timing.threads(1):
        plt.switch_backend("agg")
        for cell in (one for one in notebook.cells if one.cell_type == "code"):
            cell.outputs = outputs_of(cell.source, known)
    return notebook


def texts(notebook):
    outputs = [
        one
        for cell in notebook.cells
        if cell.cell_type == "code"
        for one in cell.outputs
    ]
    return "\n".join(
        one.get("text") or one.get("data", {}).get("text/plain", "") for one in outputs
    )


def test_the_notebook_runs_and_reads_the_photograph(run, photo_bits):
    said = texts(run)
    rows = re.findall(r"^[#.](?: [#.]){7}$", said, flags=re.M)
    assert (
        "".join(rows).replace(" ", "").replace("#", "1").replace(".", "0") == photo_bits
    )
    assert (
        sum(
            "image/png" in one.get("data", {})
            for c in run.cells
            for one in c.get("outputs", [])
        )
        == 2
    )


def test_what_the_notebook_shows_is_what_it_gives(run):
    """The rates that are stored in it come from this very code, numbers of the machine aside."""
    stored, found = (
        re.findall(r"\d\.\de-\d", texts(one))
        for one in (nbformat.read(NOTEBOOK, 4), run)
    )
    assert stored == found
