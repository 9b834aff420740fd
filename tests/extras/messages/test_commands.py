"""``task=transmit``, ``task=record`` and ``task=receive`` from a file to the same file."""

import csv
import errno
import os
from pathlib import Path

import numpy as np
import pytest
import yaml
from composing import complaint_of, composed

from vocc_torch.app.cli import run_task
from vocc_torch.errors import VoccError
from vocc_torch.receiver.locators import RefinedLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.recordings.reading import read_recording

DOCS = Path(__file__).parents[3] / "docs"
TEXT = b"A message of some bytes that two commands carry. " * 12


@pytest.fixture(scope="module")
def sent(tmp_path_factory):
    """The folder of task=transmit."""
    folder = tmp_path_factory.mktemp("sent")
    (folder / "text.txt").write_bytes(TEXT)
    words = f"input='{folder / 'text.txt'}'", "name=x", "transmit.cell_px=8"
    run_task(composed("task=transmit", *words), folder / "out")
    return folder / "out"


@pytest.fixture(scope="module")
def seen(sent, tmp_path_factory):
    """The folder of task=record."""
    folder = tmp_path_factory.mktemp("seen") / "out"
    words = (
        "scene.distance_m=40",
        "scene.ambient_lx=8000",
        "record.fps=170",
        "record.margin=2",
    )
    run_task(composed("task=record", f"input='{sent}'", "name=x", *words), folder)
    return folder


@pytest.fixture(scope="module")
def model(trained, tmp_path_factory):
    """A receiver's file."""
    path = tmp_path_factory.mktemp("model") / "receiver.pt"
    Receiver("flda_3", RefinedLocator(), Reader(), trained).save(path)
    return path


