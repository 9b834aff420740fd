"""From plain configuration dataclasses to a study's plan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import torch

from vocc_torch.config import AppConfig, ClassifierConfig, ExperimentConfig, SceneConfig, effect_settings
from vocc_torch.errors import VoccError
from vocc_torch.receiver.bank import RECEIVER_NAMES
from vocc_torch.receiver.classifiers.inputs import Inputs
from vocc_torch.receiver.classifiers.module_file import ModuleFile
from vocc_torch.receiver.classifiers.training import TrainingRecipe
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.simulation import Camera, LedPanel, SceneModel
from vocc_torch.studies.effect_costs import Catalogue, EffectStudy, Severity
from vocc_torch.studies.optional import without_absent
from vocc_torch.studies.plan import (
    SCENE_FIELDS,
    Budget,
    Experiment,
    Plan,
    ReceiverPlan,
    World,
    parsed_scene,
    resolve_device,
)
from vocc_torch.studies.plug_in import ClassifierPlan
from vocc_torch.studies.rivals import RivalStudy
from vocc_torch.studies.tradeoff import VARIED, RendererKnobs, TradeoffStudy
from vocc_torch.types import PanelShape

T = TypeVar("T")

PRECISIONS = {"float32": torch.float32, "float64": torch.float64}

HALF_PRECISIONS = ("bfloat16", "float16", "half")
"""Known to torch and not offered: they change pixels and decided bits (benchmarks/precision.py)."""


def build_plan(settings: AppConfig, folder: Path) -> Plan:
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
        experiment=_experiment(settings.experiment, "experiment"),
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


def build_experiments(settings: AppConfig, plan: Plan) -> dict[str, dict[float, Plan]]:
    """Build the plans of all experiments of ``task=figures``, by name and row; where there is no grid, one.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    built: dict[str, dict[float, Plan]] = {}
    for name, config in settings.figures.experiments.items():
        section = f"figures.experiments.{name}"
        whole = replace(plan, experiment=_experiment(config, section))
        built[name] = {0.0: whole} if config.row_axis is None else build_rows(whole, config, section)
    return built


def _experiment(config: ExperimentConfig, section: str) -> Experiment:
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


def _world(settings: AppConfig) -> World:
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


def _camera(settings: AppConfig) -> Camera:
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


def _receiver(settings: AppConfig) -> ReceiverPlan:
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


def _location(settings: AppConfig) -> PaperLocator:
    """The locator; its refusals name the configuration's key."""
    try:
        return PaperLocator(**asdict(settings.receiver.location))
    except VoccError as error:
        raise VoccError(f"receiver.{error}") from None


def build_effect_study(settings: AppConfig, folder: Path) -> EffectStudy:
    """Build the study that ``task=effects`` makes.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    plan, config = build_plan(settings, folder), settings.effects
    parts = {name: _mappings(part, f"effects.parts.{name}") for name, part in config.parts.items()}
    severities = {
        name: Severity(one.parameter, _numbers(one.values, f"effects.severity.{name}.values"))
        for name, one in config.severity.items()
    }
    catalogue = Catalogue(plan.world.effects, parts, severities, tuple(config.names))
    # All frames are of the scene itself: no experiment narrows them.
    own = Experiment("effects", "distance_m", (plan.world.scene.nearest_m,))
    return EffectStudy(
        replace(plan, experiment=own),
        catalogue,
        config.located_frames,
        config.severity_frames,
        config.repeats,
        settings.scene.name,
    )


def _mappings(part: object, key: str) -> dict[str, Any]:
    """Check that a part is a mapping of effects to mappings; the registry checks names and parameters."""
    if not isinstance(part, dict):
        raise VoccError(f"{key} is {part!r}: it must be a mapping of effects, each with its parameters")
    return effect_settings(part, key)


def _numbers(values: list[Any], key: str) -> tuple[float, ...]:
    """Check that a severity's values are numbers; whole numbers stay whole."""
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise VoccError(f"{key} has {value!r}: it must be finite numbers from harmless to harsh")
    return tuple(values)


