"""What the numbers of a study depend on, as plain values: a ledger belongs to exactly these."""

from __future__ import annotations

import dataclasses
import importlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from hydra.utils import get_object

from vocc_torch.measure.plan import Locator, Plan, resolve_device
from vocc_torch.measure.plug_in import TARGET, ClassifierPlan
from vocc_torch.receiver.classifiers.module_file import ModuleFile
from vocc_torch.simulation.effects import build_effects


def identity(plan: Plan, locators: Sequence[Locator]) -> dict[str, object]:
    """Name what the counts of a plan depend on.

    Left out is what changes only how long they take or how far they go: batch size, workers, folder, the
    frames of the budget and the stop rule, and the values of the axis, each of which is a point with a name
    of its own. The edges of contrast bins stay: they decide which frames are counted together. So does the
    kind of device, between which rounding may move a pixel by one grey level, and the releases of what draws
    and computes. Effects are named as they are built, so a default that is written out changes nothing.

    Args:
        plan: the study.
        locators: names of the locators.

    Example:
        >>> from pathlib import Path
        >>> from vocc_torch.measure.plan import Budget, Experiment, ReceiverPlan, World
        >>> experiment = Experiment("d", "distance_m", (50.0,))
        >>> plans = [
        ...     Plan(World(), ReceiverPlan(), experiment, Budget(frames), Path("runs"), batch_frames=frames)
        ...     for frames in (64, 128)
        ... ]
        >>> identity(plans[0], ["truth"]) == identity(plans[1], ["truth"])
        True
    """
    experiment = plan.experiment
    world = {name: value for name, value in _fields(plan.world).items() if name not in ("device", "effects")}
    world["effects"] = {one.name: _plain(one) for one in build_effects(plan.world.effects)}
    # Where a training's checkpoints are changes no weight.
    places = [
        replace(one, training=replace(one.training, checkpoints=None)) for one in plan.receiver.classifiers
    ]
    fields = _fields(replace(plan.receiver, classifiers=tuple(places)))
    receiver = {name: value for name, value in fields.items() if name != "save"}
    return {
        "seed": plan.seed,
        "world": world,
        "receiver": {**receiver, "locator": list(locators)},
        "experiment": {
            "name": experiment.name,
            "axis": experiment.axis,
            "bins": list(experiment.values) if experiment.axis == "contrast" else None,
            "scene": _plain(experiment.scene),
            "training": _plain(experiment.training),
        },
        "training_frames": plan.budget.training_frames,
        "made_with": {
            "device": resolve_device(plan.world.device).type,
            "torch": ".".join(torch.__version__.split(".")[:2]),
            "numpy": ".".join(np.__version__.split(".")[:2]),
            **{f"classifiers.{one.name}": _maker(one) for one in plan.receiver.classifiers},
        },
    }


def _maker(one: ClassifierPlan) -> str:
    """Tell the code of a classifier's class from another: a package's release, or the digest of a file."""
    if one.file is not None:
        return one.digest
    try:
        module = importlib.import_module(get_object(str(one.build[TARGET])).__module__)
    except Exception:
        return ""  # it cannot be built, which is told when it is
    if module.__name__.startswith("vocc_torch."):
        return ""
    version = getattr(sys.modules[module.__name__.split(".")[0]], "__version__", None)
    return str(version) if version else ModuleFile(str(module.__file__)).digest


def _fields(value: object) -> dict[str, object]:
    """Give a dataclass's fields as plain values."""
    fields = dataclasses.fields(value)  # type: ignore[arg-type]  # called with instances of dataclasses only
    # What cannot be given cannot tell two studies apart: it is what an instance keeps for itself.
    return {field.name: _plain(getattr(value, field.name)) for field in fields if field.init}


def _plain(value: object) -> object:
    """Turn dataclasses into mappings, and torch's types into their names."""
    if dataclasses.is_dataclass(value):
        return _fields(value)
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    return str(value) if isinstance(value, torch.dtype) else value
