from dataclasses import replace

import numpy as np
import pytest
import torch

import vocc_torch as vt
from vocc_torch.errors import VoccError
from vocc_torch.receiver.frame_fit import fit, settled
from vocc_torch.receiver.locators import PanelLocator
from vocc_torch.receiver.tracker import Tracker
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import Camera, LedPanel, Simulator
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import Candidates, PanelShape, Scene

SHAPE = PanelShape(8, 8)
CAMERA = Camera(width_px=240, height_px=200, sensor_width_mm=240 * 13.2 / 1920)
FRAMES, HIDDEN = 48, slice(20, 26)
NOISE = {
    "photoelectrons": {"quantum_efficiency": 0.6},
    "shot_noise": {},
    "read_noise": {"electrons": 3.0},
}


@pytest.fixture(scope="module")
def approach():
    """From 60 m to 30 m with shake of 1.5 px a frame; frames (N,H,W) and corners (N,4,2)."""
    draw = np.random.default_rng(5)
    distance = np.linspace(60, 30, FRAMES)
    shake = (
        draw.normal(0, 1.5, (2, FRAMES)).cumsum(1) * distance / CAMERA.focal_length_px
    )
    scene = Scene.of(FRAMES)
    place = {
        "distance_m": distance,
        "offset_x_m": 0.3 + shake[0],
        "offset_y_m": shake[1],
    }
    scene = Scene(
        *(
            torch.from_numpy(place[n]) if n in place else getattr(scene, n)
            for n in scene.__dataclass_fields__
        )
    )
    simulator = Simulator(
        CAMERA,
        LedPanel(board_reflectance=None),
        effects={**PAPER_EFFECTS, **NOISE, "gain": {}},
        framing="full",
    )
    keys = [FrameKey(BlockKey(0, "approach", 0), i) for i in range(FRAMES)]
    bits = torch.from_numpy(draw.random((FRAMES, 8, 8)) < 0.5)
    grey = simulator.render(scene, bits, keys=keys).grey[:, 0].numpy().copy()
    grey[HIDDEN] = draw.normal(100, 3, grey[HIDDEN].shape).round()
    return grey, simulator.true_panels(scene).corners_px.numpy()


class Told(PanelLocator):
    """A locator that is told where panels are, and counts how often it is asked."""

    def __init__(self, corners, first=None):
        self.corners, self.frame, self.asked, self.first = corners, 0, 0, first

    def locate(self, frames, shape):
        self.asked += 1
        shown = (
            self.corners is not None and not HIDDEN.start <= self.frame < HIDDEN.stop
        )
        corners = (
            torch.from_numpy(self.corners[self.frame])[None]
            if shown
            else torch.zeros(0, 4, 2)
        )
        return Candidates.of(corners, torch.ones(len(corners)))


def errors_cells(tracker, locator, grey, corners):
    """The farthest corner of the nearest panel in each frame, cells; infinite where none is seen."""
    errors = []
    for locator.frame, plane in enumerate(grey):
        cell = (
            np.linalg.norm(corners[locator.frame, 1] - corners[locator.frame, 0])
            / SHAPE.columns
        )
        seen = [
            np.abs(one.corners - corners[locator.frame]).max() / cell
            for one in tracker(plane)
        ]
        errors.append(min(seen, default=np.inf))
    return np.array(errors)


def test_a_shaking_panel_is_followed_and_found_again(approach):
    grey, corners = approach
    locator = Told(corners)
    tracker = Tracker(locator, SHAPE, every=100)
    errors = errors_cells(tracker, locator, grey, corners)
    visible = np.ones(FRAMES, bool)
    visible[HIDDEN] = False
    assert (errors[visible] < 0.25).mean() >= 0.95
    assert np.isinf(errors[~visible]).all()
    assert errors[HIDDEN.stop] < 0.25
    # Once at the beginning, once a hidden frame, and once again; all else is followed.
    assert tracker.searches == locator.asked <= 2 + len(grey[HIDDEN]) + 2


def test_a_small_standing_panel_stays_where_it_is():
    """Of 2.7 px an LED in a night's noise: by neither a line of dark LEDs nor by size or turn is it moved."""
    given = (
        "distance_m=80",
        "ambient_lx=10",
        "led_luminance_cd_m2=400",
        "offset_x_m=0",
        "offset_y_m=0",
    )
    words = [
        "camera.width_px=160",
        "camera.height_px=120",
        "scene.camera.sensor_width_mm=1.1",
    ]
    world = vt.load_scene("night", *words, *(f"scene.{one}" for one in given))
    (batch,) = vt.simulate(replace(world, framing="full"), 48, point="standing")
    corners, locator = batch.corners_px.numpy(), Told(batch.corners_px.numpy())
    errors = errors_cells(
        Tracker(locator, SHAPE, every=100),
        locator,
        batch.frames.grey[:, 0].numpy(),
        corners,
    )
    assert errors.max() < 0.25


