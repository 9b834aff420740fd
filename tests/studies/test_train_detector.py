"""The detector's training: the same for the same seed, also where it was interrupted."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from vocc_torch.receiver.detector.scout import Scout
from vocc_torch.receiver.detector.weights import SHIPPED, load_networks
from vocc_torch.report.terminal import Console
from vocc_torch.studies.train_detector import (
    TrainDetectorConfig,
    composition,
    judge_training,
    material,
    pool,
    run,
    scout_training,
)
from vocc_torch.types import PanelShape


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Hardly any frames and crops."""
    for module, settings in (
        (pool, {"frames": 2, "width_px": 240, "height_px": 160}),
        (material, {"drawings": 2, "drawing_px": 150}),
        (scout_training, {"composed": 3, "rendered": 2, "empty": 2, "mined": 1}),
        (
            judge_training,
            {"composed": 3, "rendered": 2, "empty": 2, "verdict_steps": 3},
        ),
    ):
        monkeypatch.setattr(module, "SETTINGS", replace(module.SETTINGS, **settings))


def example(panel: bool) -> pool.Example:
    """Make a frame with a bright rectangle for a panel, or with none."""
    grey = torch.full((1, 1, 200, 240), 40, dtype=torch.uint8)
    grey[..., 100:124, 60:92] += 160 * panel
    corners = torch.tensor([[60.0, 100.0], [92, 100], [92, 124], [60, 124]]).double()
    return pool.Example(grey, corners * panel, PanelShape(8, 8), readable=panel)


def test_a_block_is_the_same_again(tmp_path):
    for name in ("first", "again"):
        pool.render_block(tmp_path / f"{name}.npz", "street", (4, 8), 3, "name")
    first, again = (
        pool.read_pool([tmp_path / f"{name}.npz"]) for name in ("first", "again")
    )
    assert first[0].grey.shape == (1, 1, 160, 240)
    assert all(
        torch.equal(one.grey, two.grey)
        and torch.equal(one.corners_px, two.corners_px)
        and one.shape == PanelShape(4, 8)
        for one, two in zip(first, again, strict=True)
    )


def test_places_in_cells_are_those_of_opencvs_homography():
    quad = np.array([[12, 9], [50, 14], [47, 40], [10, 35]], np.float32)
    cells = np.array([[0, 0], [16, 0], [16, 8], [0, 8]], np.float32)
    at = np.stack(np.meshgrid(np.arange(64), np.arange(64)), -1) + 0.5
    matrix = cv2.getPerspectiveTransform(quad, cells)
    wanted = cv2.perspectiveTransform(at.reshape(1, -1, 2), matrix)[0]
    seen = composition.cells_of(
        torch.from_numpy(quad)[None], torch.tensor([[8.0, 16.0]]), 64
    )
    assert np.abs(seen[0].T.numpy() - wanted).max() < 1e-3


def test_poses_have_their_pitch():
    draws = composition.Draws(np.random.default_rng(1), 50)
    shapes, pitch = draws.shapes(), draws.geometric(2, 5)
    quads = composition.poses(draws, shapes, pitch, draws.uniform(40, 80, 2))
    areas = [cv2.contourArea(quad.numpy()) for quad in quads]
    wanted = (shapes.prod(1) * pitch.square()).tolist()
    assert areas == pytest.approx(wanted, rel=1e-3)


def test_blurs_are_scipys():
    pictures = 255 * torch.rand(3, 40, 40, generator=torch.Generator().manual_seed(0))
    sigma = torch.tensor([0.4, 0.8, 1.2])
    for picture, seen, width in zip(
        pictures, composition.blurred(pictures, sigma), sigma.tolist(), strict=True
    ):
        wanted = gaussian_filter(picture.numpy(), width, mode="nearest", radius=4)
        assert np.abs(seen.numpy() - wanted).max() < 0.01


def test_training_is_the_same_where_it_was_interrupted(tmp_path, monkeypatch):
    """Four steps at once, and two with two more from a checkpoint, to the last bit."""
    torch.manual_seed(3)
    start, found = Scout().state_dict(), []
    sampler = scout_training.Sampler(
        material.Material([example(True), example(False)], 1)
    )
    for piece in (4, 2):
        monkeypatch.setattr(run, "SETTINGS", replace(run.SETTINGS, round_steps=piece))
        for stop in range(piece, 5, piece):
            net = Scout()
            net.load_state_dict(start)
            training = run.Training(tmp_path / f"{piece}.pt", net, 5)

            def loss(draw, net=net):
                crops = sampler.batch(draw)
                return scout_training.scout_loss(net(crops.grey), crops)

            for steps in training.rounds(stop):
                training.take(steps, 4, loss)
        found.append(net.state_dict())
    assert all(torch.equal(found[0][name], found[1][name]) for name in start)
    assert not any(torch.equal(found[0][name], start[name]) for name in start)


@pytest.mark.parametrize("training", [scout_training, judge_training])
def test_crops_show_the_panel_where_they_say(training):
    """A rendered panel is brighter inside its corners than the picture on the whole."""
    sampler = training.Sampler(material.Material([example(True), example(False)], 1))
    compared = 0
    for seed in range(8):
        batch = sampler.batch(np.random.default_rng(seed))
        for picture, quad in zip(
            batch.grey[3:5].reshape(2, *batch.grey.shape[-2:]),
            batch.quads[3:5],
            strict=True,
        ):
            mask = np.zeros(picture.shape, np.uint8)
            cv2.fillPoly(mask, [quad.round().int().numpy()], 1)
            if mask.sum() > 100:
                compared += 1
                inside = picture.numpy()[mask > 0].mean()
                assert inside > picture.numpy()[mask == 0].mean() + 10
    assert compared > 8


def test_candidates_off_by_known_parts_of_a_cell():
    """Whichever corner comes first."""
    truth = 4 * torch.tensor([[5.0, 5.0], [13, 5], [13, 13], [5, 13]]).double()
    quad = truth + torch.tensor([[1.0, 0.0], [0, 0], [0, 2], [0, 0]])
    off = judge_training.off_cells(
        torch.stack([quad, quad.roll(1, 0)]), truth, PanelShape(8, 8)
    )
    assert off.tolist() == pytest.approx([0.5, 0.5])


def test_the_whole_training_runs_and_goes_on(tmp_path, monkeypatch):
    """The second time nothing is rendered."""
    own = TrainDetectorConfig(rounds=1, scout_steps=2, judge_steps=2)
    examples = run.pool(tmp_path, 1, own, Console())
    networks = run.trained(tmp_path, 1, own, examples, Console())
    networks.save(tmp_path / SHIPPED)
    monkeypatch.setattr(pool, "render_block", None)
    again = run.trained(
        tmp_path, 1, own, run.pool(tmp_path, 1, own, Console()), Console()
    )
    read = load_networks(tmp_path / SHIPPED, torch.device("cpu"))
    for name in ("scout", "judge"):
        states = [getattr(one, name).state_dict() for one in (networks, again, read)]
        assert all(
            torch.equal(states[0][key], other[key])
            for other in states[1:]
            for key in other
        )
    assert (tmp_path / SHIPPED).stat().st_size < 500_000
