"""The study's section of the configuration."""

from __future__ import annotations

from dataclasses import dataclass, field

from vocc_torch.measure.config import ExperimentConfig, SceneConfig


@dataclass
class RivalsConfig:
    """What ``task=classifiers`` compares: see :class:`vocc_torch.studies.classifiers.RivalStudy`."""

    experiments: dict[str, ExperimentConfig] = field(default_factory=dict)
    reference: str = ""
    points: dict[str, float] = field(default_factory=dict)
    genie_frames: int = 0
    scenes: dict[str, SceneConfig] = field(default_factory=dict)
    scene_frames: int = 0
    scene_training_frames: int = 0
