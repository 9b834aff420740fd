"""The detector's training: the same for the same seed, also where it was interrupted."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from vocc_torch import load_scene
from vocc_torch.errors import VoccError
from vocc_torch.receiver.detector import scout
from vocc_torch.receiver.detector.judge import Judge
from vocc_torch.receiver.detector.placer import Placer
from vocc_torch.receiver.detector.scout import Scout
from vocc_torch.receiver.detector.weights import SHIPPED, Networks, load_networks
from vocc_torch.report.terminal import Console, ProgressView
from vocc_torch.studies.train_detector import (
    candidates,
    composition,
    draws,
    finish,
    geometry,
    pool,
    run,
    scout_training,
)
from vocc_torch.studies.train_detector.sampling import Pictures
from vocc_torch.studies.train_detector.scout_training import sizes_of

CPU = torch.device("cpu")


def draws_of(seed: int, count: int) -> draws.Draws:
    """Give draws from a seed."""
    return draws.Draws(torch.Generator().manual_seed(seed), count)


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Hardly any frames and crops."""
    for module, settings in (
        (pool, {"frames": 2, "width_px": 320, "height_px": 240, "mosaics": 1}),
        (run, {"round_steps": 1, "mined_frames": 4}),
    ):
        monkeypatch.setattr(module, "SETTINGS", replace(module.SETTINGS, **settings))
    few = {"composed": 3, "rendered": 2, "counterexamples": 2, "mined": 1}
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
    return pool.Pool(
        *pool.levels_of(grey, CPU), quads, shapes, torch.tensor([True, True, False])
    )


def test_a_block_is_the_same_again(tmp_path):
    for name in ("first", "again"):
        (tmp_path / name).mkdir()
        block = pool.PoolBlock(tmp_path / name / "b.npz", "street", 4, 8, 3)
        pool.render_block(block)
    first, again = (np.load(tmp_path / name / "b.npz") for name in ("first", "again"))
    assert first["grey"].shape == (2, 240, 320)
    assert all(np.array_equal(first[name], again[name]) for name in first.files)


def test_frames_are_rendered_on_the_cpu(tmp_path, monkeypatch):
    """Also where scenes would be simulated on a GPU."""

    def on_gpu(*words):
        return replace(load_scene(*words), device="cuda")

    monkeypatch.setattr(pool, "load_scene", on_gpu)
    pool.render_block(pool.PoolBlock(tmp_path / "b.npz", "paper", 8, 8, 3))
    assert np.load(tmp_path / "b.npz")["grey"].shape == (2, 240, 320)


