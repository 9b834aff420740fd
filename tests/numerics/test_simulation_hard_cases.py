"""Light, lens, panel and sensor at their edges: against closed forms, SciPy, mpmath and larger sensors."""

import itertools
import math

import mpmath
import numpy as np
import pytest
import torch
from scipy import ndimage, stats

from vocc_torch.errors import VoccError
from vocc_torch.hardware import CAMERA_RANGES
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Camera, Distribution, LedPanel, SceneModel, Simulator
from vocc_torch.simulation.effects import Context, optics
from vocc_torch.simulation.effects.optics import Blooming
from vocc_torch.simulation.effects.sensor import poisson_quantile
from vocc_torch.simulation.framing import demand_pixels
from vocc_torch.simulation.photometry import grey_value, transmission
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import PanelShape, Scene

LINEAR = {"gamma": 1.0}
"""A camera whose grey values are proportional to the light, so that light can be summed up."""
PITCH_MM = 13.2 / 1920


def sensor(width_px, height_px, **settings):
    """A camera with the paper's pixels and another number of them."""
    return Camera(
        width_px=width_px,
        height_px=height_px,
        sensor_width_mm=width_px * PITCH_MM,
        **settings,
    )


def number(value):
    return torch.tensor(value, dtype=torch.float64, requires_grad=True)


def bare(camera=None, panel=None, effects=None, **settings):
    """A simulator in float64 without the paper's effects, or with those given."""
    return Simulator(
        camera,
        panel,
        effects or {},
        dtype=settings.pop("dtype", torch.float64),
        **settings,
    )


def all_on(scene, rows=8, columns=8):
    return torch.ones(len(scene), rows, columns, dtype=torch.bool)


def refusal(make, *arguments, **settings):
    """The one line with which something is refused."""
    with pytest.raises(VoccError) as refused:
        make(*arguments, **settings)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def excess(frames, background):
    """Light of a frame beyond its background's, summed over its pixels, in grey values at gamma 1."""
    return float((frames.grey.double() - background).sum())


# Photometry


def test_gamma_one():
    exposure, speed = number([0.0, 1e-320, 1e-30, 0.25]), number([100.0] * 4)
    grey = grey_value(exposure, speed, gamma=1.0)
    grey.sum().backward()
    assert torch.equal(grey, 118 * (exposure * 10))
    assert exposure.grad.tolist() == [1180] * 4


def test_gamma_extreme():
    for gamma in (0.1, 10.0):
        light = np.logspace(-30, 30, 61) if gamma > 1 else np.logspace(-3, 3, 61)
        for dtype, rtol in ((torch.float64, 1e-12), (torch.float32, 1e-6)):
            exposure = torch.tensor(light, dtype=dtype)
            found = grey_value(exposure, torch.tensor(10.0, dtype=dtype), gamma=gamma)
            with mpmath.workdps(50):
                exact = [
                    float(118 * mpmath.mpf(float(h)) ** (1 / mpmath.mpf(gamma)))
                    for h in exposure
                ]
            np.testing.assert_allclose(found.double().numpy(), exact, rtol=rtol)
        scene = Scene.of()
        grey = Simulator(Camera(gamma=gamma)).render(scene, all_on(scene))
        assert grey.surround.tolist() == [102]
    for gamma in (0.0999, 10.001):
        line = f"camera.gamma is {gamma}: it must be at least 0.1 and at most 10"
        assert refusal(Camera, gamma=gamma) == line


def test_pixel_among_others():
    light = torch.rand(4099, generator=torch.Generator().manual_seed(5))
    together = grey_value(light, torch.tensor(100.0), gamma=2.2)
    for size in (1, 3, 7):
        parts = [
            grey_value(part, torch.tensor(100.0), gamma=2.2)
            for part in light.split(size)
        ]
        assert torch.equal(torch.cat(parts), together)


def test_opaque_air():
    shares = transmission(
        torch.tensor([0.0, 1.0, 100.0, 180.0, 191.0, 1e9], dtype=torch.float64), 1.0
    )
    assert shares[0] == 1
    assert shares[-2:].tolist() == [0, 0]
    np.testing.assert_allclose(
        shares[1:4], [float(mpmath.exp(-3.91 * v)) for v in (1, 100, 180)], rtol=1e-12
    )
    scene = Scene.of(distance_m=50.0)
    simulator = Simulator(
        effects=PAPER_EFFECTS | {"attenuation": {"visibility_m": 0.1}}
    )
    shown, dark = (
        simulator.render(scene, bits).grey for bits in (all_on(scene), ~all_on(scene))
    )
    assert torch.equal(shown, dark)


