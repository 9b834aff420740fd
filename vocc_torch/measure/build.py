"""From the settings to a study's plan, and from a classifier's settings to the classifier."""

import inspect
import random
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, fields, replace
from importlib.util import find_spec
from pathlib import Path
from typing import cast

import numpy as np
import torch
from hydra.utils import get_object, instantiate
from torch import nn

from vocc_torch.errors import VoccError, section
from vocc_torch.hardware import LedPanel, PanelShape
from vocc_torch.measure import plan as plans
from vocc_torch.measure.config import ClassifierSettings, Settings, effect_settings
from vocc_torch.receiver import bank, location, reader
from vocc_torch.receiver.classifiers import Guarded, Inputs, adapters, protocol, training
from vocc_torch.simulation.scene import SCENE_FIELDS, SceneModel, parsed_scene
from vocc_torch.types import resolve_device

PRECISIONS = {"float32": torch.float32, "float64": torch.float64}

HALF_PRECISIONS = ("bfloat16", "float16", "half")
"""Known to torch and not offered: they change pixels and decided bits (benchmarks/precision.py)."""

RESERVED = (*bank.RECEIVER_NAMES, "_summary")
"""Names that no classifier may have: those of receivers, and of the board that compares them."""


def build_plan(settings: Settings, folder: Path) -> plans.Plan:
    """Build the plan that a configuration describes, checking every value on the way.

    Args:
        settings: the resolved configuration.
        folder: where the results go.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    if settings.precision not in PRECISIONS:
        why = ", half precision changes pixels and bits" if settings.precision in HALF_PRECISIONS else ""
        raise VoccError.of("precision", repr(settings.precision), " or ".join(PRECISIONS) + why)
    resolve_device(settings.device)
    panel, receiver, scene = asdict(settings.panel), settings.receiver, settings.scene
    with section("scene.camera", before="camera"):
        own = {name: value for name, value in vars(scene.camera).items() if value is not None}
        camera = replace(settings.camera, **own)
    shape = PanelShape(panel.pop("rows"), panel.pop("columns"))
    world = plans.World(
        camera=camera,
        panel=LedPanel(shape=shape, **panel),
        scene=SceneModel(**parsed_scene({name: getattr(scene, name) for name in SCENE_FIELDS})),
        effects=effect_settings(scene.effects),
        framing=settings.framing,  # type: ignore[arg-type]  # checked by name in Simulator
        device=settings.device,
        dtype=PRECISIONS[settings.precision],
    )
    receivers = plans.ReceiverPlan(
        names=(*receiver.names, *settings.classifiers),
        classifiers=tuple(classifier_plan(name, one) for name, one in settings.classifiers.items()),
        locator=receiver.locator,  # type: ignore[arg-type]  # checked by name in ReceiverPlan
        location=location.PaperLocator(**asdict(receiver.location)),
        reader=reader.Reader(shape, receiver.samples_per_led, receiver.gradient),  # type: ignore[arg-type]  # checked there
        save=receiver.save,
    )
    experiment, seed, batch = settings.experiment, settings.seed, settings.batch_frames
    return plans.Plan(world, receivers, experiment, settings.budget, folder, seed, batch)


def classifier_plan(name: str, config: ClassifierSettings) -> plans.ClassifierPlan:
    """Build the plan of a classifier that plugs in, checking its settings.

    Args:
        name: its name in the results, a word.
        config: its settings.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    key = f"classifiers.{name}"
    if not name.isidentifier() or name in RESERVED:
        raise VoccError(f"{key}: a classifier's name must be a word, and none of {', '.join(RESERVED)}")
    with section(key):
        keys = {one.name for one in fields(training.TrainingRecipe)}
        for word in config.training:
            if word not in keys:
                raise VoccError(f"training.{word} is not a known key: known are {', '.join(sorted(keys))}")
        return plans.ClassifierPlan(
            name=name,
            build=config.build,
            inputs=Inputs.parse(config.inputs),
            file=config.file,
            digest="" if config.file is None else protocol.ModuleFile(config.file).digest,
            training=training.TrainingRecipe(**config.training),
            frames=config.frames,
            scene=parsed_scene(config.scene),
        )


