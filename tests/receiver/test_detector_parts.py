"""The detector's stages, each against another program or a closed form."""

from itertools import pairwise

import cv2
import numpy as np
import pytest
import torch
from scipy.ndimage import maximum_filter
from scipy.stats import zscore

from vocc_torch.receiver.detector import pyramid as pyramid_file
from vocc_torch.receiver.detector.judge import Judge, judged, samples_of, waves_of
from vocc_torch.receiver.detector.layers import standardised
from vocc_torch.receiver.detector.placer import (
    Placer,
    asides,
    corner_moves,
    placed,
    placed_in_views,
    slips,
)
from vocc_torch.receiver.detector.pyramid import Pyramid, gate, halved
from vocc_torch.receiver.detector.scout import Scout, distinct, peaks
from vocc_torch.receiver.resample import cell_homography
from vocc_torch.types import PanelShape


def noise(*size: int, seed: int = 0) -> torch.Tensor:
    """Draw numbers, 0 to 255."""
    return 255 * torch.rand(*size, generator=torch.Generator().manual_seed(seed))


def test_cells_are_read_through_the_homography_of_opencv():
    plane = torch.from_numpy(
        cv2.GaussianBlur(noise(120, 160).numpy(), (0, 0), 3)
    ).byte()
    quad = np.array([[30, 20], [68, 26], [70, 62], [28, 55]], np.float32)
    samples, shape = 4, PanelShape(8, 9)
    cells = np.array([[0, 0], [9, 0], [9, 8], [0, 8]], np.float32)
    places = (
        np.stack(np.meshgrid(np.arange(44), np.arange(40)), -1) + 0.5
    ) / samples - 1
    matrix = cv2.getPerspectiveTransform(cells, quad)
    at = (
        cv2.perspectiveTransform(places.reshape(1, -1, 2).astype(np.float32), matrix)[0]
        - 0.5
    )
    wanted = cv2.remap(plane.numpy(), at[:, 0], at[:, 1], cv2.INTER_LINEAR).reshape(
        40, 44
    )
    quads = torch.from_numpy(quad)[None].double()
    homography = cell_homography(quads, shape)
    seen = Pyramid.of(plane[None, None]).read_cells(
        quads, homography, shape, (samples, samples), 1
    )
    assert np.abs(seen[0].numpy() - wanted).max() < 0.5


