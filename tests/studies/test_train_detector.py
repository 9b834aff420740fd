"""The detector's training: the same for the same seed, also where it was interrupted."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from vocc_torch.receiver.detector.scout import Scout
from vocc_torch.receiver.detector.weights import SHIPPED, load_networks
from vocc_torch.receiver.resample import corner_cells, map_points
from vocc_torch.report.terminal import Console
from vocc_torch.studies.train_detector import (
    TrainDetectorConfig,
    judge_training,
    run,
    scout_training,
)
from vocc_torch.studies.train_detector.pool import Example, read_pool, save_block
from vocc_torch.studies.train_detector.worlds import SMALL, WIDE, world
from vocc_torch.types import PanelShape

FEW = replace(SMALL, width_px=128, height_px=128, frames=3)


@pytest.fixture(scope="module")
def blocks(tmp_path_factory):
    """Frames of two blocks, in files."""
    folder = tmp_path_factory.mktemp("pool")
    paths = [folder / f"{block}.npz" for block in range(2)]
    for block, path in enumerate(paths):
        save_block(path, *world(1, block, FEW))
    return paths


def test_a_block_is_the_same_again_and_another_is_another(blocks):
    first, again = (world(1, 0, FEW) for _ in range(2))
    assert torch.equal(first.grey, again.grey)
    assert not torch.equal(first.grey, world(2, 0, FEW).grey)
    kept = read_pool(blocks[:1])
    assert all(
        torch.equal(one.grey[0, 0], grey)
        for one, grey in zip(kept, first.grey, strict=True)
    )


def test_wide_frames_have_no_panel():
    seen = world(1, 0, replace(WIDE, width_px=192, height_px=128, frames=2))
    assert seen.grey.shape == (2, 128, 192)
    assert not seen.corners_px.any()


def test_training_is_the_same_where_it_was_interrupted(blocks, tmp_path, monkeypatch):
    """Four steps at once, and two with two more from a checkpoint, to the last bit."""
    torch.manual_seed(3)
    start, found = Scout().state_dict(), []
    monkeypatch.setattr(
        scout_training, "SETTINGS", replace(scout_training.SETTINGS, batch=4)
    )
    sampler = scout_training.Sampler(read_pool(blocks))
    for piece in (4, 2):
        for stop in range(piece, 5, piece):
            net = Scout()
            net.load_state_dict(start)
            part = run.Checkpoint(tmp_path / f"{piece}.pt", net, 1e-3)
            for steps in part.rounds(stop, piece):
                scout_training.train_steps(net, part.optimiser, sampler, 5, steps, 4)
        found.append(net.state_dict())
    assert all(torch.equal(found[0][name], found[1][name]) for name in start)
    assert not any(torch.equal(found[0][name], start[name]) for name in start)


def test_corners_are_compared_in_cells():
    """Against corners that were moved by known parts of cells, whichever corner comes first."""
    shape, cells = PanelShape(8, 8), corner_cells(PanelShape(8, 8))
    truth = torch.tensor(
        [[30.0, 20.0], [68.0, 26.0], [70.0, 62.0], [28.0, 55.0]]
    ).double()
    off = torch.tensor([[0.2, -0.1], [0.0, 0.3], [-0.4, 0.1], [0.1, 0.1]]).double()
    quad = map_points(truth[None], (cells.double() + off)[None], shape)
    for turn in range(4):
        seen = judge_training.in_cells(quad, truth.roll(turn, 0), shape)
        assert (seen[0] + off).abs().max() < 0.05


def test_crops_show_the_panel_where_they_say(blocks):
    """A panel that is brighter at its corners' middle than around, mirrored and transposed."""
    grey = torch.zeros(1, 1, 320, 320, dtype=torch.uint8)
    grey[..., 100:124, 60:92] = 200
    corners = torch.tensor(
        [[60.0, 100.0], [92.0, 100.0], [92.0, 124.0], [60.0, 124.0]]
    ).double()
    sampler = scout_training.Sampler(
        [Example(grey, corners, PanelShape(8, 8), readable=True)]
    )
    draw = np.random.default_rng(0)
    for place in sampler.panels[:1] * 20:
        crop = sampler.crop(place, draw)
        (left, top), (right, bottom) = (
            end(crop.quads, 0).tolist() for end in (torch.amin, torch.amax)
        )
        inside = crop.grey[0, round(top) : round(bottom), round(left) : round(right)]
        first, second = crop.quads[0], crop.quads[2]
        assert inside.numel() == 0 or inside.mean() > crop.grey.mean() + 20
        assert (first < second).all()


def test_the_whole_training_runs_and_goes_on(tmp_path, monkeypatch):
    """With hardly any frames and steps; the second time nothing is rendered."""
    for name, options in (
        ("SMALL", FEW),
        ("WIDE", replace(WIDE, width_px=192, height_px=128, frames=2)),
    ):
        monkeypatch.setattr(run, name, options)
    few = {"batch": 4, "mined_frames": 2}
    monkeypatch.setattr(
        scout_training, "SETTINGS", replace(scout_training.SETTINGS, **few)
    )
    few = {"verdict_steps": 3, "most": 4, "candidates": 3, "shaken": 2}
    monkeypatch.setattr(
        judge_training, "SETTINGS", replace(judge_training.SETTINGS, **few)
    )
    own = TrainDetectorConfig(
        small_blocks=2, wide_blocks=1, scout_steps=2, judge_steps=2
    )
    examples = run.pool(tmp_path, 1, own, Console())
    networks = run.trained(tmp_path, 1, own, examples, Console())
    networks.save(tmp_path / SHIPPED)
    monkeypatch.setattr(run, "world", None)
    again = run.trained(
        tmp_path, 1, own, run.pool(tmp_path, 1, own, Console()), Console()
    )
    kept = load_networks(tmp_path / SHIPPED, torch.device("cpu"))
    for name in ("scout", "judge"):
        states = [getattr(one, name).state_dict() for one in (networks, again, kept)]
        assert all(
            torch.equal(states[0][key], other[key])
            for other in states[1:]
            for key in other
        )
    assert (tmp_path / SHIPPED).stat().st_size < 500_000
