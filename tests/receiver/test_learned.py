import json
from dataclasses import replace
from importlib import resources

import cv2
import numpy as np
import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.receiver.lattice_locator import LatticeLocator
from vocc_torch.receiver.lattice_search import Pyramid
from vocc_torch.receiver.learned import SHIPPED, LearnedLocator, distinct, evidence, placings, save_weights
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.receiver.locators import locator_from, locator_named, locator_settings
from vocc_torch.receiver.panel_net import CONTEXT, SAMPLES, PanelNet
from vocc_torch.receiver.tracker import Tracker
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import Camera, Simulator
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import Frames, PanelShape, Scene

SHAPE = PanelShape(8, 8)
SMALL = Camera(width_px=320, height_px=240, sensor_width_mm=320 * 13.2 / 1920)


@pytest.fixture(scope="module")
def noisy():
    """Eight noisy frames of the paper's panel at 30 to 65 m, and the true corners."""
    draw, count = np.random.default_rng(3), 8
    given = {"distance_m": np.linspace(30, 65, count), "offset_x_m": draw.uniform(-1, 1, count)}
    scene = Scene.of(count, ambient_lx=4000.0)
    parts = [
        torch.from_numpy(given[n]) if n in given else getattr(scene, n) for n in scene.__dataclass_fields__
    ]
    noise = {
        "photoelectrons": {"quantum_efficiency": 0.6},
        "shot_noise": {},
        "read_noise": {"electrons": 3.0},
    }
    simulator = Simulator(SMALL, effects={**PAPER_EFFECTS, **noise, "gain": {}}, framing="full")
    keys = [FrameKey(BlockKey(0, "learned", 0), i) for i in range(count)]
    bits = torch.from_numpy(draw.random((count, 8, 8)) < 0.5)
    return simulator.render(Scene(*parts), bits, keys=keys), simulator.true_panels(Scene(*parts))


def test_the_shipped_weights_find_most_panels_in_noise(noisy):
    """With one false alarm in twenty frames allowed; what is found is where the panel is."""
    frames, truth = noisy
    panels = LearnedLocator()(frames, SHAPE)
    assert panels.found.sum() >= 6
    assert (panels.false_alarms[panels.found] <= 1e-3).all()
    pitch = (truth.corners_px[:, 1] - truth.corners_px[:, 0]).norm(dim=1) / 8
    off = (panels.corners_px - truth.corners_px).norm(dim=2).amax(1) / pitch
    assert (off[panels.found] < 0.25).all()


def test_weights_of_ones_own_are_followed_and_state_no_false_alarms(noisy, tmp_path):
    """Found is then what the last network calls likelier than not."""
    mine = tmp_path / "mine.json"
    mine.write_bytes(resources.files("vocc_torch.receiver").joinpath(SHIPPED).read_bytes())
    locator, frame = LearnedLocator(weights=str(mine)), noisy[0][:1]
    seen = locator.sightings(frame, SHAPE)
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
        Scene.of(*shape, ambient_lx=4000.0), distance_m=torch.tensor([60.0, 70.0]).double().repeat(4)
    )
    bits = torch.from_numpy(draw.random((*shape, 8, 8)) < 0.5)
    told = {}
    for framing in ("crop", "filled"):
        simulator = Simulator(camera, framing=framing)
        told[framing] = LearnedLocator()(simulator.render(scene, bits), SHAPE)
        off = (told[framing].corners_px - simulator.true_panels(scene).corners_px).abs().amax((1, 2))
        assert bool(told[framing].found.all())
        assert bool((off < 0.25 * 3).all())
    assert (told["crop"].corners_px - told["filled"].corners_px).abs().max() < 0.1


