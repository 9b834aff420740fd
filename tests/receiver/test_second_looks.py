"""Frames in which too little is sure are seen again; what is found lies where it lies in the frame."""

from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np
import pytest
import torch
from skimage import data

from vocc_torch import PanelShape
from vocc_torch.receiver.locators import DetectorLocator, PanelLocator
from vocc_torch.receiver.locators.second_looks import locate_several, new_panels, scaled
from vocc_torch.types import Candidates, Frames

SHAPE = PanelShape(4, 4)
SEEN: list[tuple[int, ...]] = []


@dataclass(frozen=True)
class Bright(PanelLocator):
    """Takes what is brighter than 100 for the panel; is sure of it if it is at most ``most_px`` wide."""

    name: ClassVar[str] = "bright"
    finds_several: ClassVar[bool] = True

    most_px: int = 25

    @property
    def states_false_alarms(self):
        return True

    @property
    def most_false_alarms(self):
        return 1e-2

    def locate(self, frames, shape):
        SEEN.append(tuple(frames.grey.shape))
        corners, alarms = [], []
        for grey, origin in zip(frames.grey[:, 0], frames.origin_px, strict=True):
            rows, columns = ((grey > 100).any(axis).nonzero() for axis in (1, 0))
            left, right = int(columns[0]), int(columns[-1]) + 1
            top, low = int(rows[0]), int(rows[-1]) + 1
            box = [[left, top], [right, top], [right, low], [left, low]]
            corners.append(torch.tensor(box).double() + origin)
            alarms.append(1e-3 if right - left <= self.most_px else 1.0)
        score = torch.ones(len(frames)).double()
        found = Candidates.of(torch.stack(corners), score)
        return Candidates(
            found.frame,
            found.corners_px,
            score,
            torch.tensor(alarms, dtype=torch.float64),
        )


def box(left, top, side):
    grey = torch.zeros(1, 80, 120, dtype=torch.uint8)
    grey[:, top : top + side, left : left + side] = 200
    return grey


@pytest.fixture
def frames():
    return Frames.whole(torch.stack([box(8, 12, 20), box(40, 20, 28), box(60, 32, 36)]))


def test_only_frames_without_a_sure_panel_are_seen_again(frames):
    SEEN.clear()
    found = locate_several(Bright(), frames, SHAPE, 1)
    assert SEEN == [(3, 1, 80, 120), (2, 1, 63, 95), (1, 1, 50, 76)]
    assert found.frame.tolist() == [0, 1, 1, 2, 2, 2]
    whose, panels = found.panels(3, 1e-2)
    assert whose.tolist() == [0, 1, 2]
    assert panels.found.tolist() == [True] * 3
    assert panels.false_alarms.tolist() == [1e-3, 1e-2, 1e-2]
    # In a smaller frame an edge is known to a pixel.
    truth = torch.tensor([[[40, 20], [68, 48]], [[60, 32], [96, 68]]])
    assert (panels.corners_px[1:, ::2] - truth).abs().max() < 1.6


def test_a_crops_panel_lies_where_it_lies_on_the_sensor(frames):
    crops = Frames(frames.grey, frames.origin_px + torch.tensor([500, 300]), (900, 900))
    whole, moved = (
        locate_several(Bright(), one, SHAPE, 1).corners_px for one in (frames, crops)
    )
    assert torch.equal(moved, whole + torch.tensor([500, 300]))


def test_frames_of_a_pixel_are_seen(frames):
    tiny = Frames.whole(torch.full((1, 1, 1), 200, dtype=torch.uint8))
    assert len(locate_several(Bright(0), tiny, SHAPE, 1).frame) == 3


def test_frames_without_a_pixel_show_nothing():
    none = Frames.whole(torch.zeros(2, 0, 5, dtype=torch.uint8))
    assert len(locate_several(DetectorLocator(), none, SHAPE, 2).frame) == 0


