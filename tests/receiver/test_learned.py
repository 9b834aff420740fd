import json
from dataclasses import replace
from importlib import resources

import cv2
import numpy as np
import pytest
import torch
from skimage.filters import threshold_otsu

from vocc_torch.errors import VoccError
from vocc_torch.receiver.lattice_search import Pyramid
from vocc_torch.receiver.locators import (
    PaperLocator,
    locator_from,
    locator_named,
    locator_settings,
)
from vocc_torch.receiver.locators.learned import (
    LearnedLocator,
    distinct,
    is_whole,
    placings,
    with_missed_lines,
)
from vocc_torch.receiver.panel_evidence import (
    alignment,
    bright_cells,
    clues_of,
    evidence,
    two_levels,
)
from vocc_torch.receiver.panel_net import (
    CONTEXT,
    SAMPLES,
    SHIPPED,
    PanelNet,
    save_weights,
)
from vocc_torch.receiver.spot_fit import fitted_spots
from vocc_torch.receiver.tracker import Tracker
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import Camera, LedPanel, Simulator
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import Frames, PanelShape, Scene

SHAPE = PanelShape(8, 8)
SMALL = Camera(width_px=320, height_px=240, sensor_width_mm=320 * 13.2 / 1920)


@pytest.fixture(scope="module")
def noisy():
    """Eight noisy frames of the paper's panel at 30 to 65 m, and the true corners."""
    draw, count = np.random.default_rng(3), 8
    given = {
        "distance_m": np.linspace(30, 65, count),
        "offset_x_m": draw.uniform(-1, 1, count),
    }
    scene = Scene.of(count, ambient_lx=4000.0)
    parts = [
        torch.from_numpy(given[n]) if n in given else getattr(scene, n)
        for n in scene.__dataclass_fields__
    ]
    noise = {
        "photoelectrons": {"quantum_efficiency": 0.6},
        "shot_noise": {},
        "read_noise": {"electrons": 3.0},
    }
    effects = {**PAPER_EFFECTS, **noise, "gain": {}}
    simulator = Simulator(
        SMALL, LedPanel(board_reflectance=None), effects, framing="full"
    )
    keys = [FrameKey(BlockKey(0, "learned", 0), i) for i in range(count)]
    bits = torch.from_numpy(draw.random((count, 8, 8)) < 0.5)
    return simulator.render(Scene(*parts), bits, keys=keys), simulator.true_panels(
        Scene(*parts)
    )


def test_the_shipped_weights_find_most_panels_in_noise(noisy):
    """What is found is where the panel is."""
    frames, truth = noisy
    panels = LearnedLocator()(frames, SHAPE)
    assert panels.found.sum() >= 6
    assert (panels.false_alarms[panels.found] <= 1e-3).all()
    pitch = (truth.corners_px[:, 1] - truth.corners_px[:, 0]).norm(dim=1) / 8
    off = (panels.corners_px - truth.corners_px).norm(dim=2).amax(1) / pitch
    assert (off[panels.found] < 0.25).all()


def test_weights_of_ones_own_are_followed_and_state_no_false_alarms(noisy, tmp_path):
    """Found is then what the evidence calls likelier than not."""
    mine = tmp_path / "mine.json"
    mine.write_bytes(
        resources.files("vocc_torch.receiver").joinpath(SHIPPED).read_bytes()
    )
    locator, frame = LearnedLocator(weights=str(mine)), noisy[0][:1]
    seen = locator.locate(frame, SHAPE)
    assert (seen.score >= 0.5).all()
    assert seen.false_alarms.isnan().all()
    assert seen.panels(1, 1e-3)[1].found.tolist() == [True]
    followed, *_ = Tracker(locator, SHAPE)(frame.grey[0, 0].numpy())
    assert np.abs(followed.corners - seen.corners_px[0].numpy()).max() < 1


def test_what_is_found_does_not_depend_on_the_batch(noisy):
    frames, _ = noisy
    locator = LearnedLocator()
    together = locator(frames, SHAPE)
    for i in (0, 5):
        alone = locator(frames[i : i + 1], SHAPE)
        assert alone.found[0] == together.found[i]
        assert alone.score[0] == together.score[i]
        assert (alone.corners_px[0] - together.corners_px[i]).abs().max() < 1e-2


