"""A classifier that plugs in, as a configuration describes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from vocc_torch.errors import VoccError
from vocc_torch.receiver.classifiers.inputs import Inputs
from vocc_torch.receiver.classifiers.training import TrainingRecipe
from vocc_torch.simulation import Distribution

TARGET = "_target_"
"""The key that names a class."""


@dataclass(frozen=True)
class ClassifierPlan:
    """A classifier as a configuration describes it.

    Args:
        name: its name in the results.
        build: ``_target_`` names a class, or a class of ``file``; the other keys are its arguments.
        inputs: what it sees of each LED.
        file: a Python file outside the package that defines the class, or None.
        digest: what tells the file's text from another.
        training: the recipe for a torch module.
        frames: training panels, or None for the study's budget; a recipe has a number of its own.
        scene: distributions of its training scenes that replace those of the study.

    Raises:
        VoccError: no ``_target_``, or fewer than one training frame.
    """

    name: str
    build: Mapping[str, object]
    inputs: Inputs = field(default_factory=Inputs)
    file: str | None = None
    digest: str = ""
    training: TrainingRecipe = field(default_factory=TrainingRecipe)
    frames: int | None = None
    scene: Mapping[str, Distribution] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check what can be checked without building."""
        if not isinstance(self.build.get(TARGET), str):
            raise VoccError(f"classifiers.{self.name}.build has no {TARGET}: it must name a class")
        if self.frames is not None and self.frames < 1:
            section = f"classifiers.{self.name}.frames"
            raise VoccError(f"{section} is {self.frames}: it must be at least 1, or null")
