"""What holds for every registered effect: it says what it is, keeps or refuses gradients, and is alone."""

import math
from dataclasses import replace

import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import Camera
from vocc_torch.simulation.effects import PHYSICAL_ORDER, Context, Quantity, build_effects
from vocc_torch.types import Scene

PARAMETERS = {
    "pose": {"yaw_deg": ["uniform", -20, 20], "pitch_deg": 5, "roll_deg": ["choice", -3, 3]},
    "lens_distortion": {"k1": -0.2},
    "rolling_shutter": {"readout_s": 0.016, "symbol_s": 0.002},
    "stuck_leds": {"off_share": 0.2, "on_share": 0.1},
    "led_scatter": {"coefficient_of_variation": 0.1},
    "attenuation": {"visibility_m": 300},
    "background_texture": {"contrast": 0.3},
    "lamps": {"count": 3, "luminance_cd_m2": 1e4, "diameter_m": 0.3},
    "second_panel": {"offset_x_m": 0.6, "offset_y_m": 0.1},
    "airlight": {"visibility_m": 300},
    "occlusion": {"width_share": 0.3, "height_share": 0.4},
    "veiling_glare": {"luminance_cd_m2": 500.0},
    "motion_blur": {"velocity_x_m_s": 30.0},
    "defocus": {"focus_distance_m": 4.0},
    "diffraction": {},
    "blooming": {"sigma_px": 1.5},
    "vignetting": {"corner_loss": 0.2},
    "bayer": {},
    "photoelectrons": {"quantum_efficiency": 0.6},
    "prnu": {"share": 0.01},
    "dark_current": {"electrons_per_s": 1e4},
    "hot_pixels": {"share": 0.05, "electrons_per_s": 1e5},
    "shot_noise": {},
    "full_well": {"electrons": 9000},
    "dsnu": {"electrons": 1.0},
    "row_noise": {"electrons": 2.0},
    "read_noise": {"electrons": 3.0},
    "gain": {},
    "demosaicing": {},
    "saturation": {},
    "quantization": {"bits": 8},
    "jpeg": {"quality": 85},
}
KINDS = {kind.name: kind for kind in PHYSICAL_ORDER}
NO_GRADIENT = {"shot_noise", "quantization", "jpeg"}
CAMERA = Camera(width_px=96, height_px=64, sensor_width_mm=13.2 * 96 / 1920)
SCALES = {Quantity.EXPOSURE: 0.05, Quantity.ELECTRONS: 5000.0, Quantity.GREY: 240.0}
every = pytest.mark.parametrize("name", list(KINDS))


def build(name):
    """One effect, and the chain that it stands in."""
    named = {name: PARAMETERS[name]}
    if KINDS[name].takes == Quantity.ELECTRONS or name == "photoelectrons":
        named |= {key: PARAMETERS[key] for key in ("photoelectrons", "gain")}
    if name in ("quantization", "jpeg"):
        named |= {key: PARAMETERS[key] for key in ("saturation", "quantization")}
    if name == "airlight":
        named["attenuation"] = PARAMETERS["attenuation"]
    chain = build_effects(named)
    return next(effect for effect in chain if effect.name == name), chain


def context_of(chain, frames=2, distance_m=(40.0, 47.0)):
    """Frames of a small sensor with keys of their own."""
    scene = Scene.cat([Scene.of(distance_m=d) for d in distance_m[:frames]])
    keys = [FrameKey(BlockKey(0, "every", 0), frame) for frame in range(frames)]
    return Context(scene, CAMERA, keys, torch.zeros(frames, 2, dtype=torch.int64), chain)


def given(kind, frames=2, dtype=torch.float64):
    """Something that the effect takes, different in every element."""
    source = torch.Generator().manual_seed(3)
    if kind.takes == Quantity.PLACEMENT:
        placed = torch.eye(3, dtype=dtype).repeat(frames, 1, 1)
        placed[:, :, 2] = torch.tensor([0.5, -0.2, 40.0], dtype=dtype)
        return placed
    if kind.takes == Quantity.IMAGE_POINTS:
        return torch.rand(frames, 5, 2, generator=source, dtype=dtype) * 60
    if kind.takes == Quantity.SYMBOLS:
        return torch.rand(frames, 8, 8, generator=source) < 0.5
    if kind.takes == Quantity.LED_LUMINANCE:
        return 3000 * torch.rand(frames, 8, 8, generator=source, dtype=dtype)
    light = torch.rand(frames, 1, 64, 96, generator=source, dtype=dtype)
    if kind.takes == Quantity.DIGITAL:
        return (light * 255).round().to(torch.uint8)
    return light * SCALES.get(kind.takes, 800.0)


