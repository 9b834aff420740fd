"""Light, lens, panel and sensor at their edges: against closed forms, SciPy, mpmath and larger sensors."""

import itertools
import math
from dataclasses import fields

import mpmath
import numpy as np
import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.simulation import Camera, LedPanel, Simulator
from vocc_torch.simulation.framing import demand_pixels
from vocc_torch.simulation.photometry import grey_value, transmission
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import PanelShape, Scene

PITCH_MM = 13.2 / 1920


def sensor(width_px, height_px, **settings):
    """A camera with the paper's pixels and another number of them."""
    return Camera(
        width_px=width_px,
        height_px=height_px,
        sensor_width_mm=width_px * PITCH_MM,
        **settings,
    )


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


# Photometry


def test_pixel_among_others():
    light = torch.rand(259, generator=torch.Generator().manual_seed(5))
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


# Panels near and far


def test_panel_across_the_border():
    small, large = sensor(96, 64), sensor(288, 192)
    metres = 6.0 / small.focal_length_px
    bits = torch.rand(1, 8, 8, generator=torch.Generator().manual_seed(4)) < 0.5
    for x, y in itertools.product(
        (-90, -66.3, -48, -47.5, 31, 48, 60), (-70, -32, 0, 33.25)
    ):
        scene = Scene.of(distance_m=6.0, offset_x_m=x * metres, offset_y_m=y * metres)
        cut, larger = (
            bare(camera, framing="full").render(scene, bits).grey[0, 0]
            for camera in (small, large)
        )
        torch.testing.assert_close(cut, larger[64:128, 96:192], rtol=1e-12, atol=1e-12)
    far = Scene.of(distance_m=6.0, offset_x_m=1e3)
    assert Simulator(small).render(far, all_on(far)).grey.unique().tolist() == [102]
    assert float(Simulator(small).true_panels(far).corners_px[..., 0].min()) > 96


# What is given to the renderer


def test_plain_arguments():
    makers = {
        Scene.of: ("scene", Scene.__slots__, 50.0),
        Camera: ("camera", [item.name for item in fields(Camera) if item.metadata], 5),
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
    for make, (section, names, right) in makers.items():
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