def built(plan: plans.ClassifierPlan) -> Guarded:
    """Build a classifier, untrained.

    A scikit-learn estimator and a torch module are taken for what they are; a module whose class takes
    ``n_inputs`` is told how many numbers it sees of an LED. Anything else must follow the protocol itself.

    Raises:
        VoccError: a class that does not exist or cannot be built, or that does not follow the protocol.

    Example:
        >>> plan = plans.ClassifierPlan("bayes", {"_target_": "sklearn.naive_bayes.GaussianNB"})
        >>> type(built(plan).classifier).__name__
        'SklearnClassifier'
    """
    settings = dict(plan.build)
    target = str(settings.pop(plans.TARGET))
    home = None if plan.file is None else protocol.ModuleFile(plan.file)
    try:
        kind = get_object(target) if home is None else home.named(target)
        of_torch = isinstance(kind, type) and issubclass(kind, nn.Module)
        if of_torch and "n_inputs" in inspect.signature(cast("type", kind)).parameters:
            settings.setdefault("n_inputs", plan.inputs.size)
        # A module draws its first weights when it is made.
        with seeded(plan.training.seed):
            given = instantiate(settings, _convert_="all")
            made = kind(**given)  # type: ignore[operator]  # refused just below
        if isinstance(made, nn.Module):
            made = adapters.TorchClassifier(made, plan.training)
        elif adapters.is_estimator(made):
            made = adapters.SklearnClassifier(made)
    except VoccError as error:
        raise VoccError(f"classifiers.{plan.name}: {error}") from error
    except (Exception, SystemExit) as error:
        reason = " ".join(str(error.__cause__ or error).split())
        raise VoccError(f"classifiers.{plan.name}.build: {target} cannot be built ({reason})") from error
    return Guarded(plan.name, made, plan.inputs, home)


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Let Python, NumPy and torch draw from a seed, and go on afterwards as if nobody had drawn.

    Args:
        seed: at least 0.

    Example:
        >>> with seeded(0):
        ...     first = torch.rand(1)
        >>> with seeded(0):
        ...     torch.equal(torch.rand(1), first)
        True
    """
    # Estimators without a random_state draw from NumPy's global generator: there is no other to give them.
    kept, state = np.random.get_state(), random.getstate()  # noqa: NPY002
    try:
        with torch.random.fork_rng():
            random.seed(seed)
            np.random.seed(seed % 2**32)  # noqa: NPY002
            torch.manual_seed(seed)
            yield
    finally:
        np.random.set_state(kept)  # noqa: NPY002
        random.setstate(state)


EXTRAS = {"sklearn": "scikit-learn"}
"""Packages that classifiers of the package's own configuration need, by the name that is imported."""


def without_absent(receiver: plans.ReceiverPlan) -> tuple[plans.ReceiverPlan, dict[str, str]]:
    """Leave out the classifiers whose package is an extra that is not installed, and say why.

    Args:
        receiver: the receivers.

    Returns:
        The receivers that can be built, and the reason for each other one by its name.
    """
    left_out = {}
    for one in receiver.classifiers:
        for package, name in EXTRAS.items():
            if package in _packages(one.build) and find_spec(package) is None:
                left_out[one.name] = f"{name} is not installed; pip install {name} adds it"
    kept = tuple(one for one in receiver.classifiers if one.name not in left_out)
    names = tuple(name for name in receiver.names if name not in left_out)
    return replace(receiver, names=names, classifiers=kept), left_out


def _packages(build: Mapping[str, object]) -> Iterator[str]:
    """Yield the packages of a configuration's classes, those within others too."""
    for key, value in build.items():
        if isinstance(value, Mapping):
            yield from _packages(value)
        elif key == plans.TARGET:
            yield str(value).partition(".")[0]
