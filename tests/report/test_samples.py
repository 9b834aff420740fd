"""``samples.png``: the first scenes of training and of the points, before anything is counted."""

import numpy as np
import pytest

from vocc_torch.errors import VoccError
from vocc_torch.report import samples
from vocc_torch.report.led_plots import Picture, picture_figure
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
    full = make_plan(effects=world.effects, framing="full").world.simulator()
    frames = full.render(scene[:2], bits[:2], keys=keys).grey[:, 0].numpy()
    for frame, crop in zip(
        frames, samples.crops(simulator, key, world.scene, 2), strict=True
    ):
        (x, y), (height, width) = crop.origin_px.tolist(), crop.pixels.shape[:2]
        assert (np.diff(crop.pixels, axis=2) == 0).all()
        assert np.array_equal(crop.pixels[..., 0], frame[y : y + height, x : x + width])


def test_a_dozen_scenes_stand_on_the_page(make_plan, tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr(
        samples, "save_figure", lambda figure, _: figures.append(figure)
    )
    samples.write_samples(tmp_path, make_plan())
    (figure,) = figures
    assert len(figure.axes) == 12
    for axes in figure.axes:
        pixels = axes.images[0].get_array()
        assert 60 < np.median(pixels) < 130  # the background
        assert " m, ambient " in axes.get_xlabel()
    names = [axes.get_title(loc="left") for axes in figure.axes]
    assert names[0] == "Training frames"
    assert names[6].startswith("Test frames: ")


def test_a_wide_panel_leaves_no_empty_band():
    """Rows are as tall as what stands in them."""
    heights = []
    for height in (200, 20):
        shown = [Picture(np.full((height, 200, 3), 90, np.uint8))] * 7
        figure = picture_figure(shown, "Wide", columns=6, cell_in=(1.8, 0.75))
        heights.append(figure.get_figheight())
    assert heights[0] - heights[1] == pytest.approx(2 * 0.9 * 1.8)


def test_it_is_there_before_anything_is_counted_and_goes_with_a_run_that_counted_nothing(
    app, tmp_path, monkeypatch
):
    written = []

    def ends(*_):
        written.extend(path.name for path in (tmp_path / "runs" / "x").iterdir())
        raise VoccError("training is ended here")

    monkeypatch.setattr(curve.train, "train", ends)
    complaint = app("task=train", "name=x", "device=cpu").complaint
    assert complaint == "training is ended here"
    assert "samples.png" in written
    assert not (tmp_path / "runs" / "x").exists()
