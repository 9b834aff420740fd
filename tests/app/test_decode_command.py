"""``task=decode`` from settings to files: what is written, and what is refused before anything is."""

import json
import re
import time

import av
import numpy as np
import pytest
import torch
from composing import composed
from film_files import write_film
from PIL import Image
from run_files import rows_of
from skimage import data

from vocc_torch.app.cli import run_task
from vocc_torch.errors import VoccError
from vocc_torch.receiver.detector.pipeline import detected
from vocc_torch.receiver.locators import DetectorLocator, RefinedLocator
from vocc_torch.receiver.locators import detector as locator_file
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.receiver.shipped import shipped_receiver
from vocc_torch.recordings.streams import LiveStream
from vocc_torch.studies.decode.judge import LIMITS


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A receiver that task=train wrote."""
    folder = tmp_path_factory.mktemp("model")
    words = (
        "budget.training_frames=64",
        "receiver.save=flda_3",
        "panel.board_reflectance=null",
        "name=x",
    )
    run_task(composed("task=train", *words), folder)
    return folder / "receiver.pt"


@pytest.fixture
def decode(tmp_path, monkeypatch):
    """Run the task into a folder and give the rows of its bits."""
    monkeypatch.chdir(tmp_path)

    def run(recording, *words):
        settings = composed("task=decode", f"input='{recording}'", "name=x", *words)
        run_task(settings, tmp_path / "out")
        return rows_of(tmp_path / "out" / "bits.csv")

    return run


CLOSE, FAR, DESK = (
    "led-panel-8x8-photo.png",
    "led-array-4x4-bench.jpg",
    "led-matrix-8x16-desk.jpg",
)
READ = {
    "by default": (CLOSE, (), DetectorLocator),
    "letters, aslant, on a crowded desk": (DESK, (), DetectorLocator),
    "by another": (CLOSE, ("receiver=recommended",), RefinedLocator),
    "small, by another": (FAR, ("receiver=recommended",), RefinedLocator),
    "points of light, small": (FAR, ("receiver.false_alarms=0.1",), DetectorLocator),
}


def truth_of(photo, name):
    """What is written of a picture, and the words for its panel's size."""
    truth = json.loads((photo.parent / "pictures.json").read_text())[name]
    return "".join(truth["bits"]), [
        f"panel.{side}={truth[side]}" for side in ("rows", "columns")
    ]


@pytest.mark.parametrize("case", READ)
def test_a_receiver_is_trained_where_no_model_is_given(
    decode, photo, case, tmp_path, monkeypatch
):
    """And reads real pictures: a close-up, text, a small panel; what is slow is not done while it learns."""
    searched = []
    monkeypatch.setattr(
        locator_file,
        "detected",
        lambda *given: searched.append(0) or detected(*given),
    )
    name, words, locator = READ[case]
    bits, shape = truth_of(photo, name)
    rows = decode(
        photo.parent / name,
        *shape,
        *words,
        "budget.training_frames=16",
        "decode.annotate=false",
    )
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "bits.csv",
        "receiver.pt",
        "config.yaml",
    }
    assert rows[0]["bits"] == bits
    kept = Receiver.load(tmp_path / "out" / "receiver.pt")
    assert (kept.name, type(kept.locator)) == ("tag_planes", locator)
    assert len(searched) == 1


def test_where_nothing_is_sure_what_to_give_is_said_and_is_enough(
    decode, photo, tmp_path
):
    bits, shape = truth_of(photo, FAR)
    few = (*shape, "budget.training_frames=16", "decode.annotate=false")
    Image.new("L", (640, 480), 90).save(tmp_path / "flat.png")
    with pytest.raises(VoccError, match="no candidate is enough like a panel"):
        decode("flat.png", *few)
    with pytest.raises(
        VoccError,
        match="no panel of 4 x 4 LEDs in 1 of 1 frames: the best candidate",
    ) as said:
        decode(photo.parent / FAR, *few, "receiver.false_alarms=1e-5")
    word = re.search(r"(receiver\.false_alarms=\S+) accepts", str(said.value))[1]
    assert decode(photo.parent / FAR, *few, word)[0]["bits"] == bits


