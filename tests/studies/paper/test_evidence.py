"""The figures' data hold against computations that share no code with them."""

import dataclasses

import cv2
import numpy as np
import pytest
import torch
from evidence_plans import make_plan
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.metrics import roc_auc_score

from vocc_torch.errors import VoccError
from vocc_torch.measure.plan import World
from vocc_torch.simulation import Camera, LedPanel
from vocc_torch.studies.paper.evidence import EVIDENCE, make_evidence
from vocc_torch.studies.paper.evidence.base import Source, paper_scene
from vocc_torch.studies.paper.evidence.features import least_error, roc_area, separable
from vocc_torch.studies.paper.evidence.greys import most_contradicting
from vocc_torch.studies.paper.evidence.scenes import PAPER_SCENES, BlurOrder, grey_levels, scene_of_contrast
from vocc_torch.types import PanelShape, Scene

GAMMA = 2.2
PICTURED = [name for name in EVIDENCE if name != "fig25"]
"""Fig. 25 is measured with a clock, and has tests of its own."""


@pytest.fixture(scope="module")
def source():
    return Source(make_plan())


@pytest.fixture(scope="module")
def plan(source):
    return source.plan


@pytest.fixture(scope="module")
def sample(source):
    return source.sample


@pytest.fixture(scope="module")
def data(source):
    return {name: EVIDENCE[name].compute(source) for name in PICTURED}


# --- discriminability


levels_and_bits = st.lists(st.tuples(st.integers(0, 6), st.booleans()), min_size=2, max_size=40).filter(
    lambda pairs: len({bit for _, bit in pairs}) == 2
)


@settings(max_examples=150, deadline=None)
@given(levels_and_bits)
def test_the_area_is_scikit_learns_ties_included(pairs):
    values, bits = (np.array(part) for part in zip(*pairs, strict=True))
    assert roc_area(values.astype(float), bits) == pytest.approx(roc_auc_score(bits, values), abs=1e-12)


@settings(max_examples=150, deadline=None)
@given(levels_and_bits)
def test_no_threshold_has_fewer_errors_than_the_least(pairs):
    values, bits = (np.array(part) for part in zip(*pairs, strict=True))
    share, threshold = least_error(values.astype(float), bits)
    tried = [np.mean((values >= level) != bits) for level in np.arange(-0.5, 7.5)]
    assert share == pytest.approx(min(tried))
    assert np.mean((values >= threshold) != bits) == pytest.approx(share)


@settings(max_examples=100, deadline=None)
@given(levels_and_bits)
def test_one_number_is_separable_where_its_values_do_not_overlap(pairs):
    values, bits = (np.array(part) for part in zip(*pairs, strict=True))
    on, off = values[bits], values[~bits]
    apart = on.min() > off.max() or off.min() > on.max()
    assert separable(values.astype(float)[:, None], bits) == apart


@pytest.mark.parametrize("gap", [-1e-3, 1e-3])
def test_a_line_is_found_in_any_direction_where_there_is_one_and_only_then(gap):
    rng = np.random.default_rng(7)
    for angle in rng.uniform(0, 2 * np.pi, 20):
        along, bits = rng.uniform(-1, 1, 500), rng.random(500) < 0.5
        # The nearest of each side meet at the same place along the edge.
        along[:2], bits[:2] = 0.0, (True, False)
        across = np.where(bits, 1, -1) * rng.uniform(gap, 1, 500)
        across[0], across[1] = gap, -gap
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        given_values = np.column_stack([along, across]) @ turn * (3.0, 40.0) + (100.0, -2.0)
        if gap > 0:
            assert separable(given_values, bits)
        else:
            # Mirror images: the hulls overlap, whatever the direction.
            mirrored = np.concatenate([given_values, given_values])
            assert not separable(mirrored, np.concatenate([bits, ~bits]))


def test_one_status_alone_is_refused():
    for judge in (roc_area, least_error, lambda values, bits: separable(values[:, None], bits)):
        with pytest.raises(VoccError, match="0 Off"):
            judge(np.ones(3), np.ones(3, dtype=bool))


