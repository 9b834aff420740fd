"""Films against what FFmpeg was given: rotation, fields, damage, names; and live frames from a pipe."""

import os
import re
import threading
import time

import av
import cv2
import numpy as np
import pytest
from film_files import write_film
from test_pictures import frames as frames
from test_pictures import read_to_the_end

from vocc_torch.errors import VoccError
from vocc_torch.recordings.films import read_film
from vocc_torch.recordings.reading import expected_frames, read_recording
from vocc_torch.recordings.streams import LiveStream


def distance(one, other):
    """Mean difference of grey values."""
    return np.abs(np.asarray(one).astype(float) - other).mean()


@pytest.mark.parametrize("name", ["drive.mp4", "DRIVE.AVI"])
@pytest.mark.parametrize("grey_only", [False, True])
def test_a_film_frame_by_frame(frames, tmp_path, name, grey_only):
    read = list(
        read_recording(write_film(tmp_path / name, frames), "luma", grey_only=grey_only)
    )
    assert [frame.index for frame in read] == list(range(8))
    assert [frame.time_s for frame in read] == pytest.approx(
        [index / 25 for index in range(8)], abs=1e-3
    )
    assert (
        max(
            distance(frame.grey, grey) for frame, grey in zip(read, frames, strict=True)
        )
        < 4
    )
    assert (read[0].colour == 0).all() == grey_only


@pytest.mark.parametrize("suffix", ["ts", "m2ts", "mts", "3gp", "wmv", "flv", "y4m"])
def test_films_of_other_containers(frames, tmp_path, suffix):
    codec = {"ts": "mpeg2video", "flv": "flv", "wmv": "wmv2", "y4m": "wrapped_avframe"}
    path = tmp_path / f"film.{suffix}"
    write_film(path, frames, codec.get(suffix, "mpeg4"))
    assert len(list(read_recording(path, "luma"))) == len(frames)


def test_the_frames_of_a_film_and_of_a_folder_are_known_before_they_are_read(
    frames, tmp_path
):
    write_film(tmp_path / "film.mp4", frames)
    assert expected_frames(tmp_path / "film.mp4") == len(frames)
    (tmp_path / "no film.mp4").write_bytes(b"text")
    assert expected_frames(tmp_path / "no film.mp4") == 0
    for number, grey in enumerate(frames):
        cv2.imwrite(str(tmp_path / f"{number}.png"), grey)
    (tmp_path / "._0.png").write_bytes(b"what macOS knows of 0.png")
    assert expected_frames(tmp_path) == len(frames)


