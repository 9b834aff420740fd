"""Effects from outside: in their place, alike in every framing, and refused by name where they are broken."""

import re
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from scipy.ndimage import uniform_filter1d
from test_framing import KEYS, SMALL, shots

from vocc_torch import Simulator
from vocc_torch.errors import VoccError
from vocc_torch.simulation.effects import Effect, Quantity, build_effects, within
from vocc_torch.simulation.effects.optics import Blooming
from vocc_torch.simulation.effects.sensor import ReadNoise
from vocc_torch.simulation.effects.view import LensDistortion
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import Scene

EXAMPLES = Path(__file__).parents[2] / "examples"
STREAK = {"_target_": f"{EXAMPLES}/effects/streak.py:Streak", "share": 0.3}
PHOTOGRAPH = f"{EXAMPLES}/backdrops/photograph.py:Photograph"
Streak = type(build_effects({"streak": STREAK})[0]).__mro__[1]
HERE = __name__


@dataclass(frozen=True)
class Undeclared(Streak):
    """It reaches a hundred pixels and does not say so: what its parent says is of another call."""

    half_px: int = 100

    def __call__(self, value, context):
        return super().__call__(value, context)


@dataclass(frozen=True)
class Lying(Undeclared):
    fills_sensor = False
    reach_in_px = Effect.reach_in_px

    def __call__(self, value, context):
        return super().__call__(value, context)


@dataclass(frozen=True)
class Noise(Effect, on=Quantity.EXPOSURE):
    """Far from the panel frames differ; it does not say that a window would do."""

    fills_sensor = sampled = True

    def __call__(self, value, context):
        (height, width), sides = value.shape[2:], context.camera.sensor_px
        drawn = [torch.from_numpy(own.uniform(0.5, 1.5, sides)) for own in context.generators(self.name)]
        places = zip(drawn, context.first_px.tolist(), strict=True)
        return value * torch.stack([one[y : y + height, x : x + width] for one, (x, y) in places]).unsqueeze(
            1
        )


CHAINS = {
    "declared": {**PAPER_EFFECTS, "streak": {**STREAK, "half_px": 12}},
    "declared, wide, amid what fills the sensor": {**PAPER_EFFECTS, "streak": STREAK, "vignetting": {}},
    "undeclared": {**PAPER_EFFECTS, "far": {"_target_": f"{HERE}.Undeclared", "share": 0.3}},
    "undeclared, after noise": {
        **PAPER_EFFECTS,
        "far": {"_target_": f"{HERE}.Undeclared", "share": 0.3, "after": "demosaicing"},
        **{"photoelectrons": {"quantum_efficiency": 0.6}, "shot_noise": {}, "gain": {}},
    },
    "noise": {**PAPER_EFFECTS, "noise": {"_target_": f"{HERE}.Noise"}},
    "instances": [Blooming(1.5), Undeclared(0.3)],
}


@pytest.mark.parametrize("name", CHAINS)
def test_every_framing_and_the_window_have_the_same_pixels(name):
    """Those of what declares nothing bitwise; a window's border of what declares its reach is its own."""
    crop, filled, full = (shots(CHAINS[name], framing=framing) for framing in ("crop", "filled", "full"))
    near, edge = shots(CHAINS[name], panel_only=True), 8 + 46 * (name.startswith("declared, wide"))
    assert torch.equal(filled.grey, full.grey)
    if not name.startswith("declared"):
        edge = 0
        assert crop.grey.shape == near.grey.shape == full.grey.shape
    for seen, cut in ((crop, 0), (near, edge)):
        (height, width), inner = seen.grey.shape[-2:], slice(cut, -cut or None)
        for i, (x, y) in enumerate(seen.origin_px.tolist()):
            part = full.grey[i, 0, y : y + height, x : x + width]
            assert torch.equal(part[inner, inner], seen.grey[i, 0, inner, inner])


def test_what_declares_its_reach_is_rendered_in_crops_and_what_lies_about_it_is_wrong():
    crop, near = (shots(CHAINS["declared"], panel_only=only) for only in (False, True))
    assert crop.grey.shape == near.grey.shape < (3, 1, *SMALL.sensor_px)
    filled, full = (shots([Lying(0.3)], framing=framing) for framing in ("filled", "full"))
    assert not torch.equal(filled.grey, full.grey)


def test_the_streak_is_scipys_uniform_filter():
    light, context = np.random.default_rng(0).random((1, 1, 9, 300)), None
    smeared = 0.7 * light + 0.3 * uniform_filter1d(light, 81, axis=-1, mode="nearest")
    np.testing.assert_allclose(Streak(share=0.3)(torch.from_numpy(light), context), smeared, rtol=1e-12)


