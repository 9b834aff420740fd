import json
from importlib import resources

import numpy as np
import pytest
import torch

from vocc_torch.errors import VoccError
from vocc_torch.receiver.locators.learned import (
    LearnedLocator,
)
from vocc_torch.receiver.panel_net import (
    SHIPPED,
    PanelNet,
)
from vocc_torch.rng import BlockKey, FrameKey
from vocc_torch.simulation import Camera, LedPanel, Simulator
from vocc_torch.simulation.simulator import PAPER_EFFECTS
from vocc_torch.types import PanelShape, Scene

SHAPE = PanelShape(8, 8)
SMALL = Camera(width_px=320, height_px=240, sensor_width_mm=320 * 13.2 / 1920)


@pytest.fixture(scope="module")
def noisy():
    """Eight noisy frames of the paper's panel at 30 to 65 m, and the true corners."""
    draw, count = np.random.default_rng(3), 8
    given = {
        "distance_m": np.linspace(30, 65, count),
        "offset_x_m": draw.uniform(-1, 1, count),
    }
    scene = Scene.of(count, ambient_lx=4000.0)
    parts = [
        torch.from_numpy(given[n]) if n in given else getattr(scene, n)
        for n in scene.__dataclass_fields__
    ]
    noise = {
        "photoelectrons": {"quantum_efficiency": 0.6},
        "shot_noise": {},
        "read_noise": {"electrons": 3.0},
    }
    effects = {**PAPER_EFFECTS, **noise, "gain": {}}
    simulator = Simulator(
        SMALL, LedPanel(board_reflectance=None), effects, framing="full"
    )
    keys = [FrameKey(BlockKey(0, "learned", 0), i) for i in range(count)]
    bits = torch.from_numpy(draw.random((count, 8, 8)) < 0.5)
    return simulator.render(Scene(*parts), bits, keys=keys), simulator.true_panels(
        Scene(*parts)
    )


def test_the_shipped_weights_find_most_panels_in_noise(noisy):
    """What is found is where the panel is."""
    frames, truth = noisy
    panels = LearnedLocator()(frames, SHAPE)
    assert panels.found.sum() >= 6
    assert (panels.false_alarms[panels.found] <= 1e-3).all()
    pitch = (truth.corners_px[:, 1] - truth.corners_px[:, 0]).norm(dim=1) / 8
    off = (panels.corners_px - truth.corners_px).norm(dim=2).amax(1) / pitch
    assert (off[panels.found] < 0.25).all()


def test_what_is_found_does_not_depend_on_the_batch(noisy):
    frames, _ = noisy
    locator = LearnedLocator()
    together = locator(frames, SHAPE)
    for i in (0, 5):
        alone = locator(frames[i : i + 1], SHAPE)
        assert alone.found[0] == together.found[i]
        assert alone.score[0] == together.score[i]
        assert (alone.corners_px[0] - together.corners_px[i]).abs().max() < 1e-2


@pytest.mark.parametrize("level", [0, 90, 255])
def test_nothing_is_found_where_nothing_is(level):
    panels = LearnedLocator()(torch.full((2, 96, 128), level, dtype=torch.uint8), SHAPE)
    assert not panels.found.any()
    assert not panels.corners_px.any()


def damaged(text):
    """Ways in which a file of weights may be wrong, and what is said."""
    content = json.loads(text)
    name = next(iter(content["classifier"]))
    yield text.replace('"judge.', '"other.'), "its checksum does not fit"
    yield text[: len(text) // 2], "damaged or of another kind"
    yield json.dumps({**content, "version": 99}), "format version 99"
    content["classifier"][name]["shape"] = [1]
    yield json.dumps(content), "checksum"


def test_damaged_weights_are_refused(tmp_path):
    text = (resources.files("vocc_torch.receiver") / SHIPPED).read_text()
    for number, (wrong, said) in enumerate(damaged(text)):
        path = tmp_path / f"{number}.json"
        path.write_text(wrong)
        with pytest.raises(VoccError, match=f"weights .*{said}"):
            LearnedLocator(str(path))(torch.zeros(1, 64, 64, dtype=torch.uint8), SHAPE)


def test_the_weights_are_small():
    assert (resources.files("vocc_torch.receiver") / SHIPPED).stat().st_size < 2_000_000
    assert sum(one.numel() for one in PanelNet().parameters()) < 300_000
