"""A window of the sensor gets the very pixels that the full frame has there, whatever draws or codes them."""

import copy
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from vocc_torch.hardware import Camera
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.effects import Context
from vocc_torch.simulation.effects.coding import Jpeg
from vocc_torch.simulation.effects.noise import (
    TILE_PX,
    SensorPattern,
    picture_tiles,
    standard_normals,
    tile_parts,
)
from vocc_torch.simulation.effects.sensor import (
    Bayer,
    DarkCurrent,
    Dsnu,
    FullWell,
    Gain,
    HotPixels,
    Photoelectrons,
    Prnu,
    ReadNoise,
    RowNoise,
    ShotNoise,
)
from vocc_torch.types import Scene

CAMERA = replace(Camera(), width_px=420, height_px=300)
"""A sensor of some tiles, cut by none and all of its sides."""

NEW = (ShotNoise(), ReadNoise(3.0), RowNoise(1.5))
FIXED = (Prnu(0.02), Dsnu(2.0), HotPixels(0.01, 1e6))
CHAIN = (
    Bayer(),
    Photoelectrons(0.6),
    Prnu(0.01),
    DarkCurrent(2e4),
    HotPixels(1e-3, 1e6),
    ShotNoise(),
    FullWell(20_000),
    Dsnu(2.0),
    RowNoise(1.5),
    ReadNoise(3.0),
    Gain(),
)


def frame_keys(frames, *, seed=0, take="frame"):
    return [FrameKey(BlockKey(seed, "windows", 0), frame, take) for frame in range(frames)]


def run(value, *effects, keys=None, origin=None, camera=CAMERA):
    keys = frame_keys(len(value)) if keys is None else keys
    origin = None if origin is None else torch.tensor(origin).view(len(value), 2)
    context = Context(Scene.of(len(value)), camera, keys, origin, effects)
    for effect in effects:
        value = effect(value, context)
    return value


def light(frames, low, high, dtype=torch.float32):
    """Full frames whose pixels differ, (B,1,300,420)."""
    rng = np.random.default_rng(8)
    return torch.from_numpy(rng.uniform(low, high, (frames, 1, *CAMERA.sensor_px))).to(dtype)


def cut(full, origin, size):
    """The windows of full frames, (B,1,H,W)."""
    (height, width) = size
    return torch.stack(
        [frame[:, y : y + height, x : x + width] for frame, (x, y) in zip(full, origin, strict=True)]
    )