def test_readings_between_pixels_are_opencvs():
    noise = draws_of(3, 1)
    plane, at = (
        noise.uniform(0, 255, 40, 60)[0],
        noise.uniform(0, 1, 500, 2) * torch.tensor([59.0, 39.0]) + 0.5,
    )
    wanted = cv2.remap(
        plane.numpy(),
        at[0].numpy() - 0.5,
        None,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    # OpenCV's steps.
    start, size = torch.tensor([[7]]), torch.tensor([[40, 60]])
    buffer = torch.cat([torch.zeros(7), plane.flatten()])
    seen = pool.bilinear(buffer, start, size, at.mT)[0]
    assert (seen - torch.from_numpy(wanted[:, 0])).abs().max() < 255 / 32 + 1e-3


def test_crops_are_put_back_into_their_frames(tmp_path):
    """A plain scene's frame is grey all over but for the crop that is rendered."""
    pool.render_block(pool.PoolBlock(tmp_path / "b.npz", "paper", 8, 8, 3))
    grey = np.load(tmp_path / "b.npz")["grey"]
    assert grey.shape == (2, 240, 320)
    assert (grey == np.median(grey, axis=(1, 2), keepdims=True)).mean() > 0.8


def test_places_in_cells_are_those_of_opencvs_homography():
    quad = np.array([[12, 9], [50, 14], [47, 40], [10, 35]], np.float32)
    cells = np.array([[0, 0], [16, 0], [16, 8], [0, 8]], np.float32)
    at = np.stack(np.meshgrid(np.arange(64), np.arange(48)), -1) + 0.5
    matrix = cv2.getPerspectiveTransform(quad, cells)
    wanted = cv2.perspectiveTransform(at.reshape(1, -1, 2), matrix)[0]
    shapes = torch.tensor([[8.0, 16.0]])
    found = geometry.cells_of(torch.from_numpy(quad)[None], shapes, 48, 64)
    assert np.abs(found[0].T.numpy() - wanted).max() < 1e-3


def test_poses_have_their_pitch():
    drawn = draws_of(1, 50)
    shapes, pitch = composition.shapes_of(drawn), drawn.geometric(2, 5)
    quads = composition.poses(drawn, shapes, pitch, drawn.uniform(40, 80, 2))
    areas = [cv2.contourArea(quad.numpy()) for quad in quads]
    wanted = (shapes.prod(1) * pitch.square()).tolist()
    assert areas == pytest.approx(wanted, rel=1e-3)
    assert geometry.signed_area(quads).tolist() == pytest.approx(wanted, rel=1e-3)


def test_blurs_are_scipys():
    pictures = 255 * torch.rand(3, 40, 40, generator=torch.Generator().manual_seed(0))
    sigma = torch.tensor([0.4, 0.8, 1.2])
    blurred = finish.blurred(pictures, sigma)
    for picture, found, width in zip(pictures, blurred, sigma.tolist(), strict=True):
        wanted = gaussian_filter(picture.numpy(), width, mode="nearest", radius=4)
        assert np.abs(found.numpy() - wanted).max() < 0.01


def test_margins_are_a_frames_edges_going_on(monkeypatch):
    """Against OpenCV's border of a part of each picture."""
    cut = replace(finish.FINISH, cut=1.0)
    monkeypatch.setattr(finish, "FINISH", cut)
    pictures = draws_of(0, 6).uniform(0, 255, 30, 40)
    for whole, found in zip(
        pictures.numpy(),
        finish.with_edges(pictures, draws_of(3, 6)).numpy(),
        strict=True,
    ):
        rows = np.flatnonzero((found == whole).any(1))
        columns = np.flatnonzero((found == whole).any(0))
        (top, low), (left, right) = ((n[0], n[-1]) for n in (rows, columns))
        inside = whole[top : low + 1, left : right + 1]
        sides = (top, 29 - low, left, 39 - right)
        wanted = cv2.copyMakeBorder(inside, *map(int, sides), cv2.BORDER_REPLICATE)
        assert np.array_equal(found, wanted)


def test_readings_of_the_pool_are_opencvs(small_pool):
    """At the frame's own level, and at its half."""
    at = draws_of(2, 1).uniform(0, 1, 2, 200) * torch.tensor([320.0, 240.0])[:, None]
    for level in (0, 1):
        plane = small_pool.levels(level, torch.tensor([0]))[0].numpy()
        places = (at[0].mT / 2**level - 0.5).numpy()
        wanted = cv2.remap(
            plane, places, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        found = small_pool.read(torch.tensor([0]), torch.tensor([level]), at)
        # OpenCV's steps of 1/32 px.
        assert np.abs(found[0].numpy() - wanted[:, 0]).max() < 160 / 32 + 0.1


def test_turned_corners_keep_their_sides():
    """Corners go round either way; without quarter turns the first side stays as long."""
    corners = torch.tensor([[0.0, 0.0], [8, 0], [8, 4], [0, 4]]).expand(40, 4, 2)
    order = geometry.turns(draws_of(4, 40), quarters=False)
    quads = geometry.rearranged(corners, order)
    assert ((quads[:, 0] - quads[:, 1]).norm(dim=1) == 8).all()
    assert len({str(quad.tolist()) for quad in quads}) == 4
    assert torch.equal(geometry.ordered(quads), corners)


def test_lookalikes_are_no_panels(monkeypatch):
    """Each lies off the lattice, or lights its LEDs by a rule with few defects."""
    whole = replace(composition.LIKENESSES, round=0.0)
    monkeypatch.setattr(composition, "LIKENESSES", whole)
    likeness = composition.likenesses(
        draws_of(5, 200), torch.tensor([[8.0, 8.0]]).expand(200, 2)
    )
    off = likeness.off_cells.flatten(1).abs().amax(1) > 0.2
    light = likeness.light[:, :8, :8] > 0
    steps = [(a, b) for a in range(3) for b in range(3)]
    rows, columns = torch.meshgrid(torch.arange(8), torch.arange(8), indexing="ij")
    rules = torch.stack(
        [
            (a * rows + b * columns) % period == 0
            for a, b in steps
            for period in (1, 2, 3, 4)
        ]
    )
    unlike = (light[:, None] ^ rules).flatten(2).float().mean(2).amin(1)
    few = light.flatten(1).sum(1) < 12
    assert (off | (unlike < 0.15) | few).all()
    assert 0.15 < few.float().mean() < 0.4


@pytest.mark.parametrize("part", ["scout", "judge"])
def test_crops_show_the_panel_where_they_say(part, small_pool):
    """A rendered panel is brighter inside its corners than the picture on the whole."""
    sampler, compared = run.SAMPLERS[part](small_pool), 0
    for seed in range(8):
        _, pictures = sampler.batch(torch.Generator().manual_seed(seed))
        for picture, quad in zip(pictures.grey[3:5], pictures.quads[3:5], strict=True):
            mask = np.zeros(picture.shape, np.uint8)
            cv2.fillPoly(mask, [quad.round().int().numpy()], 1)
            if mask.sum() > 100:
                compared += 1
                inside = picture.numpy()[mask > 0].mean()
                assert inside > picture.numpy()[mask == 0].mean() + 10
    assert compared > 8


def test_candidates_near_a_panel_and_of_clutter_are_told_apart(small_pool):
    truth = small_pool.corners_px[:1].float()
    quads = torch.cat([truth + 2, truth + 100, truth + 12, truth])
    frame = torch.tensor([0, 0, 0, 2])
    scores, truths = torch.zeros(4), torch.zeros_like(quads)
    found = candidates.Found(frame, frame, quads, scores, truths)
    near, clutter = candidates.with_truth(small_pool, found)
    assert torch.equal(near.quads, quads[:1])
    assert torch.equal(clutter.quads, quads[[1, 3]])
    assert torch.equal(near.truth, truth)
    assert not clutter.truth.any()


def test_the_best_of_each_frame_are_those_of_each_frame_alone():
    """Against the detector's own choice, frame by frame; places lie in clusters."""
    drawn = draws_of(6, 300)
    corners = torch.tensor([[0.0, 0.0], [8, 0], [8, 8], [0, 8]])
    size = drawn.geometric(0.5, 2.0, 1, 1)
    quads = size * corners + 40 * drawn.below(4, 2)[:, None] + drawn.uniform(0, 5, 1, 2)
    frame, score = drawn.below(5), drawn.uniform(-3, 3)
    found = candidates.Found(frame, frame, quads, score, torch.zeros_like(quads))
    best = candidates.best_of_frames(found, 4)
    assert best.frame.tolist() == sorted(best.frame.tolist())
    for number in range(5):
        alone = found.rows(frame == number)
        deep = alone.score.argsort(descending=True)[:16]
        alone = alone.rows(deep)
        rows = scout.distinct(alone.quads, alone.score, 4)
        one = best.rows(best.frame == number)
        assert torch.equal(one.score, alone.score[rows].sort(descending=True).values)


def test_proposals_are_those_of_each_frame_alone(small_pool):
    net = load_networks(None, CPU).scout
    whole = candidates.proposals(net, small_pool, torch.tensor([0, 2]))
    for number in (0, 2):
        alone = candidates.proposals(net, small_pool, torch.tensor([number]))
        some = whole.rows(whole.frame == number)
        for part in ("level", "quads", "score"):
            found, expected = (getattr(of, part).detach() for of in (some, alone))
            assert found.numpy() == pytest.approx(expected.numpy(), abs=1e-3)


def test_a_frame_ends_beside_the_panel(monkeypatch, small_pool):
    """What lies beyond is of one grey value, and the panel's middle stays."""
    always = replace(scout_training.SETTINGS, framed=1.0)
    monkeypatch.setattr(scout_training, "SETTINGS", always)
    grey = draws_of(7, 6).uniform(0, 255, 128, 128)
    quad = torch.tensor([[40.0, 50.0], [70, 50], [70, 80], [40, 80]])
    panel = torch.tensor([True, True, True, True, False, False])
    quads = quad * panel[:, None, None]
    batch = Pictures(grey, quads, panel)
    shown = scout_training.framed(batch, torch.Generator().manual_seed(1))
    kept = shown == grey
    assert kept[:, 52:79, 42:69].all()
    assert not kept.flatten(1).all(1).all()
    beyond = shown[~kept].view(-1)
    means = grey.mean((1, 2))[:, None, None].expand_as(grey)[~kept]
    assert torch.allclose(beyond, means)


def test_things_stand_beside_panels(monkeypatch):
    """A polygon of one shade covers part of each picture, and seldom a panel's middle."""
    always = replace(composition.THINGS, beside=1.0)
    monkeypatch.setattr(composition, "THINGS", always)
    grey = torch.full((200, 96, 96), -1.0)
    quad = torch.tensor([[38.0, 38.0], [58, 38], [58, 58], [38, 58]])
    shown = composition.with_things(grey, quad.expand(200, 4, 2), draws_of(8, 200))
    covered = shown >= 0
    share = covered.flatten(1).float().mean(1)
    assert 0.005 < float(share.median()) < 0.3
    assert float(covered[:, 48, 48].float().mean()) < 0.2
    for picture, there in zip(shown, covered, strict=True):
        assert len(picture[there].unique()) <= 1


def test_taken_candidates_keep_the_panels_place(small_pool):
    """The panel's corners in a patch, from the candidate's, are those that it was moved by."""
    truth = small_pool.corners_px[:1].float()
    cell = torch.tensor([4.0, 3.0])
    first = torch.tensor([0])
    near = candidates.Found(first, first, truth + cell, torch.zeros(1), truth)
    sampler = run.SAMPLERS["placer"](small_pool)
    _, cells = sampler.taken(draws_of(0, 40), sampler.forms[0], near)
    middle = cells.mean(1) - 4
    assert middle.abs().mean(0).tolist() == pytest.approx([1, 1], abs=0.1)
    assert middle.sign().unique(dim=0).shape[0] == 4


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
    assert torch.load(tmp_path / "2" / f"{part}.pt")["done"] == 1
    train("2")

    first, second = (torch.load(tmp_path / name / f"{part}.pt") for name in ("1", "2"))
    fresh = getattr(Networks.fresh(), part).state_dict()
    assert all(
        torch.equal(first[kept][name], second[kept][name])
        for kept in ("net", "mean")
        for name in fresh
    )


@pytest.mark.parametrize("damage", ["earlier", "cut", "text"])
def test_another_training_is_refused_by_its_file(damage, tmp_path):
    path = tmp_path / "scout.pt"
    torch.save({"net": Scout().state_dict(), "done": 3}, path)
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
            loss = sampler.loss(net, torch.Generator().manual_seed(3))
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
