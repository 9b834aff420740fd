"""Streets: drawings against exact areas, looks of panels and their light, photographs, no panel at all."""

import math
from functools import partial

import numpy as np
import pytest
import torch
from frame_keys import frame_keys
from PIL import Image

from vocc_torch.simulation import Camera, LedPanel, Simulator, raster, sketch
from vocc_torch.types import Scene

LINEAR = Camera(width_px=320, height_px=200, sensor_width_mm=13.2 / 6, gamma=1.0)
NEAR = Scene.of(2, distance_m=10.0, ambient_lx=5000.0, led_luminance_cd_m2=900.0)
BARE = {"fill": 0.5, "square": 0, "invisible": 1}
PLAIN = {"board": 0.3, "boardless": 0, "rim": 0, "cables": 0}


keys = partial(frame_keys, "street")


def shot(effects, bits=None, scene=NEAR, panel_only=False, seed=0, camera=LINEAR):
    """Grey values in proportion to the light, 102 for the plain background, which shows between the LEDs."""
    panel = LedPanel(board_reflectance=None)
    simulator = Simulator(
        panel=panel, effects=effects, camera=camera, dtype=torch.float64, framing="full"
    )
    bits = torch.ones(len(scene), 8, 8, dtype=torch.bool) if bits is None else bits
    return simulator.render(
        scene, bits, keys=keys(len(scene), seed=seed), panel_only=panel_only
    )


def test_a_drawing_covers_the_polygons_exact_area():
    """Within the fineness of a quarter of a pixel, and without a bias over many polygons."""
    generator, gaps, wide = np.random.default_rng(0), [], []
    for _ in range(20):
        angle, reach = generator.uniform(0, 7), generator.uniform(3, 20)
        corners = np.array(
            [[np.cos(angle + k * 2.1), np.sin(angle + k * 2.1)] for k in range(3)]
        )
        corners = corners * reach + generator.uniform(25, 35, 2)
        exact = raster.polygon_cover(torch.from_numpy(corners)[None], 64, 64)[0].numpy()
        drawing = sketch.Sketch()
        drawing.polygon(corners, 7.0)
        thing = sketch.Drawing.on_sensor(drawing.parts, lambda points: points)
        keep, light = sketch.composed([thing], (0, 0, 64, 64))
        drawn = 1 - keep
        assert light == pytest.approx(7 * drawn, abs=0.03)
        wide.append(abs(drawn - exact).max())
        gaps.append((drawn.sum() - exact.sum()) / math.sqrt(exact.sum()))
    assert max(wide) < 0.55
    assert abs(np.mean(gaps)) < 0.15


def test_a_board_and_unseen_leds_have_the_grey_of_their_reflectance():
    """Eq. 1 with gamma 1: grey is in proportion to reflectance, 102 at 0.18."""
    off = torch.zeros(2, 8, 8, dtype=torch.bool)
    frames = shot({"led_look": BARE, "housing": PLAIN}, off)
    inside = frames.grey[:, 0, 80:120, 140:180]
    assert inside.numpy() == pytest.approx(102 * 0.3 / 0.18, rel=1e-3)
    shown = shot(
        {"led_look": BARE | {"invisible": 0, "reflectance": 0.6}, "housing": PLAIN}, off
    ).grey
    assert float(shown.max()) == pytest.approx(102 * 0.6 / 0.18, rel=1e-3)


@pytest.mark.parametrize("pose", [{}, {"pose": {"roll_deg": 5}}])
@pytest.mark.parametrize(("square", "share"), [(0, math.pi / 4), (1, 1.0)])
def test_leds_have_the_area_and_the_light_that_their_look_says(square, share, pose):
    """The light of 64 LEDs, in pixels of an LED's own brightness; a smaller LED sends no less."""
    pitch_px = 0.06 * LINEAR.focal_length_px / 10
    sums = {}
    for fill in (0.25, 0.5, 0.9):
        frames = shot({"led_look": BARE | {"fill": fill, "square": square}} | pose)
        sums[fill] = float((frames.grey[0, 0] - 102).sum())
    led_grey = 102 * 900 / (5000 * 0.18 / math.pi)
    assert sums[0.5] == pytest.approx(
        64 * share * (0.5 * pitch_px) ** 2 * led_grey, rel=1e-6
    )
    assert sums[0.25] == pytest.approx(sums[0.5], rel=1e-6)
    assert sums[0.9] == pytest.approx(sums[0.5] * (0.9 / 0.5) ** 2, rel=1e-6)


def test_without_a_panel_the_street_is_the_same():
    """All but the panel's surroundings is alike, and the truth says that there is none."""
    street = {
        "scenery": {},
        "clutter": {"things": 12},
        "led_look": {},
        "housing": {"cables": 0},
    }
    scene = Scene.of(3, distance_m=40.0, led_luminance_cd_m2=30_000.0)
    present, absent = (
        shot(street | more, scene=scene).grey for more in ({}, {"panel_absent": {}})
    )
    changed = (present - absent).abs().amax((0, 1)) > 1e-9
    rows, columns = changed.nonzero().T
    assert 4 < int(rows.max() - rows.min()) < 80
    assert 4 < int(columns.max() - columns.min()) < 80
    simulator = Simulator(effects={"panel_absent": {"share": 0.5}}, camera=LINEAR)
    panels = simulator.true_panels(Scene.of(40), keys(40))
    assert 5 < int(panels.found.sum()) < 35
    assert not bool(panels.corners_px[~panels.found].any())
    frames = shot({"panel_absent": {"share": 0.5}}, scene=Scene.of(40))
    assert torch.equal(frames.grey.amax((1, 2, 3)) > 103, panels.found)


def pictures(folder, **named):
    folder.mkdir()
    for name, grey in named.items():
        Image.fromarray(np.array(grey, dtype=np.uint8)).save(folder / f"{name}.png")
    return str(folder)


def test_a_photograph_stands_behind_in_the_light_that_it_shows(tmp_path):
    """Two greys with gamma 2.2 undone; one of the folder a frame, and the mean is the level."""
    halves = np.full((60, 90), 64)
    halves[:, 45:] = 192
    folder = pictures(tmp_path / "own", a=halves, b=np.full((400, 600), 50))
    scene = Scene.of(6)
    grey = shot(
        {"backdrop": {"folder": folder, "level": 0.5}, "panel_absent": {}}, scene=scene
    ).grey[:, 0]
    plain = grey.amax((1, 2)) - grey.amin((1, 2)) < 1e-3
    assert 0 < int(plain.sum()) < 6
    assert grey[plain].numpy() == pytest.approx(51, rel=1e-5)
    low, high = grey[~plain].amin((1, 2)), grey[~plain].amax((1, 2))
    assert (high / low).numpy() == pytest.approx(3**2.2, rel=1e-5)
    assert ((low + high) / 2).numpy() == pytest.approx(51, rel=1e-5)
    # Crops of their own.
    assert len({round(float(frame.mean()), 3) for frame in grey[~plain]}) > 1
