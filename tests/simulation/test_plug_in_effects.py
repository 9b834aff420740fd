"""Effects from outside: in their place, alike in every framing, and refused by name where they are broken."""

import re
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.ndimage import uniform_filter1d
from test_framing import SMALL, demand_same_pixels, shots

from vocc_torch import Simulator
from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects import Effect, Quantity, build_effects
from vocc_torch.simulation.effects.optics import Blooming
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import Scene

HERE, EXAMPLES = __name__, Path(__file__).parents[2] / "examples"
STREAK = {"_target_": f"{EXAMPLES}/effects/streak.py:Streak", "share": 0.3}
Streak = type(build_effects({"streak": STREAK})[0]).__mro__[1]
SENSOR = {
    "photoelectrons": {"quantum_efficiency": 0.6},
    "read_noise": {"electrons": 1.0},
    "gain": {},
}


@dataclass(frozen=True)
class Far(Streak):
    """It reaches a hundred pixels and does not say so: what its parent says is of another call."""

    half_px: int = 100

    def __call__(self, value, context):
        return super().__call__(value, context)


class Lying(Far):
    fills_sensor = False
    reach_in_px = Effect.reach_in_px
    __call__ = Far.__call__


class Noise(Effect, on=Quantity.EXPOSURE):
    """Far from the panel frames differ; it does not say that a window would do."""

    fills_sensor = sampled = True

    def __call__(self, value, context):
        (height, width), sides = value.shape[2:], context.camera.sensor_px
        drawn = [
            torch.from_numpy(generator.uniform(0.5, 1.5, sides))
            for generator in context.generators(self.name)
        ]
        places = zip(drawn, context.first_px.tolist(), strict=True)
        return value * torch.stack(
            [image[y : y + height, x : x + width] for image, (x, y) in places]
        ).unsqueeze(1)


FAR = {"_target_": f"{HERE}.Far", "share": 0.3}
CHAINS = {
    "declared": (0, {**PAPER_EFFECTS, "streak": {**STREAK, "half_px": 12}}),
    "declared, amid what fills the sensor": (
        54,
        {**PAPER_EFFECTS, "streak": STREAK, "vignetting": {}},
    ),
    "not declared": (0, {**PAPER_EFFECTS, "far": FAR}),
    "not declared, after noise": (
        0,
        {**PAPER_EFFECTS, **SENSOR, "far": {**FAR, "after": "demosaicing"}},
    ),
    "noise": (0, {**PAPER_EFFECTS, "noise": {"_target_": f"{HERE}.Noise"}}),
    "instances": (0, [Blooming(1.5), Far(0.3)]),
}


@pytest.mark.parametrize("name", CHAINS)
def test_every_framing_and_the_window_have_the_same_pixels(name):
    """Bitwise, but for the border of a window, as wide as the declared reach."""
    edge, chain = CHAINS[name]
    crop, filled, full = (
        shots(chain, framing=framing) for framing in ("crop", "filled", "full")
    )
    near = shots(chain, panel_only=True)
    assert torch.equal(filled.grey, full.grey)
    assert (near.grey.shape < full.grey.shape) == name.startswith("declared")
    demand_same_pixels(crop, full, 0)
    demand_same_pixels(near, full, edge)


@pytest.mark.parametrize("more", [{}, {"vignetting": {}}])
def test_one_that_says_too_little_is_refused(more):
    """Its light, or what it takes for dark, meets the border of a crop."""
    lying = {"far": {**FAR, "_target_": f"{HERE}.Lying", "after": "motion_blur"}}
    with pytest.raises(
        VoccError,
        match=r"^scene\.effects\.far changes the border of a crop of \d+ x \d+ px: reach",
    ):
        shots({**lying, **more})
    assert len(shots(lying, framing="full").grey) == 3


def test_the_streak_is_scipys_uniform_filter():
    light = np.random.default_rng(0).random((1, 1, 9, 300))
    smeared = 0.7 * light + 0.3 * uniform_filter1d(light, 81, axis=-1, mode="nearest")
    np.testing.assert_allclose(
        Streak(share=0.3)(torch.from_numpy(light), None), smeared, rtol=1e-12
    )


class Passing(Effect):
    fills_sensor = False

    def __call__(self, value, context):
        return value.mul_(1)


def passing(quantity, to=None):
    return type("Mine", (Passing,), {}, on=Quantity[quantity], to=to)


PLACES = """PLACEMENT pose, LED_LUMINANCE attenuation, BACKGROUND second_panel, UNLIT airlight, DIGITAL jpeg,
LUMINANCE veiling_glare, EXPOSURE vignetting, ELECTRONS read_noise, GREY demosaicing,
BOUNDED_GREY saturation"""


@pytest.mark.parametrize("row", PLACES.replace("\n", " ").split(", "))
def test_by_itself_it_comes_last_of_its_quantity(row, monkeypatch):
    quantity, before = row.split()
    monkeypatch.setattr(sys.modules[HERE], "Own", passing(quantity), raising=False)
    named = {
        name: {} for name in ("vignetting", "demosaicing", "saturation", "quantization")
    } | SENSOR
    named |= {
        "veiling_glare": {"luminance_cd_m2": 1},
        "jpeg": {"quality": 90},
        "pose": {"yaw_deg": 1},
    }
    named |= {"attenuation": {"visibility_m": 99}, "airlight": {"visibility_m": 99}}
    named["second_panel"] = {"offset_x_m": 2}
    order = [
        effect.name
        for effect in build_effects({"own": {"_target_": f"{HERE}.Own"}, **named})
    ]
    assert order[order.index("own") - 1] == before


