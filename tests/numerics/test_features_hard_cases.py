"""Hard cases of features and decision: black, saturated and tiny panels, and values that decide nothing."""

import math

import numpy as np
import pytest
import torch
from scipy import ndimage
from torch import nn

from vocc_torch.errors import VoccError
from vocc_torch.receiver.features import (
    average_greyscale_ratio,
    cell_means,
    gradient_radial_inwardness,
    greyscale_scores,
    neighbour_greyscale_ratio,
    preamble_threshold,
    radial_inward_field,
)
from vocc_torch.receiver.locators import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.receiver.resample import centre_greys
from vocc_torch.types import Frames, Panels, PanelShape

CPU = torch.device("cpu")
NAN, INF = math.nan, math.inf
NO_GRI = "patches or cell sizes give a GRI that is not finite: both must be finite"
NO_LEVEL = "preambles hold grey values that are not finite: each must be finite"
NO_SCORE = (
    "grey values or thresholds give a score that is not finite: both must be finite"
)


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


def gri(patches, shape, cell_px, kernel="sobel"):
    size = torch.full((len(patches),), float(cell_px), dtype=torch.float64)
    return gradient_radial_inwardness(patches, shape, size, size, kernel)


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
    for ratio in (average_greyscale_ratio, neighbour_greyscale_ratio):
        assert ratio(means).unique().tolist() == [1.0]


def test_a_panel_all_but_black():
    for dtype, grey in (
        (torch.float32, 1e-30),
        (torch.float32, 1e-40),
        (torch.float64, 1e-300),
        (torch.float16, 1e-4),
    ):
        means = torch.full((1, 4, 4), 255.0, dtype=dtype)
        means[0, 1:3, 1:3] = grey
        ratio = neighbour_greyscale_ratio(means)
        exact = (5 * 255 + 3 * float(means[0, 1, 1])) / 8 / float(means[0, 1, 1])
        wanted = min(exact, torch.finfo(dtype).max)
        assert float(ratio.max()) == pytest.approx(
            wanted, rel=4 * torch.finfo(dtype).eps
        )
        assert ratio.isfinite().all()
        assert average_greyscale_ratio(means).unique().tolist() == [1.0]


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


def test_cells_far_smaller_than_a_pixel():
    image, rows, columns, samples = texture(3), 2, 3, 4
    for cell_px in (1.0, 0.3, 0.02, 1e-3):
        panels = square_panel(17.4, 12.2, columns * cell_px, rows * cell_px)
        left, top = panels.corners_px[0, 0].tolist()
        x = left + ((np.arange((columns + 2) * samples) + 0.5) / samples - 1) * cell_px
        y = top + ((np.arange((rows + 2) * samples) + 0.5) / samples - 1) * cell_px
        grid = np.meshgrid(y - 0.5, x - 0.5, indexing="ij")
        patch = ndimage.map_coordinates(image[0, 0].numpy(), grid, order=1)
        means = patch.reshape(rows + 2, samples, columns + 2, samples).mean((1, 3))
        inner = means[1:-1, 1:-1]
        ring = ndimage.convolve(means, np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]]) / 8)[
            1:-1, 1:-1
        ]
        slope = [
            ndimage.sobel(patch, axis)[samples:-samples, samples:-samples] / 8
            for axis in (1, 0)
        ]
        steps = (np.arange(samples) + 0.5) / samples - 0.5
        away = [
            np.tile(np.outer(*pair), (rows, columns))
            for pair in ((steps**0, steps), (steps, steps**0))
        ]
        inward = (
            -(slope[0] * away[0] + slope[1] * away[1])
            / np.hypot(*away)
            * samples
            / cell_px
        )
        wanted = [
            inner / inner.mean(),
            inward.reshape(rows, samples, columns, samples).mean((1, 3)),
            ring / inner.mean(),
        ]
        features = (
            Reader(PanelShape(rows, columns), samples)
            .read(Frames.whole(image), panels)
            .features
        )
        np.testing.assert_allclose(
            features[0],
            np.stack(wanted, 2),
            rtol=0,
            atol=1e-12 * 255 * samples / cell_px,
        )