# Light and auto-ISO


def test_night_without_limits():
    scene = Scene.cat([Scene.of(), Scene.of(ambient_lx=0.0)])
    for effects in (PAPER_EFFECTS, {}):
        simulator = Simulator(effects=effects)
        for ask in (
            lambda s=simulator: s.render(scene, all_on(scene)),
            lambda s=simulator: s.contrast(scene),
        ):
            rule = "it must be above 0, or give camera.iso_limits, for auto-ISO without limits meters this light"
            assert refusal(ask) == f"scene.ambient_lx is 0: {rule}"


def test_night_with_limits():
    model = SceneModel(ambient_lx=Distribution("constant", (0.0,)))
    assert not model.draw(BlockKey(0, "night", 0), PanelShape())[0].ambient_lx.any()
    scene = Scene.of(ambient_lx=0.0, led_luminance_cd_m2=1.5, distance_m=2.0)
    camera = Camera(iso_limits=(100.0, 3200.0))
    bits = torch.rand(1, 8, 8, generator=torch.Generator().manual_seed(1)) < 0.5
    wanted = 118 * (10 * 1.5 / 1500 / (12.5 * 16) * 320) ** (1 / 2.2)
    for dtype in (torch.float32, torch.float64):
        grey = bare(camera, dtype=dtype).render(scene, bits).grey
        assert float(grey.min()) == 0
        assert float(grey.max()) == pytest.approx(wanted, rel=1e-6)
        assert float(bare(camera, dtype=dtype).contrast(scene)) == pytest.approx(
            wanted / 255, rel=1e-12
        )
    blind = Simulator(camera).render(
        Scene.of(ambient_lx=0.0, led_luminance_cd_m2=0.0), bits
    )
    assert blind.grey.unique().tolist() == blind.surround.tolist() == [0]


def test_extreme_ambient():
    for lux in (1e-12, 1e12):
        scene = Scene.of(ambient_lx=lux, distance_m=2.0)
        grey = Simulator(effects={"saturation": {}}).render(scene, all_on(scene)).grey
        off = 102 * (0.4 / 0.18) ** (1 / 2.2)
        on = off * (1 + math.pi * 3000 / (0.4 * lux)) ** (1 / 2.2)
        assert float(grey.min()) == pytest.approx(102, rel=1e-5)
        assert float(grey.max()) == pytest.approx(min(on, 255), rel=1e-5)
    rule = "it must lead to an ISO speed from 1e-30 to 1e+20, and this is {} (or give camera.iso_limits)"
    for lux, start in (
        (
            1e-30,
            f"scene.ambient_lx is 1e-30 and scene.background_grey is 102: {rule.format('3.79996e+36')}",
        ),
        (1e30, "scene.ambient_lx is 1e+30: it must"),
    ):
        for led in (0.0, 3000.0):
            line = refusal(
                lambda v=lux, own=led: Simulator().contrast(
                    Scene.of(ambient_lx=v, led_luminance_cd_m2=own)
                )
            )
            assert line.startswith(start)


def test_unclipped_light():
    scene = Scene.of(ambient_lx=1e-3, led_luminance_cd_m2=1e12)
    for gamma, effects in ((1.0, {}), (0.1, {}), (0.1, {"saturation": {}})):
        line = refusal(
            Simulator(Camera(gamma=gamma), effects=effects).render, scene, all_on(scene)
        )
        assert line.startswith(
            "scene.led_luminance_cd_m2 is 1e+12, with scene.ambient_lx is 0.001 and ISO "
        )
    seen = (
        Simulator(Camera(gamma=1.0), effects={"saturation": {}})
        .render(scene, all_on(scene))
        .grey
    )
    assert float(seen.max()) == 255


def test_everything_saturated():
    camera, scene = Camera(iso_limits=(1e9, 1e9)), Scene.of(ambient_lx=32000.0)
    seen = Simulator(camera).render(scene, all_on(scene))
    assert seen.grey.dtype == torch.uint8
    assert seen.grey.unique().tolist() == seen.surround.tolist() == [255]
    assert float(Simulator(camera).contrast(scene)) == 0