def test_small_panels_of_the_paper_are_found_in_crops_and_in_whole_frames():
    """Light of LEDs runs together there, and along an axis the bits have more power than the lattice."""
    draw, shape = np.random.default_rng(5), (8,)
    camera = Camera(width_px=160, height_px=120, sensor_width_mm=160 * 13.2 / 1920)
    scene = replace(
        Scene.of(*shape, ambient_lx=4000.0),
        distance_m=torch.tensor([60.0, 70.0]).double().repeat(4),
    )
    bits = torch.from_numpy(draw.random((*shape, 8, 8)) < 0.5)
    told = {}
    for framing in ("crop", "filled"):
        simulator = Simulator(camera, framing=framing)
        told[framing] = LearnedLocator()(simulator.render(scene, bits), SHAPE)
        off = (
            (told[framing].corners_px - simulator.true_panels(scene).corners_px)
            .abs()
            .amax((1, 2))
        )
        assert bool(told[framing].found.all())
        assert bool((off < 0.25 * 3).all())
    assert (told["crop"].corners_px - told["filled"].corners_px).abs().max() < 0.1


@pytest.mark.parametrize(
    ("shape", "turn_deg", "pitch_px", "squeezed"),
    [
        (SHAPE, 38.0, 9.0, (1.0, 1.0)),
        (PanelShape(16, 64), 6.0, 5.0, (1.0, 1.0)),
        (SHAPE, 4.0, 9.0, (0.5, 1.0)),
        (SHAPE, -3.0, 9.0, (1.0, 0.5)),
    ],
)
def test_turned_large_and_aslant_panels_are_found(shape, turn_deg, pitch_px, squeezed):
    """Turned further than in a street, of many more LEDs than a window shows, from far aside or above."""
    draw = np.random.default_rng(6)
    lit = np.pad(draw.random((shape.rows, shape.columns)) < 0.5, 1)
    disc = np.hypot(*(np.mgrid[:16, :16] - 7.5)) < 6
    board = np.kron(lit, 170 * disc) + 40.0
    scale = pitch_px / 16
    matrix = cv2.getRotationMatrix2D(
        (board.shape[1] / 2, board.shape[0] / 2), -turn_deg, scale
    )
    matrix[:, :2] *= np.array(squeezed)[:, None]
    size = (460, 300)
    matrix[:, 2] = np.array(size) / 2 - matrix[:, :2] @ np.array(board.shape[::-1]) / 2
    wall = 110 + 6 * draw.normal(size=(75, 115)).repeat(4, 0).repeat(4, 1)
    seen = cv2.GaussianBlur(board, (0, 0), 0.5 / scale)
    grey = cv2.warpAffine(
        seen, matrix, size, wall.copy(), cv2.INTER_LINEAR, cv2.BORDER_TRANSPARENT
    )
    grey = grey + draw.normal(0, 2, grey.shape)
    corners = 16 * (
        1
        + np.array(
            [[0, 0], [shape.columns, 0], [shape.columns, shape.rows], [0, shape.rows]]
        )
    )
    truth = (corners - 0.5) @ matrix[:, :2].T + matrix[:, 2] + 0.5
    picture = torch.from_numpy(grey.clip(0, 255).round().astype(np.uint8))
    panels = LearnedLocator(false_alarms=0.01)(picture[None], shape)
    assert panels.found.tolist() == [True]
    assert np.abs(panels.corners_px[0].numpy() - truth).max() < 0.25 * pitch_px * min(
        squeezed
    )


@pytest.mark.parametrize("pitch_px", [3, 16])
def test_a_panel_that_fills_the_picture_is_found(pitch_px):
    """Nothing is seen around it, as in a picture that was cut at its edge."""
    draw, seen = np.random.default_rng(2), 0
    disc = np.hypot(*(np.mgrid[:16, :16] - 7.5)) < 6
    for _ in range(4):
        board = cv2.GaussianBlur(
            np.kron(draw.random((8, 8)) < 0.5, 170.0 * disc) + 40, (0, 0), 4
        )
        grey = cv2.resize(
            board, (8 * pitch_px, 8 * pitch_px), interpolation=cv2.INTER_AREA
        )
        grey = (
            (grey + draw.normal(0, 1, grey.shape)).clip(0, 255).round().astype(np.uint8)
        )
        panels = LearnedLocator(false_alarms=0.01)(torch.from_numpy(grey)[None], SHAPE)
        truth = 8 * pitch_px * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
        off = np.abs(panels.corners_px[0].numpy() - truth).max()
        seen += bool(panels.found[0]) and off < 0.25 * pitch_px
    assert seen >= 3


