"""Otsu's threshold against OpenCV and exact arithmetic, histograms of crops, frames cut to what is uneven."""

from fractions import Fraction

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from vocc_torch.receiver.foreground import (
    histogram256,
    otsu_threshold,
    sensor_histogram,
    trimmed,
)
from vocc_torch.types import Frames


def opencv_threshold(grey):
    return int(cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[0])


def thresholds(grey):
    return otsu_threshold(histogram256(torch.from_numpy(grey)[:, None])).tolist()


def exact_threshold(counts):
    """Otsu's criterion in rational arithmetic; the lowest of the best."""
    total, mass = sum(counts), sum(i * n for i, n in enumerate(counts))
    best, best_value = 0, Fraction(-1)
    below = below_mass = 0
    for level, n in enumerate(counts):
        below, below_mass = below + n, below_mass + level * n
        if 0 < below < total:
            between = Fraction(
                (mass * below - below_mass * total) ** 2, below * (total - below)
            )
            if between > best_value:
                best, best_value = level, between
    return best


@pytest.mark.parametrize("size", [(40, 50), (300, 300)])
def test_histogram_equals_numpys_on_both_paths(size):
    rng = np.random.default_rng(1)
    grey = rng.integers(0, 256, (3, *size), dtype=np.uint8)
    grey[1] //= 3
    expected = [np.bincount(frame.ravel(), minlength=256).tolist() for frame in grey]
    assert histogram256(torch.from_numpy(grey)[:, None]).tolist() == expected


def test_thresholds_equal_opencvs_on_dense_histograms():
    rng = np.random.default_rng(2)
    grey = np.stack(
        [
            np.clip(
                np.where(
                    rng.random((120, 120)) < rng.uniform(0.05, 0.6),
                    rng.normal(rng.uniform(120, 230), rng.uniform(10, 30), (120, 120)),
                    rng.normal(rng.uniform(40, 110), rng.uniform(10, 30), (120, 120)),
                ),
                0,
                255,
            ).astype(np.uint8)
            for _ in range(60)
        ]
    )
    assert thresholds(grey) == [opencv_threshold(frame) for frame in grey]


@settings(max_examples=60, deadline=None)
@given(
    st.dictionaries(st.integers(0, 255), st.integers(1, 50), min_size=2, max_size=12)
)
def test_threshold_is_the_lowest_exact_optimum(bins):
    counts = [bins.get(level, 0) for level in range(256)]
    assert otsu_threshold(torch.tensor([counts])).item() == exact_threshold(counts)


def test_surround_counts_as_the_rest_of_the_sensor():
    rng = np.random.default_rng(4)
    full = np.full((3, 60, 80), 0, dtype=np.uint8)
    surround = np.array([100, 7, 255])
    full[:] = surround[:, None, None]
    full[:, 20:40, 30:55] = rng.integers(0, 256, (3, 20, 25))
    crop = Frames(
        torch.from_numpy(full[:, None, 20:40, 30:55].copy()),
        torch.tensor([[30, 20]] * 3),
        (60, 80),
        torch.tensor(surround),
    )
    whole = Frames.whole(torch.from_numpy(full))
    torch.testing.assert_close(
        sensor_histogram(crop), sensor_histogram(whole), rtol=0, atol=0
    )


def test_a_trimmed_frame_is_the_frame_on_one_grey_value():
    rng, full = np.random.default_rng(6), np.full((4, 301, 400), 30, dtype=np.uint8)
    full[1] += 9
    for frame, (y, x) in zip(
        full, ((0, 0), (290, 380), (100, 17), (40, 40)), strict=True
    ):
        frame[y + 1 : y + 6, x + 2 : x + 9] = rng.integers(0, 256, (5, 7))
    whole = Frames.whole(torch.from_numpy(full))
    crop = trimmed(whole)
    height, width = crop.grey.shape[-2:]
    assert (height, width) < (24, 24)
    for frame, grey, (x, y), level in zip(
        full, crop.grey, crop.origin_px.tolist(), crop.surround, strict=True
    ):
        again = np.full_like(frame, int(level))
        again[y : y + height, x : x + width] = grey[0]
        np.testing.assert_array_equal(again, frame)
    assert torch.equal(sensor_histogram(crop), sensor_histogram(whole))
    # Uneven in the first row; in a block that the border cuts.
    for place in (
        (0, 3),
        (300, 399),
    ):
        full[2][place] ^= 1
        assert trimmed(whole) is whole
        full[2][place] ^= 1