@pytest.mark.parametrize(("side", "grown"), [(20, 1), (130, 1), (130, 2), (130, 4)])
def test_cells_of_any_level_are_read_as_by_opencv_and_edges_go_on(side, grown):
    """Also in a frame that is a single level; a part of the cells lies beyond the frame."""
    scales = Pyramid.of(noise(1, 1, side, side).byte())
    shape, samples = PanelShape(4, 4), 4 // grown
    corner = np.array([[0, 0], [16, 0], [16, 16], [0, 16]]) + side - 14.3
    quads = torch.from_numpy(corner)[None]
    seen = scales.read_cells(
        quads, cell_homography(quads, shape), shape, (samples, samples), 0
    )
    level = scales.levels[grown.bit_length() - 1].float().numpy()
    at = (side - 14.3 + grown * (np.arange(4 * samples) + 0.5)) / grown - 0.5
    places = [place.astype(np.float32) for place in np.meshgrid(at, at)]
    wanted = cv2.remap(
        level, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    # OpenCV's steps.
    assert np.abs(seen[0].numpy() - wanted).max() < 255 / 32 + 1e-3


def test_halvings_are_opencvs_area_means_rounded():
    plane = noise(65, 96).byte()
    levels = Pyramid.of(plane[None, None]).levels
    assert [tuple(level.shape) for level in levels] == [(65, 96), (32, 48), (16, 24)]
    for finer, level in pairwise(levels):
        even = finer[: 2 * len(level)].float().numpy()
        wanted = cv2.resize(even, level.shape[::-1], interpolation=cv2.INTER_AREA)
        assert np.abs(level.numpy() - wanted).max() <= 0.5


@pytest.mark.parametrize("size", [(1, 1), (2, 1), (7, 9), (4, 6)])
def test_a_halving_takes_any_part_of_a_buffer(size):
    plane = noise(81).byte()[1 : 1 + size[0] * size[1]].view(size)
    found = halved(plane)
    assert found.shape == (size[0] // 2, size[1] // 2)
    even = plane[: 2 * found.shape[0], : 2 * found.shape[1]].double().numpy()
    wanted = even.reshape(found.shape[0], 2, found.shape[1], 2).mean((1, 3))
    assert np.array_equal(found.numpy(), np.floor(wanted + 0.5))


def test_an_atlas_has_a_value_everywhere():
    """Memory that nothing wrote is filled with NaN here."""
    torch.use_deterministic_algorithms(True)
    try:
        atlas = Pyramid.of(noise(1, 1, 101, 203).byte()).atlas
    finally:
        torch.use_deterministic_algorithms(False)
    assert atlas.isfinite().all()


def test_the_gate_takes_the_tiles_with_a_lattice(monkeypatch):
    monkeypatch.setattr(pyramid_file, "SETTINGS", pyramid_file.PyramidSettings(tiles=2))
    plane = torch.linspace(0, 255, 1920).expand(1080, 1920).clone()
    for row, column in ((3, 7), (16, 29)):
        tile = plane[64 * row : 64 * row + 64, 64 * column : 64 * column + 64]
        tile[::2, ::2] = 0
    assert sorted(gate(plane.byte()).tolist()) == [[3, 7], [16, 29]]


def test_candidates_are_the_local_maxima():
    outputs = noise(2, 11, 20, 30)
    score = outputs[:, 0].numpy()
    best = np.sort(
        score[score == maximum_filter(score, (0, 3, 3), mode="constant", cval=-1)]
    )[::-1]
    picture, _, quads, values = peaks(outputs[:, 0], outputs, 10)
    assert values.tolist() == pytest.approx(best[:10].tolist())
    row, column = np.argwhere(score[int(picture[0])] == score.max())[0]
    moves = outputs[int(picture[0]), 3:, row, column].view(4, 2)
    assert torch.allclose(
        quads[0], 8 * torch.tensor([column + 0.5, row + 0.5]).float() + 16 * moves
    )


def test_of_candidates_at_one_place_the_best_is_taken():
    square = torch.tensor([[0.0, 0.0], [80.0, 0.0], [80.0, 80.0], [0.0, 80.0]]).double()
    quads = torch.stack([square, square + 9.0, square / 4 + 30, square + 200.0])
    assert distinct(quads, torch.tensor([1.0, 2.0, 0.0, -1.0]), 9).tolist() == [1, 2, 3]


def test_the_scout_is_convolutional():
    """What it says of a place does not depend on what is far away, nor on the place."""
    net, crop = Scout().eval(), noise(1, 1, 160, 160)
    with torch.inference_mode():
        moved = net(torch.nn.functional.pad(crop, (160, 0, 0, 0)))[..., 20:]
        assert (moved - net(crop))[..., 4:-4, 10:-4].abs().max() < 1e-3


@pytest.mark.parametrize(("shape", "wide"), [((8, 8), 1), ((8, 16), 2)])
def test_candidates_are_pictured_through_the_homography_of_opencv(shape, wide):
    """A smooth picture, where interpolation does not matter; and corners in a picture are those in the frame."""

    class Seen(torch.nn.Module):
        def forward(self, pictures, waves):
            self.pictures = pictures
            maps = torch.zeros(len(pictures), 4, 24, 24 * wide)
            for corner, (row, column) in enumerate(
                ((4, 5), (4, 18), (18, 18), (18, 5))
            ):
                maps[:, corner, row, column * wide] = 50.0
            return torch.zeros(len(pictures)), maps

    plane = cv2.GaussianBlur(noise(90, 120).numpy(), (0, 0), 4)
    quad = np.array([[30, 20], [66, 26], [63, 52], [28, 44]], np.float32)
    square = np.array([[10, 10], [38, 10], [38, 38], [10, 38]], np.float32)
    square[:, 0] *= wide
    net, shape = Seen(), PanelShape(*shape)
    scales = Pyramid.of(torch.from_numpy(plane).byte()[None, None])
    _, moved = judged(net, scales, torch.from_numpy(quad)[None].double(), shape)
    # OpenCV counts from a pixel's centre.
    matrix = cv2.getPerspectiveTransform(quad - 0.5, square - 0.5)
    wanted = cv2.warpPerspective(plane, matrix, (48 * wide, 48))
    assert np.abs(net.pictures[0].numpy() - wanted).max() < 3
    across = [2 * (column * wide) + 1 for column in (5, 18, 18, 5)]
    places = np.stack([across, [9, 9, 37, 37]], 1)[None].astype(np.float32) - 0.5
    back = cv2.perspectiveTransform(places, np.linalg.inv(matrix)) + 0.5
    assert np.abs(moved[0].numpy() - back[0]).max() < 1e-3


def test_the_judge_is_told_rows_and_columns():
    """By a wave a row and a wave a column, whose troughs are in the middle of the LEDs; nothing lies around."""
    shape = PanelShape(4, 16)
    down, across = waves_of(torch.tensor([shape.sides]), samples_of(shape))[0]
    middles = 10 + 28 * (np.arange(4) + 0.5) / 4 - 0.5
    wave = np.interp(middles, np.arange(48), down[:, 3].numpy())
    assert wave == pytest.approx(-1, abs=0.15)
    length = np.arange(56) + 0.5
    wave = np.cos(2 * np.pi * 16 * length / 56)
    assert across[7].numpy() == pytest.approx(np.pad(wave, 20), abs=1e-5)
    net = Judge().eval()
    with torch.inference_mode():
        pictures = noise(2, 48, 48)
        four, six = (
            net(pictures, waves_of(torch.tensor([[leds, leds]]), (2, 2)))[0]
            for leds in (4, 6)
        )
    assert (four - six).abs().max() > 1e-4


def test_moves_of_cells_are_joined_as_least_squares_join_them():
    """Against NumPy's, where every cell is as sure and the ridge is small beside them."""
    draw, shape = torch.Generator().manual_seed(7), PanelShape(8, 6)
    v, u = np.meshgrid(
        (np.arange(10) - 0.5) / 4 - 1, (np.arange(8) - 0.5) / 3 - 1, indexing="ij"
    )
    fields = np.stack([np.ones_like(u), u, v, u * v], -1).reshape(-1, 4)
    cells = torch.full((1, 3, 10, 8), 6.0)
    cells[:, :2] = torch.randn(1, 2, 10, 8, generator=draw)
    wanted = np.linalg.lstsq(fields, cells[0, :2].flatten(1).T.numpy())[0]
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    by_corner = np.stack([np.ones(4), corners[:, 0], corners[:, 1], corners.prod(1)], 1)
    moves = corner_moves(cells, shape)
    assert np.abs(moves[0].numpy() - by_corner @ wanted).max() < 1e-3


def test_an_unsure_cell_says_nothing():
    cells = torch.zeros(1, 3, 10, 10)
    cells[:, 2] = 3.0
    cells[0, :, 0, 5] = torch.tensor([50.0, 50.0, -20.0])
    assert corner_moves(cells, PanelShape(8, 8)).abs().max() < 1e-3


def test_slips_are_cells_of_the_homography():
    """Against OpenCV: a corner, a side or the whole candidate lies a cell away."""
    quad = np.array([[30, 20], [68, 26], [70, 62], [28, 55]], np.float32)
    cells = np.array([[0, 0], [9, 0], [9, 8], [0, 8]], np.float32)
    matrix = cv2.getPerspectiveTransform(cells, quad)
    start = torch.from_numpy(quad).double()
    shape = PanelShape(8, 9)
    moved = torch.cat([slips(start, shape), asides(start, shape)])
    back = cv2.perspectiveTransform(
        moved.view(1, -1, 2).numpy().astype(np.float32), np.linalg.inv(matrix)
    )
    steps = (back.reshape(-1, 4, 2) - cells).round(2) + 0.0
    assert len(np.unique(steps, axis=0)) == len(steps)
    assert {np.abs(step).sum() for step in steps} == {1.0, 2.0, 4.0}


def test_the_placer_takes_any_shape():
    with torch.inference_mode():
        for shape in (PanelShape(4, 4), PanelShape(16, 5), PanelShape(32, 32)):
            size = (4 * shape.rows + 8, 4 * shape.columns + 8)
            logit, cells = Placer()(noise(3, *size))
            moves = corner_moves(cells, shape)
            assert (logit.shape, moves.shape) == ((3,), (3, 4, 2))


def test_pictures_are_standardised_as_by_scipy():
    pictures = noise(5, 12, 10)
    wanted = np.stack([zscore(one.double().numpy(), axis=None) for one in pictures])
    found = standardised(pictures, 0.0, 1.2).numpy()
    assert np.abs(found - wanted.clip(-1.2, 1.2)).max() < 1e-5


@pytest.mark.parametrize(("shape", "turn"), [((6, 6), 1), ((6, 8), 2)])
def test_a_candidate_lies_alike_however_it_is_turned(shape, turn):
    shape = PanelShape(*shape)
    torch.manual_seed(3)
    net = Placer().eval()
    pyramid = Pyramid.of(noise(1, 1, 120, 160).byte())
    quads = torch.tensor([[[30, 20], [88, 26], [90, 72], [28, 65]]]).double()
    turned = quads.roll(turn, 1)
    with torch.inference_mode():
        odds, corners = placed_in_views(net, pyramid, quads, shape)
        again, moved = placed_in_views(net, pyramid, turned, shape)
        alone, _ = placed(net, pyramid, quads, shape)
        other, _ = placed(net, pyramid, turned, shape)
    assert (alone - other).abs() > 1e-4
    assert torch.allclose(odds, again, atol=1e-5)
    assert torch.allclose(corners.roll(turn, 1), moved, atol=1e-3)
