"""What is done frame by frame on the CPU is what is done in batches elsewhere, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from vocc_torch.receiver import homography as maps
from vocc_torch.receiver import rectification
from vocc_torch.receiver.ladder import Search, climb
from vocc_torch.receiver.location import _foreground_boxes
from vocc_torch.receiver.morphology import close_mask
from vocc_torch.receiver.otsu import histogram256
from vocc_torch.receiver.regions import block_means, bright_regions, local_background
from vocc_torch.receiver.single_blob import single_blob
from vocc_torch.receiver.uneven import UnevenParts, uneven_parts
from vocc_torch.types import Frames, PanelShape

SHAPES = (PanelShape(8, 8), PanelShape(3, 7), PanelShape(1, 1))


def quadrilaterals(seed: int, count: int = 40) -> torch.Tensor:
    """Draw squares, quadrilaterals in perspective and wild ones."""
    rng = np.random.default_rng(seed)
    square = np.array([[0.0, 0], [30, 0], [30, 30], [0, 30]])
    noise = rng.choice([0.0, 1.0, 40.0], (count, 1, 1))
    corners = square * rng.uniform(0.2, 3, (count, 1, 1)) + rng.normal(0, 1, (count, 4, 2)) * noise
    return torch.from_numpy(corners + rng.uniform(0, 200, (count, 1, 2)))


@pytest.mark.parametrize("shape", SHAPES)
def test_maps_are_kornias(shape: PanelShape) -> None:
    corners = quadrilaterals(0)
    corners = corners[maps._is_convex(corners)]
    assert len(corners) > 20
    assert torch.equal(maps.cell_homography(corners, shape), maps._kornias_homography(corners, shape))


def test_points_are_mapped_as_by_matrices() -> None:
    corners, shape = quadrilaterals(1), PanelShape(8, 8)
    points = torch.from_numpy(np.random.default_rng(2).uniform(-2, 10, (len(corners), 5, 2)))
    flat = torch.cat([points, torch.ones_like(points[..., :1])], 2) @ maps.cell_homography(corners, shape).mT
    wanted = (flat[..., :2] / flat[..., 2:]).nan_to_num().clamp(-maps.MOST_PX, maps.MOST_PX)
    assert torch.equal(maps.map_points(corners, points, shape), wanted)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_windows_and_places_are_those_of_batches(shape: PanelShape, dtype: torch.dtype) -> None:
    corners = quadrilaterals(3)
    count = len(corners)
    origin = torch.from_numpy(np.random.default_rng(4).integers(0, 90, (count, 2)))
    frames = Frames(torch.zeros(count, 1, 150, 160, dtype=torch.uint8), origin, (300, 400))
    cells, every = maps.cell_homography(corners, shape), torch.arange(count)
    x, y = rectification._grid(shape, 8, corners.device)
    wanted = rectification._window(frames, every, cells, x, y, dtype)
    given = rectification._window_on_host(frames, every, cells, x, y, dtype)
    assert given.size == wanted.size
    for field in ("origin", "homography", "first", "last"):
        assert torch.equal(getattr(given, field), getattr(wanted, field)), field
    places = rectification._places(wanted, x.to(dtype), y.to(dtype))
    for one, other in zip(
        rectification._places_on_host(wanted, x.to(dtype), y.to(dtype)), places, strict=True
    ):
        assert torch.equal(one, other)


def random_mask(rng: np.random.Generator) -> np.ndarray:
    """Draw noise, a turned rectangle of it, or a grid of dots; its foreground begins at the borders."""
    high, wide = rng.integers(2, 50, 2)
    mask = rng.random((high, wide)) < rng.choice([0.05, 0.3, 0.9])
    kind = rng.integers(3)
    if kind == 1:
        turn, (y, x) = (
            rng.uniform(0, np.pi),
            np.mgrid[:high, :wide] - np.array([high, wide])[:, None, None] / 2,
        )
        along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
        mask &= (abs(along) < wide / 3) & (abs(across) < high / 3)
    if kind == 2:
        mask &= (np.arange(high)[:, None] % 4 == 0) & (np.arange(wide) % 4 == 0)
    mask[rng.integers(high), rng.integers(wide)] = True
    rows, columns = mask.any(1).nonzero()[0], mask.any(0).nonzero()[0]
    return mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def test_a_single_blob_is_chosen_as_on_the_ladder() -> None:
    rng, seen = np.random.default_rng(5), 0
    for _ in range(400):
        mask = random_mask(rng)
        shape = SHAPES[rng.integers(len(SHAPES))]
        closing, area = int(rng.choice([1, 3, 11, 999])), int(rng.choice([1, 60]))
        limits = float(rng.choice([0.0, 0.5])), float(rng.choice([0.0, 0.7]))
        search = Search(closing, area, *limits, ("min_area", "upright")[rng.integers(2)])
        plane = torch.from_numpy(mask.copy())
        closed = close_mask(plane[None, None], closing)[0, 0].numpy()
        blob = single_blob(mask, closed, shape, search)
        if blob is None:
            continue
        seen += 1
        choice = climb(plane[None], shape, search)
        assert choice.score.item() == blob.score
        assert choice.corners_px[0].tolist() == [list(corner) for corner in blob.corners_px]
        assert (choice.candidates.item(), choice.mask_px.item()) == (1, blob.mask_px)
        assert tuple(choice.first_px[0].tolist()) == blob.first_px
    assert seen > 60


def uneven_frames() -> torch.Tensor:
    """Lay out frames: plain but for a square, two of them, noise, nothing, and a square in the first row."""
    rng = np.random.default_rng(6)
    grey = np.full((6, 1, 260, 330), 100, dtype=np.uint8)
    grey[0, 0, 101:140, 203:244] = rng.integers(90, 200, (39, 41))
    grey[1, 0, [50, 200], [40, 90]] = 130, 20
    grey[2] = rng.integers(0, 256, grey[2].shape)
    grey[4, 0, :9, 100:120] = 250
    grey[5, 0, 30:230, 20:320] = rng.integers(90, 200, (200, 300))
    return torch.from_numpy(grey)


def test_what_is_of_one_grey_value_is_counted_and_bounded_as_every_pixel() -> None:
    grey = uneven_frames()
    parts = uneven_parts(grey)
    assert parts.boxes[:2] == [(203, 101, 41, 39), (40, 50, 51, 151)]
    assert [parts.outside_px(index) > 0 for index in range(6)] == [True, True, False, True, False, False]
    wanted = torch.stack([torch.bincount(frame.flatten(), minlength=256) for frame in grey])
    assert torch.equal(histogram256(grey), wanted)
    for limit in (10, 99, 100, 128, 255):
        threshold = torch.full((6,), limit)
        assert torch.equal(_foreground_boxes(grey, threshold, parts), _foreground_boxes(grey, threshold))


def test_regions_of_plain_frames_are_those_of_every_block() -> None:
    grey = uneven_frames()
    means = block_means(grey)
    assert torch.equal(block_means(grey, uneven_parts(grey)), means)
    plain = local_background(means[:1], [100])
    assert torch.equal(plain, local_background(means[:1]))

    def nothing_known(frames: torch.Tensor) -> UnevenParts:
        return UnevenParts([(0, 0, 330, 260)] * len(frames), [0] * len(frames), (260, 330))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("vocc_torch.receiver.regions.uneven_parts", nothing_known)
        wanted = bright_regions(grey)
        alone = bright_regions(grey[[0, 3]])
    for given, other in ((bright_regions(grey), wanted), (bright_regions(grey[[0, 3]]), alone)):
        assert len(other.frame)
        for field in ("frame", "left_px", "top_px", "side_px"):
            assert torch.equal(getattr(given, field), getattr(other, field)), field
