"""Area cover against closed forms, numerical integration and brute-force sampling, none of them its own."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from vocc_torch.simulation.raster import (
    disc_grid_cover,
    ellipse_cover,
    interval_cover,
)


def doubles(*values):
    return (torch.tensor([value], dtype=torch.float64) for value in values)


def disc_cover(x, y, radius, size, canvas_px):
    """Discs (N,) as ellipses."""
    spread = torch.diag_embed(torch.stack([radius, radius], dim=-1).square())
    return ellipse_cover(torch.stack([x, y], dim=-1), spread, size, canvas_px=canvas_px)


@pytest.mark.parametrize(
    "centre", [(0.0, 0.0), (7.9, 5.2), (-1.5, 3.0), (4.4, -1.9), (8.3, 9.0), (4.0, 3.5)]
)
def test_a_disc_is_cut_off_at_the_canvas_border(centre):
    """A small canvas shows the window of a large one, also where the disc is mostly or wholly outside."""
    small, large = np.zeros((7, 8)), np.zeros((27, 28))
    for canvas, shift in ((small, 0), (large, 10)):
        cover, left, top = disc_cover(
            *doubles(centre[0] + shift, centre[1] + shift, 2.3), 6, canvas.shape
        )
        canvas[int(top) : int(top) + 6, int(left) : int(left) + 6] = cover[0]
    np.testing.assert_allclose(small, large[10:17, 10:18], rtol=0, atol=1e-14)


@given(st.floats(-5, 15), st.floats(0, 20), st.integers(1, 12))
def test_interval_cover_is_the_overlap_with_each_pixel(low, length, size):
    high = low + length
    cover = interval_cover(*doubles(low, high), size)[0].tolist()
    assert cover == [
        pytest.approx(max(0.0, min(high, i + 1) - max(low, i)), abs=1e-12)
        for i in range(size)
    ]


@given(
    st.lists(
        st.tuples(st.floats(-4, 44), st.floats(-4, 44), st.floats(0.05, 3.5)),
        min_size=1,
        max_size=4,
    ),
    st.floats(0.3, 9.0),
    st.integers(1, 4),
    st.integers(1, 5),
)
def test_a_grid_of_discs_is_covered_as_each_disc_is(grids, pitch, rows, columns):
    """The quick way for upright grids gives what each disc alone has, also where the canvas cuts the grid."""
    x, y, radius = torch.tensor(grids, dtype=torch.float64).unbind(1)
    x = x.unsqueeze(1) + pitch * torch.arange(columns)
    y = y.unsqueeze(1) + pitch * torch.arange(rows)
    cover, left, top = disc_grid_cover(x, y, radius, 8, canvas_px=(32, 40))
    each = (len(grids), rows, columns)
    places = (
        x.unsqueeze(1).expand(each),
        y.unsqueeze(2).expand(each),
        radius.view(-1, 1, 1).expand(each),
    )
    one_by_one, its_left, its_top = disc_cover(
        *(of.reshape(-1) for of in places), 8, (32, 40)
    )
    torch.testing.assert_close(cover.flatten(0, 2), one_by_one, rtol=0, atol=5e-14)
    assert torch.equal(left.unsqueeze(1).expand(each).reshape(-1), its_left)
    assert torch.equal(top.unsqueeze(2).expand(each).reshape(-1), its_top)
