"""The genie against exhaustive search, SciPy and the simulator itself; truth on the paper's scenes."""

import itertools
import math
from dataclasses import replace

import mpmath
import numpy as np
import pytest
import torch
from scipy.stats import norm

from vocc_torch.measure.genie import Genie
from vocc_torch.measure.likelihood import (
    AFFINE,
    CODING,
    NOISE,
    log_interval_probability,
)
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import Camera, Distribution, LedPanel, SceneModel, Simulator
from vocc_torch.simulation.effects import PHYSICAL_ORDER
from vocc_torch.simulation.effects.sensor import Photoelectrons
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import PanelShape, Scene

NOISY = {
    "attenuation": {"visibility_m": 40_000.0},
    "blooming": {"sigma_px": 1.5},
    "photoelectrons": {"quantum_efficiency": 0.6},
    "prnu": {"share": 0.01},
    "dark_current": {"electrons_per_s": 20_000.0},
    "shot_noise": {},
    "dsnu": {"electrons": 2.0},
    "read_noise": {"electrons": 5.0},
    "gain": {},
    "saturation": {},
    "quantization": {"bits": 8},
}


def panel_of(rows, columns):
    return LedPanel(shape=PanelShape(rows, columns))


def drawn(point, frames, shape=(8, 8), **scene):
    """Scenes, bits and keys of a point of the paper's scenes, some of whose values are held."""
    held = {
        name: Distribution("constant", (float(value),)) for name, value in scene.items()
    }
    key = BlockKey(3, f"genie/{point}", 0)
    scene, bits = replace(SceneModel(), **held).draw(key, PanelShape(*shape))
    return (
        scene[:frames],
        bits[:frames],
        [FrameKey(key, frame) for frame in range(frames)],
    )


def every_bits(leds):
    return torch.tensor(list(itertools.product([False, True], repeat=leds)))


def repeated(scene, count):
    return Scene.cat([scene] * count)


def met(simulator, frame, scene, shape):
    """All bits whose really rendered frame is the one given, as a set of tuples."""
    bits = every_bits(math.prod(shape))
    again = simulator.render(repeated(scene, len(bits)), bits.view(-1, *shape))
    same = (again.grey == frame.grey).flatten(1).all(1)
    return {tuple(row) for row in bits[same].tolist()}


def test_paper_scenes_are_read_without_error_and_proven():
    simulator = Simulator()
    scene, bits, _ = drawn("paper", 6, ambient_lx=1000)
    decision = Genie(simulator).decide(
        simulator.render(scene, bits, nearest_m=30.0), scene
    )
    assert torch.equal(decision.bits, bits)
    assert decision.proven.all()
    assert torch.equal(decision.scores >= 0, bits)
    assert decision.scores.abs().min() > 0.01


@pytest.mark.parametrize("shape", [(2, 2), (3, 3)])
@pytest.mark.parametrize(
    "values",
    [
        {},
        {"distance_m": 500, "ambient_lx": 20000},
        {"led_luminance_cd_m2": 5, "ambient_lx": 20000},
        {"led_luminance_cd_m2": 0.3},
        {"ambient_lx": 5, "distance_m": 40},
    ],
    ids=str,
)
def test_exhaustive_search_finds_no_likelier_bits(shape, values):
    simulator = Simulator(panel=panel_of(*shape))
    scene, bits, _ = drawn("tiny", 4, shape, **values)
    decision = Genie(simulator).decide(simulator.render(scene, bits), scene)
    assert decision.proven.all()
    for i in range(len(scene)):
        own = scene[i : i + 1]
        likeliest = met(simulator, simulator.render(own, bits[i : i + 1]), own, shape)
        answer = decision.bits[i].flatten()
        assert tuple(answer.tolist()) in likeliest
        for led in range(len(answer)):
            other = answer.clone()
            other[led] = ~other[led]
            alike, score = (
                tuple(other.tolist()) in likeliest,
                float(decision.scores[i].flatten()[led]),
            )
            # A pixel at the very edge of its grey value may be told apart by no more than rounding.
            assert abs(score) < 1e-7 if alike else score
            assert score or answer[led]


def scipy_misfits(simulator, frame, scene, bits):
    """Minus the log-likelihood of each of many bits by SciPy's normal distribution: from renders, by hand."""
    named = {effect.name: effect for effect in simulator.effects}
    kept = {name: NOISY[name] for name in ("attenuation", "blooming")}
    linear = Simulator(panel=simulator.panel, effects=kept, dtype=torch.float64)
    mean = linear.render(repeated(scene, len(bits)), bits)
    x, y = (frame.origin_px - mean.origin_px[:1])[0].tolist()
    height, width = mean.grey.shape[-2:]
    grey = (
        frame.grey[
            0, 0, max(-y, 0) : max(-y, 0) + height, max(-x, 0) : max(-x, 0) + width
        ]
        .double()
        .numpy()
    )
    assert (max(x, 0), max(y, 0)) == (0, 0), "the window holds the crop"
    camera = Camera()
    # A grey of 118 is an exposure of 10 / S; auto-ISO gives the background, seen without LEDs, its grey.
    background_lx_s = (
        10
        * camera.exposure_time_s
        / (12.5 * 16)
        * float(scene.ambient_lx)
        * 0.18
        / math.pi
    )
    unit_lx_s = background_lx_s / (float(scene.background_grey) / 118) ** 2.2
    per_unit = (
        Photoelectrons(quantum_efficiency=0.6).electrons_per_lx_s(camera) * unit_lx_s
    )
    light = (mean.grey[:, 0].numpy() / 118) ** 2.2 * per_unit
    dark = named["dark_current"].electrons_per_s / 1500
    variance = (0.01 * light) ** 2 + (light + dark) + 2.0**2 + 5.0**2
    edges = [
        ((grey + side).clip(min=0) / 118) ** 2.2 * per_unit for side in (-0.5, 0.5)
    ]
    edges = [
        np.where(grey == 0, -np.inf, edges[0]),
        np.where(grey == 255, np.inf, edges[1]),
    ]
    low, high = ((edge - light - dark) / np.sqrt(variance) for edge in edges)
    near, far = np.where(low > 0, -low, high), np.where(low > 0, -high, low)
    return -(
        norm.logcdf(near) + np.log1p(-np.exp(norm.logcdf(far) - norm.logcdf(near)))
    ).sum((1, 2))


