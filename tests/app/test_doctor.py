"""``vocc-torch doctor``: every line says what there is, and what to do where something is missing."""

import sys

import pytest

from vocc_torch import __main__
from vocc_torch.app import doctor


def test_a_healthy_machine(capsys, monkeypatch, tmp_path):
    """The test environment has all but the extras that it does without."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["vocc-torch", "doctor"])
    with pytest.raises(SystemExit) as ended:
        __main__.main()
    lines = capsys.readouterr().out.splitlines()
    assert ended.value.code == 0
    assert len(lines) < 24
    assert all(line.startswith(("ok  ", "--  ")) for line in lines)
    assert all(": " in line for line in lines if line.startswith("--"))
    assert "0 of 64 bits of a drawn panel are wrong" in "\n".join(lines)
    assert not list(tmp_path.iterdir())


def test_missing_extras_are_named_with_the_line_that_installs_them(capsys, monkeypatch):
    wanted = ["torch>=2", 'av>=999; extra == "video"', 'pytest; extra == "test"']
    monkeypatch.setattr(doctor, "requires", lambda _: wanted)
    doctor.say_extras()
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("--  video ")
    assert "pip install 'vocc-torch[video]'" in line
