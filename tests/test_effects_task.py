"""task=effects at a tiny budget: what it writes, that workers change nothing, and what it refuses."""

import pytest
import yaml
from paper_runs import files_in, head_of, rows_of, run_in

from vocc_torch.studies.effects.effects_csv import COLUMNS, SEVERITY_COLUMNS

SMALL = (
    *("camera.width_px=480", "camera.height_px=272", "camera.sensor_width_mm=3.3"),
    *("scene.offset_x_m=0", "scene.offset_y_m=0"),
)
"""The middle of the paper's sensor: whole frames are a sixteenth of the work."""
TINY = (
    *SMALL,
    *("budget.frames=24", "budget.training_frames=24", "effects.repeats=1"),
    *("effects.located_frames=2", "effects.severity_frames=8"),
)
NAMES = (
    "effects.names=[defocus,shot_noise,blooming]",
    "effects.severity.blooming.values=[1.0,3.0]",
    "effects.severity.shot_noise.values=[0.6,0.006]",
)
BASE = ("task=effects", *TINY, *NAMES)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder for the runs of these tests."""
    return tmp_path_factory.mktemp("effects")


@pytest.fixture(scope="module")
def whole(place):
    """Three effects in this process, with a board."""
    ran = run_in(place, *BASE, "name=whole", "workers=1")
    assert (ran.status, ran.err) == (0, "")
    return place / "runs" / "whole", ran.out


def test_everything_is_written(whole):
    folder, out = whole
    written = {name for name in files_in(folder) if not name.startswith("tensorboard/")}
    assert written == {
        *(
            "config.yaml",
            "effects.csv",
            "effects.png",
            "effects.md",
            "gallery.png",
            "severity.csv",
            "severity.png",
        ),
    }
    assert (folder / "tensorboard" / "_summary").is_dir()
    for told in (
        "the scene itself",
        "defocus",
        "shot_noise",
        "blooming",
        "sum of these costs",
        "all together",
    ):
        assert told in out
    for name in ("effects.csv", "effects.md", "severity.png"):
        assert str(folder / name) in out
    for name in ("effects.png", "severity.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
        assert f"]({name})" in (folder / "effects.md").read_text()


def test_settings_are_those_of_the_task(whole):
    settings = yaml.safe_load((whole[0] / "config.yaml").read_text())
    assert settings["receiver"]["names"] == ["flda_3"]
    assert settings["effects"]["names"] == ["defocus", "shot_noise", "blooming"]
    assert settings["effects"]["parts"]["shot_noise"]["photoelectrons"] == {"quantum_efficiency": 0.6}
    assert settings["effects"]["severity"]["jpeg"]["values"][-1] == 10
    assert settings["effects"]["severity"]["jpeg"]["parameter"] == "jpeg.quality"


def test_rows_are_in_physical_order(whole):
    rows = rows_of(whole[0] / "effects.csv")
    assert head_of(whole[0] / "effects.csv") == list(COLUMNS)
    assert [(row["row"], row["effect"]) for row in rows] == [
        ("scene", ""),
        *(("effect", name) for name in ("defocus", "blooming", "shot_noise")),
        ("sum", ""),
        ("together", "all together"),
    ]
    assert {row["scene"] for row in rows} == {"paper"}
    by_name = {row["effect"]: row for row in rows}
    assert by_name["defocus"]["settings"] == "focus_distance_m=10"
    assert (by_name["blooming"]["in_scene"], by_name["shot_noise"]["fills_sensor"]) == ("1", "1")
    assert by_name["all together"]["differs_in"] == "defocus + shot_noise"
    assert by_name["all together"]["companions"] == "photoelectrons + gain"
    assert {row["true_corners_frames"] for row in rows if row["row"] == "effect"} == {"24"}
    assert [by_name[name]["located_frames"] for name in ("defocus", "shot_noise")] == ["24", "2"]


def test_severities_are_in_the_order_of_growing_severity(whole):
    rows = rows_of(whole[0] / "severity.csv")
    assert head_of(whole[0] / "severity.csv") == list(SEVERITY_COLUMNS)
    defocus = [row for row in rows if row["effect"] == "defocus" and row["trained"] == "without"]
    assert [row["value"] for row in defocus] == ["30", "15", "10", "6", "4"]
    assert [row["in_table"] for row in defocus] == ["0", "0", "1", "0", "0"]
    assert {row["frames"] for row in rows} == {"8"}
    assert [row["effect"] for row in rows if row["order"] == "0" and row["trained"] == "with"] == [
        *("defocus", "blooming", "shot_noise"),
    ]


def test_workers_and_other_receivers_change_no_number(whole, place):
    ran = run_in(
        place,
        *(*BASE, "name=others", "workers=2", "tensorboard=false", "effects.severity_frames=0"),
        "receiver.names=[center_greyscale,flda_3]",
    )
    assert (ran.status, ran.err) == (0, "")
    folder = place / "runs" / "others"
    assert files_in(folder) == {"config.yaml", "effects.csv", "effects.png", "effects.md", "gallery.png"}
    rows = rows_of(folder / "effects.csv")
    assert {row["receiver"] for row in rows} == {"center_greyscale", "flda_3"}
    counted = [name for name in COLUMNS if name.startswith(("true_corners_", "retrained_", "located_"))]
    counted = [name for name in counted if not name.endswith("ms")]
    mine = [[row[name] for name in counted] for row in rows if row["receiver"] == "flda_3"]
    alone = [[row[name] for name in counted] for row in rows_of(whole[0] / "effects.csv")]
    assert mine == alone


def test_a_scene_that_names_effects_keeps_its_own(place):
    """On a scene with noise the effects that it has are taken away, with the scene's own parameters."""
    ran = run_in(
        place,
        *("task=effects", *TINY, "scene=night", "name=night", "workers=1", "tensorboard=false"),
        *("effects.names=[read_noise,defocus]", "effects.located_frames=0", "effects.severity_frames=0"),
    )
    assert (ran.status, ran.err) == (0, "")
    rows = {row["effect"]: row for row in rows_of(place / "runs" / "night" / "effects.csv")}
    assert (rows["read_noise"]["in_scene"], rows["read_noise"]["differs_in"]) == ("1", "read_noise")
    assert (rows["defocus"]["in_scene"], rows["defocus"]["fills_sensor"]) == ("0", "0")
    assert rows["all together"]["differs_in"] == "defocus"
    assert rows["defocus"]["located_frames"] == ""


