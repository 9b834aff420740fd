"""What classifiers see of an LED, against windows cut one by one."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.util import view_as_windows

from vocc_torch.errors import VoccError
from vocc_torch.receiver.classifiers import Inputs, Patch
from vocc_torch.receiver.reader import Greys, Readings
from vocc_torch.types import PanelShape

SHAPE = PanelShape(3, 5)


def readings(samples, frames=2, seed=0, low=1.0):
    generator = torch.Generator().manual_seed(seed)
    size = (frames, 1, (SHAPE.rows + 2) * samples, (SHAPE.columns + 2) * samples)
    patches = low + (255.0 - low) * torch.rand(size, generator=generator)
    features = torch.randn(
        frames, SHAPE.rows, SHAPE.columns, 3, generator=generator, dtype=torch.float64
    )
    cell_px = torch.rand(frames, 2, generator=generator) * 9 + 1
    grey = features[..., 0]
    return Readings(features, Greys(grey, grey), patches, cell_px)


@settings(max_examples=30, deadline=None)
@given(
    st.sampled_from([1, 3]),
    st.sampled_from([1, 2, 4]),
    st.sampled_from(["grey", "exposure"]),
    st.integers(0, 9),
)
def test_patches_are_the_windows_about_each_led(cells, samples, domain, seed):
    seen = readings(samples=4, seed=seed)
    patch = Patch(cells=cells, samples=samples, domain=domain, relative="white")
    x = Inputs((), patch).of(seen).numpy()
    light = (seen.patches[:, 0].double().numpy() / 255.0) ** (
        2.2 if domain == "exposure" else 1.0
    )
    step = 4 // samples
    for frame, picture in enumerate(light):
        rows, columns = (size // step for size in picture.shape)
        small = picture.reshape(rows, step, columns, step).mean(axis=(1, 3))
        windows = view_as_windows(small, (patch.side, patch.side), step=samples)
        inner = windows if cells == 3 else windows[1:-1, 1:-1]
        np.testing.assert_allclose(
            x[frame], inner.reshape(SHAPE.rows, SHAPE.columns, -1), rtol=2e-6
        )


def test_features_first_then_the_patch_then_level_and_pitch():
    seen = readings(samples=2)
    inputs = Inputs(("ngr", "agr"), Patch(cells=1, samples=1, level=True, pitch=True))
    x = inputs.of(seen)
    assert x.shape == (2, SHAPE.rows, SHAPE.columns, inputs.size) == (2, 3, 5, 5)
    torch.testing.assert_close(x[..., :2], seen.features[..., [2, 0]].float())
    mean = seen.patches[:, 0, 2:-2, 2:-2].mean(dim=(1, 2)) / 255.0
    torch.testing.assert_close(x[..., 3], mean.view(-1, 1, 1).expand(2, 3, 5))
    torch.testing.assert_close(
        x[..., 4], seen.cell_px.mean(dim=1).view(-1, 1, 1).expand(2, 3, 5)
    )


@pytest.mark.parametrize(
    ("settings_given", "words"),
    [
        ({"features": ["agr", "agr"]}, ["inputs.features", "agr"]),
        ({"features": []}, ["must see something"]),
        ({"features": "agr"}, ["inputs.features", "list"]),
        ({"patch": 3}, ["inputs.patch", "mapping"]),
        ({"patch": {"cells": 2}}, ["inputs.patch.cells", "1 or 3"]),
        (
            {"patch": {"samples": 0}},
            ["inputs.patch.samples", "at least 1 and at most 64"],
        ),
        (
            {"patch": {"domain": "light"}},
            ["inputs.patch.domain", "one of grey, exposure"],
        ),
        (
            {"patch": {"gamma": 0}},
            ["inputs.patch.gamma", "at least 0.1 and at most 10"],
        ),
        ({"patch": {"colour": 1}}, ["inputs.patch.colour", "known are"]),
        ({"kind": "features"}, ["inputs.kind", "known are"]),
    ],
)
def test_what_is_refused(settings_given, words):
    with pytest.raises(VoccError) as refused:
        Inputs.parse(settings_given)
    assert all(word in str(refused.value) for word in words), refused.value