def test_a_folder_with_and_without_panels(decode, model, photo, tmp_path, capsys):
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    Image.new("L", (60, 80), 90).save(pictures / "a.png")
    (pictures / "b.png").write_bytes(photo.read_bytes())
    with Image.open(photo) as image:
        image.convert("RGB").save(pictures / "b.bmp")
    rows = decode(pictures, f"model={model}", "decode.scale=2")
    assert [(row["source"], row["found"]) for row in rows] == [
        ("a.png", "0"),
        ("b.bmp", "1"),
        ("b.png", "1"),
    ]
    assert "panel found in 2 of 3 frames" in capsys.readouterr().out
    # Two pictures of one name do not overwrite one another.
    drawn = list((tmp_path / "out" / "annotated").iterdir())
    with (
        Image.open(photo) as given,
        Image.open(drawn[0]) as one,
        Image.open(drawn[1]) as other,
    ):
        assert one.size == other.size == (given.width * 2, given.height * 2)


def test_the_configuration_of_a_run_with_a_model_runs_again(
    app, model, photo, tmp_path
):
    words = ("task=decode", f"model={model}", f"input={photo}")
    saved = ("--config-path", tmp_path / "runs" / "first", "--config-name", "config")
    bits = []
    for name, given in (("first", words), ("again", saved)):
        assert app(*given, f"name={name}").status == 0
        bits.append((tmp_path / "runs" / name / "bits.csv").read_bytes())
    assert bits[0] == bits[1]


def test_what_is_no_panel_is_called_doubtful(decode, model, tmp_path, capsys):
    """The locator gives the best blob there is: noise scores low, a wall high but without two levels."""
    noise = np.random.default_rng(0).integers(0, 256, (120, 160)).astype(np.uint8)
    (tmp_path / "pictures").mkdir()
    for name, grey in (("a", noise), ("b", data.brick()), ("c", data.gravel())):
        Image.fromarray(grey).save(tmp_path / "pictures" / f"{name}.png")
    with pytest.warns(UserWarning, match=r"3 of 3 frames may show no panel"):
        rows = decode("pictures", f"model={model}")
    assert ", doubtful" in capsys.readouterr().out
    low, *high = (float(row["panel_score"]) for row in rows)
    assert low < LIMITS.score < min(high)


