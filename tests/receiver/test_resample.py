"""Resampling against OpenCV and SciPy, crops against full frames, and corners that must not break it."""

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from vocc_torch.receiver.resample import (
    cell_homography,
    centre_greys,
    rectify,
)
from vocc_torch.types import Frames, Panels, PanelShape

SHAPE = PanelShape(4, 5)
QUADRILATERALS = {
    "upright": [(20.3, 15.7), (62.8, 15.7), (62.8, 49.7), (20.3, 49.7)],
    "rotated": [(30.1, 12.2), (70.4, 23.0), (61.7, 55.4), (21.4, 44.6)],
    "perspective": [(22.0, 14.0), (66.0, 19.5), (60.3, 50.2), (25.1, 57.9)],
    "upside down": [(62.8, 49.7), (20.3, 49.7), (20.3, 15.7), (62.8, 15.7)],
}


def corners_of(*quadrilaterals):
    return torch.tensor(np.array(quadrilaterals, dtype=float))


def picture(seed, height=70, width=90, smooth=1.5):
    noise = np.random.default_rng(seed).random((height, width))
    blurred = ndimage.gaussian_filter(noise, smooth)
    return torch.from_numpy((blurred - blurred.min()) / np.ptp(blurred) * 255)


def sample_points(quadrilateral, shape, samples):
    """The image points of K x K samples a cell with one cell of margin around, by OpenCV's homography."""
    cells = np.float32(
        [(0, 0), (shape.columns, 0), (shape.columns, shape.rows), (0, shape.rows)]
    )
    matrix = cv2.getPerspectiveTransform(cells, np.float32(quadrilateral))
    across = (np.arange((shape.columns + 2) * samples) + 0.5) / samples - 1
    down = (np.arange((shape.rows + 2) * samples) + 0.5) / samples - 1
    grid = np.stack(np.meshgrid(across, down), axis=-1).reshape(1, -1, 2)
    return cv2.perspectiveTransform(grid, matrix).reshape(down.size, across.size, 2)