def test_exposure_settings():
    ranges = {
        "f_number": (0.1, 1e3),
        "exposure_time_s": (1e-9, 1e4),
        "calibration_constant": (0.1, 1e3),
    }
    scene = Scene.of(2)
    scene.ambient_lx[1], scene.led_luminance_cd_m2[1] = 1.0, 0.0
    paper = bare().render(scene, all_on(scene)).grey
    for ends in itertools.product(*ranges.values()):
        camera = Camera(**dict(zip(ranges, ends, strict=True)))
        for dtype, rtol in ((torch.float64, 1e-12), (torch.float32, 1e-5)):
            seen = bare(camera, dtype=dtype).render(scene, all_on(scene)).grey
            torch.testing.assert_close(seen.double(), paper, rtol=rtol, atol=0)
    for name, (low, high) in ranges.items():
        for value in (1e-200, low * 0.999, high * 1.001, 1e200, math.inf, math.nan):
            assert refusal(Camera, **{name: value}).startswith(
                f"camera.{name} is {value:g}: it must be "
            )
        assert (
            refusal(Camera, **{name: 0.0}) == f"camera.{name} is 0: it must be above 0"
        )


def test_gradient_through_the_renderer():
    camera = Camera(iso_limits=(3200.0, 3200.0))
    scene = Scene.of(ambient_lx=0.0, distance_m=3.0)
    scene.led_luminance_cd_m2.requires_grad_()
    bits = torch.rand(1, 8, 8, generator=torch.Generator().manual_seed(2)) < 0.5
    grey = bare(camera).render(scene, bits).grey
    (slope,) = torch.autograd.grad(grey.sum(), scene.led_luminance_cd_m2)
    assert float(slope) == pytest.approx(
        float(grey.detach().sum()) / 2.2 / 3000, rel=1e-12
    )
    # The way from the panel to the exposure may drop an infinite slope of its own; the encoding has none.
    dark = torch.zeros(1, dtype=torch.float64, requires_grad=True)
    grey_value(dark, torch.tensor(3200.0), gamma=2.2).backward()
    assert float(dark.grad) == 0


# Areas


# Panels near and far


def test_touching_panel():
    camera = sensor(64, 48, **LINEAR)
    panel = LedPanel(PanelShape(1, 1))
    nearest = 0.03 * camera.focal_length_px / 99_999
    scene = Scene.of(distance_m=nearest)
    grey = bare(camera, panel).render(scene, all_on(scene, 1, 1)).grey
    on = 102 * (0.4 * 8000 / math.pi + 3000) / (0.18 * 8000 / math.pi)
    torch.testing.assert_close(grey, torch.full_like(grey, on), rtol=1e-5, atol=0)
    for distance in (nearest * 0.99, 1e-30, 5e-324):
        for ask in (
            lambda s: bare(camera, panel).render(s, all_on(s, 1, 1)),
            lambda s: bare(camera, panel).true_panels(s),
            lambda s: bare(camera, panel, {"pose": {"roll_deg": 5.0}}).render(
                s, all_on(s, 1, 1)
            ),
        ):
            line = refusal(ask, Scene.of(distance_m=distance))
            assert line.startswith(f"scene.distance_m is {distance:g}: it must ")


def test_far_panel():
    camera, panel = Camera(**LINEAR), LedPanel(board_reflectance=None)
    for distance in (500.0, 1e4, 1e5):
        scene = Scene.of(distance_m=distance, offset_x_m=0.7, ambient_lx=1.0)
        frames = bare(camera, panel).render(scene, all_on(scene))
        area = 64 * math.pi * (0.015 * camera.focal_length_px / distance) ** 2
        on = 102 * (0.4 / math.pi + 3000) / (0.18 / math.pi)
        assert excess(frames, 102.0) == pytest.approx(area * (on - 102), rel=1e-9)
    gone = Scene.of(distance_m=1e9)
    grey = bare(camera).render(gone, all_on(gone)).grey
    torch.testing.assert_close(grey, torch.full_like(grey, 102.0), rtol=1e-11, atol=0)


