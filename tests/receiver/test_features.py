"""AGR, GRI and NGR against Eqs 4 to 9 worked out by hand and against OpenCV's gradient."""

import math
import re

import cv2
import numpy as np
import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.receiver.features import (
    MOST_GREY,
    cell_means,
    checked_greys,
    gradient_radial_inwardness,
    image_gradient,
    level_ratios,
    preamble_threshold,
    radial_inward_field,
)
from vocc_torch.types import PanelShape


def random_patches(seed, shape, samples, batch=1, dtype=torch.float64):
    size = (batch, 1, (shape.rows + 2) * samples, (shape.columns + 2) * samples)
    return torch.from_numpy(np.random.default_rng(seed).random(size) * 255).to(dtype)


def gri(patches, shape, cell_px, *kernel):
    size = torch.full((len(patches),), float(cell_px), dtype=torch.float64)
    return gradient_radial_inwardness(patches, shape, size, size, *kernel)


# By hand


def test_agr_and_ngr_of_a_small_panel_by_hand():
    """Cells of a 2 x 2 panel with a margin of background at 12:

        12 12 12 12
        12 40 20 12      panel mean (40 + 20 + 20 + 0) / 4 = 20
        12 20  0 12      AGR  40/20 = 2   20/20 = 1
        12 12 12 12           20/20 = 1    0/20 = 0

    NGR: five margin cells and the other three LEDs, over 8, over 20:
        top left (60 + 20 + 20 + 0) / 160 = 0.625      top right   (60 + 40 + 20 + 0) / 160  = 0.75
        bottom left (60 + 40 + 20 + 0) / 160 = 0.75    bottom right (60 + 40 + 20 + 20) / 160 = 0.875
    """
    means = torch.full((1, 4, 4), 12.0, dtype=torch.float64)
    means[0, 1:3, 1:3] = torch.tensor([[40.0, 20.0], [20.0, 0.0]])
    agr, ngr = level_ratios(means)[0]
    assert agr.tolist() == [[2.0, 1.0], [1.0, 0.0]]
    assert ngr.tolist() == [
        [0.625, 0.75],
        [0.75, 0.875],
    ]


def test_gri_of_one_bright_sample_by_hand():
    """One LED of K = 3 samples, black but for 8 at its middle, seen at 3 px a cell: one sample is one pixel.

    Normalised Sobel (weights 1, 2, 1 over 8). Beside the bright sample the slope towards it is 2 * 8 / 8 = 2,
    and Eq. 8's vector points straight at it: 4 samples of 2. At a corner both slopes are 1 * 8 / 8 = 1 and
    the vector is (1, 1) / sqrt 2: 4 samples of sqrt 2. The middle's vector is zero, so
    GRI = (8 + 4 sqrt 2) / 9 = 1.517428.

    Eq. 6 to the letter: beside it f(x+1) - f(x-1) = 8, 4 samples of 8; at a corner 0; GRI = 32 / 9 = 3.5556.
    At 6 px a cell a sample is two pixels, and each slope a pixel half as large.
    """
    patch = torch.zeros(1, 1, 9, 9, dtype=torch.float64)
    patch[..., 4, 4] = 8.0
    one = PanelShape(1, 1)
    assert float(gri(patch, one, 3)) == pytest.approx(
        (8 + 4 * math.sqrt(2)) / 9, rel=1e-12
    )
    assert float(gri(patch, one, 3)) == pytest.approx(1.517428, abs=1e-6)
    assert float(gri(patch, one, 3, "central")) == pytest.approx(32 / 9, rel=1e-12)
    assert float(gri(patch, one, 6)) == pytest.approx(
        (8 + 4 * math.sqrt(2)) / 18, rel=1e-12
    )


def test_cell_means_are_numpys():
    shape = PanelShape(2, 3)
    patches = random_patches(1, shape, 5, batch=2)
    expected = patches.numpy().reshape(2, 4, 5, 5, 5).mean(axis=(2, 4))
    np.testing.assert_allclose(cell_means(patches, shape).numpy(), expected, rtol=1e-13)


# Gradients


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_sobel_is_opencvs_normalised_by_8_and_central_is_its_bare_difference(dtype):
    image = random_patches(2, PanelShape(2, 3), 7, dtype=dtype)
    atol = 1e-12 if dtype == torch.float64 else 5e-5
    for kernel, size, scale in (("sobel", 3, 1 / 8), ("central", 1, 1)):
        ours = image_gradient(image, kernel)[0].numpy()
        for axis, (dx, dy) in enumerate([(1, 0), (0, 1)]):
            expected = cv2.Sobel(image[0, 0].double().numpy(), cv2.CV_64F, dx, dy, ksize=size, scale=scale,
                                 borderType=cv2.BORDER_REPLICATE)  # fmt: skip
            np.testing.assert_allclose(ours[axis], expected, rtol=0, atol=atol)


