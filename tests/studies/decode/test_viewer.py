"""The viewer gets what was read; where its library is missing, one line says what to install."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from vocc_torch.errors import VoccError
from vocc_torch.recordings.frames import RecordedFrame
from vocc_torch.studies.decode.reading import Reading
from vocc_torch.studies.decode.viewer import Viewer


def library(calls):
    """A library that notes what it is told, in place of Rerun's."""

    def noted(name):
        return lambda *values, **named: calls.append((name, values, named)) or name

    names = (
        "init",
        "spawn",
        "set_time",
        "log",
        "Image",
        "LineStrips2D",
        "Points2D",
        "Clear",
    )
    return SimpleNamespace(**{name: noted(name) for name in names})


def reading(found):
    """A panel of 1 x 2 LEDs, 4 px wide and 2 px high."""
    frame = RecordedFrame(
        "film.mp4", 7, 0.1, np.zeros((4, 6, 3), np.uint8), np.zeros((4, 6), np.uint8)
    )
    corners_px = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]])
    judged = {}, 0.5, 1.0, 1, False, 0.0, False
    return Reading(frame, found, corners_px, np.array([[True, False]]), *judged)


def test_the_viewer_gets_frame_corners_and_bits(monkeypatch):
    calls = []
    monkeypatch.setitem(sys.modules, "rerun", library(calls))
    viewer = Viewer()
    viewer.show(reading(True))
    sent = {name: values for name, values, _ in calls}
    assert np.array_equal(sent["Points2D"][0], [[1.0, 1.0], [3.0, 1.0]])
    assert np.array_equal(sent["LineStrips2D"][0][0][0], sent["LineStrips2D"][0][0][-1])
    assert ("set_time", ("frame",), {"sequence": 7}) in calls
    viewer.show(reading(False))
    assert calls[-1][:2] == ("log", ("frame/panel", "Clear"))


def test_the_library_itself_keeps_what_is_sent(monkeypatch, tmp_path):
    """Into a file, in place of a window."""
    rerun = pytest.importorskip("rerun")
    path = tmp_path / "x.rrd"
    monkeypatch.setattr(rerun, "spawn", lambda: rerun.save(str(path)))
    viewer = Viewer()
    for found in (True, False):
        viewer.show(reading(found))
    rerun.disconnect()
    kept = path.read_bytes()
    assert all(name in kept for name in (b"frame/panel/bits", b"LineStrips2D"))


def test_a_missing_library_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(
        VoccError, match=r"decode\.show is true: install the extra with pip install"
    ):
        Viewer()