@pytest.mark.parametrize("degrees", [90, 180, 270])
@pytest.mark.parametrize("grey_only", [False, True])
def test_a_film_turned_by_its_header_is_read_upright(
    frames, tmp_path, degrees, grey_only
):
    """The display matrix is written into the container, as telephones do."""
    path = write_film(tmp_path / "flat.mp4", frames)
    content = path.read_bytes()
    # Past version, times, track, length, layer and volume.
    place = content.index(b"tkhd") + 4 + 4 + 20 + 16
    cosine, sine = {90: (0, 1), 180: (-1, 0), 270: (0, -1)}[degrees]
    matrix = np.array(
        [cosine << 16, sine << 16, 0, -sine << 16, cosine << 16, 0, 0, 0, 1 << 30],
        ">i4",
    )
    path.write_bytes(content[:place] + matrix.tobytes() + content[place + 36 :])
    read = list(read_film(path, "luma", grey_only=grey_only))
    # OpenCV counts quarter turns clockwise from 0.
    upright = cv2.rotate(frames[0], (degrees // 90) - 1)
    assert np.asarray(read[0].grey).shape == upright.shape
    assert distance(read[0].grey, upright) < 4
    assert read[0].note == f"turned by {degrees} degrees as the film's header says"


def test_each_field_of_interlaced_film_is_a_frame(frames, tmp_path):
    """Two pictures woven line by line are read apart."""
    woven = np.repeat(frames[:1], 4, axis=0)
    woven[:, 1::2] = frames[1, 1::2]
    read = list(
        read_film(
            write_film(tmp_path / "fields.avi", woven, "mpeg2video", interlaced=True),
            "luma",
        )
    )
    assert len(read) == 8
    assert "two fields" in read[0].note
    for index in (0, 1):
        assert distance(read[index].grey, frames[index]) < 5
    assert read[1].time_s - read[0].time_s == pytest.approx(0.02, abs=1e-3)


@pytest.mark.parametrize("name", ["drive.mkv", "drive.avi"])
def test_of_a_film_that_is_cut_the_beginning_is_read(frames, tmp_path, name):
    path = write_film(tmp_path / name, frames)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    said = (
        rf"{name}: \d frames were read, . of them damaged, and its header speaks of 8"
    )
    with pytest.warns(UserWarning, match=said):
        done, refusal = read_to_the_end(read_recording(path, "luma"))
    assert 3 <= done < 8
    assert not refusal or f"after {done} frames" in refusal


def test_of_a_damaged_film_the_other_frames_are_read(frames, tmp_path):
    """The third frame's start code is overwritten."""
    path = write_film(tmp_path / "drive.mkv", frames)
    content = bytearray(path.read_bytes())
    place = [found.start() for found in re.finditer(b"\0\0\1\xb6", content)][2]
    content[place : place + 4] = bytes(4)
    path.write_bytes(content)
    with pytest.warns(
        UserWarning,
        match="7 frames were read, . of them damaged, and its header speaks of 8",
    ):
        done, refusal = read_to_the_end(read_recording(path, "luma"))
    assert done == 7
    assert "cannot be read as a video after 7 frames" in refusal


PLAYLIST = b"ffconcat version 1.0\nfile other.mkv\n"


@pytest.mark.parametrize("content", [bytes(range(256)) * 20, b"", PLAYLIST])
def test_files_that_are_no_films_are_refused_in_one_line(tmp_path, content):
    (tmp_path / "noise.mp4").write_bytes(content)
    os.mkfifo(tmp_path / "other.mkv")  # which a playlist would wait for
    with pytest.raises(
        VoccError, match=r"noise\.mp4 cannot be read as a video after 0 frames"
    ) as refusal:
        list(read_recording(tmp_path / "noise.mp4", "luma"))
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("suffix", ["mkv", "ts", "y4m"])
def test_a_film_on_standard_input_is_read_frame_by_frame(
    command, frames, tmp_path, suffix
):
    codec = {"mkv": "mpeg4", "ts": "mpeg2video", "y4m": "wrapped_avframe"}[suffix]
    path = write_film(tmp_path / f"film.{suffix}", frames, codec)
    code = (
        "import numpy as np; from vocc_torch.recordings.reading import read_source;"
        "print([round(float(np.mean(frame.grey))) for frame in read_source('-', 'luma')])"
    )
    with path.open("rb") as film:
        ran = command(cwd=tmp_path, code=code, stdin=film)
    means = [round(float(grey.mean())) for grey in frames]
    assert np.abs(np.array(eval(ran.out)) - means).max() <= 3, ran.err


@pytest.mark.parametrize(
    ("source", "newest", "dropped"),
    [("camera:0", None, 7), ("camera:0", False, 0), ("-", None, 0), ("-", True, 7)],
)
def test_of_frames_that_a_receiver_is_late_for_the_newest_or_all_come(
    frames, tmp_path, monkeypatch, source, newest, dropped
):
    """The film stands for a live source; all is read, or one frame, before the first is taken."""
    container = av.open(str(write_film(tmp_path / "film.mkv", frames)))
    monkeypatch.setattr(
        "vocc_torch.recordings.streams.opened", lambda source: container
    )
    stream = LiveStream(source, "luma", newest=newest)
    deadline = time.monotonic() + 20
    while stream.dropped < dropped and time.monotonic() < deadline:
        time.sleep(0.01)
    assert [frame.index for frame in stream] == list(range(dropped, 8))
    assert stream.dropped == dropped


def test_the_thread_of_a_stream_that_is_closed_between_two_fields_ends(
    frames, tmp_path, monkeypatch
):
    path = write_film(tmp_path / "film.mkv", frames, "mpeg2video", interlaced=True)
    container, before = av.open(str(path)), threading.active_count()
    monkeypatch.setattr(
        "vocc_torch.recordings.streams.opened", lambda source: container
    )
    stream = LiveStream("-", "luma")
    taken = iter(stream)
    fields = [next(taken), next(taken)]
    while stream.queue.empty():
        time.sleep(0.01)
    stream.close()
    deadline = time.monotonic() + 5
    while threading.active_count() > before and time.monotonic() < deadline:
        time.sleep(0.01)
    assert [field.index for field in fields] == [0, 1]
    assert threading.active_count() == before


def test_a_stream_that_cannot_be_read_is_answered_by_what_can(monkeypatch):
    class Broken:
        def decode(self, video):
            raise av.error.InvalidDataError(1, "invalid data")

    monkeypatch.setattr("vocc_torch.recordings.streams.opened", lambda source: Broken())
    with pytest.raises(VoccError, match=r"invalid data.*it takes Matroska"):
        list(LiveStream("-", "luma"))


def test_a_camera_that_is_not_there_is_refused():
    with pytest.raises(
        VoccError, match=r"input camera:97 cannot be opened \((?!\[Errno)"
    ):
        LiveStream("camera:97", "luma")