def rows_of(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def receive(input_, folder, model, *words):
    """Run the task; its rows and its complaint."""
    settings = composed(
        "task=receive", f"input='{input_}'", "name=x", f"model='{model}'", *words
    )
    said = ""
    try:
        run_task(settings, folder)
    except VoccError as error:
        said = str(error)
    return rows_of(folder / "report.csv"), said


def test_the_film_is_the_frames_enlarged(sent):
    film = np.load(sent / "frames.npy")
    plan = yaml.safe_load((sent / "plan.yaml").read_text())
    shown = [
        frame.grey[4::8, 4::8] > 127
        for frame in read_recording(sent / "film.mp4", "luma")
    ]
    assert (np.stack(shown) == film).all()
    assert film.shape[1:] == (plan["rows"], plan["columns"]) == (8, 8)
    assert {path.name for path in sent.iterdir()} == {
        "frames.npy",
        "film.mp4",
        "plan.yaml",
        "config.yaml",
    }


def test_a_file_comes_back_from_the_video(seen, model, tmp_path, capsys):
    rows, said = receive(seen / "recording.mp4", tmp_path / "out", model)
    # Of the message's 5, three are sent twice.
    assert "8 of 8 packets arrived" in capsys.readouterr().out
    assert (tmp_path / "out" / "message.bin").read_bytes() == TEXT
    assert not said
    assert [row["sequence"] for row in rows if row["arrived"] == "1"][:5] == [
        "0",
        "1",
        "2",
        "3",
        "4",
    ]
    truth = rows_of(seen / "truth.csv")
    assert len(truth) == len(np.load(seen / "recording.npy", mmap_mode="r"))
    assert truth[-1]["symbol"] == "255"


def test_receiving_that_is_interrupted_writes_what_it_has(
    seen, model, tmp_path, monkeypatch
):
    def until_half(*given, **named):
        for one in read_recording(*given, **named):
            if one.index == 300:
                raise KeyboardInterrupt
            yield one

    monkeypatch.setattr(
        "vocc_torch.extras.messages.receive_task.read_recording", until_half
    )
    rows, said = receive(seen / "recording.mp4", tmp_path / "out", model)
    assert "interrupted after 256 frames" in said
    assert [row["sequence"] for row in rows if row["arrived"] == "1"] == [
        "0",
        "1",
        "2",
        "3",
    ]
    assert (tmp_path / "out" / "message.partial").read_bytes()[:400] == TEXT[:400]


def test_a_calibrated_scene_may_not_bear_the_name_of_one_that_ships(tmp_path):
    with pytest.raises(
        VoccError,
        match="name is 'night': it must be another name than that of a scene that",
    ):
        run_task(
            composed("task=calibrate", "name=night", "input=/dev/null"),
            tmp_path / "out",
        )


def test_a_recording_grows_as_frames_are_taken_and_a_full_disk_leaves_nothing(
    sent, tmp_path, monkeypatch
):
    """A file of its full size from the first frame on is a memory map, which a full disk ends by a signal."""
    sizes = []

    def until_full(path, frames, *_):
        for _, picture in zip(range(40), frames, strict=False):
            (file,) = path.parent.glob(".recording.*.npy")
            sizes.append((file.stat().st_size, picture.size))
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(
        "vocc_torch.extras.messages.record_task.write_video", until_full
    )
    words = f"input='{sent}'", "name=x", "scene.distance_m=40", "batch_frames=8"
    with pytest.raises(
        VoccError, match=r"cannot write .*recording.npy: No space left on device"
    ):
        run_task(composed("task=record", *words), tmp_path / "out")
    assert max(size for size, _ in sizes) < 60 * sizes[0][1]  # of 300 frames
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            "task=transmit transmit.code_rate=1.5",
            "transmit.code_rate is 1.5: it must be above 0 and below 1",
        ),
        (
            "task=transmit scene.distance_m=50",
            "scene.distance_m is 50: task=transmit does not use it",
        ),
        ("task=record record.fps=0", "record.fps is 0: it must be above 0"),
        ("task=record panel.rows=4", "panel.rows is 4: task=record does not use it"),
        (
            "task=receive receive.soft=very",
            "receive.soft is 'very': it must be one of scores, calibrated",
        ),
        (
            "task=receive receive.channel=auto",
            "receive.channel is 'auto': it must be one of luma, max, red",
        ),
        (
            "task=messages messages.codes=[rs]",
            "messages.codes has 'rs': it must be none, or rs or ldpc",
        ),
        (
            "task=messages messages.ratio=[1.2]",
            "messages.ratio is 1.2: it must be at least 1.5 and at most",
        ),
        (
            "task=messages messages.distance_m=[] messages.ambient_lx=[] messages.ratio=[]",
            "messages varies n",
        ),
        (
            "task=messages messages.signalling.bands=0",
            "messages.signalling.bands is 0: it must be",
        ),
        ("task=record record.dropped=2", "record.dropped is 2: it must be at least 0"),
        (
            "task=messages messages.signalling.code=rs",
            "messages.signalling.code is rs: task=messages does no",
        ),
        (
            "task=messages messages.codes=[none,none]",
            "messages.codes is ['none', 'none']: it must be codes, each once",
        ),
        (
            "task=receive receiver.locator=truth",
            "receiver.locator is 'truth': it must be paper, refined or detector",
        ),
        (
            "task=receive model=r.pt scene=night",
            "scene is night: the model brings its own",
        ),
    ],
)
def test_what_is_refused_is_named(words, said):
    assert complaint_of(*words.split()).startswith(said)


SMALL = """
experiment=messages name=x scene=paper workers=2 budget.training_frames=64 classifier=[] messages.recordings=2
messages.signalling.block_symbols=32 messages.ratio=[] messages.ambient_lx=[] messages.at_ratio=1.5
experiment.training={distance_m:[uniform,30,70]} batch_frames=32
"""


@pytest.mark.slow
def test_a_study_of_messages(tmp_path):
    """Near, all packets arrive and no other ones; far, none does."""
    words = "messages.distance_m=[40,400]", "messages.codes=[none,rs-0.5]"
    run_task(composed(*SMALL.split(), *words), tmp_path / "out")
    rows = rows_of(tmp_path / "out" / "messages.csv")
    told = yaml.safe_load((DOCS / "columns.yaml").read_text())["messages.csv"]
    assert list(rows[0]) == list(told["columns"])
    # Distances, receivers, codes.
    assert len(rows) == 2 * 2 * 2
    lost = {
        value: {int(row["lost"]) for row in rows if float(row["value"]) == value}
        for value in (40, 400)
    }
    assert lost == {40: {0}, 400: {int(rows[0]["packets"])}}
    assert {row["false_packets"] for row in rows} == {"0"}
    chosen = [
        (float(row["value"]), row["receiver"], row["code"])
        for row in rows
        if row["best"] == "1"
    ]
    assert chosen == [(40.0, "flda_2", "none"), (40.0, "flda_3", "none")]
    files = {path.name for path in (tmp_path / "out").iterdir()}
    assert files == {"messages.csv", "messages.png", "config.yaml"}
