"""What a study is made of, as plain values: no configuration library reaches this floor."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

import torch

from vocc_torch.devices import resolve_device as resolve_device
from vocc_torch.errors import VoccError
from vocc_torch.measure.budget import Budget as Budget
from vocc_torch.measure.plug_in import ClassifierPlan
from vocc_torch.receiver.bank import FLDA_FEATURES, check_receivers
from vocc_torch.receiver.location import PaperLocator
from vocc_torch.receiver.locators import LocatorName, PanelLocator, locator_named
from vocc_torch.receiver.reader import Reader
from vocc_torch.simulation import Camera, Distribution, LedPanel, SceneModel, Simulator
from vocc_torch.simulation.effects import Parameters
from vocc_torch.simulation.simulator import PAPER_EFFECTS, Framing

Locator = Literal["truth", LocatorName]
SCENE_FIELDS = tuple(f.name for f in dataclasses.fields(SceneModel))


def narrowed(
    model: SceneModel, changes: Mapping[str, Distribution], section: str = "experiment.scene"
) -> SceneModel:
    """Give the scene model with some of its distributions replaced.

    Args:
        model: the scenes.
        changes: distributions by the name of a value of a scene.
        section: the key under which a refusal names them.

    Raises:
        VoccError: an unknown name, or a value outside its physical range.

    Example:
        >>> narrowed(SceneModel(), {"distance_m": Distribution("constant", (50.0,))}).nearest_m
        50.0
    """
    for name in changes:
        if name not in SCENE_FIELDS:
            raise VoccError(
                f"{section}.{name} is not a value of a scene: known are {', '.join(SCENE_FIELDS)}"
            )
    with _named(section):
        return dataclasses.replace(model, **changes)


@contextmanager
def _named(section: str) -> Iterator[None]:
    """Let a refusal of ``scene.<name>`` name the key that the value came from."""
    try:
        yield
    except VoccError as error:
        raise VoccError(re.sub(r"^scene\b", section, str(error))) from None


@dataclass(frozen=True)
class World:
    """Everything in front of the receiver: camera, panel, scenes and effects, and how they are computed.

    Args:
        camera: the camera.
        panel: the LED panel.
        scene: the distributions of the scenes, which are also those that a receiver trains on.
        effects: effect name to parameters.
        framing: ``crop``, ``filled`` or ``full``: what is rendered, never what is decided.
        device: a torch device, or ``auto`` for CUDA where there is one.
        dtype: working precision of the simulation.

    Raises:
        VoccError: a device that this machine does not have.
    """

    camera: Camera = field(default_factory=Camera)
    panel: LedPanel = field(default_factory=LedPanel)
    scene: SceneModel = field(default_factory=SceneModel)
    effects: Mapping[str, Parameters] = field(default_factory=lambda: dict(PAPER_EFFECTS))
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
class ReceiverPlan:
    """Which receivers run, and what they share.

    Args:
        names: receivers in the order of the results.
        locator: ``paper`` and ``refined`` locate the panel in the frame; ``truth`` takes the true corners.
        location: the settings of the paper's locator, which the refined one uses too.
        reader: the settings of rectification and features.
        save: the FLDA receiver that is written to the model file and decodes recordings.
        classifiers: those that plug in; their names are among ``names``.

    Raises:
        VoccError: an unknown name.
    """

    names: tuple[str, ...] = ("center_greyscale", "average_greyscale", "flda_2", "flda_3")
    locator: Locator = "paper"
    location: PaperLocator = field(default_factory=PaperLocator)
    reader: Reader = field(default_factory=Reader)
    save: str = "flda_3"
    classifiers: tuple[ClassifierPlan, ...] = ()

    def __post_init__(self) -> None:
        """Check every name."""
        check_receivers(self.names, [one.name for one in self.classifiers])
        if self.locator not in (known := get_args(Locator)):
            raise VoccError(f"receiver.locator is {self.locator!r}: it must be {' or '.join(known)}")
        if self.save not in FLDA_FEATURES:
            raise VoccError(f"receiver.save is {self.save!r}: it must be one of {', '.join(FLDA_FEATURES)}")

    def finders(self, locators: Sequence[Locator]) -> dict[str, PanelLocator | None]:
        """Give what finds the panel by name, None for the simulator's own corners.

        Example:
            >>> ReceiverPlan().finders(["truth"])
            {'truth': None}
        """
        return {name: None if name == "truth" else locator_named(name, self.location) for name in locators}


@dataclass(frozen=True)
class Experiment:
    """One BER curve: an axis, its values and how the test scenes differ from the training scenes.

    Args:
        name: its name in the results.
        axis: a value of a scene, or ``contrast``, by which frames are sorted into bins after they are drawn.
        values: the points of the axis, ascending; for ``contrast`` the edges of the bins.
        scene: distributions of the test scenes that replace those of the world.
        training: distributions of the training scenes that replace those of the world.

    Raises:
        VoccError: an unknown axis, or values that are missing, not ascending or not finite.
    """

    name: str
    axis: str
    values: tuple[float, ...]
    scene: Mapping[str, Distribution] = field(default_factory=dict)
    training: Mapping[str, Distribution] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the axis and its values."""
        if self.axis not in (*SCENE_FIELDS, "contrast"):
            known = ", ".join((*SCENE_FIELDS, "contrast"))
            raise VoccError(f"experiment.axis is {self.axis!r}: it must be one of {known}")
        if self.name in ("", "train"):
            raise VoccError(
                f"experiment.name is {self.name!r}: it must be a name, and train is training's own"
            )
        least = 2 if self.axis == "contrast" else 1
        ascending = all(a < b for a, b in zip(self.values, self.values[1:], strict=False))
        if len(self.values) < least or not ascending or not all(map(math.isfinite, self.values)):
            rule = f"finite numbers in ascending order, at least {least} of them"
            raise VoccError(f"experiment.values is {list(self.values)}: it must be {rule}")
        if self.axis == "contrast" and self.values[0] < 0:
            raise VoccError(
                f"experiment.values has {self.values[0]:g}: contrast, (G_on - G_off) / 255, is at least 0"
            )

    @property
    def bins(self) -> int:
        """How many points share the frames of one run: the bins of contrast, otherwise 1."""
        return len(self.values) - 1 if self.axis == "contrast" else 1

    def at_row(self, axis: str, value: float) -> Experiment:
        """Give one row of a grid: this experiment with one more value of its scenes held.

        Example:
            >>> row = Experiment("dimming", "led_luminance_cd_m2", (250.0,)).at_row("ambient_lx", 1000.0)
            >>> row.name, row.scene["ambient_lx"].bounds
            ('dimming/ambient_lx=1000', (1000.0, 1000.0))
        """
        held = {**self.scene, axis: Distribution("constant", (value,))}
        return dataclasses.replace(self, name=f"{self.name}/{axis}={value:g}", scene=held)

    def model_at(self, world: World, value: float) -> SceneModel:
        """The scenes of one point of the axis."""
        model = narrowed(world.scene, self.scene)
        if self.axis == "contrast":
            return model
        try:
            return dataclasses.replace(model, **{self.axis: Distribution("constant", (value,))})
        except VoccError as error:
            raise VoccError(str(error).replace(f"scene.{self.axis} is", "experiment.values has", 1)) from None

    def training_model(self, world: World) -> SceneModel:
        """The scenes that a receiver trains on."""
        return narrowed(world.scene, self.training, "experiment.training")


