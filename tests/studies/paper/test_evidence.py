"""The figures' data hold against computations that share no code with them; drawings show the data."""

import copy
import dataclasses

import cv2
import numpy as np
import pytest
import torch
from evidence_plans import make_plan
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.colors import to_hex
from matplotlib.quiver import Quiver
from scipy import ndimage
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.metrics import roc_auc_score

from vocc_torch.errors import VoccError
from vocc_torch.measure.plan import World
from vocc_torch.report.canvas import figure_pixels
from vocc_torch.simulation import Camera, LedPanel
from vocc_torch.studies.paper import evidence, words
from vocc_torch.studies.paper.evidence import Source, paper_scene
from vocc_torch.studies.paper.evidence.features import least_error, roc_area, separable
from vocc_torch.studies.paper.evidence.frames import grey_levels
from vocc_torch.studies.paper.evidence.panels import (
    PAPER_SCENES,
    BlurOrder,
    most_contradicting,
    scene_of_contrast,
)
from vocc_torch.studies.paper.figures import EVIDENCE
from vocc_torch.types import PanelShape, Scene

GAMMA, FRAMES = 2.2, 40
PICTURED = [name for name in EVIDENCE if name != "fig25"]
"""Fig. 25 is measured with a clock, and has tests of its own."""


@pytest.fixture(scope="module")
def source():
    return Source(make_plan(), FRAMES)


@pytest.fixture(scope="module")
def plan(source):
    return source.plan


@pytest.fixture(scope="module")
def sample(source):
    return source.sample


@pytest.fixture(scope="module")
def data(source):
    return {name: EVIDENCE[name](source) for name in PICTURED}


@pytest.fixture(scope="module")
def figures(data):
    """Every figure, laid out."""
    drawn = {name: one.draw() for name, one in data.items()}
    for figure in drawn.values():
        figure_pixels(figure)
    return drawn


# --- discriminability


levels_and_bits = st.lists(st.tuples(st.integers(0, 6), st.booleans()), min_size=2, max_size=40).filter(
    lambda pairs: len({bit for _, bit in pairs}) == 2
)


@settings(max_examples=60, deadline=None)
@given(levels_and_bits)
def test_areas_and_thresholds_are_scikit_learns_and_those_of_a_search(pairs):
    values, bits = (np.array(part) for part in zip(*pairs, strict=True))
    assert roc_area(values.astype(float), bits) == pytest.approx(roc_auc_score(bits, values), abs=1e-12)
    share, threshold = least_error(values.astype(float), bits)
    assert share == pytest.approx(min(np.mean((values >= level) != bits) for level in np.arange(-0.5, 7.5)))
    assert np.mean((values >= threshold) != bits) == pytest.approx(share)
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
        w = LinearDiscriminantAnalysis(solver="eigen").fit(x, on).coef_[0]
        assert abs(first * w[1] - second * w[0]) < 1e-6 * np.hypot(first, second) * np.hypot(*w)
        middle = (x[on].mean(axis=0) + x[~on].mean(axis=0)) / 2
        assert threshold == pytest.approx(middle @ [first, second], rel=1e-9)
        np.testing.assert_allclose(shown.values[name].ravel(), x @ [first, second] - threshold, atol=1e-9)


# --- the sample


def test_the_sample_does_not_depend_on_the_batch(sample):
    parts = Source(dataclasses.replace(make_plan(), batch_frames=7), FRAMES).sample
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


# --- Figs 4 to 6 and 17


def test_the_two_frames_contradict_each_other_most(data, sample):
    shown = data["fig04"]
    on = [values[bits] for values, bits in zip(sample.greys, sample.bits, strict=True)]
    off = [values[~bits] for values, bits in zip(sample.greys, sample.bits, strict=True)]
    gaps = {(a, b): off[b].min() - on[a].max() for a in range(FRAMES) for b in range(FRAMES)}
    assert shown.pair == max(gaps, key=gaps.get)
    contradicting = np.mean([a.mean() < b.mean() for a in on for b in off])
    assert shown.findings["contradicting_pairs_share"] == pytest.approx(contradicting)


