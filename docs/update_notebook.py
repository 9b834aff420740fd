"""Run the notebook of the documentation and keep what it shows.

python docs/update_notebook.py
"""

from pathlib import Path

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).parent / "notebooks"


def main() -> None:
    """Run it in its own folder and write it back without times and without the files that it makes."""
    path = FOLDER / "first.ipynb"
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(
        notebook, timeout=300, resources={"metadata": {"path": FOLDER}}
    ).execute()
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
    nbformat.write(notebook, path)
    for name in ("ber.csv", "better.pt"):
        (FOLDER / name).unlink()


if __name__ == "__main__":
    main()