RECORDINGS = {
    "no.png": "input no.png does not exist",
    "text.png": "text.png cannot be read as a picture (not a known picture format)",
    "flat.png": "shows no panel of 8 x 8 LEDs in 1 of 1 frames: see receiver.location",
    "cut": "a.png cannot be read as a picture (image file is truncated); input cut/b.png cannot be read",
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_recording_that_cannot_be_used_leaves_nothing(
    decode, model, photo, tmp_path, name
):
    (tmp_path / "text.png").write_text("no picture")
    Image.new("L", (60, 80), 90).save(tmp_path / "flat.png")
    (tmp_path / "cut").mkdir()
    for cut in ("a.png", "b.png"):
        (tmp_path / "cut" / cut).write_bytes(photo.read_bytes()[:1000])
    with pytest.raises(VoccError) as refusal:
        decode(name, f"model={model}")
    assert RECORDINGS[name] in str(refusal.value)
    assert "\n" not in str(refusal.value)
    assert not (tmp_path / "out").exists() or not any((tmp_path / "out").rglob("*.*"))


MODELS = {
    "another shape": (
        ("panel.rows=4",),
        "8 x 8 LEDs, and panel.rows x panel.columns is 4 x 8",
    ),
    "missing": (("model=no.pt",), "model no.pt does not exist"),
    "no model": (("model=text.pt",), "model text.pt is damaged or of another kind"),
}


@pytest.mark.parametrize("case", MODELS)
def test_models_that_do_not_fit(decode, model, photo, tmp_path, case):
    (tmp_path / "text.pt").write_text("no model")
    words, part = MODELS[case]
    with pytest.raises(VoccError, match=part):
        decode(photo, f"model={model}", *words)
    assert not (tmp_path / "out").exists()


def test_the_receiver_that_ships_is_what_its_command_trains(decode, photo, tmp_path):
    """``models/README.md`` names the command; both receivers decide alike to the last bit."""
    decode(photo, "model=null", "decode.annotate=false")
    trained = Receiver.load(tmp_path / "out" / "receiver.pt")
    shipped = shipped_receiver("street")
    frame = torch.from_numpy(np.array(Image.open(photo).convert("L")))
    assert torch.equal(trained.decode(frame).scores, shipped.decode(frame).scores)
    assert trained.locator == shipped.locator
    for name, bounds in shipped.trained_on.items():
        assert trained.trained_on[name] == pytest.approx(bounds, rel=1e-6)


def test_a_note_on_a_file_names_that_file(decode, photo, tmp_path, capsys):
    (tmp_path / "in").mkdir()
    grey = Image.open(photo).convert("L")
    grey.save(tmp_path / "in/first.png")
    deep = np.asarray(grey).astype(np.uint16) * 4
    for name in ("second.png", "third.png"):
        Image.fromarray(deep).save(tmp_path / "in" / name)
    decode(tmp_path / "in", "decode.annotate=false")
    printed = capsys.readouterr().out
    assert printed.count("second.png: grey values up to") == 1
    assert printed.count("are read as 10 bits") == 1


def test_a_panel_that_hangs_upside_down_is_read_upright(
    decode, photo, photo_bits, tmp_path
):
    Image.open(photo).rotate(180).transpose(Image.Transpose.FLIP_LEFT_RIGHT).save(
        tmp_path / "down.png"
    )
    # Turned by 180 degrees and then mirrored: both undo what was done, for the two commute.
    assert (
        decode(tmp_path / "down.png", "decode.turn=180", "decode.mirror=true")[0][
            "bits"
        ]
        == photo_bits
    )


@pytest.fixture
def film(photo, tmp_path):
    """Four frames of the photograph, in Matroska."""
    picture = Image.open(photo).convert("RGB").crop((0, 0, 360, 346))
    return write_film(tmp_path / "film.mkv", np.stack([picture] * 4))


class LateStream(LiveStream):
    """A live source whose frames have all come when the first is taken."""

    def __iter__(self):
        deadline = time.monotonic() + 20
        while self.dropped < 3 and time.monotonic() < deadline:
            time.sleep(0.01)
        return super().__iter__()


def test_frames_that_wait_give_way_where_the_newest_is_asked_for(
    decode, film, photo, photo_bits, monkeypatch, capsys
):
    with pytest.raises(VoccError, match="must be null where input is a file"):
        decode(photo, "decode.newest=true")
    opened = av.open(str(film))
    monkeypatch.setattr("vocc_torch.recordings.streams.opened", lambda source: opened)
    monkeypatch.setattr("vocc_torch.studies.decode.run.LiveStream", LateStream)
    (row,) = decode("-", "decode.newest=true")
    assert (row["frame"], row["bits"]) == ("3", photo_bits)
    assert "3 frames dropped" in capsys.readouterr().out


def test_a_live_film_is_decoded_as_it_comes_and_ends_in_order(
    command, film, photo_bits, tmp_path
):
    """Matroska through a pipe; the table has a row a frame once the film ends."""
    with film.open("rb") as pipe:
        ran = command("task=decode", "input=-", "name=live", cwd=tmp_path, stdin=pipe)
    assert ran.status == 0, ran.err
    assert "panel found in 4 of 4 frames; latency" in ran.out
    rows = rows_of(tmp_path / "runs/live/bits.csv")
    assert [row["bits"] for row in rows] == [photo_bits] * 4
