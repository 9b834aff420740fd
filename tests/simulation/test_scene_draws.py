"""Random streams depend on their key alone, and scenes follow the distributions that they name."""

from dataclasses import fields

import numpy as np
import pytest
import torch
import yaml
from scipy import stats

from vocc_torch.errors import VoccError
from vocc_torch.rng import BlockKey
from vocc_torch.simulation.scene import Distribution, SceneModel
from vocc_torch.types import PanelShape, Scene

SHAPE = PanelShape(8, 8)
NAMES = [field.name for field in fields(Scene)]

GOLDEN_INTEGER = 1688198151
GOLDEN_DISTANCE = 54.98069623714389
GOLDEN_AMBIENT = 5987.094792068904
GOLDEN_BITS = [0, 1, 1, 0, 1, 1, 0, 0]


def blocks(model, count, seed=0, point="test"):
    """Draw and join several blocks."""
    drawn = [model.draw(BlockKey(seed, point, block), SHAPE) for block in range(count)]
    return Scene.cat([scene for scene, _ in drawn]), torch.cat(
        [bits for _, bits in drawn]
    )


# Keys and streams


def test_every_part_of_the_key_changes_the_numbers():
    keys = [
        *((seed, "p", 0, "bits") for seed in (0, 1, 2**32, 2**32 + 1)),
        *(
            (0, "q", 0, "bits"),
            (0, "p", 1, "bits"),
            (0, "p", 0, "noise"),
            (0, "p", 2**32, "bits"),
        ),
        *((0, "bits", 0, "p"), (0, "", 0, "pbits")),
    ]
    firsts = {
        float(BlockKey(s, p, b).generator(stream).random()) for s, p, b, stream in keys
    }
    assert len(firsts) == len(keys)


def test_a_draw_keeps_its_golden_value():
    """What resumed and published runs rely on."""
    # To regenerate, only ever on purpose: python -c "from vocc_torch.rng import BlockKey as K;
    # print(K(0, 'golden', 3).generator('bits').integers(2**32))"
    assert (
        int(BlockKey(0, "golden", 3).generator("bits").integers(2**32))
        == GOLDEN_INTEGER
    )


def test_a_scene_keeps_its_golden_value():
    # To regenerate: python -c "from vocc_torch.rng import BlockKey as K; from vocc_torch.simulation import *;
    # from vocc_torch.types import *; s, b = SceneModel().draw(K(0, 'golden', 3), PanelShape());
    # print(float(s.distance_m[5]), float(s.ambient_lx[63]), b[0, 0].int().tolist())"
    scene, bits = SceneModel().draw(BlockKey(0, "golden", 3), SHAPE)
    assert float(scene.distance_m[5]) == pytest.approx(GOLDEN_DISTANCE, rel=1e-14)
    assert float(scene.ambient_lx[63]) == pytest.approx(GOLDEN_AMBIENT, rel=1e-14)
    assert bits[0, 0].int().tolist() == GOLDEN_BITS


def test_streams_are_uncorrelated():
    """2000 numbers of each stream, for two seeds, points and blocks: every correlation within 4.5 sigma."""
    streams = [f"scene.{name}" for name in NAMES] + ["bits"]
    rows = [
        BlockKey(seed, point, block).generator(stream).random(2000)
        for seed in (0, 1)
        for point in ("a", "b")
        for block in (0, 1)
        for stream in streams
    ]
    correlation = np.corrcoef(rows) - np.eye(len(rows))
    assert np.abs(correlation).max() < 4.5 / np.sqrt(2000)


# Scenes


@pytest.mark.parametrize("name", NAMES)
def test_default_scenes_are_uniform_over_their_bounds(name):
    """Kolmogorov-Smirnov on 3200 draws, with a fixed seed; and no draw outside the bounds."""
    model = SceneModel()
    values = getattr(blocks(model, 50)[0], name).numpy()
    low, high = getattr(model, name).bounds
    assert values.min() >= low
    assert values.max() <= high
    assert stats.kstest(values, stats.uniform(low, high - low).cdf).pvalue > 1e-3
    assert values.mean() == pytest.approx(
        (low + high) / 2, abs=4 * (high - low) / np.sqrt(12 * values.size)
    )


def test_the_default_scene_is_the_papers_table_1():
    model = SceneModel()
    assert model.ambient_lx.bounds == (1000, 32000)
    assert model.led_luminance_cd_m2.bounds == (2000, 4000)
    assert model.distance_m.bounds == (30, 70)
    assert model.background_grey.bounds == (86, 118)
    assert model.nearest_m == 30


def test_log_uniform_draws_are_uniform_in_their_logarithm():
    drawn = Distribution("log_uniform", (10.0, 1000.0)).draw(
        np.random.default_rng(0), 5000
    )
    assert stats.kstest(np.log10(drawn), stats.uniform(1, 2).cdf).pvalue > 1e-3
    assert drawn.min() >= 10 * (1 - 1e-12)
    assert drawn.max() <= 1000 * (1 + 1e-12)


def test_bits_are_fair_and_independent_of_their_neighbours():
    """204800 bits: the mean, and the agreement with the next LED and frame, within 4 sigma of a half."""
    _, bits = blocks(SceneModel(), 50)
    shares = [
        bits.double().mean(),
        (bits[:, :, 1:] == bits[:, :, :-1]).double().mean(),
        (bits[:, 1:] == bits[:, :-1]).double().mean(),
        (bits[1:] == bits[:-1]).double().mean(),
    ]
    assert [float(share) for share in shares] == pytest.approx(
        [0.5] * 4, abs=4 * 0.5 / np.sqrt(170_000)
    )


# Reading distributions


WRONG = """
true ; .nan ; .inf ; uniform ; '50' ; null ; [] ; {} ; [40, 60] ; [normal, 0, 1] ; [uniform, 40]
[uniform, 40, 50, 60] ; [uniform, '40', 60] ; [uniform, 40, .inf] ; [uniform, 60, 40] ; [uniform, false, 40]
[log_uniform, 0, 10] ; [log_uniform, 1] ; [choice] ; [choice, null] ; [constant, 1, 2] ; [[uniform], 1, 2]
"""


@pytest.mark.parametrize(
    "spec", [yaml.safe_load(text) for text in WRONG.replace("\n", ";").split(";")[1:-1]]
)
def test_wrong_specifications_are_refused_in_one_line(spec):
    with pytest.raises(VoccError) as refusal:
        Distribution.parse(spec, "distance_m")
    message = str(refusal.value)
    assert message.startswith(f"scene.distance_m is {spec!r}: ")
    assert "\n" not in message
    assert "must" in message
