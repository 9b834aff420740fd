"""Hard cases of location: frames in which there is nothing to find, or too much, and corners of no panel."""

from functools import lru_cache

import numpy as np
import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.receiver.locators import PaperLocator, RefinedLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.resample import cell_homography, centre_greys, rectify
from vocc_torch.types import Frames, Panels, PanelShape

SHAPE = PanelShape(8, 8)
PAPER, REFINED = PaperLocator(), RefinedLocator()
ANYTHING = PaperLocator(min_area_px=1, min_rectangularity=0.0, min_compactness=0.0)
# Corners of the panel in `scene`, its pitch 5 px.
TRUTH = torch.tensor(
    [[60.0, 60.0], [100.0, 60.0], [100.0, 100.0], [60.0, 100.0]], dtype=torch.float64
)
ALL_ON = np.ones((8, 8), bool)
ALL_OFF = ~ALL_ON
ONE_ON = ALL_OFF.copy()
ONE_ON[3, 4] = True
ROWS_OFF = ALL_ON.copy()
ROWS_OFF[[0, -1]] = False


def scene(
    bits=None,
    *,
    on=0.6,
    off=0.1,
    pitch=5.0,
    centre=(80.0, 80.0),
    angle_deg=0.0,
    size=(160, 160),
):
    """Spots of Gaussian light in a grey frame, of a camera with a gamma of 2.2."""
    if bits is None:
        bits = np.random.default_rng(5).random((8, 8)) < 0.5
    y, x = (np.arange(length) + 0.5 for length in size)
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    light = np.full(size, 0.12)
    for row, column in np.ndindex(8, 8):
        right, down = (column - 3.5) * pitch, (row - 3.5) * pitch
        left = (x - centre[0] - cosine * right + sine * down) / (0.33 * pitch)
        top = (y - centre[1] - sine * right - cosine * down) / (0.33 * pitch)
        light += (on if bits[row, column] else off) * np.outer(
            np.exp(-(top**2) / 2), np.exp(-(left**2) / 2)
        )
    return np.rint(255 * np.clip(light, 0, 1) ** (1 / 2.2)).astype(np.uint8)


def block(top, left, height, width, *, size=(120, 160), dark=0, bright=255):
    """A bright rectangle on a dark frame, or the other way round."""
    grey = np.full(size, dark, np.uint8)
    grey[top : top + height, left : left + width] = bright
    return grey


def whole(*greys):
    return Frames.whole(torch.from_numpy(np.stack(greys)))


def assert_same(ours, theirs):
    for name in Panels.__slots__:
        assert torch.equal(getattr(ours, name), getattr(theirs, name)), name


def located(locator, frames, shape=SHAPE):
    """Locate twice, and demand what holds of every answer: finite, in order, in range, the same again."""
    panels, again = locator(frames, shape), locator(frames, shape)
    assert torch.equal(again.found, panels.found)
    assert torch.equal(again.candidates, panels.candidates)
    assert off_px(again, panels.corners_px) < 2e-3
    assert panels.corners_px.isfinite().all()
    assert panels.corners_px.dtype == panels.score.dtype == torch.float64
    assert ((panels.score >= 0) & (panels.score <= 1)).all()
    nowhere = ~panels.found
    for value in (panels.corners_px, panels.score, panels.candidates):
        assert not value[nowhere].any()
    assert (panels.score[panels.found] > 0).all()
    assert (panels.candidates[panels.found] >= 1).all()
    side = panels.corners_px[panels.found].roll(-1, 1) - panels.corners_px[panels.found]
    turn = (
        side[..., 0] * side.roll(-1, 1)[..., 1]
        - side[..., 1] * side.roll(-1, 1)[..., 0]
    )
    assert (turn > 0).all(), "clockwise as seen on the image"
    return panels


def off_px(panels, truth):
    return (
        float((panels.corners_px - truth).norm(dim=-1).amax())
        if len(panels.found)
        else 0.0
    )


# What there is to see


def test_a_constant_frame():
    frames = whole(
        *(np.full((120, 160), value, np.uint8) for value in (0, 1, 128, 254, 255))
    )
    for locator in (PAPER, ANYTHING, REFINED, RefinedLocator(ANYTHING, 0.0)):
        assert not located(locator, frames).found.any()


def test_every_led_on():
    for locator, clipped_px in ((PAPER, 4.5), (REFINED, 1.0)):
        assert off_px(located(locator, whole(scene(ALL_ON))), TRUTH) < 0.1
        for on in (20.0, 50.0):
            clipped = whole(scene(ALL_ON, on=on))
            assert off_px(located(locator, clipped), TRUTH) < clipped_px


def test_one_led_on():
    for locator in (PAPER, REFINED):
        for pitch in (5.0, 20.0):
            assert not located(
                locator, whole(scene(ONE_ON, off=0.0, pitch=pitch))
            ).found.any()
        assert off_px(located(locator, whole(scene(ONE_ON))), TRUTH) < 0.1


# Frames of few pixels


def test_a_frame_of_few_pixels():
    rng = np.random.default_rng(0)
    for size in ((1, 1), (1, 2), (200, 1), (9, 11)):
        frames = whole(
            rng.integers(0, 256, size, dtype=np.uint8), np.full(size, 255, np.uint8)
        )
        for locator in (PAPER, REFINED):
            assert not located(locator, frames).found.any()
        for locator in (ANYTHING, RefinedLocator(ANYTHING, 0.0)):
            panels = located(locator, frames, PanelShape(1, 1))
            assert panels.found.tolist() == [frames.grey[0].unique().numel() > 1, False]


