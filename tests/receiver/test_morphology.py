from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.measure import block_reduce

from vocc_torch.errors import VoccError
from vocc_torch.receiver.components import close_mask, halve_mask


def random_masks(seed: int, frames: int = 6, size: tuple[int, int] = (37, 44)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    share = rng.uniform(0.005, 0.15, (frames, 1, 1))
    return rng.random((frames, *size)) < share


def opencv_closing(mask: np.ndarray, size: int) -> np.ndarray:
    """Close on a plane that goes on as background."""
    plane = np.pad(mask.astype(np.uint8), size)
    closed = cv2.morphologyEx(plane, cv2.MORPH_CLOSE, np.ones((size, size), np.uint8))
    return closed[size:-size, size:-size].astype(bool)


def closed(mask: np.ndarray, size: int) -> np.ndarray:
    return close_mask(torch.from_numpy(mask)[:, None], size)[:, 0].numpy()


@pytest.mark.parametrize("size", [1, 3, 5, 11, 21])
def test_closing_equals_opencvs_up_to_the_border(size: int) -> None:
    masks = random_masks(size)
    masks[0, 0, :] = masks[1, :, -1] = masks[2, 3, 3] = True
    np.testing.assert_array_equal(closed(masks, size), [opencv_closing(mask, size) for mask in masks])


def test_closing_of_a_square_larger_than_the_mask_equals_opencvs() -> None:
    masks = random_masks(7, frames=3, size=(9, 8))
    np.testing.assert_array_equal(closed(masks, 31), [opencv_closing(mask, 31) for mask in masks])


def test_a_blob_near_the_border_is_not_dragged_to_it() -> None:
    mask = np.zeros((1, 20, 20), dtype=bool)
    mask[0, 3:8, 3:8] = True
    np.testing.assert_array_equal(closed(mask, 11), mask)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([3, 5, 11]))
def test_closing_only_adds_and_is_idempotent(seed: int, size: int) -> None:
    masks = random_masks(seed, frames=2)
    once = closed(masks, size)
    assert once[masks].all()
    np.testing.assert_array_equal(closed(once, size), once)


@pytest.mark.parametrize("size", [0, -3, 4])
def test_even_and_small_squares_are_refused(size: int) -> None:
    with pytest.raises(VoccError, match=f"size_px is {size}: it must be odd"):
        close_mask(torch.zeros(1, 1, 4, 4, dtype=torch.bool), size)


def test_no_frames_give_no_frames() -> None:
    assert close_mask(torch.zeros(0, 1, 4, 4, dtype=torch.bool), 3).shape == (0, 1, 4, 4)


@pytest.mark.parametrize("size", [(8, 8), (7, 8), (9, 5), (1, 1)])
def test_halving_equals_block_maxima(size: tuple[int, int]) -> None:
    masks = random_masks(11, size=size) | (np.random.default_rng(0).random((6, *size)) < 0.2)
    halved = halve_mask(torch.from_numpy(masks)[:, None])[:, 0].numpy()
    np.testing.assert_array_equal(halved, [block_reduce(mask, (2, 2), np.max) for mask in masks])
