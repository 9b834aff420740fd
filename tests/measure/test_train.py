"""Training: what goes into the statistics, and that a kept receiver is the trained one."""

import dataclasses

import numpy as np
import pytest
import torch
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

from vocc_torch.errors import VoccError
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.kept_training import train_plans
from vocc_torch.measure.link import Link
from vocc_torch.measure.plan import Experiment
from vocc_torch.measure.store import Store
from vocc_torch.measure.train import train
from vocc_torch.receiver.deciders import feature_indices
from vocc_torch.rng import BlockKey
from vocc_torch.simulation import Distribution
from vocc_torch.types import Panels


def features_of(plan, model=None):
    """Features and bits of the training frames, straight from the link."""
    link = Link.of(plan)
    frames = plan.budget.training_frames
    keys = [BlockKey(plan.seed, "train", block) for block in range(-(-frames // 64))]
    seen = list(
        link.observe(model or plan.world.scene, keys, preambles=False, frames=frames)
    )
    features = torch.cat([s.readings.features[s.panels.found] for s in seen]).reshape(
        -1, 3
    )
    return features, torch.cat([s.bits[s.panels.found] for s in seen]).reshape(-1)


@pytest.mark.parametrize("locator", ["truth", "paper"])
def test_agrees_with_scikit_learn_on_the_same_frames(make_plan, locator):
    """The direction of LinearDiscriminantAnalysis, on every set of features from the one pass."""
    plan = make_plan(locator=locator, training_frames=100)
    trained = train(plan)
    features, bits = features_of(plan)
    for name in ("flda_agr", "flda_gri", "flda_2", "flda_3"):
        columns = feature_indices(name)
        peer = LinearDiscriminantAnalysis(solver="lsqr").fit(
            features[:, columns].numpy(), bits.numpy()
        )
        mine = trained.flda.select(columns).direction.numpy()
        cosine = (
            mine @ peer.coef_[0] / np.linalg.norm(mine) / np.linalg.norm(peer.coef_[0])
        )
        assert cosine > 1 - 1e-9


def test_missed_panels_are_left_out(make_plan, monkeypatch):
    """Every third panel is missed: the statistics are those of the others."""
    plan = make_plan(locator="paper", training_frames=60)

    class Blinking:
        def __call__(self, frames, shape):
            panels = plan.receiver.location(frames, shape)
            found = panels.found & (torch.arange(len(frames)) % 3 > 0)
            return Panels(panels.corners_px, found, panels.score, panels.candidates)

    monkeypatch.setattr(
        type(plan.receiver),
        "finders",
        lambda _, names: dict.fromkeys(names, Blinking()),
    )
    trained = train(plan)
    assert trained.missed >= 20
    features, bits = features_of(plan)
    assert int(trained.flda.count.sum()) == len(bits) == 64 * (60 - trained.missed)
    assert torch.equal(trained.features, features)
    torch.testing.assert_close(
        trained.flda.mean[1], features[bits].mean(0), rtol=1e-9, atol=0.0
    )


def test_no_panel_in_any_frame_is_refused(make_plan):
    dark = {"led_luminance_cd_m2": Distribution("constant", (0.0,))}
    plan = make_plan(
        locator="paper",
        experiment=Experiment("dark", "distance_m", (50.0,), training=dark),
        panel=dataclasses.replace(make_plan().world.panel, led_reflectance=0.18),
    )
    with pytest.raises(VoccError, match="no panel in any of 128 frames"):
        train(plan)


@pytest.mark.parametrize(("count", "told"), [(1, 4), (2, 1)])
def test_progress_adds_to_one_for_a_receiver(make_plan, tmp_path, count, told):
    """Block by block in this process, at once from another process and from the ledger."""
    plan, heard = make_plan(training_frames=200), []
    with Store.open(tmp_path / "ledger", {}) as store, Workers(count) as workers:
        for is_new, least in ((True, told), (False, 1)):
            heard.clear()
            _, trained_now = train_plans([plan], workers, store, heard.append)
            assert trained_now == is_new
            shares = [share for share in heard if share > 1e-9]
            assert len(shares) == least
            assert sum(shares) == pytest.approx(1)
