"""Rows and columns of a panel that nobody names."""

import json

import numpy as np
import pytest
from PIL import Image

import vocc_torch as vt
from vocc_torch.studies.decode import shapes
from vocc_torch.types import PanelShape


@pytest.mark.parametrize(
    "name", ["led-panel-8x8-photo.png", "led-matrix-8x16-desk.jpg"]
)
def test_the_shape_of_photographed_panels(photo, name):
    """Columns of rows that are known; all twelve shapes take some seconds more."""
    truth = json.loads((photo.parent / "pictures.json").read_text())[name]
    grey = np.asarray(Image.open(photo.parent / name).convert("L"))
    choice = shapes.find_shape("street", [grey], truth["rows"], "auto")
    assert (choice.shape.rows, choice.shape.columns) == (
        truth["rows"],
        truth["columns"],
    )
    assert choice.is_sure, str(choice)


def test_a_shape_is_sure_where_the_next_is_far(monkeypatch):
    """On the second frame, where the first shows none; a frame without a panel is not sure."""
    rates = iter([1.0, 1.0, 1.0, 1e-6, 1e-3, 1.0])
    monkeypatch.setattr(shapes, "false_alarms", lambda *_: next(rates))
    grey = np.zeros((9, 9), np.uint8)
    choice = shapes.find_shape("street", [grey, grey], 32, "auto")
    assert choice == (PanelShape(32, 8), 1e-6, PanelShape(32, 16), 1e-3)
    assert choice.is_sure
    for first, second in ([1e-6, 2e-5], [2e-3, 1.0], [1.0, 1.0]):
        assert not choice._replace(false_alarms=first, next_alarms=second).is_sure


def test_a_receiver_of_ones_own_knows_its_shape():
    with pytest.raises(vt.VoccError, match="columns is auto"):
        vt.decode(np.zeros((9, 9)), vt.train("paper", frames=16), rows="auto")


def test_a_number_that_no_usual_panel_has():
    with pytest.raises(
        vt.VoccError, match=r"panel.rows is 7: it must be one of \[4, 8"
    ):
        shapes.find_shape("street", [], 7, "auto")
