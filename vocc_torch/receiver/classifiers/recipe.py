"""How a module is trained."""

from __future__ import annotations

import math
from dataclasses import dataclass

from vocc_torch.errors import VoccError


@dataclass(frozen=True, slots=True)
class TrainingRecipe:
    """How a module is trained.

    Args:
        frames: training panels, at least 2, whatever the study's budget is; all are held in memory.
        epochs: passes over them at most, at least 1.
        patience: passes without a better validation loss before it stops, at least 1.
        validation: share of the panels that is held back for that, above 0 and below 1.
        batch_leds: LEDs a step, at least 1.
        learning_rate: of Adam at the start, above 0; it falls to 0 along a half cosine.
        weight_decay: at least 0.
        seed: of the weights and of the order of the LEDs.
        checkpoints: folder in which the state after each pass is kept and found again, or None.

    Raises:
        VoccError: a value outside its range.
    """

    frames: int = 4000
    epochs: int = 40
    patience: int = 8
    validation: float = 0.1
    batch_leds: int = 1024
    learning_rate: float = 2e-3
    weight_decay: float = 1e-4
    seed: int = 0
    checkpoints: str | None = None

    def __post_init__(self) -> None:
        """Check every range."""
        for name, least in (("frames", 2), ("epochs", 1), ("patience", 1), ("batch_leds", 1), ("seed", 0)):
            if type(value := getattr(self, name)) is not int or value < least:
                raise VoccError(f"training.{name} is {value}: it must be a whole number, at least {least}")
        if not 0 < self.validation < 1:
            raise VoccError(f"training.validation is {self.validation}: it must be above 0 and below 1")
        if not 0 < self.learning_rate < math.inf:
            raise VoccError(f"training.learning_rate is {self.learning_rate}: it must be above 0")
        if not 0 <= self.weight_decay < math.inf:
            raise VoccError(f"training.weight_decay is {self.weight_decay}: it must be at least 0")
