from dataclasses import replace

import numpy as np
import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.receiver.foreground import (
    bright_regions,
    local_background,
    ring_statistics,
)
from vocc_torch.receiver.lattice_fit import fit_lattice
from vocc_torch.receiver.lattice_model import Lattice, corner_cells, search_lattice
from vocc_torch.receiver.locators import PaperLocator, RefinedLocator
from vocc_torch.receiver.resample import map_points
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


@pytest.mark.parametrize("share", [-0.1, 1.1])
def test_a_share_out_of_its_range_is_refused(share):
    with pytest.raises(VoccError, match=r"location\.min_share is "):
        RefinedLocator(min_share=share)


def jittered(truth, seed=0):
    """Rectangles about the panels, up to 30 % too large and half a cell off."""
    rng = np.random.default_rng(seed)
    middle = truth.mean(1, keepdim=True)
    pitch = (truth[:, 1] - truth[:, 0]).norm(dim=1).view(-1, 1, 1) / 8
    size = torch.from_numpy(rng.uniform(0.95, 1.3, (len(truth), 1, 1)))
    return (
        middle
        + (truth - middle) * size
        + torch.from_numpy(rng.uniform(-0.5, 0.5, (len(truth), 1, 2))) * pitch
    )


def test_the_search_ends_within_a_third_of_a_cell(paper_scenes):
    frames, truth, _ = paper_scenes
    assert frames.surround is not None
    found, blur = search_lattice(
        frames, jittered(truth.corners_px), frames.surround.double(), SHAPE
    )
    pitch = (truth.corners_px[:, 1] - truth.corners_px[:, 0]).norm(dim=1) / 8
    assert ((found - truth.corners_px).norm(dim=2).amax(1) / pitch).quantile(0.9) < 0.35
    assert ((blur >= 0.16) & (blur <= 0.42)).all()


@pytest.mark.parametrize("by", [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])
def test_a_fit_a_line_off_comes_back(by):
    scene, bits = small_scenes(12, distance_m=40.0)
    # Off where the lattice has slipped away from, so that little light is left out.
    away = {
        (1.0, 0.0): (2, 0),
        (-1.0, 0.0): (2, -1),
        (0.0, 1.0): (1, 0),
        (0.0, -1.0): (1, -1),
    }[by]
    bits.select(*away).fill_(False)
    simulator = Simulator(SMALL, BARE)
    frames, truth = (
        simulator.render(scene, bits),
        simulator.true_panels(scene).corners_px,
    )
    assert frames.surround is not None
    cells = (corner_cells(SHAPE) + torch.tensor(by).double()).expand(12, 4, 2)
    start = Lattice.at(
        map_points(truth, cells, SHAPE),
        torch.full((12,), 0.3).double(),
        frames.surround.double(),
        SHAPE,
    )
    assert (fit_lattice(frames, start).corners_px - truth).norm(dim=2).max() < 0.2


def test_a_dark_thing_before_the_panel_hardly_moves_the_fit():
    scene, bits = small_scenes(12, distance_m=40.0)
    occlusion = {"occlusion": {"width_share": 0.15, "height_share": 0.15}}
    simulator = Simulator(SMALL, BARE, effects={**PAPER_EFFECTS, **occlusion})
    frames = simulator.render(scene, bits, keys=keys(12))
    error = errors_px(
        RefinedLocator()(frames, SHAPE), simulator.true_panels(scene, keys(12))
    )
    # Without weights it is 0.14 px.
    assert error.median() < 0.1


def test_regions_are_found_on_a_background_that_changes_slowly():
    rng = np.random.default_rng(1)
    slope = np.linspace(60, 140, 640)[None] + np.zeros((480, 1))
    grey = slope + rng.normal(0, 2, (480, 640))
    grey[200:232, 80:112] += 15
    regions = bright_regions(
        torch.from_numpy(grey.round().clip(0, 255).astype(np.uint8))[None, None]
    )
    assert regions.frame.tolist() == [0]
    x, y, side = regions.left_px.item(), regions.top_px.item(), regions.side_px.item()
    assert x <= 80 <= 112 <= x + side
    assert y <= 200 <= 232 <= y + side
    assert side <= 96


def test_the_local_background_follows_a_slope():
    slope = torch.linspace(50, 150, 240).expand(1, 135, 240)
    assert (local_background(slope) - slope)[:, :, 20:-20].abs().max() < 4


def test_noise_of_a_ring_is_its_deviation():
    rng = np.random.default_rng(2)
    grey = rng.normal(100.3, 3.0, (3, 1, 200, 200)).round().astype(np.uint8)
    grey[:, :, 40:160, 40:160] = 255
    # A lamp on the border.
    grey[:, :, :30, 90:100] = 250
    level, noise = ring_statistics(torch.from_numpy(grey))
    assert (level - 100.3).abs().max() < 0.2
    assert (noise / 3.0 - 1).abs().max() < 0.06


def test_a_panel_seen_from_far_aside_is_found_from_another_start():
    scene, bits = small_scenes(12)
    simulator = Simulator(
        SMALL, BARE, effects={**PAPER_EFFECTS, "pose": {"yaw_deg": 50}}
    )
    frames, truth = (
        simulator.render(scene, bits, keys=keys(12)),
        simulator.true_panels(scene, keys(12)),
    )
    assert errors_px(RefinedLocator()(frames, SHAPE), truth).quantile(0.75) < 0.2


@pytest.mark.parametrize("block", [0, 1])
def test_corners_of_a_panel_with_a_face_are_found(block):
    scene, bits = SceneModel().draw(BlockKey(0, "refined", block), SHAPE)
    simulator = Simulator()
    frames = simulator.render(scene, bits, nearest_m=30.0)
    assert (
        errors_px(RefinedLocator()(frames, SHAPE), simulator.true_panels(scene)).max()
        < 0.2
    )
