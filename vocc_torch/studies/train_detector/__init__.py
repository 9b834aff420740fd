"""``task=train_detector``, the detector's training: its section of the configuration, without torch."""

from dataclasses import dataclass

from vocc_torch.errors import whole_number

MOST = 1_000_000
"""Most blocks and steps."""


@dataclass
class TrainDetectorConfig:
    """How much the detector's networks see.

    Args:
        small_blocks: blocks of 16 frames of 320 x 320 px, three in four with a panel; at least 1.
        wide_blocks: blocks of 4 whole frames without a panel; at least 0.
        scout_steps: steps of the scout's training, at least 1.
        judge_steps: steps of each of the judge's two trainings, at least 1.

    Raises:
        VoccError: a number out of its range.
    """

    small_blocks: int = 400
    wide_blocks: int = 160
    scout_steps: int = 4000
    judge_steps: int = 4000

    def __post_init__(self) -> None:
        """Check the ranges."""
        for name in ("small_blocks", "scout_steps", "judge_steps"):
            whole_number(f"train_detector.{name}", getattr(self, name), 1, MOST)
        whole_number("train_detector.wide_blocks", self.wide_blocks, 0, MOST)