def test_after_says_another_place_and_names_decide_within_one():
    placed = {name: {**STREAK, "after": "motion_blur"} for name in ("b", "a")}
    blur = {"blooming": {"sigma_px": 1}, "defocus": {"focus_distance_m": 9}}
    chain = build_effects({**placed, "c": STREAK, **blur})
    assert [effect.name for effect in chain] == ["a", "b", "defocus", "blooming", "c"]
    assert chain == build_effects(
        {**blur, "c": STREAK, **dict(reversed(placed.items()))}
    )
    assert len({*chain}) == 5


# Refusals


class Abstract(Effect, on=Quantity.EXPOSURE):
    pass


class Bare(Effect, on=Quantity.EXPOSURE):
    def __init__(self, strength):
        pass

    __call__ = Passing.__call__


CALLS = [
    (lambda value: value[5, 5, 5, 5, 5], "failed (IndexError: "),
    (lambda value: value[:, :, 1:], "gave (1, 1, "),
    (lambda value: value / 0, "gave a value that is not finite"),
    (
        lambda value: value.numpy(),
        "gave ndarray: it must give a tensor of shape (1, 1, ",
    ),
    (lambda value: value - value.mean(), "gave -"),
    (
        lambda value: value * torch.rand(1),
        "drew from torch's own generator: it must draw from context.gen",
    ),
]
REACHES = [
    (lambda: 1 / 0, "failed (ZeroDivisionError: division by zero)"),
    (lambda: 1.5, ".reach_in_px is 1.5: it must be a whole number"),
    (lambda: None, ".reach_in_px is None: it must be a whole number"),
]
BROKEN = [
    ({"__call__": lambda _, value, context, call=call: call(value)}, said)
    for call, said in CALLS
]
BROKEN += [
    ({"reach_in_px": lambda *_, reach=reach: reach()}, said) for reach, said in REACHES
]


@pytest.mark.parametrize(("methods", "said"), BROKEN)
def test_what_is_broken_is_refused_by_its_name_when_it_runs(methods, said):
    kind = type(
        "Mine",
        (Effect,),
        {"__call__": Passing.__call__, **methods},
        on=Quantity.EXPOSURE,
    )
    simulator = Simulator(SMALL, effects=[kind()])
    bits = torch.ones(1, 8, 8, dtype=torch.bool)
    with pytest.raises(
        VoccError, match=rf"^scene\.effects\.mine ?{re.escape(said)}[^\n]*$"
    ):
        simulator.render(Scene.of(), bits)


REFUSED = [
    ({"_target_": STREAK["_target_"] + "s"}, "mine: file .* has no Streaks"),
    ({"_target_": "no.py:Streak"}, "mine: file no.py cannot be read"),
    ({"_target_": "no_such.Streak"}, "mine: no_such.Streak cannot be imported"),
    ({"_target_": "Streak"}, "mine._target_ is 'Streak': it must be PACKAGE"),
    (
        {"_target_": f"{HERE}.Path"},
        "mine._target_ is .*: it must be a class of vocc_torch's Effect",
    ),
    ({"_target_": f"{HERE}.Bare"}, "mine: Bare must be a dataclass"),
    (
        {**STREAK, "shares": 1},
        "mine.shares is not a known parameter; did you mean share?",
    ),
    ({**STREAK, "share": 2}, "mine.share is 2: it must be above 0 and at most 1"),
    ({**STREAK, "share": "a lot"}, "mine.share is 'a lot': it must be a number"),
    ({"_target_": STREAK["_target_"]}, "mine.share is missing"),
    ({"_target_": f"{HERE}.Abstract"}, "mine failed .TypeError: Can't instantiate"),
    ({**STREAK, "after": "bloming"}, "mine.after is 'bloming': did you mean blooming?"),
    ({**STREAK, "after": "jpeg"}, "mine needs luminous exposure .* give another after"),
    ([passing("SYMBOLS")()], "mine acts on .* it must be a RollingShutter"),
    ([passing("IMAGE_POINTS")()], "mine acts on .* it must be a PointEffect"),
    (
        [passing("EXPOSURE", Quantity.LUMINANCE)()],
        "mine acts on .* it must not make luminance",
    ),
    (
        [Streak(0.1), Streak(0.2)],
        "is .'streak', 'streak'.: it must be effects of different names",
    ),
    ([Streak], "is .* it must be effects by name, or a list of effects"),
]


@pytest.mark.parametrize(("given", "said"), REFUSED)
def test_what_does_not_fit_is_refused_by_its_name(given, said):
    with pytest.raises(VoccError, match=rf"^scene\.effects[. ]{said}[^\n]*$"):
        build_effects(
            given if isinstance(given, list) else {"mine": given, "saturation": {}}
        )