def test_pairs_are_scored_along_scikit_learns_direction(data):
    shown = data["fig12"]
    for name, (first, second, threshold) in shown.lines.items():
        x = np.stack([shown.values[part].ravel() for part in name.split("+")], axis=1)
        on = shown.sample.bits.ravel()
        reference = LinearDiscriminantAnalysis(solver="eigen").fit(x, on)
        w = reference.coef_[0]
        assert abs(first * w[1] - second * w[0]) < 1e-6 * np.hypot(first, second) * np.hypot(*w)
        middle = (x[on].mean(axis=0) + x[~on].mean(axis=0)) / 2
        assert threshold == pytest.approx(middle @ [first, second], rel=1e-9)
        np.testing.assert_allclose(shown.values[name].ravel(), x @ [first, second] - threshold, atol=1e-9)


# --- the sample


def test_the_sample_does_not_depend_on_the_batch(sample):
    parts = Source(dataclasses.replace(make_plan(), batch_frames=7)).sample
    for name in ("bits", "greys", "thresholds", "features"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(sample, name))


def test_pictures_lie_where_their_extent_says(plan, sample):
    simulator = plan.world.simulator()
    frames = simulator.render(sample.scene, torch.from_numpy(sample.bits), nearest_m=30.0)
    centres = plan.receiver.reader.read_greys(frames, simulator.true_panels(sample.scene)).centre.numpy()
    for index, (grey, (left, right, bottom, top)) in enumerate(sample.pictures):
        rows = ((np.arange(8) + 0.5 - top) / (bottom - top) * grey.shape[0]).astype(int)
        columns = ((np.arange(8) + 0.5 - left) / (right - left) * grey.shape[1]).astype(int)
        np.testing.assert_array_equal(grey[np.ix_(rows, columns)], centres[index])


# --- Fig. 4


def test_the_two_frames_contradict_each_other_most(data, sample):
    shown = data["fig04"]
    on = [values[bits] for values, bits in zip(sample.greys, sample.bits, strict=True)]
    off = [values[~bits] for values, bits in zip(sample.greys, sample.bits, strict=True)]
    gaps = {(a, b): off[b].min() - on[a].max() for a in range(100) for b in range(100)}
    assert shown.pair == max(gaps, key=gaps.get)
    assert gaps[shown.pair] > 0
    contradicting = np.mean([a.mean() < b.mean() for a in on for b in off])
    assert shown.findings()["contradicting_pairs_share"] == pytest.approx(contradicting)


def test_frames_of_one_status_are_not_compared():
    seen = np.array([[[10.0, 10.0]], [[100.0, 50.0]], [[250.0, 240.0]]])
    bits = np.array([[[True, True]], [[True, False]], [[False, False]]])
    assert most_contradicting(seen, bits) == (1, 1)
    with pytest.raises(VoccError, match="both On and Off"):
        most_contradicting(seen[:1], bits[:1])


# --- Figs 5, 6 and 17


def test_the_marked_led_is_off_and_misleads_most(data, sample):
    shown = data["fig05_06"]
    misread = []
    for frame in range(100):
        for row, column in np.argwhere(~sample.bits[frame]):
            misread.append((sample.greys[frame, row, column] - sample.thresholds[frame], row, column))
    worst = max(misread)
    found, margins = shown.findings(), [margin for margin, _, _ in misread]
    assert not sample.bits[shown.frame][shown.led]
    assert (found["grey_with_blooming"] - found["threshold"], *shown.led) == pytest.approx(worst)
    assert found["grey_without_blooming"] < found["threshold"]
    assert found["misread_off_leds"] == np.sum(np.array(margins) >= 0)
    assert found["misread_off_share"] == pytest.approx(np.mean(np.array(margins) >= 0))


def test_both_orders_are_scipys_gaussian():
    raw = {"attenuation": {"visibility_m": 40_000.0}, "blooming": {"sigma_px": 1.5}}
    shown = BlurOrder.compute(Source(make_plan(world=World(device="cpu", effects=raw, dtype=torch.float64))))
    after, before, sharp = (grey for grey, _ in shown.pictures)
    blurred = ndimage.gaussian_filter(sharp, 1.5, mode="nearest", truncate=4)
    np.testing.assert_allclose(after, blurred, atol=1e-9)
    linear = ndimage.gaussian_filter(sharp**GAMMA, 1.5, mode="nearest", truncate=4)
    np.testing.assert_allclose(before, linear ** (1 / GAMMA), atol=1e-6)


