"""Trained receivers in a ledger: a resumed run reads them and does not train again.

Their key holds everything that training depends on. They are stored as numbers, texts and arrays, and no code
is executed: a classifier is built from the plan of the resumed run, and then loads its stored state.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import torch

from vocc_torch.boundary import demand_fields
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.plan import ClassifierPlan, Plan, resolve_device
from vocc_torch.measure.store import Store, canonical
from vocc_torch.measure.train import (
    Making,
    Training,
    parts_of,
    train_part,
    training_key,
)
from vocc_torch.receiver.classifiers import plugged
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.model_file import MOST_BYTES, UNFIT, array_of, arrays_as_json

_NUMBERS = ("frames", "missed", "seconds")


def find(store: Store, key: str, plan: Plan) -> Training | None:
    """Give the trained receivers of a ledger, or None if they must be trained.

    Args:
        store: the ledger.
        key: of :func:`vocc_torch.measure.train.training_key`.
        plan: what they are trained for.
    """
    content = store.find(key, 0, 0)
    with suppress(*UNFIT):
        return None if content is None else _unpacked(json.loads(content), plan)
    return None


def keep(store: Store, key: str, plan: Plan, training: Training) -> None:
    """Save trained receivers. A receiver that cannot be saved is trained again on resume.

    Raises:
        VoccError: the ledger cannot be written.
    """
    content = ""
    with suppress(*UNFIT):
        packed = _packed(training)
        if _alike(training, _unpacked(packed, plan), plan):
            content = canonical(packed)
    if 0 < len(content) <= MOST_BYTES:
        store.add(key, 0, 0, content.encode(), anew=True)


def train_plans(
    plans: Sequence[Plan],
    workers: Workers,
    store: Store,
    progress: Callable[[float], object],
) -> tuple[list[Training], int]:
    """Train every plan with its own locator, each receiver separately on one thread.

    Receivers can then be trained in parallel, and the time of each is known. Receivers with equal trainings
    are trained once.

    Args:
        plans: the studies.
        workers: the executor; this process, too, uses one thread.
        store: the store of trained receivers, which is read and extended.
        progress: called with the share of a receiver's training that was done since the last call.

    Returns:
        The training of each plan, with the costs of each receiver in ``making``; and the number of receivers
        that were trained now.

    Raises:
        VoccError: as :func:`train`, or a worker that was ended from outside.
    """
    parts_of_plans = [
        {training_key(part): part for part in parts_of(plan)} for plan in plans
    ]
    parts = {key: part for named in parts_of_plans for key, part in named.items()}
    trained: dict[str, Training] = {}
    for key, part in parts.items():
        if (stored := find(store, key, part)) is not None:
            trained[key] = stored
            progress(1.0)
    # The longest training begins first.
    missing = [key for key in parts if key not in trained]
    longest = sorted(missing, key=lambda key: -_panels(parts[key]))
    told = 0.0

    def tell(share: float) -> None:
        nonlocal told
        told += share
        progress(share)

    here = partial(train_part, progress=tell)
    coming = workers.map(train_part, [parts[key] for key in longest], here)
    for key, training in zip(longest, coming, strict=True):
        trained[key] = training
        # A receiver that was trained in another process has told nothing.
        progress(1 - told)
        told = 0.0
        keep(store, key, parts[key], training)
    joined = [
        Training.joined([trained[key] for key in keys]) for keys in parts_of_plans
    ]
    return joined, len(longest)


def _panels(plan: Plan) -> int:
    """Count the panels that a plan's classifiers learn from."""
    recipes = plan.receiver.classifiers
    return sum(recipe.frames or recipe.training.frames for recipe in recipes)


def _alike(first: Training, other: Training, plan: Plan) -> bool:
    """Whether classifiers score alike to the last bit: one may take up less than it gave."""
    shape, drawn = plan.world.panel.shape, torch.Generator().manual_seed(0)
    for name, learned in first.classifiers.items():
        size = shape.rows, shape.columns, learned.inputs.size
        x = torch.rand(2, *size, generator=drawn).to(resolve_device(plan.world.device))
        if not torch.equal(
            learned.decision_function(x), other.classifiers[name].decision_function(x)
        ):
            return False
    pairs = zip(first.further, other.further, strict=True)
    return all(_alike(*pair, plan) for pair in pairs)


def _packed(training: Training) -> dict[str, Any]:
    """Take a training apart."""
    arrays = {
        **training.flda.state_dict(),
        "features": training.features,
        "bits": training.bits,
    }
    learned = {}
    for name, classifier in training.classifiers.items():
        values, state = plugged.state_of(classifier)
        learned[name] = {"values": values, "arrays": arrays_as_json(state)}
    return {
        **{key: getattr(training, key) for key in _NUMBERS},
        "arrays": arrays_as_json(arrays),
        "classifiers": learned,
        "costs": {name: asdict(cost) for name, cost in training.costs.items()},
        "further": list(map(_packed, training.further)),
    }


def _unpacked(content: Mapping[str, Any], plan: Plan) -> Training:
    """Put a training together."""
    plans: dict[str, ClassifierPlan] = {
        classifier.name: classifier for classifier in plan.receiver.classifiers
    }
    arrays = {name: array_of(packed) for name, packed in content["arrays"].items()}
    device = resolve_device(plan.world.device)
    figures: dict[str, Any] = {key: arrays.pop(key) for key in ("features", "bits")}
    flda = FLDA(arrays["mean"].shape[-1])
    flda.load_state_dict(arrays)
    learned = {}
    for name, stored in content["classifiers"].items():
        state = {key: array_of(array) for key, array in stored["arrays"].items()}
        guarded = plugged.restored(
            plans[name].build, plans[name].inputs, stored["values"], state
        )
        learned[name] = guarded if device.type == "cpu" else guarded.to(device)
    costs = {name: Making(**cost) for name, cost in content["costs"].items()}
    further = tuple(_unpacked(packed, plan) for packed in content["further"])
    numbers: dict[str, Any] = {key: content[key] for key in _NUMBERS}
    training = replace(
        Training(flda.to(device), classifiers=learned, costs=costs, further=further),
        **numbers,
        **figures,
    )
    for record in (training, *costs.values()):
        demand_fields("trained", record)
    samples, features = training.features.shape
    if training.bits.shape != (samples,) or features != len(plan.receiver.reader.names):
        raise ValueError("features and bits are of other numbers of LEDs")
    return training