def test_the_centre_samples_vector():
    for samples in range(1, 10):
        field = radial_inward_field(samples, torch.float64, CPU)
        length = torch.linalg.vector_norm(field, dim=0)
        middle = torch.zeros(samples, samples, dtype=torch.bool)
        if samples % 2:
            middle[samples // 2, samples // 2] = True
        assert not length[middle].any()
        assert (length[~middle] - 1).abs().max() < 1e-12 if samples > 1 else True
        assert field.sum((1, 2)).abs().max() < 1e-12, "a slope adds up to nothing"
    patches = texture(4, (4, 5))
    for kernel in ("sobel", "central"):
        assert gri(patches, PanelShape(2, 3), 3.0, kernel).tolist() == [[[0.0] * 3] * 2]
        bump = torch.zeros(1, 1, 9, 9)
        bump[..., 4, 4] = 8.0
        assert float(gri(bump, PanelShape(1, 1), 3.0, kernel)) > 0, (
            "its neighbours see the centre"
        )


def test_a_saturated_plateau():
    for level in (1, 77, 254, 255):
        frames = Frames.whole(torch.full((1, 60, 60), level, dtype=torch.uint8))
        for samples, turn_deg, width in (
            (2, 0, 20),
            (3, 17, 7.3),
            (8, 45, 31.7),
            (64, 30, 3.0),
            (2, 10, 50),
        ):
            for kernel in ("sobel", "central"):
                reader = Reader(PanelShape(3, 5), samples, kernel)
                panels = square_panel(
                    30 - width / 2, 30 - width / 2, width, turn_deg=turn_deg
                )
                features = reader.read(frames, panels).features
                assert not features[..., 1].any()
                assert (features[..., [0, 2]] - 1).abs().max() < 1e-6


# Frames


def test_grey_values_that_are_none():
    reader, panels = Reader(PanelShape(4, 4), 4), square_panel(8, 8, 16)
    grey = texture(6, dtype=torch.float32)
    for value in (NAN, INF, -INF, -50.0, -1e-3, 2e9, 1e30, 3e38):
        broken = grey.clone()
        broken[0, 0, 14, 15] = value
        frames = Frames.whole(broken)
        for read in (reader.read, reader.read_greys):
            with pytest.raises(
                VoccError,
                match=r"^frames.grey at a panel holds .*: grey values must be finite, 0 to",
            ):
                read(frames, panels)
        with pytest.raises(VoccError, match=r"^frames.grey at a panel holds"):
            reader.read_takes([Frames.whole(grey), frames], panels)
        elsewhere = grey.clone()
        elsewhere[0, 0, 39, 0] = value
        same = reader.read(Frames.whole(elsewhere), panels).features
        assert torch.equal(same, reader.read(Frames.whole(grey), panels).features)


def test_means_that_are_no_grey_values():
    shape = PanelShape(2, 2)
    for value in (NAN, INF, -INF, -7.0, 3e38):
        means, patches = torch.full((2, 4, 4), 5.0), torch.full((1, 1, 16, 16), 5.0)
        means[1, 2, 1], patches[..., 5, 6] = value, value
        for ratio in (average_greyscale_ratio, neighbour_greyscale_ratio):
            with pytest.raises(
                VoccError, match=r"^means holds .*: grey values must be finite"
            ):
                ratio(means)
        if value != -7.0:
            with pytest.raises(
                VoccError, match=r"^cell means holds .*: grey values must be finite"
            ):
                cell_means(patches, shape)
        if not math.isfinite(value):
            with pytest.raises(VoccError, match=f"^{NO_GRI}$"):
                gri(patches, shape, 3.0)
        with pytest.raises(VoccError, match=r"^frames.grey at the LEDs' centres holds"):
            centre_greys(
                Frames.whole(torch.full((1, 9, 9), value)), square_panel(1, 1, 5), shape
            )
    with pytest.raises(VoccError, match=f"^{NO_GRI}$"):
        gri(torch.rand(1, 1, 16, 16), shape, NAN)


def test_frames_of_half_precision():
    reader = Reader(PanelShape(4, 4), 4)
    panels = square_panel(231.3, 107.6, 26.0, turn_deg=20.0)
    for dtype in (torch.float16, torch.bfloat16):
        grey = texture(7, (160, 300)).to(dtype)
        half = reader.read(Frames.whole(grey), panels)
        single = reader.read(Frames.whole(grey.float()), panels)
        for ours, theirs in (
            (half.features, single.features),
            (half.greys.average, single.greys.average),
            (half.greys.centre, single.greys.centre),
        ):
            assert torch.equal(ours, theirs)


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


def test_preambles_equal_to_one_another():
    levels = torch.tensor([0.0, 100.1, 1 / 3, 254.99, 1e-30, 255.0, 77.7, 1e8]).view(
        -1, 1, 1
    )
    for rows, columns in ((1, 1), (7, 9), (3, 11), (64, 63)):
        greys = levels.expand(-1, rows, columns)
        threshold = preamble_threshold(greys, greys)
        assert torch.equal(threshold, levels.double())
        assert not greyscale_scores(greys, threshold).any()
        assert greyscale_scores(greys, levels).dtype == torch.float64
        darker = torch.nextafter(greys, torch.tensor(-1.0))
        assert (greyscale_scores(darker, threshold) < 0).all()


def test_a_preamble_that_is_nan():
    good = torch.full((2, 3, 3), 90.0)
    for value in (NAN, INF, -INF):
        broken = good.clone()
        broken[1, 2, 0] = value
        for on, off in ((broken, good), (good, broken), (broken, broken)):
            with pytest.raises(VoccError, match=f"^{NO_LEVEL}$"):
                preamble_threshold(on, off)
        with pytest.raises(VoccError, match=f"^{NO_SCORE}$"):
            greyscale_scores(broken, preamble_threshold(good, good))
    assert torch.equal(
        preamble_threshold(good[:0], good[:0]),
        torch.empty(0, 1, 1, dtype=torch.float64),
    )


def test_pictures_that_no_receiver_reads():
    scores = torch.ones(8, 8, dtype=torch.float64)
    receiver = Receiver("flda_agr", PaperLocator(), Reader(), Fixed(scores))
    byte = torch.zeros(2, 1, 5, 6, dtype=torch.uint8)
    for images in (
        byte.float(),
        byte.short(),
        byte.bool(),
        byte.expand(2, 3, 5, 6),
        byte[0, :, :, :3],
        byte[..., :0],
    ):
        with pytest.raises(
            VoccError,
            match=r"images has dtype .* and shape .*: it must be uint8 of shape",
        ):
            receiver.decode(images)
    for images in (byte, byte[..., :1, :1] + 9, byte[..., :1] + 255, byte[:0]):
        decoded = receiver.decode(images) if len(images) else None
        if decoded is not None:
            assert not decoded.found.any()
            assert not decoded.bits.any()
            assert not decoded.scores.any()
