"""``samples.png``: the first scenes of training and of the points, before anything is counted."""

import numpy as np
import pytest

from vocc_torch.errors import VoccError
from vocc_torch.report import samples
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.studies import curve


@pytest.mark.parametrize(
    "effects", [{}, {"read_noise": {"electrons": 30.0}}], ids=["plain", "noisy"]
)
def test_crops_are_parts_of_the_frames_that_are_counted(make_plan, effects):
    """Noise that fills the sensor is that of the whole frame."""
    plan = make_plan()
    chain = (
        {"photoelectrons": {"quantum_efficiency": 0.6}, **effects, "gain": {}}
        if effects
        else {}
    )
    world = make_plan(effects={**plan.world.effects, **chain}).world
    simulator, key = world.simulator(), BlockKey(0, "train", 0)
    scene, bits = world.scene.draw(key, world.panel.shape)
    keys = [FrameKey(key, frame) for frame in range(2)]
    whole = make_plan(effects=world.effects, framing="full").world.simulator()
    frames = whole.render(scene[:2], bits[:2], keys=keys).grey[:, 0].numpy()
    for frame, crop in zip(
        frames, samples.crops(simulator, key, world.scene, 2), strict=True
    ):
        (x, y), (height, width) = crop.origin_px.tolist(), crop.pixels.shape[:2]
        assert (np.diff(crop.pixels, axis=2) == 0).all()
        assert np.array_equal(crop.pixels[..., 0], frame[y : y + height, x : x + width])


def test_it_is_there_before_anything_is_counted_and_goes_with_a_run_that_counted_nothing(
    app, tmp_path, monkeypatch
):
    there = []

    def ends(*_):
        there.extend(path.name for path in (tmp_path / "runs" / "x").iterdir())
        raise VoccError("training is ended here")

    monkeypatch.setattr(curve.terminal, "train_shown", ends)
    for task in ("test", "train"):
        assert (
            app(f"task={task}", "name=x", "device=cpu").complaint
            == "training is ended here"
        )
        assert "samples.png" in there
        assert not (tmp_path / "runs" / "x").exists()
        there.clear()
