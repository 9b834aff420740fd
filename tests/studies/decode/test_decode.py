"""Recordings in, bits out: a real photograph, pictures of every kind, videos, and model files."""

import base64
import dataclasses
import hashlib
import io
import json
import os
import pickle
import re
import struct
from pathlib import Path

import av
import numpy as np
import pytest
import torch
from PIL import Image

from vocc_torch.errors import VoccError
from vocc_torch.measure.train import receiver_for
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.receiver.recording import read_recording, to_grey
from vocc_torch.report.canvas import annotated
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Distribution, SceneModel, Simulator
from vocc_torch.studies.decode.reading import COLUMNS, decode
from vocc_torch.types import PanelShape


@pytest.fixture(scope="module")
def receiver(make_plan):
    """A receiver trained on 64 frames of the paper's scenes, located as it will have to locate."""
    return receiver_for(make_plan(locator="paper", training_frames=64), None)


@pytest.fixture(scope="module")
def near():
    """Eight frames at 30 m, four times enlarged, (8,H,W) uint8, and their bits."""
    model = dataclasses.replace(
        SceneModel(),
        ambient_lx=Distribution("constant", (8000.0,)),
        distance_m=Distribution("constant", (30.0,)),
    )
    scene, bits = model.draw(BlockKey(5, "video", 0), PanelShape())
    grey = Simulator().render(scene[:8], bits[:8]).grey[:, 0].numpy()
    size = grey.shape[1] // 2 * 2
    return grey[:, :size, :size].repeat(4, axis=1).repeat(4, axis=2), bits[:8].numpy()


