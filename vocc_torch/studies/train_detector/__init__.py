"""``task=train_detector``, the detector's training: its section of the configuration, without torch."""

from dataclasses import dataclass

from vocc_torch.errors import whole_number

MOST = 1_000_000
"""Most rounds and steps."""


@dataclass
class TrainDetectorConfig:
    """How long the detector's networks are trained.

    Args:
        rounds: rounds of 1008 rendered frames of streets, clutter, photographs and a plain scene, at least 1.
        scout_steps: steps of the scout's training, at least 1.
        judge_steps: steps of the judge's training, at least 1.
        placer_steps: steps of the placer's training, at least 1.
        batch: factor of the batch sizes 72, 128 and 156 and of the number of mined frames, at least 1.

    Raises:
        VoccError: a number out of its range.
    """

    rounds: int = 12
    scout_steps: int = 10_000
    judge_steps: int = 10_000
    placer_steps: int = 10_000
    batch: int = 1

    def __post_init__(self) -> None:
        """Check the ranges."""
        for name in ("rounds", "scout_steps", "judge_steps", "placer_steps", "batch"):
            whole_number(f"train_detector.{name}", getattr(self, name), 1, MOST)