def solved_homography(cells, corners):
    """The eight linear equations of four point pairs, solved by NumPy."""
    rows, right = [], []
    for (x, y), (u, v) in zip(np.float64(cells), np.float64(corners), strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
        right += [u, v]
    return np.append(np.linalg.solve(rows, right), 1).reshape(3, 3)


@given(st.integers(0, 100_000))
@settings(max_examples=40, deadline=None)
def test_homography_is_numpys_solution_and_opencvs_within_its_float32(seed):
    """Random convex quadrilaterals: the square's corners moved by up to a sixth of its side.

    OpenCV's own answer is up to 2e-5 px off, because it takes corners in float32.
    """
    rng = np.random.default_rng(seed)
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * 60.0
    quadrilateral = (
        square + rng.uniform(-10, 10, (4, 2)) + rng.uniform(0, 900, 2)
    ).astype(np.float32)
    cells = np.float32([(0, 0), (5, 0), (5, 4), (0, 4)])
    corners = torch.from_numpy(quadrilateral)[None]
    ours = cell_homography(corners, SHAPE)[0].numpy()
    learning = cell_homography(corners.clone().requires_grad_(), SHAPE)
    assert np.array_equal(ours, learning[0].detach().numpy())
    np.testing.assert_allclose(
        ours, solved_homography(cells, quadrilateral), rtol=1e-8, atol=1e-10
    )
    inner = np.random.default_rng(seed).uniform(0, 4, (1, 50, 2))
    theirs = cv2.perspectiveTransform(
        inner, cv2.getPerspectiveTransform(cells, quadrilateral)
    )
    np.testing.assert_allclose(
        cv2.perspectiveTransform(inner, ours), theirs, rtol=0, atol=1e-4
    )


@pytest.mark.parametrize("name", list(QUADRILATERALS))
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_patches_are_scipys_bilinear_reading_at_opencvs_points(name, dtype):
    image, points = picture(1), sample_points(QUADRILATERALS[name], SHAPE, 12)
    # SciPy counts from pixel centres, the package from pixel edges.
    expected = ndimage.map_coordinates(
        image.numpy(),
        [points[..., 1] - 0.5, points[..., 0] - 0.5],
        order=1,
        mode="nearest",
    )
    panels = Panels.known(corners_of(QUADRILATERALS[name]))
    patch = rectify(Frames.whole(image[None].to(dtype)), panels, SHAPE, 12)
    assert patch.dtype == dtype
    assert patch.shape == (1, 1, 72, 84)
    # OpenCV takes corners in float32, so 1e-5 px and with it 1e-3 DN is what the points themselves are worth.
    np.testing.assert_allclose(patch[0, 0].numpy(), expected, rtol=0, atol=1e-3)


@pytest.mark.parametrize("name", list(QUADRILATERALS))
def test_gradients_flow_to_the_corners_through_the_same_values(name):
    frames, corners = Frames.whole(picture(1)[None]), corners_of(QUADRILATERALS[name])
    moved = corners.clone().requires_grad_()
    patch = rectify(frames, Panels.known(moved), SHAPE, 2)
    assert torch.equal(patch.detach(), rectify(frames, Panels.known(corners), SHAPE, 2))
    (slope,) = torch.autograd.grad(patch.sum(), moved)
    step = torch.zeros_like(corners)
    step[0, 2, 0] = 1e-6
    ends = [
        rectify(frames, Panels.known(corners + sign * step), SHAPE, 2).sum()
        for sign in (1, -1)
    ]
    np.testing.assert_allclose(slope[0, 2, 0], (ends[0] - ends[1]) / 2e-6, rtol=1e-4)


# Crops


def cropped(image, x, y, height, width):
    """A crop of a frame that is uniform outside it."""
    grey = image[..., y : y + height, x : x + width]
    return Frames(
        grey,
        torch.tensor([[x, y]]).expand(len(image), 2),
        tuple(image.shape[-2:]),
        grey[:, 0, 0, 0],
    )


@pytest.mark.parametrize("name", list(QUADRILATERALS))
@pytest.mark.parametrize("offset", [(0.0, 0.0), (777.123, 411.987)])
def test_a_crop_reads_exactly_like_the_full_frame(name, offset):
    """Bitwise, float32 from uint8: the patches and the centres' greys."""
    full = torch.full((1, 1, 600, 1000), 102, dtype=torch.uint8)
    x, y = (int(v) for v in offset)
    full[0, 0, y + 5 : y + 65, x + 5 : x + 85] = (
        picture(6, 60, 80).round().to(torch.uint8)
    )
    panels = Panels.known(corners_of(QUADRILATERALS[name]) + torch.tensor(offset))
    crop, whole = cropped(full, x, y, 70, 90), Frames.whole(full)
    assert torch.equal(
        rectify(crop, panels, SHAPE, 8), rectify(whole, panels, SHAPE, 8)
    )
    assert torch.equal(
        centre_greys(crop, panels, SHAPE), centre_greys(whole, panels, SHAPE)
    )


# Near panels


def test_samples_of_a_near_panel_are_area_means_of_the_pixels():
    """5 px a sample exactly on pixels: the mean of any 5 x 5 pixels, not five of them skipped."""
    image = picture(7, 260, 300, smooth=0.3)
    panels = Panels.known(corners_of([(50, 45), (250, 45), (250, 205), (50, 205)]))
    patch = rectify(Frames.whole(image[None]), panels, SHAPE, 8)[0, 0]
    blocks = image[5:245, 10:290].reshape(48, 5, 56, 5).mean(dim=(1, 3))
    torch.testing.assert_close(patch, blocks, rtol=0, atol=1e-9)


# Sizes, centres, batches, wild corners


@pytest.mark.parametrize("name", list(QUADRILATERALS))
def test_centre_greys_are_the_pixels_that_hold_opencvs_centres(name):
    image = torch.from_numpy(
        np.random.default_rng(9).integers(0, 256, (70, 90), dtype=np.uint8)
    )
    points = sample_points(QUADRILATERALS[name], SHAPE, 1)[1:-1, 1:-1]
    expected = image.numpy()[
        np.floor(points[..., 1]).astype(int), np.floor(points[..., 0]).astype(int)
    ]
    ours = centre_greys(
        Frames.whole(image[None]), Panels.known(corners_of(QUADRILATERALS[name])), SHAPE
    )
    assert ours.is_floating_point()
    np.testing.assert_array_equal(ours[0].numpy(), expected)
