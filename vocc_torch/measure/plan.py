"""The plan of a study: scene, receivers, budget, and identity."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, Self

import numpy as np
import torch

from vocc_torch.distributions import parsed_scene
from vocc_torch.errors import (
    VoccError,
    demand_least,
    demand_within,
    demand_word,
    section,
)
from vocc_torch.measure.config import Budget as Budget
from vocc_torch.measure.config import Experiment as Experiment
from vocc_torch.plugins import PlugIn
from vocc_torch.receiver.classifiers import Inputs
from vocc_torch.receiver.classifiers.inputs import demand_features
from vocc_torch.receiver.classifiers.training import TrainingRecipe
from vocc_torch.receiver.deciders import FLDA_FEATURES, check_receivers
from vocc_torch.receiver.locators import (
    LOCATORS,
    PanelLocator,
    PaperLocator,
    locator_named,
    plugged_locator,
)
from vocc_torch.receiver.reader import Reader
from vocc_torch.simulation import Camera, Distribution, LedPanel, SceneModel, Simulator
from vocc_torch.simulation.effects import Parameters, build_effects, plug_ins
from vocc_torch.simulation.simulator import PAPER_EFFECTS, Framing
from vocc_torch.types import resolve_device as resolve_device

Locator = str
"""A locator's name; ``truth`` takes the simulator's own corners."""
OWN_LOCATORS = ("truth", *LOCATORS)


@dataclass(frozen=True)
class World:
    """Everything in front of the receiver: camera, panel, scenes and effects, and how they are computed.

    Args:
        camera: the camera.
        panel: the LED panel.
        scene: the distributions of the scenes, in test and training.
        effects: effect name to parameters.
        framing: ``crop``, ``filled`` or ``full``: the rendered part of the sensor. Decisions are equal.
        device: a torch device, or ``auto`` for CUDA where there is one.
        dtype: working precision of the simulation.

    Raises:
        VoccError: a device that this machine does not have.
    """

    camera: Camera = field(default_factory=Camera)
    panel: LedPanel = field(default_factory=LedPanel)
    scene: SceneModel = field(default_factory=SceneModel)
    effects: Mapping[str, Parameters] = field(
        default_factory=lambda: dict(PAPER_EFFECTS)
    )
    framing: Framing = "crop"
    device: str = "auto"
    dtype: torch.dtype = torch.float32

    def simulator(self) -> Simulator:
        """Build the simulator of this world."""
        return Simulator(
            self.camera,
            self.panel,
            self.effects,
            framing=self.framing,
            device=resolve_device(self.device),
            dtype=self.dtype,
        )


@dataclass(frozen=True)
class ClassifierPlan:
    """A classifier as a configuration describes it.

    Args:
        name: its name in the results.
        build: the class and its arguments.
        inputs: what it sees of each LED.
        training: the recipe for a torch module.
        frames: training panels, or None for the study's budget. A recipe has its own number.
        scene: distributions of its training scenes that replace those of the study.

    Raises:
        VoccError: fewer than one training frame.
    """

    name: str
    build: PlugIn
    inputs: Inputs = field(default_factory=Inputs)
    training: TrainingRecipe = field(default_factory=TrainingRecipe)
    frames: int | None = None
    scene: Mapping[str, Distribution] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check what can be checked without building."""
        demand_least(f"classifiers.{self.name}.", self, frames=1)


