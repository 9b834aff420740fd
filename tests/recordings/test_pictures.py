"""Pictures of every kind against Pillow, NumPy and pillow-heif; damaged ones are refused in a line."""

import os

import cv2
import numpy as np
import pillow_heif
import pytest
from PIL import Image

from vocc_torch.errors import VoccError
from vocc_torch.recordings.frames import to_bytes, to_grey, turned
from vocc_torch.recordings.pictures import natural_key, read_array
from vocc_torch.recordings.reading import read_recording, read_source


@pytest.fixture(scope="module")
def frames():
    """Eight smooth random pictures, (8,H,W) uint8."""
    noise = np.random.default_rng(0).integers(0, 256, (8, 10, 12)).astype(np.uint8)
    return np.stack(
        [cv2.resize(one, (96, 80), interpolation=cv2.INTER_CUBIC) for one in noise]
    )


def save(path, array, **options):
    """Write a picture and give its path."""
    Image.fromarray(array).save(path, **options)
    return path


def read_to_the_end(recording):
    """How many frames there were, and what the refusal at the end says."""
    done = 0
    try:
        for _ in recording:
            done += 1
    except VoccError as error:
        return done, str(error)
    return done, ""


def test_a_folder_is_read_in_natural_order(frames, tmp_path):
    for index, name in ((2, "10.tiff"), (0, "1.png"), (1, "2.BMP")):
        save(tmp_path / name, frames[index])
    (tmp_path / "notes.txt").write_text("no picture")
    read = list(read_recording(tmp_path, "luma"))
    assert [frame.source for frame in read] == ["1.png", "2.BMP", "10.tiff"]
    assert np.array_equal([frame.grey for frame in read], frames[:3])


def test_natural_keys_of_odd_names_can_be_compared(tmp_path):
    names = ["", "7", "a7", "a", "7a", "07", "²", "z10b2", "z9b2"]
    ordered = sorted((tmp_path / f"x{name}" for name in names), key=natural_key)
    assert [path.name[1:] for path in ordered][-3:-1] == ["z9b2", "z10b2"]


def test_files_of_a_folder_that_are_no_known_pictures_are_named(frames, tmp_path):
    save(tmp_path / "1.png", frames[0])
    (tmp_path / "raw.dng").write_bytes(b"raw")
    done, refusal = read_to_the_end(read_recording(tmp_path, "luma"))
    assert (done, refusal) == (1, "input raw.dng is not a known kind of picture")


@pytest.mark.parametrize("mode", ["L", "RGB", "RGBA", "P", "LA", "CMYK"])
def test_pictures_of_every_mode(frames, tmp_path, mode):
    path = tmp_path / ("picture.tiff" if mode == "CMYK" else "picture.png")
    Image.fromarray(frames[0]).convert(mode).save(path)
    (frame,) = read_recording(path, "luma")
    assert np.array_equal(frame.grey, frames[0])
    assert frame.colour.shape == (*frames[0].shape, 3)


@pytest.mark.parametrize("suffix", ["jpg", "webp", "avif", "jp2", "heic"])
def test_lossy_formats_are_read_to_within_their_loss(frames, tmp_path, suffix):
    path = tmp_path / f"picture.{suffix}"
    if suffix == "heic":
        pillow_heif.from_pillow(Image.fromarray(frames[0]).convert("RGB")).save(
            path, quality=95
        )
    else:
        save(path, frames[0])
    (frame,) = read_recording(path, "luma")
    assert np.abs(frame.grey.astype(float) - frames[0]).mean() < 4


@pytest.mark.parametrize(
    ("bits", "note"),
    [(10, "are read as 10 bits"), (12, "are read as 12 bits"), (16, "")],
)
def test_deep_pictures_are_scaled_to_the_white_level_of_their_depth(
    frames, tmp_path, bits, note
):
    deep = np.rint(frames[0] * ((2**bits - 1) / 255.0)).astype(np.uint16)
    (frame,) = read_recording(save(tmp_path / "deep.png", deep), "luma")
    assert np.array_equal(frame.grey, frames[0])
    assert note in frame.note