def test_a_panel_that_goes_on_beyond_the_picture_is_none():
    """Of LEDs beyond its border nothing is known: at each of four borders half a cell may be hidden."""
    panel = torch.tensor(
        [[50.0, 40.0], [82.0, 40.0], [82.0, 56.0], [50.0, 56.0]]
    ).double()
    # Of cells of 2 px.
    scales, shape = (
        Pyramid.of(torch.zeros(1, 1, 90, 120), 12),
        PanelShape(8, 16),
    )
    for to_border in ((-50, 0), (38, 0), (0, -40), (0, 34)):
        at = panel + torch.tensor(to_border)
        beyond = torch.tensor(to_border).sign() * torch.tensor([0.8, 1.2])[:, None]
        assert is_whole(scales, at + beyond[:, None], shape).tolist() == [True, False]
    assert is_whole(scales, panel.new_zeros(0, 4, 2), shape).tolist() == []


@pytest.mark.parametrize("level", [0, 90, 255])
def test_nothing_is_found_where_nothing_is(level):
    panels = LearnedLocator()(torch.full((2, 96, 128), level, dtype=torch.uint8), SHAPE)
    assert not panels.found.any()
    assert not panels.corners_px.any()


@pytest.mark.parametrize("size", [(1, 1), (2, 30), (8, 8), (11, 200), (12, 12)])
def test_in_a_picture_of_few_pixels_nothing_is_found(size):
    noise = torch.randint(
        0, 256, (2, *size), generator=torch.Generator().manual_seed(3)
    ).to(torch.uint8)
    assert not LearnedLocator()(noise, SHAPE).found.any()


def test_the_panel_network_sees_placings_where_they_are():
    """A change of one cell changes what is judged of the placings that hold it or border on it alone."""
    torch.manual_seed(0)
    net, shape, reach = PanelNet().eval(), PanelShape(4, 6), 4
    margin = reach + CONTEXT
    dark = torch.rand(1, (4 + 2 * margin) * SAMPLES, (6 + 2 * margin) * SAMPLES) * 100
    lit, pitch = dark.clone(), torch.full((1,), 4.0)
    lit[:, : 2 * SAMPLES, :SAMPLES] += (
        50  # the margin's upper left corner, outside what norms the light
    )
    with torch.inference_mode():
        change = (net(lit, pitch, shape) - net(dark, pitch, shape)).abs().amax((0, 1))
    seen = change > 1e-6
    assert seen.shape == (2 * reach + 1, 2 * reach + 1)
    assert seen[0, 0]
    assert not seen[2 * CONTEXT + 2 :].any()
    assert not seen[:, 2 * CONTEXT + 1 :].any()


def test_places_are_shifted_to_where_the_network_is_surest():
    """By whole cells of the quadrilateral, right and down, and corners by the moves that it tells."""

    class Sure(torch.nn.Module):
        def forward(self, patches, pitch_px, shape, moved):
            judged = torch.zeros(len(patches), 9, 5, 5)
            judged[:, 0, 4, 1] = 3.0  # two cells down, one to the left
            judged[:, 2] = 0.5  # the first corner down
            return judged

    quad = torch.tensor(
        [[[40.0, 30.0], [72.0, 30.0], [72.0, 46.0], [40.0, 46.0]]]
    ).double()
    scales = Pyramid.of(torch.rand(1, 1, 90, 120), 24)
    placed, logit = placings(Sure(), scales, quad, PanelShape(8, 16), 2, moved=True)
    assert logit.tolist() == [3.0]
    assert torch.allclose(
        placed - quad, torch.tensor([[-2.0, 5.0], [-2, 4], [-2, 4], [-2, 4]]).double()
    )