@pytest.mark.parametrize("samples", [2, 3, 4, 5, 8, 9])
def test_radial_vectors_are_eq_8(samples):
    """Unit length, pointing at the cell's centre; zero where a sample is the centre, which needs odd K."""
    field = radial_inward_field(samples, torch.float64, torch.device("cpu")).numpy()
    centre = (samples - 1) / 2
    for y, x in np.ndindex(samples, samples):
        away = np.array([centre - x, centre - y])
        expected = away / np.hypot(*away) if away.any() else away
        np.testing.assert_allclose(field[:, y, x], expected, rtol=0, atol=1e-15)
    assert (np.hypot(*field) == 0).sum() == samples % 2
    meta = torch.device("meta")
    assert radial_inward_field(samples, torch.float64, meta).device == meta


@pytest.mark.parametrize("kernel", ["sobel", "central"])
@pytest.mark.parametrize(
    ("shape", "samples"),
    [(PanelShape(3, 2), 5), (PanelShape(1, 4), 4), (PanelShape(2, 2), 2)],
)
def test_gri_is_eq_7_sample_by_sample(kernel, shape, samples):
    """Eqs 5, 7 and 8 in a plain loop over every LED's samples, the gradient from OpenCV; cells 7 by 9 px."""
    patch = random_patches(4, shape, samples, batch=2)
    size, scale = (3, 1 / 8) if kernel == "sobel" else (1, 1)
    dx, dy = (
        cv2.Sobel(patch[1, 0].numpy(), cv2.CV_64F, *d, ksize=size, scale=scale)
        for d in ((1, 0), (0, 1))
    )
    sides = torch.tensor([[5.0, 7.0], [4.0, 9.0]], dtype=torch.float64)
    ours = gradient_radial_inwardness(patch, shape, *sides, kernel)[1].numpy()
    single = gradient_radial_inwardness(patch.float(), shape, *sides, kernel)
    assert single.dtype == torch.float32
    for row, column in np.ndindex(shape.rows, shape.columns):
        total = 0.0
        for y, x in np.ndindex(samples, samples):
            r = np.array([(samples - 1) / 2 - x, (samples - 1) / 2 - y])
            r = r / np.hypot(*r) if r.any() else r
            i, j = (row + 1) * samples + y, (column + 1) * samples + x
            total += dx[i, j] * samples / 7 * r[0] + dy[i, j] * samples / 9 * r[1]
        expected = pytest.approx(total / samples**2, rel=1e-11, abs=1e-11)
        assert ours[row, column] == expected


# Edges


SHAPE, PATCHES = PanelShape(2, 3), random_patches(5, PanelShape(2, 3), 4)


def greys_of(*values, dtype=torch.float64):
    return checked_greys(torch.tensor(values, dtype=dtype), "greys")


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: greys_of(0.0, math.nan), "greys holds NaN"),
        (lambda: greys_of(math.inf, math.inf), "greys holds values from inf to inf"),
        (lambda: greys_of(-3.0, 7.0), "greys holds values from -3 to 7"),
        (
            lambda: greys_of(1.0, math.nextafter(MOST_GREY, math.inf)),
            "greys holds values from 1 to 1e+09",
        ),
        (
            lambda: greys_of(7, dtype=torch.uint8),
            "greys has dtype torch.uint8: it must be floating",
        ),
        (
            lambda: cell_means(PATCHES.int(), SHAPE),
            "patches has dtype torch.int32: it must be floating",
        ),
    ],
)
def test_a_refusal_says_what_was_there_and_what_may_be(call, says):
    rule = ": grey values must be finite, 0 to 1e+09" if " holds " in says else ""
    assert greys_of(0.0, MOST_GREY).tolist() == [0.0, MOST_GREY]
    with pytest.raises(VoccError, match=f"^{re.escape(says + rule)}$"):
        call()


# The baselines' threshold


def test_the_threshold_is_the_midpoint_of_the_mean_levels():
    """On LEDs at 190, 210, 200, 240 average 210, Off LEDs at 100, 90, 110, 120 average 105: halfway 157.5."""
    on = torch.tensor([[[190.0, 210.0], [200.0, 240.0]]])
    off = torch.tensor([[[100.0, 90.0], [110.0, 120.0]]])
    assert preamble_threshold(on, off).tolist() == [[[157.5]]]
