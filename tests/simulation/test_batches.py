"""Frames of like size drawn together, and what is done once for many of them."""

import kornia
import numpy as np
import pytest
import torch

from vocc_torch import PanelShape, Scene, Simulator
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import SceneModel, batch
from vocc_torch.simulation.effects import Context
from vocc_torch.simulation.effects.blooming import Blooming
from vocc_torch.simulation.geometry import Camera

FAR = Scene.of(distance_m=300.0)


@pytest.mark.parametrize("worth", [0, 1e12])
def test_small_crops_laid_into_large_ones_are_the_large_ones(monkeypatch, worth):
    """In however many groups a batch is drawn, its frames are those drawn one by one on the whole sensor."""
    monkeypatch.setattr(batch, "GROUP_PIXELS", worth)
    camera = Camera(width_px=160, height_px=120, sensor_width_mm=1.1)
    drawn, bits = SceneModel().draw(BlockKey(0, "groups", 0), PanelShape())
    aside = Scene.of(distance_m=40.0, offset_x_m=0.5)
    scene, bits = Scene.cat([drawn[:14], FAR, aside]), bits[:16]
    crops = Simulator(camera, framing="filled").render(scene, bits, nearest_m=30.0).grey
    whole = Simulator(camera, framing="full")
    for i, crop in enumerate(crops):
        assert torch.equal(crop, whole.render(scene[i : i + 1], bits[i : i + 1]).grey[0]), i


def test_the_blur_is_kornias():
    """Products with banded matrices give what Kornia's filter gives on the frame with its border repeated."""
    value = torch.rand(3, 1, 61, 30, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    for sigma in (0.4, 1.5, 6.0):
        effect = Blooming(sigma)
        reach = effect.reach_px
        padded = torch.nn.functional.pad(value, (reach,) * 4, mode="replicate")
        wanted = kornia.filters.gaussian_blur2d(padded, 2 * reach + 1, (sigma, sigma), "constant")
        wanted = wanted[..., reach:-reach, reach:-reach]
        torch.testing.assert_close(effect(value, Context(Scene.of(3), Camera())), wanted, rtol=1e-14, atol=0)


@pytest.mark.parametrize("seed", [0, 7, 2**32 - 1, 2**32, 10**30])
def test_a_stream_follows_from_its_name_whatever_the_seeds_size(seed):
    """The array of words that NumPy reads quickly gives the stream that the list of numbers gives."""
    key = BlockKey(seed, "point", 3)
    entropy = key.generator("bits").bit_generator.seed_seq.entropy
    listed = np.random.SeedSequence([int(word) for word in entropy])
    own = np.random.Generator(np.random.PCG64(listed)).random(4)
    np.testing.assert_array_equal(key.generator("bits").random(4), own)
    assert [int(word) for word in entropy[:2]] == [seed, 3]
