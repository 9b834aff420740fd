"""Compiled loops say what is said without them, to the last bit, and what OpenCV and SciPy say."""

from dataclasses import asdict

import cv2
import numpy as np
import pytest
import scipy.ndimage
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from vocc_torch import Frames, PanelShape
from vocc_torch.receiver import compiled, loops
from vocc_torch.receiver.components import close_mask
from vocc_torch.receiver.limits import LocatorLimits
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.receiver.rectification import rectify
from vocc_torch.types import Panels

SHAPE = PanelShape(8, 8)


def frame_of(seed: int) -> NDArray[np.uint8]:
    """A frame of one grey value with a panel, here and there turned, dim, cut, or beside a lamp or a blob."""
    rng = np.random.default_rng(seed)
    ground, light = int(rng.integers(0, 120)), int(rng.integers(30, 256))
    frame = np.full((160, 416), ground, np.uint8)
    pitch, on = int(rng.integers(2, 12)), rng.random((8, 8)) < rng.choice([0.2, 0.5, 0.9])
    led = np.zeros((pitch, pitch), np.uint8)
    led[: max(1, pitch - int(rng.integers(0, 4))), : max(1, pitch - int(rng.integers(0, 4)))] = 1
    panel = np.kron(on, led) * light
    if rng.random() < 0.2:
        panel = scipy.ndimage.rotate(panel.astype(np.uint8), rng.uniform(-45, 45), order=1)
    y, x = rng.integers(0, 160 - min(panel.shape[0], 159)), rng.integers(0, 416 - panel.shape[1])
    part = frame[y : y + panel.shape[0], x : x + panel.shape[1]]
    part[...] = np.maximum(part, panel[: part.shape[0]])
    for _ in range(rng.integers(0, 3)):
        a, b = rng.integers(0, 150), rng.integers(max(0, x - 60), min(400, x + 60))
        frame[a : a + rng.integers(1, 12), b : b + rng.integers(1, 12)] = rng.integers(0, 256)
    return scipy.ndimage.gaussian_filter(frame, 0.8) if seed % 2 else frame


@pytest.mark.parametrize(
    "limits", [LocatorLimits(), LocatorLimits(closing_px=7, min_area_px=400, quadrilateral="upright")]
)
def test_panels_are_the_same_to_the_last_bit(limits: LocatorLimits, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = [Frames.whole(torch.from_numpy(frame_of(seed))) for seed in range(60)]
    locate = PaperLocator(**asdict(limits))
    taken = [compiled.measure_alone(frame, SHAPE, limits, 1 << 15) is not None for frame in frames]
    assert sum(taken) > len(taken) / 5
    looped = [locate(frame, SHAPE) for frame in frames]
    monkeypatch.setattr(compiled, "_loops", lambda: None)
    for frame, one in zip(frames, looped, strict=True):
        other = locate(frame, SHAPE)
        for name in ("corners_px", "found", "score", "candidates"):
            assert torch.equal(getattr(one, name), getattr(other, name)), name


def test_threshold_and_box_are_opencvs() -> None:
    compared = 0
    for seed in range(80):
        plane = frame_of(seed)
        limit, *box = loops.lit_box(plane, plane.view(np.uint64))
        if any(box):  # what is refused goes the other way
            theirs, mask = cv2.threshold(plane, 0, 1, cv2.THRESH_OTSU)
            assert limit == theirs
            assert tuple(box) == cv2.boundingRect(mask)
            compared += 1
    assert compared > 40


@given(seed=st.integers(0, 10_000))
@settings(max_examples=60, deadline=None)
def test_a_blob_is_measured_as_by_opencv_and_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mask = np.kron(rng.random((8, 8)) < 0.4, np.ones((3, 3))).astype(bool)
    mask[0, 0] = True
    closed = close_mask(torch.from_numpy(mask)[None, None], 7)[0, 0].numpy()
    area_px, area, perimeter, *ends = loops.upright_blob(mask, closed)
    if scipy.ndimage.label(closed, np.ones((3, 3)))[1] > 1:
        assert area_px == 0
        return
    hull = cv2.convexHull(np.argwhere(mask)[:, ::-1].astype(np.int32))
    (_, sides, _), (left, top, wide, high) = cv2.minAreaRect(hull), cv2.boundingRect(hull)
    if not area_px:
        assert np.prod(sides) < (wide - 1) * (high - 1)
        return
    assert area_px == closed.sum()
    assert ends == [left, top, left + wide - 1, top + high - 1]
    # A pixel is a unit square, which adds the extents and 1 to the area and 4 to the perimeter.
    assert area == cv2.contourArea(hull) + wide + high - 1
    assert perimeter == pytest.approx(cv2.arcLength(hull, True) + 4, rel=1e-6)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_a_panel_is_read_as_without_loops_and_by_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    frame = Frames.whole(torch.from_numpy(rng.integers(0, 256, (60, 70), dtype=np.uint8)))
    x, y, side = (float(one) for one in rng.uniform((-9, -9, 12), (40, 40, 50)))
    corners = torch.tensor([[[x, y], [x + side, y], [x + side, y + side], [x, y + side]]]).double()
    read = rectify(frame, Panels.known(corners), SHAPE, 8)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "_loops", lambda: None)
        assert torch.equal(read, rectify(frame, Panels.known(corners), SHAPE, 8))
    places = (np.arange(80) + 0.5) / 8 - 1
    rows, columns = np.meshgrid(y + places * side / 8 - 0.5, x + places * side / 8 - 0.5, indexing="ij")
    theirs = scipy.ndimage.map_coordinates(
        frame.grey[0, 0].double().numpy(), [rows, columns], order=1, mode="nearest"
    )
    np.testing.assert_allclose(read[0, 0].numpy(), theirs, atol=0.02)


def test_noise_and_colourful_ground_are_left_to_the_other_way() -> None:
    noise = np.random.default_rng(0).integers(0, 256, (256, 512), dtype=np.uint8)
    assert loops.lit_box(noise, noise.view(np.uint64))[1:] == (0, 0, 0, 0)
    dark = np.full((256, 512), 200, np.uint8)
    dark[100:120, 100:120] = 10  # the ground is what is bright
    assert loops.lit_box(dark, dark.view(np.uint64))[1:] == (0, 0, 0, 0)
