"""The detector's training: the same for the same seed, also where it was interrupted."""

import subprocess
import sys
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from vocc_torch import load_scene
from vocc_torch.errors import VoccError
from vocc_torch.receiver.detector.judge import Judge
from vocc_torch.receiver.detector.placer import Placer, corner_orders
from vocc_torch.receiver.detector.scout import Scout
from vocc_torch.receiver.detector.weights import SHIPPED, Networks, load_networks
from vocc_torch.receiver.resample import cell_homography, corner_cells
from vocc_torch.report.terminal import Console, ProgressView
from vocc_torch.rng import BlockKey
from vocc_torch.simulation.roadside import Light
from vocc_torch.studies.train_detector import clutter, pool, run, sampling
from vocc_torch.studies.train_detector.scout_training import sizes_of
from vocc_torch.types import Panels, PanelShape

CPU = torch.device("cpu")


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Hardly any frames and crops."""
    for module, settings in (
        (pool, {"frames": 2, "width_px": 320, "height_px": 240}),
        (run, {"round_steps": 1, "mined_frames": 4}),
    ):
        monkeypatch.setattr(module, "SETTINGS", replace(module.SETTINGS, **settings))
    few = {"rendered": 4, "near": 2, "clutter": 3}
    for sampler in run.SAMPLERS.values():
        settings = replace(sampler.settings, **few)
        monkeypatch.setattr(sampler, "settings", settings)


@pytest.fixture(scope="module")
def small_pool():
    """Give three frames, each with a bright rectangle for a panel or with none."""
    noise = torch.Generator().manual_seed(1)
    size = 3, 240, 320
    grey = torch.randint(30, 50, size, dtype=torch.uint8, generator=noise)
    grey[:2, 100:124, 60:92] += 160
    corners = torch.tensor([[60.0, 100.0], [92, 100], [92, 124], [60, 124]]).double()
    quads = torch.stack([corners, corners, 0 * corners])
    shapes = torch.tensor([[8, 8], [8, 8], [0, 0]])
    readable = torch.tensor([True, True, False])
    return pool.Pool.from_frames(grey, quads, shapes, readable)


def found_at(small_pool, frames, quads):
    """Give candidates of the pool's frames."""
    frame = torch.tensor(frames)
    return replace(sampling.panels_of(small_pool, frame, 0 * frame), quads=quads)


def rendered(folder, scene, rows=8, columns=8, camera=0, seed=3):
    """The arrays of a block."""
    folder.mkdir(exist_ok=True)
    block = pool.PoolBlock(folder / "b.npz", scene, rows, columns, camera, seed)
    pool.render_block(block)
    return np.load(block.path)


def test_a_block_is_the_same_again(tmp_path):
    first, again = (rendered(tmp_path / name, "street", 4) for name in "ab")
    assert first["grey"].shape == (2, 240, 320)
    assert all(np.array_equal(first[name], again[name]) for name in first.files)


def test_crops_are_rendered_on_the_cpu_and_put_back_into_their_frames(
    tmp_path, monkeypatch
):
    """Also where scenes would be simulated on a GPU; beside the crop a plain scene's frame is of one grey."""

    def on_gpu(*words):
        return replace(load_scene(*words), device="cuda")

    monkeypatch.setattr(pool, "load_scene", on_gpu)
    grey = rendered(tmp_path, "paper")["grey"]
    assert grey.shape == (2, 240, 320)
    assert (grey == np.median(grey, axis=(1, 2), keepdims=True)).mean() > 0.8


@pytest.mark.slow
def test_processes_that_render_end_with_a_killed_parent(tmp_path):
    """Its output, which they hold too, comes to its end."""
    script = f"""
from pathlib import Path
from vocc_torch.report.terminal import Console
from vocc_torch.studies.train_detector import pool
pool.render(pool.blocks_of(Path({str(tmp_path)!r}), 0, 1), Console())
"""
    words = [sys.executable, "-c", script]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as run:
        while not any(tmp_path.glob("*.npz")):
            assert run.poll() is None
            time.sleep(0.1)
        run.kill()
        run.communicate(timeout=30)


