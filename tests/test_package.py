"""The wheel holds all that the package needs, and works where the repository is not."""

import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import pytest

import vocc_torch

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Build the wheel from a copy, so that nothing of an earlier build gets in."""
    if (
        find_spec("pip") is None
        or find_spec("setuptools") is None
        or int(version("setuptools").split(".")[0]) < 77
    ):
        pytest.skip("building a wheel offline needs pip and setuptools 77 or later")
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    skipped = shutil.ignore_patterns("__pycache__")
    for name in ("vocc_torch", "conf"):
        shutil.copytree(ROOT / name, source / name, ignore=skipped)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source / name)
    pip(f"wheel {source} --no-deps --no-build-isolation --quiet --wheel-dir {folder}")
    (built,) = folder.glob("*.whl")
    return built


def pip(arguments):
    """Run pip, quietly and offline."""
    command = [
        sys.executable,
        "-m",
        "pip",
        "--disable-pip-version-check",
        *arguments.split(),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_wheel_holds_every_module_and_configuration(wheel):
    with zipfile.ZipFile(wheel) as archive:
        inside = set(archive.namelist())
    ours = [
        path
        for path in (ROOT / "vocc_torch").rglob("*.*")
        if "__pycache__" not in path.parts
    ]
    modules = {path.relative_to(ROOT).as_posix() for path in ours}
    conf = {
        f"vocc_torch/{path.relative_to(ROOT).as_posix()}"
        for path in (ROOT / "conf").rglob("*.yaml")
    }
    wanted = modules | conf | {"vocc_torch/conf/__init__.py"}
    assert len(conf) > 10
    assert wanted - inside == set()
    # No tests, runs or pictures.
    assert {name.split("/")[0].split("-")[0] for name in inside} == {"vocc_torch"}
    assert not [name for name in inside if name.endswith((".png", ".pyc"))]


def test_wheel_carries_the_licence_and_the_command(wheel):
    with zipfile.ZipFile(wheel) as archive:
        about = {
            Path(name).name: archive.read(name).decode()
            for name in archive.namelist()
            if ".dist-info/" in name
        }
    assert "vocc-torch = vocc_torch.__main__:main" in about["entry_points.txt"]
    assert "License-Expression: Apache-2.0" in about["METADATA"]
    assert "Apache License" in about["LICENSE"]


def test_versions_agree():
    assert vocc_torch.__version__ == PROJECT["project"]["version"]


def test_public_names_are_there():
    for name in vocc_torch.__all__:
        assert getattr(vocc_torch, name).__name__.rpartition(".")[2] == name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = vocc_torch.nothing


def test_installed_wheel_runs_from_anywhere(wheel, command, tmp_path):
    """A tiny run, from the installed files alone and not from the repository."""
    site, away = tmp_path / "site", tmp_path / "away"
    away.mkdir()
    pip(f"install --no-deps --no-index --no-compile --quiet --target {site} {wheel}")
    code = "from vocc_torch import conf\nfrom vocc_torch.app import cli\nprint(conf.__file__, cli.run())"
    tiny = ("task=train", "budget.training_frames=8", "name=x")
    ran = command(*tiny, cwd=away, code=code, environment={"PYTHONPATH": str(site)})
    place, status = ran.out.splitlines()[-1].split()
    assert (ran.status, ran.err, status) == (0, "", "0")
    assert Path(place).is_relative_to(site)
    assert (away / "runs" / "x" / "receiver.pt").exists()
