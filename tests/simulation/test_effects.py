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

from vocc_torch.hardware import Camera
from vocc_torch.simulation.effects import CAMERA_STEPS, PHYSICAL_ORDER, Context, Quantity, build_effects
from vocc_torch.simulation.effects.coding import Quantization, Saturation
from vocc_torch.simulation.effects.light import Attenuation
from vocc_torch.simulation.effects.optics import Blooming
from vocc_torch.simulation.simulator import PAPER_EFFECTS, Simulator
from vocc_torch.types import Scene

DOUBLE = torch.float64


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


def test_blooming_in_float32_keeps_dim_light_beside_a_lamp():
    """All terms are positive: a pixel of 1e-6 in the tail of a lamp of 1e6 keeps its digits."""
    exposure = planes(5, 1, 1, 40, 60, dtype=torch.float32) * 1e-6
    exposure[..., 20, 20] = 1e6
    expected = ndimage.gaussian_filter(exposure[0, 0].double().numpy(), 1.5, truncate=4.0, mode="nearest")
    np.testing.assert_allclose(run(Blooming(1.5), exposure)[0, 0].numpy(), expected, rtol=2e-6)


@given(st.floats(0.2, 3.0), st.integers(0, 10_000))
@settings(max_examples=10, deadline=None)
def test_blooming_keeps_the_energy_of_light_away_from_the_border(sigma, seed):
    reach = Blooming(sigma).reach_px
    exposure = torch.zeros(1, 1, 4 * reach + 5, 4 * reach + 5, dtype=DOUBLE)
    exposure[..., reach:-reach, reach:-reach] = planes(seed, 2 * reach + 5, 2 * reach + 5)
    assert float(run(Blooming(sigma), exposure).sum()) == pytest.approx(float(exposure.sum()), rel=1e-12)


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


# The other effects


def test_attenuation_leaves_reflected_light_alone():
    """Eq. 20 multiplies the LED's own light: with all LEDs Off fog changes nothing, with all On it does."""
    scene, bits = Scene.of(2, distance_m=60.0), torch.zeros(2, 8, 8, dtype=torch.bool)
    fog = PAPER_EFFECTS | {"attenuation": {"visibility_m": 50.0}}
    clear = {name: values for name, values in PAPER_EFFECTS.items() if name != "attenuation"}
    foggy_off, clear_off = (Simulator(effects=e).render(scene, bits).grey for e in (fog, clear))
    assert torch.equal(foggy_off, clear_off)
    foggy_on, clear_on = (Simulator(effects=e).render(scene, ~bits).grey for e in (fog, clear))
    assert int(foggy_on.max()) < int(clear_on.max())


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