def test_frames_without_a_pixel():
    for size in (
        (2, 1, 0, 5),
        (2, 1, 5, 0),
        (1, 1, 0, 0),
        (0, 1, 40, 50),
        (0, 1, 0, 0),
    ):
        for locator in (PAPER, REFINED):
            panels = located(
                locator, Frames.whole(torch.zeros(size, dtype=torch.uint8))
            )
            assert panels.found.tolist() == [False] * size[0]
            assert panels.corners_px.shape == (size[0], 4, 2)


# Settings, batches and memory layouts


def test_a_crop_against_the_whole_frame():
    level = int(scene(ALL_OFF, off=0.0)[0, 0])
    crops = [
        scene(),
        scene(ONE_ON),
        scene(ONE_ON, off=0.0),
        scene(ROWS_OFF),
        scene(ALL_OFF, off=0.0),
        block(0, 0, 160, 160, size=(160, 160), bright=3),
    ]
    for grey in crops:
        sensor = np.full((480, 640), level, np.uint8)
        sensor[200:360, 300:460] = grey
        planes = torch.from_numpy(grey)[None, None]
        crop = Frames(
            planes, torch.tensor([[300, 200]]), (480, 640), torch.tensor([float(level)])
        )
        assert_same(located(PAPER, crop), located(PAPER, whole(sensor)))
        one, two = located(REFINED, crop), located(REFINED, whole(sensor))
        assert torch.equal(one.found, two.found)
        assert off_px(one, two.corners_px) < 0.05


def test_frames_that_hold_no_grey_values():
    grey = torch.from_numpy(scene()).float()
    for locator in (PAPER, REFINED):
        for value in (float("nan"), float("inf"), -float("inf")):
            broken = grey.clone()
            broken[3, 4] = value
            with pytest.raises(
                VoccError,
                match=r"frames.grey holds NaN or infinity: it must be grey values",
            ):
                locator(Frames.whole(broken[None]), SHAPE)
        for dtype in (torch.int16, torch.int64, torch.bool):
            with pytest.raises(
                VoccError,
                match=r"frames.grey is torch\.\w+: it must be torch.uint8 or floating",
            ):
                locator(Frames.whole(grey[None].to(dtype)), SHAPE)
        origin = torch.zeros(1, 2, dtype=torch.int64)
        with pytest.raises(
            VoccError,
            match=r"frames.grey has shape \(1, 3, 160, 160\): it must be \(B,1,H,W\)",
        ):
            locator(
                Frames(grey.byte().expand(1, 3, 160, 160), origin, (160, 160)), SHAPE
            )
        bright = torch.where(grey > 128, 1e30, grey)
        bright[0, 0] = -1e30
        clipped = Frames.whole(bright.clamp(0, 255)[None])
        for dtype in (torch.float32, torch.float64):
            assert_same(
                locator(Frames.whole(bright[None].to(dtype)), SHAPE),
                locator(clipped, SHAPE),
            )
        exact = locator(Frames.whole(grey[None].byte()), SHAPE)
        for dtype in (torch.float16, torch.bfloat16):
            assert_same(locator(Frames.whole(grey[None].to(dtype)), SHAPE), exact)


# Corners


FLAT = {
    "coincident": [(20, 20)] * 4,
    "two coincident": [(8, 8), (8, 8), (32, 32), (8, 32)],
    "on a line": [(0, 5), (10, 5), (20, 5), (30, 5)],
    "on a diagonal": [(1, 1), (10, 10), (20, 20), (30, 30)],
    "three on a line": [(8, 8), (20, 8), (32, 8), (8, 32)],
    "the third on the diagonal": [(8, 8), (32, 8), (20, 20), (8, 32)],
    "crossed": [(8, 8), (32, 32), (32, 8), (8, 32)],
    "crossed unevenly": [(8, 8), (32, 8), (8, 32), (36, 30)],
    "concave": [(8, 8), (32, 8), (15, 15), (8, 32)],
    "zero": [(0, 0)] * 4,
}


@lru_cache
def picture():
    return torch.from_numpy(
        np.random.default_rng(1).integers(20, 231, (40, 40), dtype=np.uint8)
    )


def test_corners_of_no_panel():
    proper = [(8, 8), (32, 8), (32, 32), (8, 32)]
    reader = Reader(PanelShape(2, 3), 4)
    for corners in FLAT.values():
        panels = Panels.known(torch.tensor([proper, corners, proper]).double())
        frames = Frames.whole(picture().expand(3, 40, 40))
        homography = cell_homography(panels.corners_px, reader.shape)
        x, y = corners[0]
        assert homography[1].tolist() == [[0, 0, x], [0, 0, y], [0, 0, 1]]
        readings = reader.read(frames, panels)
        assert readings.patches[1].unique().numel() == 1
        assert (readings.features[1] - torch.tensor([1.0, 0.0, 1.0])).abs().max() < 1e-6
        assert readings.greys.centre[1].unique().tolist() == [float(picture()[y, x])]
        alone = reader.read(frames[:1], Panels.known(panels.corners_px[:1]))
        for row in (0, 2):
            assert torch.equal(readings.features[row], alone.features[0])


def test_corners_that_are_no_places():
    for value in (float("nan"), float("inf"), -float("inf"), 1e200, -2e15):
        corners = torch.tensor(
            [[[8.0, 8], [32, 8], [32, 32], [8, 32]]], dtype=torch.float64
        )
        corners[0, 1, 0] = value
        frames, panels = Frames.whole(picture()[None]), Panels.known(corners)
        for read in (rectify, centre_greys):
            arguments = (
                (frames, panels, SHAPE, 4)
                if read is rectify
                else (frames, panels, SHAPE)
            )
            with pytest.raises(
                VoccError, match=r"corners_px reaches \S+ px: corners must be finite"
            ):
                read(*arguments)
        with pytest.raises(VoccError, match=r"corners_px reaches"):
            Reader(SHAPE).read(frames, panels)
