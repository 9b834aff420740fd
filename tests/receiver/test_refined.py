from dataclasses import replace

import numpy as np
import pytest
import torch

from vocc_torch.receiver.locators import PaperLocator, RefinedLocator
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import Camera, LedPanel, SceneModel, Simulator
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import Frames, Panels, PanelShape, Scene

SHAPE = PanelShape(8, 8)
NOISE = {
    "photoelectrons": {"quantum_efficiency": 0.5},
    "shot_noise": {},
    "read_noise": {"electrons": 5},
}
# The lattice model has no level for the panel's face: see the last test.
BARE = LedPanel(board_reflectance=None)
SMALL = Camera(width_px=480, height_px=320, sensor_width_mm=480 * 13.2 / 1920)


def errors_px(panels, truth):
    """The farthest corner of each panel."""
    return (panels.corners_px - truth.corners_px).norm(dim=2).amax(1)


def keys(count):
    return [FrameKey(BlockKey(0, "refined", 0), index) for index in range(count)]


def small_scenes(count, **changes):
    """Panels near the middle of a small sensor, each at its own part of a pixel."""
    rng = np.random.default_rng(7)
    place = [torch.from_numpy(rng.uniform(-0.5, 0.5, count)) for _ in range(2)]
    scene = replace(
        Scene.of(count, **changes), offset_x_m=place[0], offset_y_m=place[1]
    )
    return scene, torch.from_numpy(rng.random((count, 8, 8)) < 0.5)


@pytest.fixture(scope="module")
def paper_scenes():
    """64 frames over the whole of Table 1."""
    scene, bits = SceneModel().draw(BlockKey(0, "refined", 0), SHAPE)
    simulator = Simulator(panel=BARE)
    return (
        simulator.render(scene, bits, nearest_m=30.0),
        simulator.true_panels(scene),
        bits,
    )


def test_corners_of_the_papers_scenes_are_found_within_a_fifth_of_a_pixel(paper_scenes):
    frames, truth, _ = paper_scenes
    panels = RefinedLocator()(frames, SHAPE)
    assert panels.found.all()
    assert (panels.score > 0.99).all()
    error = errors_px(panels, truth)
    assert error.max() < 0.2
    assert (
        error.median()
        < 0.06
        < 0.5
        < errors_px(PaperLocator()(frames, SHAPE), truth).median()
    )


@pytest.mark.parametrize(
    ("distance_m", "ambient_lx"), [(30.0, 1000.0), (50.0, 8000.0), (70.0, 8000.0)]
)
def test_panels_are_found_in_sensor_noise(distance_m, ambient_lx):
    scene, bits = small_scenes(8, distance_m=distance_m, ambient_lx=ambient_lx)
    simulator = Simulator(
        SMALL, BARE, effects={**PAPER_EFFECTS, **NOISE, "gain": {}}, framing="full"
    )
    frames = simulator.render(scene, bits, keys=keys(8))
    assert frames.surround is None
    panels = RefinedLocator()(frames, SHAPE)
    assert panels.found.all()
    assert errors_px(panels, simulator.true_panels(scene)).max() < 0.4


@pytest.mark.parametrize(
    "pose", [{"roll_deg": 30}, {"yaw_deg": 25, "pitch_deg": 5}, {"roll_deg": -44}]
)
def test_turned_panels_are_found_as_they_are_seen(pose):
    scene, bits = small_scenes(12)
    simulator = Simulator(SMALL, BARE, effects={**PAPER_EFFECTS, "pose": pose})
    frames, truth = (
        simulator.render(scene, bits, keys=keys(12)),
        simulator.true_panels(scene, keys(12)),
    )
    assert errors_px(RefinedLocator()(frames, SHAPE), truth).max() < 0.3


def test_what_no_lattice_explains_is_left_to_the_papers_locator():
    rng = np.random.default_rng(3)
    blob = np.full((96, 96), 60, np.uint8)
    blob[30:66, 30:66] = rng.integers(70, 255, (36, 36))
    noise = rng.normal(100, 12, (96, 96)).clip(0, 255).astype(np.uint8)
    frames = Frames.whole(
        torch.from_numpy(np.stack([blob, noise, np.full_like(blob, 9)]))
    )
    ours, papers = RefinedLocator()(frames, SHAPE), PaperLocator()(frames, SHAPE)
    assert papers.found.tolist() == [True, True, False]
    for name in Panels.__slots__:
        assert torch.equal(getattr(ours, name), getattr(papers, name)), name


@pytest.mark.parametrize("block", [0, 1])
def test_corners_of_a_panel_with_a_face_are_found(block):
    scene, bits = SceneModel().draw(BlockKey(0, "refined", block), SHAPE)
    simulator = Simulator()
    frames = simulator.render(scene, bits, nearest_m=30.0)
    assert (
        errors_px(RefinedLocator()(frames, SHAPE), simulator.true_panels(scene)).max()
        < 0.2
    )
