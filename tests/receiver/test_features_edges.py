"""Edges of the features: the last grey value taken, what a refusal says, slopes on a black panel."""

import math
import re

import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.receiver.features import (
    MOST_GREY,
    average_greyscale_ratio,
    cell_means,
    checked_greys,
    gradient_radial_inwardness,
    neighbour_greyscale_ratio,
)
from vocc_torch.types import PanelShape


def test_the_greatest_grey_value_is_taken_and_the_next_is_not():
    most = torch.tensor([0.0, MOST_GREY], dtype=torch.float64)
    assert torch.equal(checked_greys(most, "greys"), most)
    with pytest.raises(VoccError, match=r"^greys holds values from "):
        checked_greys(torch.nextafter(most, torch.tensor(math.inf, dtype=torch.float64)), "greys")


@pytest.mark.parametrize(
    ("values", "held"),
    [
        ([0.0, math.nan], "NaN"),
        ([math.inf, math.inf], "values from inf to inf"),
        ([-3.0, 7.0], "values from -3 to 7"),
        ([1.0, 2e9], "values from 1 to 2e+09"),
    ],
)
def test_a_refusal_says_what_was_there(values, held):
    with pytest.raises(VoccError, match=rf"^greys holds {re.escape(held)}: .*0 to 1e\+09$"):
        checked_greys(torch.tensor(values), "greys")


@pytest.mark.parametrize("feature", [average_greyscale_ratio, neighbour_greyscale_ratio])
def test_a_black_panel_has_a_slope_of_zero_and_not_nan(feature):
    """Of two panels only the black one is a constant; the other's slope is that of a ratio."""
    means = torch.zeros(2, 4, 4, dtype=torch.float64)
    means[1] = torch.rand(4, 4, generator=torch.Generator().manual_seed(1)) * 100 + 20
    means.requires_grad_()
    (slopes,) = torch.autograd.grad(feature(means).square().sum(), means)
    assert slopes[0].count_nonzero() == 0
    assert torch.autograd.gradcheck(lambda m: feature(m), means[1:].detach().requires_grad_())
    assert slopes[1].isfinite().all()
    assert slopes[1].count_nonzero() > 0


@pytest.mark.parametrize(
    "size", [(1, 20, 15), (1, 1, 1, 20, 15), (20, 15), (1, 1, 20, 10), (1, 1, 15, 20), (1, 1, 3, 2)]
)
def test_patches_that_are_not_the_panels_are_refused_with_the_shape_they_must_have(size):
    """A panel of 2 x 1 LEDs has 4 x 3 cells with its margin."""
    patches = torch.zeros(size)
    cell = torch.tensor([5.0])
    wanted = re.escape(
        f"patches has shape {size}: for a panel of 2 x 1 LEDs it must be (B,1,4K,3K), K at least 1"
    )
    for refuse in (
        lambda: cell_means(patches, PanelShape(2, 1)),
        lambda: gradient_radial_inwardness(patches, PanelShape(2, 1), cell, cell),
    ):
        with pytest.raises(VoccError, match=f"^{wanted}$"):
            refuse()