@dataclass(frozen=True)
class Plan:
    """A whole study.

    Args:
        world: what is simulated.
        receiver: what receives.
        experiment: the BER curve.
        budget: how many frames.
        folder: where the results go.
        seed: root seed, at least 0.
        batch_frames: frames computed at a time, at least 1; it changes speed, never results.

    Raises:
        VoccError: a number outside its range.
    """

    world: World
    receiver: ReceiverPlan
    experiment: Experiment
    budget: Budget
    folder: Path
    seed: int = 0
    batch_frames: int = 64

    def __post_init__(self) -> None:
        """Check every range, and that every point and the training have scenes."""
        for value in self.experiment.values:
            tested = f"experiment.values has {value:g}" if self.experiment.axis == "ambient_lx" else None
            self._demand_exposure(self.experiment.model_at(self.world, value), tested)
        self._demand_exposure(self.experiment.training_model(self.world))
        frames, target = self.frames_in_point, self.budget.target_frame_errors
        if target is not None and target > frames:
            raise VoccError(
                f"budget.target_frame_errors is {target}: a point of {frames} frames cannot have as many; "
                "raise budget.frames or lower the target"
            )
        if self.seed < 0:
            raise VoccError(f"seed is {self.seed}: it must be at least 0")
        if self.batch_frames < 1:
            raise VoccError(f"batch_frames is {self.batch_frames}: it must be at least 1")
        if self.world.panel.shape != self.receiver.reader.shape:
            raise VoccError(
                "the receiver and the panel have different shapes: give panel.rows and panel.columns once"
            )

    def _demand_exposure(self, model: SceneModel, said: str | None = None) -> None:
        """Refuse scenes without ambient light where auto-ISO has no limit, before any work is done."""
        if model.ambient_lx.bounds[0] == 0 and self.world.camera.iso_limits is None:
            rule = "it must be above 0, or give camera.iso_limits: auto-ISO has no answer to no light"
            raise VoccError(f"{said or 'scene.ambient_lx is 0'}: {rule}")

    @property
    def frames_in_point(self) -> int:
        """Frames that one Monte Carlo point draws at most: the budget, times the bins if there are any."""
        return self.budget.frames * self.experiment.bins


def parsed_scene(
    specs: Mapping[str, float | Sequence[object]], section: str = "scene"
) -> dict[str, Distribution]:
    """Read distributions by name, as a configuration writes them; ``section`` is their key in a refusal.

    Raises:
        VoccError: an unknown name or a specification that cannot be read.

    Example:
        >>> parsed_scene({"distance_m": ["uniform", 40, 60]})["distance_m"].bounds
        (40.0, 60.0)
    """
    for name in specs:
        if name not in SCENE_FIELDS:
            raise VoccError(
                f"{section}.{name} is not a value of a scene: known are {', '.join(SCENE_FIELDS)}"
            )
    with _named(section):
        return {name: Distribution.parse(spec, name) for name, spec in specs.items()}