@pytest.mark.parametrize("white", [1.0, 255.0])
def test_pictures_of_floats(frames, tmp_path, white):
    picture = (frames[0] * (white / 255)).astype(np.float32)
    (frame,) = read_recording(save(tmp_path / "float.tiff", picture), "luma")
    assert np.array_equal(frame.grey, frames[0])


@pytest.mark.parametrize("value", [65536, -1, np.nan, np.inf])
def test_grey_values_beyond_sixteen_bits_are_refused(frames, tmp_path, value):
    deep = frames[0].astype(np.float32 if isinstance(value, float) else np.int32)
    deep[3, 4] = value
    with pytest.raises(
        VoccError, match=r"deep.tiff .* it must hold values from 0 to 65535"
    ):
        list(read_recording(save(tmp_path / "deep.tiff", deep), "luma"))


@pytest.mark.parametrize(
    "name", ["cut.jpg", "cut.tiff", "cut.bmp", "cut.webp", "cut.pgm", "cut.png"]
)
def test_truncated_pictures_are_refused_in_one_line(frames, tmp_path, name):
    path = save(tmp_path / name, frames[0])
    content = path.read_bytes()
    for share in (0.9, 0.5, 0.02):
        path.write_bytes(content[: int(share * len(content))])
        with pytest.raises(
            VoccError, match=rf"{name} cannot be read as a picture"
        ) as refusal:
            list(read_recording(path, "luma"))
        assert "\n" not in str(refusal.value)