@pytest.mark.parametrize("scene", pool.OWN)
def test_photographs_are_rendered(scene, tmp_path):
    """No part of a frame is of one grey value."""
    clutter.copy_photographs(tmp_path / pool.PHOTOGRAPHS)
    block = rendered(tmp_path, scene, 0, 0)
    parts = block["grey"].reshape(2, 4, 60, 4, 80).std(axis=(2, 4))
    assert (parts > 0.5).all()
    assert not block["corners"].any()
    assert not block["readable"].any()


@pytest.mark.parametrize("camera", range(1, len(pool.SETTINGS.cameras)))
def test_each_camera_shows_panels_at_their_corners(camera, tmp_path):
    """A frame's LEDs lie where the corners say, also where pixels were halved."""
    block = rendered(tmp_path, "street", camera=camera, seed=5)
    assert block["grey"].shape == (2, 240, 320)
    assert block["readable"].any()


def test_cells_are_those_of_opencvs_homography():
    quad = np.array([[12, 9], [50, 14], [47, 40], [10, 35]], np.float32)
    cells = np.array([[0, 0], [16, 0], [16, 8], [0, 8]], np.float32)
    at = np.random.default_rng(0).uniform(0, 60, (40, 2))
    matrix = cv2.getPerspectiveTransform(quad, cells)
    wanted = cv2.perspectiveTransform(at[None], matrix)[0]
    quads, points = (torch.from_numpy(one).double()[None] for one in (quad, at))
    found = sampling.cells_at(points, quads, PanelShape(8, 16))
    assert found[0].numpy() == pytest.approx(wanted, abs=1e-3)


def test_pictures_are_those_that_the_detector_reads(small_pool):
    """Of each candidate alone, to the bit, at several levels."""
    corners = torch.tensor([[0.0, 0.0], [1, 0], [1, 1], [0, 1]]).double()
    sides = torch.tensor([20.0, 60, 200] * 4)[:, None, None]
    quads = 50 + sides * corners
    form = pool.Form(PanelShape(8, 8), PanelShape(8, 8), (4, 2), 1)
    frames = [0, 1, 2, 2, 1, 0, 1, 2, 0, 0, 2, 1]
    pictures = small_pool.read(torch.tensor(frames), quads, form)
    assert pictures.shape == (12, 40, 20)
    for frame, quad, picture in zip(frames, quads[:, None], pictures, strict=True):
        homography = cell_homography(quad, form.cells)
        alone = small_pool.pyramid(frame).read_cells(
            quad, homography, form.cells, form.samples, form.margin
        )
        assert torch.equal(alone[0], picture)


def test_rows_and_columns_are_told_as_they_are_seen(small_pool):
    """In pictures whose rows are columns, too; without a panel it is one that could be looked for."""
    sides = torch.tensor([[4, 8], [4, 8], [0, 0]])
    wide = replace(small_pool, shapes=sides)
    sought = wide.sought.tolist()
    assert sought[:2] == [[4, 8]] * 2
    assert tuple(sought[2]) in pool.SHAPES
    sampler = run.SAMPLERS["judge"](wide)
    torch.manual_seed(0)
    batches = [sampler.batch()[1] for _ in range(9)]
    told = {
        tuple(one) for batch in batches for one in batch.shapes[batch.panel].tolist()
    }
    assert told == {(4, 8), (8, 4)}


def test_views_turn_and_mirror_and_keep_rows():
    corners = torch.tensor([[0.0, 0.0], [8, 0], [8, 4], [0, 4]])
    quads, turned = corners[corner_orders(square=True)].chunk(2)
    assert torch.equal(quads, corners[corner_orders(square=False)])
    assert ((quads[:, 0] - quads[:, 1]).norm(dim=1) == 8).all()
    assert len({str(quad.tolist()) for quad in quads}) == 4
    assert ((turned[:, 0] - turned[:, 1]).norm(dim=1) == 4).all()
    for some in (quads, turned):
        assert torch.equal(sampling.ordered(some), corners.expand(4, 4, 2))


