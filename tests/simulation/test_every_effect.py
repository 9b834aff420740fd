"""What holds for every registered effect: it says what it is, keeps or refuses gradients, and is alone."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
import yaml
from frame_keys import frame_keys

from vocc_torch.errors import VoccError
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import Camera
from vocc_torch.simulation.effects import (
    PHYSICAL_ORDER,
    Context,
    Quantity,
    build_effects,
)
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import Scene

PARTS = yaml.safe_load(
    (Path(__file__).parents[2] / "conf/task/effects.yaml").read_text()
)["effects"]["parts"]
"""By an effect's name, that effect and what it needs besides: an effect that is added there is tried here."""
# The sensor here is small, and the light dim.
for _name, _own in {
    "rolling_shutter": {"symbol_s": 0.002},
    "stuck_leds": {"off_share": 0.2, "on_share": 0.1},
    "lamps": {"count": 3, "luminance_cd_m2": 1e4},
    "second_panel": {"offset_x_m": 0.6},
    "hot_pixels": {"share": 0.05},
    "colour": {"peak_nm": ["uniform", 470, 630]},
    "panel_absent": {"share": 0.7},
    "led_look": {"fill": ["uniform", 0.1, 0.4]},
    "leaves": {"count": 30},
}.items():
    PARTS[_name][_name] |= _own
PARAMETERS = {
    name: parameters
    for part in (PAPER_EFFECTS, *PARTS.values())
    for name, parameters in part.items()
}
KINDS = {kind.name: kind for kind in PHYSICAL_ORDER}
NO_GRADIENT = {"shot_noise", "quantization", "jpeg"}
CAMERA = Camera(width_px=96, height_px=64, sensor_width_mm=13.2 * 96 / 1920)
SCALES = {Quantity.EXPOSURE: 0.05, Quantity.ELECTRONS: 5000.0, Quantity.GREY: 240.0}
every = pytest.mark.parametrize("name", list(KINDS))


def chain(name):
    """The paper's effects and one more with what it needs."""
    return {**PAPER_EFFECTS, **PARTS.get(name, {}), name: PARAMETERS[name]} | (
        PARTS["photoelectrons"] if name == "gain" else {}
    )


def build(name):
    """One effect, and the chain that it stands in."""
    effects = build_effects(chain(name))
    return next(effect for effect in effects if effect.name == name), effects


def context_of(chain, frames=2, distance_m=(40.0, 47.0)):
    """Frames of a small sensor with keys of their own."""
    scene = Scene.cat([Scene.of(distance_m=d) for d in distance_m[:frames]])
    keys = frame_keys("every", frames)
    return Context(
        scene, CAMERA, keys, torch.zeros(frames, 2, dtype=torch.int64), chain
    )


def sample_of(kind, frames=2, dtype=torch.float64):
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
    assert set(PARAMETERS) == set(KINDS)


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
    value, context = sample_of(KINDS[name]), context_of(chain)
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
        ahead, behind = (
            effect(value + sign * step * slope, context) for sign in (1, -1)
        )
    change = float(((ahead - behind) * weight).sum()) / (2 * step)
    assert math.isclose(float((grad * slope).sum()), change, rel_tol=2e-5, abs_tol=1e-7)


@every
def test_preambles_share_the_scenes_draws_and_frames_blocks_and_seeds_have_their_own(
    name,
):
    effect, chain = build(name)
    if not effect.sampled:
        return
    value, of_sensor = sample_of(KINDS[name]), name in ("prnu", "dsnu", "hot_pixels")

    def drawn_with(take="frame", start=0, **block):
        key = BlockKey(**{"seed": 0, "point": "every", "block": 0, **block})
        keys = [FrameKey(key, start + frame, take) for frame in range(2)]
        return effect(value, replace(context_of(chain), keys=keys))

    anew = (
        "shot_noise",
        "read_noise",
        "row_noise",
        "second_panel",
        "rolling_shutter",
        "multiplexing",
    )
    assert same(drawn_with(), drawn_with("on")) == (name not in anew)
    for other in ({"start": 2}, {"block": 1}, {"point": "other"}):
        assert (not same(drawn_with(), drawn_with(**other))) != of_sensor
    assert not same(drawn_with(), drawn_with(seed=1))


def same(one, other):
    """Frames may differ in how many symbols they show."""
    return one.shape == other.shape and torch.equal(one, other)


@every
def test_a_frame_does_not_depend_on_its_batch_and_what_is_given_stays_as_it_is(name):
    effect, effects = build(name)
    value, context = sample_of(KINDS[name]), context_of(effects)
    before, together = value.clone(), effect(value, context)
    assert torch.equal(value, before)
    for row in (slice(0, 1), slice(1, 2)):
        alone = replace(
            context,
            scene=context.scene[row],
            keys=context.keys[row],
            origin_px=context.origin_px[row],
        )
        assert torch.equal(effect(value[row], alone), together[row])


@every
def test_an_effect_says_whether_it_draws_random_numbers(name):
    """Without keys those that draw are refused, by name, and the others do not mind."""
    effect, effects = build(name)
    keyless = replace(context_of(effects), keys=[])
    if not effect.sampled:
        effect(sample_of(KINDS[name]), keyless)
        return
    with pytest.raises(
        VoccError, match=rf"scene\.effects\.{name} draws random numbers"
    ):
        effect(sample_of(KINDS[name]), keyless)
