"""Recordings in, bits out: a real photograph, pictures of every kind, videos, and model files."""

import base64
import dataclasses
import hashlib
import io
import json
import pickle

import numpy as np
import pytest
import torch
from film_files import write_film
from PIL import Image

from vocc_torch.errors import VoccError
from vocc_torch.measure.train import receiver_for
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.recordings.reading import read_recording
from vocc_torch.report.annotation import annotated
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Distribution, LedPanel, SceneModel, Simulator
from vocc_torch.studies.decode.reading import COLUMNS, read_panels
from vocc_torch.types import PanelShape


@pytest.fixture(scope="module")
def receiver(make_plan):
    """A receiver trained on 64 frames of the paper's scenes, located as it will have to locate."""
    return receiver_for(make_plan(locator="paper", training_frames=64))


@pytest.fixture(scope="module")
def near():
    """Eight frames at 30 m, four times enlarged, (8,H,W) uint8, and their bits."""
    model = dataclasses.replace(
        SceneModel(),
        ambient_lx=Distribution("constant", (8000.0,)),
        distance_m=Distribution("constant", (30.0,)),
    )
    scene, bits = model.draw(BlockKey(5, "video", 0), PanelShape())
    simulator = Simulator(panel=LedPanel(board_reflectance=None))
    grey = simulator.render(scene[:8], bits[:8]).grey[:, 0].numpy()
    size = grey.shape[1] // 2 * 2
    return grey[:, :size, :size].repeat(4, axis=1).repeat(4, axis=2), bits[:8].numpy()


def text_of(bits):
    """Bits as 0 and 1 in raster order."""
    return "".join("1" if bit else "0" for bit in bits.ravel())


def save(path, array, **options):
    """Write a picture and give its path."""
    Image.fromarray(array).save(path, **options)
    return path


# The photograph


@pytest.mark.parametrize("seed", [1, 2])
def test_real_photograph_is_read_without_an_error(make_plan, photo, photo_bits, seed):
    """No bit of 64 wrong, after training on 64 simulated frames and nothing else."""
    receiver = receiver_for(make_plan(locator="paper", training_frames=64, seed=seed))
    (reading,) = read_panels(receiver, read_recording(photo, "luma"))
    assert len(photo_bits) == 64
    assert reading.text == photo_bits
    assert reading.margin > 0


def test_receiver_does_not_depend_on_the_experiments_training(make_plan):
    """A recording is of no experiment: the receiver is that of the world's scenes."""
    plan = make_plan(locator="paper", training_frames=64)
    lean = {"distance_m": Distribution("constant", (35.0,))}
    other = dataclasses.replace(
        plan,
        experiment=dataclasses.replace(plan.experiment, name="lean", training=lean),
    )
    assert torch.equal(
        receiver_for(plan).classifier.direction,
        receiver_for(other).classifier.direction,
    )


# Pictures


def test_picture_without_a_panel_beside_one_with(receiver, near, tmp_path):
    frames, bits = near
    save(tmp_path / "a.png", np.full((60, 80), 90, np.uint8))
    save(tmp_path / "b.png", frames[0])
    without, with_one = read_panels(receiver, read_recording(tmp_path, "luma"))
    assert (without.found, without.text, without.candidates) == (False, "", 0)
    assert (with_one.found, with_one.text) == (True, text_of(bits[0]))
    empty, full = (
        dict(zip(COLUMNS, reading.row(), strict=True))
        for reading in (without, with_one)
    )
    assert [empty[name] for name in ("found", "bits", "margin", "x_top_left")] == [
        "0",
        "",
        "",
        "",
    ]
    assert full["found"] == "1"
    assert float(full["margin"]) > 0


# What is written


def test_channels_see_their_colour(receiver, near, tmp_path):
    """A panel that shines in red only is there in red and in the brightest channel, and nowhere else."""
    frames, bits = near
    colour = np.full((*frames[0].shape, 3), 60, np.uint8)
    colour[..., 0] = frames[0]
    path = save(tmp_path / "red.png", colour)
    channels = ("luma", "max", "red", "green", "blue")
    seen = {
        name: next(read_panels(receiver, read_recording(path, name)))
        for name in channels
    }
    for name in ("luma", "max", "red"):
        assert seen[name].text == text_of(bits[0]), name
    for name in ("green", "blue"):
        assert not seen[name].found, name