def test_a_photograph_stands_behind_the_panel(tmp_path):
    """Its grey values times one number where no panel is, in frames; and in windows the frame's own part."""
    grey = np.random.default_rng(0).integers(20, 256, (17, 30), dtype=np.uint8)
    Image.fromarray(grey).save(tmp_path / "street.png")
    street = {"street": {"_target_": PHOTOGRAPH, "file": str(tmp_path / "street.png")}}
    full, near = (shots(street, panel_only=only) for only in (False, True))
    ratio = full.grey[0, 0].double() / torch.from_numpy(np.kron(grey, np.ones((16, 16))))
    assert float((ratio[:, :150] / ratio[0, 0] - 1).abs().max()) < 1e-5
    assert float((ratio[110:160, 215:265] / ratio[0, 0] - 1).abs().max()) > 0.1
    (height, width) = near.grey.shape[-2:]
    assert (height, width) < SMALL.sensor_px
    for i, (x, y) in enumerate(near.origin_px.tolist()):
        assert torch.equal(full.grey[i, 0, y : y + height, x : x + width], near.grey[i, 0])


class Passing(Effect):
    """Whatever it acts on stays as it is."""

    fills_sensor = False

    def __call__(self, value, context):
        return value


KINDS = {quantity: type(f"On{quantity.name}", (Passing,), {}, on=quantity) for quantity in Quantity}
PLACES = {
    Quantity.PLACEMENT: "pose",
    Quantity.LED_LUMINANCE: "attenuation",
    Quantity.BACKGROUND: "second_panel",
    Quantity.UNLIT: "airlight",
    Quantity.LUMINANCE: "veiling_glare",
    Quantity.EXPOSURE: "vignetting",
    Quantity.ELECTRONS: "read_noise",
    Quantity.GREY: "demosaicing",
    Quantity.BOUNDED_GREY: "saturation",
    Quantity.DIGITAL: "jpeg",
}
"""What an effect from outside follows by itself."""


@pytest.mark.parametrize("quantity", PLACES)
def test_by_itself_it_comes_last_of_its_quantity_in_every_chain(quantity, monkeypatch):
    monkeypatch.setattr(sys.modules[HERE], "Own", KINDS[quantity], raising=False)
    named = {
        "vignetting": {},
        "saturation": {},
        "quantization": {},
        "jpeg": {"quality": 90},
        "demosaicing": {},
    }
    named |= {"photoelectrons": {"quantum_efficiency": 0.6}, "read_noise": {"electrons": 1.0}, "gain": {}}
    named |= {
        "veiling_glare": {"luminance_cd_m2": 1.0},
        "attenuation": {"visibility_m": 99},
        "pose": {"yaw_deg": 1},
    }
    named |= {"airlight": {"visibility_m": 99}, "second_panel": {"offset_x_m": 2.0}}
    order = [one.name for one in build_effects({"own": {"_target_": f"{HERE}.Own"}, **named})]
    assert order[order.index("own") - 1] == PLACES[quantity]


def test_after_says_another_place_and_names_decide_within_one():
    placed = {name: {**STREAK, "after": "motion_blur"} for name in ("b", "a")}
    blur = {"blooming": {"sigma_px": 1}, "defocus": {"focus_distance_m": 9}}
    chain = build_effects({**placed, "c": STREAK, **blur})
    assert [one.name for one in chain] == ["a", "b", "defocus", "blooming", "c"]
    assert chain == build_effects({**blur, "c": STREAK, **dict(reversed(placed.items()))})
    assert len({*chain}) == 5


def test_what_an_effect_does_in_place_stays_its_own(monkeypatch):
    @dataclass(frozen=True)
    class Halving(Effect, on=Quantity.LED_LUMINANCE):
        def __call__(self, value, context):
            return value.mul_(0.5)

    scene, half = Scene.of(2), Simulator(effects=[Halving()])
    dim = Simulator(effects={}).contrast(
        Scene.of(2, led_luminance_cd_m2=float(scene.led_luminance_cd_m2[0]) / 2)
    )
    for _ in range(2):
        assert torch.equal(half.contrast(scene), dim)


# Refusals


@dataclass(frozen=True)
class Broken(Effect, on=Quantity.EXPOSURE):
    way: float = within(0, 10)

    def __post_init__(self):
        super().__post_init__()
        if self.way == 8:
            raise KeyError("eight")

    def reach_in_px(self, camera, nearest_m):
        return {6: 1.5, 7: None}.get(self.way, 0) if self.way != 5 else 1 / 0

    def __call__(self, value, context):
        if self.way == 0:
            return value[5, 5, 5, 5, 5]
        if self.way == 9:
            return value * torch.rand(1)
        return {1: value[:, :, 1:], 2: value / 0, 3: value.numpy(), 4: value - value.mean()}.get(
            self.way, value
        )


