"""The shipped classifiers against scikit-learn, NumPy and OpenCV, and the guard about all of them."""

import copy
import random
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from torch import nn

from vocc_torch.errors import VoccError
from vocc_torch.receiver import classifiers
from vocc_torch.receiver.classifiers.training import Checkpoint, TrainingRecipe
from vocc_torch.receiver.levels import two_levels


def panels(frames=40, rows=4, columns=4, features=3, seed=0):
    generator = torch.Generator().manual_seed(seed)
    bits = torch.rand(frames, rows, columns, generator=generator) < 0.5
    x = (
        torch.randn(frames, rows, columns, features, generator=generator)
        + 1.5 * bits[..., None]
    )
    return x, bits


def test_flda_on_any_inputs_is_scikit_learns():
    x, bits = panels()
    mine = classifiers.FldaClassifier().fit(x, bits)
    theirs = LinearDiscriminantAnalysis(priors=[0.5, 0.5]).fit(
        x.reshape(-1, 3).numpy(), bits.reshape(-1).numpy()
    )
    scores = theirs.decision_function(x.reshape(-1, 3).numpy()).reshape(bits.shape)
    np.testing.assert_allclose(
        mine.decision_function(x).numpy(), scores, rtol=2e-3, atol=1e-3
    )


def test_the_equalizer_undoes_a_blur_that_grows_with_distance():
    generator = torch.Generator().manual_seed(3)
    bits = torch.rand(300, 6, 6, generator=generator) < 0.5
    spread = torch.linspace(0.05, 0.24, 300).view(-1, 1, 1)
    lit = torch.nn.functional.pad(bits.float(), (1, 1, 1, 1))
    beside = lit[:, :-2, 1:-1] + lit[:, 2:, 1:-1] + lit[:, 1:-1, :-2] + lit[:, 1:-1, 2:]
    own = bits.float() * (1 - 3 * spread) + spread * beside
    wide = torch.nn.functional.pad(own, (1, 1, 1, 1))
    windows = wide.unfold(1, 3, 1).unfold(2, 3, 1).flatten(3)
    x = torch.cat([windows, spread[..., None].expand(*bits.shape, 1)], dim=-1)
    plain = (own - two_levels(own.flatten(1))[0].view(-1, 1, 1) >= 0) != bits
    equalized = classifiers.LmmseEqualizer(classes=6).fit(x, bits).predict(x) != bits
    assert int(equalized.sum()) < int(plain.sum()) / 2


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(0, 12), min_size=2, max_size=9))
def test_two_means_has_the_least_sum_of_squares(values):
    numbers = np.sort(np.array(values, dtype=float))
    costs = {
        cut: numbers[:cut].var() * cut + numbers[cut:].var() * (len(numbers) - cut)
        for cut in range(1, len(numbers))
    }
    middle = float(two_levels(torch.tensor([values], dtype=torch.float64))[0])
    best = {
        (numbers[:cut].mean() + numbers[cut:].mean()) / 2
        for cut, cost in costs.items()
        if cost <= min(costs.values()) + 1e-9
    }
    assert any(abs(middle - one) < 1e-9 for one in best)


