"""Hard cases of location: frames in which there is nothing to find, or too much, and corners of no panel."""

from dataclasses import fields, replace
from functools import lru_cache

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from vocc_torch.errors import VoccError
from vocc_torch.receiver.components import close_mask
from vocc_torch.receiver.lattice_fit import fit_lattice
from vocc_torch.receiver.lattice_model import Lattice, search_lattice
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


def noise(seed, size=(120, 160)):
    return np.random.default_rng(seed).integers(0, 256, size, dtype=np.uint8)


def whole(*greys):
    return Frames.whole(torch.from_numpy(np.stack(greys)))


def assert_same(ours, theirs):
    for name in Panels.__slots__:
        assert torch.equal(getattr(ours, name), getattr(theirs, name)), name


def rows_of(panels, rows):
    return Panels(*(getattr(panels, name)[rows] for name in Panels.__slots__))


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


def test_two_grey_values():
    square = torch.tensor([[70.0, 30.0], [110.0, 30.0], [110.0, 70.0], [70.0, 70.0]])
    for dark, bright in ((0, 1), (0, 255), (254, 255), (7, 9), (100, 180)):
        for locator in (PAPER, RefinedLocator(PAPER, 1.0))[
            : 2 if bright - dark < 3 else 1
        ]:
            panels = located(
                locator, whole(block(30, 70, 40, 40, dark=dark, bright=bright))
            )
            assert torch.equal(panels.corners_px[0], square.double())
            assert panels.score.tolist() == [1.0]


def test_every_led_on():
    for locator, clipped_px in ((PAPER, 4.5), (REFINED, 1.0)):
        assert off_px(located(locator, whole(scene(ALL_ON))), TRUTH) < 0.1
        assert (
            off_px(located(locator, whole(scene(ALL_ON, on=50.0))), TRUTH) < clipped_px
        )


def test_one_led_on():
    for locator in (PAPER, REFINED):
        for pitch in (5.0, 20.0):
            assert not located(
                locator, whole(scene(ONE_ON, off=0.0, pitch=pitch))
            ).found.any()
        assert off_px(located(locator, whole(scene(ONE_ON))), TRUTH) < 0.1


def test_whole_edge_rows_off():
    frames = whole(scene(ROWS_OFF))
    (shining,) = located(PAPER, frames).corners_px
    assert torch.equal(
        shining, torch.tensor([[60.0, 64], [100, 64], [100, 96], [60, 96]]).double()
    )
    three = ROWS_OFF.copy()
    three[1] = False
    for bits in (ROWS_OFF, three, ROWS_OFF.T, three.T, three[::-1], three.T[:, ::-1]):
        assert off_px(located(REFINED, whole(scene(bits))), TRUTH) < 0.1


def test_a_component_at_the_border():
    for top, left in ((0, 0), (0, 60), (80, 120), (40, 120), (80, 0)):
        for locator in (PAPER, REFINED)[: 1 if top or left else 2]:
            (corners,) = located(locator, whole(block(top, left, 40, 40))).corners_px
            low, right = top + 40, left + 40
            assert corners.tolist() == [
                [left, top],
                [right, top],
                [right, low],
                [left, low],
            ]
    near = block(3, 4, 40, 40)  # nearer than the closing reaches
    near[100:, 140:] = 255
    panels = located(PAPER, whole(near))
    assert panels.corners_px[0].tolist() == [[4, 3], [44, 3], [44, 43], [4, 43]]
    assert panels.candidates.tolist() == [2], "not joined along the border"
    for locator in (PAPER, REFINED):
        cut = located(locator, whole(scene(ALL_ON, centre=(150.0, 80.0))))
        assert cut.found.all()
        assert (cut.corners_px >= -1).all()
        assert (cut.corners_px <= 161).all()


def test_a_panel_at_45_degrees():
    reach = 20 * 2**0.5
    diamond = torch.tensor(
        [[80, 80 - reach], [80 + reach, 80], [80, 80 + reach], [80 - reach, 80]]
    )
    for seed in range(4):
        bits = np.random.default_rng(seed).random((8, 8)) < 0.5
        bits[[0, 0, -1, -1], [0, -1, 0, -1]] = True
        frames = whole(scene(bits, angle_deg=45.0))
        for locator, most_px in ((PAPER, 1.5), (REFINED, 0.15)):
            assert off_px(located(locator, frames), diamond) < most_px