class Bare(Effect, on=Quantity.EXPOSURE):
    def __init__(self, strength):
        pass

    def __call__(self, value, context):
        return value


RUNNING = {
    0: "failed (IndexError: too many indices",
    1: "gave (1, 1, ",
    2: "gave a value that is not finite",
    3: "gave ndarray: it must give a tensor of shape (1, 1, ",
    4: "gave -",
    5: "failed (ZeroDivisionError: division by zero)",
    6: "reach_in_px is 1.5: it must be a whole number",
    7: "reach_in_px is None: it must be a whole number",
    8: "cannot be built (KeyError: 'eight')",
    9: "drew from torch's own generator: it must draw from context.generators",
    10: None,
}


@pytest.mark.parametrize("way", RUNNING)
def test_what_is_broken_is_refused_by_its_name_when_it_runs(way):
    given = {"_target_": f"{HERE}.Broken", "way": way}

    def render():
        simulator = Simulator(SMALL, effects={"mine": given})
        return simulator.render(Scene.of(), torch.ones(1, 8, 8, dtype=torch.bool), keys=KEYS[:1])

    if RUNNING[way] is None:
        assert render().grey.isfinite().all()
        return
    with pytest.raises(VoccError) as refused:
        render()
    said = str(refused.value)
    assert re.fullmatch(r"scene\.effects\.mine[^\n]+", said)
    assert RUNNING[way] in said


def on(name):
    return {"mine": {"_target_": f"{HERE}.{name}"}}


REFUSED = {
    "no such class": ({"mine": {**STREAK, "_target_": STREAK["_target_"] + "s"}}, "mine: file .* has no St"),
    "no such file": ({"mine": {"_target_": "no.py:Streak"}}, "mine: file no.py cannot be read"),
    "no such package": ({"mine": {"_target_": "no_such.Streak"}}, "mine: no_such.Streak cannot be imported"),
    "no path": ({"mine": {"_target_": "Streak"}}, "mine._target_ is 'Streak': it must be PACKAGE"),
    "no effect": (on("Path"), "mine._target_ is .*: it must be a class of vocc_torch's Effect"),
    "no dataclass": (on("Bare"), "mine: Bare must be a dataclass"),
    "a name of ours": ({"blooming": STREAK}, "blooming is an effect of the package: give yours another name"),
    "no word": ({"my-own": STREAK}, "my-own: the name of a part must be a word"),
    "nothing of that name": ({"streak": {"share": 0.3}}, "streak is not a known effect"),
    "wrong parameter": ({"mine": {**STREAK, "shares": 1}}, "mine.shares is not a known parameter; did"),
    "out of range": ({"mine": {**STREAK, "share": 2}}, "mine.share is 2: it must be above 0 and at most 1"),
    "word": ({"mine": {**STREAK, "share": "a lot"}}, "mine.share is 'a lot': it must be a number"),
    "no parameter": ({"mine": {"_target_": STREAK["_target_"]}}, "mine.share is missing"),
    "after nothing": ({"mine": {**STREAK, "after": "bloming"}}, "mine.after is 'bloming': did you mean b"),
    "after its light": ({"mine": {**STREAK, "after": "jpeg"}, "saturation": {}}, "mine needs luminous expo"),
    "of symbols": ([KINDS[Quantity.SYMBOLS]()], "on_symbols acts on .* it must be a RollingShutter"),
    "of points": ([KINDS[Quantity.IMAGE_POINTS]()], "on_image_points acts on .* it must be a PointEffect"),
    "backwards": (
        [type("Back", (Passing,), {}, on=Quantity.EXPOSURE, to=Quantity.LUMINANCE)()],
        "back acts on luminous exposure .* it must not make luminance",
    ),
    "twice": ([Streak(0.1), Streak(0.2)], "is .'streak', 'streak'.: it must be effects of different names"),
    "a class": ([Streak], "is .* it must be effects by name, or a list of effects"),
}  # fmt: skip


@pytest.mark.parametrize("row", REFUSED)
def test_what_does_not_fit_is_refused_by_its_name(row):
    named, said = REFUSED[row]
    with pytest.raises(VoccError, match=rf"^scene\.effects[. ]{said}[^\n]*$"):
        build_effects(named)


def test_our_own_may_be_subclassed_and_keeps_what_it_says():
    quiet = type("QuietNoise", (ReadNoise,), {})
    wide = type("WideBlooming", (Blooming,), {"__call__": lambda self, value, context: value})
    bent = type("BentLens", (LensDistortion,), {})
    told = {kind.name: (kind.fills_sensor, kind.unbounded) for kind in (quiet, wide, bent)}
    assert told == {"quiet_noise": (True, False), "wide_blooming": (True, True), "bent_lens": (False, False)}
