"""The lattice locator: panels darker than what is around, several, none; and its false alarms."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.stats import expon

from vocc_torch import PanelShape
from vocc_torch.errors import VoccError
from vocc_torch.receiver import false_alarms
from vocc_torch.receiver.cell_model import randomness
from vocc_torch.receiver.false_alarms import FalseAlarms
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.lattice_locator import LatticeLocator
from vocc_torch.receiver.lattice_search import Pyramid, lattice_hypotheses
from vocc_torch.receiver.learned import LearnedLocator
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.receiver.locators import locator_from, locator_named, locator_settings
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.receiver import Receiver
from vocc_torch.receiver.recording import RecordedFrame
from vocc_torch.studies.decode.colour import Mix
from vocc_torch.studies.decode.reading import COLUMNS, decode

SHAPE, ANY = PanelShape(8, 8), LatticeLocator(math.inf)
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


def corners_at(x, y, side):
    return torch.tensor([[x, y], [x + side, y], [x + side, y + side], [x, y + side]], dtype=torch.float64)


@pytest.fixture(scope="module")
def two():
    return street((50, 60), (200, 130))


def test_panels_darker_than_the_wall_are_seen_both(two):
    seen = ANY.sightings(two[None], SHAPE)
    for x, y in ((50, 60), (200, 130)):
        apart = (seen.corners_px[:2] - corners_at(x, y, 72.0)).abs().amax((1, 2))
        assert float(apart.min()) < 0.25 * 9
    assert bool((seen.score[2:] < seen.score[1]).all())


@pytest.mark.parametrize("pitch", [3.6, 4.4])
def test_a_lattice_shows_where_leds_run_into_one_another(pitch):
    """A blur of half a pitch leaves nothing of it in the grey values; noise is that of a night."""
    draw, seen = np.random.default_rng(8), 0
    for _ in range(8):
        bits, left = np.pad(draw.random((8, 8)) < 0.5, 1), 30 + 5 * draw.random(2)
        cell = [((np.arange(800) + 0.5) / 8 - one) / pitch for one in left]
        row, column = (np.floor(one).clip(-1, 8).astype(int) + 1 for one in cell)
        light = gaussian_filter(40 + 80.0 * bits[row[:, None], column], 8 * pitch / 2.3)
        grey = light.reshape(100, 8, 100, 8).mean((1, 3)) + draw.normal(0, 1.5, (100, 100))
        picture = torch.from_numpy(grey.clip(0, 255).round().astype(np.uint8))[None, None]
        guess = lattice_hypotheses(Pyramid.of(picture, 12), SHAPE)
        scale = 2.0 ** guess.level[:, None]
        off = ((guess.centre_px * scale - torch.from_numpy(left[::-1].copy())) / pitch + 0.5) % 1 - 0.5
        bent = (guess.basis_px * scale[..., None] / pitch - torch.eye(2)).abs().amax((1, 2))
        seen += bool(((bent < 0.05) & ((off.abs() - 0.5).abs().amax(1) < 0.3)).any())
    assert seen >= 6


def test_the_brightest_blob_is_no_panel_here_for_the_paper(two):
    """What the lattice is for: the panels are the darkest things in the frame."""
    panels = PaperLocator()(two[None], SHAPE)
    apart = (panels.corners_px[0] - corners_at(50, 60, 72.0)).abs().amax()
    assert not bool(panels.found[0]) or float(apart) > 9


def test_a_batch_changes_nothing(two):
    frames = torch.stack([street(), two])
    both, alone = ANY.sightings(frames, SHAPE), ANY.sightings(two[None], SHAPE)
    mine = both.frame == 1
    assert torch.equal(both.corners_px[mine], alone.corners_px)
    assert torch.equal(both.score[mine], alone.score)


@pytest.mark.parametrize("level", [0, 255, None])
def test_nothing_is_found_where_nothing_is(level):
    draw = torch.randint(0, 256, (1, 200, 300), generator=torch.Generator().manual_seed(1)).to(torch.uint8)
    grey = draw if level is None else torch.full((1, 200, 300), level, dtype=torch.uint8)
    panels = LatticeLocator()(grey, SHAPE)
    assert not bool(panels.found[0])
    assert float(panels.false_alarms[0]) > 1e-3
    assert not bool(panels.corners_px.any())


def test_the_photograph_is_located():
    picture = Image.open(Path(__file__).parents[1] / "data" / "led-panel-8x8-photo.png").convert("L")
    grey = np.asarray(picture)
    seen = ANY.sightings(grey[None].copy(), SHAPE)
    across, down = np.meshgrid((np.arange(8) + 0.5) / 8, (np.arange(8) + 0.5) / 8)
    first, second, third, fourth = seen.corners_px[0].numpy()
    weights = [(1 - across) * (1 - down), across * (1 - down), across * down, (1 - across) * down]
    place = sum(w[..., None] * c for w, c in zip(weights, (first, second, third, fourth), strict=True))
    at = grey[place[..., 1].round().astype(int).clip(0, 345), place[..., 0].round().astype(int).clip(0, 360)]
    truth = ["00000111", "10011010", "11010011", "11111001", "10000111", "11100010", "10111010", "01110001"]
    assert ["".join("01"[int(v > 100)] for v in row) for row in at] == truth


def test_rules_look_less_random_than_random_bits():
    rows = torch.zeros(8, 8, dtype=torch.bool)
    rows[::2] = True
    checks = rows ^ rows.mT
    dots = rows & rows.mT
    draws = torch.rand(200, 8, 8, generator=torch.Generator().manual_seed(2)) < 0.5
    least = float(randomness(draws).quantile(0.02))
    for rule in (rows, checks, dots, torch.zeros_like(rows)):
        assert float(randomness(rule)) < least - 3


def test_false_alarms_of_an_exponential_tail_are_scipys():
    draw = torch.rand(20000, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    table = FalseAlarms.of("mine", SHAPE, -draw.log())
    for score in (4.0, 7.0, 10.0):
        low, high = table.interval(score)
        assert low < expon.sf(score) < high
    assert math.isclose(float(table.expected(torch.tensor([table.score_at(1e-3)]))[0]), 1e-3, rel_tol=1e-6)
    assert float(table.expected(torch.tensor([-9.0]))[0]) == 1


def test_where_a_tail_grows_longer_far_out_rates_follow_it():
    """One in 25 is of another kind, with a tail three times as long."""
    generator = torch.Generator().manual_seed(6)
    draw, kind = torch.rand(2, 40000, generator=generator, dtype=torch.float64)
    table = FalseAlarms.of("mine", SHAPE, -draw.log() * torch.where(kind < 0.04, 3.0, 1.0))
    for score in (3.0, 5.0, 7.0, 12.0):
        rate = 0.96 * expon.sf(score) + 0.04 * expon.sf(score, scale=3)
        low, high = table.interval(score)
        assert low < rate < high
        assert math.isclose(
            table.score_at(float(table.expected(torch.tensor([score]))[0])), score, rel_tol=1e-6
        )


def test_frames_in_which_nothing_is_seen_are_no_floor():
    """Of 40,000 one in 25 has a score."""
    draw = -torch.rand(40000, generator=torch.Generator().manual_seed(7), dtype=torch.float64).log()
    some = torch.where(torch.arange(len(draw)) % 25 == 0, draw, -torch.inf)
    table = FalseAlarms.of("mine", SHAPE, some)
    assert len(table.floors) == 2
    for score in (1.0, 3.0, 6.0):
        low, high = table.interval(score)
        assert low < 0.04 * expon.sf(score) < high
    with pytest.raises(VoccError, match=r"maxima is 2 scores: it must be 11 at least"):
        FalseAlarms.of("mine", SHAPE, some[:50])


def test_a_table_is_read_as_written_and_serves_no_smaller_panel(tmp_path):
    row = FalseAlarms("mine", 4, 8, 5000, (350, 100), (1.25, 2.5), 0.5)
    false_alarms.write_table(tmp_path / "table.csv", [row])
    assert false_alarms.read_table(tmp_path / "table.csv") == (row,)
    assert false_alarms.calibrated("mine", PanelShape(8, 8), tmp_path / "table.csv") == row
    assert false_alarms.calibrated("mine", PanelShape(4, 4), tmp_path / "table.csv") is None
    assert false_alarms.calibrated("other", SHAPE, tmp_path / "table.csv") is None


@pytest.mark.parametrize("locator", [LatticeLocator(), LearnedLocator()])
def test_a_panel_too_small_for_a_statement_is_refused(locator):
    with pytest.raises(
        VoccError, match=r"panel is 3 x 4: it must be of at least 16 LEDs for receiver\.locator"
    ):
        locator(torch.zeros(1, 64, 64, dtype=torch.uint8), PanelShape(3, 4))
    anything = replace(locator, false_alarms=math.inf)
    assert not bool(anything(torch.zeros(1, 64, 64, dtype=torch.uint8), PanelShape(3, 4)).found[0])


def test_it_is_kept_by_its_settings():
    locator = LatticeLocator(0.01)
    assert locator_from(locator_settings(locator)) == locator
    assert locator_named("lattice", PaperLocator()) == LatticeLocator()
    with pytest.raises(VoccError, match=r"location\.false_alarms"):
        LatticeLocator(0.0)


def test_two_panels_are_two_rows(two):
    draw = torch.rand(64, 3, generator=torch.Generator().manual_seed(6))
    flda = FLDA(3).fit(draw + (torch.arange(64) % 2)[:, None], torch.arange(64) % 2)
    receiver = Receiver("flda_3", ANY, Reader(SHAPE), flda)
    colour = two.numpy()[..., None].repeat(3, 2)
    frame = RecordedFrame("two.png", 0, None, colour, two.numpy())
    read = list(decode(receiver, iter([frame]), 2))
    assert [one.panel for one in read] == [0, 1]
    assert all(len(one.row()) == len(COLUMNS) for one in read)
    left = sorted(float(one.corners_px[0, 0]) for one in read)
    assert left == pytest.approx([50, 200], abs=2)
    twice = list(decode(receiver, iter([frame]), 2, lights=(Mix("red"), Mix("blue"))))
    assert [(one.panel, one.frame.light) for one in twice] == [
        (panel, light) for light in ("red", "blue") for panel in (0, 1)
    ]
    assert [one.text for one in twice] == [one.text for one in read] * 2
    with pytest.raises(VoccError, match=r"decode\.most is 2"):
        list(decode(Receiver("flda_3", PaperLocator(), Reader(SHAPE), flda), iter([frame]), 2))
