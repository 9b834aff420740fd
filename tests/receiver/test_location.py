import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.receiver.components import close_mask
from vocc_torch.receiver.foreground import sensor_threshold
from vocc_torch.receiver.locators import paper
from vocc_torch.receiver.locators.paper import PaperLocator
from vocc_torch.types import Frames, PanelShape

SHAPE = PanelShape(8, 8)
BACKGROUND, OFF = 0.18, 0.4


def random_bits(rng, rows=8, columns=8):
    """Random bits with every corner LED On, so that the panel's extent shows."""
    bits = rng.random((rows, columns)) < 0.5
    bits[[0, 0, -1, -1], [0, -1, 0, -1]] = True
    return bits


def render(bits, pitch, size, centre, *, on=8.0, off=OFF, diameter=0.5, angle_deg=0.0):
    """Linear light of a panel of discs, four times oversampled, without blur."""
    scale, (rows, columns) = 4, bits.shape
    light = np.full((size[0] * scale, size[1] * scale), BACKGROUND, np.float32)
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    for r in range(rows):
        for k in range(columns):
            x, y = (k - (columns - 1) / 2) * pitch, (r - (rows - 1) / 2) * pitch
            where = (
                (centre[0] + c * x - s * y) * scale - 0.5,
                (centre[1] + s * x + c * y) * scale - 0.5,
            )
            point = tuple(round(v * 16) for v in where)
            cv2.circle(
                light,
                point,
                round(pitch * diameter / 2 * scale * 16),
                on if bits[r, k] else off,
                -1,
                8,
                4,
            )
    return cv2.resize(light, size[::-1], interpolation=cv2.INTER_AREA)


def grey_of(light):
    blurred = cv2.GaussianBlur(light, (0, 0), 1.5)
    return np.clip(np.rint(100 * (blurred / BACKGROUND) ** (1 / 2.2)), 0, 255).astype(
        np.uint8
    )


def panel_frame(seed, pitch, size=84, **how):
    rng = np.random.default_rng(seed)
    return grey_of(
        render(random_bits(rng), pitch, (size, size), (size / 2, size / 2), **how)
    )


def true_corners(pitch, centre, angle_deg=0.0):
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    square = 4 * pitch * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return square @ np.array([[c, s], [-s, c]]) + centre


def whole(*grey):
    return Frames.whole(torch.from_numpy(np.stack(grey)))


def levels_run(monkeypatch):
    """Note each level that is run."""
    levels: list[int] = []
    collect = paper.components.collect_blobs

    def spy(*args, min_area_px, level):
        levels.append(level)
        return collect(*args, min_area_px=min_area_px, level=level)

    monkeypatch.setattr(paper.components, "collect_blobs", spy)
    return levels


@pytest.mark.parametrize("quadrilateral", ["min_area", "upright"])
def test_panels_at_30_to_70_m_are_found_at_the_first_level(quadrilateral, monkeypatch):
    levels = levels_run(monkeypatch)
    rng = np.random.default_rng(1)
    pitches, centres, grey = rng.uniform(3.1, 7.2, 40), rng.uniform(41, 43, (40, 2)), []
    for pitch, centre in zip(pitches, centres, strict=True):
        grey.append(
            grey_of(
                render(
                    random_bits(rng),
                    pitch,
                    (84, 84),
                    tuple(centre),
                    on=OFF + rng.uniform(2, 16),
                )
            )
        )
    panels = PaperLocator(quadrilateral=quadrilateral)(whole(*grey), SHAPE)
    truth = np.stack(
        [true_corners(p, tuple(c)) for p, c in zip(pitches, centres, strict=True)]
    )
    error = np.linalg.norm(panels.corners_px.numpy() - truth, axis=2)
    assert panels.found.all()
    assert panels.candidates.tolist() == [1] * 40
    assert ((panels.score > 0) & (panels.score <= 1)).all()
    assert error.max() < 3.0
    assert error.mean() < 1.5
    # Single blobs never come to the ladder; now and then a corner LED is on its own beyond the closing.
    assert len(levels) - levels.count(0) <= 4


@pytest.mark.parametrize("channel", ["luminance", "brightest"])
def test_the_photo_is_found_higher_up(channel, monkeypatch):
    levels = levels_run(monkeypatch)
    photo = cv2.imread(
        str(Path(__file__).parents[1] / "data" / "led-panel-8x8-photo.png")
    )
    grey = (
        cv2.cvtColor(photo, cv2.COLOR_BGR2GRAY)
        if channel == "luminance"
        else photo.max(2)
    )
    panels = PaperLocator(quadrilateral="upright")(whole(grey), SHAPE)
    # LED centres read by eye: columns 28 to 335 px, rows 18 to 325 px; half a pitch of 43.9 px outside them.
    expected = np.array([[6, -4], [357, -4], [357, 347], [6, 347]])
    assert panels.candidates.tolist() == [1]
    assert max(levels) == 3
    np.testing.assert_allclose(panels.corners_px[0], expected, atol=0.2 * 43.9)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("closing_px", 4),
        ("closing_px", -1),
        ("min_area_px", 0),
        ("min_area_px", math.nan),
        ("min_area_px", 10**30),
        ("min_rectangularity", 1.1),
        ("min_compactness", -0.1),
        ("min_compactness", math.nan),
        ("quadrilateral", "round"),
    ],
)
def test_parameters_out_of_range_are_refused_by_name(name, value):
    with pytest.raises(VoccError, match=f"location.{name} is "):
        PaperLocator(**{name: value})


def test_threshold_mask_and_closing_equal_opencvs():
    grey = panel_frame(9, 6.0)
    found = sensor_threshold(whole(grey)).item()
    ours = torch.from_numpy(grey > found)
    threshold, mask = cv2.threshold(grey, 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    closed = cv2.morphologyEx(
        np.pad(mask, 11), cv2.MORPH_CLOSE, np.ones((11, 11), np.uint8)
    )[11:-11, 11:-11]
    assert found == threshold
    np.testing.assert_array_equal(ours, mask.astype(bool))
    np.testing.assert_array_equal(close_mask(ours[None, None], 11)[0, 0], closed > 0)
