"""The detector as a locator: what a user may rely on, with the weights that ship."""

import json
import math
from importlib import resources
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from vocc_torch import Camera, Scene, Simulator
from vocc_torch.errors import VoccError
from vocc_torch.receiver.detector.weights import SHIPPED
from vocc_torch.receiver.locators import DetectorLocator
from vocc_torch.types import PanelShape

SHAPE = PanelShape(8, 8)
FILE = resources.files("vocc_torch.receiver.detector") / SHIPPED


@pytest.fixture(scope="module")
def rendered():
    """Three frames of the paper's panel, and the simulator's corners."""
    camera = Camera(width_px=320, height_px=240, sensor_width_mm=2.2)
    simulator, scene = Simulator(camera, framing="full"), Scene.of(3, distance_m=40.0)
    bits = torch.rand(3, 8, 8, generator=torch.Generator().manual_seed(5)) < 0.5
    corners = simulator.true_panels(scene).corners_px
    return simulator.render(scene, bits), corners


@pytest.fixture(scope="module")
def panels(rendered):
    return DetectorLocator()(rendered[0], SHAPE)


def test_panels_lie_where_they_were_rendered_and_alarms_are_stated(rendered, panels):
    pitch = (rendered[1][:, 1] - rendered[1][:, 0]).norm(dim=1) / 8
    off = (panels.corners_px - rendered[1]).norm(dim=2).amax(1) / pitch
    assert panels.found.all()
    assert (off < 0.25).all()
    assert (panels.false_alarms <= 1e-2).all()


def test_what_is_found_does_not_depend_on_the_batch(rendered, panels):
    alone = DetectorLocator()(rendered[0][1:2], SHAPE)
    assert torch.equal(alone.corners_px[0], panels.corners_px[1])
    assert torch.equal(alone.score[0], panels.score[1])


@pytest.mark.parametrize("arithmetic", ["float32", "int8"])
@pytest.mark.parametrize("scale", [0.25, 0.7, 1.0, 1.2])
def test_a_photographed_panel_is_not_placed_a_row_aside(scale, arithmetic):
    """Its outer rows are hazy and cut by the photograph's edges; corners by OpenCV from the centres of LEDs."""
    data = Path(__file__).parents[1] / "data"
    truth = json.loads((data / "pictures.json").read_text())["led-panel-8x8-photo.png"]
    with Image.open(data / "led-panel-8x8-photo.png") as photo:
        size = [round(side * scale) for side in photo.size]
        grey = np.array(photo.convert("L").resize(size, Image.Resampling.BOX))
    ends = np.array([[[0.5, 0.5], [7.5, 0.5], [7.5, 7.5], [0.5, 7.5]]], np.float32)
    centres = np.array([truth["corner_led_centres_px"]], np.float32) * scale
    matrix = cv2.getPerspectiveTransform(ends, centres)
    cells = np.array([[[0, 0], [8, 0], [8, 8], [0, 8]]], np.float32)
    expected = cv2.perspectiveTransform(cells, matrix)[0]
    locator = DetectorLocator(arithmetic=arithmetic)
    found = locator(torch.from_numpy(grey)[None, None], SHAPE)
    off = np.linalg.norm(found.corners_px[0].numpy() - expected, axis=1).max()
    assert off < 0.25 * 44 * scale


@pytest.mark.parametrize("level", [0, 90, 255])
def test_nothing_is_found_where_nothing_is(level):
    grey = torch.full((1, 96, 128), level, dtype=torch.uint8)
    assert not DetectorLocator()(grey, SHAPE).found.any()


def test_weights_of_ones_own_state_nothing(tmp_path, rendered, panels):
    path = tmp_path / "mine.json"
    path.write_bytes(FILE.read_bytes())
    locator = DetectorLocator(str(path))
    found = locator(rendered[0][:1], SHAPE)
    assert torch.equal(found.corners_px[0], panels.corners_px[0])
    assert not locator.states_false_alarms
    assert math.isnan(locator.most_false_alarms)
    with pytest.raises(VoccError, match=r"location\.false_alarms is 0\.03"):
        DetectorLocator(str(path), false_alarms=0.03)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace('"judge.', '"other.'), "checksum does not fit"),
        (lambda text: text[: len(text) // 2], "damaged or of another kind"),
        (
            lambda text: json.dumps({**json.loads(text), "version": 99}),
            "format version 99",
        ),
    ],
)
def test_damaged_weights_are_refused(tmp_path, change, message):
    path = tmp_path / "mine.json"
    path.write_text(change(FILE.read_text()))
    with pytest.raises(VoccError, match=f"weights .*{message}"):
        DetectorLocator(str(path)).check()
