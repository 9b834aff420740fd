"""Hard cases of features and decision: black, saturated and tiny panels, and values that decide nothing."""

import math

import numpy as np
import pytest
import torch
from torch import nn

from vocc_torch.errors import VoccError
from vocc_torch.receiver.features import level_ratios
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.reader import GREYS, Reader
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.types import Frames, Panels, PanelShape

NAN, INF = math.nan, math.inf


def square_panel(left, top, width, height=None, *, turn_deg=0.0):
    """A located panel; turned about its middle."""
    height = width if height is None else height
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]]) - [
        width / 2,
        height / 2,
    ]
    cosine, sine = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    corners = corners @ np.array([[cosine, sine], [-sine, cosine]]) + [
        left + width / 2,
        top + height / 2,
    ]
    return Panels.known(torch.from_numpy(corners)[None])


def texture(seed, size=(40, 40), dtype=torch.float64):
    """Random grey values, 0 to 255."""
    return torch.from_numpy(
        np.random.default_rng(seed).uniform(0, 255, (1, 1, *size))
    ).to(dtype)


# Ratios


def test_a_panel_whose_mean_is_0():
    shape = PanelShape(2, 3)
    black = Frames.whole(torch.zeros(2, 40, 40, dtype=torch.uint8))
    lit = black.grey.clone()
    lit[0, :, :3] = 255  # beside the panel, within its margin
    lit[1] = 200
    panels = square_panel(4, 4, 24, 16)
    panels = Panels.known(panels.corners_px.repeat(2, 1, 1))
    for frames in (black, Frames.whole(lit)):
        features = Reader(shape, 4).read(frames, panels).features
        assert features[..., [0, 2]].unique().tolist() == [1.0]
        assert not features[1, ..., 1].any()
    means = torch.zeros(1, 4, 5)
    means[0, 0] = 9.0
    assert level_ratios(means).unique().tolist() == [1.0]


def test_a_panel_all_but_black():
    for dtype, grey in (
        (torch.float32, 1e-30),
        (torch.float32, 1e-40),
        (torch.float64, 1e-300),
        (torch.float16, 1e-4),
    ):
        means = torch.full((1, 4, 4), 255.0, dtype=dtype)
        means[0, 1:3, 1:3] = grey
        own, ratio = level_ratios(means).unbind(1)
        exact = (5 * 255 + 3 * float(means[0, 1, 1])) / 8 / float(means[0, 1, 1])
        wanted = min(exact, torch.finfo(dtype).max)
        assert float(ratio.max()) == pytest.approx(
            wanted, rel=4 * torch.finfo(dtype).eps
        )
        assert ratio.isfinite().all()
        assert own.unique().tolist() == [1.0]


# Cells


def test_cells_of_no_pixel():
    frames = Frames.whole(texture(2, dtype=torch.float32))
    for width in (0.0, 1e-300, 1e-13, 1e-9, 3e-5):
        readings = Reader(PanelShape(3, 3), 4).read(
            frames, square_panel(20.25, 11.75, width)
        )
        assert readings.patches.unique().numel() == 1
        assert (readings.features - torch.tensor([1.0, 0.0, 1.0])).abs().max() < 1e-6
        assert readings.greys.centre.unique().numel() == 1


# Frames


def test_grey_values_that_are_none():
    reader, panels = Reader(PanelShape(4, 4), 4), square_panel(8, 8, 16)
    grey = texture(6, dtype=torch.float32)
    for value in (NAN, INF, -INF, -50.0, -1e-3, 2e9, 1e30, 3e38):
        broken = grey.clone()
        broken[0, 0, 14, 15] = value
        frames = Frames.whole(broken)
        with pytest.raises(
            VoccError,
            match=r"^frames.grey at a panel holds .*: grey values must be finite, 0 to",
        ):
            reader.read(frames, panels)
        with pytest.raises(VoccError, match=r"^frames.grey at a panel holds"):
            reader.read(frames, panels, GREYS)
        elsewhere = grey.clone()
        elsewhere[0, 0, 39, 0] = value
        same = reader.read(Frames.whole(elsewhere), panels).features
        assert torch.equal(same, reader.read(Frames.whole(grey), panels).features)


# Decision


class Fixed(nn.Module):
    """A classifier of one feature that gives the scores it was made with."""

    n_features = 1

    def __init__(self, scores):
        super().__init__()
        self.scores = scores

    def decision_function(self, features):
        return self.scores.expand(features.shape[:-1])


def test_a_score_equal_to_the_threshold():
    scores = torch.tensor([[-5e-324, -0.0], [0.0, 5e-324]], dtype=torch.float64)
    receiver = Receiver(
        "flda_agr", PaperLocator(), Reader(PanelShape(2, 2), 4), Fixed(scores)
    )
    frames = Frames.whole(texture(9).expand(2, 1, 40, 40))
    found = square_panel(8, 8, 16)
    corners = torch.cat([found.corners_px, torch.zeros(1, 4, 2)])
    ones = torch.ones(2, dtype=torch.float64)
    decoded = receiver(
        frames, Panels(corners, torch.tensor([True, False]), ones, ones.long())
    )
    assert decoded.bits[0].tolist() == [[False, True], [True, True]]
    assert not decoded.bits[1].any()
    assert not decoded.scores[1].any()
