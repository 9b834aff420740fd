"""``task=train_detector``, the detector's training: its section of the configuration, without torch."""

from dataclasses import dataclass

from vocc_torch.errors import whole_number

MOST = 1_000_000
"""Most rounds and steps."""


@dataclass
class TrainDetectorConfig:
    """How much the detector's networks see.

    Args:
        rounds: rounds of 128 rendered frames of streets, a quarter of them without a panel; at least 1.
        scout_steps: steps of the scout's training, at least 1.
        judge_steps: steps of the judge's training, at least 1.

    Raises:
        VoccError: a number out of its range.
    """

    rounds: int = 12
    scout_steps: int = 12000
    judge_steps: int = 12000

    def __post_init__(self) -> None:
        """Check the ranges."""
        for name in ("rounds", "scout_steps", "judge_steps"):
            whole_number(f"train_detector.{name}", getattr(self, name), 1, MOST)
