"""The reader puts rectification and features together, in order, for any batch, crop and precision."""

import pytest
import torch

from vocc_torch.receiver.features import (
    cell_means,
    gradient_radial_inwardness,
    level_ratios,
)
from vocc_torch.receiver.reader import Reader
from vocc_torch.receiver.resample import cell_size_px, centre_greys, rectify
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import SceneModel, Simulator
from vocc_torch.types import PanelShape

SHAPE = PanelShape(8, 8)


@pytest.fixture(scope="module")
def observed():
    """A block of the paper's scenes: frames, true panels and bits."""
    scene, bits = SceneModel().draw(BlockKey(0, "reader", 0), SHAPE)
    simulator = Simulator()
    return simulator.render(scene, bits), simulator.true_panels(scene), bits


@pytest.mark.parametrize("gradient", ["sobel", "central"])
def test_readings_are_agr_gri_and_ngr_of_the_rectified_panels(observed, gradient):
    frames, panels, _ = observed
    readings = Reader(SHAPE, 8, gradient).read(frames, panels)
    patches = rectify(frames, panels, SHAPE, 8)
    means = cell_means(patches, SHAPE)
    agr, ngr = level_ratios(means).unbind(1)
    sizes = cell_size_px(panels.corners_px, SHAPE)
    expected = (
        agr,
        gradient_radial_inwardness(patches, SHAPE, *sizes, gradient),
        ngr,
    )
    assert readings.features.dtype == torch.float64
    assert readings.features.shape == (64, 8, 8, 3)
    assert torch.equal(readings.patches, patches)
    for feature, ours in zip(expected, readings.features.unbind(dim=-1), strict=True):
        assert torch.equal(ours, feature.double())
    assert torch.equal(readings.greys.average, means[:, 1:-1, 1:-1])
    assert torch.equal(readings.greys.centre, centre_greys(frames, panels, SHAPE))