@pytest.mark.parametrize(
    ("follow", "searches"), [("false", None), ("true", 1), ("auto", 1)]
)
def test_a_panel_is_followed_in_a_video(
    receiver, near, tmp_path, monkeypatch, follow, searches
):
    """One full search of eight frames where it is followed; the bits are the same."""
    grey, bits = near
    searched, locator = [], type(receiver.locator)
    plain = locator.__call__
    monkeypatch.setattr(
        locator,
        "__call__",
        lambda self, *given: searched.append(1) or plain(self, *given),
    )
    path = write_film(tmp_path / "film.mp4", grey)
    read = list(read_panels(receiver, read_recording(path, "luma"), follow=follow))
    assert [reading.text for reading in read] == [text_of(one) for one in bits]
    assert searches is None or len(searched) == searches


def test_annotation_marks_on_and_off(receiver, near, tmp_path):
    """A filled mark on every On LED and none inside an Off LED's ring; the corner stays as it was."""
    frames, bits = near
    (reading,) = read_panels(
        receiver, read_recording(save(tmp_path / "a.png", frames[0]), "luma")
    )
    for scale in (1, 2):
        drawn = np.asarray(
            annotated(reading.frame.colour, reading.corners_px, reading.bits, scale)
        )
        assert drawn.shape == (
            frames[0].shape[0] * scale,
            frames[0].shape[1] * scale,
            3,
        )
        corners = reading.corners_px * scale
        for r, c in np.ndindex(8, 8):
            u, v = (c + 0.5) / 8, (r + 0.5) / 8
            x, y = (
                corners[0]
                + u * (corners[1] - corners[0])
                + v * (corners[3] - corners[0])
            )
            filled = tuple(drawn[int(y), int(x)]) == (0, 114, 178)
            assert filled == bits[0, r, c]
        assert (drawn[0, 0] == frames[0][0, 0]).all()


# Model files


@pytest.fixture
def model(receiver, tmp_path):
    """A saved receiver."""
    path = tmp_path / "receiver.pt"
    receiver.save(path)
    return path


def test_saved_receiver_scores_identically(receiver, model, near):
    images = torch.from_numpy(near[0])
    before, after = receiver.decode(images), Receiver.load(model).decode(images)
    assert torch.equal(before.scores, after.scores)
    assert torch.equal(before.bits, after.bits)
    assert torch.equal(before.corners_px, after.corners_px)


class Bomb:
    """Executes code when a trusting reader unpickles it."""

    def __init__(self, fuse):
        self.fuse = str(fuse)

    def __reduce__(self):
        return (open, (self.fuse, "w"))


def with_content(model, **changes):
    """The model's file with some of its entries replaced and its checksum made to fit, as bytes."""
    content = json.loads(model.read_text()) | changes
    content.pop("sha256")
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return json.dumps(
        content | {"sha256": hashlib.sha256(text.encode()).hexdigest()}
    ).encode()


def with_settings(model, **changes):
    """The model's file with some of its settings replaced, as bytes."""
    return with_content(
        model, settings=json.loads(model.read_text())["settings"] | changes
    )


def refused(path):
    """The one line with which a model is refused."""
    with pytest.raises(VoccError) as error:
        Receiver.load(path)
    text = str(error.value)
    assert "\n" not in text
    assert str(path) in text
    return text


def test_code_in_a_model_file_is_not_executed(model, tmp_path):
    """Both as a bare pickle and inside torch's own format; first the proof that the bomb works."""
    fuse = tmp_path / "executed"
    bare = pickle.dumps(Bomb(fuse))
    pickle.loads(bare).close()
    assert fuse.exists()
    fuse.unlink()
    buffer = io.BytesIO()
    torch.save(
        {"format": "vocc_torch.receiver", "version": 1, "classifier": Bomb(fuse)},
        buffer,
    )
    for content in (bare, buffer.getvalue()):
        model.write_bytes(content)
        assert "damaged or of another kind" in refused(model)
        assert not fuse.exists()


