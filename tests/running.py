"""The command line in this process and in one of its own."""

import contextlib
import io
import os
import subprocess
import sys
from dataclasses import dataclass

import pytest
from hydra.core.global_hydra import GlobalHydra
from matplotlib.figure import Figure
from PIL import Image

from vocc_torch.app import cli


@dataclass(frozen=True)
class Ran:
    """What a command left."""

    status: int
    out: str
    err: str

    @property
    def complaint(self):
        """The one line of an error, checked to be just that."""
        assert self.status == 2, (self.status, self.err)
        assert self.err.count("\n") == 1, self.err
        assert self.err.startswith("vocc-torch: error: "), self.err
        assert "Traceback" not in self.out + self.err
        return self.err.removeprefix("vocc-torch: error: ").rstrip("\n")


def white(figure, path, **options):
    """Save a figure as one white pixel: drawing takes longer than a tiny study."""
    Image.new("RGBA", (1, 1), "white").save(path, format="PNG")


def run_here(*arguments, drawn=False):
    """Run the command line in this process; figures are white unless they are to be drawn."""
    out, err = io.StringIO(), io.StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        # So that the command line's own setting is undone.
        patch.setenv("HYDRA_FULL_ERROR", "1")
        if not drawn:
            patch.setattr(Figure, "savefig", white)
        patch.setattr(sys, "argv", ["vocc-torch", *map(str, arguments)])
        GlobalHydra.instance().clear()
        try:
            status = cli.run()
        finally:
            GlobalHydra.instance().clear()
    return Ran(status, out.getvalue(), err.getvalue())


def run_in(folder, *arguments, drawn=False):
    """Run the command line in this process, from a folder."""
    with contextlib.chdir(folder):
        return run_here(*arguments, drawn=drawn)


def run_apart(*arguments, cwd, code=None, environment=None, stdin=None):
    """Run ``python -m vocc_torch`` from ``cwd``; ``code`` is run instead of ``-m vocc_torch``."""
    start = ["-m", "vocc_torch"] if code is None else ["-c", code]
    done = subprocess.run(
        [sys.executable, *start, *map(str, arguments)],
        cwd=cwd,
        env={**os.environ, "OMP_NUM_THREADS": "1", **(environment or {})},
        stdin=stdin,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    return Ran(done.returncode, done.stdout, done.stderr)