def test_frames_of_one_status_are_not_compared():
    seen = np.array([[[10.0, 10.0]], [[100.0, 50.0]], [[250.0, 240.0]]])
    bits = np.array([[[True, True]], [[True, False]], [[False, False]]])
    assert most_contradicting(seen, bits) == (1, 1)
    with pytest.raises(VoccError, match="both On and Off"):
        most_contradicting(seen[:1], bits[:1])


def test_the_marked_led_is_off_and_misleads_most(data, sample):
    shown = data["fig05_06"]
    margins = {
        (frame, row, column): sample.greys[frame, row, column] - sample.thresholds[frame]
        for frame, row, column in np.argwhere(~sample.bits).tolist()
    }
    found, worst = shown.findings, max(margins, key=margins.get)
    assert (shown.frame, *shown.led) == worst
    assert found["grey_with_blooming"] - found["threshold"] == pytest.approx(margins[worst])
    assert found["grey_without_blooming"] < found["threshold"]
    assert found["misread_off_leds"] == sum(margin >= 0 for margin in margins.values())
    assert found["misread_off_share"] == pytest.approx(found["misread_off_leds"] / len(margins))


def test_both_orders_are_scipys_gaussian():
    raw = {"attenuation": {"visibility_m": 40_000.0}, "blooming": {"sigma_px": 1.5}}
    shown = BlurOrder(Source(make_plan(world=World(device="cpu", effects=raw, dtype=torch.float64))))
    after, before, sharp = (grey for grey, _ in shown.pictures)
    blurred = ndimage.gaussian_filter(sharp, 1.5, mode="nearest", truncate=4)
    np.testing.assert_allclose(after, blurred, atol=1e-9)
    linear = ndimage.gaussian_filter(sharp**GAMMA, 1.5, mode="nearest", truncate=4)
    np.testing.assert_allclose(before, linear ** (1 / GAMMA), atol=1e-6)


@pytest.mark.parametrize("name", ["fig05_06", "fig17"])
def test_without_blooming_there_is_nothing_to_show(name):
    with pytest.raises(VoccError, match="no blooming"):
        EVIDENCE[name](Source(make_plan(world=World(device="cpu", effects={"saturation": {}}))))


# --- Fig. 9


def test_vectors_are_scipys_sobel_a_pixel_and_gri_is_their_mean(data, sample):
    shown = data["fig09"]
    k = shown.inward.shape[-1]
    np.testing.assert_allclose(np.hypot(*shown.inward), 1, atol=1e-12)
    for led, status in enumerate((True, False)):
        for part, axis in ((0, 1), (1, 0)):
            slope = ndimage.sobel(shown.cell(shown.grey, led, around=k), axis=axis) / 8 * k / shown.cell_px
            drawn = shown.cell(shown.slopes[part], led)
            np.testing.assert_allclose(slope[k : 2 * k, k : 2 * k], drawn, atol=1e-4)
        gri = (shown.cell(shown.slopes, led) * shown.inward).sum(axis=0).mean()
        assert shown.findings[f"gri_{'on' if status else 'off'}"] == pytest.approx(gri, rel=1e-5)
        values = sample.features[shown.frame, ..., 1][sample.bits[shown.frame] == status]
        assert sample.bits[shown.frame][shown.leds[led]] == status
        assert np.sum(values < gri - 1e-4) == (len(values) - 1) // 2


# --- Figs 13 and 14


def test_w_and_the_threshold_follow_equations_14_and_19(data):
    shown = data["fig13_14"]
    on, off = shown.features[shown.bits], shown.features[~shown.bits]
    m1, m0 = on.mean(axis=0), off.mean(axis=0)
    within = (on - m1).T @ (on - m1) + (off - m0).T @ (off - m0)
    w = np.linalg.solve(within, m1 - m0) * len(shown.bits)
    np.testing.assert_allclose([shown.findings[f"w_{name}"] for name in ("agr", "gri", "ngr")], w, rtol=1e-8)
    assert shown.findings["threshold"] == pytest.approx(w @ (m0 + m1) / 2)
    np.testing.assert_allclose(shown.deviation, np.sqrt(np.diag(within) / len(shown.bits)), rtol=1e-9)
    np.testing.assert_allclose(shown.projections, shown.features @ w, rtol=1e-8)


# --- Fig. 19


def whole_frame(plan):
    simulator = dataclasses.replace(plan.world, framing="full").simulator()
    bits = Source(plan).bits("histogram")
    return simulator.render(paper_scene(), bits).grey[0, 0].numpy(), bits[0].numpy()