@pytest.mark.parametrize(("matrix", "turns"), [((0, 1, -1, 0), -1), ((-1, 0, 0, -1), 2), ((0, -1, 1, 0), 1)])
def test_a_film_is_read_as_its_header_turns_it(tmp_path, matrix, turns):
    """The track's matrix (ISO 14496-12) takes (x, y) to (a x + c y, b x + d y), with y downwards."""
    ramp = np.arange(0, 240, 4, dtype=np.uint8)[None].repeat(40, axis=0)
    write_video(tmp_path / "film.mp4", np.stack([ramp, ramp]))
    film = bytearray((tmp_path / "film.mp4").read_bytes())
    at = film.index(b"tkhd") + 4 + 40
    a, b, c, d = (65536 * number for number in matrix)
    film[at : at + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    (tmp_path / "turned.mp4").write_bytes(film)
    for grey_only in (False, True):
        frame = next(read_recording(tmp_path / "turned.mp4", "luma", grey_only=grey_only))
        grey, shown = np.asarray(frame.grey), np.rot90(ramp, turns)
        assert grey.shape == frame.colour.shape[:2] == shown.shape
        assert np.abs(grey.astype(int) - shown).max() < 12


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
    receiver = receiver_for(make_plan(locator="paper", training_frames=64, seed=seed), None)
    (reading,) = decode(receiver, read_recording(photo, "luma"))
    assert len(photo_bits) == 64
    assert reading.text == photo_bits
    assert reading.margin > 0


def test_receiver_does_not_depend_on_the_experiments_training(make_plan):
    """A recording is of no experiment: the receiver is that of the world's scenes."""
    plan = make_plan(locator="paper", training_frames=64)
    lean = {"distance_m": Distribution("constant", (35.0,))}
    other = dataclasses.replace(
        plan, experiment=dataclasses.replace(plan.experiment, name="lean", training=lean)
    )
    assert torch.equal(
        receiver_for(plan, None).classifier.direction, receiver_for(other, None).classifier.direction
    )


# Pictures


def test_folder_is_read_in_the_order_of_names(receiver, near, tmp_path):
    frames, bits = near
    for index in (2, 0, 1):
        save(tmp_path / f"{index}.{('png', 'BMP', 'tiff')[index]}", frames[index])
    (tmp_path / "notes.txt").write_text("no picture")
    readings = list(decode(receiver, read_recording(tmp_path, "luma")))
    assert [reading.frame.source for reading in readings] == ["0.png", "1.BMP", "2.tiff"]
    assert [reading.text for reading in readings] == [text_of(bits[index]) for index in range(3)]


def test_folder_of_pictures_of_different_sizes(receiver, near, photo, photo_bits, tmp_path):
    frames, bits = near
    save(tmp_path / "a.png", frames[0])
    (tmp_path / "b.png").write_bytes(photo.read_bytes())
    save(tmp_path / "c.png", frames[1])
    readings = [reading.text for reading in decode(receiver, read_recording(tmp_path, "luma"))]
    assert readings == [text_of(bits[0]), photo_bits, text_of(bits[1])]


def test_picture_without_a_panel_beside_one_with(receiver, near, tmp_path):
    frames, bits = near
    save(tmp_path / "a.png", np.full((60, 80), 90, np.uint8))
    save(tmp_path / "b.png", frames[0])
    without, with_one = decode(receiver, read_recording(tmp_path, "luma"))
    assert (without.found, without.text, without.candidates) == (False, "", 0)
    assert (with_one.found, with_one.text) == (True, text_of(bits[0]))
    empty, full = (dict(zip(COLUMNS, reading.row(), strict=True)) for reading in (without, with_one))
    assert [empty[name] for name in ("found", "bits", "margin", "x_top_left")] == ["0", "", "", ""]
    assert full["found"] == "1"
    assert float(full["margin"]) > 0


def test_sixteen_bit_picture_reads_as_eight_bit(receiver, near, tmp_path):
    frames, bits = near
    deep = save(tmp_path / "deep.png", frames[0].astype(np.uint16) * 257)
    with Image.open(deep) as image:
        assert image.mode.startswith("I")
    (reading,) = decode(receiver, read_recording(deep, "luma"))
    assert np.array_equal(reading.frame.grey, frames[0])
    assert reading.text == text_of(bits[0])


@pytest.mark.parametrize("mode", ["L", "RGB", "RGBA", "P", "LA", "CMYK"])
def test_pictures_of_every_mode(near, tmp_path, mode):
    """Grey pictures are the same grey in every mode."""
    frames, _ = near
    path = tmp_path / ("picture.tiff" if mode == "CMYK" else "picture.png")
    Image.fromarray(frames[0]).convert(mode).save(path)
    (frame,) = read_recording(path, "luma")
    assert np.array_equal(frame.grey, frames[0])
    assert frame.colour.shape == (*frames[0].shape, 3)


@pytest.mark.parametrize("level", [0, 255])
@pytest.mark.parametrize("size", [(1, 1), (1, 300), (2, 2), (40, 50)])
def test_a_picture_of_one_pixel_or_one_grey_holds_no_panel(receiver, tmp_path, size, level):
    path = save(tmp_path / "flat.png", np.full(size, level, np.uint8))
    (reading,) = decode(receiver, read_recording(path, "luma"))
    assert not reading.found
    assert (reading.text, reading.row()[12]) == ("", "")


def test_grey_values_of_other_than_eight_or_sixteen_bits_are_refused(near, tmp_path):
    """They would all be white."""
    for value in (65536, -1):
        deep = near[0][0].astype(np.int32)
        deep[3, 4] = value
        with pytest.raises(
            VoccError, match=r"deep.tiff .*holds int32 grey values from .* it must have 8 or 16 bits"
        ):
            list(read_recording(save(tmp_path / "deep.tiff", deep), "luma"))
    with pytest.raises(VoccError, match=r"float.tiff .*holds float32 grey values"):
        list(read_recording(save(tmp_path / "float.tiff", near[0][0].astype(np.float32) / 255), "luma"))


@pytest.mark.parametrize("name", ["cut.jpg", "cut.tiff", "cut.bmp", "cut.webp", "cut.pgm", "cut.png"])
def test_truncated_pictures_are_refused_in_one_line(near, tmp_path, name):
    path = save(tmp_path / name, near[0][0])
    whole = path.read_bytes()
    for share in (0.9, 0.5, 0.02):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(VoccError, match=rf"{name} cannot be read as a picture") as refused:
            list(read_recording(path, "luma"))
        assert "\n" not in str(refused.value)


def test_picture_is_read_the_way_up_that_it_is_shown(receiver, near, tmp_path):
    """A telephone held upright writes the picture on its side, with a note."""
    frames, bits = near
    exif = Image.Exif()
    exif[0x0112] = 6  # show it turned a quarter to the right
    path = save(tmp_path / "upright.jpg", np.ascontiguousarray(np.rot90(frames[0])), exif=exif, quality=98)
    (reading,) = decode(receiver, read_recording(path, "luma"))
    assert reading.text == text_of(bits[0])


def test_channels_see_their_colour(receiver, near, tmp_path):
    """A panel that shines in red only is there in red and in the brightest channel, and nowhere else."""
    frames, bits = near
    colour = np.full((*frames[0].shape, 3), 60, np.uint8)
    colour[..., 0] = frames[0]
    path = save(tmp_path / "red.png", colour)
    channels = ("luma", "max", "red", "green", "blue")
    seen = {name: next(decode(receiver, read_recording(path, name))) for name in channels}
    for name in ("luma", "max", "red"):
        assert seen[name].text == text_of(bits[0]), name
    for name in ("green", "blue"):
        assert not seen[name].found, name


def test_grey_of_colours():
    """Rec. 601: 0.299 R + 0.587 G + 0.114 B."""
    colour = np.random.default_rng(0).integers(0, 256, (20, 30, 3)).astype(np.uint8)
    exact = colour @ np.array([0.299, 0.587, 0.114])
    assert np.abs(to_grey(colour, "luma") - exact).max() <= 0.51
    assert np.array_equal(to_grey(colour, "max"), colour.max(2))
    for index, name in enumerate(("red", "green", "blue")):
        assert np.array_equal(to_grey(colour, name), colour[..., index])


@pytest.mark.parametrize(
    "content", [b"no picture", b"", b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n"]
)
def test_unreadable_pictures(tmp_path, content):
    (tmp_path / "evil.png").write_bytes(content)
    with pytest.raises(VoccError, match=r"evil.png cannot be read .*not a known picture format\)$"):
        list(read_recording(tmp_path / "evil.png", "luma"))


def test_picture_too_large_to_be_one(near, tmp_path, monkeypatch):
    """Pillow's guard against pictures that unpack to gigabytes, at both of its levels."""
    path = save(tmp_path / "huge.png", near[0][0])
    for limit in (near[0][0].size - 1, near[0][0].size // 3):
        monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", limit)
        with pytest.raises(VoccError, match=r"huge.png cannot be read as a picture"):
            list(read_recording(path, "luma"))


def test_missing_and_empty_inputs(tmp_path):
    with pytest.raises(VoccError, match=r"nowhere.png does not exist: give a picture"):
        list(read_recording(tmp_path / "nowhere.png", "luma"))
    (tmp_path / "folder").mkdir()
    with pytest.raises(VoccError, match=r"folder holds no picture: known endings are \.png"):
        list(read_recording(tmp_path / "folder", "luma"))


def test_a_pipe_is_no_recording(near, tmp_path):
    """Reading one would wait for ever."""
    os.mkfifo(tmp_path / "pipe.png")
    with pytest.raises(VoccError, match=r"pipe.png is a pipe or a device: give a picture"):
        list(read_recording(tmp_path / "pipe.png", "luma"))
    save(tmp_path / "near.png", near[0][0])
    assert [frame.source for frame in read_recording(tmp_path, "luma")] == ["near.png"]


@pytest.mark.parametrize("name", ["film.gif", "film.webp", "pages.tiff", "film.png"])
def test_all_frames_of_a_picture_are_read(receiver, near, tmp_path, name):
    frames, bits = near
    first, *rest = (Image.fromarray(frame) for frame in frames)
    options = {"lossless": True} if name == "film.webp" else {}
    first.save(tmp_path / name, save_all=True, append_images=rest, **options)
    readings = list(decode(receiver, read_recording(tmp_path / name, "luma")))
    assert [(one.frame.source, one.frame.index) for one in readings] == [(name, index) for index in range(8)]
    assert [one.text for one in readings] == [text_of(frame) for frame in bits]


def test_a_film_of_pictures_that_is_cut_says_so(near, tmp_path):
    path = tmp_path / "film.gif"
    first, *rest = (Image.fromarray(frame) for frame in near[0])
    first.save(path, save_all=True, append_images=rest)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 2 // 3])
    done, said = read_to_the_end(read_recording(path, "luma"))
    assert 3 <= done < 8
    assert f"cannot be read as a picture after {done} frames" in said
    path.write_bytes(whole[:-1])
    with pytest.warns(UserWarning, match="film.gif has no end: frames after the 8 read may be missing"):
        assert read_to_the_end(read_recording(path, "luma")) == (8, "")


def test_a_name_that_is_not_text_is_escaped(near, tmp_path):
    for name in (b"\xff\xfe.png", b"\x1b[31mred.png"):
        save(tmp_path / os.fsdecode(name), near[0][0])
    named = [frame.source for frame in read_recording(tmp_path, "luma")]
    assert named == ["\\x1b[31mred.png", "\\udcff\\udcfe.png"]


# Videos


def read_to_the_end(recording):
    """How many frames there were, and what was said of the others at the end."""
    done = 0
    try:
        for _ in recording:
            done += 1
    except VoccError as error:
        return done, str(error)
    return done, ""


def write_video(path, frames, codec="mpeg4"):
    """Encode grey frames, (N,H,W) uint8, at 25 frames a second."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = frames.shape[2], frames.shape[1], "yuv420p"
        stream.bit_rate = 20_000_000
        for grey in frames:
            picture = av.VideoFrame.from_ndarray(np.repeat(grey[..., None], 3, axis=2), format="rgb24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return path


@pytest.mark.parametrize("name", ["drive.mp4", "DRIVE.AVI"])
def test_video_frame_by_frame(receiver, near, tmp_path, name):
    frames, bits = near
    readings = list(decode(receiver, read_recording(write_video(tmp_path / name, frames), "luma")))
    assert [reading.text for reading in readings] == [text_of(frame) for frame in bits]
    assert [reading.frame.index for reading in readings] == list(range(8))
    times = [reading.frame.time_s for reading in readings]
    assert times == pytest.approx([index / 25 for index in range(8)], abs=1e-3)


@pytest.mark.parametrize(("follow", "searches"), [("false", None), ("true", 1), ("auto", 1)])
def test_a_panel_is_followed_in_a_video(receiver, near, tmp_path, monkeypatch, follow, searches):
    """One full search of eight frames where it is followed; the bits are the same."""
    grey, bits = near
    searched, locator = [], type(receiver.locator)
    plain = locator.__call__
    monkeypatch.setattr(locator, "__call__", lambda self, *given: searched.append(1) or plain(self, *given))
    path = write_video(tmp_path / "film.mp4", grey)
    read = list(decode(receiver, read_recording(path, "luma"), follow=follow))
    assert [reading.text for reading in read] == [text_of(one) for one in bits]
    assert searches is None or len(searched) == searches


def test_video_longer_than_a_batch(receiver, near, tmp_path, monkeypatch):
    monkeypatch.setattr("vocc_torch.studies.decode.reading.BATCH_PIXELS", 3 * near[0][0].size)
    frames, bits = near
    readings = list(decode(receiver, read_recording(write_video(tmp_path / "long.mp4", frames), "luma")))
    assert [reading.text for reading in readings] == [text_of(frame) for frame in bits]


@pytest.mark.parametrize("name", ["12:30:05.mp4", "http:/127.0.0.1:8765/a.mp4", "pipe:0.mp4"])
def test_a_name_that_reads_as_an_address_is_a_file(near, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    path = Path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_video(tmp_path / "drive.mp4", near[0]).rename(path)
    assert len(list(read_recording(path, "luma"))) == 8


@pytest.mark.parametrize("name", ["drive.mkv", "drive.avi"])
def test_of_a_video_that_is_cut_the_rest_is_read_and_the_end_is_missed(near, tmp_path, name):
    path = write_video(tmp_path / name, near[0])
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    with pytest.warns(
        UserWarning, match=rf"{name}: \d frames were read, . of them damaged, and its header speaks of 8"
    ):
        done, said = read_to_the_end(read_recording(path, "luma"))
    assert 3 <= done < 8
    assert not said or f"after {done} frames" in said


def test_of_a_damaged_video_what_can_be_read_is_kept(near, tmp_path):
    """The third frame's head is gone: the others stay, and the refusal comes at the end."""
    path = write_video(tmp_path / "drive.mkv", near[0])
    content = bytearray(path.read_bytes())
    at = [place.start() for place in re.finditer(b"\0\0\1\xb6", content)][2]
    content[at : at + 4] = bytes(4)
    path.write_bytes(content)
    with pytest.warns(UserWarning, match="7 frames were read, . of them damaged, and its header speaks of 8"):
        done, said = read_to_the_end(read_recording(path, "luma"))
    assert done == 7
    assert "cannot be read as a video after 7 frames" in said


def test_video_file_without_pictures(tmp_path):
    with av.open(str(tmp_path / "sound.mkv"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        sound.sample_rate = 8000
        container.mux([*stream.encode(sound), *stream.encode()])
    with pytest.raises(VoccError, match=r"sound.mkv cannot be read as a video after 0 frames"):
        list(read_recording(tmp_path / "sound.mkv", "luma"))


def test_broken_videos(near, tmp_path):
    for name, content in (("noise.mp4", bytes(range(256)) * 20), ("nothing.mp4", b"")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(VoccError, match=rf"{name} cannot be read as a video after 0 frames") as refused:
            list(read_recording(tmp_path / name, "luma"))
        assert "\n" not in str(refused.value)


# What is written


def test_rows_are_the_columns(receiver, photo, photo_bits):
    (reading,) = decode(receiver, read_recording(photo, "luma"))
    row = dict(zip(COLUMNS, reading.row(), strict=True))
    assert (row["source"], row["frame"], row["time_s"], row["found"]) == (photo.name, "0", "", "1")
    assert row["bits"] == photo_bits
    # Clockwise from the top left.
    left, right = float(row["x_top_left"]), float(row["x_bottom_right"])
    assert left == float(row["x_bottom_left"]) < right == float(row["x_top_right"])
    assert float(row["y_top_left"]) < float(row["y_bottom_left"])


def test_annotation_marks_on_and_off(receiver, near, tmp_path):
    """A filled mark on every On LED and none inside an Off LED's ring; the corner stays as it was."""
    frames, bits = near
    (reading,) = decode(receiver, read_recording(save(tmp_path / "a.png", frames[0]), "luma"))
    for scale in (1, 2):
        drawn = np.asarray(annotated(reading.frame.colour, reading.corners_px, reading.bits, scale))
        assert drawn.shape == (frames[0].shape[0] * scale, frames[0].shape[1] * scale, 3)
        corners = reading.corners_px * scale
        for r, c in np.ndindex(8, 8):
            u, v = (c + 0.5) / 8, (r + 0.5) / 8
            x, y = corners[0] + u * (corners[1] - corners[0]) + v * (corners[3] - corners[0])
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
    return json.dumps(content | {"sha256": hashlib.sha256(text.encode()).hexdigest()}).encode()


def with_settings(model, **changes):
    """The model's file with some of its settings replaced, as bytes."""
    return with_content(model, settings=json.loads(model.read_text())["settings"] | changes)


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
    torch.save({"format": "vocc_torch.receiver", "version": 1, "classifier": Bomb(fuse)}, buffer)
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
        assert all(torch.equal(value, meant[key]) for key, value in read.classifier.state_dict().items())
        assert (read.name, read.reader, read.locator) == (receiver.name, receiver.reader, receiver.locator)
    assert caught > 75


def test_models_of_other_kinds(model, tmp_path):
    assert "does not exist: give the receiver.pt" in refused(tmp_path / "nowhere.pt")
    assert "damaged or of another kind" in refused(tmp_path)
    whole = model.read_bytes()
    for content in (b"", b"text", whole[:100], whole[:-20], np.random.default_rng(0).bytes(4000)):
        model.write_bytes(content)
        refused(model)
    for content in ({"weights": [0.0]}, [1, 2], 3):
        model.write_text(json.dumps(content))
        assert "is not of vocc_torch" in refused(model)
    torch.save({"weights": torch.zeros(3)}, model)
    assert "damaged or of another kind" in refused(model)


def test_models_that_are_too_heavy_or_no_files_are_not_read(tmp_path):
    """Reading five gigabytes takes seven, and reading a pipe waits for ever."""
    with (tmp_path / "heavy.pt").open("wb") as file:
        file.truncate(5 << 30)
    os.mkfifo(tmp_path / "pipe.pt")
    (tmp_path / "deep.pt").write_text('{"format": "vocc_torch.receiver", "x": ' + "[" * 900 + "]" * 900 + "}")
    for name in ("heavy.pt", "pipe.pt", "deep.pt"):
        refused(tmp_path / name)


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

    nan = changed("mean", base64=encoded(*[np.nan] * int(np.prod(state["mean"]["shape"]))))
    empty = {key: value | {"base64": encoded(*np.zeros(value["shape"]).flat)} for key, value in state.items()}
    short = changed("mean", base64=encoded(1.0))
    other = changed("mean", dtype="float3")
    for classifier in (empty, nan, short, other, {}, None, {"count": state["count"]}, 3):
        model.write_bytes(with_content(model, classifier=classifier))
        assert ("has seen no samples" if classifier is empty else "damaged") in refused(model)
    for settings in (3, "no json", [], {}, None):
        model.write_bytes(with_content(model, settings=settings))
        assert "damaged" in refused(model)
    model.write_bytes(with_content(model, version=4))
    assert refused(model).endswith("has format version 4: this package reads versions 1 and 2 and 3")


def test_images_that_are_none(receiver):
    for images in (torch.zeros(4, 4), torch.zeros(1, 4, 4), torch.zeros(1, 3, 4, 4, dtype=torch.uint8)):
        with pytest.raises(VoccError, match="it must be uint8 of shape"):
            receiver.decode(images)