def evidence_of(
    light: torch.Tensor, moved_px: torch.Tensor | None = None, spots: float = 0.0
) -> float:
    """Draw a lattice of LEDs of so much light (R,C), 12 px apart, moved by (R,C,2) px, and weigh it."""
    high, wide = light.shape
    at = (
        np.stack(np.mgrid[:high, :wide], 2) * 12.0
        + 26.0
        + (0.0 if moved_px is None else moved_px.numpy())
    )
    y, x = np.mgrid[: high * 12 + 40, : wide * 12 + 40]
    grey = np.full(y.shape, 20.0)
    for (down, right), shine in zip(
        at.reshape(-1, 2), light.flatten().tolist(), strict=True
    ):
        grey += shine * np.exp(-((y + 0.5 - down) ** 2 + (x + 0.5 - right) ** 2) / 8)
    corners = [
        [20, 20],
        [20 + 12 * wide, 20],
        [20 + 12 * wide, 20 + 12 * high],
        [20, 20 + 12 * high],
    ]
    scales = Pyramid.of(torch.from_numpy(grey).float()[None, None], 12)
    quad, logit = torch.tensor([corners]).double(), torch.tensor([5.0])
    return float(
        evidence(
            clues_of(scales, quad, logit, torch.tensor([spots]), PanelShape(high, wide))
        )
    )


def moved_cells(seed: int) -> torch.Tensor:
    """Draw how LEDs are off their lattice, by an eighth of a cell, (8,8,2) px."""
    return 1.5 * torch.randn(8, 8, 2, generator=torch.Generator().manual_seed(seed))


BITS = (torch.rand(8, 8, generator=torch.Generator().manual_seed(2)) < 0.5).float()


def test_dots_by_a_rule_are_less_evidence_than_random_bits():
    """As sure as the network may be, lamps in rows are no panel."""
    odd = torch.arange(8) % 2 == 1
    bits, few_spots = (evidence_of(150 * BITS, spots=share) for share in (0.0, 0.9))
    assert few_spots == bits > 5
    assert evidence_of(150 * (~(odd[:, None] & odd)).float()) < bits - 8


@pytest.mark.parametrize("leds", [4, 8])
def test_lamps_of_one_or_of_many_brightnesses_are_less_evidence_than_bits(leds):
    """Of such lamps two levels explain little, and how round they are is worth less."""
    draw, gain = torch.Generator().manual_seed(4), min(1, leds**2 / 64)
    bits, round_bits = (
        evidence_of(150 * BITS[:leds, :leds], spots=share) for share in (0.0, 0.98)
    )
    assert round_bits > bits + 2 * gain
    for lamps in (
        1 + 0.05 * torch.randn(leds, leds, generator=draw),
        torch.rand(leds, leds, generator=draw),
    ):
        plain, round_lamps = (
            evidence_of(150 * lamps, spots=share) for share in (0.0, 0.98)
        )
        assert plain < bits - 2
        assert round_lamps < round_bits - 2


def test_two_levels_are_parted_as_otsu_does():
    """Against scikit-image's threshold, on values that two levels explain well and on such as they do not."""
    values = torch.randn(20, 8, 8, generator=torch.Generator().manual_seed(5)).double()
    values += torch.linspace(0, 12, 20)[:, None, None] * BITS
    for one, parted in zip(values.numpy(), two_levels(values).tolist(), strict=True):
        # To the end of the bin.
        high = one > threshold_otsu(one, 4096) + np.ptp(one) / 8192
        within = (high.mean() * one[high].var()) + ((~high).mean() * one[~high].var())
        assert parted == pytest.approx(
            np.log((one.var() - within + 1) / (within + 1)), abs=1e-3
        )
    assert (
        two_levels(torch.ones(2, 8, 8)).tolist()
        == two_levels(torch.ones(2, 1, 1)).tolist()
        == [0, 0]
    )


def cells_of(
    middles: torch.Tensor, bits: torch.Tensor, samples: int = 16
) -> torch.Tensor:
    """Draw a round spot in each cell that is On, (n,R,K,C,K), at middles (n,R,C,2) off the cell's, cells."""
    at = (torch.arange(samples) + 0.5) / samples - 0.5
    across, down = ((at - middles[..., axis, None]).square() for axis in (0, 1))
    spots = torch.exp(-(down[..., :, None] + across[..., None, :]) / (2 * 0.1**2))
    return (200 * spots * bits[..., None, None]).permute(0, 1, 3, 2, 4)


