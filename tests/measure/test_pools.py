"""What a worker does with a call that comes as bytes: its answer, its refusals, and the user's files."""

import pickle
import sys

import pytest

from vocc_torch import plugins
from vocc_torch.errors import VoccError
from vocc_torch.measure.pools import about_run, called


@pytest.fixture(autouse=True)
def no_files(monkeypatch):
    """Each test begins without the plug-in files that other tests have run."""
    for name in ("READ", "COPIES", "EXPECTED"):
        monkeypatch.setattr(plugins, name, {})


def test_a_node_of_another_release_is_refused_by_its_name():
    expected, files = pickle.loads(about_run("ray"))
    other = pickle.dumps((expected.replace("torch ", "torch 9"), files))
    well, error = pickle.loads(called(other, pickle.dumps(abs), pickle.dumps(-3)))
    assert (well, type(error)) == (False, VoccError)
    assert f"has {expected}, and this run vocc_torch 9" in str(error)
    assert str(error).endswith(": give every node the same releases")


class StubbornError(Exception):
    """An error that no other process can read."""

    def __reduce__(self):
        return int, ("no number",)


def fail(kind):
    raise kind("why")


@pytest.mark.parametrize(
    ("kind", "arrived"),
    [
        (VoccError, VoccError),
        (MemoryError, MemoryError),
        (StubbornError, RuntimeError),
    ],
)
def test_an_error_of_a_call_comes_back_as_a_value(kind, arrived):
    well, error = pickle.loads(
        called(about_run("ray"), pickle.dumps(fail), pickle.dumps(kind))
    )
    assert (well, type(error)) == (False, arrived)
    assert str(error).strip().endswith("why")


def test_the_users_files_go_along_to_another_machine(tmp_path, monkeypatch):
    """With what they import from beside them; there they are read from the copies."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    path = tmp_path / "mine_to_carry.py"
    monkeypatch.syspath_prepend(str(tmp_path))
    path.write_text("from beside_to_carry import TWO\nANSWER = 40 + TWO")
    (tmp_path / "beside_to_carry.py").write_text("TWO = 2")
    digest, answer = (
        plugins.ModuleFile(str(path)).digest,
        plugins.ModuleFile(str(path)).named("ANSWER"),
    )
    (_, files) = pickle.loads(about_run("ray"))
    with pytest.raises(
        VoccError,
        match=r"executor.kind is dask: .*mine_to_carry.py cannot go with dask",
    ):
        about_run("dask")
    text = path.read_text()
    path.write_text("ANSWER = 43")
    with pytest.raises(
        VoccError, match=r"mine_to_carry.py has changed since this run began"
    ):
        about_run("ray")
    # There, neither file lies where it was.
    path.unlink()
    (tmp_path / "beside_to_carry.py").unlink()
    for name in [one for one in sys.modules if "to_carry" in one]:
        monkeypatch.delitem(sys.modules, name)
    plugins.receive(files)
    there = plugins.ModuleFile(str(path))
    assert (there.digest, there.named("ANSWER"), there.place.read_text()) == (
        digest,
        answer,
        text,
    )
