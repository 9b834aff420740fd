"""Pictures of every kind against Pillow, NumPy and pillow-heif; damaged ones are refused in a line."""

import os
import sys

import cv2
import numpy as np
import pillow_heif
import pytest
import torch
from PIL import Image

from vocc_torch.errors import VoccError
from vocc_torch.recordings.frames import to_grey, turned
from vocc_torch.recordings.pictures import read_array
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


def test_files_of_a_folder_that_are_no_known_pictures_are_named(frames, tmp_path):
    save(tmp_path / "1.jfif", frames[0], format="JPEG")
    (tmp_path / "._1.jfif").write_bytes(b"what macOS knows of 1.jfif")
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


@pytest.mark.parametrize("suffix", ["png", "tiff"])
@pytest.mark.parametrize("bits", [10, 12, 16])
def test_deep_colours_are_scaled_likewise(frames, tmp_path, suffix, bits):
    """Pillow alone keeps the upper eight of 16 bits, of which 10-bit colours use two."""
    path = tmp_path / f"deep.{suffix}"
    bgr = np.stack([frames[0], frames[0] // 2, frames[1]], axis=2)
    cv2.imwrite(str(path), np.rint(bgr * ((2**bits - 1) / 255.0)).astype(np.uint16))
    (frame,) = read_recording(path, "luma")
    assert np.abs(frame.colour[..., ::-1].astype(int) - bgr).max() <= 1
    assert (f"read as {bits} bits" in frame.note) == (bits < 16)


def test_each_page_of_deep_colours_is_read(tmp_path):
    pages = [np.full((9, 9, 3), level, np.uint16) for level in (300, 900)]
    cv2.imwritemulti(str(tmp_path / "deep.tiff"), pages)
    read = read_recording(tmp_path / "deep.tiff", "luma")
    assert [frame.grey.max() for frame in read] == [75, 224]


def test_dark_colours_need_no_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    cv2.imwrite(str(tmp_path / "dark.png"), np.full((9, 9, 3), 12000, np.uint16))
    (frame,) = read_recording(tmp_path / "dark.png", "luma")
    assert (frame.grey == 12000 // 256).all()
    assert "vocc-torch[video]" in frame.note


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
    "source",
    [
        torch.ones(4, 4).to_sparse(),
        torch.ones(4, 4, device="meta"),
        torch.ones(4, 4, dtype=torch.bfloat16),
        "a" * 5000,
    ],
    ids=["sparse", "meta", "bfloat16", "long"],
)
def test_tensors_without_numbers_and_names_too_long_are_refused(source):
    with pytest.raises(VoccError, match=r"no array of numbers|does not exist"):
        next(read_source(source, "luma"))


def test_what_is_no_input_is_refused():
    with pytest.raises(
        VoccError, match="the input is 3: it must be a path, a picture, an array"
    ):
        read_source(3, "luma")


@pytest.mark.parametrize("turn", [0, 90, 180, 270])
@pytest.mark.parametrize("mirror", [False, True])
def test_turned_frames_are_those_of_pillow(frames, turn, mirror):
    (frame,) = turned(read_array(frames[0], "luma"), turn, mirror)
    shown = Image.fromarray(frames[0]).rotate(-turn, expand=True)
    if mirror:
        shown = shown.transpose(Image.Transpose.FLIP_LEFT_RIGHT)
    assert np.array_equal(frame.grey, np.asarray(shown))
    assert np.array_equal(frame.colour[..., 1], frame.grey)


@pytest.mark.filterwarnings("error")
def test_half_precision_reads_without_a_warning():
    """Its largest number is below 65535."""
    (frame,) = read_array(np.full((4, 5), 0.5, np.float16), "luma")
    assert (frame.grey == 128).all()


def test_a_frame_prints_without_its_pixels():
    (frame,) = read_array(np.zeros((40, 50), np.uint8), "luma")
    assert "[[" not in repr(frame)


def test_a_file_of_an_array_reads_as_the_array_does(frames, tmp_path):
    path = tmp_path / "a.npy"
    colour = np.repeat(frames[0][..., None], 3, axis=2)
    for values in (frames[0], np.stack(frames), frames[0] / 255.0, colour):
        np.save(path, values)
        read = list(read_source(path, "luma"))
        wanted = list(read_array(np.asarray(values), "luma"))
        assert [one.source for one in read] == ["a.npy"] * len(wanted)
        for one, other in zip(read, wanted, strict=True):
            assert np.array_equal(one.grey, other.grey)
    np.save(path, -frames[0].astype(float))
    with pytest.raises(VoccError, match=r"^input .*a\.npy cannot be read: it holds"):
        list(read_source(path, "luma"))


def test_a_file_of_floats_is_not_read_beyond_memory(tmp_path):
    """Only uint8 is read frame by frame. The file takes no place on the disk."""
    path = tmp_path / "a.npy"
    np.lib.format.open_memmap(path, "w+", np.float32, (300, 1000, 1000))
    with pytest.raises(VoccError, match="holds 1200000000 bytes of float32, and at"):
        next(read_source(path, "luma"))