@dataclass(frozen=True)
class ReceiverPlan:
    """Which receivers run, and what they share.

    Args:
        names: receivers in the order of the results.
        locator: ``paper``, ``refined`` and those from outside locate the panel in the frame; ``truth`` takes
            the true corners.
        location: the settings of the locator ``paper``, which ``refined`` uses too.
        reader: the settings of rectification and features.
        save: the receiver that is written to the model file and decodes recordings.
        classifiers: classifiers that plug in; their names are among ``names``.
        locators: locators that plug in, by name.
        false_alarms: threshold of ``detector``: most false alarms expected in a frame without a panel, above 0.
        preambles: ``frame``: preambles are read at the corners of the test frame; ``located``: the panel is
            located in each of them.

    Raises:
        VoccError: an unknown name, or a rate that is not above 0.
    """

    names: tuple[str, ...] = (
        "center_greyscale",
        "average_greyscale",
        "flda_2",
        "flda_3",
    )
    locator: Locator = "paper"
    location: PaperLocator = field(default_factory=PaperLocator)
    reader: Reader = field(default_factory=Reader)
    save: str = "flda_3"
    classifiers: tuple[ClassifierPlan, ...] = ()
    locators: Mapping[str, PlugIn] = field(default_factory=dict)
    false_alarms: float = 1e-2
    preambles: str = "frame"

    def __post_init__(self) -> None:
        """Check every name, and the rate."""
        key = "receiver.false_alarms"
        demand_within(key, self.false_alarms, 0, math.inf, above=True)
        demand_word("receiver.preambles", self.preambles, ("frame", "located"))
        plugged_in = [classifier.name for classifier in self.classifiers]
        check_receivers(self.names, plugged_in)
        if stray := [name for name in self.locators if name in OWN_LOCATORS]:
            raise VoccError(
                f"locators.{stray[0]} is the name of a locator that ships: choose another"
            )
        self.demand_locators("receiver.locator", [self.locator])
        for classifier in self.classifiers:
            with section(f"classifiers.{classifier.name}"):
                demand_features(classifier.inputs.features, self.reader.names)

    @property
    def reference(self) -> str:
        """The FLDA receiver that others are compared with."""
        return self.save if self.save in FLDA_FEATURES else "flda_3"

    def demand_locators(self, key: str, names: Sequence[str]) -> None:
        """Refuse a locator that nobody knows.

        Raises:
            VoccError: with those that are known.
        """
        for name in names:
            known = (*OWN_LOCATORS, *self.locators)
            demand_word(key, name, known, ", or FILE.py:NAME")

    @property
    def finder(self) -> PanelLocator | None:
        """What finds the panel; None for the simulator's own corners."""
        return self.finders([self.locator])[self.locator]

    def finders(self, locators: Sequence[Locator]) -> dict[str, PanelLocator | None]:
        """Give what finds the panel by name, None for the simulator's own corners.

        Example:
            >>> ReceiverPlan().finders(["truth"])
            {'truth': None}
        """
        found: dict[str, PanelLocator | None] = {}
        for name in locators:
            if name in self.locators:
                found[name] = plugged_locator(self.locators[name])
            elif name == "truth":
                found[name] = None
            else:
                found[name] = locator_named(name, self.location, self.false_alarms)
        return found


@dataclass(frozen=True)
class Plan:
    """A whole study.

    Args:
        world: what is simulated.
        receiver: what receives.
        experiment: the BER curve.
        budget: how many frames.
        seed: root seed, at least 0.
        batch_frames: frames computed at a time, at least 1; it changes speed, never results.

    Raises:
        VoccError: a number outside its range.
    """

    world: World
    receiver: ReceiverPlan
    experiment: Experiment
    budget: Budget
    seed: int = 0
    batch_frames: int = 64

    def __post_init__(self) -> None:
        """Check every range, that auto-ISO can expose every scene, and that the locator knows such panels."""
        if (receiver := self.receiver).locator in LOCATORS:
            locator = LOCATORS[receiver.locator].of(
                receiver.location, receiver.false_alarms
            )
            locator.demand_shape(self.world.panel.shape)
        experiment, world = self.experiment, self.world
        models = {
            f"experiment.values has {at:g}": experiment.model_at(world, at)
            for at in experiment.values
        }
        models["scene.ambient_lx is 0"] = experiment.training_model(world)
        for said, model in models.items():
            if model.ambient_lx.bounds[0] == 0 and world.camera.iso_limits is None:
                place = said if experiment.axis == "ambient_lx" else list(models)[-1]
                raise VoccError(
                    f"{place}: it must be above 0, or give camera.iso_limits: "
                    "auto-ISO has no answer to no light"
                )
        frames, target = self.frames_in_point, self.budget.target_frame_errors
        if target is not None and target > frames:
            raise VoccError.of(
                "budget.target_frame_errors",
                target,
                f"at most the {frames} frames of a point",
            )
        binned = experiment.axis == "contrast"
        if (sampling := self.budget.sampling) and (binned or experiment.rows):
            made = "axis makes contrast" if binned else "rows makes a grid"
            raise VoccError.of(
                "budget.sampling", sampling, f"null where experiment.{made}"
            )
        demand_least("", self, seed=0, batch_frames=1)
        if self.world.panel.shape != self.receiver.reader.shape:
            raise VoccError(
                "the receiver and the panel have different shapes: give panel.rows and panel.columns once"
            )

    def rows(self) -> dict[float, Self]:
        """Give a plan for each row of the experiment's grid, by its value, held in the scenes.

        One curve is its own only row, at 0.

        Example:
            >>> grid = Experiment("dim", "distance_m", (25.0,), row_axis="ambient_lx", rows=(1000.0,))
            >>> row = Plan(World(), ReceiverPlan(), grid, Budget()).rows()[1000.0].experiment
            >>> row.name, row.scene
            ('dim/ambient_lx=1000', {'ambient_lx': 1000.0})
        """
        experiment, rows = self.experiment, {} if self.experiment.rows else {0.0: self}
        for value in experiment.rows:
            name, scene = (
                f"{experiment.name}/{experiment.row_axis}={value:g}",
                {**experiment.scene, str(experiment.row_axis): value},
            )
            row = replace(experiment, name=name, scene=scene, row_axis=None, rows=())
            rows[value] = replace(self, experiment=row)
        return rows

    def locating_with(self, locator: Locator) -> Self:
        """Give the same plan with another locator."""
        return replace(self, receiver=replace(self.receiver, locator=locator))

    @property
    def frames_in_point(self) -> int:
        """Frames that one Monte Carlo point draws at most: the budget, times the bins if there are any."""
        return self.budget.frames * self.experiment.bins