def test_a_frame_of_noise():
    for grey in (noise(0), np.clip(noise(2), 120, 136), noise(4, (300, 300))):
        for locator in (PAPER, ANYTHING, REFINED, RefinedLocator(ANYTHING, 0.0)):
            panels = located(locator, whole(grey))
            assert (panels.corners_px >= -1).all()
            assert (
                panels.corners_px
                <= torch.tensor([grey.shape[1] + 1, grey.shape[0] + 1])
            ).all()
    sparse = (np.random.default_rng(3).random((160, 200)) < 0.02).astype(np.uint8) * 255
    assert located(REFINED, whole(sparse)).candidates.max() <= 1
    (candidates,) = located(
        replace(ANYTHING, closing_px=1), whole(sparse), PanelShape(1, 1)
    ).candidates
    assert candidates == 256, "what noise can cost has an end"


# Frames of few pixels


def test_a_frame_of_few_pixels():
    rng = np.random.default_rng(0)
    for size in (
        (1, 1),
        (1, 2),
        (2, 1),
        (2, 2),
        (1, 7),
        (200, 1),
        (3, 5),
        (8, 8),
        (9, 11),
    ):
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


def test_a_frame_too_wide():
    wide = np.zeros((2, 40_000), np.uint8)
    wide[:, 1:-1] = 9
    for locator in (PAPER, REFINED):
        with pytest.raises(
            VoccError,
            match=r"frames.grey is 2 x 40000 px: it must be at most 32768 px a side",
        ):
            locator(whole(wide), SHAPE)
    (corners,) = located(
        ANYTHING, whole(wide[:, -32_768:]), PanelShape(1, 1)
    ).corners_px
    assert corners.tolist() == [[0, 0], [32_767, 0], [32_767, 2], [0, 2]]


# Settings, batches and memory layouts


def test_a_closing_larger_than_the_frame():
    for seed, size in enumerate([(12, 17), (1, 9), (9, 1), (16, 16)]):
        mask = np.random.default_rng(seed).random(size) < 0.06
        for side in (15, 17, 19, 41):
            room = np.pad(mask, 2 * side).astype(np.uint8)
            kernel = np.ones((side, side), np.uint8)
            closed = cv2.morphologyEx(room, cv2.MORPH_CLOSE, kernel)
            ours = close_mask(torch.from_numpy(mask)[None, None], side)[0, 0].numpy()
            np.testing.assert_array_equal(
                ours, closed[2 * side : -2 * side, 2 * side : -2 * side].astype(bool)
            )
        most = close_mask(torch.from_numpy(mask)[None, None], 10**30 + 1)[0, 0].numpy()
        np.testing.assert_array_equal(most, ours)
    for locator in (
        PaperLocator(closing_px=65535),
        RefinedLocator(PaperLocator(closing_px=65535)),
    ):
        assert located(locator, whole(scene())).found.all()


def test_frames_that_fail_among_others():
    greys = [
        scene(),
        np.zeros((160, 160), np.uint8),
        noise(0, (160, 160)),
        scene(ONE_ON, off=0),
    ]
    greys += [scene(angle_deg=30.0), scene(ALL_ON, on=50.0), scene(ROWS_OFF)]
    frames = whole(*greys)
    for locator in (PAPER, REFINED):
        together = located(locator, frames)
        assert 0 < int(together.found.sum()) < len(greys)
        for count in (1, 2):
            for start in range(0, len(greys) - 1, count):
                rows = slice(start, start + count)
                ours, all_of_it = locator(frames[rows], SHAPE), rows_of(together, rows)
                if locator is PAPER:
                    assert_same(ours, all_of_it)
                assert torch.equal(ours.found, all_of_it.found)
                assert torch.equal(ours.candidates, all_of_it.candidates)
                assert off_px(ours, all_of_it.corners_px) < 2e-3


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


