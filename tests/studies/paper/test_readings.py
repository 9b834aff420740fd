"""Readings as data: what ships, a user's own file, and what is refused."""

import pytest
from composing import composed
from running import run_in

from vocc_torch.errors import VoccError
from vocc_torch.studies.paper.readings import load_readings, parsed

ASK = ("task=figures", "figures.names=[fig22]", "name=refused")


@pytest.mark.parametrize(
    ("readings", "complaint"),
    [
        (
            "[nobody]",
            "figures.readings is 'nobody': it must be one of board, board_true",
        ),
        ("[board,board]", "at least one reading, each once"),
        ("[none.yaml]", "figures.readings none.yaml cannot be read"),
        (
            "[odd.yaml]",
            "figures.readings: odd.yaml is 'odd.yaml': it must be a name with why: and set: below it",
        ),
        (
            "[seed.yaml]",
            "figures.readings.mine.a key is 'seed': it must be one that begins with scene, camera",
        ),
        (
            "[typo.yaml]",
            "figures.readings.mine.camera.focal_mm is not a known key: did you mean camera.focal_length_mm?",
        ),
        (
            "[laughs.yaml]",
            "figures.readings: laughs.yaml cannot be read: it has an alias",
        ),
        ("[far.yaml]", "figures.readings.mine.panel.board_reflectance is 7"),
    ],
)
def test_a_reading_that_cannot_be_used_is_refused_in_one_line(
    tmp_path, readings, complaint
):
    (tmp_path / "odd.yaml").write_text("- 1\n")
    (tmp_path / "seed.yaml").write_text("mine: {why: w, set: {seed: 1}}\n")
    (tmp_path / "typo.yaml").write_text("mine: {why: w, set: {camera.focal_mm: 25}}\n")
    (tmp_path / "laughs.yaml").write_text("a: &a [x]\nb: [*a, *a]\n")
    (tmp_path / "far.yaml").write_text(
        "mine: {why: w, set: {panel.board_reflectance: 7}}\n"
    )
    ended = run_in(tmp_path, *ASK, f"figures.readings={readings}")
    assert complaint in ended.complaint
    assert not (tmp_path / "runs").exists()


def test_a_name_that_is_no_word_is_refused():
    with pytest.raises(VoccError, match="a word of letters"):
        parsed("'a/b': {why: w, set: {}}", "mine.yaml")


def test_a_reading_of_an_effect_applies_where_the_scene_has_it(tmp_path):
    settings = composed(*ASK[:2])
    (pixels,) = load_readings(["pixels"], settings)
    assert pixels.plan.world.effects["blooming"]["reach_sigmas"] == 2
    without = composed(*ASK[:2], "~scene.effects.blooming")
    (pixels,) = load_readings(["pixels"], without)
    assert "blooming" not in pixels.plan.world.effects
    (tmp_path / "typo.yaml").write_text(
        "mine: {why: w, set: {scene.effects.bloming.sigma_px: 1}}\n"
    )
    with pytest.raises(VoccError, match="bloming is not"):
        load_readings([str(tmp_path / "typo.yaml")], without)
