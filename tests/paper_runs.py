"""Runs of the command line that several tests look at, each in a folder of its own."""

import contextlib
import csv
import io
import sys

import pytest
from conftest import Ran
from hydra.core.global_hydra import GlobalHydra
from PIL import Image

from vocc_torch.app import cli
from vocc_torch.files import atomic_file


def white(figure, path):
    """Save a figure as one white pixel: drawing takes longer than a tiny study."""
    with atomic_file(path) as temporary:
        Image.new("L", (1, 1), 255).save(temporary, format="PNG")


def run_in(folder, *arguments, drawn=False):
    """Run the command line in this process, from a folder; pictures are white unless they are to be drawn."""
    out, err = io.StringIO(), io.StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        patch.chdir(folder)
        patch.setenv("HYDRA_FULL_ERROR", "1")
        for module in () if drawn else ("report.plots",):
            patch.setattr(f"vocc_torch.{module}.save_figure", white)
        patch.setattr(sys, "argv", ["vocc-torch", *map(str, arguments)])
        GlobalHydra.instance().clear()
        try:
            status = cli.run()
        finally:
            GlobalHydra.instance().clear()
    return Ran(status, out.getvalue(), err.getvalue())


def rows_of(path):
    """A CSV file's rows."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def head_of(path):
    """A CSV file's columns."""
    with path.open(newline="", encoding="utf-8") as file:
        return next(csv.reader(file))


def files_in(folder):
    """The files below a folder, by their relative path."""
    return {
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.is_file()
    }


def contents_of(folder, *suffixes):
    """The bytes of all files of some kinds below a folder, by default of all."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and (not suffixes or path.suffix in suffixes)
    }
