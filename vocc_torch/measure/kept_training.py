"""Trained receivers in a ledger: a run that goes on takes them from there and trains nothing again.

They stand under a key of all that training depends on, as numbers, texts and arrays. Nothing of it is
executed: a classifier is built from the plan of the run that goes on, and takes up what it had learned.
"""

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, replace
from typing import Any

import torch

from vocc_torch.boundary import demand_fields
from vocc_torch.errors import VoccError
from vocc_torch.measure.plan import ClassifierPlan, Plan, resolve_device
from vocc_torch.measure.store import Store, canonical
from vocc_torch.measure.train import Making, Training, training_key
from vocc_torch.receiver.classifiers import plugged
from vocc_torch.receiver.flda import FLDA
from vocc_torch.receiver.model_file import MOST_BYTES, array_of, arrays_as_json

_NUMBERS = ("frames", "missed", "seconds")
_NOT_KEPT = (
    VoccError,
    LookupError,
    TypeError,
    ValueError,
    RuntimeError,
    AttributeError,
)
"""What a classifier raises that cannot say what it learned, or cannot take it up."""


class KeptTrainings:
    """What was trained, in the stores of a run.

    Args:
        stores: the first takes what is new, all are asked for what is known; none keeps nothing.
    """

    def __init__(self, stores: Iterable[Store]) -> None:
        self._stores = tuple(stores)

    def find(self, key: str, plan: Plan) -> Training | None:
        """Give the trained receivers that stand under a key, or None where they must be trained.

        Args:
            key: of :func:`vocc_torch.measure.train.training_key`.
            plan: what they are trained for.
        """
        for content in (store.trained(key) for store in self._stores):
            with suppress(*_NOT_KEPT):
                if content is not None:
                    return _unpacked(content, plan)
        return None

    def keep(self, key: str, plan: Plan, training: Training) -> None:
        """Save trained receivers. A receiver that cannot be saved is trained again on resume.

        Raises:
            VoccError: the ledger cannot be written.
        """
        content = ""
        with suppress(*_NOT_KEPT):
            packed = _packed(training)
            if _alike(training, _unpacked(packed, plan), plan):
                content = canonical(packed)
        for store in self._stores[:1] if 0 < len(content) <= MOST_BYTES else ():
            store.add_trained(key, content)

    def or_trained(
        self, plan: Plan, train: Callable[[], Training]
    ) -> tuple[Training, bool]:
        """Return a plan's trained receivers and whether they were saved before; otherwise train and save them."""
        key = training_key(plan)
        if (stored := self.find(key, plan)) is not None:
            return stored, True
        trained = train()
        self.keep(key, plan, trained)
        return trained, False


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