def test_alignment_is_what_a_least_squares_fit_leaves():
    """Against NumPy's, for spots that are off a lattice by chance, whatever its shift, stretch and shear."""
    draw = torch.Generator().manual_seed(7)
    v, u = torch.meshgrid(
        torch.linspace(-1, 1, 8), torch.linspace(-1, 1, 8), indexing="ij"
    )
    fields = torch.stack([torch.ones_like(u), u, v, u * v], -1)
    off = (
        0.05 * torch.randn(6, 8, 8, 2, generator=draw)
        + fields @ (0.05 * torch.randn(6, 4, 2, generator=draw))[:, None]
    )
    bits = BITS.bool()
    left = [
        np.linalg.lstsq(fields[bits].double().numpy(), one[bits].double().numpy())
        for one in off
    ]
    free = 2 * int(bits.sum()) - 8
    spread = (
        np.array([one[1].sum() for one in left]) / free
        + 0.03**2 * int(bits.sum()) / free
    )
    wanted = free / 2 * np.log(0.15**2 / spread)
    assert alignment(cells_of(off, BITS)).tolist() == pytest.approx(
        wanted.tolist(), rel=0.03
    )


def test_lights_anywhere_do_not_keep_to_a_lattice():
    anywhere = (
        0.8 * torch.rand(20, 4, 4, 2, generator=torch.Generator().manual_seed(8)) - 0.4
    )
    bits, square = BITS[:4, :4], torch.zeros(4, 4)
    square[[0, 0, 3, 3], [0, 3, 0, 3]] = 1
    kept, lost = (
        alignment(cells_of(0 * anywhere[:1], bits)),
        alignment(cells_of(anywhere, bits)),
    )
    assert lost.max() < kept / 2
    assert alignment(cells_of(anywhere, square)).tolist() == [0] * 20, (
        "four lie on some lattice"
    )
    assert torch.equal(
        bright_cells(cells_of(anywhere, bits))[0], bits.bool().expand(20, 4, 4)
    )


def test_bits_that_are_nearly_all_alike_are_less_evidence():
    """Panels are half lit, and lamps shine: of 8 x 8 random bits hardly any have nine LEDs that are Off."""
    draw = torch.Generator().manual_seed(9)
    few = torch.ones(64)
    few[torch.randperm(64, generator=draw)[:9]] = 0
    assert evidence_of(150 * few.view(8, 8)) < evidence_of(150 * BITS) - 2


def test_how_unequally_many_cells_are_bright_counts_against_a_panel():
    """The square of their share less a half, at most 1/8; the other clues being equal."""
    order = torch.randperm(64, generator=torch.Generator().manual_seed(9)).view(8, 8)
    for dark, told in ((9, 0.125), (20, (44 / 64 - 0.5) ** 2), (32, 0.0)):
        scales, corners = drawn_spots((order >= dark).float(), 9.0, 0.0)
        clues = clues_of(scales, corners[None], torch.zeros(1), torch.zeros(1), SHAPE)
        assert float(clues[0, 6]) == pytest.approx(told)
    assert evidence(torch.zeros(1, 7)) > evidence(torch.eye(7)[6:] * 0.125) + 2


def test_points_of_light_part_in_two_levels_where_they_are_read_finely():
    """Unequal ones of a pixel, 24 px apart: in a picture of 3 px a cell they are as unequal as they are."""
    draw, clues = torch.Generator().manual_seed(3), {}
    bits = BITS[:4, :4]
    for radius in (1.0, 4.0):
        y, x = np.mgrid[:200, :200]
        grey = np.full(y.shape, 20.0)
        for (down, right), lit in np.ndenumerate(bits.numpy()):
            apart = np.hypot(y + 0.5 - (64 + 24 * down), x + 0.5 - (64 + 24 * right))
            grey = np.maximum(
                grey,
                255
                * lit
                * (apart < radius * (0.7 + 0.6 * float(torch.rand(1, generator=draw)))),
            )
        scales = Pyramid.of(torch.from_numpy(grey).float()[None, None], 6)
        quad = torch.tensor([[[52.0, 52.0], [148, 52], [148, 148], [52, 148]]]).double()
        clues[radius] = float(
            clues_of(scales, quad, torch.zeros(1), torch.zeros(1), PanelShape(4, 4))[
                0, 2
            ]
        )
    assert clues[1.0] > 3
    assert clues[4.0] > 3


