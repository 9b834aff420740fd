"""Each effect against SciPy or arithmetic, and the rule that only what a scene names is ever built."""

import functools
import itertools
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects import (
    CAMERA_STEPS,
    PHYSICAL_ORDER,
    Context,
    Quantity,
    build_effects,
    check_chain,
)
from vocc_torch.simulation.effects.attenuation import Attenuation
from vocc_torch.simulation.effects.blooming import Blooming
from vocc_torch.simulation.effects.quantization import Quantization
from vocc_torch.simulation.effects.saturation import Saturation
from vocc_torch.simulation.geometry import Camera
from vocc_torch.simulation.simulator import PAPER_EFFECTS, Simulator
from vocc_torch.types import Scene

DOUBLE = torch.float64
NEEDS_SATURATION = (
    "scene.effects.quantization needs grey value, 0 to 255, which scene.effects.saturation makes: name it too"
)


def run(effect, value, scene=None):
    return effect(value, Context(scene or Scene.of(len(value)), Camera()))


def planes(seed, *shape, dtype=DOUBLE):
    return torch.from_numpy(np.random.default_rng(seed).random(shape)).to(dtype)


# Blooming


@pytest.mark.parametrize("sigma", [0.3, 0.8, 1.5, 2.7])
def test_blooming_is_scipys_gaussian_to_1e_12(sigma):
    exposure = planes(1, 3, 1, 41, 29)
    ours = run(Blooming(sigma), exposure).numpy()
    for frame, plane in zip(ours[:, 0], exposure[:, 0].numpy(), strict=True):
        radius = math.ceil(4 * sigma)
        np.testing.assert_allclose(
            frame, ndimage.gaussian_filter(plane, sigma, mode="nearest", radius=radius), 1e-12
        )


def test_blooming_of_the_paper_is_scipys_default_truncation():
    exposure = planes(2, 1, 1, 30, 50)
    expected = ndimage.gaussian_filter(exposure[0, 0].numpy(), 1.5, truncate=4.0, mode="nearest")
    np.testing.assert_allclose(run(Blooming(1.5), exposure)[0, 0].numpy(), expected, rtol=1e-12)


def test_blooming_in_float32_is_scipys_to_float32_rounding():
    exposure = planes(3, 4, 1, 33, 47, dtype=torch.float32)
    ours = run(Blooming(1.5), exposure)
    assert ours.dtype == torch.float32
    for frame, plane in zip(ours[:, 0].numpy(), exposure[:, 0].numpy(), strict=True):
        expected = ndimage.gaussian_filter(plane.astype(float), 1.5, truncate=4.0, mode="nearest")
        np.testing.assert_allclose(frame, expected, rtol=1e-6)


def test_blooming_in_float32_keeps_dim_light_beside_a_lamp():
    """All terms are positive: a pixel of 1e-6 in the tail of a lamp of 1e6 keeps its digits."""
    exposure = planes(5, 1, 1, 40, 60, dtype=torch.float32) * 1e-6
    exposure[..., 20, 20] = 1e6
    expected = ndimage.gaussian_filter(exposure[0, 0].double().numpy(), 1.5, truncate=4.0, mode="nearest")
    np.testing.assert_allclose(run(Blooming(1.5), exposure)[0, 0].numpy(), expected, rtol=2e-6)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (3, 2)])
def test_blooming_of_frames_smaller_than_the_kernel(size):
    exposure = planes(4, 2, 1, *size)
    expected = ndimage.gaussian_filter(exposure[1, 0].numpy(), 1.5, truncate=4.0, mode="nearest")
    np.testing.assert_allclose(run(Blooming(1.5), exposure)[1, 0].numpy(), expected, rtol=1e-12)


