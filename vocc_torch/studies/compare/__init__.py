"""Comparisons of receivers: the sections of the configuration, without torch."""

from dataclasses import dataclass, field
from typing import Any

from vocc_torch.measure.config import Experiment, SceneSettings, demand_file_word


@dataclass
class TradeoffConfig:
    """What ``task=tradeoff`` compares, and how it is timed.

    Args:
        locators: locators; every receiver is measured with each.
        batch_sizes: frames per call.
        frames: what is timed: ``whole`` frames or ``crops``.
        repeats: timed rounds, at least 1. Small batches have more rounds, so that all see equally many
            frames.
        threads: torch's threads during timing; 0 is torch's choice.
    """

    locators: list[str] = field(default_factory=list)
    batch_sizes: list[int] = field(default_factory=list)
    frames: str = "whole"
    repeats: int = 0
    threads: int = 0


@dataclass
class ComparisonConfig:
    """What ``task=classifiers`` compares.

    Args:
        experiments: the axes along which receivers are compared, by name.
        reference: the receiver that the others are compared with.
        points: a value of an experiment's axis that the table states, by experiment.
        scenes: other scenes by name.
        scene_frames: test frames for each pair of training and test scene; 0 leaves pairs out.
        scene_training_frames: most training frames in each of the other scenes, at least 2.

    Raises:
        VoccError: a name that is no word.
    """

    experiments: dict[str, Experiment] = field(default_factory=dict)
    reference: str = ""
    points: dict[str, float] = field(default_factory=dict)
    scenes: dict[str, SceneSettings] = field(default_factory=dict)
    scene_frames: int = 0
    scene_training_frames: int = 0

    def __post_init__(self) -> None:
        """Check the names, which ledgers and tables take; the study checks the rest."""
        for part in ("experiments", "scenes"):
            for name in getattr(self, part):
                demand_file_word(f"comparison.{part}", name)


@dataclass
class Severity:
    """A parameter along which an effect becomes harsher.

    Args:
        parameter: ``effect.parameter``.
        values: numbers from harmless to harsh, at least one, rising or falling.
    """

    parameter: str = ""
    values: list[Any] = field(default_factory=list)


@dataclass
class EffectsConfig:
    """What ``task=effects`` looks at: see :class:`vocc_torch.studies.compare.effect_scenes.EffectStudy`.

    Args:
        names: effects to measure; [] measures all.
        located_frames: frames with the locator ``paper`` for an effect that fills the sensor; other effects
            have budget.frames. 0 leaves the locator out.
        severity_frames: frames per severity, at true corners; 0 leaves severities out.
        repeats: timed rounds, at least 1.
        parts: what is added for each effect: the effect and those that it needs.
        severity: the parameter that makes each effect more severe, and its values.
    """

    names: list[str] = field(default_factory=list)
    located_frames: int = 0
    severity_frames: int = 0
    repeats: int = 0
    parts: dict[str, Any] = field(default_factory=dict)
    # A Severity each; the command line adds none to a mapping of those.
    severity: dict[str, Any] = field(default_factory=dict)