def shaken(seed, changes=True):
    """A panel of 3 px an LED at 70 m to 66 m, shaken by 2.5 px a frame, and its corners."""
    draw, many = np.random.default_rng(seed), 24
    distance, shake = np.linspace(70, 66, many), np.zeros((2, many))
    for i in range(1, many):
        shake[:, i] = 0.9 * shake[:, i - 1] + draw.normal(0, 2.5, 2)
    place = {
        "distance_m": distance,
        **dict(zip(("offset_x_m", "offset_y_m"), shake, strict=True)),
    }
    for name in ("offset_x_m", "offset_y_m"):
        place[name] = place[name] * distance / CAMERA.focal_length_px
    given = Scene.of(many, ambient_lx=8000.0)
    values = {name: getattr(given, name) for name in given.__dataclass_fields__}
    scene = Scene(
        **values | {name: torch.from_numpy(one) for name, one in place.items()}
    )
    simulator = Simulator(
        CAMERA,
        LedPanel(board_reflectance=None),
        effects={**PAPER_EFFECTS, **NOISE, "gain": {}},
        framing="full",
    )
    keys = [FrameKey(BlockKey(seed, "shaken", 0), i) for i in range(many)]
    bits = torch.from_numpy(draw.random((many, 8, 8)) < 0.5)
    bits = bits if changes else bits[:1].expand(many, -1, -1)
    corners = simulator.true_panels(scene).corners_px.numpy()
    return simulator.render(scene, bits, keys=keys).grey[:, 0].numpy(), corners


def before_an_edge(grey, corners):
    """Light of a sky above and of a road below is added, as through a panel without a board."""
    sky = np.where(np.arange(grey.shape[1]) < corners[..., 1].mean(), 110.0, 8.0)[
        :, None
    ]
    light = 255 * (grey / 255) ** 2.2 + sky
    return (255 * (light.clip(0, 255) / 255) ** (1 / 2.2)).round().astype(np.uint8)


def test_size_does_not_drift_before_an_edge():
    """By fits that explain the edge by the lattice it is 17 % too large."""
    for seed in (0, 2):
        grey, corners = shaken(seed)
        grey, sides = before_an_edge(grey, corners), np.sqrt(area(corners))
        for plane, known, side in zip(grey, corners, sides, strict=True):
            assert (
                abs(np.sqrt(area(fit(plane, known, SHAPE, 0.35)[0])) / side - 1) < 0.01
            )
        locator = Told(corners)
        errors = errors_cells(
            Tracker(locator, SHAPE, every=100), locator, grey, corners
        )
        assert (errors < 0.25).mean() > 0.9


def area(corners):
    """Area of quadrilaterals (...,4,2) by the shoelace formula."""
    x, y = corners[..., 0], corners[..., 1]
    return abs((x * np.roll(y, -1, -1) - y * np.roll(x, -1, -1)).sum(-1)) / 2


def test_a_panel_that_gives_way_to_lamps_is_soon_no_longer_claimed(approach):
    """Three lamps may be LEDs of a panel that is dark else, but not frame after frame."""
    grey, corners = approach
    y, x = np.mgrid[: grey.shape[1], : grey.shape[2]]
    lamps = (corners[11, [0, 1, 3]] * 2 + corners[11].mean(0)) / 3
    still = 20 + sum(200 * np.exp(-((x - a) ** 2 + (y - b) ** 2) / 4) for a, b in lamps)
    still = still.clip(0, 255).round().astype(np.uint8)
    locator, claimed = Told(corners), []
    tracker = Tracker(locator, SHAPE, every=100)
    for locator.frame in range(36):
        locator.corners = corners if locator.frame < 12 else None
        claimed.append(
            bool(tracker(grey[locator.frame] if locator.frame < 12 else still))
        )
    assert all(claimed[:12])
    assert not any(claimed[24:])


def test_a_part_of_a_panel_is_soon_no_longer_claimed():
    """Five of its eight columns are a lattice whose lights change; beside it they change as well."""
    grey, corners = shaken(3)
    part = corners.copy()
    part[:, 1:3] += 3 / 8 * (corners[:, [0, 3]] - corners[:, 1:3])
    locator = Told(part)
    tracker = Tracker(locator, PanelShape(8, 5), every=100)
    claimed = [bool(tracker(grey[0]))]
    locator.corners = None
    claimed += [bool(tracker(plane)) for plane in grey[1:]]
    assert claimed[0]
    assert not any(claimed[12:])


def test_a_panel_whose_leds_stand_still_is_followed_on():
    grey, corners = shaken(1, changes=False)
    locator = Told(corners)
    assert (
        errors_cells(Tracker(locator, SHAPE, every=100), locator, grey, corners) < 0.25
    ).mean() > 0.95


class Doubting(Told):
    """A locator that sees the panel and is never sure of it."""

    finds_several, most_false_alarms = True, 1e-3

    def locate(self, frames, shape):
        one = torch.ones(1, dtype=torch.float64)
        return Candidates(
            one.long() - 1, torch.from_numpy(self.corners[self.frame])[None], one, one
        )