@pytest.mark.parametrize("name", ["fig05_06", "fig17"])
def test_without_blooming_there_is_nothing_to_show(name):
    with pytest.raises(VoccError, match="no blooming"):
        EVIDENCE[name].compute(Source(make_plan(world=World(device="cpu", effects={"saturation": {}}))))


# --- Fig. 9


def test_gri_is_the_mean_of_the_drawn_vectors(data, sample):
    shown = data["fig09"]
    dots = [(shown.cell(shown.slopes, led) * shown.inward).sum(axis=0).mean() for led in (0, 1)]
    np.testing.assert_allclose(dots, shown.gri, rtol=1e-5)
    np.testing.assert_allclose(np.hypot(*shown.inward), 1, atol=1e-12)


def test_gradients_are_scipys_sobel_a_pixel(data):
    shown = data["fig09"]
    k = shown.inward.shape[-1]
    for led in range(2):
        for part, axis in ((0, 1), (1, 0)):
            slope = ndimage.sobel(shown.cell(shown.grey, led, around=k), axis=axis) / 8 * k / shown.cell_px
            drawn = shown.cell(shown.slopes[part], led)
            np.testing.assert_allclose(slope[k : 2 * k, k : 2 * k], drawn, atol=1e-4)


def test_the_drawn_leds_have_their_status_and_the_middle_gri(data, sample):
    shown = data["fig09"]
    frame = shown.frame
    for led, status in enumerate((True, False)):
        values = sample.features[frame, ..., 1][sample.bits[frame] == status]
        assert sample.bits[frame][shown.leds[led]] == status
        assert np.sum(values < shown.gri[led]) == (len(values) - 1) // 2


# --- Figs 13 and 14


def test_w_and_the_threshold_follow_equations_14_and_19(data):
    shown = data["fig13_14"]
    on, off = shown.features[shown.bits], shown.features[~shown.bits]
    m1, m0 = on.mean(axis=0), off.mean(axis=0)
    within = (on - m1).T @ (on - m1) + (off - m0).T @ (off - m0)
    w = np.linalg.solve(within, m1 - m0) * len(shown.bits)
    np.testing.assert_allclose(shown.direction, w, rtol=1e-8)
    assert shown.threshold == pytest.approx(w @ (m0 + m1) / 2)
    np.testing.assert_allclose(shown.deviation, np.sqrt(np.diag(within) / len(shown.bits)), rtol=1e-9)
    pair = np.linalg.solve(within[:2, :2], (m1 - m0)[:2]) * len(shown.bits)
    np.testing.assert_allclose(shown.pair_direction, pair, rtol=1e-8)


# --- Fig. 19


def whole_frame(plan):
    simulator = dataclasses.replace(plan.world, framing="full").simulator()
    bits = Source(plan).bits("histogram")
    return simulator.render(paper_scene(), bits).grey[0, 0].numpy(), bits[0].numpy()


def test_the_histogram_and_its_threshold_are_those_of_the_whole_frame(plan, data):
    shown = data["fig19"]
    grey, _ = whole_frame(plan)
    np.testing.assert_array_equal(shown.counts, np.bincount(grey.ravel(), minlength=256))
    threshold, mask = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    assert shown.threshold == int(threshold)
    assert shown.mask.sum() == np.count_nonzero(mask)


def test_cells_are_sorted_by_status(plan, data):
    shown = data["fig19"]
    grey, bits = whole_frame(plan)
    corners = plan.world.simulator().true_panels(paper_scene()).corners_px[0].numpy()
    on, off = np.zeros(256), np.zeros(256)
    cell = (corners[2] - corners[0]) / 8
    (left, top), (right, bottom) = np.floor(corners[0]).astype(int), np.ceil(corners[2]).astype(int)
    for row in range(top - 1, bottom + 1):
        for column in range(left - 1, right + 1):
            x, y = (np.array([column, row]) + 0.5 - corners[0]) / cell
            if 0 <= x < 8 and 0 <= y < 8:
                (on if bits[int(y), int(x)] else off)[grey[row, column]] += 1
    np.testing.assert_array_equal(shown.on_counts, on)
    np.testing.assert_array_equal(shown.off_counts, off)


