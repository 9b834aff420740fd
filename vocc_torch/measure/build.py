"""From plain configuration dataclasses to a study's plan."""

from __future__ import annotations

import math
from dataclasses import asdict, fields, replace
from itertools import pairwise
from pathlib import Path

import torch

from vocc_torch.errors import VoccError
from vocc_torch.measure.config import ClassifierConfig, ExperimentConfig, Settings, effect_settings
from vocc_torch.measure.plan import (
    SCENE_FIELDS,
    Budget,
    Experiment,
    Plan,
    ReceiverPlan,
    World,
    parsed_scene,
)
from vocc_torch.measure.plug_in import ClassifierPlan
from vocc_torch.receiver.bank import RECEIVER_NAMES
from vocc_torch.receiver.classifiers.inputs import Inputs
from vocc_torch.receiver.classifiers.module_file import ModuleFile
from vocc_torch.receiver.classifiers.training import TrainingRecipe
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.simulation import Camera, LedPanel, SceneModel
from vocc_torch.types import PanelShape

PRECISIONS = {"float32": torch.float32, "float64": torch.float64}

HALF_PRECISIONS = ("bfloat16", "float16", "half")
"""Known to torch and not offered: they change pixels and decided bits (benchmarks/precision.py)."""


def build_plan(settings: Settings, folder: Path) -> Plan:
    """Build the plan that a configuration describes, checking every value on the way.

    Args:
        settings: the resolved configuration.
        folder: where the results go.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    return Plan(
        world=_world(settings),
        receiver=_receiver(settings),
        experiment=build_experiment(settings.experiment, "experiment"),
        budget=Budget(**asdict(settings.budget)),
        folder=folder,
        seed=settings.seed,
        batch_frames=settings.batch_frames,
    )


def build_rows(plan: Plan, config: ExperimentConfig, section: str) -> dict[float, Plan]:
    """Build the plans of a grid, a row each, by the value of the row.

    Args:
        plan: the study of the whole grid.
        config: its experiment.
        section: the experiment's key.

    Raises:
        VoccError: rows that are missing, not ascending, or of no value of a scene.
    """
    axis, rows = config.row_axis, config.rows
    if axis not in SCENE_FIELDS or axis == config.axis:
        allowed = ", ".join(name for name in SCENE_FIELDS if name != config.axis)
        raise VoccError(f"{section}.row_axis is {axis!r}: it must be one of {allowed}")
    ascending = all(a < b for a, b in pairwise(rows))
    if not rows or not ascending or not all(map(math.isfinite, rows)):
        raise VoccError(f"{section}.rows is {rows}: it must be finite numbers in ascending order")
    if (least := min(*config.values, *rows)) <= 0:
        which = "rows" if least in rows else "values"
        raise VoccError(f"{section}.{which} has {least:g}: a grid takes logarithms, it must be above 0")
    return {value: replace(plan, experiment=plan.experiment.at_row(axis, value)) for value in rows}


def build_experiment(config: ExperimentConfig, section: str) -> Experiment:
    """One experiment; its refusals name the configuration's key."""
    try:
        return Experiment(
            name=config.name,
            axis=config.axis,
            values=tuple(config.values),
            scene=parsed_scene(config.scene, f"{section}.scene"),
            training=parsed_scene(config.training, f"{section}.training"),
        )
    except VoccError as error:
        if section == "experiment":
            raise
        raise VoccError(str(error).replace("experiment.", f"{section}.", 1)) from None


def _world(settings: Settings) -> World:
    """Camera, panel, scenes and effects."""
    if settings.precision not in PRECISIONS:
        why = ", half precision changes pixels and bits" if settings.precision in HALF_PRECISIONS else ""
        raise VoccError(f"precision is {settings.precision!r}: it must be {' or '.join(PRECISIONS)}{why}")
    panel = asdict(settings.panel)
    shape = PanelShape(panel.pop("rows"), panel.pop("columns"))
    distributions = parsed_scene({name: getattr(settings.scene, name) for name in SCENE_FIELDS})
    return World(
        camera=_camera(settings),
        panel=LedPanel(shape=shape, **panel),
        scene=SceneModel(**distributions),
        effects=effect_settings(settings.scene.effects),
        framing=settings.framing,  # type: ignore[arg-type]  # checked by name in Simulator
        device=settings.device,
        dtype=PRECISIONS[settings.precision],
    )


def _camera(settings: Settings) -> Camera:
    """The camera with the scene's settings of it; refusals name the key that the value came from."""
    own = {name: value for name, value in asdict(settings.scene.camera).items() if value is not None}
    camera = asdict(settings.camera) | own
    limits = camera.pop("iso_limits")
    try:
        if limits is not None and len(limits) != 2:
            raise VoccError(f"camera.iso_limits is {limits}: it must be [low, high] or null")
        return Camera(**camera, iso_limits=None if limits is None else (limits[0], limits[1]))
    except VoccError as error:
        named = str(error).removeprefix("camera.").split(" ")[0]
        raise VoccError(f"scene.{error}" if named in own else str(error)) from None


def _receiver(settings: Settings) -> ReceiverPlan:
    """Receivers and what they share."""
    receiver = settings.receiver
    shape = PanelShape(settings.panel.rows, settings.panel.columns)
    plugged_in = tuple(_classifier(name, one) for name, one in settings.classifiers.items())
    return ReceiverPlan(
        names=(*receiver.names, *settings.classifiers),
        classifiers=plugged_in,
        locator=receiver.locator,  # type: ignore[arg-type]  # checked by name in ReceiverPlan
        location=_location(settings),
        reader=Reader(shape, receiver.samples_per_led, receiver.gradient),  # type: ignore[arg-type]  # checked there
        save=receiver.save,
    )


def _classifier(name: str, config: ClassifierConfig) -> ClassifierPlan:
    """A classifier that plugs in; its refusals name the configuration's key."""
    section = f"classifiers.{name}"
    if not name.isidentifier() or name in RECEIVER_NAMES:
        raise VoccError(f"{section}: a classifier's name must be a word, and none of the built-in receivers")
    try:
        known = {one.name for one in fields(TrainingRecipe)}
        for key in config.training:
            if key not in known:
                raise VoccError(f"training.{key} is not a known key: known are {', '.join(sorted(known))}")
        return ClassifierPlan(
            name=name,
            build=config.build,
            inputs=Inputs.parse(config.inputs),
            file=config.file,
            digest="" if config.file is None else ModuleFile(config.file).digest,
            training=TrainingRecipe(**config.training),
            frames=config.frames,
            scene=parsed_scene(config.scene, "scene"),
        )
    except VoccError as error:
        raise VoccError(f"{section}.{str(error).removeprefix(f'{section}.')}") from None


def _location(settings: Settings) -> PaperLocator:
    """The locator; its refusals name the configuration's key."""
    try:
        return PaperLocator(**asdict(settings.receiver.location))
    except VoccError as error:
        raise VoccError(f"receiver.{error}") from None