def test_where_corners_shake_by_most_of_a_cell_no_line_is_missed():
    """The line around the panel stands still, and the LEDs change: that tells one line from the next."""
    for seed in (0, 4):
        grey, corners = shaken(seed)
        locator = Told(corners)
        errors = errors_cells(
            Tracker(locator, SHAPE, every=100), locator, grey, corners
        )
        assert (errors < 0.25).mean() > 0.95


def test_a_doubtful_panel_is_seen_once_its_leds_change_and_a_picture_of_one_never():
    grey, corners = shaken(1)
    locator = Doubting(corners)
    tracker = Tracker(locator, SHAPE)
    errors = errors_cells(tracker, locator, grey, corners)
    assert [one.sure for one in tracker.tracks] == [True]
    assert np.isnan(tracker.tracks[0].false_alarms), (
        "known by its flicker alone, of which none are stated"
    )
    assert np.isinf(errors[0])
    assert (errors[6:] < 0.25).all()
    for seed in range(1, 5):
        still, corners = shaken(seed, changes=False)
        locator = Doubting(corners)
        assert np.isinf(
            errors_cells(Tracker(locator, SHAPE), locator, still, corners)
        ).all()


def test_a_doubtful_panel_a_line_off_is_put_right_by_what_changes():
    grey, corners = shaken(2)
    along = (corners[:, 1] - corners[:, 0]) / SHAPE.columns
    locator = Doubting(corners + along[:, None])
    errors = errors_cells(Tracker(locator, SHAPE, every=100), locator, grey, corners)
    assert (errors[8:] < 0.5).all()
    assert (errors[-6:] < 0.25).all()


def test_full_searches_come_every_so_often(approach):
    grey, corners = approach
    locator = Told(corners)
    errors_cells(Tracker(locator, SHAPE, every=5), locator, grey[:16], corners[:16])
    assert locator.asked == 1 + 3


def test_a_second_panel_is_seen_at_the_next_full_search(approach):
    grey, corners = approach
    both, second = np.concatenate([grey, grey], 2)[:16], corners + np.array([240, 0])

    class Two(Told):
        finds_several = True

        def locate(self, frames, shape):
            known = [self.corners[self.frame]] + [second[self.frame]] * (
                self.frame >= 8
            )
            return Candidates.of(
                torch.from_numpy(np.stack(known)), torch.ones(len(known))
            )

    locator = Two(corners)
    tracker, seen = Tracker(locator, SHAPE, every=6), []
    for locator.frame, plane in enumerate(both):
        seen.append([one.number for one in tracker(np.ascontiguousarray(plane))])
    assert seen[7] == [0]
    assert seen[15] == [0, 1]


def test_corners_are_fitted_from_a_third_of_a_cell_away(approach):
    grey, corners = approach
    cell = np.linalg.norm(corners[-1, 1] - corners[-1, 0]) / 8
    found, _, share = fit(grey[-1], corners[-1] + 0.3 * cell, SHAPE, 0.3)
    assert np.abs(found - corners[-1]).max() < 0.15 * cell
    assert share > 0.9


def test_panels_are_given_as_a_locator_gives_them(approach):
    grey, corners = approach
    whose, numbers, panels = Tracker(Told(corners), SHAPE).panels(
        torch.from_numpy(grey[:3])
    )
    assert (whose, numbers) == ([0, 1, 2], [0, 0, 0])
    assert panels.found.tolist() == [True] * 3
    assert np.abs(panels.corners_px.numpy() - corners[:3]).max() < 1
    empty = Tracker(Told(corners), SHAPE, every=1)
    empty.locator.frame = HIDDEN.start
    _, _, none = empty.panels(torch.from_numpy(grey[:1]))
    assert none.found.tolist() == [False]
    assert not none.corners_px.any()


@pytest.mark.parametrize("wrong", [{"every": 0}, {"patience": 0}, {"every": 2.5}])
def test_numbers_out_of_range_are_refused(wrong):
    with pytest.raises(
        VoccError, match=r"follow\.\w+ is .*: it must be a whole number of at least 1"
    ):
        Tracker(Told(None), SHAPE, **wrong)


def test_a_lattice_is_settled_where_it_is_and_nowhere_else(approach):
    grey, corners = approach[0][0], approach[1][0]
    cell = np.linalg.norm(corners[1] - corners[0]) / 8
    there, *known = settled(grey, corners + 0.4 * cell, SHAPE)
    assert np.abs(there - corners).max() < 0.1 * cell
    again, *_ = settled(grey, corners - 0.3 * cell, SHAPE, tuple(known))
    assert np.abs(again - corners).max() < 0.1 * cell
    hidden, dark = approach[0][HIDDEN.start], np.zeros_like(grey)
    for plane, at in ((hidden, corners), (dark, corners), (grey, corners + 1.2 * cell)):
        assert settled(plane, at, SHAPE) is None
        assert settled(plane, at, SHAPE, tuple(known)) is None