def test_the_histogram_is_that_of_the_whole_frame_with_cells_sorted_by_status(plan, data):
    shown, (grey, bits) = data["fig19"], whole_frame(plan)
    np.testing.assert_array_equal(shown.counts, np.bincount(grey.ravel(), minlength=256))
    threshold, _ = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    assert shown.threshold == int(threshold)
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
    assert on == pytest.approx(off * (1 + 2000 / (32000 * 0.4 / np.pi)) ** (1 / GAMMA))
    clear = {name: one for name, one in plan.world.effects.items() if name != "attenuation"}
    contrast = float(dataclasses.replace(plan.world, effects=clear).simulator().contrast(scene))
    assert (on - off) / 255 == pytest.approx(contrast, rel=1e-9)
    night = make_plan(world=World(device="cpu", camera=Camera(iso_limits=(100.0, 200.0))))
    assert grey_levels(night, Scene.of(ambient_lx=1000.0))[0] < 60


# --- Fig. 20


def test_contrasts_are_those_of_equations_1_to_3(data):
    shown = data["fig20"]
    air = np.exp(-3.91 * 50 / 40_000)
    for index in range(6):
        ambient, luminance, _, background = shown.conditions[index]
        off = background * (0.4 / 0.18) ** (1 / GAMMA)
        on = min(255.0, off * (1 + luminance * air * np.pi / (0.4 * ambient)) ** (1 / GAMMA))
        assert shown.contrasts[index] == pytest.approx((on - off) / 255, abs=1e-9)
    np.testing.assert_allclose(100 * shown.contrasts[3:], list(PAPER_SCENES), atol=1e-7)


def test_a_contrast_beyond_white_gives_the_highest_there_is(plan):
    simulator = plan.world.simulator()
    scene = scene_of_contrast(simulator, Scene.of(background_grey=110.0), 0.9, 86.0)
    assert float(scene.background_grey) == 86
    off = 86 * (0.4 / 0.18) ** (1 / GAMMA)
    assert float(simulator.contrast(scene)) == pytest.approx((255 - off) / 255)


# --- rows and drawings


@pytest.mark.parametrize("name", PICTURED)
def test_rows_have_a_head_and_its_width(data, name):
    head, *lines = data[name].rows
    assert all(isinstance(column, str) for column in head)
    assert len(set(head)) == len(head)
    assert {len(line) for line in lines} == {len(head)}
    numbers = [cell for line in lines for cell in line if not isinstance(cell, str)]
    assert np.isfinite([*numbers, *data[name].findings.values()]).all()


def steps(axes, colour):
    """The outlined stairs of a colour."""
    stairs = (patch for patch in axes.patches if hasattr(patch, "get_data") and not patch.get_fill())
    (patch,) = (patch for patch in stairs if to_hex(patch.get_edgecolor()).upper() == colour)
    return patch.get_data()


@pytest.mark.parametrize("name", PICTURED)
def test_words_fit_are_large_enough_and_leave_the_title_clear(figures, shown_texts, name):
    figure = figures[name]
    width, height = figure.canvas.get_width_height()
    assert width == 1200
    box = figure.get_tightbbox()  # in inches
    assert min(box.x0, box.y0) >= 0
    assert box.x1 <= width / figure.dpi
    assert box.y1 <= height / figure.dpi
    texts = shown_texts(figure)
    assert min(text.get_fontsize() for text in texts) >= 8.5
    assert not any("{" in text.get_text() for text in texts)
    (title,) = (text for text in texts if text.get_text() == words.FIGURES[name]["title"])
    others = [text.get_window_extent() for text in texts if text is not title]
    others += [legend.get_window_extent() for legend in figure.legends]
    assert not any(title.get_window_extent().overlaps(other) for other in others)


def test_panels_are_shown_as_the_camera_wrote_them(figures, data, sample):
    shown = {
        "fig04": [sample.pictures[frame] for frame in data["fig04"].pair],
        "fig05_06": data["fig05_06"].pictures,
        "fig08": sample.pictures[:20],
        "fig20": data["fig20"].pictures,
    }
    for name, wanted in shown.items():
        panels = [axes for axes in figures[name].axes if axes.images]
        for axes, (grey, extent) in zip(panels, wanted, strict=True):
            np.testing.assert_array_equal(np.asarray(axes.images[0].get_array()), grey)
            assert tuple(axes.images[0].get_extent()) == extent
            assert axes.images[0].get_clim() == (0, 255)