def test_a_folder_with_results_is_refused(whole, place):
    before = files_in(whole[0])
    complaint = run_in(place, *BASE, "name=whole").complaint
    assert "runs/whole already holds" in complaint
    assert files_in(whole[0]) == before


def test_a_failed_run_leaves_nothing(place, monkeypatch):
    """Nothing is written before everything is measured."""

    def fail(*_, **__):
        raise MemoryError

    monkeypatch.setattr("vocc_torch.studies.effects.run.run_effects", fail)
    ran = run_in(place, *BASE, "name=failed", "workers=1")
    assert "not enough memory" in ran.complaint
    assert not (place / "runs" / "failed").exists()


MISTAKES = {
    "unknown effect": (
        ["effects.names=[blomming]"],
        ["effects.names has 'blomming'", "did you mean blooming?"],
    ),
    "unknown key": (
        ["effects.nmes=[blooming]"],
        ["effects.nmes is not a known key", "did you mean effects.names?"],
    ),
    "unknown part": (["+effects.parts.fogg={airlight:{visibility_m:9}}"], ["effects.parts has 'fogg'"]),
    "part that is no mapping": (["effects.parts.jpeg=3"], ["effects.parts.jpeg is 3", "mapping of effects"]),
    "effect that is no mapping": (["effects.parts.jpeg.jpeg=3"], ["effects.parts.jpeg.jpeg is 3", "mapping"]),
    "effect that is null": (["effects.parts.jpeg.jpeg=null"], ["effects.parts.jpeg.jpeg is null"]),
    "value of a part": (
        ["effects.parts.jpeg.jpeg.quality=0"],
        ["effects.parts.jpeg.jpeg.quality is 0", "1 to 100"],
    ),
    "severity outside its range": (
        ["effects.severity.jpeg.values=[90,0]"],
        ["effects.severity.jpeg.values has 0", "1 to 100"],
    ),
    "severity that is no number": (
        ["effects.severity.jpeg.values=[90,low]"],
        ["effects.severity.jpeg.values has 'low'", "finite numbers"],
    ),
    "severity of another effect": (
        ["effects.severity.jpeg.parameter=defocus.focus_distance_m"],
        ["effects.severity.jpeg.parameter", "it must be effect.parameter of one of"],
    ),
    "repeats": (["effects.repeats=0"], ["effects.repeats is 0", "at least 1"]),
    "stop rule": (["budget.precision=0.1"], ["budget.precision is 0.1", "must be null"]),
    "frames": (["budget.frames=0"], ["budget.frames is 0"]),
    "workers": (["workers=-1"], ["workers is -1"]),
    "input": (["input=photo.png"], ["input is 'photo.png'"]),
}


@pytest.mark.parametrize(("arguments", "parts"), MISTAKES.values(), ids=MISTAKES.keys())
def test_mistakes_are_one_line_and_leave_nothing(tmp_path, arguments, parts):
    complaint = run_in(tmp_path, "task=effects", *arguments).complaint
    for part in parts:
        assert part in complaint
    assert list(tmp_path.iterdir()) == []