def test_a_flipped_bit_is_refused_or_changes_nothing(receiver, model):
    whole, meant = model.read_bytes(), receiver.classifier.state_dict()
    random = np.random.default_rng(0)
    caught = 0
    for place in random.choice(8 * len(whole), 150, replace=False):
        flipped = bytearray(whole)
        flipped[place // 8] ^= 1 << (place % 8)
        model.write_bytes(bytes(flipped))
        try:
            read = Receiver.load(model)
        except VoccError:
            caught += 1
            continue
        assert all(
            torch.equal(value, meant[key])
            for key, value in read.classifier.state_dict().items()
        )
        assert (read.name, read.reader, read.locator) == (
            receiver.name,
            receiver.reader,
            receiver.locator,
        )
    assert caught > 75


def test_models_of_other_kinds(model, tmp_path):
    assert "does not exist: give the receiver.pt" in refused(tmp_path / "nowhere.pt")
    assert "Is a directory" in refused(tmp_path)
    whole = model.read_bytes()
    for content in (
        b"",
        b"text",
        whole[:100],
        whole[:-20],
        np.random.default_rng(0).bytes(4000),
    ):
        model.write_bytes(content)
        refused(model)
    for content in ({"weights": [0.0]}, [1, 2], 3):
        model.write_text(json.dumps(content))
        assert "is not of vocc_torch" in refused(model)
    torch.save({"weights": torch.zeros(3)}, model)
    assert "damaged or of another kind" in refused(model)
    deep = '{"format": "vocc_torch.receiver", "x": ' + "[" * 900 + "]" * 900 + "}"
    model.write_text(deep)
    refused(model)
    with model.open("wb") as file:  # to read five gigabytes takes seven
        file.truncate(5 << 30)
    refused(model)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"rows": 0}, "panel.rows is 0"),
        ({"rows": "8"}, "panel.rows is '8'"),
        ({"rows": 8.0}, "panel.rows is 8.0"),
        ({"rows": 10**7}, "panel.rows is 10000000"),
        ({"samples_per_led": 8.5}, "samples_per_led is 8.5"),
        ({"name": "flda_9"}, "flda_9"),
        ({"name": "flda_2"}, "damaged"),
        ({"samples_per_led": 1}, "samples_per_led is 1"),
        ({"gradient": "none"}, "gradient is 'none'"),
        ({"locator": {"closing_px": 2}}, "closing_px is 2"),
        ({"locator": {"colour": 2}}, "colour"),
        ({"locator": None}, "damaged"),
    ],
)
def test_models_with_impossible_settings(model, changes, says):
    model.write_bytes(with_settings(model, **changes))
    assert says in refused(model)


def test_models_with_impossible_numbers_or_settings(model):
    state = json.loads(model.read_text())["classifier"]

    def changed(key, **changes):
        return state | {key: state[key] | changes}

    def encoded(*numbers):
        return base64.b64encode(np.array(numbers).tobytes()).decode()

    nan = changed(
        "mean", base64=encoded(*[np.nan] * int(np.prod(state["mean"]["shape"])))
    )
    empty = {
        key: value | {"base64": encoded(*np.zeros(value["shape"]).flat)}
        for key, value in state.items()
    }
    short = changed("mean", base64=encoded(1.0))
    other = changed("mean", dtype="float3")
    for classifier in (
        empty,
        nan,
        short,
        other,
        {},
        None,
        {"count": state["count"]},
        3,
    ):
        model.write_bytes(with_content(model, classifier=classifier))
        assert ("has seen no samples" if classifier is empty else "damaged") in refused(
            model
        )
    for settings in (3, "no json", [], {}, None):
        model.write_bytes(with_content(model, settings=settings))
        assert "damaged" in refused(model)
    model.write_bytes(with_content(model, version=4))
    assert refused(model).endswith("has format version 4: this package reads version 3")