@st.composite
def windows(draw, frames=2, step=1, least=1):
    """Origins (x, y) and a common size, all on the sensor."""
    height, width = CAMERA.sensor_px
    size = draw(st.integers(least, 150)), draw(st.integers(least, 150))
    along = st.tuples(
        st.integers(0, (width - size[1]) // step).map(lambda n: n * step),
        st.integers(0, (height - size[0]) // step).map(lambda n: n * step),
    )
    return [draw(along) for _ in range(frames)], size


# Noise


@pytest.mark.parametrize("effect", [*NEW, *FIXED], ids=lambda effect: effect.name)
@given(window=windows())
@settings(max_examples=6, deadline=None)
def test_a_window_has_the_noise_of_the_full_frame(effect, window):
    """Means from 0 to 12 electrons and beyond: both of shot noise's ways to count."""
    origin, size = window
    for dtype in (torch.float32, torch.float64):
        full = light(2, 0, 12, dtype)
        full[..., 200:] *= 100
        seen = run(cut(full, origin, size), effect, origin=origin)
        assert torch.equal(seen, cut(run(full, effect), origin, size))


def noise_of(effect, frames=1, value=200.0):
    full = torch.full((frames, 1, 1024, 1024), value, dtype=torch.float64)
    return (run(full, effect, camera=Camera(width_px=1024, height_px=1024)) - value).numpy()[:, 0]


@pytest.mark.parametrize(("effect", "sigma"), [(ShotNoise(), math.sqrt(200)), (ReadNoise(3.0), 3.0)])
def test_tiles_are_drawn_independently(effect, sigma):
    """64 tiles: no two alike, none correlated with another, means and variances as of independent draws."""
    noise = noise_of(effect)[0] / sigma
    tiles = noise.reshape(8, TILE_PX, 8, TILE_PX).swapaxes(1, 2).reshape(64, -1)
    pixels = tiles.shape[1]
    correlations = np.corrcoef(tiles)[np.triu_indices(64, 1)] * math.sqrt(pixels)
    assert stats.kstest(correlations, "norm").pvalue > 1e-3
    assert stats.kstest(tiles.mean(axis=1) * math.sqrt(pixels), "norm").pvalue > 1e-3
    spread = (tiles.var(axis=1) - 1) * math.sqrt(pixels / 2)
    assert stats.kstest(spread, "norm").pvalue > 1e-3
    # The same place in all tiles, first numbers first: what a poor seeding would tie together.
    assert stats.kstest(tiles[:, :200].mean(axis=0) * 8, "norm").pvalue > 1e-3


# Tiles


@given(x=st.integers(0, 300), y=st.integers(0, 300), height=st.integers(1, 300), width=st.integers(1, 300))
@settings(max_examples=16, deadline=None)
def test_parts_cover_a_window_once_and_lie_where_they_say(x, y, height, width):
    covered = np.zeros((height, width), dtype=int)
    rows, columns = np.mgrid[y : y + height, x : x + width]
    for part in tile_parts((x, y), (height, width)):
        covered[part.in_window] += 1
        tile = np.mgrid[:TILE_PX, :TILE_PX][:, *part.in_tile]
        np.testing.assert_array_equal(part.row * TILE_PX + tile[0], rows[part.in_window])
        np.testing.assert_array_equal(part.column * TILE_PX + tile[1], columns[part.in_window])
    assert (covered == 1).all()


@pytest.mark.parametrize(("at", "tiles"), [((130, 10), 1), ((120, 10), 2), ((120, 120), 4)])
def test_a_window_draws_only_the_tiles_that_it_touches(at, tiles):
    context = Context(Scene.of(), CAMERA, frame_keys(1), torch.tensor([at]))
    (touched,) = picture_tiles(context, "read_noise", (16, 16))
    assert len(touched) == tiles


# The sensor's own patterns are kept


def counted():
    """Standard normal numbers, and the list of tiles drawn."""
    drawn = []

    def draw(generator, size):
        drawn.append(size)
        return standard_normals(generator, size)

    return draw, drawn


def test_a_pattern_is_drawn_once_in_a_run():
    pattern, (draw, drawn) = SensorPattern(), counted()

    def planes(origin, seed=0, frames=1):
        keys = frame_keys(frames, seed=seed)
        context = Context(Scene.of(frames), CAMERA, keys, torch.tensor(origin).view(frames, 2))
        return pattern.planes(torch.zeros(frames, 1, 40, 40), context, "dsnu", draw).clone()

    first = planes([10, 10])
    assert len(drawn) == 1
    planes([[10, 10], [100, 10]], frames=2)
    assert len(drawn) == 2
    assert torch.equal(planes([10, 10]), first)
    assert len(drawn) == 2
    assert not torch.equal(planes([10, 10], seed=1), first)
    assert torch.equal(planes([10, 10]), first)
    assert len(drawn) == 4


@pytest.mark.parametrize("effect", FIXED, ids=lambda effect: effect.name)
def test_what_is_kept_changes_neither_the_effect_nor_later_frames(effect):
    fresh = type(effect)(**{name: getattr(effect, name) for name in effect.__match_args__})
    value = torch.full((2, 1, *CAMERA.sensor_px), 90.0)
    first = run(value, fresh).clone()
    assert fresh == effect
    assert hash(fresh) == hash(effect)
    assert "pattern" not in repr(fresh)
    run(value, fresh, *CHAIN[2:-1])
    assert torch.equal(run(value, fresh), first)
    assert len(pickle.dumps(fresh)) < 1000
    for again in (pickle.loads(pickle.dumps(fresh)), copy.deepcopy(fresh)):
        assert torch.equal(run(value, again), first)


# What else fills the sensor


@pytest.mark.parametrize("quality", [10, 50, 75, 95, 100])
@given(data=st.data())
@settings(max_examples=6, deadline=None)
def test_a_window_of_whole_blocks_is_coded_as_in_the_full_frame(quality, data):
    """Also where the sensor cuts the last block: 300 is no multiple of 8, nor are 420 and 1."""
    full = torch.from_numpy(np.random.default_rng(2).integers(0, 256, (2, 1, 300, 420), dtype=np.uint8))
    coded = run(full, Jpeg(quality))
    along = []
    for sensor in CAMERA.sensor_px:
        first = data.draw(st.integers(0, sensor // 8))
        last = data.draw(st.integers(first + 1, -(-sensor // 8)))
        along.append(slice(8 * first, min(8 * last, sensor)))
    part = (..., *along)
    at = [along[1].start, along[0].start]
    assert torch.equal(run(full[part], Jpeg(quality), origin=[at, at]), coded[part])


def test_a_windows_coding_does_not_hang_on_rounding_errors():
    """Coded as grey RGB, one pixel of this window rounds the other way than in the full frame."""
    full = torch.from_numpy(np.random.default_rng(11).integers(80, 130, (1, 1, 128, 1920), dtype=np.uint8))
    part = (..., slice(8, 72), slice(160, 800))
    seen = run(full[part], Jpeg(80), origin=[[160, 8]])
    assert torch.equal(seen, run(full, Jpeg(80))[part])


def test_black_and_white_blocks_stay_black_and_white():
    for grey in (0, 1, 128, 254, 255):
        frame = torch.full((1, 1, 24, 24), grey, dtype=torch.uint8)
        assert torch.equal(run(frame, Jpeg(100)), frame)
