"""From plain configuration dataclasses to a study's plan."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import torch

from vocc_torch.config import AppConfig, effect_settings
from vocc_torch.errors import VoccError
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.receiver.reader import Reader
from vocc_torch.simulation import Camera, LedPanel, SceneModel
from vocc_torch.studies.plan import (
    SCENE_FIELDS,
    Budget,
    Experiment,
    Plan,
    ReceiverPlan,
    World,
    parsed_scene,
)
from vocc_torch.types import PanelShape

PRECISIONS = {"float32": torch.float32, "float64": torch.float64}


def build_plan(settings: AppConfig, folder: Path) -> Plan:
    """Build the plan that a configuration describes, checking every value on the way.

    Args:
        settings: the resolved configuration.
        folder: where the results go.

    Raises:
        VoccError: a value outside its range, named by its key.
    """
    experiment = settings.experiment
    return Plan(
        world=_world(settings),
        receiver=_receiver(settings),
        experiment=Experiment(
            name=experiment.name,
            axis=experiment.axis,
            values=tuple(experiment.values),
            scene=parsed_scene(experiment.scene, "experiment.scene"),
            training=parsed_scene(experiment.training, "experiment.training"),
        ),
        budget=Budget(**asdict(settings.budget)),
        folder=folder,
        seed=settings.seed,
        batch_frames=settings.batch_frames,
    )


def _world(settings: AppConfig) -> World:
    """Camera, panel, scenes and effects."""
    if settings.precision not in PRECISIONS:
        raise VoccError(f"precision is {settings.precision!r}: it must be {' or '.join(PRECISIONS)}")
    camera = asdict(settings.camera)
    limits = camera.pop("iso_limits")
    if limits is not None and len(limits) != 2:
        raise VoccError(f"camera.iso_limits is {limits}: it must be [low, high] or null")
    panel = asdict(settings.panel)
    shape = PanelShape(panel.pop("rows"), panel.pop("columns"))
    distributions = parsed_scene({name: getattr(settings.scene, name) for name in SCENE_FIELDS})
    return World(
        camera=Camera(**camera, iso_limits=None if limits is None else (limits[0], limits[1])),
        panel=LedPanel(shape=shape, **panel),
        scene=SceneModel(**distributions),
        effects=effect_settings(settings.scene.effects),
        framing=settings.framing,  # type: ignore[arg-type]  # checked by name in Simulator
        device=settings.device,
        dtype=PRECISIONS[settings.precision],
    )


def _receiver(settings: AppConfig) -> ReceiverPlan:
    """Receivers and what they share."""
    receiver = settings.receiver
    shape = PanelShape(settings.panel.rows, settings.panel.columns)
    return ReceiverPlan(
        names=tuple(receiver.names),
        locator=receiver.locator,  # type: ignore[arg-type]  # checked by name in ReceiverPlan
        location=_location(settings),
        reader=Reader(shape, receiver.samples_per_led, receiver.gradient),  # type: ignore[arg-type]  # checked there
        save=receiver.save,
    )


def _location(settings: AppConfig) -> PaperLocator:
    """The locator; its refusals name the configuration's key."""
    try:
        return PaperLocator(**asdict(settings.receiver.location))
    except VoccError as error:
        raise VoccError(f"receiver.{error}") from None
