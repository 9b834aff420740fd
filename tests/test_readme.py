"""Python lines of the README, and of the page about plug-ins, run as they stand."""

import csv
import re
from pathlib import Path

from hydra.core.global_hydra import GlobalHydra

from vocc_torch.app.cli import run

README = Path(__file__).parents[1] / "README.md"


def test_python_blocks_run_in_order(tmp_path, monkeypatch, capsys):
    """As they stand."""
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(), flags=re.DOTALL)
    assert len(blocks) == 1
    monkeypatch.chdir(tmp_path)
    exec(blocks[0], {})
    said = capsys.readouterr().out
    rates = [float(rate) for rate in re.findall(r"tensor\(([-.e\d]+)\)", said)]
    assert len(rates) == 1
    assert max(rates) < 0.03
    assert "95 %" in said


def test_the_block_of_the_page_on_following_follows(capsys):
    """A panel that stands still is one panel, in both frames."""
    text = (README.parent / "docs" / "following.md").read_text()
    (block,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    exec(block, {})
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [
        "0",
        "0",
    ]


def test_the_classifier_of_the_page_plugs_in(tmp_path, monkeypatch):
    """With the command that stands below it, on fewer frames."""
    text = (README.parent / "docs" / "plug-ins.md").read_text()
    (tmp_path / "mine.py").write_text(
        re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)[0]
    )
    (command,) = re.findall(r"^vocc-torch (\+classifiers\.mean\S+)$", text, flags=re.M)
    quick = [
        "budget.frames=32",
        "budget.training_frames=64",
        "experiment.values=[4000]",
        "tensorboard=false",
    ]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "sys.argv", ["vocc-torch", *command.split(), "name=own", *quick]
    )
    GlobalHydra.instance().clear()  # what another test has left
    assert run() == 0
    with (tmp_path / "runs/own/ber.csv").open(newline="") as file:
        (row,) = (row for row in csv.DictReader(file) if row["receiver"] == "mean")
    assert float(row["ber"]) < 0.05


def test_pictures_and_pages_exist():
    """No link of the page to a file of this repository is dead."""
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", README.read_text())
    assert len(links) > 8
    for link in links:
        assert (README.parent / link).exists(), link
