"""Whole-pixel cells against a loop over pixels, and the same in every batch and crop."""

import numpy as np
import pytest
import torch

from vocc_torch.receiver.features import FEATURE_NAMES
from vocc_torch.receiver.pixel_cells import read_pixels
from vocc_torch.receiver.reader import Reader
from vocc_torch.types import Frames, Panels, PanelShape

SHAPE, SHARE = PanelShape(3, 4), 0.5


def looped(grey, corners):
    """AGR, GRI, NGR, average and centre of every LED of one frame (h,w), by Eqs 4 to 9."""
    low, high = corners.min(0), corners.max(0)
    edges, middle = [], []
    for axis, leds in ((0, SHAPE.columns), (1, SHAPE.rows)):
        inset = (high[axis] - low[axis]) / leds * (1 - SHARE) / 2
        first, last = np.round(low[axis] + inset), np.round(high[axis] - inset)
        step = (last - first) / leds
        edges.append([int(np.round(first + i * step)) for i in range(-1, leds + 2)])
        middle.append([int(np.round(first + (i + 0.5) * step)) for i in range(leds)])
    columns, rows = edges
    cells = np.empty((SHAPE.rows + 2, SHAPE.columns + 2))
    gri = np.empty((SHAPE.rows, SHAPE.columns))
    for i, j in np.ndindex(*cells.shape):
        y, x = range(rows[i], rows[i + 1]), range(columns[j], columns[j + 1])
        cells[i, j] = np.mean([grey[v, u] for v in y for u in x])
        if 0 < i <= SHAPE.rows and 0 < j <= SHAPE.columns:
            inward = 0.0
            for v, u in np.ndindex(len(y), len(x)):
                to = np.subtract((len(x), len(y)), 1) / 2 - (u, v)
                at = rows[i] + v, columns[j] + u
                slope = (
                    grey[at[0], at[1] + 1] - grey[at[0], at[1] - 1],
                    grey[at[0] + 1, at[1]] - grey[at[0] - 1, at[1]],
                )
                inward += np.dot(slope, to) / max(np.hypot(*to), 0.5)
            gri[i - 1, j - 1] = inward / (len(y) * len(x))
    inner, mean = cells[1:-1, 1:-1], cells[1:-1, 1:-1].mean()
    around = np.empty_like(inner)
    for i, j in np.ndindex(*inner.shape):
        around[i, j] = (cells[i : i + 3, j : j + 3].sum() - inner[i, j]) / 8
    centre = grey[np.ix_(middle[1], middle[0])]
    return np.stack([inner / mean, gri, around / mean], axis=-1), inner, centre


@pytest.fixture(scope="module")
def seen():
    grey = np.random.default_rng(0).integers(0, 256, (2, 60, 70)).astype(np.uint8)
    box = torch.tensor([[[9.3, 8.2], [41.9, 8.2], [41.9, 33.6], [9.3, 33.6]]])
    corners = torch.cat([box, box + torch.tensor([5.45, 12.3])]).double()
    return Frames.whole(torch.from_numpy(grey)[:, None]), corners


def test_every_number_is_that_of_a_loop_over_pixels(seen):
    frames, corners = seen
    found = read_pixels(frames, corners, SHAPE, SHARE, "central")
    features = torch.stack([found[name] for name in FEATURE_NAMES], dim=-1)
    ours = features, found["average"], found["centre"]
    for at in range(2):
        grey = frames.grey[at, 0].double().numpy()
        for value, theirs in zip(ours, looped(grey, corners[at].numpy()), strict=True):
            np.testing.assert_allclose(value[at].numpy(), theirs, atol=1e-6)


def test_a_frame_reads_alike_in_every_batch_and_crop(seen):
    frames, corners = seen
    reader = Reader(SHAPE, gradient="central", disc_share=SHARE)
    both = reader.read(frames, Panels.known(corners))
    crop = Frames(
        frames.grey[1:, :, 10:, 6:], torch.tensor([[6, 10]]), frames.sensor_px
    )
    for alone in (frames[1:], crop):
        again = reader.read(alone, Panels.known(corners[1:]))
        assert torch.equal(again.features[0], both.features[1])
        assert torch.equal(again.greys.centre[0], both.greys.centre[1])
