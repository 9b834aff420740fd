"""What the numbers of a study depend on, as plain values: a ledger belongs to exactly these."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import torch

from vocc_torch.studies.plan import Locator, Plan

_SCHEDULING = ("device", "batch_frames", "folder", "workers", "save")


def identity(plan: Plan, locators: Sequence[Locator]) -> dict[str, object]:
    """Name what the counts of a plan depend on.

    Left out is what changes only how long they take or how far they go: device, batch size, workers, folder,
    the frames of the budget and the stop rule, and the values of the axis, each of which is a point with a
    name of its own. The edges of contrast bins stay: they decide which frames are counted together.

    Args:
        plan: the study.
        locators: names of the locators.

    Example:
        >>> from pathlib import Path
        >>> from vocc_torch.studies.plan import Budget, Experiment, ReceiverPlan, World
        >>> experiment = Experiment("d", "distance_m", (50.0,))
        >>> plans = [
        ...     Plan(World(), ReceiverPlan(), experiment, Budget(frames), Path("runs"), batch_frames=frames)
        ...     for frames in (64, 128)
        ... ]
        >>> identity(plans[0], ["truth"]) == identity(plans[1], ["truth"])
        True
    """
    experiment = plan.experiment
    return {
        "seed": plan.seed,
        "world": _plain(plan.world),
        "receiver": {**_fields(plan.receiver), "locator": list(locators)},
        "experiment": {
            "name": experiment.name,
            "axis": experiment.axis,
            "bins": list(experiment.values) if experiment.axis == "contrast" else None,
            "scene": _plain(experiment.scene),
            "training": _plain(experiment.training),
        },
        "training_frames": plan.budget.training_frames,
    }


def _fields(value: object) -> dict[str, object]:
    """Give a dataclass's fields as plain values, without those that are scheduling."""
    fields = dataclasses.fields(value)  # type: ignore[arg-type]  # called with instances of dataclasses only
    return {f.name: _plain(getattr(value, f.name)) for f in fields if f.name not in _SCHEDULING}


def _plain(value: object) -> object:
    """Turn dataclasses into mappings, and torch's types into their names."""
    if dataclasses.is_dataclass(value):
        return _fields(value)
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    return str(value) if isinstance(value, torch.dtype) else value
