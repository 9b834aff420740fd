"""Ledgers and models know the code that made them: the package's own, a plug-in's, and their helpers'."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import vocc_torch
from vocc_torch.errors import VoccError
from vocc_torch.measure import store
from vocc_torch.measure.store import Store
from vocc_torch.plugins import ModuleFile, PlugIn
from vocc_torch.sources import package_digest

LEVEL = """
from helpers.levels import LEVEL


class Level:
    def fit(self, x, bits):
        return self

    def decision_function(self, x):
        return x[..., 0] - LEVEL
"""


@pytest.fixture
def code(tmp_path, monkeypatch):
    """A package and a file of a user's, with a helper each that is not named anywhere."""
    for folder in ("own_package", "own_package/helpers", "helpers"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "__init__.py").write_text("")
        (tmp_path / folder / "levels.py").write_text("LEVEL = 0.5\n")
    (tmp_path / "own_package/parts.py").write_text(
        LEVEL.replace("from helpers", "from own_package.helpers")
    )
    (tmp_path / "mine.py").write_text(LEVEL)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    package_digest.cache_clear()
    for name in [
        name
        for name in sys.modules
        if name.partition(".")[0] in ("own_package", "helpers")
    ]:
        del sys.modules[name]


@pytest.mark.parametrize("target", ["own_package.parts.Level", "mine.py:Level"])
def test_a_helper_of_a_plug_in_is_part_of_its_code(code, target):
    def maker():
        package_digest.cache_clear()
        return PlugIn(
            "c", "level", target if ":" not in target else f"{code}/{target}"
        ).maker

    before = maker()
    (code / "data.csv").write_text("not watched")
    assert maker() == before != ""
    helper = code / (
        "own_package/helpers/levels.py" if ":" not in target else "helpers/levels.py"
    )
    helper.write_text("LEVEL = 0.7\n")
    assert maker() != before


@pytest.mark.parametrize("imports_the_package", [False, True])
def test_helpers_travel_with_a_file_and_the_package_does_not(
    code, monkeypatch, imports_the_package
):
    """Also where the file is named in the working folder, in which the package lies, too."""
    file = code / "mine.py"
    if imports_the_package:
        (code / "vocc_torch").mkdir()
        (code / "vocc_torch/__init__.py").write_text("")
        file.write_text(f"import vocc_torch\n{file.read_text()}")
        monkeypatch.chdir(code)
        file = Path("mine.py")
    helpers = {"helpers/__init__.py", "helpers/levels.py"}
    assert {*ModuleFile(str(file)).texts} == {"mine.py", *helpers}


def test_a_model_of_a_changed_helper_is_refused_and_one_of_a_changed_package_is_not(
    code, monkeypatch
):
    receiver = vocc_torch.train("paper", classifier=f"{code}/mine.py:Level", frames=16)
    receiver.save(code / "level.pt")
    monkeypatch.setattr(
        "vocc_torch.receiver.receiver.package_digest", lambda name: "another"
    )
    assert (
        vocc_torch.Receiver.load(code / "level.pt", [f"{code}/mine.py"]).name == "Level"
    )
    (code / "helpers/levels.py").write_text("LEVEL = 0.7\n")
    with pytest.raises(
        VoccError, match="has other source than the model was made with: train it again"
    ):
        vocc_torch.Receiver.load(code / "level.pt", [f"{code}/mine.py"])


def test_a_ledger_of_other_source_is_refused_in_a_line_that_helps(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    path = Path("a.sqlite")
    with Store.open(path, {"seed": 0}) as ledger:
        ledger.add("near", 0, 64, b"counts")
    with Store.open(path, {"seed": 0}) as ledger:
        assert len(ledger) == 1
    monkeypatch.setattr(store, "package_digest", lambda name: "0123456789abcdef")
    with pytest.raises(
        VoccError, match=r"other source code .*0123456789abcdef.*give another name=$"
    ) as error:
        Store.open(path, {"seed": 0})
    assert "\n" not in str(error.value)


def test_the_digest_is_the_same_from_an_archive_and_with_other_line_endings(tmp_path):
    """As of a wheel that is imported without unpacking."""
    source = Path(vocc_torch.__file__).parent
    (tmp_path / "plain").mkdir()
    with zipfile.ZipFile(tmp_path / "package.zip", "w") as archive:
        for path in sorted((source / "measure").glob("*.py")):
            text = b"" if path.stem == "__init__" else path.read_bytes()
            archive.writestr(f"packed/{path.name}", text.replace(b"\n", b"\r\n"))
            (tmp_path / "plain" / path.name).write_bytes(text)
    words = "from vocc_torch.sources import package_digest as p; print(p('packed') == p('plain'), p('plain'))"
    path = f"{tmp_path}/package.zip:{tmp_path}:{source.parent}"
    done = subprocess.run(
        [sys.executable, "-c", words],
        capture_output=True,
        text=True,
        check=True,
        env={"PYTHONPATH": path},
    )
    assert done.stdout.split()[0] == "True"