@pytest.mark.parametrize(("name", "axes", "value"), [("fig08", -2, "average_grey"), ("fig10", 0, "gri")])
def test_histograms_are_numpys_as_shares_of_each_status(figures, data, name, axes, value):
    values, bits = data[name].values[value], data[name].sample.bits
    for status, _, colour in evidence.STATUS:
        wanted = np.histogram(values[bits == status], np.histogram_bin_edges(values, bins=60))[0]
        drawn = steps(figures[name].axes[axes], colour).values
        np.testing.assert_allclose(drawn, wanted / (bits == status).sum())


@pytest.mark.parametrize(
    ("name", "axes", "x", "y"), [("fig10", 1, "agr", "gri"), ("fig12", 3, "agr+gri+ngr", "ngr")]
)
def test_clouds_hold_every_led_in_its_colour(figures, data, name, axes, x, y):
    cloud, values = figures[name].axes[axes].collections[0], data[name].values
    places, colours = cloud.get_offsets().data, [to_hex(c).upper() for c in cloud.get_facecolors()]
    for status, _, colour in evidence.STATUS:
        chosen = data[name].sample.bits == status
        wanted = np.stack([values[x][chosen], values[y][chosen]], axis=1)
        got = places[[c == colour for c in colours]]
        np.testing.assert_array_equal(got[np.lexsort(got.T)], wanted[np.lexsort(wanted.T)])


def test_fig09_draws_both_fields_and_states_gri(figures, shown_texts, data):
    shown, axes = data["fig09"], figures["fig09"].axes
    gradient, inward, both = (
        [part for part in one.collections if isinstance(part, Quiver)] for one in axes[:3]
    )
    for (quiver,), wanted in ((gradient, shown.cell(shown.slopes, 0)), (inward, shown.inward)):
        drawn = np.stack([quiver.U, quiver.V])
        scale = np.linalg.norm(drawn) / np.linalg.norm(wanted)
        np.testing.assert_allclose(drawn, scale * wanted.reshape(2, -1), rtol=1e-9)
    assert len(both) == 2
    # The picture's rows run down, so an arrow with a positive second part must point down.
    assert np.diff(axes[0].get_ylim()) < 0
    said = "\n".join(text.get_text() for text in shown_texts(figures["fig09"])).replace("\N{MINUS SIGN}", "-")
    assert all(f"GRI {shown.findings[f'gri_{status}']:+.1f}" in said for status in ("on", "off"))


def test_fig19_shows_the_counts_the_threshold_and_the_levels(figures, data):
    (axes, _, foreground), shown = figures["fig19"].axes, data["fig19"]
    colours = ("#5F6368", evidence.ON, evidence.OFF)
    for counts, colour in zip((shown.counts, shown.on_counts, shown.off_counts), colours, strict=True):
        drawn = steps(axes, colour)
        np.testing.assert_array_equal(drawn.values, counts)
        np.testing.assert_array_equal(drawn.edges, np.arange(257) - 0.5)
    upright = {line.get_xdata()[0] for line in axes.lines if len(set(line.get_xdata())) == 1}
    assert upright >= {shown.threshold + 0.5, *shown.levels.tolist()}  # foreground lies above the threshold
    wanted = np.where(shown.picture[0] > shown.threshold, 255.0, 0.0)
    np.testing.assert_array_equal(np.asarray(foreground.images[0].get_array()), wanted)
    assert foreground.lines
    lost = copy.copy(shown)
    lost.outline = None
    assert not lost.draw().axes[2].lines


def test_another_panel_will_do():
    world = World(device="cpu", panel=LedPanel(shape=PanelShape(2, 3)))
    reader = dataclasses.replace(make_plan().receiver.reader, shape=PanelShape(2, 3), samples_per_led=5)
    small = Source(make_plan(world=world, reader=reader), 10)
    assert all(EVIDENCE[name](small).findings for name in ("fig05_06", "fig09", "fig20"))
    assert EVIDENCE["fig19"](small).counts.sum() == 1920 * 1080