@pytest.mark.parametrize(
    ("shape", "turn_deg", "pitch_px"), [(SHAPE, 38.0, 9.0), (PanelShape(16, 64), 6.0, 5.0)]
)
def test_turned_and_large_panels_are_found(shape, turn_deg, pitch_px):
    """Turned further than in a street, and of many more LEDs than a window shows."""
    draw = np.random.default_rng(6)
    lit = np.pad(draw.random((shape.rows, shape.columns)) < 0.5, 1)
    disc = np.hypot(*(np.mgrid[:16, :16] - 7.5)) < 6
    board = np.kron(lit, 170 * disc) + 40.0
    scale = pitch_px / 16
    matrix = cv2.getRotationMatrix2D((board.shape[1] / 2, board.shape[0] / 2), -turn_deg, scale)
    size = (460, 300)
    matrix[:, 2] += np.array(size) / 2 - np.array(board.shape[::-1]) / 2
    wall = 110 + 6 * draw.normal(size=(75, 115)).repeat(4, 0).repeat(4, 1)
    seen = cv2.GaussianBlur(board, (0, 0), 0.5 / scale)
    grey = cv2.warpAffine(seen, matrix, size, wall.copy(), cv2.INTER_LINEAR, cv2.BORDER_TRANSPARENT)
    grey = grey + draw.normal(0, 2, grey.shape)
    corners = 16 * (1 + np.array([[0, 0], [shape.columns, 0], [shape.columns, shape.rows], [0, shape.rows]]))
    truth = (corners - 0.5) @ matrix[:, :2].T + matrix[:, 2] + 0.5
    picture = torch.from_numpy(grey.clip(0, 255).round().astype(np.uint8))
    panels = LearnedLocator(false_alarms=0.01)(picture[None], shape)
    assert panels.found.tolist() == [True]
    assert np.abs(panels.corners_px[0].numpy() - truth).max() < 0.25 * pitch_px


@pytest.mark.parametrize("pitch_px", [3, 16])
def test_a_panel_that_fills_the_picture_is_found(pitch_px):
    """Nothing is seen around it, as in a picture that was cut at its edge."""
    draw, seen = np.random.default_rng(2), 0
    disc = np.hypot(*(np.mgrid[:16, :16] - 7.5)) < 6
    for _ in range(4):
        board = cv2.GaussianBlur(np.kron(draw.random((8, 8)) < 0.5, 170.0 * disc) + 40, (0, 0), 4)
        grey = cv2.resize(board, (8 * pitch_px, 8 * pitch_px), interpolation=cv2.INTER_AREA)
        grey = (grey + draw.normal(0, 1, grey.shape)).clip(0, 255).round().astype(np.uint8)
        panels = LearnedLocator(false_alarms=0.01)(torch.from_numpy(grey)[None], SHAPE)
        truth = 8 * pitch_px * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
        off = np.abs(panels.corners_px[0].numpy() - truth).max()
        seen += bool(panels.found[0]) and off < 0.25 * pitch_px
    assert seen >= 3


@pytest.mark.parametrize("level", [0, 90, 255])
def test_nothing_is_found_where_nothing_is(level):
    panels = LearnedLocator()(torch.full((2, 96, 128), level, dtype=torch.uint8), SHAPE)
    assert not panels.found.any()
    assert not panels.corners_px.any()


@pytest.mark.parametrize("locator", [LearnedLocator(), LatticeLocator()])
@pytest.mark.parametrize("size", [(1, 1), (2, 30), (8, 8), (11, 200), (12, 12)])
def test_in_a_picture_of_few_pixels_nothing_is_found(locator, size):
    noise = torch.randint(0, 256, (2, *size), generator=torch.Generator().manual_seed(3)).to(torch.uint8)
    assert not locator(noise, SHAPE).found.any()


def test_the_panel_network_sees_placings_where_they_are():
    """A change of one cell changes what is judged of the placings that hold it or border on it alone."""
    torch.manual_seed(0)
    net, shape, reach = PanelNet().eval(), PanelShape(4, 6), 4
    margin = reach + CONTEXT
    dark = torch.rand(1, (4 + 2 * margin) * SAMPLES, (6 + 2 * margin) * SAMPLES) * 100
    lit, pitch = dark.clone(), torch.full((1,), 4.0)
    lit[:, : 2 * SAMPLES, :SAMPLES] += 50  # the margin's upper left corner, outside what norms the light
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

    quad = torch.tensor([[[40.0, 30.0], [72.0, 30.0], [72.0, 46.0], [40.0, 46.0]]]).double()
    scales = Pyramid.of(torch.rand(1, 1, 90, 120), 24)
    placed, logit = placings(Sure(), scales, quad, PanelShape(8, 16), 2, moved=True)
    assert logit.tolist() == [3.0]
    assert torch.allclose(placed - quad, torch.tensor([[-2.0, 5.0], [-2, 4], [-2, 4], [-2, 4]]).double())