def test_the_levels_follow_from_reflectances_and_agree_with_the_contrast(plan):
    scene = Scene.of(ambient_lx=32000.0, led_luminance_cd_m2=2000.0, background_grey=90.0)
    background, off, on = grey_levels(plan, scene)
    assert background == pytest.approx(90)
    assert off == pytest.approx(90 * (0.4 / 0.18) ** (1 / GAMMA))
    reflected = 32000 * 0.4 / np.pi
    assert on == pytest.approx(off * (1 + 2000 / reflected) ** (1 / GAMMA))
    clear = {name: one for name, one in plan.world.effects.items() if name != "attenuation"}
    contrast = float(dataclasses.replace(plan.world, effects=clear).simulator().contrast(scene))
    assert (on - off) / 255 == pytest.approx(contrast, rel=1e-9)


def test_a_clamped_iso_moves_the_levels():
    night = make_plan(world=World(device="cpu", camera=Camera(iso_limits=(100.0, 200.0))))
    levels = grey_levels(night, Scene.of(ambient_lx=1000.0))
    assert levels[0] < 60


# --- Fig. 20


def test_contrasts_are_those_of_equations_1_to_3(data):
    shown = data["fig20"]
    air = np.exp(-3.91 * 50 / 40_000)
    for index in range(6):
        ambient, luminance, _, background = shown.conditions[index]
        off = background * (0.4 / 0.18) ** (1 / GAMMA)
        on = min(255.0, off * (1 + luminance * air * np.pi / (0.4 * ambient)) ** (1 / GAMMA))
        assert shown.contrasts[index] == pytest.approx((on - off) / 255, abs=1e-9)
    np.testing.assert_allclose(shown.contrasts[3:], [wanted for wanted, _, _ in PAPER_SCENES], atol=1e-9)


def test_a_contrast_beyond_white_gives_the_highest_there_is(plan):
    simulator = plan.world.simulator()
    scene = scene_of_contrast(simulator, Scene.of(background_grey=110.0), 0.9, 86.0)
    assert float(scene.background_grey) == 86
    off = 86 * (0.4 / 0.18) ** (1 / GAMMA)
    assert float(simulator.contrast(scene)) == pytest.approx((255 - off) / 255)


# --- files and names


@pytest.mark.parametrize("name", PICTURED)
def test_rows_have_a_head_and_its_width(data, name):
    head, *lines = data[name].rows()
    assert all(isinstance(column, str) for column in head)
    assert len(set(head)) == len(head)
    assert lines
    assert all(len(line) == len(head) for line in lines)
    assert all(np.isfinite(cell) for line in lines for cell in line if not isinstance(cell, str))

    found = data[name].findings()
    assert found
    assert all(isinstance(value, int | float) and np.isfinite(value) for value in found.values())


def test_figures_are_made_whole(tmp_path):
    made = list(make_evidence(make_plan(), tmp_path / "figures", ["fig17"]))
    assert [figure.evidence.name for figure in made] == ["fig17"]
    assert sorted(path.name for path in (tmp_path / "figures").iterdir()) == ["fig17.csv", "fig17.png"]
    np.testing.assert_array_equal(cv2.imread(str(made[0].picture))[..., ::-1], made[0].pixels)
    assert made[0].pixels.shape[1:] == (1200, 3)
    assert made[0].pixels.dtype == np.uint8
    assert made[0].findings == EVIDENCE["fig17"].compute(Source(make_plan())).findings()


def test_an_unknown_name_is_refused_before_any_work(tmp_path):
    with pytest.raises(VoccError, match=r"'fig21' is not a figure: known are fig04, .*, fig25$"):
        make_evidence(make_plan(), tmp_path, ["fig04", "fig21"])
    assert not list(tmp_path.iterdir())


def test_another_panel_will_do():
    shape = PanelShape(2, 3)
    world = World(device="cpu", panel=LedPanel(shape=shape))
    reader = dataclasses.replace(make_plan().receiver.reader, shape=shape, samples_per_led=5)
    small = Source(make_plan(world=world, reader=reader))
    for name in ("fig05_06", "fig09", "fig20"):
        assert EVIDENCE[name].compute(small).findings()
    assert EVIDENCE["fig19"].compute(small).counts.sum() == 1920 * 1080
