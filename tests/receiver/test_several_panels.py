"""Several panels of one frame, as rows of readings."""

import math

import numpy as np
import pytest
import torch

from vocc_torch import PanelShape
from vocc_torch.errors import VoccError
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.locators import DetectorLocator, PaperLocator
from vocc_torch.receiver.locators.second_looks import locate_several
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.recordings.frames import RecordedFrame
from vocc_torch.studies.decode.colour import Mix
from vocc_torch.studies.decode.reading import COLUMNS, read_panels
from vocc_torch.types import Frames

SHAPE, ANY = PanelShape(8, 8), DetectorLocator(false_alarms=math.inf)
BITS = torch.rand(8, 8, generator=torch.Generator().manual_seed(3)) < 0.5


def street(*places, around=200.0, pitch=9):
    """A bright wall with grain, and dark panels whose On LEDs are darker than it."""
    draw = np.random.default_rng(5)
    grey = around + 3 * draw.normal(size=(240, 320))
    for x, y in places:
        grey[y - 4 : y + 8 * pitch + 4, x - 4 : x + 8 * pitch + 4] = 30
        cell = np.zeros((pitch, pitch))
        cell[1:-1, 1:-1] = 100
        grey[y : y + 8 * pitch, x : x + 8 * pitch] += np.kron(BITS.numpy(), cell)
    return torch.from_numpy(grey.clip(0, 255).round().astype(np.uint8))


@pytest.fixture(scope="module")
def two():
    return street((50, 60), (200, 130))


@pytest.mark.parametrize("second", [(122, 60), (50, 132)])
def test_two_panels_that_touch_are_two(second):
    frames = Frames.whole(street((50, 60), second)[None])
    found = locate_several(DetectorLocator(), frames, SHAPE, 2)
    _, panels = found.panels(1, 1e-2, 2)
    assert panels.found.tolist() == [True, True]
    begin = sorted(panels.corners_px[:, 0].tolist())
    assert np.abs(np.array(begin) - sorted([(50, 60), second])).max() < 2
    assert (
        len(locate_several(DetectorLocator(), frames, SHAPE, 1).panels(1, 1e-2)[0]) == 1
    )


def test_two_panels_are_two_rows(two):
    draw = torch.rand(64, 3, generator=torch.Generator().manual_seed(6))
    flda = FLDA(3).fit(draw + (torch.arange(64) % 2)[:, None], torch.arange(64) % 2)
    receiver = Receiver("flda_3", ANY, Reader(SHAPE), flda)
    colour = two.numpy()[..., None].repeat(3, 2)
    frame = RecordedFrame("two.png", 0, None, colour, two.numpy())
    read = list(read_panels(receiver, iter([frame]), 2))
    assert [one.panel for one in read] == [0, 1]
    assert all(len(one.row()) == len(COLUMNS) for one in read)
    left = sorted(float(one.corners_px[0, 0]) for one in read)
    assert left == pytest.approx([50, 200], abs=2)
    twice = list(
        read_panels(receiver, iter([frame]), 2, lights=(Mix("red"), Mix("blue")))
    )
    assert [(one.panel, one.frame.light) for one in twice] == [
        (panel, light) for light in ("red", "blue") for panel in (0, 1)
    ]
    assert [one.text for one in twice] == [one.text for one in read] * 2
    with pytest.raises(VoccError, match=r"decode\.most is 2"):
        list(
            read_panels(
                Receiver("flda_3", PaperLocator(), Reader(SHAPE), flda),
                iter([frame]),
                2,
            )
        )
