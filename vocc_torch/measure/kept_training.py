"""Trained receivers in a ledger: a resumed run reads them and does not train again.

Their key holds everything that training depends on. They are stored as numbers, texts and arrays, and no code
is executed: a classifier is built from the plan of the resumed run, and then loads its stored state.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from typing import Any

import torch

from vocc_torch.boundary import demand_fields
from vocc_torch.measure.executors import Workers
from vocc_torch.measure.plan import Plan, resolve_device
from vocc_torch.measure.store import Store, canonical
from vocc_torch.measure.train import (
    Lesson,
    Making,
    Training,
    assembled,
    lessons_of,
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
    keys_of_plans, lessons = [], dict[str, Lesson]()
    for plan in plans:
        lessons_of_plan = {training_key(*lesson): lesson for lesson in lessons_of(plan)}
        keys_of_plans.append([*lessons_of_plan])
        lessons |= lessons_of_plan

    trained = dict[str, Training]()
    for key, lesson in lessons.items():
        if (stored := find(store, key, lesson.plan)) is not None:
            trained[key] = stored
            progress(1 / lesson.plan.budget.trainings)
    # The longest training begins first.
    missing = [key for key in lessons if key not in trained]
    longest = sorted(missing, key=lambda key: -_panels(lessons[key].plan))
    told = 0.0

    def tell(share: float) -> None:
        nonlocal told
        told += share
        progress(share)

    here = partial(train_part, progress=tell)
    coming = workers.map(train_part, [lessons[key] for key in longest], here)
    for key, training in zip(longest, coming, strict=True):
        plan, trained[key] = lessons[key].plan, training
        # A receiver that was trained in another process has told nothing.
        progress(1 / plan.budget.trainings - told)
        told = 0.0
        keep(store, key, plan, training)
    trainings = [
        assembled(plan, [trained[key] for key in keys])
        for plan, keys in zip(plans, keys_of_plans, strict=True)
    ]
    return trainings, len(longest)


def _panels(plan: Plan) -> int:
    """Count the panels that a plan's classifiers learn from."""
    recipes = plan.receiver.classifiers
    return sum(recipe.frames or recipe.training.frames for recipe in recipes)


def _alike(first: Training, other: Training, plan: Plan) -> bool:
    """Whether classifiers score alike to the last bit: one may take up less than it gave."""
    shape, drawn = plan.world.panel.shape, torch.Generator().manual_seed(0)
    for name, learned in first.classifiers.items():
        x = torch.rand(2, *shape.sides, learned.inputs.size, generator=drawn)
        x = x.to(resolve_device(plan.world.device))
        scores = learned.decision_function(x)
        if not scores.equal(other.classifiers[name].decision_function(x)):
            return False
    return True


def _packed(training: Training) -> dict[str, Any]:
    """Take a training apart."""
    arrays = {"features": training.features, "bits": training.bits}
    learned = {}
    for name, classifier in training.classifiers.items():
        values, state = plugged.state_of(classifier)
        learned[name] = {"values": values, "arrays": arrays_as_json(state)}
    return {
        **{key: getattr(training, key) for key in _NUMBERS},
        "arrays": arrays_as_json(training.flda.state_dict() | arrays),
        "classifiers": learned,
        "costs": {name: asdict(cost) for name, cost in training.costs.items()},
    }


def _unpacked(content: Mapping[str, Any], plan: Plan) -> Training:
    """Put a training together."""
    arrays = {name: array_of(packed) for name, packed in content["arrays"].items()}
    parts: dict[str, Any] = {key: arrays.pop(key) for key in ("features", "bits")}
    parts |= {key: content[key] for key in _NUMBERS}
    device = resolve_device(plan.world.device)
    flda = FLDA(arrays["mean"].shape[-1])
    flda.load_state_dict(arrays)
    learned = {}
    for recipe in plan.receiver.classifiers:
        if (stored := content["classifiers"].get(recipe.name)) is not None:
            state = {key: array_of(array) for key, array in stored["arrays"].items()}
            values = stored["values"]
            guarded = plugged.restored(recipe.build, recipe.inputs, values, state)
            learned[recipe.name] = guarded.to(device)
    training = Training(
        flda.to(device),
        classifiers=learned,
        costs={name: Making(**cost) for name, cost in content["costs"].items()},
        **parts,
    )
    for record in (training, *training.costs.values()):
        demand_fields("trained", record)
    samples, features = training.features.shape
    if training.bits.shape != (samples,) or features != len(plan.receiver.reader.names):
        raise ValueError("features and bits are of other numbers of LEDs")
    return training