@pytest.mark.parametrize("distance_m", [60, 200])
def test_under_noise_exhaustive_search_with_scipy_finds_no_likelier_bits(distance_m):
    shape = (3, 3)
    simulator = Simulator(panel=panel_of(*shape), effects=NOISY)
    scene, bits, keys = drawn("noise", 6, shape, distance_m=distance_m, ambient_lx=2000)
    frames = simulator.render(scene, bits, keys=keys, panel_only=True)
    decision = Genie(simulator).decide(frames, scene)
    assert not decision.proven.any()
    every = every_bits(9)
    place = {tuple(row): number for number, row in enumerate(every.tolist())}
    for i in range(len(scene)):
        misfits = scipy_misfits(
            simulator, frames[i : i + 1], scene[i : i + 1], every.view(-1, *shape)
        )
        answer = decision.bits[i].flatten()
        assert place[tuple(answer.tolist())] == misfits.argmin()
        for led in range(9):
            pair = [answer.clone(), answer.clone()]
            pair[0][led], pair[1][led] = False, True
            off, on = (misfits[place[tuple(one.tolist())]] for one in pair)
            assert float(decision.scores[i].flatten()[led]) == pytest.approx(
                off - on, rel=1e-4, abs=1e-5
            )


OPTICS = {
    "fog": {
        "attenuation": {"visibility_m": 200.0},
        "airlight": {"visibility_m": 200.0},
    },
    "glare": {"veiling_glare": {"glare_illuminance_lx": 30000.0, "angle_deg": 15.0}},
    "lens": {"lens_distortion": {"k1": -0.2}, "vignetting": {"corner_loss": 0.2}},
    "blur": {
        "motion_blur": {"velocity_x_m_s": 20.0},
        "defocus": {"focus_distance_m": 10.0},
        "diffraction": {},
    },
    "mosaic": {"bayer": {}},
    "electrons": {
        "photoelectrons": {"quantum_efficiency": 0.6},
        "dark_current": {"electrons_per_s": 20_000.0},
        "full_well": {"electrons": 1e6},
        "gain": {},
    },
    "deep": {"quantization": {"bits": 12}},
    "shallow": {"quantization": {"bits": 6}},
}


@pytest.mark.parametrize("name", OPTICS)
def test_every_effect_that_is_covered_is_undone(name):
    simulator = Simulator(effects={**PAPER_EFFECTS, **OPTICS[name]})
    scene, bits, _ = drawn(f"optics/{name}", 3)
    decision = Genie(simulator).decide(
        simulator.render(scene, bits, panel_only=True), scene
    )
    assert torch.equal(decision.bits, bits)
    assert decision.proven.all()


def test_covered_effects_are_all_tested():
    tested = {
        *PAPER_EFFECTS,
        *NOISY,
        *(effect for effects in OPTICS.values() for effect in effects),
    }
    assert tested == {*AFFINE, *NOISE, *CODING}


REFUSED = {
    "pose": {"yaw_deg": 10.0},
    "rolling_shutter": {"readout_s": 0.01, "symbol_s": 0.01},
    "stuck_leds": {"off_share": 0.1},
    "led_scatter": {"coefficient_of_variation": 0.1},
    "background_texture": {"contrast": 0.2},
    "lamps": {"count": 2, "luminance_cd_m2": 5000.0, "diameter_m": 0.2},
    "second_panel": {"offset_x_m": 1.0},
    "occlusion": {"width_share": 0.1, "height_share": 0.1},
    "hot_pixels": {"share": 0.001, "electrons_per_s": 1e6},
    "row_noise": {"electrons": 2.0},
    "demosaicing": {},
    "jpeg": {"quality": 85},
}


def test_what_is_covered_and_what_is_refused_are_effects():
    assert {*AFFINE, *NOISE, *CODING, *REFUSED} <= {
        kind.name for kind in PHYSICAL_ORDER
    }


@pytest.mark.parametrize(
    ("low", "high"),
    [
        (-1.0, 2.0),
        (30.0, 30.1),
        (-45.0, -44.0),
        (-math.inf, -3.0),
        (8.0, math.inf),
        (1.0, 1.0001),
    ],
)
def test_interval_probability_against_many_digits(low, high):
    with mpmath.workdps(600):
        tails = [
            mpmath.erfc(mpmath.mpf(edge) / mpmath.sqrt(2)) / 2 for edge in (low, high)
        ]
        wanted = float(mpmath.log(tails[0] - tails[1]))
    given = (torch.tensor(edge, dtype=torch.float64) for edge in (low, high))
    assert float(log_interval_probability(*given)) == pytest.approx(wanted, rel=1e-8)
