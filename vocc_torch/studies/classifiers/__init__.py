"""``task=classifiers``: its section of the configuration; nothing here needs torch."""

from dataclasses import dataclass, field

from vocc_torch.measure.config import Experiment, SceneSettings, demand_word


@dataclass
class RivalsConfig:
    """What ``task=classifiers`` compares: see :class:`.plan.ClassifierStudy`."""

    experiments: dict[str, Experiment] = field(default_factory=dict)
    reference: str = ""
    points: dict[str, float] = field(default_factory=dict)
    genie_frames: int = 0
    scenes: dict[str, SceneSettings] = field(default_factory=dict)
    scene_frames: int = 0
    scene_training_frames: int = 0

    def __post_init__(self) -> None:
        """Check the names, which ledgers and tables take; the study checks its numbers."""
        for part in ("experiments", "scenes"):
            for name in getattr(self, part):
                demand_word(f"rivals.{part}", name)