def test_near_and_far():
    camera = sensor(96, 64)
    scene = Scene.cat(
        [Scene.of(distance_m=d, offset_y_m=0.01) for d in (0.5, 3000.0, 8.0, 60.0, 0.2)]
    )
    bits = torch.rand(5, 8, 8, generator=torch.Generator().manual_seed(3)) < 0.5
    for effects in (
        {},
        {"airlight": {"visibility_m": 200}, "attenuation": {"visibility_m": 200}},
    ):
        simulator = bare(camera, effects=effects)
        together = simulator.render(scene, bits).grey
        alone = [
            simulator.render(scene[i : i + 1], bits[i : i + 1], nearest_m=0.2).grey
            for i in range(5)
        ]
        assert torch.equal(together, torch.cat(alone))


def test_panel_across_the_border():
    small, large = sensor(96, 64), sensor(288, 192)
    metres = 6.0 / small.focal_length_px
    bits = torch.rand(1, 8, 8, generator=torch.Generator().manual_seed(4)) < 0.5
    for x, y in itertools.product(
        (-90, -66.3, -48, -47.5, 31, 48, 60), (-70, -32, 0, 33.25)
    ):
        scene = Scene.of(distance_m=6.0, offset_x_m=x * metres, offset_y_m=y * metres)
        cut, whole = (
            bare(camera, framing="full").render(scene, bits).grey[0, 0]
            for camera in (small, large)
        )
        torch.testing.assert_close(cut, whole[64:128, 96:192], rtol=1e-12, atol=1e-12)
    far = Scene.of(distance_m=6.0, offset_x_m=1e3)
    assert Simulator(small).render(far, all_on(far)).grey.unique().tolist() == [102]
    assert float(Simulator(small).true_panels(far).corners_px[..., 0].min()) > 96


def test_extreme_offsets():
    camera = Camera()
    telescope, small = (
        Camera(focal_length_mm=1e6),
        LedPanel(led_diameter_m=1e-6, led_gap_m=0.0),
    )
    views = (
        (camera, LedPanel(), 5.0),
        (camera, LedPanel(), 50.0),
        (telescope, small, 1e6),
    )
    for (seen_by, panel, distance), x, y in itertools.product(
        views, (-1e9, 1e9), (-1e9, 1e9)
    ):
        scene = Scene.of(distance_m=distance, offset_x_m=x, offset_y_m=y)
        frames = bare(seen_by, panel).render(scene, all_on(scene))
        torch.testing.assert_close(
            frames.grey, torch.full_like(frames.grey, 102.0), rtol=1e-12, atol=0
        )
        height, width = (
            full - own
            for full, own in zip(frames.sensor_px, frames.grey.shape[-2:], strict=True)
        )
        assert frames.origin_px.tolist() == [
            [0 if x < 0 else width, 0 if y < 0 else height]
        ]
    far = Scene.of(distance_m=2e-3, offset_x_m=1e9, offset_y_m=-1e9)
    line = refusal(Simulator(telescope, small).true_panels, far)
    assert line.startswith(
        "scene.offset_x_m is 1e+09, scene.offset_y_m is -1e+09, scene.distance_m is 0.002: the "
    )
    for name, value in (
        ("offset_x_m", -1.1e9),
        ("offset_y_m", 1.1e9),
        ("distance_m", 1.1e9),
    ):
        assert refusal(Scene.of, **{name: value}).startswith(
            f"scene.{name} is {value:g}: it must be at "
        )


def test_small_sensors():
    for width, height in ((1, 1), (5, 5), (7, 3), (3, 11), (61, 59)):
        for camera in (sensor(width, height), Camera(width_px=width, height_px=height)):
            scene = Scene.of(2, distance_m=20.0, offset_x_m=0.01)
            frames = [
                Simulator(camera, framing=f).render(scene, all_on(scene))
                for f in ("crop", "filled", "full")
            ]
            assert torch.equal(frames[1].grey, frames[2].grey)
            if frames[0].surround is None:
                assert torch.equal(frames[0].grey, frames[2].grey)
            assert tuple(frames[2].grey.shape[-2:]) == (height, width)


# Blooming


def test_no_blooming():
    value = torch.rand(
        2, 1, 9, 7, generator=torch.Generator().manual_seed(1), dtype=torch.float64
    )
    context = Context(Scene.of(2), Camera())
    for sigma in (5e-324, 1e-200, 1e-6, 0.02):
        assert torch.equal(Blooming(sigma)(value, context), value)
    for sigma in (0.0, -1e-6, 32.001, math.nan, math.inf):
        assert refusal(Blooming, sigma).startswith(
            f"scene.effects.blooming.sigma_px is {sigma:g}: it must be above 0"
        )