def test_lattices_are_no_panels():
    """Each lies off the lattice, is no rectangle, or lights its dots by a rule with few defects."""
    rows, columns = np.indices((16, 16))
    rules = [
        (a * rows + b * columns) % period == 0
        for a in range(3)
        for b in range(3)
        for period in (1, 2, 3, 4)
    ]
    kinds = {"off": 0, "cut": 0, "ruled": 0}
    for seed in range(200):
        drawn = clutter.lattice(np.random.default_rng(seed), Light(1e3, 3e3, 1.0))
        points, luminance = drawn.parts[-1]
        place = points.mean(axis=1)
        place = place - place.min(axis=0)
        size = place.max(axis=0).round().astype(int) + 1
        if np.abs(place - place.round()).max() > 0.1:
            kinds["off"] += 1
        elif len(place) < size.prod():
            kinds["cut"] += 1
        else:
            lit = (luminance == luminance.max()).reshape(size[::-1])
            parts = [rule[: size[1], : size[0]] for rule in rules]
            unlike = [(lit ^ part).mean() for part in parts]
            assert min(*unlike, *(1 - share for share in unlike)) < 0.25
            kinds["ruled"] += 1
    assert min(kinds.values()) > 10


def test_bits_can_be_told_where_a_panel_is_readable():
    """At the LEDs' own places and bits, and not at others."""
    shape = PanelShape(8, 8)
    bits = pool.bits_of(BlockKey(1, "test", 0), 3, shape)
    assert bits.flatten(1).any(1).all()
    assert not bits.flatten(1).all(1).any()
    grey = torch.full((3, 1, 60, 60), 40.0)
    lit = bits.repeat_interleave(2, 1).repeat_interleave(2, 2)
    grey[:, 0, 10:26, 20:36] += 100 * lit
    corners = torch.tensor([[20.0, 10.0], [36, 10], [36, 26], [20, 26]]).expand(3, 4, 2)
    moved = corners + torch.tensor([0.0, 50.0])
    for places, sent, expected in (
        (corners, bits, True),
        (corners, ~bits, False),
        (moved, bits, False),
    ):
        panels = Panels.known(places.double())
        assert (pool.readable(grey, panels, sent) == expected).all()


@pytest.mark.parametrize("part", ["scout", "judge", "placer"])
def test_pictures_show_the_panel_where_they_say(part, small_pool):
    """A rendered panel is brighter inside its corners than the picture on the whole."""
    sampler, compared = run.SAMPLERS[part](small_pool), 0
    for seed in range(8):
        torch.manual_seed(seed)
        form, pictures = sampler.batch()
        scale = torch.tensor(form.samples[::-1])
        for picture, corners in zip(
            pictures.grey[:4], pictures.corners[:4], strict=True
        ):
            mask = np.zeros(picture.shape, np.uint8)
            quad = ((corners + form.margin) * scale).round().int().numpy()
            cv2.fillPoly(mask, [quad], 1)
            if mask.sum() > 100 and (mask == 0).sum() > 50:
                compared += 1
                inside = picture.numpy()[mask > 0].mean()
                assert inside > picture.numpy()[mask == 0].mean() + 10
    assert compared > 8


def test_candidates_near_a_panel_and_of_clutter_are_told_apart(small_pool):
    truth = small_pool.corners_px[:1]
    quads = torch.cat([truth + 2, truth + 100, truth + 12, truth])
    found = found_at(small_pool, [0, 0, 0, 2], quads)
    found = replace(found, truth=0 * quads)
    near, clutter = sampling.with_truth(small_pool, found)
    assert torch.equal(near.quads, quads[:1])
    assert torch.equal(clutter.quads, quads[[1, 3]])
    assert torch.equal(near.truth, truth)
    assert not clutter.truth.any()


