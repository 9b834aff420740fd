"""``task=export``: the package's own frames, with their truth, whatever ends the run or shares it out."""

import shutil
import signal
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest
from pycocotools.coco import COCO
from run_files import contents_of, rows_of
from running import run_in

from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.studies.export import run as export
from vocc_torch.studies.export import truth
from vocc_torch.types import Scene

SMALL = ("camera.width_px=480", "camera.height_px=272", "camera.sensor_width_mm=3.3")
CENTRED = ("scene.offset_x_m=[uniform,-0.1,0.1]", "scene.offset_y_m=0")
KINDS = {
    "noisy crops": ("scene=night", "export.frames=70", "batch_frames=7"),
    "points": (
        "export.points=test",
        "experiment=distance",
        "experiment.values=[30,50]",
        "export.frames=10",
    ),
    "whole": (
        *SMALL,
        *CENTRED,
        "+scene.effects.pose={yaw_deg:20,roll_deg:10}",
        "framing=full",
        "export.frames=5",
    ),
    "filled": (*SMALL, *CENTRED, "framing=filled", "export.frames=5"),
    "three colours": (
        "+scene.effects.colour={second_nm:525,third_nm:470}",
        "export.frames=66",
    ),
}


def words_of(*words, name="x"):
    return (
        "task=export",
        "device=cpu",
        "export.shard_frames=64",
        f"name={name}",
        *words,
    )


def files_of(folder):
    """Every file but the configuration, which says by how many workers."""
    files = contents_of(folder)
    del files["config.yaml"]
    return files


def corners_of(row):
    return np.array(
        [
            [float(row[f"{axis}_{corner}"]) for axis in "xy"]
            for corner in truth.KEYPOINTS
        ]
    )