def test_a_surround_that_is_no_grey_value():
    grey = torch.from_numpy(scene())[None, None]
    for locator in (PAPER, REFINED):
        for level in (float("nan"), float("inf")):
            crop = Frames(
                grey, torch.tensor([[300, 200]]), (480, 640), torch.tensor([level])
            )
            with pytest.raises(
                VoccError, match=r"frames.surround holds NaN or infinity"
            ):
                locator(crop, SHAPE)
        for x, y in ((-1, 0), (0, -1), (481, 0), (0, 321)):
            crop = Frames(
                grey, torch.tensor([[x, y]]), (480, 640), torch.tensor([90.0])
            )
            with pytest.raises(
                VoccError,
                match=r"frames.origin_px lays a crop, \(160, 160\), off its sensor",
            ):
                locator(crop, SHAPE)
        crop = Frames(
            grey, torch.tensor([[480, 320]]), (480, 640), torch.tensor([90.0])
        )
        assert located(locator, crop).found.all()


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


def test_panels_of_any_shape():
    frames = whole(scene(), scene(ALL_ON), noise(0, (160, 160)))
    for rows, columns in (
        (1, 1),
        (1, 16),
        (16, 1),
        (2, 3),
        (17, 3),
        (1, 1024),
        (1024, 1024),
    ):
        shape = PanelShape(rows, columns)
        ours = located(REFINED, frames, shape)
        theirs = located(PAPER, frames, shape)
        if max(rows, columns) > 16:
            assert_same(ours, theirs)


def test_a_picture_without_a_lattice():
    flat = [np.full((160, 160), value, np.uint8) for value in (0, 255)]
    greys = [
        *flat,
        noise(0, (160, 160)),
        block(80, 80, 1, 1, size=(160, 160)),
        scene(ALL_ON, on=1e3),
    ]
    quads = [
        TRUTH,
        TRUTH[[0, 3, 2, 1]],
        TRUTH - 500,
        0 * TRUTH,
        torch.tensor(FLAT["crossed"]).double(),
    ]
    frames = whole(*(grey for grey in greys for _ in quads))
    corners = torch.stack(quads * len(greys))
    for shape in (SHAPE, PanelShape(1, 1), PanelShape(1, 16)):
        for level in (0.0, 255.0):
            background = torch.full((len(corners),), level)
            start, blur = search_lattice(frames, corners, background, shape)
            lattice = fit_lattice(frames, Lattice.at(start, blur, background, shape))
            for field in fields(lattice):
                assert getattr(lattice, field.name).double().isfinite().all(), (
                    field.name
                )
            assert (lattice.share <= 1).all()


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


def test_corners_in_any_order():
    cells = torch.tensor(
        [[0.0, 0, 1], [3, 0, 1], [3, 2, 1], [0, 2, 1]], dtype=torch.float64
    )

    @settings(max_examples=150, deadline=None, derandomize=True)
    @given(st.lists(st.integers(-60, 60), min_size=8, max_size=8))
    def check(numbers):
        corners = torch.tensor(numbers, dtype=torch.float64).view(1, 4, 2)
        homography = cell_homography(corners, PanelShape(2, 3))[0]
        assert homography.isfinite().all()
        places = [tuple(place) for place in corners[0].tolist()]
        if strictly_convex(places):
            mapped = cells @ homography.mT
            assert (mapped[:, :2] / mapped[:, 2:] - corners[0]).abs().max() < 1e-6
        else:
            assert not homography[:, :2].any()

    check()


def strictly_convex(places):
    """OpenCV's hull keeps all four corners, none on a line, and in their order."""
    points = np.float32(places)
    if len(set(places)) < 4:
        return False
    hull = [tuple(point) for point in cv2.convexHull(points)[:, 0].tolist()]
    if len(hull) < 4 or not cv2.isContourConvex(np.int32(points)):
        return False
    corners = [tuple(np.float64(place)) for place in places]
    return all(
        (b[0] - a[0]) * (c[1] - b[1]) != (b[1] - a[1]) * (c[0] - b[0])
        for a, b, c in zip(
            corners, corners[1:] + corners[:1], corners[2:] + corners[:2], strict=True
        )
    )


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