@pytest.mark.parametrize("columns", [255, 256, 341, 512])
def test_rows_longer_than_a_panel_may_be_are_not_looked_for(columns, frames):
    found = locate_several(Bright(0), frames[:1], PanelShape(4, columns), 4)
    assert len(found.frame) == 3


def test_floating_grey_values_are_cut_as_in_the_first_look(frames):
    """A value of 300 is white, as a byte it would be 44."""
    bright = Frames.whole(1.5 * frames.grey.float())
    corners = [scaled(Bright(), one, SHAPE, 0.5).corners_px for one in (frames, bright)]
    assert (corners[0] - corners[1]).abs().max() <= 2


def test_without_stated_false_alarms_the_higher_score_is_kept():
    """Of two candidates for one place."""
    wide = PanelShape(8, 32)
    corners = torch.tensor([[0.0, 0.0], [32, 0], [32, 8], [0, 8]]).double()
    moves = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 8.0]]).double()
    quads = corners + moves[:, None]
    score = torch.tensor([0.5, 0.75, 0.625]).double()
    found = Candidates.of(quads, score)
    found = Candidates(0 * found.frame, quads, score, found.false_alarms)
    assert new_panels(found, found[:0], wide).score.tolist() == [0.75, 0.625]
    assert new_panels(found, found[:1], wide).score.tolist() == [0.625]


def drawn(photograph, pitch, count, gap, seed):
    """Hang panels of 8 x 8 round LEDs side by side on one board before a photograph; give also their corners."""
    draw = np.random.default_rng(seed)
    grey = cv2.resize(cv2.cvtColor(photograph, cv2.COLOR_RGB2GRAY), (640, 427)).astype(
        float
    )
    high, wide = 8 * pitch, round((8 * count + gap * (count - 1)) * pitch)
    room = np.array(grey.shape) - (high, wide) - 2 * pitch
    top, left = draw.integers(pitch, room)
    grey[top - pitch // 2 : top + high + pitch // 2][
        :, left - pitch // 2 : left + wide + pitch // 2
    ] = 40
    lefts = [left + round(number * (8 + gap) * pitch) for number in range(count)]
    light = np.where(draw.random((count, 8, 8)) < 0.5, 170, 60)
    fine = cv2.resize(grey, None, fx=4, fy=4, interpolation=cv2.INTER_NEAREST)
    for number, row, column in np.ndindex(light.shape):
        at = (lefts[number] + (column + 0.5) * pitch, top + (row + 0.5) * pitch)
        centre = [round(4 * one) for one in at]
        value = int(light[number, row, column])
        cv2.circle(fine, centre, round(1.5 * pitch), value, cv2.FILLED)
    grey = cv2.GaussianBlur(
        cv2.resize(fine, (640, 427), interpolation=cv2.INTER_AREA), (0, 0), 0.6
    )
    grey = (grey + draw.normal(size=grey.shape)).clip(0, 255).round()
    corners = [
        [[x, top], [x + high, top], [x + high, top + high], [x, top + high]]
        for x in lefts
    ]
    return torch.from_numpy(grey.astype(np.uint8))[None], np.array(corners)


PHOTOGRAPHS = (data.coffee, data.chelsea, data.astronaut, data.rocket)


@pytest.mark.parametrize(
    ("count", "gap"), [(2, 0.0), (2, 0.5), (2, 1.0), (3, 0.0), (3, 1.0), (4, 1.0)]
)
def test_panels_side_by_side_are_found(count, gap):
    right = 0
    for seed, photograph in enumerate(2 * PHOTOGRAPHS):
        grey, truth = drawn(photograph(), 6 + seed, count, gap, seed)
        found = locate_several(
            DetectorLocator(), Frames.whole(grey), PanelShape(8, 8), count
        )
        _, panels = found.panels(1, 1e-2, count)
        places = panels.corners_px[panels.found].numpy()
        off = np.abs(places[:, None].mean(2) - truth.mean(1)).max(2)
        right += len(places) == count and bool((off.min(0) < 0.25 * (6 + seed)).all())
    assert right >= 7