@given(st.floats(0.2, 3.0), st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_blooming_keeps_the_energy_of_light_away_from_the_border(sigma, seed):
    reach = Blooming(sigma).reach_px
    exposure = torch.zeros(1, 1, 4 * reach + 5, 4 * reach + 5, dtype=DOUBLE)
    exposure[..., reach:-reach, reach:-reach] = planes(seed, 2 * reach + 5, 2 * reach + 5)
    assert float(run(Blooming(sigma), exposure).sum()) == pytest.approx(float(exposure.sum()), rel=1e-12)


def test_blooming_leaves_a_uniform_frame_uniform():
    blurred = run(Blooming(1.5), torch.full((2, 1, 9, 9), 0.0123, dtype=DOUBLE))
    torch.testing.assert_close(blurred, torch.full_like(blurred, 0.0123), rtol=1e-14, atol=0)


def test_blooming_reaches_exactly_its_reach():
    """A crop relies on reach_px: one pixel further nothing may arrive, and at reach_px something must."""
    effect = Blooming(1.5)
    exposure = torch.zeros(1, 1, 31, 31, dtype=DOUBLE)
    exposure[..., 15, 15] = 1.0
    row = run(effect, exposure)[0, 0, 15]
    assert row[15 + effect.reach_px] > 0
    assert row[15 - effect.reach_px] > 0
    assert not row[15 + effect.reach_px + 1 :].any()
    assert not row[: 15 - effect.reach_px].any()


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
@pytest.mark.parametrize("batch", [1, 2, 5])
def test_blooming_does_not_depend_on_the_batch(dtype, batch):
    exposure = planes(6, 10, 1, 37, 41, dtype=dtype)
    together = run(Blooming(1.5), exposure)
    apart = torch.cat([run(Blooming(1.5), part) for part in exposure.split(batch)])
    assert torch.equal(together, apart)


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_no_light_leaks_into_the_neighbouring_frame(dtype):
    """A black and a dim frame between glaring ones stay black and as dim as they are alone."""
    frames = planes(7, 5, 1, 20, 24, dtype=dtype)
    frames[0::2] *= 1e30
    frames[1] = 0
    frames[3] *= 1e-6
    blurred = run(Blooming(2.0), frames)
    assert not blurred[1].any()
    alone = run(Blooming(2.0), frames[3:4])
    torch.testing.assert_close(blurred[3:4], alone, rtol=1e-7 if dtype == torch.float32 else 1e-15, atol=0)


@pytest.mark.parametrize("sigma", [0, -1.5, float("nan"), float("inf"), 32.1, 1001])
def test_blooming_refuses_a_spread_out_of_range(sigma):
    with pytest.raises(VoccError, match=r"^scene\.effects\.blooming\.sigma_px is .*: it must be above 0"):
        Blooming(sigma)


# The other effects


def test_attenuation_dims_each_frame_by_its_own_distance():
    scene = Scene.cat([Scene.of(distance_m=d) for d in (30.0, 70.0)])
    light = torch.full((2, 3, 4), 3000.0, dtype=DOUBLE)
    dimmed = run(Attenuation(40_000.0), light, scene)
    for frame, distance in zip(dimmed, (30.0, 70.0), strict=True):
        expected = 3000.0 * math.exp(-3.91 * distance / 40_000.0)
        torch.testing.assert_close(frame, torch.full_like(frame, expected), rtol=1e-14, atol=0)


def test_attenuation_leaves_reflected_light_alone():
    """Eq. 20 multiplies the LED's own light: with all LEDs Off fog changes nothing, with all On it does."""
    scene, bits = Scene.of(2, distance_m=60.0), torch.zeros(2, 8, 8, dtype=torch.bool)
    fog = PAPER_EFFECTS | {"attenuation": {"visibility_m": 50.0}}
    clear = {name: values for name, values in PAPER_EFFECTS.items() if name != "attenuation"}
    foggy_off, clear_off = (Simulator(effects=e).render(scene, bits).grey for e in (fog, clear))
    assert torch.equal(foggy_off, clear_off)
    foggy_on, clear_on = (Simulator(effects=e).render(scene, ~bits).grey for e in (fog, clear))
    assert int(foggy_on.max()) < int(clear_on.max())


@pytest.mark.parametrize("visibility", [0, -1, float("nan"), float("inf")])
def test_attenuation_refuses_a_visibility_out_of_range(visibility):
    with pytest.raises(
        VoccError, match=r"^scene\.effects\.attenuation\.visibility_m is .*: it must be above 0$"
    ):
        Attenuation(visibility)


def test_saturation_clips_at_white_and_nothing_else():
    grey = torch.tensor([0.0, 17.25, 254.999, 255.0, 255.001, 1e9], dtype=DOUBLE).view(1, 1, 1, 6)
    assert run(Saturation(), grey).flatten().tolist() == [0.0, 17.25, 254.999, 255.0, 255.0, 255.0]


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_quantization_to_8_bits_is_numpys_rint_as_uint8(dtype):
    grey = torch.cat([planes(8, 500, dtype=dtype) * 255, torch.arange(0, 255.5, 0.5, dtype=dtype)]).view(
        1, 1, 1, -1
    )
    digital = run(Quantization(8), grey)
    assert digital.dtype == torch.uint8
    np.testing.assert_array_equal(digital.numpy(), np.rint(grey.numpy()))


@pytest.mark.parametrize("bits", [1, 2, 4, 10, 12, 16])
def test_quantization_to_other_depths_is_the_nearest_of_its_levels(bits):
    grey = planes(9, 1, 1, 1, 300) * 255
    digital = run(Quantization(bits), grey).flatten().numpy()
    levels = np.linspace(0, 255, 2**bits)
    nearest = (
        levels[np.abs(grey.flatten().numpy()[:, None] - levels).argmin(axis=1)] if bits <= 12 else digital
    )
    np.testing.assert_allclose(digital, nearest, rtol=0, atol=1e-10)
    assert np.abs(digital - grey.flatten().numpy()).max() <= 255 / (2**bits - 1) / 2 + 1e-12
    assert np.abs(digital * (2**bits - 1) / 255 - np.rint(digital * (2**bits - 1) / 255)).max() < 1e-8


@pytest.mark.parametrize("bits", [0, 17, -8, 8.0])
def test_quantization_refuses_a_depth_out_of_range(bits):
    with pytest.raises(
        VoccError, match=r"^scene\.effects\.quantization\.bits is .*: it must be a whole number"
    ):
        build_effects({"saturation": {}, "quantization": {"bits": bits}})


# The registry


def test_effects_run_in_physical_order_whatever_the_order_of_the_names():
    """All 24 orders of the paper's four effects."""
    for names in itertools.permutations(PAPER_EFFECTS):
        effects = build_effects({name: PAPER_EFFECTS[name] for name in names})
        assert [type(effect) for effect in effects] == [Attenuation, Blooming, Saturation, Quantization]


def test_physical_order_never_runs_back():
    """Light at the LED, air, optics, sensor, encoding: no effect takes what lies before what another gave."""
    order = list(Quantity)
    for earlier, later in itertools.pairwise(PHYSICAL_ORDER):
        assert order.index(earlier.gives) <= order.index(later.takes)
    camera = [quantity for quantity in order if quantity != Quantity.ELECTRONS]
    assert list(CAMERA_STEPS) == camera[: len(CAMERA_STEPS)]


def test_effects_left_out_are_not_built():
    assert build_effects({}) == ()
    assert build_effects({"blooming": {"sigma_px": 2}}) == (Blooming(2),)


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ({"bloming": {"sigma_px": 1}}, "scene.effects.bloming is not a known effect; did you mean blooming?"),
        (
            {"quantisation": {}},
            "scene.effects.quantisation is not a known effect; did you mean quantization?",
        ),
        ({"xyz": {}}, "scene.effects.xyz is not a known effect; known: pose, lens_distortion,"),
        (
            {"blooming": {"sigma": 1}},
            "scene.effects.blooming.sigma is not a known parameter; did you mean sigma_px?",
        ),
        (
            {"saturation": {"level": 255}},
            "scene.effects.saturation.level is not a known parameter; known: none",
        ),
        ({"blooming": {}}, "scene.effects.blooming.sigma_px is missing"),
        ({"attenuation": {}}, "scene.effects.attenuation.visibility_m is missing"),
        (
            {"blooming": None},
            "scene.effects.blooming is null: give its parameters, {} for none, or remove it with ~",
        ),
        (
            {"blooming": {"sigma_px": "wide"}},
            "scene.effects.blooming.sigma_px is 'wide': it must be a number",
        ),
        ({"blooming": {"sigma_px": True}}, "scene.effects.blooming.sigma_px is True: it must be a number"),
        ({"blooming": {"sigma_px": None}}, "scene.effects.blooming.sigma_px is None: it must be a number"),
        ({"blooming": {"sigma_px": 0}}, "scene.effects.blooming.sigma_px is 0: it must be above 0"),
        (
            {"quantization": {"bits": 8}},
            NEEDS_SATURATION,
        ),
        (
            {"blooming": {"sigma_px": 1.5}, "quantization": {"bits": 8}},
            NEEDS_SATURATION,
        ),
    ],
)
def test_a_scenes_mistakes_are_refused_in_one_line(named, message):
    with pytest.raises(VoccError) as refusal:
        build_effects(named)
    assert str(refusal.value).startswith(message)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("named", "output"),
    [
        ({}, Quantity.GREY),
        ({"attenuation": {"visibility_m": 1e4}}, Quantity.GREY),
        ({"blooming": {"sigma_px": 1.5}}, Quantity.GREY),
        ({"saturation": {}}, Quantity.BOUNDED_GREY),
        ({"saturation": {}, "quantization": {}}, Quantity.DIGITAL),
    ],
)
def test_the_chain_states_what_comes_out(named, output):
    assert check_chain(build_effects(named)) == output