def identity(plan: Plan, locators: Sequence[Locator]) -> dict[str, Any]:
    """Return the settings on which the counts of a plan depend.

    Left out are settings that change only the time or the number of frames: batch size, workers, the frames
    of the budget, the stop rule, and the values of the axis, because each value is a point with its own name.
    Included are the edges of contrast bins, which decide which frames are counted together; the kind of
    device, because rounding may change a pixel by one grey level; and the releases of torch and NumPy.
    Effects are given as they are built, so a default that is written out makes no difference.

    Args:
        plan: the study.
        locators: names of the locators.

    Example:
        >>> experiment = Experiment("d", "distance_m", (50.0,))
        >>> plans = [
        ...     Plan(World(), ReceiverPlan(), experiment, Budget(frames), batch_frames=frames)
        ...     for frames in (64, 128)
        ... ]
        >>> identity(plans[0], ["truth"]) == identity(plans[1], ["truth"])
        True
    """
    settings, experiment = _plain(plan), plan.experiment
    receiver = settings["receiver"]
    del settings["world"]["device"], receiver["save"]
    for classifier in receiver["classifiers"]:
        classifier["training"]["checkpoints"] = None  # where they are changes no weight
    # By name, so that a refusal names the one that differs.
    for parts in (receiver, receiver["reader"]):
        for key, value in parts.items():
            if isinstance(value, list) and key != "names":
                parts[key] = {part["name"]: part for part in value}
    built = build_effects(plan.world.effects)
    effects = {effect.name: _plain(effect) for effect in built}
    for name, part in plug_ins(plan.world.effects).items():
        effects[name] |= {"plug_in": _plain(part)}
    releases = {
        package.__name__: package.__version__.rpartition(".")[0]
        for package in (torch, np)
    }
    return {
        "seed": plan.seed,
        "world": {**settings["world"], "effects": effects},
        "receiver": {**receiver, "locator": list(locators)},
        "experiment": {
            "name": experiment.name,
            "axis": experiment.axis,
            "bins": settings["experiment"]["values"]
            if experiment.axis == "contrast"
            else None,
            "scene": _plain(parsed_scene(experiment.scene)),
            "training": _plain(parsed_scene(experiment.training)),
        },
        "training_frames": plan.budget.training_frames,
        "trainings": plan.budget.trainings,
        "sampling": plan.budget.sampling,
        "made_with": {"device": resolve_device(plan.world.device).type, **releases},
    }


def _plain(value: object) -> Any:
    """Convert a value to plain JSON values, and whole floats to integers, so that 25 and 25.0 are equal."""

    def number(text: str) -> float:
        return int(float(text)) if float(text).is_integer() else float(text)

    return json.loads(json.dumps(value, default=_fields), parse_float=number)


def _fields(value: object) -> object:
    """Return the arguments of a dataclass by name, or the name of a type of torch."""
    if is_dataclass(value):
        # Fields that are no arguments do not distinguish two studies.
        names = [attribute.name for attribute in fields(value) if attribute.init]
        # The fields of a plug-in only name its code and files; these are their contents and digests.
        names += [name for name in ("maker", "files", "digest") if hasattr(value, name)]
        return {name: getattr(value, name) for name in names}
    return dict(value) if isinstance(value, Mapping) else str(value)
