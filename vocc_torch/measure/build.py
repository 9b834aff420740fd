"""From the settings to a study's plan."""

from __future__ import annotations

from dataclasses import asdict, fields, replace
from pathlib import Path

import torch

from vocc_torch.errors import VoccError, section
from vocc_torch.hardware import Camera, LedPanel, PanelShape
from vocc_torch.measure.config import ClassifierSettings, Settings, effect_settings
from vocc_torch.measure.plan import SCENE_FIELDS, Plan, ReceiverPlan, World, parsed_scene
from vocc_torch.measure.plug_in import ClassifierPlan
from vocc_torch.receiver.bank import RECEIVER_NAMES
from vocc_torch.receiver.classifiers.inputs import Inputs
from vocc_torch.receiver.classifiers.module_file import ModuleFile
from vocc_torch.receiver.classifiers.training import TrainingRecipe
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.simulation import SceneModel
from vocc_torch.types import resolve_device

PRECISIONS = {"float32": torch.float32, "float64": torch.float64}

HALF_PRECISIONS = ("bfloat16", "float16", "half")
"""Known to torch and not offered: they change pixels and decided bits (benchmarks/precision.py)."""

RESERVED = (*RECEIVER_NAMES, "_summary")
"""Names that no classifier may have: those of receivers, and of the board that compares them."""


def build_plan(settings: Settings, folder: Path) -> Plan:
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
    shape = PanelShape(panel.pop("rows"), panel.pop("columns"))
    classifiers = tuple(_classifier(name, one) for name, one in settings.classifiers.items())
    world = World(
        camera=_camera(settings),
        panel=LedPanel(shape=shape, **panel),
        scene=SceneModel(**parsed_scene({name: getattr(scene, name) for name in SCENE_FIELDS})),
        effects=effect_settings(scene.effects),
        framing=settings.framing,  # type: ignore[arg-type]  # checked by name in Simulator
        device=settings.device,
        dtype=PRECISIONS[settings.precision],
    )
    receivers = ReceiverPlan(
        names=(*receiver.names, *settings.classifiers),
        classifiers=classifiers,
        locator=receiver.locator,  # type: ignore[arg-type]  # checked by name in ReceiverPlan
        location=PaperLocator(**asdict(receiver.location)),
        reader=Reader(shape, receiver.samples_per_led, receiver.gradient),  # type: ignore[arg-type]  # checked there
        save=receiver.save,
    )
    return Plan(
        world=world,
        receiver=receivers,
        experiment=settings.experiment,
        budget=settings.budget,
        folder=folder,
        seed=settings.seed,
        batch_frames=settings.batch_frames,
    )


def _camera(settings: Settings) -> Camera:
    """The camera with the scene's settings of it; refusals name the key that the value came from."""
    own = {name: value for name, value in vars(settings.scene.camera).items() if value is not None}
    with section("scene.camera", before="camera"):
        return replace(settings.camera, **own)


def _classifier(name: str, config: ClassifierSettings) -> ClassifierPlan:
    """A classifier that plugs in; its refusals name the configuration's key."""
    key = f"classifiers.{name}"
    if not name.isidentifier() or name in RESERVED:
        raise VoccError(f"{key}: a classifier's name must be a word, and none of {', '.join(RESERVED)}")
    with section(key):
        keys = {one.name for one in fields(TrainingRecipe)}
        for word in config.training:
            if word not in keys:
                raise VoccError(f"training.{word} is not a known key: known are {', '.join(sorted(keys))}")
        return ClassifierPlan(
            name=name,
            build=config.build,
            inputs=Inputs.parse(config.inputs),
            file=config.file,
            digest="" if config.file is None else ModuleFile(config.file).digest,
            training=TrainingRecipe(**config.training),
            frames=config.frames,
            scene=parsed_scene(config.scene),
        )