def test_likely_clutter_is_drawn_more_often(small_pool):
    found = found_at(small_pool, [2, 2], small_pool.corners_px[[2, 2]])
    score, level = torch.tensor([-20.0, 20.0]), torch.tensor([0, 1])
    found = replace(found, score=score, level=level)
    torch.manual_seed(0)
    likely = found.drawn(2000).level.double().mean()
    assert float(likely) == pytest.approx(1.05 / 1.1, abs=0.02)
    assert not len(found[:0].drawn(5).frame)


def test_beyond_a_frame_crops_have_a_mean_grey_value(small_pool):
    """A crop about a frame's corner: three quarters are beyond."""
    sampler = run.SAMPLERS["scout"](small_pool)
    (form,) = sampler.forms
    quads = 128 * (corner_cells(sampling.UNIT) - 0.5)[None]
    torch.manual_seed(0)
    crops = sampler.seen(found_at(small_pool, [2], quads), quads, form)
    (grey,) = crops.grey
    assert len(grey[:64].unique()) == len(grey[:, :64].unique()) == 1
    assert len(grey[64:, 64:].unique()) > 10
    assert 10 < float(grey[0, 0]) < 150


def test_a_frame_ends_beside_a_panel_and_not_within(small_pool):
    """In crops of the scout; without a panel it ends anywhere near the crop's edge."""
    sampler = run.SAMPLERS["scout"](small_pool)
    corners = torch.tensor([[0.3, 0.4], [0.6, 0.4], [0.6, 0.7], [0.3, 0.7]])
    panel = torch.arange(600) < 300
    grey, shapes = torch.zeros(600, 128, 128), torch.full((600, 2), 8)
    torch.manual_seed(0)
    crops = sampling.Pictures(grey, panel[:, None, None] * corners, panel, shapes)
    inside = sampler.within(crops)
    assert inside[:300, 52:89, 39:76].all()
    ends = ~inside[:, 64, [0, -1]]
    assert 0.05 < float(ends.float().mean()) < 0.2
    assert not inside[:300, 45].all()
    assert inside[:, 64, 64].all()


def test_taken_candidates_keep_the_panels_place(small_pool):
    """The panel's corners in a picture, from the candidate's, are those that it was moved by."""
    truth = small_pool.corners_px[:1].expand(40, 4, 2)
    cell = torch.tensor([4.0, 3.0])
    near = replace(found_at(small_pool, [0] * 40, truth + cell), truth=truth)
    sampler = run.SAMPLERS["placer"](small_pool)
    form = sampler.forms[0]
    torch.manual_seed(0)
    quads = sampler.moved(near, form, rough=False)
    cells = sampler.seen(near, quads, form).corners
    middle = cells.mean(1) - 4
    assert middle.mean(0).tolist() == pytest.approx([-1, -1], abs=0.1)
    assert 0.05 < float(middle.std(0).max()) < 0.15


def test_rough_corners_are_as_far_off_as_stated(small_pool):
    """Of the placer: some slip, and others move by their roughness."""
    sampler = run.SAMPLERS["placer"](small_pool)
    torch.manual_seed(0)
    off = sampler.off(4000, sampler.forms[0])
    slipped = off - off.median(1, keepdim=True).values
    least, most = sampler.settings.rough[0], sampler.settings.rough[-1]
    far = slipped.abs().amax((1, 2))
    assert (far < 8 * least).double().mean() > 0.1
    assert 0.4 < float((far > 0.55).double().mean()) < 0.7
    assert float(off.mean(1).std()) < most