def build_tradeoff_study(settings: AppConfig, folder: Path) -> TradeoffStudy:
    """Build the study that ``task=tradeoff`` makes.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    plan, config = build_plan(settings, folder), settings.tradeoff
    receiver, left_out = without_absent(plan.receiver)
    plan = replace(plan, receiver=receiver)
    scenes = {}
    for name, scene in config.scenes.items():
        if not name.isidentifier() or not isinstance(scene, dict):
            raise VoccError(f"tradeoff.scenes.{name} is {scene!r}: it must be a word with values of scenes")
        scenes[name] = parsed_scene(scene, f"tradeoff.scenes.{name}")
    knobs = config.simulation
    devices, missing = _devices(config.devices)
    return TradeoffStudy(
        # All frames are of the study's own scenes: no experiment narrows them.
        replace(plan, experiment=Experiment("tradeoff", "distance_m", (plan.world.scene.nearest_m,))),
        locators=_once(config.locators),  # type: ignore[arg-type]  # checked by name in TradeoffStudy
        samples_per_led=_once(config.samples_per_led),
        gradients=_once(config.gradients),
        dtypes=_once(config.dtypes),
        varied=_once([one for one in VARIED if one in plan.receiver.names])
        if config.varied is None
        else _once(config.varied),
        combine=config.combine,  # type: ignore[arg-type]  # likewise
        devices=devices,
        batch_sizes=tuple(sorted(_once(config.batch_sizes))),
        frames=_once(config.frames),  # type: ignore[arg-type]  # likewise
        repeats=config.repeats,
        threads=config.threads,
        scenes=scenes,
        knobs=RendererKnobs(
            knobs.frames, tuple(knobs.kernel_sigmas), tuple(knobs.margins_px), _once(knobs.supersampling)
        ),
        scene_name=settings.scene.name,
        frames_a_preamble=config.frames_a_preamble,
        genie_frames=config.genie_frames,
        missing=missing,
        left_out=left_out,
    )


def build_rival_study(settings: AppConfig, folder: Path) -> RivalStudy:
    """Build the study that ``task=classifiers`` makes.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    plan, config = build_plan(settings, folder), settings.rivals
    receiver, left_out = without_absent(plan.receiver)
    plan = replace(plan, receiver=receiver)
    plans = {}
    for name, one in config.experiments.items():
        section = f"rivals.experiments.{name}"
        if one.row_axis is not None:
            raise VoccError(f"{section} is a grid over {one.row_axis}: it must have one axis")
        plans[name] = replace(plan, experiment=_experiment(one, section))
    return RivalStudy(
        plans,
        reference=config.reference,
        points=config.points,
        genie_frames=config.genie_frames,
        home=settings.scene.name,
        # The scene of the experiments may be among the shipped ones or not.
        scenes={
            name: replace(_abroad(settings, scene, name, folder), receiver=receiver)
            for name, scene in config.scenes.items()
            if name != settings.scene.name
        },
        scene_frames=config.scene_frames,
        scene_training_frames=config.scene_training_frames,
        left_out=left_out,
    )


def _abroad(settings: AppConfig, scene: SceneConfig, name: str, folder: Path) -> Plan:
    """The plan of another scene; its refusals name the scene's own key."""
    try:
        return build_plan(replace(settings, scene=scene), folder)
    except VoccError as error:
        raise VoccError(str(error).replace("scene.", f"rivals.scenes.{name}.", 1)) from None


def _once(values: Sequence[T]) -> tuple[T, ...]:
    """Give values in their order, each once."""
    return tuple(dict.fromkeys(values))


def _devices(names: Sequence[str]) -> tuple[tuple[str, ...], dict[str, str]]:
    """Give devices by their own names, and those that this machine does not have with the reason.

    Raises:
        VoccError: no device's name, or none that is there.
    """
    found: list[str] = []
    missing: dict[str, str] = {}
    for name in _once(names):
        try:
            found.append(str(resolve_device(name)))
        except VoccError as error:
            said = str(error).replace("device is", "tradeoff.devices has", 1)
            if not name.startswith("cuda") or len(names) == 1:
                raise VoccError(said) from None
            missing[name] = said.partition(", and ")[2].partition(":")[0]
    return _once(found), missing
