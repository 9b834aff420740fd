"""Comparisons of receivers: the sections of the configuration, without torch."""

from dataclasses import dataclass, field
from typing import Any

from vocc_torch.measure.config import Experiment, SceneSettings, demand_word


@dataclass
class TradeoffConfig:
    """What ``task=tradeoff`` compares, on which frames, and how times are taken.

    Of each list the first value is the base: every receiver is measured there with each of the locators, and
    those that are ``varied`` at the other values too.

    Args:
        locators: what finds the panel.
        samples_per_led: samples along an LED cell's side.
        gradients: kernels of the gradient.
        dtypes: working precisions of rectification and features.
        varied: receivers that are measured at further values too; null for flda_3 and lmmse.
        combine: ``one_at_a_time`` varies samples, gradient and precision by itself, ``all`` combines them.
        devices: where times are taken.
        batch_sizes: frames at a time.
        frames: what is handed to the receiver: ``whole`` frames, ``crops``.
        repeats: timed rounds, at least 1; small batches have more, so that all meet as many frames.
        threads: threads within an operation while times are taken; 0 for torch's own choice.
        frames_a_preamble: frames of data that a pair of frames of known bits serves, at least 1; errors are
            counted with a pair for each.
        scenes: kinds of scenes by name: what they narrow.
        onnx: whether reading located panels in onnxruntime is timed too, on the CPU; an extra.
    """

    locators: list[str] = field(default_factory=list)
    samples_per_led: list[int] = field(default_factory=list)
    gradients: list[str] = field(default_factory=list)
    dtypes: list[str] = field(default_factory=list)
    varied: list[str] | None = None
    combine: str = "one_at_a_time"
    devices: list[str] = field(default_factory=list)
    batch_sizes: list[int] = field(default_factory=list)
    frames: list[str] = field(default_factory=list)
    repeats: int = 0
    threads: int = 0
    frames_a_preamble: int = 1
    scenes: dict[str, Any] = field(default_factory=dict)
    onnx: bool = False


@dataclass
class RivalsConfig:
    """What ``task=classifiers`` compares.

    Args:
        experiments: the axes along which receivers are compared, by name.
        reference: the receiver that the others are compared with.
        points: a value of an experiment's axis that the summary states, by experiment.
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
                demand_word(f"rivals.{part}", name)


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