@pytest.mark.parametrize("part", ["scout", "judge", "placer"])
def test_training_is_the_same_where_it_was_interrupted(
    part, tmp_path, small_pool, monkeypatch
):
    """Two steps at once, and one with one more from a checkpoint, to the last bit."""

    def interrupt(*_):
        raise KeyboardInterrupt

    def train(name):
        run.train_part(part, small_pool, tmp_path / name, 5, 2, 1, Console())

    train("1")
    with monkeypatch.context() as patch:
        patch.setattr(ProgressView, "advance", interrupt)
        with pytest.raises(KeyboardInterrupt):
            train("2")
    assert torch.load(tmp_path / "2" / f"{part}.pt")["steps"] == 1
    train("2")

    first, second = (torch.load(tmp_path / name / f"{part}.pt") for name in ("1", "2"))
    fresh = getattr(Networks.fresh(), part).state_dict()
    assert all(
        torch.equal(first[kept][name], second[kept][name])
        for kept in ("net", "mean")
        for name in fresh
    )


@pytest.mark.parametrize("seed", [-1, 1 << 50])
def test_a_seed_that_torch_cannot_take_is_refused_at_once(seed, app):
    ran = app("task=train_detector", f"seed={seed}", "name=x")
    assert ran.status == 2
    assert ran.err.startswith(f"vocc-torch: error: seed is {seed}: it must be a whole")


@pytest.mark.parametrize("damage", ["earlier", "network", "cut", "text"])
def test_another_training_is_refused_by_its_file(damage, tmp_path):
    path = tmp_path / "scout.pt"
    net = Judge() if damage == "network" else Scout()
    state = net.state_dict()
    steps = "done" if damage == "earlier" else "steps"
    torch.save({"net": state, "mean": state, "optimiser": {}, steps: 3}, path)
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:700])
    if damage == "text":
        path.write_text("no training")
    with pytest.raises(VoccError, match=r"scout\.pt is no training of this version"):
        run.current(tmp_path, CPU)


def test_the_mean_of_weights_forgets_the_first_ones():
    """A plain mean at first, and then one of the newest five hundred."""
    mean, net = torch.nn.Linear(1, 1), torch.nn.Linear(1, 1)
    values, wanted = torch.linspace(1, 2, 900).tolist(), 0.0
    for step, value in enumerate(values):
        torch.nn.init.constant_(net.weight, value)
        run.average(mean, net, step)
        share = max(0.002, 1 / (step + 1))
        wanted = (1 - share) * wanted + share * value
    assert mean.weight.item() == pytest.approx(wanted, rel=1e-4)
    assert mean.weight.item() > np.mean(values)


def test_networks_learn_one_batch(small_pool):
    """The losses fall by half in a few steps on the same batch."""
    torch.manual_seed(0)
    nets = (Scout(), Judge(), Placer())
    for net, part in zip(nets, ("scout", "judge", "placer"), strict=True):
        sampler = run.SAMPLERS[part](small_pool)
        optimiser = torch.optim.Adam(net.parameters(), 3e-3)
        losses = []
        for _ in range(40):
            torch.manual_seed(3)
            loss = sampler.loss(net)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses.append(float(loss.detach()))
        assert losses[-1] < losses[0] / 2


def test_weights_are_written_and_read(tmp_path):
    networks = Networks.fresh()
    networks.save(tmp_path / SHIPPED)
    read = load_networks(tmp_path / SHIPPED, CPU)
    states = [one.parts().state_dict() for one in (networks, read)]
    assert all(
        torch.equal(weights.half().float(), states[1][name])
        for name, weights in states[0].items()
    )
    assert (tmp_path / SHIPPED).stat().st_size < 500_000


def test_a_panel_between_two_sizes_is_surely_of_neither_other():
    """4 x 8 is just above the limit of 5.6 LEDs a side, 8 x 16 just above 11.3."""
    shapes = torch.tensor([[4.0, 4], [4, 8], [8, 8], [8, 16], [32, 32]])
    own, others = (sizes.flatten(1) for sizes in sizes_of(shapes))
    assert own.int().argmax(1).tolist() == [0, 1, 1, 2, 2]
    assert own.sum(1).tolist() == [1] * 5
    assert others.int().tolist() == [
        [0, 1, 1],
        [0, 0, 1],
        [1, 0, 1],
        [1, 0, 0],
        [1, 1, 0],
    ]