def test_the_horizon_within_the_margin():
    steep = {
        PanelShape(4, 4): [(28, 30), (32, 30), (48, 50), (12, 50)],
        PanelShape(1, 1): [(28, 30), (32, 30), (55, 55), (5, 55)],
        PanelShape(1, 8): [(25, 30), (35, 30), (45, 50), (15, 50)],
    }
    for shape, corners in steep.items():
        for turn in range(4):  # the horizon above, beside and below
            beyond_the_horizon(
                shape, np.rot90(bordered(), turn).copy(), turned(corners, turn)
            )
    # Sides that part so fast that the map divides by 0 at a sample, or between two, below the panel.
    frames = Frames.whole(picture()[None])
    for low_cells in (0.875, 0.75, 0.5, 0.25, 0.125):
        top, low = 2 * low_cells / (8 + low_cells), 2.0
        corners = torch.tensor(
            [[[20 - top, 10], [20 + top, 10], [20 + low, 30], [20 - low, 30]]]
        ).double()
        patches = rectify(frames, Panels.known(corners), SHAPE, 4)
        assert patches.isfinite().all()
        assert 20 <= float(patches.min()) <= float(patches.max()) <= 230
        centres = centre_greys(frames, Panels.known(corners), SHAPE)
        assert 20 <= float(centres.min()) <= float(centres.max()) <= 230


def bordered():
    """A frame that is darker than 200 but on its border, where it is brighter."""
    inner = np.random.default_rng(2).uniform(0, 199, (58, 58))
    return np.pad(inner, 1, constant_values=230.0)


def turned(corners, turn):
    """Corners in a frame of 60 x 60 px that is turned as np.rot90 turns it."""
    for _ in range(turn):
        corners = [(y, 60 - x) for x, y in corners]
    return corners


def beyond_the_horizon(shape, image, corners, samples=32):
    """Compare a panel with SciPy's reading of it, alone, in a batch and in a crop."""
    cells = [(0, 0), (shape.columns, 0), (shape.columns, shape.rows), (0, shape.rows)]
    homography = cv2.getPerspectiveTransform(np.float32(cells), np.float32(corners))
    y, x = (
        (np.arange((n + 2) * samples) + 0.5) / samples - 1
        for n in (shape.rows, shape.columns)
    )
    places = np.stack([*np.meshgrid(x, y), np.ones((len(y), len(x)))])
    across, down, depth = np.tensordot(homography, places, 1)
    seen = depth > 1e-3
    reading = ndimage.map_coordinates(
        image,
        [down[seen] / depth[seen] - 0.5, across[seen] / depth[seen] - 0.5],
        order=1,
        mode="nearest",
    )
    panels = Panels.known(torch.tensor([corners, cells], dtype=torch.float64))
    frames = Frames.whole(torch.from_numpy(image).expand(2, 60, 60))
    patches = rectify(frames, panels, shape, samples)
    ours = patches[0, 0].numpy()
    assert (depth < -1e-3).any()
    np.testing.assert_allclose(ours[seen], reading, rtol=0, atol=1e-6)
    assert (ours[depth < -1e-3] == 230).all(), "border pixels"
    for row in (0, 1):
        alone = rectify(
            frames[row : row + 1],
            Panels.known(panels.corners_px[row, None]),
            shape,
            samples,
        )
        assert torch.equal(alone[0], patches[row])
    inner = (
        slice(None),
        slice(None),
        slice(samples, -samples),
        slice(samples, -samples),
    )
    sensor = np.pad(image, 70).astype(np.float32)
    planes = torch.from_numpy(sensor[None, None, 70:130, 70:130].copy())
    crop = Frames(planes, torch.tensor([[70, 70]]), (200, 200), torch.tensor([0.0]))
    there = Panels.known(panels.corners_px[:1] + 70)
    single = [
        rectify(one, there, shape, samples)[inner] for one in (crop, whole(sensor))
    ]
    assert torch.equal(*single), "a crop and the whole frame, to the last bit"


def test_as_many_panels_as_frames():
    reader = Reader(SHAPE, 4)
    panel = Panels.known(torch.tensor([FLAT["concave"]]).double())
    frames = Frames.whole(picture().expand(3, 40, 40))
    with pytest.raises(
        VoccError,
        match=r"panels.corners_px has shape \(1, 4, 2\): it must be \(3,4,2\)",
    ):
        reader.read(frames, panel)
    with pytest.raises(
        VoccError, match=r"takes have shapes \(1, 1, 40, 40\), \(3, 1, 40, 40\)"
    ):
        reader.read_takes([frames[:1], frames], panel)
    with pytest.raises(
        VoccError,
        match=r"frames.grey has shape \(1, 1, 0, 4\): it must be \(B,1,H,W\), not empty",
    ):
        reader.read(Frames.whole(torch.zeros(1, 1, 0, 4)), panel)