def test_panel_otsu_has_opencvs_threshold():
    generator = torch.Generator().manual_seed(1)
    x = torch.randint(0, 256, (5, 4, 4, 4), generator=generator).float() / 255
    for panel, scores in zip(
        x, classifiers.PanelOtsu().decision_function(x), strict=True
    ):
        greys = (panel * 255).round().to(torch.uint8).reshape(-1, 1).numpy()
        threshold = cv2.threshold(greys, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[0]
        expected = panel.double().mean(dim=-1) * 255 - (threshold + 0.5)
        torch.testing.assert_close(scores, expected, rtol=0, atol=1e-4)


def test_tag_planes_follow_a_slope_that_one_threshold_cannot():
    generator = torch.Generator().manual_seed(2)
    bits = torch.rand(30, 8, 8, generator=generator) < 0.5
    slope = torch.linspace(0.0, 0.8, 8)
    own = slope + 0.3 * bits.float()
    x = own[..., None].expand(*bits.shape, 9)
    errors = {
        kind: int((one.predict(x[..., which]) != bits).sum())
        for kind, one, which in (
            ("planes", classifiers.TagPlanes(0.0, 4), slice(None)),
            ("means", classifiers.PanelKMeans(), slice(4, 5)),
        )
    }
    assert errors["planes"] < errors["means"] / 5


RECIPE = TrainingRecipe(frames=40, epochs=6, batch_leds=64, learning_rate=0.02)


def trained(seed=0, **changes):
    torch.manual_seed(seed)
    recipe = TrainingRecipe(
        **{name: getattr(RECIPE, name) for name in RECIPE.__slots__} | changes
    )
    return classifiers.TorchClassifier(classifiers.Mlp(3, [8]), recipe).fit(*panels())


def test_a_network_learns_and_its_seed_says_all():
    x, bits = panels(seed=9)
    first, again = trained(), trained()
    assert torch.equal(first.decision_function(x), again.decision_function(x))
    assert not torch.equal(
        first.decision_function(x), trained(seed=1).decision_function(x)
    )
    assert int((first.predict(x) != bits).sum()) < 0.2 * bits.numel()


class Interrupted(nn.Module):
    """A module that ends its training in some pass."""

    def __init__(self, last):
        super().__init__()
        self.inner, self.passes, self.last = classifiers.Mlp(3, [8]), 0, last

    def train(self, mode=True):
        self.passes += mode
        if mode and self.passes > self.last:
            raise KeyboardInterrupt
        return super().train(mode)

    def forward(self, x):
        return self.inner(x)


def test_a_training_that_was_interrupted_ends_with_the_same_weights(tmp_path):
    """Weights, losses and passes; another recipe or other panels begin anew."""
    recipe = replace(RECIPE, epochs=6, patience=6, checkpoints=str(tmp_path))
    torch.manual_seed(1)
    first, again = Interrupted(3), Interrupted(100)
    again.load_state_dict(first.state_dict())
    undisturbed = classifiers.TorchClassifier(
        copy.deepcopy(again), replace(recipe, checkpoints=None)
    ).fit(*panels())
    with pytest.raises(KeyboardInterrupt):
        classifiers.TorchClassifier(first, recipe).fit(*panels())
    assert len(list(tmp_path.glob("*.pt"))) == 1
    resumed = classifiers.TorchClassifier(again, recipe).fit(*panels())
    assert (again.passes, undisturbed.module.passes) == (3, 6)
    assert resumed.losses == undisturbed.losses
    assert resumed.earlier_s > 0
    for name, tensor in undisturbed.module.state_dict().items():
        assert torch.equal(again.state_dict()[name], tensor), name
    classifiers.TorchClassifier(
        Interrupted(100), replace(recipe, learning_rate=1e-3)
    ).fit(*panels())
    assert len(list(tmp_path.glob("*.pt"))) == 2


def test_no_bit_of_a_checkpoint_can_flip(tmp_path):
    """One bit anywhere, a byte more or less, or another's name: it is refused; as it was, it is loaded."""
    recipe = replace(RECIPE, epochs=1, checkpoints=str(tmp_path))
    module, cpu = classifiers.Mlp(3, [8]), torch.device("cpu")
    classifiers.TorchClassifier(copy.deepcopy(module), recipe).fit(*panels())
    checkpoint = Checkpoint(str(tmp_path), module, recipe, panels())
    whole, draws = checkpoint.path.read_bytes(), random.Random(5)
    damaged = [whole[:-1], whole[:100], whole + b"0", b"", whole[32:]]
    for bit in (0, 255, 256, *(draws.randrange(8 * len(whole)) for _ in range(100))):
        flipped = bytearray(whole)
        flipped[bit // 8] ^= 1 << bit % 8
        damaged.append(bytes(flipped))
    for content in damaged:
        checkpoint.path.write_bytes(content)
        with pytest.raises(
            VoccError, match=r"^checkpoint .*\.pt is damaged .*: delete it$"
        ):
            checkpoint.load(cpu)
    checkpoint.path.write_bytes(whole)
    assert len(checkpoint.load(cpu)["progress"][2]) == 1
    other = Checkpoint(str(tmp_path), classifiers.Mlp(3, [8]), recipe, panels())
    checkpoint.path.rename(other.path)
    with pytest.raises(VoccError, match="is damaged"):
        other.load(cpu)
