"""Train each receiver by itself, so that many are trained at the same time and the cost of each is known."""

from __future__ import annotations

import pickle
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace

from vocc_torch.measure.link import Link
from vocc_torch.measure.plan import Plan
from vocc_torch.measure.plug_in_training import TrainedClassifier, train_classifiers
from vocc_torch.measure.prices import TrainingCost
from vocc_torch.measure.stage_times import threads
from vocc_torch.measure.train import Training, train
from vocc_torch.measure.workers import Workers, worker_losses_told
from vocc_torch.receiver.bank import FLDA_FEATURES, feature_indices
from vocc_torch.receiver.discriminant import Discriminant

_Timed = tuple[Training, float]


def train_apart(plans: Sequence[Plan], workers: Workers) -> list[tuple[Training, Mapping[str, TrainingCost]]]:
    """Train the receivers of several plans, each on one thread, the longest training first.

    One pass over a plan's training frames has the statistics of all FLDA receivers, which share its time.

    Args:
        plans: which receivers, and what they learn from.
        workers: who does it.

    Returns:
        For each plan what was trained, and the cost by receiver.

    Raises:
        VoccError: no panel in any training frame, or a classifier that cannot be built or trained.
    """
    alone = {
        (place, one.name): replace(
            plan, receiver=replace(plan.receiver, names=(one.name,), classifiers=(one,))
        )
        for place, plan in enumerate(plans)
        for one in plan.receiver.classifiers
    }
    with worker_losses_told():
        classifiers: dict[tuple[int, str], Future[TrainedClassifier]] = {
            key: workers.submit(_classifier, alone[key])
            for key in sorted(alone, key=lambda key: _frames_of(alone[key]), reverse=True)
        }
        passes = [workers.submit(_flda, plan) for plan in plans]
        return [
            _collected(
                plan,
                passes[place].result(),
                {one.name: classifiers[place, one.name].result() for one in plan.receiver.classifiers},
            )
            for place, plan in enumerate(plans)
        ]


def _frames_of(plan: Plan) -> int:
    """Count the panels that a plan's only classifier learns from."""
    (one,) = plan.receiver.classifiers
    return one.frames or one.training.frames


def _flda(plan: Plan) -> _Timed:
    """Train FLDA on all features, in a worker."""
    own = replace(plan, receiver=replace(plan.receiver, names=tuple(FLDA_FEATURES), classifiers=()))
    with threads(1):
        begun = time.perf_counter()
        training = train(own)
        return training, time.perf_counter() - begun


def _classifier(plan: Plan) -> TrainedClassifier:
    """Train the only classifier of a plan, in a worker."""
    (name,), link = plan.receiver.names, Link.of(plan)
    with threads(1):
        return train_classifiers(plan, link, {"": link.locator})[""][name]


def _collected(
    plan: Plan, flda: _Timed, trained: Mapping[str, TrainedClassifier]
) -> tuple[Training, Mapping[str, TrainingCost]]:
    """Put a plan's receivers together, with what each took."""
    training, seconds = flda
    costs = {}
    for name in plan.receiver.names:
        if name in trained:
            own = trained[name]
            costs[name] = TrainingCost(
                own.seconds, own.simulated_s, own.frames, own.parameters, own.size_bytes
            )
        elif name in FLDA_FEATURES:
            # What decides, without the sums that it was solved from.
            rule, _ = Discriminant.of(training.flda.select(feature_indices(name)).statistics)
            size = len(pickle.dumps(rule))
            costs[name] = TrainingCost(seconds, None, training.frames, len(FLDA_FEATURES[name]) + 1, size)
        else:
            costs[name] = TrainingCost(parameters=0)
    return replace(training, classifiers=trained), costs