def test_wide_blooming():
    generator = torch.Generator().manual_seed(2)
    for height, width in ((1, 1), (40, 33)):
        value = torch.rand(
            3, 1, height, width, generator=generator, dtype=torch.float64
        )
        blurred = Blooming(32.0)(value, Context(Scene.of(3), Camera()))
        for frame, plain in zip(blurred, value, strict=True):
            wanted = ndimage.gaussian_filter(
                plain[0].numpy(), 32.0, truncate=4.0, mode="nearest"
            )
            np.testing.assert_allclose(frame[0].numpy(), wanted, rtol=1e-12)
        even = Blooming(32.0)(
            torch.full_like(value, 0.1), Context(Scene.of(3), Camera())
        )
        torch.testing.assert_close(
            even, torch.full_like(value, 0.1), rtol=1e-14, atol=0
        )
    camera, scene = (
        sensor(700, 500, **LINEAR),
        Scene.of(distance_m=30.0, ambient_lx=1.0),
    )
    plain, bloomed = (
        bare(camera, effects=e).render(scene, all_on(scene))
        for e in ({}, {"blooming": {"sigma_px": 32.0}})
    )
    assert bloomed.grey.shape[-1] > 256
    assert excess(bloomed, 102.0) == pytest.approx(excess(plain, 102.0), rel=1e-9)


def test_wide_kernel():
    generator = np.random.default_rng(3)
    quarter = torch.from_numpy(generator.random((9, 9)))
    half = torch.cat([quarter.flip(0)[:-1], quarter])
    kernel = torch.cat([half.flip(1)[:, :-1], half], dim=1)
    plane = torch.from_numpy(generator.random((41, 67)))
    wanted = ndimage.convolve(plane.numpy(), kernel.numpy(), mode="nearest")
    for values in (1, 2000, 10_000, 1 << 25):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(optics, "MOST_STRIP_VALUES", values)
            patch.setattr(optics, "STRIP_VALUES", 20 * values)
            found = optics.convolve_symmetric(plane, quarter)
        np.testing.assert_allclose(found.numpy(), wanted, rtol=1e-13)


def test_extreme_counts():
    normal = np.array([-7.0, -2.5, -0.3, 0.0, 1.1, 3.0, 7.0])
    assert not poisson_quantile(np.zeros(7), normal).any()
    for mean in (1e-300, 1e-9, 0.01, 0.5, 2.999, 3.0, 47.3, 1e6):
        for n, z in zip(
            poisson_quantile(np.full(7, mean), normal), normal, strict=True
        ):
            assert n >= 0
            assert stats.poisson.cdf(n, mean) >= stats.norm.cdf(z) * (1 - 1e-9)
    for mean in (1e16, 1e30):
        found = poisson_quantile(np.full(7, mean), normal)
        np.testing.assert_allclose(found, mean + normal * math.sqrt(mean), rtol=1e-15)


# What is given to the renderer


def test_plain_arguments():
    made = {
        Scene.of: ("scene", Scene.__slots__, 50.0),
        Camera: ("camera", (*CAMERA_RANGES, "width_px", "height_px"), 5),
        LedPanel: ("panel", ("led_diameter_m", "led_gap_m", "led_reflectance"), 0.5),
    }
    none = (
        "50",
        True,
        np.True_,
        None,
        math.nan,
        math.inf,
        10**400,
        -(10**5000),
        1j,
        [1],
        torch.ones(1),
    )
    for make, (section, names, right) in made.items():
        for name, wrong in itertools.product(names, none):
            line = refusal(make, **{name: wrong})
            assert line.startswith(f"{section}.{name} is ")
            assert ": it must be " in line
            assert len(line) < 160
        for name in names:
            kind = np.int64 if name.endswith("_px") else np.float64
            assert make(**{name: kind(right)}) is not None
    for wrong in (True, "8", 8.0, None, 10**400):
        assert refusal(PanelShape, columns=wrong).startswith("panel.columns is ")
        assert refusal(Scene.of, wrong).startswith("frames is ")
    none = (
        ("a", 100),
        (True, 100),
        (1,),
        (),
        "ab",
        100,
        (1, 10**400),
        (1, 2, 3),
        (3200, 100),
        (0, 100),
    )
    for wrong in none:
        assert refusal(Camera, iso_limits=wrong).startswith("camera.iso_limits is ")
    assert type(Camera(width_px=np.int64(640)).width_px) is int


