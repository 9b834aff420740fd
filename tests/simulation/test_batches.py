"""Frames of like size drawn together, and what is done once for many of them."""

import numpy as np
import pytest
import torch
from kornia.filters import gaussian_blur2d

from vocc_torch import PanelShape, Scene, Simulator
from vocc_torch.hardware import Camera
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import SceneModel, framing
from vocc_torch.simulation.effects import Context
from vocc_torch.simulation.effects.optics import Blooming

FAR = Scene.of(distance_m=300.0)


@pytest.mark.parametrize("worth", [0, 1e12])
def test_small_crops_laid_into_large_ones_are_the_large_ones(monkeypatch, worth):
    """In however many groups a batch is drawn, its frames are those drawn one by one on the whole sensor."""
    monkeypatch.setattr(framing, "GROUP_PIXELS", worth)
    camera = Camera(width_px=160, height_px=120, sensor_width_mm=1.1)
    drawn, bits = SceneModel().draw(BlockKey(0, "groups", 0), PanelShape())
    aside = Scene.of(distance_m=40.0, offset_x_m=0.5)
    scene, bits = Scene.cat([drawn[:14], FAR, aside]), bits[:16]
    crops = Simulator(camera, framing="filled").render(scene, bits, nearest_m=30.0).grey
    whole = Simulator(camera, framing="full")
    for i, crop in enumerate(crops):
        assert torch.equal(crop, whole.render(scene[i : i + 1], bits[i : i + 1]).grey[0]), i


@pytest.mark.parametrize("size", [(61, 30), (7, 300), (400, 500)])
def test_the_blur_of_a_plane_is_that_of_each_frame(size):
    """Frames laid in one plane come out as Kornia's filter blurs them one by one."""
    value = torch.rand(3, 1, *size, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    for sigma in (0.4, 1.5, 6.0):
        effect = Blooming(sigma)
        wanted = gaussian_blur2d(value, 2 * effect.reach_px + 1, (sigma, sigma), "replicate")
        torch.testing.assert_close(effect(value, Context(Scene.of(3), Camera())), wanted, rtol=1e-14, atol=0)


def test_a_frames_blur_is_the_same_to_the_last_bit_wherever_it_lies():
    """In float32, in batches of every size, and as a part of a larger frame."""
    generator = torch.Generator().manual_seed(1)
    value, context, effect = (
        torch.rand(70, 1, 89, 89, generator=generator),
        Context(Scene.of(), Camera()),
        Blooming(1.5),
    )
    together = effect(value, context)
    for frames in (1, 2, 7, 33, 64):
        assert torch.equal(effect(value[:frames], context), together[:frames]), frames
    wide = torch.rand(1, 1, 600, 701, generator=generator)
    wide[0, 0, 301:390, 207:296] = value[0, 0]
    assert torch.equal(effect(wide, context)[0, 0, 307:384, 213:290], together[0, 0, 6:-6, 6:-6])


def test_the_blur_has_a_gradient():
    """Light sent back through the blur is the light blurred: far from the border it is its own adjoint."""
    value = torch.zeros(2, 1, 30, 30, requires_grad=True)
    blurred = Blooming(1.5)(value, Context(Scene.of(2), Camera()))
    (back,) = torch.autograd.grad(blurred[1, 0, 15, 14], value)
    dot = torch.zeros(2, 1, 30, 30)
    dot[1, 0, 15, 14] = 1
    torch.testing.assert_close(back, Blooming(1.5)(dot, Context(Scene.of(2), Camera())), rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("seed", [0, 7, 2**32 - 1, 2**32, 10**30])
def test_a_stream_follows_from_its_name_whatever_the_seeds_size(seed):
    """The array of words that NumPy reads quickly gives the stream that the list of numbers gives."""
    key = BlockKey(seed, "point", 3)
    entropy = key.generator("bits").bit_generator.seed_seq.entropy
    listed = np.random.SeedSequence([int(word) for word in entropy])
    own = np.random.Generator(np.random.PCG64(listed)).random(4)
    np.testing.assert_array_equal(key.generator("bits").random(4), own)
    assert [int(word) for word in entropy[:2]] == [seed, 3]
