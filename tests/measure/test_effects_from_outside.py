"""Effects and backdrops from outside in whole runs: workers, jobs, a kill between, and code that changed."""

import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = ("examples/effects/streak.py", "examples/backdrops/photograph.py")
SHORT = (
    "budget.frames=128",
    "budget.training_frames=64",
    "receiver.names=[flda_3]",
    "receiver.locator=truth",
)
SHORT += (
    "experiment.values=[1000]",
    "experiment.scene.distance_m=66",
    "tensorboard=false",
    "name=x",
)


@pytest.fixture
def mine(tmp_path):
    """The examples as a user's own files, and the words that name them."""
    for path in EXAMPLES:
        shutil.copy(ROOT / path, tmp_path)
    shutil.copy(ROOT / "tests/data/led-panel-8x8-photo.png", tmp_path / "street.png")
    streak = (
        "+scene.effects.smear._target_=streak.py:Streak",
        "+scene.effects.smear.share=0.4",
    )
    street = (
        "+scene.effects.street._target_=photograph.py:Photograph",
        "+scene.effects.street.file=street.png",
    )
    return (*streak, *street)


def test_a_ledger_of_other_code_or_of_another_picture_is_refused(app, mine, tmp_path):
    folder = tmp_path / "runs" / "x"
    assert app(*SHORT, *mine).status == 0
    (folder / "ber.csv").rename(tmp_path / "kept.csv")
    assert app(*SHORT, *mine).out.startswith("resuming: 2 blocks")
    assert (folder / "ber.csv").read_bytes() == (tmp_path / "kept.csv").read_bytes()
    shutil.copytree(folder, tmp_path / "copy")
    for name, key in (
        ("streak.py", "effects.smear"),
        ("street.png", "effects.street.file"),
    ):
        before = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(before + b"\n")
        said = app(*SHORT, *mine).complaint
        assert f"ledger.sqlite: {key} was " in said
        assert "go back, or give another name=" in said
        (tmp_path / name).write_bytes(before)
    said = app(*SHORT, *mine, "+scene.effects.smear.after=blooming").complaint
    assert "effects.smear.after was null, is blooming" in said