@pytest.mark.parametrize("shape", [(1, 1), (1, 16), (2, 8)])
def test_panels_of_a_line_or_two_have_evidence(shape):
    """Of pairs of LEDs that are two apart a panel of two rows has none."""
    noise = torch.randint(
        0, 256, (1, 90, 120), generator=torch.Generator().manual_seed(0)
    ).to(torch.uint8)
    assert (
        LearnedLocator(false_alarms=torch.inf)
        .locate(noise, PanelShape(*shape))
        .score.isfinite()
        .all()
    )


def drawn_spots(
    bits: torch.Tensor, pitch_px: float, noise_dn: float
) -> tuple[Pyramid, torch.Tensor]:
    """Draw bright and dim round spots of bits (8,8), from 30 px on, and give their corners (4,2), too."""
    size = int(17 * pitch_px + 60)
    y, x = np.mgrid[:size, :size] + 0.5
    light = np.full(y.shape, 0.05)
    for (down, right), lit in np.ndenumerate(bits.numpy()):
        apart = np.hypot(
            y - 30 - (down + 0.5) * pitch_px, x - 30 - (right + 0.5) * pitch_px
        )
        light += (0.57 * lit + 0.03) * np.exp(-((apart / (0.25 * pitch_px)) ** 2) / 2)
    noise = np.random.default_rng(4).normal(0, noise_dn, light.shape)
    grey = (
        torch.from_numpy(255 * light.clip(0, 1) ** (1 / 2.2) + noise)
        .round()
        .clamp(0, 255)
    )
    corners = (
        30 + 8 * pitch_px * torch.tensor([[0.0, 0.0], [1, 0], [1, 1], [0, 1]]).double()
    )
    return Pyramid.of(grey[None, None], 12), corners


@pytest.mark.parametrize("pitch_px", [3.0, 4.4, 9.0, 23.0])
def test_spots_are_fitted_in_a_level_that_suits_them(pitch_px):
    """The lattice of drawn spots is found from corners that are off, alone and with others."""
    scales, truth = drawn_spots(BITS, pitch_px, 2.0)
    off = (
        0.15
        * pitch_px
        * torch.tensor([[1.0, 1.0], [-1, 1], [0.5, -1], [1, 0]]).double()
    )
    far = truth + 9 * pitch_px
    quads = torch.stack([truth + off, far, truth])
    found, share = fitted_spots(scales, quads, PanelShape(8, 8))
    assert (found[[0, 2]] - truth).abs().max() < 0.05 * pitch_px
    assert share[[0, 2]].min() > 0.98
    assert torch.equal(found[1], far)
    assert share[1] == 0
    for row in range(3):
        alone, own = fitted_spots(scales, quads[row : row + 1], PanelShape(8, 8))
        assert torch.equal(alone[0], found[row])
        assert own[0] == share[row]


@pytest.mark.parametrize(
    ("noise_dn", "shift_cells", "kept"),
    [(70, 0, 1), (85, 0, 0), (2, 1.5, 1), (2, 2.2, 0)],
)
def test_fits_that_explain_little_or_went_far_are_not_kept(noise_dn, shift_cells, kept):
    """Three quarters of the picture are to be explained, by a lattice within 1.8 cells; else corners stay."""
    scales, truth = drawn_spots(BITS, 6.0, noise_dn)
    begun = truth[None] + 6.0 * torch.tensor([shift_cells, 0.0])
    found, share = fitted_spots(scales, begun, PanelShape(8, 8))
    assert (found[0] - (truth if kept else begun[0])).abs().max() < (
        0.6 if kept else 1e-9
    )
    assert bool(share > 0) == bool(kept)