def test_wrong_bits():
    scene = Scene.of(2)
    for dtype in (torch.uint8, torch.int64, torch.float32):
        assert refusal(Simulator().render, scene, all_on(scene).to(dtype)) == (
            f"bits has the type {dtype}: it must be torch.bool, True = On"
        )
    for shape in ((2, 8), (1, 8, 8), (2, 8, 9), (2, 1, 8, 8), ()):
        bits = torch.ones(shape, dtype=torch.bool)
        assert (
            refusal(Simulator().render, scene, bits)
            == f"bits has shape {shape}: it must be (2, 8, 8)"
        )


def test_no_scenes():
    empty = Scene.of()[:0]
    line = "scene holds no frames: it must hold at least 1"
    assert refusal(Simulator().render, empty, all_on(empty)) == line
    assert refusal(Scene.of, 0).startswith(
        "frames is 0: it must be a whole number, at least 1"
    )
    assert (
        len(Simulator().true_panels(empty).found)
        == len(Simulator().contrast(empty))
        == 0
    )


def test_not_finite():
    for name, value in itertools.product(
        Scene.__slots__, (math.nan, math.inf, -math.inf)
    ):
        scene = Scene.of(5)
        getattr(scene, name)[3] = value
        line = f"scene.{name} holds a value that is not finite"
        for ask in (
            lambda s: Simulator().render(s, all_on(s)),
            Simulator().contrast,
            Simulator().true_panels,
        ):
            assert refusal(ask, scene) == line


def test_ragged_scene():
    scene = Scene.of(3)
    for wrong in (
        torch.ones(1).double(),
        torch.ones(()).double(),
        torch.ones(3, 1).double(),
    ):
        ragged = Scene(
            *(
                wrong if n == "distance_m" else getattr(scene, n)
                for n in Scene.__slots__
            )
        )
        line = (
            f"scene.distance_m has shape {tuple(wrong.shape)}: each field must be (B,)"
        )
        assert refusal(ragged.checked) == line


def test_no_nearest_distance():
    scene = Scene.of()
    for nearest in (0.0, -1.0, math.nan):
        rule = "above 0" if nearest <= 0 else "a finite number"
        assert (
            refusal(Simulator().crop_px, nearest)
            == f"nearest_m is {nearest:g}: it must be {rule}"
        )
    assert refusal(Simulator().render, scene, all_on(scene), nearest_m=0.0).startswith(
        "nearest_m is 0"
    )
    assert refusal(Simulator().crop_px, 5e-324).startswith(
        "scene.distance_m is 4.94066e-324: it must leave an LED"
    )
    assert Simulator().crop_px(0.002) == (1080, 1920)


def test_too_many_pixels():
    camera, scene = Camera(width_px=8192, height_px=8193), Scene.of()
    for framing in ("filled", "full"):
        line = refusal(Simulator(camera, framing=framing).render, scene, all_on(scene))
        assert line.startswith(
            "camera.width_px and camera.height_px lead to frames of 8192 x 8193 px: they must "
        )
        assert line.endswith(
            "(give a smaller camera, or framing=crop, which draws the panel's surroundings only)"
        )
    for allowed in ((6144, 8192), (8192, 8192)):
        demand_pixels(allowed)
    assert Simulator(camera).render(scene, all_on(scene)).surround.tolist() == [102]
    for name, value in itertools.product(
        ("width_px", "height_px"), (0, 5.5, 32769, 2**62)
    ):
        assert refusal(Camera, **{name: value}).startswith(
            f"camera.{name} is {value}: it must"
        )


# Draws


def test_equal_bounds():
    for value in (5e-324, 1e-9, 0.1, 47.3, 1e12, 1.7e308):
        for kind in ("uniform", "log_uniform"):
            drawn = Distribution(kind, (value, value)).draw(
                np.random.default_rng(0), 100
            )
            assert np.unique(drawn).tolist() == [value]
        assert set(
            Distribution("choice", (value,)).draw(np.random.default_rng(0), 9)
        ) == {value}


def test_too_wide():
    line = refusal(Distribution, "uniform", (-1e308, 1e308))
    assert line.endswith("high must not exceed low by more than 1.79769e+308")
    drawn = Distribution("uniform", (-8e307, 8e307)).draw(
        np.random.default_rng(0), 1000
    )
    assert np.isfinite(drawn).all()
