"""The public functions: what they give is what the command line gives."""

import csv
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from types import FunctionType

import pytest
from hydra.core.global_hydra import GlobalHydra

import vocc_torch as vt
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.reader import Reader


def test_what_is_public():
    assert {"load_scene", "train", "measure", "simulate", "Receiver"} <= set(dir(vt))
    assert all(getattr(vt, name).__doc__ for name in dir(vt) if name != "__version__")


def test_measure_is_a_function_although_a_package_has_its_name():
    import_module("vocc_torch.measure.counts")
    assert isinstance(vt.measure, FunctionType)
    assert vt.Decoded._fields[0] == "bits"


def test_measure_counts_what_the_command_line_counts(app, tmp_path):
    words = (
        "experiment=scenes",
        "experiment.values=[50,70]",
        "scene.distance_m=60",
        "seed=3",
        "name=x",
    )
    words += (
        "classifier=lmmse",
        "receiver.names=[flda_3]",
        "tensorboard=false",
        "device=cpu",
    )
    ran = app(*words, "budget.frames=64", "budget.training_frames=64")
    assert ran.status == 0, ran.err
    with (tmp_path / "runs" / "x" / "ber.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    wanted = {
        (row["receiver"], float(row["value"])): float(row["bit_errors"]) for row in rows
    }
    scene, seen = vt.load_scene("paper", "scene.distance_m=60", "device=cpu"), []
    receivers = {
        name: vt.train(scene, classifier=name, frames=64, seed=3)
        for name in ("flda_3", "lmmse")
    }
    table = vt.measure(
        receivers, scene, "distance_m", [50, 70], 64, seed=3, progress=seen.append
    )
    assert {(row.receiver, row.value): row.bit_errors for row in table.rows} == wanted
    assert sum(wanted.values()) > 0
    assert sum(seen) == 128
    # The classifier, not FLDA.
    kept = vt.Receiver.load(tmp_path / "runs" / "x" / "receiver.pt")
    own = receivers["lmmse"]
    assert (kept.name, kept.calibration, kept.trained_on) == (
        own.name,
        own.calibration,
        own.trained_on,
    )
    table.to_csv(tmp_path / "ber.csv")
    with (tmp_path / "ber.csv").open(newline="") as file:
        assert sorted(float(row["ber"]) for row in csv.DictReader(file)) == sorted(
            r.ber for r in table.rows
        )
    assert table.plot(tmp_path / "ber.png").axes
    for call, path, says in (
        (
            table.to_csv,
            "/dev/null",
            "cannot write /dev/null: it must be an ordinary file",
        ),
        (table.to_csv, tmp_path / "no/ber.csv", "no is no folder"),
        (table.to_csv, 3, "path is 3"),
        (table.plot, tmp_path / "ber.exe", "has no known image format"),
        (table.plot, tmp_path / "no/ber.png", "no is no folder"),
    ):
        with pytest.raises(vt.VoccError, match=says):
            call(path)
    assert not (tmp_path / "no").exists()
    assert "95 %" in str(table)


def test_measure_sorts_frames_by_contrast_into_bins():
    """The bins share the frames of one run; a frame outside of them is not counted."""
    receiver = vt.train("paper", frames=64)
    table = vt.measure(receiver, "paper", "contrast", [0.0, 0.2, 0.5], frames=64)
    assert [row.value for row in table.rows] == [0.1, 0.35]
    assert all(0 < row.frames < 128 for row in table.rows)
    assert sum(row.frames for row in table.rows) <= 128


def test_scenes_are_loaded_from_many_threads_and_hydra_is_left_alone():
    words = (
        "+scene.effects.pose={yaw_deg:[uniform,-5,5]}",
        "~scene.effects.blooming",
        "panel.rows=4",
    )
    wanted = vt.load_scene("night", *words)
    assert wanted.panel.shape.rows == 4
    assert {"pose", "shot_noise"} <= {*wanted.effects}
    assert "blooming" not in wanted.effects
    hydra = GlobalHydra.instance().hydra
    with ThreadPoolExecutor(8) as pool:
        loaded = list(pool.map(lambda _: vt.load_scene("night", *words), range(16)))
    assert all(world == wanted for world in loaded)
    assert GlobalHydra.instance().hydra is hydra


ENDLESS: dict[str, object] = {}
ENDLESS["effects"] = ENDLESS

FRESH = vt.Receiver("flda_3", PaperLocator(), Reader(), vt.FLDA(3))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: vt.load_scene("nihgt"), "scene is 'nihgt': did you mean night?"),
        (lambda: vt.load_scene("nowhere.yaml"), "scene nowhere.yaml cannot be read"),
        (lambda: vt.load_scene({"distance_m": -3}), "scene.distance_m"),
        (lambda: vt.load_scene({"colour": 1}), "scene.colour is not a known key"),
        (lambda: vt.load_scene(ENDLESS), "it must be a value of at most 32 levels"),
        (
            lambda: vt.load_scene({"effects": {"rain": {}}}),
            "scene.effects.rain is not a known effect",
        ),
        (
            lambda: FRESH.save("no/folder.pt"),
            "cannot write no/folder.pt: no is no folder",
        ),
        (lambda: FRESH.save("/dev/null"), "it must be an ordinary file"),
        (
            lambda: vt.train("paper", classifier="lmse"),
            "classifier is 'lmse': did you mean lmmse? known:",
        ),
        (lambda: vt.train("paper", locator="refind"), "locator is 'refind'"),
        (lambda: vt.train("paper", features=["agr", "colour"]), "features is"),
        (lambda: vt.train("paper", frames=1), "frames is 1: it must be at least 2"),
        (
            lambda: vt.load_scene("paper", "camera.gama=2"),
            "camera.gama is not a known key: did you mean",
        ),
        (
            lambda: vt.load_scene("paper", "budget.frames=2"),
            "budget.frames is not a known key",
        ),
        (
            lambda: vt.load_scene("paper", "panel.rows=1,2"),
            "panel.rows is 1,2: it must be one value",
        ),
        (
            lambda: vt.load_scene("paper", "panel.rows=[1"),
            "panel.rows=[1 cannot be read",
        ),
        (
            lambda: vt.load_scene("paper", "scene.effects={}"),
            "scene.effects={} takes none away",
        ),
        (
            lambda: vt.load_scene("paper", "~scene.effects.fog"),
            "scene.effects.fog is not set",
        ),
        (
            lambda: vt.load_scene("dashcam", "camera.f_number=2"),
            "camera.f_number is set by the scene",
        ),
        (
            lambda: vt.measure(FRESH, "paper", "colour", [1]),
            "experiment.axis is 'colour'",
        ),
        (lambda: vt.measure({}, "paper", "distance_m", [50]), "receivers is {}"),
    ],
)
def test_mistakes_are_one_line_that_names_the_argument(call, says):
    with pytest.raises(vt.VoccError) as error:
        call()
    assert "\n" not in str(error.value)
    assert says in str(error.value)