def test_a_fit_that_missed_an_outer_line_is_moved():
    """Of LEDs that are all Off, where the others are drawn out over it; what is right stays."""
    bits = BITS.clone()
    bits[:, 0] = 0
    scales, truth = drawn_spots(bits, 3.6, 0.5)
    missed = truth + torch.tensor([[3.6, 0.0], [0, 0], [0, 0], [3.6, 0]])
    quads = torch.stack([missed, truth, missed])
    moved = with_missed_lines(
        scales, quads, torch.tensor([0.97, 0.9995, 0.0]), PanelShape(8, 8)
    )
    assert (moved[:2] - truth).abs().max() < 0.05 * 3.6
    assert torch.equal(moved[2], missed), "of no sure fit nothing is known"


def test_leds_that_are_off_their_lattice_part_in_two_levels():
    """Where two patterns explain little the brightest spots of cells tell bits from lamps."""
    apart = {}
    for name, light in (
        ("bits", BITS),
        ("lamps", torch.rand(8, 8, generator=torch.Generator().manual_seed(5))),
    ):
        drawn = [evidence_of(150 * light, moved_cells(seed)) for seed in range(6)]
        apart[name] = float(np.mean(drawn))
    assert apart["bits"] > apart["lamps"] + 1.0


def test_of_panels_that_overlap_the_likeliest_is_kept():
    square = torch.tensor([[0.0, 0.0], [80.0, 0.0], [80.0, 80.0], [0.0, 80.0]]).double()
    quads = torch.stack(
        [square, square + 2.0, square + 20.0, square + 200.0, square * torch.nan]
    )
    logit = torch.tensor([1.0, 2.0, 0.0, -1.0, 9.0])
    kept, told = distinct(quads, logit, SHAPE, 9)
    assert told.tolist() == [2.0, 0.0, -1.0]
    assert distinct(quads, logit, SHAPE, 9, 0.35)[1].tolist() == [2.0, -1.0]
    assert torch.equal(kept[0], square + 2.0)
    assert len(distinct(quads, logit, SHAPE, 1)[0]) == 1


def test_settings_are_kept():
    locator = LearnedLocator(false_alarms=0.01)
    assert locator_from(locator_settings(locator)) == locator
    assert locator_named("learned", PaperLocator()) == LearnedLocator()


def test_a_crop_gives_sensor_coordinates(noisy):
    frames, _ = noisy
    window = Frames(
        frames.grey[:1, :, 16:, 32:], torch.tensor([[32, 16]]), frames.sensor_px
    )
    whole, cut = (
        LearnedLocator()(one, SHAPE).corners_px for one in (frames[:1], window)
    )
    assert (whole - cut).abs().max() < 0.3


def damaged(text):
    """Ways in which a file of weights may be wrong, and what is said."""
    content = json.loads(text)
    name = next(iter(content["classifier"]))
    yield text.replace('"judge.', '"other.'), "its checksum does not fit"
    yield text[: len(text) // 2], "damaged or of another kind"
    yield json.dumps({**content, "version": 99}), "format version 99"
    content["classifier"][name]["shape"] = [1]
    yield json.dumps(content), "checksum"


def test_damaged_weights_are_refused(tmp_path):
    text = (resources.files("vocc_torch.receiver") / SHIPPED).read_text()
    for number, (wrong, said) in enumerate(damaged(text)):
        path = tmp_path / f"{number}.json"
        path.write_text(wrong)
        with pytest.raises(VoccError, match=f"weights .*{said}"):
            LearnedLocator(str(path))(torch.zeros(1, 64, 64, dtype=torch.uint8), SHAPE)


def test_weights_of_another_kind_are_refused(tmp_path):
    net = PanelNet()
    with torch.no_grad():
        net.judge[0].bias[0] = torch.nan
    save_weights(tmp_path / "nan.json", net)
    for path in (tmp_path / "nan.json", tmp_path / "missing.json"):
        with pytest.raises(VoccError, match=r"weights .*(damaged|does not exist)"):
            LearnedLocator(str(path))(torch.zeros(1, 64, 64, dtype=torch.uint8), SHAPE)
    with pytest.raises(VoccError, match="false_alarms is 0: it must be above 0"):
        LearnedLocator(false_alarms=0)


def test_the_weights_are_small():
    assert (resources.files("vocc_torch.receiver") / SHIPPED).stat().st_size < 2_000_000
    assert sum(one.numel() for one in PanelNet().parameters()) < 300_000
