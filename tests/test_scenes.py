"""Each shipped scene runs what it names and nothing else."""

import functools

import pytest
import torch
import yaml
from composing import study_of

from vocc_torch.measure.link import Link, block_keys
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation.effects import PHYSICAL_ORDER
from vocc_torch.types import PanelShape

KEYS = [FrameKey(BlockKey(0, "scenes", 0), frame) for frame in range(3)]


def plan_of(*words):
    """The study that a command describes."""
    return study_of("device=cpu", *words)


def shot(plan, effects=None, *, panel_only=True):
    """Three frames of a plan's own scenes, near the panel."""
    if effects is not None:
        plan.world.effects.clear()
        plan.world.effects.update(effects)
    scene, bits = plan.world.scene.draw(KEYS[0].block, PanelShape())
    frames = plan.world.simulator().render(
        scene[:3],
        bits[:3],
        nearest_m=plan.world.scene.nearest_m,
        keys=KEYS,
        panel_only=panel_only,
    )
    return frames.grey


def alarm(method):
    """Stand in for a method, with its signature, and raise when it is called."""

    @functools.wraps(method)
    def touched(*_, **__):
        raise AssertionError("an effect that the scene does not name was touched")

    return touched


@pytest.mark.parametrize("scene", ["paper", "night", "dashcam"])
def test_a_scene_touches_only_the_effects_that_it_names(scene, monkeypatch):
    """With every method of every unnamed effect made to raise, the whole link still runs."""
    plan = plan_of(f"scene={scene}")
    for kind in PHYSICAL_ORDER:
        if kind.name in plan.world.effects:
            continue
        methods = {
            name
            for one in kind.__mro__[:-2]
            for name, of in vars(one).items()
            if callable(of)
        }
        for method in ("__init__", *sorted(methods - {"__init__"})):
            if not (
                method.startswith("__")
                and method not in ("__init__", "__post_init__", "__call__")
            ):
                monkeypatch.setattr(kind, method, alarm(getattr(kind, method)))
    seen = next(
        Link.of(
            plan_of(f"scene={scene}", "receiver.locator=truth", "batch_frames=4")
        ).observe(
            plan.world.scene, block_keys(0, "scenes", 4), preambles=True, frames=4
        )
    )
    assert bool(torch.isfinite(seen.readings.features).all())
    assert shot(plan, panel_only=False).dtype == torch.uint8
    spare = next(kind for kind in PHYSICAL_ORDER if kind.name not in plan.world.effects)
    with pytest.raises(AssertionError, match="was touched"):
        spare()


@pytest.mark.parametrize("scene", ["dashcam", "street"])
def test_a_window_has_the_whole_frames_pixels(scene):
    """In the panel's cells and a cell about them; a blur that meets a border differs at the very edge."""
    plan = plan_of(f"scene={scene}")
    scenes, bits = plan.world.scene.draw(KEYS[0].block, PanelShape())
    near, full = (
        plan.world.simulator().render(
            scenes[:2],
            bits[:2],
            nearest_m=plan.world.scene.nearest_m,
            keys=KEYS[:2],
            panel_only=only,
        )
        for only in (True, False)
    )
    height, width = near.grey.shape[-2:]
    edge = 12
    for i in range(2):
        x, y = (near.origin_px[i] - full.origin_px[i]).tolist()
        part = full.grey[i, 0, y : y + height, x : x + width][
            edge:-edge, edge:-edge
        ].int()
        gap = (part - near.grey[i, 0, edge:-edge, edge:-edge].int()).abs()
        assert int(gap.max()) <= 1
        assert float((gap > 0).float().mean()) < 1e-3


def test_the_paper_scene_draws_no_random_numbers(monkeypatch):
    for stream in ("generator", "tiles"):
        monkeypatch.setattr(FrameKey, stream, alarm(getattr(FrameKey, stream)))
    shot(plan_of())
    with pytest.raises(AssertionError, match="was touched"):
        shot(plan_of("scene=night"))


TEN_LINES = """
ambient_lx: [uniform, 1000, 5000]
led_luminance_cd_m2: 3000
distance_m: [uniform, 30, 50]
background_grey: 100
offset_x_m: [uniform, -2, 2]
offset_y_m: 0
effects:
  attenuation: {visibility_m: 2000}
  blooming: {sigma_px: 2}
  pose: {yaw_deg: [uniform, -10, 10]}
"""


def test_an_own_scene_is_a_yaml_of_ten_lines(app, tmp_path):
    own = tmp_path / "mine" / "scene"
    own.mkdir(parents=True)
    (own / "rain.yaml").write_text(TEN_LINES)
    assert len(TEN_LINES.strip().splitlines()) == 10
    small = (
        "budget.frames=64",
        "budget.training_frames=64",
        "experiment.values=[30,40]",
        "name=own",
    )
    ran = app(
        "--config-dir",
        "mine",
        "scene=rain",
        "experiment=scenes",
        "tensorboard=false",
        *small,
    )
    assert ran.status == 0, ran.err
    written = yaml.safe_load((tmp_path / "runs" / "own" / "config.yaml").read_text())
    assert written["scene"]["effects"]["pose"] == {"yaw_deg": ["uniform", -10, 10]}
