"""``vocc_torch.decode``: anything that a person has, read as the command reads it."""

import csv
import subprocess
import sys
import warnings

import numpy as np
import pillow_heif
import pytest
import torch
from composing import composed
from film_files import write_film
from PIL import Image

import vocc_torch as vt
from vocc_torch.app.cli import run_task

HEAVY = (
    "vocc_torch.simulation",
    "vocc_torch.measure.plan",
    "vocc_torch.measure.train",
    "matplotlib",
    "tensorboard",
    "scipy",
    "kornia",
    "jinja2",
    "torch._dynamo",
    "av",
)
"""What a picture is decoded without."""


@pytest.fixture(scope="module")
def receiver():
    """A quick receiver that reads the photograph."""
    return vt.train("paper", frames=64)


@pytest.fixture(scope="module")
def grey(photo):
    """The photograph's greys (H,W)."""
    return np.asarray(Image.open(photo).convert("L"))


def texts(*source, **options):
    """The bits that are read of each frame."""
    return [reading.text for reading in vt.decode(*source, **options)]


IN_MEMORY = {
    "bytes (H,W)": lambda grey: grey,
    "floats (H,W)": lambda grey: grey / 255,
    "floats of torch": lambda grey: torch.from_numpy(grey.copy()).float() / 255,
    "16 bits": lambda grey: grey.astype(np.uint16) * 257,
    "colours (H,W,3)": lambda grey: grey[..., None].repeat(3, 2),
    "frames (B,H,W)": lambda grey: np.stack([grey, grey]),
    "Pillow": Image.fromarray,
}


@pytest.mark.parametrize("kind", IN_MEMORY)
def test_pictures_in_memory(receiver, grey, photo_bits, kind):
    read = texts(IN_MEMORY[kind](grey), receiver)
    assert read == [photo_bits] * (1 + kind.startswith("frames"))


def exif(orientation):
    """EXIF data that says how a picture lies."""
    data = Image.Exif()
    data[0x0112] = orientation
    return data


def with_alpha(picture):
    """A picture whose right half is transparent."""
    picture = picture.convert("RGBA")
    mask = Image.new("L", picture.size, 255)
    mask.paste(0, (picture.width // 2, 0, picture.width, picture.height))
    picture.putalpha(mask)
    return picture


FILES = {
    "phone.heic": lambda path, picture: pillow_heif.from_pillow(
        picture.convert("RGB")
    ).save(path, quality=90),
    "web.avif": lambda path, picture: picture.convert("RGB").save(path, quality=90),
    "deep.png": lambda path, picture: Image.fromarray(
        np.asarray(picture).astype(np.uint16) * 257
    ).save(path),
    "turned.jpg": lambda path, picture: picture.rotate(90, expand=True).save(
        path, quality=95, exif=exif(6)
    ),
    "moving.gif": lambda path, picture: picture.save(path),
    "float.tif": lambda path, picture: Image.fromarray(
        np.asarray(picture).astype(np.float32) / 255
    ).save(path),
    "alpha.png": lambda path, picture: with_alpha(picture).save(path),
    "palette.png": lambda path, picture: picture.convert("P").save(path),
    "print.jpg": lambda path, picture: picture.convert("CMYK").save(path, quality=95),
    "web.webp": lambda path, picture: picture.convert("RGB").save(path, quality=90),
}


@pytest.mark.parametrize("name", FILES)
def test_ten_files_of_a_person(receiver, grey, photo_bits, tmp_path, name):
    """The formats of phones, cameras, scanners and the web."""
    FILES[name](tmp_path / name, Image.fromarray(grey))
    assert texts(tmp_path / name, receiver, turn=0) == [photo_bits]


def test_a_film_that_lies_on_its_side(receiver, grey, photo_bits, tmp_path):
    """``turn`` is clockwise, ``numpy.rot90`` is not."""
    turned = np.ascontiguousarray(np.rot90(grey)[None, :360, :346])
    write_film(tmp_path / "side.mp4", turned)
    assert texts(tmp_path / "side.mp4", receiver, turn=90) == [photo_bits]


def test_of_a_folder_what_cannot_be_read_is_named(receiver, photo, tmp_path):
    (tmp_path / "a.png").write_bytes(photo.read_bytes())
    (tmp_path / "b.raw").write_bytes(b"\0" * 9)
    with pytest.warns(UserWarning, match="b.raw is not a known kind of picture"):
        assert len(texts(tmp_path, receiver)) == 1


@pytest.mark.parametrize(
    ("source", "options", "refusal"),
    [
        (np.zeros((2, 3, 4, 5)), {}, "the array's shape is"),
        (np.zeros((4, 5)) - 1, {}, "the array cannot be read"),
        (7, {}, "the input is 7"),
        ("no.png", {}, "input no.png does not exist"),
        (np.zeros((4, 5)), {"channel": "grey"}, "^channel is 'grey'"),
        (np.zeros((4, 5)), {"turn": 45}, "^turn is 45"),
        (np.zeros((4, 5)), {"model": "rain.pt"}, "model rain.pt does not exist"),
        (np.zeros((4, 5)), {"rows": 0}, "panel.rows is 0"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(source, options, refusal):
    with pytest.raises(vt.VoccError, match=refusal) as said:
        vt.decode(source, **options)
    assert "\n" not in str(said.value)


def test_the_command_reads_the_same_bits(photo, photo_bits, tmp_path):
    settings = composed("task=decode", f"input={photo}", "name=x")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # nothing about it is in doubt
        run_task(settings, tmp_path / "out")
    with (tmp_path / "out" / "bits.csv").open(newline="") as file:
        (_, *rows) = csv.reader(file)
    (reading,) = vt.decode(photo)
    assert rows == [reading.row()]
    assert reading.text == photo_bits


def test_a_picture_is_decoded_without_what_simulates_and_draws(photo, tmp_path):
    """In a process of its own, for this one has imported everything."""
    code = (
        "import sys; from vocc_torch.app.cli import run; "
        f"sys.argv = ['vocc-torch', 'task=decode', 'input={photo}']; assert run() == 0; "
        f"print(sorted(name for name in sys.modules if name in {HEAVY}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines()[-1] == "[]"