def test_every_registered_effect_is_tried_here():
    assert list(PARAMETERS) == list(KINDS)


@every
def test_an_effect_says_what_it_is(name):
    """Source, whether it is differentiable, and an example that the test suite runs."""
    text = KINDS[name].__doc__
    assert "Source:" in text
    assert "ifferentiable" in text or "gradient" in text
    assert ">>> " in text


@every
def test_an_effect_carries_the_gradient_of_light_or_says_that_it_does_not(name):
    """Along a random direction, against a central difference."""
    effect, chain = build(name)
    value, context = given(KINDS[name]), context_of(chain)
    if not value.is_floating_point():
        assert not effect(value, context).is_floating_point()
        return
    value.requires_grad_(True)
    out = effect(value, context)
    if name in NO_GRADIENT:
        assert not out.requires_grad
        return
    source = torch.Generator().manual_seed(4)
    weight = torch.rand(out.shape, generator=source, dtype=out.dtype) - 0.5
    slope = torch.rand(value.shape, generator=source, dtype=value.dtype) - 0.5
    (grad,) = torch.autograd.grad((out * weight).sum(), value)
    step = 1e-6 * float(value.detach().abs().max())
    with torch.no_grad():
        ahead, behind = (effect(value + sign * step * slope, context) for sign in (1, -1))
    change = float(((ahead - behind) * weight).sum()) / (2 * step)
    assert math.isclose(float((grad * slope).sum()), change, rel_tol=2e-5, abs_tol=1e-7)


@every
def test_preambles_share_the_scenes_draws_and_frames_blocks_and_seeds_have_their_own(name):
    effect, chain = build(name)
    if not effect.sampled:
        return
    value, of_sensor = given(KINDS[name]), name in ("prnu", "dsnu", "hot_pixels")

    def seen(take="frame", start=0, **block):
        key = BlockKey(**{"seed": 0, "point": "every", "block": 0, **block})
        keys = [FrameKey(key, start + frame, take) for frame in range(2)]
        return effect(value, replace(context_of(chain), keys=keys))

    anew = ("shot_noise", "read_noise", "row_noise", "second_panel", "rolling_shutter")
    assert same(seen(), seen("on")) == (name not in anew)
    for other in ({"start": 2}, {"block": 1}, {"point": "other"}):
        assert (not same(seen(), seen(**other))) != of_sensor
    assert not same(seen(), seen(seed=1))


def same(one, other):
    """Frames may differ in how many symbols they show."""
    return one.shape == other.shape and torch.equal(one, other)


@every
def test_an_effect_does_not_change_what_it_is_given(name):
    effect, chain = build(name)
    value, context = given(KINDS[name]), context_of(chain)
    before = value.clone()
    effect(value, context)
    assert torch.equal(value, before)


@every
def test_a_frame_does_not_depend_on_its_batch(name):
    effect, chain = build(name)
    value, context = given(KINDS[name]), context_of(chain)
    together = effect(value, context)
    for row in (slice(0, 1), slice(1, 2)):
        alone = Context(
            context.scene[row], CAMERA, context.keys[row], context.origin_px[row], context.effects
        )
        assert torch.equal(effect(value[row], alone), together[row])


@every
def test_an_unknown_parameter_is_refused_by_name(name):
    with pytest.raises(VoccError, match=rf"^scene\.effects\.{name}\.sevrity is not a known parameter"):
        build_effects({name: {**PARAMETERS[name], "sevrity": 1}})


@every
def test_an_effect_says_whether_it_draws_random_numbers(name):
    """Without keys those that draw are refused, by name, and the others do not mind."""
    effect, chain = build(name)
    scene = Scene.cat([Scene.of(distance_m=d) for d in (40.0, 47.0)])
    keyless = Context(scene, CAMERA, [], torch.zeros(2, 2, dtype=torch.int64), chain)
    if effect.sampled:
        with pytest.raises(VoccError, match=rf"scene\.effects\.{name} draws random numbers"):
            effect(given(KINDS[name]), keyless)
    else:
        effect(given(KINDS[name]), keyless)
