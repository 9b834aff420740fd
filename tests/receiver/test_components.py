"""Closing, block maxima, connected components and blobs, against OpenCV, SciPy and scikit-image."""

import cv2
import numpy as np
import pytest
import torch
from scipy.spatial import ConvexHull
from skimage.measure import block_reduce

from vocc_torch.receiver.components import (
    close_mask,
    collect_blobs,
    halve_mask,
    label_components,
)
from vocc_torch.receiver.quadrilateral import convex_hull


def random_masks(seed, frames=6, size=(37, 44), share=None):
    rng = np.random.default_rng(seed)
    shares = rng.uniform(0.005, 0.15, (frames, 1, 1)) if share is None else share
    return rng.random((frames, *size)) < shares


def opencv_closing(mask, size):
    """Close on a plane that goes on as background."""
    plane = np.pad(mask.astype(np.uint8), size)
    closed = cv2.morphologyEx(plane, cv2.MORPH_CLOSE, np.ones((size, size), np.uint8))
    return closed[size:-size, size:-size]


def opencv_blobs(mask, size):
    """Components of the closed mask, by first mask pixel in raster order, from OpenCV and NumPy."""
    count, labels = cv2.connectedComponents(opencv_closing(mask, size), connectivity=8)
    found = []
    for label in range(1, count):
        rows, columns = np.nonzero((labels == label) & mask)
        ends = {row: columns[rows == row] for row in set(rows.tolist())}
        extremes = [
            (ends[row].min(), ends[row].max()) if row in ends else None
            for row in range(rows.min(), rows.max() + 1)
        ]
        area = int((labels == label).sum())
        found.append(
            (
                area,
                len(rows),
                (int(columns[0]), int(rows[0])),
                int(columns.min()),
                extremes,
            )
        )
    return sorted(found, key=lambda blob: blob[2][::-1])


def as_opencv(blobs):
    found = []
    for blob in blobs:
        ends = zip(blob.first.tolist(), blob.last.tolist(), strict=True)
        left = blob.left_px
        extremes = [(a + left, b + left) if a <= b else None for a, b in ends]
        found.append((blob.area_px, blob.mask_px, blob.first_px, left, extremes))
    return sorted(found, key=lambda blob: blob[2][::-1])


@pytest.mark.parametrize(
    ("closing", "share"), [(1, 0.3), (3, 0.06), (5, 0.02), (11, 0.004)]
)
def test_blobs_equal_opencvs(closing, share):
    for mask in torch.from_numpy(random_masks(closing, share=share)):
        labels = label_components(close_mask(mask[None, None], closing)[0, 0])
        blobs = collect_blobs(mask, labels)
        assert as_opencv(blobs) == opencv_blobs(mask.numpy(), closing)


@pytest.mark.parametrize("shape", ["disc", "turned square", "noise"])
def test_hulls_of_tall_blobs_equal_scipys(shape):
    y, x = np.mgrid[0:301, 0:301] - 150
    inside = {
        "disc": x**2 + y**2 <= 150**2,
        "turned square": np.abs(0.8 * x + 0.6 * y) + np.abs(0.8 * y - 0.6 * x) <= 140,
        "noise": np.random.default_rng(0).random((301, 301)) < 0.01,
    }[shape]
    rows, columns = np.nonzero(inside)
    points = np.stack([columns, rows - rows.min()], 1)
    height = points[:, 1].max() + 1
    first, last = np.full(height, 9999), np.full(height, -1)
    np.minimum.at(first, points[:, 1], points[:, 0])
    np.maximum.at(last, points[:, 1], points[:, 0])
    hull = convex_hull(torch.from_numpy(first[None]), torch.from_numpy(last[None]))
    expected = {tuple(point) for point in points[ConvexHull(points).vertices].tolist()}
    assert {(int(a), int(b)) for a, b in hull[0].tolist()} == expected


def closed(mask, size):
    return close_mask(torch.from_numpy(mask)[:, None], size)[:, 0].numpy()


@pytest.mark.parametrize("size", [1, 3, 5, 11, 21])
def test_closing_equals_opencvs_up_to_the_border(size):
    masks = random_masks(size)
    masks[0, 0, :] = masks[1, :, -1] = masks[2, 3, 3] = True
    np.testing.assert_array_equal(
        closed(masks, size), [opencv_closing(mask, size) for mask in masks]
    )


@pytest.mark.parametrize("size", [(8, 8), (7, 8), (9, 5), (1, 1)])
def test_halving_equals_block_maxima(size):
    masks = random_masks(11, size=size) | (
        np.random.default_rng(0).random((6, *size)) < 0.2
    )
    halved = halve_mask(torch.from_numpy(masks)[:, None])[:, 0].numpy()
    np.testing.assert_array_equal(
        halved, [block_reduce(mask, (2, 2), np.max) for mask in masks]
    )
