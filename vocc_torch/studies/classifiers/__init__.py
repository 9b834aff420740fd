"""``task=classifiers``: its section of the configuration; nothing here needs torch."""

from dataclasses import dataclass, field

from vocc_torch.measure.config import Experiment, SceneSettings, demand_word


@dataclass
class RivalsConfig:
    """What ``task=classifiers`` compares.

    Args:
        experiments: the axes along which receivers are compared, by name.
        reference: the receiver that the others are compared with.
        points: a value of an experiment's axis that the summary states, by experiment.
        genie_frames: frames a point that the genie decides; 0 for none.
        scenes: other scenes by name.
        scene_frames: test frames for each pair of scenes; 0 for no pairs.
        scene_training_frames: most frames that a receiver learns from there, at least 2.

    Raises:
        VoccError: a name that is no word.
    """

    experiments: dict[str, Experiment] = field(default_factory=dict)
    reference: str = ""
    points: dict[str, float] = field(default_factory=dict)
    genie_frames: int = 0
    scenes: dict[str, SceneSettings] = field(default_factory=dict)
    scene_frames: int = 0
    scene_training_frames: int = 0

    def __post_init__(self) -> None:
        """Check the names, which ledgers and tables take; the study checks the rest."""
        for part in ("experiments", "scenes"):
            for name in getattr(self, part):
                demand_word(f"rivals.{part}", name)
