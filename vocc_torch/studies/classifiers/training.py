"""Train each receiver by itself, so that many are trained at the same time and each has a price."""

from __future__ import annotations

import pickle
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace

from vocc_torch.measure.link import Link
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.plug_in import ClassifierPlan
from vocc_torch.measure.plug_in_training import TrainedClassifier, train_classifiers
from vocc_torch.measure.train import Training, train
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.receiver.bank import FLDA_FEATURES, feature_indices
from vocc_torch.receiver.discriminant import Discriminant
from vocc_torch.simulation import SceneModel
from vocc_torch.studies.tradeoff.price_list import Making
from vocc_torch.studies.tradeoff.times import threads

Timed = tuple[Training, float]
"""FLDA's training and its seconds."""


def train_rivals(plans: Sequence[Plan], workers: Workers) -> list[tuple[Training, dict[str, Making]]]:
    """Train every plan's receivers; plans that train on the same scenes share them.

    Args:
        plans: plans of the same receivers.
        workers: who does it; each receiver is trained on one thread, here too.

    Returns:
        For each plan what was trained, and what it took by receiver.

    Raises:
        VoccError: no panel in any training frame, or a classifier that cannot be built or trained.
    """
    scenes: list[SceneModel] = [plan.experiment.training_model(plan.world) for plan in plans]
    first = {scenes.index(scene): plan for scene, plan in zip(scenes, plans, strict=True)}
    with worker_losses_told():
        waiting = {place: _handed_out(plan, workers) for place, plan in first.items()}
        made = {place: _collected(first[place], *futures) for place, futures in waiting.items()}
    return [made[scenes.index(scene)] for scene in scenes]


def _handed_out(plan: Plan, workers: Workers) -> tuple[Future[Timed], dict[str, Future[TrainedClassifier]]]:
    """Begin with the longest training."""

    def panels(one: ClassifierPlan) -> int:
        return one.frames or one.training.frames

    ordered = sorted(plan.receiver.classifiers, key=panels, reverse=True)
    alone = {
        one.name: replace(plan, receiver=replace(plan.receiver, names=(one.name,), classifiers=(one,)))
        for one in ordered
    }
    classifiers = {name: workers.submit(_classifier, own) for name, own in alone.items()}
    return workers.submit(_fisher, plan), classifiers


def _fisher(plan: Plan) -> Timed:
    """Train FLDA on all features: one pass has the statistics of all FLDA receivers."""
    own = replace(plan, receiver=replace(plan.receiver, names=tuple(FLDA_FEATURES), classifiers=()))
    with threads(1):
        begun = time.perf_counter()
        training = train(own)
        return training, time.perf_counter() - begun


def _classifier(plan: Plan) -> TrainedClassifier:
    """Train the only classifier of a plan."""
    (name,), link = plan.receiver.names, Link.of(plan)
    with threads(1):
        return train_classifiers(plan, link, {"": link.locator})[""][name]


def _collected(
    plan: Plan, fisher: Future[Timed], classifiers: Mapping[str, Future[TrainedClassifier]]
) -> tuple[Training, dict[str, Making]]:
    """Put a plan's receivers together, with what each took."""
    training, seconds = fisher.result()
    trained = {one.name: classifiers[one.name].result() for one in plan.receiver.classifiers}
    making = {}
    for name in plan.receiver.names:
        if name in trained:
            own = trained[name]
            making[name] = Making(own.seconds, own.simulated_s, own.frames, own.parameters, own.size_bytes)
        elif name in FLDA_FEATURES:
            # What decides, without the sums that it was solved from.
            own_rule, _ = Discriminant.of(training.flda.select(feature_indices(name)).statistics)
            size = len(pickle.dumps(own_rule))
            making[name] = Making(seconds, None, training.frames, len(FLDA_FEATURES[name]) + 1, size)
        else:
            making[name] = Making(parameters=0)
    return replace(training, classifiers=trained), making