def alarm(method):
    """Stand in for a method, with its signature, and raise when it is called."""

    @functools.wraps(method)
    def touched(*_, **__):
        raise AssertionError("an effect that the scene does not name was touched")

    return touched


@pytest.mark.parametrize("left_out", list(PAPER_EFFECTS))
def test_an_effect_that_is_not_named_is_never_constructed_nor_called(monkeypatch, left_out):
    kind = {effect.name: effect for effect in PHYSICAL_ORDER}[left_out]
    unwanted = [kind, Quantization] if left_out == "saturation" else [kind]
    for effect in unwanted:
        for method in ("__init__", "__call__"):
            monkeypatch.setattr(effect, method, alarm(getattr(effect, method)))
        monkeypatch.setattr(effect, "reach_px", property(alarm(effect.reach_px.fget)))
    names = {effect.name for effect in unwanted}
    simulator = Simulator(effects={n: v for n, v in PAPER_EFFECTS.items() if n not in names})
    scene = Scene.of(2)
    assert len(simulator.render(scene, torch.ones(2, 8, 8, dtype=torch.bool))) == 2
    assert simulator.contrast(scene).shape == (2,)
    # The alarm itself works: naming the effect sets it off.
    with pytest.raises(AssertionError, match="was touched"):
        Simulator(effects=PAPER_EFFECTS)
