"""The study's section of the configuration."""

from __future__ import annotations

from dataclasses import dataclass, field

from vocc_torch.errors import VoccError
from vocc_torch.measure.config import Experiment, SceneSettings, demand_word


@dataclass
class RivalsConfig:
    """What ``task=classifiers`` compares: see :class:`vocc_torch.studies.classifiers.RivalStudy`."""

    experiments: dict[str, Experiment] = field(default_factory=dict)
    reference: str = ""
    points: dict[str, float] = field(default_factory=dict)
    genie_frames: int = 0
    scenes: dict[str, SceneSettings] = field(default_factory=dict)
    scene_frames: int = 0
    scene_training_frames: int = 0

    def __post_init__(self) -> None:
        """Check the names, which ledgers and tables take, and that no number is negative."""
        for part in ("experiments", "scenes"):
            for name in getattr(self, part):
                demand_word(f"rivals.{part}", name)
        for part in ("genie_frames", "scene_frames", "scene_training_frames"):
            if (value := getattr(self, part)) < 0:
                raise VoccError.of(f"rivals.{part}", value, "at least 0")
