"""Rows exposed one after the other, against sampled time, hand-made phases and the binomial law."""

import math
from functools import partial

import numpy as np
import pytest
import torch
from frame_keys import frame_keys

from vocc_torch.errors import VoccError
from vocc_torch.hardware import Camera, LedPanel
from vocc_torch.simulation.effects.base import Context
from vocc_torch.simulation.effects.light import RollingShutter
from vocc_torch.types import Scene

SMALL = Camera(
    width_px=120, height_px=101, sensor_width_mm=13.2 / 16, exposure_time_s=0.1
)
"""Rows enough for a panel, and an exposure time for round numbers."""


keys = partial(frame_keys, "rows")


def context(scene, *, camera=SMALL, take="frame", origin=None, start=0, panel=None):
    named = keys(len(scene), take=take, start=start)
    return Context(scene, camera, named, origin, (), panel or LedPanel())


def scenes(frames, seed=0):
    """Panels of 25 to 60 rows, anywhere on the sensor and across its border."""
    draw = np.random.default_rng(seed).uniform
    ranges = ((1e3, 32e3), (2e3, 4e3), (30, 70), (86, 118), (-1, 1), (-0.6, 0.6))
    return Scene(*(torch.from_numpy(draw(*limits, frames)) for limits in ranges))


def random_bits(frames, shape=(8, 8), seed=0):
    return torch.from_numpy(
        np.random.default_rng(seed).integers(2, size=(frames, *shape))
    ).bool()


def phases(scene, *, take="frame"):
    """Each frame's phase, drawn as the effect draws it: first from its own stream."""
    return [
        key.generator("effect.rolling_shutter").random()
        for key in keys(len(scene), take=take)
    ]


def light(symbols, shares):
    """Each LED's On share of each row's exposure, (B,H,R,C), summed in a fixed order."""
    total = torch.zeros(
        len(shares), shares.shape[2], *symbols.shape[2:], dtype=torch.float64
    )
    for number in range(symbols.shape[1]):
        total += symbols[:, number, None] * shares[:, number, :, None, None]
    return total


# Shares


def test_light_is_what_sampled_time_says():
    """Each row's exposure in 4000 instants: which symbol shows then; ends are off by one instant."""
    scene, bits = scenes(6), random_bits(6)
    effect = RollingShutter(readout_s=0.9, symbol_s=0.13)
    placed = context(scene)
    symbols, shares = effect(bits, placed), effect.row_shares(placed, 101)
    ours, truth = light(symbols, shares), symbols.shape[1] // 2
    instants = (np.arange(4000) + 0.5) / 4000 * SMALL.exposure_time_s
    tested = 0
    for frame, phase in enumerate(phases(scene)):
        scale = SMALL.focal_length_px / float(scene.distance_m[frame])
        middle = 50.5 + float(scene.offset_y_m[frame]) * scale
        centre = min(max(math.floor(middle), 0), 100)
        start = centre * 0.009 + SMALL.exposure_time_s / 2 - phase * 0.13
        for row in range(101):
            if not abs(row + 0.5 - middle) < 0.24 * scale:
                continue
            number = (
                np.floor((row * 0.009 + instants - start) / 0.13).astype(int) + truth
            )
            expected = symbols[frame].numpy()[number].mean(axis=0)
            np.testing.assert_allclose(ours[frame, row], expected, atol=2.5 / 4000)
            tested += 1
    assert tested > 150


# Refusals


def test_a_symbol_shorter_than_the_exposure_is_refused_when_the_camera_is_known():
    effect = RollingShutter(readout_s=1.0, symbol_s=0.09)
    message = r"^scene\.effects\.rolling_shutter\.symbol_s is 0\.09: it must be at least camera\.exposure_time_s"
    for call in (
        lambda placed: effect(random_bits(1), placed),
        lambda placed: effect.row_shares(placed, 101),
    ):
        with pytest.raises(VoccError, match=message + ", 0.1$"):
            call(context(Scene.of()))
    RollingShutter(readout_s=1.0, symbol_s=0.1)(random_bits(1), context(Scene.of()))
