"""Comparisons of receivers: the sections of the configuration, without torch."""

from dataclasses import dataclass, field
from typing import Any

from vocc_torch.measure.config import Experiment, SceneSettings, demand_file_word


@dataclass
class TradeoffConfig:
    """What ``task=tradeoff`` compares, and how times are taken.

    Args:
        locators: what finds the panel; every receiver is measured with each.
        batch_sizes: frames at a time.
        frames: what is handed to the receiver while times are taken: ``whole`` frames or ``crops``.
        repeats: timed rounds, at least 1; small batches have more, so that all meet as many frames.
        threads: threads within an operation while times are taken; 0 for torch's own choice.
    """

    locators: list[str] = field(default_factory=list)
    batch_sizes: list[int] = field(default_factory=list)
    frames: str = "whole"
    repeats: int = 0
    threads: int = 0


@dataclass
class RivalsConfig:
    """What ``task=classifiers`` compares.

    Args:
        experiments: the axes along which receivers are compared, by name.
        reference: the receiver that the others are compared with.
        points: a value of an experiment's axis that the table states, by experiment.
        scenes: other scenes by name.
        scene_frames: test frames for each pair of scenes; 0 for no pairs.
        scene_training_frames: most frames that a receiver learns from there, at least 2.

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
                demand_file_word(f"rivals.{part}", name)


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
    """What ``task=effects`` looks at: see :class:`vocc_torch.studies.compare.effect_plan.EffectStudy`.

    Args:
        names: some of the effects; all by default.
        located_frames: frames with the paper's locator where an effect fills the sensor; 0 leaves it out.
        severity_frames: frames at each severity, true corners; 0 leaves the severities out.
        repeats: timed rounds, at least 1.
        parts: what is added: by an effect's name, it with what it needs.
        severity: by an effect's name, the parameter along which it becomes harsher.
    """

    names: list[str] = field(default_factory=list)
    located_frames: int = 0
    severity_frames: int = 0
    repeats: int = 0
    parts: dict[str, Any] = field(default_factory=dict)
    # A Severity each; the command line adds none to a mapping of those.
    severity: dict[str, Any] = field(default_factory=dict)