def test_exif_orientation_is_followed(frames, tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6  # shown turned clockwise
    path = save(
        tmp_path / "upright.png", np.ascontiguousarray(np.rot90(frames[0])), exif=exif
    )
    (frame,) = read_recording(path, "luma")
    assert np.array_equal(frame.grey, frames[0])


def test_grey_of_colours():
    """Rec. 601: 0.299 R + 0.587 G + 0.114 B."""
    colour = np.random.default_rng(0).integers(0, 256, (20, 30, 3)).astype(np.uint8)
    exact = colour @ np.array([0.299, 0.587, 0.114])
    assert np.abs(to_grey(colour, "luma") - exact).max() <= 0.51
    assert np.array_equal(to_grey(colour, "max"), colour.max(2))
    for index, name in enumerate(("red", "green", "blue")):
        assert np.array_equal(to_grey(colour, name), colour[..., index])


@pytest.mark.parametrize(
    "content",
    [b"no picture", b"", b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n"],
)
@pytest.mark.parametrize("name", ["evil.png", "evil.heic", "evil.avif", "evil.jp2"])
def test_unreadable_pictures(tmp_path, content, name):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(
        VoccError,
        match=rf"{name} cannot be read as a picture \(not a known picture format\)$",
    ):
        list(read_recording(tmp_path / name, "luma"))


def test_a_picture_that_unpacks_to_gigabytes_is_refused(frames, tmp_path, monkeypatch):
    path = save(tmp_path / "huge.png", frames[0])
    for limit in (frames[0].size - 1, frames[0].size // 3):
        monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", limit)
        with pytest.raises(VoccError, match=r"huge.png cannot be read as a picture"):
            list(read_recording(path, "luma"))


def test_missing_empty_and_special_inputs(frames, tmp_path):
    with pytest.raises(VoccError, match=r"nowhere.png does not exist: give a picture"):
        read_recording(tmp_path / "nowhere.png", "luma")
    (tmp_path / "folder").mkdir()
    with pytest.raises(
        VoccError, match=r"folder holds no picture: known endings are \.png"
    ):
        read_recording(tmp_path / "folder", "luma")
    os.mkfifo(tmp_path / "pipe.png")
    with pytest.raises(
        VoccError, match=r"pipe.png is a pipe or a device: give a picture"
    ):
        read_recording(tmp_path / "pipe.png", "luma")
    save(tmp_path / "near.png", frames[0])
    assert [frame.source for frame in read_recording(tmp_path, "luma")] == ["near.png"]


@pytest.mark.parametrize("name", ["film.gif", "film.webp", "pages.tiff", "film.png"])
def test_all_frames_of_a_picture_are_read(frames, tmp_path, name):
    first, *others = (Image.fromarray(frame) for frame in frames)
    options = {"lossless": True} if name == "film.webp" else {}
    first.save(tmp_path / name, save_all=True, append_images=others, **options)
    read = list(read_recording(tmp_path / name, "luma"))
    assert [(frame.source, frame.index) for frame in read] == [
        (name, index) for index in range(8)
    ]
    assert np.array_equal([frame.grey for frame in read], frames)


def test_an_animation_that_is_cut_says_so(frames, tmp_path):
    path = tmp_path / "film.gif"
    first, *others = (Image.fromarray(frame) for frame in frames)
    first.save(path, save_all=True, append_images=others)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    done, refusal = read_to_the_end(read_recording(path, "luma"))
    assert 3 <= done < 8
    assert f"cannot be read as a picture after {done} frames" in refusal
    path.write_bytes(content[:-1])
    with pytest.warns(
        UserWarning, match="film.gif has no end: frames after the 8 read may be missing"
    ):
        assert read_to_the_end(read_recording(path, "luma")) == (8, "")


def test_a_name_that_is_not_text_is_escaped(frames, tmp_path):
    for name in (b"\xff\xfe.png", b"\x1b[31mred.png"):
        save(tmp_path / os.fsdecode(name), frames[0])
    names = {frame.source for frame in read_recording(tmp_path, "luma")}
    assert names == {"\\x1b[31mred.png", "\\udcff\\udcfe.png"}


@pytest.mark.parametrize(
    "kind", ["grey", "batch", "colour", "colours", "floats", "alpha", "pillow", "deep"]
)
def test_arrays_and_pictures_in_memory(frames, kind):
    colours = np.repeat(frames[..., None], 3, axis=3)
    alpha = np.concatenate([colours[0], np.zeros((80, 96, 1), np.uint8)], axis=2)
    sources = {
        "grey": frames[0],
        "batch": frames,
        "colour": colours[0],
        "colours": colours,
        "floats": frames[0] / 255,
        "alpha": alpha,
        "pillow": Image.fromarray(colours[0]),
        "deep": frames[0].astype(np.uint16) * 257,
    }
    read = [frame.grey for frame in read_source(sources[kind], "luma")]
    assert np.array_equal(read, frames if kind in ("batch", "colours") else frames[:1])


@pytest.mark.parametrize(
    ("values", "refusal"),
    [
        (
            np.zeros((2, 2, 2, 2)),
            r"the array's shape is \(2, 2, 2, 2\): it must be \(H,W\)",
        ),
        (np.zeros((0, 5)), "not empty"),
        (np.array(["a"]), "it must hold integers or floats"),
        (np.full((2, 2), -1.0), "it must hold values from 0 to 65535"),
        (np.zeros(5), r"is \(5,\)"),
    ],
)
def test_arrays_that_are_no_pictures_are_refused(values, refusal):
    with pytest.raises(VoccError, match=refusal):
        list(read_array(values, "luma"))


def test_what_is_no_input_is_refused():
    with pytest.raises(
        VoccError, match="the input is 3: it must be a path, a picture, an array"
    ):
        read_source(3, "luma")


def test_bytes_of_white_levels():
    for white in (1023, 4095, 16383, 65535):
        scaled, _ = to_bytes(np.array([0, white], np.uint16))
        assert scaled.tolist() == [0, 255]


@pytest.mark.parametrize("turn", [0, 90, 180, 270])
@pytest.mark.parametrize("mirror", [False, True])
def test_turned_frames_are_those_of_pillow(frames, turn, mirror):
    (frame,) = turned(read_array(frames[0], "luma"), turn, mirror)
    shown = Image.fromarray(frames[0]).rotate(-turn, expand=True)
    if mirror:
        shown = shown.transpose(Image.Transpose.FLIP_LEFT_RIGHT)
    assert np.array_equal(frame.grey, np.asarray(shown))
    assert np.array_equal(frame.colour[..., 1], frame.grey)


def test_another_angle_is_refused():
    with pytest.raises(
        VoccError, match=r"decode\.turn is 45: it must be 0, 90, 180 or 270 degrees"
    ):
        turned(iter(()), 45, False)