def test_dots_by_a_rule_are_less_evidence_than_random_bits():
    """As sure as the network may be, lamps in rows are no panel."""
    across = torch.arange(8)
    rule = ~((across % 2 == 1)[:, None] & (across % 2 == 1))
    told = []
    for bits in (torch.rand(8, 8, generator=torch.Generator().manual_seed(2)) < 0.5, rule):
        grey = torch.full((1, 1, 90, 100), 20.0)
        spot = torch.zeros(6, 6)
        spot[1:5, 1:5] = 150.0
        grey[0, 0, 20:68, 30:78] += torch.kron(bits.float(), spot)
        quad = torch.tensor([[[30.0, 20.0], [78.0, 20.0], [78.0, 68.0], [30.0, 68.0]]]).double()
        scales, logit = Pyramid.of(grey, 12), torch.tensor([5.0])
        told.append(
            [float(evidence(scales, quad, logit, torch.tensor([one]), SHAPE)) for one in (0.0, 0.9, 0.99)]
        )
    (none, few, most), (ruled, *_) = told
    assert none > 5
    assert few == none < most - 2
    assert ruled < none - 8


def test_lamps_that_all_shine_are_less_evidence_than_bits_that_need_no_round_spots():
    """An array of 4 x 4 lamps is a perfect lattice of round spots, but of one level."""
    draw = torch.Generator().manual_seed(4)
    spot = torch.zeros(6, 6)
    spot[1:5, 1:5] = 150.0
    quad, told = torch.tensor([[[30.0, 20.0], [54.0, 20.0], [54.0, 44.0], [30.0, 44.0]]]).double(), []
    lamps = 1 + 0.05 * torch.randn(4, 4, generator=draw)
    bits = torch.tensor([[1, 0, 0, 1], [0, 1, 0, 0], [1, 1, 0, 1], [0, 0, 1, 0]]).float()
    for light, spots in ((bits, 0.0), (lamps, 0.999)):
        grey = 20 + torch.randn(1, 1, 90, 100, generator=draw)
        grey[0, 0, 20:44, 30:54] += torch.kron(light, spot)
        scales = Pyramid.of(grey, 6)
        told.append(
            float(evidence(scales, quad, torch.tensor([7.0]), torch.tensor([spots]), PanelShape(4, 4)))
        )
    assert told[0] > told[1] + 2


def test_of_panels_that_overlap_the_likeliest_is_kept():
    square = torch.tensor([[0.0, 0.0], [80.0, 0.0], [80.0, 80.0], [0.0, 80.0]]).double()
    quads = torch.stack([square, square + 2.0, square + 20.0, square + 200.0, square * torch.nan])
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
    window = Frames(frames.grey[:1, :, 16:, 32:], torch.tensor([[32, 16]]), frames.sensor_px)
    whole, cut = (LearnedLocator()(one, SHAPE).corners_px for one in (frames[:1], window))
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
        with pytest.raises(VoccError, match=said):
            LearnedLocator(str(path))(torch.zeros(1, 64, 64, dtype=torch.uint8), SHAPE)


def test_weights_of_another_kind_are_refused(tmp_path):
    net = PanelNet()
    with torch.no_grad():
        net.judge[0].bias[0] = torch.nan
    save_weights(tmp_path / "nan.json", net)
    for path in (tmp_path / "nan.json", tmp_path / "missing.json"):
        with pytest.raises(VoccError, match=r"model .*(damaged|does not exist)"):
            LearnedLocator(str(path))(torch.zeros(1, 64, 64, dtype=torch.uint8), SHAPE)
    with pytest.raises(VoccError, match="false_alarms is 0: it must be above 0"):
        LearnedLocator(false_alarms=0)


def test_the_weights_are_small():
    assert (resources.files("vocc_torch.receiver") / SHIPPED).stat().st_size < 2_000_000
    assert sum(one.numel() for one in PanelNet().parameters()) < 300_000