@pytest.mark.parametrize("words", KINDS.values(), ids=KINDS)
def test_pictures_are_the_simulators_and_the_truth_is_that_of_its_scenes(
    app, tmp_path, monkeypatch, words
):
    """Bit by bit, drawn block by block by the same keys; OpenCV and COCO's own reader read them."""
    plans, build_plan = [], export.build.build_plan
    monkeypatch.setattr(
        export.build,
        "build_plan",
        lambda *given: plans.append(build_plan(*given)) or plans[0],
    )
    assert app(*words_of(*words)).err == ""
    folder = tmp_path / "runs" / "x"
    (plan,), rows = plans, iter(rows_of(folder / "truth.csv"))
    coco, simulator = COCO(str(folder / "coco.json")), plan.world.simulator()
    images, crop = iter(coco.loadImgs(coco.getImgIds())), plan.world.framing == "crop"
    points = "test" if "export.points=test" in words else "train"
    count = int(next(word for word in words if "export.frames" in word)[14:])
    for point, model in export.sweep.scenes_of(plan, points).items():
        for block in range(-(-count // 64)):
            key, most = BlockKey(plan.seed, point, block), min(64, count - 64 * block)
            scene, bits = (
                one[:most] for one in model.draw(key, plan.world.panel.shape)
            )
            keys = [FrameKey(key, frame) for frame in range(most)]
            seen = simulator.render(
                scene, bits, nearest_m=model.nearest_m, keys=keys, panel_only=crop
            )
            true = simulator.true_panels(scene, keys).corners_px
            corners = (true - seen.origin_px[:, None]).numpy()
            sent = {"bits": bits} | {
                f"bits_{name}": values
                for name, values in simulator.further_bits(scene, keys).items()
            }
            for frame in range(most):
                row, image = next(rows), next(images)
                picture = cv2.imread(str(folder / row["file"]), cv2.IMREAD_UNCHANGED)
                # Blue first, as OpenCV has it.
                shown = picture if picture.ndim == 2 else picture[..., ::-1]
                assert np.array_equal(shown, seen.pixels[frame])
                assert np.array_equal(corners_of(row), corners[frame])
                origin = dict(zip("xy", seen.origin_px[frame].tolist(), strict=True))
                stated = {"seed": 0, "point": point, "block": block, "frame": frame}
                stated |= {f"origin_{axis}_px": at for axis, at in origin.items()}
                assert {name: row[name] for name in stated} == {
                    name: str(value) for name, value in stated.items()
                }
                values = {
                    name: float(getattr(scene, name)[frame])
                    for name in Scene.__dataclass_fields__
                }
                assert {name: float(row[name]) for name in values} == values
                assert {name: image[name] for name in values} == values
                assert image["file_name"] == row["file"]
                assert (image["height"], image["width"]) == picture.shape[:2]
                (annotation,) = coco.loadAnns(coco.getAnnIds(imgIds=[image["id"]]))
                keypoints = np.array(annotation["keypoints"]).reshape(4, 3)
                assert np.array_equal(keypoints[:, :2], corners[frame])
                assert (keypoints[:, 2] == 2).all()
                for name in ("bits", "bits_second", "bits_third"):
                    shown = sent[name][frame].flatten().int() if name in sent else []
                    text = "".join(str(int(bit)) for bit in shown)
                    assert row[name] == annotation.get(name, "") == text
    assert next(rows, next(images, None)) is None
    assert coco.loadCats(coco.getCatIds())[0]["keypoints"] == list(truth.KEYPOINTS)


def test_the_outline_is_the_panel_and_the_bits_are_its_leds_row_by_row(app, tmp_path):
    """By pycocotools' masks, and by the pictures alone: near and in the dark an On LED is the brighter."""
    scene = (
        "scene.distance_m=30",
        "scene.ambient_lx=1000",
        "+scene.effects.pose={roll_deg:8}",
    )
    assert app(*words_of(*scene, "export.frames=3")).status == 0
    coco = COCO(str(tmp_path / "runs/x/coco.json"))
    for one in coco.loadAnns(coco.getAnnIds()):
        (image,) = coco.loadImgs(one["image_id"])
        grey = cv2.imread(
            str(tmp_path / "runs/x" / image["file_name"]), cv2.IMREAD_UNCHANGED
        )
        assert coco.annToMask(one).sum() == pytest.approx(one["area"], rel=0.05)
        assert one["bbox"] == pytest.approx(
            cv2.boundingRect(coco.annToMask(one)), abs=1.5
        )
        corners = np.array(one["keypoints"]).reshape(4, 3)[:, :2].astype(np.float32)
        square = np.array([(0, 0), (8, 0), (8, 8), (0, 8)], dtype=np.float32)
        centres = np.stack(
            np.meshgrid(np.arange(8) + 0.5, np.arange(8) + 0.5), axis=-1
        ).reshape(-1, 1, 2)
        at = cv2.perspectiveTransform(
            centres, cv2.getPerspectiveTransform(square, corners)
        )[:, 0]
        greys = np.array([grey[int(y), int(x)] for x, y in at])
        on = np.array([bit == "1" for bit in one["bits"]])
        assert greys[on].min() > greys[~on].max()


LONG = "export.frames=1000"


@pytest.mark.slow
def test_a_killed_run_of_two_workers_goes_on_in_one_to_the_bytes_of_an_undisturbed_one(
    app, tmp_path
):
    assert app(*words_of(LONG, name="y")).status == 0
    begin = [sys.executable, "-m", "vocc_torch", *words_of(LONG, "workers=2")]
    process = subprocess.Popen(begin, cwd=tmp_path, stdout=subprocess.DEVNULL)
    folder = tmp_path / "runs" / "x"
    while not list(folder.glob("frames/**/manifest.json")) and process.poll() is None:
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (folder / "truth.csv").exists()
    half = folder / "frames/train/.0000896.999999999-0.tmp"  # as a worker leaves it
    half.mkdir(exist_ok=True)
    (half / "0000960.png").write_bytes(b"another")
    assert "resuming" in app(*words_of(LONG)).out
    assert files_of(folder) == files_of(tmp_path / "runs" / "y")
    assert len(list(folder.rglob("*.png"))) == 1000 + 1


def shorten(path):
    path.write_bytes(path.read_bytes()[:100])


def a_picture_is_deleted_and_a_truth_cut(train):
    (train / "0000064/0000070.png").unlink()
    shorten(train / "0000000/truth.csv")


def a_picture_is_another_and_a_manifest_damaged(train):
    other = (train / "0000064/0000071.png").read_bytes()
    (train / "0000064/0000070.png").write_bytes(other)
    shorten(train / "0000128/manifest.json")


def a_shard_is_deleted_and_a_manifest_names_another(train):
    shutil.rmtree(train / "0000064")
    (train / "0000128/manifest.json").write_text('{"../0000064/0000070.png": [1, "a"]}')


DAMAGES = (
    a_picture_is_deleted_and_a_truth_cut,
    a_picture_is_another_and_a_manifest_damaged,
    a_shard_is_deleted_and_a_manifest_names_another,
)


THREE_SHARDS = ("export.frames=130", "scene.distance_m=70")


@pytest.fixture(scope="module")
def three_shards(tmp_path_factory):
    """A folder in which an export of three shards is complete."""
    place = tmp_path_factory.mktemp("export")
    assert run_in(place, *words_of(*THREE_SHARDS)).status == 0
    return place


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_missing_or_damaged_is_rendered_again(
    app, tmp_path, three_shards, damage
):
    words = words_of(*THREE_SHARDS)
    shutil.copytree(three_shards, tmp_path, dirs_exist_ok=True)
    folder = tmp_path / "runs" / "x"
    before = files_of(folder)
    times = {path: path.stat().st_mtime_ns for path in folder.rglob("*.png")}
    damage(folder / "frames" / "train")
    again = app(*words)
    assert again.status == 0
    assert "resuming: 1 of 3 folders are complete" in again.out
    assert files_of(folder) == before
    rewritten = {
        path.parent for path, at in times.items() if path.stat().st_mtime_ns != at
    }
    assert len(rewritten - {folder}) == 2


def test_a_run_that_could_write_nothing_leaves_nothing(app, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(export.Image, "fromarray", full)
    monkeypatch.setattr(export.samples, "write_samples", lambda *_: None)
    assert app(*words_of()).complaint.endswith(
        "frames/train/0000000: No space left on device"
    )
    assert not (tmp_path / "runs" / "x").exists()
